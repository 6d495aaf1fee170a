"""The mesh along the backbone: panels that end where the mechanics has a kink, nodes graded towards each
panel's start.

Everything the simulator integrates along s is integrated base to tip with variable-step Adams-Moulton weights
of order four inside a panel (exact for cubics on the last four nodes, fewer at the panel's start, where the
nodes are graded). A panel starts with a node of its own at the same s as the end of the panel before it, so
that curvature may jump there. The causal (base-to-tip) stencil is what lets one march solve the equilibrium;
`benchmarks/solver_study.py` measures it.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

STENCIL = 4  # nodes of a quadrature weight's stencil, hence order four
# First intervals of a panel, relative to the others; without grading the error of TD-CM I is 11 times larger.
GRADING = (0.06, 0.2, 0.5)


@functools.lru_cache(maxsize=512)
def panel_table(intervals: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of the unit panel, the weights that integrate from each node's predecessor to it, and those that
    differentiate at both.

    Args:
        intervals: number of intervals, at least 1.

    Returns:
        positions (intervals+1,) in [0, 1]; lengths (intervals+1,), the first 0; weights (intervals+1, 4),
        where row i gives the integral over [x_(i-1), x_i] as sum_j weights[i, j] f(x_(i-j)); rates
        (intervals+1, 2, 4), which give the derivative at x_i and x_(i-1) in the same way. The first rows are
        0.
    """
    sizes = np.ones(intervals)
    if intervals > len(GRADING):
        sizes[: len(GRADING)] = GRADING
    x = np.concatenate([[0.0], np.cumsum(sizes)])
    x /= x[-1]
    lengths = np.concatenate([[0.0], np.diff(x)])
    weights, rates = np.zeros((intervals + 1, STENCIL)), np.zeros((intervals + 1, 2, STENCIL))
    for i in range(1, intervals + 1):
        k = min(i + 1, STENCIL)
        local = (x[i - np.arange(k)] - x[i]) / lengths[i]
        moments = -((-1.0) ** np.arange(1, k + 1)) / np.arange(1, k + 1)
        powers = np.vander(local, k, increasing=True).T
        weights[i, :k] = np.linalg.solve(powers, moments) * lengths[i]
        for end, at in enumerate((0.0, -1.0)):
            slopes = np.arange(k) * at ** np.maximum(np.arange(k) - 1, 0)
            rates[i, end, :k] = np.linalg.solve(powers, slopes) / lengths[i]
    for a in (x, lengths, weights, rates):
        a.setflags(write=False)
    return x, lengths, weights, rates


class Interval(NamedTuple):
    """The interval between a node and its predecessor.

    Attributes:
        length: [m], shape (N,); 0 where a panel starts.
        starts: whether the node starts a panel, shape (N,).
        joined: 1.0 where there is a predecessor, 0.0 at the base, shape (N,).
    """

    length: Float[Array, " N"]
    starts: Bool[Array, " N"]
    joined: Float[Array, " N"]


class Mesh(eqx.Module):
    """Nodes along the backbone; the positions follow the panel ends, so they are differentiable in them.

    Attributes:
        s: arc length of the nodes [m], shape (N,); panel ends appear twice.
        weights: Adams-Moulton weights [m], shape (N, 4); see `panel_table`.
        interval: what lies between each node and its predecessor.
        rates: weights that differentiate at each node and at its predecessor [1/m], shape (N, 2, 4); None for
            a robot in the plane, which needs none.
    """

    s: Float[Array, " N"]
    weights: Float[Array, "N 4"]
    interval: Interval
    rates: Float[Array, "N 2 4"] | None = None


def build_mesh(
    panel_ends: Float[Array, " ends"], intervals: tuple[int, ...], with_rates: bool = False
) -> Mesh:
    """Lay the nodes of all panels.

    Args:
        panel_ends: increasing arc lengths [m] from 0 to L; equal neighbours make a panel of no length, which
            is harmless.
        intervals: number of intervals of each panel (static).
        with_rates: whether the robot needs `rates`.

    Returns:
        The mesh with N = sum(intervals) + number of panels nodes.
    """
    s, length, weights, rates = [], [], [], []
    for p, count in enumerate(intervals):
        x, h, w, d = panel_table(count)
        start, extent = panel_ends[p], panel_ends[p + 1] - panel_ends[p]
        s.append(start + extent * x)
        length.append(extent * h)
        weights.append(extent * w)
        rates.append(jnp.where(extent > 0, 1.0 / jnp.where(extent > 0, extent, 1.0), 0.0) * d)
    starts = np.diff(panel_index(intervals), prepend=-1) > 0
    joined = np.ones(len(starts))
    joined[0] = 0.0
    interval = Interval(jnp.concatenate(length), jnp.asarray(starts), jnp.asarray(joined))
    return Mesh(
        s=jnp.concatenate(s),
        weights=jnp.concatenate(weights),
        interval=interval,
        rates=jnp.concatenate(rates) if with_rates else None,
    )


def panel_index(intervals: tuple[int, ...]) -> np.ndarray:
    """Index of each node's panel, shape (N,)."""
    return np.repeat(np.arange(len(intervals)), np.asarray(intervals, int) + 1)


def shifted(
    values: Float[Array, "*tendons N"], by: int = 1, fill: float | Array = 0.0
) -> Float[Array, "*tendons N"]:
    """`values` moved `by` nodes towards the tip: entry i is values[i - by]; the first `by` entries are
    `fill`.
    """
    first = jnp.broadcast_to(jnp.asarray(fill, values.dtype), (*values.shape[:-1], by))
    return jnp.concatenate([first, values[..., :-by]], axis=-1)


def following(values: Float[Array, " N"]) -> Float[Array, " N"]:
    """`values` moved one node towards the base: entry i is values[i + 1]; the last is zero."""
    return shifted(values[::-1])[::-1]


def derivatives(
    rates: Float[Array, "N 2 4"], values: Float[Array, " N"]
) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """Derivative of `values` at each node and, over the same interval, at its predecessor, (N,) each."""
    behind = [values, *(shifted(values, j) for j in range(1, STENCIL))]
    now, before = (jnp.sum(rates[:, end] * jnp.stack(behind, axis=1), axis=1) for end in (0, 1))
    return now, before


def along_nodes(take, weights, values: Float[Array, "N *strain"]):
    """`increments` or `derivatives` of values that may have a last axis of components."""
    return take(weights, values) if values.ndim == 1 else jax.vmap(take, (None, 1), 1)(weights, values)


def increments(weights: Float[Array, "N 4"], values: Float[Array, " N"]) -> Float[Array, " N"]:
    """Integral of `values` over the interval that ends at each node, shape (N,)."""
    total = weights[:, 0] * values
    for j in range(1, STENCIL):
        total = total + weights[:, j] * shifted(values, j)
    return total


def trapezoids(lengths: Float[Array, " N"], values: Float[Array, " N"]) -> Float[Array, " N"]:
    """The same by the trapezoidal rule."""
    return 0.5 * lengths * (values + shifted(values))


def cumulative(weights: Float[Array, "N 4"], values: Float[Array, " N"]) -> Float[Array, " N"]:
    """Integral of `values` from the base to each node, shape (N,)."""
    return jnp.cumsum(increments(weights, values))
