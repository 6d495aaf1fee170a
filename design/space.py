"""The search space: which numbers may change, between which bounds, and the robot they change."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any

import numpy as np

from gtr_jax.config.checks import outer_radius_at
from gtr_jax.config.config import RobotConfig, parse_config
from gtr_jax.config.routings import SPATIAL
from gtr_jax.config.toml_file import place_of
from gtr_jax.errors import InputError, did_you_mean
from gtr_jax.robot.build import build_robot, choose_intervals
from gtr_jax.robot.clearance import place_in_section
from gtr_jax.robot.parameters import Parameter, parameter, parameters_of
from gtr_jax.robot.robot import Robot
from gtr_jax.units import DIMENSIONS, convert, display_of, to_si

from .target import SPLINE, T_BASE, TargetConfig, is_tension
from .tensions import Pull, pulls_of

N_SINE = "n_sine"
KNOTS = 6  # of a spline, unless given
# Sections of the robot file whose numbers may be free.
SECTIONS = ("backbone.", "routing.", "tendon.", "tendons.")
ROUNDED = 1e-6  # of the distance between the bounds, to which the numbers of a design are rounded


@dataclasses.dataclass(frozen=True)
class Variable:
    """One number that may change.

    Attributes:
        name: short name, e.g. "r1"; of a base tension "T_base", or "T_base.2" and so on if there are several,
            and with the name of one of several tendons, "T_base.left" or "T_base.2.left".
        key: in the robot file; "" of a base tension.
        unit: SI.
        lower, upper: bounds, SI.
        start: value in the files, SI.
        place: of a base tension, which of all of them, tendon after tendon, then load after load.
    """

    name: str
    key: str
    unit: str
    lower: float
    upper: float
    start: float
    place: int = -1

    @property
    def of_channel(self) -> bool:
        """Whether it is a number of a channel."""
        return is_of_channel(self.key)


def is_of_channel(key: str) -> bool:
    """Whether the key of a robot's file is that of a number of a channel."""
    return key.startswith("routing.") or ".routing." in key


@dataclasses.dataclass(frozen=True, eq=False)
class Space:
    """What is searched.

    Attributes:
        config: the robot, its channel of the family that is searched.
        robot: the same to compute with; its mesh serves every design within the bounds.
        variables: numbers of the robot that may change; the number of half waves last if it is chosen.
        tensions: base tensions [N] that the targets name, increasing, of several tendons each; the one before
            release last.
        free_tensions: those of them that may change, as variables.
        choices: numbers of half waves to choose from; empty if there is no choice.
    """

    config: RobotConfig
    robot: Robot
    variables: tuple[Variable, ...]
    tensions: tuple[Pull, ...]
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
                node = node[place_of(part, node)]
            node[place_of(last, node)] = value
        for holder in data.get("tendons") or [data]:
            wave = holder["routing"]
            if wave["kind"] == "straight-sine-straight":
                gap = 1e-6 * self.config.backbone.length
                wave["w1"] = min(wave["w1"], self.config.backbone.length - gap)
                wave["w2"] = max(wave["w2"], wave["w1"] + gap)
        return parse_config(data, source=self.config.source)

    def tensions_at(self, values: np.ndarray) -> np.ndarray:
        """Base tensions of a design [N], (t, *tendons)."""
        out = np.array(self.tensions, float)
        own = [v.place for v in self.free_tensions]
        out.reshape(-1)[own] = np.asarray(values, float)[len(self.variables) :]
        return out


def build_space(config: RobotConfig, target: TargetConfig, *, resolution: float) -> Space:
    """The space that a target file asks for.

    Args:
        config: the robot file, its channel of the family that is searched (`with_family`).
        target: checked against it.
        resolution: factor on the mesh of the search.

    Raises:
        InputError: a name that is not a number of the robot, or bounds that are missing, unknown or crossed.
    """
    robot = build_robot(config)
    tensions = pulls_of(config, target)
    bounds = dict(target.search.bounds)
    names = _names(config, robot, target)
    variables = tuple(_variable(name, config, robot, target, bounds) for name in names)
    free = _free_tensions(tensions, config, target, bounds) if target.search.frees_tension else ()
    unused = set(bounds) - {v.name for v in variables} - {v.key for v in variables}
    unused -= set(_bound_names(config)) if free else set()
    if unused:
        name = sorted(unused)[0]
        known = [*(v.name for v in variables), *(_bound_names(config) if free else [])]
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
    return dataclasses.replace(
        space, robot=dataclasses.replace(robot, intervals=_intervals(space, resolution))
    )


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
    return dataclasses.replace(robot, intervals=_intervals(space, resolution))


def _bound_names(config: RobotConfig) -> list[str]:
    """Names under which bounds of base tensions may stand."""
    return [T_BASE, *(f"{T_BASE}.{name}" for name in config.tendon_names)]


def _names(config: RobotConfig, robot: Robot, target: TargetConfig) -> list[str]:
    """Short names of the numbers of the robot that may change."""
    search, known = target.search, parameters_of(robot)
    own = [
        name
        for name, p in known.items()
        if is_of_channel(p.key) and name.partition(".")[0] not in (N_SINE, "plane_angle")
    ]
    wanted = [*(own if search.routing is None else search.routing), *search.free]
    names: list[str] = []
    for name in wanted:
        if is_tension(name):
            continue
        if name.partition(".")[0] == N_SINE:
            raise InputError(
                f"{target.source}: search: n_sine is chosen from a list; write n_sine = [2, 3, 4] under "
                "[search] and leave it out of the names"
            )
        entry = next((p for p in known.values() if name in (p.name, p.key)), None)
        if entry is None or not entry.key.startswith(SECTIONS):
            may = [p.name for p in known.values() if p.key.startswith(SECTIONS)]
            raise InputError(
                f"{target.source}: search: '{name}' is not a number of body, channel or tendon that may "
                "change; "
                f"{did_you_mean(name, [*may, T_BASE])}"
            )
        short = entry.name
        if short in names:
            raise InputError(f"{target.source}: search: '{name}' is given twice; remove one")
        names.append(short)
    if not names and not search.frees_tension and not search.n_sine:
        raise InputError(
            f"{target.source}: search.routing: nothing may change; name for example {', '.join(own)}"
        )
    if target.search.n_sine and config.tendons:
        raise InputError(
            f"{target.source}: search.n_sine: is chosen for robots of one tendon; leave it out, and set the "
            "half waves of each in the robot file"
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
    if not is_of_channel(entry.key):
        return None
    body = config.backbone
    name, _, tendon = entry.name.partition(".")
    if name in ("w1", "w2"):
        return 0.0, body.length
    if name == "sigma":
        return 0.0, 1.0
    if name == "turns":
        return None
    if entry.unit == "rad":
        return -np.pi, np.pi
    room = float(max(body.outer_radius))
    if name.startswith("knot_"):
        routing = next(routing for own, _, routing in config.strung if own == tendon)
        room = float(outer_radius_at(body, routing.knots[int(name.rpartition("_")[2])][0]))
    return (0.0 if entry.lower == 0.0 else -room), room


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
                f"{where}: missing; {entry.name} is free, so give its bounds, for example "
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
    tensions: tuple[Pull, ...], config: RobotConfig, target: TargetConfig, bounds: dict[str, Any]
) -> tuple[Variable, ...]:
    many, names = len(tensions) > 1, config.tendon_names
    found: list[Variable] = []
    for i, pull in enumerate(tensions):
        numbered = f"{T_BASE}.{i + 1}" if many else T_BASE
        if not isinstance(pull, tuple):
            found.append(_free_tension(numbered, i, pull, ("", config.tendon.preload), target, bounds))
            continue
        for k, (name, tendon, _) in enumerate(config.strung):
            if {T_BASE, f"{T_BASE}.{name}"} & set(target.search.free_tensions):
                place, own = i * len(names) + k, (name, tendon.preload)
                found.append(_free_tension(f"{numbered}.{name}", place, pull[k], own, target, bounds))
    return tuple(found)


def _free_tension(
    name: str,
    place: int,
    start: float,
    tendon: tuple[str, float],
    target: TargetConfig,
    bounds: dict[str, Any],
) -> Variable:
    """One base tension that may change, of a tendon of some name and preload."""
    own, preload = tendon
    key = f"{T_BASE}.{own}" if f"{T_BASE}.{own}" in bounds else T_BASE
    where = f"{target.source}: search.bounds.{key}"
    given, top = bounds.get(key), target.limits.max_T_base
    if given is None and top is None:
        raise InputError(f'{where}: missing; T_base is free, so give its bounds, for example ["5 N", "60 N"]')
    lower, upper = (to_si(v, "N", where) for v in given) if given is not None else (0.05 * (top or 0.0), top)
    upper = min(upper, top) if top is not None else upper  # type: ignore[type-var]
    slack = bool(own)  # one of several tendons may be slack
    if upper is None or not 0 <= lower < upper or (lower == 0 and not slack):
        raise InputError(
            f"{where}: {lower:g} N to {upper:g} N is not a range of tensions; give the least first"
        )
    if lower < preload:
        raise InputError(f"{where}: {lower:g} N is less than the preload of {preload:g} N; begin there")
    return Variable(name, "", "N", lower, upper, start, place)


def with_family(config: RobotConfig, target: TargetConfig) -> RobotConfig:
    """The robot with a channel of the family that is searched."""
    kind = target.search.kind
    if kind is None:
        return config
    if config.tendons:
        raise InputError(
            f"{target.source}: search.kind: is for robots with one tendon; leave it out, and give each of "
            "several its kind of channel in the robot file"
        )
    present = config.routing
    if kind == present.kind and not (kind == "curve" and target.search.knots is not None):
        return config
    if kind == SPLINE and present.kind == "table" and target.search.knots is None:
        return config
    if kind == SPLINE and present.kind in SPATIAL:
        raise InputError(
            f"{target.source}: search.kind: a spline lies in a plane, and a channel of the kind "
            f'{present.kind} does not; take "curve"'
        )
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    body = config.backbone
    room = min(body.outer_radius) - target.limits.wall_clearance - 0.5 * target.limits.channel_diameter
    if kind in (SPLINE, "curve"):
        s = np.linspace(0.0, body.length, target.search.knots or KNOTS)
        robot = build_robot(config)
        if kind == SPLINE:
            across, name = channel_of(robot, s), "table"
        else:
            across, name = place_in_section(robot.tendon, s, body.length), kind
        routing: dict[str, Any] = {"kind": name, "knots": np.column_stack([s, across]).tolist()}
    elif kind == "parallel":
        routing = {"kind": kind, "offset": 0.5 * room}
    elif kind == "helix":
        routing = {"kind": kind, "radius": 0.5 * room, "turns": 0.5, "start_angle": 0.0}
    elif kind == "straight":
        routing = {"kind": kind, "radius": 0.5 * room, "angle": 0.0}
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
    """Offset of the channel of a robot in the plane [m] at s [m], (M,)."""
    return place_in_section(robot.tendon, s, float(robot.backbone.length))[:, 0]


@functools.lru_cache(maxsize=16)
def _intervals(space: Space, resolution: float) -> tuple[int, ...]:
    """Intervals per panel of a mesh that serves every design in the space: the most that any of a sample of
    designs asks for.
    """
    from scipy.stats import qmc

    robot = space.robot
    draws = qmc.Sobol(max(len(space.variables), 1), scramble=False).random_base2(6)
    most = np.asarray(choose_intervals(robot, resolution))
    for draw in draws:
        values = {
            v.name: v.lower + x * (v.upper - v.lower) for v, x in zip(space.variables, draw, strict=False)
        }
        for first, last in wave_ends(values):
            w1, w2 = (values.get(w, float(robot.value(w))) for w in (first, last))
            apart = 0.1 * space.config.backbone.length
            w1, w2 = min(w1, w2), max(w1, w2)
            values |= {w: x for w, x in ((first, w1), (last, max(w2, w1 + apart))) if w in values}
        many = robot.with_values(**values)
        most = np.maximum(most, choose_intervals(many, resolution))
    return tuple(int(n) for n in most)


def wave_ends(names: Iterable[str]) -> list[tuple[str, str]]:
    """The names of the two ends of every wave of which one is among some names: ("w1", "w2") or, of one of
    several tendons, ("w1.left", "w2.left").
    """
    found = dict.fromkeys(name[2:] for name in names if name.partition(".")[0] in ("w1", "w2"))
    return [(f"w1{ending}", f"w2{ending}") for ending in found]
