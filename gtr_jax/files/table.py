"""Tables of measurements, whatever program wrote them."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from .csv_text import read_csv
from .large_csv import read_large
from .sheet import Table
from .text import read_bytes, text_of


def read_table(path: str | os.PathLike[str]) -> Table:
    """A table with named columns from a file.

    Raises InputError if it is absent, empty, of no format that is read, has a header only, or a row of
    another length.
    """
    path = Path(path)
    data = read_bytes(path)
    sha256 = hashlib.sha256(data).hexdigest()
    text = text_of(path, data)
    del data
    return read_large(path, text, sha256) or read_csv(path, text, sha256)
