"""`python -m benchmarks.mujoco_export`: how far the tip of an exported robot is from the simulator's, in
MuJoCo's static equilibrium without friction by number of links, and along a pull and a release with friction;
and how long MuJoCo's own friction loss holds. It writes results/mujoco.md.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import root

import gtr_jax as gtr
from gtr_jax.config.config import RobotConfig, load_config, parse_config
from gtr_jax.export.mjcf import mjcf, shares_left

from . import measure

PAGE = measure.RESULTS / "mujoco.md"
LINKS = (10, 20, 40, 80)
DENSITY = 1070.0
HANGING = {"gravity": [0.0, 0.0, -9.81], "tip_force": [0.0, -0.05, 0.1]}
WITH = 40  # links with friction
RAMP, LATER = 2.0, (0.5, 2.0, 20.0)  # s of a pull, and after it


def robot(name: str, *, friction: float | None = None, loads: dict[str, Any] | None = None) -> RobotConfig:
    """A robot of examples/ that has a density, with another friction or loads."""
    config = load_config(f"examples/{name}.toml")
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["backbone"]["density"] = DENSITY
    if friction is not None:
        data["tendon"]["friction_coefficient"] = friction
    if loads is not None:
        data["loads"] = loads
    return parse_config(data, source=name)


class Model:
    """An exported robot in MuJoCo.

    Args:
        text: MJCF.
    """

    def __init__(self, text: str) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)

    @property
    def tip(self) -> np.ndarray:
        """Place of the tip [m], (3,)."""
        return self.data.site("tip").xpos.copy()

    def settle(self, tensions: Sequence[float]) -> np.ndarray:
        """Tip [m], (3,), where all forces balance, under base tensions [N]; RuntimeError if there is no such
        place. Found by Newton's method from where the robot is.
        """
        self.data.qvel[:] = 0.0
        self.data.ctrl[: len(tensions)] = tensions

        def force(q: np.ndarray) -> np.ndarray:
            self.data.qpos[:] = q
            self.mujoco.mj_forward(self.model, self.data)
            return self.data.qfrc_smooth.copy()

        found = root(force, self.data.qpos.copy(), method="hybr", options={"xtol": 1e-12})
        left = float(np.max(np.abs(force(found.x))))
        if left > 1e-9:
            raise RuntimeError(f"no equilibrium: {left:.2g} N m are left")
        return self.tip

    def move(self, tension: float, seconds: float) -> np.ndarray:
        """Tip [m], (3,), after the first tendon's tension [N] has gone evenly to another in some time."""
        steps = round(seconds / self.model.opt.timestep)
        for now in np.linspace(self.data.ctrl[0], tension, steps):
            self.data.ctrl[0] = now
            self.mujoco.mj_step(self.model, self.data)
        return self.tip


def errors(config: RobotConfig, pulls: Sequence[float], links: int) -> list[float]:
    """Distance of the two tips at each pull, in shares of the length."""
    model, own = Model(mjcf(config, links=links)), gtr.build_robot(config, resolution=2.0)
    found, start = [], 0.0
    for pull in pulls:
        for tension in np.linspace(start, pull, 4)[1:]:
            tip = model.settle([tension])
        start = pull
        wanted = np.asarray(gtr.equilibrium(own, pull).tip_position)
        found.append(float(np.linalg.norm(tip - wanted)) / config.backbone.length)
    return found


def along_a_loop(config: RobotConfig, tensions: Sequence[float], at: float | None, links: int) -> list[float]:
    """Distance of the two tips in equilibrium at each of some base tensions [N] in turn, in shares of the
    length; `at` is the tension at which friction is taken.
    """
    model = Model(mjcf(config, links=links, friction_at=at))
    found = []
    for tension, wanted in zip(tensions, looped(config, tensions), strict=True):
        for now in np.linspace(model.data.ctrl[0], tension, 4)[1:]:
            tip = model.settle([now])
        found.append(float(np.linalg.norm(tip - wanted)) / config.backbone.length)
    return found


def looped(config: RobotConfig, tensions: Sequence[float]) -> np.ndarray:
    """The simulator's tip [m], (N, 3), at each of some base tensions [N] in turn."""
    starts = [0.0, *tensions]
    history = [np.linspace(a, b, 21)[1:] for a, b in zip(starts, tensions, strict=False)]
    done = gtr.simulate(gtr.build_robot(config), np.concatenate(history))
    return np.asarray(done.tip_position)[19::20]


def with_friction_loss(config: RobotConfig, tension: float, links: int, stiffest: bool) -> list[float]:
    """What MuJoCo's own friction loss holds of a pull: of what it keeps the tip from, the share when the pull
    ends and after each time in `LATER`. The loss is that of the mean tension.
    """
    lost = tension * (1 - float(shares_left(gtr.build_robot(config), tension)[0]))
    text = mjcf(config, links=links)
    setting = ' solimpfriction="0.9999 0.9999 0.001 0.5 2" solreffriction="0.004 1"' if stiffest else ""
    free, held, full = (
        Model(model)
        for model in (
            text,
            text.replace("<spatial ", f'<spatial frictionloss="{lost:.9g}"{setting} '),
            text.replace('gear="-1"', f'gear="{lost / tension - 1:.9g}"'),
        )
    )
    found = []
    for end in (free, full):
        for now in np.linspace(0.0, tension, 5)[1:]:
            end.settle([now])
    for i, seconds in enumerate((RAMP, *LATER)):
        tip = held.move(tension, seconds if i < 2 else seconds - LATER[i - 2])
        kept = np.linalg.norm(tip - free.tip) / np.linalg.norm(full.tip - free.tip)
        found.append(float(kept))
    return found


CASES = (
    ("TD-CM I, in the plane", "tdcm-1", None, (5.0, 10.0, 20.0)),
    ("helix, in space", "helix", None, (3.0, 6.0, 9.0)),
    ("the same with gravity and a force at its tip", "helix", HANGING, (3.0, 6.0, 9.0)),
)


def main() -> int:
    import mujoco

    machine = measure.machine()
    lines = [f"MuJoCo {mujoco.__version__}, jax {machine['versions']['jax']}.", ""]
    lines += ["| without friction | pull, N | " + " | ".join(f"{n} links" for n in LINKS) + " |"]
    lines += ["|---|---|" + "---|" * len(LINKS)]
    for says, name, loads, pulls in CASES:
        table = np.array([errors(robot(name, friction=0.0, loads=loads), pulls, n) for n in LINKS])
        for pull, row in zip(pulls, table.T, strict=True):
            lines.append(f"| {says} | {pull:g} | " + " | ".join(f"{100 * e:.2g} %" for e in row) + " |")
    loop = (5.0, 10.0, 20.0, 10.0, 5.0)
    heads = [
        f"{b:g} N {'pulling' if b > a else 'releasing'}" for a, b in zip((0.0, *loop), loop, strict=False)
    ]
    lines += [
        "",
        f"| with friction, {WITH} links | " + " | ".join(heads) + " |",
        "|---|" + "---|" * len(loop),
    ]
    for says, name, _, _ in CASES[:2]:
        for at in (None, 5.0, 20.0):
            row = along_a_loop(robot(name), loop, at, WITH)
            kind = "exported without" if at is None else f"`--friction-at {at:g}N`"
            lines.append(f"| {says}, {kind} | " + " | ".join(f"{100 * e:.2g} %" for e in row) + " |")
    lines += ["", "| MuJoCo's frictionloss holds of a pull to 20 N | at its end | "]
    lines[-1] += " | ".join(f"{later:g} s later" for later in LATER) + " |"
    lines += ["|---|---|" + "---|" * len(LATER)]
    for stiffest in (False, True):
        row = with_friction_loss(robot("tdcm-1"), 20.0, WITH, stiffest)
        kind = "its stiffest settings" if stiffest else "its usual settings"
        lines.append(f"| TD-CM I, {kind} | " + " | ".join(f"{100 * kept:.2g} %" for kept in row) + " |")
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(PAGE.read_text(encoding="utf-8"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
