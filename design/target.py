"""The target file: `TARGET.toml` read and checked by itself; `checks` holds it against the robot.

The classes below are the file's sections; after validation they hold SI floats (m, N, rad).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, StrictInt, StrictStr, Tag

from gtr_jax.config.routings import SPATIAL
from gtr_jax.config.section import Section
from gtr_jax.config.sections import FileSection
from gtr_jax.config.toml_file import read_toml
from gtr_jax.units import Unit

Length = Annotated[float, Unit("m")]
Angle = Annotated[float, Unit("rad")]
Force = Annotated[float, Unit("N")]
Ratio = Annotated[float, Unit("dimensionless")]
Whole = Annotated[StrictInt, Field(gt=-(2**63), lt=2**63)]
Branch = Literal["pulling", "releasing"]


def _axes(value: Any) -> str:
    return "#space" if isinstance(value, list | tuple) and len(value) >= 3 else "#plane"


def _places(value: Any) -> str:
    return "#space" if isinstance(value, list | tuple) and len(value) >= 4 else "#plane"


def _turned(value: Any) -> str:
    return "#space" if isinstance(value, list | tuple) else "#plane"


def _named(value: Any) -> str:
    return "#several" if isinstance(value, Mapping) else "#one"


# x, y of a robot in the plane, and z of one in space.
Place = Annotated[
    Annotated[tuple[Length, Length], Tag("#plane")] | Annotated[tuple[Length, Length, Length], Tag("#space")],
    Discriminator(_axes),
]
Point = Annotated[
    Annotated[tuple[Length, Length, Length], Tag("#plane")]
    | Annotated[tuple[Length, Length, Length, Length], Tag("#space")],
    Discriminator(_places),
]
Direction = tuple[Ratio, Ratio, Ratio]
Heading = Annotated[
    Annotated[Angle, Tag("#plane")] | Annotated[Direction, Tag("#space")], Discriminator(_turned)
]
# Of one tendon, or of several by their names.
Tension = Annotated[
    Annotated[Force, Tag("#one")] | Annotated[dict[str, Force], Tag("#several")], Discriminator(_named)
]

SPLINE = "spline"
T_BASE = "T_base"
TIP_TOLERANCE, SHAPE_TOLERANCE = 1e-3, 5e-3  # of the length
FAMILIES = ("parallel", "straight-sine-straight", "converging-sine", "crossing-sine", SPLINE, *SPATIAL)


class PoseTarget(Section):
    """Where the tip is to be at one base tension: its position, where it points, or both."""

    T_base: Tension = Field(examples=["45 N"])
    """Base tension [N]; of several tendons each by its name, those that are left out at their preload."""
    branch: Branch = "pulling"
    """Whether the tendon is pulled to this tension, or released to it from the largest of the file."""
    tip: Place | None = None
    """Tip of the midline [m]: x along the base tangent, y to its left; in space z too, in the world."""
    angle: Angle | None = None
    """Angle of the midline at the tip [rad], anticlockwise, not reduced to a full turn; in the plane."""
    direction: Direction | None = None
    """Direction of the midline at the tip, a vector of any length; in space."""
    rotation: tuple[Angle, Angle, Angle] | None = None
    """Rotation vector of the section at the tip [rad], which says its twist too; in space, instead of
    direction."""
    tip_tolerance: Length | None = None
    """Distance [m] within which the tip counts as there; 0.1 % of the length unless given."""
    angle_tolerance: Angle = 1e-3
    """Angle [rad] within which it counts as pointing there."""
    weight: Ratio = 1.0
    """Of this target against the others, where not all can be met."""

    @property
    def turn(self) -> str | None:
        """The key that says where the tip is to point; None if none does."""
        keys = ("angle", "direction", "rotation")
        return next((key for key in keys if getattr(self, key) is not None), None)

    def near(self, length: float) -> float:
        """Distance [m] within which the tip of an arm of this length [m] counts as there."""
        return TIP_TOLERANCE * length if self.tip_tolerance is None else self.tip_tolerance


class ShapeTarget(Section):
    """Where points of the midline are to be at one base tension."""

    T_base: Tension = Field(examples=["45 N"])
    """Base tension [N], as of a pose."""
    branch: Branch = "pulling"
    """As of a pose."""
    points: tuple[Point, ...] = Field(examples=[[["125 mm", "120 mm", "20 mm"]]])
    """[s, x, y] of each point [m], in space [s, x, y, z]: arc length along the midline, and where it is to
    be."""
    tolerance: Length | None = None
    """Distance [m] within which a point counts as there; 0.5 % of the length unless given."""
    weight: Ratio = 1.0
    """As of a pose."""

    def near(self, length: float) -> float:
        """Distance [m] within which a point of an arm of this length [m] counts as there."""
        return SHAPE_TOLERANCE * length if self.tolerance is None else self.tolerance


class Goal(Section):
    """What to make as large, or as small, as the limits and the targets allow."""

    kind: Literal["reach", "bend", "tension"] = Field(examples=["reach"])
    """reach: how far the tip gets in a direction; bend: the angle of the tip; tension: the least base tension
    at which the targets are met."""
    T_base: Tension | None = None
    """Base tension [N] of reach and bend, as of a pose."""
    branch: Branch = "pulling"
    """As of a pose."""
    direction: Heading = 0.5 * 3.141592653589793
    """Of reach [rad], from the base tangent, sideways (along y) unless given; in space a vector."""


class Obstacle(Section):
    """What the body must not touch at any target: a ball, or a rod with round ends."""

    at: Place = Field(examples=[["150 mm", "40 mm"]])
    """Its middle, or one end of the rod [m]: x, y; in space x, y, z in the world."""
    to: Place | None = None
    """The other end of the rod [m]; a ball unless given."""
    radius: Length = Field(examples=["10 mm"])
    """Radius [m]."""


class Search(Section):
    """What may change, within which bounds, and how it is searched."""

    kind: StrictStr | None = None
    """Family of the channel; that of the robot unless given."""
    routing: tuple[StrictStr, ...] | None = None
    """Numbers of the channel that may change; all of them unless given."""
    free: tuple[StrictStr, ...] = ()
    """Other numbers that may change: T_base (T_base.left of one of several tendons), or any of the robot (E,
    outer_radius_tip, bore_0_diameter)."""
    knots: Whole | None = None
    """Number of knots of a spline or a curve, evenly spaced; 6 unless given."""
    n_sine: tuple[Ratio, ...] | None = None
    """Numbers of half waves to choose from; that of the robot unless given."""
    bounds: dict[str, tuple[Any, Any]] = Field(default_factory=dict)
    """Least and largest value of a number that may change, by its name."""
    starts: Whole = 12
    """Starts of the search for each number of half waves."""
    method: Literal["auto", "gauss-newton", "l-bfgs-b"] = "auto"
    """How to search; auto takes Gauss-Newton for targets and L-BFGS-B for goals."""
    seed: Whole = 0
    """Of the starts."""

    @property
    def free_tensions(self) -> tuple[str, ...]:
        """The names among the free numbers that are of base tensions: T_base, or T_base.left."""
        return tuple(name for name in (*self.free, *(self.routing or ())) if is_tension(name))

    @property
    def frees_tension(self) -> bool:
        """Whether any base tension may change."""
        return bool(self.free_tensions)


def is_tension(name: str) -> bool:
    """Whether the name of a free number is that of base tensions."""
    return name.partition(".")[0] == T_BASE


class Limits(Section):
    """What the design has to keep."""

    wall_clearance: Length = 0.0
    """Least wall [m] between the channel and the outer surface."""
    bore_clearance: Length = 0.0
    """Least wall [m] between the channel and a bore."""
    channel_clearance: Length = 0.0
    """Least wall [m] between the channels of two tendons."""
    obstacle_clearance: Length = 0.0
    """Least distance [m] between the body and an obstacle, at every target."""
    channel_diameter: Length = 0.0
    """Of the channel [m]; clearances count from its edge."""
    min_channel_radius: Length | None = None
    """Least radius of curvature of the channel [m], in the unloaded body."""
    max_tension_loss: Ratio | None = None
    """Largest share of the base tension that may be lost on the way to the tip while pulling."""
    max_T_base: Force | None = None
    """Largest base tension [N]."""
    min_T_tip: Force | None = None
    """Least tension at the tip [N] at every target."""
    max_base_slope: Angle | None = None
    """Largest angle [rad] between channel and midline where the channel begins."""
    max_tip_slope: Angle | None = None
    """The same where it ends."""


class Robust(Section):
    """How well friction and modulus are known, and whether the design is to allow for it."""

    optimise: Literal["nominal", "expected", "worst"] = "nominal"
    """nominal: the target is met by the robot as the file has it; expected: least mean square error over what
    is not known; worst: least largest error."""
    friction_coefficient: Ratio | None = None
    """Standard deviation of the friction coefficient, relative; that of the robot's [uncertainty] unless
    given."""
    youngs_modulus: Ratio | None = None
    """The same of the modulus, or of the bending stiffness of a body that is given by it."""
    fit: StrictStr | None = None
    """fit.json with both deviations and their correlation, relative to the target file."""
    deviations: Ratio = 2.0
    """Standard deviations up to which the worst case looks."""


class TargetConfig(FileSection):
    """A target file in SI units."""

    schema_version: Literal[1] = Field(alias="schema", examples=[1])
    """Version of the file format."""
    name: StrictStr = "design"
    """Name in reports, and of the designed robot."""
    pose: tuple[PoseTarget, ...] = ()
    """Poses of the tip."""
    shape: tuple[ShapeTarget, ...] = ()
    """Shapes of the midline."""
    goal: Goal | None = None
    """What to make as large as can be."""
    obstacle: tuple[Obstacle, ...] = ()
    """What the body must not touch."""
    T_base_max: Force | None = None
    """Base tension [N] from which targets on the releasing branch are released; the largest of the file
    unless given."""
    search: Search = Search()
    limits: Limits = Limits()
    robust: Robust = Robust()

    @property
    def loads(self) -> tuple[PoseTarget | ShapeTarget | Goal, ...]:
        """Everything that asks for a state, in the order poses, shapes, goal."""
        return (*self.pose, *self.shape, *((self.goal,) if self.goal else ()))


def parse_target(
    data: Mapping[str, Any], *, source: str = "target", folder: str | os.PathLike[str] = "."
) -> TargetConfig:
    """Check the contents of a target file. `source` names it in errors; `folder` is where its files lie.

    Raises InputError naming source, key and remedy.
    """
    return TargetConfig.parsed(data, source=source, folder=folder)


def load_target(path: str | os.PathLike[str]) -> TargetConfig:
    """Read a target file. Raises InputError naming file, key and remedy."""
    return parse_target(read_toml(path), source=str(path), folder=Path(path).parent)


def target_text(target: TargetConfig) -> str:
    """A target file as TOML, with unit strings."""
    import tomli_w

    return tomli_w.dumps(
        target.model_dump(
            by_alias=True, exclude_defaults=True, exclude_none=True, context={"unit_strings": True}
        )
    )
