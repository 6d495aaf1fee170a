"""The robot file: `robot.toml` read, checked and written.

The classes below are the file's sections; after validation they hold SI floats (m, N, Pa, rad, kg/m^3). Unit
strings, defaults, missing and unknown keys are theirs, what fits into what is in `config_checks`.

`python -m gtr_jax.config` writes the JSON Schema, generated from the same classes, to docs/robot.schema.json.
"""

from __future__ import annotations

import functools
import json
import operator
import os
import re
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

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

from gtr_jax.config_checks import check_keys, check_robot, check_strings, check_terms, one_line
from gtr_jax.config_file import dotted, find_key, place_of, read_route, read_toml
from gtr_jax.errors import InputError
from gtr_jax.recording import write_whole
from gtr_jax.terms import REGISTRY, Term, null_values
from gtr_jax.units import DIMENSIONS, Unit, parse_quantity, quantity_text, to_si

Length = Annotated[float, Unit("m")]
Angle = Annotated[float, Unit("rad")]
Curvature = Annotated[float, Unit("rad/m")]
Modulus = Annotated[float, Unit("Pa")]
Density = Annotated[float, Unit("kg/m^3")]
Force = Annotated[float, Unit("N")]
Moment = Annotated[float, Unit("N m")]
Mass = Annotated[float, Unit("kg")]
Ratio = Annotated[float, Unit("dimensionless")]


# Columns of a comment in a robot file.
NOTE_WIDTH = 110

_SHARES = re.compile(r".*[\d.]\s*(|%|percent|dimensionless)\s*")


def _deviation(value: Any) -> Any:
    """A share as a number; a string with another unit as it is, until it is known of what."""
    if isinstance(value, str) and not _SHARES.fullmatch(value):
        return value.strip()
    return parse_quantity(value, "dimensionless")


# Names by which people call the two numbers that are fitted most.
_SHORT = {"mu": "friction_coefficient", "E": "youngs_modulus"}
Deviation = Annotated[float | str, BeforeValidator(_deviation)]


class Section(BaseModel):
    """One table of the robot file; unknown keys are refused with the nearest valid name."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

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


def _one_tendon_or_several(schema: dict[str, Any]) -> None:
    schema["oneOf"] = [{"required": ["routing", "tendon"]}, {"required": ["tendons"]}]


class RobotConfig(Section):
    """A robot as its file describes it, in SI units."""

    model_config = ConfigDict(title="robot.toml of gtr-jax", json_schema_extra=_one_tendon_or_several)

    schema_version: Literal[1] = Field(alias="schema", examples=[1])
    """Version of the file format."""
    name: StrictStr = "robot"
    """Name in reports."""
    backbone: BackboneConfig
    if TYPE_CHECKING:  # so that whoever knows that a robot has one tendon need not say so again
        routing: RoutingConfig
        tendon: TendonConfig
    else:
        routing: RoutingConfig | None = None
        """The channel of a robot with one tendon; of several each has its own."""
        tendon: TendonConfig | None = None
        """The tendon of a robot with one; None where `tendons` has several."""
    tendons: tuple[OneOfSeveralTendons, ...] = ()
    """The tendons of a robot with several, instead of routing and tendon."""
    loads: LoadsConfig = LoadsConfig()
    uncertainty: dict[str, Deviation] = Field(default_factory=dict)
    """Prior knowledge of numbers of the robot ("youngs_modulus"): one standard deviation, relative or with a
    unit."""
    terms: tuple[TermConfig, ...] = ()
    """Physics beyond the paper, each term once."""
    _source: str = PrivateAttr("robot")

    @property
    def source(self) -> str:
        """The file this robot was read from, for messages."""
        return self._source

    def __eq__(self, other: object) -> bool:
        """Equal if the numbers are, whichever file they came from."""
        return isinstance(other, RobotConfig) and self.model_dump() == other.model_dump()

    @classmethod
    def _resolved(cls, data: dict[str, Any], folder: Path) -> dict[str, Any]:
        check_terms(data, REGISTRY)
        check_strings(data)
        return data

    @property
    def strung(self) -> tuple[tuple[str, TendonConfig, Any], ...]:
        """Name (of an only one: ""), tendon and routing of every tendon, in the order of the file."""
        if not self.tendons:
            return (("", self.tendon, self.routing),)
        return tuple((tendon.name, tendon, tendon.routing) for tendon in self.tendons)

    @property
    def tendon_names(self) -> tuple[str, ...]:
        """Names of several tendons; empty for one."""
        return tuple(tendon.name for tendon in self.tendons)

    @model_validator(mode="after")
    def _check(self) -> RobotConfig:
        check_robot(self)
        resolved: dict[str, float | str] = {}
        for key, deviation in self.uncertainty.items():
            path = find_key(_SHORT.get(key, key), self.numbers(), "uncertainty")
            size = deviation
            if isinstance(size, str):
                size = to_si(size, self._unit_of(path), f"uncertainty.{key}")
            if size <= 0:
                raise InputError(
                    f"uncertainty.{key}: must be positive, is {deviation}; remove it if known exactly"
                )
            if path in resolved:
                raise InputError(f"uncertainty.{key}: {path} stands twice; keep one")
            resolved[path] = deviation
        self.uncertainty.clear()  # the keys as written give way to the dotted ones
        self.uncertainty.update(resolved)
        return self

    def _unit_of(self, key: str) -> str:
        """SI unit of a number of the robot, by dotted key."""
        data = self.model_dump(mode="json", by_alias=True, exclude_none=True, context={"unit_strings": True})
        text = next(value for path, value in dotted(data) if path == key)
        shown = text.split(" ", 1)[1] if isinstance(text, str) else "dimensionless"
        return next(si for si, d in DIMENSIONS.items() if shown in (d.display, si))

    def without_deviations(self, keys: Iterable[str]) -> RobotConfig:
        """A copy in which [uncertainty] says nothing of some numbers, by dotted key."""
        gone = set(keys)
        left = {key: said for key, said in self.uncertainty.items() if key not in gone}
        return self.model_copy(update={"uncertainty": left})

    def with_deviations(self, deviations: Mapping[str, float]) -> RobotConfig:
        """A copy in which [uncertainty] says other things of some numbers: standard deviations in SI, by
        dotted key. They are written as shares, to three digits, but those of a number that is zero with their
        unit; of one that is zero and has no unit nothing can be said.
        """
        values = self.numbers()
        said = {
            key: float(f"{sd / abs(values[key]):.3g}") if values[key] else f"{sd:.3g} {self._unit_of(key)}"
            for key, sd in deviations.items()
            if values[key] or self._unit_of(key) != "dimensionless"
        }
        return self.model_copy(update={"uncertainty": {**self.uncertainty, **said}})

    def deviation(self, key: str) -> float | None:
        """What [uncertainty] says of a number, by dotted key: one standard deviation in SI; None if it says
        nothing, or gives a share of zero.
        """
        said = self.uncertainty.get(key)
        if isinstance(said, str):
            return parse_quantity(said, self._unit_of(key))
        return None if said is None else abs(said * self.numbers()[key]) or None

    @property
    def term_values(self) -> dict[str, dict[str, float]]:
        """The numbers of all terms, those of absent ones at their null values, by term and name, SI."""
        values = null_values()
        for term in self.terms:
            values[term.kind] |= {name: getattr(term, name) for name in values[term.kind]}
        return values

    def numbers(self) -> dict[str, float]:
        """Every number of the robot in SI, by dotted key such as "backbone.outer_radius.0",
        "tendons.left.friction_coefficient" or "terms.tip-gain.gain" of a term that the file has.
        """
        data = self.model_dump(
            mode="json", by_alias=True, exclude_none=True, exclude={"schema_version", "uncertainty"}
        )
        return {key: value for key, value in dotted(data) if isinstance(value, float)}

    def with_values(self, values: Mapping[str, Any]) -> RobotConfig:
        """A copy with some values changed, checked like a file.

        Args:
            values: SI numbers or unit strings, by dotted key ("tendon.friction_coefficient",
                "backbone.outer_radius.0", "tendons.left.preload", "terms.tip-gain.gain") or by a bare key
                where it is the only one. A term that is not there is added.

        Raises InputError naming the key that is unknown or whose value does not fit.
        """
        data = self.model_dump(mode="json", by_alias=True, exclude_none=True)
        there = {term["kind"] for term in data.get("terms", ())}
        for kind, null in null_values().items():
            if kind not in there and any(key.startswith(f"terms.{kind}.") for key in values):
                data.setdefault("terms", []).append({"kind": kind, **null})
        keys = {key: value for key, value in dotted(data) if not key.startswith("uncertainty.")}
        for key, value in values.items():
            *parents, last = find_key(key, keys, self.source).split(".")
            node: Any = data
            for parent in parents:
                node = node[place_of(parent, node)]
            node[place_of(last, node)] = value
        return parse_config(data, source=self.source)


def parse_config(
    data: Mapping[str, Any], *, source: str = "robot", folder: str | os.PathLike[str] = "."
) -> RobotConfig:
    """Check the contents of a robot file. `source` names it in errors; `folder` is where its files lie.

    Raises InputError naming source, key and remedy.
    """
    try:
        config = RobotConfig.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        raise InputError(f"{source}: {one_line(error, ROUTINGS)}") from None
    config._source = source
    return config


def load_config(path: str | os.PathLike[str]) -> RobotConfig:
    """Read a robot file. Raises InputError naming file, key and remedy."""
    return parse_config(read_toml(path), source=str(path), folder=Path(path).parent)


def config_text(config: RobotConfig) -> str:
    """A robot file as TOML, with unit strings; it reads back to equal SI values."""
    import tomli_w

    return tomli_w.dumps(
        config.model_dump(by_alias=True, exclude_defaults=True, context={"unit_strings": True})
    )


def dump_config(config: RobotConfig, path: str | os.PathLike[str], *, note: str = "") -> None:
    """Write a robot file, whole or not at all, with a note as comment at its top; see `config_text`."""
    comment = "".join(f"# {line}\n" for line in textwrap.wrap(note, NOTE_WIDTH, break_on_hyphens=False))
    write_whole(path, comment + config_text(config))


def json_schema() -> dict[str, Any]:
    """JSON Schema of the robot file, with which editors complete and check it."""
    schema = RobotConfig.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def write_schema(path: str | os.PathLike[str]) -> None:
    """Write the JSON Schema of the robot file."""
    write_whole(path, json.dumps(json_schema(), indent=2) + "\n")


if __name__ == "__main__":
    import sys

    write_schema(sys.argv[1] if len(sys.argv) > 1 else "docs/robot.schema.json")
