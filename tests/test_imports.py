"""Imports go down only: which folder may import which, and no circle of files or of folders."""

import ast
import itertools
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gtr_jax

ROOT = Path(__file__).parents[1]
PACKAGES = ("gtr_jax", "calibrate", "design")
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]

# The door of a package is its __init__.py, in which its users find their names.
DOOR = {package: f"{package} (door)" for package in PACKAGES}

NAMED = re.compile(r"`([^`]+)`")


def rows() -> list[tuple[list[str], str]]:
    """The table of CONTRIBUTING.md: folders, and what these may import."""
    lines = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines()
    start = lines.index("| folder | may import |") + 2
    cells = [
        line.strip("|").split("|") for line in itertools.takewhile(lambda s: s[:1] == "|", lines[start:])
    ]
    return [(NAMED.findall(folders), imports) for folders, imports in cells]


def allowed() -> dict[str, set[str]]:
    """What each folder may import besides itself."""
    table: dict[str, set[str]] = {}
    for folders, imports in ROWS:
        same = [table[other] for other in re.findall(r"as `([^`]+)`", imports)]
        table |= {folder: set(NAMED.findall(imports)).union(*same) for folder in folders}
    return table


ROWS = rows()
ALLOWED = allowed()


def files_by_module() -> dict[str, Path]:
    """Every file by the name it is imported under."""
    found = {}
    for path in FILES:
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = files_by_module()


def room(path: Path) -> str:
    """The folder a file belongs to, as `ALLOWED` names it."""
    *folders, file = path.relative_to(ROOT).with_suffix("").parts
    if len(folders) == 1 and file == "__init__":
        return DOOR[folders[0]]
    if folders == ["gtr_jax"]:
        return "app.cli" if file == "__main__" else "base"  # `python -m gtr_jax` is the command
    return ".".join(folders[1:] if folders[0] == "gtr_jax" else folders)


def imported(path: Path) -> set[str]:
    """Full names of what a file imports, within functions and for type checks too."""
    package = path.relative_to(ROOT).parent.parts
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            stem = package[: len(package) + 1 - node.level] if node.level else ()
            module = ".".join([*stem, *([node.module] if node.module else [])])
            whole = {f"{module}.{alias.name}" for alias in node.names}
            names |= whole if whole <= {*MODULES} else whole | {module}
    return names


def own_imports(path: Path) -> set[Path]:
    """The files of this project that a file imports."""
    return {MODULES[name] for name in imported(path) & {*MODULES}} - {path}


def run_by_importing(path: Path) -> set[Path]:
    """What importing a file runs besides it: the files that it imports, and each `__init__.py` above these;
    but for those of its own folders and of the packages, which have begun before it.
    """
    found = own_imports(path)
    folders = {folder for file in found for folder in file.relative_to(ROOT).parents}
    folders -= {Path(), *map(Path, PACKAGES), *path.relative_to(ROOT).parents}
    return (found | {ROOT / folder / "__init__.py" for folder in folders}) - {path}


def circle(below: dict) -> list:
    """A way through a graph that comes back to where it began; empty if there is none."""
    done, way = set(), []

    def visit(node):
        if node in way:
            return [*way[way.index(node) :], node]
        if node in done:
            return []
        way.append(node)
        for other in sorted(below.get(node, ())):
            if found := visit(other):
                return found
        done.add(way.pop())
        return []

    return next((found for node in below if (found := visit(node))), [])


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_folder_imports_only_what_it_may(path):
    own = room(path)
    others = {room(other): other.relative_to(ROOT) for other in own_imports(path)}
    assert own in ALLOWED, "a new folder: say in the table of CONTRIBUTING.md what it may import"
    assert not {name: file for name, file in others.items() if name not in ALLOWED[own] | {own}}


def test_no_file_imports_itself_by_way_of_others():
    names = {path: str(path.relative_to(ROOT)) for path in FILES}
    assert circle({names[path]: {names[other] for other in run_by_importing(path)} for path in FILES}) == []


def test_no_folder_imports_itself_by_way_of_others():
    below: dict[str, set[str]] = {}
    for path in FILES:
        below.setdefault(room(path), set()).update(room(other) for other in own_imports(path))
    assert circle({own: others - {own} for own, others in below.items()}) == []


def test_the_table_names_only_what_is_imported():
    for folders, imports in ROWS:
        own = [path for path in FILES if room(path) in folders]
        assert {*NAMED.findall(imports)} <= {room(other) for path in own for other in own_imports(path)}, (
            folders
        )


def test_what_the_table_allows_has_no_circle_either():
    assert set().union(*ALLOWED.values()) <= {*ALLOWED}
    assert circle(ALLOWED) == []


def test_circles_are_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_the_walker_sees_imports_of_every_kind():
    assert "gtr_jax.recordings.formats.table" in imported(ROOT / "gtr_jax/recordings/recording.py")
    assert "gtr_jax.app.cli.fit" in imported(ROOT / "gtr_jax/app/cli/demo.py")
    assert "gtr_jax.config.sections" in imported(ROOT / "gtr_jax/config/midline.py")  # for type checks only
    assert "calibrate.report.fit" in imported(ROOT / "gtr_jax/app/cli/fit.py")  # within a function


HEAVY = {
    "jax",
    "numpy",
    "scipy",
    "pint",
    "pydantic",
    "equinox",
    "matplotlib",
    "pandas",
    "xarray",
    "rich",
    "jinja2",
    "bokeh",
    "ezdxf",
}


def output_of(code: str, **environment: str) -> str:
    """The last line that a Python process prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env=os.environ | environment,
    )
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["simulate", "--help"], ["sweep", "--help"]]
)
def test_the_command_line_is_built_without_anything_heavy(arguments):
    heavy = HEAVY | {"calibrate", "design", "gtr_jax.config", "gtr_jax.recordings", "gtr_jax.terms"}
    code = "import sys; from gtr_jax.app.cli import main;"
    code += f"main({arguments}); print(sorted({heavy} & {{*sys.modules}}))"
    assert output_of(code) == "[]"


def test_the_package_shows_its_names_and_imports_them_when_they_are_used():
    code = (
        "import sys, gtr_jax as gtr; before = 'jax' in sys.modules;"
        "print(before, {*gtr.__all__} <= {*dir(gtr)}, gtr.InputError.__module__, 'jax' in sys.modules,"
        "callable(gtr.equilibrium), 'jax' in sys.modules)"
    )
    assert output_of(code) == "False True gtr_jax.errors False True True"
    for name in gtr_jax.__all__:
        assert getattr(gtr_jax, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gtr_jax.__getattr__("nothing")


def test_type_checkers_and_users_import_names_from_the_same_files():
    tree = ast.parse((ROOT / "gtr_jax/__init__.py").read_text(encoding="utf-8"))
    checked = next(node for node in tree.body if isinstance(node, ast.If)).body
    imports = [node for node in checked if isinstance(node, ast.ImportFrom)]
    assert {node.module: tuple(a.name for a in node.names) for node in imports} == gtr_jax.FILES
    assert sorted(name for names in gtr_jax.FILES.values() for name in names) == gtr_jax.__all__


@pytest.mark.parametrize(
    "first",
    [
        "import gtr_jax, jax",
        "import jax, gtr_jax",
        "import gtr_jax.units, jax",
        "from gtr_jax import equilibrium; import jax",
        "import jax, calibrate",
    ],
)
def test_jax_is_set_up_whoever_imports_it(first):
    code = f"import os; {first}; import jax.numpy as jnp; print(jnp.ones(1).dtype, os.environ['XLA_FLAGS'])"
    dtype, flags = output_of(code, JAX_ENABLE_X64="0", XLA_FLAGS="").split(" ", 1)
    assert dtype == "float64" and "small_while_loop" in flags


@pytest.mark.parametrize(
    ("given", "warned"),
    [("", 1), ("--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=9", 0)],
)
def test_flags_stay_as_they_are_once_jax_has_computed(given, warned):
    code = (
        "import os, warnings, jax.numpy as jnp; jnp.ones(1)\n"
        "with warnings.catch_warnings(record=True) as caught:\n"
        "    warnings.simplefilter('always')\n"
        "    import gtr_jax, calibrate\n"
        "own = [w for w in caught if 'import gtr_jax before' in str(w.message)]\n"
        "files = {os.path.basename(w.filename) for w in own} - {'<string>'}\n"
        "print(len(own), files, jnp.ones(1).dtype, os.environ['XLA_FLAGS'])"
    )
    out = output_of(code, JAX_ENABLE_X64="0", XLA_FLAGS=given)
    assert out == f"{warned} set() float64 {given}"
