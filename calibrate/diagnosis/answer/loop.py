"""A recording beside the base model and the one that is shown, and the columns of `diagnosis.csv`."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from calibrate.inference.channels import unit_of
from gtr_jax.recordings.headed import dataset_of, frame_of
from gtr_jax.recordings.recording import SAMPLE
from gtr_jax.recordings.signals.noise import Noise

if TYPE_CHECKING:
    import pandas
    import xarray


@dataclasses.dataclass(frozen=True, eq=False)
class Pull:
    """One tendon of a recording of K samples.

    Attributes:
        tendon: its name, "" of the only one.
        drive: true base tension as estimated [N] or, where displacement drives it, that [m], (K,).
        by_displacement: whether it does.
        phases: of the base model, (K,).
        branches: base tension, D and S of the recording, before and after, see `locate.ratio_of_branches`;
            none where displacement drives it.
        noise_drive: of what is recorded at the base, in the unit of `drive`.
    """

    tendon: str
    drive: np.ndarray
    by_displacement: bool
    phases: np.ndarray
    branches: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    noise_drive: float


@dataclasses.dataclass(frozen=True, eq=False)
class Loop:
    """One recording of K samples beside the base model and the one that is shown.

    Attributes:
        name: of the recording.
        channels: first those that are explained: the tip tensions, one for each tendon, or where none was
            recorded, what else has one unit.
        time: [s], (K,), or None.
        recorded, before, after: SI, (C, K).
        cycles: number of the cycle, from 1, (K,).
        counted: samples that are compared, (K,) bool.
        explained: how many of the channels are.
        of: number of the tendon that each channel belongs to, or that leads.
        pulls: what concerns each tendon.
        noise: of each channel.
    """

    name: str
    channels: tuple[str, ...]
    time: np.ndarray | None
    recorded: np.ndarray
    before: np.ndarray
    after: np.ndarray
    cycles: np.ndarray
    counted: np.ndarray
    explained: int
    of: tuple[int, ...]
    pulls: tuple[Pull, ...]
    noise: tuple[Noise, ...]

    def to_pandas(self) -> pandas.DataFrame:
        """The recording beside both models, with the columns of `diagnosis.csv`: SI, units in the names."""
        return frame_of(loop_columns(self), SAMPLE)

    def to_xarray(self) -> xarray.Dataset:
        """The same as a dataset with units: (sample,), of several tendons (sample, tendon)."""
        names = tuple(pull.tendon for pull in self.pulls if pull.tendon)
        return dataset_of(loop_columns(self), SAMPLE, tendons=names)


def loop_columns(loop: Loop) -> dict[str, np.ndarray]:
    """The columns of `diagnosis.csv` by header, (K,) each: what drives each tendon, what is explained as
    recorded, by the base model and by the model that is shown, and the phase of each tendon.
    """
    columns: dict[str, np.ndarray] = {} if loop.time is None else {"time_s": loop.time}
    for i, pull in enumerate(loop.pulls):
        ending = f".{pull.tendon}" if pull.tendon else ""
        columns[("displacement_m" if pull.by_displacement else "T_base_N") + ending] = pull.drive
        for c, channel in enumerate(loop.channels[: loop.explained]):
            if loop.of[c] == i:
                quantity, _, tendon = channel.partition(".")
                rows = {"": loop.recorded, "_before": loop.before, "_after": loop.after}
                for which, each in rows.items():
                    name = f"{quantity}{which}_{unit_of(channel)}"
                    columns[f"{name}.{tendon}" if tendon else name] = each[c]
        columns[f"phase{ending}"] = pull.phases
    return columns
