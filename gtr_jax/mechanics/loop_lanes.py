"""What loops carry, in the lanes of `jax.vmap`."""

from __future__ import annotations

from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

Tree = TypeVar("Tree")


def in_lanes_of(given, start: Tree) -> Tree:
    """The same values to start a loop from, with the lanes of what the loop uses; their derivatives too.

    JAX learns which of the arrays that a loop carries differ between lanes by going through its body until no
    more are found: two or three times in each loop, and loops lie in loops. It learns in the same way which
    have derivatives. Where all do from the start, one time is enough. It adds zeros, which compilers take out
    again.

    Args:
        given: what the loop uses that may differ between lanes, arrays; of these the floats.
        start: what it carries.
    """
    leaves: list[Any] = [
        leaf
        for leaf in jtu.tree_leaves(given)
        if isinstance(leaf, Tracer) and leaf.size and jnp.issubdtype(leaf.dtype, jnp.floating)
    ]
    if not leaves:
        return start
    values, tree = jtu.tree_flatten(jtu.tree_map(jnp.asarray, start))
    smooth = [jnp.issubdtype(value.dtype, jnp.floating) for value in values]
    moved = iter(_with_zero(leaves, [v for v, s in zip(values, smooth, strict=True) if s]))
    zero = _zero(leaves)
    still = [
        v ^ (zero != 0) if v.dtype == np.bool_ else v + zero.astype(v.dtype)
        for v, s in zip(values, smooth, strict=True)
        if not s
    ]
    others = iter(still)
    return jtu.tree_unflatten(tree, [next(moved) if s else next(others) for s in smooth])


def _zero(leaves: list[Array]) -> Float[Array, ""]:
    """Zero, in the lanes of some arrays."""
    any_of = sum(leaf.reshape(-1)[0] if leaf.ndim else leaf for leaf in leaves)
    return jnp.where(any_of > 0, 0.0, 0.0)


@jax.custom_jvp
def _with_zero(leaves: list[Array], values: list[Array]) -> list[Array]:
    zero = _zero(leaves)
    return [value + zero for value in values]


@_with_zero.defjvp
def _with_zero_jvp(primals, tangents):
    # A derivative is linear, so zero is the sum of nothing here.
    zero = sum(jnp.sum(tangent.reshape(-1)[:0]) for tangent in tangents[0])
    return _with_zero(*primals), [tangent + zero for tangent in tangents[1]]
