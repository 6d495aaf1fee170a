"""Corners of the base tension where all channels together put them, once the base model is fitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from calibrate.diagnosis.likelihood.likelihood import passing
from calibrate.inference.setup import Observation, recorded
from gtr_jax import Recording
from gtr_jax.recordings.base_tension import BEND, sharpened

from .fit import BaseFits, Start


def sharpen(
    fits: BaseFits, start: Start, recordings: Sequence[Recording], say: Callable[[str], None]
) -> Start:
    """The base model fitted again with corners of the base tension put where the tip tells, if these reduce
    the misfit enough; else the start as it is.
    """
    sharper = _sharpened(start, [recorded(r, fits.robot)[0] for r in recordings])
    if sharper is None:
        return start
    say("fitting again, with the corners of the base tension placed by the tip")
    again = fits.fit(sharper, start.base.x, start.likelihood.base, start.likelihood.dimensions)
    return start if again is None else _better(start, again)


def _better(before: Start, after: Start) -> Start:
    """The start with added corners of the base tension if these reduce the misfit enough at the same noise;
    else the start before.
    """
    likelihood, values = after.likelihood, after.base.values
    seen = likelihood.simulate(values)
    if seen is None:
        return before
    likewise = dataclasses.replace(
        likelihood.weighed(values, seen, before.likelihood.noise), rules=before.likelihood.rules
    )
    squares = float(np.sum(likewise.rows(seen) ** 2))
    sizes = [sum(rig.part.T_base.size for rig in s.likelihood.rigs) for s in (before, after)]
    if before.base.chi2 - squares <= BEND * max(sizes[1] - sizes[0], 1):
        return before
    return after._replace(likelihood=likelihood.weighed(values, seen, likelihood.noise))


def _sharpened(start: Start, readings: Sequence[np.ndarray]) -> list[Observation] | None:
    """The recordings with corners of the base tension where all channels together put them: a noisy base
    cell alone misses small steps and turns that the tip follows. None where the cell determines it better.

    Args:
        start: the base model fitted.
        readings: base tension of each recording as recorded [N], (K,).
    """
    found, changed = [], False
    values = dict(start.base.values) | dict(start.base.dimensions)
    for part, rig, noise, read in zip(start.full, start.exact, start.likelihood.noise, readings, strict=True):
        base, here = part.T_base, rig(values)
        found.append(part)
        if base.sd == 0 or here is None or part.samples != len(read) or part.others:
            continue
        weigh = passing(rig, here, noise, values)
        own = (weigh.last == np.arange(part.samples)) * weigh.slope * weigh.weight**2
        from_channels, residual = (
            np.sum(own * weigh.slope, axis=0),
            weigh.centred(here.values[rig.where] - part.recorded),
        )
        cell = base.sd**-2
        if np.median(from_channels) < cell:
            continue
        shift = (cell * (read - base.T_base) - np.sum(own * residual, axis=0)) / (from_channels + cell)
        informed = from_channels > cell
        sd = float(np.sqrt(np.mean(1 / (from_channels + cell)[informed])))
        sharper = sharpened(base, read, base.T_base + np.where(informed, shift, 0.0), sd)
        changed = changed or sharper is not base
        found[-1] = dataclasses.replace(part, T_base=sharper)
    return found if changed else None
