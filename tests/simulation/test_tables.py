"""Results as tables and datasets: the numbers of the arrays, under the names of the CSV files, with units."""

import csv

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.config.config import parse_config
from gtr_jax.recordings.headed import dataset_of
from gtr_jax.recordings.recording import write_recording
from gtr_jax.simulation.tables import simulation_columns

PULL = np.array([0.0, 8.0, 4.0])
KINKED = {"kind": "straight-sine-straight", "r1": -0.01, "r2": 0.01, "w1": 0.03, "w2": 0.1}


@pytest.fixture(scope="module")
def two():
    """A robot of two tendons in space, and a history."""
    config = parse_config(
        {
            "schema": 1,
            "name": "two",
            "space": True,
            "backbone": {
                "length": 0.2,
                "outer_radius": 0.012,
                "youngs_modulus": 1e6,
                "poissons_ratio": 0.45,
                "density": 1000.0,
            },
            "tendons": [
                {
                    "name": name,
                    "friction_coefficient": 0.2,
                    "routing": {"kind": "straight", "radius": 0.008, "angle": angle},
                }
                for name, angle in (("left", 0.5 * np.pi), ("up", 0.1))
            ],
        }
    )
    robot = gtr.build_robot(config, resolution=0.25)
    return robot, gtr.simulate(robot, np.array([[0.2, 0.2], [3.0, 0.2], [1.0, 2.0]]))


def test_a_simulation_in_the_plane_is_labelled(make_robot):
    robot = make_robot(0.5, routing=KINKED, markers=[{"name": "m1", "at": 0.25}])
    run = gtr.simulate(robot, PULL, time=[0.0, 1.0, 2.5])
    data = run.to_xarray(robot)
    assert data.tension.dims == ("step", "s") and data.tension.units == "N"
    np.testing.assert_array_equal(data.tension, run.tension)
    assert data.time.values.tolist() == [0.0, 1.0, 2.5] and data.attrs["robot"] == robot.name
    # Of two nodes at a place the label is unique, so that places are found.
    assert data.indexes["s"].is_unique and data.indexes["s"].is_monotonic_increasing
    assert np.any(np.diff(run.s) == 0)
    tip = data.sel(s=0.25, method="nearest")
    np.testing.assert_allclose([tip.x, tip.y, tip.angle], np.asarray(run.tip_pose).T, atol=1e-12)
    assert all("units" in v.attrs for n, v in data.data_vars.items() if n != "converged")
    state = gtr.equilibrium_at(robot, run, 1).to_xarray()
    assert state.tension.dims == ("s",) and state.wrap.units == "rad"
    for name in ("tension", "x", "y", "curvature"):
        np.testing.assert_allclose(state[name], data[name].isel(step=1), atol=1e-12)
    assert "x" not in run.to_xarray() and "tendon" not in run.to_xarray().dims


def test_kinks_at_one_place_keep_labels_apart():
    """The bores of TD-CM I end where its channel has kinks: four nodes share a place."""
    robot = gtr.load_robot("examples/tdcm-1.toml")
    state = gtr.equilibrium(robot, 20.0)
    assert np.max(np.unique(np.asarray(state.s), return_counts=True)[1]) > 2
    for data in (state.to_xarray(), gtr.simulate(robot, [0.0, 20.0]).to_xarray()):
        assert data.indexes["s"].is_unique and data.indexes["s"].is_monotonic_increasing
        assert float(data.sel(s=0.1, method="nearest").s) == pytest.approx(0.1, abs=2e-3)
        np.testing.assert_allclose(data.s, state.s, rtol=0, atol=1e-15)


def test_several_tendons_in_space_are_labelled_by_their_names(two):
    robot, run = two
    data = run.to_xarray(robot)
    assert data.tension.dims == ("step", "tendon", "s")
    assert tuple(data.tendon.values) == robot.tendon_names
    second = data.tension.sel(tendon=robot.tendon_names[1])
    np.testing.assert_array_equal(second, run.tension[:, 1])
    np.testing.assert_array_equal(data.z.isel(s=-1), run.tip_position[:, 2])
    assert run.to_xarray().tendon.values.tolist() == ["1", "2"]


def test_the_table_of_a_simulation_has_the_columns_of_its_file(two, tmp_path):
    robot, run = two
    table = run.to_pandas(robot)
    write_recording(tmp_path / "simulation.csv", simulation_columns(run, robot), tendons=robot.tendon_names)
    with open(tmp_path / "simulation.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert list(table.columns) == header and len(rows) == len(table)
    left = robot.tendon_names[0]
    np.testing.assert_array_equal(table[f"T_tip_N.{left}"], run.T_tip[:, 0])
    assert table.index.name == "step" and {"tip_z_m", f"phase.{left}"} <= {*header}


def test_true_tensions_are_told_from_those_that_cells_show(make_robot):
    robot = make_robot(0.5).with_values(**{"tip-gain.gain": 1.5})
    run = gtr.simulate(robot, PULL)
    data, table = run.to_xarray(), run.to_pandas()
    np.testing.assert_allclose(data.T_tip, 1.5 * np.asarray(run.T_tip))
    np.testing.assert_array_equal(data.T_tip_true, run.T_tip)
    np.testing.assert_array_equal(table["T_tip_true_N"], run.T_tip)
    np.testing.assert_array_equal(table["T_tip_N"], data.T_tip)


def test_batches_and_traced_results_are_refused(make_robot):
    run = gtr.simulate(make_robot(0.5), PULL)
    many = jax.tree_util.tree_map(lambda a: jnp.stack([a, a]), run)
    with pytest.raises(ValueError, match=r"Simulation: this is a batch.*tree_map"):
        many.to_xarray()
    with pytest.raises(ValueError, match="while JAX traces"):
        jax.jit(lambda r: len(r.to_pandas()))(run)


def test_a_recording_is_a_table_and_a_dataset(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("time_s,T_base_N.l,T_base_N.r,T_tip_N.l,T_tip_N.r\n0,1,2,0.5,1\n1,2,3,1,1.5\n2,3,4,2,2\n")
    recording = gtr.read_recording(path, tendons=("l", "r"))
    table, data = recording.to_pandas(), recording.to_xarray()
    assert list(table.columns) == ["time_s", "T_base_N.l", "T_base_N.r", "T_tip_N.l", "T_tip_N.r"]
    assert data.T_tip.sel(tendon="r").values.tolist() == [1.0, 1.5, 2.0] and data.T_tip.units == "N"
    assert data.time.units == "s" and "time" in data.coords
    alone = dataset_of({"T_base_N.l": np.ones(2), "friction_N_per_m": np.zeros(2)}, "row", tendons=("l", "r"))
    assert np.isnan(alone.T_base.sel(tendon="r")).all() and alone.friction.units == "N/m"
