"""The posterior sampled by NUTS, for parameters whose likelihood no parabola describes.

Errors are those of the fit (`answer.py`), priors those of the robot file; outside the range searched the
density is zero. The sampler, NumPyro's, is an extra: `pip install 'gtr-jax[posterior]'`.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.linalg import cho_solve_banded

from gtr_jax import InputError, Robot

from .answer import Answer
from .coordinates import Coordinates
from .load_history import LoadHistory
from .posterior_draws import EXTRA, Posterior
from .predictor import Predictor, shown
from .setup import Observation, Setup
from .weighing import Weighing

# Chains, steps of each to settle, and draws of each.
CHAINS, WARM_UP, DRAWS = 4, 150, 250
# Knots of the base tension, at most: the program holds a dense matrix of them, 32 MB for this number.
MOST_KNOTS = 2000
# What the sampler says of each draw, by its names, and those of ArviZ.
SAID = {
    "diverging": "diverging",
    "potential_energy": "lp",
    "accept_prob": "acceptance_rate",
    "num_steps": "n_steps",
}
# Depth of the sampler's tree: at most 2^6 simulations with derivatives for each draw.
DEEPEST = 6


class _Weigher(eqx.Module):
    """`Weighing` for the compiled program: sum of squares of weighed residuals."""

    slope: Float[Array, "C K"]
    last: Int[Array, "C K"]
    weight: Float[Array, "C K"]
    tau: Float[Array, " C"]
    floating: Bool[Array, " C"]
    stretch: Float[Array, "C K"]
    near: Int[Array, "K 4"]
    shares: Float[Array, "K 4"]
    inverse: Float[Array, "M M"]
    sd_base: Float[Array, " K"]
    exact: bool = eqx.field(static=True)

    @staticmethod
    def of(weigh: Weighing) -> _Weigher:
        base, exact = weigh.base, weigh.exact
        inverse = np.zeros((0, 0))
        if not exact:
            if base.size > MOST_KNOTS:
                raise InputError(
                    f"the base tension has {base.size} knots, too many for the posterior; "
                    "take it as exact (--noise-base 0, noise_base_N=0)"
                )
            inverse = cho_solve_banded((weigh.factor, False), np.eye(base.size))
        return _Weigher(
            slope=jnp.asarray(weigh.slope),
            last=jnp.asarray(weigh.last),
            weight=jnp.asarray(weigh.weight),
            tau=jnp.asarray(weigh.tau),
            floating=jnp.asarray(weigh.floating),
            stretch=jnp.broadcast_to(jnp.asarray(weigh.stretch), weigh.weight.shape),
            near=jnp.asarray(base.near),
            shares=jnp.asarray(base.weights),
            inverse=jnp.asarray(inverse),
            sd_base=jnp.broadcast_to(jnp.asarray(weigh.sd_base), weigh.weight.shape[1]),
            exact=exact,
        )

    def __call__(self, rows: Float[Array, "C K"]) -> Float[Array, ""]:
        squared = self.weight**2
        floats = jnp.where(self.floating[:, None], squared, 0.0)
        total = jnp.sum(floats, axis=1, keepdims=True)
        rows = rows - jnp.sum(floats * rows, axis=1, keepdims=True) / jnp.where(total > 0, total, 1.0)
        # As `Weighing.centred`.
        safe = jnp.where(total > 0, total, 1.0)
        own = jnp.where(
            self.floating[:, None],
            self.stretch - jnp.sum(floats * self.stretch, axis=1, keepdims=True) / safe,
            0.0,
        )
        power = jnp.sum(squared * own**2, axis=1, keepdims=True)
        part = (1 - 1 / jnp.sqrt(1 + power)) / jnp.where(power > 0, power, 1.0)
        rows = rows - own * part * jnp.sum(squared * own * rows, axis=1, keepdims=True)
        shift = jnp.zeros(rows.shape[1])
        if not self.exact:
            pulled = -(self.slope * squared * rows)
            near, shares = self.near[self.last], self.shares[self.last]
            knots = jnp.zeros(self.inverse.shape[0]).at[near].add(shares * pulled[..., None])
            shift = jnp.sum(self.shares * (self.inverse @ knots)[self.near], axis=1)
        moved = self.weight * (rows + self.slope * shift[self.last]) / jnp.sqrt(self.tau)[:, None]
        sd = jnp.where(self.exact, 1.0, self.sd_base)
        base = jnp.sum((shift / sd) ** 2) / self.tau[0]
        return jnp.sum(moved**2) + base


class _Target(eqx.Module):
    """One recording in the compiled program."""

    robot: Robot
    at: Coordinates
    history: LoadHistory
    before: Int[Array, " K"]
    after: Int[Array, " K"]
    share: Float[Array, " K"]
    recorded: Float[Array, "C K"]
    weigher: _Weigher
    channels: tuple[str, ...] = eqx.field(static=True)

    @staticmethod
    def of(part: Observation, at: Coordinates, predict: Predictor, weigh: Weighing) -> _Target:
        before, after, share = predict.interpolation
        return _Target(
            robot=part.robot,
            at=at,
            history=predict.history,
            before=before,
            after=after,
            share=share,
            recorded=jnp.asarray(part.recorded),
            weigher=_Weigher.of(weigh),
            channels=part.channels,
        )

    def squares(self, u: Float[Array, " p"]) -> Float[Array, ""]:
        """Sum of squares at u; infinite where a load step does not converge."""
        steps, run = shown(self.at.robot_at(self.robot, u), self.history, self.channels)
        share = self.share[None]
        values = (1 - share) * steps[:, self.before] + share * steps[:, self.after]
        ok = jnp.all(run.solved)
        return jnp.where(ok, self.weigher(jnp.where(ok, values, self.recorded) - self.recorded), jnp.inf)


def potential_of(setup: Setup, answer: Answer) -> Callable[[Float[Array, " p"]], Float[Array, ""]]:
    """Minus the logarithm of the posterior density at coordinates u, (p,), up to a constant.

    Derivatives are taken forward, because the parameters are few.
    """
    targets = [
        _Target.of(part, at, predict, judged.weigh)
        for part, at, predict, judged in zip(
            setup.parts, answer.at, answer.problem.predictors, answer.judged, strict=True
        )
    ]
    centre, precision, reach = (
        jnp.asarray(a) for a in (answer.problem.centre, answer.problem.precision, answer.problem.reach)
    )

    def half_squares(u):
        total = jnp.sum(((u - centre) * precision) ** 2) + sum(target.squares(u) for target in targets)
        inside = jnp.all(jnp.abs(u) < reach)
        return jnp.where(inside & jnp.isfinite(total), 0.5 * total, jnp.inf)

    @jax.custom_vjp
    def potential(u):
        return half_squares(u)

    def forward(u):
        value, pushed = jax.vmap(lambda v: jax.jvp(half_squares, (u,), (v,)))(jnp.eye(u.shape[0]))
        return value[0], jnp.where(jnp.isfinite(pushed), pushed, 0.0)

    def backward(slopes, g):
        return (g * slopes,)

    potential.defvjp(forward, backward)
    return potential


def require_sampler() -> None:
    """Refuse if the sampler is not installed.

    Raises:
        InputError: it is not.
    """
    try:
        import numpyro  # noqa: F401
    except ImportError:
        raise InputError(f"the posterior needs NumPyro, which is not installed; {EXTRA}") from None


def sample(
    setup: Setup, answer: Answer, *, chains: int = CHAINS, draws: int = DRAWS, seed: int = 0
) -> Posterior | None:
    """Sample the posterior by NUTS from where the fit ended, in coordinates in which the fit's covariance is
    the identity.

    Returns:
        The draws of the numbers asked for; None if the recordings do not determine every one of them.
    """
    from numpyro.diagnostics import summary
    from numpyro.infer import MCMC, NUTS

    if not answer.known(setup).known[: len(setup.asked)].all():
        return None
    best, root = jnp.asarray(answer.descent.u), jnp.asarray(np.linalg.cholesky(answer.spread(setup)))
    potential = potential_of(setup, answer)
    kernel = NUTS(
        potential_fn=lambda y: potential(best + root @ y),
        adapt_mass_matrix=False,
        max_tree_depth=DEEPEST,
        target_accept_prob=0.8,
    )
    mcmc = MCMC(
        kernel,
        num_warmup=WARM_UP,
        num_samples=draws,
        num_chains=chains,
        chain_method="vectorized",
        progress_bar=False,
    )
    rng = np.random.default_rng(seed)
    start = jnp.asarray(0.5 * rng.normal(size=(chains, len(best))))
    # NumPyro relies on JAX's standard promotion rules, whatever the process has set.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        mcmc.run(jax.random.key(seed), init_params=start, extra_fields=tuple(SAID))
    y = mcmc.get_samples(group_by_chain=True)
    statistics = summary({"y": np.asarray(y)}, prob=0.95)["y"]
    u = np.asarray(best) + np.asarray(y) @ np.asarray(root).T
    values = np.asarray(jax.vmap(jax.vmap(answer.at[0].values))(jnp.asarray(u)))
    n = len(setup.asked)
    values = values[..., :n]
    flat = values.reshape(-1, values.shape[-1])
    lower, upper = np.quantile(flat, [0.025, 0.975], axis=0)
    fields = mcmc.get_extra_fields(group_by_chain=True)
    said = {name: np.asarray(fields[own]) for own, name in SAID.items()}
    return Posterior(
        names=tuple(f.name for f in setup.asked),
        units=tuple(f.entry.unit for f in setup.asked),
        draws=values,
        lower95=lower,
        upper95=upper,
        sd=flat.std(axis=0, ddof=1),
        effective=np.asarray(statistics["n_eff"])[:n],
        rhat=np.asarray(statistics["r_hat"])[:n],
        statistics=said | {"lp": -said["lp"]},
    )
