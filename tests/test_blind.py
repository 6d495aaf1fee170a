"""The machine of the blind benchmark: nothing of ours in it, and on sound physics it agrees with us."""

import ast
import itertools
from pathlib import Path

import numpy as np

import gtr_jax as gtr
from benchmarks.blind import machine
from gtr_jax.examples import CONCEALED_ROBOT


def test_the_machine_imports_nothing_of_ours():
    tree = ast.parse(Path(machine.__file__).read_text())
    names = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in names} <= {
        "__future__",
        "collections",
        "dataclasses",
        "numpy",
        "scipy",
    }


def test_machine_and_simulator_agree():
    robot = gtr.load_robot(CONCEALED_ROBOT).with_values(mu=0.3, E=1.5e6)
    w1, w2 = 0.02, 0.08

    def offset(s):
        wave = -0.009 * np.cos(np.pi * (s - w1) / (w2 - w1))
        return np.where(s < w1, -0.009, np.where(s > w2, 0.009, wave))

    arm = machine.Arm(
        length=0.25,
        outer=lambda s: 0.020 - 0.028 * s,
        bore=lambda s: np.where((s < w1) | (s >= w2), 0.007, 0.0),
        modulus=1.5e6,
        offset=offset,
        friction=0.3,
    )
    corners = [0.0, 40.0, 6.0, 22.0, 1.0]
    T_base = np.concatenate([np.linspace(a, b, 20)[:-1] for a, b in itertools.pairwise(corners)])
    shown = machine.run(arm, 0.5 * np.arange(len(T_base)), T_base)
    assert shown.worst < 1e-4
    run = gtr.simulate(robot, T_base)
    off = np.asarray(run.T_tip) - shown.T_tip
    # Load cells are noisy by some 0.05 N, protractors by 5 mrad.
    assert np.sqrt(np.mean(off**2)) < 0.005 and np.max(np.abs(off)) < 0.02
    assert np.max(np.abs(np.asarray(run.tip_pose)[:, 2] - shown.pose[:, 2])) < 3e-4
    assert np.max(np.abs(np.asarray(run.displacement) - shown.drawn)) < 5e-5
