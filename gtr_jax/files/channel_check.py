"""Whether the tendon channel stays inside the body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gtr_jax.errors import InputError

from .config import RobotConfig
from .config_checks import mm, outer_radius_at


def check_channel(
    config: RobotConfig,
    offset: Callable[[np.ndarray], np.ndarray],
    *,
    tendon: str | None = None,
    points: int = 2001,
) -> None:
    """Refuse a tendon channel that leaves the body.

    Args:
        config: the robot.
        offset: the channel's offset [m] from the backbone at each arc length s [m] of an array: R, (N,), or
            its place in the section, (N, 2).
        tendon: name of the tendon, if the robot has several.
        points: places along the backbone to look at, besides the knots or junctions of the routing.

    Raises InputError naming the file, the place s where the channel is farthest outside, and the remedy.
    """
    length = config.backbone.length
    own, routing = next((own, channel) for name, own, channel in config.strung if name == (tendon or ""))
    table = f"tendons.{tendon}.routing" if tendon else "routing"
    special: list[float] = []
    if routing.kind == "straight-sine-straight":
        special = [routing.w1, routing.w2]
    elif routing.kind in ("table", "curve"):
        special = [knot[0] for knot in routing.knots]
    end = own.to or length
    s = np.union1d(np.linspace(0.0, end, points), np.clip(special, 0.0, end))
    place = np.asarray(offset(s), dtype=np.float64)
    reach = np.abs(place) if place.ndim == 1 else np.hypot(*place.T)
    radius = outer_radius_at(config.backbone, s)
    if not np.all(np.isfinite(reach)):
        raise InputError(f"{config.source}: {table}: the channel has no finite offset; check its values")
    worst = int(np.argmax(reach - radius))
    if reach[worst] >= radius[worst]:
        raise InputError(
            f"{config.source}: {table}: the tendon leaves the body at s = {mm(s[worst])}, where it runs "
            f"{mm(reach[worst])} from the axis and the outer radius is {mm(radius[worst])}; "
            "bring the channel inside or widen the body"
        )
