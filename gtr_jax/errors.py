"""The one error a user's input can raise, and the one warning."""

import difflib
import re
from collections.abc import Iterable

_LONG_QUOTE = re.compile(r"'([^']{100})[^']{200,}'")  # from 300 characters on, of which 100 are kept
_ENOUGH = 80  # characters of a name that are compared: difflib takes quadratic time


class InputError(ValueError):
    """Bad input: what is wrong, where (file, row, column or key) and the remedy, in one line.

    The command line prints ``error: <message>`` and exits with status 2. Line breaks in the message are
    folded into spaces, long quotes are cut and unprintable characters are replaced, so that text quoted from
    a file cannot break the line.
    """

    def __init__(self, message: str) -> None:
        message = _LONG_QUOTE.sub(r"'\1…'", message)
        super().__init__("".join(c if c.isprintable() else "�" for c in " ".join(message.split())))


class InputWarning(UserWarning):
    """Input that is taken for something else than it may look like: what, where and the remedy, in one line.
    The command line prints ``warning: <message>``.
    """


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name most similar to `name`, ignoring case, or the only one that it begins; None if none is
    similar.
    """
    by_folded = {candidate.casefold(): candidate for candidate in known}
    begun = [folded for folded in by_folded if len(name) > 2 and folded.startswith(f"{name.casefold()}-")]
    if len(begun) == 1:
        return by_folded[begun[0]]
    alike = difflib.get_close_matches(name.casefold()[:_ENOUGH], by_folded, n=1, cutoff=0.5)
    return by_folded[alike[0]] if alike else None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Remedy for an unknown name: the nearest known one, or the list of them all."""
    known = list(known)
    match = nearest(name, known)
    return f"did you mean '{match}'?" if match else f"known: {listed(known)}"


def nearest_first(name: str, known: Iterable[str]) -> list[str]:
    """All known names, the most similar to `name` first."""
    folded = name.casefold()
    return sorted(known, key=lambda k: -difflib.SequenceMatcher(None, folded, k.casefold()).ratio())


def listed(names: Iterable[str], most: int = 12) -> str:
    """Names separated by commas, cut after `most` of them."""
    names = list(names)
    return ", ".join(names[:most]) + (", …" if len(names) > most else "")


def excerpt(text: object, most: int = 60) -> str:
    """The text of a value, shortened so that a message can quote it."""
    try:
        text = str(text)
    except ValueError:  # Python does not write out integers of thousands of digits
        return "an integer of thousands of digits"
    return text if len(text) <= most else f"{text[: most - 1]}…"


def reason(fault: BaseException) -> str:
    """What a library says is wrong, cut short; the kind of its error if it says nothing."""
    return excerpt(fault) if str(fault).strip() else type(fault).__name__
