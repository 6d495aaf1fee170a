"""What a diagnosis starts from: recordings loaded, the base model fitted, and what may be missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.outside.leave_out import Stretch, without
from calibrate.diagnosis.outside.sanity import faults
from calibrate.diagnosis.search.differ import Difference
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import SimulatedRig, friction_of
from calibrate.inference.simulation_cache import SimulationCache
from gtr_jax import Recording, Robot, RobotConfig
from gtr_jax.robot.stiffness import stiffness_of

from .fit import BaseFits
from .load import load
from .mask import mask
from .may_be_missing import hypotheses_of
from .sharpen import sharpen
from .split import split


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """What the search starts from.

    Attributes:
        config: the robot file, or None.
        fine: the robot on its own mesh.
        parts, full: the recordings, and those samples of them that are used.
        kept: indices of the samples that hypotheses are tried on.
        warnings: what the reader must know.
        likelihood: of few samples on a coarse mesh.
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


class Undiagnosable(NamedTuple):
    """Recordings that cannot be diagnosed, why, and what the reader must know besides."""

    faults: list[str]
    parts: list[Observation]
    warnings: list[str]
    config: RobotConfig | None


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
) -> Prepared | Undiagnosable:
    """Read the recordings, fit the base model, ask whether a number differs between them, and list what may
    be missing; arguments as of `diagnose`.

    Args:
        may_differ: whether numbers that differ are looked for.
        leave_out: what is simulated and not compared, by name of the recording; of a long recording, what
            happens to it from outside comes to that.
        untried: names of terms that are not tried.

    Returns:
        What the search starts from; why not, where the data do not allow a diagnosis.
    """
    loaded = load(robot, recording, channels, noise_N, noise_base_N, leave_out=leave_out, untried=untried)
    parts, out, warnings, config = loaded.parts, loaded.leave_out, loaded.warnings, loaded.config
    found = [fault for part in parts for fault in faults(part)]
    if found:
        return Undiagnosable(found, parts, warnings, config)
    fits = BaseFits(loaded, cache, untried)
    say(f"fitting {' and '.join([*friction_of(fits.robot), *stiffness_of(fits.robot)])}")
    start = fits.fit(parts, None)
    start, differ = split(fits, parts, start, say) if may_differ else (start, [])
    parts, start, outside = mask(fits, parts, out[parts[0].name], start, say)
    if start is None:
        return Undiagnosable(["the simulation fails at every start value tried"], parts, warnings, config)
    start = sharpen(fits, start, loaded.recordings, say)
    own = {n.parameter for n in start.base.numbers}
    hypotheses = [
        h
        for h in hypotheses_of(fits.coarse, start.base, start.full, untried)
        if not own & {*h.fixed, *(n.name for n in h.numbers)}
    ]
    return Prepared(
        config=config,
        fine=fits.robot,
        parts=parts,
        full=start.full,
        kept=start.kept,
        warnings=warnings,
        likelihood=start.likelihood,
        rough=fits.on_the_coarse_mesh(start.full),
        exact=start.exact,
        base=start.base,
        hypotheses=hypotheses,
        differ=differ,
        leave_out={name: [*known, *outside] for name, known in out.items()},
    )
