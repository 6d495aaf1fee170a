"""Recordings in; out come fitted parameters, how certain they are, and which physics the model leaves out."""

from .diagnosis import Diagnosis, diagnose
from .estimate import Estimate, Profile
from .fit import fit
from .posterior_draws import Posterior
from .result import FitResult, FittedChannel, FittedRecording

__all__ = [
    "Diagnosis",
    "Estimate",
    "FitResult",
    "FittedChannel",
    "FittedRecording",
    "Posterior",
    "Profile",
    "diagnose",
    "fit",
]
