"""Shapes that no real body takes: a body that passes through itself, or a wall strained beyond the linear
law.

The mechanics models a linearly elastic midline and knows no contact of the body with itself. Pulled
hard enough, the body winds up into itself: the equations still have a solution, but it means nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .backbone import Backbone
from .shapes import strains

STRAIN_LIMIT = 0.5  # strain of the wall beyond which the linear law of bending is not credible
LOOKED_AT = 200  # most steps of a history checked for overlap; a check takes (2 nodes)^2 comparisons


@dataclass(frozen=True)
class Impossible:
    """Why no real body can follow a simulation.

    Attributes:
        overlap_step: first of the steps looked at in which the body's outline crosses itself, from 0; None if
            none does.
        overlap_T_base: largest base tension in that step [N].
        strain: largest strain of the wall, |kappa - kappa_0| r and of a body that stretches |e| more, in any
            step.
        strain_step: the step of that strain, from 0.
        rigid: whether it is a sheath of fixed shape.
    """

    overlap_step: int | None
    overlap_T_base: float
    strain: float
    strain_step: int
    rigid: bool = False

    @property
    def overlaps(self) -> bool:
        """Whether the body passes through itself."""
        return self.overlap_step is not None

    @property
    def means_nothing(self) -> bool:
        """Whether the simulation says nothing about any robot. The tensions in a sheath of fixed shape follow
        from how far it turns, wherever it runs.
        """
        return self.overlaps and not self.rigid

    @property
    def says(self) -> tuple[str, ...]:
        """What is wrong, as sentences."""
        said = []
        if self.overlaps and self.rigid:
            said.append(
                "The sheath passes through itself: no sheath can take this shape. The tensions hold for "
                "one that turns as far and is led past itself; places do not."
            )
        elif self.overlap_step is not None:
            said.append(
                f"The body passes through itself from step {self.overlap_step + 1} on (base tension "
                f"{self.overlap_T_base:.3g} N), which the model does not hinder: no robot can take this "
                "shape; "
                "do not use what follows, pull less."
            )
        if self.strain > STRAIN_LIMIT:
            said.append(
                f"The wall is strained by {100 * self.strain:.2g} % in step {self.strain_step + 1}; beyond "
                f"{100 * STRAIN_LIMIT:.0f} % the model's linear law of bending does not hold."
            )
        return tuple(said)


def impossible(
    backbone: Backbone,
    s: Float[Array, " N"],
    *,
    curvature: Float[Array, "K N"],
    angle: Float[Array, "K N"],
    T_base: Float[Array, "K *tendons"],
) -> Impossible:
    """What no real body can do of a simulation. A rigid sheath is strained by nothing.

    Args:
        backbone: the body.
        s: its nodes [m], (N,).
        curvature: of the midline in every step [1/m], (K, N).
        angle: of the midline [rad], (K, N).
        T_base: base tension of every tendon [N], (K, *tendons).
    """
    if backbone.rigid:
        curvature, angle, T_base = curvature[:1], angle[:1], T_base[:1]
    radius, rest = np.asarray(backbone.radius(s)), np.asarray(backbone.curvature_at_rest(s))
    fibre = radius
    if backbone.notches or backbone.shape is not None:
        start, end = (np.asarray(places)[:, None] for places in backbone.stretches)
        within = jnp.asarray((start <= np.asarray(s)) & (np.asarray(s) <= end))
        fibre = np.asarray(backbone.reach(s, within))
    kappa, phi, nodes = np.asarray(curvature), np.asarray(angle), np.asarray(s)
    pull = np.asarray(T_base).reshape(len(phi), -1).max(axis=1)
    bent = np.abs(kappa - rest) * fibre
    strain = np.where(np.all(np.isfinite(bent), axis=1), bent.max(axis=1), 0.0)
    # A curve in a plane that turns by less than half a turn in all, and nowhere more sharply than its wall
    # allows, does not cross itself, nor do its walls.
    turned = np.sum(np.abs(np.diff(phi, axis=1)), axis=1)
    able = np.flatnonzero((turned > 0.5 * np.pi) | (np.abs(kappa) * radius >= 1.0).any(axis=1))
    some = able[:: -(-len(able) // LOOKED_AT)] if len(able) else able
    found = next((int(k) for k in some if crosses_itself(outline(nodes, phi[k], radius))), None)
    at = 0.0 if found is None else float(pull[found])
    if backbone.rigid:
        return Impossible(found, at, 0.0, 0, rigid=True)
    return Impossible(found, at, float(strain.max()), int(strain.argmax()))


def impossible_in_space(
    backbone: Backbone,
    s: Float[Array, " N"],
    *,
    strain: Float[Array, "K N 3"],
    position: Float[Array, "K N 3"],
    T_base: Float[Array, "K *tendons"],
    stretch: Float[Array, "K N"] | None = None,
) -> Impossible:
    """What no real body can do of a simulation in space. The wall is strained by bending and by the stretch
    of the axis, |kappa - kappa_0| r + |e|, and sheared by twist; the larger one is told. A rigid sheath is
    strained by nothing.

    Args:
        backbone: the body.
        s: its nodes [m], (N,).
        strain: twist and bendings in every step [1/m], (K, N, 3).
        position: of the midline [m], (K, N, 3).
        T_base: base tension of every tendon [N], (K, *tendons).
        stretch: of the axis [-]; None of a body that does not stretch.
    """
    if backbone.rigid:
        strain, position, T_base, stretch = strain[:1], position[:1], T_base[:1], None
    longer = 0.0 if stretch is None else np.asarray(stretch)
    radius, rest = np.asarray(backbone.radius(s)), np.asarray(backbone.strain_at_rest(s))[:, :3]
    u, p, nodes = np.asarray(strain), np.asarray(position), np.asarray(s)
    pull = np.asarray(T_base).reshape(len(u), -1).max(axis=1)
    more = u - rest
    if backbone.shape is None:
        sheared, bends = np.abs(more[..., 0]) * radius, np.linalg.norm(more[..., 1:], axis=-1) * radius
    else:
        sheared, bends = strains(backbone.shape, more)
    wall = np.maximum(sheared, bends + np.abs(longer))
    worst = np.where(np.all(np.isfinite(wall), axis=1), wall.max(axis=1), 0.0)
    bent = np.linalg.norm(u[..., 1:], axis=-1)
    turned = np.sum(0.5 * (bent[:, 1:] + bent[:, :-1]) * np.diff(nodes), axis=1)
    able = np.flatnonzero((turned > 0.5 * np.pi) | (bent * radius >= 1.0 + longer).any(axis=1))
    some = able[:: -(-len(able) // LOOKED_AT)] if len(able) else able
    folded = (bent * radius >= 1.0 + longer).any(axis=1)
    found = next((int(k) for k in some if folded[k] or meets_itself(nodes, p[k], radius)), None)
    at = 0.0 if found is None else float(pull[found])
    if backbone.rigid:
        return Impossible(found, at, 0.0, 0, rigid=True)
    return Impossible(found, at, float(worst.max()), int(worst.argmax()))


def meets_itself(s: np.ndarray, position: np.ndarray, radius: np.ndarray) -> bool:
    """Whether two parts of a body in space come nearer to one another than their radii allow.

    Parts count that lie farther apart along the body than half a turn about their radii, which is as near as
    a body that is not folded comes to itself by bending on.

    Args:
        s: nodes [m], (N,).
        position: of the midline there [m], (N, 3).
        radius: of the body there [m], (N,).
    """
    if not np.all(np.isfinite(position)):
        return False
    room = radius[:, None] + radius[None, :]
    far = np.abs(s[:, None] - s[None, :]) > 0.5 * np.pi * room
    apart = np.linalg.norm(position[:, None] - position[None, :], axis=-1)
    return bool(np.any(far & (apart < room)))


def outline(s: np.ndarray, angle: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The body's outline from the base along one wall, over the tip and back along the other, (2N, 2) [m].

    Args:
        s: nodes [m], (N,).
        angle: of the midline there [rad], (N,).
        radius: of the body there [m], (N,).
    """
    tangent = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    steps = np.diff(s)[:, None] * 0.5 * (tangent[1:] + tangent[:-1])
    middle = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    wall = radius[:, None] * normal
    return np.concatenate([middle + wall, (middle - wall)[::-1]])


def crosses_itself(points: np.ndarray) -> bool:
    """Whether any two non-adjacent sides of an open polygon (n, 2) cross."""
    if not np.all(np.isfinite(points)):
        return False
    a, b = points[:-1], points[1:]

    def side(p, q, r):
        """Sign of the area of each triangle of a side (p, q) and each point r, (n, n)."""
        u, v = q - p, r[None, :, :] - p[:, None, :]
        return np.sign(u[:, None, 0] * v[..., 1] - u[:, None, 1] * v[..., 0])

    apart = side(a, b, a) * side(a, b, b)  # (i, j) < 0: ends of j on opposite sides of i
    return bool(np.any(np.triu((apart < 0) & (apart.T < 0), k=2)))
