"""Loops that start in the lanes of what they use."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gtr_jax.mechanics.loop_lanes import in_lanes_of


def summed(x, *, tied):
    """The sum of 1, x, x, x by a loop that starts from one, and the number of steps."""

    def step(carry, _):
        total, count, late = carry
        return (total + x, count + 1, late | (count > 1)), None

    start = (jnp.ones(2), jnp.asarray(0), jnp.asarray(False))
    start = in_lanes_of(x, start) if tied else start
    return jax.lax.scan(step, start, None, length=3)[0]


def test_values_and_kinds_stay():
    for run in (jax.jit(lambda x: summed(x, tied=True)), jax.vmap(lambda x: summed(x, tied=True))):
        total, count, late = run(jnp.array([0.5, 2.0]))
        np.testing.assert_array_equal(np.asarray(total).ravel()[[0, -1]], [2.5, 7.0])
        assert jnp.issubdtype(count.dtype, jnp.integer) and np.all(count == 3)
        assert late.dtype == bool and np.all(late)


@pytest.mark.parametrize("slope", [jax.jacfwd, jax.jacrev])
def test_derivatives_stay(slope):
    """And they are not spoilt by numbers that are not finite, which a zero times a number would be."""
    x = jnp.array([0.5, 2.0])
    np.testing.assert_array_equal(slope(lambda x: summed(x, tied=True)[0])(x), 3 * np.eye(2))

    def by(x):
        return in_lanes_of(x, jnp.ones(2))

    for value in (np.inf, np.nan):
        np.testing.assert_array_equal(by(jnp.array([value, 1.0])), [1.0, 1.0])
        np.testing.assert_array_equal(slope(by)(jnp.array([value, 1.0])), np.zeros((2, 2)))


def test_a_loop_is_gone_through_once_for_lanes():
    """JAX calls the rule each time that it looks for arrays that differ between lanes."""

    def times(*, tied):
        calls = []

        @jax.custom_batching.custom_vmap
        def f(x):
            return 2 * x

        @f.def_vmap
        def _(size, batched, x):
            calls.append(batched)
            return 2 * x, True

        def run(x):
            start = (jnp.ones(()), jnp.ones(()))
            start = in_lanes_of(x, start) if tied else start
            return jax.lax.scan(lambda c, _: ((c[1] + x, f(c[0])), None), start, None, length=2)[0]

        found = jax.jit(jax.vmap(run))(jnp.arange(3.0))
        return len(calls), found

    (once, found), (often, wanted) = times(tied=True), times(tied=False)
    jax.tree_util.tree_map(np.testing.assert_array_equal, found, wanted)
    assert once < often


def test_what_is_known_stays_as_it_is():
    start = (jnp.ones(3), jnp.asarray(1))
    assert in_lanes_of((jnp.ones(2), None), start) is start


@pytest.mark.parametrize("slope", [jax.jacfwd, jax.jacrev])
def test_whole_numbers_do_not_spoil_derivatives(slope):
    def total(x, count):
        return in_lanes_of((x, count), jnp.ones(2)) * x

    found = jax.jit(slope(total))(jnp.array([0.5, 2.0]), jnp.asarray(3))
    np.testing.assert_array_equal(found, np.eye(2))


SCRIPT = """
import numpy as np, jax, gtr_jax as gtr
from benchmarks import systems
robot = systems.HELIX.robot(0.4)
def tip(mu):
    return gtr.equilibrium(robot.with_values(mu=mu), 8.0).tip_pose[1]
both = jax.jit(jax.vmap(jax.value_and_grad(tip)))(np.array([0.1, 0.3]))
print(*np.concatenate(both).tolist())
"""


@pytest.mark.slow
def test_programs_as_users_compile_them_give_the_same():
    """The tests compile without optimisation, and so without what fuses a program as users have it."""
    flags = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    results = [
        np.array(
            subprocess.run(
                [sys.executable, "-c", SCRIPT], env=env, check=True, capture_output=True, text=True
            ).stdout.split(),
            float,
        )
        for env in (flags, os.environ)
    ]
    np.testing.assert_allclose(results[0], results[1], rtol=1e-11)
