"""The tables of a robot file together, and what they say of tendons, laws and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, StrictBool, StrictStr

from gtr_jax.terms import Law, Term, catalogue_of

from .law_section import LawSection
from .routings import RoutingConfig
from .sections import (
    BackboneConfig,
    BaseConfig,
    Deviation,
    FileSection,
    LoadsConfig,
    MarkerConfig,
    OneOfSeveralTendons,
    TendonConfig,
    TermConfig,
)
from .toml_file import dotted


class RobotTables(FileSection):
    """What a robot file says, in SI units; `RobotConfig` adds that it fits together."""

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
    base: BaseConfig = BaseConfig()
    markers: tuple[MarkerConfig, ...] = ()
    """Points of the body that are recorded."""
    space: StrictBool = False
    """Whether the robot is computed in space though nothing in its file leaves the plane."""
    uncertainty: dict[str, Deviation] = Field(default_factory=dict)
    """Prior knowledge of numbers of the robot ("youngs_modulus"): one standard deviation, relative or with a
    unit."""
    terms: tuple[TermConfig, ...] = ()
    """Physics beyond the paper, each term once."""

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

    @property
    def laws(self) -> tuple[Law, ...]:
        """The laws that the file states."""
        return tuple(term.as_law for term in self.terms if isinstance(term, LawSection))

    @property
    def catalogue(self) -> Mapping[str, Term]:
        """Every physics term that the robot may have, by name: its own laws and the registered ones."""
        return catalogue_of(self.laws)

    def numbers(self) -> dict[str, float]:
        """Every number of the robot in SI, by dotted key such as "backbone.outer_radius.0",
        "tendons.left.friction_coefficient" or "terms.tip-gain.gain" of a term that the file has.
        """
        data = self.model_dump(
            mode="json", by_alias=True, exclude_none=True, exclude={"schema_version", "uncertainty"}
        )
        said = tuple(f"terms.{law.name}.{table}." for law in self.laws for table in ("usual", "bounds"))
        return {k: v for k, v in dotted(data) if isinstance(v, float) and not k.startswith(said)}
