"""What a diagnosis starts from: the likelihood, the base model fitted to it, and what may be missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from calibrate.fitting.fit import channels_of, driven_as_recorded, part_of
from calibrate.inference.channels import CHANNELS, quantity_of
from calibrate.inference.free import distinct
from calibrate.inference.instruments import cells_of, explained_first, instruments
from calibrate.inference.load_history import padded_history
from calibrate.inference.number import Number, values_in
from calibrate.inference.samples import some_samples
from calibrate.inference.setup import Observation, check_columns, check_noise, recorded
from calibrate.inference.simulated_rig import SimulatedRig, friction_of, program_for, resolution_of
from calibrate.inference.simulation_cache import SimulationCache
from gtr_jax import InputError, Recording, Robot, RobotConfig, build_robot
from gtr_jax.errors import excerpt, nearest_first
from gtr_jax.recordings.base_tension import BEND, sharpened
from gtr_jax.robot.parameters import parameter
from gtr_jax.robot.stiffness import stiffness_of
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_with

from .answer.result import BAD_DATA, Diagnosis
from .evidence.models import Models
from .evidence.refine import refine
from .hypotheses.hypotheses import Hypothesis, base_numbers, catalogue, instrument_numbers
from .hypotheses.model import Fitted
from .likelihood.follow import dimensions_of
from .likelihood.likelihood import HEAVY, SCANNED, Likelihood, change_by, passing
from .outside.disturbances import behind_gaps, disturbances, within
from .outside.leave_out import Stretch, without
from .outside.sanity import faults
from .search.differ import MOST as MOST_DIFFER
from .search.differ import Difference, differing, names_to_split
from .search.search import base_fit

# Samples of each recording on which hypotheses are tried, and on which the best are refitted.
FEW, MANY = 140, 2400
# Samples of each recording on which hypotheses are tried where there are several: together they hold more
# information.
FEW_OF_SEVERAL = 96
# Samples from which on a recording shows what its instruments add.
LONG = 1000
# Names that a message offers for an unknown one.
NEAREST = 3
# Quantities in which a stretch of the tendon ahead of the channel is seen.
DRAWN = ("displacement", "T_base")
# Times that events from outside are looked for, each with a better fit.
LOOKS = 2
# Resolution of the mesh that the best models are corrected to, relative to the robot's own.
FINEST = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """What the search starts from.

    Attributes:
        config: the robot file, or None.
        fine: the robot on its own mesh.
        parts, full: the recordings, and those samples of them that are used.
        kept: indices of the samples in the likelihood.
        warnings: what the reader must know.
        likelihood: few samples on a coarse mesh.
        rough, exact: all samples on the coarse mesh, and on a fine one.
        base: fit of the base model.
        hypotheses: what may be missing.
        differ: the numbers that differ between the recordings.
        leave_out: what is simulated and not compared, by name of the recording.
    """

    config: RobotConfig | None
    fine: Robot
    parts: list[Observation]
    full: list[Observation]
    kept: list[np.ndarray]
    warnings: list[str]
    likelihood: Likelihood
    rough: list[SimulatedRig]
    exact: list[SimulatedRig]
    base: Fitted
    hypotheses: list[Hypothesis]
    differ: list[Difference] = dataclasses.field(default_factory=list)
    leave_out: Mapping[str, Sequence[Stretch]] = dataclasses.field(default_factory=dict)

    def without(self, stretches: Mapping[str, Sequence[Stretch]]) -> Prepared:
        """The same with stretches of the recordings that are not compared in the final fits."""

        def again(rigs: Sequence[SimulatedRig]) -> list[SimulatedRig]:
            return [rig.of(without(rig.part, stretches.get(rig.part.name, ()))) for rig in rigs]

        rough, exact = again(self.rough), again(self.exact)
        return dataclasses.replace(self, full=[rig.part for rig in rough], rough=rough, exact=exact)


def prepare(
    robot: RobotConfig | Robot,
    recording: Recording | Sequence[Recording],
    channels: Sequence[str] | str | None = None,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    say: Callable[[str], None] = lambda _: None,
    cache: SimulationCache | None = None,
    *,
    may_differ: bool = True,
    leave_out: Mapping[str, Sequence[Stretch]] | None = None,
    untried: Sequence[str] = (),
) -> Prepared | Diagnosis:
    """Read the recordings, fit the base model, ask whether a number differs between them, and list what may
    be missing; arguments as of `diagnose`.

    Args:
        may_differ: whether numbers that differ are looked for.
        leave_out: what is simulated and not compared, by name of the recording; of a long recording, what
            happens to it from outside comes to that.
        untried: names of terms that are not tried.

    Returns:
        What the search starts from; a diagnosis where the data do not allow one.
    """
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    if not recordings:
        raise InputError("diagnose: no recording is given")
    config = robot if isinstance(robot, RobotConfig) else None
    fine = build_robot(robot) if isinstance(robot, RobotConfig) else robot
    _check_names(fine, untried)
    if fine.tendon_names and fine.backbone.rigid:
        raise InputError(
            f"diagnose: {fine.name} is a rigid sheath of {len(fine.tendons)} tendons, which act by "
            "themselves; diagnose each with a robot file of its own"
        )
    warnings: list[str] = []
    for k, r in enumerate(recordings):
        if (r.T_tip is None) != (recordings[0].T_tip is None):
            lacks, has = (r, recordings[0]) if r.T_tip is None else (recordings[0], r)
            raise InputError(
                f"{lacks.path}: no tip tension, which {has.path} has; map it with --columns "
                "'T_tip=NAME[N]', or diagnose each by itself"
            )
        check_columns(r, fine)
        same = fine.tendons
        fine, config, more = driven_as_recorded(fine, config, r)
        warnings += more
        if k and fine.tendons is not same and [t.drive for t in fine.tendons] != [t.drive for t in same]:
            raise InputError(
                f"{r.path}: displacement drives a tendon that tension drives in {recordings[0].path}; "
                "diagnose each by itself"
            )
    channels = channels_of(channels, recordings, [fine] * len(recordings))
    if channels is None and not (fine.space or fine.tendon_names):
        channels = (*CHANNELS, *(marker.name for marker in fine.markers))
    names = names_of(recordings)
    parts: list[Observation] = []
    for name, r in zip(names, recordings, strict=True):
        part, more = part_of(name, fine, config, r, channels, noise_N=noise_N, noise_base_N=noise_base_N)
        parts.append(part)
        warnings += more
    out = {part.name: list((leave_out or {}).get(part.name, ())) for part in parts}
    parts = [without(part, out[part.name]) for part in explained_first(parts)]
    check_noise(noise_N, parts)
    found = [fault for part in parts for fault in faults(part)]
    if found:
        return Diagnosis.without_answer(BAD_DATA, found, parts, warnings, config)
    coarse = build_robot(config, resolution=resolution_of(fine)) if config else fine
    finest = build_robot(config, resolution=FINEST) if config else fine
    deviations = deviations_of(config, fine)
    dimensions = dimensions_of(config, fine)
    several = len(parts) > 1
    long = _long(parts)
    instruments, heavy = (instrument_numbers(parts[0]), HEAVY) if long else ((), None)
    free = [*(d.name for d in dimensions), *(names_to_split(fine, dimensions) if several else [])]

    def fitted(
        parts: list[Observation],
        start: np.ndarray | None,
        numbers: tuple[Number, ...] = (*base_numbers(fine, deviations), *instruments),
        dimensions: Sequence[Number] = dimensions,
    ) -> _Start | None:
        """The likelihood of the recordings, and the base model fitted to them; None if that fails."""
        full = [part if part.samples <= MANY else part.only(some_samples(part, MANY)) for part in parts]
        kept = [some_samples(part, FEW_OF_SEVERAL if several else FEW) for part in full]
        small = [p if len(k) == p.samples else p.only(k) for p, k in zip(full, kept, strict=True)]
        rigs = [SimulatedRig(p, coarse, free, cache) for p in small]
        likelihood = Likelihood(
            rigs=tuple(rigs), base=numbers, dimensions=tuple(dimensions), heavy=heavy, untried=untried
        )
        rough = base_fit(likelihood, start)
        if rough is None:
            return None
        likelihood, base = rough
        exact = [SimulatedRig(p, finest, free, cache) for p in full]
        found = base_fit(refine(likelihood, Models(likelihood, ()), {(): base}, exact, kept), base.x)
        if found is None:
            return None
        likelihood, base = found
        return _Start(full=full, kept=kept, likelihood=likelihood, exact=exact, base=base)

    say(f"fitting {' and '.join([*friction_of(fine), *stiffness_of(fine)])}")
    start = fitted(parts, None)
    differ: list[Difference] = []
    found_outside, as_asked = list[Stretch](), parts[0]
    while start is not None and may_differ and several and len(differ) < MOST_DIFFER:
        say("testing whether one number differs between the recordings")
        found_split = differing(
            start.likelihood, start.base, fine, hypotheses_of(coarse, start.base, start.full, untried)
        )
        if found_split is None:
            break
        numbers, left, at, difference = found_split
        again = fitted(parts, at, numbers, left)
        if again is None:
            break
        start, differ = again, [*differ, difference]
    for _ in range(LOOKS if long else 0):
        more = [] if start is None else _from_outside(as_asked, start)
        if start is None or not more:
            break
        say("leaving out where the tip moves in a way that the base cannot have caused, and after gaps")
        without_them = [without(as_asked, [*out[as_asked.name], *more])]
        again = fitted(without_them, start.base.x)
        if again is None:
            break
        parts, start, found_outside = without_them, again, more
    out = {name: [*known, *found_outside] for name, known in out.items()}
    if start is not None:
        sharper = _sharpened(start, [recorded(r, fine)[0] for r in recordings])
        if sharper is not None:
            say("fitting again, with the corners of the base tension placed by the tip")
            again = fitted(sharper, start.base.x, start.likelihood.base, start.likelihood.dimensions)
            start = start if again is None else _better(start, again)
    if start is None:
        return Diagnosis.without_answer(
            BAD_DATA, ["the simulation fails at every start value tried"], parts, warnings, config
        )
    full, kept, likelihood, exact, base = start
    own = {n.parameter for n in base.numbers}
    hypotheses = [
        h
        for h in hypotheses_of(coarse, base, full, untried)
        if not own & {*h.fixed, *(n.name for n in h.numbers)}
    ]
    return Prepared(
        config=config,
        fine=fine,
        parts=parts,
        full=full,
        kept=kept,
        warnings=warnings,
        likelihood=likelihood,
        rough=[SimulatedRig(p, coarse, free, cache) for p in full],
        exact=exact,
        base=base,
        hypotheses=hypotheses,
        differ=differ,
        leave_out=out,
    )


def _from_outside(part: Observation, start: _Start) -> list[Stretch]:
    """What of a long recording no model of its load history can know, by the base model fitted to it: where
    something from outside moves the tip, and after gaps.
    """
    rig, robot, thinned = start.exact[0], part.robot, start.full[0]
    if part.tips != 1 or part.others or robot.tendons[0].drive != "tension":
        return []
    values = dict(start.base.values) | dict(start.base.dimensions)
    seen = rig(values)
    slope = change_by(rig, values, 0)
    if seen is None or slope is None:
        return []
    delay = values.get(SCANNED, 0.0)
    found = [*disturbances(part, thinned, seen, slope[0], delay), *behind_gaps(part, thinned, seen)]
    return within(found, part.samples)


def _long(parts: Sequence[Observation]) -> bool:
    """Whether a recording is long enough to show what its instruments add, and what happens once; several
    recordings share no drift, and need not share a delay.
    """
    return len(parts) == 1 and parts[0].time is not None and parts[0].samples >= LONG


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """Names of recordings, each once."""
    return distinct([r.path.stem for r in recordings])


class _Start(NamedTuple):
    """The recordings: all their samples, those in the likelihood, the likelihood, all on a fine mesh, and the
    base model fitted.
    """

    full: list[Observation]
    kept: list[np.ndarray]
    likelihood: Likelihood
    exact: list[SimulatedRig]
    base: Fitted


def _better(before: _Start, after: _Start) -> _Start:
    """The start with added corners of the base tension if these reduce the misfit enough at the same noise;
    else the start before.
    """
    likelihood, values = after.likelihood, after.base.values
    seen = likelihood.simulate(values)
    if seen is None:
        return before
    likewise = dataclasses.replace(
        likelihood.weighed(values, seen, before.likelihood.noise), heavy=before.likelihood.heavy
    )
    squares = float(np.sum(likewise.rows(seen) ** 2))
    sizes = [sum(rig.part.T_base.size for rig in s.likelihood.rigs) for s in (before, after)]
    if before.base.chi2 - squares <= BEND * max(sizes[1] - sizes[0], 1):
        return before
    return after._replace(likelihood=likelihood.weighed(values, seen, likelihood.noise))


def _sharpened(start: _Start, readings: Sequence[np.ndarray]) -> list[Observation] | None:
    """The recordings with corners of the base tension where all channels together put them: a noisy base
    cell alone misses small steps and turns that the tip follows. None where the cell determines it better.

    Args:
        start: the base model fitted.
        readings: base tension of each recording as recorded [N], (K,).
    """
    found, changed = [], False
    values = dict(start.base.values) | dict(start.base.dimensions)
    for part, rig, noise, read in zip(start.full, start.exact, start.likelihood.noise, readings, strict=True):
        base, here = part.T_base, rig(values)
        found.append(part)
        if base.sd == 0 or here is None or part.samples != len(read) or part.others:
            continue
        weigh = passing(rig, here, noise, values)
        own = (weigh.last == np.arange(part.samples)) * weigh.slope * weigh.weight**2
        from_channels, residual = (
            np.sum(own * weigh.slope, axis=0),
            weigh.centred(here.values[rig.where] - part.recorded),
        )
        cell = base.sd**-2
        if np.median(from_channels) < cell:
            continue
        shift = (cell * (read - base.T_base) - np.sum(own * residual, axis=0)) / (from_channels + cell)
        informed = from_channels > cell
        sd = float(np.sqrt(np.mean(1 / (from_channels + cell)[informed])))
        sharper = sharpened(base, read, base.T_base + np.where(informed, shift, 0.0), sd)
        changed = changed or sharper is not base
        found[-1] = dataclasses.replace(part, T_base=sharper)
    return found if changed else None


def deviations_of(config: RobotConfig | None, robot: Robot) -> dict[str, float]:
    """Standard deviations of the logarithms of friction and stiffness that the robot file states, by name."""
    if config is None:
        return {}
    found = {}
    for name in (*friction_of(robot), *stiffness_of(robot)):
        sd = config.deviation(parameter(robot, name).key)
        if sd:
            found[name] = float(np.log1p(sd / abs(float(robot.value(name)))))
    return found


def _check_names(robot: Robot, untried: Sequence[str]) -> None:
    """InputError if a name among the terms that are not tried belongs to no term."""
    for name in untried:
        if name not in robot.catalogue:
            near = ", ".join(nearest_first(excerpt(name), robot.catalogue)[:NEAREST])
            raise InputError(f"without: no term '{excerpt(name)}'; the nearest are {near}")


def hypotheses_of(
    robot: Robot, base: Fitted, parts: Sequence[Observation], untried: Sequence[str] = ()
) -> list[Hypothesis]:
    """What may be missing in these recordings, given a fit of the base model, but for terms left out."""
    axes = [f"tip_{axis}" for axis in ("xyz" if robot.space else "y")]
    travel = np.concatenate(
        [
            seen.values[[instruments(robot, part.channels).index(name) for name in axes]].T
            for seen, part in zip(base.seen, parts, strict=True)
        ]
    )
    if robot.space:
        travel = (travel - np.asarray(robot.base.position)) @ np.asarray(robot.base.rotation)
    return catalogue(
        robot,
        timed=all(p.time is not None for p in parts),
        largest_tip=max((float(np.max(p.recorded[: p.tips])) for p in parts if p.tips), default=0.0),
        travel=travel if robot.space else np.asarray([travel.min(), travel.max()]),
        bend=_bend(robot, base, parts[0]),
        displaced=any(tendon.drive == "displacement" for tendon in robot.tendons)
        or any(quantity_of(name) in DRAWN for p in parts for name in p.channels),
        cells=cells_of(parts),
        without=untried,
    )


def _bend(robot: Robot, fitted: Fitted, part: Observation) -> float:
    """Largest curvature that the tendons give the body [1/m], by the base model."""
    values = values_in(fitted.values, part.name)
    own = {name: values[name] for name in (*friction_of(robot), *stiffness_of(robot)) if name in values}
    robot = robot.with_values(**own)
    structure = structure_with(robot, program_for(robot, ()))
    if not (part.others or robot.space):
        top = np.asarray([0.0, float(part.T_base.T_base.max())])
        loads = loads_of(jnp.asarray(top), jnp.arange(2.0), None)
        return float(steps_natively(robot, structure, loads).bent[-1])
    history = padded_history(
        part.drive, part.time, part.trial, drawn=tuple(t.drive == "displacement" for t in robot.tendons)
    )
    loads = loads_of(history.T_base, history.time, history.cycle)
    bent = steps_natively(robot, structure, loads, drawn=history.displacement).bent
    return float(np.nanmax(bent))
