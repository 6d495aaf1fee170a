"""`python -m gtr_jax` is `gtr`."""

import sys

from .cli import command

if __name__ == "__main__":
    sys.exit(command())
