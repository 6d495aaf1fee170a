"""What killed processes leave is removed, and never what is at work."""

import os
import subprocess
import sys
import time

import pytest

from gtr_jax import leftovers
from gtr_jax.leftovers import beside, clear, replaced_atomically

pytestmark = pytest.mark.skipif(os.name != "posix", reason="processes cannot be asked for there")


@pytest.fixture(scope="module")
def ended():
    """The number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def of(pid, path, ending="part"):
    """The name that another process would have given."""
    return path.with_name(beside(path, ending).name.replace(f"-{os.getpid()}-", f"-{pid}-"))


def test_what_a_killed_process_left_is_removed(tmp_path, ended):
    for name in ("file", "folder"):
        left = of(ended, tmp_path / name)
        if name == "folder":
            (left / "deep").mkdir(parents=True)
            (left / "deep" / "file").write_text("")
        else:
            left.write_text("")
    of(ended, tmp_path / "view", "html").write_text("")
    (tmp_path / ".other.part").write_text("")
    clear(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".other.part"]


def test_what_is_at_work_stays(tmp_path, ended, monkeypatch):
    beside(tmp_path / "own").write_text("")
    of(os.getppid(), tmp_path / "parent").mkdir()
    of(1, tmp_path / "first").mkdir()
    with monkeypatch.context() as elsewhere:  # a machine that shares the folder
        elsewhere.setattr(leftovers, "_machine", lambda: "0" * 8)
        of(ended, tmp_path / "elsewhere").mkdir()
    before = sorted(tmp_path.iterdir())
    clear(tmp_path)
    assert sorted(tmp_path.iterdir()) == before and len(before) == 4


def test_what_stood_before_the_machine_was_started_is_removed(tmp_path, monkeypatch):
    with monkeypatch.context() as earlier:
        earlier.setattr(leftovers, "_start", lambda: "0" * 6)
        names = [of(1, tmp_path / name) for name in ("before", "twin")]
    for name in names:
        name.write_text("")
    long_ago = time.time() - 1e9
    os.utime(names[0], (long_ago, long_ago))
    clear(tmp_path)
    assert [*tmp_path.iterdir()] == names[1:]  # of a machine with the same names that is at work


def test_a_folder_moved_aside_gets_its_name_back(tmp_path, ended):
    for name in ("lost", "there"):
        old = of(ended, tmp_path / name, "old")
        old.mkdir()
        (old / "answer").write_text(name)
    (tmp_path / "there").mkdir()
    clear(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lost", "there"]
    assert (tmp_path / "lost" / "answer").read_text() == "lost"
    assert not [*(tmp_path / "there").iterdir()]


KILLED = """
import os, signal, sys
from pathlib import Path
from gtr_jax.app.cli.run_folder import RunFolder
from gtr_jax.leftovers import replaced_atomically
with RunFolder(Path("out"), {}, with_jax=False).write() as part, replaced_atomically("file") as whole:
    (part / "report.html").write_text("half")
    whole.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_next_run_removes_what_a_killed_one_left(tmp_path, monkeypatch):
    from gtr_jax.app.cli.run_folder import RunFolder

    subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path, timeout=120)
    assert len([*tmp_path.glob(".*.part")]) == 2
    monkeypatch.chdir(tmp_path)
    with RunFolder(tmp_path / "another", {}, with_jax=False).write():
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["another"]


def test_threads_do_not_write_to_the_same_temporary_file(tmp_path):
    with replaced_atomically(tmp_path / "file") as one, replaced_atomically(tmp_path / "file") as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
