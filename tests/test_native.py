"""The native program of a load history is the traced one: to 1e-10, and with the same slip."""

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.mechanics import in_order
from gtr_jax.native import program, translate
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_of
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
    "several": ("body-hysteresis", "tendon-stretch", "adhesion", "clearance", "local-friction"),
}


@pytest.mark.parametrize("name", SETS)
def test_native_steps_are_the_traced_ones(make_robot, name):
    loads = {"tip_force": [0.0, -0.05]} if name == "loaded" else {}
    terms = {f"{kind}.{q.name}": float(q.typical) for kind in SETS[name] for q in REGISTRY[kind].quantities}
    if name == "events":
        terms |= {"sheath-moved.change": -0.6, "sheath-moved.time": 3.0, "tip-moved.time": 4.5}
    robot = make_robot(0.4, routing=SINE, loads=loads).with_values(**terms)
    how = gtr.March(atol=1e-12)
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


def _double(robot, carried, row):
    return carried + row, jnp.sort(robot) + carried


def test_what_is_not_known_is_refused_by_name():
    shape = translate.jax.ShapeDtypeStruct((3,), jnp.float64)
    with pytest.raises(translate.Untranslatable, match="sort"):
        program.Program(lambda robot: robot * 0, _double, shape, shape, ("test",))(
            np.zeros(3), np.zeros((2, 3))
        )
