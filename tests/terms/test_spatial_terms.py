"""Physics terms of robots in space: they are the planar ones where the robot stays in a plane, turn with it,
do nothing at their null values, and make no energy.
"""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import gtr_jax as gtr
from gtr_jax.terms import REGISTRY, body_hysteresis, stiffening, viscoelastic_body
from gtr_jax.terms.term import Bent

SOFT = {"outer_radius": [0.012, 0.012], "youngs_modulus": 1.2e6, "poissons_ratio": 0.5, "density": 900.0}
HELIX = {"kind": "helix", "radius": 0.008, "turns": 1.25, "start_angle": 0.5}
PARALLEL = {"kind": "parallel", "offset": 0.008}
HISTORY, CLOCK = np.array([0.0, 4.0, 9.0, 6.0, 3.0, 8.0]), 2.0 * np.arange(6)
TURN = 0.9  # rad, by which a planar robot is turned about its axis


def turned(x, y):
    return {"x": x, "y": y * np.cos(TURN), "z": y * np.sin(TURN)}


# A term in the plane, and the same turned with the robot.
TERMS = {
    "stiffening": ({"coefficient": 0.01}, {"coefficient": 0.01}),
    "body-hysteresis": ({"ratio": 0.3, "curvature": 2.0}, {"ratio": 0.3, "curvature": 2.0}),
    "viscoelastic-body": (
        {"ratio": 0.4, "time": 5.0, "spread": 0.4},
        {"ratio": 0.4, "time": 5.0, "spread": 0.4},
    ),
    "contact": (
        {"stiffness": 100.0, "distance": 0.03},
        {"stiffness": 100.0, "distance": 0.03, "elevation": TURN},
    ),
    "tip-load": ({"x": 0.02, "y": 0.1}, turned(0.02, 0.1)),
    "gravity-error": ({"x": 1.0, "y": -2.0}, turned(1.0, -2.0)),
}


@pytest.fixture
def robot_with(make_robot):
    def build(term, routing=HELIX, **sections):
        terms = [{"kind": kind, **values} for kind, values in term.items()]
        return make_robot(routing=routing, backbone=SOFT, space=True, terms=terms, **sections)

    return build


@pytest.mark.parametrize("kind", TERMS)
def test_a_turned_planar_robot_with_a_term_is_the_planar_one_turned(make_robot, robot_with, kind):
    flat_numbers, numbers = TERMS[kind]
    flat = make_robot(routing=PARALLEL, backbone=SOFT, terms=[{"kind": kind, **flat_numbers}])
    want = gtr.simulate(flat, HISTORY, time=CLOCK)
    plain = gtr.simulate(make_robot(routing=PARALLEL, backbone=SOFT), HISTORY)
    found = gtr.simulate(robot_with({kind: numbers}, PARALLEL | {"plane_angle": TURN}), HISTORY, time=CLOCK)
    assert want.converged.all() and found.converged.all()
    np.testing.assert_allclose(found.T_tip, want.T_tip, rtol=1e-6)
    tip = Rotation.from_rotvec([TURN, 0, 0]).apply(np.array(want.tip_position))
    np.testing.assert_allclose(found.tip_position, tip, atol=1e-8)
    assert np.max(np.abs(np.asarray(want.tip_position - plain.tip_position))) > 1e-3, "the term acts"


@pytest.mark.parametrize("kind", ["stiffening", "body-hysteresis", "viscoelastic-body", "contact"])
def test_a_term_at_its_null_does_nothing(robot_with, kind):
    robot = robot_with({})
    plain = gtr.simulate(robot, HISTORY, with_terms=False)
    null = gtr.simulate(robot, HISTORY, time=CLOCK, with_terms=[kind])
    np.testing.assert_allclose(null.T_tip, plain.T_tip, atol=1e-9)
    np.testing.assert_allclose(null.tip_position, plain.tip_position, atol=1e-9)


def test_a_stop_is_a_plane_that_the_tip_of_a_helix_presses_on(robot_with):
    free = gtr.simulate(robot_with({}), HISTORY)
    angle, elevation, distance, stiffness = -1.5, 1.2, 0.02, 5e3
    normal = np.array(
        [np.cos(elevation) * np.cos(angle), np.cos(elevation) * np.sin(angle), np.sin(elevation)]
    )
    numbers = {"angle": angle, "elevation": elevation, "distance": distance, "stiffness": stiffness}
    run = gtr.simulate(robot_with({"contact": numbers}), HISTORY)
    assert run.converged.all()
    beyond, held = (np.asarray(r.tip_position) @ normal - distance for r in (free, run))
    meets = beyond > 1e-4
    assert meets.any() and not meets.all()
    assert np.all(held[meets] > 0) and np.all(held[meets] < 0.1 * beyond[meets])
    # The force of the stop is what bends the body at the base beyond the tendon.
    k = int(np.argmax(beyond))
    eq = gtr.equilibrium_at(robot_with({"contact": numbers}), run, k)
    moment = np.cross(np.asarray(run.tip_position[k]), -stiffness * held[k] * normal)
    np.testing.assert_allclose(eq.external_moment[0], moment, atol=1e-6 * np.abs(moment).max())


class TestLaws:
    """The laws of a section by themselves, along closed ways of its strain."""

    stiff = np.array([1.5, 2.0, 0.7])  # GJ, EI_y, EI_z

    def work(self, bend, numbers, strain):
        """Work of a law's moment along a way of the strain, (K, 3)."""
        remembers = next(term.remembers for term in REGISTRY.values() if term.bend_in_space is bend)
        kept = tuple(jnp.zeros(remembers) for _ in range(3))
        done, before = 0.0, strain[0]
        last = np.zeros(3)
        for now in strain:
            at = Bent((0.0,) * 3, tuple(before), kept, jnp.asarray(0.01), tuple(1 / self.stiff))
            extra, kept = bend(numbers, tuple(now), at)
            kept = tuple(jnp.atleast_1d(k) for k in kept)
            moment = self.stiff * np.array([float(e) for e in extra])
            done += 0.5 * (moment + last) @ (now - before)
            before, last = now, moment
        return done

    def circle(self, steps=1200, rounds=2.0):
        t = np.linspace(0, 2 * np.pi * rounds, steps)
        return np.stack([0.4 * np.sin(2 * t), 3 * np.cos(t) - 3, 2 * np.sin(t)], axis=1)

    def test_stiffening_of_any_section_keeps_energy(self):
        numbers = {"coefficient": 0.05}
        assert abs(self.work(stiffening.bend_in_space, numbers, self.circle())) < 1e-5
        half = self.circle(rounds=0.5)
        assert self.work(stiffening.bend_in_space, numbers, half) > 0.1

    @pytest.mark.parametrize(
        ("bend", "numbers"),
        [
            (body_hysteresis.bend_in_space, {"ratio": 0.3, "curvature": 1.0}),
            (viscoelastic_body.bend_in_space, {"ratio": 0.3, "time": 0.5, "spread": 0.3}),
        ],
    )
    def test_hysteresis_and_creep_lose_it(self, bend, numbers):
        assert self.work(bend, numbers, self.circle()) > 0.1

    def test_hysteresis_of_bending_back_and_forth_is_that_of_the_plane(self):
        numbers, way = {"ratio": 0.3, "curvature": 1.0}, np.array([0.0, 1.0, 0.2, 0.9, -2.0])
        across, kept, flat = np.array([0.0, 0.6, 0.8]), (jnp.zeros(1),) * 3, jnp.zeros(1)
        one = jnp.ones(())
        for before, now in itertools.pairwise(way):
            want, flat = body_hysteresis.bend(numbers, now, Bent(0.0, before, flat, one))
            at = Bent((0.0,) * 3, tuple(before * across), kept, one)
            extra, kept = body_hysteresis.bend_in_space(numbers, tuple(now * across), at)
            np.testing.assert_allclose(np.array([float(e) for e in extra]), want * across, atol=1e-12)


@pytest.mark.parametrize(
    "term",
    [
        {"stiffening": {"coefficient": 0.01}},
        {"body-hysteresis": {"ratio": 0.3, "curvature": 0.3}},
        {"contact": {"stiffness": 300.0, "distance": 0.02, "angle": -1.5, "elevation": 1.2}},
    ],
    ids=lambda term: next(iter(term)),
)
def test_no_energy_is_created_over_a_closed_loop(robot_with, term):
    T = np.concatenate([np.linspace(2, 10, 17), np.linspace(10, 2, 17)[1:]])
    run = gtr.simulate(robot_with(term), np.concatenate([T, T[1:]]))
    assert run.converged.all()
    drawn = np.asarray(run.displacement)
    np.testing.assert_allclose(drawn[32], drawn[-1], atol=2e-6 * np.ptp(drawn) + 1e-9)
    assert np.trapezoid(np.concatenate([T, T[1:]])[32:], drawn[32:]) > 1e-4


def test_several_tendons_take_what_does_not_bend_a_held_stretch(robot_with):
    three = [
        {"name": n, "friction_coefficient": 0.3, "routing": {"kind": "straight", "radius": 0.008, "angle": a}}
        for n, a in zip("abc", (0.0, 2.1, 4.2), strict=True)
    ]
    robot = robot_with({"stiffening": {"coefficient": 0.01}}, tendons=three)
    history = np.array([[6.0, 1.0, 2.0], [3.0, 4.0, 1.0]])
    softer = gtr.simulate(robot_with({}, tendons=three), history)
    run = gtr.simulate(robot, history)
    assert run.converged.all()
    away = [np.linalg.norm(np.asarray(r.tip_position)[:, 1:], axis=1) for r in (run, softer)]
    assert np.all(away[0] < away[1])
    for kind in ("contact", "viscoelastic-body"):
        size = REGISTRY[kind].sizes[0]
        held = robot.with_values(**{f"{kind}.{size.name}": size.typical})
        with pytest.raises(ValueError, match=f"{kind}: bends the stretch that friction holds"):
            gtr.simulate(held, history, time=np.arange(2.0))


DRIVEN = {
    "viscous, stretch and drag": {
        "viscous-friction": {"coefficient": 20.0},
        "tendon-stretch": {"compliance": 1e-4},
        "adhesion": {"drag": 1.0},
    },
    "creep": {"viscoelastic-body": {"ratio": 0.3, "time": 5.0}},
    "presliding": {"presliding": {"length": 4e-4}},
    "wear and contact": {"wear": {"rate": 0.1}, "contact": {"stiffness": 100.0, "distance": 0.03}},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVEN)
def test_drive_by_displacement_beside_terms_equals_drive_by_tension(robot_with, name):
    pulled, drawn = (
        robot_with(DRIVEN[name], tendon={"friction_coefficient": 0.3, "drive": drive})
        for drive in ("tension", "displacement")
    )
    cycle = np.linspace(0, 1.5, len(HISTORY))
    want = gtr.simulate(pulled, HISTORY, time=CLOCK, cycle=cycle)
    found = gtr.simulate(
        drawn, np.zeros_like(HISTORY), time=CLOCK, cycle=cycle, displacement=want.displacement
    )
    assert want.converged.all() and found.converged.all()
    np.testing.assert_allclose(found.T_base, HISTORY, atol=1e-7)
    np.testing.assert_allclose(found.T_tip, want.T_tip, atol=1e-7)


def test_an_end_moved_from_outside_is_refused_beside_drive_by_displacement(robot_with):
    term = {"tip-moved": {"tension": -2.0, "time": 3.0}}
    with pytest.raises(gtr.InputError, match="tip-moved: moves an end of the tendon"):
        robot_with(term, tendon={"friction_coefficient": 0.3, "drive": "displacement"})
