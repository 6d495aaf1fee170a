"""`python -m benchmarks`: the table of speeds; with --study, the solver study too."""

from __future__ import annotations

import argparse
import sys

from . import commands, live_page, measure, sweeping
from .gate import BASELINE, worse, write_baseline
from .speed import GROUPS as SPEEDS
from .speed import Metric

WAITED = {
    "fit": commands.fit,
    "diagnose": commands.diagnose,
    "design": commands.design,
    "first": commands.first,
}
GROUPS = SPEEDS | WAITED | sweeping.GROUPS | live_page.GROUPS


def _row(m: Metric) -> str:
    target = "" if m.target is None else f"{'<=' if m.direction == 'lower' else '>='} {m.target:g}"
    missed = m.target is not None and (m.value > m.target if m.direction == "lower" else m.value < m.target)
    cold = "" if m.cold is None else f"{m.cold:.2f}"
    says = ("MISSED " if missed else "") + m.note
    return f"{m.name:<52} {m.value:>9.4g} {m.unit:<10} {target:>8} {cold:>8}  {says}".rstrip()


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one system per group")
    parser.add_argument(
        "--gate", action="store_true", help="exit 1 where a ratio is worse than the baseline's"
    )
    parser.add_argument("--update-baseline", action="store_true", help=f"write {BASELINE.name}")
    parser.add_argument(
        "--only", choices=[*GROUPS, "study"], action="append", help="run only this group; repeatable"
    )
    parser.add_argument("--study", action="store_true", help="also run the solver study (minutes)")
    args = parser.parse_args(argv)

    machine = measure.machine()
    versions = machine["versions"]
    print(f"{machine['processor']}, {machine['cores']} cores, jax {versions['jax']}, {machine['date']}")
    print(f"{'what':<52} {'value':>9} {'unit':<10} {'target':>8} {'cold s':>8}")
    metrics = []
    for name, group in GROUPS.items():
        if name in (args.only or GROUPS):
            for metric in group(args.quick):
                metrics.append(metric)
                print(_row(metric), flush=True)
    failed = worse(metrics) if args.gate else []
    if args.update_baseline:
        write_baseline(metrics)
    for line in failed:
        print(f"gate: {line}", file=sys.stderr)
    if args.study or "study" in (args.only or ()):
        from . import solver_study  # last: it keeps the process on one core

        solver_study.main(args.quick)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
