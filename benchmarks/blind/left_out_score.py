"""Scoring of the cases whose cause is left out of the catalogue, and their section of the page."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from .exam import keys as keys_of
from .left_out import ALSO, PLACES
from .score import quantiles, rate, seconds, table, taken

NOT_YET = """## One term left out

These cases have not been scored yet; `python -m benchmarks.blind --family left-out` does it.
"""
# Verdicts that say that effects of the catalogue explain the recording.
EXPLAINED = ("missing-physics", "ambiguous")


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """One case: its key and the answer."""

    name: str
    key: dict[str, Any]
    answer: dict[str, Any]

    @property
    def effect(self) -> str:
        """The one that is hidden."""
        return self.key["hidden"][0]

    @property
    def verdict(self) -> str:
        """Of the diagnosis."""
        return self.answer["verdict"]

    @property
    def law(self) -> dict[str, Any] | None:
        """The law that it found."""
        return self.answer.get("law")

    @property
    def told(self) -> list[str]:
        """Hooks and variables that are told, the one that is shown first."""
        law = self.law
        return [] if law is None else [f"{law['acts']} of {law['of']}", *law["possible"]]

    @property
    def right(self) -> bool:
        """The cause's hook and variable is told, alone or as one of two."""
        return len(self.told) <= 2 and not self._causes.isdisjoint(self.told)

    @property
    def first(self) -> bool:
        """The law that is shown has the cause's hook and variable."""
        return not self._causes.isdisjoint(self.told[:1])

    @property
    def _causes(self) -> set[str]:
        """Hooks and variables that are right."""
        return {" of ".join(place) for place in (PLACES[self.effect], *ALSO.get(self.effect, ()))}

    @property
    def gain(self) -> float | None:
        """Share of the misfit beyond the noise that what is shown takes on unseen samples."""
        return taken(self.answer, self.key) if self.answer.get("held_out") else None


def read(folder: Path) -> list[LeftOut]:
    """All cases that have an answer."""
    found = []
    for name, key in keys_of(folder).items():
        answer = folder / "answers" / f"{name}.json"
        if answer.exists():
            found.append(LeftOut(name, key, json.loads(answer.read_text(encoding="utf-8"))))
    return found


def overview(cases: Sequence[LeftOut]) -> list[list[str]]:
    """Rows of the main table: what, target, reached."""
    shows = [c for c in cases if c.verdict != "adequate"]
    asked = [c for c in shows if c.verdict not in EXPLAINED]
    laws = [c for c in cases if c.law]
    gains = [c.gain for c in laws if c.gain is not None]
    anyhow = [c.gain for c in shows if c.gain is not None]
    return [
        ["shows in the recording at all", "", rate([c in shows for c in cases])],
        [
            "of these: right hook and variable, or a set of two with it",
            "≥ 70 %",
            rate([c.right for c in shows]),
        ],
        [
            "another effect of the catalogue explains it as well",
            "",
            rate([c.verdict in EXPLAINED for c in shows]),
        ],
        [
            "right hook and variable, where no effect of the catalogue explains it",
            "",
            rate([c.right for c in asked]),
        ],
        ["a law of something else is told instead", "", rate([not c.right for c in laws])],
        [
            "share of what there is to gain on unseen samples, of the laws (median; 90 % above)",
            "≥ 85 %",
            "–" if not gains else f"{np.median(gains):.0%}; {np.quantile(gains, 0.1):.0%}",
        ],
        ["the same, of all that shows (median)", "", quantiles(anyhow, "{:.0%}")],
        ["time of an answer [s] (median; 90 % below)", "≤ 60", quantiles(seconds(cases), "{:.0f}; {:.0f}")],
    ]


def by_effect(cases: Sequence[LeftOut]) -> list[list[str]]:
    """Rows by what is hidden."""
    rows = []
    for effect in sorted({c.effect for c in cases}):
        of = [c for c in cases if c.effect == effect]
        gains = [c.gain for c in of if c.law and c.gain is not None]
        others = sorted({t for c in of if c.law and not c.right for t in c.told[:1]})
        rows.append(
            [
                effect,
                of[0].key["terms"][0],
                " of ".join(PLACES[effect]),
                str(len(of)),
                str(sum(c.first for c in of)),
                str(sum(c.right and not c.first for c in of)),
                ", ".join(others) or "–",
                str(sum(c.verdict in EXPLAINED for c in of)),
                str(sum(c.verdict in ("unexplained", "partly-explained") for c in of)),
                str(sum(c.verdict == "adequate" for c in of)),
                quantiles(gains, "{:.0%}"),
            ]
        )
    return rows


def rows_csv(cases: Sequence[LeftOut]) -> str:
    """One line per case, for those who want to look."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        ["case", "hidden", "robot", "protocol", "verdict", "sets", "laws", "formula", "gain", "seconds"]
    )
    for c in sorted(cases, key=lambda c: (c.effect, c.name)):
        row = [c.name, c.effect, c.key["robot"], c.key["protocol"], c.verdict]
        row += [" or ".join(" + ".join(s) for s in c.answer.get("sets", [])), " or ".join(c.told)]
        row += [c.law["formula"] if c.law else "", "" if c.gain is None else f"{c.gain:.3f}"]
        writer.writerow([*row, f"{c.answer.get('seconds', float('nan')):.1f}"])
    return out.getvalue()


def write(cases: Sequence[LeftOut], folder: Path, seeds: str, drawn: int) -> None:
    """The section, `left-out.md`, into a folder, and a line per case into `proof` in it."""
    (folder / "proof").mkdir(parents=True, exist_ok=True)
    (folder / "proof" / "left-out-cases.csv").write_text(rows_csv(cases), encoding="utf-8")
    template = Template(Path(__file__).with_name("left_out.md").read_text(encoding="utf-8"))
    head = [
        "hidden",
        "term left out",
        "cause",
        "cases",
        "found",
        "one of two",
        "another law",
        "another effect",
    ]
    head += ["left", "adequate", "gain of the laws (median)"]
    text = template.substitute(
        cases=len(cases),
        drawn=drawn,
        seeds=seeds,
        tools=", ".join(sorted({c.answer["tool"] for c in cases})),
        effects=len({c.effect for c in cases}),
        crashed=sum(c.verdict == "crashed" for c in cases),
        overview=table(["what", "target", "reached"], overview(cases)),
        by_effect=table(head, by_effect(cases)),
    )
    (folder / "left-out.md").write_text(text, encoding="utf-8")
