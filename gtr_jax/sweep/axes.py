"""What is varied: a parameter of the robot or of the load history, with its values."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from gtr_jax.errors import InputError, did_you_mean, listed
from gtr_jax.robot.parameters import Parameter, parameters_of
from gtr_jax.robot.robot import Robot
from gtr_jax.units import to_si

from .config import SweepConfig

SCALES = ("linear", "log")
MOST_VALUES = 10**8  # along a parameter: they are held in memory


def of_history(unit: str) -> dict[str, Parameter]:
    """Parameters of the load history, by name; pull and release are in `unit`, "N" or "m"."""
    return {
        "pull": Parameter("pull", "history.pull", unit, 0.0, None),
        "release": Parameter("release", "history.release", unit, 0.0, None),
        "dt": Parameter("dt", "history.dt", "s", 0.0, None, log=True),
    }


@dataclasses.dataclass(frozen=True)
class Axis:
    """One parameter that is varied.

    Attributes:
        parameter: which; `pull`, `release` and `dt` are of the load history.
        values: its values [SI], (n,), on a grid or to choose from; None where it is drawn from a range.
        low, high: ends of the range [SI].
        scale: "linear" or "log" between them; "normal" with mean `low` and standard deviation `high`.
    """

    parameter: Parameter
    values: np.ndarray | None = None
    low: float = 0.0
    high: float = 0.0
    scale: str = "linear"

    @property
    def name(self) -> str:
        """Short name, of its dimension or coordinate in the store."""
        return self.parameter.name

    @property
    def of_history(self) -> bool:
        """Whether it belongs to the load history and not to the robot."""
        return self.parameter.key.startswith("history.")

    def allows(self, values: Array) -> Array:
        """Whether values [SI], of any shape, lie within the bounds of the parameter."""
        p, positive = self.parameter, self.positive
        holds = jnp.isfinite(values)
        if p.lower is not None:
            holds &= values > p.lower if positive else values >= p.lower
        return holds if p.upper is None else holds & (values <= p.upper)

    @property
    def positive(self) -> bool:
        """Whether its lower bound is excluded; friction may vanish, though it is fitted by its logarithm."""
        return self.parameter.positive

    @property
    def ends(self) -> tuple[float, float]:
        """Least and largest value [SI]; of a normal one, three standard deviations from the mean."""
        if self.values is not None:
            return float(np.min(self.values)), float(np.max(self.values))
        if self.scale == "normal":
            return self.low - 3 * self.high, self.low + 3 * self.high
        return min(self.low, self.high), max(self.low, self.high)

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values [SI] at cumulative probabilities in [0, 1], of any shape."""
        if self.values is not None:
            return self.values[np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)]
        if self.scale == "normal":
            from scipy.special import ndtri

            return self.low + self.high * ndtri(np.clip(share, 1e-12, 1 - 1e-12))
        if self.scale == "log":
            return np.exp(np.log(self.low) + (np.log(self.high) - np.log(self.low)) * share)
        return self.low + (self.high - self.low) * share


def find(robot: Robot, key: str, where: str, unit: str) -> Parameter:
    """The parameter meant by a name or a key; InputError naming `where`. Pull and release are in `unit`."""
    known = parameters_of(robot) | of_history(unit)
    by_key = {p.key: p for p in known.values()}
    if key in known or key in by_key:
        return known.get(key) or by_key[key]
    raise InputError(f"{where}: no parameter '{key}' on this robot; {did_you_mean(key, [*known, *by_key])}")


def axes_of(sweep: SweepConfig, robot: Robot, unit: str) -> tuple[Axis, ...]:
    """What the sweep's [vary] varies, in its order; InputError naming the key. Pull and release are in
    `unit`.
    """
    axes: list[Axis] = []
    for key, said in _flat(sweep.vary):
        where = f"{sweep.source}: vary.{key}"
        parameter = find(robot, key, f"{sweep.source}: vary", unit)
        if any(axis.parameter == parameter for axis in axes):
            raise InputError(
                f"{where}: is given twice, as '{parameter.name}' and '{parameter.key}'; remove one"
            )
        axis = _axis(parameter, said, where, gridded=sweep.sample == "grid")
        check_values(np.asarray(axis.ends), axis, where)
        axes.append(axis)
    return tuple(axes)


def check_values(values: np.ndarray, axis: Axis, where: str) -> None:
    """InputError if a value lies outside the bounds of its parameter."""
    p = axis.parameter
    for value in values:
        if not axis.allows(value):
            least = f"{'above' if axis.positive else 'at least'} {p.lower:g}" if p.lower is not None else ""
            bound = f"at most {p.upper:g}" if p.upper is not None and value > p.upper else least
            more = " (three standard deviations off)" if axis.scale == "normal" else ""
            raise InputError(
                f"{where}: must be {bound} {p.unit}".rstrip() + f", is {value:g}{more}; correct it"
            )


def _flat(node: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Keys with their values; dotted keys that TOML took for tables are joined again."""
    for key, said in node.items():
        whole = f"{path}.{key}" if path else key
        if isinstance(said, Mapping) and any(isinstance(v, Mapping | list) for v in said.values()):
            if "values" not in said:
                yield from _flat(said, whole)
                continue
        yield whole, said


def _axis(parameter: Parameter, said: Any, where: str, *, gridded: bool) -> Axis:
    unit = parameter.unit or "dimensionless"
    if isinstance(said, list | tuple):
        return Axis(parameter, _listed(said, unit, where))
    forms = "[values], { from, to, count } or { mean, sd }"
    if not isinstance(said, Mapping):
        raise InputError(f"{where}: expected {forms}, found {said!r}; a list of one value keeps it fixed")
    keys = ("from", "to", "count", "scale", "values", "mean", "sd")
    for key in said:
        if key not in keys:
            raise InputError(f"{where}: unknown key '{key}'; {did_you_mean(key, keys)}")
    if "values" in said:
        _refuse_beside(said, "values", (), where)
        return Axis(parameter, _listed(said["values"], unit, f"{where}.values"))
    if "mean" in said or "sd" in said:
        return _normal(parameter, said, where, gridded)
    for key in ("from", "to"):
        if key not in said:
            raise InputError(f"{where}: missing key '{key}'; expected {forms}")
    low, high = (to_si(said[key], unit, f"{where}.{key}") for key in ("from", "to"))
    scale, count = said.get("scale", "linear"), said.get("count")
    if scale not in SCALES:
        raise InputError(f"{where}.scale: expected {listed(SCALES)}, found {scale!r}")
    if scale == "log" and min(low, high) <= 0:
        raise InputError(f"{where}: a log scale takes positive ends, found {min(low, high):g}; correct it")
    if not gridded:
        if count is not None:
            raise InputError(f"{where}.count: belongs to a grid; count = N of a sample stands by itself")
        if low == high:
            raise InputError(f"{where}: from and to are the same; leave it out of what is drawn")
        return Axis(parameter, low=low, high=high, scale=scale)
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise InputError(f"{where}.count: expected how many values, found {count!r}; for example count = 100")
    if count > MOST_VALUES:
        raise InputError(
            f"{where}.count: at most {MOST_VALUES:,} values along one parameter, found {count:,}"
        )
    if count > 1 and low == high:
        raise InputError(f"{where}: from and to are the same; write count = 1, or leave it out")
    return Axis(parameter, (np.geomspace if scale == "log" else np.linspace)(low, high, count))


def _normal(parameter: Parameter, said: Mapping[str, Any], where: str, gridded: bool) -> Axis:
    _refuse_beside(said, "mean", ("sd",), where)
    if gridded:
        raise InputError(f'{where}: mean and sd are for samples; add sample = "sobol" and count = 1024')
    for key in ("mean", "sd"):
        if key not in said:
            raise InputError(f"{where}: missing key '{key}'; a normal distribution has mean and sd")
    unit = parameter.unit or "dimensionless"
    mean, sd = (to_si(said[key], unit, f"{where}.{key}") for key in ("mean", "sd"))
    if sd <= 0:
        raise InputError(f"{where}.sd: must be positive, is {sd:g}")
    return Axis(parameter, low=mean, high=sd, scale="normal")


def _refuse_beside(said: Mapping[str, Any], key: str, allowed: tuple[str, ...], where: str) -> None:
    for other in said:
        if other not in (key, *allowed):
            raise InputError(f"{where}.{other}: has no effect beside {key}; leave one of the two out")


def _listed(said: Any, unit: str, where: str) -> np.ndarray:
    if not isinstance(said, list | tuple) or not said:
        raise InputError(f"{where}: expected a list of values, found {said!r}")
    values = np.array([to_si(value, unit, f"{where}[{i}]") for i, value in enumerate(said)])
    if len(np.unique(values)) < len(values):
        raise InputError(f"{where}: a value is given twice; remove one")
    return values
