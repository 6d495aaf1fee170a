"""Which numbers of a tree are being differentiated."""

from __future__ import annotations

import jax.tree_util as jtu


def split_tangents(tree, tangents):
    """The leaves of a tree that have a tangent, and those that have none, each with None for the others."""

    def chosen(keep):
        return jtu.tree_map(lambda t, x: x if (t is None) != keep else None, tangents, tree, is_leaf=_is_none)

    return chosen(True), chosen(False)


def _is_none(x) -> bool:
    return x is None
