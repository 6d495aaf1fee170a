"""Laws as robot files state them, for tests."""

from gtr_jax.terms.law import ACTS
from gtr_jax.terms.term import Quantity

# Each beside the term of the catalogue that it restates: numbers of the term, and the table of the law.
RESTATED = {
    "adhesion": ({"drag": 2.0}, {"acts": "drag", "law": "size", "size": "2 N/m"}),
    "viscous-friction": (
        {"coefficient": 20.0},
        {"acts": "viscous", "law": "size * v", "size": "20 s/m"},
    ),
    "stribeck-friction": (
        {"ratio": 0.2, "speed": 1e-3},
        {
            "acts": "friction",
            "law": "1 + size * exp(-(v / speed)^2)",
            "size": 0.2,
            "speed": "1 mm/s",
        },
    ),
    "pressure-dependent-friction": (
        {"exponent": 0.9, "reference": 100.0},
        {
            "acts": "friction",
            "law": "max(p / reference, 1e-6)^size",
            "size": -0.1,
            "reference": "100 N/m",
        },
    ),
    "wear": ({"rate": 0.1}, {"acts": "friction", "law": "1 + size * n", "size": 0.1}),
    "friction-drift": ({"rate": 0.01}, {"acts": "friction", "law": "1 + size * t", "size": "0.01 1/s"}),
    "stiffening": ({"coefficient": 0.02}, {"acts": "bending", "law": "size * k^3", "size": "0.02 m^2"}),
    "tendon-stretch": ({"compliance": 5e-4}, {"acts": "strain", "law": "size * T", "size": "5e-4 1/N"}),
    "tip-gain": ({"gain": 1.08}, {"acts": "tip_cell", "law": "T * (1 + size)", "size": 0.08}),
    "base-gain": ({"gain": 1.08}, {"acts": "base_cell", "law": "T * (1 + size)", "size": 0.08}),
    "zero-drift": ({"tip": 0.01}, {"acts": "tip_cell", "law": "T + size * t", "size": "0.01 N/s"}),
}


def table(**keys):
    """A law's table in a robot file."""
    return {"kind": "law", **keys}


def numbers(acts, **given):
    """Parameters of a law, each from its unit or from (unit, usual range); `size` is the size."""
    found = []
    for name, said in given.items():
        unit, usual = (said, (0.5, 2.0)) if isinstance(said, str) else said
        null = 0.0 if name == "size" else 1.0
        found.append(Quantity(name, unit, null, 1.0, "", usual, size=name == "size"))
    assert acts in ACTS
    return tuple(found)
