"""Fits as tables and datasets: the columns of `fit.csv` and `draws.csv`, and the estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calibrate.inference.channels import ROTATION, turned_back
from gtr_jax import Recording
from gtr_jax.recordings.formats.quantities import COLUMNS, QUATERNION, column_of
from gtr_jax.recordings.headed import headed

if TYPE_CHECKING:
    import pandas

    from .result import FitResult, FittedRecording


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


def beside(recording: Recording, fitted: FittedRecording) -> dict[str, np.ndarray]:
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


def estimates_frame(fit: FitResult) -> pandas.DataFrame:
    """See `FitResult.to_pandas`."""
    import pandas as pd

    names = ("key", "value", "sd", "lower95", "upper95", "initial", "unit", "detectable", "note")
    rows = [
        {name: getattr(e, name) for name in names} | {"carried": carried}
        for each, carried in ((fit.estimates, False), (fit.carried, True))
        for e in each
    ]
    index = pd.Index([e.name for e in (*fit.estimates, *fit.carried)], name="parameter")
    table = pd.DataFrame(rows, index=index, columns=[*names, "carried"])
    return table.astype({name: float for name in ("sd", "lower95", "upper95", "detectable")})
