"""How the tip's pose and tension respond to each number of the design."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from gtr_jax import InputError, Robot, equilibrium, parameters_of
from gtr_jax.robot.parameters import Parameter, parameter, places_of

POSE = {"tip_x": "m", "tip_y": "m", "tip_angle": "rad"}


@dataclasses.dataclass(frozen=True, eq=False)
class Sensitivities:
    """First derivatives of the tip's pose and tension at one base tension.

    Attributes:
        T_base: base tension [N], (*tendons,).
        outputs: the q quantities derived: tip_x, tip_y, tip_angle, and T_tip or, of several tendons,
            T_tip.left and the like.
        output_units: SI unit of each.
        values: each of them at the present design, SI, (q,).
        parameters: the p numbers with respect to which they are derived, with key and unit.
        parameter_values: their present values, SI, (p,).
        derivatives: d output/d parameter, SI, (p, q).
        converged: whether the equilibrium met its tolerance; if not, believe nothing here.
    """

    T_base: np.ndarray
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    values: np.ndarray
    parameters: tuple[Parameter, ...]
    parameter_values: np.ndarray
    derivatives: np.ndarray
    converged: bool

    def __getitem__(self, at: tuple[str, str]) -> float:
        """The derivative of an output by a parameter: table["tip_x", "r1"]."""
        output, name = at
        names = [p.name for p in self.parameters]
        return float(self.derivatives[names.index(name), self.outputs.index(output)])

    def unit(self, output: str, name: str) -> str:
        """Unit of that derivative, e.g. "rad/m"."""
        above = self.output_units[self.outputs.index(output)]
        below = next(p.unit for p in self.parameters if p.name == name)
        if above == below or not below:
            return "" if above == below else above
        return f"{above}/{below}" if below.isalpha() else f"{above}/({below})"

    def rows(self) -> list[dict[str, str | float]]:
        """The table: per parameter its name, value and unit, and each derivative under "output [unit]"."""
        table = []
        for i, p in enumerate(self.parameters):
            row: dict[str, str | float] = {"parameter": p.name, "value": float(self.parameter_values[i])}
            row["unit"] = p.unit
            for j, output in enumerate(self.outputs):
                unit = self.unit(output, p.name)
                row[f"d {output} [{unit or '-'}]"] = float(self.derivatives[i, j])
            table.append(row)
        return table


@eqx.filter_jit
def _slopes(robot: Robot, T_base: Float[Array, "*tendons"], index: Int[Array, " p"]):
    flat, unravel = ravel_pytree(robot)

    def tip(values):
        eq = equilibrium(unravel(flat.at[index].set(values)), T_base)
        return jnp.concatenate([eq.tip_pose, jnp.atleast_1d(eq.T_tip)]), eq.converged

    def along(direction):
        value, slope, converged = jax.jvp(tip, (flat[index],), (direction,), has_aux=True)
        return value, slope, converged

    return jax.vmap(along, out_axes=(None, 0, None))(jnp.eye(index.shape[0]))


def pose_sensitivity(
    robot: Robot, T_base: float | Sequence[float] | np.ndarray, names: Sequence[str] | None = None
) -> Sensitivities:
    """Derivatives of the tip's pose and tension by numbers of the design, on the first pull.

    Forward mode through the equilibrium by the implicit function theorem: the bent shape, the friction along
    it and the tension all respond. One compiled program per robot structure and number of parameters.

    Args:
        robot: the design.
        T_base: base tension [N]; with several tendons one each, pulled together.
        names: parameters, by short name or key of the robot file; every number of routing and backbone unless
            given.

    Returns:
        The table. `converged` is False if the equilibrium was not found.

    Raises:
        InputError: unknown parameter, or the modulus of a rigid sheath.
    """
    if names is None:
        designed = ("backbone", "routing")
        chosen = [p for p in parameters_of(robot).values() if set(designed) & set(p.key.split("."))]
    else:
        chosen = [parameter(robot, name) for name in names]
    if not chosen:
        raise InputError("pose_sensitivity: no parameter is named; name some, or leave names out for all")
    robot = robot.with_values(**{p.name: robot.value(p.name) for p in chosen})
    index = places_of(robot, [p.name for p in chosen])
    tensions = [f"T_tip.{name}" for name in robot.tendon_names] or ["T_tip"]
    value, slope, converged = _slopes(robot, jnp.asarray(T_base, dtype=float), index)
    return Sensitivities(
        T_base=np.asarray(T_base, dtype=float),
        outputs=(*POSE, *tensions),
        output_units=(*POSE.values(), *["N"] * len(tensions)),
        values=np.asarray(value),
        parameters=tuple(chosen),
        parameter_values=np.asarray([robot.value(p.name) for p in chosen]),
        derivatives=np.asarray(slope),
        converged=bool(converged),
    )
