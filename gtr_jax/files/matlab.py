"""MATLAB files (.mat): version 4 to 7 by scipy, version 7.3, which is HDF5, by h5py where it is installed."""

from __future__ import annotations

import io
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gtr_jax.errors import InputError, excerpt

from .cells import Numbers
from .sheet import Table

MAGIC = b"MATLAB 5.0 MAT-file"
MAGIC_HDF5 = b"MATLAB 7.3 MAT-file"
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
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            variables = _of_hdf5(path, data) if data.startswith(MAGIC_HDF5) else _of_mat(data)
    except InputError:
        raise
    except Exception as fault:
        raise InputError(f"{path}: not a whole MATLAB file ({excerpt(fault)}); save it again") from None
    found = dict(_vectors(variables))
    lengths = Counter(len(values) for values in found.values() if len(values) > 1)
    if not lengths:
        raise InputError(f"{path}: holds no vectors of numbers (tables and objects are not read); {_REMEDY}")
    most = max(lengths, key=lambda length: (lengths[length], length))
    columns = {name: values for name, values in found.items() if len(values) == most}
    names = [name.strip() for name in columns]
    struct = names[0].split(".")[0]
    if isinstance(variables.get(struct), Mapping) and all(name.startswith(f"{struct}.") for name in names):
        names = [name.removeprefix(f"{struct}.") for name in names]
    cells = [Numbers(values) for values in columns.values()]
    return Table(path, sha256, names, cells, np.arange(1, most + 1), plain=True)


def _of_mat(data: bytes) -> dict[str, Any]:
    from scipy.io import loadmat

    return loadmat(io.BytesIO(data), simplify_cells=True)


def _of_hdf5(path: Path, data: bytes) -> dict[str, Any]:
    try:
        import h5py
    except ImportError:
        raise InputError(
            f"{path}: MATLAB version 7.3; pip install 'gtr-jax[hdf5]', or save it with save(..., '-v7')"
        ) from None

    def contents(group: Any, depth: int = 0) -> dict[str, Any]:
        out = {}
        for name, item in group.items():
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
                out[name] = np.asarray(item).T  # MATLAB's arrays are stored by columns
            elif isinstance(item, h5py.Group) and not name.startswith("#") and depth < _DEEPEST:
                out[name] = contents(item, depth + 1)
        return out

    with h5py.File(io.BytesIO(data), "r") as file:
        return contents(file)


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
