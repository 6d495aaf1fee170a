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

# Half width of a range that holds 90 % of a normal distribution, in standard deviations.
NINE_OF_TEN = 1.645
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


# Terms that stand for several hypotheses, or have fixed numbers: the free numbers of each hypothesis.
VARIANTS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "local-friction": {"base": ("base",), "tip": ("tip",), "stretch": ("factor", "start", "end")},
    "tendon-stretch": {"": ("compliance",)},
    "cell-hysteresis": {
        "tip": ("tip", "width"),
        "base": ("base", "width"),
        "tip-spread": ("tip", "width", "spread"),
        "base-spread": ("base", "width", "spread"),
    },
    "zero-drift": {"tip": ("tip",), "base": ("base",)},
    "low-pass": {
        "tip": ("tip",),
        "base": ("base",),
        "tip-second": ("tip", "second"),
        "base-second": ("base", "second"),
    },
    "time-skew": {"": ("delay",), "drift": ("rate", "delay")},
    "saturation": {
        "tip": ("tip",),
        "base": ("base",),
        "tip-knee": ("tip", "knee"),
        "base-knee": ("base", "knee"),
    },
    "superelastic": {"": ("softening", "strain"), "unloading": ("hysteresis",)},
    # The reference cannot be told from mu; the direction of a stop is set by the direction of the bend.
    "pressure-dependent-friction": {"": ("exponent",)},
    "contact": {"": ("stiffness", "distance")},
    "viscous-friction": {"": ("coefficient",), "power": ("coefficient", "exponent")},
    "viscoelastic-body": {"": ("ratio", "time"), "spectrum": ("ratio", "time", "spread")},
}
# Numbers that shape the readings of both cells: an effect on one of them has them at their null, and none on
# the other cell may free them beside it.
OF_BOTH_CELLS: Mapping[str, tuple[str, ...]] = {"low-pass": ("second",), "saturation": ("knee",)}
# Variants that act where the rest of their term does: offered beside it, and to robots that have the rest.
WITHIN = {"superelastic.unloading"}
# The number of an effect on the cell at the tip, or at the anchor before it, and on the cell at the base.
AT_TIP, AT_BASE = "tip", "base"
# Events: their free time lets them fit any bump, so that none is offered until a misfit is located in time.
EVENTS = {kind for kind, term in REGISTRY.items() if term.event}
# Terms without an effect on anything that varies, or read from the samples themselves; and one that on a body
# of one radius is stiffening by another name.
NEVER = {"quantisation", "hyperelastic"}
# Shortest presliding length [m]: a little below what is usual. Shooting from the base becomes ill-conditioned
# for shorter ones: at 5e-5 m slip at the tip changes 2e5 times as much as at the base, at 1.5e-5 m 2e12
# times.
SHORTEST = 4e-5
# Compliance assumed for a tendon in a rigid sheath whose file states none [1/N].
COMPLIANCE = 5e-5
# Standard deviations of what instruments add: a delay between the cells [s], and the drift of a zero in the
# whole recording, as a share of the largest tension, beside what the cell shows while the tendon is slack
# (below this share of its largest reading). It is at most so many standard deviations: a drift that may be
# larger imitates friction, and an effect that is missing is not found any more.
DELAY, DRIFT, SLACK, FARTHEST = 0.03, 0.002, 0.02, 3.0
DRIFTS = ("zero-drift.tip", "zero-drift.base")
INSTRUMENT_NUMBERS = {"time-skew.delay", *DRIFTS}
# Numbers beside the size up to which all combinations of their ends are tried.
MOST_SHAPES = 3
# Modulus from which a body may be of a superelastic metal [Pa].
METAL = 1e9
# Sizes to try, in standard deviations of the prior.
SIZES = (0.3, 1.0)
# Decades between widths that the elements of a hysteretic cell start from.
SPREAD = 0.2


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
    file already has and `EVENTS`.

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
    rigid, found = robot.backbone.rigid, []
    may = every_for(robot)
    for term in robot.catalogue.values():
        if term.id in {*NEVER, *EVENTS, *without} or (term.ahead and not displaced):
            continue
        if not term.of_cells and term.id not in may:
            continue
        if term.timed and not timed:
            continue
        acts = known_on(term, robot.terms[term.id])
        if rigid and (term.bend or term.loads or term.stop):
            continue
        if term.id == "gravity-error" and not robot.loaded:
            continue
        if term.softens and (rigid or largest_modulus(robot.backbone) < METAL * (1 - 1e-9)):
            continue
        known = term.numbers if robot.space else term.quantities
        plain = {"": tuple(q.name for q in known)}
        for variant, names in VARIANTS.get(term.id, plain).items():
            name = f"{term.id}.{variant}" if variant else term.id
            if acts and (name not in WITHIN or _is_set(robot, term, names)):
                continue
            if not cells.tip and (names[0] == AT_TIP or (term.tip and not term.true_base)):
                continue
            if not cells.base and term.of_cells and (names[0] == AT_BASE or (term.base and not term.tip)):
                continue
            free = tuple(number_of(term, q) for wanted in names for q in known if q.name == wanted)
            started = _started(name, term, free, robot, largest_tip, travel, bend)
            reads = frozenset(f"{term.id}.{shape}" for shape in OF_BOTH_CELLS.get(term.id, ()))
            found.append(dataclasses.replace(started, reads=reads))
    return found


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


def _started(
    name: str,
    term: Term,
    free: tuple[Number, ...],
    robot: Robot,
    largest: float,
    travel: np.ndarray,
    bend: float,
) -> Hypothesis:
    length = float(robot.backbone.length)
    fixed: dict[str, float] = {}
    if name == "local-friction.stretch":
        span = 0.5 * length / NINE_OF_TEN
        factor, start, end = free
        start = dataclasses.replace(start, centre=0.35 * length, sd=0.6 * span, upper=0.97 * length)
        end = dataclasses.replace(end, centre=0.65 * length, sd=0.6 * span, lower=0.03 * length, upper=length)
        free = (factor, start, end)
        windows = [(0.02, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.98), (0.25, 0.6), (0.5, 0.9)]
        starts = [
            {factor.name: f, start.name: a * length, end.name: b * length}
            for f in (2.5, 0.45)
            for a, b in windows
        ]
        return Hypothesis(name=name, kind=term.id, numbers=free, starts=tuple(starts))
    if term.id == "saturation":
        own = dataclasses.replace(free[0], centre=largest, sd=0.15, log=True, lower=1e-3, size=False)
        # A knee is at most as wide as its limit is high, and mostly a tenth of it.
        knees = [
            dataclasses.replace(n, centre=0.1 * largest, sd=1.0, log=True, upper=largest) for n in free[1:]
        ]
        shape = {n.name: n.centre for n in knees}
        starts = tuple({own.name: share * largest} | shape for share in (0.97, 0.9, 0.75))
        return Hypothesis(name=name, kind=term.id, numbers=(own, *knees), starts=starts)
    if term.id == "contact":
        stiffness, distance = free
        stiffness = dataclasses.replace(stiffness, centre=200.0, sd=1.5, log=True, lower=1.0, size=False)
        way, reach = _way_of(travel)
        distance = dataclasses.replace(distance, centre=0.5 * reach, sd=0.4 * reach)
        fixed = {f"contact.{name}": angle for name, angle in way.items()}
        starts = [
            {stiffness.name: k, distance.name: d * reach} for d in (0.3, 0.6, 0.85) for k in (100.0, 600.0)
        ]
        return Hypothesis(
            name=name, kind=term.id, numbers=(stiffness, distance), starts=tuple(starts), fixed=fixed
        )
    if term.id == "presliding":
        # A presliding length shorter than the slip between samples is Coulomb friction, and hard to solve.
        free = (dataclasses.replace(free[0], lower=SHORTEST), *free[1:])
        stretches = bool(np.any(np.asarray(robot.terms["tendon-stretch"]["compliance"]) > 0))
        fixed = {"tendon-stretch.compliance": COMPLIANCE} if robot.backbone.rigid and not stretches else {}
    if term.id in ("tip-load", "gravity-error"):
        across = [*range(1, len(free)), 0]
        starts = [
            {n.name: s * n.sd * (sign if i == axis else 0.0) for i, n in enumerate(free)}
            for s in (0.1, 0.5)
            for axis in across
            for sign in (1, -1)
        ]
        return Hypothesis(name=name, kind=term.id, numbers=free, starts=tuple(starts), fixed=fixed)
    if term.id == "stiffening":
        # In units of 1/(largest change of curvature)^2. Below -4/27 of this unit, the moment has a maximum
        # below the applied moment, and the body would buckle.
        far = max(bend, 1e-6) ** -2
        own = dataclasses.replace(free[0], sd=0.4 * far, lower=-0.13 * far)
        starts = tuple({own.name: c * far} for c in (0.12, 0.4, -0.05, -0.11))
        return Hypothesis(name=name, kind=term.id, numbers=(own,), starts=starts)
    if name == "time-skew.drift":
        rate, delay = free
        starts = [{rate.name: sign * size * rate.sd, delay.name: 0.0} for size in SIZES for sign in (1, -1)]
        return Hypothesis(name=name, kind=term.id, numbers=free, starts=tuple(starts))
    if term.id == "cell-hysteresis" and name.endswith("-spread"):
        force, width, spread = free
        found = [
            {force.name: force.value(size), width.name: width.value(x), spread.name: SPREAD}
            for size in SIZES
            for x in (-0.4, 0.9)
        ]
        # A cell whose elements build up too steeply would show less of more tension.
        starts = tuple(s for s in found if not _fault(term, robot, s))
        return Hypothesis(name=name, kind=term.id, numbers=free, starts=starts)
    first, shapes = free[0], free[1:]
    signs = [s for s in (1.0, -1.0) if first.bounds[0] < s * SIZES[0] < first.bounds[1]]
    ends = [[n.value(-0.9), n.value(0.9)] for n in shapes]
    # A law of the robot file may have many numbers: not all their combinations are tried.
    few = [tuple(n.value(x) for n in shapes) for x in (-0.9, 0.0, 0.9)]
    starts = [
        {first.name: first.value(sign * size)} | dict(zip([n.name for n in shapes], shape, strict=True))
        for sign in signs
        for size in SIZES
        for shape in (itertools.product(*ends) if len(shapes) <= MOST_SHAPES else few)
    ]
    return Hypothesis(name=name, kind=term.id, numbers=free, starts=tuple(starts), fixed=fixed)


def _fault(term: Term, robot: Robot, start: Mapping[str, float]) -> str:
    """Why no robot can have a start of a hypothesis."""
    own = {q.name: float(np.max(np.asarray(robot.terms[term.id][q.name]))) for q in term.quantities}
    own |= {name.partition(".")[2]: value for name, value in start.items()}
    return "" if term.fault is None else term.fault(own, float(robot.backbone.length))


def _way_of(travel: np.ndarray) -> tuple[dict[str, float], float]:
    """Direction in which the tip goes farthest across the base tangent, as the angles of a stop in its way
    [rad], by name, and how far it goes [m]; `travel` as of `catalogue`.
    """
    if travel.ndim == 1:
        low, high = (float(v) for v in travel)
        return {"angle": (1.0 if high >= -low else -1.0) * np.pi / 2}, max(high, -low, 1e-3)
    across = travel[:, 1:]
    y, z = across[np.argmax(np.linalg.norm(across, axis=1))]
    side = 1.0 if y >= 0 else -1.0
    reach = max(float(np.hypot(y, z)), 1e-3)
    return {"angle": side * np.pi / 2, "elevation": float(np.arctan2(z, abs(y)))}, reach


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
    """What the instruments of a rig always add, little of it: a delay between the cells, and drifts of their
    zeros. Long recordings show it, and every hypothesis fits it beside mu and E: it is not an effect that is
    missing, and must not pass for one.

    Args:
        part: a recording with times.
    """
    assert part.time is not None
    found = [_instrument("time-skew.delay", 0.0, DELAY, np.inf)] if part.tips else []
    if part.others or not part.pulled:
        return tuple(found)  # the terms of the cells would drift alike at every tendon
    shown = {"zero-drift.base": part.T_base.T_base}
    shown |= {"zero-drift.tip": part.T_tip} if part.tips else {}
    unit = float(np.max(part.T_base.T_base)) / float(np.ptp(part.time))
    for name, T in shown.items():
        seen = zero_drift(part.time, T)
        found.append(_instrument(name, 0.0 if seen is None else seen, DRIFT * unit, FARTHEST))
    return tuple(found)


def _instrument(name: str, centre: float, sd: float, farthest: float) -> Number:
    kind, quantity = name.split(".")
    term = REGISTRY[kind]
    number = number_of(term, next(q for q in term.quantities if q.name == quantity))
    lower, upper = max(number.lower, centre - farthest * sd), min(number.upper, centre + farthest * sd)
    return dataclasses.replace(number, centre=centre, sd=sd, lower=lower, upper=upper, size=False)


def zero_drift(time: np.ndarray, T: np.ndarray) -> float | None:
    """Drift of a cell's zero [N/s], from what it shows while the tendon is slack; None where it is slack too
    seldom to tell.

    Args:
        time: [s], (K,).
        T: what the cell shows [N], (K,).
    """
    slack = T < SLACK * float(np.max(T))
    visit = np.cumsum(np.diff(slack.astype(int), prepend=0) == 1)
    rests = [(time[k], T[k]) for v in range(1, visit[-1] + 1) if np.sum(k := slack & (visit == v)) >= 5]
    if len(rests) < 3:
        return None
    t, zero = np.asarray([(np.median(when), np.median(shown)) for when, shown in rests]).T
    return float(np.polyfit(t, zero, 1)[0]) if np.ptp(t) > 0.5 * np.ptp(time) else None
