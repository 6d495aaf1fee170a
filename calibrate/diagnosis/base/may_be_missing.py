"""What may be missing in recordings, given a fit of the base model."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis, catalogue
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.inference.channels import quantity_of
from calibrate.inference.instruments import cells_of, instruments
from calibrate.inference.load_history import padded_history
from calibrate.inference.number import values_in
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import friction_of, program_for
from gtr_jax import Robot
from gtr_jax.robot.stiffness import stiffness_of
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_with

# Quantities in which a stretch of the tendon ahead of the channel is seen.
DRAWN = ("displacement", "T_base")


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
