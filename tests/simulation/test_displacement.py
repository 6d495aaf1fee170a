"""Tendons driven by displacement: the tensions that draw them out as far as they are."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.native.values import Untranslatable
from gtr_jax.simulation import displacement as by_displacement
from gtr_jax.simulation import history as histories
from gtr_jax.simulation import natively
from gtr_jax.simulation.equilibrium import solved

HELIX = {"kind": "helix", "radius": 0.008, "turns": 0.5, "start_angle": 0.5}
BODY = {"outer_radius": 0.012, "youngs_modulus": 1.2e6}
HISTORY = np.concatenate([np.linspace(0, 8, 7), np.linspace(8, 2, 6)[1:], np.linspace(2, 5, 4)[1:]])


@pytest.fixture
def pair_of(make_config):
    """The same robot driven by tension and by displacement."""

    def build(**tendon):
        return [
            gtr.build_robot(make_config(routing=HELIX, backbone=BODY, tendon={"drive": drive, **tendon}))
            for drive in ("tension", "displacement")
        ]

    return build


@pytest.mark.slow
@pytest.mark.parametrize(
    "tendon", [{}, {"axial_stiffness": 3e3, "free_length": 0.4}], ids=["stiff", "stretches"]
)
def test_it_equals_drive_by_tension_when_given_its_displacements(pair_of, tendon):
    pulled, drawn = pair_of(**tendon)
    want = gtr.simulate(pulled, HISTORY)
    found = gtr.simulate(drawn, np.full_like(HISTORY, np.nan), displacement=want.displacement)
    assert found.converged.all()
    np.testing.assert_allclose(found.T_base, HISTORY, atol=1e-8)
    np.testing.assert_allclose(found.T_tip, want.T_tip, atol=1e-8)
    np.testing.assert_allclose(found.tip_position, want.tip_position, atol=1e-10)


def test_displacement_drives_in_the_plane_as_tension_does(make_config):
    """A robot that was built in the plane may be driven by the displacement that a recording has."""
    import dataclasses

    pulled = gtr.build_robot(make_config())
    tendons = tuple(dataclasses.replace(tendon, drive="displacement") for tendon in pulled.tendons)
    drawn = dataclasses.replace(pulled, tendons=tendons)
    in_space = gtr.build_robot(make_config(tendon={"drive": "displacement"}))
    assert in_space.space and not drawn.space
    np.testing.assert_allclose(
        by_displacement.compliance(drawn), by_displacement.compliance(in_space), rtol=1e-12
    )
    want = gtr.simulate(pulled, HISTORY)
    found = gtr.simulate(drawn, np.full_like(HISTORY, np.nan), displacement=want.displacement)
    assert found.converged.all()
    np.testing.assert_allclose(found.T_base, HISTORY, atol=1e-8)


def test_a_tendon_that_stretches_is_drawn_out_farther_by_its_tension(pair_of):
    (stiff, _), (soft, _) = pair_of(), pair_of(axial_stiffness=3e3, free_length=0.4)
    one, other = (gtr.simulate(robot, jnp.array([0.0, 6.0])) for robot in (stiff, soft))
    np.testing.assert_allclose(one.T_tip, other.T_tip, rtol=0)
    more = float(other.displacement[1] - one.displacement[1])
    length = float(gtr.equilibrium_at(stiff, one, 1).tendon_length)
    # Its tension lies between that at the tip and that at the base, which it has all along its free length.
    assert float(one.T_tip[1]) * length + 0.4 * 6 < 3e3 * more < 6 * (length + 0.4)


@pytest.mark.slow
def test_a_tendon_that_would_push_is_slack(pair_of):
    _, drawn = pair_of()
    found = gtr.simulate(drawn, jnp.zeros(4), displacement=jnp.array([0.0, 0.004, -0.002, 0.001]))
    assert found.converged.all()
    assert float(found.T_base[1]) > 1.0 and float(found.T_base[2]) == 0.0 < float(found.T_base[3])
    np.testing.assert_allclose(found.tip_position[2], [0.25, 0, 0], atol=1e-12)


def test_a_trial_takes_one_equilibrium(pair_of, monkeypatch):
    """Its derivative comes from the same."""
    _, drawn = pair_of()
    taken = []

    def counted(*given):
        taken.append(given)
        return solved(*given)

    monkeypatch.setattr(by_displacement, "solved", counted)
    jax.eval_shape(
        lambda way: by_displacement.drawn_at_once(
            drawn, jnp.zeros(()), way, gtr.SolverOptions(), sloped=False
        ),
        jnp.asarray(0.004),
    )
    assert len(taken) == 1


@pytest.mark.slow
def test_gradients_agree_with_differences(pair_of):
    _, drawn = pair_of(axial_stiffness=3e3)
    way = jnp.array([0.0, 0.003, 0.006, 0.0055])

    def T_tip(values, way):
        robot = drawn.with_values(mu=values[0], radius=values[1], EA=values[2])
        return gtr.simulate(robot, jnp.zeros(4), displacement=way).T_tip

    at = jnp.array([0.3, 0.008, 3e3])
    by_values, by_way = jax.jacfwd(T_tip, argnums=(0, 1))(at, way)
    for i, h in enumerate((1e-5, 1e-8, 0.1)):
        step = h * jnp.eye(3)[i]
        slope = (T_tip(at + step, way) - T_tip(at - step, way)) / (2 * h)
        np.testing.assert_allclose(
            by_values[1:, i], slope[1:], rtol=2e-5, atol=1e-7 * float(jnp.abs(slope).max())
        )
    slope = (T_tip(at, way + 1e-8 * jnp.eye(4)[2]) - T_tip(at, way - 1e-8 * jnp.eye(4)[2])) / 2e-8
    np.testing.assert_allclose(by_way[2:, 2], slope[2:], rtol=2e-5)


def test_what_is_asked_of_displacement(pair_of):
    pulled, drawn = pair_of()
    with pytest.raises(ValueError, match="displacement: drives the tendon"):
        gtr.simulate(drawn, jnp.zeros(2))
    with pytest.raises(ValueError, match="displacement: drives no tendon"):
        gtr.simulate(pulled, jnp.zeros(2), displacement=jnp.zeros(2))
    with pytest.raises(ValueError, match="displacement: of the shape of T_base"):
        gtr.simulate(drawn, jnp.zeros(2), displacement=jnp.zeros(3))
    with pytest.raises(ValueError, match="tip-moved: moves an end of the tendon"):
        moved = drawn.with_values(**{"tip-moved.tension": -2.0})
        gtr.simulate(moved, jnp.zeros(2), displacement=jnp.zeros(2), time=jnp.arange(2.0))


EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_three_tendons_by_displacement_turn_the_tip_around():
    robot = gtr.load_robot(EXAMPLES / "three-tendons.toml")
    given = gtr.read_recording(
        EXAMPLES / "three-tendons-displacement.csv", need_tip=False, tendons=robot.tendon_names, space=True
    )
    assert given.displacement is not None
    run = gtr.simulate(robot, given.T_base, displacement=given.displacement)
    assert run.converged.all()
    np.testing.assert_allclose(run.displacement, given.displacement, atol=1e-11)
    tip = np.asarray(run.tip_position)[:, 1:]
    circle, radius = tip[17:53], np.hypot(*tip.T)
    angle = np.unwrap(np.arctan2(circle[:, 1], circle[:, 0]))
    assert angle[-1] - angle[0] == pytest.approx(2 * np.pi * 35 / 36, abs=0.1)
    # Once each tendon has turned round, the tip's way repeats every third of a turn.
    np.testing.assert_allclose(radius[25:41], radius[37:53], rtol=1e-10)
    # Friction makes ripples; without it the tip goes round in a circle.
    numbers = {name: 0.0 for name in gtr.parameters_of(robot) if name.split(".")[0] == "mu"}
    smooth = gtr.simulate(robot.with_values(**numbers), given.T_base, displacement=given.displacement)
    assert np.ptp(np.hypot(*np.asarray(smooth.tip_position)[17:53, 1:].T)) < 1e-3 * radius.max()
    assert np.ptp(radius[17:53]) > 1e-2 * radius.max()


@pytest.mark.parametrize("start", [2.0, 14.3, 14.9, 15.5, 40.0])
def test_one_tension_is_found_where_displacement_does_not_rise_with_it(start):
    """Held between 14 and 15 N, where it falls a little, and no answer beyond 30 N."""

    def miss(x):
        held, freed = 6e-9 + 2e-9 * (15.0 - x), 8e-9 + 3e-5 * (x - 14.0)
        out = jnp.where(x > 15.0, 6e-9 + 1e-4 * (x - 15.0), jnp.where(x > 14.0, held, freed))
        return jnp.where(x > 30.0, jnp.nan, out)

    def tried(x):
        return miss(x), jnp.diag(jax.vmap(jax.grad(miss))(x))

    found = by_displacement.search(tried, jnp.array([start]), jnp.array([1e-4]), 1e-13)
    np.testing.assert_allclose(found.x, 14.0 - 8e-9 / 3e-5, atol=1e-8)
    assert abs(float(found.miss[0])) <= 1e-13 and int(found.trials) < 40


@pytest.mark.slow
def test_a_hold_after_a_partial_release_keeps_its_tension_under_differentiation(pair_of):
    _, drawn = pair_of()
    up = np.linspace(0.0, 8e-3, 6)
    way = jnp.array([*up, up[4], up[3], up[3], up[3], up[3]])

    def tensions(mu):
        run = gtr.simulate(drawn.with_values(mu=mu), jnp.zeros(len(way)), displacement=way)
        return run.T_base, run.converged

    (base, met), (slope, _) = jax.jvp(tensions, (0.2,), (1.0,))
    want, _ = tensions(0.2)
    assert np.all(met) and np.all(np.isfinite(slope))
    np.testing.assert_allclose(base, want, atol=1e-6)


class TestKnownNumbers:
    """Where nothing is traced, native code finds the base tensions."""

    WAY = jnp.array([0.0, 0.003, 0.006, 0.0055])

    def test_native_code_finds_the_tensions(self, pair_of, monkeypatch):
        _, drawn = pair_of()

        def driven(*_):
            raise AssertionError("the program with derivatives was compiled")

        monkeypatch.setattr(histories, "driven", driven)
        found = gtr.simulate(drawn, jnp.zeros(4), displacement=self.WAY)
        assert found.converged.all() and float(found.T_base[2]) > 1.0
        np.testing.assert_allclose(found.displacement, self.WAY, atol=1e-9)

    @pytest.mark.parametrize("lacking", [False, True], ids=["misses a step", "lacks an operation"])
    def test_the_program_with_derivatives_has_the_last_word(self, pair_of, monkeypatch, lacking):
        def steps(*_):
            if lacking:
                raise Untranslatable("argmax")
            return missed

        _, drawn = pair_of()
        missed = type("Missed", (), {"converged": np.array([True, True, False, True])})
        monkeypatch.setattr(natively, "steps_natively", steps)
        asked = []

        def driven(robot, loads, wanted, how, structure):
            asked.append(wanted.shape)
            return by_displacement.Driven(
                2.0 * jnp.ones_like(wanted), jnp.arange(16) < 2, jnp.ones(16, dtype=int)
            )

        monkeypatch.setattr(histories, "driven", driven)
        found = gtr.simulate(drawn, jnp.zeros(4), displacement=self.WAY)
        assert asked == [(16,)]
        np.testing.assert_array_equal(found.T_base, 2.0)
        np.testing.assert_array_equal(found.converged, [True, True, False, False])

    @pytest.mark.slow
    @pytest.mark.parametrize("mixed", [False, True], ids=["one tendon", "another by tension"])
    def test_both_find_the_same(self, pair_of, make_config, mixed):
        if mixed:
            other = HELIX | {"start_angle": 2.6}
            drives = {"a": {"drive": "displacement", "routing": HELIX}, "b": {"routing": other}}
            tendons = [{"name": name, "friction_coefficient": 0.3} | own for name, own in drives.items()]
            drawn = gtr.build_robot(make_config(backbone=BODY, routing=None, tendon=None, tendons=tendons))
            T, way = jnp.stack([jnp.full(4, jnp.nan), jnp.arange(4.0)], 1), jnp.stack([self.WAY] * 2, 1)
        else:
            (_, drawn), T, way = pair_of(axial_stiffness=3e3), jnp.zeros(4), self.WAY

        def run(way):
            return gtr.simulate(drawn, T, displacement=way)

        known, traced = run(way), jax.jit(run)(way)
        for name in ("T_base", "T_tip", "displacement", "tip_position"):
            np.testing.assert_allclose(getattr(known, name), getattr(traced, name), rtol=1e-8, atol=1e-10)
