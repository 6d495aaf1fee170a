"""A law that was found, as a formula, a curve with its band, and a part of a robot file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from calibrate.diagnosis.evidence.marginal import Marginal
from gtr_jax import RobotConfig
from gtr_jax.config.config import parse_config
from gtr_jax.terms import Law
from gtr_jax.terms.expression import evaluate
from gtr_jax.terms.law import VARIABLES
from gtr_jax.units import quantity_text

from .discovery import Discovery

# Points of a curve, and draws of the numbers for its band.
POINTS, DRAWS = 201, 400


class Words(NamedTuple):
    """A hook in words: what a law there is called, what it changes, and what its expression gives if that is
    another.
    """

    called: str
    changes: str
    gives: str = ""


HOOKS = {
    "friction": Words("friction", "factor on the friction coefficient"),
    "viscous": Words("viscous friction", "addition to the friction coefficient"),
    "drag": Words("drag", "force per length that opposes slip"),
    "strain": Words("strain", "strain of the tendon"),
    "bending": Words("bending", "addition to the bending moment over EI"),
    "tip_cell": Words(
        "an error of the tip's cell", "what the cell at the tip adds", "the cell at the tip shows"
    ),
    "base_cell": Words(
        "an error of the base's cell", "what the cell at the base adds", "the cell at the base shows"
    ),
    "tip_response": Words(
        "a response of the tip's cell",
        "what the cell at the tip shows beyond a step of the tension, as a share of it",
    ),
}
STIFFENS = "share that is added to the bending stiffness there"


@dataclasses.dataclass(frozen=True, eq=False)
class FoundLaw:
    """A law that was found.

    Attributes:
        law: the law.
        acts, of: hook and variable.
        changes, gives: what it changes, for people, and what its expression gives.
        unit, of_unit: SI units of that and of the variable.
        formula: the expression.
        values: of its parameters, SI.
        smooth: whether it is a smooth curve of unknown form.
        takes: share of the misfit beyond the noise that it takes on unseen samples.
        pieces: whether the unseen samples are short pieces that alternate with those fitted; see
            `held_out.folds`.
        x, y, lower, upper: the curve over the range that the recordings cover, with its 95 % band, (P,).
        possible: other hooks and variables that the recordings do not rule out.
    """

    law: Law
    acts: str
    of: str
    changes: str
    gives: str
    unit: str
    of_unit: str
    formula: str
    values: Mapping[str, float]
    smooth: bool
    takes: float
    pieces: bool
    x: np.ndarray
    y: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    possible: list[str]

    def to_json(self) -> dict[str, Any]:
        """For `diagnosis.json`."""
        return {
            "acts": self.acts,
            "of": self.of,
            "formula": self.formula,
            "parameters": {q.name: {"value": self.values[q.name], "unit": q.unit} for q in self.law.numbers},
            "smooth": self.smooth,
            "takes": self.takes,
            "held_out_in_pieces": self.pieces,
            "possible_instead": self.possible,
            "curve": {
                "of": {"unit": self.of_unit, "values": self.x},
                "value": {"unit": self.unit, "values": self.y},
                "lower95": self.lower,
                "upper95": self.upper,
            },
        }


def found_law(discovery: Discovery, after: Marginal) -> FoundLaw:
    """The law with its curve, from the fit in which all that is uncertain is free."""
    law, place = discovery.law, discovery.place
    words = HOOKS[place.acts]
    values = {q.name: after.fitted.values[f"{law.name}.{q.name}"] for q in law.numbers}
    x = np.linspace(place.low, place.high, POINTS)
    numbers = after.fitted.numbers
    rng = np.random.default_rng(0)
    drawn = []
    for at in after.draws(DRAWS, rng):
        own = {n.name: n.value(v) for n, v in zip(numbers, at, strict=True)}
        drawn.append(_curve(law, {q: own.get(f"{law.name}.{q}", v) for q, v in values.items()}, place.of, x))
    lower, upper = np.quantile(drawn, [0.025, 0.975], axis=0)
    return FoundLaw(
        law=law,
        acts=place.acts,
        of=place.of,
        changes=STIFFENS if place.stiffness else words.changes,
        gives=words.gives or words.changes,
        unit=place.unit if place.stiffness else law.place.unit,
        of_unit=place.of_unit,
        formula=law.text,
        values=values,
        smooth=discovery.form is None,
        takes=discovery.takes,
        pieces=discovery.pieces,
        x=x,
        y=_curve(law, values, place.of, x),
        lower=lower,
        upper=upper,
        possible=[f"{other.acts} of {other.of}" for other in discovery.possible_places],
    )


def _curve(law: Law, values: Mapping[str, float], of: str, x: np.ndarray) -> np.ndarray:
    """The law over its variable; of a cell, what it adds; of the place, at a curvature of 1/m."""
    at = {name: np.zeros_like(x) for name in VARIABLES} | {"k": np.ones_like(x), of: x}
    found = np.broadcast_to(evaluate(law.tree, {**at, **values}, np), x.shape)
    return found - at["T"] if law.place.neutral == "T" else np.asarray(found)


def with_law(config: RobotConfig, law: Law, values: Mapping[str, float]) -> RobotConfig:
    """A robot file that has the law too.

    Args:
        config: the file.
        law: the law.
        values: of its parameters, SI, by name.

    Raises:
        InputError: these values do not make a law.
    """
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    text = {q.name: quantity_text(float(values[q.name]), q.unit) for q in law.numbers}
    # The prior of whoever diagnoses with the file: about these values.
    usual = {
        q.name: [
            quantity_text(end, q.unit)
            for end in _about(float(values[q.name]), q.usual, not _is_signed(q.name))
        ]
        for q in law.numbers
    }
    section = {"kind": "law", "name": law.name, "acts": law.acts, "law": law.text, **text, "usual": usual}
    # A phase and the parts of a smooth curve may be negative; a scale may not.
    signed = [q.name for q in law.numbers if _is_signed(q.name)]
    if signed:
        section["bounds"] = {name: [-math.inf, math.inf] for name in signed}
    data.setdefault("terms", []).append(section)
    return parse_config(data, source=config.source)


def _is_signed(name: str) -> bool:
    """Whether a number of a law that is found may be negative besides its size."""
    return name == "phase" or (name[0] == "c" and name[1:].isdigit())


def _about(value: float, usual: tuple[float, float], scale: bool) -> tuple[float, float]:
    """A range about a value: a factor of five for a scale, else as wide as is usual to each side."""
    if value > 0 and usual[0] >= 0 and scale:
        return value / 5, value * 5
    far = max(abs(value), 0.5 * (usual[1] - usual[0]))
    return value - far, value + far
