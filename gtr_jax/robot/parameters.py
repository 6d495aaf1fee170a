"""Named parameters of a robot: where each lives, its unit, bounds and transform. Shared by calibration and
design.
"""

from __future__ import annotations

import dataclasses
import difflib
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from gtr_jax.errors import InputError, excerpt
from gtr_jax.mechanics.structure import in_order
from gtr_jax.terms import REGISTRY, Term, known_acting

from .parts import Parts

AnyRobot = TypeVar("AnyRobot", bound=Parts)


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One named number of the robot.

    Attributes:
        name: the short name, e.g. "mu"; with several tendons "mu.left".
        key: the key in the robot file, e.g. "tendon.friction_coefficient" or
            "tendons.left.friction_coefficient".
        at: where it lives in `Robot`, e.g. "backbone.outer_radius.0".
        unit: SI unit for people.
        lower, upper: bounds in SI; None where open.
        log: whether it is estimated on a logarithmic scale (positive parameters).
        external: whether it is an external force, so that setting it makes the robot loaded.
    """

    name: str
    key: str
    unit: str
    lower: float | None = None
    upper: float | None = None
    log: bool = False
    external: bool = False
    at: str = ""

    def __post_init__(self):
        if not self.at:
            object.__setattr__(self, "at", self.key)

    @property
    def positive(self) -> bool:
        """Whether its lower bound is excluded; friction and density are the exception: they may vanish."""
        return self.log and self.name.partition(".")[0] not in ("mu", "density")


# Parameters of every robot that are not of a tendon.
_COMMON = (
    Parameter("E", "backbone.youngs_modulus", "Pa", 0.0, None, log=True),
    Parameter("length", "backbone.length", "m", 0.0, None, log=True),
    Parameter("density", "backbone.density", "kg/m^3", 0.0, None, log=True),
    Parameter("outer_radius_base", "backbone.outer_radius.0", "m", 0.0, None, log=True),
    Parameter("outer_radius_tip", "backbone.outer_radius.1", "m", 0.0, None, log=True),
    Parameter("gravity_angle", "loads.gravity_angle", "rad"),
    Parameter("tip_force_x", "loads.tip_force.0", "N", external=True),
    Parameter("tip_force_y", "loads.tip_force.1", "N", external=True),
    Parameter("tip_moment", "loads.tip_moment", "N m"),
    Parameter("payload", "loads.payload", "kg", 0.0, None),
)
_ROUTING_UNITS = {"n_sine": "", "sigma": ""}  # all others are lengths


def _of_tendon(robot: Parts, index: int) -> Iterator[Parameter]:
    """The parameters of one tendon and its channel."""
    tendon, several = robot.tendons[index], len(robot.tendons) > 1
    ending = f".{tendon.name}" if several else ""
    table = f"tendons.{tendon.name}" if several else "tendon"
    channel = f"{table}.routing" if several else "routing"
    at = f"tendons.{index}"
    friction = f"{table}.friction_coefficient"
    yield Parameter(f"mu{ending}", friction, "", 0.0, None, log=True, at=f"{at}.friction_coefficient")
    yield Parameter(f"preload{ending}", f"{table}.preload", "N", 0.0, None, at=f"{at}.preload")
    for field in vars(tendon.routing):
        if field in ("knots_s", "knots_R", "basis"):
            continue
        name = field.rstrip("_")
        unit = _ROUTING_UNITS.get(name, "m")
        yield Parameter(f"{name}{ending}", f"{channel}.{name}", unit, at=f"{at}.routing.{field}")
    for k in range(getattr(tendon.routing, "knots_R", jnp.zeros(0)).shape[0]):
        yield Parameter(f"knot_{k}{ending}", f"{channel}.knots.{k}.1", "m", at=f"{at}.routing.knots_R.{k}")


def parameters_of(robot: Parts) -> dict[str, Parameter]:
    """All parameters of this robot, by short name."""
    tendons = itertools.chain(*(_of_tendon(robot, i) for i in range(len(robot.tendons))))
    found = {p.name: p for p in (*tendons, *_COMMON)}
    if robot.backbone.rigid:
        del found["E"]
    for k in range(robot.backbone.bore_start.shape[0]):
        for field, word in (("bore_start", "from"), ("bore_end", "to"), ("bore_diameter", "diameter")):
            name = f"bore_{k}_{word}"
            key = f"backbone.bores.{k}.{word}"
            found[name] = Parameter(name, key, "m", 0.0, None, at=f"backbone.{field}.{k}")
    for kind, values in robot.terms.items():
        for q in REGISTRY[kind].quantities:
            if q.name in values:
                key, unit = f"terms.{kind}.{q.name}", "" if q.unit == "dimensionless" else q.unit
                name = f"{kind}.{q.name}"
                found[name] = Parameter(name, key, unit, q.lower, q.upper, log=q.log)
    if robot.backbone.natural_curvature.shape[0] == 1:
        name = "natural_curvature"
        at = "backbone.natural_curvature.0"
        found[name] = Parameter(name, "backbone.natural_curvature", "rad/m", at=at)
    return found


def term_of(entry: Parameter) -> Term | None:
    """The physics term that a parameter belongs to; None if it belongs to none."""
    return REGISTRY.get(entry.name.partition(".")[0])


def parameter(robot: Parts, name: str) -> Parameter:
    """Look a parameter up by short name or by its key in the robot file.

    Raises:
        InputError: no such parameter; names the nearest and lists all.
    """
    known = parameters_of(robot)
    if name in known:
        return known[name]
    by_key = {p.key: p for p in known.values()}
    if name in by_key:
        return by_key[name]
    if name in ("E", "backbone.youngs_modulus"):
        raise InputError("parameter 'E': the backbone is rigid, so its stiffness has no effect; leave E out")
    near = difflib.get_close_matches(name, [*known, *by_key], n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise InputError(f"parameter '{name}' does not exist on this robot; {hint}known: {', '.join(known)}")


def _locate(at: str) -> tuple[Callable[[Parts], Array], int | None]:
    """A function that gets the array that holds a number, and the number's index in it, if it has one."""
    parts = at.split(".")
    index = int(parts.pop()) if parts[-1].isdigit() else None

    def where(robot: Parts) -> Array:
        node: Any = robot
        for part in parts:
            if isinstance(node, dict):
                node = node[part]
            else:
                node = node[int(part)] if part.isdigit() else getattr(node, part)
        return node

    return where, index


def value_of(robot: Parts, name: str) -> Float[Array, ""]:
    """Value of a named parameter, SI, scalar."""
    where, index = _locate(parameter(robot, name).at)
    leaf = where(robot)
    return leaf if index is None else leaf[index]


_ROUNDING = 1e-9  # relative error of a bound that a transform reached


def check_bounds(robot: Parts, values: Mapping[str, Any]) -> None:
    """Refuse concrete values [SI], of any shape, that a parameter cannot have; traced ones are not checked.

    Raises:
        InputError: unknown name, no number, or out of bounds.
    """
    for name, value in values.items():
        if not isinstance(value, Tracer):
            _check_bounds(parameter(robot, name), value)


def _check_bounds(entry: Parameter, value: Any) -> None:
    try:
        values = np.asarray(value, dtype=float)
    except (OverflowError, TypeError, ValueError):
        raise InputError(f"parameter '{entry.name}': expected a number, found {excerpt(value)}") from None
    for bound, sign, words in ((entry.lower, 1, "least"), (entry.upper, -1, "most")):
        if bound is None:
            continue
        beyond = np.min(sign * (values - bound), initial=np.inf)
        outside = not beyond >= -_ROUNDING * abs(bound) or (entry.positive and sign > 0 and beyond == 0)
        if outside:
            least = f"above {bound:g}" if entry.positive and sign > 0 else f"at {words} {bound:g}"
            found = excerpt(f"{values:g}" if values.ndim == 0 else value)
            raise InputError(
                f"parameter '{entry.name}': must be {least} {entry.unit}".rstrip() + f", is {found}"
            )
    if np.any(np.isnan(values)):
        raise InputError(f"parameter '{entry.name}': is not a number; give one in SI units")


def with_values(robot: AnyRobot, values: Mapping[str, Float[Array, ""] | float]) -> AnyRobot:
    """The robot with named parameters replaced. Values may be traced; only `Robot.with_values` checks them
    against bounds. Physics terms whose size is named, at whatever value, and those known to act join
    `robot.acting`, external forces make the robot `loaded`: the pytree's structure changes with them.

    Raises:
        InputError: unknown name, or the modulus of a rigid sheath.
    """
    loaded, acting = robot.loaded, [*robot.acting]
    for name, value in values.items():
        entry = parameter(robot, name)
        where, index = _locate(entry.at)
        leaf = where(robot)
        new = jnp.asarray(value, leaf.dtype)
        new = new if index is None else leaf.at[index].set(new)
        robot = eqx.tree_at(where, robot, new)
        loaded = loaded or entry.external
        term = term_of(entry)
        if term is not None and entry.name.partition(".")[2] in [q.name for q in term.sizes]:
            acting.append(term.id)
    return dataclasses.replace(robot, loaded=loaded, acting=in_order([*acting, *known_acting(robot.terms)]))


def places_of(robot: Parts, names: Sequence[str]) -> Int[Array, " p"]:
    """Where named parameters lie in the robot flattened by `jax.flatten_util.ravel_pytree`, (p,).

    With places instead of names, one compiled program serves every choice of as many parameters.
    """
    flat, unravel = ravel_pytree(robot)
    places = unravel(jnp.arange(flat.shape[0], dtype=flat.dtype))
    return jnp.asarray([int(value_of(places, name)) for name in names])
