"""What a fit compares: channels, their units and words, and their readings in a recording.

A channel is named after its column of the recording; one of a tendon among several ends with the tendon's
name, as "T_tip.left". The tip's orientation becomes three channels: the rotation from the recorded to the
simulated orientation, in the tip's own axes, is added to the recorded turning of the tip so far, so that it
is a residual like any other and the noise of neighbouring samples shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gtr_jax import Recording, Robot
from gtr_jax.recordings.formats.quantities import ANGLE, column_of, marker_quantities
from gtr_jax.robot.rotation import quaternion_of

# Of one tendon in the plane.
CHANNELS = ("T_tip", "tip_x", "tip_y", "tip_angle", "displacement")
CHANNEL_UNITS = ("N", "m", "m", "rad", "m")
ORIENTATION = "tip_rotation"
ROTATION = tuple(f"{ORIENTATION}_{axis}" for axis in "xyz")
TINY = 1e-16  # square of half an angle below which its sine is the angle
_WORDS = {
    **{f"tip_{axis}": f"the tip's {axis}" for axis in "xyz"},
    **{name: f"the tip's rotation about its own {name[-1]} axis" for name in ROTATION},
    "tip_angle": "the tip's angle",
    "displacement": "the tendon's displacement",
    "T_tip": "the tension at the tip",
    "T_base": "the tension at the base",
}


class Orientation(NamedTuple):
    """The recorded orientation of the tip at K samples; arrays of NumPy, or of JAX in a program.

    Attributes:
        rotation: its directors as columns, (K, 3, 3).
        turned: how far it has turned since the first sample about its own axes [rad], (K, 3).
    """

    rotation: Any
    turned: Any

    def only(self, samples: np.ndarray) -> Orientation:
        """Some of the samples."""
        return Orientation(*(np.asarray(values)[samples] for values in self))


def orientation_of(recording: Recording) -> Orientation | None:
    """The recorded orientation; None where there is none."""
    quaternion = recording.tip_quaternion
    if quaternion is None:
        return None
    from scipy.spatial.transform import Rotation  # few recordings need it, and it takes long to import

    each = Rotation.from_quat(quaternion)
    steps = (each[:-1].inv() * each[1:]).as_rotvec()
    return Orientation(each.as_matrix(), np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))


def turned_by(rotation: Float[Array, "P 3 3"], recorded: Orientation) -> Float[Array, "P 3"]:
    """A simulated orientation as the channels ROTATION have it [rad], (P, 3): the rotation vector from the
    recorded one, less than half a turn, added to how far that has turned.
    """
    x, y, z, w = quaternion_of(jnp.einsum("pji,pjk->pik", jnp.asarray(recorded.rotation), rotation)).T
    square = x * x + y * y + z * z
    size = jnp.sqrt(jnp.where(square > TINY, square, 1.0))
    longer = jnp.where(square > TINY, 2.0 * jnp.arctan2(size, w) / size, 2.0)
    return jnp.asarray(recorded.turned) + jnp.stack([x, y, z], axis=1) * longer[:, None]


def turned_back(quaternion: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Quaternions (x, y, z, w) of the simulated orientation, (K, 4), from the recorded ones and the residual
    of the channels ROTATION [rad], (K, 3).
    """
    from scipy.spatial.transform import Rotation

    return (Rotation.from_quat(quaternion) * Rotation.from_rotvec(residual)).as_quat()


def quantity_of(channel: str) -> str:
    """The quantity of a channel, without the name of its tendon."""
    return channel.partition(".")[0]


def of_tendons(quantity: str, robot: Robot) -> list[str]:
    """The channels of a quantity that every tendon has, in their order."""
    return [f"{quantity}.{name}" for name in robot.tendon_names] or [quantity]


def tendon_of(channel: str, robot: Robot) -> int:
    """Number of the tendon that a channel belongs to."""
    return robot.tendon_names.index(channel.partition(".")[2]) if robot.tendon_names else 0


def unit_of(channel: str) -> str:
    """SI unit of a channel."""
    quantity = quantity_of(channel)
    return "rad" if quantity in ROTATION else column_of(quantity).unit


def words_of(channel: str) -> str:
    """A channel in words."""
    quantity, _, tendon = channel.partition(".")
    of = f" of {tendon}" if tendon else ""
    if quantity in _WORDS:
        return _WORDS[quantity] + of
    marker, _, axis = quantity.rpartition("_")
    return f"the angle at marker {marker}" if axis == ANGLE else f"the {axis} of marker {marker}"


def is_of_marker(channel: str) -> bool:
    """Whether a channel is the place of a marker, or the angle of its section."""
    return quantity_of(channel) not in _WORDS


def instrument_of(channel: str) -> str:
    """What the channels have in common that one instrument measures with one error: the places of all
    markers, the angles of their sections; else the channel itself.
    """
    if not is_of_marker(channel):
        return channel
    return "marker angles" if unit_of(channel) == "rad" else "marker places"


def chosen_by(channel: str) -> tuple[str, ...]:
    """The names under which a channel may be asked for: its own, its quantity's, and the orientation's or
    the marker's of which it is a part.
    """
    quantity = quantity_of(channel)
    whole = quantity.rpartition("_")[0]
    part = quantity in ROTATION or is_of_marker(channel)
    return (channel, quantity, *([whole] if part else []))


def channels_in(recording: Recording, robot: Robot) -> dict[str, np.ndarray]:
    """What a recording has that can be compared, by channel, SI, (K,) each, T_tip first.

    The displacement is compared where tension drives a tendon, and the base tension where displacement does.
    """
    found: dict[str, np.ndarray] = {}

    def per_tendon(quantity: str, drive: str) -> None:
        values = getattr(recording, quantity)
        if values is None:
            return
        columns = np.asarray(values, float).T if robot.tendon_names else [np.asarray(values, float)]
        for name, tendon, own in zip(of_tendons(quantity, robot), robot.tendons, columns, strict=True):
            if drive in ("", tendon.drive) and not np.all(np.isnan(own)):
                found[name] = own

    per_tendon("T_tip", "")
    axes = ("tip_x", "tip_y", "tip_z") if robot.space else ("tip_x", "tip_y", "tip_angle")
    for name in axes:
        if getattr(recording, name) is not None:
            found[name] = np.asarray(getattr(recording, name), float)
    turned = orientation_of(recording) if robot.space else None
    if turned is not None:
        found |= dict(zip(ROTATION, np.asarray(turned.turned).T, strict=True))
    per_tendon("displacement", "tension")
    per_tendon("T_base", "displacement")
    for marker in robot.markers:
        for name in marker_quantities(marker.name, space=robot.space):
            values = recording.markers.get(name)
            if values is not None:
                found[name] = np.asarray(values, float)
    return found


def known_to(robot: Robot) -> list[str]:
    """Names of all that recordings of a robot may be asked to be compared by."""
    pose = ["tip_z", *ROTATION] if robot.space else ["tip_angle"]
    places = [name for m in robot.markers for name in marker_quantities(m.name, space=robot.space)]
    ends = [name for quantity in ("displacement", "T_base") for name in of_tendons(quantity, robot)]
    drawn = any(tendon.drive == "displacement" for tendon in robot.tendons)
    ends = [name for name in ends if drawn or quantity_of(name) != "T_base"]
    every = ["T_tip", "tip_x", "tip_y", *pose, *ends, *places]
    return list(dict.fromkeys(name for channel in every for name in reversed(chosen_by(channel))))


def names_of(recordings: Sequence[Recording], robots: Sequence[Robot]) -> list[str]:
    """Every name under which a channel of some recording may be asked for."""
    each = (channels_in(recording, robot) for recording, robot in zip(recordings, robots, strict=True))
    return list(dict.fromkeys(name for found in each for channel in found for name in chosen_by(channel)))
