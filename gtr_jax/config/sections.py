"""The tables of a robot file: keys, defaults and units; those of its channels are in `routings`.

After validation they hold SI floats (m, N, Pa, rad, kg/m^3). Unit strings, defaults, missing and unknown keys
are theirs; what fits into what is in `checks`.
"""

from __future__ import annotations

import functools
import operator
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    PrivateAttr,
    StrictBool,
    StrictInt,
    StrictStr,
    Tag,
    ValidationError,
    create_model,
)

from gtr_jax.errors import InputError
from gtr_jax.terms import Term, terms_of_files
from gtr_jax.units import Unit, parse_quantity, quantity_text

from .form import one_line
from .law_section import LawSection
from .references import referenced
from .routings import ROUTINGS, RoutingConfig
from .section import (
    NOT_NEGATIVE,
    POSITIVE,
    Acceleration,
    Angle,
    BendingStiffness,
    Curvature,
    Density,
    Force,
    Length,
    Mass,
    Modulus,
    Moment,
    Ratio,
    Section,
    TermSection,
)

MOST_NOTCHES = 200  # in a row; each is a panel of the mesh

_SHARES = re.compile(r".*[\d.]\s*(|%|percent|dimensionless)\s*")


def _deviation(value: Any) -> Any:
    """A share as a number; a string with another unit as it is, until it is known of what."""
    if isinstance(value, str) and not _SHARES.fullmatch(value):
        return value.strip()
    return parse_quantity(value, "dimensionless")


Deviation = Annotated[float | str, BeforeValidator(_deviation)]


class FileSection(Section):
    """The whole of a file: knows which it was read from."""

    _source: str = PrivateAttr("file")
    _folder: Path = PrivateAttr(Path("."))

    def model_post_init(self, context: Any) -> None:
        """Note where it was read from, as the context of the validation says."""
        self._source = (context or {}).get("source", self._source)
        self._folder = Path((context or {}).get("folder", self._folder))

    @property
    def source(self) -> str:
        """The file it was read from, for messages."""
        return self._source

    @property
    def folder(self) -> Path:
        """Where the files that it names lie."""
        return self._folder

    def beside(self, name: str, key: str) -> Path:
        """The path of a file that it names under a key; InputError as of `references.referenced`."""
        return referenced(name, self._folder, f"{self._source}: {key}")

    def __eq__(self, other: object) -> bool:
        """Equal if the contents are, whichever file they came from."""
        return isinstance(other, type(self)) and self.model_dump() == other.model_dump()

    @classmethod
    def parsed(cls, data: Mapping[str, Any], *, source: str, folder: str | os.PathLike[str]) -> Self:
        """The contents of a file, checked; InputError naming source, key and remedy.

        Args:
            data: the contents.
            source: names the file in errors.
            folder: where the files lie that it names.
        """
        try:
            return cls.model_validate(data, context={"folder": folder, "source": source})
        except ValidationError as error:
            raise InputError(
                f"{source}: {one_line(error, {'routing': ROUTINGS, 'section': SECTIONS})}"
            ) from None


class BoreConfig(Section):
    """A cylinder missing from the backbone, concentric with it."""

    from_: Length = Field(alias="from", examples=["0 mm"])
    """Arc length [m] where the bore begins."""
    to: Length = Field(examples=["20 mm"])
    """Arc length [m] where the bore ends."""
    diameter: Annotated[Length, POSITIVE] = Field(examples=["14 mm"])
    """Diameter [m] of the concentric bore."""


def _pair(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value, value)


def _shape(value: Any) -> str:
    return "#pairs" if isinstance(value, list | tuple) else "#constant"


def _kind(value: Any) -> str:
    """Whether a stiffness is one number, two, or a table."""
    if not isinstance(value, list | tuple):
        return "#constant"
    return "#table" if value and isinstance(value[0], list | tuple) else "#pair"


def _row(value: Any) -> str:
    return "#two" if isinstance(value, list | tuple) and len(value) == 3 else "#one"


_StiffnessRow = Annotated[
    Annotated[tuple[Length, BendingStiffness], Tag("#one")]
    | Annotated[tuple[Length, BendingStiffness, BendingStiffness], Tag("#two")],
    Discriminator(_row),
]
_Constant = Annotated[BendingStiffness, Tag("#constant")]
_Pair = Annotated[tuple[BendingStiffness, BendingStiffness], Tag("#pair")]
AlongBody = Annotated[
    Annotated[Curvature, Tag("#constant")] | Annotated[tuple[tuple[Length, Curvature], ...], Tag("#pairs")],
    Discriminator(_shape),
]
Bending = Annotated[
    _Constant | _Pair | Annotated[tuple[_StiffnessRow, ...], Tag("#table")], Discriminator(_kind)
]
Torsion = Annotated[
    _Constant | Annotated[tuple[tuple[Length, BendingStiffness], ...], Tag("#pairs")], Discriminator(_shape)
]


class PieceConfig(Section):
    """A piece of the body that differs from the rest; what is absent is as there."""

    from_: Length = Field(alias="from", examples=["100 mm"])
    """Arc length [m] where the piece begins."""
    to: Length = Field(examples=["120 mm"])
    """Arc length [m] where it ends."""
    outer_radius: (
        Annotated[
            tuple[Length, Length],
            BeforeValidator(_pair, json_schema_input_type=Length | tuple[Length, Length]),
        ]
        | None
    ) = None
    """Outer radius [m] at its beginning and its end, linear between; one value for both."""
    youngs_modulus: Annotated[Modulus, POSITIVE] | None = None
    """Young's modulus [Pa]."""
    bending_stiffness: Annotated[_Constant | _Pair, Discriminator(_kind)] | None = None
    """EI [N m^2] instead of modulus and radius: one number, or two, about y and about z."""
    torsional_stiffness: BendingStiffness | None = None
    """GJ [N m^2]; absent: that of a round section, EI/(1 + poissons_ratio)."""


def _angles(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value,)


class NotchesConfig(Section):
    """A row of equal notches, cut into a tube from one side so that it bends there."""

    from_: Length = Field(alias="from", examples=["1.5 mm"])
    """Arc length [m] where the first begins."""
    height: Length = Field(examples=["0.5 mm"])
    """Length [m] of each along the body."""
    depth: Length = Field(examples=["1.4 mm"])
    """Depth [m] of each from the outside; more than the outer radius, less than the diameter."""
    count: Annotated[StrictInt, Field(ge=1, le=MOST_NOTCHES)] = 1
    """How many there are."""
    spacing: Annotated[Length, NOT_NEGATIVE] = 0.0
    """Uncut length [m] between two."""
    side: Literal["left", "right"] = "left"
    """Side of the body that is cut."""
    end_correction: Length = 0.0
    """Length [m] by which each bends as if it were longer than it is cut; negative where rounded corners make
    it stiffer."""
    natural_angle: Annotated[
        tuple[Angle, ...],
        BeforeValidator(_angles, json_schema_input_type=Angle | tuple[Angle, ...]),
    ] = (0.0,)
    """Angle [rad] by which each is bent without load, towards the side of the cut; one for all, or a list."""

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        """With an angle for each notch."""
        angle, count = data.get("natural_angle", 0.0), data.get("count", 1)
        each = angle if isinstance(angle, list | tuple) else (angle,)
        if len(each) == 1 and isinstance(count, int) and 0 < count <= MOST_NOTCHES:
            data["natural_angle"] = tuple(each) * count
        return data

    @property
    def ends(self) -> tuple[tuple[float, float], ...]:
        """Where each begins and ends [m]."""
        each = [self.from_ + i * (self.height + self.spacing) for i in range(self.count)]
        return tuple((start, start + self.height) for start in each)


class TubeConfig(Section):
    """A round tube that carries the load, or a rod without a hole."""

    kind: Literal["tube"]
    outer_diameter: Length = Field(examples=["2 mm"])
    """Outer diameter [m]."""
    inner_diameter: Length = 0.0
    """Inner diameter [m]; 0: a rod."""


class RingConfig(Section):
    """A round tube that carries the load, by both its diameters."""

    kind: Literal["ring"]
    outer_diameter: Length = Field(examples=["2 mm"])
    """Outer diameter [m]."""
    inner_diameter: Length = Field(examples=["1.6 mm"])
    """Inner diameter [m]."""


class RectangleConfig(Section):
    """A strip that carries the load."""

    kind: Literal["rectangle"]
    height: Length = Field(examples=["0.5 mm"])
    """Its size [m] along y, in the plane of a robot in the plane."""
    width: Length = Field(examples=["8 mm"])
    """Its size [m] along z, across that plane."""


SECTIONS = ("tube", "ring", "rectangle")
SectionShape = Annotated[TubeConfig | RingConfig | RectangleConfig, Field(discriminator="kind")]


def stiffness_by_several(body: Mapping[str, Any]) -> bool:
    """Whether several numbers give the stiffness of a body, by rows or by sections with their own, so that
    one factor on all of them is a number of its own; `body` is its table in the file.
    """
    rows = body.get("bending_stiffness")
    if isinstance(rows, list | tuple) and any(isinstance(row, list | tuple) for row in rows):
        return True
    pieces = body.get("sections")
    own = ("youngs_modulus", "bending_stiffness")
    return isinstance(pieces, list | tuple) and any(
        isinstance(piece, Mapping) and any(piece.get(key) is not None for key in own) for piece in pieces
    )


class BackboneConfig(Section):
    """The elastic body, or the sheath of fixed shape."""

    length: Length = Field(examples=["250 mm"])
    """Arc length [m] from base to tip."""
    outer_radius: Annotated[
        tuple[Length, Length], BeforeValidator(_pair, json_schema_input_type=Length | tuple[Length, Length])
    ] = Field(examples=[["20 mm", "13 mm"]])
    """Outer radius [m] at the base and at the tip, linear between; one value for both."""
    bores: tuple[BoreConfig, ...] = ()
    """Concentric bores, which do not overlap."""
    youngs_modulus: Modulus = 0.0
    """Young's modulus [Pa]; needed unless the backbone is rigid or has a bending_stiffness."""
    density: Annotated[Density, NOT_NEGATIVE] = 0.0
    """Density [kg/m^3]; needed with gravity."""
    natural_curvature: AlongBody = 0.0
    """Curvature [rad/m] of the unloaded backbone: a constant, or [s, curvature] pairs from base to tip."""
    natural_curvature_y: AlongBody = 0.0
    """Curvature [rad/m] of the unloaded backbone about y, out of the plane, positive from x towards -z: a
    constant, or [s, curvature] pairs from base to tip."""
    natural_twist: AlongBody = 0.0
    """Twist [rad/m] of the unloaded backbone about its axis, from y towards z."""
    poissons_ratio: Ratio = 0.5
    """Poisson's ratio, on which the stiffness against twist depends; no effect in the plane."""
    bending_stiffness: Bending | None = None
    """EI [N m^2] instead of youngs_modulus: one number, two (about y and about z), or rows [s, EI] or
    [s, EI_y, EI_z] from base to tip."""
    torsional_stiffness: Torsion | None = None
    """GJ [N m^2], one number or [s, GJ] pairs from base to tip; absent: that of a round section,
    EI/(1 + poissons_ratio)."""
    stiffness_factor: Annotated[Ratio, POSITIVE] | None = None
    """Factor on the stiffness of a body that several numbers give, by rows or by sections with their own; 1
    unless given."""
    section: SectionShape | None = None
    """What carries the load, where that is not all of the body within outer_radius: a tube, or a strip."""
    sections: tuple[PieceConfig, ...] = ()
    """Pieces that differ from the rest, which do not overlap."""
    notches: tuple[NotchesConfig, ...] = ()
    """Rows of notches, which do not overlap."""
    extensible: StrictBool = False
    """Whether forces along the body stretch and shorten it, by its modulus and section."""
    axial_stiffness: Annotated[Force, POSITIVE] | None = None
    """EA [N] of a body that stretches, instead of modulus and section."""
    rigid: StrictBool = False
    """Whether the backbone keeps its natural shape (a sheath), so that only friction acts."""

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        """With the factor on a stiffness that several numbers give, as a number of its own."""
        if stiffness_by_several(data) and not data.get("rigid"):
            data.setdefault("stiffness_factor", 1.0)
            data["stiffness_factor"] = 1.0 if data["stiffness_factor"] is None else data["stiffness_factor"]
        return data

    @property
    def stretches(self) -> bool:
        """Whether forces along the body stretch it."""
        return self.extensible or self.axial_stiffness is not None


class TendonConfig(Section):
    """The tendon and its friction in the channel."""

    friction_coefficient: Ratio = Field(examples=[0.36])
    """Coulomb friction coefficient between tendon and channel."""
    preload: Force = 0.0
    """Tension [N] along the whole tendon before the history begins."""
    drive: Literal["tension", "displacement"] = "tension"
    """What moves its end at the base: a tension, or how far it is pulled out."""
    to: Length | None = None
    """Arc length [m] at which it is anchored; absent: the tip."""
    guides: tuple[Length, ...] = ()
    """Arc lengths [m] of the disks that guide it, straight between them; absent: a channel all along."""
    axial_stiffness: Force | None = None
    """EA [N]; absent: it does not stretch."""
    free_length: Length = 0.0
    """Length [m] that runs free between motor and base, and stretches too."""


class OneOfSeveralTendons(TendonConfig):
    """One tendon of several, with its channel."""

    name: StrictStr = Field(examples=["left"])
    """Name, with which its columns (T_base_N.left) and parameters (mu.left) end."""
    routing: RoutingConfig = Field(examples=[{"kind": "parallel", "offset": "8 mm"}])
    """Its channel."""


def _axes(value: Any) -> str:
    return "#space" if isinstance(value, list | tuple) and len(value) >= 3 else "#plane"


def _turns(value: Any) -> str:
    return "#space" if isinstance(value, list | tuple) else "#plane"


class LoadsConfig(Section):
    """External loads on the backbone."""

    gravity_angle: Angle | None = None
    """Direction of gravity [rad] in the plane of x and y, from x (the base tangent); absent: no effect."""
    gravity: tuple[Acceleration, Acceleration, Acceleration] | None = Field(
        default=None, examples=[["0 m/s^2", "0 m/s^2", "-9.81 m/s^2"]]
    )
    """Acceleration of gravity [m/s^2] along x, y and z, instead of gravity_angle."""
    tip_force: Annotated[
        Annotated[tuple[Force, Force], Tag("#plane")] | Annotated[tuple[Force, Force, Force], Tag("#space")],
        Discriminator(_axes),
    ] = (0.0, 0.0)
    """Dead force [N] on the tip, along x (the base tangent), y (to its left) and, in space, z."""
    tip_moment: Annotated[
        Annotated[Moment, Tag("#plane")] | Annotated[tuple[Moment, Moment, Moment], Tag("#space")],
        Discriminator(_turns),
    ] = 0.0
    """Moment [N m] on the tip, anticlockwise in the plane, or about x, y and z."""
    payload: Annotated[Mass, NOT_NEGATIVE] = 0.0
    """Mass [kg] at the tip; weighs along gravity."""


class BaseConfig(Section):
    """Where the base stands in the world."""

    position: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Place [m] of the base's middle: x, y, z."""
    rotation: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Rotation vector [rad]: the axis by which the base is turned, as long as the angle; about one axis only,
    the angle stands in its place."""


class MarkerConfig(Section):
    """A point of the body that is recorded."""

    name: StrictStr = Field(examples=["m1"])
    """Name, with which its columns begin (m1_x_m)."""
    at: Length = Field(examples=["125 mm"])
    """Arc length [m] of its section."""
    offset: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Place [m] in it: along the body, to its left, across the plane."""
    angle_from: Length = 0.0
    """Arc length [m] of the section from which its section's angle (m1_angle_rad) is counted."""


def _term_section(term: Term) -> type[TermSection]:
    """The table [[terms]] of one kind of term."""
    name = "".join(part.capitalize() for part in term.id.split("-"))
    needed = term.sizes if len(term.sizes) == 1 else ()
    quantities: dict[str, Any] = {
        q.name: (
            Annotated[float, Unit(q.unit)],
            Field(
                ... if q in needed else float(q.null),
                examples=[quantity_text(float(q.typical), q.unit)],
                description=q.says,
            ),
        )
        for q in term.numbers
    }
    kind: Any = (Literal[term.id], Field(description=term.says))
    return create_model(name, __base__=TermSection, __doc__=term.says, kind=kind, **quantities)


if TYPE_CHECKING:
    TermConfig = TermSection
else:
    TermConfig = Annotated[
        functools.reduce(operator.or_, [*map(_term_section, terms_of_files()), LawSection]),
        Field(discriminator="kind"),
    ]
