"""What drives the tendons on the page: a pull and release, a recording, or a hand on a slider."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from gtr_jax.recordings.base_tension import estimate_base
from gtr_jax.recordings.recording import Recording
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.displacement import by_tension
from gtr_jax.simulation.equilibrium import equilibrium

from .knobs import rounded

BRANCH = 40  # steps of a pull, and of a release
HELD = 96  # steps that a hand's history is padded to, so that one program serves it however long it is
BENT = 1.0  # rad, by which the default pull bends the body
TRIAL = 1e-3  # N, under which a body bends in proportion
LEAST_TURN = 1e-12  # rad, below which it does not bend
STIFF = 10.0  # N, by which a body that does not bend is pulled


@dataclasses.dataclass(frozen=True, eq=False)
class History:
    """What drives the tendons along K steps, SI.

    Attributes:
        T_base: true base tension [N], (K, *tendons), of a recording as its cell shows it; NaN of tendons that
            displacement drives.
        displacement: drawn out at the base [m], (K, *tendons); None where tension drives all.
        time: [s], (K,).
        padded: steps at its beginning that only repeat the first, and are not shown.
        recording: that it comes from, of K samples.
    """

    T_base: np.ndarray
    displacement: np.ndarray | None
    time: np.ndarray
    padded: int = 0
    recording: Recording | None = None

    def __len__(self) -> int:
        return len(self.time)


def moved_by(robot: Robot) -> list[str]:
    """The unit of what drives each tendon: "N", or "m" of a displacement."""
    return ["m" if tendon.drive == "displacement" else "N" for tendon in robot.tendons]


def at_rest(robot: Robot) -> np.ndarray:
    """What drives each tendon before anything is pulled: its preload [N], or no displacement [m]."""
    return np.array([0.0 if t.drive == "displacement" else float(t.preload) for t in robot.tendons])


def _history(robot: Robot, ways: np.ndarray, padded: int = 0) -> History:
    """One step per second of what drives each tendon, (K, tendons)."""
    drawn = np.array([unit == "m" for unit in moved_by(robot)])
    one = not robot.tendon_names
    T_base, displacement = np.where(drawn, np.nan, ways), np.where(drawn, ways, np.nan)
    return History(
        T_base=T_base[:, 0] if one else T_base,
        displacement=None if not drawn.any() else displacement[:, 0] if one else displacement,
        time=np.arange(len(ways), dtype=float) - padded,
        padded=padded,
    )


def pull_and_release(robot: Robot, tendon: int, pull: float, release: float) -> History:
    """A pull of one tendon to a tension [N], or by a displacement [m], and its release; the others stay."""
    start = at_rest(robot)
    ways = np.tile(start, (2 * BRANCH + 1, 1))
    ways[:, tendon] = np.concatenate(
        [np.linspace(start[tendon], pull, BRANCH + 1), np.linspace(pull, release, BRANCH + 1)[1:]]
    )
    return _history(robot, ways)


def by_hand(robot: Robot, moves: Sequence[np.ndarray]) -> History:
    """What a hand did to the tendons so far, (tendons,) each, as a history of HELD steps."""
    kept = np.asarray(shortened([at_rest(robot), *moves], HELD))
    missing = HELD - len(kept)
    ways = np.concatenate([np.tile(kept[:1], (missing, 1)), kept])
    return _history(robot, ways, missing)


def shortened(moves: Sequence[np.ndarray], most: int) -> list[np.ndarray]:
    """A history of at most so many steps: where it is longer, steps on the way go first, every other one;
    turning points and both ends stay as long as there is room, the latest longest.
    """
    kept = [np.asarray(move, float) for move in moves]
    while len(kept) > most:
        turns = [0, *(i for i in range(1, len(kept) - 1) if _turns(*kept[i - 1 : i + 2])), len(kept) - 1]
        on_the_way = [i for i in range(len(kept)) if i not in turns]
        gone = {*on_the_way[::2]} or {*range(1, 1 + len(kept) - most)}
        kept = [move for i, move in enumerate(kept) if i not in gone]
    return kept


def _turns(before: np.ndarray, here: np.ndarray, after: np.ndarray) -> bool:
    """Whether any tendon turns back here."""
    return bool(np.any((here - before) * (after - here) < 0))


def recorded(robot: Robot, recording: Recording) -> History:
    """What a recording says of the base, without the noise of its cells, as a fit starts from it."""
    time = np.arange(len(recording), dtype=float) if recording.time is None else recording.time
    drawn = np.array([unit == "m" for unit in moved_by(robot)])
    columns, tips = (
        None if T is None else T.reshape(len(T), -1) for T in (recording.T_base, recording.T_tip)
    )
    assert columns is not None
    each = np.full(columns.shape, np.nan)
    for i in np.flatnonzero(~drawn):
        tip = None if tips is None else tips[:, i]
        each[:, i] = np.maximum(estimate_base(columns[:, i], recording.time, tip=tip).T_base, 0.0)
    displacement = recording.displacement if drawn.any() else None
    return History(each.reshape(recording.T_base.shape), displacement, time, recording=recording)


def usual_pull(robot: Robot, tendon: int) -> float:
    """A pull of one tendon that bends the body by about a radian without friction: a tension [N], or of one
    that displacement drives a displacement [m].
    """
    names, base, rest = robot.tendon_names, by_tension(robot), at_rest(by_tension(robot))
    pulled = rest.copy()
    pulled[tendon] += TRIAL
    before, after = (equilibrium(base, jnp.asarray(T if names else T[0])) for T in (rest, pulled))
    if moved_by(robot)[tendon] == "m":
        reach = float(np.max(np.abs(np.asarray(before.R)[tendon] if names else np.asarray(before.R))))
        return rounded(BENT * reach) if reach > 0 else rounded(0.02 * float(robot.backbone.length))
    if after.shape is None or before.shape is None:
        turned = float(np.max(np.abs(np.asarray(after.angle) - np.asarray(before.angle))))
    else:
        apart = np.asarray(after.shape.rotation) - np.asarray(before.shape.rotation)
        turned = float(np.max(np.linalg.norm(apart, axis=(1, 2)))) / np.sqrt(2.0)
    return rounded(BENT * TRIAL / turned) if turned > LEAST_TURN else STIFF
