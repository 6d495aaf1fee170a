"""The quantities of a recording: their units, the headers they are written under, and their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple


class Column(NamedTuple):
    """One quantity of a recording: its SI unit, the header it is written under, and other spellings."""

    unit: str
    header: str
    spellings: frozenset[str]


# Spellings are compared in lower case without spaces, dots, underscores and hyphens.
COLUMNS = {
    "time": Column("s", "time_s", frozenset({"time", "t", "timestamp"})),
    "T_base": Column("N", "T_base_N", frozenset({"tbase", "basetension", "tensionbase", "tproximal"})),
    "T_tip": Column("N", "T_tip_N", frozenset({"ttip", "tiptension", "tensiontip", "tdistal"})),
    "tip_x": Column("m", "tip_x_m", frozenset({"tipx", "xtip"})),
    "tip_y": Column("m", "tip_y_m", frozenset({"tipy", "ytip"})),
    "tip_z": Column("m", "tip_z_m", frozenset({"tipz", "ztip"})),
    "tip_angle": Column("rad", "tip_angle_rad", frozenset({"tipangle", "angletip", "phitip"})),
    "tip_qx": Column("dimensionless", "tip_qx", frozenset({"tipqx", "qxtip"})),
    "tip_qy": Column("dimensionless", "tip_qy", frozenset({"tipqy", "qytip"})),
    "tip_qz": Column("dimensionless", "tip_qz", frozenset({"tipqz", "qztip"})),
    "tip_qw": Column("dimensionless", "tip_qw", frozenset({"tipqw", "qwtip"})),
    "displacement": Column("m", "displacement_m", frozenset({"displacement", "tendondisplacement"})),
    "trial": Column("dimensionless", "trial", frozenset({"trial"})),
}
NEEDED = ("T_base", "T_tip")
PER_TENDON = ("T_base", "T_tip", "displacement")
DRIVES = ("T_base", "displacement")  # one of which moves a tendon
QUATERNION = ("tip_qx", "tip_qy", "tip_qz", "tip_qw")
# The quantity that each spelling means.
SPELLINGS = {spelling: name for name, column in COLUMNS.items() for spelling in column.spellings}
IN_SPACE = ("tip_z", *QUATERNION)
AXES = ("x", "y", "z")
ANGLE = "angle"  # of a marker's section
# Units known as a header's ending, as in T_base_gf; in brackets, as in Tbase [gf], any unit is known.
_HEADER_ENDINGS = {
    "s": ("s", "ms", "us", "min"),
    "N": ("N", "mN", "kN", "gf", "kgf", "lbf"),
    "m": ("m", "mm", "cm", "um"),
    "rad": ("rad", "mrad", "deg"),
}


def plain_name(name: str) -> str:
    """A name as spellings are compared: in lower case, without blanks, dots, underscores and hyphens."""
    return re.sub(r"[\s._-]", "", name).lower()


def split_unit(header: str, si: str) -> tuple[str, str | None]:
    """Part a header into name and unit: "Tbase [gf]", "Tbase (gf)" or "T_base_gf"; None without a unit."""
    bracketed = re.fullmatch(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]", header)
    if bracketed:
        return bracketed[1], bracketed[2].strip() or None
    name, _, ending = header.replace(" ", "_").rpartition("_")
    return (name, ending) if name and ending in _HEADER_ENDINGS.get(si, ()) else (header, None)


def quantities_of(
    tendons: Sequence[str], *, markers: Sequence[str] = (), space: bool = False
) -> dict[str, tuple[str, str]]:
    """What may be read: the quantity and the tendon ("" for none) under each name, such as "T_base.left".

    Args:
        tendons: names of several tendons.
        markers: names of the markers of the robot.
        space: whether the robot may leave its plane.
    """
    wanted = {}
    for quantity in COLUMNS:
        if quantity in IN_SPACE and not space:
            continue
        names = tendons if quantity in PER_TENDON and tendons else ("",)
        wanted |= {f"{quantity}.{name}" if name else quantity: (quantity, name) for name in names}
    return wanted | {quantity: (quantity, "") for name in markers for quantity in marker_quantities(name)}


def column_of(quantity: str) -> Column:
    """The column of a quantity; one that is not in COLUMNS is a place of a marker, or its section's angle."""
    if quantity in COLUMNS:
        return COLUMNS[quantity]
    unit = "rad" if quantity.endswith(f"_{ANGLE}") else "m"
    return Column(unit, f"{quantity}_{unit}", frozenset({plain_name(quantity)}))


def with_tendon(name: str, tendon: str) -> str:
    """The name of a tendon's quantity, "T_base.left"; the quantity's own where there is one tendon."""
    return f"{name}.{tendon}" if tendon else name


def of_tendon(header: str, tendon: str) -> str | None:
    """The header without the name of a tendon ("T_base_N" of "T_base_N.left"); None if it has another."""
    if not tendon:
        return header
    found = re.fullmatch(rf"(.*?)\.{re.escape(tendon)}(\s*[\[(].*)?", header)
    return f"{found[1]}{found[2] or ''}" if found else None


def marker_quantities(name: str, *, space: bool = True) -> tuple[str, ...]:
    """The quantities of a marker: its place m1_x, m1_y and, in space, m1_z, and the angle of its section,
    m1_angle.
    """
    return tuple(f"{name}_{end}" for end in (*(AXES if space else AXES[:2]), ANGLE))
