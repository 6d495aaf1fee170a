"""`python -m benchmarks.held [--write]`: what friction holds, and the body bends, against an elastic thread.

Where a stop or creep bends the body under a stretch of tendon that friction holds, the tension there follows
from that the tendon does not get longer. The blind benchmark's machine is a thread marched in time and knows
nothing of that law: its tip tension, without noise, is what the simulator's is compared with. The drawn
numbers are the machine's own, given to the robot.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import gtr_jax as gtr

from .blind.cases import BUILDS, built, forces_on, protocol, robot_file
from .blind.effects import Scene
from .blind.machine import Shown, run
from .measure import command

HEAD = (
    "# A held stretch against an elastic thread",
    "",
    "Written by `python -m benchmarks.held --write`.",
    "",
)
CASES = (
    ("contact", "one-bend", "rich"),
    ("contact", "two-bends", "rich"),
    ("contact", "cone-wave", "random"),
    ("creep", "one-bend", "rich"),
    ("creep", "cone-wave", "random"),
    ("creep", "catheter", "rich"),
    ("creep and contact", "one-bend", "rich"),
    ("creep and tip load", "one-bend", "random"),
    ("tip load", "two-bends", "rich"),
)
MU, STIFFNESS, HEIGHT = 0.3, 120.0, 0.55  # of friction; of the stop [N/m], and its share of the free way
RATIO, TIME, TIP = 0.3, 10.0, (0.05, 0.15)  # of the creep, its time [s]; dead force on the tip [N]


class Compared(NamedTuple):
    """A case: the simulation, and what the machine shows; each with K samples."""

    found: gtr.Simulation
    shown: Shown


def _branch(ratio: float, slow: float):
    """One Maxwell branch beside the springs, by implicit steps."""

    def spring(kappa, kept, dt):
        share = 0.0 if np.isinf(dt) else 1 / (1 + dt / slow)
        q = share * (kept[0] + ratio * (kappa - kept[1]))
        return q, np.stack([q, kappa])

    return spring


def compared(kind: str, name: str, way: str, *, samples: int = 160, links: int | None = None) -> Compared:
    """The machine and the simulator go through the same history.

    Args:
        kind: of what acts, in words: contact, creep, tip load, joined by "and".
        name: of the build.
        way: of the protocol.
        samples: how many of it.
        links: of the machine; as many as the build has unless given.
    """
    rng = np.random.default_rng(900)
    build = next(b for b in BUILDS if b.name == name)
    arm, own = built(build, rng, MU)
    arm = arm if links is None else dataclasses.replace(arm, links=links)
    time, T_base, trial = (column[:samples] for column in protocol(way, build.largest, rng))
    scene, height = Scene(arm, time, T_base, trial), None
    numbers: dict[str, Any] = {}
    if "contact" in kind:
        scene.stop = (STIFFNESS, HEIGHT, 0.0)
        free = run(dataclasses.replace(arm, links=arm.links // 2), time, T_base)
        height = HEIGHT * float(free.pose[int(np.argmax(np.abs(free.pose[:, 1]))), 1])
        numbers |= {"contact.stiffness": STIFFNESS, "contact.distance": abs(height)}
        numbers |= {"contact.angle": float(np.sign(height)) * np.pi / 2}
    if "creep" in kind:
        scene.law(spring=_branch(RATIO, TIME), remembers=2)
        numbers |= {"viscoelastic-body.ratio": RATIO, "viscoelastic-body.time": TIME}
    if "load" in kind:
        scene.tip_force = TIP
        numbers |= {"tip-load.x": TIP[0], "tip-load.y": TIP[1]}
    arm = dataclasses.replace(
        scene.arm, laws=dataclasses.replace(scene.arm.laws, forces=forces_on(scene, 0, height))
    )
    shown = run(arm, time, T_base, parts=2 if "creep" in kind else 1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.toml"
        file.write_text(robot_file(build, down=False), encoding="utf-8")
        robot = gtr.load_robot(file).with_values(mu=MU, **own, **numbers)
    return Compared(gtr.simulate(robot, T_base, time=time), shown)


def rows() -> list[str]:
    """The table."""
    found = ["| what acts | build | T_tip: median | 90 % | largest | drawn out: rms | converged |"]
    found.append("|---|---|---|---|---|---|---|")
    for case in CASES:
        simulated, shown = compared(*case)
        off = np.abs(np.asarray(simulated.T_tip) - shown.T_tip)
        drawn = float(np.sqrt(np.mean((np.asarray(simulated.displacement) - shown.drawn) ** 2)))
        sizes = " | ".join(f"{1e3 * size:.0f} mN" for size in np.quantile(off, [0.5, 0.9, 1.0]))
        whole = "yes" if bool(np.all(simulated.converged)) else "NO"
        found.append(f"| {case[0]} | {case[1]} | {sizes} | {1e6 * drawn:.0f} um | {whole} |")
    return found


def main(argv: list[str] | None = None) -> int:
    return command("held", __doc__, lambda: [*HEAD, *rows()], argv)


if __name__ == "__main__":
    sys.exit(main())
