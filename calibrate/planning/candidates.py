"""The catalogue of experiments: what to drive, what to do to the rig before, and what to read."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from calibrate.inference.channels import ORIENTATION, of_tendons, quantity_of, unit_of
from gtr_jax import InputError, Robot
from gtr_jax.recordings.formats.quantities import marker_quantities

from .load_histories import checks, menu, more_histories
from .model import OpenModel
from .opened import READINGS, TENSION_SD, Opened
from .ways_to_drive import Values, ways_to_drive

# Standard deviation assumed for instruments that were not used: m, m, m, rad, m.
POSE_NOISE = {"tip_x": 3e-4, "tip_y": 3e-4, "tip_z": 3e-4, "tip_angle": 5e-3, "displacement": 1e-4}
# Standard deviation of a marker's place and of the angle of its section where none was recorded [m, rad].
MARKER_NOISE = {"m": 3e-4, "rad": 5e-3}
TENSION, POSE, DRAWN, MARKERS = (
    "the tension at the tip",
    "the pose of the tip",
    "the tendon's displacement",
    "the markers",
)
REMOVED, ALL_REMOVED = "the tendon taken off", "the tendons taken off"
# What it takes to do something to the rig, and to add an instrument, in the worth of `plan`.
EFFORT_OF_RIG, EFFORT_OF_INSTRUMENT = 1.0, 0.5


def listed(names: Sequence[str], word: str = "and") -> str:
    """Names as a sentence lists them: a, b and c."""
    return f" {word} ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


@dataclasses.dataclass(frozen=True, eq=False)
class Candidate:
    """An experiment.

    Attributes:
        name: what is driven, in words.
        done: what is done to the rig before, in words; "" for nothing.
        added: instruments that were not read before, in words.
        time: [s], (K,).
        drive: of each tendon, a tension [N] or a displacement [m], (K, tendons); for a check of the cells the
            weight on each base cell [N].
        weight: on each tip cell, for a check of the cells, (K,); else None.
        sd: standard deviation of each channel that is recorded, SI, by name.
        changed: what it makes of the values of a robot.
    """

    name: str
    done: str
    added: tuple[str, ...]
    time: np.ndarray
    drive: np.ndarray
    weight: np.ndarray | None
    sd: Mapping[str, float]
    changed: Callable[[Values], Values]

    @property
    def effort(self) -> float:
        """What it takes beyond another load history."""
        return EFFORT_OF_RIG * bool(self.done) + EFFORT_OF_INSTRUMENT * len(self.added)

    @property
    def in_words(self) -> str:
        """What it is, in words."""
        more = [self.done] if self.done else []
        if self.added:
            more.append(f"{listed(self.added)} recorded")
        return f"{self.name}, with {listed(more)}" if more else self.name

    @property
    def joins(self) -> bool:
        """Whether its recording can be diagnosed or fitted with those before: the rig is as it was."""
        return not self.done


# What is recorded: what that adds, in words, and the standard deviation of each channel, SI, by name.
Readings = tuple[tuple[str, ...], dict[str, float]]


def driven(
    robot: Robot,
    tendon: int,
    histories: Mapping[str, tuple[np.ndarray, np.ndarray]],
    resting: np.ndarray,
    readings: Sequence[Readings],
    *,
    hung_from: float | None,
) -> list[Candidate]:
    """The experiments in which one tendon is driven and the others rest, with all that may be recorded.

    Args:
        robot: of the rig.
        tendon: number of the one that is driven.
        histories: time [s] and drive of the tendon, a tension [N] or a displacement [m], (K,) each, by
            description.
        resting: drive of each tendon at rest, (tendons,).
        readings: what may be recorded.
        hung_from: the largest base tension [N], of which a weight hung from the tip is a share; None where
            the rig stays as it is.
    """
    ways = ways_to_drive(list(histories), robot, hung_from or 0.0)
    whose = f" by {robot.tendon_names[tendon]}" if robot.tendon_names else ""
    found = []
    for way in ways[: len(histories)] if hung_from is None else ways:
        time, own = histories[way.name]
        drive = np.tile(resting, (len(time), 1))
        drive[:, tendon] = own
        for added, sd in readings:
            found.append(Candidate(way.name + whose, way.done, added, time, drive, None, sd, way.changed))
    return found


def check_of_cells(
    robot: Robot, name: str, check: tuple[np.ndarray, np.ndarray, np.ndarray], sd: Mapping[str, float]
) -> Candidate:
    """A check of the load cells by themselves.

    Args:
        robot: of the rig.
        name: description of the check.
        check: time [s] and the weights on the base cells and on the tip cells [N], (K,) each.
        sd: standard deviations of "T_base" and "T_tip" [N].
    """
    time, base, tip = check
    return Candidate(
        name=name,
        done=ALL_REMOVED if robot.tendon_names else REMOVED,
        added=(),
        time=time,
        drive=np.tile(base[:, None], (1, len(robot.tendons))),
        weight=tip,
        sd=sd,
        changed=dict,
    )


def by_drive(candidates: Iterable[Candidate]) -> list[list[Candidate]]:
    """Candidates in groups that are simulated once, because they differ in what is recorded alone."""
    return [list(group) for _, group in itertools.groupby(candidates, key=lambda c: (c.name, c.done))]


def channels_of(group: Iterable[Candidate]) -> tuple[str, ...]:
    """All channels that are recorded in some of the candidates."""
    return tuple(dict.fromkeys(name for candidate in group for name in candidate.sd))


def candidates(
    opened: Opened, *, largest: float | None = None, longest: float | None = None
) -> list[Candidate]:
    """Every experiment of the catalogue for a rig.

    Args:
        opened: what is open.
        largest: base tension not to exceed [N]; as far as was recorded unless given.
        longest: time that an experiment may take [s]; histories that take longer are driven faster.

    Raises:
        InputError: a largest tension is given where displacement drives a tendon.
    """
    model = opened.models[0]
    robot = model.robot
    most, least = opened.largest, opened.resting
    if largest is not None:
        if any(tendon.drive == "displacement" for tendon in robot.tendons):
            raise InputError(
                "--max-tension: displacement drives a tendon of this robot; leave it out, and the plan "
                "keeps to the displacements that were recorded"
            )
        most = np.full(len(most), largest)
        least = np.minimum(least, 0.5 * most)
    readings = _readings(opened, float(np.max(most)))
    found = []
    for tendon in range(len(robot.tendons)):
        if most[tendon] <= 0:
            continue
        histories = _histories(opened.pace, longest)
        # A weight is hung from the tip of a tendon that tension drives: its size follows from the tension.
        pulled = robot.tendons[tendon].drive == "tension"
        hung_from = float(most[tendon]) if pulled and not tendon else None
        scaled = {name: (time, share * most[tendon]) for name, (time, share) in histories.items()}
        found += driven(robot, tendon, scaled, least, readings, hung_from=hung_from)
    return [*found, *_checks(opened, model, float(np.max(most)), longest)]


def _histories(pace: float, longest: float | None) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Time [s] and share of the largest drive of every load history, by description, each within the longest
    time that it may take.
    """

    def at(pace: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        return menu(1.0, READINGS, pace) | more_histories(1.0, READINGS, pace)

    found = {}
    for i, (name, (time, share)) in enumerate(at(pace).items()):
        if longest is not None and time[-1] > longest:
            name, (time, share) = list(at(pace * longest / time[-1]).items())[i]
        found[name] = (time, share)
    return found


def _readings(opened: Opened, largest: float) -> list[Readings]:
    """What may be read: as before, and with each further instrument and with all."""
    robot = opened.models[0].robot
    before = {name: sd for name, sd in opened.noise.items() if not name.startswith(ORIENTATION)}
    more: dict[str, dict[str, float]] = {}
    tips = [name for name in of_tendons("T_tip", robot) if name not in before]
    if tips:
        more[TENSION] = dict.fromkeys(tips, TENSION_SD * largest)
    if not robot.backbone.rigid:
        pose = ("tip_x", "tip_y", "tip_z") if robot.space else ("tip_x", "tip_y", "tip_angle")
        drawn = [
            name
            for name, tendon in zip(of_tendons("displacement", robot), robot.tendons, strict=True)
            if tendon.drive == "tension"
        ]
        places = [q for marker in robot.markers for q in marker_quantities(marker.name, space=robot.space)]
        for words, names in ((POSE, pose), (DRAWN, drawn), (MARKERS, places)):
            if names and not any(name in before for name in names):
                more[words] = {n: POSE_NOISE.get(quantity_of(n)) or MARKER_NOISE[unit_of(n)] for n in names}
    found: list[Readings] = [((), before)] if before else []
    found += [((words,), before | sd) for words, sd in more.items()]
    if len(more) > 1:
        every = {name: sd for each in more.values() for name, sd in each.items()}
        found.append((tuple(more), before | every))
    return found


def _checks(opened: Opened, model: OpenModel, largest: float, longest: float | None) -> list[Candidate]:
    """Checks of the load cells by themselves, where both ends of every tendon have one and tension drives."""
    robot = model.robot
    tips = of_tendons("T_tip", robot)
    if any(name not in opened.noise for name in tips) or any(t.drive != "tension" for t in robot.tendons):
        return []
    sd = max(opened.noise[name] for name in tips)
    pace = opened.pace
    found = []
    for i, (name, (time, base, tip)) in enumerate(checks(largest, pace).items()):
        if longest is not None and time[-1] > longest:
            name, (time, base, tip) = list(checks(largest, pace * longest / time[-1]).items())[i]
        if longest is not None and time[-1] > longest:
            time = time * longest / time[-1]
        found.append(check_of_cells(robot, name, (time, base, tip), {"T_base": sd, "T_tip": sd}))
    return found
