"""Tables of measurements, whatever program wrote them."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from gtr_jax.errors import InputError

from . import bags, matlab, parquet
from .csv_text import read_csv
from .large_csv import read_large
from .sheet import Table
from .text import digest, read_bytes, text_of


def read_table(path: str | os.PathLike[str]) -> Table:
    """A table with named columns from a file: CSV, Parquet, MATLAB, or a bag of ROS, which may be a folder.

    What a file is, its first bytes tell.

    Raises InputError if it is absent, empty, of no format that is read, has a header only, or a row of
    another length.
    """
    path = Path(path)
    if path.is_dir():
        return _of_folder(path)
    data = read_bytes(path)
    sha256 = hashlib.sha256(data).hexdigest()
    if data.startswith(parquet.MAGIC):
        return parquet.read_parquet(path, data, sha256)
    if data.startswith((matlab.MAGIC, matlab.MAGIC_HDF5)) or path.suffix.lower() == ".mat":
        return matlab.read_matlab(path, data, sha256)
    if data.startswith(bags.MAGICS):
        del data
        return bags.read_bag(path, sha256)
    text = text_of(path, data)
    del data
    return read_large(path, text, sha256) or read_csv(path, text, sha256)


def _of_folder(path: Path) -> Table:
    if not (path / "metadata.yaml").exists():
        raise InputError(f"{path}: a folder, and no bag of ROS 2 (no metadata.yaml in it); name a file")
    return bags.read_bag(path, digest(path))
