"""The run folder: written whole or not at all, and never over another command's files or somebody else's."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import platform
import shlex
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError, listed
from gtr_jax.interruption import interruption
from gtr_jax.leftovers import beside, clear
from gtr_jax.recordings.formats.text import digest
from gtr_jax.to_jsonable import to_jsonable

from .options import HELD, own_terms

if TYPE_CHECKING:
    from gtr_jax.report.page import Report

MARK = "run.json"
FIGURES = "figures"  # folder of the figures for papers
PACKAGES = ("gtr-jax", "jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")


class RunFolder:
    """Where a command writes its answer.

    Made, and refused, before anything is computed; `write` then gives a temporary folder beside it, which
    takes its place when everything is in it.

    Args:
        out: the folder the user named.
        inputs: files the command reads, by role; their hashes are recorded.
        force: replace whatever the folder holds, but for inputs of this command and folders that are in use.
        with_jax: whether JAX computes the answer, whose device is then recorded.
        command: as the user may type it again, of a script; that of `gtr` unless given.
    """

    def __init__(
        self,
        out: Path,
        inputs: Mapping[str, Path],
        *,
        force: bool = False,
        with_jax: bool = True,
        command: str = "",
    ) -> None:
        self.path = out
        self._with_jax = with_jax
        self.record = {
            "written_by": "gtr-jax",
            "command": command or command_line(),
            "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "inputs": {
                role: {"path": _named(path), "sha256": digest(path)}
                for role, path in {**inputs, **own_terms()}.items()
            },
        }
        self._began = time.monotonic()
        self._target = out.resolve()
        clear(self._target.parent)
        _refuse_unless_ours(out, self._target, inputs, _subcommand(self.record["command"]), force)

    def settings(self) -> dict[str, Any]:
        """What made the answer: command, versions, device, hashes of the inputs."""
        return {**self.record, "versions": versions(self._with_jax)}

    @property
    def steps(self) -> Path:
        """File beside the folder for what a long run has done, should it be interrupted."""
        return self._target.with_name(f".{self._target.name}.steps")

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """Keep other processes from going on with the same long run at the same time; refused if one does."""
        import filelock

        path = self._target.with_name(f".{self._target.name}.lock")
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(path, blocking=False)
        try:
            lock.acquire()
        except filelock.Timeout:
            raise InputError(
                f"-o {self.path}: another gtr is at work on it ({path.name} is locked); wait until it ends, "
                "or choose another folder"
            ) from None
        except OSError:
            pass  # a disk without locks: released below is what is held
        try:
            yield
        finally:
            # While it is held, so that nobody holds a file that is gone.
            with contextlib.suppress(OSError):
                path.unlink()
            lock.release()

    @contextlib.contextmanager
    def write(self, adopted: Mapping[str, Path] | None = None) -> Iterator[Path]:
        """A folder to write into; it becomes the run folder on leaving, or vanishes if that fails.

        Args:
            adopted: folders, by the name they get, that are moved into it at the end; they are moved back if
                it fails. Nothing else may be written into them afterwards.
        """
        with _said(self.path):
            yield from self._written(adopted)

    def _written(self, adopted: Mapping[str, Path] | None) -> Iterator[Path]:
        target = self._target
        target.parent.mkdir(parents=True, exist_ok=True)
        part, old = beside(target), beside(target, "old")
        part.mkdir()
        try:
            with interruption.undoing(lambda: shutil.rmtree(part, ignore_errors=True)):
                yield part
            seconds = time.monotonic() - self._began
            files = sorted(str(p.relative_to(part)) for p in part.rglob("*") if p.is_file())
            files += [MARK, *(f"{name}/" for name in adopted or ())]
            write_json(part / MARK, {**self.settings(), "seconds": round(seconds, 2), "files": files})
            places = {part / name: path for name, path in (adopted or {}).items()}
            with interruption.held():
                with _moved(places):
                    _take_place(part, target, old)
                interruption.says = f"interrupted: {self.path} is written"
        finally:
            shutil.rmtree(part, ignore_errors=True)


@contextlib.contextmanager
def _said(out: Path) -> Iterator[None]:
    """What the system says against writing a run folder as a line that names it."""
    try:
        yield
    except OSError as fault:
        where = f" ({fault.filename})" if fault.filename else ""
        raise InputError(f"-o {out}: {fault.strerror or fault}{where}; choose another place") from None


@contextlib.contextmanager
def _moved(places: Mapping[Path, Path]) -> Iterator[None]:
    """Folders moved to where they belong, and back if what follows fails."""
    try:
        for place, path in places.items():
            path.rename(place)
        yield
    except BaseException:
        for place, path in places.items():
            if place.exists():
                place.rename(path)
        raise


def _take_place(part: Path, target: Path, old: Path) -> None:
    try:
        if target.exists():
            target.rename(old)
        part.rename(target)
    except BaseException:
        if old.exists() and not target.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _refuse_unless_ours(
    out: Path, target: Path, inputs: Mapping[str, Path], command: str, force: bool
) -> None:
    """InputError if what the folder holds may not be replaced by a run of this command."""
    if target.exists() and not target.is_dir():
        raise InputError(f"-o {out}: is a file, not a folder; choose another name")
    standing = next(parent for parent in target.parents if parent.exists())
    if not standing.is_dir():
        raise InputError(f"-o {out}: {standing} is a file, not a folder; choose another name")
    ours, made_by = _record_of(target / MARK)
    adopted = tuple(name for name in ours if name.endswith("/"))
    held = sorted(_held(target, adopted)) if target.exists() else []
    if not held:
        return
    foreign = [name for name in held if name not in ours]
    for path in inputs.values():
        if path.resolve().is_relative_to(target):
            raise InputError(
                f"-o {out}: holds the input {path}, which would be replaced; choose another folder"
            )
    if force:
        for place, what in ((Path.cwd(), "the folder you are in"), (Path.home(), "your home folder")):
            if place.resolve().is_relative_to(target):
                raise InputError(f"-o {out}: {what} is not replaced, not by --force either; choose another")
        return
    if not ours:
        raise InputError(
            f"-o {out}: not a run folder of gtr ({listed(held, 3)} in it); choose a new or empty folder, or "
            "replace it with --force"
        )
    if foreign:
        raise InputError(
            f"-o {out}: holds files not written by gtr ({listed(foreign, 3)}); move them, choose another "
            "folder, or replace all with --force"
        )
    if command and made_by != command:
        raise InputError(
            f"-o {out}: holds a run of 'gtr {made_by}', not of 'gtr {command}'; choose another folder, or "
            "replace it with --force"
        )


def _held(target: Path, adopted: tuple[str, ...]) -> Iterator[str]:
    """Names of the files in a folder, but for those in the folders it has adopted."""
    for folder, inner, files in os.walk(target):
        beneath = Path(folder).relative_to(target)
        inner[:] = [name for name in inner if f"{beneath / name}/" not in adopted]
        yield from (str(beneath / name) for name in files)


def _record_of(mark: Path) -> tuple[set[str], str]:
    """The files of a run folder, and the command that wrote it; none of a folder that is not one."""
    try:
        record = json.loads(mark.read_text(encoding="utf-8"))
        if record["written_by"] == "gtr-jax":
            return set(record["files"]), _subcommand(record["command"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return set(), ""


def _subcommand(line: str) -> str:
    """Which of its commands a command line of `gtr` runs; "" of a script that writes a run folder itself."""
    words = shlex.split(line)
    return words[1] if len(words) > 1 and words[0] == "gtr" else ""


def _named(path: Path) -> str:
    """How the user named an input."""
    context = click.get_current_context(silent=True)
    return "-" if context and context.meta.get(HELD) == path else str(path)


def command_line() -> str:
    """The command as the user may type it again."""
    context = click.get_current_context(silent=True)
    return shlex.join(["gtr", *(context.obj if context and context.obj else sys.argv[1:])])


def versions(with_jax: bool = True) -> dict[str, str]:
    """Versions of what computed the answer, and, if JAX did, on what."""
    computed_on = {}
    if with_jax:
        import jax

        computed_on = {"device": jax.devices()[0].device_kind}
    return {
        "python": platform.python_version(),
        **{name: version(name) for name in PACKAGES},
        **computed_on,
        "system": f"{platform.system()} {platform.machine()}",
    }


def write_json(path: Path, data: Any) -> None:
    """Write JSON; a number that is not finite becomes null, which JSON can hold."""
    path.write_text(
        json.dumps(to_jsonable(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
    )


def write_report(
    folder: Path,
    report: Report,
    settings: Mapping[str, Any],
    robot: str | None,
    *,
    figures: Sequence[str] = (),
) -> None:
    """Write a report's pictures and its page.

    Args:
        folder: to write into.
        report: what it says.
        settings: as of `render`.
        robot: text of the robot file, which the page shows, if there is one.
        figures: endings of the files for papers that are written of each picture, see `plots.printed`.
    """
    from gtr_jax.plots.printed import printed
    from gtr_jax.report.page import render

    for ending in dict.fromkeys(figures):
        (folder / FIGURES).mkdir(exist_ok=True)
        for figure in report.all_figures:
            (folder / FIGURES / f"{figure.name}.{ending}").write_bytes(printed(figure.drawn, ending))

    for figure in report.all_figures:
        (folder / f"{figure.name}.png").write_bytes(figure.image)
    (folder / "report.html").write_text(render(report, settings, robot), encoding="utf-8")
