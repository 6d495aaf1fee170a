"""What a plan says: which experiment, what it would settle, and what no experiment of the catalogue does."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from gtr_jax.files.numbers import quantity

from .opened import Opened
from .worth import pairs

if TYPE_CHECKING:
    from .plan import Ranked

# Distance [standard errors] above which two models are told apart, and share of its present width to which an
# interval must narrow for an experiment to be worth the work.
TELLS, NARROWS = 3.0, 0.8
# A standard deviation above this share of a number's value is no knowledge of it.
UNKNOWN = 0.7


def in_words(opened: Opened, best: Ranked, best_of: np.ndarray, counts: np.ndarray, nothing: bool) -> str:
    """The answer in sentences.

    Args:
        opened: what is open.
        best: the experiment that is ranked first.
        best_of: distance of each pair of models in the experiment that tells it apart best, (m, m).
        counts: numbers whose intervals are to narrow, (p,) bool.
        nothing: whether no experiment settles anything.
    """
    if opened.rivals:
        return _of_rivals(opened, best, best_of, nothing)
    return _of_intervals(opened, best, counts, nothing)


def instruction(best: Ranked) -> str:
    """The experiment as an instruction."""
    c = best.candidate
    if c.weight is not None:
        return f"{c.done[0].upper()}{c.done[1:]}, {c.name}"
    return f"Drive {', with '.join([c.name, *([c.done] if c.done else []), *c.added])}"


def _list(names: list[str], word: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


def _of_rivals(opened: Opened, best: Ranked, best_of: np.ndarray, nothing: bool) -> str:
    names = [model.name for model in opened.models]
    every = _list(names)
    if nothing:
        return (
            f"No experiment of the catalogue tells {every} apart: the best, {best.candidate.in_words}, holds "
            f"them {float(np.max(pairs(best.separation))):.1f} standard errors apart, where {TELLS:g} are "
            "needed. More tension, a longer time, another instrument or a look at the rig itself may."
        )
    told, open_, never = [], [], []
    for i, j in itertools.combinations(range(len(names)), 2):
        pair = f"{names[i]} from {names[j]}"
        own, most = best.separation[i, j], best_of[i, j]
        if own > TELLS:
            told.append(pair)
        else:
            (open_ if most > TELLS else never).append(f"{pair} ({most:.1f} standard errors at best)")
    if not open_ and not never:
        return f"{instruction(best)}: it would tell {every} apart (by {best.least:.1f} standard errors)."
    says = f"{instruction(best)}: it would tell {_list(told)}."
    if open_:
        says += f" Another experiment has to tell {_list(open_)}."
    if never:
        says += f" No experiment of the catalogue tells {_list(never)}."
    return says


def _of_intervals(opened: Opened, best: Ranked, counts: np.ndarray, nothing: bool) -> str:
    model = opened.models[0]
    each = []
    for n, before, after, own in zip(model.numbers, model.sd, best.sd, counts, strict=True):
        if own:
            now = _share(before, n.centre, n.unit)
            each.append(f"{n.name} to {_share(after, n.centre, n.unit)} (now {now})")
    if nothing:
        return (
            f"No experiment of the catalogue narrows an interval to {100 * NARROWS:.0f} % of its width: the "
            f"best, {best.candidate.in_words}, would bring {_list(each)}."
        )
    return f"{instruction(best)}: it would narrow {_list(each)}."


def _share(sd: float, value: float, unit: str) -> str:
    """A standard deviation as a share of a value, or in its unit where that is zero."""
    if value and sd > UNKNOWN * abs(value):
        return "unknown"
    return f"± {100 * sd / abs(value):.2g} %" if value else f"± {quantity(sd, unit, 2)}"
