"""What a notebook shows of an object: its sentence, a picture and a table, in HTML that loads nothing."""

from __future__ import annotations

from .page import Report, environment


def card(report: Report) -> str:
    """A report as a part of a page, without its settings."""
    return environment().get_template("card.html.jinja").render(report=report)
