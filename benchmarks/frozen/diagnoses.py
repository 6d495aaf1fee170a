"""Frozen diagnoses: recordings of the blind benchmark's machine, of the examples and of the demo.

The machine's recordings are drawn once and kept beside the answers, in `cases.zip`: for each a robot file, a
recording, and what was hidden in it.
"""

from __future__ import annotations

import json
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import gtr_jax as gtr

from . import store
from .case import EXAMPLES, Answers, Case

SEED, COUNT, DRAWS = 196, 40, 20
ZIP = store.FOLDER / "cases.zip"
FILES = ("robot.toml", "recording.csv", "key.json")
# Probability from which a rival is kept.
LIKELY = 0.05
# Of numbers that an optimiser found; probabilities, and the structure left, in units of one.
ALLOWED = 1e-3
FLOORS = {"*probability*": 10.0, "left": 10.0, "base_left": 10.0}

LOOSER = {"sd.*": 0.03}


def drawn(number: int, kind: str, hidden: tuple[str, ...]) -> dict[str, str]:
    """The files of a case by name; drawn, and kept, where it is not there yet."""
    from benchmarks.blind import cases as blind

    with zipfile.ZipFile(ZIP, "a", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        there = archive.namelist()
        names = {file: f"{number:02}/{file}" for file in FILES}
        if names["key.json"] not in there:
            for draw in range(DRAWS):
                case = blind.make(kind, hidden, np.random.default_rng([SEED, number, draw]))
                if case is not None:
                    break
            else:
                raise RuntimeError(f"case {number}: the machine fails at every draw ({kind} {hidden})")
            with tempfile.TemporaryDirectory() as folder:
                blind.write(case, Path(folder), Path(folder) / "key.json")
                key = {k: v for k, v in case.key.items() if k not in ("T_base", "clean")}
                (Path(folder) / "key.json").write_text(json.dumps(key), encoding="utf-8")
                for file, name in names.items():
                    archive.write(Path(folder) / file, name)
        return {file: archive.read(name).decode() for file, name in names.items()}


def blind_case(number: int, kind: str, hidden: tuple[str, ...]) -> Answers:
    """The diagnosis of a case of the machine."""
    files = drawn(number, kind, hidden)
    with tempfile.TemporaryDirectory() as folder:
        for file in FILES[:2]:
            (Path(folder) / file).write_text(files[file], encoding="utf-8")
        return diagnosed(Path(folder) / "robot.toml", [Path(folder) / "recording.csv"])


def diagnosed(robot: Path, recordings: Sequence[Path]) -> Answers:
    """What is kept of a diagnosis."""
    import calibrate

    found = calibrate.diagnose(
        gtr.load_config(robot), [gtr.read_recording(path) for path in recordings], experiment=False
    )
    kept: Answers = {
        "verdict": np.asarray(found.verdict),
        "named": np.asarray(" + ".join(sorted(found.named))),
        "rivals named": np.asarray(" or ".join(" + ".join(sorted(s)) for s in found.confusion_set)),
        "differ": np.asarray(", ".join(sorted(d.name for d in found.differ))),
        "named_probability": np.asarray(found.named_probability),
        "rms_N": np.asarray(found.rms_N),
        "noise_N": np.asarray(found.noise_N),
        "left": np.asarray(found.left),
        "base_left": np.asarray(found.base_left),
        "converged": np.asarray(found.converged),
    }
    for names, probability in found.probability.items():
        if probability > LIKELY:
            kept[f"probability.{names}"] = np.asarray(probability)
    for c in found.parameters:
        if c.after is not None and (c.name.partition("@")[0] in ("mu", "E") or "." in c.name):
            kept[f"value.{c.name}"] = np.asarray(c.after)
            kept[f"sd.{c.name}"] = np.asarray(np.nan if c.sd is None else c.sd)
    for when, held in zip(("before", "after"), found.held_out, strict=False):
        kept[f"held out, {when}"] = np.asarray([held["rms_N"], held["chi2_per_n"]])
    return kept


def cases() -> list[Case]:
    """All diagnoses."""
    from benchmarks.blind import cases as blind
    from gtr_jax.examples import CONCEALED, CONCEALED_ROBOT

    rig, (monday, oiled) = (
        EXAMPLES / "rig/robot.toml",
        (EXAMPLES / f"rig/{d}.csv" for d in ("monday", "oiled")),
    )
    runs = [
        ("rig: monday", lambda: diagnosed(rig, [monday])),
        ("rig: monday and oiled", lambda: diagnosed(rig, [monday, oiled])),
        ("demo: concealed", lambda: diagnosed(CONCEALED_ROBOT, [CONCEALED])),
    ]
    for number, (kind, hidden) in enumerate(blind.kinds(np.random.default_rng([SEED]), COUNT)):
        name = f"blind {number:02}: {' + '.join(hidden) or kind}"
        runs.append((name, lambda n=number, k=kind, h=hidden: blind_case(n, k, h)))
    return [Case("diagnose", name, run, ALLOWED, FLOORS, LOOSER) for name, run in runs]
