"""The antagonistic pair as a part of the reproduction."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from gtr_jax.report.page import Figure, Table
from gtr_jax.simulation.forces import channel_forces
from gtr_jax.simulation.history import simulate
from gtr_jax.simulation.phases import TRANSITION, label_phases

from . import antagonist_figures as draw
from .antagonists import FILE, HELD, PULL, STEPS, Held, pull_against, strung
from .study import Statement, Study, beyond

SHOWN = 5.0  # N: the held tension whose tensions along the robot are drawn


def _facts(case: Held) -> dict[str, Any]:
    forces = [channel_forces(case.pulled.of_tendon(i)) for i in range(2)]
    friction = [float(jnp.sum(f.friction * f.length)) for f in forces]
    tips = np.asarray(case.pulled.T_tip)
    found = np.append(float(case.pulled.tip_pose[2]), tips)
    phases = label_phases(case.run)
    locked = phases[case.top + 1 :] == TRANSITION
    middle = 0.5 * (PULL + case.held)
    angle = np.degrees(np.asarray(case.run.tip_pose[:, 2]))
    T_base = np.asarray(case.run.T_base[:, 0])
    turned = case.top + int(locked[:, 0].sum())
    there, back = slice(0, case.top + 1), slice(None, case.top - 1, -1)
    return {
        "held_N": case.held,
        "T_tip_pulled_N": float(tips[0]),
        "T_tip_held_N": float(tips[1]),
        "loss_of_pulled": 1.0 - float(tips[0]) / PULL,
        "rise_of_held": float(tips[1]) / case.held - 1.0,
        "friction_on_pulled_N": friction[0],
        "friction_on_held_N": friction[1],
        "tip_angle_deg": float(np.degrees(case.pulled.tip_pose[2])),
        "half_way_N": middle,
        "tip_angle_half_way_pulling_deg": float(np.interp(middle, T_base[there], angle[there])),
        "tip_angle_half_way_releasing_deg": float(np.interp(middle, T_base[back], angle[back])),
        "tip_angle_left_over_deg": float(angle[-1]),
        "closed_form_error": float(np.max(np.abs(found / case.exact - 1))),
        "steps_in_transition": locked.sum(axis=0).tolist(),
        "T_tip_change_in_transition_N": float(case.run.T_tip[turned, 0] - tips[0]),
        "slip_direction_in_pull": np.asarray(case.run.slip_direction[case.top]).tolist(),
        "slip_direction_in_release": np.asarray(case.run.slip_direction[-1]).tolist(),
        "converged": bool(jnp.all(case.run.converged)),
        "steps": len(case.run.T_base),
    }


def _statements(
    facts: list[dict[str, Any]], alone: dict[str, Any], together: dict[str, Any]
) -> list[Statement]:
    worst = max(f["closed_form_error"] for f in facts)
    losses = [f["loss_of_pulled"] for f in facts]
    total = [f["friction_on_pulled_N"] + abs(f["friction_on_held_N"]) for f in facts]
    helds = ", ".join(f"{f['held_N']:g}" for f in facts)

    def each(key: str, text: str, scale: float = 1) -> str:
        return ", ".join(text.format(f[key] if scale == 1 else scale * f[key]) for f in facts)

    return [
        beyond(
            "Antagonistic tension influences the friction along the tendons (the subject of reference [18]).",
            f"Held at {helds} N, the antagonist takes {each('friction_on_held_N', '{:+.2f}')} N of friction "
            f"and the pulled tendon {each('friction_on_pulled_N', '{:.2f}')} N; the tip turns by "
            f"{each('tip_angle_deg', '{:.0f}°')}. The pulled tendon loses "
            f"{each('loss_of_pulled', '{:.1f} %', 100)}: less, because the body bends less.",
            bool(np.ptp(total) > 0.05 * max(total)) and bool(np.all(np.diff(losses) < 0)),
        ),
        beyond(
            "A tendon whose base is held slides too, dragged by the body, and is tightest at the tip.",
            f"Its tip tension is above its base tension by {each('rise_of_held', '{:.0f} %', 100)}; it "
            "slips towards the tip while the other is pulled and towards the base while it is released. "
            f"Both tip tensions and the tip angle agree with the closed form within {worst:.0e}.",
            worst < 1e-5 and all(f["slip_direction_in_pull"] == [1.0, -1.0] for f in facts),
        ),
        beyond(
            "On release both tendons pass through the transition together, and the angle has a loop that "
            "closes.",
            "Mirrored parallel channels lengthen by what the other shortens, so both turn over at the same "
            f"points: transition in {each('steps_in_transition', '{}')} of {STEPS} steps (pulled, held). "
            f"Half way up the tip turns by {each('tip_angle_half_way_pulling_deg', '{:.0f}°')}, half way "
            f"back by {each('tip_angle_half_way_releasing_deg', '{:.0f}°')}; at equal base tensions the "
            "body is straight again.",
            all(
                f["steps_in_transition"][0] == f["steps_in_transition"][1]
                and f["tip_angle_half_way_releasing_deg"] > f["tip_angle_half_way_pulling_deg"] + 1
                and abs(f["tip_angle_left_over_deg"]) < 0.1
                for f in facts
            ),
        ),
        beyond(
            "Beside an antagonist T_tip does not stay at its maximum in the transition, as it does alone.",
            f"The pulled tendon's changes by {each('T_tip_change_in_transition_N', '{:+.2f}')} N while its "
            "far part is locked. There the body keeps its shape, so the difference of the tensions stays; "
            "but the held tendon, dragged to its limit of friction, must follow when it is let go nearer to "
            "the base, and the pulled one falls with it.",
            all(f["T_tip_change_in_transition_N"] < -0.01 * PULL for f in facts),
        ),
        beyond(
            "Pulled together, antagonists neither bend the body nor lose tension.",
            f"Both to {PULL:g} N: the tip turns by {together['tip_angle_deg']:.0e}° and "
            f"{together['T_tip_N'][0]:.3f} and {together['T_tip_N'][1]:.3f} N arrive. (One alone would lose "
            f"{100 * alone['loss']:.1f} %.)",
            abs(together["tip_angle_deg"]) < 1e-6 and abs(together["T_tip_N"][0] - PULL) < 1e-6,
        ),
    ]


def study_antagonists(progress: Callable[[str], None]) -> Study:
    """Several tendons: an antagonistic pair, one pulled against the other held.

    Args:
        progress: told each stage.
    """
    progress("antagonists: pulled against a held tension")
    cases = [pull_against(held) for held in HELD]
    facts = [_facts(case) for case in cases]
    robot = strung(0.0)
    both = simulate(robot, np.linspace([0.0, 0.0], [PULL, PULL], 2 * STEPS + 1))
    single = simulate(robot, np.linspace([0.0, 0.0], [PULL, 0.0], 2 * STEPS + 1))
    together = {
        "tip_angle_deg": float(np.degrees(both.tip_pose[-1, 2])),
        "T_tip_N": np.asarray(both.T_tip[-1]).tolist(),
    }
    alone = {"loss": 1.0 - float(single.T_tip[-1, 0]) / PULL}
    runs = [*(case.run for case in cases), both, single]
    solved, steps = sum(int(jnp.sum(run.converged)) for run in runs), sum(len(run.T_base) for run in runs)
    shown = next(case for case in cases if case.held == SHOWN)
    rows = [
        [
            f"{f['held_N']:g}",
            f"{f['T_tip_pulled_N']:.2f}",
            f"{f['T_tip_held_N']:.2f}",
            f"{100 * f['loss_of_pulled']:.1f} %",
            f"{f['friction_on_pulled_N']:.2f}, {f['friction_on_held_N']:.2f}".replace("-", "−"),
            f"{f['tip_angle_deg']:.0f}°",
            f"{f['tip_angle_half_way_pulling_deg']:.0f}°, {f['tip_angle_half_way_releasing_deg']:.0f}°",
            f"{f['closed_form_error']:.0e}",
        ]
        for f in facts
    ]
    return Study(
        title="Several tendons",
        text=[
            "Each tendon has its own routing, friction coefficient, preload and history of base tension; "
            "their moments add, and the friction of each depends on the shape they share. With one tendon "
            "it is enough to compare tensions; with several, a tendon may slide without its base tension "
            f"changing, so friction follows the slip (docs: Mechanics). {solved} of {steps} steps converged.",
            "The pair is `examples/antagonists.toml`: parallel channels at ±8 mm, μ = 0.3. The left tendon "
            f"is pulled to {PULL:g} N and released while the right one is held.",
        ],
        solved=(solved, steps),
        statements=_statements(facts, alone, together),
        figures=[
            Figure(
                "antagonists-loops",
                draw.plot_pairs(cases),
                "Tip tensions of the pulled and of the held tendon, and the tip's angle, against the "
                "tension pulled with. Dashed: the held base tension.",
            ),
            Figure(
                "antagonists-along",
                draw.plot_along(shown),
                f"Tensions along the robot at {PULL:g} N against {SHOWN:g} N, and on the way back.",
            ),
        ],
        tables=[
            Table(
                f"Left pulled to {PULL:g} N, right held",
                [
                    *(
                        "held [N]",
                        "T_tip left [N]",
                        "T_tip right [N]",
                        "loss of left",
                        "friction on each [N]",
                    ),
                    *("tip", "tip half way, up and back", "off the closed form"),
                ],
                rows,
                "Friction: along the tendon, positive where it takes tension away on the way to the tip.",
            )
        ],
        facts={"T_base_pulled_N": PULL, "held": facts, "together": together, "alone": alone},
        robots={FILE.name: FILE.read_text(encoding="utf-8")},
    )
