"""What a diagnosis compares: the channels that `gtr fit` compares, as a simulation shows them.

A robot of one tendon in the plane has the five of `CHANNELS`, whether they are recorded or not, because the
experiment that is proposed next may record them; any other robot has the tensions and displacements of each
of its tendons and the place of its tip. Those of the tip's orientation and of markers are added where they
are recorded.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gtr_jax import InputError, Robot

from .channels import CHANNELS, of_tendons, quantity_of, tendon_of, unit_of
from .setup import Observation


def instruments(robot: Robot, recorded: Sequence[str]) -> tuple[str, ...]:
    """Names of the channels that simulations of a recording hold, the tip tensions first.

    Args:
        robot: what was recorded.
        recorded: channels that are compared.
    """
    drawn = [tendon.drive == "displacement" for tendon in robot.tendons]
    if not (robot.space or robot.tendon_names):
        every = CHANNELS
    else:
        pose = ("tip_x", "tip_y", "tip_z" if robot.space else "tip_angle")
        ends = [
            of_tendons("T_base" if by_draw else "displacement", robot)[i] for i, by_draw in enumerate(drawn)
        ]
        every = (*of_tendons("T_tip", robot), *pose, *ends)
    return tuple(dict.fromkeys((*every, *recorded)))


def explained_first(parts: Sequence[Observation]) -> list[Observation]:
    """Recordings with the channels first that a diagnosis explains: the tip tensions; where none was
    recorded, those of the unit that most channels of all recordings have.

    Raises:
        InputError: a recording without tip tension has no channel of that unit.
    """
    if parts[0].tips:
        return list(parts)
    units = [unit_of(name) for part in parts for name in part.channels]
    most, found = max(dict.fromkeys(units), key=units.count), []
    for part in parts:
        order = sorted(range(len(part.channels)), key=lambda c: unit_of(part.channels[c]) != most)
        channels = tuple(part.channels[c] for c in order)
        if unit_of(channels[0]) != most:
            what = {"m": "place", "rad": "angle", "N": "tension"}[most]
            raise InputError(
                f"{part.path}: has no {what}, which the others have; diagnose it by itself, or add the column"
            )
        found.append(dataclasses.replace(part, channels=channels, recorded=part.recorded[order]))
    return found


class Cells(NamedTuple):
    """Whether the tension at the tip, and at the base, is read by a cell in every recording."""

    tip: bool = True
    base: bool = True


BOTH = Cells()


def cells_of(parts: Sequence[Observation]) -> Cells:
    """Which cells recordings have."""
    base = all(p.pulled or any(quantity_of(name) == "T_base" for name in p.channels) for p in parts)
    return Cells(all(p.tips for p in parts), bool(base))


def leading(part: Observation) -> int:
    """Number of the tendon that leads: what drives it changes most, as a share of its largest value, and
    then, of several, by most.
    """

    def size(i: int) -> tuple[float, float]:
        T = part.drives[i].T_base
        return round(float(np.ptp(T)) / max(float(np.max(np.abs(T))), 1e-12), 2), float(np.ptp(T))

    return max(range(len(part.drives)), key=lambda i: (*size(i), -i))


def of_one(values: np.ndarray, tendon: int) -> np.ndarray:
    """Values of one tendon, (K,), of such with or without a tendon axis, (K, *tendons)."""
    return values if values.ndim == 1 else values[:, tendon]


def tendon_of_channel(part: Observation, channel: str) -> int:
    """Number of the tendon by whose phases a channel is judged: its own, or that which leads."""
    ends = channel.partition(".")[2] or len(part.drives) == 1
    return tendon_of(channel, part.robot) if ends else leading(part)


def words_for(part: Observation, tendon: int) -> str:
    """The name of one of several tendons, as words end with it: " of left"; "" of the only one."""
    names = part.robot.tendon_names
    return f" of {names[tendon]}" if names else ""
