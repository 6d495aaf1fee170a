"""A simulation and an equilibrium as labelled datasets, and the columns of `simulation.csv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax.core import Tracer

from gtr_jax.recordings.formats.quantities import AXES, QUATERNION, column_of, marker_quantities
from gtr_jax.recordings.headed import TENDON, frame_of, headed
from gtr_jax.robot.robot import Robot
from gtr_jax.robot.rotation import quaternion_of

from .arrays import EquilibriumArrays, SimulationArrays
from .markers import marker_readings, marker_rows, shape_in_plane
from .phases import label_phases
from .sensing import cells_differ
from .shape import Shape

if TYPE_CHECKING:
    import pandas
    import xarray

STEP, NODE = "step", "s"  # dimensions
STRAINS = ("twist", "curvature_y", "curvature_z")  # of a body in space, as in `profile.csv`
Variables = dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]


def _tip_in_space(run: SimulationArrays) -> dict[str, np.ndarray]:
    quaternion = np.asarray(quaternion_of(run.tip_rotation))
    places = {f"tip_{axis}": np.asarray(run.tip_position)[:, i] for i, axis in enumerate(AXES)}
    return places | {name: quaternion[:, i] for i, name in enumerate(QUATERNION)}


def marker_columns(robot: Robot, run: SimulationArrays) -> dict[str, np.ndarray]:
    """The places of markers at every step [m], in the plane x and y, and the angles of their sections [rad],
    by header, (K,) each.
    """
    rows = marker_rows(robot, np.asarray(marker_readings(robot, run)))
    shown = [name for m in robot.markers for name in marker_quantities(m.name, space=robot.space)]
    return {column_of(name).header: rows[name] for name in shown}


def simulation_columns(run: SimulationArrays, robot: Robot | None, *, timed: bool = True) -> dict[str, Any]:
    """The columns of `simulation.csv`, by quantity of a recording or header: (K,) or (K, tendons).

    Args:
        run: a simulation.
        robot: as simulated, for its markers and load cells, or None.
        timed: whether it has times of its own.
    """
    if run.shape is not None:
        pose = _tip_in_space(run)
    else:
        pose = {name: run.tip_pose[:, i] for i, name in enumerate(("tip_x", "tip_y", "tip_angle"))}
    columns = {
        "time": run.time if timed else None,
        "T_base": run.reading.T_base,
        "T_tip": run.reading.T_tip,
        **pose,
        **(marker_columns(robot, run) if robot is not None and robot.markers else {}),
        "displacement": run.displacement,
        "phase": label_phases(run),
    }
    if _cells_differ(run) if robot is None else cells_differ(robot):
        columns |= {"T_base_true_N": run.T_base, "T_tip_true_N": run.T_tip}
    if not np.all(run.converged):
        columns["converged"] = np.asarray(run.converged).astype(int)
    return columns


def _cells_differ(run: SimulationArrays) -> bool:
    """Whether the load cells show anything but the true tensions."""
    pairs = zip(run.reading, (run.T_base, run.T_tip), strict=True)
    return not all(np.array_equal(shown, true) for shown, true in pairs)


def simulation_frame(run: SimulationArrays, robot: Robot | None) -> pandas.DataFrame:
    """See `Simulation.to_pandas`."""
    _check(run, run.residual_norm, 1)
    names = _tendons(run.T_base.shape[1:], robot)
    return frame_of(headed(simulation_columns(run, robot), tendons=names), STEP)


def simulation_dataset(run: SimulationArrays, robot: Robot | None) -> xarray.Dataset:
    """See `Simulation.to_xarray`."""
    _check(run, run.residual_norm, 1)
    names = _tendons(run.T_base.shape[1:], robot)
    each = (STEP, TENDON) if names else (STEP,)
    along, nodes = (*each, NODE), (STEP, NODE)
    shape = run.shape
    if shape is None and robot is not None:
        shape = shape_in_plane(robot, run.curvature, run.angle)
    found: Variables = {
        "T_base": _said(each, run.reading.T_base, "N", "tension at the base, as its load cell shows it"),
        "T_tip": _said(each, run.reading.T_tip, "N", "tension at the anchor, as its load cell shows it"),
        "T_base_true": _said(each, run.T_base, "N", "tension at the base"),
        "T_tip_true": _said(each, run.T_tip, "N", "tension at the tip's anchor"),
        "displacement": _said(each, run.displacement, "m", "of the tendon drawn out at the base"),
        "slip_direction": _said(each, run.slip_direction, "1", "of the tendon at the base, +1 towards it"),
        "slip_front": _said(each, run.slip_front, "m", "the tendon slips from the base to here"),
        "tension": _said(along, run.tension, "N", "along the tendon"),
        "slip": _said(along, run.slip, "m", "of the tendon towards the base"),
        **_body(nodes, run, shape, in_plane=run.shape is None),
        "residual_norm": _said((STEP,), run.residual_norm, "1", "of the solver"),
        "iterations": _said((STEP,), run.iterations, "1", "of the solver"),
        "converged": ((STEP,), run.converged, {"long_name": "whether the step met its tolerance"}),
    }
    if run.mobilisation is not None:
        found["mobilisation"] = _said(along, run.mobilisation, "1", "of friction")
    tip = run.tip_pose.T
    if run.shape is None:
        found |= {
            "tip_x": _said((STEP,), tip[0], "m", "tip of the midline along the base tangent"),
            "tip_y": _said((STEP,), tip[1], "m", "tip of the midline to the left of the base tangent"),
            "tip_angle": _said((STEP,), tip[2], "rad", "angle of the midline at the tip, anticlockwise"),
        }
    else:
        for name, values in _tip_in_space(run).items():
            unit, says = ("1", "orientation of the tip, a unit quaternion") if "q" in name else ("m", _PLACE)
            found[name] = _said((STEP,), values, unit, says)
    if robot is not None and robot.markers:
        rows = marker_rows(robot, np.asarray(marker_readings(robot, run)))
        for name in (n for m in robot.markers for n in marker_quantities(m.name, space=robot.space)):
            found[name] = _said((STEP,), rows[name], column_of(name).unit, "of a marker")
    coords = {
        STEP: np.arange(len(run.time)),
        "time": _said((STEP,), run.time, "s", "since the first step"),
        "phase": (each, label_phases(run), {"long_name": "phase of the tendon"}),
    }
    return _dataset(found, coords, run.s, names, robot)


def equilibrium_dataset(state: EquilibriumArrays, robot: Robot | None) -> xarray.Dataset:
    """See `Equilibrium.to_xarray`."""
    _check(state, state.residual_norm, 0)
    names = _tendons(state.tension.shape[:-1], robot)
    each: tuple[str, ...] = (TENDON,) if names else ()
    along = (*each, NODE)
    found: Variables = {
        "T_tip": _said(each, state.T_tip, "N", "tension at the tip's anchor"),
        "tendon_length": _said(each, state.tendon_length, "m", "of the channel"),
        "tension": _said(along, state.tension, "N", "along the tendon"),
        "slip": _said(along, state.slip, "m", "of the tendon towards the base"),
        "wrap": _said(along, state.wrap, "rad", "turning of the tendon since the base"),
        "metric": _said(along, state.metric, "1", "length of the channel per length of the body"),
        **_body((NODE,), state, state.shape, in_plane=state.shape is None),
        "residual_norm": _said((), state.residual_norm, "1", "of the solver"),
        "iterations": _said((), state.iterations, "1", "of the solver"),
        "converged": ((), state.converged, {"long_name": "whether it met its tolerance"}),
    }
    if state.shape is None:
        found |= {
            "x": _said((NODE,), state.x, "m", _PLACE),
            "y": _said((NODE,), state.y, "m", _PLACE),
            "offset": _said(along, state.R, "m", "of the channel from the midline"),
        }
    else:
        for i, axis in enumerate("yz"):
            found[f"offset_{axis}"] = _said(along, state.R[..., i], "m", "of the channel from the midline")
    return _dataset(found, {}, state.s, names, robot)


_PLACE = "of the midline in the world"


def _body(
    nodes: tuple[str, ...], run: SimulationArrays | EquilibriumArrays, shape: Shape | None, *, in_plane: bool
) -> Variables:
    """What belongs to the body, at its nodes."""
    found = {
        "curvature": _said(nodes, run.curvature, "1/m", "of the midline"),
        "angle": _said(nodes, run.angle, "rad", "of the midline, anticlockwise"),
    }
    if in_plane:
        found["external_moment"] = _said(nodes, run.external_moment, "N m", "of the external loads")
        if shape is not None:
            for i, axis in enumerate("xy"):
                found[axis] = _said(nodes, shape.position[..., i], "m", _PLACE)
        return found
    assert shape is not None
    for i, axis in enumerate(AXES):
        moment = run.external_moment[..., i]
        found[f"external_moment_{axis}"] = _said(nodes, moment, "N m", "of the external loads")
        found[axis] = _said(nodes, shape.position[..., i], "m", _PLACE)
        found[STRAINS[i]] = _said(nodes, shape.strain[..., i], "1/m", "in the axes of the section")
    quaternion = quaternion_of(shape.rotation)
    for i, name in enumerate("xyzw"):
        found[f"q{name}"] = _said(
            nodes, quaternion[..., i], "1", "orientation of the section, a unit quaternion"
        )
    if shape.stretch is not None:
        found["stretch"] = _said(nodes, shape.stretch, "1", "axial strain of the body")
    return found


def _said(dims: tuple[str, ...], values: Any, unit: str, says: str):
    return dims, values, {"long_name": says, "units": unit}


def _check(thing: Any, size: Any, dimensions: int) -> None:
    """ValueError where the numbers are unknown, or of many things side by side."""
    leaves = jax.tree_util.tree_leaves(thing)
    what = type(thing).__name__
    if any(isinstance(leaf, Tracer | jax.ShapeDtypeStruct) for leaf in leaves):
        raise ValueError(f"{what}: its numbers are unknown while JAX traces; label what comes out of jit")
    if np.ndim(size) != dimensions:
        raise ValueError(f"{what}: this is a batch; label one, jax.tree_util.tree_map(lambda a: a[0], ...)")


def _tendons(several: tuple[int, ...], robot: Robot | None) -> tuple[str, ...]:
    """Names of several tendons, which are their numbers from 1 where no robot says; () of one."""
    if not several:
        return ()
    return robot.tendon_names if robot is not None else tuple(str(i + 1) for i in range(several[0]))


def _dataset(
    found: Variables, coords: Mapping[str, Any], s: Any, tendons: Sequence[str], robot: Robot | None
) -> xarray.Dataset:
    import xarray as xr

    known = {name: (dims, np.asarray(values), says) for name, (dims, values, says) in found.items()}
    more: dict[str, Any] = {NODE: _said((NODE,), _apart(np.asarray(s)), "m", "arc length from the base")}
    more |= {TENDON: list(tendons)} if tendons else {}
    return xr.Dataset(known, {**coords, **more}, {} if robot is None else {"robot": robot.name})


def _apart(s: np.ndarray) -> np.ndarray:
    """Nodes as labels, each once: where panels of the mesh meet there are two nodes at one place, before and
    behind a kink, and more where kinks lie within a rounding error of each other; each but the first gets the
    next number above the label before it.
    """
    labels = np.array(s, float)
    for i in range(1, len(labels)):
        labels[i] = max(labels[i], np.nextafter(labels[i - 1], np.inf))
    return labels
