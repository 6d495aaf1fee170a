"""What the diagnosis answers to the cases of the blind benchmark. It sees no key."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.answer.result import BAD_DATA
from calibrate.diagnosis.base.prepare import Undiagnosable, prepare
from calibrate.inference.parallel import use_threads
from calibrate.inference.simulation_cache import SimulationCache
from gtr_jax.cache import enable_cache
from gtr_jax.interpreters import started_safely

from . import baselines
from .cases import WITHOUT

# Packages whose source decides the answers.
TOOL = (Path(calibrate.__file__).parent, Path(gtr.__file__).parent)
# Cases that a process answers before another takes its place: compiled programs fill its memory.
A_TIME = 12
# Row of the file that holds the first sample.
FIRST_ROW = 2
# Keys of `diagnosis.json` that are kept for the cases made as rigs make them.
LATER = ("named", "named_probability", "share_explained", "episodes", "left_out")
# Folders of those packages that decide no answer.
NO_PART = {"cli", "report", "plots", "paper", "examples", "sweep", "planning"}


def tool() -> str:
    """Hash of the source that answers."""
    whole = hashlib.sha256()
    for root in TOOL:
        for path in sorted(root.rglob("*.py")):
            if NO_PART & set(path.relative_to(root).parts):
                continue
            whole.update(path.relative_to(root.parent).as_posix().encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()[:16]


def answer(folder: Path) -> dict[str, Any]:
    """The diagnosis of a case, and what it took [s]."""
    robot = gtr.load_config(folder / "robot.toml")
    recording = gtr.read_recording(folder / "recording.csv")
    with tempfile.TemporaryDirectory() as temporary:
        # The baselines start from the same fit: its simulations are not done twice.
        steps = Path(temporary) / "steps"
        began = time.perf_counter()
        found = calibrate.diagnose(robot, recording, experiment=False, steps=steps)
        took = time.perf_counter() - began
        ready = prepare(robot, recording, cache=SimulationCache(steps))
        simpler = {} if isinstance(ready, Undiagnosable) else baselines.of(ready)
    return _told(found, len(recording), took) | {"baselines": simpler}


def rig_answer(folder: Path) -> dict[str, Any]:
    """The diagnosis of a case that is made as rigs make recordings, and what it took [s]."""
    began = time.perf_counter()
    try:
        robot = gtr.load_config(folder / "robot.toml")
        recording = gtr.read_recording(folder / "recording.csv")
    except gtr.InputError as fault:
        return {"verdict": "refused", "says": str(fault)}
    found = calibrate.diagnose(robot, recording, experiment=False)
    written = found.to_json()
    more = {name: written[name] for name in LATER}
    masked = [
        {"channel": m.channel, "first": m.rows[0] - FIRST_ROW, "last": m.rows[1] - FIRST_ROW}
        for m in recording.masked
    ]
    return _told(found, len(recording), time.perf_counter() - began) | more | {"masked": masked}


def left_out_answer(folder: Path) -> dict[str, Any]:
    """The diagnosis of a case without the term that it names, and what it took [s]."""
    return plain_answer(folder, (folder / WITHOUT).read_text(encoding="utf-8").split())


def plain_answer(folder: Path, without: Sequence[str] = ()) -> dict[str, Any]:
    """The diagnosis of a case, without some terms and without the baselines, and what it took [s]."""
    robot = gtr.load_config(folder / "robot.toml")
    recording = gtr.read_recording(folder / "recording.csv")
    began = time.perf_counter()
    found = calibrate.diagnose(robot, recording, experiment=False, without=without)
    return _told(found, len(recording), time.perf_counter() - began)


def _told(found: calibrate.Diagnosis, samples: int, took: float) -> dict[str, Any]:
    return {
        "verdict": found.verdict,
        "sets": [sorted(s) for s in found.confusion_set],
        "models": [
            {"terms": sorted({n.partition(".")[0] for n in r.names}), "names": list(r.names)}
            | {
                "probability": r.probability,
                "chi2_per_n": r.chi2_per_n,
                "delta": r.delta,
                "log": r.log_posterior,
            }
            for r in found.rivals
        ],
        "parameters": {c.name: [c.before, c.after, c.sd] for c in found.parameters},
        "intervals": {
            c.name: [[c.lower95, c.upper95], c.averaged95] for c in found.parameters if c.averaged95
        },
        "law": None
        if found.discovered is None
        else {
            "acts": found.discovered.acts,
            "of": found.discovered.of,
            "formula": found.discovered.formula,
            "takes": found.discovered.takes,
            "possible": found.discovered.possible,
        },
        "left": found.left,
        "base_left": found.base_left,
        "rms_N": found.rms,
        "noise_N": found.noise,
        "held_out": [{("rms_N" if k == "rms" else k): v for k, v in h.items()} for h in found.held_out],
        "where": [w.says for w in found.where[:1]],
        "samples": samples,
        "seconds": took,
    }


def alone() -> None:
    """One thread for each process."""
    enable_cache()
    use_threads(1)


def only_features(folder: Path) -> dict[str, Any]:
    """What the baselines make of a case."""
    ready = prepare(gtr.load_config(folder / "robot.toml"), gtr.read_recording(folder / "recording.csv"))
    if isinstance(ready, Undiagnosable):
        return {"verdict": BAD_DATA, "baselines": {}}
    return {"verdict": "", "baselines": {"features": baselines.features(ready)}}


def features(folder: Path) -> dict[str, list[float]]:
    """Features of the cases that have any, by name."""
    found = {}
    for path in sorted((folder / "answers").glob("*.json")):
        known = json.loads(path.read_text(encoding="utf-8")).get("baselines", {})
        if known:
            found[path.stem] = known["features"]
    return found


def _one(job: tuple[Path, Path, str, Callable[[Path], dict[str, Any]]]) -> str:
    folder, target, source, by = job
    try:
        found = by(folder)
    except Exception:  # the next case may go well; this one counts as failed
        found = {"verdict": "crashed", "says": traceback.format_exc()}
    found["tool"] = source
    part = target.with_suffix(".part")
    part.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    os.replace(part, target)
    return f"{folder.name} {found['verdict']} {found.get('seconds', 0):.0f} s"


def run(folder: Path, processes: int, by: Callable[[Path], dict[str, Any]] = answer) -> None:
    """Answer the cases that have no answer yet; those answered by other source are answered again."""
    source, target = tool(), folder / "answers"
    target.mkdir(exist_ok=True)
    jobs = []
    for case in sorted((folder / "cases").iterdir()):
        done = target / f"{case.name}.json"
        if not done.exists() or json.loads(done.read_text(encoding="utf-8"))["tool"] != source:
            jobs.append((case, done, source, by))
    # Not concurrent.futures: with max_tasks_per_child its pool stands still once the first processes are done
    # (Python 3.11, github.com/python/cpython/issues/115634).
    with (
        started_safely(),
        multiprocessing.get_context("spawn").Pool(processes, alone, maxtasksperchild=A_TIME) as pool,
    ):
        for k, line in enumerate(pool.imap_unordered(_one, jobs), start=1):
            print(f"{k} of {len(jobs)}: {line}", file=sys.stderr, flush=True)
