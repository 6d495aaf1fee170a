"""The reproduction written down: as a page that loads nothing, as Markdown for the docs, as JSON."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gtr_jax.report.page import STYLE

from .study import FITTED, Study

FOLDER = Path(__file__).parent
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+")
TITLE = "Liu & Alambeigi (RA-L 2022), reproduced"
PAPER = (
    'Y. Liu and F. Alambeigi, "Impact of Generic Tendon Routing on Tension Loss of Tendon-Driven Continuum '
    'Manipulators with Planar Deformation", IEEE Robotics and Automation Letters 7(2), 3624–3631, 2022.'
    " We had its text, not its figures: what is called published or stated here is so in the text."
)


def verdict(parts: Sequence[Study]) -> str:
    """The outcome in one sentence."""
    every = [statement for part in parts for statement in part.statements]
    paper, ours = ([s.agrees for s in every if s.beyond is own] for own in (False, True))
    solved, wanted = (sum(part.solved[i] for part in parts) for i in (0, 1))
    return (
        f"Statements of the paper: {paper.count(True)} hold, {paper.count(FITTED)} were fitted to, "
        f"{paper.count(False)} wrong, {paper.count(None)} not tested here. Beyond it: {ours.count(True)} of "
        f"{len(ours)} hold. {solved} of {wanted} solutions that the numbers rest on converged."
    )


def converged(parts: Sequence[Study]) -> bool:
    """Whether everything that the numbers rest on did."""
    return all(part.solved[0] == part.solved[1] for part in parts)


def facts(parts: Sequence[Study]) -> dict[str, Any]:
    """Every number, and every statement, by part."""
    return {
        "schema": 1,
        "paper": PAPER,
        "verdict": verdict(parts),
        "converged": converged(parts),
        "parts": {
            part.title: {
                "converged": list(part.solved),
                "statements": [vars(statement) for statement in part.statements],
                "facts": part.facts,
            }
            for part in parts
        },
    }


def html(parts: Sequence[Study], settings: Mapping[str, Any]) -> str:
    """One self-contained page."""
    return _render("page.html.jinja", parts, settings=settings, style=STYLE)


def markdown(parts: Sequence[Study], figures: str) -> str:
    """The same for the docs.

    Args:
        parts: the studies.
        figures: where their pictures lie, relative to the page.
    """
    return _render("page.md.jinja", parts, figures=figures)


def _typeset(text: str) -> str:
    """Minus signs and powers of ten as print has them."""
    text = re.sub(r"\b0e\+00\b", "0", text)
    text = re.sub(r"(?<=\d)e([+-]?)0*(\d+)\b", lambda m: "·10" + (m[1] + m[2]).translate(RAISED), text)
    return re.sub(r"(?<![\w.\-])-(?=\d)", "−", text)


def _cell(text: str) -> str:
    """Text in a Markdown table or paragraph: what Markdown or HTML would read as markup is kept from it."""
    return re.sub(r"([\\|_*<`\[\]])", r"\\\1", _typeset(text))


def _render(template: str, parts: Sequence[Study], **given: Any) -> str:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER),
        autoescape=template.endswith(".html.jinja"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"cell": _cell, "typeset": _typeset}
    return environment.get_template(template).render(
        title=TITLE,
        paper=PAPER,
        verdict=verdict(parts),
        parts=parts,
        answer={True: "yes", False: "no", FITTED: FITTED, None: "–"},
        **given,
    )
