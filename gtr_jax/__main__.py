"""`python -m gtr_jax` is `gtr`."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
