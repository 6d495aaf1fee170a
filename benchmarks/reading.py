"""`python -m benchmarks.reading [--write]`: CSV files of many rows, split all at once and row by row.

Five columns; the time of a process of its own for each. Both ways give the same table, as
`tests/recordings` shows.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gtr_jax.recordings.formats.csv_writing import csv_of

from .measure import command

HEAD = (
    "# CSV files of many rows, split all at once and row by row",
    "",
    "Written by `python -m benchmarks.reading --write`; processor time of a process for each.",
    "Row by row, more than 5 million cells are refused.",
    "",
    "| file | rows | at once | row by row | ratio |",
    "|---|---|---|---|---|",
)
FEW, MANY, SEED = 100_000, 1_000_000, 26112902
NAMES = ("time_s", "T_base_N", "T_tip_N", "tip_x_m", "tip_y_m")
READ = """
import sys, time
from gtr_jax.recordings.formats import csv_text
from gtr_jax.recordings.recording import read_recording
if sys.argv[2] == "row by row":
    csv_text.LARGE = 10**12
begun = time.process_time()
read_recording(sys.argv[1])
print(time.process_time() - begun)
"""


STAMPS = """
import time
import numpy as np
from gtr_jax.recordings.formats.cells import TextCells
cells = (np.datetime64("2026-01-31T14:05:00", "ms") + np.arange(100_000)).astype(str).tolist()
times = [time.process_time()]
own, _ = TextCells(cells).nanoseconds()
times.append(time.process_time())
import pandas
times.append(time.process_time())
theirs = pandas.to_datetime(cells, format="ISO8601", utc=True).as_unit("ns").astype("int64")
times.append(time.process_time())
assert (own == theirs).all()
print(*np.diff(times))
"""


def texts(rows: int) -> Iterator[tuple[str, str]]:
    """Files of so many rows: numbers, decimal commas, time stamps."""
    rng = np.random.default_rng(SEED)
    drawn = {name: 20.0 * rng.random(rows) for name in NAMES}
    text = csv_of(drawn | {"time_s": np.arange(rows) / 1000})
    yield "numbers", text
    yield "decimal commas", text.replace(",", ";").replace(".", ",")
    stamps = np.datetime64("2026-01-31T14:05:00", "ms") + np.arange(rows)
    cells = (line.partition(",")[2] for line in text.splitlines()[1:])
    lines = (f"{stamp},{rest}\n" for stamp, rest in zip(stamps.astype(str), cells, strict=True))
    yield "time stamps", ",".join(("time", *NAMES[1:])) + "\n" + "".join(lines)


def printed(*arguments: str) -> list[float]:
    """The numbers that a process of Python prints."""
    said = subprocess.run([sys.executable, "-P", "-c", *arguments], capture_output=True, check=True).stdout
    return [float(number) for number in said.split()]


def table() -> Iterator[str]:
    """The lines of the results."""
    yield from HEAD
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        for rows in (FEW, MANY):
            for name, text in texts(rows):
                path.write_text(text, encoding="utf-8")
                (fast,) = printed(READ, str(path), "at once")
                line = f"| {name} | {rows:,} | {fast:.2f} s |"
                if rows == FEW:
                    (slow,) = printed(READ, str(path), "row by row")
                    line += f" {slow:.2f} s | {slow / fast:.1f} |"
                else:
                    line += " refused | |"
                yield line
    own, imported, theirs = printed(STAMPS)
    yield ""
    yield (
        f"100,000 time stamps take {own:.2f} s cell by cell; by pandas {theirs:.2f} s, and {imported:.2f} s "
        "to import it."
    )


def main(argv: list[str] | None = None) -> int:
    """Measure, print, and write if asked."""
    return command("reading", __doc__, table, argv)


if __name__ == "__main__":
    sys.exit(main())
