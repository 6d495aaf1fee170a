"""Where a law of unknown form may act, and of what: the range that the recordings cover, and a law that is a
single tent, by which a form is felt.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from calibrate.diagnosis.hypotheses.model import Point
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.likelihood.locate import cycles_of
from calibrate.inference.channels import CHANNELS
from calibrate.inference.number import OWN
from calibrate.inference.simulated_readings import SimulatedReadings
from calibrate.inference.simulated_rig import friction_of
from gtr_jax import Robot, equilibrium
from gtr_jax.robot.stiffness import stiffness_of
from gtr_jax.terms import Law, Quantity
from gtr_jax.terms.law import ACTS, VARIABLES

# Variables in a word, for names.
WORDS = {
    "p": "pressure",
    "T": "tension",
    "v": "speed",
    "s": "place",
    "k": "curvature",
    "t": "time",
    "n": "cycle",
    "d": "drawn",
    "l": "lag",
}
# Tents over the range of a variable. A cell that shows waves needs more, and they cost no simulation there;
# how it responds is felt at as many lags, each a sample longer.
TENTS, TENTS_OF_CELL, LAGS = 24, 72, 49
# Usual size of an unknown law: of a factor on friction, of what a cell adds as a share of the largest
# tension, of the moment as a share of that of the largest curvature (and of the stiffness at a place), of
# what drags along the whole channel as a share of the largest tension, strain of the tendon at the largest
# tension, what a cell shows beyond a change of the tension, as a share of it, and what the speed adds to the
# friction coefficient.
FRICTION, CELL, BENDING, DRAG, STRAIN, RESPONSE, VISCOUS = 0.5, 0.03, 0.4, 0.03, 2e-3, 0.3, 0.1
# Least size of a law of the stiffness at a place; one that leaves the body none is refused besides.
SOFTEST = -0.95
# Samples of a part up to which it is asked how a cell responds: the work grows with their square.
RESPONDS = 1000
# Largest share of the samples that may lie beyond the range of a variable that varies without end, the speed.
RARE = 0.05


@dataclasses.dataclass(frozen=True)
class LawPlace:
    """A hook and a variable.

    Attributes:
        acts: the hook, as `Law.acts`.
        of: the variable.
        low, high: range of the variable in the recordings [SI].
        size: usual size of the law, in `unit`.
        unit: of the size.
        ending: that tells its laws from those that the robot has already; "" where it has none.
    """

    acts: str
    of: str
    low: float
    high: float
    size: float
    unit: str
    ending: str = ""

    @property
    def name(self) -> str:
        """For people and for the names of terms."""
        return f"{self.acts.replace('_', '-')}-of-{WORDS[self.of]}{self.ending}"

    @property
    def span(self) -> float:
        """Width of the range."""
        return self.high - self.low

    @property
    def least(self) -> float:
        """Least value of the size."""
        if self.stiffness:
            return SOFTEST
        return 0.0 if ACTS[self.acts].one_sided else -np.inf

    @property
    def stiffness(self) -> bool:
        """Whether its laws are a factor on the stiffness of the body, less one."""
        return self.acts == "bending" and self.of == "s"

    @property
    def of_unit(self) -> str:
        """SI unit of the variable."""
        return VARIABLES[self.of].unit

    @property
    def tents(self) -> np.ndarray:
        """Middles of the tents, (n,)."""
        many = {"tip_cell": TENTS_OF_CELL, "tip_response": LAGS}
        return np.linspace(self.low, self.high, many.get(self.acts, TENTS))

    @property
    def argument(self) -> str:
        """The variable as a form has it: the size of a curvature, whose sign a bending law follows."""
        return "abs(k)" if self.of == "k" else self.of

    def law(self, name: str, form: str, numbers: tuple[Quantity, ...]) -> Law:
        """A law that adds a form to what is there without it.

        Args:
            name: of the law.
            form: an expression of `argument` that is zero without effect.
            numbers: its parameters.
        """
        whole = {
            "friction": f"1+{form}",
            "viscous": form,
            "drag": form,
            "strain": form,
            "bending": f"k*{form}" if self.stiffness else f"sign(k)*{form}",
            "tip_cell": f"T+{form}",
            "base_cell": f"T+{form}",
            "tip_response": form,
        }[self.acts]
        return Law(name, self.acts, whole, numbers)

    def tent(self) -> Law:
        """A law that is one tent, and nothing elsewhere."""
        form = f"size*max(0,1-abs({self.argument}-at)/width)"
        wide = float(self.tents[1] - self.tents[0])
        return self.law(
            f"{self.name}-tent",
            form,
            (
                self.quantity("size", self.unit, self.size, size=True),
                self.quantity("at", self.of_unit, self.low),
                self.quantity("width", self.of_unit, wide),
            ),
        )

    def quantity(self, name: str, unit: str, usual: float, *, size: bool = False) -> Quantity:
        """A parameter of a law."""
        far = max(abs(usual), 1e-12)
        return Quantity(
            name=name,
            unit=unit,
            null=0.0 if size else usual,
            typical=usual,
            says="",
            usual=(-far, far) if size else (0.0, far),
            size=size,
        )


def places(robot: Robot, likelihood: Likelihood, at: Point) -> list[LawPlace]:
    """The hooks and variables of which the recordings can tell something.

    Args:
        robot: on the likelihood's mesh, with the values of its file.
        likelihood: the recordings.
        at: a model of them, from which the ranges are taken.
    """
    known = {*friction_of(robot), *stiffness_of(robot)}
    values = {name.partition(OWN)[0]: v for name, v in at.values.items() if name.partition(OWN)[0] in known}
    top = max(float(rig.part.T_base.T_base.max()) for rig in likelihood.rigs)
    pulled = equilibrium(robot.with_values(**values), jnp.asarray(top))
    wrap, tension, s = (np.asarray(x) for x in (pulled.wrap, pulled.tension, pulled.s))
    there = np.diff(s) > 0
    pressure = (tension[1:] * np.diff(wrap))[there] / np.diff(s)[there]
    length = float(robot.backbone.length)
    found = [
        LawPlace("friction", "T", 0.0, top, FRICTION, "dimensionless"),
        LawPlace("friction", "p", 0.0, float(pressure.max()), FRICTION, "dimensionless"),
        LawPlace("friction", "s", 0.0, length, FRICTION, "dimensionless"),
        LawPlace("base_cell", "T", 0.0, top, CELL * top, "N"),
    ]
    at_tip = all(rig.part.tips for rig in likelihood.rigs)
    if at_tip:
        # A cell that reads too little ends below what is simulated.
        recorded = max(float(rig.part.T_tip.max()) for rig in likelihood.rigs)
        largest = max(recorded, largest_tip(likelihood, at.seen))
        found.append(LawPlace("tip_cell", "T", 0.0, largest, CELL * top, "N"))
    found.append(LawPlace("drag", "s", 0.0, length, DRAG * top / length, "N/m"))
    if any("displacement" in rig.part.channels for rig in likelihood.rigs):
        found.append(LawPlace("strain", "T", 0.0, top, STRAIN, "dimensionless"))
    if not robot.backbone.rigid:
        bend = float(np.max(np.abs(np.asarray(pulled.curvature))))
        found.append(LawPlace("bending", "k", 0.0, bend, BENDING * bend, "1/m"))
        found.append(LawPlace("bending", "s", 0.0, length, BENDING, "dimensionless"))
    drawn = max(float(np.nanmax(seen.values[CHANNELS.index("displacement")])) for seen in at.seen)
    if drawn > 0:
        found.append(LawPlace("friction", "d", 0.0, drawn, FRICTION, "dimensionless"))
    times = [rig.part.time for rig in likelihood.rigs if rig.part.time is not None]
    if len(times) == len(likelihood.rigs):
        end = max(float(np.ptp(time)) for time in times)
        found.append(LawPlace("friction", "t", 0.0, end, FRICTION, "dimensionless"))
        if at_tip:
            found.append(LawPlace("tip_cell", "t", 0.0, end, CELL * top, "N"))
        every = float(np.median(np.concatenate([np.diff(time) for time in times])))
        if every > 0 and at_tip and all(rig.part.samples <= RESPONDS for rig in likelihood.rigs):
            longest = (LAGS - 1) * every
            found.append(LawPlace("tip_response", "l", 0.0, longest, RESPONSE, "dimensionless"))
        fast = _fastest(times, at)
        if fast > 0:
            found.append(LawPlace("friction", "v", 0.0, fast, FRICTION, "dimensionless"))
            found.append(LawPlace("viscous", "v", 0.0, fast, VISCOUS, "dimensionless"))
    turns = max(int(cycles_of(rig.part.T_base.T_base)[-1]) for rig in likelihood.rigs)
    if turns >= 3:
        found.append(LawPlace("friction", "n", 0.0, float(turns), FRICTION, "dimensionless"))
    there = {place.name: sum(law.name.startswith(place.name) for law in robot.laws) for place in found}
    return [
        dataclasses.replace(place, ending=f"-{there[place.name] + 1}" if there[place.name] else "")
        for place in found
        if place.span > 0
    ]


def largest_tip(likelihood: Likelihood, seen: Sequence[SimulatedReadings]) -> float:
    """Largest tip tension that is simulated [N]."""
    return max(
        float(np.max(s.values[rig.where][: rig.part.tips]))
        for s, rig in zip(seen, likelihood.rigs, strict=True)
    )


def _fastest(times: Sequence[np.ndarray], at: Point) -> float:
    """Speed of the tendon's end that few samples exceed [m/s]."""
    speeds = []
    row = CHANNELS.index("displacement")
    for time, seen in zip(times, at.seen, strict=True):
        dt = np.diff(time)
        drawn = np.abs(np.diff(seen.values[row]))
        speeds.append(drawn[dt > 0] / dt[dt > 0])
    all_of_them = np.concatenate(speeds)
    return float(np.quantile(all_of_them, 1 - RARE)) if len(all_of_them) else 0.0
