"""Recordings: headers, units, column mapping, and one line for everything that can be wrong in one."""

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from gtr_jax.errors import InputError
from gtr_jax.recordings.formats.csv_writing import MANY
from gtr_jax.recordings.recording import Recording, read_recording, write_recording

SHARED = Path(__file__).parents[3] / "shared/data"
GIRAFFE = SHARED / "giraffe/loadcell_measurements.csv"
GIRAFFE_COLUMNS = "T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]"

GOOD = "time_s,T_base_N,T_tip_N\n0,0,0\n1,10,6\n2,20,12\n3,10,9\n"


def write(folder, text, name="recording.csv"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def fault(folder, text, columns=None, **options):
    """The error message of a recording, which must be one line that begins with the file's name."""
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        read_recording(path, columns, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def test_canonical_headers(tmp_path):
    path = write(
        tmp_path,
        "time_s,T_base_N,T_tip_N,tip_x_m,tip_y_m,tip_angle_rad,displacement_m,trial,note\n"
        "0,0.5,-0.01,0.25,0,0,0,1,start\n2,10,6,0.2,0.1,0.5,0.003,2,\n",
    )
    recording = read_recording(path)
    assert len(recording) == 2
    np.testing.assert_array_equal(recording.T_tip, [-0.01, 6.0])
    np.testing.assert_array_equal(recording.tip_angle, [0.0, 0.5])
    np.testing.assert_array_equal(recording.displacement, [0.0, 0.003])
    np.testing.assert_array_equal(recording.trial, [1.0, 2.0])
    assert recording.T_base.dtype == np.float64 and not recording.T_base.flags.writeable
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert recording.path == path


@pytest.mark.parametrize(
    ("header", "scale"),
    [
        ("t,Tbase,Ttip", (1, 1)),
        ("Time [ms],Tbase [N],T_tip (N)", (1e-3, 1)),
        ("time_ms,T_base_gf,T_tip_gf", (1e-3, 9.80665e-3)),
        ("TIME,base tension [kgf],tip tension [kgf]", (1, 9.80665)),
        ("t_s,T base mN,T-tip_mN", (1, 1e-3)),
    ],
)
def test_common_spellings_and_units(tmp_path, header, scale):
    recording = read_recording(write(tmp_path, f"{header}\n0,1,0.5\n1,2,1\n"))
    assert recording.time is not None and recording.T_tip is not None
    np.testing.assert_allclose(recording.time, np.array([0, 1]) * scale[0], rtol=1e-15)
    np.testing.assert_allclose(recording.T_base, np.array([1, 2]) * scale[1], rtol=1e-15)
    np.testing.assert_allclose(recording.T_tip, np.array([0.5, 1]) * scale[1], rtol=1e-15)


def test_the_canonical_header_wins_over_a_spelling(tmp_path):
    recording = read_recording(write(tmp_path, "T_base_N,Tbase [gf],T_tip_N\n2,900,1\n"))
    np.testing.assert_array_equal(recording.T_base, [2.0])


def test_mapped_columns(tmp_path):
    text = ",Clock,layout.dim,data_0,data_2,force[raw]\n0,0,[],100,50,1\n1,500,[],200,80,2\n"
    recording = read_recording(write(tmp_path, text), "T_base=data_0[gf], T_tip=data_2 [gf],time=Clock[ms]")
    np.testing.assert_allclose(recording.T_base, [0.980665, 1.96133], rtol=1e-15)
    np.testing.assert_array_equal(recording.time, [0.0, 0.5])
    recording = read_recording(write(tmp_path, text), "Tbase=data_0,T_tip=force[raw][mN]")
    np.testing.assert_array_equal(recording.T_base, [100.0, 200.0])
    np.testing.assert_array_equal(recording.T_tip, [0.001, 0.002])
    assert recording.time is None


def test_what_the_mapping_leaves_out_is_found_in_the_header(tmp_path):
    recording = read_recording(write(tmp_path, "time_s,T_base_N,cell3\n0,10,5\n"), "T_tip=cell3[N]")
    np.testing.assert_array_equal(recording.time, [0.0])
    np.testing.assert_array_equal(recording.T_base, [10.0])


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace(",", ";"),
        GOOD.replace(",", "\t"),
        GOOD.replace("\n", "\r\n"),
        "\n" + GOOD + "\n\n",
        "\ufeff" + GOOD,
        GOOD.replace("time_s", '"time_s"'),
    ],
)
def test_other_forms_of_csv(tmp_path, text):
    np.testing.assert_array_equal(read_recording(write(tmp_path, text)).T_base, [0, 10, 20, 10])


EXPORTED = "time_s,T_base_N,T_tip_N\n0,0.5,0.25\n1,1234.5,6.5\n2,20,12.5\n"
DECIMAL = EXPORTED.replace(",", ";").replace(".", ",")
EXPORTS = {
    "decimal comma": DECIMAL,
    "thousands and decimal comma": DECIMAL.replace("1234,5", "1.234,5"),
    "thousands parted by points": DECIMAL.replace("1234,5", "1.234,5").replace("20;", "20,0;"),
    "thousands parted by commas": EXPORTED.replace("1234.5", '"1,234.5"'),
    "thousands parted by blanks": DECIMAL.replace("1234,5", "1 234,5"),
    "thousands parted by apostrophes": EXPORTED.replace("1234.5", "1'234.5"),
    "comments": f"# rig 2, spring 0.5\n# {{\n{EXPORTED}# done\n",
    "header in a comment": f"# {EXPORTED}",
    "title": f"Pull test, rig 2\n{EXPORTED}",
    "title in a padded row": f"Pull test,,\n{EXPORTED}",
    "title above semicolons": f"Prüfung 3,5 mm\n{DECIMAL}",
    "name and value above": f"Operator,Jane\nRate,100\n\n{EXPORTED}",
    "sep=;": f"sep=;\n{DECIMAL}",
    "sep=; with a byte-order mark": f"\ufeffsep=;\r\n{DECIMAL}".replace("\n", "\r\n"),
    "units below": EXPORTED.replace("\n0,", "\ns,N,N\n0,", 1),
    "units in brackets below": EXPORTED.replace("\n0,", "\n[s],(N),[N]\n0,", 1),
    "Latin-1": EXPORTED.replace("\n", ",Prüfling µ\n").encode("latin-1"),
    "UTF-16": EXPORTED.encode("utf-16"),
    "UTF-16 without a mark": EXPORTED.encode("utf-16-le"),
    "UTF-16, other end first": EXPORTED.encode("utf-16-be"),
    "UTF-8 with a mark": EXPORTED.encode("utf-8-sig"),
    "separator at the end of the rows": EXPORTED.replace("5\n", "5,\n"),
    "units above names of cells": EXPORTED.replace("\n0,", "\ns,N,N\n,cell-a,cell-b\n0,", 1),
    "names of cells above units": EXPORTED.replace("\n0,", "\n,cell-a,cell-b\ns,N,N\n0,", 1),
    "a small table above": f"Results\n,Peak (N),At (mm)\n1,1234.5,4.0\n\nRaw data\n{EXPORTED}",
    "a wider table above": f"Sample,Peak,At,Area,Rate\nA,1,2,3,4\n{EXPORTED}",
    "a small table below": f"{EXPORTED}\nStatistics\nquantity,mean,sd\nbase,1,2\n",
    "a last line that is cut off": EXPORTED + "3,25",
    "minus signs of typesetters": EXPORTED.replace("0.5", "\u22120.5"),
}


@pytest.mark.parametrize("name", EXPORTS)
def test_exports_of_other_programs(tmp_path, name):
    recording = read_recording(write(tmp_path, EXPORTS[name]))
    assert recording.time is not None and recording.T_tip is not None
    np.testing.assert_array_equal(recording.time, [0, 1, 2])
    first = -0.5 if "minus" in name else 0.5
    np.testing.assert_array_equal(recording.T_base, [first, 1234.5, 20])
    np.testing.assert_array_equal(recording.T_tip, [0.25, 6.5, 12.5])


def test_units_in_a_row_are_converted(tmp_path):
    recording = read_recording(
        write(tmp_path, "time,T_base,T_tip\n(ms),(gf),(mN)\n0,500,200\n100,1000,400\n")
    )
    np.testing.assert_allclose(recording.T_base, [4.903325, 9.80665], rtol=1e-15)
    assert recording.T_tip is not None
    np.testing.assert_allclose(recording.T_tip, [0.2, 0.4], rtol=1e-15)
    np.testing.assert_array_equal(recording.time, [0, 0.1])
    mapped = read_recording(recording.path, "T_base=T_base[N]")
    np.testing.assert_array_equal(mapped.T_base, [500, 1000])


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        (("2026-01-31T14:05:00.25", "2026-01-31T14:05:01.5"), 1.25),
        (("2026-01-31 23:59:59Z", "2026-02-01 00:00:01.000000250Z"), 2.00000025),
        (("2026-01-31T14:05:00+01:00", "2026-01-31T14:05:00+00:00"), 3600.0),
        (("9:59:59.5", "10:00:00"), 0.5),
        (("23:59:59.5", "00:00:01"), 1.5),
        (("11:59:59.5 PM", "12:00:00.25 am"), 0.75),
        (("12:59:59 PM", "1:00:00 PM"), 1.0),
        (("01/31/2026 02:05:00.250000 PM", "01/31/2026 02:05:01.500000 PM"), 1.25),
        (("01/31/2026 11:59:59 PM", "02/01/2026 12:00:01 AM"), 2.0),
        (("31/01/2026 23:59:59", "01/02/2026 00:00:01"), 2.0),
        (("1.2.2026 14:05:00.5", "2.2.2026 14:05:00.5"), 86400.0),
        (("01/02/2026 14:05:00.5", "01/02/2026 14:05:01"), 0.5),
        (("2026/01/31 9:05:00.5", "2026/02/01 9:05:01"), 86400.5),
        (("31-Jan-2026 14:05:00", "01-Feb-2026 14:05"), 86400.0),
    ],
)
def test_time_stamps_are_seconds_since_the_first(tmp_path, stamps, seconds):
    text = "Timestamp,T_base_N,T_tip_N\n{},0,0\n{},10,6\n".format(*stamps)
    recording = read_recording(write(tmp_path, text))
    assert recording.time is not None
    np.testing.assert_allclose(recording.time, [0, seconds], rtol=1e-12)


def test_columns_that_nobody_mapped_are_in_nobodys_way(tmp_path):
    text = "Timestamp,Time [s],trial,displacement_m,T_base_N,T_tip_N\n"
    rows = "Monday 14:05,0,A,,0,0\nMonday 14:06,2,B,,10,6\n"
    recording = read_recording(write(tmp_path, text + rows))
    np.testing.assert_array_equal(recording.time, [0, 2])
    assert recording.trial is None and recording.displacement is None
    unmapped = read_recording(write(tmp_path, (text + rows).replace("Time [s]", "clock")))
    assert unmapped.time is None
    stamped = read_recording(write(tmp_path, (text + rows).replace("Monday", "2026-01-31")))
    np.testing.assert_array_equal(stamped.time, [0, 2])  # numbers before time stamps


def test_a_history_needs_no_tip(tmp_path):
    recording = read_recording(write(tmp_path, "T_base_N\n0\n10\n"), need_tip=False)
    assert recording.T_tip is None and len(recording) == 2


def test_noise_about_zero_is_kept(tmp_path):
    text = "T_base_N,T_tip_N\n-0.02,-0.09\n30,0.05\n-0.01,-0.08\n"
    np.testing.assert_array_equal(read_recording(write(tmp_path, text)).T_tip, [-0.09, 0.05, -0.08])


FAULTS = {
    "empty": ("", None, "the file is empty"),
    "header only": (
        "T_base_N,T_tip_N\n",
        None,
        "has a header but no rows; at least one row of numbers is needed",
    ),
    "binary": (b"\x89PNG\x0d\x00\xff", None, "not a text file; save it as plain text in UTF-8"),
    "missing column": (
        "time_s,T_base_N,T_tp_N\n0,1,1\n",
        None,
        "no column T_tip_N; columns found: time_s, T_base_N, T_tp_N (nearest: 'T_tp_N'); "
        "rename one, or add --columns 'T_tip=T_tp_N[N]'",
    ),
    "missing base": (
        "a,b\n1,1\n",
        None,
        "no column T_base_N; columns found: a, b; rename one, or add --columns",
    ),
    "unknown unit": (
        "Tbase [Newtn],T_tip_N\n1,1\n",
        None,
        "column 'Tbase [Newtn]': unknown unit 'Newtn'; give its unit with --columns 'T_base=",
    ),
    "wrong unit": (
        "Tbase [mm],T_tip_N\n1,1\n",
        None,
        "column 'Tbase [mm]': 'mm' is not a unit of a force; give",
    ),
    "mapped unknown unit": (
        GOOD,
        "T_tip=T_tip_N[gff]",
        "column 'T_tip_N': unknown unit 'gff'; give its unit",
    ),
    "text in a cell": (
        GOOD.replace("20,12", "20,n/a"),
        None,
        "row 4, column 'T_tip_N': expected a number, found 'n/a'; correct the cell or delete the row",
    ),
    "row numbers as in an editor": ("\n" + GOOD.replace("20,12", "\n20,x,1"), None, "row 5 has 2 cells"),
    "nan": (GOOD.replace("1,10", "1,NaN"), None, "row 3, column 'T_base_N': expected a number, found 'NaN'"),
    "infinity": (
        GOOD.replace("1,10", "1,inf"),
        None,
        "row 3, column 'T_base_N': expected a number, found 'inf'",
    ),
    "empty cell": (
        GOOD.replace("1,10", "1,"),
        None,
        "row 3, column 'T_base_N': expected a number, found an empty cell",
    ),
    "commas that may be either": (
        'T_base_N,T_tip_N\n"1,234","1,111"\n"2,345","1,222"\n',
        None,
        "'1,234' may be 1.234 or 1234; export it again with decimal points and without thousands separators",
    ),
    "both decimal marks": (
        "T_base_N;T_tip_N\n1,5;0.5\n",
        None,
        "decimals take both marks, '0.5' and '1,5'; export it again",
    ),
    "decimal commas parted by commas": (
        "T_base_N,T_tip_N\n1,5,1,2\n2,5,1,3\n",
        None,
        "row 2 has 4 cells and the header 2; if these are decimal commas, export with semicolons",
    ),
    "parted by blanks": (
        GOOD.replace(",", " "),
        None,
        "blanks separate its numbers; separate the cells with commas, semicolons or tabs",
    ),
    "no header": (
        "0,0,0\n1,10,6\n",
        None,
        "has no header, so that its columns are numbered: column 1, column 2, column 3; put their "
        "names above, for example time_s,T_base_N,T_tip_N, or say which they are, for example "
        "--columns 'T_base=column 2[N],T_tip=column 3[N]'",
    ),
    "workbook": (
        b"PK\x03\x04\x14\x00",
        None,
        "not a complete workbook or archive (File is not a zip file); export it again",
    ),
    "stroke between digits": (
        GOOD.replace("1,10", "1,1_0"),
        None,
        "row 3, column 'T_base_N': expected a number",
    ),
    "mapped time of another kind": (
        "When,T_base_N,T_tip_N\n10:00 on Monday,0,0\n",
        "time=When",
        "row 2, column 'When': expected seconds or a time stamp such as 2026-01-31T14:05:00.25, found '10:00",
    ),
    "days and months that may be either": (
        "time,T_base_N,T_tip_N\n01/02/2026 10:00:00,0,0\n02/02/2026 10:00:00,1,1\n",
        None,
        "column 'time': '01/02/2026 10:00:00' may begin with the day or with the month; write dates as",
    ),
    "a broken time stamp": (
        "time,T_base_N,T_tip_N\n2026-01-31T14:05:00,0,0\nlater,1,1\n",
        None,
        "row 3, column 'time': expected seconds or a time stamp",
    ),
    "grams": (
        "Tbase [g],Ttip [g]\n1,1\n",
        None,
        "column 'Tbase [g]': 'g' is not a unit of a force; grams-force are written gf; "
        "give its unit with --columns 'T_base=Tbase [g][gf]'",
    ),
    "other names": (
        "Bend,F_base_g,F_tip_g\n1,5,2\n",
        None,
        "no column T_base_N; columns found: Bend, F_base_g, F_tip_g (nearest: 'F_base_g'); rename one, or "
        "add --columns 'T_base=F_base_g[gf],T_tip=F_tip_g[gf]'",
    ),
    "other names, units in a row": (
        "Clock,Distal load,Proximal load\n[s],[mN],[mN]\n0,200,500\n1,300,600\n",
        None,
        "no column T_base_N; columns found: Clock, Distal load, Proximal load (nearest: 'Proximal load'); "
        "rename one, or add --columns 'T_base=Proximal load[mN],T_tip=Distal load[mN]'",
    ),
    "no unit, but many of it": (
        "base,tip\n0,0\n1500,700\n",
        None,
        "no column T_base_N; columns found: base, tip (nearest: 'base'); rename one, or add "
        "--columns 'T_base=base[gf],T_tip=tip[gf]'",
    ),
    "nothing suggests itself": (
        "Load cell 1,Load cell 2,Bend\n1,1,1\n",
        None,
        "no column T_base_N; columns found: Load cell 1, Load cell 2, Bend; rename one, or add "
        "--columns 'T_base=NAME[N],T_tip=NAME[N]'",
    ),
    "two tendons, none named": (
        "T_base_N.left,T_base_N.right\n0,0\n1,1\n",
        None,
        "no column T_base_N, but T_base_N.left, T_base_N.right of several tendons; for one tendon rename its "
        "column to T_base_N; several are named in the robot file, as [[tendons]], or in Python, "
        "read_recording(..., tendons=('left', 'right'))",
    ),
    "time backwards": (
        GOOD.replace("2,20", "0.5,20"),
        None,
        "row 4, column 'time_s': time goes backwards, from 1 s to 0.5 s; put the rows in time order",
    ),
    "swapped": (
        "T_base_N,T_tip_N\n0,0\n12,20\n",
        None,
        "row 3, column 'T_tip_N': T_tip peaks at 20 N and T_base at 12 N; columns swapped or units mixed?",
    ),
    "reversed sign": (
        "T_base_N,T_tip_N\n0.1,0\n-20,-12\n",
        None,
        "row 3, column 'T_base_N': T_base peaks at -20 N, but a tendon only pulls; reverse the sign",
    ),
    "reversed tip": (
        "T_base_N,T_tip_N\n0.1,0\n20,-12\n",
        None,
        "row 3, column 'T_tip_N': T_tip peaks at -12 N",
    ),
    "several recordings": (
        f"{GOOD}\n{GOOD}",
        None,
        "holds 2 tables with one header, their first rows 2, 8; give each recording a file of its own",
    ),
    "ragged": (
        GOOD.replace("1,10,6", "1,10"),
        None,
        "row 3 has 2 cells and the header 3; complete or delete the row",
    ),
    "two columns": (
        "Tbase,T_base,T_tip\n1,1,1\n",
        None,
        "'Tbase' and 'T_base' all name T_base; choose one with --columns 'T_base=Tbase'",
    ),
    "mapping without =": (
        GOOD,
        "T_base",
        "--columns: cannot read 'T_base'; write for example 'T_base=data_0[gf]",
    ),
    "mapping unknown": (GOOD, "Tbse=T_base_N", "--columns: unknown quantity 'Tbse'; did you mean 'T_base'?"),
    "mapping absent": (
        GOOD,
        "T_base=T_bas_N[gf]",
        "--columns: no column 'T_bas_N' for T_base; did you mean 'T_base_N'?",
    ),
    "mapping twice": (
        GOOD,
        "T_base=T_base_N,T_base=T_tip_N",
        "--columns: T_base is mapped twice; remove one",
    ),
    "mapping doubled": (
        "a,a\n1,1\n",
        "T_base=a",
        "--columns: column 'a' is in the header twice; rename one",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_take_one_line(tmp_path, name):
    text, columns, says = FAULTS[name]
    assert fault(tmp_path, text, columns).startswith(says)


def test_absent_file(tmp_path):
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'x.csv'}: no such file; check the path")):
        read_recording(tmp_path / "x.csv")


def test_written_recordings_read_back_exactly(tmp_path):
    rng = np.random.default_rng(0)
    given = {
        "T_tip": rng.random(5),
        "T_base": 1 + rng.random(5),
        "phase": ["pulling"] * 5,
        "tip_x": rng.random(5),
    }
    write_recording(tmp_path / "run" / "simulation.csv", given)
    first = (tmp_path / "run" / "simulation.csv").read_text().splitlines()[0]
    assert first == "T_base_N,T_tip_N,tip_x_m,phase"
    recording = read_recording(tmp_path / "run" / "simulation.csv")
    for quantity in ("T_base", "T_tip", "tip_x"):
        np.testing.assert_array_equal(getattr(recording, quantity), given[quantity])
    write_recording(tmp_path / "again.csv", recording)
    again = read_recording(tmp_path / "again.csv")
    assert isinstance(again, Recording) and again.tip_y is None
    np.testing.assert_array_equal(again.T_tip, recording.T_tip)


def test_very_long_recordings_are_written_as_short_ones_are(tmp_path):
    rng = np.random.default_rng(0)
    T_base = np.concatenate([10.0 ** rng.uniform(-9, 9, MANY), [0.0, 1e22, 5e-324, 123456789.0]])
    given = {"time": np.arange(float(len(T_base))), "T_base": T_base, "T_tip": 0.5 * T_base}
    write_recording(tmp_path / "a.csv", given)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[:2] == ["time_s,T_base_N,T_tip_N", f"0.0,{T_base[0]},{T_base[0] / 2}"]
    read = np.array([line.split(",") for line in lines[1:]], dtype=float)
    np.testing.assert_array_equal(read, np.stack(list(given.values()), axis=1))
    for odd in (
        np.full(len(T_base), "pulling"),
        np.where(T_base > 1, np.nan, T_base),
        np.arange(len(T_base)),
    ):
        write_recording(tmp_path / "b.csv", given | {"odd": odd})
        own = [line.rpartition(",") for line in (tmp_path / "b.csv").read_text().splitlines()]
        assert own[1][2] == str(odd.tolist()[0]) and len(own) == len(lines)
    with pytest.raises(ValueError, match="shorter"):
        write_recording(tmp_path / "c.csv", given | {"T_tip": T_base[1:]})


def test_columns_of_unequal_length_are_not_written(tmp_path):
    with pytest.raises(ValueError, match="shorter"):
        write_recording(tmp_path / "a.csv", {"T_base": [1.0, 2.0], "T_tip": [1.0]})
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.skipif(not GIRAFFE.exists(), reason="needs the shared data beside the repository")
def test_the_giraffe_recording_reads_as_it_is():
    recording = read_recording(GIRAFFE, GIRAFFE_COLUMNS)
    assert len(recording) == 2254 and recording.T_tip is not None and recording.time is not None
    assert recording.T_base.max() == pytest.approx(13.8833, abs=1e-4)
    assert recording.T_tip.max() == pytest.approx(6.8089, abs=1e-4)
    assert recording.time[-1] == pytest.approx(25.945, abs=1e-3)


@pytest.mark.skipif(not SHARED.exists(), reason="needs the shared data beside the repository")
def test_shared_recordings_read():
    for path in sorted(SHARED.glob("*/*/recording.csv")):
        header = path.read_text().partition("\n")[0]
        tendons = re.findall(r"T_base_N\.(\w+)", header)
        assert len(read_recording(path, tendons=tendons)) > 10
