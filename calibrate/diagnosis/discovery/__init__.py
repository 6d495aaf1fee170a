"""Laws that no catalogue holds: looked for in the residual, fitted inside the simulator, judged on unseen
samples.
"""

from .discover import Discovery, discover, with_laws
from .shown import FoundLaw, found_law, with_law

__all__ = ["Discovery", "FoundLaw", "discover", "found_law", "with_law", "with_laws"]
