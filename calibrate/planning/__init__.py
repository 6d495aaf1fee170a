"""What to measure next: experiments simulated under all that recordings leave open, and ranked."""

from .model import OpenModel
from .opened import Opened, open_files, open_folder
from .plan import Plan, plan

__all__ = ["OpenModel", "Opened", "Plan", "open_files", "open_folder", "plan"]
