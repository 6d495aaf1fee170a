"""Draws from a posterior, and whether the chains that drew them agree."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtr_jax import InputError
from gtr_jax.atomic_write import replaced_atomically
from gtr_jax.recordings.headed import frame_of

if TYPE_CHECKING:
    import pandas
    import xarray

# Chains that agree have a potential scale reduction below this.
AGREED = 1.01
# Names of what the sampler says of each draw, as ArviZ has them, with units and words.
STATISTICS = {
    "diverging": "whether the transition diverged",
    "lp": "logarithm of the posterior density, up to a constant",
    "acceptance_rate": "mean probability of acceptance in the transition",
    "n_steps": "leapfrog steps of the transition",
}
EXTRA = "pip install 'gtr-jax[posterior]'"


def require_netcdf(path: str | os.PathLike[str]) -> None:
    """Refuse to write a NetCDF file if what writes it is not installed.

    Raises:
        InputError: it is not.
    """
    try:
        import h5netcdf  # noqa: F401
    except ImportError:
        raise InputError(f"{path}: NetCDF needs h5netcdf, which is not installed; {EXTRA}") from None


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of the p free numbers, SI, from several chains, n each.

    Attributes:
        names: of the free numbers.
        units: SI, "" if dimensionless.
        draws: (chains, n, p).
        lower95, upper95: 2.5 and 97.5 % quantiles, (p,).
        sd: standard deviations, (p,).
        effective: effective sample sizes, (p,).
        rhat: split potential scale reductions, (p,).
        statistics: what the sampler says of each draw, (chains, n) each: diverging, lp, acceptance_rate,
            n_steps.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    draws: np.ndarray
    lower95: np.ndarray
    upper95: np.ndarray
    sd: np.ndarray
    effective: np.ndarray
    rhat: np.ndarray
    statistics: dict[str, np.ndarray]

    @property
    def divergences(self) -> int:
        """Divergent transitions of the sampler."""
        return int(np.sum(self.statistics["diverging"]))

    @property
    def converged(self) -> bool:
        """Whether the chains agree and none diverged."""
        return self.divergences == 0 and bool(np.all(self.rhat < AGREED))

    def to_pandas(self) -> pandas.DataFrame:
        """The draws, a row each, with the columns of `draws.csv`: SI, units in the names."""

        return frame_of(draws_columns(self), "row")

    def to_xarray(self) -> xarray.DataTree:
        """The draws as ArviZ lays them out: the group `posterior` with a variable (chain, draw) for each
        number, its SI unit in `units`, and the group `sample_stats` with what the sampler says of each draw.
        Chains and draws count from 1, as in `draws.csv`. ArviZ 1.0 and later take the tree as it is.
        """
        import xarray as xr

        chains, each, _ = self.draws.shape
        dims = ("chain", "draw")
        coords = {"chain": np.arange(1, chains + 1), "draw": np.arange(1, each + 1)}
        drawn: dict[str, Any] = {
            name: (dims, self.draws[..., i], {"units": unit or "1"})
            for i, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        }
        said = {n: (dims, own, {"long_name": STATISTICS[n]}) for n, own in self.statistics.items()}
        made = {"inference_library": "numpyro", "creation_library": "gtr-jax"}
        return xr.DataTree.from_dict(
            {
                "/posterior": xr.Dataset(drawn, coords, made),
                "/sample_stats": xr.Dataset(said, coords, made),
            }
        )

    def to_arviz(self) -> Any:
        """The draws as `arviz.InferenceData`; with ArviZ 1.0 and later, which has no such class, as
        `to_xarray`.

        Raises:
            InputError: ArviZ is not installed.
        """
        try:
            import arviz
        except ImportError:
            raise InputError(f"to_arviz: ArviZ is not installed; {EXTRA}") from None
        tree = self.to_xarray()
        if not hasattr(arviz, "InferenceData"):
            return tree
        groups: dict[str, Any] = {name: group.to_dataset() for name, group in tree.children.items()}
        return arviz.InferenceData(**groups)

    def to_netcdf(self, path: str | os.PathLike[str]) -> Path:
        """Write `to_xarray` as a NetCDF file, whole or not at all: `draws.nc` of `gtr fit --posterior`, which
        `arviz.from_netcdf` reads.

        Args:
            path: of the file, which is replaced.

        Returns:
            Its path.

        Raises:
            InputError: h5netcdf is not installed.
        """
        require_netcdf(path)
        tree = self.to_xarray()
        with replaced_atomically(path) as part:
            tree.to_netcdf(part, engine="h5netcdf")
        return Path(path)


def draws_columns(posterior: Posterior) -> dict[str, np.ndarray]:
    """The draws of a posterior as columns, a row each, SI with the unit in the name."""
    chains, each, _ = posterior.draws.shape
    columns = {
        "chain": np.repeat(np.arange(1, chains + 1), each),
        "draw": np.tile(np.arange(1, each + 1), chains),
    }
    for i, (name, unit) in enumerate(zip(posterior.names, posterior.units, strict=True)):
        columns[f"{name} [{unit}]" if unit else name] = posterior.draws[..., i].reshape(-1)
    return columns
