"""Simpler ways to diagnose, on the same fit of the base model: what the method must beat.

- Refit only: says that something is missing where the refitted base model leaves structure; names nothing.
- Score test: the hypothesis with the largest score statistic at null, if that is significant among so many.
- Residual match: the hypothesis whose change of the simulation, nothing refitted, is most like the residual.
- Classifier: a random forest on features of the residual, trained on cases of other seeds.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from scipy import stats

from calibrate.diagnosis.decision.decide import structured
from calibrate.diagnosis.likelihood.likelihood import Model
from calibrate.diagnosis.likelihood.locate import PHASES, cycles_of, misfit, phases_of
from calibrate.diagnosis.prepare import Prepared

# Step at null, in standard deviations of the prior; share of sound recordings that may be called otherwise.
SMALL, FALSE = 0.05, 0.02
LAGS, BINS = (1, 2, 4, 8), 4


def _change(ready: Prepared, numbers, values: dict[str, float], fixed) -> np.ndarray | None:
    """By how much white residuals change."""
    model = Model((), numbers, fixed)
    x = np.asarray([n.at(values[n.name]) for n in numbers])
    seen = ready.likelihood.simulate(dict(ready.base.values) | model.values(x))
    return None if seen is None else ready.likelihood.rows(seen) - ready.base.rows


def score_test(ready: Prepared) -> dict[str, Any]:
    """Name and significance of the largest score statistic."""
    base = ready.base
    J = np.concatenate([base.jacobian, np.eye(len(base.x))])
    q, _ = np.linalg.qr(J)
    r = np.concatenate([base.rows, base.x])
    best, name = 0.0, ""
    for h in ready.hypotheses:
        first = h.numbers[0]
        small = first.value(SMALL if first.bounds[1] > 0 else -SMALL)
        changed = _change(ready, h.numbers, dict(h.few[0]) | {first.name: small}, h.fixed)
        if changed is not None:
            slope = np.concatenate([changed, np.zeros(len(base.x))])
            across = slope - q @ (q.T @ slope)
            power = float(across @ across)
            z2 = float(across @ r) ** 2 / power if power > 1e-12 else 0.0
            if z2 > best:
                best, name = z2, h.name
    p = float(stats.chi2.sf(best, 1)) * len(ready.hypotheses)
    return {"claims": p < FALSE, "names": name, "statistic": best}


def residual_match(ready: Prepared) -> dict[str, Any]:
    """Name and likeness of the hypothesis most like the residual."""
    r = ready.base.rows
    best, name = 0.0, ""
    for h in ready.hypotheses:
        for start in h.few:
            changed = _change(ready, h.numbers, dict(start), h.fixed)
            if changed is None:
                continue
            size = float(np.linalg.norm(changed) * np.linalg.norm(r))
            alike = -float(changed @ r) / size if size > 0 else 0.0
            if alike > best:
                best, name = alike, h.name
    return {"names": name, "alike": best}


def features(ready: Prepared) -> list[float]:
    """Of the residuals of the base fit: by phase and tension, cycle and lag, of T_tip and of the pose."""
    found: list[float] = []
    likelihood, base = ready.likelihood, ready.base
    part = likelihood.rigs[0].part
    white = likelihood.by_channel(base.rows)[0]
    T, phases, cycle = part.T_base.T_base, phases_of(likelihood, base, 0), cycles_of(part.T_base.T_base)
    edges = np.linspace(T.min(), T.max() + 1e-9, BINS + 1)
    rows = [white[k] if k < len(white) else np.zeros(white.shape[1]) for k in range(5)]
    z = rows[0]
    for phase in PHASES:
        for low, high in itertools.pairwise(edges):
            inside = (phases == phase) & (T >= low) & (T < high)
            n = max(int(inside.sum()), 1)
            found.append(float(np.sum(z[inside]) / np.sqrt(n)))
    way = np.linspace(-1, 1, len(z))
    found += [
        float(np.mean(z * way)),
        float(np.mean(z[cycle == cycle[0]])),
        float(np.mean(z[cycle == cycle[-1]])),
    ]
    found += [float(np.mean(z[lag:] * z[:-lag])) for lag in LAGS]
    rate = np.gradient(T, part.time if part.time is not None else np.arange(len(T)))
    found += [float(np.mean(z * np.sign(rate))), float(np.mean(z * np.abs(rate)) / max(np.std(rate), 1e-9))]
    for row in rows:
        found += [float(np.sqrt(np.mean(row**2))), float(np.mean(row)), float(np.mean(row * T) / T.max())]
    found += [float(base.x[1]) if len(base.x) > 1 else 0.0, float(len(white) > 1)]
    return found


def of(ready: Prepared) -> dict[str, Any]:
    """The answers of all that need no training, and the features of the one that does."""
    left = misfit(ready.likelihood, ready.base)
    return {
        "refit only": {"claims": bool(structured(left))},
        "score test": score_test(ready),
        "residual match": {"claims": bool(structured(left)), **residual_match(ready)},
        "features": features(ready),
    }
