"""Which physics a model leaves out."""

from .answer.result import Diagnosis
from .diagnose import diagnose

__all__ = ["Diagnosis", "diagnose"]
