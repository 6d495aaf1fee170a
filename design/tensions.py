"""The base tensions that a target file names, of one tendon or of several."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gtr_jax.config.config import RobotConfig

from .target import TargetConfig

Pull = float | tuple[float, ...]  # base tension [N], of several tendons in their order


def pull_of(config: RobotConfig, T_base: float | Mapping[str, float]) -> Pull:
    """The base tensions of one load; tendons that are not named have their preload.

    Args:
        config: the robot.
        T_base: as a target has it [N], checked against the robot.
    """
    if not isinstance(T_base, Mapping):
        return T_base
    return tuple(T_base.get(name, tendon.preload) for name, tendon, _ in config.strung)


def pulls_of(config: RobotConfig, target: TargetConfig) -> tuple[Pull, ...]:
    """The base tensions of all loads, each once, increasing; that before release last."""
    found = {pull_of(config, load.T_base) for load in target.loads if load.T_base is not None}
    if target.T_base_max is not None:
        found.add(target.T_base_max)
    return tuple(sorted(found, key=lambda pull: pull if isinstance(pull, tuple) else (pull,)))


def pull_says(pull: Any, names: tuple[str, ...]) -> str:
    """Base tensions in words, "45 N" or "left 5 N, right 2 N"."""
    if not names:
        return f"{float(pull):.4g} N"
    return ", ".join(f"{name} {float(T):.4g} N" for name, T in zip(names, pull, strict=True))
