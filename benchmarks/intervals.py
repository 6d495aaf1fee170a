"""`python -m benchmarks.intervals -o FOLDER`: how often the printed 95 % intervals hold the truth.

Recordings of the blind benchmark's machine (`blind/machine.py`), which shares no code with the simulator: its
modulus and dimensions are drawn from what the robot file calls uncertain, the protocol, the noise and whether
the pose is recorded at random. Those of the fit hide nothing; those of the diagnosis hide nothing or one
effect whose law is the catalogue's, so that its size can be compared. The run resumes.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

import calibrate
import gtr_jax as gtr
from gtr_jax.atomic_write import write_atomically
from gtr_jax.interpreters import started_safely

from .blind import answers, cases

RESULTS = Path(__file__).parent / "results/intervals.md"
# Cases that a process answers before another takes its place: compiled programs fill its memory.
A_TIME = 16
GRAVITY = 9.81


def _same(number: str, of: str) -> Callable[[Mapping[str, float]], dict[str, float]]:
    return lambda hidden: {number: hidden[of]}


def _tip_load(hidden: Mapping[str, float]) -> dict[str, float]:
    size, way = hidden["tip-load.size_N"], hidden["tip-load.way_rad"]
    return {"tip-load.x": size * math.cos(way), "tip-load.y": size * math.sin(way)}


def _gravity(hidden: Mapping[str, float]) -> dict[str, float]:
    turn, weight = hidden["gravity.turned_rad"], GRAVITY * hidden["gravity.weight"]
    return {"gravity-error.x": weight * math.sin(turn), "gravity-error.y": GRAVITY - weight * math.cos(turn)}


# Effects whose law is the catalogue's: their true sizes by the simulator's names.
SIZES: dict[str, Callable[[Mapping[str, float]], dict[str, float]]] = {
    "adhesion": _same("adhesion.drag", "adhesion.drag_N_m"),
    "asymmetry": _same("friction-asymmetry.ratio", "asymmetry.ratio"),
    "entry": _same("local-friction.base", "entry.base"),
    "anchor": _same("local-friction.tip", "anchor.tip"),
    "stretch": _same("tendon-stretch.compliance", "stretch.compliance_1_N"),
    "tip-load": _tip_load,
    "gravity": _gravity,
    "crosstalk": _same("crosstalk.share", "crosstalk.share"),
    "tip-gain": _same("tip-gain.gain", "tip-gain.gain"),
    "base-gain": _same("base-gain.gain", "base-gain.gain"),
    "tip-offset": _same("tip-offset.force", "tip-offset.offset_N"),
    "base-offset": _same("base-offset.force", "base-offset.offset_N"),
    "skew": _same("time-skew.delay", "skew.delay_s"),
}


class Job(NamedTuple):
    """One recording: which command answers, its number, what it hides, and where the answer goes."""

    command: str
    seed: int
    number: int
    hidden: str
    folder: Path

    @property
    def target(self) -> Path:
        """The answer."""
        return self.folder / f"{self.command}-{self.number:04d}.json"


def _drawn(job: Job) -> cases.Case:
    for draw in range(20):
        rng = np.random.default_rng([job.seed, job.command == "diagnose", job.number, draw])
        hidden = (job.hidden,) if job.hidden else ()
        case = cases.make("single" if hidden else "sound", hidden, rng)
        if case is not None:
            return case
    raise RuntimeError(f"{job.target.name}: the machine fails at every draw")


def _truth(key: Mapping[str, Any], hidden: str) -> dict[str, float]:
    sizes = SIZES[hidden](key["numbers"]) if hidden else {}
    return {"mu": key["mu"], "E": key["E"], **key["dimensions"], **sizes}


def _answer(job: Job) -> dict[str, Any]:
    case = _drawn(job)
    folder = job.folder / "cases" / job.target.stem
    cases.write(case, folder, folder / "key.json")
    robot = gtr.load_config(folder / "robot.toml")
    recording = gtr.read_recording(folder / "recording.csv")
    began, verdict, named = time.perf_counter(), "", []
    if job.command == "fit":
        fit = calibrate.fit(robot, recording)
        verdict = "fitted" if fit.converged else "not converged"
        found = {e.name: (e.value, e.sd, e.lower95, e.upper95) for e in (*fit.estimates, *fit.carried)}
    else:
        diagnosis = calibrate.diagnose(robot, recording, experiment=False)
        verdict, named = diagnosis.verdict, diagnosis.named
        found = {c.name: (c.after, c.sd, c.lower95, c.upper95) for c in diagnosis.parameters}
    took = time.perf_counter() - began
    return {
        "verdict": verdict,
        "named": named,
        "terms": case.key["terms"],
        "truth": _truth(case.key, job.hidden),
        "found": found,
        "seconds": took,
        "robot": case.key["robot"],
        "protocol": case.key["protocol"],
        "pose": case.key["pose"],
        "noise": case.key["noise"],
    }


def _one(job: Job) -> str:
    try:
        found = _answer(job)
    except Exception:  # the next case may go well; this one counts as failed
        found = {"verdict": "crashed", "says": traceback.format_exc()}
    write_atomically(job.target, json.dumps(found, indent=1) + "\n")
    return f"{job.target.stem} {found['verdict']} {found.get('seconds', 0):.0f} s"


def jobs_of(folder: Path, seed: int, fits: int, diagnoses: int) -> list[Job]:
    """All recordings: half of those that are diagnosed hide nothing, the others one effect each in turn."""
    turn = list(SIZES)
    hidden = ["" if k % 2 else turn[(k // 2) % len(turn)] for k in range(diagnoses)]
    found = [Job("fit", seed, k, "", folder) for k in range(fits)]
    return found + [Job("diagnose", seed, k, h, folder) for k, h in enumerate(hidden)]


def _kind(name: str) -> str:
    """Row of the table that a number counts in."""
    if name in ("mu", "E"):
        return name
    return "dimensions" if "." not in name else "size of the effect named"


def _right(answer: Mapping[str, Any]) -> bool:
    """Whether the answer's model is the true one, so that its numbers mean what the truth's do."""
    if answer["verdict"] == "fitted":
        return True
    if answer["verdict"] not in ("adequate", "missing-physics"):
        return False
    return sorted(answer["named"]) == sorted(answer["terms"])


def rows(answers: Iterable[Mapping[str, Any]]) -> list[tuple[str, int, int, float]]:
    """Of each kind of number: how many intervals there are, how many hold the truth, and the scatter of the
    error in standard deviations, which should be 1.
    """
    table: dict[str, list[tuple[bool, float]]] = {}
    for a in answers:
        for name, true in a["truth"].items():
            value, sd, low, high = a["found"].get(name, (None,) * 4)
            if low is not None and high is not None and sd:
                table.setdefault(_kind(name), []).append((low <= true <= high, (value - true) / sd))
    return [
        (k, len(v), sum(h for h, _ in v), float(np.sqrt(np.mean([min(z * z, 100) for _, z in v]))))
        for k, v in table.items()
    ]


def page(folder: Path, seed: int) -> str:
    """The table, in Markdown."""
    lines = [
        f"Seed {seed}.",
        "",
        "| command | recordings | number | intervals | hold the truth | error over its sd, rms |",
        "|---|---|---|---|---|---|",
    ]
    every = {p: json.loads(p.read_text(encoding="utf-8")) for p in sorted(folder.glob("*-????.json"))}
    groups: list[tuple[str, str, Callable[[Mapping[str, Any]], bool]]] = [
        ("fit", "nothing hidden, pose recorded", lambda a: a["pose"]),
        ("fit", "nothing hidden, tensions only", lambda a: not a["pose"]),
        ("diagnose", "nothing hidden, called adequate", lambda a: not a["terms"] and _right(a)),
        ("diagnose", "one effect, named exactly", lambda a: bool(a["terms"]) and _right(a)),
        (
            "diagnose",
            "one effect, called adequate",
            lambda a: bool(a["terms"]) and a["verdict"] == "adequate",
        ),
        (
            "diagnose",
            "all that name or find nothing",
            lambda a: a["verdict"] in ("adequate", "missing-physics"),
        ),
    ]
    for command, label, of in groups:
        mine = [a for p, a in every.items() if p.stem.startswith(command) and a["verdict"] != "crashed"]
        mine = [a for a in mine if of(a)]
        for kind, n, held, scatter in rows(mine):
            low, high = stats.binomtest(held, n).proportion_ci(method="exact")
            share = f"{100 * held / n:.0f} % ({100 * low:.0f}–{100 * high:.0f})"
            lines.append(
                f"| `gtr {command}` | {len(mine)}: {label} | {kind} | {n} | {share} | {scatter:.2f} |"
            )
    verdicts: dict[str, int] = {}
    for path, a in every.items():
        key = f"{path.stem.partition('-')[0]}: {a['verdict']}"
        verdicts[key] = verdicts.get(key, 0) + 1
    lines += ["", "Answers: " + ", ".join(f"{k} {n}" for k, n in sorted(verdicts.items())) + "."]
    return "\n".join(lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.intervals", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of recordings and answers")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--fits", type=int, default=100, help="recordings that are fitted")
    parser.add_argument("--diagnoses", type=int, default=100, help="recordings that are diagnosed")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--write", action="store_true", help=f"write the table into {RESULTS.name}")
    args = parser.parse_args(argv)
    args.output.mkdir(parents=True, exist_ok=True)
    open_jobs = [
        j for j in jobs_of(args.output, args.seed, args.fits, args.diagnoses) if not j.target.exists()
    ]
    # Not concurrent.futures: see blind/answers.py.
    with (
        started_safely(),
        multiprocessing.get_context("spawn").Pool(args.jobs, answers.alone, maxtasksperchild=A_TIME) as pool,
    ):
        for k, line in enumerate(pool.imap_unordered(_one, open_jobs), start=1):
            print(f"{k} of {len(open_jobs)}: {line}", file=sys.stderr, flush=True)
    text = page(args.output, args.seed)
    print(text)
    if args.write:
        RESULTS.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
