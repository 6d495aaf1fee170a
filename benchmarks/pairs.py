"""`python -m benchmarks.pairs [--write]`: two tendons in a plane, with a physics term of no size and without.

Both programs solve one law of friction, the former in `mechanics/grip.py`, the latter in `mechanics/several`.
Random histories of both base tensions are gone through by both: ramps between random corners, one tendon held
or slack for a while, both in antiphase. The robot is `examples/antagonists.toml`, in every other history with
other numbers.
"""

from __future__ import annotations

import sys
import time

import jax
import numpy as np

import gtr_jax as gtr

from .measure import command

HEAD = (
    "# Two tendons in one plane, with and without a physics term",
    "",
    "Written by `python -m benchmarks.pairs --write`.",
    "",
)
SEED, HISTORIES, SAMPLES, LARGEST = 26112901, 200, 96, 18.0  # N
TERMS = {"a stretch of none": ("tendon-stretch",), "presliding of none": ("presliding",)}


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


def rows(count: int = HISTORIES) -> list[str]:
    """The table."""
    rng = np.random.default_rng(SEED)
    plain = gtr.load_robot("examples/antagonists.toml")
    drawn = histories(rng, count)
    robots = [
        plain
        if i % 2 == 0
        else plain.with_values(
            **{"mu.left": rng.uniform(0.02, 0.6), "mu.right": rng.uniform(0.02, 0.6)},
            E=float(plain.backbone.youngs_modulus) * rng.uniform(0.6, 2.0),
        )
        for i in range(count)
    ]

    def gone(terms):
        """Runs and CPU time of all but the first history, which compiles."""
        found, begun = [], 0.0
        for i, (robot, history) in enumerate(zip(robots, drawn, strict=True)):
            found.append(jax.block_until_ready(gtr.simulate(robot, history, with_terms=terms)))
            begun = time.process_time() if i == 0 else begun
        return found, time.process_time() - begun

    without, cost = gone(None)
    table = ["| program | steps | not converged | T_tip apart, largest | tip apart, largest | CPU time |"]
    table.append("|---|---|---|---|---|---|")
    failed = sum(int(np.sum(~np.asarray(run.converged))) for run in without)
    table.append(f"| without terms | {drawn.size // 2:,} | {failed} | | | 1 |")
    for name, terms in TERMS.items():
        found, own = gone(terms)
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
            f"| with {name} | {drawn.size // 2:,} | {failed} | {apart[0]:.1e} N | {apart[1]:.1e} m, rad | "
            f"{own / cost:.2f} |"
        )
    return table


def main(argv: list[str] | None = None) -> int:
    return command("pairs", __doc__, lambda: [*HEAD, *rows()], argv)


if __name__ == "__main__":
    sys.exit(main())
