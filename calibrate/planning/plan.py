"""`plan`: rank the experiments of the catalogue by what they tell about what is open, and choose one."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calibrate.inference.parallel import in_parallel
from gtr_jax import InputError
from gtr_jax.errors import did_you_mean
from gtr_jax.to_jsonable import to_jsonable

from .candidates import Candidate, by_drive, candidates, channels_of
from .choice import Ranked, by_worth
from .opened import Opened
from .outcome import FINE_STEP, Outcome, Trial, outcome, refitted
from .words import NARROWS, TELLS, in_words
from .worth import pairs, sd_after, separations, worth_of_narrowing, worth_of_separation

# Candidates, at most, whose separation is computed again with every rival refitted, beyond the first order:
# the first ones, until the first of all is one of them.
CONFIRMED = 12
# A standard deviation that is larger by this factor with derivatives over a small step counts: in a rigid
# sheath with a gain and an asymmetry, whose two ratios do not tell three numbers, it is 70 times as large.
FALSE = 3.0
SETTLES, PARTLY, NOTHING = "settles", "settles-some", "settles-nothing"
NARROWS_ONE, NARROWS_NONE = "narrows", "narrows-nothing"


@dataclasses.dataclass(frozen=True, eq=False)
class Expected:
    """What the chosen experiment would show under each of m models.

    Attributes:
        channels: that are read, C of them.
        rows: the readings under each model, SI, (m, C, K).
        after: the same of each model refitted to what the first one would show, SI, (m, C, K).
    """

    channels: tuple[str, ...]
    rows: np.ndarray
    after: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What to measure next.

    Attributes:
        opened: what is open.
        verdict: "settles" where the experiment would tell all rivals apart, "settles-some" where some of
            them, "settles-nothing" where no experiment of the catalogue does; of one model "narrows" or
            "narrows-nothing".
        says: the same in sentences.
        ranked: every experiment that could be simulated, the best first.
        best_of: distance of each pair of models in the experiment that tells it apart best, (m, m).
        expected: of the first experiment.
        wanted: names of the numbers whose intervals are to narrow.
        warnings: what the reader must know.
    """

    opened: Opened
    verdict: str
    says: str
    ranked: list[Ranked]
    best_of: np.ndarray
    expected: Expected
    wanted: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def chosen(self) -> Candidate | None:
        """The experiment to do; None where none settles anything."""
        return None if self.verdict in (NOTHING, NARROWS_NONE) else self.ranked[0].candidate

    def to_json(self) -> dict[str, Any]:
        """The contents of `next.json`."""
        models, first = self.opened.models, self.opened.models[0]

        def apart(separation: np.ndarray) -> list[dict[str, Any]]:
            return [
                {"models": [models[i].name, models[j].name], "standard_errors": separation[i, j]}
                for i, j in itertools.combinations(range(len(models)), 2)
            ]

        def entry(own: Ranked) -> dict[str, Any]:
            c = own.candidate
            sds = dict(zip([n.name for n in first.numbers], own.sd, strict=True))
            return {
                "experiment": c.in_words,
                "rig": c.done or None,
                "added": list(c.added),
                "duration_s": c.time[-1],
                "worth": own.worth,
                "separation": apart(own.separation),
                "refitted": own.confirmed and self.opened.rivals,
                "sd_after": None if self.opened.rivals else sds,
            }

        return to_jsonable(
            {
                "verdict": self.verdict,
                "says": self.says,
                "from": self.opened.source,
                "answered_so_far": self.opened.verdict,
                "models": [
                    {
                        "name": m.name,
                        "file": m.file,
                        "probability": m.probability,
                        "numbers": {
                            n.name: {"value": n.centre, "sd": sd, "unit": n.unit}
                            for n, sd in zip(m.numbers, m.sd, strict=True)
                        },
                    }
                    for m in models
                ],
                "chosen": None if self.chosen is None else entry(self.ranked[0]),
                "numbers_to_narrow": list(self.wanted),
                "best_separation": apart(self.best_of),
                "catalogue": [entry(own) for own in self.ranked],
                "noise": self.opened.noise,
                "warnings": list(self.warnings),
            }
        )


def plan(
    opened: Opened,
    *,
    largest: float | None = None,
    longest: float | None = None,
    wanted: Sequence[str] = (),
    as_it_is: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Rank the experiments of the catalogue, and choose one.

    Where rivals are left, an experiment is worth the distance at which it holds them apart, each refitted to
    what another one would show; else the narrowing of the intervals of the only model.

    Args:
        opened: what is open, from `open_folder` or `open_files`.
        largest: base tension not to exceed [N]; as far as was recorded unless given.
        longest: time that an experiment may take [s].
        wanted: names of the numbers whose intervals are to narrow; all that were fitted unless given, and
            then also that they no longer trade off counts.
        as_it_is: whether only experiments with the rig and the instruments as they are count.
        progress: called with a line of text at each stage.

    Raises:
        InputError: an unknown number, numbers to narrow where rivals are left, or no experiment that can be
            simulated.
    """
    models = opened.models
    counts = _counted(opened, wanted)
    every = candidates(opened, largest=largest, longest=longest)
    every = [c for c in every if not (as_it_is and c.effort)]
    if not opened.rivals:
        every = [c for c in every if c.weight is None]
    if not every:
        raise InputError(f"{opened.source}: nothing was recorded by which a new load history could be judged")
    groups = by_drive(every)
    progress(f"simulating {len(groups)} experiments under {len(models)} model{'s'[: len(models) - 1]}")
    trials = in_parallel(lambda group: _tried(opened, group), groups)
    ranked = []
    for group, trial in zip(groups, trials, strict=True):
        if trial is not None:
            ranked += [
                _judged(opened, candidate, trial.outcomes, counts, bool(wanted)) for candidate in group
            ]
    if not ranked:
        raise InputError(f"{opened.source}: no experiment of the catalogue could be simulated")
    ranked = by_worth(ranked)
    trial_of = {id(c): trial for group, trial in zip(groups, trials, strict=True) for c in group}
    if opened.rivals:
        progress("refitting the rivals to what the best experiments would show")
        for _ in range(CONFIRMED):
            if ranked[0].confirmed:
                break
            first = _confirmed(opened, ranked[0], trial_of[id(ranked[0].candidate)])
            ranked = by_worth([first, *ranked[1:]])
        ranked.sort(key=lambda r: not r.confirmed)
    else:
        progress("checking what the best experiments would narrow")
        fine: dict[int, Outcome | None] = {}
        for _ in range(len(ranked)):
            if ranked[0].confirmed:
                break
            trial = trial_of[id(ranked[0].candidate)]
            first = _checked(opened, ranked[0], trial, fine, counts, bool(wanted))
            ranked = by_worth([first, *ranked[1:]])
    best_of = np.max([r.separation for r in ranked], axis=0)
    best = ranked[0]
    verdict = _verdict(opened, best, counts)
    trial = trial_of[id(best.candidate)]
    return Plan(
        opened=opened,
        verdict=verdict,
        says=in_words(opened, ranked, counts, nothing=verdict in (NOTHING, NARROWS_NONE)),
        ranked=ranked,
        best_of=best_of,
        expected=_expected(best.candidate, trial),
        wanted=tuple(n.name for n, own in zip(models[0].numbers, counts, strict=True) if own),
        warnings=opened.left_out,
    )


def _counted(opened: Opened, wanted: Sequence[str]) -> np.ndarray:
    """Which numbers of the first model are to be known better, (p,) bool."""
    first = opened.models[0]
    if not wanted:
        return first.asked
    if opened.rivals:
        raise InputError(
            f"--for: {opened.source} leaves open which of {len(opened.models)} models is right, which the "
            "plan settles first; leave --for out, or give the robot file of one model"
        )
    names = [n.name for n in first.numbers]
    for name in wanted:
        if name not in names:
            raise InputError(f"--for: no free number '{name}'; {did_you_mean(name, names)}")
    return np.asarray([name in wanted for name in names])


@dataclasses.dataclass(frozen=True, eq=False)
class _Tried:
    """A drive simulated under every model, and what it shows."""

    trials: list[Trial]
    outcomes: list[Outcome]


def _tried(opened: Opened, group: Sequence[Candidate]) -> _Tried | None:
    """One drive of the rig under every model, with all instruments of its candidates; None where load steps
    of a model do not converge.
    """
    trials = [Trial(model, group[0], channels_of(group), opened.noise_drive) for model in opened.models]
    outcomes = [own for own in map(outcome, trials) if own is not None]
    return _Tried(trials, outcomes) if len(outcomes) == len(trials) else None


def _judged(
    opened: Opened, candidate: Candidate, outcomes: Sequence[Outcome], counts: np.ndarray, each: bool
) -> Ranked:
    shown = [own.weighed(candidate) for own in outcomes]
    separation = separations([model.information for model in opened.models], shown)
    first, slopes = opened.models[0], shown[0].white(shown[0].slopes)
    if opened.rivals:
        worth = worth_of_separation(separation, candidate.effort)
    else:
        worth = worth_of_narrowing(first, slopes, counts, each=each, effort=candidate.effort)
    return Ranked(candidate, worth, separation, sd_after(first, slopes))


def _confirmed(opened: Opened, ranked: Ranked, trial: _Tried | None) -> Ranked:
    """The same with the rivals refitted beyond the first order."""
    assert trial is not None  # it was ranked
    models, candidate = opened.models, ranked.candidate
    ways = list(itertools.permutations(range(len(models)), 2))

    def left(way: tuple[int, int]) -> float:
        true, other = way
        target = trial.outcomes[true].weighed(candidate).rows
        return refitted(trial.trials[other], candidate, target, trial.outcomes[other])[0]

    distances = dict(zip(ways, in_parallel(left, ways), strict=True))
    separation = np.zeros_like(ranked.separation)
    for i, j in ways:
        separation[i, j] = min(distances[i, j], distances[j, i])
    worth = worth_of_separation(separation, candidate.effort)
    return dataclasses.replace(ranked, worth=worth, separation=separation, confirmed=True)


def _checked(
    opened: Opened,
    ranked: Ranked,
    trial: _Tried | None,
    fine: dict[int, Outcome | None],
    counts: np.ndarray,
    each: bool,
) -> Ranked:
    """The same with derivatives over a small step, where by these some number stays known much worse.

    Args:
        opened, ranked, trial: what is open, the experiment, and its simulations.
        fine: outcomes over the small step that are known, by the simulations; more are added.
        counts, each: as of `_judged`.
    """
    assert trial is not None  # it was ranked
    if id(trial) not in fine:
        fine[id(trial)] = outcome(trial.trials[0], width=FINE_STEP)
    own = fine[id(trial)]
    if own is None:
        return dataclasses.replace(ranked, confirmed=True)
    again = _judged(opened, ranked.candidate, [own], counts, each)
    if np.all(again.sd <= FALSE * ranked.sd):
        again = ranked
    return dataclasses.replace(again, confirmed=True)


def _verdict(opened: Opened, best: Ranked, counts: np.ndarray) -> str:
    if opened.rivals:
        told = pairs(best.separation) > TELLS
        return SETTLES if told.all() else PARTLY if told.any() else NOTHING
    narrowed = (best.sd / opened.models[0].sd)[counts]
    return NARROWS_ONE if float(np.min(narrowed)) < NARROWS else NARROWS_NONE


def _expected(candidate: Candidate, trial: _Tried | None) -> Expected:
    assert trial is not None  # it was ranked
    first = trial.outcomes[0]
    at = [first.channels.index(name) for name in candidate.sd]
    target, after = first.weighed(candidate).rows, [first.rows]
    for other, own in zip(trial.trials[1:], trial.outcomes[1:], strict=True):
        after.append(refitted(other, candidate, target, own)[1])
    return Expected(
        channels=tuple(candidate.sd),
        rows=np.stack([own.rows[at] for own in trial.outcomes]),
        after=np.stack([rows[at] for rows in after]),
    )
