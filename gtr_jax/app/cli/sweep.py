"""`gtr sweep`: many robots, loads and histories into one labelled store."""

from __future__ import annotations

import contextlib
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from gtr_jax.errors import InputError

from .options import OUTPUT_HELP, figures_option, force_option

if TYPE_CHECKING:
    from gtr_jax.sweep.run import Done, Estimate
    from gtr_jax.sweep.store import Store
    from gtr_jax.sweep.task import Task

    from .run_folder import RunFolder


@click.command()
@click.argument("sweep", metavar="SWEEP.toml", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    type=click.Path(path_type=Path),
    help=OUTPUT_HELP,
)
@force_option
@click.option("--dry-run", is_flag=True, help="Only say how many points, blocks, bytes and how much time.")
@click.option(
    "--threads", type=int, metavar="N", help="Threads of this process.  [default: as many as cores]"
)
@click.option("--workers", type=int, metavar="N", help="Compute in N processes on this machine, by Dask.")
@click.option("--scheduler", metavar="ADDRESS", help="Compute by the workers of this Dask scheduler.")
@click.option(
    "--part",
    metavar="I/N",
    help="Compute only the I-th of N parts of the blocks, and leave finishing to a last run without --part: "
    "for job arrays on a shared disk.",
)
@click.option("--plot/--no-plot", default=True, show_default=True, help="Draw the answer.")
@figures_option
def sweep(
    sweep: Path,
    output: Path | None,
    force: bool,
    dry_run: bool,
    threads: int | None,
    workers: int | None,
    scheduler: str | None,
    part: str | None,
    plot: bool,
    figures: Sequence[str],
) -> int:
    """Compute every point of SWEEP.toml and store what it asks for in OUT/sweep.zarr.

    The store opens as an xarray dataset: gtr_jax.sweep.open_sweep("OUT"). A sweep that was interrupted
    resumes where it stopped when the same command runs again.
    """
    from gtr_jax.cache import enable_cache
    from gtr_jax.sweep import load_sweep, task_of
    from gtr_jax.sweep.task import inputs_of

    from .progress import Progress, kept
    from .run_folder import RunFolder

    how = How(threads, workers, scheduler, None if part is None else _numbers(part))
    _check(how, output, dry_run)
    _check_figures(figures, plot, {"--dry-run": dry_run, "--part": how.part is not None})
    file = load_sweep(sweep)
    enable_cache()
    task = task_of(file)
    if dry_run:
        from gtr_jax.sweep.run import estimate

        with Progress() as progress:
            progress("compiling and timing a block")
            click.echo(said(task, estimate(task, how.threads or 0)))
        return 0
    assert output is not None
    folder = RunFolder(output, {"sweep": sweep, **inputs_of(file)}, force=force)
    # The parts of a job array work on one store.
    alone = contextlib.nullcontext() if how.part else folder.alone()
    with alone, kept(), Progress() as progress:
        store = _store(folder, output, task)
        progress("preparing")
        store.create()
        left = store.left()
        if left and len(left) < task.plan.blocks:
            click.echo(
                f"resuming the interrupted run: {task.plan.blocks - len(left)} blocks are there already",
                err=True,
            )
        done = _compute(task, store, how.own(left), sweep, how, progress)
        for block, fault in done.lost[:3]:
            click.echo(f"error: block {block} was not computed: {fault}", err=True)
        if done.lost or how.part is not None:
            return _unfinished(store, done, how)
        return _finish(folder, output, task, store, done, plot, figures, progress)


class How(NamedTuple):
    """By what a sweep is computed: threads, workers or a scheduler's; and which of how many parts."""

    threads: int | None
    workers: int | None
    scheduler: str | None
    part: tuple[int, int] | None

    def own(self, blocks: list[int]) -> list[int]:
        """Those of some blocks that are of this part."""
        if self.part is None:
            return blocks
        i, n = self.part
        return [block for block in blocks if block % n == i - 1]


def _check(how: How, output: Path | None, dry_run: bool) -> None:
    """Refuse options that do not go together."""
    if output is None and not dry_run:
        raise InputError("-o: missing; name the folder to write, for example -o out, or ask for --dry-run")
    ways = {"--threads": how.threads, "--workers": how.workers, "--scheduler": how.scheduler}
    given = [name for name, value in ways.items() if value is not None]
    if len(given) > 1:
        raise InputError(f"{given[1]}: has no effect with {given[0]}; leave one of the two out")
    for name in ("--threads", "--workers"):
        value = ways[name]
        if isinstance(value, int) and value < 1:
            raise InputError(f"{name}: must be 1 or more, is {value}; 2 for example")
    if how.part is not None and given and given[0] != "--threads":
        raise InputError(f"--part: has no effect with {given[0]}; leave one of the two out")
    if dry_run and (how.part or how.workers or how.scheduler):
        raise InputError("--dry-run: times this process alone; leave --part, --workers and --scheduler out")


def _check_figures(figures: Sequence[str], plot: bool, without: Mapping[str, bool]) -> None:
    """Refuse to write figures where none are drawn."""
    reasons = {"--no-plot": not plot, **without}
    for name in (name for name, given in reasons.items() if given and figures):
        raise InputError(f"--figures: has no effect with {name}, which draws none; leave one of the two out")


def _numbers(part: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", part.strip())
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(f"--part: expected I/N with I from 1 to N, for example 3/16, found '{part}'")
    return int(match[1]), int(match[2])


def _store(folder: RunFolder, output: Path, task: Task) -> Store:
    """The store beside the run folder, or in it, if that of a finished run of the same sweep is there."""
    from gtr_jax.sweep.store import STORE, Store

    finished = output.resolve() / STORE
    if finished.exists() and not folder.steps.exists() and Store(finished, task).same():
        return Store(finished, task)
    return Store(folder.steps, task)


def _compute(
    task: Task,
    store: Store,
    blocks: list[int],
    file: Path,
    how: How,
    progress: Any,
) -> Done:
    if how.workers is None and how.scheduler is None:
        from gtr_jax.sweep.run import run_here

        return run_here(task, store, blocks, progress, how.threads or 0)
    from gtr_jax.sweep.cluster import local_cluster, run_there, their_cluster

    progress("starting workers")
    with local_cluster(how.workers) if how.workers else their_cluster(str(how.scheduler)) as client:
        return run_there(client, file, task, store, blocks, progress)


def _unfinished(store: Store, done: Done, how: How) -> int:
    left = len(store.left())
    rest = f"{left} blocks are left" if left else "every block is there"
    again = "run the command again" if how.part is None else "run the command without --part to finish"
    click.echo(f"{done.points:,} points computed; {rest}: {again}")
    return 1 if done.lost else 0


def said(task: Task, expected: Estimate) -> str:
    """A dry run in words."""
    from gtr_jax.sweep.run import duration

    return (
        f"{expected.points:,} points in {expected.blocks:,} blocks of at most {task.plan.largest:,}; "
        f"{size(expected.bytes)} before compression; estimated time on this machine: "
        f"{duration(expected.seconds)}, after {duration(expected.compiling)} of compiling"
    )


def size(count: int) -> str:
    """Bytes for people."""
    value, units = float(count), ["B", "kB", "MB", "GB", "TB"]
    while value >= 1000 and len(units) > 1:
        value, units = value / 1000, units[1:]
    return f"{value:.3g} {units[0]}"


def _finish(
    folder: RunFolder,
    output: Path,
    task: Task,
    store: Store,
    done: Done,
    plot: bool,
    figures: Sequence[str],
    progress: Any,
) -> int:
    """Write all that a sweep leaves, beside it everything that its file names."""
    from gtr_jax.atomic_write import write_atomically
    from gtr_jax.config.config import config_text, dump_config
    from gtr_jax.report.sweep import sweep_report
    from gtr_jax.sweep.config import sweep_text
    from gtr_jax.sweep.store import STORE, open_sweep
    from gtr_jax.sweep.summary import summary_of
    from gtr_jax.sweep.task import inputs_of, named_beside

    from .run_folder import write_json, write_report

    progress("reading the store through")
    store.clean()
    answer = summary_of(task, store, done)
    progress("drawing" if plot else "writing")
    data = open_sweep(store.path)
    report = sweep_report(answer, task, data, plot=plot)
    data.close()
    settings = folder.settings()
    with folder.write({STORE: store.path}) as part:
        dump_config(task.config, part / "robot.toml")
        for role, path in inputs_of(task.file).items():
            if role != "robot":
                shutil.copyfile(path, part / f"{role}.csv")
        write_atomically(part / "sweep.toml", sweep_text(named_beside(task.file)))
        write_json(part / "sweep.json", {**answer.to_json(), "settings": settings})
        write_report(part, report, settings, config_text(task.config), figures=figures)
    click.echo(answer.says)
    click.echo(f"report: {output / 'report.html'}")
    return 0 if answer.converged else 1
