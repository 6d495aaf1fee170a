"""Recordings in, fitted parameters out, how certain they are, and how well the model describes them."""

from .estimate import Estimate, Profile
from .fit import fit
from .posterior_draws import Posterior
from .result import Channel, FitResult, FittedRecording

__all__ = ["Channel", "Estimate", "FitResult", "FittedRecording", "Posterior", "Profile", "fit"]
