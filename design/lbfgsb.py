"""jaxopt's L-BFGS-B behind one function: jaxopt is no longer maintained; what replaces it goes here."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

LARGE = 1e12  # value where the function is not finite


class Minimum(NamedTuple):
    """Where a minimisation ended: point, value, its projected gradient's largest entry, iterations, and
    whether that gradient met the tolerance.
    """

    z: Float[Array, " c"]
    value: Float[Array, ""]
    error: Float[Array, ""]
    steps: Int[Array, ""]
    settled: Bool[Array, ""]


def minimise(
    fun: Callable[..., Float[Array, ""]],
    z: Float[Array, " c"],
    *args: Any,
    lower: Float[Array, " c"],
    upper: Float[Array, " c"],
    tol: float,
    steps: int,
) -> Minimum:
    """Minimise a function within bounds by L-BFGS-B (Byrd, Lu, Nocedal and Zhu 1995); works under vmap and
    lax.map.

    Args:
        fun: of the point and `args`; where it is not finite it counts as large.
        z: start, (c,).
        args: whatever else the function takes.
        lower, upper: bounds, (c,).
        tol: largest entry of the projected gradient at which it stops.
        steps: most iterations.
    """
    with _permissive():
        from jaxopt import LBFGSB

    def safe(z, *args):
        (value, gradient) = jax.value_and_grad(fun)(z, *args)
        fine = jnp.isfinite(value) & jnp.all(jnp.isfinite(gradient))
        return jnp.where(fine, value, LARGE), jnp.where(fine, gradient, 0.0)

    with _permissive():
        solver = LBFGSB(
            fun=safe,
            value_and_grad=True,
            maxiter=steps,
            tol=tol,
            linesearch="backtracking",
            maxls=20,
            history_size=min(8, max(z.shape[0], 2)),
            implicit_diff=False,
            jit=True,
        )
        found, state = solver.run(jnp.clip(z, lower, upper), (lower, upper), *args)
    return Minimum(found, state.value, state.error, state.iter_num, state.error <= tol)


@contextlib.contextmanager
def _permissive() -> Iterator[None]:
    """Allow jaxopt to mix ranks and dtypes, and ignore its deprecation warning at import."""
    with warnings.catch_warnings(), jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        yield
