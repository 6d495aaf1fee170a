"""Whether the tendon channel stays inside the body, and whether it is a channel there at all."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from gtr_jax.errors import InputError, InputWarning

from .checks import mm, outer_radius_at
from .config import RobotConfig
from .sections import RingConfig, TendonConfig, TubeConfig

_NEAR = 0.02  # share of the radius of a bore: a channel this close to its wall lies on it


def check_channel(
    config: RobotConfig,
    offset: Callable[[np.ndarray], np.ndarray],
    *,
    tendon: str | None = None,
    points: int = 2001,
) -> None:
    """Refuse a tendon channel that leaves the body, and warn of one that lies in the free space of a bore.

    Args:
        config: the robot.
        offset: the channel's offset [m] from the backbone at each arc length s [m] of an array: R, (N,), or
            its place in the section, (N, 2).
        tendon: name of the tendon, if the robot has several.
        points: places along the backbone to look at, besides the knots or junctions of the routing.

    Raises InputError naming the file, the place s where the channel is farthest outside, and the remedy.
    Warns with an `InputWarning` of a tendon within a bore, which is computed as in a channel, unless `guides`
    or the term clearance say what it does there.
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
    _warn_of_free_space(config, own, s, reach, table, tendon)


def _warn_of_free_space(
    config: RobotConfig, own: TendonConfig, s: np.ndarray, reach: np.ndarray, table: str, name: str | None
) -> None:
    """Warn where a tendon lies within a bore, away from its wall, and nothing says how it runs there.

    Args:
        config: the robot.
        own: the tendon.
        s: arc lengths [m], (N,), increasing.
        reach: distance of the tendon from the axis there [m], (N,).
        table: of the channel in the file.
        name: of the tendon; None for an only one.
    """
    cleared = any(term.id == "clearance" and term.tendon in (None, name) for term in config.terms)
    if own.guides or cleared or config.backbone.rigid:
        return
    hollow = [(bore.from_, bore.to, bore.diameter / 2) for bore in config.backbone.bores]
    section = config.backbone.section
    if isinstance(section, TubeConfig | RingConfig) and section.inner_diameter:
        hollow.append((0.0, config.backbone.length, section.inner_diameter / 2))
    for first, last, radius in hollow:
        free = (first <= s) & (s <= last) & (reach < radius * (1 - _NEAR))
        ends = np.flatnonzero(np.diff(free, prepend=False, append=False)).reshape(-1, 2)
        stretches = [(a, b - 1) for a, b in ends.tolist() if s[b - 1] > s[a]]
        if not stretches:
            continue
        room = max(float(np.max(radius - reach[a : b + 1])) for a, b in stretches)
        a, b = max(stretches, key=lambda ends: s[ends[1]] - s[ends[0]])
        others = len(stretches) - 1
        more = f" and in {others} more stretch{'es' if others > 1 else ''}" if others else ""
        warnings.warn(
            f"{config.source}: {table}: from s = {mm(float(s[a]))} to {mm(float(s[b]))}{more} the tendon "
            f"lies in a bore, up to {mm(room)} from its wall, and is computed as if a channel held it there; "
            "if it is free, name the disks between which it runs straight as guides, or give the term "
            "clearance",
            InputWarning,
            stacklevel=3,
        )
