"""What is left out of a recording, mapping files, guesses of columns, and recordings that are thinned."""

import json
import math

import numpy as np
import pytest
from command_line import RECORDED, RECORDING, run_gtr
from test_recording import GIRAFFE, GIRAFFE_COLUMNS, GOOD, fault, write

from gtr_jax.errors import InputError
from gtr_jax.recordings.cleaning.masking import Masked, masked_says
from gtr_jax.recordings.columns import columns_text, read_columns, write_columns
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.recordings.recording import guess, read_recording
from gtr_jax.recordings.thinning import thinned, thinned_says

K = 300
TIME = 0.01 * np.arange(K)
BASE = 10 + 5 * np.sin(TIME * 4)
TIP = 0.6 * BASE


def recorded(folder, base=BASE, tip=TIP, name="recording.csv", header="time_s,T_base_N,T_tip_N"):
    """A recording's file; NaN becomes an empty cell."""
    rng = np.random.default_rng(0)
    noisy = [np.round(v + 0.005 * rng.standard_normal(len(v)), 5) for v in (base, tip)]
    rows = [
        ",".join("" if math.isnan(v) else repr(float(v)) for v in row)
        for row in zip(TIME, *noisy, strict=True)
    ]
    return write(folder, "\n".join([header, *rows, ""]), name)


def spoilt():
    """Both channels with two glitches, an empty cell and a dropout."""
    base, tip = BASE.copy(), TIP.copy()
    tip[100], tip[150] = 154.0, math.nan
    base[200:202] += 30
    return base, tip


def test_glitches_and_empty_cells_are_left_out(tmp_path):
    recording = read_recording(recorded(tmp_path, *spoilt()))
    assert len(recording) == K - 4 and recording.T_tip is not None and recording.time is not None
    assert recording.rows is not None
    assert recording.T_tip.max() < 10 and recording.T_base.max() < 16
    gone = sorted(set(range(2, K + 2)) - set(recording.rows.tolist()))
    assert gone == [102, 152, 202, 203]
    np.testing.assert_array_equal(recording.time, np.delete(TIME, [100, 150, 200, 201]))
    assert not recording.rows.flags.writeable and not recording.T_base.flags.writeable
    assert [(m.rows, m.channel, m.kind) for m in recording.masked] == [
        ((102, 102), "T_tip", "glitch"),
        ((152, 152), "T_tip", "dropout"),
        ((202, 203), "T_base", "glitch"),
    ]
    first, empty, last = recording.masked
    assert (
        first.time == (1.0, 1.0)
        and first.unit == "N"
        and first.size == pytest.approx(154 - TIP[100], abs=0.1)
    )
    assert math.isnan(empty.size)
    assert first.says.startswith("row 102 (1 s): T_tip jumps by +15") and first.says.endswith(" N")
    assert empty.says == "row 152 (1.5 s): T_tip has no number"
    assert last.says.startswith("rows 202 to 203 (2 s to 2.01 s): T_base jumps by +3")
    assert masked_says(recording.masked) == (
        "3 samples at 2 places masked as glitches (rows 102, 202 to 203); --keep-glitches keeps them; "
        "1 sample at 1 place without a number left out (row 152)"
    )


def test_glitches_that_are_kept(tmp_path):
    base, tip = spoilt()
    path = recorded(tmp_path, base, np.where(tip > 100, 20.0, tip))
    recording = read_recording(path, keep_glitches=True)
    assert [m.rows for m in recording.masked] == [(152, 152)]  # what is not a number cannot be kept
    assert recording.T_base.max() > 30
    mapping = tmp_path / "columns.toml"
    write_columns(mapping, {"T_base": "T_base_N"}, keep_glitches=True)
    assert len(read_recording(path, mapping)) == len(recording)
    with pytest.raises(InputError, match="row 102, column 'T_tip_N': T_tip peaks at 154"):
        read_recording(recorded(tmp_path, base, tip), keep_glitches=True)


def test_a_history_is_read_as_it_is(tmp_path):
    path = write(tmp_path, "T_base_N\n" + "".join(f"{50 if i == 60 else i % 7}\n" for i in range(120)))
    recording = read_recording(path, need_tip=False)
    assert len(recording) == 120 and recording.masked == ()


def test_too_many_empty_cells(tmp_path):
    tip = TIP.copy()
    tip[:K:20] = math.nan
    assert len(read_recording(recorded(tmp_path, BASE, tip)).masked) == 15
    tip[1] = math.nan
    with pytest.raises(InputError) as caught:
        read_recording(recorded(tmp_path, BASE, tip))
    assert str(caught.value).endswith(
        "row 2, column 'T_tip_N': expected a number, found an empty cell; correct the cell or delete the "
        "row; up to 5 % of a column may be empty, not 5.3 %"
    )
    header = "time_s,T_base_N,T_tip_N"
    rows = [header, *(f"{i},{i},{i / 2}" for i in range(40)), "40,,5", "41,n/a,6", ""]
    assert fault(tmp_path, "\n".join(rows)).startswith(
        "row 43, column 'T_base_N': expected a number, found 'n/a'"
    )
    assert fault(tmp_path, "\n".join(rows).replace("n/a", "inf")).startswith("row 43, column 'T_base_N'")
    timed = "\n".join(rows).replace("41,n/a", "41,41").replace("40,,5", ",40,5")
    assert [m.channel for m in read_recording(write(tmp_path, timed)).masked] == ["time"]


DROPS = {
    "12.5-13": "is not a stretch FROM:TO; write for example '12.5 s:13 s'",
    "": "is not a stretch FROM:TO",
    "1:2:3": "is not a stretch FROM:TO",
    "2:1": "ends before it begins",
    "1 m:2 m": "'m' is not a unit of a time",
    "one:two": "cannot read 'one' as a time",
    "nan:2": "cannot read 'nan' as a time",
    "5:6": "holds no sample; the recording goes from 0 s to 2.99 s",
    ":": "is not a stretch FROM:TO",
    ":9": None,
}


@pytest.mark.parametrize("drop", DROPS)
def test_stretches_that_cannot_be_dropped(drop, tmp_path):
    with pytest.raises(InputError) as caught:
        read_recording(recorded(tmp_path), drop=[drop])
    said = DROPS[drop]
    if said is None:
        assert "no sample is left; drop less of it" in str(caught.value)
    else:
        assert f"recording.csv: --drop '{drop}': {said}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_dropped_stretches(tmp_path):
    path = recorded(tmp_path, *spoilt())
    recording = read_recording(path, drop=["990 ms:1.01s", "2.5:"])
    assert recording.time is not None and recording.time.max() < 2.5
    assert not np.any((recording.time > 0.985) & (recording.time < 1.015))
    assert [(m.rows, m.kind) for m in recording.masked] == [
        ((101, 103), "dropped"),
        ((152, 152), "dropout"),
        ((202, 203), "glitch"),
        ((252, 301), "dropped"),
    ]
    assert recording.masked[0].says == "rows 101 to 103 (0.99 s to 1.01 s): dropped"
    assert masked_says(recording.masked).endswith(
        "53 samples at 2 places dropped (rows 101 to 103, 252 to 301)"
    )
    with pytest.raises(InputError, match="--drop '0:1': needs the time of the samples; map a column"):
        read_recording(write(tmp_path, GOOD.replace("time_s", "clock")), drop=["0:1"])


def test_several_tendons_are_masked_together(tmp_path):
    base, tip = spoilt()
    path = recorded(tmp_path, base, np.where(np.isnan(tip), 5, tip), header="time_s,T_base_N.a,T_tip_N.a")
    text = path.read_text().splitlines()
    cells = [line.split(",") for line in text[1:]]
    rows = [",".join([*c, str(float(c[1]) + 1 if i != 50 else 90), c[2]]) for i, c in enumerate(cells)]
    path.write_text("\n".join([text[0] + ",T_base_N.b,T_tip_N.b", *rows]))
    recording = read_recording(path, tendons=("a", "b"))
    assert recording.T_tip is not None and recording.T_base.shape == recording.T_tip.shape == (K - 4, 2)
    assert {m.channel for m in recording.masked} >= {"T_base.b", "T_tip.a", "T_base.a"}


# Mapping files

MAPPING = """schema = 1
[columns]
time = "Clock [ms]"
T_base = "data_0 [gf]"
T_tip = "data_2"
[clean]
keep_glitches = true
drop = ["1 s:2 s"]
"""


def test_mapping_files(tmp_path):
    path = write(tmp_path, "Clock,data_0,data_2\n0,0,0\n500,100,0.5\n1500,200,0.6\n2500,300,0.7\n")
    mapping = write(tmp_path, MAPPING, "columns.toml")
    recording = read_recording(path, str(mapping))
    np.testing.assert_array_equal(recording.time, [0, 0.5, 2.5])
    np.testing.assert_allclose(recording.T_base, [0, 0.980665, 2.941995], rtol=1e-15)
    np.testing.assert_array_equal(recording.T_tip, [0, 0.5, 0.7])
    read = read_columns(mapping)
    assert read.keep_glitches and read.drop == ("1 s:2 s",) and read.place == str(mapping)


def test_mapping_files_are_written_as_they_are_read(tmp_path):
    columns = {"time": "Time [s]", "T_base": 'data "0" [gf]', "T_tip": "µ\\x"}
    write_columns(tmp_path / "a.toml", columns, drop=[":2 s"], note="guessed\nfrom a file")
    read = read_columns(tmp_path / "a.toml")
    assert dict(read.entries) == columns and read.drop == (":2 s",) and not read.keep_glitches
    assert (tmp_path / "a.toml").read_text().startswith("# guessed\n# from a file\nschema = 1\n")
    assert columns_text({"T_base": "a"}) == 'schema = 1\n\n[columns]\nT_base = "a"\n'


def test_mapping_files_of_several_tendons(tmp_path):
    path = write(tmp_path, "a,b\n1,2\n3,4\n")
    for text in ('T_base.left = "a"\nT_base.right = "b"', '"T_base.left" = "a"\n"T_base.right" = "b"'):
        mapping = write(tmp_path, f"schema = 1\n[columns]\n{text}\n", "columns.toml")
        recording = read_recording(path, mapping, need_tip=False, tendons=("left", "right"))
        np.testing.assert_array_equal(recording.T_base, [[1, 2], [3, 4]])


MAPPINGS = {
    "no schema": ("schema = 1", "", "schema: must be 1 in a mapping file"),
    "another schema": ("schema = 1", "schema = 2", "schema: must be 1"),
    "unknown key": ("[clean]", "[cleen]", "unknown key 'cleen'; did you mean 'clean'?"),
    "unknown key below": ("drop", "dropp", "clean: unknown key 'dropp'; did you mean 'drop'?"),
    "unknown quantity": ("T_tip", "T_tipp", "unknown quantity 'T_tipp'; did you mean 'T_tip'?"),
    "no such column": ("data_2", "data_3", "no column 'data_3' for T_tip; did you mean"),
    "number": ('"data_2"', "2", "columns.T_tip: expected the name of a column, found '2'"),
    "list": ('"data_2"', '["a"]', "columns.T_tip: expected the name of a column"),
    "no columns": (MAPPING.partition("[clean]")[0], "schema = 1\n", "columns: names no column"),
    "columns no table": (MAPPING, 'schema = 1\ncolumns = "a"', "columns: expected a table"),
    "no truth": ("= true", "= 1", "clean.keep_glitches: expected true or false, found '1'"),
    "no list": ('["1 s:2 s"]', '"1 s:2 s"', "clean.drop: expected a list of stretches"),
    "no stretch": ("1 s:2 s", "1 s", "--drop '1 s': is not a stretch FROM:TO"),
    "not TOML": ("[columns]", "[columns", "not TOML"),
    "empty": (MAPPING, "", "the file is empty"),
}


@pytest.mark.parametrize("name", MAPPINGS)
def test_faults_of_mapping_files(name, tmp_path):
    path = write(tmp_path, "Clock,data_0,data_2\n0,0,0\n500,100,0.5\n")
    old, new, says = MAPPINGS[name]
    assert old in MAPPING
    mapping = write(tmp_path, MAPPING.replace(old, new), "columns.toml")
    with pytest.raises(InputError) as caught:
        read_recording(path, mapping)
    assert says in str(caught.value) and "\n" not in str(caught.value)
    assert "columns.toml" in str(caught.value) or "--drop" in str(caught.value)


def test_a_mapping_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none.toml: no such file"):
        read_recording(write(tmp_path, GOOD), str(tmp_path / "none.toml"))


# Guesses


def guessed(folder, text):
    """The guess of a file's columns: source, why the column and why the unit, by quantity; and the guess."""
    found = guess(read_table(write(folder, text)))
    return {name: (g.source, g.found, g.unit_found) for name, g in found.quantities.items()}, found


def test_guesses(tmp_path):
    sure, found = guessed(tmp_path, GOOD)
    assert sure == {
        "time": ("time_s", "header", "header"),
        "T_base": ("T_base_N", "header", "header"),
        "T_tip": ("T_tip_N", "header", "header"),
    }
    assert all(g.sure for g in found.quantities.values()) and not found.missing
    rows = "".join(f"{i},{i * 7 % 10},{0.6 * (i * 7 % 10)},{i % 5}\n" for i in range(30))
    words, found = guessed(tmp_path, f"Time (ms),Force base [kg],F_tip_kg,angle tip [deg]\n{rows}")
    assert words == {
        "time": ("Time (ms)", "header", "header"),
        "T_base": ("Force base [kg] [kgf]", "name", "name"),
        "T_tip": ("F_tip_kg [kgf]", "name", "name"),
        "tip_angle": ("angle tip [deg]", "header", "header"),
    }
    assert "'kg' is a mass: its weight is meant" in found.quantities["T_base"].says
    raw, found = guessed(tmp_path, f"t,T_base (counts),T_tip [V],x\n{rows}")
    assert raw["T_base"][0] == "T_base (counts)" and not found.quantities["T_base"].sure
    assert "holds raw counts, no force" in found.quantities["T_base"].says
    assert "holds a voltage, no force" in found.quantities["T_tip"].says
    with pytest.raises(InputError, match="'counts'"):
        read_recording(tmp_path / "recording.csv", "T_base=T_base (counts),T_tip=T_tip [V]")
    sized, found = guessed(
        tmp_path,
        "n,a,b,c\n" + "".join(f"{i},{i * i % 11},{90 * (i % 9)},{200 * (i % 9)}\n" for i in range(99)),
    )
    assert sized == {"T_base": ("c [gf]", "size", "size"), "T_tip": ("b [gf]", "size", "size")}
    assert found.unused == ("n", "a")
    assert "guessed from the size of the numbers" in found.quantities["T_base"].says


@pytest.mark.parametrize("text", ["a,b\n1,x\n2,y\n", "1,2\n3,4\n", "a,a\n1,1\n", "T_base,Tbase\n1,2\n3,4\n"])
def test_guesses_refuse_nothing(text, tmp_path):
    _, found = guessed(tmp_path, text)
    assert found.missing


@pytest.mark.skipif(not GIRAFFE.exists(), reason="needs the shared data beside the repository")
def test_the_columns_of_the_giraffe_recording_are_guessed(tmp_path):
    found = guess(read_table(GIRAFFE))
    assert found.columns == {"time": "Time [s]", "T_base": "data_0 [gf]", "T_tip": "data_2 [gf]"}
    write_columns(tmp_path / "columns.toml", found.columns)
    read, expected = (read_recording(GIRAFFE, c) for c in (tmp_path / "columns.toml", GIRAFFE_COLUMNS))
    np.testing.assert_array_equal(read.T_tip, expected.T_tip)
    assert read.masked == ()


@pytest.mark.skipif(not GIRAFFE.exists(), reason="needs the shared data beside the repository")
def test_spikes_in_the_giraffe_recording_are_masked(tmp_path):
    header, *lines = GIRAFFE.read_text().splitlines()
    place = header.split(",").index("data_2")
    for i in (700, 1500):
        cells = lines[i].split(",")
        cells[place] = "15725.0"  # 154 N
        lines[i] = ",".join(cells)
    recording = read_recording(write(tmp_path, "\n".join([header, *lines])), GIRAFFE_COLUMNS)
    assert [m.rows for m in recording.masked] == [(702, 702), (1502, 1502)] and len(recording) == 2252


# Thinning


def long(K):
    """A recording of ramps and holds with noise."""
    rng = np.random.default_rng(0)
    corners = np.array([0, 0.1, 0.15, 0.4, 0.41, 0.6, 0.8, 1.0]) * K
    base = np.interp(np.arange(K), corners, [0, 10, 10, 2, 2, 15, 15, 0])
    time = 0.01 * np.arange(K)
    return (
        corners,
        base,
        {"time_s": time, "T_base_N": base + 0.01 * rng.standard_normal(K), "T_tip_N": 0.5 * base},
    )


def test_thinned_recordings_keep_their_corners(tmp_path):
    from gtr_jax.recordings.recording import Recording

    K, most = 100_000, 2000
    corners, base, data = long(K)
    whole = Recording(
        data["T_base_N"], tmp_path / "a.csv", "", data["T_tip_N"], data["time_s"], rows=np.arange(2, K + 2)
    )
    few = thinned(whole, most)
    assert few.rows is not None
    assert len(few) <= most and few.thinned_from == K and len(few) > 0.95 * most
    assert few.rows[0] == 2 and few.rows[-1] == K + 1
    at = few.rows - 2
    np.testing.assert_array_equal(few.T_base, whole.T_base[at])
    for corner in corners[1:-1]:
        assert np.min(np.abs(at - corner)) <= 2
    between = np.interp(np.arange(K), at, base[at])
    assert np.max(np.abs(between - base)) < 0.01
    assert np.std(few.T_base - base[at]) == pytest.approx(0.01, rel=0.1)  # the noise is no larger
    assert thinned_says(few) == f"{K} samples thinned to {len(few)}, all kept around the corners"
    assert thinned(few, most) is few and thinned_says(whole) == ""
    still = thinned(Recording(np.ones(1000), tmp_path / "a.csv", ""), 10)
    assert 2 <= len(still) <= 10


# The commands


def test_commands_say_what_is_left_out(tmp_path, capsys):
    lines = RECORDING.read_text().splitlines()
    column = lines[0].split(",").index("T_base_N")
    cells = lines[7].split(",")
    cells[column] = ""
    write(tmp_path, "\n".join([*lines[:7], ",".join(cells), *lines[8:]]), "rec.csv")
    (tmp_path / "columns.toml").write_text('schema = 1\n[columns]\nT_base = "T_base_N"\n')
    done = run_gtr(
        *(capsys, "fit", RECORDED, tmp_path / "rec.csv", "--columns", tmp_path / "columns.toml"),
        *("--drop", ":0.01", "-o", tmp_path / "out"),
    )
    assert done.status == 0
    said = "1 sample at 1 place without a number left out (row 8); 1 sample at 1 place dropped (row 2)"
    assert done.err.count(f"warning: {tmp_path / 'rec.csv'}: {said}\n") == 1
    settings = json.loads((tmp_path / "out/fit.json").read_text())["settings"]
    left_out = settings["left_out"][str(tmp_path / "rec.csv")]
    assert left_out["says"] == said and [m["rows"] for m in left_out["masked"]] == [[2, 2], [8, 8]]
    assert settings["inputs"]["columns 1"]["path"] == str(tmp_path / "columns.toml")


def test_one_mapping_for_each_recording_or_one_for_all(tmp_path, capsys):
    for command in ("fit", "diagnose"):
        done = run_gtr(
            *(capsys, command, RECORDED, RECORDING, "--columns", "T_base=a", "--columns", "T_base=b"),
            *("-o", tmp_path / "out"),
        )
        assert done.status == 2 and "--columns: given 2 times for 1 recording; give it once" in done.err


def test_glitches_are_not_kept_where_none_are_looked_for(tmp_path, capsys):
    history = tmp_path / "history.csv"
    history.write_text("time_s,T_base_N\n0,0\n1,5\n2,9\n3,2\n", encoding="utf-8")
    given = (
        "simulate",
        "examples/tdcm-1.toml",
        "--history",
        history,
        "--keep-glitches",
        "-o",
        tmp_path / "o",
    )
    done = run_gtr(capsys, *given)
    assert done.status == 2
    assert f"--keep-glitches: has no effect on {history}, in which no glitches are looked for" in done.err


@pytest.mark.parametrize("option", [["--columns", "T_base=a"], ["--keep-glitches"], ["--drop", "1:2"]])
def test_options_of_recordings_need_a_history(option, tmp_path, capsys):
    done = run_gtr(capsys, "simulate", RECORDED, "--pull", "5", *option, "-o", tmp_path / "out")
    assert done.status == 2 and f"{option[0]}: has no effect without --history" in done.err


def test_masked_is_a_plain_tuple():
    assert Masked((1, 2), None, "T_tip", "dropout", -5.0, "N").says == "rows 1 to 2: T_tip drops out by -5 N"
