"""What there is to say of the physics terms at the command line."""

from __future__ import annotations

import textwrap

from gtr_jax.terms import REGISTRY, Quantity, Term
from gtr_jax.units import display_of, quantity_text

WIDTH = 100
GROUPS = {
    "Friction and tendon": lambda term: not (_of_cells(term) or _of_body(term) or _of_loads(term)),
    "Body": lambda term: _of_body(term),
    "Loads": lambda term: _of_loads(term),
    "Load cells": lambda term: _of_cells(term),
}


EXAMPLE_OF_A_LAW = (
    "[[terms]]",
    'kind = "law"',
    'name = "seal"',
    'acts = "drag"',
    'law = "size * exp(-p / fade)"',
    'size = "2 N/m"',
    'fade = "100 N/m"',
    'usual.size = ["0.2 N/m", "10 N/m"]',
)


def _of_cells(term: Term) -> bool:
    return term.of_cells and term.ahead is None


def _of_body(term: Term) -> bool:
    return term.bend is not None


def _of_loads(term: Term) -> bool:
    return term.loads is not None or term.stop is not None


def value_text(value: float, unit: str) -> str:
    """A number of a term as people write it."""
    if unit == "dimensionless":
        return f"{value:.4g}"
    display, size = display_of(unit)
    return f"{value / size:.4g} {display}"


def usual_range(q: Quantity) -> str:
    """The usual values of a number of a term, as people write them."""
    low, high = (value_text(v, q.unit) for v in q.usual)
    return f"{low} to {high}"


def overview() -> str:
    """All terms, one line of law and one of numbers each."""
    lines = []
    for group, belongs in GROUPS.items():
        lines += ["", group.upper()]
        for term in REGISTRY.values():
            if belongs(term):
                numbers = ", ".join(
                    f"{q.name} (typically {value_text(float(q.typical), q.unit)})" for q in term.quantities
                )
                lines += wrapped(f"{term.id}: ", term.says, "  ")
                lines += wrapped("", term.law, "      ") + wrapped("", numbers, "      ")
    lines += [
        "",
        "YOUR OWN",
        *wrapped("law: ", "Physics of your own, as an expression in the robot file.", "  "),
    ]
    return "\n".join(lines[1:]) + "\n\n`gtr terms KIND` says more of one, and what to write in a robot file."


def wrapped(label: str, text: str, indent: str) -> list[str]:
    """A text in lines, with a label before it."""
    return textwrap.wrap(label + text, WIDTH, initial_indent=indent, subsequent_indent=indent + "    ")


def said_of(term: Term) -> list[str]:
    """What a term is, in lines, up to its numbers."""
    rows = [f"{term.id}: {term.says}", ""]
    for label, text in (("law", term.law), ("seen", term.seen), ("told apart", term.told_apart)):
        rows += wrapped(f"{label}: ", text, "")
    if term.source:
        rows += wrapped("source: ", term.source, "")
    if term.note:
        rows += wrapped("note: ", term.note, "")
    return [*rows, "", "numbers:"]


def description(term: Term) -> str:
    """All that a term's file says, and how to write it in a robot file."""
    rows = said_of(term)
    for q in term.numbers:
        null = "does nothing at" if q.size else "unless given"
        where = "In space only. " if q in term.across else ""
        said = f"{where}{q.says} {null} {value_text(float(q.null), q.unit)}; usually {usual_range(q)}"
        rows += wrapped(f"{q.name}: ", said, "  ")
    return "\n".join([*rows, "", "in a robot file:", "", *example(term)])


def example(term: Term) -> list[str]:
    """The table of a robot file."""
    lines = ["[[terms]]", f'kind = "{term.id}"']
    for q in term.quantities:
        text = quantity_text(float(q.typical), q.unit)
        lines.append(f"{q.name} = " + (f'"{text}"' if isinstance(text, str) else f"{text:g}"))
    return lines
