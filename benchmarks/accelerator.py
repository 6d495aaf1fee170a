"""Sweeps on an accelerator: microseconds a point by the number of lanes, beside one core of its machine.

`python -m benchmarks.accelerator --write` writes results/accelerator.md, on which the lanes of
`gtr_jax.sweep.task` on accelerators rest. It needs nothing but the core of gtr_jax and its dependencies.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import gtr_jax as gtr

from . import measure

EXAMPLES = Path(__file__).parents[1] / "examples"
COUNTS = (16, 1024, 8192, 32768, 131072)
# Lanes times load steps, so that 80 GB hold them in space; only what fits is measured.
MOST = 1.1e7
# Lanes that one core solves fastest (results/lanes.md).
OF_A_CORE = 16
# Calls of each, the shortest counts.
CALLS = 3


def pull(steps: int, top: float) -> Array:
    """Base tensions of a pull and a release [N], (steps + 1,)."""
    return jnp.concatenate(
        [jnp.linspace(0.0, top, steps // 2 + 1), jnp.linspace(top, 0.0, steps // 2 + 1)[1:]]
    )


def points() -> Iterator[tuple[str, Callable[[Array, Array], tuple[Array, ...]], int]]:
    """What a point of a sweep computes from mu and E, and how many load steps it takes."""
    plane, helix = (gtr.load_robot(EXAMPLES / f"{name}.toml") for name in ("tdcm-1", "helix"))

    def equilibrium(mu: Array, E: Array) -> tuple[Array, ...]:
        found = gtr.equilibrium(plane.with_values(mu=mu, E=E), 45.0)
        return found.T_tip, found.tip_pose

    def history(robot: gtr.Robot, steps: int, top: float, **more: float) -> Callable:
        def run(mu: Array, E: Array) -> tuple[Array, ...]:
            found = gtr.simulate(robot.with_values(mu=mu, E=E, **more), pull(steps, top))
            return found.T_tip, found.tip_pose

        return run

    yield "one equilibrium", equilibrium, 1
    yield "81 steps", history(plane, 80, 45.0), 81
    yield "41 steps, helix in space", history(helix, 40, 10.0), 41
    yield "11 steps, presliding", history(plane, 10, 45.0, **{"presliding.length": 6e-4}), 11


def microseconds(point: Callable, lanes: int, device: Any) -> float:
    """Microseconds a point, warm, on a device."""
    run, best = jax.jit(jax.vmap(point)), np.inf
    with jax.default_device(device):
        for seed in range(CALLS + 1):
            rng = np.random.default_rng(seed)
            drawn = [jax.device_put(rng.uniform(*of, lanes), device) for of in ((0.05, 0.6), (0.7e6, 2.1e6))]
            start = time.perf_counter()
            jax.block_until_ready(run(*drawn))
            best = min(best, time.perf_counter() - start) if seed else best
    return best / lanes * 1e6


def study() -> Iterator[str]:
    """The table, line by line."""
    fast, core, on = jax.devices()[0], jax.devices("cpu")[0], measure.machine()
    yield (
        f"{fast.device_kind}, {on['processor']}, {on['date']}, jax {jax.__version__}; microseconds a point, "
        f"warm, by the points solved at once, in double precision; on one core {OF_A_CORE} at once."
    )
    yield ""
    yield "| points | one core | " + " | ".join(f"{lanes} lanes" for lanes in COUNTS) + " |"
    yield "|---" * (len(COUNTS) + 2) + "|"
    for says, point, steps in points():
        cells = [
            f"{microseconds(point, lanes, fast):.3g}" if lanes * steps < MOST else "–" for lanes in COUNTS
        ]
        yield f"| {says} | {microseconds(point, OF_A_CORE, core):.3g} | " + " | ".join(cells) + " |"


def main(argv: list[str] | None = None) -> int:
    return measure.command("accelerator", __doc__, study, argv)


if __name__ == "__main__":
    sys.exit(main())
