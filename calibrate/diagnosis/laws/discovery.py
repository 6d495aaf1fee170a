"""From structure that no effect of the catalogue explains to a law that predicts unseen samples."""

from __future__ import annotations

import dataclasses
import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from calibrate.diagnosis.decision.decide import structured
from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis, is_friction, is_stiffness
from calibrate.diagnosis.hypotheses.model import Fitted, Point, model_of
from calibrate.diagnosis.likelihood.likelihood import MOST_ITERATIONS, Likelihood
from calibrate.diagnosis.likelihood.locate import misfit
from calibrate.diagnosis.screening.screen import FAR, SEEN, Start
from calibrate.diagnosis.search.forward_search import Unseen
from calibrate.diagnosis.search.search import BEGIN, raced
from calibrate.diagnosis.search.twins import settled
from calibrate.inference.number import Number
from calibrate.inference.side_by_side import in_lanes
from calibrate.inference.simulated_rig import SimulatedRig
from gtr_jax import Robot
from gtr_jax.terms import Law, null_values
from gtr_jax.terms.expression import evaluate

from .forms import (
    ALONE,
    EDGE,
    SIZE,
    SWINGING,
    TRANSIENT,
    Form,
    coordinates,
    cosines,
    forms_for,
    hypothesis_of,
    law_of,
    smooth_of,
    usual_size,
    waves,
)
from .places import LawPlace, largest_tip, places

# Hooks and variables that are felt besides where a number of the model is so many times what fits best: a
# cell that shows too little makes friction too large, a body that stiffens makes E too large, and to first
# order from there the right law promises little.
PROBED_AT = (
    (("tip_cell", "T"), is_friction, (0.35, 0.5, 0.65, 0.8, 1.25, 1.6)),
    (("bending", "k"), is_stiffness, (0.5, 0.7, 1.4)),
)
# Size at which a tent is tried, as a share of the usual size.
FELT = 0.3
# A form must promise this many variances, and as many more for each of its numbers beside the size.
WORTH, EACH = 16.0, 4.0
# The share of the best promise that a place must have to be tried at all.
LEAST_PROMISE = 0.1
# Hooks and variables that are fitted inside the simulator; forms of the first and of each other of them, and
# starts of the best form of each.
PLACES, FORMS, STARTS = 3, (4, 2), 2
# Starts of a form that has a minimum beside each of many periods or stretches: so many are simulated, and the
# fit goes on from the best of them. Where a law moves much, those that first order ranks first may be the
# wrong ones.
MANY_STARTS, KEPT_STARTS = 32, 8
# Places at which a smooth law is compared with short forms, how many of these are fitted from it, the largest
# share of its squares that one may leave, and the least friction at its level, as a share of what it was.
SEEN_AT, ALIKE, UNLIKE, LEAST_LEVEL = 201, 3, 0.4, 0.1
# Largest size, in usual sizes, that a fit starts from; shortest period and width, in distances of tents.
LARGEST, WAVES, WIDE = 2.5, 2.5, 0.5
# A law is told if it takes this share of the misfit beyond the noise on unseen samples; a short law is shown
# in the place of the smooth one if what it leaves there is at most so many times as much. A law that leaves
# structure beyond the noise is the wrong one, or not alone: it is told only if it takes nearly all.
TAKES, AS_WELL, NEARLY_ALL = 0.5, 1.1, 0.9
# Short laws of a place that are judged, at most, and how much worse than the most probable they may fit, in
# variances, or as many more as an error of unknown cause has.
SHORT_EACH, WORSE = 3, 12.0
# Another hook or variable stays possible above this probability; models of the catalogue's effects that are
# shown beside the law.
POSSIBLE, CATALOGUED = 0.03, 4


class Felt(NamedTuple):
    """How the white residuals respond to tents at a place, beside what the fitted numbers can follow.

    Attributes:
        place: the place.
        gram, toward: Gram matrix of the tents' changes, (n, n), and their product with the residual, (n,);
            per unit of the size.
        moved: the changes of the rows themselves, (rows, n).
        x, rows: coordinates of the model's numbers where it is felt, and the white residuals there.
        lost: by how many variances the model is worse there than where it fits best, once its numbers have
            followed, to first order.
    """

    place: LawPlace
    gram: np.ndarray
    toward: np.ndarray
    moved: np.ndarray
    x: np.ndarray
    rows: np.ndarray
    lost: float = 0.0


class LawCandidate(NamedTuple):
    """A form at a place, or a smooth law (no form), with what it promises and where to fit it from."""

    place: LawPlace
    form: Form | None
    score: float
    law: Law
    hypothesis: Hypothesis
    start: np.ndarray

    @property
    def transient(self) -> bool:
        """Whether it describes what happens once, at some time."""
        return self.form is not None and _is_transient(self.place, self.form)


@dataclasses.dataclass(frozen=True, eq=False)
class Discovery:
    """A law that was found.

    Attributes:
        models: all models, with those that have a law.
        fitted: the model that is shown.
        place: hook and variable.
        law: the law.
        form: its form; None if it is a smooth curve.
        laws: of the models that are shown or stay possible, by name.
        possible: names of models with a law at another hook or of another variable that stay possible, and
            where these act.
        takes: share of the misfit beyond the noise that it takes on unseen samples.
        pieces: whether the unseen samples are short pieces that alternate with those fitted; as of
            `held_out.folds`.
    """

    models: Models
    fitted: Fitted
    place: LawPlace
    law: Law
    form: Form | None
    laws: dict[str, Law]
    possible: list[tuple[str, ...]]
    possible_places: list[LawPlace]
    takes: float
    pieces: bool


def with_laws(robot: Robot, laws: Sequence[Law]) -> Robot:
    """A robot that may have more laws, all of them null."""
    null = null_values(tuple(laws))
    more = {law.name: {n: jnp.asarray(v) for n, v in null[law.name].items()} for law in laws}
    return dataclasses.replace(robot, laws=(*robot.laws, *laws), terms={**robot.terms, **more})


def _likelihood_with(likelihood: Likelihood, laws: Sequence[Law]) -> Likelihood:
    """The same recordings, of a robot that may have more laws."""
    rigs, known = [], {}
    for rig in likelihood.rigs:
        robot = known.setdefault(id(rig.robot), with_laws(rig.robot, laws))
        rigs.append(SimulatedRig(rig.part, robot, rig.more, rig.cache))
    return dataclasses.replace(likelihood, rigs=tuple(rigs))


def discover(models: Models, head: Fitted, progress: Callable[[str], None]) -> Discovery | None:
    """Look for a law that explains what a model leaves.

    Tents over the range of each variable tell to first order what any law of it would change: that ranks
    smooth laws and short forms at every hook without simulating them. The best are fitted inside the
    simulator, and judged on samples that the fit has not seen.

    Args:
        models: all that were refitted, to all samples.
        head: the model that leaves structure.
        progress: called with a line at each stage.
    """
    progress("looking for where a law outside the catalogue would act")
    ranked = _ranked(feel(models, head))
    wider, candidates = _fitted(models, head, ranked[:PLACES], progress)
    unseen = Unseen(wider)
    found = _judged(wider, head, candidates, unseen)
    if found is not None:
        return found
    rest = [entry for entry in ranked[PLACES:] if entry.score > LEAST_PROMISE * ranked[0].score]
    wider, more = _fitted(wider, head, _others(models, head, rest), progress)
    return _judged(wider, head, [*candidates, *more], unseen.shared(wider)) if more else None


def _others(models: Models, head: Fitted, rest: Sequence[Ranked]) -> list[Ranked]:
    """Of places that were not tried, the one first whose best form does most once it is refitted briefly: a
    law that changes much may do more than it promises to first order.
    """
    information = head.information()
    candidates = [
        [_formed(head, information, of.felt, one) for one in of.found if one[1] is of.found[0][1]][:STARTS]
        for of in rest
    ]
    every = list(itertools.chain(*candidates))
    if not every:
        return []
    likelihood = _likelihood_with(models.likelihood, [of[0].law for of in candidates])
    own = models.hypotheses(head.names)
    items = [((*own, c.hypothesis), Start(c.start, {})) for c in every]
    costs = {f.names[-1]: f.cost for f in raced(likelihood, head, items, BEGIN)}
    left = sorted((costs.get(of[0].law.name, np.inf), k) for k, of in enumerate(candidates))
    return [rest[k] for cost, k in left[:PLACES] if cost < head.cost - WORTH]


def _fitted(
    models: Models, head: Fitted, ranked: Sequence[Ranked], progress: Callable[[str], None]
) -> tuple[Models, list[LawCandidate]]:
    """Fit the laws of some places, the best first, beside the head, and short forms that look like the smooth
    ones.

    Returns:
        The models with those that do more than the head, and what was tried.
    """
    candidates = promising(head, ranked)
    if not candidates:
        return models, []
    names = list(dict.fromkeys(c.place.name for c in candidates))
    progress(f"fitting laws inside the simulator: {', '.join(names)}")
    wider = _with_candidates(models, candidates)
    own = models.hypotheses(head.names)
    candidates = _nearest(wider.likelihood, head, own, candidates)
    fits = _raced(wider, head, own, candidates)
    more = distilled(wider, head, candidates)
    fits = list({f.names: wider.stored(f) for f in [*fits, *_raced(wider, head, own, more)]}.values())
    candidates += [c for c in more if c.law.name not in {other.law.name for other in candidates}]
    tried = {*models.of, *(c.law.name for c in candidates)}
    wider.of = {name: h for name, h in wider.of.items() if name in tried}
    if wider.likelihood.heavy is not None:  # far from the data, rows that count less when far off show no way
        settled(wider, fits)
    return wider, candidates


def _raced(
    wider: Models, head: Fitted, own: Sequence[Hypothesis], candidates: Sequence[LawCandidate]
) -> list[Fitted]:
    """Fits of candidates beside a model that do more than it, which join the models."""
    items = [((*own, c.hypothesis), Start(c.start, {})) for c in candidates]
    fits = [f for f in raced(wider.likelihood, head, items, MOST_ITERATIONS) if f.cost < head.cost]
    wider.add(fits)
    return fits


def distilled(wider: Models, head: Fitted, candidates: Sequence[LawCandidate]) -> list[LawCandidate]:
    """Short forms that look like a smooth law that was fitted, each from where that fit ended: to first order
    from the head, the start of a law that changes much is far from its end.

    Args:
        wider: the models with the fits of smooth laws.
        head: the model that they extend.
        candidates: that were fitted.
    """
    found = []
    for c in candidates:
        names = tuple(sorted((*head.names, c.law.name)))
        if c.form is not None or names not in wider.fits:
            continue
        smooth = wider.fits[names]
        base, curve = smooth.x[: len(head.x)], smooth.values
        u = np.linspace(0.0, 1.0, SEEN_AT)
        g = cosines(c.place, u) @ [curve[f"{c.law.name}.c{j}"] for j in waves(c.place)]
        for _, form, level, size, shapes in _short_forms(c.place, u, g)[:ALIKE]:
            of_form = coordinates(c.place, form, size, shapes)
            start = np.concatenate([_levelled(wider, c.place, base, level), of_form])
            law, hypothesis = law_of(c.place, form)[0], hypothesis_of(c.place, form)
            found.append(LawCandidate(c.place, form, c.score, law, hypothesis, start))
    return found


def _short_forms(place: LawPlace, u: np.ndarray, g: np.ndarray):
    """What is left of a curve g(u) by each form that looks like it, the form, and its level, size and shapes
    as in a grid; the nearest first. A constant that the curve has beside the form is its level.
    """
    found = []
    # What does not change with the variable is not a part of these laws.
    centred = place.acts not in ALONE
    for form in forms_for(place):
        best, most = None, LARGEST * usual_size(place, form)
        for shapes in form.grid:
            v = form.value(u, *shapes)
            columns = np.stack([np.ones_like(u), v], axis=1) if centred else v[:, None]
            at = np.linalg.lstsq(columns, g, rcond=None)[0]
            left = float(np.sum((columns @ at - g) ** 2))
            if best is None or left < best[0]:
                best = left, at, shapes
        assert best is not None
        left, at, shapes = best
        # Friction takes the level of its law; that of the others is left to what is fitted beside them.
        level = float(at[0]) if place.acts == "friction" else 0.0
        if left < UNLIKE * float(np.sum(g**2)) and level > LEAST_LEVEL - 1:
            size = float(np.clip(at[-1] / (1 + level), max(-most, place.least), most))
            found.append((left, form, level, size, shapes))
    return sorted(found, key=lambda entry: entry[0])


def _levelled(wider: Models, place: LawPlace, base: np.ndarray, level: float) -> np.ndarray:
    """Coordinates of a model's numbers once its friction has taken the level of a law."""
    if place.acts != "friction":
        return base
    return _scaled(wider.likelihood.base, base, is_friction, 1 + level)


def _scaled(
    numbers: Sequence[Number], x: np.ndarray, moves: Callable[[Number], bool], factor: float
) -> np.ndarray:
    """Coordinates once some of the numbers are so many times what they are, within their bounds."""
    moved = x.copy()
    for i, number in enumerate(numbers):
        if moves(number):
            moved[i] = np.clip(number.at(factor * number.value(x[i])), *number.bounds)
    return moved


def _nearest(
    likelihood: Likelihood, head: Fitted, own: Sequence[Hypothesis], candidates: Sequence[LawCandidate]
) -> list[LawCandidate]:
    """The candidates, of a law with many starts those that fit best as they are."""
    starts = Counter(c.law.name for c in candidates)
    many = [c for c in candidates if starts[c.law.name] > KEPT_STARTS]
    values = [model_of(likelihood.base, [*own, c.hypothesis]).values(c.start) for c in many]
    costs = [
        np.inf
        if seen is None or sum(s.failed for s in seen) > head.failed
        else float(np.sum(likelihood.rows(seen) ** 2) + np.sum(c.start**2))
        for c, seen in zip(many, likelihood.simulated(values, head.names), strict=True)
    ]
    left = set[int]()
    for name in starts:
        of = sorted((cost, k) for k, cost in enumerate(costs) if many[k].law.name == name)
        left |= {id(many[k]) for _, k in of[KEPT_STARTS:]}
    return [c for c in candidates if id(c) not in left]


def _with_candidates(models: Models, candidates: Sequence[LawCandidate]) -> Models:
    """The models with a likelihood that knows the laws, and those of the other forms at their places."""
    every = [(c.law, c.hypothesis) for c in candidates]
    for place in {c.place.name: c.place for c in candidates}.values():
        every += [(law_of(place, form)[0], hypothesis_of(place, form)) for form in forms_for(place)]
    laws, new = {law.name: law for law, _ in every}, {law.name: h for law, h in every}
    wider = Models(
        _likelihood_with(models.likelihood, list(laws.values())), [*models.of.values(), *new.values()]
    )
    wider.add(list(models.fits.values()))
    return wider


def feel(models: Models, head: Fitted) -> list[Felt]:
    """How the readings respond to tents at every place; at some also where friction or the stiffness of the
    body is another than fits best without a law (`PROBED_AT`).
    """
    robot, here = models.likelihood.rigs[0].robot, Point(head.values, head.seen, head.rows)
    spots = [(place, head.x, here) for place in places(robot, models.likelihood, here)]
    tents = [place.tent() for place, *_ in spots]
    own = models.hypotheses(head.names)
    known = {(place.acts, place.of) for place, *_ in spots}
    for there, moves, factors in PROBED_AT:
        for x, point in _elsewhere(models.likelihood, head, own, moves, factors) if there in known else ():
            found = places(robot, models.likelihood, point)
            spots += [(place, x, point) for place in found if (place.acts, place.of) == there]
    likelihood = _likelihood_with(models.likelihood, tents)

    def change(job: tuple[int, float]) -> np.ndarray | None:
        place, x, point = spots[job[0]]
        if place.acts == "viscous" and job[1] == 0:  # its laws vanish there
            return None
        name, step = place.tent().name, FELT * place.size
        fixed = {f"{name}.at": job[1], f"{name}.width": float(place.tents[1] - place.tents[0])}
        tent = Hypothesis(name, name, (), (), {**fixed, f"{name}.{SIZE}": step})
        # With the mesh's correction of the head: the difference of two corrections is not an effect.
        seen = likelihood.simulate(model_of(likelihood.base, [*own, tent]).values(x), head.names)
        if seen is None or sum(s.failed for s in seen) > head.failed:
            return None
        return (likelihood.rows(seen) - point.rows) / step

    jobs = [(k, float(middle)) for k, (place, *_) in enumerate(spots) for middle in place.tents]
    changed = dict(zip(jobs, in_lanes(change, jobs), strict=True))
    q, _ = np.linalg.qr(np.concatenate([head.jacobian, np.eye(len(head.x))]))
    felt = []
    for k, (place, x, point) in enumerate(spots):
        changes = [changed[k, float(middle)] for middle in place.tents]
        moved = np.stack([np.zeros_like(point.rows) if c is None else c for c in changes], axis=1)
        across = np.concatenate([moved, np.zeros((len(x), moved.shape[1]))])
        across -= q @ (q.T @ across)
        left = np.concatenate([point.rows, x])
        left -= q @ (q.T @ left)
        lost = max(float(left @ left) - head.chi2 - head.prior, 0.0)
        felt.append(Felt(place, across.T @ across, -across.T @ left, moved, x, point.rows, lost))
    return felt


def _elsewhere(
    likelihood: Likelihood,
    head: Fitted,
    own: Sequence[Hypothesis],
    moves: Callable[[Number], bool],
    factors: Sequence[float],
) -> list[tuple[np.ndarray, Point]]:
    """The head where some of its numbers are so many times what they are, within their bounds, and all else
    is as it was: coordinates, and what is simulated there.
    """
    model = model_of(likelihood.base, own)
    many: list[np.ndarray] = []
    for factor in factors:
        x = _scaled(model.numbers, head.x, moves, factor)
        if not any(np.array_equal(x, other) for other in (head.x, *many)):
            many.append(x)
    points = zip(many, likelihood.points(model, many), strict=True)
    return [(x, point) for x, point in points if point is not None and point.failed <= head.failed]


class Ranked(NamedTuple):
    """A place with the score of its best form, and what `_of_forms` gives, the best first."""

    score: float
    felt: Felt
    found: list[tuple[float, Form, float, tuple[float, ...]]]


def _ranked(felt: Sequence[Felt]) -> list[Ranked]:
    """The places that promise something, the best first; of one that is felt several times, where it promises
    most.
    """
    every = []
    for f in felt:
        found = sorted(_of_forms(f), key=lambda entry: -entry[0])
        if found and found[0][0] > WORTH:
            every.append(Ranked(found[0][0], f, found))
    best: dict[str, Ranked] = {}
    for entry in sorted(every, key=lambda entry: -entry.score):
        best.setdefault(entry.felt.place.name, entry)
    return list(best.values())


def promising(head: Fitted, ranked: Sequence[Ranked]) -> list[LawCandidate]:
    """The forms and smooth laws that promise most at some places, the best place first; those of a place
    together.
    """
    information = head.information()
    candidates = []
    for k, (_, f, found) in enumerate(ranked):
        forms = FORMS[k > 0]
        kept: dict[str, int] = {}
        for entry in found:
            score, form, *_ = entry
            # Several starts of the best form and of transients, one of each other form.
            first = not kept or form.name == next(iter(kept))
            many = _is_transient(f.place, form) or (first and form.name in SWINGING)
            most = MANY_STARTS if many else STARTS if first else 1
            if score < WORTH or (form.name not in kept and len(kept) == forms) or kept.get(form.name) == most:
                continue
            kept[form.name] = kept.get(form.name, 0) + 1
            candidates.append(_formed(head, information, f, entry))
        candidates.append(_smooth(head, information, f))
    return candidates


def _formed(
    head: Fitted, information: np.ndarray, felt: Felt, entry: tuple[float, Form, float, tuple[float, ...]]
) -> LawCandidate:
    """A form at a place, from its best fit to first order; the entry as of `_of_forms`."""
    (score, form, size, shapes), place = entry, felt.place
    u = (place.tents - place.low) / place.span
    own = coordinates(place, form, size, shapes)
    start = _followed(head, information, felt, felt.moved @ (size * form.value(u, *shapes)), own)
    return LawCandidate(place, form, score, law_of(place, form)[0], hypothesis_of(place, form), start)


def _is_transient(place: LawPlace, form: Form) -> bool:
    """Whether a form there describes what happens once, at some time."""
    return place.of == "t" and form.name in TRANSIENT


def _of_forms(felt: Felt):
    """Score, form, size and shapes of what is worth fitting at a place, one entry of each form and region of
    its shapes.
    """
    place = felt.place
    u = (place.tents - place.low) / place.span
    for form in forms_for(place):
        grid = [shapes for shapes in form.grid if _is_felt(form, shapes, len(u))]
        values = np.stack([form.value(u, *shapes) for shapes in grid])
        power = np.einsum("gi,ij,gj->g", values, felt.gram, values)
        toward = values @ felt.toward
        usual = usual_size(place, form)
        most = LARGEST * usual
        sizes = np.clip(toward / (power + usual**-2), max(-most, place.least), most)
        gains = 2 * sizes * toward - sizes**2 * (power + usual**-2)
        scores = gains - EACH * len(form.shapes) - felt.lost
        taken: list[np.ndarray] = []
        for g in np.argsort(-scores)[: 10 * MANY_STARTS]:
            pattern = values[g] / max(np.linalg.norm(values[g]), 1e-12)
            if all(abs(pattern @ other) < 0.9 for other in taken):
                taken.append(pattern)
                yield float(scores[g]), form, float(sizes[g]), grid[g]


def _is_felt(form: Form, shapes: Sequence[float], tents: int) -> bool:
    """Whether a form is coarse enough for its tents: a faster wave looks like a slow one."""
    return all(
        value >= (WAVES if shape.name == "period" else WIDE) / (tents - 1)
        for shape, value in zip(form.shapes, shapes, strict=True)
        if shape.log and shape is not EDGE
    )


def _followed(
    head: Fitted, information: np.ndarray, felt: Felt, moved: np.ndarray, own: np.ndarray
) -> np.ndarray:
    """Coordinates from which a law is fitted: those of the head where the law is felt, once they follow the
    change of the rows, and the law's own.
    """
    follow = np.linalg.solve(information, -head.jacobian.T @ (felt.rows + moved) - felt.x)
    return np.concatenate([felt.x + np.clip(follow, -FAR, FAR), own])


def _smooth(head: Fitted, information: np.ndarray, felt: Felt) -> LawCandidate:
    """The smooth law at a place, from its best fit to first order."""
    place = felt.place
    law, h = smooth_of(place)
    u = (place.tents - place.low) / place.span
    sds = np.asarray([n.sd for n in h.numbers])
    basis = sds * cosines(place, u)
    inside = basis.T @ felt.gram @ basis + np.eye(len(sds))
    toward = basis.T @ felt.toward
    x = np.clip(np.linalg.solve(inside, toward), -LARGEST, LARGEST)
    start = _followed(head, information, felt, felt.moved @ (basis @ x), x)
    return LawCandidate(place, None, float(toward @ x) - felt.lost, law, h, start)


def _judged(
    models: Models, head: Fitted, candidates: Sequence[LawCandidate], unseen: Unseen
) -> Discovery | None:
    """The law that is told, if one predicts unseen samples well enough."""
    of = {c.law.name: c for c in candidates}
    fits = [f for f in models.fits.values() if f.names and f.names[-1] in of]
    fits = [f for f in fits if head.cost - f.cost > SEEN**2 and not _refused(models, of[f.names[-1]], f)]
    fits = [f for f in fits if np.any(np.isfinite(unseen.squares([f])))]
    if not fits:
        return None
    found = _told(models, head, of, fits, unseen)
    if (
        found is None
        and not unseen.rows
        and any(rig.part.explained < len(rig.part.channels) for rig in models.likelihood.rigs)
    ):
        # A law of the body may show in the pose alone.
        found = _told(models, head, of, fits, unseen.shared(rows=True))
    # What happens once, within one part, is in no other. A law of the cycle says the same of it.
    others = [f for f in fits if of[f.names[-1]].place.of != "n"]
    best = min(others, key=lambda f: f.cost, default=None)
    if found is None and best is not None and of[best.names[-1]].transient:
        found = _told(models, head, of, fits, Unseen(models, pieces=True))
    return found


def _told(
    models: Models, head: Fitted, of: dict[str, LawCandidate], fits: Sequence[Fitted], unseen: Unseen
) -> Discovery | None:
    """The law that is told of some that were fitted, judged on unseen samples; in pieces a transient."""
    probability = models.probabilities_given_discrepancy(min(fits, key=lambda f: f.cost))
    short = sorted((f for f in fits if of[f.names[-1]].form is not None), key=lambda f: -probability[f.names])
    smooth = {of[f.names[-1]].place.name: f for f in fits if of[f.names[-1]].form is None}
    # The short laws of each place that fit nearly alike are judged, and the smooth one beside them: what fits
    # a little less may predict better what lies beyond the samples that were fitted.
    best: dict[str, list[Fitted]] = {}
    for f in short:
        c = of[f.names[-1]]
        if c.place.of != "t" or not unseen.pieces or c.transient:
            there = best.setdefault(c.place.name, [])
            if not there or (
                len(there) < SHORT_EACH
                and f.cost < there[0].cost + WORSE * models.likelihood.scale_left(there[0])
            ):
                there.append(f)
    tried = [*itertools.chain(*best.values()), *smooth.values()]
    nearest = [f for f in models.fits.values() if f.names and f.names[-1] not in of]
    nearest = sorted(nearest, key=lambda f: f.cost)[:CATALOGUED]
    rivals = [head, *nearest[:1]]
    _, totals = unseen.totals([*rivals, *tried])
    if not totals.any():
        return None
    least = dict(zip([f.names for f in tried], totals[len(rivals) :], strict=True))
    first = min(tried, key=lambda f: least[f.names])
    # The probability decides between those that predict as well as the best.
    equal = [f for f in tried if least[f.names] <= AS_WELL * least[first.names]]
    may_be_shown = [f for f in equal if of[f.names[-1]].transient or not unseen.pieces]
    shown = max(may_be_shown, key=lambda f: probability[f.names], default=None)
    if shown is None or any(unseen.best(other, [shown]) is None for other in rivals):
        return None
    if unseen.rows and models.likelihood.heavy is None:  # by all rows: not at the cost of what is explained
        folds = unseen.folds([head, shown])
        if np.sum(folds[1, :, 0]) > AS_WELL * np.sum(folds[0, :, 0]):
            return None
    told = of[shown.names[-1]]
    others: dict[str, Fitted] = {}
    for f in sorted(equal, key=lambda f: -probability[f.names]):
        there = of[f.names[-1]].place.name
        if there != told.place.name:
            others.setdefault(there, f)
    total = probability[shown.names] + sum(probability[f.names] for f in others.values())
    possible = [f.names for f in others.values() if probability[f.names] > POSSIBLE * total]
    takes = _takes(unseen, head, shown)
    models = _weighed_by(models, shown, [head.names, *possible, *(f.names for f in nearest)])
    again = Unseen(models, pieces=unseen.pieces, rows=unseen.rows)
    takes = max(takes, _takes_of_noise(again, models.stored(head), models.stored(shown)))
    stays = structured(misfit(models.likelihood, models.stored(shown)))
    if takes < (NEARLY_ALL if told.transient or stays else TAKES) or (unseen.pieces and stays):
        return None
    return Discovery(
        models=models,
        fitted=models.stored(shown),
        place=_covered(models.likelihood, told, models.stored(shown)),
        law=told.law,
        form=told.form,
        laws={names[-1]: of[names[-1]].law for names in (shown.names, *possible)},
        possible=possible,
        possible_places=[of[names[-1]].place for names in possible],
        takes=takes,
        pieces=unseen.pieces,
    )


def _refused(models: Models, candidate: LawCandidate, fitted: Fitted) -> str:
    """Why a robot cannot have a law with these numbers; "" if it can."""
    robot, law = models.likelihood.rigs[0].robot, candidate.law
    values = {q.name: fitted.values[f"{law.name}.{q.name}"] for q in law.numbers}
    if law.acts == "viscous":  # what it takes off friction must be there
        v = np.linspace(candidate.place.low, candidate.place.high, SEEN_AT)
        least = min(fitted.values[n.name] for n in fitted.numbers if is_friction(n))
        if np.min(evaluate(law.tree, {**values, "v": v}, np)) < -least:
            return "friction would push the tendon forward"
    fault = robot.catalogue[law.name].fault
    return "" if fault is None else fault(values, float(robot.backbone.length))


def _covered(likelihood: Likelihood, candidate: LawCandidate, fitted: Fitted) -> LawPlace:
    """The place of a law with the range that its fit covers: the tension at the tip's cell is simulated."""
    place = candidate.place
    if (place.acts, place.of) != ("tip_cell", "T"):
        return place
    without = dict(fitted.values) | {f"{candidate.law.name}.{SIZE}": 0.0}
    seen = likelihood.simulate(without, fitted.names)
    return place if seen is None else dataclasses.replace(place, high=largest_tip(likelihood, seen))


def _weighed_by(models: Models, shown: Fitted, others: Sequence[tuple[str, ...]]) -> Models:
    """The models with the noise taken from the one that is shown: a model that leaves structure takes some of
    it for noise. The base model, the one shown and some others are kept, refitted.
    """
    likelihood = models.likelihood.weighed(shown.values, shown.seen)
    again = Models(likelihood, list(models.of.values()))
    kept = {names: models.fits[tuple(sorted(names))] for names in ((), shown.names, *others)}

    def refit(item: tuple[tuple[str, ...], Fitted]) -> Fitted | None:
        names, f = item
        # With less noise, what was the end of a fit no longer is.
        return likelihood.refit(models.hypotheses(names), f.x, most=MOST_ITERATIONS if f is shown else 5)

    again.add([f for f in in_lanes(refit, list(kept.items())) if f is not None])
    return again if {(), tuple(sorted(shown.names))} <= set(again.fits) else models


def _takes(unseen: Unseen, head: Fitted, shown: Fitted) -> float:
    """Share of the misfit beyond the noise, of all channels, that a model takes on unseen samples."""
    folds = unseen.folds([head, shown])
    folds = folds[:, np.all(folds[..., 3] > 0, axis=0)]
    before, after = (max(float(np.sum(f[:, 2] - f[:, 3])), 0.0) for f in folds)
    return 1 - after / before if before > 0 else 0.0


def _takes_of_noise(unseen: Unseen, head: Fitted, shown: Fitted) -> float:
    """The same, by the noise that the law leaves: what changes from each sample to the next passes for noise
    without it. No more than its share of the whole sum of squares on unseen samples.
    """
    _, (before, after) = unseen.totals([head, shown])
    return min(_takes(unseen, head, shown), 1 - after / before if before > 0 else 0.0)
