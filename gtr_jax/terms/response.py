"""What a load cell shows after each change of the tension: a response that its lag alone decides.

A cell is linear and the same at all times here: with g(l) for what it shows beyond the true tension at the
time l after a step of one newton, it shows T(t) + integral of g(t - t') dT(t'). Between two samples the
tension changes evenly, as `low-pass` has it.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Gauss's three points and weights on [0, 1], for the mean of a response over the time between two samples.
POINTS = (0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5)
WEIGHTS = (5 / 18, 8 / 18, 5 / 18)


def _shares(respond: Callable, time: Float[Array, " K"], k) -> Float[Array, " changes"]:
    """What the cell shows at sample k of each change of the tension, (K - 1,); nothing of later ones."""
    earlier = jnp.arange(1, time.shape[0]) <= k
    start, end = (jnp.where(earlier, time[k] - at, 0.0) for at in (time[:-1], time[1:]))
    mean = sum(w * respond(end + x * (start - end)) for x, w in zip(POINTS, WEIGHTS, strict=True))
    return jnp.where(earlier, mean, 0.0)


def shown_with(
    respond: Callable, T: Float[Array, "K *tendons"], time: Float[Array, " K"]
) -> Float[Array, "K *tendons"]:
    """What a cell shows [N]; it starts settled.

    Args:
        respond: g of lags [s], of any shape.
        T: true tension [N]. time: of the samples [s].
    """
    change = jnp.diff(T, axis=0)
    added = jax.lax.map(lambda k: jnp.tensordot(_shares(respond, time, k), change, 1), jnp.arange(len(time)))
    return T + added


def true_behind(
    respond: Callable, shown: Float[Array, "K *tendons"], time: Float[Array, " K"]
) -> Float[Array, "K *tendons"]:
    """The true tension [N] behind what a cell shows, sample by sample; arguments as of `shown_with`."""

    def step(carry, k):
        before, change = carry
        share = _shares(respond, time, k)
        own = share[k - 1]
        # Of the change up to this sample the cell shows 1 + own; the response to earlier ones is known.
        known = before + jnp.tensordot(jnp.where(jnp.arange(len(share)) == k - 1, 0.0, share), change, 1)
        rises = 1.0 + own
        new = (shown[k] - known) / jnp.where(rises > 0, rises, 1.0)
        new = jnp.where(rises > 0, new, shown[k] - known)
        return (before + new, change.at[k - 1].set(new)), before + new

    start = (shown[0], jnp.zeros((len(time) - 1, *shown.shape[1:])))
    return jnp.concatenate([shown[:1], jax.lax.scan(step, start, jnp.arange(1, len(time)))[1]])
