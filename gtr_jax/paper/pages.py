"""The reproduction written down: as a page that loads nothing, as Markdown for the docs, as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gtr_jax.report.page import STYLE

from .study import Study

FOLDER = Path(__file__).parent
TITLE = "Liu & Alambeigi (RA-L 2022), reproduced"
PAPER = (
    "Y. Liu, F. Alambeigi: friction along generically routed tendons of continuum manipulators with planar "
    "deformation. IEEE Robotics and Automation Letters, 2022."
)


def verdict(parts: Sequence[Study]) -> str:
    """The outcome in one sentence."""
    found = [statement.agrees for part in parts for statement in part.statements]
    solved, wanted = (sum(part.solved[i] for part in parts) for i in (0, 1))
    return (
        f"Of {len(found)} statements {found.count(True)} hold, {found.count(False)} do not, and "
        f"{found.count(None)} cannot be tested; {solved} of {wanted} equilibria, load steps and fits "
        "converged."
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


def _cell(text: str) -> str:
    """Text in a Markdown table or paragraph: what Markdown or HTML would read as markup is kept from it."""
    for mark in "\\|_*<`":
        text = text.replace(mark, f"\\{mark}")
    return text


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
    environment.filters["cell"] = _cell
    return environment.get_template(template).render(
        title=TITLE,
        paper=PAPER,
        verdict=verdict(parts),
        parts=parts,
        answer={True: "yes", False: "no", None: "–"},
        **given,
    )
