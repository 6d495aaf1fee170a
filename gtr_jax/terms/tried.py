"""What a diagnosis tries of an effect, as the effect's own file states it: in which variants, what is
believed of their numbers before a recording is seen, and from which values fits start.

Whatever a file does not state follows from its quantities: one variant in which every number is free, priors
from the `usual` ranges, and starts at some sizes on both sides of null.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

# Half width of a range that holds 90 % of a normal distribution, in standard deviations.
NINE_OF_TEN = 1.645
# Sizes to start from, in standard deviations of the prior.
SIZES = (0.3, 1.0)


class Rig(NamedTuple):
    """What is known of a rig and its recordings before an effect is tried.

    Attributes:
        length: of the body [m].
        rigid: whether the body does not bend.
        loaded: whether gravity or a force acts on it.
        largest_tip: largest recorded tip tension [N]; 0 where none was recorded.
        travel: where the tip goes across the base tangent, smallest and largest y [m], (2,); in space its
            places in the axes of the base [m], (M, 3).
        bend: largest change of curvature [1/m].
        values: numbers of all terms as the robot has them, SI, by term and name.
    """

    length: float
    rigid: bool
    loaded: bool
    largest_tip: float
    travel: np.ndarray
    bend: float
    values: Mapping[str, Mapping[str, Any]]


class Moments(NamedTuple):
    """When an event may have happened [s] since the first sample.

    Attributes:
        begins: times at which it may begin, spread over those under tension and where a misfit begins.
        held: when each misfit begins that lies where friction should hold the tip, and how long it lasts.
    """

    begins: Sequence[float]
    held: Sequence[tuple[float, float]]


class Read(NamedTuple):
    """What the cells show in a long recording.

    Attributes:
        time: of the samples [s], (K,).
        T_base: tension at the base [N], (K,).
        T_tip: tension at the tip [N], (K,); None where it was not recorded.
        alone: whether the robot has one tendon, which is pulled by a known tension.
    """

    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray | None
    alone: bool


@dataclasses.dataclass(frozen=True)
class Prior:
    """What is believed of a number, where its `usual` range does not say it; None where it does.

    Attributes:
        centre: value in the middle; of a size its null.
        sd: standard deviation of the value, or of its logarithm where `log`.
        log: whether the value is on a logarithmic scale.
        lower, upper: bounds [SI].
        size: whether it sets the strength of the effect and is null without it.
    """

    centre: float | None = None
    sd: float | None = None
    log: bool | None = None
    lower: float | None = None
    upper: float | None = None
    size: bool | None = None

    @property
    def stated(self) -> dict[str, float | bool]:
        """What is stated, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}


# The free numbers of a variant by name: each gives its value [SI] so many standard deviations of its prior
# above the centre.
At = Mapping[str, Callable[[float], float]]
Start = Mapping[str, float]


@dataclasses.dataclass(frozen=True)
class Variant:
    """One form in which an effect is tried.

    Attributes:
        name: what tells it from other variants, after the term's id and a dot; "" for the plain form.
        free: names of the numbers that are fitted, a size first; () for all. A variant whose first number is
            called "tip" or "base" acts at that end, and is tried only where the tension there is recorded.
        prior: what is believed of some of them, by name, from the `Rig`.
        starts: values from which fits start [SI], by name, from `At` and the `Rig`; of an event, from the
            `Moments` instead.
        fixed: numbers that are set and stay, from the `Rig`, of an event from the `Moments`; one of another
            term is named with its id, as "tendon-stretch.compliance".
        within: whether it acts where the rest of its term does: it is then tried beside it, and of robots
            whose file has the rest.
    """

    name: str = ""
    free: tuple[str, ...] = ()
    prior: Callable[[Rig], Mapping[str, Prior]] | None = None
    starts: Callable[[At, Any], Sequence[Start]] | None = None
    fixed: Callable[[Any], Mapping[str, float]] | None = None
    within: bool = False


@dataclasses.dataclass(frozen=True)
class Instrument:
    """A number that an instrument always adds, little of it: in a long recording every hypothesis fits it,
    and it is no effect that is missing.

    Attributes:
        name: of the number.
        prior: what is believed of it, from what the cells `Read`; None where it is not fitted.
    """

    name: str
    prior: Callable[[Read], Prior | None]


@dataclasses.dataclass(frozen=True)
class Tried:
    """What a diagnosis tries of an effect.

    Attributes:
        variants: its forms, in the order in which they are tried; () where it is never tried.
        shared: names of numbers that shape what several variants do. One variant may act beside another only
            where neither frees what the other is shaped by.
        where: whether it can act on a rig at all; None where it can on every one.
        always: numbers that an instrument always adds.
        by_recording: names of numbers that may differ between recordings of one rig.
    """

    variants: tuple[Variant, ...] = (Variant(),)
    shared: tuple[str, ...] = ()
    where: Callable[[Rig], bool] | None = None
    always: tuple[Instrument, ...] = ()
    by_recording: tuple[str, ...] = ()


PLAINLY, NEVER = Tried(), Tried(variants=())


def along_each(at: At, sizes: Sequence[float]) -> list[Start]:
    """Starts with one number at a time off its centre, to both sides: the components of a vector, the first
    of them last.
    """
    names = list(at)
    return [
        {name: at[name](sign * size if name == one else 0.0) for name in names}
        for size in sizes
        for one in (*names[1:], names[0])
        for sign in (1, -1)
    ]


def fault_of(
    tried: Tried,
    known: Mapping[str, float],
    values: Mapping[str, Mapping[str, float]],
    *,
    event: bool = False,
) -> str:
    """What is wrong with what is tried of a term; "" if nothing is. Functions that give starts and priors are
    tried on a rig that is made up.

    Args:
        tried: what is tried of it.
        known: typical values of its numbers [SI], by name.
        values: numbers of all terms on that rig, by term and name.
        event: whether the term is one.
    """
    called = [variant.name for variant in tried.variants]
    if len(set(called)) < len(called):
        return "two variants have one name; give each its own"
    used = [name for variant in tried.variants for name in variant.free]
    used += [*tried.shared, *tried.by_recording, *(one.name for one in tried.always)]
    unknown = [name for name in used if name not in known]
    if unknown:
        return f"what is tried frees '{unknown[0]}', which is none of its numbers; correct the name"
    rig = Rig(0.2, False, True, 10.0, np.array([0.0, 0.1]), 5.0, values)
    given = Moments([1.0], [(2.0, 0.5)]) if event else rig
    for variant in tried.variants:
        free = variant.free or tuple(known)
        at = {name: lambda x, value=known[name]: value for name in free}
        starts = variant.starts(at, given) if variant.starts else []
        if any(set(start) != set(free) for start in starts):
            return f"each start of variant '{variant.name}' must give {', '.join(free)} and nothing else"
        priors = variant.prior(rig) if variant.prior else {}
        odd = [name for name in priors if name not in known]
        if odd:
            return f"the prior of '{odd[0]}' is for none of its numbers; correct the name"
    return ""
