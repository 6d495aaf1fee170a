"""Answers as plain values that JSON can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any


def to_jsonable(data: Any) -> Any:
    """Mappings, lists, text and numbers only; a number that is not finite becomes null."""
    if isinstance(data, Mapping):
        return {str(key): to_jsonable(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [to_jsonable(value) for value in data]
    if hasattr(data, "tolist"):  # numpy and JAX
        return to_jsonable(data.tolist())
    if isinstance(data, float) and not math.isfinite(data):
        return None
    return data
