"""Fits and diagnoses from the page: the same commands as at the command line, in a process of their own."""

from __future__ import annotations

import dataclasses
import shlex
import signal
import subprocess
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from gtr_jax.config.config import RobotConfig, dump_config
from gtr_jax.interpreters import python, surroundings

ANSWERED = (0, 1)  # exit statuses of a command that has written its run folder


@dataclasses.dataclass(frozen=True)
class Done:
    """A command that has ended.

    Attributes:
        folder: the run folder.
        says: what it printed, a line each; of one that failed, why.
        answered: whether the run folder is written.
        robots: the robot files that it found, the first the best.
    """

    folder: Path
    says: list[str]
    answered: bool
    robots: list[Path]


class Run:
    """A command at work on the robot as the page has it.

    Args:
        command: "fit" or "diagnose".
        config: the robot.
        recording: its file.
        options: what follows at the command line, for example the free numbers.
        out: where robot file and run folder are written, under names that are not taken.
        progress: called from another thread with each stage that the command reports.
        done: called from there when it has ended.
    """

    def __init__(
        self,
        command: str,
        config: RobotConfig,
        recording: Path,
        options: Sequence[str],
        *,
        out: Path,
        progress: Callable[[str], None],
        done: Callable[[Done], None],
    ) -> None:
        self.folder = free_name(out, command)
        robot = self.folder.with_suffix(".toml")
        out.mkdir(parents=True, exist_ok=True)
        dump_config(config, robot, note=f"The robot as `gtr view` gave it to gtr {command}.")
        arguments = [command, str(robot), str(recording), *options, "-o", str(self.folder)]
        self.line = shlex.join(["gtr", *arguments])
        self._progress, self._done, self._stopped = progress, done, False
        self._process = subprocess.Popen(
            python("-m", "gtr_jax", *arguments),
            env=surroundings(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            # So that Ctrl-C in the terminal reaches it through `stop` only, which lets it end in order.
            start_new_session=True,
        )
        threading.Thread(target=self._follow, name=f"gtr {command}", daemon=True).start()

    def stop(self) -> None:
        """Interrupt the command, as Ctrl-C does; the second time end it at once."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM if self._stopped else signal.SIGINT)
        self._stopped = True

    def wait(self, seconds: float) -> None:
        """Wait until it has ended, and end it if that takes longer."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _follow(self) -> None:
        assert self._process.stdout is not None and self._process.stderr is not None
        last = ""
        for line in self._process.stderr:
            last = line.strip() or last
            self._progress(last)
        printed = [line.strip() for line in self._process.stdout if line.strip()]
        answered = self._process.wait() in ANSWERED and self.folder.is_dir()
        says = printed if answered else [last or "the command ended without a message"]
        self._done(Done(self.folder, says, answered, _robots(self.folder) if answered else []))


def free_name(out: Path, stem: str) -> Path:
    """A path in a folder, `stem` with the next number, that neither a file nor a run folder has."""
    number = 1
    while (path := out / f"{stem}-{number}").exists() or path.with_suffix(".toml").exists():
        number += 1
    return path


def _robots(folder: Path) -> list[Path]:
    """The robot files that a fit or a diagnosis found."""
    return [*folder.glob("fitted.toml"), *sorted(folder.glob("diagnosed*.toml"))]
