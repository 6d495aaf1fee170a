"""A simulation's answer: what is read off the run, in JSON, in words and in pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from gtr_jax import plots
from gtr_jax.equilibrium import Equilibrium, equilibrium
from gtr_jax.forces import channel_forces
from gtr_jax.history import Simulation, simulate
from gtr_jax.phases import RELEASING, TRANSITION, Switch, label_phases, release_switch
from gtr_jax.plots.style import number
from gtr_jax.robot import Robot

from .page import Figure, Report, Table


@dataclass(frozen=True)
class SimulationAnswer:
    """Everything that the outputs of `gtr simulate` are made of.

    Attributes:
        robot, run: as simulated.
        frictionless: the same history without friction.
        phases: label of each step, (K,).
        switch: where the transition after a pull to the largest base tension ends.
        rest, loaded, last: equilibria with a slack tendon, at the largest base tension, and at the end.
    """

    robot: Robot
    run: Simulation
    frictionless: Simulation
    phases: np.ndarray
    switch: Switch
    rest: Equilibrium
    loaded: Equilibrium
    last: Equilibrium

    @property
    def top(self) -> int:
        """Step of the largest base tension."""
        return int(jnp.argmax(self.run.T_base))

    @property
    def released(self) -> bool:
        """Whether the history goes back from its largest base tension as far as the switch."""
        return float(jnp.min(self.run.T_base[self.top :])) <= float(self.switch.T_base)

    @property
    def flagged(self) -> np.ndarray:
        """Steps that did not converge."""
        return np.flatnonzero(~np.asarray(self.run.converged))

    @property
    def converged(self) -> bool:
        """Whether everything reported converged."""
        others = (self.switch.converged, self.rest.converged, self.loaded.converged, self.last.converged)
        return not len(self.flagged) and all(bool(ok) for ok in others)


def answer_simulation(robot: Robot, T_base: np.ndarray) -> SimulationAnswer:
    """Simulate a history and all that is shown beside it.

    Args:
        robot: from `load_robot`.
        T_base: base tension at each step [N], (K,).
    """
    run = simulate(robot, jnp.asarray(T_base))
    preload = jnp.broadcast_to(robot.tendon.preload, run.s.shape)

    def state_at(step: int) -> Equilibrium:
        memory = run.tension[step - 1] if step else preload
        return equilibrium(robot, run.T_base[step], memory=memory)

    return SimulationAnswer(
        robot=robot,
        run=run,
        frictionless=simulate(robot.with_values(mu=0.0), jnp.asarray(T_base)),
        phases=label_phases(run),
        switch=_switch(robot, jnp.max(run.T_base)),
        rest=equilibrium(robot, jnp.zeros(()), memory=preload),
        loaded=state_at(int(jnp.argmax(run.T_base))),
        last=state_at(len(T_base) - 1),
    )


def _switch(robot: Robot, T_base_max: Array) -> Switch:
    if T_base_max > 0:
        return release_switch(robot, T_base_max)
    return Switch(jnp.zeros(()), jnp.zeros(()), jnp.asarray(True))  # a tendon that stays slack


def tension_loss(answer: SimulationAnswer) -> float | None:
    """Share of the largest base tension that does not reach the tip; None if the tendon was never pulled."""
    top = answer.top
    T_base = float(answer.run.T_base[top])
    return 1.0 - float(answer.run.T_tip[top]) / T_base if T_base > 0 else None


def facts(answer: SimulationAnswer) -> dict[str, Any]:
    """The answer as JSON: units in the keys, steps counted from 1 as the rows of `simulation.csv`."""
    run, top = answer.run, answer.top
    x, y, angle = run.tip_pose[top].tolist()
    return {
        "schema": 1,
        "robot": answer.robot.name,
        "verdict": verdict(answer),
        "steps": len(run.T_base),
        "T_base_max_N": float(run.T_base[top]),
        "T_tip_max_N": float(jnp.max(run.T_tip)),
        "T_base_switch_N": float(answer.switch.T_base),
        "tension_loss": tension_loss(answer),
        "at_T_base_max": {
            "step": top + 1,
            "T_tip_N": float(run.T_tip[top]),
            "tip_x_m": x,
            "tip_y_m": y,
            "tip_angle_rad": angle,
            "displacement_m": float(run.displacement[top]),
            "wrap_rad": float(answer.loaded.wrap[-1]),
        },
        "phases": {phase: _stretch(answer, phase) for phase in dict.fromkeys(answer.phases.tolist())},
        "convergence": {
            "converged": answer.converged,
            "flagged": len(answer.flagged),
            "flagged_steps": answer.flagged + 1,
            "worst_residual_norm": float(jnp.max(run.residual_norm)),
            "iterations": int(jnp.sum(run.iterations)),
            "most_iterations": int(jnp.max(run.iterations)),
        },
        "mesh": {"nodes": len(run.s), "intervals": list(answer.robot.intervals)},
    }


def _stretch(answer: SimulationAnswer, phase: str) -> dict[str, Any]:
    T_base = np.asarray(answer.run.T_base)[answer.phases == phase]
    T_tip = np.asarray(answer.run.T_tip)[answer.phases == phase]
    return {
        "steps": len(T_base),
        "T_base_N": [float(T_base.min()), float(T_base.max())],
        "T_tip_N": [float(T_tip.min()), float(T_tip.max())],
    }


def verdict(answer: SimulationAnswer) -> str:
    """The answer in one sentence."""
    run, top, name = answer.run, answer.top, answer.robot.name
    if not answer.converged:
        if len(answer.flagged):
            first = answer.flagged[0] + 1
            return (
                f"{name}: {len(answer.flagged)} of {len(run.T_base)} steps did not converge, "
                f"the first being step {first}; do not use the results from there on."
            )
        return f"{name}: the history converged, but T_base_switch or a drawn shape did not; do not use those."
    loss = tension_loss(answer)
    if loss is None:
        return f"{name}: the tendon stays slack, so nothing reaches the tip."
    text = (
        f"{name}: of {float(run.T_base[top]):.3g} N at the base, {float(run.T_tip[top]):.3g} N reach the tip "
        f"({100 * loss:.3g} % lost)"
    )
    if not {TRANSITION, RELEASING} & set(answer.phases[top:].tolist()):
        return text + "."
    switch = f"{float(answer.switch.T_base):.3g} N"
    if answer.released:
        return text + f"; on release the tip keeps its tension until the base is down to {switch}."
    return text + f"; on release the tip keeps its tension, and would until the base is down to {switch}."


def simulation_report(answer: SimulationAnswer) -> Report:
    """Verdict, figures and tables of a simulation."""
    return Report(
        title=f"{answer.robot.name}: simulation",
        verdict=verdict(answer),
        figures=_figures(answer),
        tables=_tables(answer),
    )


def _figures(answer: SimulationAnswer) -> list[Figure]:
    run, phases, robot = answer.run, answer.phases, answer.robot
    switch = (float(answer.switch.T_base), float(answer.switch.T_tip)) if answer.released else None
    loop = plots.plot_loop(
        np.asarray(run.T_base),
        np.asarray(run.T_tip),
        phases=phases,
        frictionless=np.asarray(answer.frictionless.T_tip),
        switch=switch,
    )
    if robot.backbone.rigid:
        postures = [plots.Posture("sheath", answer.loaded)]
    else:
        top, last = float(run.T_base[answer.top]), float(run.T_base[-1])
        ended = answer.top != len(run.T_base) - 1
        apart = _differ(answer.rest, answer.last)
        rest = "at rest" if apart or not ended else "at rest, and at the end"
        postures = [plots.Posture(rest, answer.rest), plots.Posture(f"at {top:.3g} N", answer.loaded)]
        if ended and apart:
            postures.append(plots.Posture(f"at the end, {last:.3g} N", answer.last))
    forces = channel_forces(answer.loaded)
    shape = plots.plot_shape(
        postures, radius=np.asarray(robot.backbone.radius(run.s)), loaded=answer.loaded, forces=forces
    )
    kinks = float(jnp.max(forces.kink_normal))
    at_kinks = f" Kinks of the channel carry up to {kinks:.2g} N besides." if kinks > 1e-9 else ""
    return [
        Figure(
            "loop",
            plots.png(loop),
            "Tension at the tip against tension at the base, coloured by phase; dashed, without friction"
            + ("; the cross marks where release reaches the tip." if switch else "."),
        ),
        Figure(
            "shape",
            plots.png(shape),
            "Midline, body and tendon. At the largest base tension, along the tendon and below against s: "
            "the normal force on the channel (blue, on the side it presses) and the friction (orange), per "
            "length of tendon." + at_kinks,
        ),
        Figure(
            "tension",
            plots.png(plots.plot_tension(run, phases)),
            "Tension along the tendon at several steps, numbered in the order of the history; dotted where "
            "the tendon is locked.",
        ),
    ]


def _differ(a: Equilibrium, b: Equilibrium) -> bool:
    apart = jnp.max(jnp.hypot(a.x - b.x, a.y - b.y))
    return bool(apart > 2e-3 * a.s[-1])


def _tables(answer: SimulationAnswer) -> list[Table]:
    data = facts(answer)
    top, convergence = data["at_T_base_max"], data["convergence"]
    loss = data["tension_loss"]
    numbers = [
        ("largest tension at the base", number(data["T_base_max_N"], "N")),
        ("tension at the tip there", number(top["T_tip_N"], "N")),
        ("lost on the way", number(None if loss is None else 100 * loss, "%")),
        ("base tension where release reaches the tip (T_base_switch)", number(data["T_base_switch_N"], "N")),
        ("wrap there", number(top["wrap_rad"], "rad")),
        ("tip there: x, y", f"{number(1e3 * top['tip_x_m'])}, {number(1e3 * top['tip_y_m'])} mm"),
        ("tip there: angle", number(float(np.degrees(top["tip_angle_rad"])), "°")),
        ("tendon drawn out there", number(1e3 * top["displacement_m"], "mm")),
    ]
    phases = [
        (phase, str(p["steps"]), _range(p["T_base_N"]), _range(p["T_tip_N"]))
        for phase, p in data["phases"].items()
    ]
    solver = [
        ("steps", f"{data['steps']}, of which {convergence['flagged']} did not converge"),
        ("worst residual (relative)", number(convergence["worst_residual_norm"], digits=2)),
        ("iterations", f"{convergence['iterations']}, at most {convergence['most_iterations']} in a step"),
        ("mesh nodes", str(data["mesh"]["nodes"])),
    ]
    return [
        Table("At the largest base tension", ("", ""), numbers),
        Table("Phases", ("phase", "steps", "base [N]", "tip [N]"), phases),
        Table("Solver", ("", ""), solver),
    ]


def _range(ends: list[float]) -> str:
    return f"{number(ends[0], digits=3)} … {number(ends[1], digits=3)}"
