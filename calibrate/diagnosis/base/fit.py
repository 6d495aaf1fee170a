"""Fit: the base model fitted to the recordings, on few samples and a coarse mesh that is corrected to a fine
one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.evidence.refine import refine
from calibrate.diagnosis.hypotheses.hypotheses import base_numbers, instrument_numbers
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.follow import dimensions_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.likelihood.recording_length import rules_for
from calibrate.diagnosis.search.differ import names_to_split
from calibrate.diagnosis.search.search import base_fit
from calibrate.inference.number import Number
from calibrate.inference.samples import some_samples
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import SimulatedRig, friction_of, resolution_of
from calibrate.inference.simulation_cache import SimulationCache
from gtr_jax import Robot, RobotConfig, build_robot
from gtr_jax.robot.parameters import parameter
from gtr_jax.robot.stiffness import stiffness_of

from .load import Loaded

# Samples of each recording on which hypotheses are tried, and on which the best are refitted.
FEW, MANY = 140, 2400
# Samples of each recording on which hypotheses are tried where there are several: together they hold more
# information.
FEW_OF_SEVERAL = 96
# Resolution of the mesh that the best models are corrected to, relative to the robot's own.
FINEST = 1.5


class Start(NamedTuple):
    """Recordings with the base model fitted to them.

    Attributes:
        full: all samples of the recordings that are used.
        kept: indices of those that hypotheses are tried on.
        likelihood: of these.
        exact: all samples on a fine mesh.
        base: fit of the base model.
    """

    full: list[Observation]
    kept: list[np.ndarray]
    likelihood: Likelihood
    exact: list[SimulatedRig]
    base: Fitted


class BaseFits:
    """Fits of the base model to recordings of a robot, and to what is left of them.

    Args:
        loaded: the recordings and the robot.
        cache: of finished simulations.
        untried: names of terms that are not tried.

    Attributes:
        robot, coarse: the robot on its own mesh, and on a coarse one.
        rules: what differs where a recording is long.
        several: whether there are several recordings.
    """

    def __init__(self, loaded: Loaded, cache: SimulationCache | None, untried: Sequence[str]):
        config, self.robot, parts = loaded.config, loaded.robot, loaded.parts
        self.cache, self.untried = cache, untried
        self.coarse = build_robot(config, resolution=resolution_of(self.robot)) if config else self.robot
        self.finest = build_robot(config, resolution=FINEST) if config else self.robot
        deviations = deviations_of(config, self.robot)
        self.dimensions = dimensions_of(config, self.robot)
        self.several, self.rules = len(parts) > 1, rules_for(parts)
        instruments = instrument_numbers(parts[0]) if self.rules.fits_instruments else ()
        self.numbers = (*base_numbers(self.robot, deviations), *instruments)
        split = names_to_split(self.robot, self.dimensions) if self.several else []
        self.free = [*(d.name for d in self.dimensions), *split]

    def fit(
        self,
        parts: list[Observation],
        start: np.ndarray | None,
        numbers: tuple[Number, ...] | None = None,
        dimensions: Sequence[Number] | None = None,
    ) -> Start | None:
        """The base model fitted to recordings; None if that fails.

        Args:
            parts: the recordings.
            start: coordinates to begin from; several are tried unless given.
            numbers, dimensions: of the base model, and those that follow it; as of the robot unless given.
        """
        full = [part if part.samples <= MANY else part.only(some_samples(part, MANY)) for part in parts]
        kept = [some_samples(part, FEW_OF_SEVERAL if self.several else FEW) for part in full]
        small = [p if len(k) == p.samples else p.only(k) for p, k in zip(full, kept, strict=True)]
        likelihood = Likelihood(
            rigs=tuple(self.on_the_coarse_mesh(small)),
            base=self.numbers if numbers is None else numbers,
            dimensions=tuple(self.dimensions if dimensions is None else dimensions),
            rules=self.rules,
            untried=self.untried,
        )
        rough = base_fit(likelihood, start)
        if rough is None:
            return None
        likelihood, base = rough
        exact = [SimulatedRig(p, self.finest, self.free, self.cache) for p in full]
        found = base_fit(refine(likelihood, Models(likelihood, ()), {(): base}, exact, kept), base.x)
        if found is None:
            return None
        likelihood, base = found
        return Start(full=full, kept=kept, likelihood=likelihood, exact=exact, base=base)

    def on_the_coarse_mesh(self, parts: Sequence[Observation]) -> list[SimulatedRig]:
        """Recordings to be simulated on the coarse mesh."""
        return [SimulatedRig(part, self.coarse, self.free, self.cache) for part in parts]


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
