"""Notched tubes and superelastic metal: the section that a notch leaves, its neutral line, how far it closes;
and angles between sections.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.optimize import brentq

import calibrate
import gtr_jax as gtr
from gtr_jax.config.config import parse_config
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.notches import remaining
from gtr_jax.robot.overlap import impossible
from gtr_jax.robot.validity import is_robot
from gtr_jax.simulation.markers import marker_angles

OUTER, INNER, DEPTH = 0.81e-3, 0.70e-3, 1.4e-3
HEIGHT, SPACING, FIRST = 0.8e-3, 1.2e-3, 1.2e-3
E = 50e9


def wrist(count=3, terms=(), mu=0.0, side="left", **changes):
    """A notched tube with its tendon along the inner wall, and the angle of each notch."""
    length = FIRST + count * (HEIGHT + SPACING)
    ends = [FIRST + (i + 1) * HEIGHT + i * SPACING + 0.5 * SPACING for i in range(count)]
    row = {
        "from": FIRST,
        "height": HEIGHT,
        "depth": DEPTH,
        "count": count,
        "spacing": SPACING,
        "side": side,
        **changes.pop("notches", {}),
    }
    return parse_config(
        {
            "schema": 1,
            "name": "wrist",
            "backbone": {
                "length": length,
                "outer_radius": OUTER,
                "youngs_modulus": E,
                "bores": [{"from": 0.0, "to": length, "diameter": 2 * INNER}],
                "notches": [row],
                **changes.pop("backbone", {}),
            },
            "routing": {"kind": "parallel", "offset": INNER if side == "left" else -INNER},
            "tendon": {"friction_coefficient": mu},
            "markers": [
                {"name": f"n{i + 1}", "at": end, "angle_from": ends[i - 1] if i else 0.0}
                for i, end in enumerate(ends)
            ],
            "terms": list(terms),
            **changes,
        }
    )


def angles(robot, T):
    """Angles of the notches [rad], (K, count)."""
    run = gtr.simulate(robot, np.asarray(T))
    assert np.all(run.converged)
    return np.asarray(marker_angles(robot, run))


def of_tube(T, count=3):
    """What the tube about each notch adds to its angle [rad], (K, count); tensions the same all along."""
    EI = E * np.pi / 4 * (OUTER**4 - INNER**4)
    lengths = np.full(count, SPACING)
    lengths[0] = FIRST + 0.5 * SPACING
    return np.outer(T, lengths) * INNER / EI


def section():
    return remaining(jnp.asarray([OUTER]), jnp.asarray([INNER]), jnp.asarray(DEPTH))


def test_what_a_notch_leaves_is_the_integral_over_the_sector():
    half = np.arccos((DEPTH - OUTER) / OUTER)

    def over(f):
        return dblquad(lambda r, a: f(r * np.cos(a)) * r, -half, half, INNER, OUTER)[0]

    area = over(lambda y: 1.0)
    centroid = over(lambda y: y) / area
    second = over(lambda y: (y - centroid) ** 2)
    left = section()
    assert np.allclose([left.area[0], left.centroid[0], left.second[0]], [area, centroid, second], rtol=1e-9)
    assert left.reach[0] == pytest.approx(max(OUTER - centroid, centroid - INNER * np.cos(half)))


def test_notches_bend_by_the_moment_about_their_neutral_line_and_then_close():
    left = section()
    arm, EI = float(left.centroid[0]) + INNER, E * float(left.second[0])
    T = np.array([0.0, 1.0, 3.0, 30.0])
    found = angles(build_robot(wrist()), T)
    found = found - of_tube(T)
    assert np.allclose(found[:3], (T[:3] * arm / EI * HEIGHT)[:, None], rtol=1e-9, atol=1e-12)
    closed = HEIGHT / (OUTER + float(left.centroid[0]))
    as_tube = np.pi / 4 * (OUTER**4 - INNER**4) / float(left.second[0])
    beyond = (T[3] * arm / EI - closed / HEIGHT) / as_tube * HEIGHT
    assert np.allclose(found[3], closed + beyond, rtol=1e-9)


def test_friction_closes_the_notches_one_after_the_other():
    T = np.linspace(0, 60, 31)
    found = angles(build_robot(wrist(count=5, mu=0.3)), T)
    assert np.all(np.diff(found[1:6], axis=1) < 0)
    left = section()
    arm, EI = float(left.centroid[0]) + INNER, E * float(left.second[0])
    # Tension falls by exp(-mu theta), and a notch has the mean of what acts along it.
    before = np.concatenate([[0.0], np.cumsum(found[2])[:-1]])
    mean = T[2] * np.exp(-0.3 * before) * -np.expm1(-0.3 * found[2]) / (0.3 * found[2])
    assert np.allclose(found[2], mean * arm / EI * HEIGHT + of_tube(mean, 5)[0], rtol=2e-3)
    closed = HEIGHT / (OUTER + float(left.centroid[0]))
    shut = np.argmax(found > closed, axis=0)
    assert np.all(np.diff(shut) >= 0)
    assert shut[-1] > shut[0] > 0


def test_a_moment_at_the_tip_may_close_notches_before_the_tendon_is_pulled():
    robot = build_robot(wrist(loads={"tip_moment": 0.05}))
    run = gtr.simulate(robot, np.array([0.0, 1e-6]))
    closed = HEIGHT / (OUTER + float(section().centroid[0]))
    assert np.all(np.asarray(marker_angles(robot, run))[0] > closed)
    assert abs(float(run.displacement[0])) < 1e-12


def test_markers_in_a_notch_follow_the_axis_that_it_shortens():
    markers = [{"name": f"m{i}", "at": FIRST + x * HEIGHT} for i, x in enumerate((0.03, 0.3, 0.77))]
    coarse, fine = (
        gtr.marker_places(robot, gtr.simulate(robot, np.array([0.0, 8.0])))
        for robot in (build_robot(wrist(markers=markers), resolution=r) for r in (1.0, 3.0))
    )
    assert np.allclose(coarse, fine, atol=1e-9)


def test_rows_on_both_sides_alternate():
    """Each tendon bends the notches of its side towards it, and opens the others: the mirror image."""
    pitch = HEIGHT + SPACING
    row = {"height": 0.4 * HEIGHT, "depth": DEPTH, "count": 3, "spacing": pitch - 0.4 * HEIGHT}
    sides = [{**row, "from": FIRST, "side": "left"}, {**row, "from": FIRST + 0.5 * pitch, "side": "right"}]
    length = 2 * FIRST + 3 * pitch
    tendons = [
        {"name": name, "friction_coefficient": 0.0, "routing": {"kind": "parallel", "offset": offset}}
        for name, offset in (("left", INNER), ("right", -INNER))
    ]
    bore = {"from": 0.0, "to": length, "diameter": 2 * INNER}
    body = {"length": length, "outer_radius": OUTER, "youngs_modulus": E, "bores": [bore], "notches": sides}
    robot = build_robot(parse_config({"schema": 1, "backbone": body, "tendons": tendons}))
    run = gtr.simulate(robot, np.array([[3.0, 0.0], [0.0, 3.0], [40.0, 0.0], [0.0, 40.0]]))
    assert np.all(run.converged)
    angle = np.asarray(run.tip_pose)[:, 2]
    assert np.allclose(angle[::2], -angle[1::2], rtol=1e-9)
    left = section()
    arms, width = INNER + np.array([1.0, -1.0]) * float(left.centroid[0]), 3 * 0.4 * HEIGHT
    tube = 3.0 * INNER * (length - 2 * width) / (E * np.pi / 4 * (OUTER**4 - INNER**4))
    assert angle[0] == pytest.approx(3.0 * arms.sum() * width / (E * float(left.second[0])) + tube, rel=1e-9)


def test_a_sweep_marks_notches_that_no_body_has():
    robot = build_robot(wrist())
    assert bool(is_robot(robot))
    for values in ({"notches_height": 3e-3}, {"notches_depth": 0.5e-3}, {"notches_depth": 1.7e-3}):
        assert not bool(is_robot(robot.with_values(**values)))


def test_a_notch_has_the_modulus_of_its_piece():
    piece = {"from": FIRST, "to": FIRST + HEIGHT, "youngs_modulus": E / 2}
    found = angles(build_robot(wrist(backbone={"sections": [piece]})), [0.0, 1.0])
    plain = angles(build_robot(wrist()), [0.0, 1.0])
    assert np.allclose((found - of_tube([0.0, 1.0]))[1], (plain - of_tube([0.0, 1.0]))[1] * [2, 1, 1])


def test_either_side():
    one, other = (
        angles(build_robot(wrist(mu=0.2, side=side)), [0.0, 2.0, 20.0]) for side in ("left", "right")
    )
    assert np.allclose(one, -other, atol=1e-9)


def test_the_axis_shortens_as_notches_close_about_their_neutral_line():
    """Rigid pieces that turn about the neutral line of each notch."""
    config = wrist(count=3)
    robot = build_robot(config)
    run = gtr.simulate(robot, np.array([0.0, 3.0]))
    theta = np.asarray(marker_angles(robot, run))[-1]
    left = float(section().centroid[0])
    place, turned = np.zeros(2), 0.0

    def along(angle, length):
        return length * np.array([np.cos(angle), np.sin(angle)])

    def normal(angle):
        return np.array([-np.sin(angle), np.cos(angle)])

    place = along(0.0, FIRST)
    for angle in theta:
        neutral = place - left * normal(turned)
        # An arc of the neutral line, as long as the notch is high.
        chord = HEIGHT * np.sinc(angle / 2 / np.pi)
        neutral = neutral + along(turned + angle / 2, chord)
        turned += angle
        place = neutral + left * normal(turned) + along(turned, SPACING)
    assert np.allclose(np.asarray(run.tip_pose)[-1], [*place, turned], atol=3e-6, rtol=1e-3)


def test_loads_bend_notches_about_their_neutral_line():
    """The moment of the tip force about the neutral line, from the shape found: nothing of the march."""
    force = np.array([-1.0, 0.2])
    robot = build_robot(wrist(loads={"tip_force": force.tolist()}))
    state = gtr.equilibrium(robot, 0.0)
    left = section()
    starts, ends = (np.asarray(ends) for ends in (robot.backbone.notch_start, robot.backbone.notch_end))
    s, kappa, phi = (np.asarray(values) for values in (state.s, state.curvature, state.angle))
    inside = np.any((s[:, None] > starts + 1e-9) & (s[:, None] < ends - 1e-9), axis=1)
    beside = np.where(inside, float(left.centroid[0]), 0.0)
    arm = np.stack([state.x[-1] - state.x, state.y[-1] - state.y]) + beside * np.stack(
        [-np.sin(phi), np.cos(phi)]
    )
    moment = arm[0] * force[1] - arm[1] * force[0]
    wanted = moment / (E * float(left.second[0]))
    assert 0 < inside.sum() < len(s)
    assert np.allclose(kappa[inside], wanted[inside], rtol=1e-6)


def test_an_end_correction_bends_less_and_closes_at_the_same_angle():
    T = np.array([0.0, 2.0, 30.0])
    found, plain = (
        angles(build_robot(wrist(notches={"end_correction": d})), T) - of_tube(T) for d in (-0.2e-3, 0.0)
    )
    assert np.allclose(found[1], 0.75 * plain[1], rtol=0.002)
    assert np.allclose(found[2], plain[2], rtol=0.01)


def test_natural_angles_are_there_without_load():
    config = wrist(notches={"natural_angle": ["1 deg", "2 deg", "3 deg"]})
    robot = build_robot(config)
    found = angles(robot, [0.0, 1.0])
    assert np.allclose(np.rad2deg(found[0]), [1, 2, 3], atol=1e-9)
    plain = angles(build_robot(wrist()), [0.0, 1.0])
    assert np.allclose(found[1] - found[0], plain[1], rtol=1e-6)
    assert robot.value("notches_natural_angle_1") == pytest.approx(np.deg2rad(2))
    again = config.with_values({"backbone.notches.0.natural_angle.1": 0.05})
    assert again.backbone.notches[0].natural_angle[1] == 0.05


def test_superelastic_follows_its_law():
    softening, strain = 0.85, 0.012
    robot = build_robot(wrist(terms=[{"kind": "superelastic", "softening": softening, "strain": strain}]))
    left = section()
    arm, EI, reach = float(left.centroid[0]) + INNER, E * float(left.second[0]), float(left.reach[0])

    def moment(kappa):
        x = kappa * reach / strain
        return EI * kappa * (1 - (softening * (1 - 1.5 / x + 0.5 / x**3) if x > 1 else 0.0))

    def bent(T):
        root: Any = brentq(lambda kappa: moment(kappa) - T * arm, 0.0, 5000.0)
        return root * HEIGHT

    T = np.array([0.0, 0.5, 1.5, 2.5])
    wanted = [bent(t) for t in T]
    assert wanted[-1] > 3 * T[-1] * arm / EI * HEIGHT / 2
    closed = HEIGHT / (OUTER + float(left.centroid[0]))
    assert np.all(np.array(wanted) < closed)
    # The tube is bent far less than to its plateau.
    assert np.allclose(angles(robot, T) - of_tube(T), np.array(wanted)[:, None], rtol=1e-7, atol=1e-12)


@pytest.mark.slow
def test_superelastic_in_space_is_that_of_the_plane():
    body = {"length": 0.1, "outer_radius": 1e-3, "youngs_modulus": 50e9}
    data = {
        "schema": 1,
        "backbone": body,
        "routing": {"kind": "parallel", "offset": 0.8e-3},
        "tendon": {"friction_coefficient": 0.2},
        "terms": [{"kind": "superelastic", "softening": 0.8, "strain": 0.01}],
    }
    T = np.linspace(0, 1500, 13)
    runs = [gtr.simulate(build_robot(parse_config(data | more)), T) for more in ({}, {"space": True})]
    assert all(np.all(run.converged) for run in runs)
    assert runs[0].tip_pose[-1, 2] > 2 * runs[0].tip_pose[4, 2]
    assert np.allclose(runs[0].tip_position[:, :2], runs[1].tip_position[:, :2], atol=1e-7)


def test_gradients_reach_the_numbers_of_notches():
    robot = build_robot(wrist(mu=0.2, terms=[{"kind": "superelastic", "softening": 0.8, "strain": 0.012}]))
    T = jnp.linspace(0.0, 2.0, 5)
    names = ("E", "mu", "superelastic.strain", "superelastic.softening", "notches_end_correction")

    def tip(values):
        changed = robot.with_values(**dict(zip(names, values, strict=True)))
        return gtr.simulate(changed, T).tip_pose[-1, 2]

    at = jnp.asarray([float(robot.value(name)) for name in names])
    slope = jax.grad(tip)(at)
    sizes = jnp.asarray([E, 0.2, 0.012, 0.8, 1e-3]) * 1e-5
    differences = [
        (tip(at.at[i].add(step)) - tip(at.at[i].add(-step))) / (2 * step) for i, step in enumerate(sizes)
    ]
    assert np.allclose(slope, differences, rtol=2e-4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"notches": {"depth": 0.5e-3}}, "notches[0].depth"),
        ({"notches": {"depth": 1.7e-3}}, "leaves something of the body"),
        ({"notches": {"spacing": 3e-3}}, "outside the backbone"),
        ({"notches": {"count": 0}}, "notches[0].count"),
        ({"notches": {"end_correction": -0.8e-3}}, "leaves nothing"),
        ({"notches": {"spacing": -0.1e-3}}, "spacing: cannot be negative"),
        ({"notches": {"natural_angle": ["1 deg", "2 deg"]}}, "2 angles for 3 notches"),
        ({"backbone": {"youngs_modulus": 0.0, "bending_stiffness": 1e-3}}, "needs the stiffness"),
        ({"space": True}, "computed in the plane"),
        ({"notches": {"natural_angle": "60 deg"}}, "closed at 30.63 deg"),
        ({"side": "right", "notches": {"natural_angle": ["1 deg", "31 deg", "2 deg"]}}, "natural_angle"),
        (
            {"backbone": {"sections": [{"from": FIRST, "to": 3e-3, "bending_stiffness": 1.0}]}},
            "needs the stiffness of its section",
        ),
    ],
)
def test_wrong_notches_are_refused(changes, words):
    with pytest.raises(gtr.InputError) as error:
        build_robot(wrist(**changes))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_angles_are_read_fitted_and_written(tmp_path):
    """A recording of base tension and angles alone."""
    config = wrist(mu=0.25)
    robot = build_robot(config)
    T = np.linspace(0.0, 3.0, 20)
    found = angles(robot, T) + np.random.default_rng(1).normal(0, 0.003, (20, 3))
    path = tmp_path / "angles.csv"
    header = "T_base_N," + ",".join(f"n{i}_angle_deg" for i in (1, 2, 3))
    np.savetxt(path, np.c_[T, np.rad2deg(found)], delimiter=",", header=header, comments="")
    recording = gtr.read_recording(path, need_tip=False, measured=True, markers=("n1", "n2", "n3"))
    assert np.allclose(recording.markers["n2_angle"], found[:, 1], atol=1e-9)
    fit = calibrate.fit(robot.with_values(mu=0.1, E=40e9), recording, free=("mu", "E"))
    for name, truth in (("mu", 0.25), ("E", E)):
        low, high = fit[name].lower95, fit[name].upper95
        assert low is not None and high is not None
        assert low < truth < high


def test_the_strain_that_is_told_is_that_of_what_a_notch_leaves():
    robot = build_robot(wrist())
    run = gtr.simulate(robot, np.array([0.0, 3.0]))
    told = impossible(robot.backbone, run.s, curvature=run.curvature, angle=run.angle, T_base=run.T_base)
    largest = float(np.max(run.curvature[-1])) * float(section().reach[0])
    assert told.strain == pytest.approx(largest)
    assert not told.says
