"""The midline of a body that nothing loads: its natural strain, followed along the body from the base, which
is at the origin with its tangent along x.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .sections import BackboneConfig

PLACES = 1001  # along the body, at which its shape is known; between them it is followed in one step


@dataclasses.dataclass(frozen=True, eq=False)
class Midline:
    """A midline, known at places along it.

    Attributes:
        s: arc lengths [m], (M,), increasing from 0 to the length.
        middle: places there [m], (M, 3).
        frames: directors of the sections as columns, (M, 3, 3).
        strain: natural twist and curvatures about y and z [1/m], (N, 3), at arc lengths [m], (N,).
        straight: whether there is none.
    """

    s: np.ndarray
    middle: np.ndarray
    frames: np.ndarray
    strain: Callable[[np.ndarray], np.ndarray]
    straight: bool

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places [m], (N, 3), and directors as columns, (N, 3, 3), at arc lengths [m], (N,)."""
        s = np.asarray(s, float)
        if self.straight:
            return s[:, None] * np.eye(3)[0], np.broadcast_to(np.eye(3), (len(s), 3, 3))
        below = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 1)
        step = s - self.s[below]
        ahead, turn = _steps(step, self.strain(self.s[below] + 0.5 * step))
        middle = self.middle[below] + np.einsum("nij,nj->ni", self.frames[below], ahead)
        return middle, self.frames[below] @ turn


def _steps(step: np.ndarray, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Way [m], (N, 3), and rotation, (N, 3, 3), along steps [m], (N,), in the axes of their beginnings, with
    the strain in their middles [1/m], (N, 3).
    """
    from scipy.spatial.transform import Rotation

    turn = step[:, None] * strain
    half, whole = (Rotation.from_rotvec(part * turn).as_matrix() for part in (0.5, 1.0))
    return step[:, None] * half[:, :, 0], whole


def followed(s: np.ndarray, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Midline [m], (N, 3), and directors as columns, (N, 3, 3), at increasing arc lengths from 0 on [m],
    (N,), of a body with this strain in the middles between them [1/m], (N - 1, 3).
    """
    frames, middle = [np.eye(3)], [np.zeros(3)]
    for ahead, turn in zip(*_steps(np.diff(s), strain), strict=True):
        middle.append(middle[-1] + frames[-1] @ ahead)
        frames.append(frames[-1] @ turn)
    return np.array(middle), np.array(frames)


def midline(
    length: float, strain: Callable[[np.ndarray], np.ndarray], kinks: Iterable[float] = ()
) -> Midline:
    """The midline of a body.

    Args:
        length: of the body [m].
        strain: natural twist and curvatures about y and z [1/m], (N, 3), over arc length [m], (N,).
        kinks: arc lengths where its derivative jumps [m].
    """
    s = np.unique(np.clip([*np.linspace(0.0, length, PLACES), *kinks], 0.0, length))
    own = strain(0.5 * (s[1:] + s[:-1]))
    straight = not (np.any(own) or np.any(strain(s)))
    return Midline(s, *followed(s, own), strain, straight)


def midline_at_rest(backbone: BackboneConfig) -> Midline:
    """The midline of a body as its file describes it, its notches as they are cut."""
    tables = [
        np.asarray(along if isinstance(along, tuple) else [(0.0, along)], float)
        for along in (backbone.natural_twist, backbone.natural_curvature_y, backbone.natural_curvature)
    ]

    def strain(s: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(s, *table.T) for table in tables], axis=-1)

    return midline(backbone.length, strain, [k for table in tables for k in table[:, 0]])
