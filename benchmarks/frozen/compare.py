"""What differs between two folders of answers: numbers, words, or something that is missing.

JSON and TOML are compared key by key, CSV column by column, other text line by line, number by number. Times,
versions and paths are left out; pictures and pages are not looked at.
"""

from __future__ import annotations

import csv
import io
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

CLOSE = 1e-9  # relative: what the order of a sum over threads may do
IGNORED = {"started", "seconds", "compiling_seconds", "versions", "command", "path", "sha256"}
READ = {".json", ".toml", ".csv", ".txt", ".npy", ".xml", ".dxf", ".step"}
DRAWINGS = {".xml", ".dxf", ".step"}  # a line more or less is another drawing
OF_THE_TOOL = {"case.json"}
MASKED = (
    (re.compile(r"(\$TD\w+\s+40\s+)\S+"), r"\1TIME"),  # Julian dates of a DXF file
    (re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[.\d]*(?:Z|[+-]\d\d:\d\d)?"), "TIME"),
    (re.compile(r"\{[0-9A-F]{8}(?:-[0-9A-F]{4}){3}-[0-9A-F]{12}\}"), "ID"),
    (re.compile(r"computed in [^\"\n]*? per second"), "computed"),
    (re.compile(r"(?m)^.*\(\d+ s\)\n"), ""),  # progress
)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?!\w)")


class Change(NamedTuple):
    """One difference: where, of which kind, in words, and for a number by how much."""

    where: str
    kind: Literal["number", "words", "missing"]
    says: str = ""
    absolute: float = 0.0
    relative: float = 0.0

    def __str__(self) -> str:
        if self.kind == "number":
            return f"{self.where}: {self.says}by {self.absolute:.3g} ({self.relative:.1e} relative)"
        return f"{self.where}: {self.says}"


def worst(changes: Sequence[Change]) -> float:
    """The largest relative difference of a number; infinite where one is missing."""
    return max((np.inf if c.kind == "missing" else c.relative for c in changes), default=0.0)


def folders(before: Path, after: Path) -> list[Change]:
    """Every difference between two folders of the answers of one case."""
    roots = [_roots(folder) for folder in (before, after)]
    names = [_names(folder) for folder in (before, after)]
    found = [Change(name, "missing", "no such file any more") for name in names[0] if name not in names[1]]
    found += [Change(name, "words", "a new file") for name in names[1] if name not in names[0]]
    for name in names[0]:
        if name in names[1]:
            found += _files(before / name, after / name, name, roots)
    return found


def _names(folder: Path) -> list[str]:
    files = (path for path in sorted(folder.rglob("*")) if path.suffix in READ and path.is_file())
    return [str(path.relative_to(folder)) for path in files if path.name not in OF_THE_TOOL]


def _roots(folder: Path) -> Mapping[str, str]:
    """Paths that stand in the answers, and what to call them."""
    kept = folder / "case.json"
    return json.loads(kept.read_text(encoding="utf-8"))["roots"] if kept.exists() else {}


def _files(before: Path, after: Path, name: str, roots: Sequence[Mapping[str, str]]) -> Iterator[Change]:
    if before.suffix == ".npy":
        yield from _column(np.load(before).ravel(), np.load(after).ravel(), name)
        return
    texts = [_text(path, root) for path, root in zip((before, after), roots, strict=True)]
    if texts[0] == texts[1]:
        return
    if before.suffix in (".json", ".toml"):
        parse = json.loads if before.suffix == ".json" else tomllib.loads
        try:
            values = [parse(text) for text in texts]
        except ValueError:
            yield Change(name, "missing", "can no longer be read")
            return
        yield from _values(values[0], values[1], name)
    elif before.suffix == ".csv":
        yield from _tables(texts[0], texts[1], name)
    else:
        yield from _lines(texts[0], texts[1], name, drawing=before.suffix in DRAWINGS)


def _text(path: Path, roots: Mapping[str, str]) -> str:
    text = path.read_text(encoding="utf-8", errors="replace")
    for root in sorted(roots, key=len, reverse=True):
        text = text.replace(root, roots[root])
    for pattern, instead in MASKED:
        text = pattern.sub(instead, text)
    return text


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float))  # a bool too: whether it converged is an answer


def _values(before: Any, after: Any, where: str) -> Iterator[Change]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in before:
            if key in IGNORED:
                continue
            if key not in after:
                yield Change(f"{where} {key}", "missing", "no such key any more")
            else:
                yield from _values(before[key], after[key], f"{where} {key}")
        for key in after:
            if key not in before and key not in IGNORED:
                yield Change(f"{where} {key}", "words", "a new key")
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield Change(where, "number", f"{len(before)} values, now {len(after)}, ", np.inf, np.inf)
        elif before and all(map(_is_number, [*before, *after])):
            yield from _column(np.asarray(before, float), np.asarray(after, float), where)
        else:
            for k, (a, b) in enumerate(zip(before, after, strict=True)):
                yield from _values(a, b, f"{where}[{k}]")
    elif _is_number(before) and _is_number(after):
        yield from _column(np.asarray([before], float), np.asarray([after], float), where)
    elif isinstance(before, str) and isinstance(after, str):
        yield from _lines(before, after, where)
    elif before != after:
        yield Change(where, "missing", f"{_short(before)}, now {_short(after)}")


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) < 30 else text[:27] + "..."


def _column(before: np.ndarray, after: np.ndarray, where: str) -> Iterator[Change]:
    """The largest difference of a column, absolute and relative to the largest number in it."""
    if before.shape != after.shape:
        yield Change(where, "number", f"{before.size} values, now {after.size}, ", np.inf, np.inf)
        return
    if before.dtype.kind not in "fiub" or after.dtype.kind not in "fiub":
        if np.any(before != after):
            yield Change(where, "words", "other words")
        return
    a, b = before.astype(float), after.astype(float)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    if np.all(same):
        return
    off = np.abs(np.where(same, 0.0, b) - np.where(same, 0.0, a))
    absolute = np.inf if np.any(np.isnan(off)) else float(np.max(off))
    sizes = np.abs(np.concatenate([a, b]))
    relative = absolute / np.max(sizes[np.isfinite(sizes)], initial=0.0)
    one = f"{a[0]:.9g}, now {b[0]:.9g}, " if a.size == 1 else ""
    yield Change(where, "number", one, absolute, relative)


def _tables(before: str, after: str, where: str) -> Iterator[Change]:
    columns = [_columns(text) for text in (before, after)]
    for name, old in columns[0].items():
        if name not in columns[1]:
            yield Change(f"{where} {name}", "missing", "no such column any more")
            continue
        yield from _cells(old, columns[1][name], f"{where} {name}")
    for name in columns[1]:
        if name not in columns[0]:
            yield Change(f"{where} {name}", "words", "a new column")


def _columns(text: str) -> dict[str, list[str]]:
    head, *rows = list(csv.reader(io.StringIO(text))) or [[]]
    return {name or str(k): [row[k] if k < len(row) else "" for row in rows] for k, name in enumerate(head)}


def _cells(before: list[str], after: list[str], where: str) -> Iterator[Change]:
    numbers = [[_number(cell) for cell in cells] for cells in (before, after)]
    if len(before) != len(after):
        yield Change(where, "number", f"{len(before)} rows, now {len(after)}, ", np.inf, np.inf)
        return
    yield from _column(np.asarray(numbers[0]), np.asarray(numbers[1]), where)
    for a, b, x, y in zip(before, after, *numbers, strict=True):
        if a != b and np.isnan(x) and np.isnan(y):
            yield Change(where, "words", f"{_short(a)!r}, now {_short(b)!r}")
            return


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _lines(before: str, after: str, where: str, drawing: bool = False) -> Iterator[Change]:
    """Numbers where the words around them are the same; else words."""
    texts = before.splitlines(), after.splitlines()
    if drawing and len(texts[0]) != len(texts[1]):
        yield Change(where, "number", f"{len(texts[0])} lines, now {len(texts[1])}, ", np.inf, np.inf)
        return
    words, numbers = [], []
    for k, (a, b) in enumerate(zip_longest(*texts, fillvalue=""), start=1):
        if a == b:
            continue
        if NUMBER.sub("#", a) != NUMBER.sub("#", b):
            words.append((k, a, b))
            continue
        pairs = [[float(found) for found in NUMBER.findall(line)] for line in (a, b)]
        numbers += [(k, x, y) for x, y in zip(*pairs, strict=True) if x != y]
    if words:
        k, a, b = words[0]
        kind = "missing" if drawing else "words"
        yield Change(f"{where} line {k}", kind, f"{_short(a)!r}, now {_short(b)!r}")
    if numbers:
        k, x, y = max(numbers, key=lambda n: abs(n[2] - n[1]) / max(abs(n[1]), abs(n[2])))
        yield from _column(np.asarray([x]), np.asarray([y]), f"{where} line {k}")
