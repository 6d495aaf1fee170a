"""Code of the current folder is not run: by the command, and by the interpreters that are started."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gtr_jax import interpreters
from gtr_jax.interpreters import ROOT, program, search_path, started_safely, surroundings

LIBRARY = os.path.dirname(os.__file__)
# What the command, its readers and workers import, or would if it lay in the current folder.
PLANTED = ("polars", "h5py", "multiprocessing", "struct", "socket", "random", "gtr_jax", "calibrate")


@pytest.fixture
def handed_over(tmp_path, monkeypatch):
    """A folder that somebody hands over, as the current one, with code that tells when it is run."""
    import polars

    time = np.linspace(0.0, 10.0, 60)
    T_base = np.interp(time, [0.0, 5.0, 10.0], [0.0, 8.0, 1.0])
    table = polars.DataFrame({"time_s": time, "T_base_N": T_base, "T_tip_N": 0.8 * T_base})
    folder = tmp_path / "handed over"
    folder.mkdir()
    table.write_parquet(folder / "rec.parquet")
    for name in PLANTED:
        (folder / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r} + ' ')\n")
    monkeypatch.chdir(folder)
    return folder


def ran(folder):
    """Which of the planted files were run."""
    told = folder.parent / "ran"
    return told.read_text() if told.exists() else ""


READ = "print(gtr_jax.read_recording('rec.parquet').T_tip.max())"


@pytest.mark.parametrize("beside", [False, True])
def test_a_table_is_read_by_no_code_of_its_folder(handed_over, beside):
    """Also by a process that has the current folder first on its path, as a notebook has."""
    script = handed_over.parent / "script.py"
    late = "sys.path.insert(0, '')" if beside else ""
    script.write_text(f"import sys, struct, socket, random, gtr_jax.recordings.recording\n{late}\n{READ}\n")
    env = os.environ | {"PYTHONPATH": ROOT}
    done = subprocess.run([sys.executable, script], env=env, capture_output=True, text=True, timeout=120)
    assert done.stdout.startswith("6.3"), done.stderr
    assert ran(handed_over) == ""


@pytest.mark.parametrize("module", [False, True])
def test_the_command_runs_no_code_of_the_current_folder(handed_over, module):
    """Nor where PYTHONPATH has an empty part, which Python takes for the current folder."""
    for name in ("gtr_jax", "calibrate"):  # which `python -m gtr_jax` itself would run
        (handed_over / f"{name}.py").unlink()
    script = handed_over.parent / "gtr"  # as pip writes it
    script.write_text("import sys\nfrom gtr_jax.app.cli import main\nsys.exit(main())\n")
    start, more = (["-m", "gtr_jax"], "") if module else ([script], os.pathsep)
    env = os.environ | {"PYTHONPATH": f"{ROOT}{more}"}
    done = subprocess.run(
        [sys.executable, *start, "inspect", "rec.parquet", "-o", "out"],
        env=env,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, ran(handed_over)) == (0, ""), done.stderr
    assert (handed_over / "out" / "run.json").exists()


def test_processes_that_libraries_start_run_no_code_of_the_current_folder(handed_over):
    """As `multiprocessing` starts the workers of a sweep."""
    command = [sys.executable, "-c", "from multiprocessing.spawn import spawn_main"]
    subprocess.run(command, stderr=subprocess.DEVNULL, timeout=60)
    assert "multiprocessing" in ran(handed_over)
    (handed_over.parent / "ran").unlink()
    with started_safely():
        subprocess.run(command, timeout=60, check=True)
    assert ran(handed_over) == ""


def test_the_path_keeps_what_the_user_names_and_what_is_installed(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    here, own, packages = str(tmp_path), "/home/u/own", f"{LIBRARY}/site-packages"
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([own, "", "lib"]))
    # As Python makes it of that: of parts that are not whole paths, from the current folder.
    path = [here, own, here, f"{here}/lib", LIBRARY, packages]
    assert search_path(path) == [own, LIBRARY, packages]
    # Packages under development are installed by naming their folder, behind the library.
    assert search_path([*path, here]) == [own, LIBRARY, packages, here]
    assert search_path(["", *path[1:2], LIBRARY, packages]) == [own, LIBRARY, packages]
    monkeypatch.setenv("PYTHONPATH", here)
    assert search_path([here, here, LIBRARY]) == [here, here, LIBRARY]
    # A checkout that is not installed.
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.setattr(interpreters, "ROOT", here)
    assert search_path([here, LIBRARY]) == [here, LIBRARY]


def test_the_environment_is_as_before_afterwards(monkeypatch):
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    monkeypatch.setenv("PYTHONPATH", "/one")
    monkeypatch.setattr(sys, "path", ["/one", f"/a{os.pathsep}b", "c", LIBRARY])
    with started_safely():
        assert os.environ["PYTHONSAFEPATH"] == "1"
        assert os.environ["PYTHONPATH"] == os.pathsep.join(["/one", LIBRARY])
        assert surroundings()["PYTHONPATH"] == os.environ["PYTHONPATH"]
    assert "PYTHONSAFEPATH" not in os.environ and os.environ["PYTHONPATH"] == "/one"


def test_a_program_of_the_current_folder_is_not_found(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("tool").write_text("#!/bin/sh\n")
    Path("tool").chmod(0o755)
    for path in (".", "", f".{os.pathsep}", os.pathsep):
        monkeypatch.setenv("PATH", path)
        assert program("tool") is None
    monkeypatch.setenv("PATH", os.pathsep.join([".", str(tmp_path)]))
    assert program("tool") == str(tmp_path / "tool")


def started(path):
    """Calls of a file that start a process with a list as its command, or interpreters by a library."""
    calls = {"run", "Popen", "check_output", "check_call", "call", "system", "execv", "execve"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            of = node.func.value
            if isinstance(of, ast.Name) and of.id in ("subprocess", "os") and node.func.attr in calls:
                yield ast.unparse(node)


@pytest.mark.parametrize("package", ["gtr_jax", "calibrate", "design", "examples", "benchmarks"])
def test_every_interpreter_is_started_without_the_current_folder(package):
    """`sys.executable` stands in `interpreters` and beside the flag -P only; pools are made in its block."""
    for path in sorted((Path(ROOT) / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        where = str(path.relative_to(ROOT))
        for call in started(path):
            assert "sys.executable" not in call or "'-P'" in call, f"{where}: {call}"
            assert "'python" not in call, f"{where}: {call}"
        if "get_context(" in text or "LocalCluster(" in text:
            assert "started_safely()" in text, where
