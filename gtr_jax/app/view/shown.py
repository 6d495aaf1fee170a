"""What the page is asked to show, and what it then shows."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from .compared import ANGLE, TENSION, compared
from .figures import Plotted
from .ghosts import Ghost
from .histories import History
from .model import Curves, Setting
from .postures import Drawing


@dataclasses.dataclass(frozen=True, eq=False)
class Wanted:
    """What the page is to show: a robot along a history, at a step, None for that of the largest tension; the
    quantity that it is compared by, and the steps that are brushed.
    """

    setting: Setting
    history: History
    step: int | None
    ghosts: Sequence[Ghost]
    quantity: str
    brushed: Sequence[int]


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """What it then shows: curves, those of ghosts, the step and the body there, midlines of brushed steps
    from each side, the bodies of ghosts by colour, and how long it took [s].
    """

    plotted: Plotted
    others: list[Plotted]
    step: int
    drawing: Drawing
    brushed: list[list[np.ndarray]]
    ghosts: list[tuple[str, Drawing]]
    seconds: float

    @property
    def curves(self) -> Curves:
        """The simulation."""
        return self.plotted.curves


def plotted(colour: str, curves: Curves, quantity: str) -> Plotted:
    """Curves with the quantity that they are compared by; tensions are drawn in any case, so that the last
    plot then shows how the tip turns.
    """
    chosen = compared(curves, quantity)
    traced = chosen if quantity != TENSION else compared(curves, ANGLE)
    return Plotted(colour, curves, None if np.all(np.isnan(chosen.recorded)) else chosen, traced)
