"""The outcome of a solve in readable form: `print(equilibrium.result)` prints `successful`."""

from __future__ import annotations

from typing import Any

import numpy as np
import optimistix as optx
from equinox._enum import EnumerationItem


class Outcome(EnumerationItem):
    """An item of `optimistix.RESULTS`, or an array of them, that prints its name and what it means."""

    def __repr__(self) -> str:
        if self.is_traced():
            return f"{self._enumeration.__qualname__}<traced>"
        names = {int(item._value): name for name, item in self._enumeration._name_to_item.items()}
        values, counts = np.unique(np.asarray(self._value), return_counts=True)
        if np.ndim(self._value):
            return ", ".join(f"{n} {names[int(v)]}" for v, n in zip(values, counts, strict=True))
        index = int(values[0])
        meaning = self._enumeration._index_to_message[index]
        return f"{names[index]}: {meaning}" if meaning else names[index]


def outcome(result: optx.RESULTS) -> Any:
    """The result as an `Outcome`, which prints its name."""
    return Outcome(result._value, result._enumeration)
