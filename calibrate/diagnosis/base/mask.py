"""Mask: what of a long recording no model of its load history can know is left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from calibrate.diagnosis.hypotheses.hypotheses import DELAYS
from calibrate.diagnosis.likelihood.likelihood import change_by
from calibrate.diagnosis.outside.disturbances import behind_gaps, disturbances, within
from calibrate.diagnosis.outside.leave_out import Stretch, without
from calibrate.inference.setup import Observation

from .fit import BaseFits, Start


def mask(
    fits: BaseFits,
    parts: list[Observation],
    asked: Sequence[Stretch],
    start: Start | None,
    say: Callable[[str], None],
) -> tuple[list[Observation], Start | None, list[Stretch]]:
    """The recordings without what something outside the model does to a long one, the base model fitted to
    them, and what is left out.

    Args:
        fits: of the base model.
        parts: the recordings.
        asked: stretches of the first that are left out as asked.
        start: the base model fitted.
        say: called with a line of text at each stage.
    """
    as_asked, outside = parts[0], list[Stretch]()
    for _ in range(fits.rules.looks_outside):
        more = [] if start is None else _from_outside(as_asked, start)
        if start is None or not more:
            break
        say("leaving out where the tip moves in a way that the base cannot have caused, and after gaps")
        without_them = [without(as_asked, [*asked, *more])]
        again = fits.fit(without_them, start.base.x)
        if again is None:
            break
        parts, start, outside = without_them, again, more
    return parts, start, outside


def _from_outside(part: Observation, start: Start) -> list[Stretch]:
    """What of a long recording no model of its load history can know, by the base model fitted to it: where
    something from outside moves the tip, and after gaps.
    """
    rig, robot, thinned = start.exact[0], part.robot, start.full[0]
    if part.tips != 1 or part.others or robot.tendons[0].drive != "tension":
        return []
    values = dict(start.base.values) | dict(start.base.dimensions)
    seen = rig(values)
    slope = change_by(rig, values, 0)
    if seen is None or slope is None:
        return []
    delay = sum(values.get(name, 0.0) for name in DELAYS)
    found = [*disturbances(part, thinned, seen, slope[0], delay), *behind_gaps(part, thinned, seen)]
    return within(found, part.samples)
