"""soromox's robots for the problems in space: of piecewise constant strain, and of a strain that is a
polynomial along the whole rod.
"""
# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from soromox.actuation import ThreadlikeActuator, ThreadlikeRouting
from soromox.actuation.threadlike import BaseThreadlikeRoutingParams
from soromox.systems import GVS, PCS, LinkSpec, PCSStructure
from soromox.systems.components import JointSpec
from soromox.systems.gvs import GVSSegment, StrainBasisSpec

from .problem import LENGTH, POISSONS_RATIO, RADIUS, YOUNGS_MODULUS, SpatialProblem

SEGMENTS = (1, 2, 4, 8, 16, 32)
POINTS = 10  # of Gauss, least along the whole rod
# Orders of the polynomials, and points of Gauss.
POLYNOMIALS = ((1, 10), (2, 10), (3, 12), (4, 12), (6, 16), (8, 24), (8, 40), (10, 60))
BASE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])  # place and quaternion


class Setting(NamedTuple):
    """A robot, how it is called and its number of coordinates."""

    name: str
    robot: PCS | GVS
    size: int


class Wound(BaseThreadlikeRoutingParams):
    """Channels of which radius and angle are linear in the arc length, (n,) each."""

    radius: jnp.ndarray
    growth: jnp.ndarray
    start_angle: jnp.ndarray
    speed: jnp.ndarray
    start_segment_index: tuple[int, ...] = eqx.field(static=True)
    end_segment_index: tuple[int, ...] = eqx.field(static=True)

    @property
    def num_paths(self) -> int:
        """Number of channels."""
        return len(self.start_segment_index)

    def validate_structure(self) -> None:
        """All are arrays of one length."""

    def validate_values(self) -> None:
        """Any radius and angle will do."""


def _place(channel: Wound, s):
    radius, angle = channel.radius + channel.growth * s, channel.start_angle + channel.speed * s
    return radius * jnp.stack([jnp.zeros_like(angle), jnp.cos(angle), jnp.sin(angle)])


def _slope(channel: Wound, s):
    radius, angle = channel.radius + channel.growth * s, channel.start_angle + channel.speed * s
    out = jnp.stack([jnp.zeros_like(angle), jnp.cos(angle), jnp.sin(angle)])
    round_ = jnp.stack([jnp.zeros_like(angle), -jnp.sin(angle), jnp.cos(angle)])
    return channel.growth * out + radius * channel.speed * round_


def tendons(problem: SpatialProblem, segments: int) -> ThreadlikeActuator:
    """The tendons of a problem."""
    channels = problem.channels
    params = Wound(
        radius=jnp.array([c.radius for c in channels]),
        growth=jnp.array([(c.tip_radius - c.radius) / LENGTH for c in channels]),
        start_angle=jnp.array([c.start_angle for c in channels]),
        speed=jnp.array([2 * jnp.pi * c.turns / LENGTH for c in channels]),
        start_segment_index=(0,) * len(channels),
        end_segment_index=(segments - 1,) * len(channels),
    )
    return ThreadlikeActuator.tendons(
        ThreadlikeRouting(params=params, offset_fn=_place, derivative_fn=_slope)
    )


def _link(length: float) -> LinkSpec:
    return LinkSpec.circular(
        length=length,
        radius=RADIUS,
        density=1000.0,
        reference_strain=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        young_modulus=YOUNGS_MODULUS,
        poisson_ratio=POISSONS_RATIO,
    )


def settings(problem: SpatialProblem, quick: bool) -> Iterator[Setting]:
    """Every robot that is tried."""
    still = {"gravity": jnp.zeros(3), "base_pose": jnp.asarray(BASE)}
    for n in SEGMENTS[: 4 if quick else None]:
        structure = PCSStructure(
            num_gauss_points=max(2, POINTS // n), strain_selector=[True, True, True, False, False, False] * n
        )
        robot = PCS.from_links(
            [_link(LENGTH / n)] * n,
            structure=structure,
            actuators=tendons(problem, n),
            backend="jax",
            **still,
        )
        yield Setting(f"{n} segment{'s' * (n > 1)}", robot, 3 * n)
    for order, points in POLYNOMIALS[: 4 if quick else None]:
        segment = GVSSegment(
            link=_link(LENGTH),
            joint=JointSpec.fixed(),
            basis=StrainBasisSpec("legendre", ["kappa_x", "kappa_y", "kappa_z"], order),
            num_gauss_points=points,
        )
        robot = GVS.from_segments([segment], actuators=tendons(problem, 1), backend="jax", **still)
        yield Setting(f"strain of order {order}, {points} points", robot, 3 * (order + 1))
