"""MATLAB files (.mat): version 4 to 7 by scipy, version 7.3, which is HDF5, by h5py where it is installed."""

from __future__ import annotations

import importlib.util
import io
import math
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gtr_jax.errors import InputError, excerpt

from .cells import NumberCells
from .expansion import check_bytes, check_numbers
from .sheet import Table
from .subprocess_reader import read_in_subprocess

MAGIC = b"MATLAB 5.0 MAT-file"
MAGIC_HDF5 = b"MATLAB 7.3 MAT-file"
ENDINGS = (".mat",)
_COMPRESSED = 15  # type of an element of the file
_DEEPEST = 8  # structs in structs
_WIDEST = 1000  # columns of an array
_REMEDY = "export the signals as vectors of one length, or as CSV with writetable"


def read_matlab(path: Path, data: bytes, sha256: str) -> Table:
    """The table of a MATLAB file: every vector of numbers is a column under its variable's name, the field of
    a struct under "struct.field", and column i of an array under "name.i", unless a variable of as many texts
    names them. Vectors of another length than most are left out. Where all come from one struct, its
    name is left out of theirs.

    Raises InputError naming the file if it is damaged, of version 7.3 without h5py, or holds no vectors.
    """
    hdf5 = data.startswith(MAGIC_HDF5)
    if hdf5 and importlib.util.find_spec("h5py") is None:
        raise InputError(
            f"{path}: MATLAB version 7.3; pip install 'gtr-jax[hdf5]', or save it with save(..., '-v7')"
        )
    reader = vectors_of_hdf5 if hdf5 else vectors_of_mat
    common, found = read_in_subprocess(
        reader, data, path=path, intact="a complete MATLAB file", remedy="save it again"
    )
    lengths = Counter(len(values) for values in found.values() if len(values) > 1)
    if not lengths:
        raise InputError(f"{path}: holds no vectors of numbers (tables and objects are not read); {_REMEDY}")
    most = max(lengths, key=lambda length: (lengths[length], length))
    columns = {name: values for name, values in found.items() if len(values) == most}
    names = [name.strip().removeprefix(common) for name in columns]
    cells = [NumberCells(values) for values in columns.values()]
    return Table(path, sha256, names, cells, np.arange(1, most + 1), plain=True)


def vectors_of_mat(data: bytes) -> tuple[str, dict[str, np.ndarray]]:
    """The vectors of a file of version 4 to 7 by name; before them what all names begin with, if they are
    fields of one struct.

    Raises InputError if they would be too many.
    """
    from scipy.io import loadmat, whosmat

    check_bytes(sum(_expanded(data)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, shape, kind in whosmat(io.BytesIO(data)):
            if kind not in ("struct", "cell", "char", "object", "function", "opaque"):
                check_numbers(math.prod(shape), f"'{excerpt(name)}' has {math.prod(shape):,} numbers")
        return _named(loadmat(io.BytesIO(data), simplify_cells=True))


def _expanded(data: bytes) -> Iterator[int]:
    """How many bytes the compressed variables of a file of version 5 to 7 say that they have."""
    order = "<" if data[126:128] == b"IM" else ">"
    place = 128
    while data.startswith(MAGIC) and place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        place += 8
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(data[place : place + min(size, 64)], 8)
            yield struct.unpack(f"{order}II", head)[1]
        place += size


def vectors_of_hdf5(data: bytes) -> tuple[str, dict[str, np.ndarray]]:
    """The same of a file of version 7.3.

    Raises InputError also if any of it lies in another file, which whoever made it may have chosen.
    """
    import h5py

    numbers: int = 0
    again = "save it again into one"

    def item_of(group: Any, name: str) -> Any:
        """What a group holds; links to it, and numbers in other files, are not followed."""
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise InputError(f"'{excerpt(name)}' lies in another file; {again}")
        if not isinstance(link, h5py.HardLink):
            raise InputError(f"'{excerpt(name)}' is a link; save the file again without it")
        item = group[name]
        if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
            raise InputError(f"'{excerpt(name)}' lies in another file; {again}")
        return item

    def contents(group: Any, depth: int = 0) -> dict[str, Any]:
        nonlocal numbers
        out = {}
        for name in group:
            numbers += 1  # a group may hold itself
            check_numbers(numbers, "has too many entries")
            item = item_of(group, name)
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
                numbers += item.size or 0
                check_numbers(numbers, f"'{excerpt(name)}' has {item.size or 0:,} numbers")
                out[name] = np.asarray(item).T  # MATLAB's arrays are stored by columns
            elif isinstance(item, h5py.Group) and not name.startswith("#") and depth < _DEEPEST:
                out[name] = contents(item, depth + 1)
        return out

    with h5py.File(io.BytesIO(data), "r") as file:
        return _named(contents(file))


def _named(variables: Mapping[str, Any]) -> tuple[str, dict[str, np.ndarray]]:
    found = dict(_vectors(variables))
    check_numbers(sum(values.size for values in found.values()), "has too many numbers")
    first = next(iter(found), "").partition(".")[0]
    alone = isinstance(variables.get(first), Mapping) and all(n.startswith(f"{first}.") for n in found)
    return (f"{first}." if alone else ""), found


def _vectors(node: Mapping[str, Any], before: str = "", depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Vectors of numbers by name, from variables and the fields of structs."""
    texts = {len(v): [str(text) for text in v] for v in node.values() if _are_texts(v)}
    for name, value in node.items():
        if str(name).startswith("__"):
            continue
        if isinstance(value, Mapping) and depth < _DEEPEST:
            yield from _vectors(value, f"{before}{name}.", depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            values = np.squeeze(value)
            if values.ndim == 1:
                yield f"{before}{name}", values
            elif values.ndim == 2 and min(values.shape) <= _WIDEST:
                values = values if values.shape[0] >= values.shape[1] else values.T
                named = texts.get(values.shape[1])
                for i, column in enumerate(values.T):
                    yield (f"{before}{named[i]}" if named else f"{before}{name}.{i + 1}"), column


def _are_texts(value: Any) -> bool:
    if not isinstance(value, np.ndarray) or value.ndim != 1:
        return False
    return value.dtype.kind == "U" or (value.dtype == object and all(isinstance(text, str) for text in value))
