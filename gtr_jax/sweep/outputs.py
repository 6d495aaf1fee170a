"""What a sweep can compute at every point: names and units."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from gtr_jax.errors import did_you_mean
from gtr_jax.recordings.formats.quantities import ANGLE, AXES, QUATERNION, column_of, marker_quantities
from gtr_jax.robot.robot import Robot

from .config import SweepConfig

STEP, NODE = "step", "node"  # names of dimensions in the store
NODE_QUATERNION = ("qx", "qy", "qz", "qw")


@dataclasses.dataclass(frozen=True)
class Variable:
    """One array of the store.

    Attributes:
        name: in the store.
        unit: SI; "" without.
        says: what it is.
        dims: of one point: some of "step", "node".
        smooth: whether it has gradients.
    """

    name: str
    unit: str
    says: str
    dims: tuple[str, ...] = (STEP,)
    smooth: bool = False


T_TIP = Variable("T_tip", "N", "tension at the tip's anchor, as its load cell shows it", smooth=True)
POSE = (
    Variable("tip_x", "m", "tip of the midline along the base tangent", smooth=True),
    Variable("tip_y", "m", "tip of the midline to the left of the base tangent", smooth=True),
    Variable("tip_angle", "rad", "angle of the midline at the tip, anticlockwise", smooth=True),
)
POSE_IN_SPACE = (
    *(
        Variable(f"tip_{axis}", "m", f"tip of the midline along {axis} of the world", smooth=True)
        for axis in AXES
    ),
    *(Variable(name, "", "orientation of the tip, a unit quaternion", smooth=True) for name in QUATERNION),
)
ALONG = Variable("s", "m", "arc length of the nodes from the base", (NODE,))
COMMON: dict[str, tuple[Variable, ...]] = {
    "T_tip": (T_TIP,),
    "loss": (Variable("loss", "", "share of the base tension that does not reach the tip", smooth=True),),
    "T_base_switch": (
        Variable("T_base_switch", "N", "base tension at which the released tendon slips at the tip", ()),
    ),
    "displacement": (Variable("displacement", "m", "of the tendon drawn out at the base", smooth=True),),
    "tension_profile": (
        ALONG,
        Variable("tension", "N", "along the tendon", (STEP, NODE)),
    ),
    "dissipation": (Variable("dissipation", "J", "work lost to the tendon's friction over the history", ()),),
}
IN_PLANE: dict[str, tuple[Variable, ...]] = {
    "tip_pose": POSE,
    "shape": (
        ALONG,
        Variable("x", "m", "midline along the base tangent", (STEP, NODE)),
        Variable("y", "m", "midline to the left of the base tangent", (STEP, NODE)),
        Variable("angle", "rad", "of the midline, anticlockwise", (STEP, NODE)),
    ),
}
IN_SPACE: dict[str, tuple[Variable, ...]] = {
    "tip_pose": POSE_IN_SPACE,
    "shape": (
        ALONG,
        *(Variable(axis, "m", f"midline along {axis} of the world", (STEP, NODE)) for axis in AXES),
        *(
            Variable(name, "", "orientation of the section, a unit quaternion", (STEP, NODE))
            for name in NODE_QUATERNION
        ),
    ),
}
MARKERS = "markers"  # the output that is named after the robot's markers
GRADIENTS = "gradients"  # the output that asks for derivatives of the others
PER_TENDON = ("T_tip", "loss", "displacement", "tension", "T_base", "drawn_out")  # of each tendon
RESULT = Variable("result", "", "0 converged, 1 not converged, 2 not finite, 3 no such robot", ())
BASE = Variable("T_base", "N", "tension at the tendon's base")
FOUND_BASE = Variable(
    "T_base", "N", "tension at the base of the tendon that displacement drives", smooth=True
)
DRAWN_OUT = Variable("drawn_out", "m", "by which the tendon's drive draws it out at the base")


def check_outputs(sweep: SweepConfig) -> None:
    """InputError if an output is unknown or given twice."""
    known = [*COMMON, *IN_PLANE, MARKERS, GRADIENTS]
    for i, name in enumerate(sweep.outputs):
        if name not in known:
            raise sweep.fault("outputs", f"unknown output '{name}'; {did_you_mean(name, known)}")
        if name in sweep.outputs[:i]:
            raise sweep.fault("outputs", f"'{name}' is given twice; remove one")
    smooth = {name for name, group in (COMMON | IN_PLANE).items() if any(v.smooth for v in group)}
    if GRADIENTS in sweep.outputs and not {*smooth, MARKERS} & {*sweep.outputs}:
        raise sweep.fault(
            "outputs", "gradients of what? add T_tip, tip_pose, loss or displacement, which have them"
        )


def variables(sweep: SweepConfig, robot: Robot, drawn: Sequence[bool]) -> tuple[Variable, ...]:
    """The arrays that a sweep's outputs ask for, each once; of several tendons one for each where it has its
    own. Base tensions that displacement sets are among them, asked for or not.

    Args:
        sweep: the file.
        robot: the robot.
        drawn: of every tendon, whether displacement drives it.

    Raises:
        InputError: markers of a robot that has none.
    """
    groups = COMMON | (IN_SPACE if robot.space else IN_PLANE) | {MARKERS: of_markers(robot)}
    if MARKERS in sweep.outputs and not robot.markers:
        raise sweep.fault(
            "outputs", "markers: the robot has none; add [[markers]] to its file, or leave it out"
        )
    found = dict.fromkeys(v for name in sweep.outputs if name != GRADIENTS for v in groups[name])
    bases = zip(of_tendons(FOUND_BASE, robot.tendon_names), drawn, strict=True)
    return (
        *(named for v in found for named in of_tendons(v, robot.tendon_names)),
        *(base for base, moved in bases if moved),
    )


def of_tendons(variable: Variable, tendons: Sequence[str]) -> tuple[Variable, ...]:
    """An array, or one for each tendon."""
    if not tendons or variable.name not in PER_TENDON:
        return (variable,)
    return tuple(dataclasses.replace(variable, name=f"{variable.name}.{name}") for name in tendons)


def of_markers(robot: Robot) -> tuple[Variable, ...]:
    """The places of the markers, in the plane x and y, and the angles of their sections."""

    def says(marker: str, end: str) -> str:
        if end == ANGLE:
            return f"angle of the section at marker {marker}"
        return f"marker {marker} along {end} of the world"

    return tuple(
        Variable(name, column_of(name).unit, says(m.name, name.removeprefix(f"{m.name}_")), smooth=True)
        for m in robot.markers
        for name in marker_quantities(m.name, space=robot.space)
    )
