"""An antagonistic pair: one tendon pulled and released, the other held. The held one slides all the same."""

from pathlib import Path

import numpy as np

import gtr_jax as gtr

robot = gtr.load_robot(Path(__file__).parent / "antagonists.toml")
held = 5.0
left = np.concatenate([np.linspace(1.0, held, 9), np.linspace(held, 15.0, 21), np.linspace(15.0, held, 21)])
right = np.minimum(left, held)  # strung together first, then held
run = gtr.simulate(robot, np.stack([left, right], axis=1))
print(f"tendons {', '.join(robot.tendon_names)}; all steps converged: {bool(run.converged.all())}")
for step in (29, 39, 50):
    tips = " and ".join(f"{T:.2f}" for T in run.T_tip[step])
    bend = np.degrees(run.tip_pose[step, 2])
    print(f"left at {left[step]:.1f} N: {tips} N at the tips, the tip turns by {bend:.0f} deg")
