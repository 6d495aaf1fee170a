"""What a simulation is compared with on the page: whatever a recording has, as a fit reads it."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibrate.inference.channels import ROTATION, channels_in, quantity_of, unit_of, words_of
from gtr_jax.numbers import display_unit
from gtr_jax.recordings.recording import Recording
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.markers import marker_readings, marker_rows

from .model import Curves

ANGLE, TENSION = "tip_angle", "T_tip"


@dataclasses.dataclass(frozen=True, eq=False)
class Compared:
    """One quantity along a history of K steps, of each tendon or of the only thing that has it.

    Attributes:
        label: what it is, for example "the tip's angle".
        unit: that it is shown in.
        simulated, recorded: in that unit, (K, columns); NaN where there is none.
    """

    label: str
    unit: str
    simulated: np.ndarray
    recorded: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """Simulated minus recorded, (K, columns)."""
        return self.simulated - self.recorded


def comparable(robot: Robot, recording: Recording | None) -> dict[str, str]:
    """The quantities that a recording lets a simulation be compared by, with what people call them; how the
    tip has turned in space, which the page does not draw, left out.
    """
    if recording is None:
        return {}
    channels = [name for name in channels_in(recording, robot) if name not in ROTATION]
    return {quantity_of(name): _label(quantity_of(name)) for name in channels}


def compared(curves: Curves, quantity: str) -> Compared:
    """A quantity along a history, and what was recorded of it there.

    Args:
        curves: the simulation.
        quantity: for example T_tip, tip_x or m1_y.
    """
    recording = curves.history.recording
    unit, size = display_unit(unit_of(quantity))
    simulated = _simulated(curves, quantity)
    recorded = None if recording is None else _recorded(recording, quantity)
    if recorded is None:
        recorded = np.full(simulated.shape, np.nan)
    return Compared(_label(quantity), unit, simulated / size, recorded.reshape(simulated.shape) / size)


def _recorded(recording: Recording, quantity: str) -> np.ndarray | None:
    """As recorded [SI], None where it was not."""
    return (
        recording.markers[quantity] if quantity in recording.markers else getattr(recording, quantity, None)
    )


def _label(quantity: str) -> str:
    return {"T_tip": "T_tip", "T_base": "T_base"}.get(quantity, words_of(quantity))


def _simulated(curves: Curves, quantity: str) -> np.ndarray:
    """As the instruments show it [SI], (K, columns)."""
    ends = {"T_base": curves.T_base, "T_tip": curves.T_tip, "displacement": curves.displacement}
    if quantity in ends:
        return ends[quantity]
    if quantity == ANGLE:
        return curves.tip_angle[:, None]
    position = np.asarray(curves.run.tip_position)
    tip = {f"tip_{axis}": position[:, i] for i, axis in enumerate("xyz")}
    if quantity in tip:
        return tip[quantity][:, None]
    places = marker_rows(curves.robot, marker_readings(curves.robot.for_any_terms(), curves.run))
    return np.asarray(places[quantity])[:, None]
