# %% [markdown]
# # Why does my recording differ?
#
# A fit that leaves more than noise has left some physics out. This notebook makes a recording in which an effect is at work that the robot file does
# not know, shows what a plain fit makes of it, asks which effect it is, and predicts the next experiment with the answer. Put your recording in
# place of the simulated one.

# %%
import tempfile
import tomllib
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import calibrate
import gtr_jax as gtr
from gtr_jax.config.config import parse_config

gtr.enable_cache()  # compiled programs are kept for the next session
here = Path.cwd()  # somewhere in a checkout
examples = next(p / "examples" for p in (here, *here.parents) if (p / "examples").is_dir())
folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## A recording from a rig that is not as its owner thinks
#
# In the true rig the friction does not turn around at once where the pull does: the tendon first creeps against it ([presliding](../terms/presliding.md)).
# Its friction coefficient and modulus are not those of the file either, and both load cells have noise.

# %%
description = tomllib.loads((examples / "tdcm-1.toml").read_text())
effect = {"kind": "presliding", "length": "0.4 mm"}
true = gtr.build_robot(parse_config(description | {"terms": [effect]}))
true = true.with_values(mu=0.33, E=1.15e6)

ends = [0, 40, 12, 34, 5, 45, 0]
legs = [np.linspace(a, b, 60, endpoint=False) for a, b in pairwise(ends)]
T_base = np.concatenate(legs)
run = gtr.simulate(true, T_base)
random = np.random.default_rng(7)
columns = {
    "time": np.arange(len(T_base)) / 10,
    "T_base": T_base + random.normal(0, 0.05, len(T_base)),
    "T_tip": np.asarray(run.T_tip) + random.normal(0, 0.03, len(T_base)),
}
gtr.write_recording(folder / "recording.csv", columns)
recording = gtr.read_recording(folder / "recording.csv")
recording.to_pandas().describe().loc[["count", "min", "max"]]

# %% [markdown]
# ## What a plain fit says

# %%
robot = gtr.load_config(examples / "tdcm-1.toml")
fit = calibrate.fit(robot, recording)
print(fit.verdict)

# %% [markdown]
# ## What is missing
#
# `diagnose` tries every effect of the catalogue, refits the promising ones, and judges them on samples that the fit has not seen.

# %%
diagnosis = calibrate.diagnose(robot, recording)
diagnosis

# %%
diagnosis.to_pandas()[["before", "after", "sd", "lower95", "upper95", "unit"]]

# %% [markdown]
# The answer also says how probable each of the models is. Models of similar probability are rivals that the recording cannot tell apart.

# %%
for model in diagnosis.rivals[:5]:
    print(f"{' + '.join(model.names) or 'nothing':40s} {model.probability:.3f}")

# %% [markdown]
# ## The next experiment, predicted
#
# A model that only redescribes what it was fitted to is worth little. The diagnosed robot predicts a pull that was not in the recording, and so does the
# plain one.

# %%
pull = np.concatenate([np.linspace(0, 25, 80), np.linspace(25, 15, 60), np.linspace(15, 30, 60)])
happens = gtr.simulate(true, pull).T_tip
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
models = {"plain fit": fit.robot, "diagnosed": gtr.build_robot(diagnosis.config)}
for name, model in models.items():
    error = np.asarray(gtr.simulate(model, pull).T_tip - happens)
    axes.plot(pull, error, label=f"{name}: {1e3 * np.sqrt(np.mean(error**2)):.0f} mN rms")
axes.set(xlabel="base tension [N]", ylabel="predicted less true tip tension [N]")
axes.legend()
plt.show()
