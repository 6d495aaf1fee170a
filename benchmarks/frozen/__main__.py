"""`python -m benchmarks.frozen record|check`: record the answers of the code, or compare it with them.

`check` prints what changed and by how much, and ends with status 1 if anything moved further than its
tolerance: 1e-9 of the base model, 1e-6 with physics terms, verdicts not at all. `record` goes on where it
was interrupted and keeps what is there; `--again` records anew.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections.abc import Iterable
from pathlib import Path

from . import store
from .case import Case
from .compare import Change, compare, table

GROUPS = ("simulate", "equilibrium", "gradient", "fit", "design", "sweep", "diagnose")
A_TIME = 12  # cases after which compiled programs are let go: they fill the memory


def cases_of(group: str) -> list[Case]:
    """The cases of a group."""
    from . import designs, diagnoses, equilibria, fits, gradients, simulations, sweeps

    modules = (simulations, equilibria, gradients, fits, designs, sweeps, diagnoses)
    return modules[GROUPS.index(group)].cases()


def chosen(groups: Iterable[str], names: Iterable[str]) -> list[Case]:
    """The cases to run."""
    found = [case for group in groups for case in cases_of(group)]
    wanted = set(names)
    unknown = wanted - {case.name for case in found}
    if unknown:
        near = ", ".join(case.name for case in found)
        raise SystemExit(f"--case {sorted(unknown)[0]}: no such case; there are {near}")
    return [case for case in found if not wanted or case.name in wanted]


def record(cases: list[Case], folder: Path, again: bool) -> int:
    """Compute and keep the answers that are not there yet."""
    failed = 0
    for k, case in enumerate(cases):
        answers = store.load(folder, case.group)
        if case.name in answers and not again:
            continue
        began = time.perf_counter()
        try:
            answers[case.name] = case.run()
        except Exception:
            failed += 1
            print(f"{case.group} {case.name}:", traceback.format_exc(), sep="\n", file=sys.stderr)
            continue
        store.save(folder, case.group, answers)
        print(f"{case.group} {case.name}: {time.perf_counter() - began:.1f} s", flush=True)
        _let_go(k)
    return 1 if failed else 0


def check(cases: list[Case], folder: Path, everything: bool) -> int:
    """Compare, and print what changed."""
    frozen = {group: store.load(folder, group) for group in {case.group for case in cases}}
    shown: list[Change] = []
    beyond = same = 0
    for k, case in enumerate(cases):
        began = time.perf_counter()
        if case.name not in frozen[case.group]:
            changes = [Change(case.name, "", float("nan"), float("nan"), "was never recorded", True)]
        else:
            try:
                changes = compare(case, frozen[case.group][case.name], case.run())
            except Exception as error:
                traceback.print_exc()
                changes = [Change(case.name, "", float("nan"), float("nan"), f"raises {error!r}", True)]
        far = [c for c in changes if c.beyond]
        beyond, same = beyond + bool(far), same + (not changes)
        # Of what stays within its tolerance, the largest change of each case tells enough.
        within = sorted((c for c in changes if not c.beyond), key=lambda c: -c.relative)
        shown += far + (within if everything else within[:1])
        verdict = "MOVED" if far else "within tolerance" if changes else "the same"
        print(f"{case.group} {case.name}: {verdict}, {time.perf_counter() - began:.1f} s", flush=True)
        _let_go(k)
    if shown:
        print("", table(shown), sep="\n")
    moved = len(cases) - same - beyond
    print(f"\n{len(cases)} cases: {same} the same, {moved} within tolerance, {beyond} beyond it")
    return 1 if beyond else 0


def _let_go(k: int) -> None:
    if k % A_TIME == A_TIME - 1:
        import jax

        jax.clear_caches()


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.frozen", description=__doc__)
    parser.add_argument("what", choices=("record", "check", "list"))
    parser.add_argument("--only", metavar="GROUPS", help=f"some of {','.join(GROUPS)}")
    parser.add_argument(
        "--case", action="append", default=[], metavar="NAME", help="one case; may be repeated"
    )
    parser.add_argument("--again", action="store_true", help="record what is there already again")
    parser.add_argument("--all", action="store_true", help="print every quantity that changed at all")
    parser.add_argument(
        "-o", "--output", type=Path, default=store.FOLDER, metavar="FOLDER", help="where the answers lie"
    )
    given = parser.parse_args(argv)
    groups = GROUPS if given.only is None else tuple(given.only.split(","))
    for group in groups:
        if group not in GROUPS:
            parser.error(f"--only: no group '{group}'; there are {', '.join(GROUPS)}")
    cases = chosen(groups, given.case)
    if given.what == "list":
        print(*(f"{case.group} {case.name}" for case in cases), sep="\n")
        return 0
    from gtr_jax.cli.cache import enable_cache

    enable_cache()
    if given.what == "record":
        return record(cases, given.output, given.again)
    return check(cases, given.output, given.all)


if __name__ == "__main__":
    sys.exit(main())
