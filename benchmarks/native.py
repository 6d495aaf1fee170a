"""Native code: a load history by JAX, by the native program alone, and in its lanes.

`python -m benchmarks.native --write` writes results/native.md. All programs simulate the same robot, on which
one term acts: what differs is which others they hold.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from unittest import mock

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import gtr_jax as gtr
from calibrate.inference.simulated_rig import programs_of
from gtr_jax.kept import Kept
from gtr_jax.mechanics import ProgramSpec
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import LANES, Brief, Native, Run, ready
from gtr_jax.simulation.programs import structure_with

from . import measure, systems

STEPS, DRAG = 400, 2.0
SAYS = (
    "base model",
    "terms that need no slip",
    "with loads, contact and creep",
    "with presliding",
    "with viscous friction",
)


def history() -> tuple[np.ndarray, np.ndarray]:
    """Base tensions of a pull, a release and inner loops [N], and times [s], (STEPS,) each."""
    corners = [0.0, 24.0, 6.0, 18.0, 9.0, 24.0, 0.0]
    at = np.linspace(0, len(corners) - 1, STEPS)
    return np.interp(at, np.arange(len(corners)), corners), 0.1 * np.arange(STEPS)


def by_native(native: Native, run: Run, structure: ProgramSpec, lanes: int) -> Brief:
    """A history by itself, or as many as there are lanes."""
    if lanes == 1:
        return native(run.ready, structure, run.loads)
    return native.side_by_side([run] * lanes, structure)[0]


def cold(*args) -> float:
    """Seconds to compile a program and run it once, nothing being kept; arguments as of `by_native`."""
    with (
        mock.patch.object(Kept, "read", lambda self, name: None),
        mock.patch.object(Kept, "write", lambda self, name, contents: None),
    ):
        start = time.perf_counter()
        by_native(*args)
        return time.perf_counter() - start


def study() -> Iterator[str]:
    """The table, line by line."""
    robot = systems.TDCM_1.robot().with_values(**{"adhesion.drag": DRAG})
    T, clock = history()
    loads = loads_of(jnp.asarray(T), jnp.asarray(clock), None)
    run, native, on = Run(ready(robot, jnp.asarray(T)), loads), Native(robot), measure.machine()
    yield (
        f"{on['processor']}, {on['cores']} cores, {on['date']}, jax {on['versions']['jax']}; {STEPS} load "
        f"steps of {systems.TDCM_1.name}, milliseconds for a history, one core, warm."
    )
    yield ""
    yield f"| program | terms | JAX | native, one | native, {LANES} lanes | compiling: one | {LANES} lanes |"
    yield "|---|---|---|---|---|---|---|"
    for says, kinds in zip(SAYS, programs_of(robot), strict=True):
        structure = structure_with(robot, kinds)
        first = [cold(native, run, structure, lanes) for lanes in (1, LANES)]

        def traced(T: Array, kinds: tuple[str, ...] = kinds) -> Array:
            return gtr.simulate(robot, T, time=clock, with_terms=kinds or False).T_tip

        def native_ms(lanes: int, structure: ProgramSpec = structure) -> float:
            return measure.shortest(lambda: by_native(native, run, structure, lanes).T_tip) / lanes * 1e3

        by_jax = measure.timed(traced, jnp.asarray(T)).warm * 1e3
        yield (
            f"| {says} | {len(kinds)} | {by_jax:.3g} | {native_ms(1):.3g} | {native_ms(LANES):.3g} "
            f"| {first[0]:.2g} s | {first[1]:.2g} s |"
        )


def main(argv: list[str] | None = None) -> int:
    return measure.command("native", __doc__, study, argv)


if __name__ == "__main__":
    sys.exit(main())
