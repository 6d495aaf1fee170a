"""pyelastica's Cosserat rod, damped until it rests; prints JSON.

pyelastica steps a dynamic rod in time. What is done to let it rest soon, close to the rod of the problem:

- The tendon pulls the anchor with T against the tangent, presses its channel with T times the curvature along
  the normal, and its anchor sits at the lever R. The first two leave the rod in pure compression T, which an
  inextensible rod does not feel; the lever leaves the couple T R at the tip. So the couple alone acts, except
  in the run that is named after the full load.
- Stretch and shear are softened by a factor, because their waves limit the time step; rest then differs from
  the problem's by about the softened strain, which is why the factor falls as the accuracy rises.
- The rotary inertia of the elements is raised until their rotation is as slow as their stretch; at rest
  nothing of it is left.
- The clamped element is centred at the base: pyelastica holds a whole element, a first-order error if it
  lies in front of the base.
- The damping is near critical for the slowest mode of the straight rod.
"""
# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
import time
from typing import Any

_START = time.perf_counter()

import elastica  # noqa: E402
import numpy as np  # noqa: E402

from .answer import answer  # noqa: E402
from .problem import (  # noqa: E402
    BENDING_STIFFNESS,
    LENGTH,
    LOADED,
    OFFSET,
    PLANAR,
    RADIUS,
    TENDON,
    TENSION,
    YOUNGS_MODULUS,
    Problem,
    error,
)

IMPORT_S = time.perf_counter() - _START
DENSITY = 1000.0  # kg/m^3; scales time, not the number of steps
AREA = math.pi * RADIUS**2
SLOWEST = 3.516 / LENGTH**2 * math.sqrt(BENDING_STIFFNESS / DENSITY / AREA)  # rad/s, straight rod
COURANT = 0.6  # of the softened stretch wave; 0.9 was unstable
CHECK_EVERY = 50  # steps between looks at the speeds
DEADLINE_S = 60.0

# elements, softening of stretch and shear, damping over critical, speed that counts as rest
SETTINGS = {
    TENDON: (
        (8, 1000.0, 0.7, 1e-4),
        (12, 1000.0, 0.7, 1e-4),
        (14, 1000.0, 0.7, 1e-4),
        (16, 1000.0, 0.7, 1e-4),
        (24, 400.0, 0.7, 1e-5),
        (40, 200.0, 0.7, 1e-5),
        (48, 100.0, 0.7, 1e-5),
        (100, 25.0, 0.7, 1e-6),
    ),
    LOADED: (
        (16, 400.0, 0.7, 1e-4),
        (16, 100.0, 0.7, 1e-4),
        (24, 200.0, 0.7, 1e-4),
        (24, 100.0, 0.7, 1e-4),
        (40, 20.0, 0.7, 1e-5),
        (56, 10.0, 0.7, 1e-5),
        (64, 10.0, 0.7, 1e-5),
        (100, 4.0, 0.7, 1e-6),
    ),
}


class _Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping): ...


class _TipCouple(elastica.NoForces):
    """A couple about +z on the last element."""

    def __init__(self, couple: float):
        super().__init__()
        self.couple = np.array([0.0, 0.0, couple])

    def apply_torques(self, system, time=0.0):
        system.external_torques[..., -1] += system.director_collection[..., -1] @ self.couple


class _ChannelAndAnchor(elastica.NoForces):
    """What a tensioned tendon of a parallel channel presses on the rod, besides the couple."""

    def __init__(self, tension: float):
        super().__init__()
        self.tension = tension

    def apply_forces(self, system, time=0.0):
        pull = self.tension * system.tangents
        system.external_forces[:, :-1] += pull
        system.external_forces[:, 1:] -= pull


def rest(
    problem: Problem,
    elements: int,
    softening: float,
    damping: float,
    speed: float,
    *,
    full_load: bool = False,
    deadline_s: float = DEADLINE_S,
) -> tuple[np.ndarray, bool, int, float]:
    """Tip at rest, whether it rests, steps taken, seconds stepped.

    Args:
        problem: the problem.
        elements: of the rod.
        softening: divides the stiffness against stretch and shear.
        damping: over the critical one of the slowest mode.
        speed: that counts as rest, over the length times the slowest frequency.
        full_load: with the compression that the tendon leaves in the rod.
        deadline_s: gives up after; 0 for a few steps, which compile.
    """
    size = LENGTH / (elements - 0.5)
    rod = elastica.CosseratRod.straight_rod(
        elements,
        start=np.array([-size / 2, 0.0, 0.0]),
        direction=np.array([1.0, 0.0, 0.0]),
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=LENGTH + size / 2,
        base_radius=RADIUS,
        density=DENSITY,
        youngs_modulus=YOUNGS_MODULUS,
        shear_modulus=YOUNGS_MODULUS / 2.6,
    )
    rod.shear_matrix /= softening
    heavier = max(0.33 * (size / RADIUS) ** 2, softening)
    rod.mass_second_moment_of_inertia *= heavier
    rod.inv_mass_second_moment_of_inertia /= heavier
    step = np.float64(COURANT * size / math.sqrt(YOUNGS_MODULUS / DENSITY / softening))

    simulator = _Simulator()
    simulator.append(rod)
    simulator.constrain(rod).using(
        elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    simulator.add_forcing_to(rod).using(_TipCouple, TENSION * OFFSET)
    if full_load:
        simulator.add_forcing_to(rod).using(_ChannelAndAnchor, TENSION)
    if problem.loaded:
        simulator.add_forcing_to(rod).using(
            elastica.EndpointForces, np.zeros(3), np.array([*problem.tip_force, 0.0]), ramp_up_time=step
        )
    simulator.dampen(rod).using(
        elastica.AnalyticalLinearDamper, uniform_damping_constant=2 * SLOWEST * damping, time_step=step
    )
    simulator.finalize()

    stepper, now, steps = elastica.PositionVerlet(), np.float64(0.0), 0
    start = time.perf_counter()
    while True:
        for _ in range(CHECK_EVERY):
            now = stepper.step(simulator, now, step)
        steps += CHECK_EVERY
        fastest = np.max(np.abs(rod.velocity_collection))
        resting = bool(fastest < speed * LENGTH * SLOWEST)
        if resting or not np.isfinite(fastest) or time.perf_counter() - start > deadline_s:
            break
    return rod.position_collection[:2, -1].copy(), resting, steps, time.perf_counter() - start


def run(quick: bool) -> dict[str, Any]:
    """Compile, then every setting."""
    start = time.perf_counter()
    rest(LOADED, 4, 1.0, 1.0, 1e-3, full_load=True, deadline_s=0.0)
    cold = time.perf_counter() - start
    points = []

    def enter(problem: Problem, setting, **options):
        elements, softening = setting[:2]
        tip, resting, steps, took = rest(problem, *setting, **options)
        points.append(
            {
                "problem": problem.name,
                "setting": f"{elements} elements, stretch softened {softening:g} times"
                if not options
                else f"{elements} elements, stretch as it is, full load of the tendon",
                "steps": steps,
                "error": error(problem, tip),
                "converged": resting,
                "warm_s": took,
                "cold_s": cold + IMPORT_S,
            }
        )

    for problem in PLANAR:
        for setting in SETTINGS[problem][:: 3 if quick else 1]:
            enter(problem, setting)
    if not quick:
        enter(TENDON, (16, 1.0, 0.7, 1e-4), full_load=True)
    return {"points": points, "batches": []}


if __name__ == "__main__":
    answer(run, ("pyelastica", "numba", "numpy"))
