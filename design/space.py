"""The search space: which numbers may change, between which bounds, and the robot they change."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gtr_jax.errors import InputError, did_you_mean
from gtr_jax.files.config import RobotConfig, parse_config
from gtr_jax.files.config_checks import outer_radius_at
from gtr_jax.files.units import DIMENSIONS, convert, display_of, to_si
from gtr_jax.robot.build import build_robot, choose_intervals
from gtr_jax.robot.parameters import Parameter, parameter, parameters_of
from gtr_jax.robot.robot import Robot

from .target import SPLINE, T_BASE, TargetConfig

N_SINE = "n_sine"
KNOTS = 6  # of a spline, unless given
# Sections of the robot file whose numbers may be free.
SECTIONS = ("backbone.", "routing.", "tendon.")
ROUNDED = 1e-6  # of the distance between the bounds, to which the numbers of a design are rounded


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number that may change.

    Attributes:
        name: short name, e.g. "r1"; of a base tension "T_base", or "T_base.2" and so on if there are several.
        key: in the robot file; "" of a base tension.
        unit: SI.
        lower, upper: bounds, SI.
        start: value in the files, SI.
    """

    name: str
    key: str
    unit: str
    lower: float
    upper: float
    start: float


@dataclasses.dataclass(frozen=True, eq=False)
class Space:
    """What is searched.

    Attributes:
        config: the robot, its channel of the family that is searched.
        robot: the same to compute with; its mesh serves every design within the bounds.
        variables: numbers of the robot that may change; the number of half waves last if it is chosen.
        tensions: base tensions [N] that the targets name, increasing; the one before release last.
        free_tensions: those of them that may change, as variables.
        choices: numbers of half waves to choose from; empty if there is no choice.
    """

    config: RobotConfig
    robot: Robot
    variables: tuple[Variable, ...]
    tensions: tuple[float, ...]
    free_tensions: tuple[Variable, ...]
    choices: tuple[float, ...]

    @property
    def all(self) -> tuple[Variable, ...]:
        """The coordinates of the search: numbers of the robot, then base tensions."""
        return (*self.variables, *self.free_tensions)

    @property
    def lower(self) -> np.ndarray:
        """Lower bounds, SI, (p,)."""
        return np.array([v.lower for v in self.all])

    @property
    def upper(self) -> np.ndarray:
        """Upper bounds, SI, (p,)."""
        return np.array([v.upper for v in self.all])

    def values_at(self, z: np.ndarray) -> np.ndarray:
        """Values at coordinates from 0 to 1 between the bounds, SI, (p,)."""
        return self.lower + z * (self.upper - self.lower)

    def rounded(self, values: np.ndarray) -> np.ndarray:
        """Values to as many decimals as people can use, in the units of the files, within the bounds, SI,
        (p,).
        """
        short = []
        for v, value in zip(self.all, values, strict=True):
            unit = v.unit or "dimensionless"
            display, size = display_of(unit)
            decimals = int(np.ceil(-np.log10(ROUNDED * (v.upper - v.lower) / size)))
            shown = round(float(value) / size, decimals)
            short.append(convert(shown, display, unit) if unit in DIMENSIONS else shown * size)
        return np.clip(short, self.lower, self.upper)

    def design(self, values: np.ndarray) -> RobotConfig:
        """The robot file of a design.

        Args:
            values: of the coordinates, SI, (p,).

        Raises:
            InputError: no robot has such numbers.
        """
        numbers = {v.key: float(x) for v, x in zip(self.variables, values, strict=False)}
        data = self.config.model_dump(mode="json", by_alias=True, exclude_none=True)
        for key, value in numbers.items():
            node: Any = data
            *parents, last = key.split(".")
            for part in parents:
                node = node[int(part)] if isinstance(node, list) else node[part]
            node[int(last) if isinstance(node, list) else last] = value
        if self.config.routing.kind == "straight-sine-straight":
            wave = data["routing"]
            gap = 1e-6 * self.config.backbone.length
            wave["w1"] = min(wave["w1"], self.config.backbone.length - gap)
            wave["w2"] = max(wave["w2"], wave["w1"] + gap)
        return parse_config(data, source=self.config.source)

    def tensions_at(self, values: np.ndarray) -> np.ndarray:
        """Base tensions of a design [N], (t,)."""
        out = np.array(self.tensions, float)
        own = [self.tensions.index(v.start) for v in self.free_tensions]
        out[own] = np.asarray(values, float)[len(self.variables) :]
        return out


def build_space(config: RobotConfig, target: TargetConfig, *, resolution: float) -> Space:
    """The space that a target file asks for.

    Args:
        config: the robot file.
        target: checked against it.
        resolution: factor on the mesh of the search.

    Raises:
        InputError: a name that is no number of the robot, or bounds that are missing, unknown or crossed.
    """
    config = _with_family(config, target)
    robot = build_robot(config)
    tensions = _tensions(target)
    bounds = dict(target.search.bounds)
    names = _names(config, robot, target)
    variables = tuple(_variable(name, config, robot, target, bounds) for name in names)
    free = _free_tensions(tensions, config, target, bounds) if target.search.frees_tension else ()
    unused = set(bounds) - {v.name for v in variables} - {v.key for v in variables}
    unused -= {T_BASE} if free else set()
    if unused:
        name = sorted(unused)[0]
        known = [*(v.name for v in variables), *([T_BASE] if free else [])]
        raise InputError(
            f"{target.source}: search.bounds.{name}: nothing of this name is searched; "
            f"{did_you_mean(name, known)}"
        )
    choices = _choices(config, target)
    if len(choices) > 1:
        entry = parameter(robot, N_SINE)
        value = float(robot.value(N_SINE))
        variables = (
            *variables,
            Variable(N_SINE, entry.key, entry.unit, float(min(choices)), float(max(choices)), value),
        )
    elif choices:
        config = config.with_values({"routing.n_sine": choices[0]})
        robot = build_robot(config)
        choices = ()
    space = Space(config, robot, variables, tensions, free, choices)
    return dataclasses.replace(space, robot=_with_mesh(space, resolution))


def on_common_mesh(space: Space, config: RobotConfig, resolution: float) -> Robot:
    """A design's robot on a mesh that all designs of the space share, so that one compiled program serves
    them all.

    Args:
        space: of which it is a design.
        config: its file.
        resolution: factor on the mesh; 1 is nowhere coarser than the default.

    Raises:
        InputError: the tendon leaves the body.
    """
    robot = build_robot(config)
    return dataclasses.replace(robot, intervals=_with_mesh(space, resolution).intervals)


def _tensions(target: TargetConfig) -> tuple[float, ...]:
    """Base tensions that occur, increasing; the largest is that before release."""
    found = {load.T_base for load in target.loads if load.T_base is not None}
    if target.T_base_max is not None:
        found.add(target.T_base_max)
    return tuple(sorted(found))


def _names(config: RobotConfig, robot: Robot, target: TargetConfig) -> list[str]:
    """Short names of the numbers of the robot that may change."""
    search, known = target.search, parameters_of(robot)
    own = [name for name, p in known.items() if p.key.startswith("routing.") and name != N_SINE]
    wanted = [*(own if search.routing is None else search.routing), *search.free]
    names: list[str] = []
    for name in wanted:
        if name == T_BASE:
            continue
        if name == N_SINE:
            raise InputError(
                f"{target.source}: search: n_sine is chosen from a list; write n_sine = [2, 3, 4] under "
                "[search] and leave it out of the names"
            )
        entry = next((p for p in known.values() if name in (p.name, p.key)), None)
        if entry is None or not entry.key.startswith(SECTIONS):
            may = [p.name for p in known.values() if p.key.startswith(SECTIONS)]
            raise InputError(
                f"{target.source}: search: '{name}' is no number of body, channel or tendon that may change; "
                f"{did_you_mean(name, [*may, T_BASE])}"
            )
        short = entry.name
        if short in names:
            raise InputError(f"{target.source}: search: '{name}' stands twice; keep one")
        names.append(short)
    if not names and not search.frees_tension and not search.n_sine:
        raise InputError(
            f"{target.source}: search.routing: nothing may change; name for example {', '.join(own)}"
        )
    if target.search.n_sine and config.routing.kind not in ("converging-sine", "crossing-sine"):
        raise InputError(
            f"{target.source}: search.n_sine: a {config.routing.kind} channel has no half waves to choose; "
            'take kind = "crossing-sine", or leave n_sine out'
        )
    return names


def _choices(config: RobotConfig, target: TargetConfig) -> tuple[float, ...]:
    return tuple(sorted(set(target.search.n_sine or ())))


def _default_bounds(entry: Parameter, config: RobotConfig) -> tuple[float, float] | None:
    """Bounds of a number of the channel that the body itself sets; None of any other number. The limits
    decide how far inside the body the channel stays, so that they are seen to bind.
    """
    if not entry.key.startswith("routing."):
        return None
    body = config.backbone
    if entry.name in ("w1", "w2"):
        return 0.0, body.length
    if entry.name == "sigma":
        return 0.0, 1.0
    room = float(max(body.outer_radius))
    if entry.name.startswith("knot_"):
        place = config.routing.knots[int(entry.name.removeprefix("knot_"))][0]  # pyright: ignore
        room = float(outer_radius_at(body, place))
    return -room, room


def _variable(
    name: str, config: RobotConfig, robot: Robot, target: TargetConfig, bounds: dict[str, Any]
) -> Variable:
    entry = parameter(robot, name)
    given = bounds.get(entry.name, bounds.get(entry.key))
    where = f"{target.source}: search.bounds.{entry.name}"
    start = float(robot.value(name))
    if given is None:
        found = _default_bounds(entry, config)
        if found is None:
            unit = entry.unit or "1"
            raise InputError(
                f"{where}: missing; {entry.name} is free, so say within what, for example "
                f"{entry.name} = [{_example(0.5 * start, unit)}, {_example(2 * start, unit)}]"
            )
        lower, upper = found
    else:
        unit = entry.unit or "dimensionless"
        lower, upper = (to_si(value, unit, where) for value in given)
    if not lower < upper:
        raise InputError(f"{where}: {lower:g} is not below {upper:g}; give the least first, then the largest")
    below = entry.lower is not None and (lower < entry.lower or (entry.log and lower <= entry.lower))
    above = entry.upper is not None and upper > entry.upper
    if below or above:
        raise InputError(f"{where}: no robot has such a number; keep within what is possible")
    return Variable(entry.name, entry.key, entry.unit, lower, upper, start)


def _example(value: float, unit: str) -> str:
    return f"{value:.3g}" if unit == "1" else f'"{value:.3g} {unit}"'


def _free_tensions(
    tensions: tuple[float, ...], config: RobotConfig, target: TargetConfig, bounds: dict[str, Any]
) -> tuple[Variable, ...]:
    where = f"{target.source}: search.bounds.{T_BASE}"
    given, top = bounds.get(T_BASE), target.limits.max_T_base
    if given is None and top is None:
        raise InputError(f'{where}: missing; T_base is free, so say within what, for example ["5 N", "60 N"]')
    lower, upper = (to_si(v, "N", where) for v in given) if given is not None else (0.05 * (top or 0.0), top)
    upper = min(upper, top) if top is not None else upper  # type: ignore[type-var]
    if upper is None or not 0 < lower < upper:
        raise InputError(f"{where}: {lower:g} N to {upper:g} N is no range of tensions; give the least first")
    if lower < config.tendon.preload:
        raise InputError(
            f"{where}: {lower:g} N is less than the preload of {config.tendon.preload:g} N; begin there"
        )
    many = len(tensions) > 1
    return tuple(
        Variable(f"{T_BASE}.{i + 1}" if many else T_BASE, "", "N", lower, upper, T)
        for i, T in enumerate(tensions)
    )


def _with_family(config: RobotConfig, target: TargetConfig) -> RobotConfig:
    """The robot with a channel of the family that is searched."""
    kind = target.search.kind
    present = config.routing
    if kind is None or kind == present.kind:
        return config
    if kind == SPLINE and present.kind == "table" and target.search.knots is None:
        return config
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    body = config.backbone
    room = min(body.outer_radius) - target.limits.wall_clearance - 0.5 * target.limits.channel_diameter
    if kind == SPLINE:
        s = np.linspace(0.0, body.length, target.search.knots or KNOTS)
        R = channel_of(build_robot(config), s)
        routing: dict[str, Any] = {
            "kind": "table",
            "knots": [list(map(float, k)) for k in zip(s, R, strict=True)],
        }
    elif kind == "parallel":
        routing = {"kind": kind, "offset": 0.5 * room}
    elif kind == "straight-sine-straight":
        ends = 0.25 * body.length, 0.75 * body.length
        routing = {"kind": kind, "r1": -0.5 * room, "r2": 0.5 * room, "w1": ends[0], "w2": ends[1]}
    else:
        waves = max(target.search.n_sine or (2.0,))
        routing = {"kind": kind, "R_max": 0.5 * room, "r_min": 0.5 * room, "n_sine": waves}
        routing |= {"sigma": 0.2} if kind == "converging-sine" else {}
    data["routing"] = routing
    data["uncertainty"] = {
        key: value for key, value in data.get("uncertainty", {}).items() if not key.startswith("routing.")
    }
    return parse_config(data, source=config.source)


def channel_of(robot: Robot, s: np.ndarray) -> np.ndarray:
    """Offset of the channel [m] at s [m], (M,)."""
    import jax.numpy as jnp

    at = jnp.asarray(s, dtype=float)
    passed = robot.routing.kinks()[:, None] <= at[None, :]
    return np.asarray(robot.routing.offset(at, passed, robot.backbone.length).value)


def _with_mesh(space: Space, resolution: float) -> Robot:
    """The robot on a mesh that serves every design in the space: per panel the most intervals that any of a
    sample of designs asks for.
    """
    from scipy.stats import qmc

    robot = space.robot
    draws = qmc.Sobol(max(len(space.variables), 1), scramble=False).random_base2(6)
    most = np.asarray(choose_intervals(robot, resolution))
    for draw in draws:
        values = {
            v.name: v.lower + x * (v.upper - v.lower) for v, x in zip(space.variables, draw, strict=False)
        }
        if "w1" in values or "w2" in values:
            w1, w2 = (values.get(w, float(robot.value(w))) for w in ("w1", "w2"))
            apart = 0.1 * space.config.backbone.length
            w1, w2 = min(w1, w2), max(w1, w2)
            values |= {w: x for w, x in (("w1", w1), ("w2", max(w2, w1 + apart))) if w in values}
        many = robot.with_values(**values)
        most = np.maximum(most, choose_intervals(many, resolution))
    return dataclasses.replace(robot, intervals=tuple(int(n) for n in most))
