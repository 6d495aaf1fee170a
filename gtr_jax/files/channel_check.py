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
        offset: the channel's offset R [m] from the backbone at each arc length s [m] of an array.
        tendon: name of the tendon, if the robot has several.
        points: places along the backbone to look at, besides the knots or junctions of the routing.

    Raises InputError naming the file, the place s where the channel is farthest outside, and the remedy.
    """
    length = config.backbone.length
    routing = next(channel for name, _, channel in config.strung if name == (tendon or ""))
    table = f"tendons.{tendon}.routing" if tendon else "routing"
    special: list[float] = []
    if routing.kind == "straight-sine-straight":
        special = [routing.w1, routing.w2]
    elif routing.kind == "table":
        special = [s for s, _ in routing.knots]
    s = np.union1d(np.linspace(0.0, length, points), np.clip(special, 0.0, length))
    reach = np.abs(np.asarray(offset(s), dtype=np.float64))
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
