"""Whether one number differs between recordings: tested before any physics is called missing.

A tendon that was oiled, a warmer body or a cell's zero that has moved make recordings of one robot disagree.
No term of the catalogue explains that, because its numbers are the same for all recordings. So each number
that may differ is fitted once with one value for all recordings, and once with a value for each; the mesh,
the noise and the priors are the same.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from calibrate.diagnosis.evidence.models import BELIEVED, HOW_MANY, LARGEST_SCALE, Models
from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis, number_of
from calibrate.diagnosis.hypotheses.model import Fitted, model_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.screening.screen import SEEN, screen
from calibrate.inference.instruments import cells_of
from calibrate.inference.number import OWN, Number, number_at, values_in
from calibrate.inference.parallel import in_parallel
from gtr_jax import Robot
from gtr_jax.robot.parameters import parameter
from gtr_jax.terms import REGISTRY, known_on

from .search import ONE_EACH, base_fit, refit_best

# Besides the base numbers and the uncertain dimensions, the preload and the zeros of the cells may differ
# between sessions. Standard deviation of the preload as a share of the largest base tension.
PRELOAD, PRELOAD_SHARE = "preload", 0.05
ZEROS = ("tip-offset", "base-offset")
# Numbers that may differ at once.
MOST = 2
# An effect that may be the cause instead is refitted if it promises this share of the drop that the differing
# number brings.
PROMISING = 0.3
# Standard errors from which two recordings are said to differ; log odds within which another cause is
# reported as well; number of effects refitted as other causes, and iterations of each refit.
DISAGREE, ODDS, INSTEAD, ITERATIONS = 3.0, 3.0, 3, 8
# Two load histories are alike if the rms difference of their base tensions is below this share of the range,
# and if their durations differ by less than this share.
ALIKE = 0.03


@dataclasses.dataclass(frozen=True)
class Difference:
    """A number that differs between recordings.

    Attributes:
        name, unit: of the parameter.
        shared: its value if all recordings share one, SI.
        own: its value in each recording, SI.
        groups: recordings that do not differ by `DISAGREE` standard errors, lowest value first.
        standard_errors: root of the drop of the sum of squares, in variances of the residual, counting
            independent samples.
        or_numbers, or_effects: what would explain the recordings nearly as well: another number that differs,
            or an effect with one value of every number for all.
    """

    name: str
    unit: str
    shared: float
    own: dict[str, float]
    groups: list[list[str]]
    standard_errors: float
    or_numbers: list[str]
    or_effects: list[str]

    def at(self, values: Mapping[str, float]) -> Difference:
        """The difference with the values of a model, by name."""
        return dataclasses.replace(self, own={k: values[f"{self.name}{OWN}{k}"] for k in self.own})


class Split(NamedTuple):
    """A base model in which a number differs: its numbers, the dimensions that follow, coordinates to start
    from, and what differs.
    """

    base: tuple[Number, ...]
    dimensions: tuple[Number, ...]
    start: np.ndarray
    difference: Difference


class _Tried(NamedTuple):
    """A number with one shared value, and with a value for each recording: both fits of the base model, and
    the likelihood of the second.
    """

    number: Number
    shared: Fitted
    each: Likelihood
    own: Fitted


def preloads(robot: Robot) -> list[str]:
    """Names of the tendons' preloads."""
    return [f"{PRELOAD}.{name}" if name else PRELOAD for name in robot.tendon_names or ("",)]


def names_to_split(robot: Robot, dimensions: Sequence[Number]) -> list[str]:
    """Names of further numbers that rigs must be able to change, for `candidates`."""
    return [name for name in preloads(robot) if name not in {d.name for d in dimensions}]


def candidates(likelihood: Likelihood, robot: Robot) -> list[Number]:
    """The numbers that may differ between recordings: those of the base model, with the uncertain dimensions,
    the preload and the zeros of the cells.
    """
    found = [n for n in likelihood.base if OWN not in n.name]
    taken = {n.parameter for n in likelihood.base}
    for name in preloads(robot):
        if name in taken:
            continue
        tensions = [
            T for rig in likelihood.rigs for T in rig.part.pulled or rig.part.recorded[: rig.part.tips]
        ]
        largest = max((float(np.max(T)) for T in tensions), default=0.0)
        if largest == 0:  # nothing says how large the tensions are
            continue
        preload = number_at(parameter(robot, name), float(robot.value(name)), sd=PRELOAD_SHARE * largest)
        found.append(dataclasses.replace(preload, size=True))
    cells = cells_of([rig.part for rig in likelihood.rigs])
    for kind, read in zip(ZEROS, (cells.tip, cells.base), strict=True):
        if not read:
            continue
        term = REGISTRY[kind]
        number = number_of(term, term.quantities[0])
        if number.name not in taken and not known_on(term, robot.terms[kind]):
            found.append(number)
    return found


def split(number: Number, recordings: Sequence[str]) -> list[Number]:
    """One copy of a number for each recording."""
    return [number.of(name) for name in recordings]


def _base_with(likelihood: Likelihood, number: Number, *, each: bool) -> tuple[Number, ...]:
    """The base numbers with a number among them, once, or once for each recording."""
    own = split(number, [rig.part.name for rig in likelihood.rigs]) if each else [number]
    names = [n.name for n in likelihood.base]
    if number.name not in names:
        return (*likelihood.base, *own)
    at = names.index(number.name)
    return (*likelihood.base[:at], *own, *likelihood.base[at + 1 :])


def _by_itself(likelihood: Likelihood, k: int, shared: np.ndarray) -> tuple[Likelihood, Fitted] | None:
    """One of the recordings, and the base model fitted to it with noise of its own; None where that fails."""
    alone = dataclasses.replace(
        likelihood,
        rigs=(likelihood.rigs[k],),
        noise=[likelihood.noise[k]],
        weighs=[likelihood.weighs[k]],
        corrections={(): [likelihood.correction(())[k]]},
    )
    fits = [base_fit(alone, start) for start in (shared, np.zeros(len(shared)))]
    found = [fit for fit in fits if fit is not None]
    return min(found, key=lambda one: one[0].mean_square(one[1]), default=None)


def _together(likelihood: Likelihood, alone: Sequence[tuple[Likelihood, Fitted]]) -> Likelihood:
    """The likelihood with the noise that each recording shows by itself: in a joint fit, a wrong shared value
    passes for noise.
    """
    return dataclasses.replace(
        likelihood, noise=[own.noise[0] for own, _ in alone], weighs=[own.weighs[0] for own, _ in alone]
    )


def _refitted(likelihood: Likelihood, starts: Sequence[np.ndarray]) -> Fitted | None:
    """The base model of a likelihood, refitted from the best of some starts, because a descent may stop at a
    kink of friction.
    """
    fits = [likelihood.refit((), start, exact=False) for start in starts]
    best = min((f for f in fits if f is not None), key=lambda f: f.cost, default=None)
    return best and likelihood.refit((), best.x)


def _starts(
    likelihood: Likelihood,
    base: tuple[Number, ...],
    fitted: Fitted,
    alone: Sequence[tuple[Likelihood, Fitted]],
) -> list[np.ndarray]:
    """Starting coordinates of the base numbers: as fitted to all recordings, and as fitted to each by itself,
    with the mean for shared numbers.
    """
    together = fitted.values
    apart = {
        rig.part.name: values_in(f.values, rig.part.name)
        for rig, (_, f) in zip(likelihood.rigs, alone, strict=True)
    }

    def mean(n: Number) -> float:
        if n.owner:
            return apart[n.owner].get(n.parameter, n.centre)
        return float(np.mean([values.get(n.parameter, n.centre) for values in apart.values()]))

    values = [
        [together.get(n.name, together.get(n.parameter, n.centre)) for n in base],
        [mean(n) for n in base],
    ]
    return [
        np.asarray([np.clip(n.at(v), *n.bounds) for n, v in zip(base, some, strict=True)]) for some in values
    ]


def _tried(
    likelihood: Likelihood, fitted: Fitted, alone: Sequence[tuple[Likelihood, Fitted]], number: Number
) -> _Tried | None:
    """Fit a number with one shared value, and with one value for each recording; None where that fails."""

    def split_fit(start: Fitted, *, each: bool) -> tuple[Likelihood, Fitted | None]:
        base = _base_with(likelihood, number, each=each)
        own = likelihood.with_base(base)
        return own, _refitted(own, _starts(own, base, start, alone))

    _, shared = split_fit(fitted, each=False)
    if shared is None:
        return None
    split_likelihood, own = split_fit(shared, each=True)
    return None if own is None else _Tried(number, shared, split_likelihood, own)


def _log_evidence(fitted: Fitted, scale: float) -> float:
    return -0.5 * fitted.chi2 / scale + fitted.volume()


def least_drop(recordings: int) -> float:
    """Drop of the sum of squares from which a number differs between this many recordings: as improbable by
    chance as the drop from which an effect is claimed.
    """
    return float(chdtri(recordings - 1, chdtrc(1, SEEN**2)))


def differing(
    likelihood: Likelihood, base: Fitted, robot: Robot, hypotheses: Sequence[Hypothesis]
) -> Split | None:
    """The number by which recordings differ most probably; None where they agree, or where an effect that all
    have in common explains them much better.

    Args:
        likelihood, base: the recordings, and the base model fitted to them.
        robot: with the values of its file.
        hypotheses: effects that may be the cause as well.
    """
    K = len(likelihood.rigs)
    if K < 2:
        return None
    free = likelihood.with_dimensions_free()
    values = dict(base.values) | dict(base.dimensions)
    x = np.asarray([np.clip(n.at(values[n.name]), *n.bounds) for n in free.base])
    apart = in_parallel(lambda k: _by_itself(free, k, x), list(range(K)))
    alone = [a for a in apart if a is not None]
    if len(alone) < K:
        return None
    free = _together(free, alone)
    again = _refitted(free, [x, *_starts(free, free.base, alone[0][1], alone)[1:]])
    # A single number that differs cannot explain more than separate fits of all numbers do.
    if again is None or again.cost - sum(f.chi2 for _, f in alone) < least_drop(K):
        return None
    numbers = candidates(free, robot)
    found = in_parallel(lambda n: _tried(free, again, alone, n), numbers)
    tried = [t for t in found if t is not None]
    if not tried:
        return None
    # One scale for all models, so that they can be compared.
    scale = float(np.clip(min(t.each.mean_square(t.own) for t in tried), 1.0, LARGEST_SCALE))
    tried.sort(key=lambda t: -_log_evidence(t.own, scale))
    best = tried[0]
    drop = (best.shared.cost - best.own.cost) / best.each.scale_left(best.own)
    if drop < least_drop(K):
        return None
    behind = [_log_evidence(best.own, scale) - _log_evidence(t.own, scale) for t in tried]
    others = [t.number.name for t, less in zip(tried, behind, strict=True) if BELIEVED * less < ODDS][1:]
    difference = _difference(best, float(np.sqrt(drop)), others)
    if not _driven_alike(likelihood, difference.groups):
        odds = _effects_instead(free, again, best.own, len(numbers), hypotheses)
        if any(log > ODDS for log in odds.values()):
            return None
        effects = [name for name, log in odds.items() if log > -ODDS]
        difference = dataclasses.replace(difference, or_effects=effects)
    numbers = _base_with(likelihood, best.number, each=True)
    start = np.asarray([np.clip(n.at(best.own.values[n.name]), *n.bounds) for n in numbers])
    dimensions = tuple(d for d in likelihood.dimensions if d.name != best.number.name)
    return Split(base=numbers, dimensions=dimensions, start=start, difference=difference)


def still_differ(
    likelihood: Likelihood, fitted: Fitted, hypotheses: Sequence[Hypothesis], differ: Sequence[Difference]
) -> bool:
    """Whether recordings still differ in some numbers once the model has the effects that were found.

    Args:
        likelihood, fitted: the recordings, and a model fitted to them in which the numbers differ.
        hypotheses: its effects.
        differ: the numbers.
    """
    base: dict[str, Number] = {}
    for n in likelihood.base:
        base.setdefault(n.parameter, dataclasses.replace(n, name=n.parameter))
    one = likelihood.with_base(tuple(base.values()))
    numbers = model_of(one.base, hypotheses).numbers
    values = dict(fitted.values) | {d.name: float(np.mean(list(d.own.values()))) for d in differ}
    shared = one.refit(hypotheses, np.asarray([n.at(values[n.name]) for n in numbers]), exact=False)
    if shared is None:
        return True
    drop = (shared.cost - fitted.cost) / likelihood.scale_left(fitted)
    return drop > least_drop(len(likelihood.rigs))


def _driven_alike(likelihood: Likelihood, groups: Sequence[Sequence[str]]) -> bool:
    """Whether two recordings that differ were driven alike: then no effect that they have in common makes
    them differ.
    """
    part_of = {rig.part.name: rig.part for rig in likelihood.rigs}
    for one, other in itertools.combinations(groups, 2):
        for a, b in itertools.product((part_of[k] for k in one), (part_of[k] for k in other)):
            if (a.time is None) != (b.time is None):
                continue
            clock, other_clock = (
                np.linspace(0.0, 1.0, p.samples) if p.time is None else p.time - p.time[0] for p in (a, b)
            )
            lasts = [float(clock[-1]), float(other_clock[-1])]
            alike = [
                np.sqrt(np.mean((np.interp(clock, other_clock, theirs.T_base) - own.T_base) ** 2))
                < ALIKE * max(float(np.ptp(drive.T_base)) for drive in a.drives)
                for own, theirs in zip(a.drives, b.drives, strict=True)
            ]
            if abs(lasts[0] - lasts[1]) < ALIKE * max(lasts) and all(alike):
                return True
    return False


def _effects_instead(
    likelihood: Likelihood, base: Fitted, own: Fitted, numbers: int, hypotheses: Sequence[Hypothesis]
) -> dict[str, float]:
    """Log odds of the effects that best explain the recordings with one value of every number, against one of
    `numbers` numbers having a value of its own in each recording.
    """
    models = Models(likelihood, hypotheses)
    models.add([base])
    screened = [
        s
        for s in screen(likelihood, base, hypotheses, thorough=False)
        if s.gain > PROMISING * (base.cost - own.cost)
    ]
    models.add(refit_best(likelihood, (), base, screened[:INSTEAD], ONE_EACH, ITERATIONS))
    differs = models.log_likelihood(own) + own.volume() + float(np.log(HOW_MANY[1] / numbers))
    return {
        " + ".join(f.names): BELIEVED
        * (models.log_likelihood(f) + f.volume() + models.log_prior(f) - differs)
        for f in models.fits.values()
        if f.names
    }


def _difference(best: _Tried, standard_errors: float, others: list[str]) -> Difference:
    name, names = best.number.name, [rig.part.name for rig in best.each.rigs]
    own = {k: best.own.values[f"{name}{OWN}{k}"] for k in names}
    return Difference(
        name=name,
        unit=best.number.unit,
        shared=best.shared.values[name],
        own=own,
        groups=groups(best, names),
        standard_errors=standard_errors,
        or_numbers=others,
        or_effects=[],
    )


def groups(tried: _Tried, recordings: Sequence[str]) -> list[list[str]]:
    """Recordings ordered by their value, in groups that are `DISAGREE` standard errors apart; each in a group
    of its own if no neighbours are.
    """
    fitted, of = tried.own, {}
    for i, n in enumerate(fitted.numbers):
        if n.parameter == tried.number.name:
            of[n.owner] = i
    covariance = np.linalg.inv(fitted.information(tried.each.scale_left(fitted)))
    ordered = sorted(recordings, key=lambda k: fitted.x[of[k]])
    found = [[ordered[0]]]
    for a, b in itertools.pairwise(ordered):
        i, j = of[a], of[b]
        sd = np.sqrt(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j])
        if fitted.x[j] - fitted.x[i] > DISAGREE * sd:
            found.append([b])
        else:
            found[-1].append(b)
    return found if len(found) > 1 else [[k] for k in ordered]
