"""Tendons that disks guide: straight between them, friction by the corners."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root_scalar

import gtr_jax as gtr

L, MU = 0.25, 0.3
SOFT: dict[str, Any] = {"outer_radius": 0.012, "youngs_modulus": 1.2e6, "poissons_ratio": 0.5, "density": 0.0}
HELIX = {"kind": "helix", "radius": 0.008, "turns": 1.25, "start_angle": 0.5}
PARALLEL = {"kind": "parallel", "offset": 0.008}
HISTORY = np.array([0.0, 6.0, 10.0, 7.0, 3.0, 8.0])


def evenly(count):
    """Guides that part the body into segments of one length."""
    return [L * (i + 1) / count for i in range(count - 1)]


@pytest.fixture
def guided(make_robot):
    """A robot of one guided tendon."""

    def make(guides, routing=HELIX, mu=MU, resolution=1.0, **sections):
        tendon = {"friction_coefficient": mu, "guides": guides} | sections.pop("tendon", {})
        body = SOFT | sections.pop("backbone", {})
        return make_robot(resolution, backbone=body, routing=routing, tendon=tendon, **sections)

    return make


def test_a_rigid_straight_body_is_a_capstan_of_corners(guided):
    """Tension falls by exp(-mu times the angle) at each corner of the polyline, the entry's included."""
    guides = evenly(7)
    robot = guided(guides, backbone={"rigid": True})
    s = np.array([0.0, *guides, L])
    angle = 0.5 + 2 * np.pi * 1.25 * s / L
    points = np.stack([s, 0.008 * np.cos(angle), 0.008 * np.sin(angle)], axis=1)
    rate = 0.008 * 2 * np.pi * 1.25 / L
    entry = np.array([1.0, -rate * np.sin(0.5), rate * np.cos(0.5)])
    ways = np.concatenate([entry[None], np.diff(points, axis=0)])
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    corners = np.arccos(np.sum(ways[1:] * ways[:-1], axis=1))
    eq = gtr.equilibrium(robot, 5.0)
    assert eq.converged
    np.testing.assert_allclose(eq.T_tip, 5.0 * np.exp(-MU * corners.sum()), rtol=1e-10)
    straight = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    np.testing.assert_allclose(eq.tendon_length, straight, rtol=1e-10)
    jumps = np.flatnonzero(np.abs(np.diff(np.asarray(eq.tension))) > 1e-9)
    np.testing.assert_allclose(np.asarray(eq.s)[jumps], guides, atol=1e-12)


def bent_by_chords(T, guides, mu):
    """Tip and tip tension of a soft planar body with a parallel tendon, segment by segment: in each the chord
    that closes, by integrating the elastica and finding a root.
    """
    EI, d = SOFT["youngs_modulus"] * np.pi / 4 * SOFT["outer_radius"] ** 4, PARALLEL["offset"]
    place, turned, came = np.zeros(2), 0.0, None
    ends = np.array([0.0, *guides, L])

    def segment(slope, length, pull):
        chord = np.array([1.0, slope]) / np.hypot(1.0, slope)

        def along(_, y):
            x, across, phi = y
            arm = np.array([0.0, d]) - [x, across]
            return [np.cos(phi), np.sin(phi), -pull * (arm[0] * chord[1] - arm[1] * chord[0]) / EI]

        end = solve_ivp(along, (0, length), [0.0, 0.0, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
        guide = end[:2] + d * np.array([-np.sin(end[2]), np.cos(end[2])])
        reach = guide - [0.0, d]
        return reach[1] / reach[0] - slope, end

    for start, stop in itertools.pairwise(ends):

        def tension(slope, came=came, T=T):
            return T * np.exp(-mu * abs(np.arctan(slope) - (0.0 if came is None else came)))

        slope = root_scalar(
            lambda a, length=stop - start, pull=tension: segment(a, length, pull(a))[0],
            bracket=(0.0, 2.0),
            xtol=1e-13,
        ).root
        T = tension(slope)
        end = segment(slope, stop - start, T)[1]
        turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
        place, turned = place + turn @ end[:2], turned + end[2]
        came = np.arctan(slope) - end[2]
    return place, T


@pytest.fixture
def in_thirds(guided):
    """A finely meshed robot of two guides, with other values: all share one program."""
    robot = guided(evenly(3), resolution=2.0)
    return lambda **values: robot.with_values(**values)


STRAIGHTENED = {"turns": 0.0, "start_angle": 0.0}  # a helix that is `PARALLEL`


@pytest.mark.parametrize("guides", [pytest.param((0.08, 0.15), marks=pytest.mark.slow), (0.05, 0.18)])
def test_a_soft_body_bends_as_the_elastica_of_each_segment(in_thirds, guides):
    place, T_tip = bent_by_chords(5.0, guides, MU)
    eq = gtr.equilibrium(in_thirds(guide_0=guides[0], guide_1=guides[1], **STRAIGHTENED), 5.0)
    assert eq.converged
    np.testing.assert_allclose(eq.T_tip, T_tip, rtol=1e-6)
    np.testing.assert_allclose(eq.tip_position, [*place, 0.0], atol=1e-7)


@pytest.mark.slow
def test_many_guides_are_a_channel(make_robot, guided):
    channel = make_robot(backbone=SOFT, routing=HELIX, tendon={"friction_coefficient": MU}, space=True)
    want = gtr.equilibrium(channel, 8.0)
    found = [gtr.equilibrium(guided(evenly(n)), 8.0) for n in (24, 48)]
    assert all(bool(eq.converged) for eq in found)
    lost = [abs(float(eq.T_tip - want.T_tip)) for eq in found]
    away = [float(jnp.linalg.norm(eq.tip_position - want.tip_position)) for eq in found]
    # The last segment has no corner at its end: half of what turns there costs nothing.
    rate = (want.wrap[-1] - want.wrap[-2]) / (want.s[-1] - want.s[-2])
    spared = float(want.T_tip * MU * rate * L / 48 / 2)
    assert lost[0] / lost[1] > 1.8 and lost[1] == pytest.approx(spared, rel=0.2)
    assert away[0] / away[1] > 1.8 and away[1] < 3e-4


def test_the_tendon_is_as_long_as_its_chords(in_thirds):
    guides = evenly(3)
    eq = gtr.equilibrium(in_thirds(), 8.0)
    assert eq.shape is not None
    s, R = np.asarray(eq.s), np.asarray(eq.R)
    offset = np.concatenate([np.zeros((len(s), 1)), R], axis=1)
    at = np.asarray(eq.shape.position) + np.einsum("nij,nj->ni", np.asarray(eq.shape.rotation), offset)
    nodes = [0, *[int(np.argmin(np.abs(s - g))) for g in guides], len(s) - 1]
    chords = np.diff(at[nodes], axis=0)
    np.testing.assert_allclose(eq.tendon_length, np.linalg.norm(chords, axis=1).sum(), rtol=1e-6)
    for (a, b), chord in zip(itertools.pairwise(nodes), chords, strict=True):
        off = np.cross(at[a + 1 : b] - at[a], chord / np.linalg.norm(chord))
        assert np.max(np.abs(off)) < 1e-8


@pytest.mark.slow
def test_a_guide_where_the_tendon_ends_is_its_anchor(guided):
    for end in ({}, {"to": 0.2}):
        stop = end.get("to", L)
        with_one, without = (
            gtr.equilibrium(guided(guides, tendon=end), 5.0) for guides in ([0.1, stop], [0.1])
        )
        assert with_one.converged
        np.testing.assert_allclose(with_one.T_tip, without.T_tip, rtol=1e-8)
        np.testing.assert_allclose(with_one.tip_position, without.tip_position, atol=1e-8)


@pytest.mark.slow
def test_no_energy_is_created_over_a_closed_loop(guided):
    T = np.concatenate([np.linspace(2, 10, 9), np.linspace(10, 2, 9)[1:]])
    T = np.concatenate([T, T[1:]])
    run = gtr.simulate(guided(evenly(6)), T)
    assert run.converged.all()
    drawn = np.asarray(run.displacement)
    np.testing.assert_allclose(drawn[16], drawn[-1], atol=1e-8)
    assert np.trapezoid(T[16:], drawn[16:]) > 1e-4


STRAIGHT = [
    {
        "name": n,
        "friction_coefficient": MU,
        "guides": evenly(5),
        "routing": {"kind": "straight", "radius": 0.008},
    }
    for n in "abc"
]


def three(**changes):
    each = [
        tendon
        | {"routing": tendon["routing"] | {"angle": k * 2 * np.pi / 3}}
        | changes.get(tendon["name"], {})
        for k, tendon in enumerate(STRAIGHT)
    ]
    return {"tendons": each, "routing": None, "tendon": None}


@pytest.mark.slow
def test_three_equal_tendons_do_not_bend(make_robot):
    run = gtr.simulate(make_robot(backbone=SOFT, **three()), np.array([[2.0] * 3, [4.0] * 3, [1.0] * 3]))
    assert run.converged.all()
    np.testing.assert_allclose(run.tip_position, [[L, 0.0, 0.0]] * 3, atol=1e-12)
    np.testing.assert_allclose(run.T_tip, run.T_base, rtol=1e-12)


@pytest.mark.slow
def test_a_slack_tendon_beside_it_does_nothing(make_robot, guided):
    """One of three pulls; of the slack others one is guided to an anchor inside, one runs in a channel."""
    robot = make_robot(backbone=SOFT, **three(b={"guides": [0.04, 0.11], "to": 0.2}, c={"guides": []}))
    alone = guided(evenly(5), PARALLEL, space=True)
    run = gtr.simulate(robot, np.stack([HISTORY, 0 * HISTORY, 0 * HISTORY], axis=1))
    want = gtr.simulate(alone, HISTORY)
    assert run.converged.all()
    np.testing.assert_allclose(run.T_tip[:, 0], want.T_tip, rtol=1e-5)
    np.testing.assert_allclose(run.tip_position, want.tip_position, atol=1e-6)


@pytest.mark.slow
def test_a_mirror_image_mirrors_under_a_load(guided):
    loads = {"tip_force": [0.02, 0.05, -0.08]}
    run = gtr.simulate(guided(evenly(6), loads=loads), HISTORY)
    mirrored = HELIX | {"turns": -1.25, "start_angle": -0.5}
    image = gtr.simulate(guided(evenly(6), mirrored, loads={"tip_force": [0.02, 0.05, 0.08]}), HISTORY)
    assert run.converged.all() and image.converged.all()
    np.testing.assert_allclose(image.T_tip, run.T_tip, rtol=1e-8)
    np.testing.assert_allclose(np.asarray(image.tip_position) * [1, 1, -1], run.tip_position, atol=1e-8)


def test_a_tendon_that_would_bend_the_body_without_bound_is_flagged(in_thirds):
    eq = gtr.equilibrium(in_thirds(guide_0=0.2, guide_1=0.225, **STRAIGHTENED), 12.0)
    assert not eq.converged


@pytest.mark.slow
@pytest.mark.parametrize("loads", [{}, {"tip_force": [0.02, 0.05, -0.08]}], ids=["free", "loaded"])
def test_gradients_equal_differences(guided, loads):
    robot = guided(evenly(4), loads=loads)
    names, steps = ("mu", "E", "radius", "guide_1"), (1e-5, 5.0, 1e-7, 1e-6)
    history = jnp.asarray([4.0, 9.0, 6.0])

    def last(values):
        run = gtr.simulate(robot.with_values(**dict(zip(names, values, strict=True))), history)
        return jnp.concatenate([run.T_tip[-1:], run.tip_position[-1]])

    at = jnp.stack([robot.value(name) for name in names])
    slopes = np.asarray(jax.jacfwd(last)(at))
    for k, step in enumerate(steps):
        up, down = (last(at.at[k].add(way * step)) for way in (1, -1))
        rate = np.asarray((up - down) / (2 * step))
        np.testing.assert_allclose(slopes[:, k], rate, atol=1e-5 * np.max(np.abs(rate)))


@pytest.mark.slow
def test_drive_by_displacement_equals_drive_by_tension(guided):
    pulled, drawn = (guided(evenly(5), tendon={"drive": drive}) for drive in ("tension", "displacement"))
    want = gtr.simulate(pulled, HISTORY)
    found = gtr.simulate(drawn, 0 * HISTORY, displacement=want.displacement)
    assert found.converged.all()
    np.testing.assert_allclose(found.T_base, HISTORY, atol=1e-7)
    np.testing.assert_allclose(found.T_tip, want.T_tip, atol=1e-7)
