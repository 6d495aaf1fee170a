"""The tables of a robot file: keys, defaults and units.

After validation they hold SI floats (m, N, Pa, rad, kg/m^3). Unit strings, defaults, missing and unknown keys
are theirs; what fits into what is in `config_checks`.
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
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    StrictBool,
    StrictStr,
    Tag,
    ValidationError,
    ValidationInfo,
    create_model,
    model_validator,
)

from gtr_jax.errors import InputError
from gtr_jax.terms import REGISTRY, Term

from .config_file import read_route
from .config_form import check_keys, one_line
from .units import Unit, parse_quantity, quantity_text

Length = Annotated[float, Unit("m")]
Angle = Annotated[float, Unit("rad")]
Curvature = Annotated[float, Unit("rad/m")]
Modulus = Annotated[float, Unit("Pa")]
Density = Annotated[float, Unit("kg/m^3")]
Force = Annotated[float, Unit("N")]
Moment = Annotated[float, Unit("N m")]
Mass = Annotated[float, Unit("kg")]
Ratio = Annotated[float, Unit("dimensionless")]


_SHARES = re.compile(r".*[\d.]\s*(|%|percent|dimensionless)\s*")


def _deviation(value: Any) -> Any:
    """A share as a number; a string with another unit as it is, until it is known of what."""
    if isinstance(value, str) and not _SHARES.fullmatch(value):
        return value.strip()
    return parse_quantity(value, "dimensionless")


Deviation = Annotated[float | str, BeforeValidator(_deviation)]


class Section(BaseModel):
    """One table of the robot file; unknown keys are refused with the nearest valid name.

    What stands below a key says what it is, and becomes its description in the JSON Schema (`schema`).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _keys(cls, data: Any, info: ValidationInfo) -> Any:
        if isinstance(data, Mapping):
            data = cls._resolved(dict(data), Path((info.context or {}).get("folder", ".")))
        check_keys(cls, data)
        return data

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        """The section with what it refers to in other files, relative to `folder`, put in place."""
        return data


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
            raise InputError(f"{source}: {one_line(error, ROUTINGS)}") from None


class BoreConfig(Section):
    """A cylinder missing from the backbone, concentric with it."""

    from_: Length = Field(alias="from", examples=["0 mm"])
    """Arc length [m] where the bore begins."""
    to: Length = Field(examples=["20 mm"])
    """Arc length [m] where the bore ends."""
    diameter: Length = Field(examples=["14 mm"])
    """Diameter [m] of the concentric bore."""


def _pair(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else (value, value)


def _shape(value: Any) -> str:
    return "#pairs" if isinstance(value, list | tuple) else "#constant"


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
    """Young's modulus [Pa]; needed unless the backbone is rigid."""
    density: Density = 0.0
    """Density [kg/m^3]; needed with loads.gravity_angle."""
    natural_curvature: Annotated[
        Annotated[Curvature, Tag("#constant")]
        | Annotated[tuple[tuple[Length, Curvature], ...], Tag("#pairs")],
        Discriminator(_shape),
    ] = 0.0
    """Curvature [rad/m] of the unloaded backbone: a constant, or [s, curvature] pairs from base to tip."""
    rigid: StrictBool = False
    """Whether the backbone keeps its natural shape (a sheath), so that only friction acts."""


class StraightSineStraight(Section):
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


class ConvergingSine(Section):
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


class CrossingSine(Section):
    """The paper's eq. (20): a sine that crosses the axis, its amplitude converging from base to tip."""

    kind: Literal["crossing-sine"]
    R_max: Length = Field(examples=["20 mm"])
    """Amplitude [m] at the base."""
    r_min: Length = Field(examples=["8 mm"])
    """Amplitude [m] at the tip."""
    n_sine: Ratio = Field(examples=[5])
    """Number of half waves along the backbone."""


class Parallel(Section):
    """A channel at a constant offset."""

    kind: Literal["parallel"]
    offset: Length = Field(examples=["10 mm"])
    """Offset [m]."""


def _either_knots_or_file(schema: dict[str, Any]) -> None:
    schema["required"] = ["kind"]
    schema["oneOf"] = [{"required": ["knots"]}, {"required": ["file"]}]


class TableRouting(Section):
    """A channel given by knots, in the file itself or in a CSV file with the columns s_mm, R_mm."""

    model_config = ConfigDict(json_schema_extra=_either_knots_or_file)

    kind: Literal["table"]
    knots: tuple[tuple[Length, Length], ...] = Field(examples=[[["0 mm", "10 mm"], ["250 mm", "8 mm"]]])
    """Pairs [s, R] of arc length and offset [m], in increasing s, covering the backbone."""
    file: StrictStr | None = None
    """CSV file of the knots, relative to the robot file; None once it is read into `knots`."""

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        file = data.get("file")
        if file is None:
            return data
        if "knots" in data:
            raise InputError("has both 'knots' and 'file'; remove one of the two")
        if not isinstance(file, str):
            raise InputError(f"file: expected the name of a CSV file, found {file!r}")
        return {**data, "file": None, "knots": read_route(folder / file)}


ROUTINGS = {
    "straight-sine-straight": StraightSineStraight,
    "converging-sine": ConvergingSine,
    "crossing-sine": CrossingSine,
    "parallel": Parallel,
    "table": TableRouting,
}
RoutingConfig = Annotated[
    StraightSineStraight | ConvergingSine | CrossingSine | Parallel | TableRouting,
    Field(discriminator="kind"),
]


class TendonConfig(Section):
    """The tendon and its friction in the channel."""

    friction_coefficient: Ratio = Field(examples=[0.36])
    """Coulomb friction coefficient between tendon and channel."""
    preload: Force = 0.0
    """Tension [N] along the whole tendon before the history begins."""


class OneOfSeveralTendons(TendonConfig):
    """One tendon of several, with its channel."""

    name: StrictStr = Field(examples=["left"])
    """Name, with which its columns (T_base_N.left) and parameters (mu.left) end."""
    routing: RoutingConfig = Field(examples=[{"kind": "parallel", "offset": "8 mm"}])
    """Its channel."""


class LoadsConfig(Section):
    """External loads on the backbone."""

    gravity_angle: Angle | None = None
    """Direction of gravity [rad] in the bending plane, from the base tangent; absent: no effect."""
    tip_force: tuple[Force, Force] = (0.0, 0.0)
    """Dead force [N] on the tip, along x (the base tangent) and y (to its left)."""
    tip_moment: Moment = 0.0
    """Moment [N m] on the tip, anticlockwise."""
    payload: Mass = 0.0
    """Mass [kg] at the tip; weighs along gravity."""


class TermSection(Section):
    """One physics term; see `gtr_jax.terms`."""

    kind: str


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
        for q in term.quantities
    }
    kind: Any = (Literal[term.id], Field(description=term.says))
    return create_model(name, __base__=TermSection, __doc__=term.says, kind=kind, **quantities)


if TYPE_CHECKING:
    TermConfig = TermSection
else:
    TermConfig = Annotated[
        functools.reduce(operator.or_, map(_term_section, REGISTRY.values())), Field(discriminator="kind")
    ]
