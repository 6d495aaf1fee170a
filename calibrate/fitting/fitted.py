"""A recording beside the fitted model, and the columns of `fit.csv`."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from calibrate.inference.channels import ROTATION, of_tendons, turned_back
from gtr_jax import Recording, Robot, RobotConfig
from gtr_jax.recordings.formats.quantities import COLUMNS, QUATERNION, column_of
from gtr_jax.recordings.headed import dataset_of, frame_of, headed
from gtr_jax.recordings.recording import SAMPLE

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclasses.dataclass(frozen=True, eq=False)
class FittedChannel:
    """One recorded quantity of K samples beside the fitted model, SI.

    Attributes:
        unit: SI unit.
        simulated: (K,).
        residual: simulated minus recorded, (K,); for a displacement, with the unknown zero of its instrument
            taken off.
        sd: standard deviation that its errors were given; None where nothing was fitted.
    """

    unit: str
    simulated: np.ndarray
    residual: np.ndarray
    sd: float | None

    @property
    def rms(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))


@dataclasses.dataclass(frozen=True, eq=False)
class FittedRecording:
    """One recording of K samples beside the fitted model.

    Attributes:
        name: of the recording.
        robot: the robot fitted to it.
        config: its file; None when a `Robot` was given, or when the file would refuse the fitted values.
        channels: what was fitted to, the tip tensions first where they were recorded.
        T_base: base tension without noise [N], (K, *tendons), as its cell shows it: a gain or offset of the
            cell is taken off for the simulation. Of a tendon that displacement drives, that instead [m].
        band: standard error of the simulated T_tip due to the parameters' uncertainty [N], (K, *tendons);
            zero where no T_tip was recorded.
        phases: "pulling", "transition", "releasing" or "rest", (K, *tendons).
        by_phase: per phase its "count", "rms_N" and "mean_N" of the residual; of several tendons, per tendon
            and phase; empty where no T_tip was recorded.
        noise_N: standard deviation of the recorded tip tension [N], given or estimated; None if unknown, or
            if there is none.
        noise_from: what it was estimated from.
        noise_base_N: standard deviation of the recorded base tension [N]; 0 if it is taken as exact.
        chi2_per_n: sum of squared residuals of the tensions in units of the noise per degree of freedom; None
            without noise.
        outliers: samples that a robust fit counts less than half.
        settings: what was chosen for it, plain values.
        unrecorded: simulated T_tip where none was recorded [N], (K, *tendons).
    """

    name: str
    robot: Robot
    config: RobotConfig | None
    channels: dict[str, FittedChannel]
    T_base: np.ndarray
    band: np.ndarray
    phases: np.ndarray
    by_phase: dict[str, dict[str, float]]
    noise_N: float | None
    noise_from: str
    noise_base_N: float
    chi2_per_n: float | None
    outliers: int
    settings: dict[str, Any]
    unrecorded: np.ndarray | None = None

    def to_pandas(self, recording: Recording) -> pandas.DataFrame:
        """The recording and the fitted model, with the columns of `fit.csv`: SI, units in the names.

        Args:
            recording: that was fitted; ValueError if it has another length.
        """
        return frame_of(_beside(recording, self), SAMPLE)

    def to_xarray(self, recording: Recording) -> xarray.Dataset:
        """The same as a dataset with units: (sample,), of several tendons (sample, tendon)."""
        return dataset_of(_beside(recording, self), SAMPLE, tendons=recording.tendons)

    @property
    def T_tip(self) -> np.ndarray:
        """Simulated [N], (K, *tendons), compared or not."""
        return self._tips([c.simulated for c in self.tips]) if self.unrecorded is None else self.unrecorded

    @property
    def residual(self) -> np.ndarray:
        """Simulated minus recorded tip tension [N], (K, *tendons); NaN where none was recorded."""
        if self.unrecorded is not None:
            return np.full(self.T_base.shape, np.nan)
        return self._tips([c.residual for c in self.tips])

    @property
    def tips(self) -> list[FittedChannel]:
        """The tip tension of each tendon; empty where none was recorded."""
        return [self.channels[name] for name in of_tendons("T_tip", self.robot) if name in self.channels]

    def _tips(self, each: list[np.ndarray]) -> np.ndarray:
        return np.stack(each, axis=1) if self.robot.tendon_names else each[0]

    @property
    def rms_N(self) -> float:
        """Root mean square of the residual of the tip tensions [N]; NaN where none was recorded."""
        return float(np.sqrt(np.mean(self.residual**2)))


def fitted_columns(recording: Recording, fitted: FittedRecording) -> dict[str, Any]:
    """A recording, and beside it what the fitted model shows, by quantity or header."""
    columns = {name: getattr(recording, name) for name in COLUMNS}
    columns |= {column_of(name).header: values for name, values in recording.markers.items()}
    drawn = np.asarray([tendon.drive == "displacement" for tendon in fitted.robot.tendons])
    which = drawn.reshape(fitted.T_base.shape[1:])
    if not drawn.all():
        columns["T_base_fitted_N"] = np.where(which, np.nan, fitted.T_base)
    if drawn.any():
        columns["displacement_fitted_m"] = np.where(which, fitted.T_base, np.nan)
    for name, channel in fitted.channels.items():
        quantity, dot, tendon = name.partition(".")
        if quantity not in ROTATION:
            columns[f"{quantity}_fitted_{channel.unit}{dot}{tendon}"] = channel.simulated
    if ROTATION[0] in fitted.channels and recording.tip_quaternion is not None:
        left = np.stack([fitted.channels[name].residual for name in ROTATION], axis=1)
        fits = turned_back(recording.tip_quaternion, left).T
        columns |= {f"{name}_fitted": row for name, row in zip(QUATERNION, fits, strict=True)}
    if fitted.tips:
        columns["residual_N"] = fitted.residual
    columns["phase"] = fitted.phases
    return {name: values for name, values in columns.items() if values is not None}


def _beside(recording: Recording, fitted: FittedRecording) -> dict[str, np.ndarray]:
    """The columns of `fit.csv` by header, (K,) each.

    Raises:
        ValueError: the recording is another one.
    """
    if len(recording) != len(fitted.T_base):
        raise ValueError(
            f"{recording.path.name} has {len(recording)} samples, and {fitted.name}, which was fitted, "
            f"{len(fitted.T_base)}; give the recording that was fitted"
        )
    return headed(fitted_columns(recording, fitted), tendons=recording.tendons)
