"""What a sweep can compute at every point: names, units and what is read off the solved states."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array

from gtr_jax.errors import did_you_mean
from gtr_jax.robot.robot import Robot, lay_out

from ..mechanics.mesh import cumulative
from ..simulation.history import Simulation
from ..simulation.sensing import cells_show
from ..simulation.solution import Equilibrium, drawn_out
from .config import SweepConfig

STEP, NODE = "step", "node"  # names of dimensions in the store


@dataclasses.dataclass(frozen=True)
class Variable:
    """One array of the store.

    Attributes:
        name: in the store.
        unit: SI; "" without.
        says: what it is.
        dims: of one point: some of "step", "node".
        smooth: whether it has gradients.
    """

    name: str
    unit: str
    says: str
    dims: tuple[str, ...] = (STEP,)
    smooth: bool = False


T_TIP = Variable("T_tip", "N", "tension at the tip's anchor, as its load cell shows it", smooth=True)
POSE = (
    Variable("tip_x", "m", "tip of the midline along the base tangent", smooth=True),
    Variable("tip_y", "m", "tip of the midline to the left of the base tangent", smooth=True),
    Variable("tip_angle", "rad", "angle of the midline at the tip, anticlockwise", smooth=True),
)
ALONG = Variable("s", "m", "arc length of the nodes from the base", (NODE,))
OUTPUTS: dict[str, tuple[Variable, ...]] = {
    "T_tip": (T_TIP,),
    "loss": (Variable("loss", "", "share of the base tension that does not reach the tip", smooth=True),),
    "T_base_switch": (
        Variable("T_base_switch", "N", "base tension at which the released tendon slips at the tip", ()),
    ),
    "tip_pose": POSE,
    "displacement": (Variable("displacement", "m", "of the tendon drawn out at the base", smooth=True),),
    "shape": (
        ALONG,
        Variable("x", "m", "midline along the base tangent", (STEP, NODE)),
        Variable("y", "m", "midline to the left of the base tangent", (STEP, NODE)),
        Variable("angle", "rad", "of the midline, anticlockwise", (STEP, NODE)),
    ),
    "tension_profile": (
        ALONG,
        Variable("tension", "N", "along the tendon", (STEP, NODE)),
    ),
    "dissipation": (Variable("dissipation", "J", "work lost to the tendon's friction over the history", ()),),
}
GRADIENTS = "gradients"  # the output that asks for derivatives of the others
PER_TENDON = ("T_tip", "loss", "displacement", "tension", "T_base")  # of each tendon
RESULT = Variable("result", "", "0 converged, 1 not converged, 2 not finite, 3 no such robot", ())
BASE = Variable("T_base", "N", "tension at the tendon's base")


def check_outputs(sweep: SweepConfig) -> None:
    """InputError if an output is unknown or stands twice."""
    known = [*OUTPUTS, GRADIENTS]
    for i, name in enumerate(sweep.outputs):
        if name not in known:
            raise sweep.fault("outputs", f"unknown output '{name}'; {did_you_mean(name, known)}")
        if name in sweep.outputs[:i]:
            raise sweep.fault("outputs", f"'{name}' stands twice; keep one")
    if GRADIENTS in sweep.outputs and not any(v.smooth for v in variables(sweep.outputs, ())):
        raise sweep.fault(
            "outputs", "gradients of what? add T_tip, tip_pose, loss or displacement, which have them"
        )


def variables(outputs: Sequence[str], tendons: Sequence[str]) -> tuple[Variable, ...]:
    """The arrays that some outputs ask for, each once; of several tendons one for each where it has its
    own.
    """
    found = dict.fromkeys(v for name in outputs if name != GRADIENTS for v in OUTPUTS[name])
    return tuple(named for v in found for named in of_tendons(v, tendons))


def of_tendons(variable: Variable, tendons: Sequence[str]) -> tuple[Variable, ...]:
    """An array, or one for each tendon."""
    if not tendons or variable.name not in PER_TENDON:
        return (variable,)
    return tuple(dataclasses.replace(variable, name=f"{variable.name}.{name}") for name in tendons)


def at_rest(robot: Robot, eq: Equilibrium, T_base: Array) -> dict[str, Array]:
    """The outputs of one equilibrium, by name, with a leading axis of one step."""
    time = jnp.zeros(1)
    shown = cells_show(robot, T_base[None], eq.T_tip[None], time)
    pose, preload = eq.tip_pose, robot.per_tendon(lambda tendon: tendon.preload)
    return _named(
        robot,
        {
            "T_base": shown.T_base,
            "T_tip": shown.T_tip,
            "loss": (1.0 - _share(eq.T_tip, T_base))[None],
            "tip_x": pose[None, 0],
            "tip_y": pose[None, 1],
            "tip_angle": pose[None, 2],
            "displacement": drawn_out(robot.terms, eq.slip[..., 0], T_base, preload)[None],
            "s": eq.s,
            "x": eq.x[None],
            "y": eq.y[None],
            "angle": eq.angle[None],
            "tension": eq.tension[None],
        },
    )


def along(robot: Robot, run: Simulation, kept: Sequence[int], shapes: bool) -> dict[str, Array]:
    """The outputs of some steps of a load history, by name.

    Args:
        robot: as simulated.
        run: its simulation.
        kept: which steps.
        shapes: whether the midline is wanted, which a simulation does not hold.
    """
    at = jnp.asarray(kept)
    shown = cells_show(robot, run.T_base, run.T_tip, run.time)
    said = {
        "T_base": shown.T_base[at],
        "T_tip": shown.T_tip[at],
        "loss": 1.0 - _share(run.T_tip, run.T_base)[at],
        "tip_x": run.tip_pose[at, 0],
        "tip_y": run.tip_pose[at, 1],
        "tip_angle": run.tip_pose[at, 2],
        "displacement": run.displacement[at],
        "s": run.s,
        "angle": run.angle[at],
        "tension": run.tension[at],
        "dissipation": dissipation(run),
    }
    if shapes:
        x, y = jax.vmap(lambda phi: midline(robot, phi))(run.angle[at])
        said |= {"x": x, "y": y}
    return _named(robot, said)


def midline(robot: Robot, phi: Array) -> tuple[Array, Array]:
    """Position of the nodes [m], (N,) each, from the angle of the midline."""
    weights = lay_out(robot).mesh.weights
    return cumulative(weights, jnp.cos(phi)), cumulative(weights, jnp.sin(phi))


def dissipation(run: Simulation) -> Array:
    """Work lost to friction of the tendon in its channel over a load history [J], ().

    The friction force between two nodes is the drop of tension between them; it does work where the tendon
    slips. Integrated by the trapezoidal rule along the tendon and over the steps; friction lumped at the
    tendon's ends is not counted.
    """
    grip = run.tension[..., :-1] - run.tension[..., 1:]
    slip = 0.5 * (run.slip[..., :-1] + run.slip[..., 1:])
    grip, slip = (jnp.concatenate([jnp.zeros_like(a[:1]), a]) for a in (grip, slip))
    return jnp.sum(0.5 * (grip[1:] + grip[:-1]) * jnp.diff(slip, axis=0))


def _share(T_tip: Array, T_base: Array) -> Array:
    """Share of the base tension that reaches the tip; 1 of a slack tendon."""
    return jnp.where(T_base > 0, T_tip / jnp.where(T_base > 0, T_base, 1.0), 1.0)


def _named(robot: Robot, said: dict[str, Array]) -> dict[str, Array]:
    """Of several tendons, one entry for each where it has its own."""
    names = robot.tendon_names
    if not names:
        return said
    parted = {}
    for name, values in said.items():
        if name in PER_TENDON:
            parted |= {f"{name}.{tendon}": values[:, i] for i, tendon in enumerate(names)}
        else:
            parted[name] = values
    return parted
