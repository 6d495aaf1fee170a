"""One material from two published losses, and the eight paths of Table I predicted with it.

The paper gives the loss at 60 N of path 1 (69.2 %) and path 3 (99.5 %), not mu and E. Two equations, two
unknowns: Newton's method with derivatives through the equilibrium.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import optimistix as optx

import gtr_jax as gtr

HERE = Path(__file__).parent
LOSS = {1: 0.692, 3: 0.995}

paths = {k: gtr.load_robot(HERE / f"path-{k}.toml") for k in range(1, 9)}


def missed(logs, _):
    mu, E = jnp.exp(logs)
    tips = [gtr.equilibrium(paths[k].with_values(mu=mu, E=E), 60.0).T_tip for k in LOSS]
    return jnp.log(jnp.stack(tips) / 60.0) - jnp.log1p(-jnp.asarray(list(LOSS.values())))


start = jnp.log(jnp.asarray([0.3, 0.5e6]))
found = optx.root_find(missed, optx.Newton(rtol=1e-10, atol=1e-10), start)
mu, E = jnp.exp(found.value)
print(f"mu = {mu:.3f}, E = {1e-6 * E:.3f} MPa")
for k, robot in paths.items():
    T_base = 60.0 if k <= 4 else 40.0
    eq = gtr.equilibrium(robot.with_values(mu=mu, E=E), T_base)
    loss, angle = 1 - eq.T_tip / T_base, np.degrees(eq.tip_pose[2])
    print(f"path {k}: {100 * loss:.1f} % of {T_base:.0f} N lost, the tip turns by {angle:.0f} deg")
