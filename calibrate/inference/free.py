"""Which numbers are free, and which recordings each of them belongs to."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from gtr_jax import InputError, Robot, RobotConfig, parameters_of
from gtr_jax.config.checks import refused_for_section
from gtr_jax.robot.parameters import Parameter, parameter, parameters_listed

# Values in two robot files that differ by less than this, relative, count as equal.
SAME = 1e-9


@dataclasses.dataclass(frozen=True)
class Free:
    """One free number.

    Attributes:
        entry: the robots' parameter.
        name: its name in answers: the parameter's; where each recording or robot has its own, followed by @
            and the recording's or robot's name.
        parts: recordings it belongs to, by number.
        initial: its value in the robot file, SI.
        prior: its standard deviation by the robot file, SI; None if the file states none.
        carried: whether it was not requested but is fitted too, with a prior, because the robot file calls it
            uncertain; its uncertainty thus enters that of the others.
    """

    entry: Parameter
    name: str
    parts: tuple[int, ...]
    initial: float
    prior: float | None
    carried: bool = False


def _has(robot: Robot, name: str) -> bool:
    known = parameters_of(robot)
    return name in known or any(p.key == name for p in known.values())


def _short(robots: Sequence[Robot], name: str) -> str:
    """The short name of a parameter that some robot has; InputError if none has it."""
    owner = next((robot for robot in robots if _has(robot, name)), robots[0])
    return parameter(owner, name).name


def _prior(config: RobotConfig | None, entry: Parameter) -> float | None:
    return None if config is None else config.deviation(entry.key)


def _check_section(config: RobotConfig | None, entry: Parameter) -> None:
    """InputError if the number is of a physics term that the body's section cannot have."""
    if config is None or entry.term is None:
        return
    fault = refused_for_section(config.backbone, entry.term)
    if fault:
        raise InputError(f"{config.source}: terms.{entry.term.id}: {fault}")


def free_of(
    robots: Sequence[Robot],
    configs: Sequence[RobotConfig | None],
    robot_of_part: Sequence[int],
    part_names: Sequence[str],
    robot_names: Sequence[str],
    free: Sequence[str],
    per_recording: Sequence[str] = (),
    per_robot: Sequence[str] = (),
) -> list[Free]:
    """The free numbers of one or more recordings of one or more robots.

    A parameter is shared by all recordings of the robots that have it, unless each recording or each robot is
    to have its own.

    Args:
        robots, configs: the robots, and their files if given.
        robot_of_part: robot of each recording.
        part_names, robot_names: distinct names of the recordings and robots.
        free: parameters, by short name or key.
        per_recording, per_robot: parameters of which each has its own value; they need not be listed in
            `free`.

    Raises:
        InputError: no robot has the parameter, or its section cannot, one is named twice, or it is shared and
            the robots' files disagree about it.
    """
    scopes: dict[str, str] = {}
    for short in (_short(robots, name) for name in free):
        if short in scopes:
            raise InputError(f"parameter '{short}' is named twice; remove one")
        scopes[short] = ""
    for scope, names in (("recording", per_recording), ("robot", per_robot)):
        for short in (_short(robots, name) for name in names):
            if scopes.get(short):
                raise InputError(f"parameter '{short}' is named in two of the scopes; remove one")
            scopes[short] = scope
    if not scopes:
        raise InputError(f"no parameter is free; name some; {parameters_listed(robots[0])}")
    found: list[Free] = []
    for name, scope in scopes.items():
        owners = [r for r, robot in enumerate(robots) if _has(robot, name)]
        entry = parameter(robots[owners[0]], name)
        parts = [k for k, r in enumerate(robot_of_part) if r in owners]
        groups: dict[str, list[int]] = {}
        for k in parts:
            if scope == "recording" and len(robot_of_part) > 1:
                ending = f"@{part_names[k]}"
            elif scope == "robot" and len(robots) > 1:
                ending = f"@{robot_names[robot_of_part[k]]}"
            else:
                ending = ""
            groups.setdefault(ending, []).append(k)
        for ending, members in groups.items():
            of = sorted({robot_of_part[k] for k in members})
            for r in of:
                _check_section(configs[r], entry)
            values = [float(robots[r].value(entry.name)) for r in of]
            priors = [_prior(configs[r], entry) for r in of]
            _agree(entry, [_file(configs[r], robot_names[r]) for r in of], values, priors)
            found.append(
                Free(
                    entry=entry,
                    name=entry.name + ending,
                    parts=tuple(members),
                    initial=_start(entry, values[0]),
                    prior=priors[0],
                )
            )
    return found


def carried_by(
    robots: Sequence[Robot],
    configs: Sequence[RobotConfig | None],
    robot_of_part: Sequence[int],
    robot_names: Sequence[str],
    free: Sequence[Free],
) -> list[Free]:
    """The numbers that robot files call uncertain and that are free in no recording of that robot.

    Args:
        robots, configs: the robots, and their files if given.
        robot_of_part: robot of each recording.
        robot_names: distinct names of the robots.
        free: what is free, from `free_of`.

    Returns:
        One for each robot and number. A force is left out where the robot carries no external load, because
        it acts on nothing there; so is a relative uncertainty of a number that is zero.
    """
    found = []
    for r, (robot, config) in enumerate(zip(robots, configs, strict=True)):
        if config is None or not config.uncertainty:
            continue
        parts = tuple(k for k, own in enumerate(robot_of_part) if own == r)
        for entry in parameters_of(robot).values():
            prior = _prior(config, entry)
            taken = {k for f in free if f.entry.name == entry.name for k in f.parts}
            if not prior or taken & set(parts) or (entry.external and not robot.loaded):
                continue
            name = entry.name if len(robots) == 1 else f"{entry.name}@{robot_names[r]}"
            found.append(
                Free(
                    entry=entry,
                    name=name,
                    parts=parts,
                    initial=float(robot.value(entry.name)),
                    prior=prior,
                    carried=True,
                )
            )
    return found


def _start(entry: Parameter, value: float) -> float:
    """Where a fit starts: the value, but a typical one for the size of a physics term that is absent, and the
    middle of the usual ones for a number that typically is zero: at zero nothing may depend on it.
    """
    term = entry.term
    if term is None or value != 0.0 or entry.lower != 0.0:
        return value
    own = next(q for q in term.quantities if entry.name == f"{term.id}.{q.name}")
    return own.typical or 0.5 * sum(own.usual)


def _file(config: RobotConfig | None, name: str) -> str:
    return name if config is None else config.source


def _agree(entry: Parameter, names: list[str], values: list[float], priors: list[float | None]) -> None:
    """Refuse a shared parameter about which robot files disagree."""
    for what, each in (("is", values), ("has the uncertainty", priors)):
        first = each[0]
        for name, other in zip(names, each, strict=True):
            same = first == other
            if isinstance(first, float) and isinstance(other, float):
                same = abs(first - other) <= SAME * max(abs(first), abs(other))
            if not same:
                words = [
                    f"{v:.6g} {entry.unit}".rstrip() if v is not None else "none" for v in (first, other)
                ]
                raise InputError(
                    f"{entry.name} is shared, but {what} {words[0]} in {names[0]} and {words[1]} in {name}; "
                    "make them equal, or let each have its own with --per-robot "
                    f"{entry.name} (per_robot=)"
                )


def distinct(names: Sequence[str]) -> list[str]:
    """The names, told apart by a number where several are the same."""
    out: list[str] = []
    for name in names:
        count, new = 1, name
        while new in out:
            count += 1
            new = f"{name}-{count}"
        out.append(new)
    return out
