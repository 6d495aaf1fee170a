"""Split: numbers that differ between the recordings get a value for each."""

from __future__ import annotations

from collections.abc import Callable

from calibrate.diagnosis.search.differ import MOST, Difference, differing
from calibrate.inference.setup import Observation

from .fit import BaseFits, Start
from .may_be_missing import hypotheses_of


def split(
    fits: BaseFits, parts: list[Observation], start: Start | None, say: Callable[[str], None]
) -> tuple[Start | None, list[Difference]]:
    """The base model with a value for each recording of the numbers that differ between them, and these.

    Args:
        fits: of the base model.
        parts: the recordings.
        start: the base model fitted with one value for all.
        say: called with a line of text at each stage.
    """
    differ: list[Difference] = []
    while start is not None and fits.several and len(differ) < MOST:
        say("testing whether one number differs between the recordings")
        possible = hypotheses_of(fits.coarse, start.base, start.full, fits.untried)
        found = differing(start.likelihood, start.base, fits.robot, possible)
        if found is None:
            break
        numbers, left, at, difference = found
        again = fits.fit(parts, at, numbers, left)
        if again is None:
            break
        start, differ = again, [*differ, difference]
    return start, differ
