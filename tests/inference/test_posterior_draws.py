"""Draws of a posterior as a table, for ArviZ, and as a NetCDF file."""

import sys
from types import ModuleType

import numpy as np
import pytest

import gtr_jax as gtr
from calibrate import Posterior


@pytest.fixture
def posterior():
    draws = np.random.default_rng(1).normal([0.3, 1e6], [0.01, 2e4], (4, 200, 2))
    at = draws.reshape(-1, 2)
    said = {name: np.zeros((4, 200)) for name in ("lp", "acceptance_rate", "n_steps")}
    return Posterior(
        names=("mu", "E@rig-1"),
        units=("", "Pa"),
        draws=draws,
        lower95=np.quantile(at, 0.025, axis=0),
        upper95=np.quantile(at, 0.975, axis=0),
        sd=at.std(axis=0, ddof=1),
        effective=np.array([800.0, 800.0]),
        rhat=np.array([1.0, 1.0]),
        statistics={**said, "diverging": np.arange(800).reshape(4, 200) == 5},
    )


def test_draws_are_a_table(posterior):
    table = posterior.to_pandas()
    assert list(table.columns) == ["chain", "draw", "mu", "E@rig-1 [Pa]"]
    assert table["chain"].tolist() == np.repeat([1, 2, 3, 4], 200).tolist()
    row = table[(table["chain"] == 2) & (table["draw"] == 3)].iloc[0]
    assert row["E@rig-1 [Pa]"] == posterior.draws[1, 2, 1]
    assert posterior.divergences == 1 and not posterior.converged


def test_arviz_reads_the_draws_in_memory_and_from_the_file(posterior, tmp_path):
    arviz = pytest.importorskip("arviz")
    path = posterior.to_netcdf(tmp_path / "draws.nc")
    for data in (posterior.to_arviz(), arviz.from_netcdf(path)):
        assert data.posterior["mu"].dims == ("chain", "draw")
        np.testing.assert_array_equal(data.posterior["E@rig-1"], posterior.draws[..., 1])
        assert data.posterior["E@rig-1"].attrs["units"] == "Pa"
        assert int(data.sample_stats["diverging"].sum()) == 1
        table = arviz.summary(data, round_to="none")
        np.testing.assert_allclose(table["sd"], posterior.sd, rtol=1e-9)
        assert np.all(table["r_hat"] < 1.02)
    assert [file.name for file in tmp_path.iterdir()] == ["draws.nc"]


def test_a_file_that_cannot_be_written_leaves_the_earlier_one(posterior, tmp_path, monkeypatch):
    path = tmp_path / "draws.nc"
    path.write_bytes(b"earlier")
    monkeypatch.setattr("xarray.DataTree.to_netcdf", lambda self, part, engine: part.write_text("half") / 0)
    with pytest.raises(ZeroDivisionError):
        posterior.to_netcdf(path)
    assert path.read_bytes() == b"earlier" and [file.name for file in tmp_path.iterdir()] == ["draws.nc"]


def test_what_is_not_installed_is_named(posterior, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(gtr.InputError, match=r"draws\.nc: NetCDF needs h5netcdf.*gtr-jax\[posterior\]"):
        posterior.to_netcdf(tmp_path / "draws.nc")
    with pytest.raises(gtr.InputError, match=r"ArviZ is not installed.*gtr-jax\[posterior\]"):
        posterior.to_arviz()


def test_an_arviz_without_inference_data_gets_the_tree(posterior, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", ModuleType("arviz"))
    assert set(posterior.to_arviz().children) == {"posterior", "sample_stats"}
