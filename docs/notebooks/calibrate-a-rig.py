# %% [markdown]
# # Calibrate a rig
#
# A bench rig pulls a continuum manipulator by one tendon and records the tension at the base and at the tip. This notebook fits the friction
# coefficient and the stiffness to two such recordings, looks at what the fit leaves, and continues with the answer as tables and datasets. The files are in
# `examples/rig`; [From a recording to an answer](../tutorial.md) does the same with commands.

# %%
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

import calibrate
import gtr_jax as gtr
from gtr_jax.plots.loop import plot_loop

gtr.enable_cache()  # compiled programs are kept for the next session
here = Path.cwd()  # somewhere in a checkout
examples = next(p / "examples" for p in (here, *here.parents) if (p / "examples").is_dir())
rig = examples / "rig"

# %% [markdown]
# ## The robot and its recordings
#
# The robot file says what its owner knows, and under `[uncertainty]` how well. A robot displays itself:

# %%
robot = gtr.load_config(rig / "robot.toml")
robot

# %%
monday, tuesday = (gtr.read_recording(rig / f"{day}.csv") for day in ("monday", "tuesday"))
tuesday.to_pandas().head()

# %% [markdown]
# ## The fit
#
# Two recordings of one robot are fitted together. On Tuesday a camera saw the angle of the tip, and an encoder the length of tendon that was drawn out;
# everything that a recording holds is used.

# %%
fit = calibrate.fit(robot, [monday, tuesday])
fit

# %% [markdown]
# Read the verdict first: is the model good enough for its numbers to mean anything?

# %%
print(fit.verdict)

# %% [markdown]
# The numbers are a table, in SI units:

# %%
fit.to_pandas()[["value", "sd", "lower95", "upper95", "unit"]]

# %% [markdown]
# ## What the fit leaves
#
# `to_pandas` gives the recording and the fitted model sample by sample, `to_xarray` the same as a dataset with units.

# %%
of_monday = fit.recordings[0]
print(of_monday.to_xarray(monday))

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
plot_loop(monday.T_base, monday.T_tip, phases=of_monday.phases, axes=left)
right.plot(monday.time, 1e3 * (monday.T_tip - of_monday.T_tip), ".", markersize=3)
right.set(xlabel="time [s]", ylabel="recorded less fitted tip tension [mN]")
plt.show()

# %% [markdown]
# ## What follows from it
#
# The fitted robot goes into every other function. What tip tension does it promise when the base pulls with 45 N, and how far is it to be trusted? The
# gradient through the solver takes the covariance of the fit there.

# %%
names = [e.name for e in fit.estimates]
fitted = of_monday.robot


def tip_tension(values):
    robot = fitted.with_values(**dict(zip(names, values, strict=True)))
    return gtr.equilibrium(robot, 45.0).T_tip


at, sd = (np.array([getattr(e, what) for e in fit.estimates]) for what in ("value", "sd"))
slope = np.asarray(jax.grad(tip_tension)(at))
covariance = fit.correlation * np.outer(sd, sd)
sure = np.sqrt(slope @ covariance @ slope)
print(f"{float(tip_tension(at)):.3f} ± {sure:.3f} N at the tip for 45 N at the base")
