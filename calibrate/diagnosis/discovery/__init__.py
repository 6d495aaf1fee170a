"""Laws that no catalogue holds: looked for in the residual, fitted inside the simulator, judged on unseen
samples.
"""

from .discover import Discovery, discover

__all__ = ["Discovery", "discover"]
