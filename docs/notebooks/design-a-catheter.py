# %% [markdown]
# # Design a catheter
#
# A catheter has to place its tip, and keep its shape while it does. This notebook finds the routing of the tendon that takes the tip to a pose, shows how
# exactly it must be made, and then follows a gradient of its own to an aim that no target file has.

# %%
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import design
import gtr_jax as gtr

gtr.enable_cache()  # compiled programs are kept for the next session
here = Path.cwd()  # somewhere in a checkout
examples = next(p / "examples" for p in (here, *here.parents) if (p / "examples").is_dir())
robot = gtr.load_config(examples / "tdcm-1.toml")
robot

# %% [markdown]
# ## The target
#
# The target file says where the tip has to be at which base tension, what may be searched, and what must hold: clearances, the channel's smallest radius
# of curvature, the share of the tension that friction may take.

# %%
print((examples / "tdcm-1-target.toml").read_text())

# %%
found = design.optimise(robot, examples / "tdcm-1-target.toml")
found

# %% [markdown]
# Several routings may reach it. They are a table, the best first:

# %%
found.to_pandas()

# %%
designed = gtr.build_robot(found.config)
pulled = gtr.equilibrium(designed, 45.0)
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
states = {"as it was": gtr.equilibrium(gtr.build_robot(robot), 45.0), "designed": pulled}
for name, state in states.items():
    axes.plot(1e3 * state.x, 1e3 * state.y, label=name)
axes.plot(231.5, -48.4, "k+", markersize=14, label="target")
axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
axes.legend()
plt.show()

# %% [markdown]
# ## How exactly must it be made?
#
# The tip answers to every dimension of the channel. These are derivatives through the equilibrium, friction and all:

# %%
slopes = design.pose_sensitivity(designed, 45.0, ["r1", "r2", "w1", "w2", "mu"])
for name in ("r1", "r2", "w1", "w2"):
    x, y = (0.1 * slopes[f"tip_{axis}", name] for axis in "xy")
    print(f"{name}: 0.1 mm more moves the tip by {x:+.3f} mm along x, {y:+.3f} mm along y")

# %% [markdown]
# ## An aim of your own
#
# Friction makes the tip lag: on the way back it is not where it was on the way out, at the same tension. Suppose that this matters more to the
# procedure than where exactly the tip ends. No target file can say so, but anything that can be computed from a simulation can be an aim, because all of it
# is differentiable. JAX gives the gradient through pull and release, and [optax](https://optax.readthedocs.io) follows it, within bounds that keep the
# channel in the wall ([Gradients of your own](../gradients.md) tells more).

# %%
import optax

out_and_back = jnp.array([0.0, 10.0, 20.0, 30.0, 45.0, 30.0, 20.0, 10.0])
names = ["r1", "r2", "w1", "w2"]
lowest = jnp.array([4.0, -10.5, 1.0, 60.0])  # mm
highest = jnp.array([16.5, -4.0, 40.0, 120.0])
target = jnp.array([231.5, -48.4])  # mm


def lag_and_miss(x):
    """How far apart the tip is on the two ways, and how far it ends from its target, rms [mm]."""
    values = dict(zip(names, 1e-3 * x, strict=True))
    run = gtr.simulate(designed.with_values(**values), out_and_back)
    tip = 1e3 * run.tip_pose[:, :2]
    apart = tip[jnp.array([1, 2, 3])] - tip[jnp.array([7, 6, 5])]
    return jnp.sqrt(jnp.mean(jnp.sum(apart**2, -1))), jnp.sqrt(jnp.sum((tip[4] - target) ** 2))


def aim(x):
    lag, miss = lag_and_miss(x)
    return lag**2 + 10 * miss**2


@jax.jit
def step(x, state):
    change, state = descent.update(jax.grad(aim)(x), state)
    x = optax.apply_updates(x, change)
    return optax.projections.projection_box(x, lowest, highest), state


descent = optax.adam(0.5)
x = 1e3 * jnp.array([designed.value(name) for name in names])
state, measure = descent.init(x), jax.jit(lag_and_miss)
print("lag {:.2f} mm, miss {:.2f} mm, as designed".format(*measure(x)))
for _ in range(80):
    x, state = step(x, state)
print("lag {:.2f} mm, miss {:.2f} mm, after 80 steps".format(*measure(x)))
print(", ".join(f"{name} = {value:.2f} mm" for name, value in zip(names, x, strict=True)))

# %% [markdown]
# The lag falls by more than half for a miss of two millimetres; both offsets of the channel have become smaller. Limits that are not bounds of single numbers, such as the radius of curvature of the channel, belong in the aim as
# penalties; `gtr design` keeps those of the target file by itself.
