"""Pictures of a design in space, or of several tendons: the body at every target from three sides and turned,
the tip's way, the channels unrolled, the tension along each tendon.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from gtr_jax.plots.tension import plot_tension
from gtr_jax.plots.views import Around, Posture, Strung, plot_views
from gtr_jax.report.page import Figure, Playback, Scene
from gtr_jax.report.scene import scene
from gtr_jax.report.spatial import strung_of
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.displacement import by_tension
from gtr_jax.simulation.history import Simulation, equilibrium_at, simulate
from gtr_jax.simulation.markers import shape_in_plane
from gtr_jax.simulation.phases import label_phases

from ..option import Option
from ..pose import DIRECTION, PLANE, place_of
from ..result import Design
from ..tensions import pull_says
from ..unrolled import unroll
from .figures import plot_tip, plot_unrolled
from .playback import Way, design_playback, pull_and_release, tendons_playback

STEPS = 20  # load steps of the way to each state
DRAWN = 3  # states drawn from three sides, at most


def pictures(answer: Design, alternatives: list[Option]) -> tuple[list[Figure], list[Scene], list[Playback]]:
    """Figures and scenes of a design, and its pull and release to go through, or of several tendons the ways
    to all targets.

    Args:
        answer: the design.
        alternatives: other designs to draw the channels of.
    """
    robot = by_tension(build_robot(answer.config))
    ways = _ways(answer, robot)
    body = strung_of(robot, equilibrium_at(robot, ways[0].run, 0))
    figures = [_views(answer, robot, ways, body)]
    channels, tensions = _channels(answer, alternatives), _tensions(robot, ways)
    if robot.tendon_names:
        return [*figures, channels, *tensions], [], [tendons_playback(robot, ways)]
    run = pull_and_release(answer, robot)
    phases = label_phases(run)
    played = design_playback(robot, run, phases, answer.best.errors)
    figures += [_tip(answer, run, phases), channels, *tensions]
    return figures, [_scene(robot, ways, body)], [played]


def _ways(answer: Design, robot: Robot) -> list[Way]:
    """A run to every state, as the design takes it: tendons pulled together, and released where asked."""
    preload = np.asarray(robot.per_tendon(lambda tendon: tendon.preload))
    top = np.max(answer.best.tensions, axis=0)
    wanted, errors, ways = answer.problem.objective.wanted, answer.best.errors, []
    for state, (number, released) in enumerate(answer.problem.objective.states):
        T = np.asarray(answer.best.tensions[number])
        turn = top if released else T
        history = np.linspace(preload, turn, STEPS + 1)
        history = np.concatenate([history, np.linspace(turn, T, STEPS + 1)[1:]]) if released else history
        run = simulate(robot, history, time=1e6 * np.arange(len(history)))
        word = pull_says(T, robot.tendon_names) + (", releasing" if released else "")
        own = [e for e, reached in zip(errors, wanted.pose_state, strict=False) if reached == state]
        ways.append(Way(word, run, history, own))
    return ways


def _posture(name: str, robot: Robot, run: Simulation, step: int) -> Posture:
    shape = run.shape
    if shape is None:
        shape = shape_in_plane(robot, run.curvature, run.angle)
    tension = np.atleast_2d(np.asarray(run.tension[step]))
    return Posture(name, np.asarray(shape.position[step]), np.asarray(shape.rotation[step]), tension)


def _around(answer: Design) -> Around:
    """What the targets ask for, and the obstacles, in space."""
    wanted, directions = [], []
    for e in answer.best.errors:
        place = place_of(e.wanted) if np.all(np.isfinite(place_of(e.wanted))) else place_of(e.found)
        wanted.append(np.append(place, np.zeros(3 - len(place))))
        if len(e.wanted) == PLANE:
            directions.append((np.cos(e.wanted[2]), np.sin(e.wanted[2]), 0.0))
        else:
            directions.append(np.asarray(e.wanted)[DIRECTION])
    own = answer.problem.objective.obstacles
    rods = np.stack([np.asarray(own.start), np.asarray(own.end)], axis=1)
    rods = np.pad(rods, ((0, 0), (0, 0), (0, 3 - rods.shape[2])))
    return Around(np.reshape(wanted, (-1, 3)), np.reshape(directions, (-1, 3)), rods, np.asarray(own.radius))


def _views(answer: Design, robot: Robot, ways: list[Way], body: Strung) -> Figure:
    rest = _posture("before the pull", robot, ways[0].run, 0)
    postures = [rest, *(_posture(way.name, robot, way.run, -1) for way in ways[:DRAWN])]
    around = _around(answer)
    left = len(ways) - DRAWN
    return Figure(
        "target",
        plot_views(body, postures, around),
        "The body at the targets from three sides at one scale, its channels coloured by the tension of the "
        "tendon in them, and what is wanted: crosses, and arrows of the direction."
        + (" Obstacles are shaded." if len(around.radius) else "")
        + (f" {left} more states are in the body that moves." if left > 0 else ""),
    )


def _tip(answer: Design, run: Simulation, phases: np.ndarray) -> Figure:
    marks = [
        (float(e.T_base), e.branch, column, e.wanted[column], e.tip_tolerance)  # pyright: ignore
        for e in answer.best.errors
        if e.name.startswith("pose")
        for column in range(3)
        if np.isfinite(e.wanted[column])
    ]
    return Figure(
        "tip",
        plot_tip(np.asarray(run.T_base), np.asarray(run.tip_position), phases, marks, space=True),
        "Tip against base tension, pulled and released; where the two differ is hysteresis. Bars are the "
        "tolerances, where these are larger than the marks.",
    )


def _channels(answer: Design, alternatives: list[Option]) -> Figure:
    config, own = answer.config, answer.problem.target.limits
    body = build_robot(config).backbone
    s = np.linspace(0.0, config.backbone.length, 401)
    half = 0.5 * own.channel_diameter
    largest = np.asarray(body.radius(jnp.asarray(s))) - own.wall_clearance - half
    least = np.zeros_like(s)
    for bore in config.backbone.bores:
        inside = (s >= bore.from_) & (s <= bore.to)
        least = np.where(inside, 0.5 * bore.diameter + own.bore_clearance + half, least)
    chosen = "chosen" if answer.verdict in ("reached", "optimal") else "nearest"
    drawn = [unroll(config), *(unroll(option.config) for option in alternatives)]
    return Figure(
        "channel",
        plot_unrolled(drawn, (1e3 * s, 1e3 * least, 1e3 * largest), chosen),
        "The channels about the axis of the unloaded body: angle from the y axis towards z, and distance "
        "from the axis, which the walls keep between the dashed lines."
        + (" Alternatives reach the targets within the limits too." if alternatives else ""),
    )


def _tensions(robot: Robot, ways: list[Way]) -> list[Figure]:
    way = max(ways, key=lambda way: float(np.max(way.pull)))
    figures = []
    for i, tendon in enumerate(robot.tendons):
        run = way.run.of_tendon(i) if robot.tendon_names else way.run
        figures.append(
            Figure(
                f"tension-{tendon.name}" if tendon.name else "tension",
                plot_tension(run, label_phases(run)),
                (f"Tendon {tendon.name}. " if tendon.name else "")
                + "Tension along the tendon at several steps; dotted where the tendon is locked.",
            )
        )
    return figures


def _scene(robot: Robot, ways: list[Way], body: Strung) -> Scene:
    postures, ends = [], []
    for way in ways:
        for k, pull in enumerate(way.pull):
            says = pull_says(pull, robot.tendon_names)
            postures.append(_posture(f"to {way.name}: {says} at the base", robot, way.run, k))
        ends.append(len(postures) - 1)
    return scene(
        body,
        postures,
        first=ends[0],
        caption="Turn the body with the mouse, a finger or the arrow keys; the wheel zooms, the slider goes "
        "through the pull to each target.",
    )
