"""The native program of a load history is the traced one: to 1e-10, and with the same slip."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from calibrate.inference.simulated_rig import EVERY, program_for
from gtr_jax.mechanics import in_order
from gtr_jax.native import program, values
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_of, structure_with
from gtr_jax.terms import REGISTRY
from tests.conftest import SINE

LOOP = np.array([0.0, 8, 16, 24, 18, 9, 14, 18, 10, 2, 12, 20])
CLOCK = 0.7 * np.arange(len(LOOP))
SETS = {
    "base": (),
    "loaded": (),
    "presliding": ("presliding",),
    "viscous": ("viscous-friction",),
    "contact": ("contact",),
    "events": ("sheath-moved", "tip-moved", "free-length"),
    "rubber and nitinol": ("hyperelastic", "superelastic"),
    "several": ("body-hysteresis", "tendon-stretch", "adhesion", "clearance", "local-friction"),
}


@pytest.mark.parametrize("name", SETS)
def test_native_steps_are_the_traced_ones(make_robot, name):
    loads = {"tip_force": [0.0, -0.05]} if name == "loaded" else {}
    terms = {f"{kind}.{q.name}": float(q.typical) for kind in SETS[name] for q in REGISTRY[kind].quantities}
    if name == "events":
        terms |= {"sheath-moved.change": -0.6, "sheath-moved.time": 3.0, "tip-moved.time": 4.5}
    if name == "rubber and nitinol":
        terms |= {"superelastic.strain": 0.1}
    robot = make_robot(0.4, routing=SINE, loads=loads).with_values(**terms)
    how = gtr.SolverOptions(atol=1e-12)
    traced = gtr.simulate(robot, LOOP, time=CLOCK, solver=how)
    structure = structure_of(robot, None)
    assert structure is not None and structure.terms == in_order(SETS[name])
    found = steps_natively(robot, structure, loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None), how)
    for quantity in ("T_tip", "tip_pose", "displacement", "slip_front", "slip_direction"):
        np.testing.assert_allclose(
            getattr(found, quantity), getattr(traced, quantity), rtol=1e-10, atol=1e-12, err_msg=quantity
        )
    np.testing.assert_array_equal(found.converged, traced.converged)
    # At the tolerance rounding decides whether one more is taken.
    np.testing.assert_allclose(found.iterations, traced.iterations, atol=1)


ALONE = [kind for kind in EVERY if not REGISTRY[kind].of_cells]
FALLS = [kind for kind in ALONE if REGISTRY[kind].loosens]


@pytest.mark.parametrize(
    "kind", [kind if kind in FALLS else pytest.param(kind, marks=pytest.mark.slow) for kind in ALONE]
)
def test_a_program_of_many_terms_gives_what_each_gives_alone(make_robot, kind):
    """That of the diagnosis, in which the others do not act: friction that falls relaxes what is held."""
    known = {"sheath-moved.change": -0.6, "sheath-moved.time": 3.0, "tip-moved.time": 4.5, "wear.rate": -0.3}
    known |= {"friction-drift.rate": -0.05, "shaken-sheath.time": 3.0, "shaken-sheath.duration": 3.0}
    numbers = {f"{kind}.{q.name}": float(q.typical) for q in REGISTRY[kind].quantities}
    robot = make_robot(0.4, routing=SINE)
    acting = robot.with_values(**numbers | {n: v for n, v in known.items() if n in numbers})
    how = gtr.SolverOptions(atol=1e-12)
    alone = gtr.simulate(acting, LOOP, time=CLOCK, solver=how)
    plain = gtr.simulate(robot, LOOP, time=CLOCK, solver=how)
    assert np.max(np.abs(alone.displacement - plain.displacement)) > 1e-5
    loads = loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None)
    found = steps_natively(acting, structure_with(robot, program_for(robot, {kind})), loads, how)
    np.testing.assert_allclose(found.T_tip, alone.T_tip, atol=1e-6)
    np.testing.assert_allclose(found.displacement, alone.displacement, atol=1e-9)


@pytest.mark.parametrize("place", ["base", "tip"])
def test_a_program_of_many_terms_gives_what_a_few_give_together(make_robot, place):
    """Friction that follows the slip relaxes by itself where it falls, lumped friction beside it or not."""
    numbers = {"presliding.length": 2e-4, "friction-drift.rate": -0.05, f"local-friction.{place}": 0.1}
    acting = make_robot(0.4, routing=SINE).with_values(**numbers)
    loop = np.array([0.0, 8, 16, 24, 24, 24, 18, 9, 9, 14, 18, 18, 10, 2, 2, 12, 20])
    clock = 0.7 * np.arange(len(loop))
    alone = gtr.simulate(acting, loop, time=clock, solver=gtr.SolverOptions(atol=1e-12))
    structure = structure_with(acting, program_for(acting, {name.partition(".")[0] for name in numbers}))
    loads = loads_of(jnp.asarray(loop), jnp.asarray(clock), None)
    found = steps_natively(acting, structure, loads, gtr.SolverOptions(atol=1e-12))
    np.testing.assert_allclose(found.T_tip, alone.T_tip, atol=1e-6)


STRAIGHT = {"kind": "straight", "radius": 0.01}


@pytest.mark.parametrize("extensible", [False, True])
def test_native_steps_in_space_are_the_traced_ones(make_robot, extensible):
    """Of two tendons of which one ends early."""
    tendons = [
        {"name": f"t{i}", "friction_coefficient": 0.2, "routing": {**STRAIGHT, "angle": angle}}
        for i, angle in enumerate((0.3, 2.0))
    ]
    tendons[0]["to"] = 0.15
    body = {"poissons_ratio": 0.4, "extensible": extensible}
    robot = make_robot(0.3, backbone=body, tendons=tendons)
    T = np.stack([LOOP, 0.5 * LOOP[::-1]], axis=1)
    how = gtr.SolverOptions(atol=1e-12)
    traced = gtr.simulate(robot, T, time=CLOCK, solver=how)
    structure = structure_of(robot, None)
    assert structure is not None and np.all(traced.converged)
    found = steps_natively(robot, structure, loads_of(jnp.asarray(T), jnp.asarray(CLOCK), None), how)
    for quantity in ("T_tip", "displacement", "slip_front", "slip_direction"):
        np.testing.assert_allclose(
            getattr(found, quantity), getattr(traced, quantity), rtol=1e-9, atol=1e-11, err_msg=quantity
        )


def _picked(robot, carried, row):
    """Rows of two arrays side by side, at places of each its own, as chords of guided tendons are taken."""
    places = jnp.asarray([[2, 0], [1, 1]])
    each = robot.reshape(2, 3, 2)
    rows = jax.vmap(lambda a, i: a[i])(each, places)
    again = jnp.take_along_axis(each, places[..., None], axis=-2)
    carried = carried + jnp.sum(rows * again * row)
    return carried, jnp.concatenate([rows.ravel(), again.ravel()])


def test_rows_side_by_side_are_taken_from_each_its_own():
    shape = jax.ShapeDtypeStruct
    robot, rows = np.arange(12.0), np.array([1.0, -2.0])
    native = program.Program(
        lambda robot: jnp.zeros(()), _picked, shape((12,), jnp.float64), shape((), jnp.float64), ("rows",)
    )
    found = native(robot, rows[:, None])
    carried = jnp.zeros(())
    for row, out in zip(rows, found, strict=True):
        carried, wanted = _picked(jnp.asarray(robot), carried, jnp.asarray(row))
        np.testing.assert_array_equal(out, wanted)


def _double(robot, carried, row):
    return carried + row, jnp.sort(robot) + carried


def test_what_is_not_known_is_refused_by_name():
    shape = jax.ShapeDtypeStruct((3,), jnp.float64)
    with pytest.raises(values.Untranslatable, match="sort"):
        program.Program(lambda robot: robot * 0, _double, shape, shape, ("test",))(
            np.zeros(3), np.zeros((2, 3))
        )


def test_a_program_is_compiled_once_where_it_is_kept(monkeypatch):
    class Shelf(dict):
        def read(self, name):
            return self.get(name)

        def write(self, name, contents):
            self[name] = contents

    shelf, shape = Shelf(), jax.ShapeDtypeStruct((3,), jnp.float64)

    def build():
        def step(robot, carried, row):
            return carried + row, robot * carried

        return program.Program(lambda robot: robot * 0, step, shape, shape, ("test",), kept=shelf)

    rows = np.arange(6.0).reshape(2, 3)
    first = build()(np.ones(3), rows)
    assert len(shelf) == 1
    monkeypatch.setattr(program.Program, "_compiled", lambda self: pytest.fail("compiled again"))
    np.testing.assert_array_equal(build()(np.ones(3), rows), first)
