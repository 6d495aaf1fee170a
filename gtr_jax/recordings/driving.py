"""Which tendons a recording drives by displacement, and how it drives them all."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError

from .recording import Recording


class Drive(NamedTuple):
    """What drives the tendons along a history.

    Attributes:
        T_base: base tension [N], (K, *tendons); NaN of tendons that displacement drives.
        displacement: drawn out at the base [m], (K, *tendons); None if tension drives them all.
    """

    T_base: np.ndarray
    displacement: np.ndarray | None


def driven(config: RobotConfig, given: Recording) -> tuple[RobotConfig, Drive]:
    """The robot and its history as a file drives it: a tendon without base tension by its displacement.

    Raises:
        InputError: displacement drives a tendon that has none.
    """
    strung = [(name, tendon.drive) for name, tendon, _ in config.strung]
    drawn = driven_by(given, strung)
    if not drawn:
        return config, Drive(given.T_base.copy(), None)
    which = np.asarray([name in drawn for name, _ in strung]).reshape(given.T_base.shape[1:])
    keys = {f"tendons.{name}.drive" if name else "tendon.drive": "displacement" for name in drawn}
    return config.with_values(keys), Drive(np.where(which, np.nan, given.T_base), given.displacement)


def driven_by(recording: Recording, tendons: Iterable[tuple[str, str]]) -> list[str]:
    """Names of the tendons that a recording drives by displacement: those that their robot has driven so, and
    those of which it has no base tension.

    Args:
        recording: of a robot.
        tendons: name of each tendon, "" for the only one, and what drives it by the robot file.

    Raises:
        InputError: displacement drives a tendon of which the recording has none.
    """
    columns = recording.T_base.reshape(len(recording), -1)
    places = None if recording.displacement is None else recording.displacement.reshape(len(recording), -1)
    found = []
    for i, (name, drive) in enumerate(tendons):
        if drive == "displacement" and (places is None or np.all(np.isnan(places[:, i]))):
            ending = f".{name}" if name else ""
            raise InputError(
                f"{recording.path}: no column displacement_m{ending}, by which the tendon is driven; add it, "
                'or write drive = "tension" in the robot file'
            )
        if drive == "displacement" or np.all(np.isnan(columns[:, i])):
            found.append(name)
    return found
