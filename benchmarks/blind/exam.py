"""Drawing the cases of the blind benchmark and sealing their keys, which only the scorer reads again."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType

import numpy as np

from gtr_jax.interpreters import started_safely

from . import cases

# Draws of a case before it is given up.
DRAWS = 20
SEAL = "seal.json"


def _one(job: tuple[int, int, str, tuple[str, ...], Path, Callable]) -> tuple[str, str] | None:
    """Make a case; its id and the hash of its key. None, with a line that says so, if the machine fails at
    every draw.
    """
    seed, number, kind, hidden, folder, make = job
    for draw in range(DRAWS):
        rng = np.random.default_rng([seed, number, draw])
        name = hashlib.sha256(rng.bytes(16)).hexdigest()[:12]
        if (folder / "keys" / f"{name}.json").exists():
            break
        case = make(kind, hidden, rng)
        if case is not None:
            cases.write(case, folder / "cases" / name, folder / "keys" / f"{name}.json")
            break
    else:
        print(f"case {number} of seed {seed} is left out: the machine fails at every draw ({kind} {hidden})")
        return None
    return name, digest(folder / "keys" / f"{name}.json")


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def make(folder: Path, seed: int, count: int, processes: int, family: ModuleType = cases) -> None:
    """Draw cases of a family, a module with `kinds` and `make`, and seal their keys; those already there are
    kept. What the machine cannot make is left out, before anything is answered.
    """
    drawn = family.kinds(np.random.default_rng([seed]), count)
    jobs = [(seed, k, kind, hidden, folder, family.make) for k, (kind, hidden) in enumerate(drawn)]
    with (
        started_safely(),
        ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool,
    ):
        sealed = dict(one for one in pool.map(_one, jobs) if one is not None)
    text = json.dumps({"seed": seed, "keys": dict(sorted(sealed.items()))}, indent=1)
    (folder / SEAL).write_text(text + "\n", encoding="utf-8")


def keys(folder: Path) -> dict[str, dict]:
    """The keys by case, for the scorer; refused where one was changed since it was sealed."""
    sealed = json.loads((folder / SEAL).read_text(encoding="utf-8"))["keys"]
    found = {}
    for name, expected in sealed.items():
        path = folder / "keys" / f"{name}.json"
        if digest(path) != expected:
            raise SystemExit(f"{path}: was changed since it was sealed; draw the cases again")
        found[name] = json.loads(path.read_text(encoding="utf-8"))
    return found
