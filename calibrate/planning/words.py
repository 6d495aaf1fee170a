"""What a plan says: which experiment, what it would settle, and what no experiment of the catalogue does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from gtr_jax.numbers import quantity

from .candidates import ALL_REMOVED, Candidate, listed
from .choice import Ranked
from .opened import Opened
from .worth import pairs

# Distance [standard errors] above which two models are told apart, and share of its present width to which an
# interval must narrow for an experiment to be worth the work.
TELLS, NARROWS = 3.0, 0.8
# A standard deviation above this share of a number's value is not knowledge of it.
UNKNOWN, NOT_KNOWN = 0.7, "unknown"


def in_words(opened: Opened, ranked: Sequence[Ranked], counts: np.ndarray, *, nothing: bool) -> str:
    """The answer in sentences.

    Args:
        opened: what is open.
        ranked: every experiment, the best first.
        counts: numbers whose intervals are to narrow, (p,) bool.
        nothing: whether no experiment settles anything.
    """
    if opened.rivals:
        return _of_rivals(opened, ranked, nothing)
    return _of_intervals(opened, ranked[0], counts, nothing)


def instruction(candidate: Candidate) -> str:
    """The experiment as an instruction."""
    return _check(candidate) if candidate.weight is not None else f"Drive {candidate.in_words}"


def instruction_by_channels(candidate: Candidate) -> str:
    """The experiment as an instruction of a diagnosis, which lists channels and not instruments."""
    if candidate.weight is not None:
        return _check(candidate)
    done = f", with {candidate.done}" if candidate.done else ""
    also = f", and record {', '.join(candidate.added)}" if candidate.added else ""
    return f"Drive {candidate.name}{done}{also}"


def proposed(best: Ranked, rivals: Sequence[tuple[str, ...]], *, named: bool) -> str:
    """What a diagnosis proposes, in sentences.

    Args:
        best: the experiment.
        rivals: the models that it is to tell apart, by names of hypotheses.
        named: whether the answer names a model, which its robot file then holds.
    """
    which = " and ".join(" + ".join(names) if names else "nothing missing" for names in rivals)
    verb = "would tell" if best.least > TELLS else "is the best of the menu, but would hardly tell"
    experiment = instruction_by_channels(best.candidate)
    says = f"{experiment}: it {verb} {which} apart ({best.least:.1f} standard errors)."
    if named and best.candidate.weight is None and not best.candidate.joins:
        says += (
            " Diagnose that recording with diagnosed.toml, changed to say so: the answer is adequate if what "
            "the file holds is right."
        )
    return says


def _check(candidate: Candidate) -> str:
    return f"Take the tendon{'s' if candidate.done == ALL_REMOVED else ''} off and {candidate.name}"


def _of_rivals(opened: Opened, ranked: Sequence[Ranked], nothing: bool) -> str:
    names, best = [model.name for model in opened.models], ranked[0]
    every = listed(names)
    if nothing:
        return (
            f"No experiment of the catalogue tells {every} apart: the best, {best.candidate.in_words}, holds "
            f"them {float(np.max(pairs(best.separation))):.1f} standard errors apart, where {TELLS:g} are "
            "needed. More tension, a longer time, another instrument or a look at the rig itself may help."
        )
    both = list(itertools.combinations(range(len(names)), 2))
    told = [best.separation[pair] for pair in both if best.separation[pair] > TELLS]
    says = f"{instruction(best.candidate)}: it would tell {every} apart (by {min(told):.1f} standard errors"
    says += " or more)" if len(both) > 1 else ")"
    left = [pair for pair in both if best.separation[pair] <= TELLS]
    says += f", but not {listed([f'{names[i]} from {names[j]}' for i, j in left], 'or')}." if left else "."
    for i, j in left:
        other = max(ranked, key=lambda r: r.separation[i, j])
        apart = other.separation[i, j]
        pair = f"{names[i]} from {names[j]}"
        if apart > TELLS:
            says += f" To tell {pair}: {_lower(instruction(other.candidate))} ({apart:.1f} standard errors)."
        else:
            says += f" No experiment of the catalogue tells {pair} ({apart:.1f} standard errors at best)."
    return says


def _lower(text: str) -> str:
    return text[0].lower() + text[1:]


def _of_intervals(opened: Opened, best: Ranked, counts: np.ndarray, nothing: bool) -> str:
    model = opened.models[0]
    each, silent = [], []
    for n, before, after, own in zip(model.numbers, model.sd, best.sd, counts, strict=True):
        now, then = _share(before, n.centre, n.unit), _share(after, n.centre, n.unit)
        if own and then == NOT_KNOWN:
            silent.append(n.name)
        elif own:
            each.append(f"{n.name} to {then} (now {now})")
    if nothing:
        bring = f"would bring {listed(each)}" if each else f"says nothing about {listed(silent, 'or')}"
        return (
            f"No experiment of the catalogue narrows an interval to {100 * NARROWS:.0f} % of its width: the "
            f"best, {best.candidate.in_words}, {bring}."
        )
    beside = f" It says nothing about {listed(silent, 'or')}." if silent else ""
    return f"{instruction(best.candidate)}: it would narrow {listed(each)}.{beside}"


def _share(sd: float, value: float, unit: str) -> str:
    """A standard deviation as a share of a value, or in its unit where that is zero."""
    if value and sd > UNKNOWN * abs(value):
        return NOT_KNOWN
    return f"± {100 * sd / abs(value):.2g} %" if value else f"± {quantity(sd, unit, 2)}"
