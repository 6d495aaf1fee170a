"""`python -m benchmarks.sliding [--write]`: slip that outlasts a reversal, against an elastic thread.

Where friction grows with the speed of the slip, a tendon slips on for a while after its base tension has
turned back. The blind benchmark's machine is a thread marched in time, here in eight steps for each sample;
the simulator takes one or four. Where nothing is predicted of the slip, each point may keep the tension that
friction could hold.
"""

from __future__ import annotations

import sys
from unittest import mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax.examples import CONCEALED_ROBOT
from gtr_jax.mechanics import history
from gtr_jax.mechanics.case import Sliding

from .blind.machine import Arm, Laws, run
from .measure import command

HEAD = (
    "# Slip that outlasts a reversal, against an elastic thread",
    "",
    "Written by `python -m benchmarks.sliding --write`; rms of the tip tension, histories up to 40 N.",
    "",
)
DT, MU, MODULUS, FINE = 0.25, 0.3, 1.5e6, 8
# Corners of the base tension: [s], [N].
HISTORIES = {
    "one reversal, holds": [(0, 0), (8, 40), (14, 15), (20, 15), (22, 30), (28, 2), (32, 2)],
    "two inner loops": [
        (0, 0),
        (10, 40),
        (13, 20),
        (15, 34),
        (18, 10),
        (20, 24),
        (21, 18),
        (24, 40),
        (30, 1),
    ],
    "reversals each second": [
        *((0, 0), (4, 40), (5, 10), (6, 38), (7, 5), (9, 30), (10, 2), (14, 25), (15, 20), (16, 28), (18, 0)),
    ],
    "holds": [
        *((0, 0), (5, 30), (8, 30), (10, 22), (12, 22), (13, 34), (16, 34), (20, 5), (23, 5), (25, 15)),
        *((27, 15), (29, 3)),
    ],
}
# Coefficient [s/m] and exponent.
FRICTION = ((5.0, 1.0), (20.0, 1.0), (60.0, 1.0), (200.0, 1.0), (40.0, 0.7), (40.0, 1.4))


def _offset(s):
    """Of the channel of `CONCEALED_ROBOT` from the midline [m]."""
    wave = -0.009 * np.cos(np.pi * (s - 0.02) / 0.06)
    return np.where(s < 0.02, -0.009, np.where(s > 0.08, 0.009, wave))


def thread(coefficient: float, exponent: float) -> Arm:
    """The machine built like `CONCEALED_ROBOT`, with friction that grows with the speed."""

    def friction(guides):
        share = (guides.flow / 0.01) ** 2 + 0.02**2
        return 1 + coefficient * np.abs(guides.flow) * share ** (0.5 * (exponent - 1)) / MU

    return Arm(
        length=0.25,
        outer=lambda s: 0.020 - 0.028 * s,
        bore=lambda s: np.where((s < 0.02) | (s >= 0.08), 0.007, 0.0),
        modulus=MODULUS,
        offset=_offset,
        friction=MU,
        links=100,
        laws=Laws(friction=friction),
    )


def _unpredicted(case, load, memory):
    none = jnp.zeros_like(memory.tension)
    return Sliding(none, none)


def in_parts(time, T_base, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and base tension [N] with so many load steps for each sample."""
    samples, at = np.arange(len(T_base)), np.arange((len(T_base) - 1) * parts + 1) / parts
    return np.interp(at, samples, time), np.interp(at, samples, T_base)


def simulated(coefficient: float, exponent: float, time, T_base, parts: int) -> tuple[np.ndarray, bool]:
    """Tip tension [N] at the samples, with so many steps for each, and whether every step converged."""
    time, T_base = in_parts(time, T_base, parts)
    robot = gtr.load_robot(CONCEALED_ROBOT).with_values(
        **{"mu": MU, "E": MODULUS, "viscous-friction.coefficient": coefficient},
        **{"viscous-friction.exponent": exponent},
    )
    found = gtr.simulate(robot, T_base, time=time)
    return np.asarray(found.T_tip)[::parts], bool(np.all(found.converged))


def sampled(corners) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and base tension [N] of the samples of a history of some corners."""
    at, T = np.asarray(corners, float).T
    time = np.arange(0.0, at[-1], DT)
    return time, np.interp(time, at, T)


def _histories():
    """Name, law of friction, time [s] and base tension [N] of each row."""
    for name, corners in HISTORIES.items():
        for law in FRICTION:
            yield name, law, *sampled(corners)


def rows() -> list[str]:
    """The table: rms of the tip tension [mN]."""
    found = [
        "| history | coefficient, exponent | machine, one step | one step | four steps | four, unpredicted |",
        "|---|---|---|---|---|---|",
    ]
    with mock.patch.object(history, "predicted_slip", _unpredicted):
        held = [simulated(*law, time, T_base, 4)[0] for _, law, time, T_base in _histories()]
    # Programs traced without the prediction are forgotten.
    jax.clear_caches()
    eqx.clear_caches()
    for (name, law, time, T_base), without in zip(_histories(), held, strict=True):
        fine, coarse = (run(thread(*law), time, T_base, parts=parts).T_tip for parts in (FINE, 1))
        (one, settled), (four, also) = (simulated(*law, time, T_base, parts) for parts in (1, 4))
        off = [np.sqrt(np.mean((tip - fine) ** 2)) for tip in (coarse, one, four, without)]
        sizes = " | ".join(f"{1e3 * size:.0f} mN" for size in off)
        found.append(
            f"| {name} | {law[0]:g} s/m, {law[1]:g} | {sizes} |{'' if settled and also else ' NOT CONVERGED'}"
        )
    return found


def main(argv: list[str] | None = None) -> int:
    return command("sliding", __doc__, lambda: [*HEAD, *rows()], argv)


if __name__ == "__main__":
    sys.exit(main())
