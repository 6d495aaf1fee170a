"""Files spoilt at random: every reader answers, or refuses in one line that names the file.

A mutant is a sound file changed in its bytes, in its tokens (numbers, units, words, lines), or in what it
means (values of another kind or size, keys moved, doubled or left out).
"""

from __future__ import annotations

import copy
import gzip
import math
import random
import re
import tempfile
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from design.target import load_target, target_text
from gtr_jax.config.config import config_text, load_config
from gtr_jax.errors import InputError, InputWarning
from gtr_jax.recordings.columns import read_columns, write_columns
from gtr_jax.recordings.formats import csv_text, many_cells
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.recordings.recording import read_recording
from gtr_jax.robot.build import load_robot
from gtr_jax.sweep.axes import axes_of
from gtr_jax.sweep.config import load_sweep, sweep_text
from gtr_jax.sweep.plan import plan_of

MUTANTS = 5000
ROOT = Path(__file__).parents[2]

ROBOTS = [
    path.read_text()
    for path in sorted((ROOT / "examples").glob("*.toml"))
    if "[backbone]" in path.read_text()
]
ROBOT = """schema = 1
name = "all of it"
[backbone]
length = "250 mm"
outer_radius = ["20 mm", "13 mm"]
bores = [{ from = "0 mm", to = "20 mm", diameter = "14 mm" }]
youngs_modulus = "1.06 MPa"
density = "1070 kg/m^3"
natural_curvature = [[0, 0.1], ["250 mm", "0.2 rad/m"]]
[[tendons]]
name = "left"
friction_coefficient = 0.3
preload = "1 N"
routing = { kind = "converging-sine", R_max = "9 mm", r_min = "6 mm", n_sine = 5, sigma = 0.1 }
[[tendons]]
name = "right"
friction_coefficient = 0.3
routing = { kind = "table", knots = [["0 mm", "-8 mm"], ["100 mm", "-7 mm"], ["250 mm", "-8 mm"]] }
[loads]
gravity_angle = "-90 deg"
tip_force = ["0 N", "-0.2 N"]
tip_moment = 0.01
payload = "5 g"
[uncertainty]
youngs_modulus = 0.1
"loads.gravity_angle" = "5 deg"
[[terms]]
kind = "presliding"
length = "0.6 mm"
[[terms]]
kind = "contact"
stiffness = "200 N/m"
"""
TARGET = """schema = 1
name = "round the corner"
T_base_max = "60 N"
[[pose]]
T_base = "45 N"
tip = ["231.5 mm", "-48.4 mm"]
angle = "-55.2 deg"
[[pose]]
T_base = "15 N"
branch = "releasing"
angle = "-40 deg"
angle_tolerance = "2 deg"
weight = 2
[[shape]]
T_base = "30 N"
points = [["125 mm", "120 mm", "20 mm"]]
[goal]
kind = "reach"
T_base = "45 N"
[search]
routing = ["r1", "r2", "w1", "w2"]
free = ["E"]
starts = 6
seed = 3
[search.bounds]
E = ["0.8 MPa", "1.5 MPa"]
[limits]
wall_clearance = "1.5 mm"
max_tension_loss = 0.7
max_base_slope = "20 deg"
[robust]
optimise = "expected"
friction_coefficient = 0.1
"""
SWEEP = """schema = 1
name = "friction and stiffness"
robot = "robot.toml"
outputs = ["T_tip", "tip_pose"]
sample = "sobol"
count = 64
seed = 2
resolution = 0.5
[vary]
"tendon.friction_coefficient" = { from = 0.1, to = 0.5 }
"backbone.youngs_modulus" = { from = "0.5 MPa", to = "2 MPa", scale = "log" }
r1 = { mean = "-10 mm", sd = "0.2 mm" }
[history]
pull = "45 N"
release = "0 N"
steps = 40
keep = "all"
"""
MAPPING = """schema = 1
[columns]
time = "Time [s]"
T_base = "data_0 [gf]"
"T_tip.left" = "data_2 [gf]"
T_tip.right = "data_3"
[clean]
keep_glitches = true
drop = ["12.5 s:13 s", ":2"]
"""
HEADER = "Timestamp,time_s,T_base_N,T_tip_N,tip_angle [deg],displacement_mm,trial,note\n"
RECORDING = HEADER + "".join(
    f"2026-01-31T14:05:{i:02d}.2,{0.5 * i},{20 - abs(20 - 2 * i)},{12 - abs(12 - 1.2 * i):.3f},{i},0.{i},1,\n"
    for i in range(21)
)
COLUMNS = "T_base=data_0[gf],T_tip=data 2 [mN],time=Clock[ms],tip_x=x,trial=n"
MAPPED = "data_0,data 2 [mN],Clock,x,n,data 2\n" + "".join(f"{100 * i},{i},{i},{i},1,{i}\n" for i in range(5))

# What people and programs put where a number, a unit or a word should stand.
ODD = [
    "", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "-0", "0", "9" * 400, "0x" + "f" * 5000,
    "1_000", "1,5", "1.234,5", "1 234", "٣", "½", "−5", "true", '""', "[]", "{}", "[[[]]]", "#", "null",
    "1e30", "1e-30", "2**63", "9223372036854775808", "2026-01-31", "25:61:61", "0.1.2", "mm", "5 mm",
    '"5 mm"', '"1e308 mm"', '"5 furlongs"', '"5 9**9**9"', '"5 m**99999999"', '"nan N"', '"-5 N"',
    '"' + "a" * 500 + '"', "'", '"', "\\", "\x00", "\ufeff", "\u2028", "=", "==", "[", "]", "][", "\r",
    "\n\n", ";", ",", "\t", "💥", "%s", "{0}", "../..", "/", "con",
]  # fmt: skip
HUGE = [
    10**400, -(10**400), 10**25, 1e308, -1e308, 1e-320, 5e-324, math.inf, math.nan, 0, -1, 2**63 - 1, True,
    "", "5", "x", [], {}, [[]], [1e308] * 3, "1e308 m", "1e200 km", "-1 N", "5 9**9**9", "0 mm", "1e-300 mm",
    {"kind": "x"}, {"from": 0},
]  # fmt: skip
TOKEN = re.compile(r"\d+(?:\.\d+)?|[A-Za-z_]+|\s+|.", re.DOTALL)


def spoil_bytes(data: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, cut, doubled, swapped, or of another encoding."""
    mutable = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        at = rng.randrange(len(mutable) + 1)
        what = rng.randrange(6)
        if what == 0 and at < len(mutable):
            mutable[at] ^= 1 << rng.randrange(8)
        elif what == 1:
            mutable[at:at] = bytes(rng.randrange(256) for _ in range(rng.choice([1, 3, 9])))
        elif what == 2:
            del mutable[at : at + rng.choice([1, 2, 10, 200])]
        elif what == 3:
            mutable[at:at] = mutable[at : at + rng.choice([1, 20, 300])]
        elif what == 4:
            mutable = bytearray(
                mutable.decode("latin-1").encode(rng.choice(["utf-16", "utf-8", "utf-16-be"]))
            )
        else:
            mutable = mutable[:at] if rng.random() < 0.1 else mutable
    return bytes(mutable)


def spoil_tokens(text: str, rng: random.Random) -> str:
    """Numbers, words, marks or lines replaced, doubled, left out or moved."""
    if rng.random() < 0.3:
        lines = text.splitlines(keepends=True)
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i : i + 1] = rng.choice(
            [[], [lines[i]] * 2, [lines[j]], [f"# {lines[i]}"], [lines[i].replace(",", ";")]]
        )
        text = "".join(lines)
    tokens = TOKEN.findall(text)
    for _ in range(rng.choice([1, 1, 2, 4])):
        if not tokens:
            break
        i, j = rng.randrange(len(tokens)), rng.randrange(len(tokens))
        tokens[i] = rng.choice(
            [rng.choice(ODD), "", tokens[j], tokens[i] * 2, tokens[i].swapcase(), tokens[i][::-1]]
        )
    return "".join(tokens)


def spoil_meaning(data: dict, rng: random.Random) -> dict:
    """Values of another kind or size, keys moved, doubled in another place or left out."""
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        places = list(leaves(data))
        node, key = rng.choice(places)
        what = rng.randrange(6)
        if what <= 2:
            node[key] = rng.choice(HUGE)
        elif what == 3:
            other, name = rng.choice(places)
            node[key] = copy.deepcopy(other[name])
        elif what == 4 and isinstance(node, dict):
            node[rng.choice([*map(str, node), "x", "kind", "schema", str(key).upper(), f"{key}s"])] = (
                node.pop(key)
            )
        elif what == 5:
            del node[key]
    return data


def leaves(node, depth=0):
    """Every place (table or list, key) of nested data."""
    for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
        yield node, key
        if isinstance(value, dict | list) and depth < 8:
            yield from leaves(value, depth + 1)


def spoilt(text: str, rng: random.Random) -> bytes:
    """A mutant of a TOML or CSV file."""
    kind = rng.randrange(3)
    if kind == 0:
        return spoil_bytes(text.encode(), rng)
    if kind == 1 or "=" not in text:
        return spoil_tokens(text, rng).encode("utf-8", "surrogatepass")
    return tomli_w.dumps(spoil_meaning(tomllib.loads(text), rng)).encode()


def answers(read: Callable[[Path], object], path: Path, seed: int) -> bool:
    """Whether a mutant is read; if not, it is refused in one line that names it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", InputWarning)  # a warning answers, too
            read(path)
        return True
    except InputError as fault:
        said = str(fault)
        assert "\n" not in said and len(said) < 1500, (seed, said)
        assert path.name in said, (seed, said)
        assert said.isprintable(), (seed, said)
        return False
    except BaseException as fault:
        raise AssertionError(f"mutant {seed}: {path.read_bytes()!r}") from fault


def robot(path: Path) -> None:
    config = load_config(path)
    again = path.with_name("again.toml")
    again.write_text(config_text(config), encoding="utf-8")
    assert load_config(again) == config


def target(path: Path) -> None:
    read = load_target(path)
    again = path.with_name("again.toml")
    again.write_text(target_text(read), encoding="utf-8")
    assert load_target(again) == read


def sweep(path: Path) -> None:
    read = load_sweep(path)
    again = path.with_name("again.toml")
    again.write_text(sweep_text(read), encoding="utf-8")
    assert sweep_text(load_sweep(again)) == sweep_text(read)  # what varies stays as written, nan too
    plan_of(read, axes_of(read, SWEPT, "N"), None, 1)


def recording(path: Path) -> None:
    read = read_recording(path)
    assert read.T_tip is not None and len(read) == len(read.T_tip)
    for values in (read.T_base, read.T_tip, read.time, read.displacement, read.tip_angle, read.trial):
        assert values is None or (np.all(np.isfinite(values)) and values.shape == (len(read),))


def mapping(path: Path) -> None:
    read = read_columns(path)
    again = path.with_name("again.toml")
    write_columns(again, dict(read.entries), keep_glitches=read.keep_glitches, drop=read.drop)
    assert {*read_columns(again).entries} == {*dict(read.entries).items()}
    assert read_columns(again).drop == read.drop


SWEPT = load_robot(ROOT / "examples/tdcm-1.toml")

READERS = {
    "robot": ("robot.toml", [ROBOT, *ROBOTS], robot),
    "target": ("target.toml", [TARGET], target),
    "sweep": ("sweep.toml", [SWEEP], sweep),
    "mapping": ("mapping.toml", [MAPPING], mapping),
    "recording": ("recording.csv", [RECORDING, RECORDING.replace(",", ";").replace(".", ",")], recording),
}


MAPPED_BAG = "T_base=/cells.force.x[N],T_tip=/cells.force.y[N]"
FORMAT_MUTANTS = 10_000


def binary_files(folder: Path) -> dict[str, tuple[str, bytes, str | None]]:
    """A sound recording of each format but plain CSV: its name, its bytes, its mapping."""
    import polars as pl
    from scipy.io import savemat
    from test_formats import DATA, bag, hdf5

    pl.DataFrame(DATA | {"note": ["x"] * 50}).write_parquet(folder / "a.parquet")
    savemat(
        folder / "a.mat", DATA | {"s": {"a": DATA["time_s"]}, "names": np.array(["a", "b"], dtype=object)}
    )
    hdf5(folder / "b.mat", DATA)
    bag(folder / "a.bag", "bag")
    bag(folder / "mcap", "mcap")
    bag(folder / "sqlite3", "sqlite3")
    loggers(folder, DATA)
    files = {kind: f"a.{kind}" for kind in ("tdms", "xlsx", "gz", "lvm", "log")}
    files |= {"parquet": "a.parquet", "mat": "a.mat", "mat 7.3": "b.mat", "bag": "a.bag"}
    files |= {"mcap": "mcap/mcap.mcap", "db3": "sqlite3/sqlite3.db3"}
    mapped: dict[str, str] = dict.fromkeys(("bag", "mcap", "db3"), MAPPED_BAG)
    endings = {kind: (f"recording{Path(name).suffix}", folder / name) for kind, name in files.items()}
    return {kind: (name, path.read_bytes(), mapped.get(kind)) for kind, (name, path) in endings.items()}


def loggers(folder: Path, data: dict[str, np.ndarray]) -> None:
    """The same recording as loggers write it: a.tdms, a.xlsx, a.gz, a.lvm and a.log."""
    import nptdms
    import openpyxl

    with nptdms.TdmsWriter(folder / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("g", name, values) for name, values in data.items()])
    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    rows = [*zip(*(values.tolist() for values in data.values()), strict=True)]
    for row in ([*data], *rows):
        sheet.append(row)
    book.save(folder / "a.xlsx")
    text = "".join(",".join(map(str, row)) + "\n" for row in ([*data], *rows))
    (folder / "a.gz").write_bytes(gzip.compress(text.encode()))
    head = (ROOT / "tests/data/loggers/with_comments.lvm").read_text("latin-1").partition("X_Value")[0]
    lines = ["X_Value\tT_base_N\tT_tip_N\tComment", *("\t".join(map(str, row)) for row in rows)]
    (folder / "a.lvm").write_text(head + "\n".join(lines) + "\n")
    named = (f"{i}.5 -> T_base: {a:.4f} N, T_tip: {b:.4f} N\n" for i, (_, a, b) in enumerate(rows, 10))
    (folder / "a.log").write_text("".join(f"14:05:{line}" for line in named))


def mutants_of_format(kind: str, folder: Path, number: int) -> None:
    """Read so many mutants of a format."""
    name, sound, columns = binary_files(folder)[kind]
    path = folder / name
    path.write_bytes(sound)
    assert len(read_recording(path, columns)) == 50
    read_whole = 0
    for seed in range(number):
        path.write_bytes(spoil_bytes(sound, random.Random(f"{kind} {seed}")))
        read_whole += answers(lambda path: read_recording(path, columns), path, seed)
    assert 0.01 * number < read_whole < 0.9 * number


FORMATS = ("tdms", "xlsx", "gz", "lvm", "log", "parquet", "mat", "mat 7.3", "bag", "mcap", "db3")


@pytest.mark.parametrize("kind", FORMATS)
def test_few_mutants_of_formats(kind, folder):
    mutants_of_format(kind, folder, 200)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FORMATS)
def test_mutants_of_formats(kind, folder):
    mutants_of_format(kind, folder, FORMAT_MUTANTS)


def read_both_ways(number: int, folder: Path, monkeypatch) -> None:
    """Read mutants of CSV files as small and as large ones: what is said of them is the same."""
    from test_formats import as_text

    path = folder / "recording.csv"
    read_large = 0
    for seed in range(number):
        rng = random.Random(f"large {seed}")
        path.write_bytes(spoilt(rng.choice(READERS["recording"][1]), rng))
        said = []
        for least in (10**9, 0):
            monkeypatch.setattr(csv_text, "LARGE", least)
            try:
                table = read_table(path)
                said.append(as_text(table))
                read_large += isinstance(table.columns[0], many_cells.ManyTextCells)
            except InputError as fault:
                said.append(str(fault))
        assert said[0] == said[1], (seed, path.read_bytes())
    assert read_large > 0.2 * number


@pytest.mark.parametrize("number", [200, pytest.param(FORMAT_MUTANTS, marks=pytest.mark.slow)])
def test_mutants_are_read_as_large_files_as_they_are_as_small_ones(number, folder, monkeypatch):
    monkeypatch.setattr(csv_text, "_HEAD", 4)
    monkeypatch.setattr(many_cells, "_FIRST", 2)
    read_both_ways(number, folder, monkeypatch)


SPOILT = {
    "schema of 400 digits": ("schema = 1", f"schema = 1{400 * '9'}", "schema: 1999"),
    "seed of 400 digits": ("seed = ", f"seed = 1{400 * '0'}", "seed: 1000"),
    "seed of 70 bits": ("seed = ", f"seed = {2**70}", "seed: 1180591620717411303424"),
    "force of 1e308": ('"45 N"', "1e308", "1e+308 is more than can be computed with"),
    "force of 400 digits": ('"45 N"', f"1{400 * '0'}", "has too many digits for an integer"),
}


@pytest.mark.parametrize("case", SPOILT)
@pytest.mark.parametrize("kind", ["target", "sweep"])
def test_numbers_beyond_floats(kind, case, tmp_path):
    name, (text, *_), read = READERS[kind]
    old, new, says = SPOILT[case]
    assert old in text
    path = tmp_path / name
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ") and says in str(caught.value)


@pytest.fixture
def folder():
    """A folder in memory where there is one: each mutant is a file."""
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as name:
        yield Path(name)


@pytest.mark.slow
@pytest.mark.parametrize("kind", READERS)
def test_mutants(kind, folder):
    name, sound, read = READERS[kind]
    path = folder / name
    for text in sound:
        path.write_text(text, encoding="utf-8")
        read(path)
    read_whole = 0
    for seed in range(MUTANTS):
        rng = random.Random(f"{kind} {seed}")
        path.write_bytes(spoilt(rng.choice(sound), rng))
        read_whole += answers(read, path, seed)
    assert 0.01 * MUTANTS < read_whole < 0.9 * MUTANTS  # neither all too harmless nor all too coarse


@pytest.mark.slow
def test_mutants_of_columns(folder):
    path = folder / "recording.csv"
    path.write_text(MAPPED, encoding="utf-8")
    sound = np.asarray(read_recording(path, COLUMNS).T_base)
    read_whole = 0
    for seed in range(MUTANTS):
        rng = random.Random(f"columns {seed}")
        if rng.random() < 0.3:
            columns = spoil_bytes(COLUMNS.encode(), rng).decode("utf-8", "replace")
        else:
            columns = spoil_tokens(COLUMNS, rng)
        try:
            read_whole += answers(lambda p, columns=columns: read_recording(p, columns), path, seed)
        except AssertionError as fault:
            raise AssertionError(f"--columns {columns!r}") from fault
    assert 0.01 * MUTANTS < read_whole < 0.9 * MUTANTS
    np.testing.assert_allclose(sound, 0.980665 * np.arange(5), rtol=1e-15)
