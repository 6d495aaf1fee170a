"""Imports run one way: gtr_jax <- calibrate, design; inside gtr_jax, mechanics <- plots <- report <- paper,
cli.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("gtr_jax", "calibrate", "design")
# What each may import of the others, at module level.
ALLOWED = {"gtr_jax": set(), "calibrate": {"gtr_jax"}, "design": {"gtr_jax"}}
# Layers of gtr_jax above the mechanics, and which of them each may import at module level.
LAYERS = {
    "plots": set(),
    "sweep": set(),
    "report": {"plots", "examples"},
    "paper": {"report", "plots", "examples"},
    "cli": {"report", "plots", "examples", "sweep"},
    "examples": set(),
}
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path, *, anywhere: bool = False) -> set[str]:
    """Full names of what a file imports, at module level or anywhere; not those for type checks only."""
    package = path.relative_to(ROOT).parent.parts
    names = set()
    pending: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not anywhere:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            stem = package[: len(package) + 1 - node.level] if node.level else ()
            module = ".".join([*stem, *([node.module] if node.module else [])])
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
        pending += ast.iter_child_nodes(node)
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_packages_import_one_way(path):
    own = path.relative_to(ROOT).parts[0]
    others = {name.split(".")[0] for name in imported(path)} & set(PACKAGES) - {own}
    assert others <= ALLOWED[own]


def test_only_the_command_imports_calibrate():
    users = {
        path.relative_to(ROOT).parts[1]
        for path in (ROOT / "gtr_jax").rglob("*.py")
        if {name.split(".")[0] for name in imported(path, anywhere=True)} & {"calibrate", "design"}
    }
    assert users <= {"cli"}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_layers_import_one_way(path):
    parts = path.relative_to(ROOT).parts
    own = parts[1] if parts[0] == "gtr_jax" and len(parts) > 2 else ""
    own = "cli" if parts == ("gtr_jax", "__main__.py") else own  # `python -m gtr_jax` is the command
    above = {n.split(".")[1] for n in imported(path) if n.startswith("gtr_jax.")} & set(LAYERS) - {own}
    assert above <= LAYERS.get(own, set())


def test_the_walker_sees_relative_imports():
    assert "gtr_jax.forces" in imported(ROOT / "gtr_jax/report/simulation.py")
    assert "gtr_jax.cli.fit" in imported(ROOT / "gtr_jax/cli/demo.py")
    assert "calibrate" not in imported(ROOT / "gtr_jax/cli/fit.py")
    assert "calibrate" in imported(ROOT / "gtr_jax/cli/fit.py", anywhere=True)


def test_help_imports_nothing_heavy():
    code = (
        "import sys; sys.modules['dask'] = None;"  # what JAX imports if it is there, and jinja2 with it
        "from gtr_jax.cli import main; main(['--help']);"
        "print(sorted({'calibrate', 'matplotlib', 'pandas', 'rich', 'jinja2'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]"
