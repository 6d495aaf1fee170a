"""The numbers of a diagnosis and their errors, from a joint fit of all uncertain numbers.

The search lets the uncertain dimensions of the robot file follow to first order, which is enough to rank
hypotheses. Where dimensions and modulus have nearly the same effect, that is too rough for values and errors,
so the base model and the one chosen are fitted once more with the dimensions as free as every other number.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis
from calibrate.diagnosis.hypotheses.model import Fitted, Model, model_of
from calibrate.diagnosis.likelihood.likelihood import LARGEST_STEP, Likelihood
from calibrate.diagnosis.likelihood.locate import phases_of
from calibrate.inference.answer import by_source
from calibrate.inference.estimate import NORMAL_95, shares_of_variance
from calibrate.inference.instruments import leading, of_one, tendon_of_channel
from calibrate.inference.parallel import in_parallel
from calibrate.inference.setup import STRETCH
from gtr_jax.recordings.signals.noise import correlation_time
from gtr_jax.simulation.phases import PULLING

from .models import Models

# Iterations of the fit, and step of the central differences at its end, in standard deviations of the priors.
MOST, HALF_STEP = 8, 1e-3
# Ratio of its cost to that of the search's fit from which the joint fit has gone astray.
WORSE = 1.5
LAW, MESH = "the law's inexactness", "mesh"


@dataclasses.dataclass(frozen=True, eq=False)
class Marginal:
    """A model with all uncertain numbers fitted jointly.

    Attributes:
        likelihood: the recordings, with the uncertain dimensions among the numbers that are fitted.
        fitted: the fit; its numbers are mu, E, the dimensions and those of the effects.
        covariance: of its coordinates, (p, p).
        made_of: share of the variance of each coordinate by source, p of them.
    """

    likelihood: Likelihood
    fitted: Fitted
    covariance: np.ndarray
    made_of: tuple[Mapping[str, float], ...]

    def sd(self, i: int) -> float:
        """Standard deviation of number i, SI."""
        n = self.fitted.numbers[i]
        size = abs(n.value(self.fitted.x[i])) if n.log else 1.0
        return float(size * n.sd * np.sqrt(self.covariance[i, i]))

    def interval(self, i: int) -> tuple[float, float]:
        """Ends of the 95 % interval of number i, SI."""
        n, x, off = self.fitted.numbers[i], self.fitted.x[i], NORMAL_95 * np.sqrt(self.covariance[i, i])
        return n.value(x - off), n.value(x + off)

    def information(self) -> np.ndarray:
        """What is known of the numbers, those of recordings and priors together: the inverse of their
        covariance, per product of their SI units, (p, p).
        """
        fitted = self.fitted
        unit = np.asarray(
            [
                n.sd * (abs(n.value(x)) if n.log else 1.0)
                for n, x in zip(fitted.numbers, fitted.x, strict=True)
            ]
        )
        return np.linalg.inv(self.covariance) / np.outer(unit, unit)

    def draws(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Draws of the coordinates, (count, p)."""
        root = np.linalg.cholesky(self.covariance + 1e-12 * np.eye(len(self.fitted.x)))
        return self.fitted.x + rng.standard_normal((count, len(root))) @ root.T


def jointly(models: Models, fitted: Fitted, finer: float) -> Marginal:
    """Fit a model with the dimensions free as well, from where the search left it.

    The covariance is A^-1 with A = J'J + 1, derivatives by central differences, rows weighed by errors with
    the size and correlation time of the residual. Two terms are added: laws that are not exact, and the
    remaining error of the mesh, move the estimates by A^-1 J'd, where d is the change of the readings by one
    standard deviation of either.

    Args:
        models: of all samples, corrected to a fine mesh.
        fitted: the model.
        finer: number of intervals of that mesh over that of the likelihood's.

    Returns:
        The fit; as the search left it where no better one is found.
    """
    hypotheses = models.hypotheses(fitted.names)
    likelihood = _freed(models.likelihood, fitted)
    model = model_of(likelihood.base, hypotheses)
    own = {n.name: x for n, x in zip(fitted.numbers, fitted.x, strict=True)}
    own |= {
        d.name: (fitted.dimensions.get(d.name, d.centre) - d.centre) / d.sd
        for d in models.likelihood.dimensions
    }
    start = np.asarray([own[n.name] for n in model.numbers])
    left = _as_left(models.likelihood, model, fitted, start)
    found = _polished(likelihood, model, hypotheses, start)
    if found is None or found.cost > WORSE * left.cost:
        # Dimensions that followed to first order may have gone too far.
        centred = np.asarray(
            [0.0 if n in models.likelihood.dimensions else own[n.name] for n in model.numbers]
        )
        again = _polished(likelihood, model, hypotheses, centred)
        found = min((f for f in (found, again) if f is not None), key=lambda f: f.cost, default=left)
    if found.cost > WORSE * left.cost:
        found = left
    weight = _as_they_show(likelihood, found)[:, None]
    jacobian = weight * found.jacobian
    inverse = np.linalg.inv(jacobian.T @ jacobian + np.eye(len(found.x)))
    gain = inverse @ (weight * jacobian).T
    priors = dict(zip((n.name for n in found.numbers), np.eye(len(found.x)), strict=True))
    labels, shares = shares_of_variance(by_source(jacobian, [rig.part for rig in likelihood.rigs]), priors)
    variances = [share * np.diag(inverse) for share in shares]
    covariance = inverse
    for label, rows in (
        (LAW, _law(models, likelihood, found, fitted)),
        (MESH, _mesh(likelihood, found, finer)),
    ):
        moved = gain @ rows
        covariance = covariance + moved @ moved.T
        labels, variances = [*labels, label], [*variances, np.sum(moved**2, axis=1)]
    total = np.diag(covariance)
    made_of = tuple(
        {label: float(v[i] / total[i]) for label, v in zip(labels, variances, strict=True) if v[i] > 0}
        for i in range(len(total))
    )
    return Marginal(likelihood, found, covariance, made_of)


def _freed(likelihood: Likelihood, fitted: Fitted) -> Likelihood:
    """The same recordings with the uncertain dimensions among the base numbers, and with an uncertain stretch
    of the tendon in the displacement, unless stretch is among the effects.
    """
    other = likelihood.with_dimensions_free()
    if any(name.startswith(STRETCH) for name in fitted.names):
        return other
    weighs = [
        dataclasses.replace(weigh, stretch=rig.part.stretch(seen.values[: seen.tips]))
        for weigh, rig, seen in zip(likelihood.weighs, likelihood.rigs, fitted.seen, strict=True)
    ]
    return dataclasses.replace(other, weighs=weighs)


def _polished(
    likelihood: Likelihood, model: Model, hypotheses: Sequence[Hypothesis], start: np.ndarray
) -> Fitted | None:
    """The model refitted, with derivatives recomputed by central differences and one last step with these."""
    here = likelihood.at(model, start)
    if here is None:
        return None
    found = likelihood.refit(
        hypotheses, start, jacobian=_slopes(likelihood, model, start, here.rows), most=MOST, exact=False
    )
    if found is None:
        return None
    jacobian = _slopes(likelihood, model, found.x, found.rows, central=True)
    found = dataclasses.replace(found, jacobian=jacobian)
    low, high = (np.asarray([n.bounds[k] for n in model.numbers]) for k in (0, 1))
    step = -np.linalg.solve(found.information(), jacobian.T @ found.rows + found.x)
    x = np.clip(found.x + np.clip(step, -LARGEST_STEP, LARGEST_STEP), low, high)
    there = likelihood.at(model, x)
    if there is None:
        return found
    squares, prior = float(np.sum(there.rows**2)), float(np.sum(x**2))
    better = dataclasses.replace(
        found,
        x=x,
        values=there.values,
        rows=there.rows,
        chi2=squares,
        prior=prior,
        seen=there.seen,
        failed=there.failed,
    )
    return better if better.cost < found.cost else found


def _slopes(
    likelihood: Likelihood, model: Model, x: np.ndarray, rows: np.ndarray, *, central: bool = False
) -> np.ndarray:
    """Derivatives of the rows by the coordinates, (n, p): by differences, on both cores."""

    def column(i: int) -> np.ndarray:
        low, high = model.numbers[i].bounds
        ends = []
        for step in (HALF_STEP, -HALF_STEP):
            moved = np.array(x)
            moved[i] = np.clip(x[i] + step, low, high)
            there = None if moved[i] == x[i] else likelihood.at(model, moved)
            if there is not None:
                ends.append((moved[i], there.rows))
                if not central:
                    break
        if not ends:
            return np.zeros_like(rows)
        if len(ends) == 1:
            return (ends[0][1] - rows) / (ends[0][0] - x[i])
        return (ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0])

    return np.stack(in_parallel(column, list(range(len(x)))), axis=1)


def _as_left(likelihood: Likelihood, model: Model, fitted: Fitted, x: np.ndarray) -> Fitted:
    """The search's fit in the coordinates of the model with free dimensions, to first order."""
    rows, jacobian = fitted.rows, fitted.jacobian
    columns = {n.name: jacobian[:, i] for i, n in enumerate(fitted.numbers)}
    if likelihood.follow is not None:
        change = likelihood.follow.change
        for k, d in enumerate(likelihood.dimensions):
            columns[d.name] = likelihood.white([c[..., k] for c in change])
    return dataclasses.replace(
        fitted,
        numbers=model.numbers,
        x=x,
        values=model.values(x),
        rows=rows,
        jacobian=np.stack([columns[n.name] for n in model.numbers], axis=1),
        prior=float(np.sum(x**2)),
    )


def _as_they_show(likelihood: Likelihood, fitted: Fitted) -> np.ndarray:
    """Weights of the whitened rows, (n,), that give errors the size and correlation time of each channel's
    residual, as in `gtr fit`. The noise alone comes from neighbouring samples and misses a slow misfit.
    """
    found = []
    for z, rig in zip(likelihood.by_channel(fitted.rows), likelihood.rigs, strict=True):
        free = 1 - len(fitted.x) / max(likelihood.readings, len(fitted.x) + 1)
        tau = [correlation_time(row) for row in z]
        for row, long in zip(z, tau, strict=True):
            large = max(1.0, float(np.mean(row**2)) / free)
            found.append(np.full(len(row), 1 / np.sqrt(large * long)))
        part = rig.part
        of = [tendon_of_channel(part, name) for name in part.channels]
        for i in range(len(part.drives)):
            # That of the tendon's cell at the tip, which comes first; without one of what moves with it.
            own = tau[i] if part.tips else max([t for t, k in zip(tau, of, strict=True) if k == i] or tau)
            found.append(np.full(z.shape[1], 1 / np.sqrt(own)))
    return np.concatenate(found)


def _law(models: Models, likelihood: Likelihood, found: Fitted, fitted: Fitted) -> np.ndarray:
    """Whitened rows of possible errors of the effects' laws, (n, ways): the effect while pulling and
    otherwise, at low and at high tension, each times the relative error that the evidence leaves
    (`models.INEXACT`).
    """
    nothing = np.zeros((len(found.rows), 0))
    if not found.names:
        return nothing
    without = {n.name: found.values[n.name] for n in likelihood.base}
    plain = likelihood.simulate(without, found.names)
    if plain is None:
        return nothing
    share = models.inexactness(fitted)
    masks = []
    for k, rig in enumerate(likelihood.rigs):
        lead = leading(rig.part)
        T, pulling = rig.part.drives[lead].T_base, of_one(phases_of(likelihood, found, k), lead) == PULLING
        low = T < 0.5 * (float(T.max()) + float(T.min()))
        masks.append([pulling & low, pulling & ~low, ~pulling & low, ~pulling & ~low])
    effect = [
        (s.values - p.values)[rig.where] for rig, s, p in zip(likelihood.rigs, found.seen, plain, strict=True)
    ]
    ways = range(len(masks[0]))
    return share * np.stack(
        [likelihood.white([e * m[w] for e, m in zip(effect, masks, strict=True)]) for w in ways], axis=1
    )


def _mesh(likelihood: Likelihood, found: Fitted, finer: float) -> np.ndarray:
    """Whitened rows of the error left on the fine mesh, (n, 1), extrapolated from its correction: errors fall
    with the square of the interval.
    """
    left = 1 / (finer**2 - 1) if finer > 1 else 1.0
    corrected = likelihood.correction(found.names)
    rows = likelihood.white([c[rig.where] for rig, c in zip(likelihood.rigs, corrected, strict=True)])
    return left * rows[:, None]
