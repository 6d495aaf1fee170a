"""The tables [routing] of a robot file: one for each kind of channel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, StrictStr

from gtr_jax.errors import InputError

from .references import referenced
from .section import Angle, Length, Ratio, Section
from .toml_file import read_route


class PlanarChannel(Section):
    """A channel in a plane through the axis."""

    plane_angle: Angle = 0.0
    """Angle [rad] by which its plane is turned about the axis, from the plane of x and y towards z."""


class StraightSineStraight(PlanarChannel):
    """The paper's eq. (21): offset r1 up to w1, a half cosine, offset r2 from w2 on."""

    kind: Literal["straight-sine-straight"]
    r1: Length = Field(examples=["-10 mm"])
    """Offset [m] at the base."""
    r2: Length = Field(examples=["10 mm"])
    """Offset [m] at the tip."""
    w1: Length = Field(examples=["20 mm"])
    """Arc length [m] where the channel leaves the first straight."""
    w2: Length = Field(examples=["80 mm"])
    """Arc length [m] where it joins the second straight."""


class ConvergingSine(PlanarChannel):
    """The paper's eq. (19): a sine superposed on an offset that converges from base to tip."""

    kind: Literal["converging-sine"]
    R_max: Length = Field(examples=["15 mm"])
    """Mean offset [m] at the base."""
    r_min: Length = Field(examples=["7.5 mm"])
    """Mean offset [m] at the tip."""
    n_sine: Ratio = Field(examples=[10])
    """Number of half waves along the backbone."""
    sigma: Ratio = Field(examples=[0.1])
    """Amplitude of the sine, relative to the mean offset."""


class CrossingSine(PlanarChannel):
    """The paper's eq. (20): a sine that crosses the axis, its amplitude converging from base to tip."""

    kind: Literal["crossing-sine"]
    R_max: Length = Field(examples=["20 mm"])
    """Amplitude [m] at the base."""
    r_min: Length = Field(examples=["8 mm"])
    """Amplitude [m] at the tip."""
    n_sine: Ratio = Field(examples=[5])
    """Number of half waves along the backbone."""


class Parallel(PlanarChannel):
    """A channel at a constant offset."""

    kind: Literal["parallel"]
    offset: Length = Field(examples=["10 mm"])
    """Offset [m]."""


def _either_knots_or_file(schema: dict[str, Any]) -> None:
    schema["required"] = ["kind"]
    schema["oneOf"] = [{"required": ["knots"]}, {"required": ["file"]}]


class TableRouting(PlanarChannel):
    """A channel given by knots, in the file itself or in a CSV file with the columns s_mm, R_mm."""

    model_config = ConfigDict(json_schema_extra=_either_knots_or_file)

    kind: Literal["table"]
    knots: tuple[tuple[Length, Length], ...] = Field(examples=[[["0 mm", "10 mm"], ["250 mm", "8 mm"]]])
    """Pairs [s, R] of arc length and offset [m], in increasing s, covering the backbone."""
    file: StrictStr | None = None
    """CSV file of the knots, or DXF drawing of the channel in the unloaded body, relative to the robot file;
    None once it is read into `knots`."""
    layer: StrictStr | None = None
    """Layer of the drawing on which the channel is; absent: the only one with lines."""
    unit: StrictStr | None = None
    """Unit of a drawing whose header says none."""

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        return _with_knots(data, folder, ("s", "R"))


class Helix(Section):
    """A channel that winds about the axis."""

    kind: Literal["helix"]
    radius: Length = Field(examples=["8 mm"])
    """Distance [m] from the axis at the base."""
    turns: Ratio = Field(examples=[1.25])
    """Turns about the axis from base to tip, from y towards z; negative the other way."""
    start_angle: Angle = 0.0
    """Angle [rad] about the axis at the base, from y towards z."""
    tip_radius: Length | None = None
    """Distance [m] from the axis at the tip, linear between; absent: as at the base."""


class Straight(Section):
    """A channel parallel to the axis, anywhere in the section."""

    kind: Literal["straight"]
    radius: Length = Field(examples=["8 mm"])
    """Distance [m] from the axis."""
    angle: Angle = Field(examples=["120 deg"])
    """Angle [rad] about the axis, from y towards z."""


class CurveRouting(Section):
    """A channel given by knots in space, in the file itself or in a CSV file with the columns s_mm, y_mm,
    z_mm.
    """

    model_config = ConfigDict(json_schema_extra=_either_knots_or_file)

    kind: Literal["curve"]
    knots: tuple[tuple[Length, Length, Length], ...] = Field(
        examples=[[["0 mm", "8 mm", "0 mm"], ["250 mm", "0 mm", "8 mm"]]]
    )
    """Triples [s, y, z] of arc length and offsets [m], in increasing s, covering the backbone."""
    file: StrictStr | None = None
    """CSV file of the knots, or DXF drawing of the channel in the unloaded body, relative to the robot file;
    None once it is read into `knots`."""
    layer: StrictStr | None = None
    """Layer of the drawing on which the channel is; absent: the only one with lines."""
    unit: StrictStr | None = None
    """Unit of a drawing whose header says none."""

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        return _with_knots(data, folder, ("s", "y", "z"))


def _with_knots(data: dict[str, Any], folder: Path, columns: Sequence[str]) -> dict[str, Any]:
    """The table with the knots of the CSV file that it names put in place."""
    file = data.get("file")
    for key in ("layer", "unit"):
        if data.get(key) is not None and not str(file).lower().endswith(".dxf"):
            raise InputError(
                f"{key}: has no effect without the DXF drawing of a channel as 'file'; remove it"
            )
    if file is None:
        return data
    if "knots" in data:
        raise InputError("has both 'knots' and 'file'; remove one of the two")
    if str(file).lower().endswith(".dxf"):
        raise InputError("file: a drawing is read for a whole robot; correct the body first")
    if not isinstance(file, str):
        raise InputError(f"file: expected the name of a CSV file, found {file!r}")
    return {**data, "file": None, "knots": read_route(referenced(file, folder, "file"), columns)}


ROUTINGS = {
    "straight-sine-straight": StraightSineStraight,
    "converging-sine": ConvergingSine,
    "crossing-sine": CrossingSine,
    "parallel": Parallel,
    "table": TableRouting,
    "helix": Helix,
    "straight": Straight,
    "curve": CurveRouting,
}
SPATIAL = ("helix", "straight", "curve")
RoutingConfig = Annotated[
    StraightSineStraight
    | ConvergingSine
    | CrossingSine
    | Parallel
    | TableRouting
    | Helix
    | Straight
    | CurveRouting,
    Field(discriminator="kind"),
]
