"""A simulator of a helical tendon in a soft arm that shares no code with `gtr_jax`: rigid links, ball joints.

The body is a chain of links whose guides stand h apart; between two guides a joint resists turning and
bending. The tendon runs straight from guide to guide, so that the length of each piece depends on one joint
only, and there Coulomb friction acts in the corner that it makes. Each guide remembers the tension beyond it.
Many arms are simulated side by side.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

LINKS = 240
ROUNDS = 9  # of the fixed point of each joint, whose contraction is T r^2/(E I), a few hundredths


@dataclasses.dataclass(frozen=True)
class Arms:
    """B arms, SI; every number (B,).

    Attributes:
        length, outer_radius, inner_radius: of the body, a round tube.
        E, nu: of its material.
        radius, turns, start_angle: of the helix that the channel is.
        mu: friction coefficient.
    """

    length: np.ndarray
    outer_radius: np.ndarray
    inner_radius: np.ndarray
    E: np.ndarray
    nu: np.ndarray
    radius: np.ndarray
    turns: np.ndarray
    start_angle: np.ndarray
    mu: np.ndarray

    def channel(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The channel in the section at arc lengths, (B,), and its derivative, (B, 3) each."""
        rate = 2 * np.pi * self.turns / self.length
        angle, nil = self.start_angle + rate * s, np.zeros_like(s)
        cos, sin = self.radius * np.cos(angle), self.radius * np.sin(angle)
        return np.stack([nil, cos, sin], axis=1), rate[:, None] * np.stack([nil, -sin, cos], axis=1)


@dataclasses.dataclass(frozen=True)
class Run:
    """What B arms do over K samples: tip tension [N], place of the tip [m], its rotation vector [rad], and
    the tendon drawn out [m].
    """

    T_tip: np.ndarray
    tip: np.ndarray
    rotation: np.ndarray
    displacement: np.ndarray


def turned(vector: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Vectors, (B, 3), turned by rotation vectors, (B, 3), by Rodrigues' formula."""
    angle = np.linalg.norm(by, axis=1, keepdims=True)
    axis = by / np.where(angle > 0, angle, 1.0)
    along = np.sum(axis * vector, axis=1, keepdims=True) * axis
    return along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))


def simulate(arms: Arms, T_base: np.ndarray, links: int = LINKS) -> Run:
    """Run arms through a history of base tensions.

    Args:
        arms: B of them.
        T_base: [N], (K, B).
        links: pieces that the tendon is divided into.
    """
    B, h = len(arms.length), arms.length / links
    half = np.stack([h / 2, np.zeros(B), np.zeros(B)], axis=1)
    EI = arms.E * np.pi / 4 * (arms.outer_radius**4 - arms.inner_radius**4)
    give = (h / np.stack([EI / (1 + arms.nu), EI, EI], axis=1).T).T
    places, slopes = zip(*(arms.channel(j * h) for j in range(links + 1)), strict=True)
    held = np.zeros((links + 1, B))  # tension beyond each guide
    bent = np.zeros((links, B, 3))
    rest = sum(
        np.linalg.norm(2 * half + after - before, axis=1) for before, after in itertools.pairwise(places)
    )
    found = {"T_tip": [], "tip": [], "rotation": [], "displacement": []}

    def tangent(at: int, turn: np.ndarray) -> np.ndarray:
        strain = turn / h[:, None]
        return np.array([1.0, 0, 0]) + np.cross(strain, places[at]) + slopes[at]

    def beyond(guide: int, T: np.ndarray, corner: np.ndarray) -> np.ndarray:
        grip = np.exp(arms.mu * corner)
        return np.clip(held[guide], T / grip, T * grip)

    for pull in T_base:
        T, length = pull, np.zeros(B)
        frame = np.broadcast_to(np.eye(3), (B, 3, 3)).copy()
        tip, arriving = np.zeros((B, 3)), np.zeros((B, 3))
        for j in range(links):
            turn = bent[j]
            for _ in range(ROUNDS):
                guide = turned(half + places[j + 1], turn)
                piece = half + guide - places[j]
                comes = arriving if j else tangent(0, turn)
                beyond_it = beyond(j, T, _angle(comes, piece))
                size = np.linalg.norm(piece, axis=1, keepdims=True)
                moment = np.cross(guide, -beyond_it[:, None] * piece / size)
                turn = give * turned(moment, -turn / 2)
            bent[j], held[j], T = turn, beyond_it, beyond_it
            length += size[:, 0]
            arriving = turned(piece, -turn)
            tip += np.einsum("bij,bj->bi", frame, half)
            frame = frame @ np.stack([turned(np.tile(e, (B, 1)), turn) for e in np.eye(3)], axis=2)
            tip += np.einsum("bij,bj->bi", frame, half)
        held[links] = beyond(links, T, _angle(arriving, tangent(links, bent[-1])))
        found["T_tip"].append(held[links].copy())
        found["tip"].append(tip)
        found["rotation"].append(_vector_of(frame))
        found["displacement"].append(rest - length)
    return Run(**{name: np.stack(values) for name, values in found.items()})


def _vector_of(frames: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(frames).as_rotvec()
