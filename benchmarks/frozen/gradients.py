"""Frozen derivatives of tip tension and tip position in every number of a robot."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr

from .case import BASE, EXAMPLES, Answers, Case, typical
from .simulations import LOADS

# A pull and part of a release: at the end a stretch slips back and the rest is locked.
T_BASE = 45.0 * np.asarray([0.1, 0.3, 0.5, 0.7, 0.85, 1.0, 0.9, 0.75])
TIME = np.asarray([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.3, 3.6])
OUTPUTS = ("T_tip", "tip_x")
# Compiled without XLA's optimisation, today's derivatives with terms move by 1.4e-5.
TERMS = 1e-4
SETS = {
    "presliding": typical("presliding"),
    "viscous-friction": typical("viscous-friction"),
    "contact": {"contact.stiffness": 400.0, "contact.distance": 0.005},
    "stiffening": typical("stiffening"),
}


@eqx.filter_jit
def _slopes(robot: gtr.Robot, T_base: jax.Array, time: jax.Array, of: jax.Array, with_terms: bool):
    """Weighted sum of the outputs after the last step, and its derivatives in all numbers of the robot."""

    def output(robot: gtr.Robot) -> jax.Array:
        run = gtr.simulate(robot, T_base, time=time, with_terms=with_terms)
        tip = jnp.ravel(run.T_tip[-1])[0]
        return of @ jnp.stack([tip, run.tip_pose[-1, 0]])

    return eqx.filter_value_and_grad(output)(robot)


def gradient(file: str, T_base: np.ndarray, with_terms: bool, **values: float) -> Answers:
    """The outputs, and their derivatives by where in the robot each number lies. A derivative comes with
    its number's magnitude taken in (which leaves the output's unit), as long as that is not zero.
    """
    robot = gtr.load_robot(EXAMPLES / file).with_values(**values)
    numbers = jax.tree_util.tree_leaves_with_path(eqx.filter(robot, eqx.is_inexact_array))
    found: Answers = {}
    for k, name in enumerate(OUTPUTS):
        weights = jnp.zeros(len(OUTPUTS)).at[k].set(1.0)
        value, slopes = _slopes(robot, jnp.asarray(T_base), jnp.asarray(TIME), weights, with_terms)
        found[name] = np.asarray(value)
        by_place = dict(jax.tree_util.tree_leaves_with_path(slopes))
        for place, leaf in numbers:
            if leaf.size == 0:
                continue
            size = np.abs(np.asarray(leaf))
            slope = np.asarray(by_place[place]) * np.where(size > 0, size, 1.0)
            # The program without terms knows nothing of their numbers.
            key = jax.tree_util.keystr(place)
            if with_terms or not key.startswith(".terms"):
                found[f"{name} by {key}"] = slope
    return found


def cases() -> list[Case]:
    """All gradients."""
    pair = np.stack([0.3 * T_BASE, np.asarray([1, 1, 1, 1, 1, 1, 1, 3.0])], axis=1)
    runs = [
        ("tdcm-1", BASE, lambda: gradient("tdcm-1.toml", T_BASE, False)),
        ("tdcm-1, loaded", BASE, lambda: gradient("tdcm-1.toml", T_BASE, False, **LOADS["payload"])),
        ("antagonists", BASE, lambda: gradient("antagonists.toml", pair, False)),
    ]
    for name, values in SETS.items():
        runs.append((name, TERMS, lambda v=values: gradient("tdcm-1.toml", T_BASE, True, **v)))
    # Derivatives below a thousandth of the output, for a change of a number by its whole size, are small.
    floors = {"T_tip by*": 0.02, "tip_x by*": 2e-4}
    return [Case("gradient", f"gradient: {name}", run, allowed, floors) for name, allowed, run in runs]
