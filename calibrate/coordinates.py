"""The free parameters as coordinates near zero, and recordings simulated in them with their derivatives.

A positive parameter is value = reference exp(u), any other value = reference + scale u. Which parameters are
free is data, not structure: one compiled program serves every choice of the same number of parameters.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from gtr_jax import InputError, Robot, Simulation, label_phases, reading, simulate, true_base
from gtr_jax.robot.parameters import Parameter, places_of, term_of
from gtr_jax.simulation.history import cycles, padded_length
from gtr_jax.simulation.programs import known_to_act

# What instruments may show, in the order of predictions; names are those of `gtr_jax.Recording`.
CHANNELS = ("T_tip", "tip_x", "tip_y", "tip_angle", "displacement")
CHANNEL_UNITS = ("N", "m", "m", "rad", "m")

# One unit of a parameter that is neither positive nor has a value to be measured by.
UNIT_SCALE = {"N": 1.0, "N m": 0.1, "m": 1e-3, "rad": 0.1, "rad/m": 1.0, "": 0.1}


class Coordinates(eqx.Module):
    """Where the p free parameters lie and how they are scaled.

    Attributes:
        index: places in the flattened robot, (p,); the one after its last for a parameter it does not have.
        reference: values at u = 0, SI, (p,).
        scale: value per unit of u where not logarithmic, SI, (p,).
        log: whether value = reference exp(u), (p,).
        lower, upper: bounds of the others, at which values stop, SI, (p,); infinite where open.
        of_terms: whether any is a number of a physics term that is not of the load cells.
    """

    index: Int[Array, " p"]
    reference: Float[Array, " p"]
    scale: Float[Array, " p"]
    log: Bool[Array, " p"]
    lower: Float[Array, " p"]
    upper: Float[Array, " p"]
    of_terms: bool = eqx.field(static=True)

    def values(self, u: Float[ArrayLike, " p"]) -> Float[Array, " p"]:
        """SI values at the coordinates u."""
        u = jnp.asarray(u)
        growth = jnp.exp(jnp.where(self.log, u, 0.0))
        shifted = self.reference + self.scale * u
        bounded = jnp.where(shifted < self.lower, self.lower, shifted)
        bounded = jnp.where(bounded > self.upper, self.upper, bounded)
        return jnp.where(self.log, self.reference * growth, bounded)

    def robot_at(self, robot: Robot, u: Float[ArrayLike, " p"]) -> Robot:
        """The robot with its free parameters at the coordinates u."""
        flat, unravel = ravel_pytree(robot)
        return unravel(jnp.append(flat, 0.0).at[self.index].set(self.values(u))[:-1])

    def stopped(self, u: np.ndarray) -> np.ndarray:
        """Which values lie at their bounds, (p,) bool (host side)."""
        shifted = np.asarray(self.reference) + np.asarray(self.scale) * u
        outside = (shifted <= np.asarray(self.lower)) | (shifted >= np.asarray(self.upper))
        return ~np.asarray(self.log) & outside

    def at(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Coordinates of SI values (host side)."""
        values, reference = np.asarray(values, float), np.asarray(self.reference)
        log = np.asarray(self.log)
        ratio = np.where(log, values / np.where(log, reference, 1.0), 1.0)
        return np.where(log, np.log(ratio), (values - reference) / np.asarray(self.scale))


def is_log(entry: Parameter, initial: float) -> bool:
    """Whether a parameter is fitted on a logarithmic scale: declared so, or positive by its bounds."""
    return entry.log or (entry.lower == 0.0 and initial > 0.0)


def coordinates(
    robot: Robot,
    chosen: Sequence[Parameter],
    reference: Sequence[float] | np.ndarray,
    has: Sequence[bool] | None = None,
) -> Coordinates:
    """Coordinates of parameters about reference values.

    Args:
        robot: whose parameters they are.
        chosen: the parameters, p of them.
        reference: values, SI, (p,).
        has: which of them are parameters of this robot, (p,); all unless given.

    Raises:
        InputError: a positive parameter whose reference is zero has no logarithm.
    """
    reference = [float(v) for v in reference]
    log = [is_log(p, v) for p, v in zip(chosen, reference, strict=True)]
    for entry, positive, value in zip(chosen, log, reference, strict=True):
        if positive and value <= 0:
            raise InputError(f"{entry.key}: its start value is 0; give a positive one to fit it")
    scale = [abs(v) or UNIT_SCALE.get(p.unit, 1.0) for p, v in zip(chosen, reference, strict=True)]
    own = np.ones(len(chosen), bool) if has is None else np.asarray(has, bool)
    index = np.full(len(chosen), ravel_pytree(robot)[0].shape[0])
    index[own] = np.asarray(places_of(robot, [p.name for p, mine in zip(chosen, own, strict=True) if mine]))
    return Coordinates(
        jnp.asarray(index),
        jnp.asarray(reference, float),
        jnp.asarray(scale, float),
        jnp.asarray(log),
        jnp.asarray([-np.inf if p.lower is None else p.lower for p in chosen]),
        jnp.asarray([np.inf if p.upper is None else p.upper for p in chosen]),
        of_terms=any(term is not None and not term.of_cells for term in map(term_of, chosen)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction:
    """A simulated recording of K samples and its derivatives, in the order of CHANNELS.

    Attributes:
        values: what the instruments would show, SI, (C, K).
        jacobian: their derivatives by u, (C, K, p).
        slope: their change if the base tension were higher by one newton throughout, (C, K): of T_tip, while
            friction holds the tip, that at the sample where it slipped last.
        failed: load steps that did not meet their tolerance.
        run: the simulation, padded, without what lies between base and tip.
        step: the simulation's step at or after each sample, (K,).
    """

    values: np.ndarray
    jacobian: np.ndarray
    slope: np.ndarray
    failed: int
    run: Simulation
    step: np.ndarray

    @property
    def T_tip(self) -> np.ndarray:
        """Tip tension [N], (K,)."""
        return self.values[0]

    @property
    def converged(self) -> bool:
        """Whether every load step met its tolerance."""
        return self.failed == 0

    @property
    def phases(self) -> np.ndarray:
        """Phase of each sample, (K,)."""
        return label_phases(self.run)[self.step]

    @property
    def slips(self) -> np.ndarray:
        """Whether slip reaches the tip at each sample, (K,)."""
        whole = np.asarray(self.run.slip_front) >= float(self.run.s[-1]) * (1 - 1e-12)
        return whole[self.step]


class History(eqx.Module):
    """A load history, held at its end until it has one of the few lengths that are compiled, P.

    Attributes:
        T_base: base tension as its cell shows it [N], (P,).
        time: [s], (P,).
        cycle: pulls and releases done, (P,); see `gtr_jax.simulate`.
        with_terms: whether to simulate with the physics terms (static).
    """

    T_base: Float[Array, " P"]
    time: Float[Array, " P"]
    cycle: Float[Array, " P"]
    with_terms: bool = eqx.field(static=True)


def shown(robot: Robot, history: History) -> tuple[Float[Array, "C P"], Simulation]:
    """What the instruments show of a load history, SI, in the order of CHANNELS, and the simulation."""
    T_base = true_base(robot, history.T_base, history.time)
    run = simulate(robot, T_base, time=history.time, cycle=history.cycle, with_terms=history.with_terms)
    return jnp.stack([reading(robot, run).T_tip, *run.tip_pose.T, run.displacement]), run


def padded_history(
    T_base: np.ndarray, time: np.ndarray | None, trial: np.ndarray | None, *, with_terms: bool
) -> History:
    """A load history of K samples; a second each without their times. Trials count as cycles where there is
    more than one.
    """
    clock = np.arange(len(T_base), dtype=float) if time is None else np.asarray(time, float)
    missing = padded_length(len(T_base)) - len(T_base)
    last = clock[-1] - clock[-2] if len(clock) > 1 else 1.0
    done = np.zeros(0) if trial is None else np.unique(trial, return_inverse=True)[1]
    if not np.any(done):
        done = np.asarray(cycles(jnp.asarray(T_base)))
    return History(
        jnp.asarray(np.concatenate([T_base, np.full(missing, T_base[-1])])),
        jnp.asarray(np.concatenate([clock, clock[-1] + last * np.arange(1, missing + 1)])),
        jnp.asarray(np.concatenate([done, np.full(missing, done[-1])]), float),
        with_terms=with_terms,
    )


def history_of(
    robot: Robot,
    at: Coordinates,
    T_base: np.ndarray,
    time: np.ndarray | None,
    trial: np.ndarray | None = None,
) -> History:
    """A load history of K samples for a robot with free parameters."""
    return padded_history(T_base, time, trial, with_terms=bool(at.of_terms or known_to_act(robot)))


@eqx.filter_jit
def _predict(robot: Robot, at: Coordinates, history: History, u: Float[Array, " p"]):
    T_base = history.T_base

    def at_coordinates(u, T_base):
        values, run = shown(at.robot_at(robot, u), dataclasses.replace(history, T_base=T_base))
        none = jnp.zeros((*T_base.shape, 0))
        return values, eqx.tree_at(
            lambda r: (r.tension, r.slip, r.curvature, r.angle, r.external_moment), run, (none,) * 5
        )

    def along(direction):
        raised = jnp.broadcast_to(direction[-1], T_base.shape)
        return jax.jvp(at_coordinates, (u, T_base), (direction[:-1], raised), has_aux=True)

    return jax.vmap(along, out_axes=(None, -1, None))(jnp.eye(u.shape[0] + 1))


class Predictor:
    """Simulates one load history at any coordinates.

    One compiled program per robot structure, padded length and number of free parameters; forward mode,
    because the parameters are few: the derivatives come with the simulation at little more than its cost.

    Args:
        robot: robot whose other parameters stay.
        at: coordinates of the free ones.
        T_base: base tension as its cell shows it [N], (K,).
        time: of the samples [s], (K,); a second each unless given.
        trial: number of the trial, (K,), or None.
        nodes: samples that are simulated, (J,), increasing from the first to the last; all unless given. What
            lies between two is interpolated along T_base, which must not turn there; in a hold along time.

    Attributes:
        samples, steps: how many there are to predict, K, and to simulate, J.
        history: at the steps, padded.
    """

    def __init__(
        self,
        robot: Robot,
        at: Coordinates,
        T_base: np.ndarray,
        time: np.ndarray | None = None,
        nodes: np.ndarray | None = None,
        trial: np.ndarray | None = None,
    ):
        self.robot, self.at, self.samples = robot, at, len(T_base)
        nodes = np.arange(self.samples) if nodes is None else nodes
        self.steps = len(nodes)
        clock, number = (None if v is None else v[nodes] for v in (time, trial))
        self.history = history_of(robot, at, T_base[nodes], clock, number)
        self._next = np.searchsorted(nodes, np.arange(self.samples))
        self._before = np.maximum(self._next - (nodes[self._next] != np.arange(self.samples)), 0)
        low, high = T_base[nodes[self._before]], T_base[nodes[self._next]]
        rise = np.where(high == low, 1.0, high - low)
        # In a hold only what takes time goes on.
        clock = np.arange(self.samples) if time is None else time
        first, last = clock[nodes[self._before]], clock[nodes[self._next]]
        held = np.where(last > first, (clock - first) / np.where(last > first, last - first, 1.0), 1.0)
        self._share = np.where(high == low, held, (T_base - low) / rise)

    @property
    def interpolation(self) -> tuple[Int[Array, " K"], Int[Array, " K"], Float[Array, " K"]]:
        """Steps before and after each sample, and its share of the way between them."""
        return jnp.asarray(self._before), jnp.asarray(self._next), jnp.asarray(self._share)

    def _at_samples(self, values: np.ndarray) -> np.ndarray:
        """From the nodes, (C, J, ...), to the samples, (C, K, ...)."""
        if self.steps == self.samples:
            return values
        share = self._share.reshape(-1, *[1] * (values.ndim - 2))
        return (1 - share) * values[:, self._before] + share * values[:, self._next]

    def __call__(self, u: np.ndarray) -> Prediction | None:
        """The recording at coordinates u, (p,); None where the simulator breaks down."""
        try:
            values, slopes, run = jax.block_until_ready(
                _predict(self.robot, self.at, self.history, jnp.asarray(u, float))
            )
        except RuntimeError as fault:  # a linear solve given NaN raises, from within the compiled program
            if "non-finite" not in str(fault):
                raise
            return None
        values, slopes = (self._at_samples(np.asarray(v)[:, : self.steps]) for v in (values, slopes))
        if not (np.all(np.isfinite(values)) and np.all(np.isfinite(slopes))):
            return None
        failed = int(np.sum(~np.asarray(run.converged)[: self.steps]))
        return Prediction(values, slopes[..., :-1], slopes[..., -1], failed, run, self._next)


class Predictors:
    """Simulates several load histories, each of its robot, at the same coordinates; counts how often."""

    def __init__(self, parts: Sequence[Predictor]):
        self.parts = tuple(parts)
        self.count = 0

    def __call__(self, u: np.ndarray) -> tuple[Prediction, ...] | None:
        """One prediction each; None where the simulator breaks down."""
        self.count += 1
        found = []
        for part in self.parts:
            prediction = part(u)
            if prediction is None:
                return None
            found.append(prediction)
        return tuple(found)
