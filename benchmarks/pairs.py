"""`python -m benchmarks.pairs [--write]`: two tendons in a plane, with a physics term of no size and without,
by JAX and as native code, and their derivatives.

All programs solve one law of friction, in `mechanics/grip.py`. Random histories of both base tensions are
gone through by each: ramps between random corners, one tendon held or slack for a while, both in antiphase.
The robot is `examples/antagonists.toml`, in every other history with other numbers.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import Native, ready
from gtr_jax.simulation.programs import structure_of

from .measure import command

HEAD = (
    "# Two tendons in one plane",
    "",
    "Until commit 364f8c5 several tendons in one plane had a solver of their own where no physics term "
    "acted (dense Newton steps by LAPACK). It was removed because the march "
    "gives its answers in a quarter of its time or less. Both were measured in one process before that "
    "(2026-11-29, two shared cores of an AMD EPYC, jax 0.10.2). Times are CPU times of the dense solver, "
    "the march, and the march as native code; the first run has the compiling, a later one is the mean of "
    "a history, the least of three passes:",
    "",
    "| robot of `examples/antagonists.toml` | steps | not converged | T_tip apart | tip apart | "
    "first run [s] | later run [ms] |",
    "|---|---|---|---|---|---|---|",
    "| one pulled, one held | 100 | 0, 0, 0 | 1.6e-13 N | 1.6e-15 m, rad | 12.3, 8.2, 2.7 | 110, 27, 32 |",
    "| in antiphase | 100 | 0, 0, 0 | 7.5e-14 N | 1.3e-15 m, rad | compiled | 161, 33, 38 |",
    "| in antiphase, with a tip force | 100 | 0, 0, 0 | 7.9e-10 N | 7.6e-11 m, rad | 32.6, 9.6, 2.8 | "
    "258, 48, 79 |",
    "| with a third tendon | 100 | 0, 0, 0 | 1.6e-13 N | 2.9e-15 m, rad | 13.6, 9.9, 3.1 | 302, 47, 66 |",
    "| 20 of the histories below | 1,920 | 0, 0, 0 | 6.7e-13 N | 5.1e-15 m, rad | 11.7, 9.5, compiled | "
    "99, 25, 28 |",
    "| 200 of them | 19,200 | 0, 0, | 9.7e-07 N | 2.9e-08 m, rad | | a quarter |",
    "",
    "Directions of slip and slip fronts were the same in all. Native code goes through four histories side "
    "by side in about the time of one.",
    "",
    "What is left to compare are programs with a physics term of no size, native code, and derivatives. "
    "Written by `python -m benchmarks.pairs --write`.",
    "",
)
SEED, HISTORIES, SAMPLES, LARGEST = 26112901, 200, 96, 18.0  # N
TERMS = {"with a stretch of none": ("tendon-stretch",), "with presliding of none": ("presliding",)}
BY, STEP, EVERY = ("mu.left", "mu.right", "E"), 1e-5, 4  # derivatives: relative step; steps of a history


def histories(rng: np.random.Generator, count: int) -> np.ndarray:
    """Base tensions of both tendons [N], (count, SAMPLES, 2)."""
    found = []
    for _ in range(count):
        corners = rng.uniform(0.0, LARGEST, (int(rng.integers(3, 9)), 2))
        corners[0] = 1.0
        kind = rng.choice(["ramps", "held", "slack", "antiphase"])
        if kind == "held":
            corners[:, rng.integers(2)] = rng.uniform(0.0, 5.0)
        elif kind == "slack":
            corners[rng.integers(1, len(corners)), rng.integers(2)] = 0.0
        elif kind == "antiphase":
            corners[:, 1] = LARGEST - corners[:, 0]
        at = np.linspace(0.0, len(corners) - 1, SAMPLES)
        found.append(np.stack([np.interp(at, np.arange(len(corners)), c) for c in corners.T], axis=1))
    return np.stack(found)


def robots(rng: np.random.Generator, count: int) -> list[gtr.Robot]:
    """The robot of each history."""
    plain = gtr.load_robot("examples/antagonists.toml")
    return [
        plain
        if i % 2 == 0
        else plain.with_values(
            **{"mu.left": rng.uniform(0.02, 0.6), "mu.right": rng.uniform(0.02, 0.6)},
            E=float(plain.backbone.youngs_modulus) * rng.uniform(0.6, 2.0),
        )
        for i in range(count)
    ]


def by_native(robot: gtr.Robot) -> Callable[[gtr.Robot, np.ndarray], object]:
    """A run of robots that differ from this one in their numbers only, as native code."""
    program, structure, begun = Native(robot), structure_of(robot, None), jax.jit(ready)
    clock = jnp.arange(float(SAMPLES))

    def run(robot, history):
        T_base = jnp.asarray(history)
        return program(begun(robot, T_base), structure, loads_of(T_base, clock, None))

    return run


def gone(run: Callable, of: Sequence[gtr.Robot], drawn: np.ndarray) -> tuple[list, float]:
    """Runs, and the CPU time of all but the first history, which compiles."""
    found, begun = [], 0.0
    for i, (robot, history) in enumerate(zip(of, drawn, strict=True)):
        found.append(jax.block_until_ready(run(robot, history)))
        begun = time.process_time() if i == 0 else begun
    return found, time.process_time() - begun


def rows(count: int = HISTORIES) -> list[str]:
    """The table, and how far derivatives are from differences."""
    rng = np.random.default_rng(SEED)
    drawn = histories(rng, count)
    of = robots(rng, count)

    def by_jax(terms):
        return lambda robot, history: gtr.simulate(robot, history, with_terms=terms)

    without, cost = gone(by_jax(None), of, drawn)
    table = ["| program | steps | not converged | T_tip apart, largest | tip apart, largest | CPU time |"]
    table.append("|---|---|---|---|---|---|")
    failed = sum(int(np.sum(~np.asarray(run.converged))) for run in without)
    table.append(f"| without terms | {drawn.size // 2:,} | {failed} | | | 1 |")
    others = {name: by_jax(terms) for name, terms in TERMS.items()}
    for name, run in (others | {"without terms, native code": by_native(of[0])}).items():
        found, own = gone(run, of, drawn)
        both = [np.asarray(a.converged & b.converged) for a, b in zip(found, without, strict=True)]
        apart = [
            max(
                float(np.max(np.abs(np.asarray(getattr(a, part) - getattr(b, part))[ok])))
                for a, b, ok in zip(found, without, both, strict=True)
            )
            for part in ("T_tip", "tip_pose")
        ]
        failed = sum(int(np.sum(~np.asarray(run.converged))) for run in found)
        table.append(
            f"| {name} | {drawn.size // 2:,} | {failed} | {apart[0]:.1e} N | {apart[1]:.1e} m, rad | "
            f"{own / cost:.2f} |"
        )
    off = differences(of[0], drawn[0][::EVERY])
    return [
        *table,
        "",
        f"Derivatives of T_tip by {', '.join(BY)} along the first history, every fourth step, differ from "
        f"central differences by at most {off:.0e} of the largest one.",
    ]


def differences(robot: gtr.Robot, history: np.ndarray) -> float:
    """Largest difference between derivatives of the tip tensions and central differences, over the largest
    derivative by the same number.
    """

    @jax.jit
    def tips(values):
        return gtr.simulate(robot.with_values(**dict(zip(BY, values, strict=True))), history).T_tip

    at = jnp.stack([robot.value(name) for name in BY])
    slopes = np.asarray(jax.jit(jax.jacfwd(tips))(at))
    off = []
    for i, value in enumerate(at):
        step = STEP * value
        want = np.asarray(tips(at.at[i].add(step)) - tips(at.at[i].add(-step))) / (2 * float(step))
        off.append(np.max(np.abs(slopes[..., i] - want)) / np.max(np.abs(want)))
    return float(max(off))


def main(argv: list[str] | None = None) -> int:
    return command("pairs", __doc__, lambda: [*HEAD, *rows()], argv)


if __name__ == "__main__":
    sys.exit(main())
