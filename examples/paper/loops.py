"""The loops of TD-CM I and II, the frictionless model beside them, and an inner loop."""

from pathlib import Path

import numpy as np

import gtr_jax as gtr

HERE = Path(__file__).parent
PULL = np.linspace(0.0, 45.0, 46)
RELEASE = PULL[-2::-1]
INNER = np.concatenate([PULL, np.arange(44.0, 19.9, -1.0), np.arange(21.0, 45.1, 1.0)])

for name in ("tdcm-1", "tdcm-2"):
    robot = gtr.load_robot(HERE / f"{name}.toml")
    loop = gtr.simulate(robot, np.concatenate([PULL, RELEASE]))
    switch = gtr.release_switch(robot, 45.0)
    frictionless = gtr.equilibrium(robot.with_values(mu=0.0), 45.0)
    print(f"{robot.name}: {loop.T_tip[45]:.1f} N of 45 N at the tip, T_base_switch {switch.T_base:.1f} N")
    print(f"  without friction: {frictionless.T_tip:.1f} N, and the tip turns by ", end="")
    print(f"{np.degrees(frictionless.tip_pose[2]):.0f} instead of {np.degrees(loop.tip_pose[45, 2]):.0f} deg")
    inner = gtr.simulate(robot, INNER)
    back = np.max(np.abs(inner.tension[-1] - inner.tension[45]))
    print(f"  45 -> 20 -> 45 N: the tension along the tendon is back within {back:.1e} N")
