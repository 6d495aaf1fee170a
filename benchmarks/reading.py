"""`python -m benchmarks.reading [--write]`: CSV files of many rows, split all at once and row by row.

Five columns; time and most memory of a process of its own for each. Both ways give the same table, as
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
    "Written by `python -m benchmarks.reading --write`; processor time and the most memory of a process for",
    "each. The limit on cells that are read one by one is lifted.",
    "",
    "| file | rows | at once | | row by row | | ratio of times |",
    "|---|---|---|---|---|---|---|",
)
ROWS, SEED = (100_000, 1_000_000), 26112902
NAMES = ("time_s", "T_base_N", "T_tip_N", "tip_x_m", "tip_y_m")
READ = """
import resource, sys, time
from gtr_jax.recordings.formats import csv_text, expansion
from gtr_jax.recordings.recording import read_recording
expansion.CELLS = 10**9
if sys.argv[2] == "row by row":
    csv_text.LARGE = 10**12
begun = time.process_time()
read_recording(sys.argv[1])
print(time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
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


def read(path: Path, way: str) -> tuple[float, float]:
    """Processor time [s] and most memory [MiB] of a process that reads a file."""
    out = subprocess.run(
        [sys.executable, "-c", READ, str(path), way], capture_output=True, text=True, check=True
    )
    seconds, kibibytes = map(float, out.stdout.split())
    return seconds, kibibytes / 1024


def table() -> Iterator[str]:
    """The lines of the results."""
    yield from HEAD
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        for rows in ROWS:
            for name, text in texts(rows):
                path.write_text(text, encoding="utf-8")
                (fast, small), (slow, large) = (read(path, way) for way in ("at once", "row by row"))
                yield (
                    f"| {name} | {rows:,} | {fast:.2f} s | {small:.0f} MiB | {slow:.2f} s | {large:.0f} MiB "
                    f"| {slow / fast:.1f} |"
                )


def main(argv: list[str] | None = None) -> int:
    """Measure, print, and write if asked."""
    return command("reading", __doc__, table, argv)


if __name__ == "__main__":
    sys.exit(main())
