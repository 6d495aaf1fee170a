"""What comes from outside of the catalogue: episodes, disturbances, readings that stand still."""
