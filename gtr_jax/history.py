"""A load history, step by step: base tension in; tip tension, pose and the state of the tendon out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .equilibrium import Equilibrium, Loaded, at_preload, describe, load_step, metric_of, tendon_length
from .march import March
from .mesh import cumulative
from .robot import Robot, sections
from .slip import Kept


class Simulation(eqx.Module):
    """A load history of K steps on N nodes, SI units. What belongs to a tendon has a tendon axis where the
    robot has several.

    Attributes:
        T_base: as given, (K, *tendons).
        T_tip: tension at the anchor, (K, *tendons).
        tip_pose: x, y, angle of the midline's tip, (K, 3).
        displacement: tendon drawn out at the base since the robot settled with slack tendons, (K, *tendons).
        slip_direction: +1 where the tendon at the base slips towards the base in the step, -1 towards the
            tip, 0 at rest, (K, *tendons).
        slip_front: the tendon slips on [0, slip_front] and is locked beyond, (K, *tendons); L when all of it
            slips. Several tendons may make a tendon slip farther out again; this is the first front.
        s: nodes, (N,).
        tension: along the tendons, (K, *tendons, N).
        curvature, angle: along the robot, (K, N).
        mobilisation: of friction, (K, tendons, N), as `Equilibrium.mobilisation`; None for one tendon.
        result: optimistix result per step.
        residual_norm, iterations: per step, (K,).
    """

    T_base: Float[Array, "K *tendons"]
    T_tip: Float[Array, "K *tendons"]
    tip_pose: Float[Array, "K 3"]
    displacement: Float[Array, "K *tendons"]
    slip_direction: Float[Array, "K *tendons"]
    slip_front: Float[Array, "K *tendons"]
    s: Float[Array, " N"]
    tension: Float[Array, "K *tendons N"]
    curvature: Float[Array, "K N"]
    angle: Float[Array, "K N"]
    mobilisation: Float[Array, "K tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, " K"]
    iterations: Int[Array, " K"]

    @property
    def converged(self) -> Bool[Array, " K"]:
        """True for each step that met the tolerance."""
        return self.result == optx.RESULTS.successful

    def of_tendon(self, index: int) -> Simulation:
        """What this run is for one of several tendons: the same, without the tendon axis."""
        own = ("T_base", "T_tip", "displacement", "slip_direction", "slip_front", "tension")
        taken = {name: getattr(self, name)[:, index] for name in own}
        return dataclasses.replace(self, **taken, mobilisation=None)


SLIP_TOLERANCE = 1e-8


def _slipping(done: Loaded, memory: Float[Array, "*tendons N"], scale: Float[Array, ""]):
    """Direction of slip along the tendons, (*tendons, N): told by the change of tension of one tendon, by the
    slip itself of several.
    """
    if done.xi is None:
        change = done.tension - memory
        return jnp.where(jnp.abs(change) > SLIP_TOLERANCE * scale, jnp.sign(change), 0.0)
    slipped = jnp.concatenate([done.xi[..., 1:2], done.xi[..., 1:]], axis=-1)
    return jnp.where(jnp.abs(slipped) > 1.0 + SLIP_TOLERANCE, jnp.sign(slipped), 0.0)


def _front(s, sign):
    """Direction of slip of one tendon at the base and arc length up to which it reaches."""
    locked = sign != sign[0]
    front = jnp.where(jnp.any(locked), s[jnp.maximum(jnp.argmax(locked) - 1, 0)], s[-1])
    return sign[0], jnp.where(sign[0] == 0.0, 0.0, front)


def padded_length(steps: int) -> int:
    """Length a history is padded to, at most a quarter more, so that a few compiled programs serve all."""
    if steps <= 16:
        return 16
    unit = 2 ** ((steps - 1).bit_length() - 3)
    return -(-steps // unit) * unit


@eqx.filter_jit
def _run(robot: Robot, T_base: Float[Array, "K *tendons"], solver: optx.AbstractRootFinder) -> Simulation:
    s = sections(robot)
    settled, kept = at_preload(robot, s, solver)
    scale = jnp.maximum(jnp.max(T_base), jnp.maximum(jnp.max(kept.tension), 1e-6))
    xi = jnp.zeros_like(kept.tension) if robot.tendon_names else None

    def step(carry, T_now):
        kept, start, xi = carry
        done = load_step(robot, s, T_now, kept, start, solver, xi)
        memory = Kept(done.tension, metric_of(s, done.state), done.mobilisation)
        now = (memory, *jax.lax.stop_gradient((done.state, done.xi)))
        carry = jtu.tree_map(lambda new, old: jnp.where(done.converged, new, old), now, carry)
        return carry, (done, kept.tension)

    start = (kept, *jax.lax.stop_gradient((settled, xi)))
    _, (done, memory) = jax.lax.scan(step, start, T_base)
    # What is read off the states is computed for all steps at once, outside the loop.
    eq = jax.vmap(lambda done: describe(s, done))(done)
    sign = jax.vmap(lambda done, before: _slipping(done, before, scale))(done, memory)
    fronts = jax.vmap(lambda sign: _front(s.mesh.s, sign))
    direction, front = (fronts if sign.ndim == 2 else jax.vmap(fronts))(sign)
    return Simulation(
        T_base=T_base,
        T_tip=eq.T_tip,
        tip_pose=eq.tip_pose,
        displacement=tendon_length(s, settled)[None] - eq.tendon_length,
        slip_direction=direction,
        slip_front=front,
        s=s.mesh.s,
        tension=eq.tension,
        curvature=eq.curvature,
        angle=eq.angle,
        mobilisation=eq.mobilisation,
        result=eq.result,
        residual_norm=eq.residual_norm,
        iterations=eq.iterations,
    )


def simulate(
    robot: Robot,
    T_base: ArrayLike | Sequence[float] | Sequence[Sequence[float]],
    *,
    solver: optx.AbstractRootFinder = March(),  # noqa: B008
) -> Simulation:
    """Run a robot through a load history; any sequence of pulls, releases, re-pulls and holds.

    The tendon starts at its preload (slack unless the robot file says otherwise), the robot settled under its
    external loads. Differentiable in every number of the robot and in T_base.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: base tension at each step [N], (K,), K >= 1; with several tendons (K, tendons). Negative
            values count as slack.
        solver: as for `equilibrium`.

    Returns:
        One entry per step. A step that does not converge is flagged in `result` and leaves the tendon's
        memory as it was.

    Raises:
        ValueError: T_base is not a history of at least one step.
    """
    history, names = jnp.asarray(T_base, dtype=float), robot.tendon_names
    if names and history.shape[1:] != (len(names),):
        raise ValueError(
            f"T_base: a history of the tendons {', '.join(names)} has shape (steps, {len(names)}), "
            f"not {history.shape}"
        )
    if history.size == 0 or (not names and history.ndim != 1):
        raise ValueError(f"T_base: a history is one row of at least one tension, not shape {history.shape}")
    steps = history.shape[0]
    fill = jnp.broadcast_to(history[-1], (padded_length(steps) - steps, *history.shape[1:]))
    run = _run(robot, jnp.concatenate([history, fill]), solver)
    return Simulation(
        **{k: v if k == "s" else jtu.tree_map(lambda a: a[:steps], v) for k, v in vars(run).items()}
    )


def equilibrium_at(robot: Robot, run: Simulation, step: int) -> Equilibrium:
    """The equilibrium of one step of a simulation, with all that `Equilibrium` offers.

    Args:
        robot: as simulated.
        run: its simulation.
        step: counted from 0; negative ones from the end.
    """
    step = range(len(run.T_base))[step]
    before = None
    if step:
        mobilisation = None if run.mobilisation is None else run.mobilisation[step - 1]
        before = run.tension[step - 1], run.curvature[step - 1], mobilisation
    return _equilibrium_after(robot, run.T_base[step], before)


@eqx.filter_jit
def _equilibrium_after(robot: Robot, T_base: Float[Array, "*tendons"], before) -> Equilibrium:
    s, solver = sections(robot), March()
    start, kept = at_preload(robot, s, solver)
    if before is not None:
        tension, kappa, mobilisation = before
        start = dataclasses.replace(start, kappa=kappa, phi=cumulative(s.mesh.weights, kappa))
        kept = Kept(tension, metric_of(s, start), mobilisation)
    return describe(s, load_step(robot, s, T_base, kept, start, solver))
