"""The same frictionless rod solved by this project and by its peers, each in an environment of its own."""
