"""Effects that the recordings cannot tell apart whatever they show, found by sensitivity: where a small size
of one changes the readings exactly as numbers of a model do, one may stand in the other's place.

In a sheath of fixed shape, tensions scale: a gain of one cell, one over it of the other, and friction that
differs between pull and release are the same in the readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis, may_join
from calibrate.diagnosis.hypotheses.model import Fitted, model_of
from calibrate.inference.side_by_side import in_lanes

# Size of an effect at which its sensitivity is taken [standard deviations of its prior]; share of the change
# of the readings that the numbers of a model may leave for it to count as a twin; and share of an effect's
# own change in the combination from which on it is the one in whose place the twin stands.
SMALL, SAME, ITS_PLACE = 0.1, 0.1, 0.5
# Twins are refitted until the cost falls by less than this, at most so often.
SETTLED, MOST_ROUNDS = 0.5, 4


def twins_of(models: Models, fitted: Fitted) -> dict[str, tuple[str, ...]]:
    """For each effect of a model, those that would change the readings as it does.

    Args:
        models: all that were refitted.
        fitted: the model.
    """
    likelihood, others = models.likelihood, models.addable(fitted)
    columns = in_lanes(lambda h: _change(models, fitted, h), others)
    own = fitted.jacobian
    found: dict[str, tuple[str, ...]] = dict.fromkeys(fitted.names, ())
    base = len(likelihood.base)
    for h, column in zip(others, columns, strict=True):
        size = 0.0 if column is None else float(np.linalg.norm(column))
        if column is None or size < 1e-9:
            continue
        shares = np.linalg.lstsq(own, column, rcond=None)[0]
        if np.linalg.norm(column - own @ shares) > SAME * size:
            continue
        at = base
        for name in fitted.names:
            count = len(models.of[name].numbers)
            part = own[:, at : at + count] @ shares[at : at + count]
            at += count
            if models.of[name].kind != h.kind and np.linalg.norm(part) > ITS_PLACE * size:
                found[name] += (h.name,)
    return found


def _change(models: Models, fitted: Fitted, h: Hypothesis) -> np.ndarray | None:
    """Change of the rows by a small size of an effect added to a model, its other numbers as it starts."""
    model = model_of(models.likelihood.base, [*models.hypotheses(fitted.names), h])
    first, *shapes = h.numbers
    if not first.size:
        return None
    start = h.starts[0]
    more = [SMALL if first.bounds[1] >= SMALL else -SMALL, *(n.at(start[n.name]) for n in shapes)]
    order = [*fitted.numbers, *h.numbers]
    x = dict(zip((n.name for n in order), [*fitted.x, *more], strict=True))
    there = models.likelihood.at(model, np.asarray([x[n.name] for n in model.numbers]))
    return None if there is None else there.rows - fitted.rows


def settled_with_twins(models: Models, head: Fitted, rounds: int = 2) -> None:
    """A model and its twins, refitted until the cost no longer falls and added to `models`: twins must not
    differ by where a descent stopped. Where one of them ends lower than the model, the others start from it.
    """
    for _ in range(rounds):
        fits = settled(models, [head, *swapped(models, head, twins_of(models, head))])
        best = min((models.stored(f) for f in fits), key=lambda f: f.cost)
        if best.names == head.names or best.cost > models.stored(head).cost - SETTLED:
            return
        head = best


def settled(models: Models, fits: Sequence[Fitted]) -> list[Fitted]:
    """Models refitted until the cost no longer falls, and added."""

    def settle(f: Fitted) -> Fitted:
        own = models.hypotheses(f.names)
        for _ in range(MOST_ROUNDS):
            start = models.likelihood.scanned(model_of(models.likelihood.base, own), f.x)
            again = models.likelihood.refit(own, start)
            if again is None or again.cost > f.cost - SETTLED:
                break
            f = again
        return f

    found = in_lanes(settle, list(fits))
    models.add(found)
    return found


def swapped(models: Models, head: Fitted, instead: Mapping[str, tuple[str, ...]]) -> list[Fitted]:
    """The model with each of its effects replaced by one of those named for it, refitted."""
    known = {n.name: v for n, v in zip(head.numbers, head.x, strict=True)}

    def refit(item):
        name, other = item
        names = tuple(other if n == name else n for n in head.names)
        model = model_of(models.likelihood.base, models.hypotheses(names))
        alone = next((f for f in models.fits.values() if other in f.names), None)
        own = {} if alone is None else {n.name: v for n, v in zip(alone.numbers, alone.x, strict=True)}
        first = next(i for i, n in enumerate(model.numbers) if n == models.of[other].numbers[0])
        plain = np.asarray([known.get(n.name, own.get(n.name, 0.0)) for n in model.numbers])
        # As large as the effect it stands for, of either sign; as found alone; or as sensitivities say.
        size = known[models.of[name].numbers[0].name]
        starts = [plain, plain.copy(), plain.copy()]
        starts[1][first], starts[2][first] = size, -size
        told = _in_its_place(models, head, name, models.of[other])
        starts += [] if told is None else [np.asarray([told.get(n.name, 0.0) for n in model.numbers])]
        costs = models.likelihood.squares(model, [np.clip(x, *model.bounds) for x in starts])
        start = starts[int(np.argmin(costs))]
        return models.likelihood.refit(models.hypotheses(names), start, exact=False)

    items = [
        (name, other)
        for name in head.names
        for other in dict.fromkeys(instead.get(name, ()))
        if other not in head.names
        and may_join(models.of[other], models.hypotheses([k for k in head.names if k != name]))
    ]
    return [f for f in in_lanes(refit, items) if f is not None]


def _in_its_place(models: Models, head: Fitted, name: str, other: Hypothesis) -> dict[str, float] | None:
    """Coordinates at which another effect changes the readings as one of the model does, to first order, with
    the model's other numbers moved as that takes; None where it has no such sensitivity.
    """
    column = _change(models, head, other)
    if column is None:
        return None
    shares = np.linalg.lstsq(head.jacobian, column, rcond=None)[0]
    own = dict(zip((n.name for n in head.numbers), shares.tolist(), strict=True))
    first = models.of[name].numbers[0].name
    at = dict(zip((n.name for n in head.numbers), head.x.tolist(), strict=True))
    if abs(own[first]) < 1e-9:
        return None
    times = at[first] / own[first]
    start = other.starts[0]
    shapes = {n.name: n.at(start[n.name]) for n in other.numbers[1:]}
    size = times * (SMALL if other.numbers[0].bounds[1] >= SMALL else -SMALL)
    return {k: v - times * own[k] for k, v in at.items()} | shapes | {other.numbers[0].name: size}
