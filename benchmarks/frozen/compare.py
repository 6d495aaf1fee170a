"""What changed between frozen answers and new ones, and by how much."""

from __future__ import annotations

import dataclasses
from fnmatch import fnmatchcase

import numpy as np

from .case import DISCRETE, Answers, Case


@dataclasses.dataclass(frozen=True)
class Change:
    """One quantity of a case, compared.

    Attributes:
        case, quantity: of it.
        absolute, relative: largest change, in its unit and relative to its largest magnitude; of words and
            discrete quantities the relative change is the share of entries that differ.
        where: index of the entry that changed most, or what else there is to say.
        beyond: whether it is more than is allowed.
    """

    case: str
    quantity: str
    absolute: float
    relative: float
    where: str
    beyond: bool


def compare(case: Case, frozen: Answers, found: Answers) -> list[Change]:
    """All quantities of a case that changed at all."""
    changes = []
    for quantity in [*frozen, *(q for q in found if q not in frozen)]:
        if quantity not in found:
            changes.append(Change(case.name, quantity, np.nan, np.nan, "is missing now", True))
        elif quantity not in frozen:
            changes.append(Change(case.name, quantity, np.nan, np.nan, "is new", False))
        else:
            change = _compared(case, quantity, frozen[quantity], np.asarray(found[quantity]))
            if change is not None:
                changes.append(change)
    return changes


def _compared(case: Case, quantity: str, was: np.ndarray, now: np.ndarray) -> Change | None:
    if was.shape != now.shape:
        return Change(case.name, quantity, np.nan, np.nan, f"shape {was.shape}, now {now.shape}", True)
    words = was.dtype.kind in "USb" or now.dtype.kind in "USb"
    if words or quantity in DISCRETE:
        differs = was != now
        if not words:
            scale = max(float(np.max(np.abs(was), initial=0.0)), 1e-300)
            differs = ~(np.abs(was - now) <= case.allowed * scale)
        if not differs.any():
            return None
        at = np.unravel_index(int(np.argmax(differs)), differs.shape)
        share = float(np.mean(differs))
        largest = np.nan if words else float(np.max(np.abs(was - now)))
        said = f"{_index(at)}: {was[at]}, now {now[at]}; {int(differs.sum())} of {differs.size} differ"
        return Change(case.name, quantity, largest, share, said, words or share > case.steps_allowed)
    known = np.isfinite(was)
    if not np.array_equal(known, np.isfinite(now)):
        at = np.unravel_index(int(np.argmax(known != np.isfinite(now))), was.shape)
        return Change(case.name, quantity, np.nan, np.nan, f"{_index(at)}: {was[at]}, now {now[at]}", True)
    change = np.where(known, np.abs(np.where(known, now, 0.0) - np.where(known, was, 0.0)), 0.0)
    if change.size == 0 or not np.any(change):
        return None
    floor = max((v for like, v in case.floors.items() if fnmatchcase(quantity, like)), default=0.0)
    allowed = next((v for like, v in case.looser.items() if fnmatchcase(quantity, like)), case.allowed)
    scale = max(float(np.max(np.abs(was[known]))), floor)
    at = np.unravel_index(int(np.argmax(change)), change.shape)
    relative = float(change[at]) / scale if scale > 0 else np.inf
    said = f"{_index(at)}: {was[at]:.10g}, now {now[at]:.10g}"
    return Change(case.name, quantity, float(change[at]), relative, said, not relative <= allowed)


def _index(at: tuple) -> str:
    return f"[{', '.join(str(int(i)) for i in at)}]" if at else "value"


def table(changes: list[Change]) -> str:
    """Changes as a table; those beyond what is allowed carry an exclamation mark."""
    rows = [("", "case", "quantity", "absolute", "relative", "where")]
    for c in changes:
        rows.append(("!" * c.beyond, c.case, c.quantity, f"{c.absolute:.2g}", f"{c.relative:.2g}", c.where))
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    return "\n".join(
        "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[-1]]) for row in rows
    )
