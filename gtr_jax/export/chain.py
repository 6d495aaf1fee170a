"""A body as a chain of rigid links with springs between them, and its tendons as lines through points of the
links: what simulators of rigid bodies take.

The body of length L is cut into n stretches of the length h = L/n. In the middle of each is a joint, at
s = (i + 1/2) h; its spring is as compliant as the stretch, the integral of 1/EI, and at rest where the body
is. Link i reaches from joint i to the next one; the half stretch before the first joint is fixed to the base.
A tendon goes through the points of its channel at s = 0, h, 2h, ..., the middles of the links, so that a pull
has at each joint the moment arm of the channel there, to second order in h. Points nearer to the joints would
tilt what crosses them by more than the body is strained, since all of a stretch's strain is in its joint.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from gtr_jax.robot.backbone import Backbone
from gtr_jax.robot.parts import Tendon
from gtr_jax.robot.robot import Robot

from .unloaded import Unloaded, end_of, in_blocks, stops_of, unloaded

SUMMED = 64  # places in each stretch over which its compliance and mass are summed


@dataclasses.dataclass(frozen=True, eq=False)
class Link:
    """One rigid link, in its own axes: those of the body's section at its joint, which is its origin.

    Attributes:
        start, end: arc lengths [m].
        joint: place of its joint in the link before it [m], (3,).
        turn: its axes at rest in those of the link before it, as columns, (3, 3).
        stiffness: of the joint [N m/rad], (1,) about z in the plane, (3,) about x, y and z in space.
        along: of the joint against stretching [N/m]; None of a body that does not stretch.
        mass: [kg].
        centre: of mass [m], (3,).
        inertia: about it [kg m^2], (3, 3).
    """

    start: float
    end: float
    joint: np.ndarray
    turn: np.ndarray
    stiffness: np.ndarray
    along: float | None
    mass: float
    centre: np.ndarray
    inertia: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """A robot as a chain.

    Attributes:
        robot: of which.
        body: at rest.
        links: from the base, without what is fixed to it.
    """

    robot: Robot
    body: Unloaded
    links: tuple[Link, ...]

    @property
    def step(self) -> float:
        """h [m]."""
        return self.body.length / len(self.links)

    def link_at(self, s: float) -> int:
        """Which link an arc length [m] is on; 0 is what is fixed to the base, i + 1 the link i."""
        return int(np.clip(np.floor(s / self.step + 0.5 + 1e-9), 0, len(self.links)))

    def in_link(self, s: float, place: np.ndarray) -> tuple[int, np.ndarray]:
        """The link at s [m], and a place in the body at rest [m], (3,), in the axes of that link."""
        number = self.link_at(s)
        if number == 0:
            return 0, place
        (origin,), (frame,) = self.body.at(np.array([self.links[number - 1].start]))
        return number, frame.T @ (place - origin)

    def through(self, tendon: Tendon) -> np.ndarray:
        """Arc lengths of the points that a tendon goes through [m]: the middles of the links and its anchor,
        or its guides.
        """
        stops = stops_of(tendon, self.body.length)
        if stops is not None:
            return stops
        end = end_of(tendon, self.body.length)
        middles = self.step * np.arange(len(self.links) + 1)
        return np.append(middles[middles < end - 1e-9 * self.body.length], end)


def chain_of(robot: Robot, links: int) -> Chain:
    """A robot as a chain of `links` links; its loads and terms are not looked at."""
    body = unloaded(robot)
    h = body.length / links
    starts = h * (np.arange(links) + 0.5)
    compliance = _summed(body, h * np.arange(links), h, lambda s, within: _compliance(robot, s, within))
    origins, frames = body.at(starts)
    found = []
    for i, start in enumerate(starts):
        end = starts[i + 1] if i + 1 < links else body.length
        before, turned = (np.zeros(3), np.eye(3)) if i == 0 else (origins[i - 1], frames[i - 1])
        mass, centre, inertia = _mass(body, float(start), float(end), origins[i], frames[i])
        found.append(
            Link(
                start=float(start),
                end=float(end),
                joint=turned.T @ (origins[i] - before),
                turn=turned.T @ frames[i],
                stiffness=1.0 / compliance[i, :3],
                along=1.0 / float(compliance[i, 3]) if compliance.shape[1] == 4 else None,
                mass=mass,
                centre=centre,
                inertia=inertia,
            )
        )
    return Chain(robot, body, tuple(found))


def _within(backbone: Backbone, s: np.ndarray) -> jnp.ndarray:
    """Which bores, pieces and notches each arc length lies in."""
    starts, ends = backbone.stretches
    at = jnp.asarray(s)[None, :]
    return (starts[:, None] <= at) & (at < ends[:, None])


def _compliance(robot: Robot, s: np.ndarray, within: jnp.ndarray) -> jnp.ndarray:
    if robot.space:
        return robot.backbone.compliances(jnp.asarray(s), within)
    return robot.backbone.compliance(jnp.asarray(s), within)[:, None]


def _summed(body: Unloaded, starts: np.ndarray, length: float, along) -> np.ndarray:
    """Integrals over stretches of one length that begin at `starts` [m] of what a function gives there."""
    share = (np.arange(SUMMED) + 0.5) / SUMMED
    s = (starts[:, None] + length * share).ravel()
    values = in_blocks(lambda s: along(s, _within(body.robot.backbone, s)), s)
    return length * values.reshape(len(starts), SUMMED, -1).mean(axis=1)


def _mass(
    body: Unloaded, start: float, end: float, origin: np.ndarray, frame: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, its centre and the inertia about it of the body between two arc lengths, in the axes of a link
    with this origin and frame.
    """
    backbone, step = body.robot.backbone, (end - start) / SUMMED
    s = start + step * (np.arange(SUMMED) + 0.5)

    def sections(s: np.ndarray) -> jnp.ndarray:
        within, at = _within(backbone, s), jnp.asarray(s)
        return jnp.stack([backbone.area(at, within), *backbone.second_moments(at, within)], axis=1)

    area, about_y, about_z = (float(backbone.density) * step * in_blocks(sections, s)).T
    middle, frames = body.at(s)
    place, turn = (middle - origin) @ frame, frame.T @ frames
    mass = float(area.sum())
    centre = area @ place / mass if mass > 0 else np.zeros(3)
    arm = place - centre
    slices = np.stack([about_y + about_z, about_y, about_z], axis=1)
    turning = np.einsum("nij,nj,nkj->ik", turn, slices, turn)
    points = np.einsum("n,nij->ij", area, np.sum(arm**2, axis=1)[:, None, None] * np.eye(3))
    return mass, centre, turning + points - np.einsum("n,ni,nj->ij", area, arm, arm)
