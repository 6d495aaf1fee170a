"""Text, units, tables, recordings and robot files: read, checked and written."""
