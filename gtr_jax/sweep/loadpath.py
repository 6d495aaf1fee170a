"""The load history of every point: base tensions, and displacements of the tendons that these drive."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gtr_jax.config.amount import DISPLACEMENT, TENSION, unit_of
from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError, listed
from gtr_jax.recordings.driving import Drive, driven
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.recordings.recording import read_recording
from gtr_jax.robot.robot import Robot
from gtr_jax.terms import known_on
from gtr_jax.units import to_si

from .axes import Axis
from .config import SweepConfig

STEPS = 40  # load steps of each branch unless given


@dataclasses.dataclass(frozen=True)
class LoadPath:
    """The load history of every point, as shares of its branches or as it is given.

    Attributes:
        pull, release: in `unit`; None where varied, or for release where there is none.
        up, down: shares of the two branches done at each step.
        given: base tension instead of both [N], (K, *tendons).
        time: of the steps [s], (K,); None where nothing depends on it.
        kept: the steps that are stored.
        tendon: index of the tendon pulled; None for one tendon.
        unit: of what pulls it, "N" of a tension, "m" of a displacement.
        drawn: of every tendon, whether displacement drives it.
        displacement: beside `given`, of the tendons that it drives [m], (K, *tendons).
    """

    pull: float | None
    release: float | None
    up: np.ndarray
    down: np.ndarray
    given: np.ndarray | None
    time: np.ndarray | None
    kept: tuple[int, ...]
    tendon: int | None = None
    unit: str = TENSION
    drawn: tuple[bool, ...] = (False,)
    displacement: np.ndarray | None = None

    @property
    def steps(self) -> int:
        """Load steps."""
        return len(self.given) if self.given is not None else len(self.up) + len(self.down)

    @property
    def shown(self) -> int:
        """Which of the steps kept is pulled hardest, by the sum over the tendons: used for figures and
        sensitivity indices.
        """
        if self.displacement is not None:
            pulled = np.abs(self.displacement).reshape(self.steps, -1).sum(axis=1)
        elif self.given is not None:
            pulled = self.given if self.given.ndim == 1 else self.given.sum(axis=1)
        else:
            pulled = np.concatenate([self.up, 1 - self.down])
        return int(np.argmax(pulled[list(self.kept)]))


class Driven(NamedTuple):
    """What drives the tendons at every step of a point.

    Attributes:
        T_base: base tension [N], (K, *tendons); without meaning of tendons that displacement drives.
        displacement: drawn out at the base [m], (K, *tendons), without meaning of the others; None if tension
            drives them all.
    """

    T_base: Float[Array, "K *tendons"]
    displacement: Float[Array, "K *tendons"] | None


def drive_of(path: LoadPath, robot: Robot, varied: dict[str, Array]) -> Driven:
    """What drives the tendons at a point.

    Args:
        path: the history.
        robot: at this point.
        varied: what of the history is varied, by name.
    """
    if path.given is not None:
        out = None if path.displacement is None else jnp.asarray(path.displacement)
        return Driven(jnp.asarray(path.given), out)
    preload = robot.per_tendon(lambda tendon: tendon.preload)
    start = preload if path.tendon is None else preload[path.tendon]
    start = jnp.zeros(()) if path.unit == DISPLACEMENT else start
    pull = end_of(path, varied, "pull")
    way = start + (pull - start) * jnp.asarray(path.up)
    if len(path.down):
        release = end_of(path, varied, "release")
        way = jnp.concatenate([way, pull + (release - pull) * jnp.asarray(path.down)])
    if path.tendon is None:
        return Driven(way, None) if path.unit == TENSION else Driven(jnp.zeros_like(way), way)
    held = jnp.broadcast_to(preload, (way.shape[0], preload.shape[0]))
    if path.unit == TENSION:
        return Driven(held.at[:, path.tendon].set(way), jnp.zeros_like(held) if any(path.drawn) else None)
    return Driven(held, jnp.zeros_like(held).at[:, path.tendon].set(way))


def end_of(path: LoadPath, varied: dict[str, Array], name: str) -> Array:
    """Where a branch ends, in the history's unit, whether it is varied or given."""
    return varied[name] if name in varied else jnp.asarray(getattr(path, name), dtype=float)


class Given(NamedTuple):
    """A history from a CSV file: what drives the tendons, and when [s]."""

    drive: Drive
    time: np.ndarray | None


def given_history(file: SweepConfig, config: RobotConfig) -> tuple[RobotConfig, Given | None]:
    """The history that a sweep takes from a file, if it does, and the robot as this drives it.

    Raises:
        InputError: the file is wrong or has gaps.
    """
    if file.history.file is None:
        return config, None
    path = file.beside(file.history.file, "history.file")
    table = read_table(path)
    table.refuse_unless_numbers()
    read = read_recording(table, need_tip=False, tendons=config.tendon_names, keep_glitches=True, space=True)
    if read.masked:
        raise InputError(f"{path}: {read.masked[0].says}; complete the history or delete the row")
    config, drive = driven(config, read)
    return config, Given(drive, read.time)


def unit_of_pull(file: SweepConfig, config: RobotConfig) -> str:
    """The unit of what pulls the tendon; InputError if it is not said which."""
    return (
        unit_of(config.strung[_tendon(file, config) or 0][1].drive) if file.history.file is None else TENSION
    )


def load_path(
    file: SweepConfig,
    config: RobotConfig,
    axes: Sequence[Axis],
    by_slip: bool,
    table: np.ndarray | None,
    given: Given | None,
) -> LoadPath:
    """The load history of a sweep, checked; InputError naming the key.

    Args:
        file: the sweep.
        config: the robot, as the history drives it.
        axes: what is varied.
        by_slip: whether physics terms act that are not of the cells.
        table: the points of a file [SI], (points, axes).
        given: the history of a file.
    """
    said = file.history
    varied = {axis.name: axis for axis in axes if axis.of_history}
    for name in varied:
        if getattr(said, name) is not None:
            raise file.fault(f"history.{name}", "is varied as well; leave it out of one, [vary] or [history]")
        if given is not None:
            raise file.fault(f"vary.history.{name}", "has no effect beside history.file; leave one out")
    if given is not None:
        return _given(file, config, given)
    tendon, unit = _tendon(file, config), unit_of_pull(file, config)
    pull, release = (_end(file, name, unit) for name in ("pull", "release"))
    if pull is None and "pull" not in varied:
        example = "45 N" if unit == TENSION else "10 mm"
        raise file.fault("history.pull", f'missing; add for example pull = "{example}" under [history]')
    releases = release is not None or "release" in varied
    lasting = "dissipation" in file.outputs or said.keep == "all" or by_slip
    steps = said.steps or (STEPS if releases or lasting else 1)
    if "dissipation" in file.outputs and steps < 10:
        raise file.fault("history.steps", f"{steps} are too few for dissipation; {STEPS} for example")
    ends = {"pull": pull, "release": release}
    _check_branches(file, config, axes, table, tendon, unit, ends, releases)
    up = np.linspace(0, 1, steps + 1) if steps > 1 else np.ones(1)
    down = np.linspace(0, 1, steps + 1)[1:] if releases else np.zeros(0)
    total = len(up) + len(down)
    turns = (len(up) - 1, total - 1) if releases else (total - 1,)
    kept = {"all": tuple(range(total)), "last": turns[-1:], "turns": turns}[said.keep]
    timed = _timed(config, axes)
    if timed and said.dt is None and "dt" not in varied and total > 1:
        raise file.fault("history.dt", f'missing; {timed} depends on time; add for example dt = "0.1 s"')
    if total == 1 and (said.dt is not None or "dt" in varied):
        raise file.fault("history.dt", "has no effect on a single step, which comes to rest; add steps = 40")
    time = None if said.dt is None else said.dt * np.arange(total)
    if "dt" in varied:
        time = np.arange(total, dtype=float)
    return LoadPath(pull, release, up, down, None, time, kept, tendon, unit, _drawn(config))


def _drawn(config: RobotConfig) -> tuple[bool, ...]:
    return tuple(tendon.drive == "displacement" for _, tendon, _ in config.strung)


def _end(file: SweepConfig, name: str, unit: str) -> float | None:
    """Where a branch ends, in the unit of what pulls the tendon; None if it is not given."""
    amount = getattr(file.history, name)
    if amount is None or amount.unit == unit:
        return None if amount is None else amount.value
    where = f"{file.source}: history.{name}"
    if unit == TENSION:
        return to_si(amount.text, TENSION, where)  # which says what is wrong with it
    raise file.fault(
        f"history.{name}", f'the tendon is driven by displacement; write for example {name} = "10 mm"'
    )


def _check_branches(
    file: SweepConfig,
    config: RobotConfig,
    axes: Sequence[Axis],
    table: np.ndarray | None,
    tendon: int | None,
    unit: str,
    ends: dict[str, float | None],
    releases: bool,
) -> None:
    """InputError unless the pull begins below its end, and the release lies between nothing and the pull."""
    name, strung, _ = config.strung[tendon or 0]
    usual = {"preload": strung.preload if unit == TENSION else 0.0, **ends}
    names = {"pull": "pull", "release": "release"}
    names["preload"] = (f"preload.{name}" if name else "preload") if unit == TENSION else ""
    number = {axis.name: i for i, axis in enumerate(axes)}

    def among(what: str) -> np.ndarray:
        """Its values at the points of a table, or its ends."""
        i = number.get(names[what])
        if i is None:
            return np.array([float(usual[what] or 0.0)])
        return np.asarray(axes[i].ends) if table is None else table[:, i]

    def above(high: np.ndarray, low: np.ndarray) -> bool:
        return bool(np.all(high >= low) if table is not None else high.min() >= low.max())

    preload, pull, release = (among(what) for what in ("preload", "pull", "release"))
    if not above(pull, preload):
        least = f"the preload of {preload.max():g} N" if unit == TENSION else "0 m"
        raise file.fault("history.pull", f"must be above {least}, is {pull.min():g} {unit}")
    if releases and not above(pull, release):
        raise file.fault(
            "history.release",
            f"must lie between 0 {unit} and the pull of {pull.min():g} {unit}; change one of the two",
        )


def _tendon(file: SweepConfig, config: RobotConfig) -> int | None:
    names, wanted = config.tendon_names, file.history.tendon
    if not names and wanted is not None:
        raise file.fault("history.tendon", "the robot has one tendon; leave it out")
    if names and wanted not in names:
        raise file.fault(
            "history.tendon", f"which of {listed(names)} to pull? name one, or give all in a file"
        )
    return None if not names else names.index(str(wanted))


def _given(file: SweepConfig, config: RobotConfig, given: Given) -> LoadPath:
    """A history from a CSV file."""
    (T, out), time = given.drive, given.time
    drawn = _drawn(config)
    if out is not None:
        moved = np.asarray(drawn).reshape(T.shape[1:])
        T, out = np.where(moved, 0.0, T), np.where(moved, out, 0.0)
        turns = sorted({turn for way in out.reshape(len(out), -1).T for turn in _turns(way)})
    else:
        turns = _turns(T if T.ndim == 1 else T.sum(axis=1))
    ends = tuple(sorted({*turns, len(T) - 1}))
    kept = {"all": tuple(range(len(T))), "last": (len(T) - 1,), "turns": ends}[file.history.keep]
    timed = _timed(config, ())
    if timed and time is None:
        path = file.folder / str(file.history.file)
        raise InputError(f"{path}: {timed} depends on time; give the file a column time_s")
    return LoadPath(None, None, np.zeros(0), np.zeros(0), T, time, kept, None, drawn=drawn, displacement=out)


def _turns(way: np.ndarray) -> list[int]:
    """The steps at which a history turns."""
    moves = np.sign(np.diff(way))
    moving = np.flatnonzero(moves)
    return [int(a) + 1 for a, b in itertools.pairwise(moving) if moves[a] != moves[b]]


def _timed(config: RobotConfig, axes: Sequence[Axis]) -> str | None:
    """A physics term that depends on time, if any acts."""
    for term in config.catalogue.values():
        acts = known_on(term, config.term_values[term.id])
        varied = any(axis.name.startswith(f"{term.id}.") for axis in axes)
        if term.timed and (acts or varied):
            return term.id
    return None
