"""Which tendons a recording drives by displacement."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gtr_jax.errors import InputError

from .recording import Recording


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
