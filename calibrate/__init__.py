"""Recordings in, fitted parameters out, how certain they are, and how well the model describes them."""

from .estimate import Estimate
from .fit import fit
from .result import FitResult

__all__ = ["Estimate", "FitResult", "fit"]
