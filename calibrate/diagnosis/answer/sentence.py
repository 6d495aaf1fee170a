"""A diagnosis in words that its numbers support."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibrate.diagnosis.decision.decide import (
    ADEQUATE,
    AMBIGUOUS,
    DISCOVERED,
    PARTLY,
    UNEXPLAINED,
    structured,
)
from calibrate.diagnosis.laws.found import HOOKS
from calibrate.diagnosis.outside.leave_out import ASKED, STILL, LeftOut, moves
from calibrate.diagnosis.search.differ import Difference
from calibrate.fitting.verdict import in_unit
from calibrate.inference.estimate import NORMAL_95
from calibrate.inference.number import OWN
from gtr_jax.numbers import measured_quantity, quantity
from gtr_jax.robot.parameters import STIFFNESS
from gtr_jax.terms.law import VARIABLES

from .result import Diagnosis

DIFFER = "recordings-differ"
# Residual, in units of the expected noise, above which the sentence calls it more than noise: of 86 sound
# recordings of the blind benchmark, from which this is taken, one with a bad repeat reached 1.49.
MORE = 1.5
# Standard errors from which on what an instrument adds is told.
INSTRUMENT_SEEN = 4.0
# An interval averaged over models is told if it is wider than that of the model shown by this factor; and an
# effect that may act unseen if it is this probable.
WIDER, MAY_ACT = 2.0, 1e-3
# The error of the mesh is mentioned from this share of the noise on.
COUNTS = 0.5


def difference_in_words(d: Diagnosis, difference: Difference) -> str:
    """Which number differs, by how much and between which recordings."""
    own = d.own(difference)

    def value_in(recording: str) -> str:
        shown = measured_quantity(difference.own[recording], own[recording].sd, difference.unit)
        return f"{shown} in {recording}"

    parts = [" and ".join(map(value_in, group)) for group in difference.groups]
    apart = f"{difference.standard_errors:.0f} standard errors, without what is uncertain of all alike"
    words = f"{difference.name} differs between the recordings: {', but '.join(parts)} ({apart})."
    others = [f"{name} that differs" for name in difference.or_numbers]
    others += [f"{name} in all of them" for name in difference.or_effects]
    if others:
        words += f" {' or '.join(others)} would explain them nearly as well."
    return words


def _noise(d: Diagnosis, verb: str = "") -> str:
    """The noise in words, and what the mesh leaves out where that counts."""
    mesh = float(np.sqrt(max(d.expected**2 - d.noise**2, 0.0)))
    also = f" and the mesh leaves out {in_unit(mesh, d.unit, 1)}" if mesh > COUNTS * d.noise else ""
    return f"noise{verb} {in_unit(d.noise, d.unit)}{also}"


def sentence(d: Diagnosis, chosen: tuple[str, ...]) -> str:
    """The verdict in words that its numbers support."""
    before = "".join(f"{difference_in_words(d, difference)} " for difference in d.differ)
    return before + _of_physics(d, chosen) + _unseen(d) + _instruments(d) + _left_out(d)


def interval_in_words(ends: tuple[float, float], unit: str) -> tuple[str, str]:
    """Both ends of an interval, to the digits that its width gives meaning to."""
    sd = (ends[1] - ends[0]) / (2 * NORMAL_95)
    low, high = (measured_quantity(end, sd, unit, error=False) for end in ends)
    return low, high


def _unseen(d: Diagnosis) -> str:
    """Between what mu and the stiffness are once models are averaged, where that is much wider than the one
    model says, and which effect that may act unseen adds most to that.
    """
    if d.verdict == UNEXPLAINED:
        return ""
    wide = [
        (c, interval_in_words(c.averaged95, c.unit), interval_in_words((c.lower95, c.upper95), c.unit))
        for c in d.parameters
        if c.name.partition(OWN)[0].partition(".")[0] in ("mu", *STIFFNESS) and c.widened > WIDER
        if c.averaged95 is not None and c.lower95 is not None and c.upper95 is not None
    ]
    if not wide:
        return ""
    are = [
        f"{c.name} is between {low} and {high} ({own[0]} to {own[1]} if nothing else acts)"
        for c, (low, high), own in wide
    ]
    rivals = "the rivals and " if len(d.confusion_set) > 1 else ""
    words = (
        f" Counting {rivals}any one effect that these recordings neither show nor exclude, "
        f"{' and '.join(are)}"
    )
    most = next((h for h in d.hidden if h.mu95 is not None and h.probability > MAY_ACT), None)
    if most is not None and wide[0][0].name.startswith("mu"):
        amount, null = quantity(most.largest, most.unit, 2), quantity(most.null, most.unit, 3)
        words += (
            f"; {most.name} adds most to the spread of mu ({most.number} may differ from {null} by {amount}; "
            f"the probability that it acts is {most.probability:.1g})"
        )
    return words + "."


def _instruments(d: Diagnosis) -> str:
    """What the instruments add, where that is fitted beside every hypothesis and is seen."""
    seen = [
        f"{c.name} = {measured_quantity(c.after, c.sd, c.unit)}"
        for c in d.instruments
        if c.after is not None and c.sd is not None and abs(c.after) > INSTRUMENT_SEEN * c.sd
    ]
    return (
        f" Fitted beside it, because instruments always add a little of it: {', '.join(seen)}."
        if seen
        else ""
    )


def _left_out(d: Diagnosis) -> str:
    """Which stretches are left out, and why."""

    def which(e: LeftOut) -> str:
        return f"{e.recording}, {e.when}" if len(d.loops) > 1 else e.when

    asked = [which(e) for e in d.left_out if e.why == ASKED]
    gaps = [which(e) for e in d.left_out if e.why != ASKED and not e.outside]
    still = [which(e) for e in d.left_out if e.why == STILL]
    outside = [e for e in d.left_out if moves(e)]
    words = f" Left out of the fit as asked: {', '.join(asked)}." if asked else ""
    if gaps:
        words += f" Left out of the fit, because the load is not known in the gap before: {', '.join(gaps)}."
    if still:
        words += f" Left out of the fit, because readings stand still there: {', '.join(still)}."
    if outside:
        size = float(np.sqrt(np.average([e.size**2 for e in outside], weights=[e.samples for e in outside])))
        words += (
            " Left out of the fit, because the tip moves there in a way that the base cannot have caused: "
            f"{', '.join(map(which, outside))}; simulated and recorded T_tip differ by {size:.2g} N rms "
            "there."
        )
    return words


def sets_in_words(sets: Sequence[Sequence[str]]) -> list[str]:
    """Sets of effects as they are told: what adds effects to another of them follows it, since the data say
    of the added ones only that they may act besides.

    Args:
        sets: sets of terms, the most probable first.

    Returns:
        The first set, then those that hold no other, each with what may act beside it.
    """
    told = list(sets[:1])
    told += [s for s in sets[1:] if not any({*other} < {*s} for other in sets)]
    words, placed = [], set()
    for s in told:
        besides = []
        for k, other in enumerate(sets):
            if other not in told and {*s} < {*other} and k not in placed:
                placed.add(k)
                besides.append(" and ".join(name for name in other if name not in s))
        alone = " with ".join(s)
        words.append(f"{alone} (alone or beside {' or '.join(besides)})" if besides else alone)
    return words


def _of_physics(d: Diagnosis, chosen: tuple[str, ...]) -> str:
    held = d.held_out
    better = ""
    if len(held) > 1 and np.isfinite(held[1]["rms"]):
        ends = [in_unit(h["rms"], d.unit) for h in held[:2]]
        pieces = ""
        if d.discovered is not None and d.discovered.pieces:
            pieces = " (short pieces that alternate with those it has seen)"
        better = (
            f" On samples the fit has not seen{pieces}, the residual goes from {ends[0].split()[0]} to "
            f"{ends[1]} ({_noise(d)})."
        )
    if d.verdict in (ADEQUATE, DIFFER):
        best = d.rivals[0] if d.rivals else None
        hint = ""
        if best is not None and best.names and best.probability > 0.5:
            hint = f" {' with '.join(best.names)} would fit a little better, too little to be claimed."
        more = ""
        if d.rms[1] > MORE * d.expected:
            more = ", which is more, with too little structure in it to claim anything"
        what = "Nothing else is missing" if d.verdict == DIFFER else "Nothing is missing"
        return (
            f"{what} that these recordings could show: the residual is {in_unit(d.rms[1], d.unit)} where "
            f"the {_noise(d, ' is')}{more}.{hint}"
        )
    outside = any(e.outside for e in d.left_out)
    if d.verdict == UNEXPLAINED and outside and not (structured(d.left) or d.pattern or chosen):
        what = (
            "Readings stand still for a while where the model moves, which no term of the catalogue "
            "explains: is a cell, its amplifier or its line stuck, or the tendon held from outside?"
        )
        if any(map(moves, d.left_out)):
            what = (
                "Something from outside acts on the tendon in short episodes, which no term of the catalogue "
                "explains."
            )
        return (
            f"{what} In the rest nothing is missing: the residual is {in_unit(d.rms[1], d.unit)} where "
            f"the {_noise(d, ' is')}."
        )
    if d.verdict == UNEXPLAINED:
        nearest = ""
        if chosen:
            nearest = (
                f" The nearest, {' with '.join(chosen)}, leaves structure of {d.left[0]:.2g} standard "
                f"deviations of the noise.{better}"
            )
        what = "Something is missing that no term of the catalogue explains:"
        if d.pattern is not None:
            by_chance = f"by chance: {max(d.pattern.chance, 1e-99):.1g}"
            where = f" (in {d.pattern.recording})" if len(d.loops) > 1 else ""
            what += f" {d.pattern.says}{where} ({by_chance}), {100 * d.pattern.share:.0f} % of it;"
        at = f" Most of it: {d.where[0].says}." if d.where else ""
        off = f"the fit is off by {in_unit(d.rms[0 if chosen else 1], d.unit)} where the {_noise(d, ' is')}"
        return f"{what} {off}.{at}{nearest}"
    sizes = ", ".join(
        f"{c.name} = {measured_quantity(c.after, c.sd, c.unit)}{' (assumed)' if c.sd is None else ''}"
        for c in d.parameters
        if c.before is None and c not in d.instruments
    )
    if d.verdict == PARTLY:
        return _partly(d, sizes) + better
    if d.verdict == DISCOVERED:
        return _discovered(d, chosen, sizes, better)
    mu = next((c for c in d.parameters if c.name == "mu"), None)
    moved = f" Friction goes from {mu.before:.3g} to {mu.after:.3g}." if mu and mu.before and mu.after else ""
    stays = ""
    if structured(d.left):
        stays = (
            f" Structure of {d.left[0]:.2g} standard deviations of the noise remains: a law is not quite "
            "right, or something more is missing."
        )
    if d.verdict == AMBIGUOUS:
        sets = " or ".join(sets_in_words(d.confusion_set))
        return f"Missing is {sets}: these recordings cannot tell which.{better}{moved}{stays}"
    effects = "; ".join(d.catalogue[kind].says.rstrip(".") for kind in d.named)
    sure = "above 0.99" if d.named_probability > 0.99 else f"{d.named_probability:.2f}"
    return f"Missing: {' and '.join(d.named)} (probability {sure}). {effects}: {sizes}.{better}{moved}{stays}"


def _discovered(d: Diagnosis, chosen: tuple[str, ...], sizes: str, better: str) -> str:
    """The law that no catalogue holds, how sure it is, and what is left."""
    found = d.discovered
    assert found is not None
    other = [name for name in chosen if name != found.law.name]
    beside = f" beside {' and '.join(other)}" if other else ""
    acts, of = HOOKS[found.acts].called, VARIABLES[found.of].says
    what = f"a law of its own does{beside}: {acts} that depends on {found.of}, the {of}"
    form = "a smooth curve (see the figure)" if found.smooth else f"{found.gives} {found.formula}, {sizes}"
    words = f"Something is missing that no term of the catalogue explains; {what}: {form}.{better}"
    if better:
        left_by = " and ".join(other) if other else "the base model"
        words += (
            f" There the law takes {100 * found.takes:.0f} % of what {left_by} leaves beyond the noise, all "
            "channels counted."
        )
    if found.possible:
        others = [of.split(" of ") for of in found.possible]
        instead = " or ".join(f"{HOOKS[acts].called} that depends on {of}" for acts, of in others)
        words += f" These recordings do not rule out {instead} instead."
    if structured(d.left):
        words += f" Structure of {d.left[0]:.2g} standard deviations of the noise is left."
    return words


def _partly(d: Diagnosis, sizes: str) -> str:
    """What explains part of the misfit, how much of it, and what is left and where."""
    sets = sets_in_words(d.confusion_set)
    first = d.confusion_set[0]
    what = f"{sets[0]} {'is' if len(first) == 1 else 'are'} missing ({sizes})"
    if len(sets) > 1:
        what += f"; these recordings do not rule out {' or '.join(sets[1:])} instead"
    share = d.share_explained
    takes = "" if share is None else f" That takes {100 * share:.0f} % of the misfit beyond the noise."
    where = f", most of it {d.rest[0].says}" if d.rest else ""
    rest = " In the rest nothing is left but noise."
    if structured(d.left):
        rest = (
            f" Structure of {d.left[0]:.2g} standard deviations of the noise is left{where}: something more "
            "is missing."
        )
    return f"Part of the misfit is explained: {what}.{takes}{rest}"
