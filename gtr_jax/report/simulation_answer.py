"""What a simulation found: the run, and what is shown beside it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jax import Array

from gtr_jax.robot.clearance import distances
from gtr_jax.robot.overlap import Impossible, impossible, impossible_in_space
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.robot.robot import Robot

from ..mechanics import FOREVER
from ..simulation.displacement import by_tension
from ..simulation.equilibrium import equilibrium
from ..simulation.history import Simulation, equilibrium_at, simulate
from ..simulation.phases import label_phases
from ..simulation.programs import terms_act
from ..simulation.release import Switch, release_switch
from ..simulation.sensing import cells_differ
from ..simulation.solution import Equilibrium

LONG = 2000  # steps of a history beyond which a run of it costs more than to compile an equilibrium


@dataclass(frozen=True)
class SimulationAnswer:
    """Everything that the outputs of `gtr simulate` are made of.

    Attributes:
        robot, run: as simulated.
        frictionless: the same history of base tensions without friction.
        phases: label of each step, (K,).
        switch: where the transition after a pull to the largest base tension ends; None of several tendons,
            and with physics terms.
        rest, loaded, last: equilibria with slack tendons, at the largest base tension, and at the end.
        top: step of the largest base tension.
        impossible: what of it no body does.
        tendon: name of the tendon, if this is the part of one of several (`of_tendon`).
    """

    robot: Robot
    run: Simulation
    frictionless: Simulation
    phases: np.ndarray
    switch: Switch | None
    rest: Equilibrium
    loaded: Equilibrium
    last: Equilibrium
    top: int
    impossible: Impossible
    tendon: str = ""

    @property
    def several(self) -> bool:
        """Whether it is the answer of several tendons together."""
        return self.run.T_base.ndim == 2

    def of_tendon(self, index: int) -> SimulationAnswer:
        """The part of one of several tendons."""
        parts = {name: getattr(self, name).of_tendon(index) for name in ("run", "frictionless")}
        parts |= {name: getattr(self, name).of_tendon(index) for name in ("rest", "loaded", "last")}
        name = self.robot.tendon_names[index]
        return dataclasses.replace(self, **parts, phases=self.phases[:, index], tendon=name)

    @property
    def released(self) -> bool:
        """Whether the history goes back from its largest base tension as far as the switch."""
        if self.switch is None:
            return False
        return float(jnp.min(self.run.T_base[self.top :])) <= float(self.switch.T_base)

    @property
    def warnings(self) -> list[str]:
        """What the reader must know before using the numbers."""
        said = list(self.impossible.says)
        if self.robot.space:
            said += [pair.says for pair in distances(self.robot) if pair.says]
        if cells_differ(self.robot):
            said.append(
                "A physics term of the load cells acts: simulation.csv holds what they show as T_base_N and "
                "T_tip_N, and the true tensions as T_base_true_N and T_tip_true_N. Text, pictures and "
                "tables are of the true ones, except where they say shown."
            )
        return said

    @property
    def flagged(self) -> np.ndarray:
        """Steps that did not converge."""
        return np.flatnonzero(~np.asarray(self.run.converged))

    @property
    def converged(self) -> bool:
        """Whether everything reported converged."""
        others = [self.rest.converged, self.loaded.converged, self.last.converged]
        others += [self.switch.converged] if self.switch else []
        return not len(self.flagged) and all(bool(ok) for ok in others)


def answer_simulation(
    robot: Robot,
    T_base: np.ndarray,
    time: np.ndarray | None = None,
    cycle: np.ndarray | None = None,
    displacement: np.ndarray | None = None,
) -> SimulationAnswer:
    """Simulate a history and all that is shown beside it.

    Args:
        robot: from `load_robot`.
        T_base: base tension at each step [N], (K, *tendons).
        time, cycle: as for `simulate`, (K,).
        displacement: as for `simulate`, (K, *tendons).
    """
    run = simulate(robot, T_base, time=time, cycle=cycle, displacement=displacement)
    pulled = by_tension(robot)
    pull = run.T_base if run.T_base.ndim == 1 else jnp.max(run.T_base, axis=1)
    top = int(jnp.argmax(pull))
    slippery = {p.name: 0.0 for p in parameters_of(robot).values() if p.name.partition(".")[0] == "mu"}
    return SimulationAnswer(
        robot=robot,
        run=run,
        frictionless=simulate(pulled.with_values(**slippery), run.T_base, time=time, cycle=cycle),
        phases=label_phases(run),
        switch=None
        if robot.tendon_names or terms_act(robot) or displacement is not None
        else _switch(robot, jnp.max(run.T_base)),
        rest=_at_rest(pulled, run.T_base, time),
        loaded=equilibrium_at(pulled, run, jnp.asarray(top)),
        last=equilibrium_at(pulled, run, jnp.asarray(len(run.T_base) - 1)),
        top=top,
        impossible=_impossible(robot, run),
    )


def _at_rest(robot: Robot, T_base: Array, time: np.ndarray | None) -> Equilibrium:
    """The robot with its tendons slack and at rest. By the program that runs the history, unless that is
    long: one of its own would have to be compiled, which takes seconds in space.
    """
    K = max(len(T_base), 2)
    if K > LONG:
        return equilibrium(robot, jnp.zeros_like(T_base[0]))
    # The first step lasts until all creep has ended.
    ends = None if time is None else np.append(0.0, np.full(K - 1, FOREVER))
    slack = simulate(robot, jnp.zeros((K, *T_base.shape[1:])), time=ends)
    return equilibrium_at(robot, slack, jnp.asarray(0))


def _impossible(robot: Robot, run: Simulation) -> Impossible:
    if run.shape is None:
        return impossible(robot.backbone, run.s, curvature=run.curvature, angle=run.angle, T_base=run.T_base)
    shape = run.shape
    return impossible_in_space(
        robot.backbone,
        run.s,
        strain=shape.strain,
        position=shape.position,
        T_base=run.T_base,
        stretch=shape.stretch,
    )


def _switch(robot: Robot, T_base_max: Array) -> Switch:
    if T_base_max > 0:
        return release_switch(robot, T_base_max)
    return Switch(jnp.zeros(()), jnp.zeros(()), jnp.asarray(True))  # a tendon that stays slack
