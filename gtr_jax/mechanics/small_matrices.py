"""Linear algebra of a few unknowns, written out.

On the CPU, XLA compiles a loop whole only while nothing in it calls a library. LAPACK's inverse of a 3 x 3
matrix made a history of load steps with physics terms run operation by operation: at 13 nodes 176 us a step
instead of 113 us, at 24 nodes 215 us instead of 178 us.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float


def inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse by Gauss and Jordan's elimination with row pivots; not finite where the matrix is singular."""
    n = matrix.shape[0]
    rows = jnp.arange(n)
    both = jnp.concatenate([matrix, jnp.eye(n)], axis=1)
    for k in range(n):
        column = jnp.where(rows >= k, jnp.abs(both[:, k]), -1.0)
        chosen = rows == jnp.argmax(column)
        pivot = jnp.sum(jnp.where(chosen[:, None], both, 0.0), axis=0)
        both = jnp.where(chosen[:, None], both[None, k], both)
        pivot = pivot / pivot[k]
        both = jnp.where((rows == k)[:, None], pivot[None, :], both - both[:, k, None] * pivot[None, :])
    return both[:, n:]


def times(matrix: Float[Array, "n m"], vector: Float[Array, " m"]) -> Float[Array, " n"]:
    """Matrix times vector."""
    return jnp.sum(matrix * vector[None, :], axis=1)


def product(one: Float[Array, "n m"], other: Float[Array, "m k"]) -> Float[Array, "n k"]:
    """Matrix times matrix."""
    shape = (*one.shape, other.shape[1])
    return jnp.sum(jnp.broadcast_to(one[:, :, None], shape) * jnp.broadcast_to(other, shape), axis=1)
