"""The page: verdict, figures, tables, settings, in one HTML file that loads nothing."""

from __future__ import annotations

import base64
import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure as Drawing

from gtr_jax.plots.style import DOTS, png

FOLDER = Path(__file__).parent
STYLE = (FOLDER / "page.css").read_text(encoding="utf-8")
# Each says at its top what it draws; the later ones use the earlier.
SCRIPTS = ("shades.js", "frame.js", "chart.js", "plane.js", "turning.js", "playback.js")
SCRIPT = "\n".join((FOLDER / name).read_text(encoding="utf-8") for name in SCRIPTS)


@dataclass(frozen=True)
class Figure:
    """A picture with what it shows.

    Attributes:
        name: its file name without ending.
        drawn: the picture.
        caption: what it shows.
        dots: of its image, per inch.
    """

    name: str
    drawn: Drawing
    caption: str
    dots: int = DOTS

    @functools.cached_property
    def image(self) -> bytes:
        """The picture as PNG."""
        return png(self.drawn, self.dots)

    @property
    def source(self) -> str:
        """The picture as a data address."""
        return "data:image/png;base64," + base64.b64encode(self.image).decode()


@dataclass(frozen=True)
class Scene:
    """A body that the reader turns with the mouse; `turning.js` draws it and says what `data` holds."""

    data: Mapping[str, Any]
    caption: str

    @property
    def text(self) -> str:
        """The data as JSON that can stand in a page."""
        return _embedded(self.data)


@dataclass(frozen=True)
class Playback:
    """A load history that the reader goes through, with charts to zoom and the body at every step;
    `playback.js` says what `data` holds.

    Attributes:
        data: of the charts and the body.
        caption: what is seen.
        stills: names of the figures it stands in for; these stay for print and for pages without scripts.
        title: above it, where there are several.
    """

    data: Mapping[str, Any]
    caption: str
    stills: Sequence[str] = ()
    title: str = ""

    @property
    def text(self) -> str:
        """The data as JSON that can stand in a page."""
        return _embedded(self.data)


def _embedded(data: Mapping[str, Any]) -> str:
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


@dataclass(frozen=True)
class Table:
    """A table: a title, the column names (blank ones for none), and rows of text."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a page that answers for one of several inputs.

    Attributes:
        title: of the part.
        verdict, warnings, figures, tables: as of a report.
    """

    title: str
    verdict: str
    warnings: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = field(default_factory=tuple)


@dataclass(frozen=True)
class Report:
    """All that a page says.

    Attributes:
        title: of the page.
        verdict: one plain sentence; stands first.
        warnings: what the reader must know before using the numbers.
        figures, tables: in this order.
        sections: parts that follow, each with its own.
        scenes: bodies that can be turned; below the figures.
        playbacks: histories that can be gone through; above the figures.
    """

    title: str
    verdict: str
    warnings: Sequence[str] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = field(default_factory=tuple)
    sections: Sequence[Section] = ()
    scenes: Sequence[Scene] = ()
    playbacks: Sequence[Playback] = ()

    @property
    def stills(self) -> set[str]:
        """Names of the figures that playbacks stand in for."""
        return {name for playback in self.playbacks for name in playback.stills}

    @property
    def all_figures(self) -> list[Figure]:
        """The figures of the report and of its sections."""
        return [*self.figures, *(figure for section in self.sections for figure in section.figures)]


@dataclass(frozen=True)
class Link:
    """A report that an index names: its title, where it lies, what it shows and what it answered."""

    title: str
    href: str
    shows: str
    verdict: str
    pictures: Sequence[tuple[str, str]] = ()


def render_index(title: str, says: str, links: Sequence[Link]) -> str:
    """A page that links several reports, as HTML; pictures lie beside it.

    Args:
        title: of the page.
        says: what they are, in a sentence or two.
        links: to the reports, in the order to read them.
    """
    return (
        environment()
        .get_template("index.html.jinja")
        .render(title=title, says=says, links=links, style=STYLE)
    )


def render(report: Report, settings: Mapping[str, Any], robot_file: str | None) -> str:
    """The page as HTML.

    Args:
        report: what it says.
        settings: command, versions, device and hashes of the inputs, as in `run.json`.
        robot_file: the resolved robot file; None where no robot is read.
    """
    template = environment().get_template("page.html.jinja")
    script = SCRIPT if report.scenes or report.playbacks else ""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return template.render(
        report=report, settings=settings, robot_file=robot_file, style=STYLE, script=script, digest=digest
    )


def environment() -> Any:
    """Jinja, for the templates in this folder."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
