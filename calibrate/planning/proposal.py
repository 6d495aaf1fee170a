"""`propose`: the experiment that would tell the rivals of a diagnosis apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibrate.inference.channels import quantity_of
from calibrate.inference.parallel import in_parallel
from calibrate.inference.simulated_rig import SimulatedRig

from .candidates import POSE_NOISE, Candidate, Readings, by_drive, channels_of, check_of_cells, driven
from .choice import Ranked, by_worth
from .load_histories import checks, menu, pace_of
from .model import Rival
from .outcome import SimulatedExperiment, weighed_forward
from .words import proposed
from .worth import separations, worth_of_least

# Noise of a cell at the tip where none was, as a share of the largest tension.
CELL_NOISE = 2e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """What to measure next.

    Attributes:
        says: in a sentence.
        separates: the models it tells apart, by names of hypotheses.
        expected_probability: expected probability of the true model after the experiment.
        time: of the load history [s], (K,).
        T_base: what to drive: base tensions [N], or displacements [m] of tendons that these drive, (K,
            *tendons); for a check of the cells, the weight on the base cells, (K,).
        T_tip: for a check of the cells, the weight on the tip cells [N], (K,); else None.
        record: channels to record.
        menu: all that was considered, with the separation each reaches [standard errors].
    """

    says: str
    separates: list[tuple[str, ...]]
    expected_probability: float
    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray | None
    record: tuple[str, ...]
    menu: list[tuple[str, float]]


def propose(
    rivals: Sequence[Rival], rig: SimulatedRig, sd: Sequence[float], *, named: bool
) -> Experiment | None:
    """Choose what to measure, and how, that separates the rivals most (T-optimality); None where nothing can
    be simulated.

    Experiments are judged to first order: unlike `plan`, which takes minutes, it is part of an answer.

    Args:
        rivals: two models or more.
        rig: the first recording.
        sd: standard deviation of the noise of each of its channels, SI.
        named: whether the answer names a model.
    """
    groups = by_drive(_candidates(rig, sd))
    ranked = by_worth(
        [own for group in in_parallel(lambda group: _judged(rig, rivals, group), groups) for own in group],
        tie=lambda candidate: candidate.name,
    )
    if not ranked:
        return None
    best = ranked[0]
    expected = 1 / (1 + (len(rivals) - 1) * np.exp(-0.5 * min(best.least, 20.0) ** 2))
    chosen, single = best.candidate, not rig.part.others
    return Experiment(
        says=proposed(best, [rival.names for rival in rivals], named=named),
        separates=[rival.names for rival in rivals],
        expected_probability=float(expected),
        time=chosen.time,
        T_base=chosen.drive[:, 0] if single or chosen.weight is not None else chosen.drive,
        T_tip=chosen.weight,
        record=tuple(chosen.sd),
        menu=[(", ".join((own.candidate.name, *_needs(own.candidate))), own.least) for own in ranked],
    )


def _needs(candidate: Candidate) -> list[str]:
    """All it takes beyond another load history."""
    return [candidate.done] * bool(candidate.done) + ["more recorded"] * bool(candidate.added)


def _judged(rig: SimulatedRig, rivals: Sequence[Rival], group: Sequence[Candidate]) -> list[Ranked]:
    """Candidates that differ in what is recorded, with what they are worth; none where load steps of a rival
    do not converge.
    """
    experiment = SimulatedExperiment(
        group[0], channels_of(group), rig.robot, rig.more, name=rig.part.name, cache=rig.cache
    )
    outcomes = []
    for rival in rivals:
        shown = weighed_forward(experiment, rival, group)
        if shown is None:
            return []
        outcomes.append(shown)
    information = [rival.information() for rival in rivals]
    found = []
    for candidate, *shown in zip(group, *outcomes, strict=True):
        separation = separations(information, shown)
        worth = worth_of_least(separation, len(_needs(candidate)))
        found.append(Ranked(candidate, worth, separation))
    return [own for own in found if np.isfinite(own.least)]


def _candidates(rig: SimulatedRig, sd: Sequence[float]) -> list[Candidate]:
    """The experiments that are considered: fewer than `candidates` has for a plan, with as many samples as
    were simulated so far, so that no other program is compiled.
    """
    part, robot = rig.part, rig.robot
    largest = max((float(np.max(T)) for T in part.pulled or part.recorded[: part.tips]), default=1.0)
    # Where there is no cell at the tip, one may be added.
    tip = max(sd[: part.tips], default=CELL_NOISE * largest)
    pace = pace_of(None if part.time is None else float(part.time[-1] - part.time[0]))
    resting = np.asarray([float(drive.T_base.min()) for drive in part.drives])
    readings = _readings(rig, sd, tip)
    found = []
    for tendon, drive in enumerate(part.drives):
        most = float(drive.T_base.max())
        # The corners of a single tension are scaled, and not the history between them: that is the other way
        # round where several tendons or a displacement are driven, and differs in the last bit.
        if part.others or not part.pulled:
            shares = menu(1.0, part.samples, pace)
            histories = {name: (time, share * most) for name, (time, share) in shares.items()}
        else:
            histories = menu(most, part.samples, pace)
        hung_from = None if tendon else largest
        found += driven(robot, tendon, histories, resting, readings, hung_from=hung_from)
    noise = {"T_base": _noise_of_base(rig, tip), "T_tip": tip}
    return [
        *found,
        *(check_of_cells(robot, name, own, noise) for name, own in checks(largest, pace).items()),
    ]


def _readings(rig: SimulatedRig, sd: Sequence[float], tip: float) -> list[Readings]:
    """What may be recorded: the same channels as before, and all that a simulation shows."""
    part = rig.part
    known = dict.fromkeys(rig.channels[: len(part.drives)], tip)
    if not rig.robot.backbone.rigid:
        known |= {c: POSE_NOISE[quantity_of(c)] for c in rig.channels if quantity_of(c) in POSE_NOISE}
    known |= dict(zip(part.channels, sd, strict=True))
    every = tuple(c for c in rig.channels if c in known)
    return [
        (
            tuple(c.replace("_", " ") for c in channels if c not in part.channels),
            {c: known[c] for c in channels},
        )
        for channels in dict.fromkeys((tuple(part.channels), every))
    ]


def _noise_of_base(rig: SimulatedRig, tip: float) -> float:
    """Standard deviation of the base cells [N]; that of the tip cells where it is not known."""
    bases = [
        drive.sd
        for drive, tendon in zip(rig.part.drives, rig.part.robot.tendons, strict=True)
        if tendon.drive == "tension" and drive.sd > 0
    ]
    return max(*bases, 1e-6) if bases else tip
