"""Scoring of the cases that are made as rigs make recordings: sets of effects, events, glitches, delays."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .effects import CATALOGUE
from .exam import keys as keys_of
from .rig import TWINS, term
from .score import CAUSES, quantiles, rate, within

# Probability from which on a term that is named counts as sure.
SURE = 0.9
# How far in time an episode may lie from the event that it shows [s].
NEAR = 0.25
TWIN = "gain of a cell, or friction that differs between pull and release"
# Key under which a case holds the truth of a number.
TRUTH = {"mu": "mu", "time-skew.delay": "delay_s"}
NAMING = ("missing-physics", "partly-explained", "ambiguous")


@dataclasses.dataclass(frozen=True)
class Rig:
    """One case: its key and the answer."""

    name: str
    key: dict[str, Any]
    answer: dict[str, Any]

    def merged(self, terms: Iterable[str]) -> set[str]:
        """Terms, those that are one by algebra in these recordings as one."""
        sheathed = self.key["robot"] == "sheath"
        return {TWIN if sheathed and t in TWINS else t for t in terms}

    @property
    def verdict(self) -> str:
        """Of the diagnosis."""
        return self.answer["verdict"]

    @property
    def answered(self) -> bool:
        """Whether there is a diagnosis: the file was read, and nothing crashed."""
        return self.verdict not in ("refused", "crashed", "bad-data")

    @property
    def truth(self) -> set[str]:
        """Terms of the catalogue that are missing."""
        return self.merged(self.key["terms"])

    @property
    def neutral(self) -> set[str]:
        """Terms that the instruments or the tendon always bring: neither asked for nor wrong."""
        return self.merged(self.key["always"]) - self.truth

    @property
    def named(self) -> set[str]:
        """Terms that are named, of a set of rivals the most probable; those always there left out."""
        if self.verdict not in NAMING:
            return set()
        sets = self.answer.get("sets", [])
        return self.merged(self.answer.get("named") or (sets[0] if sets else [])) - self.neutral

    @property
    def claims(self) -> bool:
        """Whether it says that an effect is missing, or that something is left that it cannot explain, or
        finds a law.
        """
        return bool(self.named) or self.verdict in ("partly-explained", "unexplained", "discovered")

    @property
    def strange_told(self) -> bool:
        """Of a case with an effect outside the catalogue: whether it says that something is left, or finds
        its law.
        """
        law = self.answer.get("law") or {}
        causes = [CAUSES[hidden] for hidden in self.key["outside"] if hidden in CAUSES]
        right = self.verdict == "discovered" and (law.get("acts"), law.get("of")) in causes
        return right or self.verdict in ("partly-explained", "unexplained")

    @property
    def exact(self) -> bool:
        """Every effect is named and nothing else."""
        return not self.key["outside"] and self.named == self.truth

    @property
    def partly_right(self) -> bool:
        """Of a verdict partly-explained: all that is named is there, and something is left that is not."""
        more = self.truth - self.named or self.key["outside"] or self.key["events"]
        return self.named <= self.truth and bool(more)

    def probability(self, term: str) -> float:
        """That a term that is named acts: of all models that hold it."""
        models = self.answer.get("models", [])
        if not models:
            return float(self.answer.get("named_probability", 0.0))
        return min(sum(m["probability"] for m in models if term in self.merged(m["terms"])), 1.0)

    @property
    def sure(self) -> set[str]:
        """Terms that are named with a probability above `SURE`."""
        return {t for t in self.named if self.probability(t) > SURE}

    @property
    def wrong(self) -> bool:
        """Confidently wrong: a term is named with a probability above `SURE` and is not there."""
        return bool(self.sure - self.truth)

    @property
    def explained(self) -> float | None:
        """Share of the misfit on held-out cycles, noise of the tip's cell aside, that the answer explains."""
        held = self.answer.get("held_out")
        if not held:
            return None
        noise = self.key["noise_N"]["T_tip"]
        before, after = (max(held[k]["rms_N"] ** 2 - noise**2, 0.0) for k in (0, -1))
        return 1 - after / before if before > 0 else None

    def spans(self) -> list[tuple[float, float]]:
        """Start and end [s] of what is said to happen once: episodes, what is left out, shaking as a term."""
        said = [*self.answer.get("episodes", []), *self.answer.get("left_out", [])]
        found = [(e["start_s"], e["end_s"]) for e in said]
        numbers = self.answer.get("parameters", {})
        if "shaken-sheath.time" in numbers and self.verdict in NAMING:
            start, lasts = (numbers[f"shaken-sheath.{name}"][1] for name in ("time", "duration"))
            found.append((start, start + lasts))
        return found

    def found(self) -> list[bool]:
        """Of each event, whether it says that something happened at its time."""
        return [
            any(start <= e["end_s"] + NEAR and end >= e["start_s"] - NEAR for start, end in self.spans())
            for e in self.key["events"]
        ]

    def excluded(self) -> float:
        """Share of the recording that what it says happened covers."""
        length = self.key["seconds"]
        covered = np.zeros(1000, bool)
        at = length * (np.arange(1000) + 0.5) / 1000
        for start, end in self.spans():
            covered |= (at >= start) & (at <= end)
        return float(covered.mean())

    def masked(self) -> set[tuple[str, int]]:
        """Readings that the answer leaves out as glitches and dropouts."""
        said = self.answer.get("masked", [])
        return {(m["channel"], row) for m in said for row in range(m["first"], m["last"] + 1)}

    def rows_left_out(self) -> set[int]:
        """Rows that the answer leaves out, of whichever cell it says so: both go."""
        return {row for _, row in self.masked()}

    def spoilt(self) -> set[tuple[str, int]]:
        """Readings that are glitches and dropouts."""
        cells = self.key["spoilt"]
        return {(cell, row) for cell, kinds in cells.items() for rows in kinds.values() for row in rows}

    def delay(self) -> float | None:
        """Error of the delay between the cells [s]; None where none is told."""
        _, value, _ = self.answer.get("parameters", {}).get("time-skew.delay", (None, None, None))
        return None if value is None else value - self.key["delay_s"]

    def holds(self, of: str, which: int) -> bool | None:
        """Whether the 95 % interval of `mu` or `time-skew.delay` holds the truth: under the model shown (0),
        or averaged over models (1); None where there is none.
        """
        return within(self.answer, self.key, which, of, TRUTH[of])


def read(folder: Path) -> list[Rig]:
    """All cases that have an answer."""
    found = []
    for name, key in keys_of(folder).items():
        answer = folder / "answers" / f"{name}.json"
        if answer.exists():
            found.append(Rig(name, key, json.loads(answer.read_text(encoding="utf-8"))))
    return found


def _pooled(cases: Sequence[Rig], of: str) -> list[bool]:
    """Of each term that is named, whether it is there; or of each that is there, whether it is named."""
    pairs = [(getattr(c, of), c.truth if of != "truth" else c.named) for c in cases]
    return [one in other for terms, other in pairs for one in terms]


def overview(cases: Sequence[Rig]) -> list[list[str]]:
    """Rows of the table: what, target, reached."""
    sound = [c for c in cases if c.key["kind"] == "sound"]
    rigs = [c for c in cases if c.key["kind"] == "rig"]
    partly = [c for c in rigs if c.verdict == "partly-explained"]
    strange = [c for c in rigs if c.key["outside"]]
    shares = [-c.explained for c in rigs if c.explained is not None]
    delays = [d for c in cases if (d := c.delay()) is not None]
    masked, spoilt = ([(c, row) for c in cases for row in sorted(of(c))] for of in (Rig.masked, Rig.spoilt))
    eventful = [c for c in cases if c.key["events"]]
    quiet, shaken = ([c for c in sound if bool(c.key["events"]) == e] for e in (False, True))
    median = f"{-np.median(shares):.0%}; {-np.quantile(shares, 0.9):.0%}" if shares else "–"
    return [
        ["answered: the file is read and there is a verdict", "100 %", rate([c.answered for c in cases])],
        [
            "false alarms on sound recordings without events",
            "≤ 2 %",
            rate([c.claims or not c.answered for c in quiet]),
        ],
        ["sound recordings with events: an effect is named", "≤ 2 %", rate([bool(c.named) for c in shaken])],
        ["detected", "≥ 95 %", rate([c.claims for c in rigs])],
        ["precision: terms that are named and there", "≥ 90 %", rate(_pooled(rigs, "named"))],
        ["recall: terms that are there and named", "≥ 60 %", rate(_pooled(rigs, "truth"))],
        ["the whole set named and nothing else", "", rate([c.exact for c in rigs if not c.key["outside"]])],
        ["partly-explained, and rightly so", "≥ 90 %", rate([c.partly_right for c in partly])],
        [
            "with an effect outside the catalogue: partly-explained, unexplained, or found as a law",
            "≥ 75 %",
            rate([c.strange_told for c in strange]),
        ],
        [
            "share of the misfit explained on held-out cycles, noise aside (median; 90 % above)",
            "≥ 90 %",
            median,
        ],
        [
            f"confidently wrong: named with probability above {SURE:g} and not there",
            "≤ 5 %",
            rate([c.wrong for c in cases]),
        ],
        [
            f"terms named with probability above {SURE:g} that are there",
            "≥ 90 %",
            rate(_pooled(cases, "sure")),
        ],
        ["events found", "≥ 80 %", rate([f for c in cases for f in c.found()])],
        [
            "recording that episodes and what is left out cover, where there are events (median; 90 % below)",
            "",
            quantiles([c.excluded() for c in eventful], "{:.1%}; {:.1%}"),
        ],
        [
            "readings masked that are glitches or dropouts",
            "≥ 95 %",
            rate([x in c.spoilt() for c, x in masked]),
        ],
        [
            "rows of glitches and dropouts that are left out",
            "≥ 95 %",
            rate([x[1] in c.rows_left_out() for c, x in spoilt]),
        ],
        *(_intervals(cases, of, says) for of, says in (("mu", "μ"), ("time-skew.delay", "the delay"))),
        [
            "error of that delay (median; 90 % below)",
            "",
            quantiles([1e3 * abs(e) for e in delays], "{:.2f}; {:.2f} ms"),
        ],
    ]


def _intervals(cases: Sequence[Rig], of: str, says: str) -> list[str]:
    """Row of the table about the intervals of a number."""
    averaged, shown = (rate([h for c in cases if (h := c.holds(of, which)) is not None]) for which in (1, 0))
    what = f"95 % interval of {says} averaged over models holds the truth"
    return [what, "≥ 90 %", f"{averaged}; under the model shown {shown}"]


def term_of(case: Rig, effect: str) -> set[str]:
    """What must be named for an effect that is there."""
    return case.merged([term(effect)])


def by_effect(cases: Sequence[Rig]) -> list[list[str]]:
    """Rows: effect, how often it is there, how often its term is named, and how often that term is named in
    cases that do not have it.
    """
    rows = []
    for effect in sorted({h for c in cases for h in c.key["hidden"]}):
        have = [c for c in cases if effect in c.key["hidden"]]
        known = sum(term_of(c, effect) <= c.named for c in have)
        others = [c for c in cases if not term_of(c, effect) & c.truth]
        false = sum(term_of(c, effect) <= c.named for c in others)
        moved = float(np.median([c.key["sizes"][effect] for c in have]))
        inside = effect in CATALOGUE
        row = [effect, term(effect) if inside else "–", str(len(have)), f"{moved:.1%}"]
        rows.append(row + ([str(known), f"{false} of {len(others)}"] if inside else ["–", "–"]))
    return rows


def by_stratum(cases: Sequence[Rig]) -> list[list[str]]:
    """Rows by number of effects, body, events and length: cases, detected, precision, recall, wrong."""
    rigs = [c for c in cases if c.key["kind"] == "rig"]
    strata = [(f"{n} effects", [c for c in rigs if len(c.key["hidden"]) == n]) for n in (2, 3, 4)]
    sheath = [c.key["robot"] == "sheath" for c in rigs]
    strata += [("sheath of fixed shape", [c for c, s in zip(rigs, sheath, strict=True) if s])]
    strata += [("body that bends", [c for c, s in zip(rigs, sheath, strict=True) if not s])]
    strata += [("with events", [c for c in rigs if c.key["events"]])]
    strata += [("without events", [c for c in rigs if not c.key["events"]])]
    seen = [bool(c.key["pose"] or c.key["displacement"]) for c in rigs]
    strata += [("with pose or displacement", [c for c, s in zip(rigs, seen, strict=True) if s])]
    return [
        [
            label,
            str(len(some)),
            rate([c.claims for c in some]),
            rate(_pooled(some, "named")),
            rate(_pooled(some, "truth")),
            rate([c.wrong for c in some]),
        ]
        for label, some in strata
    ]


def rows_csv(cases: Sequence[Rig]) -> str:
    """One line per case."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = "case kind hidden robot samples seconds events delay_ms verdict named wrong explained took_s"
    writer.writerow(names.split())
    for c in sorted(cases, key=lambda c: (c.key["kind"], c.key["hidden"], c.name)):
        key, explained = c.key, c.explained
        row = [c.name, key["kind"], " + ".join(key["hidden"]), key["robot"], len(key["clean"]["T_tip"])]
        row += [f"{key['seconds']:.0f}", " + ".join(e["kind"] for e in key["events"])]
        row += [f"{1e3 * key['delay_s']:.2f}", c.verdict, " + ".join(sorted(c.named)), int(c.wrong)]
        row += [
            "" if explained is None else f"{explained:.3f}",
            f"{c.answer.get('seconds', float('nan')):.1f}",
        ]
        writer.writerow(row)
    return out.getvalue()
