"""The sweep file: `SWEEP.toml` read and checked by itself; `sweep.task` checks it against the robot.

The classes below are the file's sections; after validation they hold SI floats (N, s). What is varied stays
as written until its unit is known, which depends on the robot.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, StrictInt, StrictStr

from gtr_jax.config.amount import Amount, Pulled
from gtr_jax.config.section import Section
from gtr_jax.config.sections import FileSection
from gtr_jax.config.toml_file import read_toml
from gtr_jax.errors import InputError
from gtr_jax.units import Unit

Pull = Annotated[Amount, Pulled()]
Time = Annotated[float, Unit("s")]
Ratio = Annotated[float, Unit("dimensionless")]
Whole = Annotated[StrictInt, Field(gt=-(2**63), lt=2**63)]

DRAWN = ("sobol", "latin-hypercube", "random", "saltelli", "morris")


class HistorySection(Section):
    """The load history of every point."""

    pull: Pull | None = Field(default=None, examples=["45 N"])
    """Base tension to which the tendon is pulled from its preload, or by how far where displacement drives
    it."""
    release: Pull | None = None
    """Base tension, or displacement, to which it is then released."""
    steps: Whole | None = None
    """Load steps of each branch; one for a pull alone, 40 with a release, unless given."""
    dt: Time | None = None
    """Time of each step [s], for physics terms that depend on it."""
    tendon: StrictStr | None = None
    """Of several tendons the one that is pulled; the others keep their preload, or their place."""
    file: StrictStr | None = None
    """CSV file of the base tension, or of the displacement, relative to the sweep file, instead of pull and
    release."""
    keep: Literal["turns", "all", "last"] = "turns"
    """Which steps of the history are kept: the end of each branch, all, or the last."""


class SweepConfig(FileSection):
    """A sweep file."""

    schema_version: Literal[1] = Field(alias="schema", examples=[1])
    """Version of the file format."""
    name: StrictStr = "sweep"
    """Name in reports."""
    robot: StrictStr = Field(examples=["robot.toml"])
    """Robot file, relative to the sweep file."""
    outputs: tuple[StrictStr, ...] = Field(examples=[["T_tip", "tip_pose"]])
    """What to compute at every point; see `gtr_jax.sweep.outputs`."""
    sample: Literal["grid", "sobol", "latin-hypercube", "random", "saltelli", "morris"] = "grid"
    """Every combination of the values, or points drawn; saltelli and morris are drawn for sensitivity
    indices."""
    count: Whole | None = None
    """Points drawn; with saltelli and morris, of the base sample or of trajectories."""
    seed: Whole = 0
    """Of the points drawn."""
    resolution: Ratio = 1.0
    """Factor on the number of mesh intervals."""
    points: StrictStr | None = None
    """CSV file of the points instead of [vary], one column for each parameter, relative to the sweep file."""
    vary: dict[str, Any] = Field(default_factory=dict)
    """What is varied, by name or key: a list of values, { from, to, count, scale }, or { mean, sd }."""
    history: HistorySection = HistorySection()

    def fault(self, key: str, says: str) -> InputError:
        """An error at one of its keys."""
        return InputError(f"{self.source}: {key}: {says}")


def parse_sweep(
    data: Mapping[str, Any], *, source: str = "sweep", folder: str | os.PathLike[str] = "."
) -> SweepConfig:
    """Check the contents of a sweep file. `source` names it in errors; `folder` is where its files lie.

    Raises InputError naming source, key and remedy.
    """
    sweep = SweepConfig.parsed(data, source=source, folder=folder)
    _check(sweep)
    return sweep


def load_sweep(path: str | os.PathLike[str]) -> SweepConfig:
    """Read a sweep file. Raises InputError naming file, key and remedy."""
    return parse_sweep(read_toml(path), source=str(path), folder=Path(path).parent)


def sweep_text(sweep: SweepConfig) -> str:
    """A sweep file as TOML, with unit strings."""
    import tomli_w

    return tomli_w.dumps(
        sweep.model_dump(
            by_alias=True, exclude_defaults=True, exclude_none=True, context={"unit_strings": True}
        )
    )


def _check(sweep: SweepConfig) -> None:
    drawn = sweep.sample in DRAWN
    if not sweep.outputs:
        raise sweep.fault("outputs", 'is empty; write for example outputs = ["T_tip", "tip_pose"]')
    if not sweep.vary and sweep.points is None:
        example = '"tendon.friction_coefficient" = { from = 0.1, to = 0.5, count = 100 }'
        raise sweep.fault("vary", f"nothing is varied; write for example {example} under [vary]")
    if sweep.points is not None and (sweep.vary or drawn or sweep.count is not None):
        raise sweep.fault("points", "has the points already; leave vary, sample and count out")
    if drawn and (sweep.count is None or sweep.count < 1):
        raise sweep.fault(
            "count", f"sample = '{sweep.sample}' needs how many; write for example count = 1024"
        )
    if not drawn and sweep.count is not None:
        raise sweep.fault(
            "count", "a grid takes a count for each parameter; put it there, or choose a sample to draw"
        )
    if sweep.sample == "saltelli" and sweep.count is not None and sweep.count & (sweep.count - 1):
        raise sweep.fault("count", f"must be a power of two for saltelli, is {sweep.count}; 1024 for example")
    if sweep.seed < 0:
        raise sweep.fault("seed", f"must not be negative, is {sweep.seed}; 0 for example")
    if not 0.1 <= sweep.resolution <= 100:
        raise sweep.fault("resolution", f"must lie between 0.1 and 100, is {sweep.resolution:g}; 1 is usual")
    _check_history(sweep)


def _check_history(sweep: SweepConfig) -> None:
    h = sweep.history
    if h.file is not None:
        for key in ("pull", "release", "steps", "dt", "tendon"):
            if getattr(h, key) is not None:
                raise sweep.fault(f"history.{key}", "has no effect beside file; leave one of the two out")
    if h.steps is not None and not 1 <= h.steps <= 100_000:
        raise sweep.fault("history.steps", f"must lie between 1 and 100000, is {h.steps}; 40 for example")
    if h.dt is not None and h.dt <= 0:
        raise sweep.fault("history.dt", f"must be positive, is {h.dt:g} s; 0.1 s for example")
