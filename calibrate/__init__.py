"""Recordings in; out come fitted parameters, how certain they are, and which physics the model leaves out."""

from typing import TYPE_CHECKING, Any

from .estimate import Estimate, Profile
from .fit import fit
from .posterior_draws import Posterior
from .result import FitResult, FittedChannel, FittedRecording

if TYPE_CHECKING:
    from .diagnosis import Diagnosis, diagnose

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


def __getattr__(name: str) -> Any:
    """What a fit does not need is imported when it is first asked for."""
    if name in ("Diagnosis", "diagnose"):
        from . import diagnosis

        return getattr(diagnosis, name)
    raise AttributeError(f"module 'calibrate' has no attribute '{name}'")
