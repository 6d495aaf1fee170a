"""Which physics a model leaves out."""

from .diagnose import diagnose
from .result import Diagnosis

__all__ = ["Diagnosis", "diagnose"]
