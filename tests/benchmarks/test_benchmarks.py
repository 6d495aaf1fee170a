"""The benchmarks run: candidates agree with the march, metrics come out, the gate tells worse from same."""

import dataclasses
import json
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks is not installed
from benchmarks import gate, measure, node_equation, noisy, solver_study, speed, systems
from benchmarks.candidates import CANDIDATES, equilibrium
from benchmarks.whole_pull import Pull

RIVALS = [name for name in CANDIDATES if name != "march"]


@pytest.mark.parametrize("system", [systems.TDCM_1, systems.TDCM_1_LOADED], ids=lambda s: s.name)
@pytest.mark.parametrize("name", RIVALS)
def test_candidates_find_the_march_s_solution(system, name):
    robot = system.robot(0.5)
    march = gtr.equilibrium(robot, system.T_base, solver=gtr.SolverOptions(atol=1e-12))
    rival = equilibrium(robot, system.T_base, CANDIDATES[name])
    assert bool(rival.converged)
    assert float(rival.T_tip) == pytest.approx(float(march.T_tip), rel=1e-8)
    np.testing.assert_allclose(rival.tip_pose, march.tip_pose, atol=1e-8)


def test_the_pass_that_is_timed_is_the_march():
    system = systems.TDCM_1
    robot = system.robot()
    pull = Pull.of(robot, jnp.asarray(system.T_base))
    T_tip, left = node_equation.one_pass(pull, node_equation.RULES["fixed point, two secants"])
    assert float(left) < 1e-12
    exact = gtr.equilibrium(robot, system.T_base, solver=gtr.SolverOptions(atol=1e-12)).T_tip
    assert float(T_tip) == pytest.approx(float(exact), rel=1e-11)


def test_mesh_rules_leave_the_package_as_it_was():
    before = systems.TDCM_1.robot().intervals
    with solver_study.mesh_rule(24, 10, 3, ()):
        assert sum(systems.TDCM_1.robot().intervals) < sum(before)
    assert systems.TDCM_1.robot().intervals == before


def test_order_is_the_slope():
    points = [{"resolution": r, "nodes": 50 * r, "T_tip_relative": 1e-4 * r**-4} for r in (0.5, 1.0, 2.0)]
    assert solver_study.order(points) == pytest.approx(4.0)


def test_metrics_and_gate(tmp_path):
    metrics = list(speed.equilibrium(quick=True))
    assert metrics and all(np.isfinite(m.value) and m.value > 0 for m in metrics)
    path = tmp_path / "baseline.json"
    gate.write_baseline(metrics, path)
    assert gate.worse(metrics, path) == []
    slower = [dataclasses.replace(m, gated=m.gated * (1.1 + m.tolerance)) for m in metrics if m.gated]
    assert len(gate.worse(slower, path)) == len(slower) > 0


def test_committed_baseline_names_its_machine_and_knows_the_metrics():
    baseline = json.loads(gate.BASELINE.read_text())
    assert baseline["machine"].keys() >= measure.machine().keys()
    assert any(m["gated"] for m in baseline["metrics"].values())


def test_labelled_recordings_are_made_of_noise_free_ones(tmp_path):
    reference = Path(__file__).parents[1] / "data/reference"
    for name in ("coulomb", "local-friction-tip"):
        noisy.write(reference / name, tmp_path)
    true = gtr.read_recording(reference / "coulomb/recording.csv")
    with_pose = gtr.read_recording(tmp_path / "coulomb-pose/recording.csv")
    off = np.asarray(with_pose.T_tip) - np.asarray(true.T_tip)
    assert np.std(off) == pytest.approx(0.05, rel=0.25) and 0.3 < np.corrcoef(off[1:], off[:-1])[0, 1] < 0.7
    assert with_pose.tip_x is not None and np.std(with_pose.tip_x - true.tip_x) == pytest.approx(
        3e-4, rel=0.2
    )
    alone = gtr.read_recording(tmp_path / "local-friction-tip-tensions/recording.csv")
    assert alone.tip_x is None and len(alone) == len(true)
    stated = [
        float(gtr.build_robot(gtr.load_config(folder / "robot.toml")).value("E"))
        for folder in (reference / "coulomb", tmp_path / "coulomb-pose")
    ]
    assert stated[1] / stated[0] == pytest.approx(noisy.E_OFF, rel=1e-3)
    truth = json.loads((tmp_path / "local-friction-tip-pose/truth.json").read_text())
    assert truth["effects"] == ["local-friction"] and noisy.effect("coulomb-gravity") == []
