"""What a load cell shows after each change of the tension: a response that its lag alone decides.

A cell is linear and the same at all times here: with g(l) for what it shows beyond the true tension at the
time l after a step of one newton, it shows T(t) + integral of g(t - t') dT(t'). Between two samples the
tension changes evenly, as `low-pass` has it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Gauss's three points and weights on [0, 1], for the mean of a response over the time between two samples.
POINTS = (0.5 - 0.15**0.5, 0.5, 0.5 + 0.15**0.5)
WEIGHTS = (5 / 18, 8 / 18, 5 / 18)
# Sampling intervals at which it is asked whether a cell can be read backwards, as shares of the times of its
# response; over how many samples, in three parts of which an error must not be larger in the last than in the
# one before; and what an error of 1 N may come to besides [N].
INTERVALS, STEPS, FELT = (0.02, 0.1, 0.3, 1.0, 3.0), 300, 0.01


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
    # Checkpointed, so that a reverse-mode gradient keeps no square of the samples.
    row = jax.checkpoint(lambda k: jnp.tensordot(_shares(respond, time, k), change, 1))
    return T + jax.lax.map(row, jnp.arange(len(time)))


def is_readable(respond: Callable, times: Sequence[float]) -> bool:
    """Whether the true tension can be read off a cell: at sampling intervals about some times [s] it rises
    with each change, and an error of one reading does not grow in the readings after it.

    Args:
        respond: g of lags [s], of numpy arrays.
        times: that the response has.
    """
    for interval in [share * time for time in times for share in INTERVALS]:
        lags = interval * (np.arange(STEPS)[:, None] + np.asarray(POINTS))
        shares = np.broadcast_to(np.asarray(respond(lags), float), lags.shape) @ np.asarray(WEIGHTS)
        rises = 1.0 + shares[0]
        if not rises > 0:
            return False
        change = np.zeros(STEPS)
        for k in range(STEPS):
            # What one reading that is off by 1 N makes of the changes after it.
            shown = (k == 0) - (k == 1)
            change[k] = (shown - np.dot(np.diff(shares[: k + 1])[::-1], change[:k])) / rises
        _, earlier, later = (np.max(part) for part in np.split(np.abs(np.cumsum(change)), 3))
        if not later < max(earlier, FELT):
            return False
    return True


def true_behind(
    respond: Callable, shown: Float[Array, "K *tendons"], time: Float[Array, " K"]
) -> Float[Array, "K *tendons"]:
    """The true tension [N] behind what a cell shows, sample by sample; arguments as of `shown_with`. NaN from
    where the cell does not rise with the tension.
    """
    if len(time) < 2:
        return shown

    def step(carry, k):
        before, change = carry
        share = _shares(respond, time, k)
        own = share[k - 1]
        # Of the change up to this sample the cell shows 1 + own; the response to earlier ones is known.
        known = before + jnp.tensordot(jnp.where(jnp.arange(len(share)) == k - 1, 0.0, share), change, 1)
        rises = 1.0 + own
        new = jnp.where(rises > 0, (shown[k] - known) / jnp.where(rises > 0, rises, 1.0), jnp.nan)
        return (before + new, change.at[k - 1].set(new)), before + new

    start = (shown[0], jnp.zeros((len(time) - 1, *shown.shape[1:])))
    return jnp.concatenate([shown[:1], jax.lax.scan(step, start, jnp.arange(1, len(time)))[1]])
