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
import jax.tree_util as jtu
import numpy as np
from jax.core import Tracer
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from gtr_jax.errors import InputError, excerpt, listed
from gtr_jax.mechanics.program_spec import in_order
from gtr_jax.terms import Term, known_acting

from .backbone import Backbone, Stiffness
from .parts import Parts, Tendon

AnyRobot = TypeVar("AnyRobot", bound=Parts)
NEAREST, MOST = 3, 16  # names that an error names: alike, or of the robot itself


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
        term: the physics term that it belongs to; None if it belongs to none.
    """

    name: str
    key: str
    unit: str
    lower: float | None = None
    upper: float | None = None
    log: bool = False
    external: bool = False
    at: str = ""
    term: Term | None = dataclasses.field(default=None, repr=False)

    def __post_init__(self):
        if not self.at:
            object.__setattr__(self, "at", self.key)

    @property
    def positive(self) -> bool:
        """Whether its lower bound is excluded; friction and density are the exception: they may vanish."""
        return self.log and self.name.partition(".")[0] not in ("mu", "density")


# The numbers that say how stiff a whole body is: its modulus; the factor on several numbers; its bending
# stiffness.
STIFFNESS = ("E", "stiffness_factor", "EI", "EI_z", "EI_y")
# Numbers that are infinite where a tendon does not stretch.
ENDLESS = ("EA",)

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
)
_IN_PLANE = (Parameter("tip_moment", "loads.tip_moment", "N m"),)
_LAST = (Parameter("payload", "loads.payload", "kg", 0.0, None),)
_IN_SPACE = (
    Parameter("tip_force_z", "loads.tip_force.2", "N", external=True),
    *(
        Parameter(f"tip_moment_{axis}", f"loads.tip_moment.{i}", "N m", external=True)
        for i, axis in enumerate("xyz")
    ),
    *(
        Parameter(
            f"gravity_{axis}", f"loads.gravity.{i}", "m/s^2", external=True, at=f"loads.more_gravity.{i}"
        )
        for i, axis in enumerate("xyz")
    ),
    *(Parameter(f"base_{axis}", f"base.position.{i}", "m") for i, axis in enumerate("xyz")),
    *(
        Parameter(
            f"base_rotation_{axis}",
            f"base.rotation.{i}",
            "rad",
            -2 * np.pi,
            2 * np.pi,
            at=f"base.rotation_vector.{i}",
        )
        for i, axis in enumerate("xyz")
    ),
    Parameter("nu", "backbone.poissons_ratio", "", -1.0, 0.5),
)
# Of numbers of a channel: unit and least value. All others are lengths.
_ROUTING_UNITS = {"n_sine": "", "sigma": "", "turns": "", "start_angle": "rad", "angle": "rad"}
_ROUTING_LEAST = {"radius": 0.0, "tip_radius": 0.0}
# Fields of a channel that are not numbers of their own.
_ARRAYS = ("knots_s", "knots_R", "knots_y", "knots_z", "basis", "plane_angle")
_COLUMNS = {"knots_R": 1, "knots_y": 1, "knots_z": 2}  # of a row of knots in the file


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
    for field, value in vars(tendon.routing).items():
        if field in _ARRAYS or value is None:
            continue
        name = field.rstrip("_")
        unit, least = _ROUTING_UNITS.get(name, "m"), _ROUTING_LEAST.get(name)
        yield Parameter(f"{name}{ending}", f"{channel}.{name}", unit, least, at=f"{at}.routing.{field}")
    for field, column in _COLUMNS.items():
        name = field.replace("knots_R", "knot").replace("knots", "knot")
        for k in range(getattr(tendon.routing, field, jnp.zeros(0)).shape[0]):
            key = f"{channel}.knots.{k}.{column}"
            yield Parameter(f"{name}_{k}{ending}", key, "m", at=f"{at}.routing.{field}.{k}")
    if robot.space:
        yield from _of_tendon_in_space(tendon, ending, table, channel, at)


def _of_tendon_in_space(
    tendon: Tendon, ending: str, table: str, channel: str, at: str
) -> Iterator[Parameter]:
    """The parameters that a tendon has in space only."""
    if hasattr(tendon.routing, "plane_angle"):
        key = f"{channel}.plane_angle"
        yield Parameter(f"plane_angle{ending}", key, "rad", at=f"{at}.routing.plane_angle")
    if tendon.to is not None:
        yield Parameter(f"to{ending}", f"{table}.to", "m", 0.0, None, at=f"{at}.to")
    for k in range(len(() if tendon.guides is None else tendon.guides)):
        yield Parameter(f"guide_{k}{ending}", f"{table}.guides.{k}", "m", 0.0, None, at=f"{at}.guides.{k}")
    key = f"{table}.axial_stiffness"
    yield Parameter(f"EA{ending}", key, "N", 0.0, None, log=True, at=f"{at}.axial_stiffness")
    yield Parameter(f"free_length{ending}", f"{table}.free_length", "m", 0.0, None, at=f"{at}.free_length")


def _of_body(robot: Parts) -> Iterator[Parameter]:
    """The parameters of the body that not every robot has."""
    body = robot.backbone
    for k in range(body.bore_start.shape[0]):
        for field, word in (("bore_start", "from"), ("bore_end", "to"), ("bore_diameter", "diameter")):
            key = f"backbone.bores.{k}.{word}"
            yield Parameter(f"bore_{k}_{word}", key, "m", 0.0, None, at=f"backbone.{field}.{k}")
    if body.stiffness is not None:
        yield from _of_stiffness(body.stiffness, "", "backbone", "backbone.stiffness", robot.space)
    if body.stiffness_factor is not None:
        yield Parameter("stiffness_factor", "backbone.stiffness_factor", "", 0.0, None, log=True)
    for k, piece in enumerate(body.pieces):
        name, key, at = f"section_{k}", f"backbone.sections.{k}", f"backbone.pieces.{k}"
        for field, word in (("start", "from"), ("end", "to")):
            yield Parameter(f"{name}_{word}", f"{key}.{word}", "m", 0.0, None, at=f"{at}.{field}")
        for i, end in enumerate(("base", "tip") if piece.outer_radius is not None else ()):
            own = f"outer_radius.{i}"
            yield Parameter(
                f"{name}_outer_radius_{end}", f"{key}.{own}", "m", 0.0, None, log=True, at=f"{at}.{own}"
            )
        if piece.youngs_modulus is not None:
            own = "youngs_modulus"
            yield Parameter(f"{name}_E", f"{key}.{own}", "Pa", 0.0, None, log=True, at=f"{at}.{own}")
        if piece.stiffness is not None:
            yield from _of_stiffness(piece.stiffness, f"{name}_", key, f"{at}.stiffness", robot.space)
    for field in () if body.shape is None else [f.name for f in dataclasses.fields(body.shape)]:
        key, at = f"backbone.section.{field}", f"backbone.shape.{field}"
        yield Parameter(f"section_{field}", key, "m", 0.0, None, log=field != "inner_diameter", at=at)
    if body.axial_stiffness is not None:
        key = "backbone.axial_stiffness"
        yield Parameter("body_EA", key, "N", 0.0, None, log=True)
    for k, row in enumerate(body.notches):
        name = "notches" if len(body.notches) == 1 else f"notches_{k}"
        key = f"backbone.notches.{k}"
        for field in ("height", "depth", "spacing", "end_correction"):
            least = None if field == "end_correction" else 0.0
            yield Parameter(f"{name}_{field}", f"{key}.{field}", "m", least, None)
        for i in range(row.count):
            yield Parameter(f"{name}_natural_angle_{i}", f"{key}.natural_angle.{i}", "rad")
    strains = ("natural_curvature", "natural_curvature_y", "natural_twist")
    for name in strains if robot.space else strains[:1]:
        if getattr(body, name).shape[0] == 1:
            yield Parameter(name, f"backbone.{name}", "rad/m", at=f"backbone.{name}.0")


def _of_stiffness(given: Stiffness, start: str, table: str, at: str, space: bool) -> Iterator[Parameter]:
    """Each number that a stiffness is given by, under its place in a constant, a pair or rows of the file."""
    two = given.bending_y is not None
    numbers = [("EI_z" if two else "EI", "bending_stiffness", "bending", 1 + two)]
    if space:
        numbers += [("EI_y", "bending_stiffness", "bending_y", 1)] if two else []
        numbers += [("GJ", "torsional_stiffness", "torsion", 1)]
    for name, key, field, column in numbers:
        count = len(() if (values := getattr(given, field)) is None else values)
        for k in range(count):
            row = count > 1
            places = [str(k), str(column)] if row else [str(column - 1)] if name in ("EI_y", "EI_z") else []
            full = ".".join([f"{table}.{key}", *places])
            numbered = f"{start}{name}_{k}" if row else f"{start}{name}"
            yield Parameter(numbered, full, "N m^2", 0.0, None, log=True, at=f"{at}.{field}.{k}")


def parameters_of(robot: Parts) -> dict[str, Parameter]:
    """All parameters of this robot, by short name."""
    tendons = itertools.chain(*(_of_tendon(robot, i) for i in range(len(robot.tendons))))
    common = (*_COMMON, *(_IN_SPACE if robot.space else _IN_PLANE), *_LAST)
    found = {p.name: p for p in (*tendons, *common)}
    if _no_modulus(robot.backbone):
        del found["E"]
    if robot.space and robot.backbone.rigid:
        del found["nu"]
    found |= {p.name: p for p in _of_body(robot)}
    for kind, values in robot.terms.items():
        term = robot.catalogue[kind]
        for q in term.numbers if robot.space else term.quantities:
            for name, key, at in _of_term(robot, kind, q.name) if q.name in values else ():
                unit = "" if q.unit == "dimensionless" else q.unit
                if name in found:
                    raise InputError(f"{key}: the robot has a number {name} already; rename the law")
                found[name] = Parameter(name, key, unit, q.lower, q.upper, log=q.log, at=at, term=term)
    return found


def _of_term(robot: Parts, kind: str, number: str) -> Iterator[tuple[str, str, str]]:
    """Name, key and place of a number of a term, or of each tendon's where each has its own."""
    whole = f"{kind}.{number}"
    if not jnp.ndim(robot.terms[kind][number]):
        yield whole, f"terms.{whole}", f"terms.{whole}"
        return
    for i, tendon in enumerate(robot.tendon_names):
        yield f"{whole}.{tendon}", f"terms.{kind}:{tendon}.{number}", f"terms.{whole}.{i}"


def _no_modulus(body: Backbone) -> str:
    """Why Young's modulus has no effect on a body; "" if it has."""
    if body.rigid:
        return "the backbone is rigid"
    own = all(piece.stiffness is not None or piece.youngs_modulus is not None for piece in body.pieces)
    return "the backbone has a bending_stiffness" if body.stiffness is not None and own else ""


def parameter(robot: Parts, name: str) -> Parameter:
    """Look a parameter up by short name or by its key in the robot file.

    Raises:
        InputError: no such parameter; names the nearest, or the robot's own and what lists the rest.
    """
    known = parameters_of(robot)
    if name in known:
        return known[name]
    by_key = {p.key: p for p in known.values()}
    if name in by_key:
        return by_key[name]
    if name in ("E", "backbone.youngs_modulus"):
        instead = [own for own in STIFFNESS if own in known]
        remedy = "leave E out" if robot.backbone.rigid else f"name {instead[0]} instead"
        raise InputError(f"parameter 'E': {_no_modulus(robot.backbone)}, so it has no effect; {remedy}")
    near = difflib.get_close_matches(name, [*known, *by_key], n=NEAREST)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else parameters_listed(robot)
    raise InputError(f"parameter '{excerpt(name)}' does not exist on this robot; {hint}")


def parameters_listed(robot: Parts) -> str:
    """The names of a robot's own parameters in a line, and what lists those of its terms."""
    own = [name for name, each in parameters_of(robot).items() if each.term is None]
    return f"known: {listed(own, MOST)}, and KIND.NUMBER of a term, which gtr terms KIND lists"


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
        term = entry.term
        if term is not None and entry.name.split(".")[1] in [q.name for q in term.sizes]:
            acting.append(term.id)
    acting += known_acting(robot.terms, robot.laws)
    return dataclasses.replace(robot, loaded=loaded, acting=in_order(acting, robot.laws))


def bounded(
    robot: Parts,
) -> tuple[Float[Array, " b"], Float[np.ndarray, " b"], Float[np.ndarray, " b"], Bool[np.ndarray, " b"]]:
    """The numbers of a robot but those of `ENDLESS`, which may be traced, (b,); the least and the most of
    each, infinite without such a bound, and whether it must lie above the least. Numbers of an absent physics
    term may be at their null.
    """
    leaves, tree = jtu.tree_flatten(robot)
    sizes = [int(np.prod(np.shape(leaf))) for leaf in leaves]
    first = np.cumsum([0, *sizes])[:-1]
    places = jtu.tree_unflatten(
        tree,
        [at + np.arange(n).reshape(np.shape(leaf)) for at, n, leaf in zip(first, sizes, leaves, strict=True)],
    )
    every = parameters_of(robot)
    entries = [p for p in every.values() if p.name.partition(".")[0] not in ENDLESS]
    at = []
    for entry in entries:
        where, index = _locate(entry.at)
        at.append(int(where(places) if index is None else where(places)[index]))
    flat = jnp.concatenate([jnp.ravel(jnp.asarray(leaf)) for leaf in leaves])
    return (
        flat[np.asarray(at, int)],
        np.array([-np.inf if p.lower is None else p.lower for p in entries]),
        np.array([np.inf if p.upper is None else p.upper for p in entries]),
        np.array([p.positive and p.term is None for p in entries]),
    )


def places_of(robot: Parts, names: Sequence[str]) -> Int[Array, " p"]:
    """Where named parameters lie in the robot flattened by `jax.flatten_util.ravel_pytree`, (p,).

    With places instead of names, one compiled program serves every choice of as many parameters.
    """
    flat, unravel = ravel_pytree(robot)
    places = unravel(jnp.arange(flat.shape[0], dtype=flat.dtype))
    return jnp.asarray([int(value_of(places, name)) for name in names])
