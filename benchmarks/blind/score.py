"""Scoring of the blind benchmark: only here are the keys read, and answers held against them."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
import multiprocessing
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from sklearn.ensemble import RandomForestClassifier

from gtr_jax.interpreters import started_safely

from . import answers, oracle
from .exam import digest
from .exam import keys as keys_of

# Information from which on an effect counts as one that should be found.
ENOUGH = 6.0
NOTHING, STRANGE = "nothing", "outside the catalogue"
# Hook and variable of what lies outside the catalogue; of the rest no law of one variable is the cause.
CAUSES = {
    "breathing": ("friction", "t"),
    "jolt": ("friction", "t"),
    "snag": ("friction", "d"),
    "ripple": ("tip_cell", "T"),
    "ringing": ("tip_response", "l"),
}
# What a law may leave on unseen samples, per sample in variances, to count as a model of the cause.
MODELLED = 1.3


@dataclasses.dataclass
class Scored:
    """One case: its key, what it holds, the answer, and whether that is right."""

    name: str
    key: dict[str, Any]
    holds: dict[str, float]
    answer: dict[str, Any]

    @property
    def kind(self) -> str:
        """Sound, single, pair, triple or outside."""
        return self.key["kind"]

    @property
    def truth(self) -> list[str]:
        """Terms that are missing."""
        return sorted(self.key["terms"])

    @property
    def information(self) -> float:
        """Root of what the base model leaves, in variances of the noise."""
        return self.holds["information"]

    @property
    def verdict(self) -> str:
        """Of the diagnosis."""
        return self.answer["verdict"]

    @property
    def claims(self) -> bool:
        """Whether it says that anything is missing, or fails to say that nothing is."""
        return self.verdict != "adequate"

    @property
    def sets(self) -> list[list[str]]:
        """What it names: one set of terms, or those it does not tell apart; a law found is not a term."""
        return [] if self.law else [sorted(s) for s in self.answer.get("sets", [])]

    @property
    def law(self) -> dict[str, Any] | None:
        """The law that it found."""
        return self.answer.get("law")

    @property
    def modelled(self) -> bool:
        """A law is found that predicts unseen samples to about the noise."""
        held = self.answer.get("held_out")
        return bool(self.law and held and held[-1]["chi2_per_n"] <= MODELLED)

    @property
    def cause(self) -> tuple[str, str] | None:
        """Hook and variable of a cause outside the catalogue, where it has such."""
        return CAUSES.get(self.key["hidden"][0]) if self.kind == "outside" else None

    @property
    def wrong_law(self) -> bool:
        """A law is found at another hook or of another variable than the cause's."""
        return bool(self.law) and self.cause != (self.law["acts"], self.law["of"])

    @property
    def names_one(self) -> bool:
        """Whether one set of terms is named, as all or as part of what is missing."""
        return self.verdict in ("missing-physics", "partly-explained") and len(self.sets) == 1

    @property
    def exact(self) -> bool:
        """Named exactly, and nothing else."""
        return self.names_one and self.sets == [self.truth]

    @property
    def covered(self) -> bool:
        """The truth is named or in the set."""
        return self.truth in self.sets

    @property
    def near(self) -> bool:
        """Something is named, or a set of rivals, and all of it is there."""
        return bool(self.sets) and all(s and set(s) <= set(self.truth) for s in self.sets)

    @property
    def all_wrong(self) -> bool:
        """Something is named, or a set of rivals, and each holds something that is not there."""
        return bool(self.sets) and not any(set(s) <= set(self.truth) for s in self.sets)

    @property
    def top3(self) -> bool:
        """The truth is among the three most probable sets of terms, nothing missing being one."""
        return self.truth in [list(terms) for terms, _ in self.by_terms()[:3]]

    def by_terms(self) -> list[tuple[tuple[str, ...], float]]:
        """Sets of terms with their probabilities, the most probable first."""
        found: dict[tuple[str, ...], float] = {}
        for model in self.answer.get("models", []):
            terms = tuple(sorted(model["terms"]))
            found[terms] = found.get(terms, 0.0) + model["probability"]
        return sorted(found.items(), key=lambda item: -item[1])

    @property
    def wrong(self) -> bool:
        """Confidently wrong: one set of terms named, and something in it is not there; or a law told that is
        not the cause, and the cause not among those that are possible instead.
        """
        if self.law is not None:
            told = self.cause is not None and " of ".join(self.cause) in self.law["possible"]
            return self.wrong_law and not told
        return self.names_one and not set(self.sets[0]) <= set(self.truth)

    @property
    def separable(self) -> bool:
        """Whether no term of another kind comes near the readings, noise aside."""
        return self.holds["apart"] > ENOUGH

    @property
    def beaten(self) -> bool:
        """Whether a term of another kind fits the readings, noise aside, no worse than its own law."""
        return self.holds["rival"] <= self.holds["own"]


def rate(hits: Sequence[bool]) -> str:
    """A share with its 95 % interval (Clopper and Pearson)."""
    n, k = len(hits), int(np.sum(hits))
    if n == 0:
        return "–"
    low, high = stats.binomtest(k, n).proportion_ci(method="exact")
    return f"{100 * k / n:.0f} % ({k}/{n}; {100 * low:.0f}–{100 * high:.0f})"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def _held(job: tuple[Path, str, dict[str, Any]]) -> tuple[str, dict[str, float]]:
    folder, name, key = job
    return name, oracle.left(folder / "cases" / name, key)


def read(folder: Path, processes: int) -> list[Scored]:
    """All cases that have an answer; what each holds is computed once and kept."""
    kept, source = folder / "oracle.json", answers.tool() + digest(Path(oracle.__file__))[:8]
    holds = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    told = {}
    for name, key in keys_of(folder).items():
        answer = folder / "answers" / f"{name}.json"
        if answer.exists():
            told[name] = key, json.loads(answer.read_text(encoding="utf-8"))
    holds = {name: held for name, held in holds.items() if held["tool"] == source}
    jobs = [(folder, name, key) for name, (key, _) in told.items() if name not in holds]
    with (
        started_safely(),
        multiprocessing.get_context("spawn").Pool(
            processes, answers.alone, maxtasksperchild=answers.A_TIME
        ) as pool,
    ):
        try:
            for k, (name, held) in enumerate(pool.imap_unordered(_held, jobs), start=1):
                holds[name] = {"tool": source, **held}
                print(f"{k} of {len(jobs)}: what {name} holds", file=sys.stderr, flush=True)
        finally:
            kept.write_text(json.dumps(holds), encoding="utf-8")
    return [Scored(name, key, holds[name], answer) for name, (key, answer) in told.items()]


def classified(scored: Sequence[Scored], trained: Sequence[tuple[list[float], dict[str, Any]]]) -> list[str]:
    """Labels that a random forest trained on other cases gives."""
    X, y = zip(*[(f, label(key)) for f, key in trained], strict=True)
    forest = RandomForestClassifier(600, min_samples_leaf=2, class_weight="balanced", random_state=0)
    forest.fit(np.asarray(X), np.asarray(y))
    known = [s.answer.get("baselines", {}).get("features") for s in scored]
    said = iter(forest.predict(np.asarray([f for f in known if f is not None])))
    return [NOTHING if f is None else str(next(said)) for f in known]


def label(key: dict[str, Any]) -> str:
    """What a classifier should say of a case."""
    if key["kind"] == "outside":
        return STRANGE
    return " + ".join(sorted(key["terms"])) or NOTHING


def baselines(scored: Sequence[Scored], labels: Sequence[str] | None) -> list[list[str]]:
    """Rows of a table: who, false alarms, detection, exact name of singles, confidently wrong, and what is
    called unexplained of that outside the catalogue.
    """
    usable = [s for s in scored if s.answer.get("baselines") or s.verdict in ("crashed", "bad-data")]
    nothing = {"claims": True, "names": ""}

    def row(who, claims, name, unexplained):
        sound = [claims(s) for s in usable if s.kind == "sound"]
        missing = [claims(s) for s in usable if s.kind != "sound" and s.information > ENOUGH]
        single = [name(s) == s.truth for s in usable if s.kind == "single" and s.information > ENOUGH]
        inside = [s for s in usable if s.kind in ("single", "pair", "triple", "outside")]
        wrong = [bool(name(s)) and not set(name(s)) <= set(s.truth) for s in inside]
        outside = [unexplained(s) for s in usable if s.kind == "outside" and s.information > ENOUGH]
        return [who, *(rate(x) for x in (sound, missing, single, wrong, outside))]

    def kinds(text):
        return sorted({n.partition(".")[0] for n in text.split(" + ") if n})

    def of(which):
        return lambda s: s.answer.get("baselines", {}).get(which, nothing)

    def named_by(which):
        return lambda s: kinds(of(which)(s)["names"]) if of(which)(s)["claims"] else []

    rows = [
        row(
            "this diagnosis",
            lambda s: s.claims,
            lambda s: s.sets[0] if s.names_one else [],
            lambda s: s.verdict == "unexplained" or s.law is not None,
        ),
        row("refit only", lambda s: of("refit only")(s)["claims"], lambda s: [], lambda s: False),
    ]
    for which in ("score test", "residual match"):
        rows.append(row(which, lambda s, w=which: of(w)(s)["claims"], named_by(which), lambda s: False))
    if labels is not None:
        said = dict(zip([s.name for s in scored], labels, strict=True))
        rows.append(
            row(
                "classifier (random forest)",
                lambda s: said[s.name] != NOTHING,
                lambda s: [] if said[s.name] in (NOTHING, STRANGE) else said[s.name].split(" + "),
                lambda s: said[s.name] == STRANGE,
            )
        )
    return rows


def overview(scored: Sequence[Scored]) -> list[list[str]]:
    """Rows of the main table: what, target, reached."""
    sound = [s for s in scored if s.kind == "sound"]
    single = [s for s in scored if s.kind == "single"]
    told = [s for s in single if s.information > ENOUGH and s.separable]
    several = [s for s in scored if s.kind in ("pair", "triple") and s.information > ENOUGH]
    outside = [s for s in scored if s.kind == "outside"]
    strong = [s for s in outside if s.information > ENOUGH]
    named = [s for s in scored if s.kind in ("single", "pair", "triple") and s.covered]
    sets = [s for s in single if s.sets]
    held = [s.answer["held_out"][-1]["chi2_per_n"] for s in scored if s.exact and s.answer.get("held_out")]
    any_named = [s for s in scored if s.names_one]
    any_held = [s.answer["held_out"][-1]["chi2_per_n"] for s in any_named if s.answer.get("held_out")]
    any_bias = [abs(s.answer["parameters"]["mu"][1] / s.key["mu"] - 1) for s in any_named]
    bias = [abs(s.answer["parameters"]["mu"][1] / s.key["mu"] - 1) for s in scored if s.exact]
    before = [abs(s.answer["parameters"]["mu"][0] / s.key["mu"] - 1) for s in scored if s.exact]
    gain = [improvement(s) for s in scored if s.exact and s.answer.get("held_out")]
    return [
        ["false alarms on sound recordings", "≤ 2 %", rate([s.claims for s in sound])],
        [
            "detected, information > 6 (any kind)",
            "",
            rate([s.claims for s in scored if s.kind != "sound" and s.information > ENOUGH]),
        ],
        [
            "named exactly, single, separable (nearest rival > 6 behind), information > 6",
            "≥ 90 %",
            rate([s.exact for s in told]),
        ],
        ["truth among the three most probable, the same", "", rate([s.top3 for s in told])],
        [
            "not separable, single, information > 6",
            "",
            rate([not s.separable for s in single if s.information > ENOUGH])
            + f"; of these {sum(s.beaten for s in single if s.information > ENOUGH)} because a rival fits as "
            "well as the term's own law or better",
        ],
        [
            "named exactly, or in the set where it is not separable, single, information > 6",
            "",
            rate([s.exact or (s.covered and not s.separable) for s in single if s.information > ENOUGH]),
        ],
        [
            "set holds the truth, of singles for which anything is named",
            "≥ 95 %",
            rate([s.covered for s in sets]),
        ],
        ["mean size of these sets", "≤ 2", f"{np.mean([len(s.sets) for s in sets]):.2f}" if sets else "–"],
        *[
            [
                f"{kind}s named whole or in the set, information > 6",
                target,
                rate([s.covered for s in several if s.kind == kind]),
            ]
            for kind, target in (("pair", "≥ 65 %"), ("triple", "≥ 40 %"))
        ],
        *[
            [
                f"the same, of the {kind}s of which every part is missed beside the others by more than 6",
                "",
                rate([s.covered for s in several if s.kind == kind and s.holds["least_part"] > ENOUGH]),
            ]
            for kind in ("pair", "triple")
        ],
        [
            "pairs and triples: part of them named and nothing wrong",
            "≥ 85 %",
            rate([s.near for s in several]),
        ],
        ["pairs and triples: confidently wrong", "≤ 5 %", rate([s.wrong for s in several])],
        [
            "outside the catalogue called unexplained, or found as a law, information > 6",
            "≥ 75 %",
            rate([s.verdict == "unexplained" or s.law is not None for s in strong]),
        ],
        [
            f"outside the catalogue found as a law that leaves χ²/n ≤ {MODELLED} on unseen samples, the same",
            "≥ 50 %",
            rate([s.modelled for s in strong]),
        ],
        [
            "laws found outside the catalogue: right hook and variable",
            "",
            rate([not s.wrong_law for s in outside if s.law]),
        ],
        ["laws found where the catalogue holds the cause", "", rate([bool(s.law) for s in several + single])],
        ["outside the catalogue, confidently wrong", "≤ 7 %", rate([s.wrong for s in outside])],
        [
            "confidently wrong of all that is not sound, information > 6",
            "",
            rate([s.wrong for s in scored if s.kind != "sound" and s.information > ENOUGH]),
        ],
        [
            "named, or a set of rivals, all of them wrong, the same",
            "",
            rate([s.all_wrong for s in scored if s.kind != "sound" and s.information > ENOUGH]),
        ],
        [
            "held-out χ²/n after naming exactly (median; 90 % below)",
            "≤ 1.15",
            quantiles(held, "{:.2f}; {:.2f}"),
        ],
        ["error of μ after naming exactly (median; 90 % below)", "≤ 3 %", quantiles(bias, "{:.1%}; {:.1%}")],
        ["the same before", "", quantiles(before, "{:.1%}; {:.1%}")],
        ["held-out χ²/n wherever one set of terms is named", "", quantiles(any_held, "{:.2f}; {:.2f}")],
        ["error of μ wherever one set of terms is named", "", quantiles(any_bias, "{:.1%}; {:.1%}")],
        ["held-out improvement, share of what there is to gain (median)", "", quantiles(gain, "{:.0%}")],
        ["cases named or in a set", "", str(len(named))],
        *intervals(scored),
    ]


def holds(s: Scored, which: int, of: str = "mu") -> bool | None:
    """Whether the 95 % interval of a number holds the truth: under the model shown (0), or averaged over
    models (1); None where there is none.
    """
    return within(s.answer, s.key, which, of, of)


def within(answer: dict[str, Any], key: dict[str, Any], which: int, of: str, truth: str) -> bool | None:
    """As `holds`, of any answer and its key, which has the truth of the number under the name `truth`."""
    ends = answer.get("intervals", {}).get(of)
    return None if ends is None else bool(ends[which][0] <= key[truth] <= ends[which][1])


def intervals(scored: Sequence[Scored]) -> list[list[str]]:
    """Rows of the main table about the intervals of mu."""
    groups: list[tuple[str, str, Callable[[Scored], bool]]] = [
        ("all cases", "≥ 90 %", lambda s: True),
        ("sound", "≥ 90 %", lambda s: s.kind == "sound"),
        ("one effect", "≥ 90 %", lambda s: s.kind == "single"),
        ("pairs and triples", "≥ 90 %", lambda s: s.kind in ("pair", "triple")),
        ("outside the catalogue", "", lambda s: s.kind == "outside"),
        ("called adequate and not sound", "≥ 90 %", lambda s: s.kind != "sound" and not s.claims),
    ]
    rows = []
    for label, target, chosen in groups:
        shares = []
        for which in (1, 0):
            told = [holds(s, which) for s in scored if chosen(s)]
            shares.append(rate([t for t in told if t is not None]))
        what = f"95 % interval of μ averaged over models holds the truth, {label}"
        rows.append([what, target, f"{shares[0]}; under the model shown {shares[1]}"])
    wider = []
    for s in scored:
        ends = s.answer.get("intervals", {}).get("mu")
        if s.kind == "sound" and ends is not None and ends[0][1] > ends[0][0]:
            wider.append((ends[1][1] - ends[1][0]) / (ends[0][1] - ends[0][0]))
    label = "averaged interval of μ over that of the model shown, sound (median; 90 % below)"
    return [*rows, [label, "≤ 3", quantiles(wider, "{:.2f}; {:.2f}")]]


def improvement(s: Scored) -> float:
    """Share of the held-out residual beyond the noise that the diagnosis takes away."""
    return taken(s.answer, s.key)


def taken(answer: dict[str, Any], key: dict[str, Any]) -> float:
    """Share of the misfit of T_tip beyond the noise that an answer takes away on unseen samples."""
    before, after = (answer["held_out"][k]["rms_N"] for k in (0, -1))
    return float((before**2 - after**2) / max(before**2 - key["sd"]["T_tip"] ** 2, 1e-12))


def quantiles(values: Sequence[float], form: str) -> str:
    """Median, and what nine of ten lie below."""
    return form.format(*np.quantile(values, [0.5, 0.9])) if values else "–"


def seconds(answered: Sequence[Any]) -> list[float]:
    """What the answers of cases of any family took [s]."""
    return [s.answer["seconds"] for s in answered if "seconds" in s.answer]


def per_effect(scored: Sequence[Scored]) -> list[list[str]]:
    """Rows by hidden effect, singles and those outside the catalogue."""
    rows = []
    for kind in ("single", "outside"):
        effects = sorted({s.key["hidden"][0] for s in scored if s.kind == kind})
        for effect in effects:
            of = [s for s in scored if s.kind == kind and s.key["hidden"] == [effect]]
            strong = [s for s in of if s.information > ENOUGH]
            count = {v: sum(s.verdict == v for s in of) for v in ("adequate", "unexplained", "discovered")}
            rows.append(
                [
                    effect,
                    of[0].truth[0] if kind == "single" else "–",
                    f"{len(strong)} of {len(of)}",
                    f"{np.median([s.information for s in of]):.0f}",
                    f"{np.median([s.holds['concealment'] for s in of]):.0%}",
                    f"{np.median([s.holds['own'] for s in of]):.0f}" if kind == "single" else "–",
                    str(sum(s.exact for s in of)),
                    str(sum(s.covered and not s.exact for s in of)),
                    str(count["unexplained"]),
                    str(count["discovered"]),
                    str(count["adequate"]),
                    str(sum(s.wrong for s in of)),
                    str(sum(len(s.sets) > 1 and not s.covered for s in of)),
                ]
            )
    return rows


STRATA: tuple[tuple[str, Callable[[Scored], float], tuple[float, ...]], ...] = (
    ("information", lambda s: s.information, (0, 3, 6, 12, 30, 1e9)),
    ("concealment", lambda s: s.holds["concealment"], (0, 0.5, 0.75, 0.9, 1.01)),
)
# What the best fit of the term's own law leaves of the noise-free readings.
OWN = (0, ENOUGH, 2 * ENOUGH, 1e9)


def by_stratum(scored: Sequence[Scored]) -> list[list[str]]:
    """Rows of detection, exact names and coverage of singles by what is left, by what is hidden, and by what
    was recorded.
    """
    single, rows = [s for s in scored if s.kind == "single"], []

    def add(label: str, inside: list[Scored]) -> None:
        rows.append(
            [
                label,
                str(len(inside)),
                *(
                    rate(x)
                    for x in (
                        [s.claims for s in inside],
                        [s.exact for s in inside],
                        [s.top3 for s in inside],
                        [s.wrong for s in inside],
                    )
                ),
            ]
        )

    def between(low: float, high: float) -> str:
        return f"above {low:g}" if high > 1e6 else f"{low:g} to {high:g}"

    for name, value, edges in STRATA:
        for low, high in itertools.pairwise(edges):
            add(f"{name} {between(low, high)}", [s for s in single if low <= value(s) < high])
    strong = [s for s in single if s.information > ENOUGH]
    for low, high in itertools.pairwise(OWN):
        add(
            f"separable, information > 6, its own law leaves {between(low, high)}",
            [s for s in strong if s.separable and low <= s.holds["own"] < high],
        )
    for name in ("staircase", "rich", "random"):
        add(f"{name}, information > 6", [s for s in strong if s.key["protocol"] == name])
    for posed in (True, False):
        add(
            f"{'with' if posed else 'without'} pose, information > 6",
            [s for s in strong if s.key["pose"] == posed],
        )
    return rows


def located(scored: Sequence[Scored]) -> str:
    """How well local friction that is named is placed."""
    where = {
        "entry": "local-friction.base",
        "anchor": "local-friction.tip",
        "patch": "local-friction.stretch",
    }
    right = []
    for s in scored:
        if s.kind == "single" and s.key["hidden"][0] in where and s.covered:
            first = next(m for m in s.answer["models"] if sorted(m["terms"]) == s.truth)
            right.append(first["names"] == [where[s.key["hidden"][0]]])
    return rate(right)


def reliability(scored: Sequence[Scored]) -> list[tuple[float, float, int]]:
    """Of the most probable set of terms, of all that the catalogue holds: mean probability, share right, and
    count, by bins of the probability.
    """
    points = []
    for s in scored:
        if s.kind != "outside" and s.answer.get("models"):
            best, probability = s.by_terms()[0]
            points.append((probability, list(best) == s.truth))
    found, p = [], np.asarray(points, float).reshape(-1, 2)
    for low, high in ((0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 0.995), (0.995, 1.01)):
        inside = (p[:, 0] >= low) & (p[:, 0] < high)
        if inside.any():
            found.append((float(p[inside, 0].mean()), float(p[inside, 1].mean()), int(inside.sum())))
    return found


def rows_csv(scored: Sequence[Scored]) -> str:
    """One line per case, for those who want to look."""
    out = io.StringIO()
    names = ["case", "kind", "hidden", "robot", "protocol", "pose", "noise", "information", "concealment"]
    names += ["own", "rival", "apart", "least_part", "verdict", "sets", "mu", "mu_before", "mu_after"]
    names += ["seconds"]
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    for s in sorted(scored, key=lambda s: (s.kind, s.key["hidden"], s.name)):
        mu = s.answer.get("parameters", {}).get("mu", [float("nan")] * 3)
        writer.writerow(
            [
                s.name,
                s.kind,
                " + ".join(s.key["hidden"]),
                s.key["robot"],
                s.key["protocol"],
                int(s.key["pose"]),
            ]
            + [s.key["noise"], f"{s.information:.2f}", f"{s.holds['concealment']:.2f}"]
            + [f"{s.holds[x]:.2f}" if x in s.holds else "" for x in ("own", "rival", "apart", "least_part")]
            + [s.verdict]
            + [" or ".join(" + ".join(x) for x in s.sets), f"{s.key['mu']:.4f}"]
            + [f"{v:.4f}" for v in mu[:2]]
            + [f"{s.answer.get('seconds', float('nan')):.1f}"]
        )
    return out.getvalue()
