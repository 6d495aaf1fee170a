"""All models that were refitted, and how probable they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis, may_join
from calibrate.diagnosis.hypotheses.model import Fitted, model_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.parallel import in_parallel

# Prior probability of no, one, two and three missing effects, and of four where three are not enough.
HOW_MANY = (0.5, 0.35, 0.12, 0.03, 0.006)
# No law is exact: relative errors of an effect's law, with their probabilities, in this many independent
# directions. The error of a law must not let a rival win or name a second effect; nor must a law that leaves
# much be accepted where another leaves nothing.
INEXACT, WAYS = {0.0: 0.55, 0.03: 0.2, 0.07: 0.15, 0.15: 0.07, 0.3: 0.03}, 4
# Largest factor by which the noise variance may be underestimated; and factor on log probabilities, because
# the model of the noise is not exact. Both were chosen on some 350 blind development recordings, by the mean
# log probability given to the truth; a smaller scale or a larger factor misjudged more of the sound
# recordings.
LARGEST_SCALE, BELIEVED = 1.3, 0.8
# Models whose log posterior is this far below the best are not refitted once the noise is known better; but
# at least this many single effects are.
HOPELESS, HEADS = 40.0, 5


class Models:
    """All models refitted so far, and how probable they are.

    Args:
        likelihood: the recordings.
        hypotheses: the catalogue.
    """

    def __init__(self, likelihood: Likelihood, hypotheses: Sequence[Hypothesis]):
        self.likelihood = likelihood
        self.of = {h.name: h for h in hypotheses}
        self.fits: dict[tuple[str, ...], Fitted] = {}
        # Computed from all fits, when first asked for.
        self._scale: float | None = None
        self._excess: float | None = None

    def add(self, fits: Sequence[Fitted]) -> None:
        """Add fits; of two fits of one model, the better is kept."""
        self._scale = self._excess = None
        for f in fits:
            key = tuple(sorted(f.names))
            if key not in self.fits or f.cost < self.fits[key].cost:
                self.fits[key] = f

    def mend(self) -> None:
        """Refit each model that ended worse than one with fewer of its effects from where that one ended,
        with the other effects at null: it cannot be worse there.
        """

        def again(f: Fitted) -> Fitted | None:
            smaller = [g for g in self.fits.values() if set(g.names) < set(f.names) and g.cost < f.cost]
            if not smaller:
                return None
            parent = min(smaller, key=lambda g: g.cost)
            known = {n.name: v for n, v in zip(parent.numbers, parent.x, strict=True)}
            start = np.asarray([known.get(n.name, 0.0) for n in f.numbers])
            return self.likelihood.refit(self.hypotheses(f.names), start)

        self.add([f for f in in_parallel(again, list(self.fits.values())) if f is not None])

    def stored(self, fitted: Fitted) -> Fitted:
        """The fit that is kept of a fit's model."""
        return self.fits[tuple(sorted(fitted.names))]

    @property
    def base(self) -> Fitted:
        """The fit without any hypothesis."""
        return self.fits[()]

    @property
    def scale(self) -> float:
        """Variance of white residuals by which models are compared: that of the best fit, within limits."""
        if self._scale is None:
            least = min(self.likelihood.mean_square(f) for f in self.fits.values())
            self._scale = float(np.clip(least, 1.0, LARGEST_SCALE))
        return self._scale

    def log_likelihood(self, fitted: Fitted) -> float:
        """Log likelihood of the data at the fit, up to a constant: for white noise, and errors of the
        effects' laws in `WAYS` directions.
        """
        each = self._by_share(fitted)
        return float(np.logaddexp.reduce(each)) - 0.5 * (fitted.cost - fitted.prior - fitted.chi2)

    def _by_share(self, fitted: Fitted) -> np.ndarray:
        """Log of the joint probability of the data and each relative error of the laws (`INEXACT`)."""
        squares = fitted.chi2 / self.scale
        explained = max(self.base.chi2 - fitted.chi2, 0.0) / self.scale
        beyond = max(squares - self.likelihood.readings, 0.0) + WAYS
        each = []
        for share, weight in INEXACT.items():
            more = share**2 * explained / WAYS
            fits = squares - beyond * more / (1 + more)
            each.append(np.log(weight) - 0.5 * WAYS * np.log1p(more) - 0.5 * fits)
        return np.asarray(each)

    def inexactness(self, fitted: Fitted) -> float:
        """Root mean square of the relative error of the effects' laws, given the data."""
        each = self._by_share(fitted)
        weights = np.exp(each - np.logaddexp.reduce(each))
        return float(np.sqrt(np.sum(weights * np.square(list(INEXACT)))))

    def log_posterior(self, fitted: Fitted) -> float:
        """Log of the posterior probability, up to a constant.

        The allowance for inexact laws must not turn noise into an effect: against the base model, the best
        effect counts no more than it would if laws were exact and its whole residual were noise.
        """
        if self._excess is None:
            effects = [f for f in self.fits.values() if f.names]
            best = max(effects, key=self._believed, default=None)
            more = 0.0 if best is None else self._believed(best) - self._believed(self.base)
            self._excess = 0.0 if best is None else max(0.0, more - BELIEVED * self._plain_odds(best))
        return self._believed(fitted) - (self._excess if fitted.names else 0.0)

    def _believed(self, fitted: Fitted) -> float:
        return BELIEVED * (self.log_likelihood(fitted) + fitted.volume() + self.log_prior(fitted))

    def _plain_odds(self, fitted: Fitted) -> float:
        """Log odds against the base model if laws were exact and the residual of the best fit were noise."""
        scale = max(1.0, min(self.likelihood.mean_square(f) for f in self.fits.values()))
        gain = 0.5 * (self.base.cost - self.base.prior - fitted.cost + fitted.prior) / scale
        return (
            gain + fitted.volume() - self.base.volume() + self.log_prior(fitted) - self.log_prior(self.base)
        )

    def log_prior(self, fitted: Fitted) -> float:
        """Log of the prior probability of a model's effects."""
        n, k = len(self.of), len(fitted.names)
        ways = float(np.prod([(n - i) / (i + 1) for i in range(k)]))
        return float(np.log(HOW_MANY[k] / ways))

    def ranked(self) -> list[Fitted]:
        """The models, the most probable first."""
        return sorted(self.fits.values(), key=lambda f: (-self.log_posterior(f), f.names))

    def probabilities(self) -> dict[tuple[str, ...], float]:
        """Probability of each model among those refitted, the most probable first. In a long recording even
        the best fit leaves more than noise, slowly changing: there it counts as an error of unknown cause.
        """
        ranked = self.ranked()
        if self.likelihood.heavy is not None:
            return self.probabilities_given_discrepancy(min(ranked, key=lambda f: f.cost))
        logs = np.asarray([self.log_posterior(f) for f in ranked])
        share = np.exp(logs - logs.max())
        return {f.names: float(p) for f, p in zip(ranked, share / share.sum(), strict=True)}

    def probabilities_given_discrepancy(self, fitted: Fitted) -> dict[tuple[str, ...], float]:
        """Probability of each model beside an error of unknown cause as large as what a fit leaves; the most
        probable first. Evidence against the noise alone would call one of two models certain though both
        leave many times the noise.
        """
        scale = self.likelihood.scale_left(fitted)
        logs = {
            f.names: BELIEVED * (-0.5 * (f.cost - f.prior) / scale + f.volume(scale) + self.log_prior(f))
            for f in self.fits.values()
        }
        most = max(logs.values())
        total = sum(float(np.exp(v - most)) for v in logs.values())
        ranked = sorted(logs.items(), key=lambda item: (-item[1], item[0]))
        return {names: float(np.exp(v - most)) / total for names, v in ranked}

    def hypotheses(self, names: Sequence[str]) -> list[Hypothesis]:
        """The hypotheses of a model."""
        return [self.of[name] for name in names]

    def addable(self, fitted: Fitted) -> list[Hypothesis]:
        """The hypotheses that may act beside those of a model: no events."""
        taken = {n.name for n in fitted.numbers}
        acting = self.hypotheses(fitted.names)
        return [h for h in self.of.values() if h.kind not in EVENTS and may_join(h, acting, taken)]

    def coordinates(self, names: Sequence[str], fitted: Fitted) -> np.ndarray:
        """Coordinates of a model, taken from the fit of a model with the same effects and more."""
        known = {n.name: v for n, v in zip(fitted.numbers, fitted.x, strict=True)}
        numbers = model_of(self.likelihood.base, self.hypotheses(names)).numbers
        return np.asarray([known[n.name] for n in numbers])

    def reweigh(self) -> None:
        """Estimate the noise again from the best model, and refit the models that matter."""
        ranked = self.ranked()
        top = ranked[0]
        self.likelihood = self.likelihood.weighed(top.values, top.seen)
        kept = [
            f for f in ranked if not f.names or self.log_posterior(f) > self.log_posterior(top) - HOPELESS
        ]
        kept += [f for f in ranked if len(f.names) == 1 and f not in kept][: max(0, HEADS + 1 - len(kept))]

        def again(f):
            return self.likelihood.refit(self.hypotheses(f.names), f.x, most=5)

        self.fits = {}
        self.add([f for f in in_parallel(again, kept) if f is not None])
