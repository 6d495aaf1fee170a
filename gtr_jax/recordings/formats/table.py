"""Tables of measurements, whatever program wrote them."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from gtr_jax.errors import InputError

from . import bags, expansion, matlab, parquet, tdms, workbook
from .csv_text import read_csv
from .lvm import is_lvm, read_lvm
from .serial_lines import read_lines
from .sheet import Table
from .text import digest, read_bytes, text_of


def read_table(path: str | os.PathLike[str]) -> Table:
    """A table with named columns from a file: CSV, lines of a serial monitor, LVM, TDMS, a workbook, Parquet,
    MATLAB, or a bag of ROS, which may be a folder. All but bags may be compressed by gzip.

    What a file is, its first bytes or its name's ending tell.

    Raises InputError if it is absent, empty, of no format that is read, has a header only, or a row of
    another length.
    """
    path = Path(path)
    if path.is_dir():
        return _of_folder(path)
    data = read_bytes(path)
    sha256 = hashlib.sha256(data).hexdigest()
    ending = path.suffix.lower()
    packed = data.startswith(expansion.GZIP)
    if packed:
        data = expansion.expanded_gzip(path, data)
        ending = Path(path.stem).suffix.lower() if ending == ".gz" else ending
    if data.startswith(parquet.MAGIC) or ending in parquet.ENDINGS:
        return parquet.read_parquet(path, data, sha256)
    if data.startswith((matlab.MAGIC, matlab.MAGIC_HDF5)) or ending in matlab.ENDINGS:
        return matlab.read_matlab(path, data, sha256)
    if data.startswith(tdms.MAGIC) or ending in tdms.ENDINGS:
        return tdms.read_tdms(path, data, sha256)
    if data.startswith(workbook.MAGICS):
        return workbook.read_workbook(path, data, sha256)
    if data.startswith(bags.MAGICS) or ending in bags.ENDINGS:
        if packed:
            raise InputError(f"{path}: a compressed recording of ROS; expand it with gunzip")
        del data
        return bags.read_bag(path, sha256)
    if packed:
        expansion.check_separators(path, data)
    text = text_of(path, data)
    del data
    if is_lvm(text):
        return read_lvm(path, text, sha256)
    return read_lines(path, text, sha256) or read_csv(path, text, sha256)


def _of_folder(path: Path) -> Table:
    if not (path / "metadata.yaml").exists():
        raise InputError(f"{path}: a folder, and no bag of ROS 2 (no metadata.yaml in it); name a file")
    odd = next((p for p in path.rglob("*") if not (p.is_file() or p.is_dir())), None)
    if odd is not None:
        raise InputError(f"{odd}: is no file; a bag of ROS holds files only")
    return bags.read_bag(path, digest(path))
