"""How things are timed, and on what machine."""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.integrate import solve_bvp

RESULTS = Path(__file__).parent / "results"


def told(lines: Iterable[str], into: str | None) -> None:
    """Print lines as they come; write them to a file of results too, if one is named."""
    kept = []
    for line in lines:
        kept.append(line)
        print(line, flush=True)
    if into is not None:
        (RESULTS / into).write_text("\n".join(kept) + "\n", encoding="utf-8")


def command(name: str, says: str | None, lines: Callable[[], Iterable[str]], argv: list[str] | None) -> int:
    """The command of a benchmark that tells lines, and writes them to results/NAME.md if asked."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{name}", description=says)
    parser.add_argument("--write", action="store_true", help=f"write results/{name}.md")
    told(lines(), f"{name}.md" if parser.parse_args(argv).write else None)
    return 0


class Timed(NamedTuple):
    """Seconds per call when warm (the shortest of the repeats), seconds of the first call, its result."""

    warm: float
    cold: float
    value: Any


def shortest(fn: Callable, *args, budget: float = 0.4, least: int = 3) -> float:
    """Seconds per call: the shortest of repeats of at least 2 ms each, for about `budget` seconds."""
    jax.block_until_ready(fn(*args))
    calls, best, spent, repeats = 1, np.inf, 0.0, 0
    while spent < budget or repeats < least:
        start = time.perf_counter()
        for _ in range(calls):
            out = fn(*args)
        jax.block_until_ready(out)
        took = time.perf_counter() - start
        spent += took
        repeats += 1
        best = min(best, took / calls)
        if took < 2e-3:
            calls = int(np.ceil(2.5e-3 / max(took / calls, 1e-7)))
    return float(best)


def timed(fn: Callable, *args, budget: float = 0.4, jit: bool = True) -> Timed:
    """Time a function as a user of `jax.jit` calls it; `jit=False` for one that compiles itself."""
    run = jax.jit(fn) if jit else fn
    start = time.perf_counter()
    value = jax.block_until_ready(run(*args))
    cold = time.perf_counter() - start
    return Timed(shortest(run, *args, budget=budget), cold, value)


def reference_seconds(budget: float = 0.4) -> float:
    """A fixed piece of numpy and scipy work on one core [s]: the elastica by `scipy.integrate.solve_bvp`.

    The gate compares ratios to this, so that a slower machine does not fail it.
    """
    s = np.linspace(0.0, 1.0, 100)

    def solve():
        return solve_bvp(
            lambda s, y: np.stack([y[1], -3.0 * np.cos(y[0])]),
            lambda a, b: np.array([a[0], b[1]]),
            s,
            np.zeros((2, s.size)),
            tol=1e-8,
        ).y

    return shortest(solve, budget=budget, least=5)


def cores() -> int:
    """Cores this process may use. Not gtr_jax's: peers are timed in environments without it."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine() -> dict[str, Any]:
    """Where and with what the numbers were taken."""
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "device": jax.devices()[0].device_kind,
        "processor": _processor(),
        "cores": cores(),
        "python": platform.python_version(),
        "versions": {
            name: version(name)
            for name in ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "scipy")
        },
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
