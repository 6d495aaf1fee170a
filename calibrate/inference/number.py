"""A number of a robot that is estimated, as a coordinate near zero."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from gtr_jax.robot.parameters import Parameter

# Separates a number's name from that of the recording or robot that has its own value of it.
OWN = "@"
# Unit of the coordinate, by SI unit, for a parameter on a linear scale whose value is zero.
UNIT_SCALE = {"N": 1.0, "N m": 0.1, "m": 1e-3, "rad": 0.1, "rad/m": 1.0, "": 0.1}


@dataclasses.dataclass(frozen=True)
class Number:
    """A free number of a robot: value = centre exp(sd x) where logarithmic, else centre + sd x.

    In a diagnosis x ~ N(0, 1) before anything is seen; in a fit sd is the unit that x is measured in.

    Attributes:
        name: of the parameter, as `gtr_jax.parameters_of` lists it; where one recording, or one robot, has
            the number to itself, with its name after an @.
        unit: SI.
        centre, sd: see above; for a size, the centre is its null value.
        log: whether it is logarithmic.
        lower, upper: bounds of the value.
        size: whether it says how strong an effect is.
        key: the parameter's key in the robot file, "" where that is not asked for.
        apart: change of the value that matters, for derivatives by differences and for scans; the unit of the
            coordinate tells where that is not given.
    """

    name: str
    unit: str
    centre: float
    sd: float
    log: bool
    lower: float = -np.inf
    upper: float = np.inf
    size: bool = False
    key: str = ""
    apart: float | None = None

    @property
    def parameter(self) -> str:
        """Name of the robot's parameter."""
        return self.name.partition(OWN)[0]

    @property
    def owner(self) -> str:
        """The recording or robot that has it to itself; "" if it is shared."""
        return self.name.partition(OWN)[2]

    def of(self, owner: str) -> Number:
        """The same number of one recording alone."""
        return dataclasses.replace(self, name=f"{self.parameter}{OWN}{owner}")

    def value(self, x: float) -> float:
        """The value at a coordinate, within its bounds."""
        return float(self.values(np.asarray(x)))

    def values(self, x: np.ndarray) -> np.ndarray:
        """The values at coordinates, within its bounds, the shape of `x`."""
        far = self.sd * x
        value = self.centre * np.exp(np.minimum(far, 700.0)) if self.log else self.centre + far
        return np.clip(value, self.lower, self.upper)

    def at(self, value: float) -> float:
        """The coordinate of a value."""
        return float(np.log(value / self.centre) if self.log else value - self.centre) / self.sd

    @property
    def bounds(self) -> tuple[float, float]:
        """Range of the coordinate; on a logarithmic scale at most from -8 to 8."""
        if self.log:
            low = self.at(self.lower) if self.lower > 0 else -8.0
            return max(low, -8.0), min(self.at(self.upper) if np.isfinite(self.upper) else 8.0, 8.0)
        return self.at(self.lower), self.at(self.upper)


def number_at(entry: Parameter, value: float, *, sd: float | None = None, name: str = "") -> Number:
    """A robot's parameter as a number about a value [SI].

    Args:
        entry: the parameter.
        value: where the coordinate is zero.
        sd: prior standard deviation [SI], which is then the unit of the coordinate, on a linear scale; unless
            given, the unit is the value's own size.
        name: of the number; the parameter's unless given.
    """
    log = sd is None and is_log(entry, value)
    return Number(
        name=name or entry.name,
        unit=entry.unit,
        centre=value,
        sd=1.0 if log else sd or abs(value) or UNIT_SCALE.get(entry.unit, 1.0),
        log=log,
        lower=-np.inf if entry.lower is None else entry.lower,
        upper=np.inf if entry.upper is None else entry.upper,
        key=entry.key,
    )


def is_log(entry: Parameter, initial: float) -> bool:
    """Whether a parameter is fitted on a logarithmic scale: declared so, or positive by its bounds."""
    return entry.log or (entry.lower == 0.0 and initial > 0.0)


def values_in(values: Mapping[str, float], recording: str) -> dict[str, float]:
    """Values by name as one recording has them: its own "mu@monday" becomes "mu"."""
    own = {
        name.partition(OWN)[0]: value
        for name, value in values.items()
        if name.partition(OWN)[1:] == (OWN, recording)
    }
    return {name: value for name, value in values.items() if OWN not in name} | own
