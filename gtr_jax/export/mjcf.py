"""A robot as MJCF, the model file of MuJoCo: the chain of `chain`, its tendons as spatial tendons.

MuJoCo has one tension along a whole tendon. Coulomb friction in the channel, by which the tension falls from
base to tip and remembers which way it was pulled, has no counterpart. A tendon's `frictionloss` is none
either: one force for the whole tendon at every tension, which is gone once the robot rests (docs/export.md).
So friction is left out, or a pull is reduced by the share that friction takes of it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.parts import Tendon
from gtr_jax.robot.robot import Robot, loads_of
from gtr_jax.simulation.equilibrium import equilibrium

from .chain import Chain, Link, chain_of
from .unloaded import end_of

LINKS = 40
MOST_LINKS = 500
RELAXATION = 0.02  # s, in which a joint's spring and damper alone come to rest
TIMESTEP = 0.002  # s
STRONGEST = 1e4  # N, above which no tension can be set
WIDTH = 0.02  # of a drawn tendon, of the body's radius
COLOUR, STRING = "0.75 0.78 0.82 0.5", ("0.84 0.37 0 1", "0 0.45 0.7 1", "0 0.62 0.45 1", "0.8 0.47 0.65 1")
WORLD = "world.frame"  # site in whose axes the load at the tip acts; with a dot, which no marker's name has
LOAD = "tip_load"  # actuator of the force and moment at the tip


def mjcf(config: RobotConfig, *, links: int = LINKS, friction_at: float | None = None) -> str:
    """A robot as MJCF. Actuators are named as the tendons ("tendon" of an only one); their control is the
    base tension [N]. A force or moment on the tip is an actuator "tip_load", whose control must be 1. The
    keyframe "rest" sets both, with the tendons at their preload.

    Args:
        config: the robot; of its terms those that are loads are taken, see `left_out`.
        links: number of the rigid links.
        friction_at: base tension [N]; actuators then pull with the share of their control that Coulomb
            friction leaves on average along the tendon, when it is pulled to this tension. None: with all.

    Raises:
        InputError: the body is rigid, notched or has no density, or a tendon is called as the motor of the
            load at the tip is.
        RuntimeError: the simulator finds no equilibrium at `friction_at`.
    """
    _refuse(config)
    if not 2 <= links <= MOST_LINKS:
        raise InputError(f"links: must lie between 2 and {MOST_LINKS}, is {links}; {LINKS} is the default")
    robot = build_robot(config)
    chain = chain_of(robot, links)
    shares = np.ones(len(robot.tendons)) if friction_at is None else shares_left(robot, friction_at)
    root = ET.Element("mujoco", model=config.name)
    root.append(ET.Comment(_says(config, links, friction_at)))
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    gravity = loads_of(robot).gravity_vector()
    ET.SubElement(
        root, "option", gravity=_numbers(gravity), timestep=f"{TIMESTEP:g}", integrator="implicitfast"
    )
    _bodies(ET.SubElement(root, "worldbody"), chain)
    strings = ET.SubElement(root, "tendon")
    motors = ET.SubElement(root, "actuator")
    for i, (tendon, share) in enumerate(zip(robot.tendons, shares, strict=True)):
        name = tendon.name or "tendon"
        width = WIDTH * float(robot.backbone.outer_radius[0])
        string = ET.SubElement(
            strings, "spatial", name=name, width=f"{width:.6g}", rgba=STRING[i % len(STRING)]
        )
        for k in range(len(chain.through(tendon))):
            ET.SubElement(string, "site", site=_site(tendon, k))
        ET.SubElement(
            motors, "motor", name=name, tendon=name, gear=f"{-share:.9g}", ctrlrange=f"0 {STRONGEST:g}"
        )
    force = _tip_load(robot)
    if np.any(force):
        if LOAD in robot.tendon_names:
            raise InputError(
                f"{config.source}: tendons.{LOAD}: is the name of the motor of the load at the tip; rename it"
            )
        ET.SubElement(motors, "motor", name=LOAD, site="tip", refsite=WORLD, gear=_numbers(force))
    preloads = [float(tendon.preload) for tendon in robot.tendons]
    held = [*preloads, *([1.0] if np.any(force) else [])]
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="rest", ctrl=_numbers(held))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def left_out(config: RobotConfig, *, friction_at: float | None = None) -> list[str]:
    """What of a robot its MJCF does not have, as phrases."""
    strung = [tendon for _, tendon, _ in config.strung]
    out = []
    if any(tendon.friction_coefficient > 0 for tendon in strung):
        out.append("friction" if friction_at is None else "friction's course along the tendon and its memory")
    if any(tendon.axial_stiffness is not None for tendon in strung):
        out.append("stretch of the tendons")
    if any(tendon.drive == "displacement" for tendon in strung):
        out.append("drive by displacement (actuators pull with a force)")
    return out + [term.id for term in config.terms if config.catalogue[term.id].loads is None]


def shares_left(robot: Robot, T_base: float) -> np.ndarray:
    """Mean tension along each tendon over the base tension [N] with which all are pulled, (tendons,).

    Raises:
        RuntimeError: there is no equilibrium.
    """
    several = len(robot.tendons) > 1
    found = equilibrium(robot, [T_base] * len(robot.tendons) if several else T_base)
    if not bool(found.converged):
        raise RuntimeError(f"no equilibrium at a base tension of {T_base:g} N; try a lower one")
    s, tension = np.asarray(found.s), np.atleast_2d(np.asarray(found.tension))
    shares = []
    for tendon, own in zip(robot.tendons, tension, strict=True):
        end = end_of(tendon, s[-1])
        there = s <= end * (1 + 1e-12)
        shares.append(np.trapezoid(own[there], s[there]) / end / T_base)
    return np.array(shares)


def _refuse(config: RobotConfig) -> None:
    body, where = config.backbone, config.source
    if body.rigid:
        raise InputError(f"{where}: backbone.rigid: a sheath of fixed shape has nothing that moves")
    if body.notches:
        raise InputError(f"{where}: backbone.notches: are not exported to MuJoCo; give the body by pieces")
    if body.density <= 0:
        raise InputError(f'{where}: backbone.density: MuJoCo needs masses; give it, as "1070 kg/m^3"')


def _says(config: RobotConfig, links: int, friction_at: float | None) -> str:
    """What stands at the top of the file; no two hyphens in a row, which a comment cannot hold."""
    out = left_out(config, friction_at=friction_at)
    without = f" Without: {', '.join(out)}." if out else ""
    said = (
        f"Written by gtr export: {config.name}, {links} links. Controls are base tensions in N. SI units. "
        f"The damping of the joints ({RELAXATION:g} s times their stiffness) is not of the robot.{without}"
    )
    return f" {said.replace('--', '- -')} "


def _numbers(values: Any) -> str:
    return " ".join(f"{float(v):.12g}" for v in np.asarray(values).ravel())


def _quat(matrix: np.ndarray) -> str:
    return _numbers(Rotation.from_matrix(matrix).as_quat(scalar_first=True))


def _site(tendon: Tendon, number: int) -> str:
    """A name that no marker has: markers' have no dot."""
    return f"{tendon.name or 'tendon'}.{number}"


def _tip_load(robot: Robot) -> np.ndarray:
    """Force and moment on the tip in the world, (6,)."""
    loads = loads_of(robot)
    force, moment = np.zeros(3), np.zeros(3)
    own = np.asarray(loads.tip_force)
    force[: len(own)] = own
    turn = np.atleast_1d(np.asarray(loads.tip_moment))
    moment[3 - len(turn) :] = turn
    return np.concatenate([force, moment])


def _bodies(world: ET.Element, chain: Chain) -> None:
    """The links, one in the other, with the points of tendons and markers."""
    robot = chain.robot
    ET.SubElement(world, "site", name=WORLD, size="1e-4")
    base = ET.SubElement(
        world,
        "body",
        name="base",
        pos=_numbers(robot.base.position),
        quat=_quat(np.asarray(robot.base.rotation)),
    )
    bodies, h = [base], chain.step
    _drawn(base, chain, 0.0, 0.5 * h)
    for i, link in enumerate(chain.links):
        body = ET.SubElement(
            bodies[-1], "body", name=f"link_{i}", pos=_numbers(link.joint), quat=_quat(link.turn)
        )
        _inertial(body, link, chain, last=i + 1 == len(chain.links))
        _joints(body, link, i)
        _drawn(body, chain, link.start, link.end)
        bodies.append(body)
    places = [
        (_site(tendon, k), float(s), place)
        for tendon in robot.tendons
        for k, (s, place) in enumerate(_points(chain, tendon))
    ]
    places += [(marker.name, *_marker(chain, marker)) for marker in robot.markers]
    for name, s, place in places:
        number, own = chain.in_link(s, place)
        ET.SubElement(bodies[number], "site", name=name, pos=_numbers(own), size="1e-4")
    _tip(bodies[-1], chain)


def _points(chain: Chain, tendon: Tendon) -> list[tuple[float, np.ndarray]]:
    s = chain.through(tendon)
    return list(zip(s, chain.body.channel(tendon)(s), strict=True))


def _marker(chain: Chain, marker) -> tuple[float, np.ndarray]:
    at = float(marker.at)
    (middle,), (frame,) = chain.body.at(np.array([at]))
    return at, middle + frame @ np.asarray(marker.offset)


def _tip(body: ET.Element, chain: Chain) -> None:
    """The section at the tip as a site, in the axes of the body there."""
    link = chain.links[-1]
    (start, end), (first, last) = chain.body.at(np.array([link.start, link.end]))
    place, turn = first.T @ (end - start), first.T @ last
    ET.SubElement(body, "site", name="tip", pos=_numbers(place), quat=_quat(turn), size="1e-4")


def _inertial(body: ET.Element, link: Link, chain: Chain, *, last: bool) -> None:
    mass, centre, inertia = link.mass, link.centre, link.inertia
    payload = float(loads_of(chain.robot).payload) if last else 0.0
    if payload > 0:
        (start, end), (first, _) = chain.body.at(np.array([link.start, link.end]))
        tip, whole = first.T @ (end - start), mass + payload
        both = (mass * centre + payload * tip) / whole
        for m, arm in ((mass, centre - both), (payload, tip - both)):
            inertia = inertia + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        mass, centre = whole, both
    i = inertia
    full = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
    ET.SubElement(body, "inertial", pos=_numbers(centre), mass=_numbers([mass]), fullinertia=_numbers(full))


def _joints(body: ET.Element, link: Link, number: int) -> None:
    """Hinges about x, y and z of a robot in space, about z in the plane; a slider along x if it stretches.

    Rotations about three axes depend on their order; it is turned round from joint to joint, so that this
    cancels to first order in the angles.
    """
    axes = "xyz" if len(link.stiffness) == 3 else "z"
    springs = [(f"{axis}_{number}", axis, "hinge", k) for axis, k in zip(axes, link.stiffness, strict=True)]
    springs = springs[::-1] if number % 2 else springs
    if link.along is not None:
        springs.insert(0, (f"along_{number}", "x", "slide", link.along))
    for name, axis, kind, stiffness in springs:
        ET.SubElement(
            body,
            "joint",
            name=name,
            type=kind,
            axis=_numbers([float(axis == a) for a in "xyz"]),
            stiffness=_numbers([stiffness]),
            damping=_numbers([RELAXATION * stiffness]),
        )


def _drawn(body: ET.Element, chain: Chain, start: float, end: float) -> None:
    """The link as a cylinder that touches nothing and weighs nothing."""
    (first, last), (frame, _) = chain.body.at(np.array([start, end]))
    radius = float(np.mean(np.asarray(chain.robot.backbone.radius(jnp.array([start, end])))))
    tip = last - first if start == 0 else frame.T @ (last - first)
    ET.SubElement(
        body,
        "geom",
        type="cylinder",
        fromto=_numbers([0, 0, 0, *tip]),
        size=f"{radius:.6g}",
        mass="0",
        contype="0",
        conaffinity="0",
        rgba=COLOUR,
    )
