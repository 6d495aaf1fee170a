"""What the page of the wrists concludes, computed from the errors that it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

NEARLY = 0.8  # of what the best remedy takes: mends nearly as much
SETTLED = 0.05  # degrees, a tenth of what an angle is read to: held-out errors less apart do not choose
COUNTS = ("no", "one", "two", "three", "four")


class Remedy(NamedTuple):
    """What may be added to one set of numbers for both wrists.

    Attributes:
        what: in words.
        more: how many numbers it adds.
        left: error on the trials trained on, both wrists together [degrees].
        out: error on the held-out trials, by wrist [degrees].
    """

    what: str
    more: int
    left: float
    out: Mapping[str, float]


def listed(several: Sequence[str]) -> str:
    """ "a, b and c"."""
    return " and ".join([", ".join(several[:-1]), several[-1]] if len(several) > 1 else several)


def nearly(one: float, remedies: Sequence[Remedy]) -> list[Remedy]:
    """The remedies that take `NEARLY` as much as the best, that one first; none where none takes anything."""
    best, *others = sorted(remedies, key=lambda remedy: remedy.left)
    if best.left >= one:
        return []
    return [best, *(each for each in others if one - each.left >= NEARLY * (one - best.left))]


def mended(one: float, remedies: Sequence[Remedy]) -> str:
    """What mends most of the error of one set for both, what nearly as much, and what less.

    Args:
        one: that error, on the trials trained on [degrees].
        remedies: what may be added.
    """
    near = nearly(one, remedies)
    if not near:
        return f"Nothing of this mends the {one:.2f}° of one set."
    best, *others = near
    less = sorted((each for each in remedies if each not in near), key=lambda remedy: remedy.left)
    found = f"**{_shown(best)} mends most**"
    if others:
        found += f", {listed([_shown(each) for each in others])} nearly as much"
    if less:
        found += f", {listed([_shown(each) for each in less])} less"
    return found[:2] + found[2].upper() + found[3:] + "."


def _shown(remedy: Remedy) -> str:
    numbers = "number" if remedy.more == 1 else "numbers"
    return f"{remedy.what} ({COUNTS[remedy.more]} {numbers} more, {remedy.left:.2f}°)"


def helped(out: Mapping[str, float], before: Mapping[str, float]) -> str:
    """Which wrists have a lower held-out error [degrees] than before, which a higher one, as shown."""
    change = {wrist: round(out[wrist], 2) - round(before[wrist], 2) for wrist in before}
    helps = [wrist for wrist, more in change.items() if more < 0]
    harms = [wrist for wrist, more in change.items() if more > 0]
    parts = [f"{does} {listed(each)}" for does, each in (("helps", helps), ("harms", harms)) if each]
    return listed(parts or ["changes nothing"])


def settled(before: Mapping[str, float], remedies: Sequence[Remedy]) -> str:
    """What the held-out trials say of remedies that mend about alike.

    Args:
        before: held-out errors of one set for both, by wrist [degrees].
        remedies: those that mend about alike on the trials trained on.
    """
    each = [f"{remedy.what} gives {_pair(remedy.out)}" for remedy in remedies]
    verdicts = {remedy.what: helped(remedy.out, before) for remedy in remedies}
    found = f"On the held-out trials {listed(each)}, where one set gives {_pair(before)}: "
    if len(set(verdicts.values())) == 1:
        found += ("each " if len(remedies) > 1 else "that ") + next(iter(verdicts.values())) + "."
    else:
        found += listed([f"{what} {does}" for what, does in verdicts.items()]) + "."
    if len(remedies) < 2:
        return found
    apart = max(
        max(remedy.out[wrist] for remedy in remedies) - min(remedy.out[wrist] for remedy in remedies)
        for wrist in before
    )
    if apart < SETTLED:
        return f"{found} They differ by {apart:.2f}° at most: the recordings cannot settle which it is."
    ranked = [min(remedies, key=lambda remedy: remedy.out[wrist]).what for wrist in before]
    if len(set(ranked)) == 1:
        return f"{found} The held-out trials of both are met best by {ranked[0]}."
    return f"{found} The held-out trials of the two wrists do not agree on which it is."


def _pair(out: Mapping[str, float]) -> str:
    return listed([f"{error:.2f}°" for error in out.values()])


def way(alone: Sequence[float], together: Sequence[float]) -> str:
    """Whether two numbers that differ one way, fitted one by one, do so in a fit of both."""
    same = (alone[1] - alone[0]) * (together[1] - together[0]) > 0
    return "the same way around" if same else "the other way around"


def alike(pooled: Mapping[str, float], within: Mapping[str, float]) -> str:
    """Whether samples predicted from all trials of a wrist are farther off than from their own trial.

    Args:
        pooled: error of samples that one curve of all held-out trials predicts, by wrist [degrees].
        within: the largest error of samples that a curve of their own trial predicts, by wrist [degrees].
    """
    unlike = [wrist for wrist in pooled if round(pooled[wrist], 2) > round(within[wrist], 2)]
    like = [wrist for wrist in pooled if wrist not in unlike]
    parts = []
    if unlike:
        parts.append(f"In {listed(unlike)} that is more than within any trial: the trials are not alike.")
    if like:
        parts.append(f"In {listed(like)} that is no more than within a trial, and does not tell them apart.")
    return " ".join(parts)
