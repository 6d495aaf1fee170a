"""`python -m benchmarks.frozen`: freeze the answers of the program; later, say what changed and by how much.

    python -m benchmarks.frozen --write quick              in the earlier commit
    python -m benchmarks.frozen --check quick --times      after a change, with the same --answers
    python -m benchmarks.frozen --against COMMIT           both at once

A case that this source has answered is not run again. Programs are compiled anew for each source, so that the
times of both sides can be compared; with one case alone, it alone pays for compiling.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from pathlib import Path

from . import compare, running
from .cases import PARTS, Case
from .running import Place

ROOT = Path(__file__).parents[2]
BEFORE, NOW = "before", "now"
SAYS = "Freeze the answers of the program; later, say what changed and by how much."


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(ROOT), *arguments], check=True, capture_output=True, text=True
    ).stdout.strip()


def shared_data() -> Path | None:
    """The recordings beside the repository, also for a worktree of it; None where there are none."""
    beside = [ROOT.parent]
    with contextlib.suppress(subprocess.CalledProcessError, FileNotFoundError):
        beside.append((ROOT / _git("rev-parse", "--git-common-dir")).resolve().parents[1])
    found = (folder / "shared/data" for folder in beside)
    return next((folder for folder in found if folder.is_dir()), None)


@contextlib.contextmanager
def checkout_of(commit: str) -> Iterator[Path]:
    """A worktree of a commit, for as long as it is needed."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary).resolve() / "checkout"
        _git("worktree", "add", "--quiet", "--detach", str(folder), commit)
        try:
            yield folder
        finally:
            _git("worktree", "remove", "--force", str(folder))


def chosen(part: str, only: str | None, root: Path, shared: Path | None) -> list[Case]:
    """Cases of a part whose name matches, and those whose answers they read."""
    cases = PARTS[part](root, shared)
    if only is None:
        return cases
    wanted = {case.name for case in cases if fnmatch(case.name, only)}
    wanted |= {case.after for case in cases if case.name in wanted}
    return [case for case in cases if case.name in wanted]


def said(changes: Sequence[compare.Change]) -> str:
    """What became of a case, in a line."""
    numbers = [c for c in changes if c.kind == "number"]
    missing = [c for c in changes if c.kind == "missing"]
    if not changes:
        return "the same"
    more = f", and {len(changes) - 1} more" if len(changes) > 1 else ""
    if missing:
        return f"missing: {missing[0]}{more}"
    if not numbers:
        return f"only words changed: {changes[0]}{more}"
    largest = max(numbers, key=lambda c: c.relative)
    head = "changed" if largest.relative > compare.CLOSE else "the same but for rounding"
    return f"{head}: {largest}{more}"


def report(cases: Sequence[Case], folder: Path, every: bool = False) -> bool:
    """A line for each case and a summary; whether all numbers are as they were. With `every`, each change."""
    counts = {"the same": 0, "the same but for rounding": 0, "only words changed": 0}
    counts |= {"changed": 0, "missing": 0}
    for case in cases:
        before, now = folder / BEFORE / case.name, folder / NOW / case.name
        if running.kept(before) is None:
            line, changes = "missing: no answer was kept of it", []
        else:
            changes = compare.folders(before, now)
            line = said(changes)
        counts[line.split(":")[0]] += 1
        print(f"{case.name}: {line}")
        for change in changes if every else []:
            print(f"    {change}")
    print("; ".join(f"{count} {what}" for what, count in counts.items() if count))
    return not (counts["changed"] or counts["missing"])


def times(cases: Sequence[Case], folder: Path) -> None:
    """A table of the processor time before and now, of each case and of each command."""
    totals: dict[str, list[float]] = {}
    print(f"\n{'case':<56} {'before s':>9} {'now s':>9} {'ratio':>6}")
    for case in cases:
        both = [running.kept(folder / run / case.name) for run in (BEFORE, NOW)]
        if both[0] is None or both[1] is None:
            continue
        spent = [one["cpu"] for one in both if one]
        print(_row(case.name, *spent))
        for key in (case.command, "all"):
            total = totals.setdefault(key, [0.0, 0.0])
            totals[key] = [a + b for a, b in zip(total, spent, strict=True)]
    print()
    for name, (before, now) in totals.items():
        print(_row(name, before, now))


def _row(name: str, before: float, now: float) -> str:
    return f"{name:<56} {before:>9.1f} {now:>9.1f} {now / max(before, 1e-9):>6.2f}"


def main(argv: list[str] | None = None) -> int:
    """Write, check, or both; 1 where a number changed by more than a sum over threads may change it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.frozen", description=SAYS)
    task = parser.add_mutually_exclusive_group(required=True)
    part = {"nargs": "?", "const": "quick", "choices": list(PARTS)}
    task.add_argument("--write", **part, help="run a part and keep its answers")
    task.add_argument("--check", **part, help="run a part and compare with the answers kept")
    task.add_argument(
        "--against", metavar="COMMIT", help="run a commit too, where it has no answers, and compare"
    )
    parser.add_argument("--part", choices=list(PARTS), default="quick", help="with --against")
    parser.add_argument("--answers", type=Path, default=Path("frozen-out"), help="folder  [frozen-out]")
    parser.add_argument("--only", metavar="GLOB", help="cases with such a name")
    parser.add_argument("--jobs", type=int, default=1, help="cases at a time  [1]")
    parser.add_argument("--again", action="store_true", help="run also what this source has answered")
    parser.add_argument("--times", action="store_true", help="tell the processor time before and now")
    parser.add_argument("--every", action="store_true", help="tell every change, not only the largest")
    given = parser.parse_args(argv)
    folder, shared = given.answers.resolve(), shared_data()
    if shared is None:
        print("No shared/data beside the repository: cases of it are skipped.")
    if given.check and not (folder / BEFORE).is_dir():
        print(
            f"{given.answers}: no answers; check out the earlier commit and run `python -m benchmarks.frozen "
            f"--write {given.check} --answers FOLDER` there, or use --against COMMIT",
            file=sys.stderr,
        )
        return 2
    cases = chosen(given.write or given.check or given.part, given.only, ROOT, shared)

    def run(checkout: Path, name: str) -> None:
        running.run_all(cases, Place(checkout, folder, name, shared), jobs=given.jobs, again=given.again)

    if given.write:
        run(ROOT, BEFORE)
        return 0
    if given.against:
        with checkout_of(given.against) as checkout:
            run(checkout, BEFORE)
    run(ROOT, NOW)
    same = report(cases, folder, given.every)
    if given.times:
        times(cases, folder)
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
