"""What new recordings settle of the rivals that an earlier diagnosis left open."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gtr_jax import InputError
from gtr_jax.recordings.formats.text import read_text

from .result import Diagnosis
from .robots import kinds
from .settled import Rivalry, Settled

FILE = "diagnosis.json"
RIGHT, OPEN, OUT = "named", "still open", "ruled out"


def earlier_set(folder: Path) -> list[tuple[tuple[str, ...], float]]:
    """The rivals of an earlier diagnosis, by terms, with their probabilities.

    Raises:
        InputError: the folder is of no diagnosis, or the diagnosis left no rivals.
    """
    path = folder / FILE
    try:
        answer: dict[str, Any] = json.loads(read_text(path)[0])
        sets = [tuple(terms) for terms in answer["confusion_set"]]
        rivals = [(tuple(kinds(r["names"])), float(r["probability"])) for r in answer["rivals"]]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"--settles {folder}: is not a run folder of gtr diagnose; give one") from None
    if len(sets) < 2:
        raise InputError(
            f"--settles {folder}: that diagnosis left no rivals (its verdict is '{answer.get('verdict')}'); "
            "leave --settles out"
        )
    return [(own, _share(own, rivals)) for own in sets]


def settle(folder: str, earlier: Sequence[tuple[tuple[str, ...], float]], answer: Diagnosis) -> Settled:
    """What a new diagnosis says of the rivals of an earlier one.

    Args:
        folder: of the earlier diagnosis, as it was named.
        earlier: from `earlier_set`.
        answer: the new diagnosis.
    """
    now = [(tuple(kinds(r.names)), r.probability) for r in answer.rivals]
    best = max((r.delta for r in answer.rivals), default=0.0)
    deltas: Mapping[tuple[str, ...], float] = {
        own: max(r.delta for r in answer.rivals if tuple(kinds(r.names)) == own) for own, _ in now
    }
    found = []
    for terms, before in earlier:
        own = next((known for known in deltas if {*known} == {*terms}), None)
        behind = None if own is None else max(best**2 - deltas[own] ** 2, 0.0) ** 0.5
        found.append(Rivalry(terms, before, _share(terms, now), _status(terms, answer), behind))
    return Settled(folder, _in_words(folder, found, answer), tuple(found))


def _share(terms: Sequence[str], rivals: Sequence[tuple[tuple[str, ...], float]]) -> float:
    return sum(p for own, p in rivals if {*own} == {*terms})


def _status(terms: Sequence[str], answer: Diagnosis) -> str:
    if answer.named and {*terms} == {*answer.named}:
        return RIGHT
    return OPEN if any({*terms} == {*own} for own in answer.confusion_set) else OUT


def _words(rivals: Sequence[Rivalry]) -> str:
    return " or ".join(" with ".join(r.terms) for r in rivals)


def _in_words(folder: str, rivals: Sequence[Rivalry], answer: Diagnosis) -> str:
    every = _words(rivals)
    right = [r for r in rivals if r.status == RIGHT]
    left = [r for r in rivals if r.status == OPEN]
    out = [r for r in rivals if r.status == OUT]
    if right:
        return f"What {folder} left open, {every}, is settled: it is {_words(right)}."
    if not left:
        now = " with ".join(answer.named) or f"'{answer.verdict}'"
        return f"What {folder} left open, {every}, is ruled out altogether: the answer is now {now}."
    if out:
        return f"Of what {folder} left open, {_words(out)} is ruled out; {_words(left)} is still open."
    return f"What {folder} left open is still open: {every}."
