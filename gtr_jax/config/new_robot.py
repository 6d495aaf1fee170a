"""A robot file from a few answers: what each kind of channel asks for, likely values, and the whole."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

from gtr_jax.units import display_of

from .routings import ROUTINGS, SPATIAL

# Directions of gravity in the axes of the base: x along the base tangent, y to its left, z out of the plane.
DIRECTIONS = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
_ANGLES = {"+x": "0 deg", "-x": "180 deg", "+y": "90 deg", "-y": "-90 deg"}
# Keys of a channel that are read from a CSV file, and the key that names it.
KNOTS, FILE = "knots", "file"
# Likely values of a channel's numbers, and what they are: lengths along the body and from its axis, as shares
# of its length and of its least radius, numbers without unit, and angles about the axis.
_ALONG = {
    "w1": (0.1, "arc length where the channel leaves its first straight"),
    "w2": (0.35, "arc length where it joins its second straight"),
}
_ACROSS = {
    "offset": (0.6, "offset from the axis, positive to the left"),
    "r1": (-0.6, "offset at the base, positive to the left"),
    "r2": (0.6, "offset at the tip"),
    "R_max": (0.6, "largest offset, at the base"),
    "r_min": (0.4, "largest offset, at the tip"),
    "radius": (0.6, "distance from the axis"),
}
_PURE = {
    "n_sine": (4.0, "half waves along the body"),
    "sigma": (0.1, "amplitude of the wave, relative to the offset"),
    "turns": (0.5, "turns about the axis from base to tip"),
}
_ABOUT = {
    "angle": "angle about the axis, from y towards z",
    "start_angle": "angle about the axis at the base",
}
_DIGITS = 3


@dataclasses.dataclass(frozen=True)
class Ask:
    """A number that a channel asks for.

    Attributes:
        key: in the robot file.
        says: what it is.
        unit: SI unit, "dimensionless" if it has none; "" for the name of a file.
        default: a likely value, as people write it; None where there is none.
    """

    key: str
    says: str
    unit: str
    default: str | None


def kinds(*, space: bool) -> list[str]:
    """Kinds of channels for a robot that leaves its plane, or that stays in it, the simplest first."""
    planar = [kind for kind in ROUTINGS if kind not in SPATIAL]
    planar.sort(key=lambda kind: kind != "parallel")
    return ["straight", *(kind for kind in SPATIAL if kind != "straight")] if space else planar


def asks(kind: str, *, length: float, radius: float, tendon: int = 0, of: int = 1) -> list[Ask]:
    """The numbers that a kind of channel asks for.

    Args:
        kind: of the channel.
        length, radius: of the body, its least radius [m].
        tendon, of: number of the tendon, from 0, and how many there are: they share the section evenly.
    """
    turned, side = 2 * math.pi * tendon / of, -1.0 if tendon % 2 else 1.0
    found = []
    for key, field in ROUTINGS[kind].model_fields.items():
        if key == "kind" or not (field.is_required() or key in _ABOUT):
            continue
        if key == KNOTS:
            found.append(Ask(FILE, "CSV file of the knots", "", None))
        elif key in _PURE:
            value, says = _PURE[key]
            found.append(Ask(key, says, "dimensionless", f"{value:g}"))
        elif key in _ABOUT:
            found.append(Ask(key, _ABOUT[key], "rad", _text(turned, "rad")))
        else:
            share, says = _ALONG.get(key) or _ACROSS[key]
            size = share * length if key in _ALONG else share * radius * (1.0 if key == "radius" else side)
            found.append(Ask(key, says, "m", _text(size, "m")))
    return found


def robot_data(
    *,
    name: str,
    backbone: Mapping[str, Any],
    channels: Sequence[Mapping[str, Any]],
    tendons: Sequence[str],
    friction: float,
    drive: str,
    gravity: str,
    strength: float,
    space: bool,
    uncertainty: Mapping[str, Any],
) -> dict[str, Any]:
    """The contents of a robot file, unchecked.

    Args:
        name: of the robot.
        backbone: table of the body.
        channels: table of the channel of each tendon.
        tendons: names of several tendons; none for one.
        friction: coefficient of all of them.
        drive: what moves their ends, "tension" or "displacement".
        gravity: one of `DIRECTIONS`, or "none".
        strength: of gravity [m/s^2].
        space: whether the robot may leave its plane.
        uncertainty: standard deviations, by dotted key.
    """
    string = {"friction_coefficient": friction, "drive": drive}
    data: dict[str, Any] = {"schema": 1, "name": name, "backbone": dict(backbone)}
    if tendons:
        each = zip(tendons, channels, strict=True)
        data["tendons"] = [{"name": own, **string, "routing": dict(channel)} for own, channel in each]
    else:
        data |= {"routing": dict(channels[0]), "tendon": string}
    if gravity in _ANGLES and not space:
        data["loads"] = {"gravity_angle": _ANGLES[gravity]}
    elif gravity != "none":
        data["loads"] = {"gravity": [strength * part for part in DIRECTIONS[gravity]]}
    if uncertainty:
        data["uncertainty"] = dict(uncertainty)
    return data


def columns_of(
    tendons: Sequence[str], *, drive: str, rigid: bool, space: bool
) -> tuple[list[str], list[str]]:
    """Headers of the columns that a recording of a robot needs, and of those that it may have besides.

    Args:
        tendons, drive, space: as of `robot_data`.
        rigid: whether the body keeps its shape.
    """
    endings = [f".{name}" for name in tendons] or [""]
    driven = "displacement_m" if drive == "displacement" else "T_base_N"
    needed = ["time_s", *(f"{header}{end}" for header in (driven, "T_tip_N") for end in endings)]
    if rigid:
        return needed, []
    pose = ["tip_x_m", "tip_y_m", *(["tip_z_m"] if space else ["tip_angle_rad"])]
    beside = "T_base_N" if drive == "displacement" else "displacement_m"
    return needed, [*pose, *(f"{beside}{end}" for end in endings)]


def _text(value: float, unit: str) -> str:
    """A likely value as people write it, to few digits."""
    display, size = display_of(unit)
    return f"{value / size:.{_DIGITS}g} {display}"
