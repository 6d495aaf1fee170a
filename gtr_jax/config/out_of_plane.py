"""Whether anything in a robot file leaves the plane, or is computed in space only."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .robot_tables import RobotTables
from .routings import SPATIAL


def out_of_plane(config: RobotTables) -> str | None:
    """The first key, dotted, by which a robot leaves its plane; None if it stays in it."""
    return next((key for key, out in _ways(config) if out), None)


def _ways(config: RobotTables) -> Iterator[tuple[str, bool]]:
    for name, tendon, routing in config.strung:
        table = f"tendons.{name}" if name else "tendon"
        channel = f"{table}.routing" if name else "routing"
        yield f"{channel}.kind", routing.kind in SPATIAL
        yield f"{channel}.plane_angle", getattr(routing, "plane_angle", 0.0) != 0.0
        yield f"{table}.to", tendon.to is not None
        yield f"{table}.guides", bool(tendon.guides)
        yield f"{table}.drive", tendon.drive != "tension"
        yield f"{table}.axial_stiffness", tendon.axial_stiffness is not None
    body, loads = config.backbone, config.loads
    for key in ("natural_curvature_y", "natural_twist"):
        yield f"backbone.{key}", _any(getattr(body, key))
    yield "backbone.extensible", body.extensible
    yield "backbone.axial_stiffness", body.axial_stiffness is not None
    yield "loads.gravity", loads.gravity is not None and loads.gravity[2] != 0.0
    yield "loads.tip_force", any(loads.tip_force[2:])
    yield "loads.tip_moment", isinstance(loads.tip_moment, tuple) and any(loads.tip_moment[:2])
    for term in config.terms:
        for q in config.catalogue[term.id].across:
            yield f"terms.{term.id}.{q.name}", getattr(term, q.name) != q.null
    yield "base", any(config.base.position) or any(config.base.rotation)


def _any(along: Any) -> bool:
    """Whether a constant, or any value of [s, value] pairs, differs from zero."""
    return bool(np.any(np.asarray(along, float)[:, 1])) if isinstance(along, tuple) else along != 0.0
