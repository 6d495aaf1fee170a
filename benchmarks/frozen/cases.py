"""The cases: command lines of `gtr`, and a short program that uses public names only.

In their arguments `{out}` is the folder of the case, `{answers}` that of all cases, `{made}` that of what was
made for them (`made.py`), `{shared}` the recordings beside the repository, which not everybody has.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from .made import DRAWN, OPENED

COMMANDS = (
    *("demo", "design", "diagnose", "export", "fit", "init", "inspect", "next", "schema", "simulate"),
    *("sweep", "terms", "view"),
)
EXAMPLES = {
    "examples/antagonists.toml": "--tendon left --pull 15 --release 1",
    "examples/helix.toml": "--pull 10 --release 1",
    "examples/tdcm-1-law.toml": "--pull 45 --release 0",
    "examples/tdcm-1.toml": "--pull 45 --release 0",
    "examples/tdcm-2.toml": "--pull 20 --release 0",
    "examples/three-tendons.toml": "--history examples/three-tendons-displacement.csv",
    "examples/paper/antagonists.toml": "--tendon right --pull 12 --release 2",
    "examples/paper/tdcm-1.toml": "--pull 45 --release 0",
    "examples/paper/tdcm-2.toml": "--pull 20 --release 0",
    "examples/rig/robot.toml": "--history examples/rig/monday.csv",
    "examples/robots/tentacle/tentacle.toml": "--tendon left --pull 4 --release 0",
    "examples/robots/tentacle/fitted.toml": "--history examples/robots/tentacle/test.csv",
} | {f"examples/paper/path-{k}.toml": "--pull 20 --release 0" for k in range(1, 9)}
WRISTS = ("wrist90", "wrist150-diagnosed", "wrist-both-fitted")
GIRAFFE = "{shared}/giraffe"
GIRAFFE_COLUMNS = "T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]"
FITTED = ("coulomb", "presliding-dahl", "stribeck-friction", "viscoelastic-body")
RECORDINGS = (".csv", ".txt", ".lvm", ".tdms")

# Tension and place of the tip after a pull and a release, and their derivatives: ROBOT OUT LARGEST NAMES.
GRADIENTS = """
import json, sys
import jax, numpy as np
import gtr_jax as gtr

file, out, largest, names = sys.argv[1], sys.argv[2], float(sys.argv[3]), sys.argv[4].split(",")
robot = gtr.load_robot(file)
T = largest * np.array([0.0, 0.3, 0.7, 1.0, 0.8, 0.5, 0.6])
history = np.stack([T, 0.1 * T], axis=1) if "mu.left" in names else T

def reached(values):
    run = gtr.simulate(robot.with_values(**dict(zip(names, values))), history)
    return {"T_tip": run.T_tip, "position": run.tip.position, "rotation": run.tip.rotation}

values = [robot.value(name) for name in names]
def plain(tree):
    return jax.tree.map(lambda leaf: np.asarray(leaf).ravel().tolist(), tree)
found = {"values": plain(jax.jit(reached)(values)), "forward": plain(jax.jit(jax.jacfwd(reached))(values))}
def mixed(values):
    leaves = jax.tree.leaves(reached(values))
    return sum((np.cos(np.arange(leaf.size)) * leaf.ravel()).sum() for leaf in leaves)
found["reverse"] = plain(jax.jit(jax.grad(mixed))(values))
with open(out, "w") as file:
    json.dump(found, file, indent=1)
"""


class Case(NamedTuple):
    """One case: its name, the arguments, the program if it is not `gtr`, what is made for it, and the case
    whose answers it reads.
    """

    name: str
    arguments: tuple[str, ...]
    program: str = ""
    made: str = ""
    after: str = ""

    @property
    def command(self) -> str:
        return self.name.split(".")[0]


def quick(root: Path, shared: Path | None) -> list[Case]:
    """Every command on small inputs: some twenty minutes of one core."""
    return [
        *_words(),
        *_gradients(),
        *_fits(root, shared),
        *_others(),
        *_simulations(root),
        *_inspections(root, shared),
        *_exports(),
    ]


def long(root: Path, shared: Path | None) -> list[Case]:
    """All labelled recordings and 40 blind ones diagnosed, all reference runs fitted: hours."""
    labelled = root / "tests/data/labelled" if shared is None else shared / "labelled"
    found = [_diagnosis("labelled", folder, root, shared) for folder in sorted(labelled.glob("case-*"))]
    for seed in OPENED:
        for number in range(0, DRAWN, 6):
            name = f"blind/{seed}-{number:03d}"
            files = f"{{made}}/{name}/robot.toml", f"{{made}}/{name}/recording.csv"
            found.append(Case(f"diagnose.{_slug(name)}", ("diagnose", *files, "-o", "{out}/run"), made=name))
    for folder in sorted((root / "tests/data/reference").iterdir()):
        found.append(_fit(f"reference-{folder.name}", f"{folder.relative_to(root)}"))
    found += [_spatial("fit", path, root) for path in sorted((root / "tests/data/reference3d").glob("*.csv"))]
    tentacle = "examples/robots/tentacle"
    files = f"{tentacle}/tentacle.toml", f"{tentacle}/train.csv"
    found.append(Case("fit.tentacle", ("fit", *files, "--free", "E,mu.left,mu.right", "-o", "{out}/run")))
    return found


PARTS = {"quick": quick, "long": long}


def _slug(path: str) -> str:
    for old, new in (("{shared}/", "shared/"), ("tests/data/", ""), ("examples/", ""), ("/", "-")):
        path = path.replace(old, new)
    return path.removesuffix(".toml").removesuffix(".csv")


def _run(command: str, name: str, *arguments: str, **more: str) -> Case:
    """A case that writes a run folder."""
    return Case(f"{command}.{name}", (command, *arguments, "-o", "{out}/run"), **more)


def _words() -> Iterator[Case]:
    yield Case("help.gtr", ("--help",))
    for command in COMMANDS:
        yield Case(f"help.{command}", (command, "--help"))
    yield Case("schema.robot", ("schema",))
    yield Case("terms.all", ("terms",))
    yield Case("terms.presliding", ("terms", "presliding"))
    yield Case("init.default", ("init", "--yes", "{out}/robot.toml"))


def _simulations(root: Path) -> Iterator[Case]:
    for robot, history in EXAMPLES.items():
        yield _run("simulate", _slug(robot), robot, *history.split())
    for wrist in WRISTS:
        robot = f"examples/robots/wrists/{wrist}.toml"
        yield _run("simulate", _slug(robot), robot, "--pull", "3", "--release", "0")
    for folder in sorted((root / "tests/data/reference").iterdir()):
        robot, recording = (
            f"tests/data/reference/{folder.name}/{f}" for f in ("robot.toml", "recording.csv")
        )
        yield _run("simulate", f"reference-{folder.name}", robot, "--history", recording)
    for path in sorted((root / "tests/data/reference3d").glob("*.csv")):
        yield _spatial("simulate", path, root)


def _spatial(command: str, path: Path, root: Path) -> Case:
    """A reference run in space, whose robot file is made."""
    made, recording = f"reference3d/{path.stem}.toml", str(path.relative_to(root))
    given = ("--history", recording) if command == "simulate" else (recording,)
    return _run(command, f"reference3d-{path.stem}", f"{{made}}/{made}", *given, made=made)


def _inspections(root: Path, shared: Path | None) -> Iterator[Case]:
    of_examples = ["examples/helix-recording.csv", "examples/three-tendons-displacement.csv"]
    of_examples += [f"examples/rig/{day}.csv" for day in ("monday", "tuesday", "oiled")]
    of_examples += [f"examples/robots/tentacle/{name}.csv" for name in ("train", "test")]
    for name in of_examples:
        yield _run("inspect", _slug(name), name)
    for path in sorted((root / "tests/data").rglob("*")):
        if path.suffix in RECORDINGS:
            name = str(path.relative_to(root))
            yield _run("inspect", _slug(name), name)
    for path in sorted(shared.glob("*/*.csv")) if shared else []:
        name = f"{{shared}}/{path.relative_to(shared)}" if shared else ""
        yield _run("inspect", _slug(name), name)


def _exports() -> Iterator[Case]:
    robots = ("tdcm-1", "helix", "antagonists", "three-tendons", "paper/path-3", "robots/tentacle/tentacle")
    for robot in (*robots, "robots/wrists/wrist90", "rig/robot"):
        for ending in ("dxf", "step", "xml"):
            file = f"examples/{robot}.toml"
            name = f"export.{_slug(file)}-{ending}"
            yield Case(name, ("export", file, "-o", f"{{out}}/robot.{ending}"))


def _fit(name: str, folder: str) -> Case:
    return _run("fit", name, f"{folder}/robot.toml", f"{folder}/recording.csv")


def _fits(root: Path, shared: Path | None) -> Iterator[Case]:
    rig = "examples/rig"
    yield _run("fit", "rig", f"{rig}/robot.toml", f"{rig}/monday.csv")
    yield _run("fit", "rig-both", f"{rig}/robot.toml", f"{rig}/monday.csv", f"{rig}/tuesday.csv")
    yield _run("fit", "helix", "examples/helix.toml", "examples/helix-recording.csv")
    for name in FITTED:
        yield _fit(f"reference-{name}", f"tests/data/reference/{name}")
    yield _spatial("fit", root / "tests/data/reference3d/two-tendons.csv", root)
    if shared:
        robot, recording = f"{GIRAFFE}/robot.toml", f"{GIRAFFE}/loadcell_measurements.csv"
        yield _run("fit", "giraffe", robot, recording, "--columns", GIRAFFE_COLUMNS)


def _diagnosis(name: str, folder: Path, root: Path, shared: Path | None) -> Case:
    inside = shared is not None and folder.is_relative_to(shared)
    place = f"{{shared}}/{folder.relative_to(shared)}" if shared and inside else f"{folder.relative_to(root)}"
    files = f"{place}/robot.toml", f"{place}/recording.csv"
    return _run("diagnose", f"{name}-{folder.name}", *files)


def _others() -> Iterator[Case]:
    for name in ("tdcm-1", "helix"):
        yield _run("sweep", name, f"examples/{name}-sweep.toml", "--threads", "1")
        yield _run("design", name, f"examples/{name}.toml", f"examples/{name}-target.toml")
    yield _run("next", "rig", "{answers}/fit.rig/run", after="fit.rig")
    yield _run("next", "rivals", "examples/tdcm-1.toml", "examples/tdcm-1-law.toml", "--max-tension", "45")
    yield _run("diagnose", "rig", "examples/rig/robot.toml", "examples/rig/monday.csv")
    for name in ("case-000", "case-005"):
        place = f"tests/data/labelled/{name}"
        yield _run("diagnose", name, f"{place}/robot.toml", f"{place}/recording.csv")


def _gradients() -> Iterator[Case]:
    for robot, largest, names in (
        ("rig/robot", 40, "mu,E"),
        ("helix", 10, "mu,E"),
        ("antagonists", 15, "mu.left,mu.right,E"),
    ):
        arguments = (f"examples/{robot}.toml", "{out}/gradients.json", str(largest), names)
        yield Case(f"gradients.{_slug(robot)}", arguments, GRADIENTS)
