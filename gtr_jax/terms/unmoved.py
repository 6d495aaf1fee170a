"""Which laws cannot act because the tendon does not move along its channel: in a rigid sheath, unless it
stretches.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from .term import Channel, Passing, Term, Values

NO_SLIP = "no tendon slips in a rigid sheath unless it stretches; add the term tendon-stretch"

# Hooks that do not depend on the slip or on its speed: a term that has one acts by that.
_OTHERS = (
    *("wrap", "base_grip", "tip_grip", "bend", "bend_in_space", "strain", "anchor", "tugged", "ahead"),
    *("loads", "stop", "tip", "base"),
)
_TRIED = 256  # places, times, cycles, pressures and tensions with which a law is tried


def unmoved(
    catalogue: Mapping[str, Term], values: Mapping[str, Values], acting: Collection[str], length: float
) -> list[str]:
    """Of the terms that a rigid sheath has, those that cannot act: laws of a slip that does not occur.

    Args:
        catalogue: the terms by name.
        values: their numbers, SI.
        acting: names of those that it has.
        length: of the sheath [m].
    """
    if any(catalogue[kind].strain or catalogue[kind].anchor for kind in acting):
        return []
    return [kind for kind in acting if needs_slip(catalogue[kind], values[kind], length)]


def needs_slip(term: Term, values: Values, length: float) -> bool:
    """Whether a term does nothing, with these numbers, as long as the tendon does not move along its channel:
    it builds friction up over a slip, or is a law of its speed, or of what is drawn out, that vanishes.
    """
    if term.mobilise is not None:
        return True
    reads = term.by_speed or term.reads_speed or term.reads_drawn
    if not reads or any(getattr(term, hook) is not None for hook in _OTHERS):
        return False
    rng = np.random.default_rng(0)
    ends = np.sort(rng.uniform(0.0, length, (2, _TRIED)), axis=0)
    still, sense = jnp.zeros(_TRIED), jnp.where(jnp.arange(_TRIED) % 2 == 1, 1.0, -1.0)
    times, cycles, pressures, tensions = (
        jnp.asarray(10.0 ** rng.uniform(*decades, _TRIED))
        for decades in ((-2.0, 6.0), (-1.0, 3.0), (-2.0, 4.0), (-2.0, 3.0))
    )
    at = Channel(jnp.asarray(ends[0]), jnp.asarray(ends[1]), still, sense, times, cycles, still)
    passing = Passing(pressures, tensions, at)
    found: list[tuple[Any, float]] = []
    if term.by_speed is not None:
        found.append((term.by_speed(values, still), 0.0))
    if term.friction is not None:
        found.append((term.friction(values, at), 1.0))
    if term.by_pressure is not None:
        found.append((term.by_pressure(values, passing), 1.0))
    if term.drag is not None:
        found.append((term.drag(values, passing), 0.0))
    return all(bool(np.all(np.asarray(value) == null)) for value, null in found)
