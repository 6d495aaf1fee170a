"""Frozen answers on disk: one compressed file for each group, written anew after every case.

A file holds all numbers of the group one after another, and as JSON what they are: for each case and quantity
its type and shape, or its words.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from .case import Answers

FOLDER = Path(__file__).parent / "answers"


def load(folder: Path, group: str) -> dict[str, Answers]:
    """The frozen answers of a group by case; none where it was never recorded."""
    path = folder / f"{group}.npz"
    if not path.exists():
        return {}
    with np.load(path, allow_pickle=False) as data:
        numbers, index = data["numbers"], json.loads(bytes(data["index"]))
    found: dict[str, Answers] = {}
    at = 0
    for case, quantities in index.items():
        found[case] = {}
        for name, (kind, held) in quantities.items():
            if kind == "words":
                found[case][name] = np.asarray(held, dtype=str)
                continue
            size = math.prod(held)
            found[case][name] = numbers[at : at + size].reshape(held).astype(kind)
            at += size
    return found


def save(folder: Path, group: str, answers: dict[str, Answers]) -> None:
    """Write the answers of a group; an interruption leaves the former file."""
    folder.mkdir(parents=True, exist_ok=True)
    index: dict[str, dict[str, Any]] = {}
    numbers = [np.zeros(0)]
    for case, found in sorted(answers.items()):
        index[case] = {}
        for name, values in found.items():
            if values.dtype.kind in "US":
                index[case][name] = ("words", values.tolist())
            else:
                index[case][name] = (values.dtype.str, values.shape)
                numbers.append(values.astype(float).ravel())
    told = np.frombuffer(json.dumps(index).encode(), np.uint8)
    part = folder / f"{group}.part"
    with part.open("wb") as file:
        np.savez_compressed(file, numbers=np.concatenate(numbers), index=told)
    os.replace(part, folder / f"{group}.npz")
