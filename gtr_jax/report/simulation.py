"""A simulation's answer: what is read off the run, in JSON, in words and in pictures."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from gtr_jax.numbers import number
from gtr_jax.plots.loop import plot_loop
from gtr_jax.plots.shape import Posture, Pressed, plot_shape
from gtr_jax.plots.straight import notches_of
from gtr_jax.plots.tendons import plot_tendons
from gtr_jax.plots.tension import plot_tension
from gtr_jax.recordings.formats.quantities import AXES
from gtr_jax.robot.clearance import distances

from ..simulation.forces import channel_forces
from ..simulation.phases import RELEASING, TRANSITION
from ..simulation.sensing import cells_differ
from ..simulation.solution import Equilibrium
from . import spatial
from .page import Figure, Report, Table
from .simulation_answer import SimulationAnswer
from .simulation_playback import simulation_playback

APART = 2e-3  # of the length, by which two shapes must differ for both to be drawn


def tension_loss(answer: SimulationAnswer) -> float | None:
    """Share of the largest base tension that does not reach the tip; None if the tendon was never pulled."""
    top = answer.top
    T_base = float(answer.run.T_base[top])
    return 1.0 - float(answer.run.T_tip[top]) / T_base if T_base > 0 else None


def facts(answer: SimulationAnswer) -> dict[str, Any]:
    """The answer as JSON: units in the keys, steps counted from 1 as the rows of `simulation.csv`."""
    run = answer.run
    own = _several_facts(answer) if answer.several else _tendon_facts(answer)
    return {
        "schema": 1,
        "robot": answer.robot.name,
        "verdict": verdict(answer),
        "warnings": answer.warnings,
        "body": {
            "overlaps_itself": answer.impossible.overlaps,
            "overlap_step": None if (at := answer.impossible.overlap_step) is None else at + 1,
            "largest_wall_strain": answer.impossible.strain,
        },
        **({"channels": _distances(answer)} if answer.robot.space and answer.several else {}),
        "steps": len(run.T_base),
        **own,
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


def _distances(answer: SimulationAnswer) -> list[dict[str, Any]]:
    """How near the channels of each two tendons run to one another."""
    return [
        {"tendons": [pair.first, pair.second], "least_distance_m": pair.least, "at_s_m": pair.at}
        for pair in distances(answer.robot)
    ]


def _pose_facts(answer: SimulationAnswer) -> dict[str, Any]:
    if answer.robot.space:
        return {"step": answer.top + 1, **spatial.pose_facts(answer.run, answer.top)}
    x, y, angle = answer.run.tip_pose[answer.top].tolist()
    return {"step": answer.top + 1, "tip_x_m": x, "tip_y_m": y, "tip_angle_rad": angle}


def _tendon_facts(answer: SimulationAnswer) -> dict[str, Any]:
    run, top = answer.run, answer.top
    return {
        "T_base_max_N": float(run.T_base[top]),
        "T_tip_max_N": float(jnp.max(run.T_tip)),
        **({"T_base_switch_N": float(answer.switch.T_base)} if answer.switch else {}),
        "tension_loss": tension_loss(answer),
        "at_T_base_max": {
            **_pose_facts(answer),
            "T_tip_N": float(run.T_tip[top]),
            **_shown(answer),
            "displacement_m": float(run.displacement[top]),
            "wrap_rad": float(answer.loaded.wrap[-1]),
        },
        "phases": {phase: _stretch(answer, phase) for phase in dict.fromkeys(answer.phases.tolist())},
    }


def _shown(answer: SimulationAnswer) -> dict[str, float]:
    """What the cells show at the largest base tension, where that is not the true tension."""
    if not cells_differ(answer.robot):
        return {}
    cells = answer.run.reading
    return {
        "T_base_shown_N": float(cells.T_base[answer.top]),
        "T_tip_shown_N": float(cells.T_tip[answer.top]),
    }


def _several_facts(answer: SimulationAnswer) -> dict[str, Any]:
    tendons, phases = {}, {}
    for part in _parts(answer):
        run, top = part.run, part.top
        tendons[part.tendon] = {
            "T_base_N": float(run.T_base[top]),
            "T_tip_N": float(run.T_tip[top]),
            **_shown(part),
            "displacement_m": float(run.displacement[top]),
            "wrap_rad": float(part.loaded.wrap[-1]),
        }
        phases[part.tendon] = {name: _stretch(part, name) for name in dict.fromkeys(part.phases.tolist())}
    return {"at_T_base_max": {**_pose_facts(answer), "tendons": tendons}, "phases": phases}


def _parts(answer: SimulationAnswer) -> list[SimulationAnswer]:
    """The answer by tendons; of one tendon, itself."""
    return [answer.of_tendon(i) for i in range(len(answer.robot.tendons))] if answer.several else [answer]


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
    if answer.impossible.means_nothing:
        return f"{name}: no result. {answer.impossible.says[0]}"
    if answer.several:
        ends = ", ".join(
            f"{part.tendon} {number(float(part.run.T_base[top]), 'N', 3)} at the base and "
            f"{number(float(part.run.T_tip[top]), 'N', 3)} at the tip"
            for part in _parts(answer)
        )
        turned = number(float(np.degrees(spatial.tip_angle(answer.run)[top])), "°", 3)
        return f"{name}: at the largest base tension {ends}; the tip turns by {turned}."
    loss = tension_loss(answer)
    if loss is None:
        return f"{name}: the tendon stays slack, so nothing reaches the tip."
    text = (
        f"{name}: of {float(run.T_base[top]):.3g} N at the base, {float(run.T_tip[top]):.3g} N reach the tip "
        f"({100 * loss:.3g} % lost)"
    )
    if answer.switch is None or not {TRANSITION, RELEASING} & set(answer.phases[top:].tolist()):
        return text + "."
    switch = f"{float(answer.switch.T_base):.3g} N"
    if answer.released:
        return text + f"; on release the tip keeps its tension until the base is down to {switch}."
    return text + f"; on release the tip keeps its tension, and would until the base is down to {switch}."


def simulation_report(answer: SimulationAnswer, time: np.ndarray | None = None) -> Report:
    """Verdict, figures and tables of a simulation.

    Args:
        answer: what it found.
        time: of the steps [s], (K,), where it was given.
    """
    return Report(
        title=f"{answer.robot.name}: simulation",
        verdict=verdict(answer),
        warnings=[text for text in answer.warnings if text not in verdict(answer)],
        figures=_figures(answer),
        tables=_tables(answer),
        playbacks=[simulation_playback(answer, time)],
    )


def _figures(answer: SimulationAnswer) -> list[Figure]:
    drawn = _overview(answer) if answer.several else []
    for part in _parts(answer):
        drawn += [_loop(part)] if np.ptp(np.asarray(part.run.T_base)) > 0 else []
    drawn.append(_shape(answer))
    parts = _parts(answer)
    most = max(parts, key=lambda part: np.ptp(np.asarray(part.run.T_base)))
    pulled = (most.tendon, np.asarray(most.run.T_base))
    return [*drawn, *(_along(part, pulled) for part in parts)]


def _suffix(answer: SimulationAnswer) -> tuple[str, str]:
    """What a tendon adds to a file's name, and to a caption."""
    return (f"-{answer.tendon}", f"Tendon {answer.tendon}. ") if answer.tendon else ("", "")


def _overview(answer: SimulationAnswer) -> list[Figure]:
    run = answer.run
    T_base, T_tip, angle = np.asarray(run.T_base), np.asarray(run.T_tip), spatial.tip_angle(answer.run)
    picture = plot_tendons(T_base, T_tip, angle, answer.robot.tendon_names)
    caption = "Tension of every tendon at the tip (full) and at the base (dashed), and the angle of the tip."
    return [Figure("tendons", picture, caption)]


def _loop(answer: SimulationAnswer) -> Figure:
    run = answer.run
    at = answer.switch if answer.released else None
    switch = (float(at.T_base), float(at.T_tip)) if at else None
    loop = plot_loop(
        np.asarray(run.T_base),
        np.asarray(run.T_tip),
        phases=answer.phases,
        frictionless=np.asarray(answer.frictionless.T_tip),
        switch=switch,
    )
    ending, who = _suffix(answer)
    return Figure(
        f"loop{ending}",
        loop,
        f"{who}Tension at the tip against tension at the base, coloured by phase; dashed, without friction"
        + ("; the cross marks where release reaches the tip." if switch else "."),
    )


def _along(answer: SimulationAnswer, pulled: tuple[str, np.ndarray]) -> Figure:
    ending, who = _suffix(answer)
    return Figure(
        f"tension{ending}",
        plot_tension(answer.run, answer.phases, pulled=pulled),
        f"{who}Tension along the tendon at several steps, numbered in the order of the history; dotted where "
        "the tendon is locked.",
    )


def _shape_in_space(answer: SimulationAnswer) -> Figure:
    run, last = answer.run, len(answer.run.T_base) - 1
    top, end = (float(jnp.max(run.T_base[step])) for step in (answer.top, last))
    named = [(f"at {top:.3g} N", answer.top)]
    if last != answer.top and spatial.apart(answer.rest, answer.last) > APART:
        named.append((f"at the end, {end:.3g} N", last))
    return spatial.shape_figure(answer.robot, run, answer.rest, named)


def _shape(answer: SimulationAnswer) -> Figure:
    run, robot = answer.run, answer.robot
    if robot.space:
        return _shape_in_space(answer)
    if robot.backbone.rigid:
        postures = [Posture("sheath", answer.loaded)]
    else:
        top, last = (float(jnp.max(run.T_base[step])) for step in (answer.top, -1))
        ended = answer.top != len(run.T_base) - 1
        apart = _differ(answer.rest, answer.last)
        rest = "at rest" if apart or not ended else "at rest, and at the end"
        postures = [Posture(rest, answer.rest), Posture(f"at {top:.3g} N", answer.loaded)]
        if ended and apart:
            postures.append(Posture(f"at the end, {last:.3g} N", answer.last))
    pressed = [Pressed(p.tendon, p.loaded, channel_forces(p.loaded)) for p in _parts(answer)]
    body = robot.backbone
    bores = np.stack([body.bore_start, body.bore_end, body.bore_diameter], axis=1).tolist()
    shape = plot_shape(
        postures,
        radius=np.asarray(body.radius(run.s)),
        pressed=pressed,
        bores=[tuple(b) for b in bores],
        notches=notches_of(robot),
    )
    kinks = max(float(jnp.max(tendon.forces.kink_normal)) for tendon in pressed)
    at_kinks = f" Kinks of the channel carry up to {kinks:.2g} N besides." if kinks > 1e-9 else ""
    return Figure(
        "shape",
        shape,
        "Midline, body"
        + (", bores (dotted)" if bores else "")
        + " and tendon. At the largest base tension, along the tendon and below against s: "
        "the normal force on the channel (on the side it presses) and the friction (on the other), per "
        "length of tendon; the bar gives the scale of the bands." + at_kinks,
    )


def _differ(a: Equilibrium, b: Equilibrium) -> bool:
    apart = jnp.max(jnp.hypot(a.x - b.x, a.y - b.y))
    return bool(apart > APART * a.s[-1])


def _tables(answer: SimulationAnswer) -> list[Table]:
    data = facts(answer)
    if answer.several:
        return [*_several_tables(answer, data), _solver_table(data)]
    top = data["at_T_base_max"]
    loss = data["tension_loss"]
    numbers = [
        ("largest tension at the base", number(data["T_base_max_N"], "N")),
        ("tension at the tip there", number(top["T_tip_N"], "N")),
        *(
            [("shown there by the cells: base, tip", _pair(top["T_base_shown_N"], top["T_tip_shown_N"]))]
            if "T_tip_shown_N" in top
            else []
        ),
        ("lost on the way", number(None if loss is None else 100 * loss, "%")),
        *(
            [("base tension where release reaches the tip (T_base_switch)", number(switch, "N"))]
            if (switch := data.get("T_base_switch_N")) is not None
            else []
        ),
        ("wrap there", number(top["wrap_rad"], "rad")),
        *(spatial.pose_rows(top) if answer.robot.space else _pose_rows(top)),
        ("tendon drawn out there", number(1e3 * top["displacement_m"], "mm")),
    ]
    phases = [
        (phase, str(p["steps"]), _range(p["T_base_N"]), _range(p["T_tip_N"]))
        for phase, p in data["phases"].items()
    ]
    return [
        Table("At the largest base tension", ("", ""), numbers),
        Table("Phases", ("phase", "steps", "base [N]", "tip [N]"), phases),
        _solver_table(data),
    ]


def _pose_rows(top: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        ("tip there: x, y", f"{number(1e3 * top['tip_x_m'])}, {number(1e3 * top['tip_y_m'])} mm"),
        ("tip there: angle", number(float(np.degrees(top["tip_angle_rad"])), "°")),
    ]


def _several_tables(answer: SimulationAnswer, data: dict[str, Any]) -> list[Table]:
    top = data["at_T_base_max"]
    rows = [
        (
            name,
            number(t["T_base_N"]),
            number(t["T_tip_N"]),
            number(t["wrap_rad"]),
            number(1e3 * t["displacement_m"]),
        )
        for name, t in top["tendons"].items()
    ]
    if answer.robot.space:
        pose = ", ".join(number(1e3 * top[f"tip_{axis}_m"]) for axis in AXES) + " mm"
        points = f"is turned by {number(float(np.degrees(top['tip_turned_rad'])), '°')}"
    else:
        pose = f"{number(1e3 * top['tip_x_m'])}, {number(1e3 * top['tip_y_m'])} mm"
        points = f"points to {number(float(np.degrees(top['tip_angle_rad'])), '°')}"
    phases = [
        (name, phase, str(p["steps"]), _range(p["T_base_N"]), _range(p["T_tip_N"]))
        for name, own in data["phases"].items()
        for phase, p in own.items()
    ]
    return [
        Table(
            "At the largest base tension",
            ("tendon", "base [N]", "tip [N]", "wrap [rad]", "drawn out [mm]"),
            rows,
            f"Step {top['step']}; the tip lies at {pose} and {points}.",
        ),
        Table("Phases", ("tendon", "phase", "steps", "base [N]", "tip [N]"), phases),
    ]


def _solver_table(data: dict[str, Any]) -> Table:
    convergence = data["convergence"]
    solver = [
        ("steps", f"{data['steps']}, of which {convergence['flagged']} did not converge"),
        ("worst residual (relative)", number(convergence["worst_residual_norm"], digits=2)),
        ("iterations", f"{convergence['iterations']}, at most {convergence['most_iterations']} in a step"),
        ("mesh nodes", str(data["mesh"]["nodes"])),
    ]
    return Table("Solver", ("", ""), solver)


def _pair(first: float, second: float) -> str:
    return f"{number(first)}, {number(second)} N"


def _range(ends: list[float]) -> str:
    return f"{number(ends[0], digits=3)} … {number(ends[1], digits=3)}"
