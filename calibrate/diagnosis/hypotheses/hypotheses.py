"""What may be missing: each physics term as a hypothesis with a few free numbers and a prior for each."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from calibrate.inference.instruments import BOTH, Cells
from calibrate.inference.number import Number
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import acts_on_tendon, friction_of
from gtr_jax import Robot
from gtr_jax.robot.parameters import STIFFNESS, parameter
from gtr_jax.robot.stiffness import largest_modulus, stiffness_of
from gtr_jax.simulation.programs import every_for
from gtr_jax.terms import REGISTRY, Term, known_on
from gtr_jax.terms.term import Quantity
from gtr_jax.terms.tried import NINE_OF_TEN, SIZES, Moments, Prior, Read, Rig, Variant

# Prior standard deviation of ln mu, and of ln E where the robot file states none.
ANY_MU, ANY_E = 1.5, 1.0


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """An effect that may be missing.

    Attributes:
        name: the term's id, with the number that tells variants apart after a dot: "low-pass.base".
        kind: the term's id.
        numbers: what is free, sizes first.
        starts: values to start from, one mapping each.
        fixed: numbers that are set and stay.
        dated: whether its numbers beside the first are times, of which nothing in other cycles tells.
        reads: numbers that shape it, free or not, and shape others of its kind, too.
    """

    name: str
    kind: str
    numbers: tuple[Number, ...]
    starts: tuple[Mapping[str, float], ...]
    fixed: Mapping[str, float] = dataclasses.field(default_factory=dict)
    dated: bool = False
    reads: frozenset[str] = frozenset()

    @property
    def few(self) -> tuple[Mapping[str, float], ...]:
        """A few of the starts: those of medium size where there are many."""
        if len(self.starts) <= 2:
            return self.starts
        by_size = sorted({s[self.numbers[0].name] for s in self.starts}, key=abs)
        middle = abs(by_size[len(by_size) // 2])
        found = [s for s in self.starts if np.isclose(abs(s[self.numbers[0].name]), middle)]
        return (
            tuple(found[:2]) if len({s[self.numbers[0].name] for s in found}) < 2 else (found[0], found[-1])
        )


def may_join(h: Hypothesis, acting: Collection[Hypothesis], taken: Collection[str] = ()) -> bool:
    """Whether a hypothesis may act beside others: it does nothing at its null then, and leaves theirs alone.

    Args:
        h: the hypothesis.
        acting: the others.
        taken: names of numbers that are free whatever acts.
    """
    free = {n.name for n in h.numbers}
    taken = {*taken, *(n.name for other in acting for n in other.numbers)}
    read = {name for other in acting for name in other.reads}
    return not free & (taken | read) and not h.reads & taken


# The first number of a variant that acts at the tip, or at the anchor before its cell, and at the base.
AT_TIP, AT_BASE = "tip", "base"
# Events: their free time lets them fit any bump, so that none is offered until a misfit is located in time.
EVENTS = {kind for kind, term in REGISTRY.items() if term.event}
# What instruments always add; of it, what moves their readings in time.
INSTRUMENT_NUMBERS = {f"{kind}.{one.name}" for kind, term in REGISTRY.items() for one in term.tried.always}
DELAYS = {name for name in INSTRUMENT_NUMBERS if REGISTRY[name.partition(".")[0]].read_at}
# Numbers beside the size up to which all combinations of their ends are tried.
MOST_SHAPES = 3
# Modulus from which a body may be of a superelastic metal [Pa].
METAL = 1e9


def number_of(term: Term, q: Quantity) -> Number:
    """A term's quantity as a free number with a prior."""
    name, low, high = f"{term.id}.{q.name}", *q.usual
    lower, upper = (-np.inf if q.lower is None else q.lower), (np.inf if q.upper is None else q.upper)
    if q.size:
        ends = [np.log(end / q.null) if q.log else end - q.null for end in (low, high)]
        centre, far = q.null, max(map(abs, ends))
    elif q.log:
        centre, far = float(np.sqrt(low * high)), 0.5 * np.log(high / low)
    else:
        centre, far = 0.5 * (low + high), 0.5 * (high - low)
    return Number(
        name=name,
        unit=q.unit,
        centre=centre,
        sd=far / NINE_OF_TEN,
        log=q.log,
        lower=lower,
        upper=upper,
        size=q.size,
    )


def catalogue(
    robot: Robot,
    *,
    timed: bool,
    largest_tip: float,
    travel: np.ndarray,
    bend: float,
    displaced: bool = False,
    cells: Cells = BOTH,
    without: Collection[str] = (),
) -> list[Hypothesis]:
    """The hypotheses that can act on a robot, laws of its file that are null included, except those that its
    file already has and events.

    Args:
        robot: the robot.
        timed: whether the recordings have times.
        largest_tip: largest recorded tip tension [N]; not used where none was.
        travel: where the tip goes across the base tangent, smallest and largest y [m], (2,); in space its
            places in the axes of the base [m], (M, 3).
        bend: largest change of curvature [1/m].
        displaced: whether a recording has the displacement, in which alone some terms are seen.
        cells: those of the recordings, in which alone some terms are seen.
        without: names of terms that are left out.
    """
    rig = Rig(
        length=float(robot.backbone.length),
        rigid=robot.backbone.rigid,
        loaded=robot.loaded,
        largest_tip=largest_tip,
        travel=travel,
        bend=bend,
        values=robot.terms,
    )
    may, found = every_for(robot), []
    for term in robot.catalogue.values():
        if term.event or term.id in without or not (term.of_cells or term.id in may):
            continue
        if (term.ahead and not displaced) or (term.timed and not timed) or not _acts_on(term, robot, rig):
            continue
        acts = known_on(term, robot.terms[term.id])
        known = term.numbers if robot.space else term.quantities
        for variant in term.tried.variants:
            free = numbers_of(term, variant, known)
            first = free[0].name.partition(".")[2]
            if acts and not (variant.within and not _is_set(robot, term, variant.free)):
                continue
            if not cells.tip and (first == AT_TIP or of_tip_alone(term)):
                continue
            if not cells.base and term.of_cells and (first == AT_BASE or (term.base and not term.tip)):
                continue
            priors = variant.prior(rig) if variant.prior else {}
            found.append(hypothesis_of(term, variant, believed(free, priors), rig))
    return found


def _acts_on(term: Term, robot: Robot, rig: Rig) -> bool:
    """Whether a term can do anything on a rig."""
    if rig.rigid and (term.bend or term.loads or term.stop):
        return False
    if term.softens and (rig.rigid or largest_modulus(robot.backbone) < METAL * (1 - 1e-9)):
        return False
    return term.tried.where is None or term.tried.where(rig)


def of_tip_alone(term: Term) -> bool:
    """Whether a term acts on what the cell at the tip shows, and on no other."""
    return term.tip is not None and term.true_base is None


def numbers_of(term: Term, variant: Variant, known: Sequence[Quantity]) -> tuple[Number, ...]:
    """The free numbers of a variant of a term, with priors from their usual ranges.

    Args:
        term, variant: the term and its variant.
        known: the quantities of the term that the robot has.
    """
    names = variant.free or tuple(q.name for q in known)
    return tuple(number_of(term, q) for name in names for q in known if q.name == name)


def believed(free: Sequence[Number], priors: Mapping[str, Prior]) -> tuple[Number, ...]:
    """Free numbers of a term with what is believed of some of them, by name within the term."""
    return tuple(
        dataclasses.replace(n, **priors[name].stated) if (name := n.name.partition(".")[2]) in priors else n
        for n in free
    )


def hypothesis_of(term: Term, variant: Variant, free: tuple[Number, ...], given: Rig | Moments) -> Hypothesis:
    """A variant of a term as a hypothesis.

    Args:
        term, variant: the term and its variant.
        free: its numbers with their priors.
        given: what its starts and fixed numbers follow from.
    """

    def full(name: str) -> str:
        return name if "." in name else f"{term.id}.{name}"

    if variant.starts is None:
        starts = _starts(free)
    else:
        at = {n.name.partition(".")[2]: n.value for n in free}
        starts = [{full(name): value for name, value in start.items()} for start in variant.starts(at, given)]
    fixed = variant.fixed(given) if variant.fixed else {}
    return Hypothesis(
        name=f"{term.id}.{variant.name}" if variant.name else term.id,
        kind=term.id,
        numbers=free,
        starts=tuple(starts),
        fixed={full(name): value for name, value in fixed.items()},
        reads=frozenset(full(name) for name in term.tried.shared),
    )


def _is_set(robot: Robot, term: Term, names: Collection[str]) -> bool:
    """Whether any of some numbers of a term is set to what does something."""
    values = robot.terms[term.id]
    return any(bool(np.any(np.asarray(values[q.name]) != q.null)) for q in term.sizes if q.name in names)


def of_single_tendons(robot: Robot, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses of one of several tendons each: "crosstalk.left" of "crosstalk"."""
    return [
        _of_tendon(h, tendon)
        for h in hypotheses
        for tendon in robot.tendon_names
        if acts_on_tendon(robot.catalogue[h.kind])
    ]


def _of_tendon(h: Hypothesis, tendon: str) -> Hypothesis:
    def own(name: str) -> str:
        return f"{name}.{tendon}" if name.partition(".")[0] == h.kind else name

    return dataclasses.replace(
        h,
        name=f"{h.name}.{tendon}",
        numbers=tuple(dataclasses.replace(n, name=own(n.name)) for n in h.numbers),
        starts=tuple({own(name): value for name, value in start.items()} for start in h.starts),
        fixed={own(name): value for name, value in h.fixed.items()},
        reads=frozenset(map(own, h.reads)),
    )


def _starts(free: Sequence[Number]) -> list[dict[str, float]]:
    """Starts where none are stated: sizes to both sides of null, with the other numbers at the ends of what
    is usual.
    """
    first, shapes = free[0], free[1:]
    signs = [s for s in (1.0, -1.0) if first.bounds[0] < s * SIZES[0] < first.bounds[1]]
    ends = [[n.value(-0.9), n.value(0.9)] for n in shapes]
    # A law of the robot file may have many numbers: not all their combinations are tried.
    few = [tuple(n.value(x) for n in shapes) for x in (-0.9, 0.0, 0.9)]
    return [
        {first.name: first.value(sign * size)} | dict(zip([n.name for n in shapes], shape, strict=True))
        for sign in signs
        for size in SIZES
        for shape in (itertools.product(*ends) if len(shapes) <= MOST_SHAPES else few)
    ]


def is_friction(number: Number) -> bool:
    """Whether a number is the friction coefficient of a tendon."""
    return number.parameter.partition(".")[0] == "mu"


def is_stiffness(number: Number) -> bool:
    """Whether a number says how stiff the body is."""
    return number.parameter in STIFFNESS


def base_numbers(robot: Robot, deviations: Mapping[str, float]) -> tuple[Number, ...]:
    """The numbers that every hypothesis fits: mu of each tendon and, unless the backbone is rigid, E, or the
    bending stiffness of a body that is given by it.

    Args:
        robot: with the values of its file.
        deviations: relative standard deviations of the file, by name of the parameter.
    """
    found = []
    for name in friction_of(robot):
        mu = max(float(robot.value(name)), 0.02)
        found.append(Number(name=name, unit="", centre=mu, sd=deviations.get(name, ANY_MU), log=True))
    for name in stiffness_of(robot):
        value, unit = float(robot.value(name)), parameter(robot, name).unit
        found.append(Number(name=name, unit=unit, centre=value, sd=deviations.get(name, ANY_E), log=True))
    return tuple(found)


def instrument_numbers(part: Observation) -> tuple[Number, ...]:
    """What the instruments of a rig always add, little of it, as their terms state it. Long recordings show
    it, and every hypothesis fits it beside mu and E: it is not an effect that is missing, and must not pass
    for one.

    Args:
        part: a recording with times.
    """
    assert part.time is not None
    alone = bool(part.pulled) and not part.others
    read = Read(part.time, part.T_base.T_base, part.T_tip if part.tips else None, alone)
    found = []
    for name in sorted(INSTRUMENT_NUMBERS):
        kind, _, quantity = name.partition(".")
        term = REGISTRY[kind]
        one = next(one for one in term.tried.always if one.name == quantity)
        if prior := one.prior(read):
            free = numbers_of(term, Variant(free=(quantity,)), term.quantities)
            found += believed(free, {quantity: prior})
    return tuple(found)
