"""What the pages of the real robots share: models that are fitted one after the other, and their tables."""

from __future__ import annotations

import os
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from calibrate.diagnosis.answer.change import Change
from calibrate.diagnosis.answer.sentence import interval_in_words
from calibrate.inference.estimate import Estimate
from gtr_jax.atomic_write import write_atomically
from gtr_jax.numbers import measured_quantity

HERE = Path(__file__).parent
DOCS = HERE.parents[1] / "docs" / "robots"
# Pictures that show recordings without a licence: never in the repository.
OUT = HERE.parents[1] / "out-robots"
WIDTH = 150  # characters of a line of prose
MARKER = re.compile(r"(?:- |\d+\. |> )")
# What would begin a list, a heading or a quotation at the beginning of a line.
BEGINS = re.compile(r" (?=(?:[-+*>]|#+|\d+[.)])(?: |$))")
# Recordings without a licence lie outside the repository.
SHARED = Path(os.environ.get("GTR_SHARED_DATA", HERE.parents[2] / "shared" / "data"))


def elsewhere(*names: str) -> Path:
    """A recording that does not ship; ends the program where it is not there."""
    path = SHARED.joinpath(*names)
    if not path.exists():
        sys.exit(
            f"{path} is not there: it has no licence and does not ship; set GTR_SHARED_DATA to its folder"
        )
    return path


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def interval(found: Estimate | Change) -> str:
    """The 95 % interval of a number; "" without one."""
    if found.lower95 is None or found.upper95 is None:
        return ""
    return " to ".join(interval_in_words((found.lower95, found.upper95), found.unit))


def numbers(estimates: Sequence[Estimate]) -> str:
    """The fitted numbers of a robot, with their intervals."""
    rows = [
        [f"`{e.name}`", measured_quantity(e.value, e.sd, e.unit), interval(e) or e.note] for e in estimates
    ]
    return table(["number", "fitted", "95 % interval"], rows)


def say(text: str) -> None:
    """Progress, at once."""
    print(text, flush=True)


def page(name: str) -> str:
    """The text of a page, with gaps for its numbers."""
    return (HERE / name / "page.md").read_text(encoding="utf-8")


def save(picture: Figure, name: str, *, shows_recording: bool = False) -> None:
    """A picture: into the docs, or, if it shows a recording that does not ship, into `OUT`."""
    folder = OUT if shows_recording else DOCS
    folder.mkdir(exist_ok=True)
    picture.savefig(folder / f"{name}.png", dpi=150, bbox_inches="tight")
    say(f"  {folder / name}.png")


def insist(conclusions: Mapping[str, bool]) -> None:
    """Ends the program where what the text of a page concludes does not hold of the numbers."""
    wrong = [said for said, holds in conclusions.items() if not holds]
    if wrong:
        sys.exit("the page says what these numbers do not: " + "; ".join(wrong))


def wrapped(text: str) -> str:
    """A page with its prose in lines of `WIDTH`: paragraphs, items of lists and quotations; tables, headings
    and pictures as they are.
    """
    return "\n\n".join(_block(block) for block in text.rstrip("\n").split("\n\n")) + "\n"


def _block(block: str) -> str:
    if block.lstrip("\n").startswith(("|", "#", "![", "```")):
        return block
    items: list[list[str]] = []
    for line in block.split("\n"):
        if not items or (MARKER.match(line) and not (line.startswith("> ") and items[-1][0] == "> ")):
            marker = MARKER.match(line)
            items.append([marker.group() if marker else "", line[marker.end() if marker else 0 :].strip()])
        else:
            items[-1].append(line.removeprefix("> ").strip())
    return "\n".join(_filled(marker, " ".join(lines)) for marker, *lines in items)


def _filled(marker: str, text: str) -> str:
    lines = textwrap.wrap(
        BEGINS.sub("\0", text), WIDTH - len(marker), break_long_words=False, break_on_hyphens=False
    )
    hanging = marker if marker == "> " else " " * len(marker)
    return "\n".join((hanging if i else marker) + line.replace("\0", " ") for i, line in enumerate(lines))


def write(name: str, text: str) -> None:
    """A page of the docs."""
    DOCS.mkdir(exist_ok=True)
    write_atomically(DOCS / f"{name}.md", wrapped(text))
