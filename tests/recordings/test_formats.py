"""Files of other formats than CSV hold the same recording, and large CSV files are read as small ones."""

import gzip
import sys
import zlib
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from test_recording import EXPORTED, EXPORTS

from gtr_jax.errors import InputError
from gtr_jax.recordings.formats import csv_text, expansion, many_cells
from gtr_jax.recordings.formats.subprocess_reader import read_in_subprocess
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.recordings.recording import read_recording

T = np.linspace(0, 1, 50)
DATA = {"time_s": T, "T_base_N": 10 * np.sin(3 * T) ** 2, "T_tip_N": 6 * np.sin(3 * T) ** 2}
MAPPING = "time={0}time_s,T_base={0}T_base_N[N],T_tip={0}T_tip_N[N]"


def same(recording, data=DATA):
    """Whether a recording holds DATA."""
    for name, values in (("time", data["time_s"]), ("T_base", data["T_base_N"]), ("T_tip", data["T_tip_N"])):
        np.testing.assert_array_equal(getattr(recording, name), values)
    np.testing.assert_array_equal(recording.rows, np.arange(1, 51))


def refused(path, columns=None):
    """The one line that refuses a file."""
    with pytest.raises(InputError) as caught:
        read_recording(path, columns)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{path}: ")


# Large CSV files


@pytest.fixture
def large(monkeypatch):
    """Every CSV file counts as large."""
    monkeypatch.setattr(csv_text, "LARGE", 0)
    monkeypatch.setattr(csv_text, "_HEAD", 4)
    monkeypatch.setattr(many_cells, "_FIRST", 1)


def as_text(table):
    """All that a table says of itself."""
    columns = []
    for index in range(len(table.header)):
        try:
            columns.append(table.column(index, 1.0).tolist())
        except InputError as fault:
            columns.append(str(fault))
        try:
            columns.append(table.times(index).tolist())
        except InputError as fault:
            columns.append(str(fault))
        columns += [table.has_numbers(index), table.has_times(index), table.unit(index)]
    return repr((table.header, columns, table.numbers.tolist(), table.sha256))


ODD = {
    "text": EXPORTED.replace("20,", "broken,"),
    "empty and NaN": EXPORTED.replace("20,", ",").replace("6.5", "nan"),
    "blanks": EXPORTED.replace("20,", " 20 ,"),
    "a blank line": EXPORTED.replace("\n2", "\n\n2"),
    "a row of blanks": EXPORTED + ",,\n",
    "a quote": EXPORTED.replace("20,", '"20",'),
    "a comment": EXPORTED + "# done\n",
    "no last line break": EXPORTED.rstrip(),
    "line breaks of Windows": EXPORTED.replace("\n", "\r\n"),
    "strokes": EXPORTED.replace("20,", "2_0,"),
    "infinity": EXPORTED.replace("20,", "-inf,"),
    "exponents": EXPORTED.replace("20,", "+2.0E+01,"),
    "both marks": EXPORTS["decimal comma"].replace("0,25", "0.25"),
    "stamps": "time,T_base_N\n2026-01-31T14:05:00.25,1\n2026-01-31 14:05:01,2\n2026-02-01T00:00:00.5Z,3\n",
    "broken stamps": "time,T_base_N\n2026-01-31T14:05:00.25,1\n2026-01-32 14:05:01,2\n2026,3\n",
    "clock": "time,T_base_N\n14:05:00.25,1\n14:05:01,2\n14:5:1,3\n",
    "clock past midnight": "time,T_base_N\n23:59:59.25,1\n00:00:01,2\nx,3\n00:00:02,3\n",
    "halves of the day": "time,T_base_N\n01/31/2026 11:59:59.25 PM,1\n02/01/2026 12:00:01 AM,2\n",
    "days with points": "time,T_base_N\n31.01.2026 14:05:00.25,1\n01.02.2026 14:05,2\n2026-02-01,2\n",
    "days or months": "time,T_base_N\n01/02/2026 14:05:00.25,1\n02/02/2026 14:05,2\n",
    "fractions elsewhere": "time,T_base_N\n14:05.5:00,1\n14:05:00.25.5,2\n14:05:00,3\n",
    "no header": "0.0,4.1,2.5\n0.5,8.1,5.0\n1.0,9.2,6.0\n",
    "no header, an empty column": "0.0,4.1,\n0.5,8.1,\n1.0,9.2,6.0\n",
    "columns counted": ",0,1\n0,4.1,2.5\n1,8.1,5.0\n2,9.2,6.0\n",
    "tendons counted": "time,1,2\n0,4.1,2.5\n1,8.1,5.0\n2,9.2,6.0\n",
    "a row of words": EXPORTED.replace("\n1,", "\npause,pause,pause\n1,"),
    "a row of nothing": EXPORTED.replace("\n1,", "\nnan,nan,nan\n1,"),
    "another table of as many columns": EXPORTED + "a,b,c\n1,2,3\n4,5,6\n7,8,9\n1,2,3\n",
    "doubtful": "T_base_N;T_tip_N\n1,234;2,345\n1,111;2,222\n1,222;1,111\n",
    "thousands": "T_base_N;T_tip_N\n1.234,5;2\n1.111;2\n12.222;1,111\n",
}


@pytest.mark.parametrize("name", [*EXPORTS, *ODD])
def test_large_files_are_read_as_small_ones(name, tmp_path, large, monkeypatch):
    path = tmp_path / "recording.csv"
    text = (EXPORTS | ODD)[name]
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    found = as_text(read_table(path))
    monkeypatch.setattr(csv_text, "LARGE", 10**9)
    assert found == as_text(read_table(path))


@pytest.mark.parametrize("text", [EXPORTED, EXPORTS["decimal comma"], EXPORTS["units below"]])
def test_large_files_are_not_left_to_the_small_way(text, tmp_path, large):
    path = tmp_path / "recording.csv"
    path.write_text(text.removesuffix("# done\n"))
    assert isinstance(read_table(path).columns[0], many_cells.ManyTextCells)


@pytest.mark.parametrize("row", ["1,2", "1,2,3,4", "1,2,x"])
def test_large_files_are_refused_as_small_ones(row, tmp_path, large, monkeypatch):
    path = tmp_path / "recording.csv"
    path.write_text(EXPORTED + row + "\n")
    found = refused(path)
    monkeypatch.setattr(csv_text, "LARGE", 10**9)
    assert found == refused(path) and found.startswith("row 5")


# Parquet


def test_parquet(tmp_path):
    path = tmp_path / "recording.parquet"
    pl.DataFrame(DATA | {"note": ["x"] * 50, "pair": [[1, 2]] * 50}).write_parquet(path)
    same(read_recording(path))


def test_parquet_of_times_and_texts(tmp_path):
    path = tmp_path / "recording.parquet"
    start = np.datetime64("2026-01-31T14:05:00", "us")
    stamps = pl.Series(start + (1e4 * np.arange(50)).astype("timedelta64[us]"))
    texts = [str(value) for value in DATA["T_tip_N"]]
    pl.DataFrame(
        {**DATA, "time_s": stamps, "T_tip_N": texts, "T_base_N": DATA["T_base_N"].astype("f4")}
    ).write_parquet(path)
    recording = read_recording(path)
    assert recording.time is not None
    np.testing.assert_allclose(recording.time, 0.01 * np.arange(50), rtol=1e-12)
    np.testing.assert_array_equal(recording.T_tip, DATA["T_tip_N"])
    np.testing.assert_array_equal(recording.T_base, DATA["T_base_N"].astype("f4"))


def test_parquet_faults(tmp_path):
    path = tmp_path / "recording.parquet"
    pl.DataFrame(DATA).write_parquet(path)
    path.write_bytes(path.read_bytes()[:-300])
    assert refused(path).startswith("not a complete Parquet file (")
    pl.DataFrame({"a": []}).write_parquet(path)
    assert refused(path).startswith("holds no rows of numbers")
    gaps = pl.DataFrame(DATA).with_columns(
        pl.when(pl.col("time_s") > 0.5).then(pl.col("T_tip_N")).alias("T_tip_N")
    )
    gaps.write_parquet(path)
    assert refused(path).startswith("row 1, column 'T_tip_N': expected a number, found 'nan'")


# MATLAB


def test_matlab(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "recording.mat"
    data = {**DATA, "rate": 50.0, "title": "rig 2"}
    savemat(path, data)
    same(read_recording(path))
    savemat(path, data, do_compression=True, oned_as="column")
    same(read_recording(path))
    savemat(path, data, format="4")
    same(read_recording(path))


def test_matlab_structs_and_arrays(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "recording.mat"
    savemat(path, {"run": {**DATA, "about": {"rate": 50.0}}})
    same(read_recording(path))
    savemat(path, {"run": DATA, "t": T})
    same(read_recording(path, MAPPING.format("run.")))
    array = np.stack(list(DATA.values()), axis=1)
    savemat(path, {"data": array})
    same(read_recording(path, "time=data.1[s],T_base=data.2[N],T_tip=data.3[N]"))
    savemat(path, {"data": array.T, "names": np.array(list(DATA), dtype=object)})
    same(read_recording(path))


def hdf5(path, data):
    """A file as MATLAB writes version 7.3: HDF5 behind 512 bytes of its own."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in data.items():
            file.create_dataset(f"run/{name}", data=np.atleast_2d(values))
        file.create_dataset("#refs#/a", data=np.zeros(50))
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" "))


def test_matlab_of_version_7_3(tmp_path, monkeypatch):
    path = tmp_path / "recording.mat"
    hdf5(path, DATA)
    same(read_recording(path))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert refused(path) == (
        "MATLAB version 7.3; pip install 'gtr-jax[hdf5]', or save it with save(..., '-v7')"
    )


def test_matlab_of_numbers_in_other_files(tmp_path):
    """A file may not have another one read, nor wait for one."""
    h5py = pytest.importorskip("h5py")
    other = tmp_path / "other.bin"
    other.write_bytes(np.arange(50.0).tobytes())

    def external(file):
        file.create_dataset("a", shape=(1, 50), dtype="f8", external=[(str(other), 0, 400)])

    def virtual(file):
        layout = h5py.VirtualLayout(shape=(1, 50), dtype="f8")
        layout[:] = h5py.VirtualSource(str(other), "run/time_s", shape=(1, 50))
        file.create_virtual_dataset("a", layout)

    def linked(file):
        file["a"] = h5py.ExternalLink(str(other), "/run")

    def soft(file):
        file["a"] = h5py.SoftLink("/run/time_s")

    lies = "'a' lies in another file; save it again into one"
    link = "'a' is a link; save the file again without it"
    for made, says in ((external, lies), (virtual, lies), (linked, lies), (soft, link)):
        path = tmp_path / f"{made.__name__}.mat"
        hdf5(path, DATA)
        with h5py.File(path, "r+") as file:
            made(file)
        assert refused(path) == says


def test_matlab_faults(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "recording.mat"
    savemat(path, {"a": 1.0, "text": "b"})
    assert refused(path).startswith("holds no vectors of numbers")
    savemat(path, DATA)
    path.write_bytes(path.read_bytes()[:700])
    assert refused(path).startswith("not a complete MATLAB file (")
    savemat(path, {name.rstrip("_N"): values for name, values in DATA.items()} | {"T_tip": T[:9]})
    assert refused(path).startswith("no column T_tip_N; columns found:")


# ROS


def bag(path, kind):
    """A bag of two topics: both cells at 50 Hz, and a slower temperature that begins later."""
    rosbag1, rosbag2, typesys = (
        pytest.importorskip(f"rosbags.{name}") for name in ("rosbag1", "rosbag2", "typesys")
    )
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if kind == "bag" else typesys.Stores.ROS2_HUMBLE)
    types = store.types
    vector, wrench = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Wrench"]
    if kind == "bag":
        writer = rosbag1.Writer(path)
    else:
        plugins = {"mcap": rosbag2.StoragePlugin.MCAP, "sqlite3": rosbag2.StoragePlugin.SQLITE3}
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugins[kind])
    with writer:
        cells = writer.add_connection("/cells", "geometry_msgs/msg/Wrench", typestore=store)
        warm = writer.add_connection("/warm", "std_msgs/msg/Float64", typestore=store)
        serialise = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
        for i in range(50):
            message = wrench(
                force=vector(x=DATA["T_base_N"][i], y=DATA["T_tip_N"][i], z=0.0),
                torque=vector(x=0.0, y=0.0, z=0.0),
            )
            stamp = 10**18 + i * 20_000_000
            writer.write(cells, stamp, serialise(message, "geometry_msgs/msg/Wrench"))
            if i % 10 == 1:
                data = types["std_msgs/msg/Float64"](data=float(i))
                writer.write(warm, stamp + 1, serialise(data, "std_msgs/msg/Float64"))


@pytest.mark.parametrize("kind", ["bag", "mcap", "sqlite3"])
def test_ros(kind, tmp_path):
    path = tmp_path / ("run.bag" if kind == "bag" else "run")
    bag(path, kind)
    files = [path] if kind == "bag" else [path, *path.glob("*.mcap"), *path.glob("*.db3")]
    for file in files:
        recording = read_recording(file, "T_base=/cells.force.x[N],T_tip=/cells.force.y[N]")
        same(recording, DATA | {"time_s": 20_000_000 * np.arange(50) / 1e9})
        assert recording.notes == (
            "the rows are the messages of /cells; /warm joined by the last value received",
        )
        table = read_table(file)
        warm = table.column(table.header.index("/warm.data"), 1.0)
        assert np.isnan(warm[:2]).all() and warm[2] == 1.0 and warm[11] == 1.0 and warm[12] == 11.0


def test_ros_faults(tmp_path, monkeypatch):
    path = tmp_path / "run.bag"
    bag(path, "bag")
    assert "no column T_base_N; columns found: time, /cells.force.x" in refused(path)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    assert refused(broken).startswith("not a complete recording of ROS (")
    assert refused(tmp_path).startswith("a folder, and no bag of ROS 2")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    assert refused(path) == "a recording of ROS; pip install 'gtr-jax[ros]', or export its topics as CSV"


# Files that expand


def zeros(path, count, kind):
    """A small file of very many numbers, of a format and a kind of column."""
    if kind == "parquet":
        column = pl.zeros(count, eager=True)
        pl.DataFrame({"T_base_N": column, "T_tip_N": column}).write_parquet(path)
    elif kind == "hdf5":
        hdf5(path, {})
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "r+") as file:
            file.create_dataset("T_base_N", shape=(1, count), dtype="f8", chunks=(1, 1000))
    else:
        from scipy.io import savemat

        savemat(path, {"T": np.zeros((1 if kind == "struct" else count, 1), np.uint8)}, do_compression=True)
        if kind == "struct":  # only its first bytes, which say what would follow
            head = zlib.compress(np.array([14, count], "<u4").tobytes())
            element = np.array([15, len(head)], "<u4").tobytes() + head
            path.write_bytes(path.read_bytes()[:128] + element)


@pytest.mark.parametrize(
    ("kind", "count", "says"),
    [
        ("parquet", 30_000_000, "has 30,000,000 rows of 2 columns; at most 50 million numbers are read, so"),
        ("mat", 60_000_000, "'T' has 60,000,000 numbers; at most 50 million numbers are read, so"),
        ("struct", 450_000_000, "expands to 450 MB; at most 400 MB are read, so"),
        ("hdf5", 10**12, "'T_base_N' has 1,000,000,000,000 numbers; at most 50 million numbers are read, so"),
    ],
)
def test_a_small_file_of_very_many_numbers_is_not_expanded(kind, count, says, tmp_path):
    path = tmp_path / f"bomb.{'parquet' if kind == 'parquet' else 'mat'}"
    zeros(path, count, kind)
    assert path.stat().st_size < 2_000_000
    assert refused(path) == f"{says} export fewer columns, a shorter stretch, or fewer samples"


def test_a_small_file_of_very_long_texts_is_not_expanded(tmp_path):
    path = tmp_path / "r.parquet"
    texts = pl.repeat("x" * 10_000, 50_000, eager=True)
    pl.DataFrame({"T_base_N": pl.zeros(50_000, eager=True), "note": texts}).write_parquet(path)
    assert path.stat().st_size < 2_000_000
    assert refused(path).startswith("expands to 500 MB; at most 400 MB are read, so")


def test_texts_of_very_many_cells_are_refused(tmp_path, monkeypatch):
    """Such as are read cell by cell take a hundred times what they have on the disk, compressed ones more."""
    path = tmp_path / "r.csv.gz"
    path.write_bytes(gzip.compress(b"T_base_N,T_tip_N\n" + b"0,0\n" * 30_000_000, 1))
    assert path.stat().st_size < 2_000_000
    assert refused(path).startswith(
        "expands to about 60 million cells; at most 50 million numbers are read, so"
    )
    monkeypatch.setattr(expansion, "CELLS", 60)
    for name, text in (
        ("r.csv", "T_base_N,T_tip_N\n" + "2,1\n" * 40),
        ("r.txt", "base: 2 g, tip: 1 g\n" * 40),
        ("r.lvm", "LabVIEW Measurement\t\n" + "2\t1\n" * 40),
    ):
        (tmp_path / name).write_text(text)
        said = refused(tmp_path / name)
        assert said.startswith("has about ") and "million cells; at most 6e-05 million are read from" in said


def test_a_bag_of_very_many_numbers(tmp_path, monkeypatch):
    from gtr_jax.recordings.formats import bags

    path = tmp_path / "run.bag"
    bag(path, "bag")
    monkeypatch.setattr(expansion, "NUMBERS", 100)
    with pytest.raises(InputError, match="its messages have too many numbers"):
        bags.topics_of(str(path))


def test_a_reader_may_take_so_much_memory_only(monkeypatch):
    pytest.importorskip("resource")
    said = {"path": Path("big.mat"), "intact": "a whole file", "remedy": "save it again"}
    with pytest.raises(InputError, match=r"^big\.mat: expands to more than 4 GiB; export fewer"):
        read_in_subprocess(taken, 8 << 30, **said)
    assert read_in_subprocess(taken, 8, **said) == 8


def taken(size):
    """How many bytes there are, once they are taken."""
    return len(bytearray(size))
