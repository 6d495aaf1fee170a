"""Fit parameters to recordings, with their uncertainty, and find which physics the model leaves out."""

from typing import TYPE_CHECKING, Any

from gtr_jax.notebook import cards_come_with

from .fitting.fit import fit
from .fitting.fitted import FittedChannel, FittedRecording
from .fitting.result import FitResult
from .inference.estimate import Estimate, Profile
from .inference.posterior_draws import Posterior

if TYPE_CHECKING:
    from .diagnosis.answer.result import Diagnosis
    from .diagnosis.diagnose import diagnose

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


def _import_cards() -> None:
    from .report import cards  # noqa: F401


cards_come_with(_import_cards)


def __getattr__(name: str) -> Any:
    """Import the diagnosis, which a fit does not need, only when it is first used."""
    if name == "Diagnosis":
        from .diagnosis.answer.result import Diagnosis

        return Diagnosis
    if name == "diagnose":
        from .diagnosis.diagnose import diagnose

        return diagnose
    raise AttributeError(f"module 'calibrate' has no attribute '{name}'")
