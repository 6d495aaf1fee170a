"""`python -m benchmarks.peers`: the same rod by every solver, one after another; --write keeps the result."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from .. import measure
from . import environments, report
from .plot import plot
from .problem import LEVELS, PROBLEMS, TENSION, reference

# name in the tables -> module, environment of its own (None: this one)
SOLVERS: dict[str, tuple[str, str | None]] = {
    "gtr-jax": ("run_ours", None),
    "soromox": ("run_soromox", "soromox"),
    "solve_bvp": ("run_solve_bvp", None),
    "pyelastica": ("run_pyelastica", "pyelastica"),
}

PICTURE = Path(__file__).parents[2] / "docs" / "peers.png"


def solver(name: str, quick: bool) -> dict[str, Any]:
    """What a solver found, or why it found nothing."""
    module, peer = SOLVERS[name]
    try:
        python = environments.python_of(peer) if peer else Path(sys.executable)
        return json.loads(environments.run(module, python, quick=quick))
    except (environments.PeerError, json.JSONDecodeError) as problem:
        print(f"left out: {problem}", file=sys.stderr)
        return {"failed": str(problem)}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument(
        "--write", action="store_true", help="write benchmarks/results/peers.{json,md} and docs/peers.png"
    )
    parser.add_argument("--quick", action="store_true", help="fewer settings and lanes")
    parser.add_argument("--only", choices=SOLVERS, action="append", help="only this solver; repeatable")
    args = parser.parse_args(argv)

    found: dict[str, Any] = {
        "machine": measure.machine(),
        "quick": args.quick,
        "tension_N": TENSION,
        "levels": list(LEVELS),
        "problems": [
            {
                "name": p.name,
                "tip_force_N": list(p.tip_force),
                "tip_m": list(reference(p)),
                "channels": [str(c) for c in getattr(p, "channels", ())],
            }
            for p in PROBLEMS
        ],
        "solvers": {},
    }
    for name in args.only or SOLVERS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        found["solvers"][name] = solver(name, args.quick)
    text = report.markdown(found)
    print(text)
    if args.write:
        where = measure.RESULTS
        (where / "peers.json").write_text(json.dumps(found, indent=1) + "\n")
        (where / "peers.md").write_text(text)
        plot(found, PICTURE)
    return 1 if any("failed" in s for s in found["solvers"].values()) else 0


if __name__ == "__main__":
    sys.exit(main())
