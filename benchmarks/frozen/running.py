"""Runs a case in a process of its own and keeps its answers."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import made
from .cases import Case
from .compare import READ

SOURCE = ("gtr_jax", "calibrate", "design")
INPUTS = ("examples", "tests/data")


class Place(NamedTuple):
    """Where cases run: the checkout whose `gtr` is asked, the folder of all answers, that of this run inside
    it (`before` or `now`), and the shared recordings, if there are any.
    """

    checkout: Path
    folder: Path
    run: str
    shared: Path | None

    @property
    def answers(self) -> Path:
        return self.folder / self.run

    def roots(self) -> dict[str, str]:
        """Paths that stand in the answers, and what to call them."""
        named = {self.answers: "ANSWERS", self.folder / "made": "MADE", self.checkout: "CHECKOUT"}
        if self.shared:
            named[self.shared] = "SHARED"
        return {str(path): name for path, name in named.items()}


def digest(checkout: Path) -> str:
    """Of the source and the inputs of a checkout."""
    found = hashlib.sha256()
    for top in (*SOURCE, *INPUTS):
        for path in sorted((checkout / top).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                found.update(f"{path.relative_to(checkout)}\0".encode())
                found.update(path.read_bytes())
    return found.hexdigest()[:16]


def kept(folder: Path) -> dict[str, Any] | None:
    """What is known of a case that ran; None if it did not, or not to its end."""
    path = folder / "case.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def run_all(cases: Sequence[Case], place: Place, *, jobs: int, again: bool) -> None:
    """Run the cases that have no answers by this source yet; a line for each."""
    source, cache = digest(place.checkout), place.folder / "cache"
    cache = cache / digest(place.checkout)  # of its own, so that no side profits from the other
    cache.mkdir(parents=True, exist_ok=True)
    for case in cases:
        if case.made:
            made.make(case.made, place.folder / "made", place.checkout)
    futures: dict[str, Future[None]] = {}
    lock = threading.Lock()

    def one(case: Case, number: int) -> None:
        if case.after in futures:  # it was submitted before, so that it runs or is done
            futures[case.after].result()
        of = hashlib.sha256(repr((source, case)).encode()).hexdigest()[:16]
        before = kept(place.answers / case.name)
        if before is not None and before["digest"] == of and not again:
            return
        found = _run(case, place, of, cache)
        with lock:
            status = f", exit status {found['exit']}" if found["exit"] else ""
            print(f"{number}/{len(cases)} {case.name}: {found['cpu']:.1f} s{status}", flush=True)

    with ThreadPoolExecutor(jobs) as pool:
        for number, case in enumerate(cases, start=1):
            futures[case.name] = pool.submit(one, case, number)
        for future in futures.values():
            future.result()


def _run(case: Case, place: Place, of: str, cache: Path) -> Mapping[str, Any]:
    out = place.answers / case.name
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    names = {"out": out, "answers": place.answers, "made": place.folder / "made", "shared": place.shared}
    arguments = []
    for argument in case.arguments:
        for name, path in names.items():
            argument = argument.replace(f"{{{name}}}", str(path))
        arguments.append(argument)
    program = ["-c", case.program] if case.program else ["-m", "gtr_jax"]
    # The checkout comes first on the path, whatever is installed.
    environment = os.environ | {
        "PYTHONPATH": str(place.checkout),
        "PYTHONSAFEPATH": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONHASHSEED": "0",  # ezdxf writes the classes of a drawing in the order of a set
        "GTR_JAX_CACHE": str(cache),
        "COLUMNS": "100",
    }
    with (out / "said.txt").open("w") as said, (out / "trouble.txt").open("w") as trouble:
        process = subprocess.Popen(
            [sys.executable, "-P", *program, *arguments],
            cwd=place.checkout,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=trouble,
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    _tidy(out)
    found = {
        "digest": of,
        "exit": process.returncode,
        "cpu": usage.ru_utime + usage.ru_stime,
        "roots": place.roots(),
    }
    (out / "exit.json").write_text(json.dumps({"exit": process.returncode}), encoding="utf-8")
    (out / "case.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


def _tidy(out: Path) -> None:
    """Keep what is compared: a store of a sweep as an array per variable, no pictures, no pages."""
    import xarray

    for store in out.rglob("*.zarr"):
        with xarray.open_zarr(store, consolidated=False) as data:
            for name in [*data.data_vars, *data.coords]:
                values = np.asarray(data[name].values)
                np.save(
                    store.parent / f"{name}.npy", values.astype(str) if values.dtype == object else values
                )
        shutil.rmtree(store)
    for path in out.rglob("*"):
        if path.is_file() and path.suffix not in READ:
            path.unlink()
