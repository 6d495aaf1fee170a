"""What to measure next: experiments simulated under all that recordings leave open, and ranked.

`plan` serves `gtr next`, `propose` a diagnosis. Both go from `candidates.py`
(with `load_histories.py` and `ways_to_drive.py`) to `outcome.py`, `worth.py`, `choice.py` and `words.py`.
"""

from .model import OpenModel
from .opened import Opened, open_files, open_folder
from .plan import Plan, plan

__all__ = ["OpenModel", "Opened", "Plan", "open_files", "open_folder", "plan"]
