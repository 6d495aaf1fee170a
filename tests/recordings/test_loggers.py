"""Recordings as loggers, load-cell amplifiers, testing machines and LabVIEW write them: read, or refused with
the remedy in one line. The files in tests/data/loggers that show a sheath were made with mu·theta = 0.5,
three.csv with 0.6.
"""

import gzip
import io
import json
import zipfile
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from command_line import run_gtr

from gtr_jax.errors import InputError
from gtr_jax.inspection.inspection import inspect
from gtr_jax.inspection.mapping import mapping as mapping_of
from gtr_jax.recordings.columns import read_columns
from gtr_jax.recordings.formats import csv_text, expansion
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.recordings.guessing import guess
from gtr_jax.recordings.recording import read_recording

LOGGERS = Path(__file__).parents[1] / "data" / "loggers"
# Files of the sheath, the mapping that each needs, and its samples.
SHEATH = {
    "instron.csv": ("T_base=Load,T_tip=Load cell 2", 690),
    "midnight.csv": ("T_base=Base (N),T_tip=Tip (N)", 690),
    "millishdr.csv": ("T_base=base_g[gf],T_tip=tip_g[gf],time=millis[ms]", 690),
    "nidaq.csv": ("T_base=Dev1/ai0 (N),T_tip=Dev1/ai1 (N)", 690),
    "nohdr.csv": ("T_base=column 2[gf],T_tip=column 3[gf],time=column 1[ms]", 690),
    "ints.csv": ("T_base=column 2[N],T_tip=column 3[N],time=column 1[s]", 200),
    "monitor.csv": ("T_base=column 2[gf],T_tip=column 3[gf]", 212),
    "labelled.txt": ("T_base=Load_cell 1 output val[gf],T_tip=Load_cell 2 output val[gf]", 94),
    "three.csv": (None, 397),
}


def refused(path, columns=None):
    """The one line that refuses a file."""
    with pytest.raises(InputError) as caught:
        read_recording(path, columns)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{path}: ")


def written(folder, text, name="log.txt"):
    """The path of a file with this text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", SHEATH)
def test_loggers_of_a_sheath(name):
    columns, count = SHEATH[name]
    recording = read_recording(LOGGERS / name, columns)
    assert len(recording) == count and recording.T_tip is not None
    pulled = recording.T_base[: int(np.argmax(recording.T_base))] > 5.0
    ratio = recording.T_tip[: len(pulled)][pulled] / recording.T_base[: len(pulled)][pulled]
    assert np.median(ratio) == pytest.approx(np.exp(-0.6 if name == "three.csv" else -0.5), rel=0.02)
    if name == "labelled.txt":
        assert recording.time is None
    else:
        assert recording.time is not None
        np.testing.assert_allclose(np.diff(recording.time), 0.1, atol=1.5e-3)


@pytest.mark.parametrize("name", [name for name in SHEATH if SHEATH[name][0]])
def test_the_mapping_that_a_refusal_asks_for_works(name):
    """Where no header says which column is which, the message has a mapping to add."""
    said = refused(LOGGERS / name)
    columns = said.rpartition("--columns '")[2].removesuffix("'")
    assert "NAME" not in columns
    read = read_recording(LOGGERS / name, columns)
    np.testing.assert_array_equal(read.T_base, read_recording(LOGGERS / name, SHEATH[name][0]).T_base)


def test_what_is_said_of_loggers():
    def notes(name):
        return read_recording(LOGGERS / name, SHEATH[name][0]).notes

    assert notes("nohdr.csv") == notes("ints.csv") == ("has no header: its columns are numbered",)
    assert notes("instron.csv") == ("holds 2 tables: the longest, rows 8 to 697, is read",)
    cut = "row 213, the last, is incomplete and left out"
    assert notes("monitor.csv") == (cut, "has no header: its columns are numbered")
    assert notes("labelled.txt") == ("row 95, the last, is incomplete and left out",)


MARKS = {
    "OVL,OVL,OVL": (30, "time_s", "OVL"),
    "Trial,two,begins": (30, "time_s", "Trial"),
    "paused,by,Jo": (30, "time_s", "paused"),
    "OVL,OVL,": (30, "time_s", "OVL"),
}


@pytest.mark.parametrize("large", [False, True], ids=["small", "large"])
@pytest.mark.parametrize("row", MARKS)
def test_a_row_of_words_inside_a_recording_is_refused(row, large, tmp_path, monkeypatch):
    if large:
        monkeypatch.setattr(csv_text, "LARGE", 0)
        monkeypatch.setattr(csv_text, "_HEAD", 4)
    lines = ["time_s,T_base_N,T_tip_N", *(f"{i},{i}.5,{i}.25" for i in range(60))]
    for place, more in ((30, []), (30, [*lines[30:]]), (1, ["OVL,OVL,OVL"])):
        if place == 1 and row != "OVL,OVL,OVL":
            continue
        text = "\n".join([*lines[:place], row, *more, *lines[place:]]) + "\n"
        said = refused(written(tmp_path, text, "r.csv"))
        assert said.startswith(
            f"row {place + 1}, column '{MARKS[row][1]}': expected a number, found '{MARKS[row][2]}'"
        ) or (row == "OVL,OVL," and said.startswith("row 31, column 'T"))


@pytest.mark.parametrize("large", [False, True], ids=["small", "large"])
def test_tables_of_as_many_columns_are_refused(large, tmp_path, monkeypatch):
    """They may be parts of one recording; of another width they are not."""
    if large:
        monkeypatch.setattr(csv_text, "LARGE", 0)
        monkeypatch.setattr(csv_text, "_HEAD", 4)
    rows = "".join(f"{i},{i}.5,{i}.25\n" for i in range(30))
    first = f"time_s,T_base_N,T_tip_N\n{rows}"
    for header, of in (
        ("time_s,T_base_N,T_tip_N", "with one header"),
        ("Clock,Force_N,Other_N", "of 3 columns"),
        ("one,two,three\ns,N,N", "of 3 columns"),
    ):
        said = refused(written(tmp_path, f"{first}{header}\n{rows}", "r.csv"))
        assert said.startswith(f"holds 2 tables {of}, their first rows 2, "), said
    wide = "one,two,three,four\n1,2,3,4\n"
    assert read_recording(written(tmp_path, first + wide, "r.csv")).notes == (
        "holds 2 tables: the longest, rows 2 to 31, is read",
    )


def test_a_logger_fits(tmp_path, capsys):
    """A file of a testing machine gives the friction of the sheath that made it."""
    outcome = run_gtr(
        capsys, "fit", LOGGERS / "cap.toml", LOGGERS / "nohdr.csv", "--columns", SHEATH["nohdr.csv"][0],
        "--free", "mu", "-o", tmp_path / "run",
    )  # fmt: skip
    assert outcome.status == 0, outcome.err
    mu = json.loads((tmp_path / "run/fit.json").read_text())["parameters"]["mu"]["value"]
    assert mu == pytest.approx(0.5, abs=0.02)  # theta is 1 rad


# Lines of serial monitors

STAMPS = [f"14:05:{i:02d}.500" for i in range(40)]
BASE, TIP = 2.0 * np.sin(np.arange(40) / 6) ** 2, np.sin(np.arange(40) / 6) ** 2
LINES = {
    "an arrow": (lambda t, a, b: f"{t} -> {a:.3f},{b:.3f}", "time,column 2,column 3"),
    "an arrow, blanks": (lambda t, a, b: f"{t} -> {a:.3f} {b:.3f}", "time,column 2,column 3"),
    "brackets": (lambda t, a, b: f"[2026-01-31 {t}] {a:.3f}\t{b:.3f}", "time,column 2,column 3"),
    "brackets of days": (lambda t, a, b: f"[31.01.2026 {t}]: {a:.3f};{b:.3f}", "time,column 2,column 3"),
    "a blank": (lambda t, a, b: f"{t} {a:.3f},{b:.3f}", "time,column 2,column 3"),
    "halves of the day": (lambda t, a, b: f"02{t[2:]} PM -> {a:.3f},{b:.3f}", "time,column 2,column 3"),
    "an arrow, names": (lambda t, a, b: f"{t} -> base: {a:.3f} g, tip: {b:.3f} g", "time,base,tip"),
    "colons": (lambda t, a, b: f"base:{a:.3f},tip:{b:.3f}", "base,tip"),
    "equals signs": (lambda t, a, b: f"base={a:.3f}\ttip={b:.3f}", "base,tip"),
    "bars": (lambda t, a, b: f"one reading:\t{a:.3f}\t| average:\t{b:.3f}", "one reading,average"),
    "JSON": (lambda t, a, b: f'{{"base": {a:.3f}, "tip": {b:.3f}}}', "base,tip"),
    "a number before": (lambda t, a, b: f"{t[6:8]}, base: {a:.3f}, tip: {b:.3f}", "column 1,base,tip"),
    "words": (lambda t, a, b: f"Base {a:.3f} Tip {b:.3f}", "Base,Tip"),
    "one name twice": (lambda t, a, b: f"val: {a:.3f} val: {b:.3f}", "val,val 2"),
}  # fmt: skip


@pytest.mark.parametrize("title", ["", "---- Opened the serial port COM3 ----\nHX711 ready\n"])
@pytest.mark.parametrize("name", LINES)
def test_lines_of_monitors(name, title, tmp_path):
    line, header = LINES[name]
    text = title + "".join(line(*own) + "\n" for own in zip(STAMPS, BASE, TIP, strict=True))
    table = read_table(written(tmp_path, text))
    assert ",".join(table.header) == header and not table.notes
    np.testing.assert_allclose(table.column(len(table.header) - 2), BASE, atol=6e-4)
    np.testing.assert_allclose(table.column(len(table.header) - 1), TIP, atol=6e-4)
    if table.header[0] == "time":
        np.testing.assert_array_equal(table.times(0), np.arange(40.0))
    assert table.numbers[0] == 1 + title.count("\n")


def test_lines_with_a_header_of_their_own(tmp_path):
    text = "14:04:59.000 -> base_g,tip_g\n" + "".join(f"{t} -> {i},{i}\n" for i, t in enumerate(STAMPS))
    assert read_table(written(tmp_path, text)).header == ["time", "base_g", "tip_g"]
    timed = "14:04:59.000 -> t,base_g\n" + text.partition("\n")[2]
    assert read_table(written(tmp_path, timed)).header == ["stamp", "t", "base_g"]


def test_lines_that_are_no_readings_are_left_out_and_said(tmp_path):
    lines = [f"{t} -> base: {i}.5, tip: {i}.25" for i, t in enumerate(STAMPS)]
    lines[7] += "\noverflow"
    table = read_table(written(tmp_path, "\n".join(lines)))
    assert table.notes == ("1 line that is not a reading is left out: 9",) and len(table.numbers) == 40
    assert table.units == []
    for i in range(20, 30):
        lines[i] += "\noverflow"
    assert refused(written(tmp_path, "\n".join(lines))) == (
        "row 9 reads 'overflow', 11 of 51 lines are not like the others; delete them, or log nothing but the "
        "readings"
    )


def test_cells_beside_words_are_no_named_numbers(tmp_path):
    text = "T_base_N,T_tip_N,note\n" + "1,x,trial 1\n" * 40
    assert refused(written(tmp_path, text, "r.csv")).startswith("row 2, column 'T_tip_N': expected a number")


# LabVIEW


@pytest.mark.parametrize(
    ("name", "header", "units", "first"),
    [
        ("short", ["time", "Excitation (Trigger)", "Response (Trigger)"], ["s", "Newtons", "m/s^2"],
         [[0.0, 3.90625e-05], [0.914018, 0.537321], [1.204792, 1.208403]]),
        ("with_comments", ["time", "Pressão ABS. (MPa)", "Temperatura (°C)", "Volume (ml)"],
         ["s", "MPa", "°C", "ml"],
         [[0.0, 0.328878], [1.833787, 1.522167], [5.479238, 5.310735], [0, 89.8214]]),
        ("with_empty_fields", ["time", "Dev0/Ai0", "Dev0/Ai2", "Dev0/Ai0 1"], ["s", "", "", ""],
         [[0.0, 0.001], [-0.011923, -0.009206], [7.254639, 7.254639], [-0.011923, -0.009206]]),
        ("multi_time_column", ["time", "Voltage", "Acceleration"], ["s", "Volts", "g"],
         [[0.0, 1.953125e-5], [-0.035229, -0.034882], [0.532608, 0.502991]]),
        ("no_decimal_separator", ["time", "ax", "ay", "az"], ["s", "g", "g", "g"],
         [[0.0, 0.00025], [-0.008807, -0.025979], [-0.028189, -0.03106], [0.021503, -0.005606]]),
    ],
)  # fmt: skip
def test_lvm(name, header, units, first):
    table = read_table(LOGGERS / f"{name}.lvm")
    assert table.header == header and table.units == units and not table.notes
    for index, cells in enumerate(first):
        np.testing.assert_array_equal(table.column(index)[:2], cells)
    text = (LOGGERS / f"{name}.lvm").read_bytes().decode("latin-1").split("\n")
    assert text[table.numbers[0] - 2].startswith("X_Value")


def test_lvm_is_mapped_with_its_units():
    recording = read_recording(
        LOGGERS / "short.lvm", "T_base=Response (Trigger)[N],T_tip=Excitation (Trigger)"
    )
    assert recording.T_tip is not None and recording.T_tip[0] == 0.914018
    said = refused(LOGGERS / "multi_time_column.lvm")
    assert said.startswith("no column T_base_N; columns found: time, Voltage, Acceleration;")


def test_lvm_of_several_stretches_and_clocks(tmp_path):
    text = (LOGGERS / "multi_time_column.lvm").read_text("latin-1").rstrip() + "\n"
    again = text[text.index("Channels\t") :].replace("10:45:47.03", "10:45:49.03")
    table = read_table(written(tmp_path, f"{text}\n{again}"))
    np.testing.assert_allclose(table.column(0)[[0, 3]], [0.0, 2.0], atol=1e-9)
    assert len(table.numbers) == 6
    slower = text.replace("1.953125E-5\t0.5", "2.953125E-5\t0.5")
    table = read_table(written(tmp_path, slower))
    assert table.header == ["time", "Voltage"]
    assert table.notes == ("'Acceleration' left out, whose clock is not that of 'Voltage'",)


def test_lvm_faults(tmp_path):
    text = (LOGGERS / "short.lvm").read_text("latin-1")
    assert refused(written(tmp_path, text[: text.index("X_Value")])).startswith(
        "a LabVIEW measurement without"
    )
    assert refused(written(tmp_path, text.replace("0,537321", "broken"))) == (
        "row 25, column 'Excitation (Trigger)': expected a number, found 'broken'; correct the cell or "
        "delete the row"
    )
    assert refused(written(tmp_path, text.rstrip() + "\n\n1,5\n")).startswith("row 35: expected a stretch's")
    assert refused(written(tmp_path, text.replace("Delta_X\t3", "Delta_X\tx3"))).startswith(
        "Delta_X: expected"
    )


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    table = read_table(LOGGERS / "raw1.tdms")
    assert table.header[:3] == ["time", "First  Channel", "Second Chan"] and table.units[:2] == ["s", "Volts"]
    np.testing.assert_allclose(table.column(0)[:3], [0.0, 2e-5, 4e-5], rtol=1e-12)
    # A message shows one blank where the name has two: either will do.
    mapped = read_recording(LOGGERS / "raw1.tdms", "T_base=Second Chan*5[N],T_tip=First Channel*2+1[N]")
    np.testing.assert_array_equal(mapped.T_base, 5.0 * table.column(2))
    path = tmp_path / "recording.tdms"
    stamps = np.datetime64("2026-01-31T14:05:00") + np.arange(5) * np.timedelta64(100, "ms")
    with nptdms.TdmsWriter(path) as writer:
        for group in "ab":
            channels = [
                nptdms.ChannelObject(group, "stamp", stamps),
                nptdms.ChannelObject(group, "cell", np.arange(5.0) ** 2, {"unit_string": "Newtons"}),
                nptdms.ChannelObject(group, "note", np.array(["x"] * 5)),
                nptdms.ChannelObject(group, "slow", np.arange(2.0)),
            ]
            writer.write_segment(channels)
    table = read_table(path)
    assert table.header == ["a/stamp", "a/cell", "b/stamp", "b/cell"]
    assert table.notes == ("'slow', 'slow' left out, of another length than most",)
    recording = read_recording(path, "time=a/stamp,T_base=a/cell,T_tip=b/cell")
    assert recording.time is not None
    np.testing.assert_allclose(recording.time, 0.1 * np.arange(5), rtol=1e-12)
    np.testing.assert_array_equal(recording.T_base, np.arange(5.0) ** 2)
    path.write_bytes((LOGGERS / "raw1.tdms").read_bytes()[:200])
    assert refused(path) == "no channel of this TDMS file holds numbers; at least one is needed"
    sound = (LOGGERS / "raw1.tdms").read_bytes()
    path.write_bytes(sound[:40] + 100 * b"\xff" + sound[140:])
    assert refused(path).startswith("not a complete TDMS file (")


# Workbooks and compressed files


def workbook(path, sheets):
    """A workbook of these sheets of rows."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def test_workbooks(tmp_path):
    start = datetime(2026, 1, 31, 23, 59, 50)
    stamps = [start + timedelta(milliseconds=500 * i) for i in range(40)]
    rows = [
        ["Pull test", None, None], ["Time", "Load", "Load cell 2"], [None, "[N]", "[mN]"],
        *([t, float(a), float(b)] for t, a, b in zip(stamps, BASE, TIP, strict=True)),
    ]  # fmt: skip
    path = workbook(tmp_path / "r.xlsx", {"Summary": [["Peak", "N"], ["A", 20.0]], "Raw": rows})
    recording = read_recording(path, "T_base=Load,T_tip=Load cell 2")
    assert recording.notes == ("of 2 sheets, 'Raw' is read",)
    assert recording.time is not None and recording.T_tip is not None
    np.testing.assert_allclose(recording.time, 0.5 * np.arange(40), rtol=1e-12)
    np.testing.assert_allclose(recording.T_base, BASE, rtol=1e-15)
    np.testing.assert_allclose(recording.T_tip, TIP / 1000, rtol=1e-15)
    np.testing.assert_array_equal(recording.rows, np.arange(4, 44))
    clocks = [[t.time(), a, b] for t, a, b in rows[3:]]
    path = workbook(tmp_path / "c.xlsx", {"S": [["time", "T_base_N", "T_tip_N"], *clocks]})
    np.testing.assert_allclose(np.asarray(read_recording(path).time), 0.5 * np.arange(40), rtol=1e-12)
    rows[10][1] = "broken"
    path = workbook(tmp_path / "r.xlsx", {"Raw": rows})
    assert refused(path, "T_base=Load,T_tip=Load cell 2").startswith(
        "row 11, column 'Load': expected a number"
    )


def test_workbooks_that_are_none(tmp_path):
    path = tmp_path / "r.xlsx"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.csv", "T_base_N,T_tip_N\n1,1\n")
    assert refused(path) == "an archive and no workbook; unpack it and name the file in it"
    workbook(path, {"S": [["a", "b"]]})
    assert refused(path).startswith("no sheet of this workbook holds rows of numbers")
    path.write_bytes(path.read_bytes()[:-200])
    assert refused(path).startswith("not a complete workbook or archive (")
    path.write_bytes(b"\xd0\xcf\x11\xe0" + bytes(600))
    assert refused(path).startswith("not a complete workbook, or one of too many cells (")


def test_a_workbook_of_two_cells_far_apart(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = "T_base_N", 1.0
    book.save(tmp_path / "r.xlsx")
    assert refused(tmp_path / "r.xlsx").startswith("not a complete workbook, or one of too many cells (")


def test_compressed_files(tmp_path):
    for name in ("nohdr.csv", "monitor.csv", "short.lvm", "raw1.tdms"):
        path = tmp_path / f"{name}.gz"
        path.write_bytes(gzip.compress((LOGGERS / name).read_bytes()))
        table, plain = read_table(path), read_table(LOGGERS / name)
        assert table.header == plain.header and table.path == path
        np.testing.assert_array_equal(table.column(1), plain.column(1))
    path.write_bytes(path.read_bytes()[:-9])
    assert refused(path).startswith("not a complete gzip file (")


def test_compressed_files_of_endless_zeros(tmp_path, monkeypatch):
    monkeypatch.setattr(expansion, "LARGEST", 2**20)
    path = tmp_path / "r.csv.gz"
    path.write_bytes(gzip.compress(bytes(2**20 + 1)))
    says = "expands to more than 1 MiB; export fewer columns, a shorter stretch, or fewer samples"
    assert refused(path) == says
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", bytes(2**20 + 1))
    path = tmp_path / "r.xlsx"
    path.write_bytes(stream.getvalue())
    assert refused(path) == says


# Counts


COUNTS = "raw_0,raw_1,cell-1\n" + "".join(f"{84213 + 100 * i},{50 * i},{i}\n" for i in range(5))


@pytest.mark.parametrize(
    ("text", "base"),
    [
        ("raw_1*0.01[N]", [0, 0.5, 1, 1.5, 2]),
        ("raw_1*0.01-0.25[N]", [-0.25, 0.25, 0.75, 1.25, 1.75]),
        ("raw_1*0.01[N]-0.25", [-0.25, 0.25, 0.75, 1.25, 1.75]),
        ("raw_1 * 1e1 + 5 [mN]", [0.005, 0.505, 1.005, 1.505, 2.005]),
        ("(raw_0-84213)/100[N]", [0, 1, 2, 3, 4]),
        ("(raw_0 - 84213)*-0.01+5[N]", [5, 4, 3, 2, 1]),
        ("cell-1*2", [0, 2, 4, 6, 8]),
        ("cell-1", [0, 1, 2, 3, 4]),
    ],
)
def test_counts_are_converted(text, base, tmp_path):
    path = written(tmp_path, COUNTS, "counts.csv")
    np.testing.assert_allclose(
        read_recording(path, f"T_base={text}", need_tip=False).T_base, base, atol=1e-12
    )
    mapping = written(tmp_path, f'schema = 1\n[columns]\nT_base = "{text}"\n', "columns.toml")
    np.testing.assert_allclose(read_recording(path, mapping, need_tip=False).T_base, base, atol=1e-12)
    assert read_columns(mapping).entries == (("T_base", text),)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("raw_9*0.01[N]", "--columns: no column 'raw_9' for T_base; did you mean 'raw_"),
        ("raw_1-0.25[N]", "--columns: no column 'raw_1-0.25' for T_base; did you mean"),
        ("raw_1*0[N]", "--columns: T_base: a factor of 0 leaves nothing of column 'raw_1'; correct it"),
        ("raw_1/0[N]", "--columns: T_base: a factor of 0 leaves nothing of column 'raw_1'; correct it"),
        ("raw_1*1e999[N]", "--columns: T_base: 'raw_1*1e999[N]' is not finite; correct its numbers"),
    ],
)
def test_counts_that_cannot_be_converted(text, says, tmp_path):
    assert refused(written(tmp_path, COUNTS, "counts.csv"), f"T_base={text},T_tip=cell-1").startswith(says)


def test_counts_are_no_forces(tmp_path):
    """What `gtr inspect` is told of counts has the remedy."""
    rows = enumerate(zip(BASE, TIP, strict=True))
    text = "".join(f"{0.1 * i:.1f},{round(1000 * a)},{round(1000 * b)}\n" for i, (a, b) in rows)
    path = written(tmp_path, f"time_s,raw_0,raw_1\n{text}", "counts.csv")
    (note,) = guess(read_table(path)).quantities["T_base"].notes
    assert note.startswith("'raw_0' holds raw counts, no force: ") and "T_base=raw_0*0.0098-1.2[N]" in note


def test_inspect_keeps_the_conversion(tmp_path):
    path = written(tmp_path, COUNTS, "counts.csv")
    table = read_table(path)
    said = read_columns("T_base=(raw_0-84213)/100[N],T_tip=raw_1*0.01")
    columns = mapping_of(table, guess(table), said).columns
    assert columns == {"T_base": "raw_0*0.01-842.13 [N]", "T_tip": "raw_1*0.01 [N]"}
    again = read_recording(path, ",".join(f"{key}={text}" for key, text in columns.items()))
    np.testing.assert_allclose(again.T_base, np.arange(5), atol=1e-9)
    units = read_table(written(tmp_path, "a,b\nmN,N\n1,1\n2,2\n", "units.csv"))
    assert mapping_of(units, guess(units), read_columns("T_base=a,T_tip=b")).columns["T_base"] == "a [mN]"


# Rows that are logged several times


@pytest.mark.parametrize("stamped", [True, False], ids=["stamps repeat", "stamps go on"])
def test_rows_that_are_logged_several_times_are_no_stuck_cell(stamped):
    once = read_recording(LOGGERS / "millishdr.csv", SHEATH["millishdr.csv"][0])
    assert once.time is not None and once.T_tip is not None
    times = np.random.default_rng(1).integers(3, 6, len(once))
    rows = np.repeat(np.arange(len(once)), times)
    time = once.time[rows] if stamped else 0.025 * np.arange(len(rows))
    found = inspect(replace(once, T_base=once.T_base[rows], T_tip=once.T_tip[rows], time=time))
    for cell, alone in ((found.base, inspect(once).base), (found.tip, inspect(once).tip)):
        assert not cell.dead and not cell.saturated
        assert cell.noise.white_N == pytest.approx(alone.noise.white_N, rel=0.1)
    dead = np.array(once.T_tip[rows])
    begin, end = np.searchsorted(rows, [100, 160])
    dead[begin:end] = dead[begin]
    found = inspect(replace(once, T_base=once.T_base[rows], T_tip=dead, time=time))
    (stretch,) = found.tip.dead
    assert abs(stretch.where.first - begin) < 10 and abs(stretch.where.last - end) < 10


# What is not a tension


def test_clocks_and_displacements_are_no_tensions(tmp_path):
    base, tip = np.round(20 * BASE, 3), np.round(12 * TIP, 3)
    clock = np.repeat(np.arange(20) * 100, 2)  # each stamp twice
    text = "n_load,F1,F2\n" + "".join(f"{t},{a},{b}\n" for t, a, b in zip(clock, base, tip, strict=True))
    found = guess(read_table(written(tmp_path, text))).quantities
    assert {key: own.header for key, own in found.items()} == {
        "time": "n_load",
        "T_base": "F1",
        "T_tip": "F2",
    }
    pose = "time_s,T_base_N,tip_z_m,tip_y_m\n" + "".join(
        f"{0.1 * i:.1f},{a},{-b / 2000},{b / 2000}\n" for i, (a, b) in enumerate(zip(base, tip, strict=True))
    )
    found = guess(read_table(written(tmp_path, pose)))
    assert found.missing == ("T_tip",)
    for name in ("tip_qx", "stroke", "displacement_m.left", "m1_x"):
        assert guess(read_table(written(tmp_path, pose.replace("tip_y_m", name)))).missing == ("T_tip",)
    unnamed = pose.replace("tip_z_m", "P1").replace("tip_y_m", "P2 [mm]")
    assert guess(read_table(written(tmp_path, unnamed))).missing == ("T_tip",)


def test_a_file_of_several_tendons_is_not_guessed_to_be_of_one(tmp_path):
    text = "displacement_m.a,T_base_N.a,T_base_N.b\n" + "".join(
        f"{-b / 2000},{20 * a},{12 * b}\n" for a, b in zip(BASE, TIP, strict=True)
    )
    path = written(tmp_path, text)
    assert guess(read_table(path)).missing == ("T_base", "T_tip")
    assert refused(path).startswith("no column T_base_N, but T_base_N.a, T_base_N.b of several tendons;")


def test_a_steady_pull_is_no_clock(tmp_path):
    """Forces that a machine raises evenly are forces by their names."""
    rows = "".join(f"{0.5 * i:.2f},{0.2 * i:.3f}\n" for i in range(60))
    for header in ("Load cell base,Load cell tip", "F1 [N],F2 [N]"):
        found = guess(read_table(written(tmp_path, f"{header}\n{rows}", "r.csv"))).quantities
        base, tip = header.split(",")
        assert {key: own.header for key, own in found.items()} == {"T_base": base, "T_tip": tip}
    timed = "n,Load cell base,Load cell tip\n" + "".join(
        f"{i // 2},{a}\n" for i, a in enumerate(rows.splitlines())
    )
    found = guess(read_table(written(tmp_path, timed, "r.csv"))).quantities
    assert [own.header for own in found.values()] == ["n", "Load cell base", "Load cell tip"]
    assert "n_load" in refused(written(tmp_path, timed.replace("n,", "n_load,", 1), "r.csv"))
