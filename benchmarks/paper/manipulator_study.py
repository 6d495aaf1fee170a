"""The two fabricated manipulators, told: loops, the family of parameters, one silicone for both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gtr_jax.config.config import config_text
from gtr_jax.mechanics import rest_state
from gtr_jax.numbers import number
from gtr_jax.report.page import Figure, Table
from gtr_jax.robot.robot import sections
from gtr_jax.simulation.equilibrium import equilibrium
from gtr_jax.simulation.phases import PULLING, RELEASING, TRANSITION, label_phases
from gtr_jax.simulation.release import release_switch
from gtr_jax.simulation.solution import tendon_length

from . import manipulator_figures as draw
from .manipulators import (
    FINE_STEP,
    GRAVITIES,
    NAMES,
    OFFSET,
    OFFSET_BORE,
    OFFSETS,
    PUBLISHED,
    READINGS,
    ROBOT_FILES,
    SHARED_LEADS,
    SHARED_OFFSETS,
    T_MAX,
    WIDEST,
    Family,
    Shared,
    case_of,
    family,
    pulled_and_released,
    robot_of,
    shared_fits,
    solved_config,
    solved_robot,
    switch_backward,
    template,
)
from .study import FITTED, Statement, Study


def _mm(metres: float) -> str:
    return number(1e3 * metres, "mm", 3)


def _loop_facts(name: str) -> dict[str, Any]:
    """The loop's numbers, and the three ways to T_base_switch."""
    robot, run = solved_robot(name), pulled_and_released(name)
    phases = label_phases(run)
    T_base, T_tip = np.asarray(run.T_base), np.asarray(run.T_tip)
    moving = phases == TRANSITION
    switch = release_switch(robot, T_MAX)
    backward, solutions = switch_backward(robot, float(switch.T_tip))
    straight = robot.with_values(r1=robot.value("r2"))
    straight_switch = release_switch(straight, T_MAX)
    pulled, straight_pulled = equilibrium(robot, T_MAX), equilibrium(straight, T_MAX)
    rest = sections(robot)
    return {
        "phases": list(dict.fromkeys(phases.tolist())),
        "converged": bool(np.all(np.asarray(run.converged))) and bool(switch.converged),
        "T_tip_max_N": float(T_tip.max()),
        "T_tip_spread_in_transition_N": float(np.ptp(T_tip[moving])),
        "T_base_switch_release_switch_N": float(switch.T_base),
        "T_base_switch_backward_N": backward,
        "backward_solutions": solutions,
        "T_base_switch_fine_steps_N": float(T_base[moving].min()),
        "fine_step_N": FINE_STEP,
        "tension_loss_at_45_N": 1.0 - float(T_tip.max()) / T_MAX,
        "tip_angle_at_45_N_deg": float(np.degrees(pulled.angle[-1])),
        "wrap_at_45_N_rad": float(pulled.wrap[-1]),
        "tip_at_45_N_mm": [1e3 * float(pulled.x[-1]), 1e3 * float(pulled.y[-1])],
        "steepest_slope_of_channel": float(np.max(np.abs(rest.R.slope))),
        "channel_length_mm": 1e3 * float(tendon_length(rest, rest_state(rest))),
        "straight_routing_T_tip_max_N": float(straight_switch.T_tip),
        "straight_routing_T_base_switch_N": float(straight_switch.T_base),
        "straight_routing_wrap_at_45_N_rad": float(straight_pulled.wrap[-1]),
        "readings_pulling_N": T_tip[:: round(5.0 / FINE_STEP)][: len(READINGS)].tolist(),
        "readings_releasing_N": T_tip[:: round(5.0 / FINE_STEP)][len(READINGS) - 1 :].tolist(),
    }


def _span(values) -> str:
    return f"{number(float(np.min(values)), digits=3)} to {number(float(np.max(values)), digits=3)}"


def _shared_best(fits: Shared, gravity: int, *, same: bool) -> tuple[float, float, Shared]:
    """The best fit of one gravity: |r| of I and II [m] and the fit; `same`: with one |r|."""
    allowed = fits.converged[gravity] & (np.asarray(SHARED_LEADS == 0.0)[None, :] if same else True)
    i, j = np.unravel_index(np.argmin(np.where(allowed, fits.rms[gravity], np.inf)), fits.rms[gravity].shape)
    first = float(SHARED_OFFSETS[i])
    second = min(first + float(SHARED_LEADS[j]), WIDEST)
    return first, second, Shared(*(field[gravity, i, j] for field in fits))


def _equal_wraps(fit: Shared, offset: float) -> list[tuple[float, float]]:
    """Wrap [rad] and tension loss of I and II at 45 N with one mu, E and |r|, no gravity."""
    states = [
        equilibrium(robot_of(template(False), case_of(name, offset=offset), fit.mu, fit.E), T_MAX)
        for name in NAMES
    ]
    return [(float(eq.wrap[-1]), 1.0 - float(eq.T_tip) / T_MAX) for eq in states]


def _family_table(solved: Family) -> Table:
    rows = []
    for (name, gravity), pairs in solved.pairs.items():
        pair = solved.pair(name, gravity)
        rows.append(
            [
                name,
                gravity,
                number(float(pair.mu), digits=3),
                number(1e-6 * float(pair.E), "MPa", 3),
                number(float(np.degrees(pair.tip_angle)), "°", 3),
                _span(pairs.mu),
                f"{_span(1e-6 * pairs.E)} MPa",
                f"{_span(np.degrees(pairs.tip_angle))}°",
            ]
        )
    ends = f"|r| = {1e3 * OFFSETS[0]:g} to {1e3 * OFFSETS[-1]:g} mm"
    at = f"|r| = {1e3 * OFFSET:g} mm"
    return Table(
        "μ and E that meet both published tensions, and the tip angle they give at 45 N",
        ["", "gravity", f"μ at {at}", "E", "tip", f"μ at {ends}", "E", "tip"],
        rows,
        "Pulled up: base tangent horizontal, bending plane vertical, the tendon lifts the tip; pulled down: "
        "it lowers it; hanging: base tangent down. Density 1070 kg/m³ is ours (a silicone).",
    )


def _shared_table(fits: Shared) -> tuple[Table, list[dict[str, Any]]]:
    rows, facts = [], []
    for g, gravity in enumerate(GRAVITIES):
        for same in (True, False):
            first, second, fit = _shared_best(fits, g, same=same)
            published = np.asarray([PUBLISHED[name] for name in NAMES])[:, :2]
            ours = np.stack([fit.T_tip_max, fit.T_base_switch], axis=1)
            errors = ours - published
            facts.append(
                {
                    "gravity": gravity,
                    "one_offset": same,
                    "offset_I_m": first,
                    "offset_II_m": second,
                    "mu": float(fit.mu),
                    "E_Pa": float(fit.E),
                    "T_tip_max_N": fit.T_tip_max.tolist(),
                    "T_base_switch_N": fit.T_base_switch.tolist(),
                    "rms_relative_error": float(fit.rms),
                    "largest_error_N": float(np.max(np.abs(errors))),
                    "largest_relative_error": float(np.max(np.abs(errors / published))),
                }
            )
            pairs = (f"{tip:.1f} / {switch:.1f}" for tip, switch in ours)
            offsets = _mm(first) if same else f"{_mm(first)}, {_mm(second)}"
            rows.append(
                [
                    gravity,
                    offsets,
                    number(float(fit.mu), digits=3),
                    number(1e-6 * float(fit.E), "MPa", 3),
                    *pairs,
                    f"{100 * float(fit.rms):.1f} %",
                    f"{np.max(np.abs(errors)):.1f} N, {100 * np.max(np.abs(errors / published)):.1f} %",
                ]
            )
    table = Table(
        "One silicone for both: the closest that one μ and one E come to the four published tensions",
        ["gravity", "|r|", "μ", "E", "I [N]", "II [N]", "rms", "largest"],
        rows,
        "Published: "
        + ", ".join(f"{n} {p.T_tip_max:g} / {p.T_base_switch:g} N" for n, p in PUBLISHED.items())
        + " (T_tip_max / T_base_switch). First row of each: one |r| for both; second: |r| of each "
        f"({1e3 * SHARED_OFFSETS[0]:g} to {1e3 * WIDEST:g} mm, 1 mm steps). {int(fits.converged.sum())} of "
        f"{fits.converged.size} fits settled; only these are compared.",
    )
    return table, facts


def _corner_spans(solved: Family) -> dict[str, dict[str, list[float]]]:
    named = {**solved.corners, "TD-CM II, switch to 1 N": solved.coarse}
    return {
        name: {
            "mu": [float(pair.mu.min()), float(pair.mu.max())],
            "E_Pa": [float(pair.E.min()), float(pair.E.max())],
        }
        for name, pair in named.items()
    }


def _statements(solved: Family, loops: dict[str, dict], equal: list[tuple[float, float]]) -> list[Statement]:
    one, two = (loops[name] for name in NAMES)
    both = [(name, loops[name]) for name in NAMES]

    def each(text: Callable[[dict], str]) -> str:
        return "; ".join(f"{name}: {text(facts)}" for name, facts in both)

    order = [PULLING, TRANSITION, RELEASING]
    wall = OFFSETS > OFFSET_BORE - 1e-9
    angles = {n: np.degrees(solved.pairs[n, "no gravity"].tip_angle[wall]) for n in NAMES}
    met = all(
        abs(f["T_tip_max_N"] - PUBLISHED[n].T_tip_max) < PUBLISHED[n].half_digit
        and abs(f["T_base_switch_release_switch_N"] - PUBLISHED[n].T_base_switch) < PUBLISHED[n].half_digit
        for n, f in both
    )
    own_wraps = one["wrap_at_45_N_rad"] > two["wrap_at_45_N_rad"]
    ways = max(abs(f["T_base_switch_backward_N"] - f["T_base_switch_release_switch_N"]) for _, f in both)
    steps = max(abs(f["T_base_switch_fine_steps_N"] - f["T_base_switch_release_switch_N"]) for _, f in both)
    return [
        Statement(
            "T_tip stays at its maximum through the transition: 22.0 N (I), 23.9 N (II), for 45 N at the "
            "base.",
            each(
                lambda f: (
                    f"{f['T_tip_max_N']:.2f} N, constant within {f['T_tip_spread_in_transition_N']:.0e} N"
                )
            )
            + " (μ and E are solved so that the level is met; that it is constant follows).",
            met and all(f["T_tip_spread_in_transition_N"] < 1e-9 for _, f in both),
        ),
        Statement(
            "Release reaches the tip at T_base_switch = 11.9 N (I) and 15 N (II).",
            each(lambda f: f"{f['T_base_switch_release_switch_N']:.2f} N")
            + f", met by some μ and E at every |r| from {_mm(OFFSETS[0])} to {_mm(OFFSETS[-1])}, with and "
            "without gravity.",
            FITTED if met and all(bool(np.all(p.converged)) for p in solved.pairs.values()) else False,
        ),
        Statement(
            "Algorithm 1 captures three phases, in the order pulling, transition, releasing.",
            each(lambda f: ", ".join(f["phases"])) + ".",
            all([p for p in f["phases"] if p != "rest"] == order for _, f in both),
        ),
        Statement(
            "T_base_switch can be had by solving (18) backward with λ = −1 from T_tip_max.",
            each(
                lambda f: (
                    f"backward {f['T_base_switch_backward_N']:.4f} N in {f['backward_solutions']} solutions, "
                    f"our search {f['T_base_switch_release_switch_N']:.4f} N, the history in {FINE_STEP:g} N "
                    f"steps {f['T_base_switch_fine_steps_N']:.2f} N"
                )
            )
            + ".",
            ways < 1e-6 and steps <= FINE_STEP,
        ),
        Statement(
            "Path I is steeper than path II because its wave is shorter.",
            each(lambda f: f"largest |dR/ds| {f['steepest_slope_of_channel']:.3f}") + " (at equal |r|).",
            one["steepest_slope_of_channel"] > two["steepest_slope_of_channel"],
        ),
        Statement(
            "Wrap angle and curvature of path I are larger than those of path II, which explains its larger "
            "loss.",
            f"With one μ, E and |r| for both: wrap at 45 N {equal[0][0]:.2f} rad (I) and {equal[1][0]:.2f} "
            f"rad (II), loss {100 * equal[0][1]:.1f} % and {100 * equal[1][1]:.1f} %. With each its own "
            f"pair, which meets the published tensions exactly at |r| = {_mm(OFFSET)}, "
            f"{one['wrap_at_45_N_rad']:.2f} and {two['wrap_at_45_N_rad']:.2f} rad: "
            f"{'the same order' if own_wraps else 'the other way round, and then μ makes the difference'}. "
            "The curvature is not compared.",
            True if own_wraps else None,
        ),
        Statement(
            "I loses more tension than II; the loss is about 50 %.",
            each(lambda f: f"{100 * f['tension_loss_at_45_N']:.1f} %") + ".",
            FITTED if one["tension_loss_at_45_N"] > two["tension_loss_at_45_N"] > 0.4 else False,
        ),
        Statement(
            "I and II deform differently under the same base tension.",
            each(lambda f: f"tip turned {f['tip_angle_at_45_N_deg']:.0f}° at 45 N") + " (|r| = 10 mm).",
            abs(one["tip_angle_at_45_N_deg"] - two["tip_angle_at_45_N_deg"]) > 5,
        ),
        Statement(
            "The transition is larger than with straight routing; partly because the tendon is longer.",
            "In the same body: "
            + each(
                lambda f: (
                    f"transition {T_MAX - f['T_base_switch_release_switch_N']:.1f} N wide against "
                    f"{T_MAX - f['straight_routing_T_base_switch_N']:.1f} N for a straight channel at r₂; "
                    f"the channel is {100 * (f['channel_length_mm'] / 250.0 - 1):.1f} % longer than the body"
                )
            )
            + ". A straight channel at r₂ bends the whole body one way and so wraps too: "
            + each(
                lambda f: (
                    f"{f['wrap_at_45_N_rad']:.2f} rad with the wave, "
                    f"{f['straight_routing_wrap_at_45_N_rad']:.2f} rad straight, at 45 N"
                )
            )
            + ". The paper compares with other manipulators, of its reference [8], so this does not test it.",
            None,
        ),
        Statement(
            "Agreement in tensions indirectly shows that the shape is predicted.",
            "; ".join(
                f"{n}: pairs that meet both tensions turn the tip by {_span(a)}° at 45 N as |r| goes from "
                f"{_mm(OFFSET_BORE)} to {_mm(OFFSETS[-1])}"
                for n, a in angles.items()
            )
            + ". The two tensions alone do not fix the shape; with a known |r|, which the authors have, "
            "they do, within the model.",
            None,
        ),
        Statement(
            "Mean absolute percentage error over 120 readings: 9.98 % (I), 7.10 % (II).",
            "The readings are not in the text; nothing to compare with.",
            None,
        ),
    ]


def study_manipulators(progress: Callable[[str], None]) -> Study:
    """The two fabricated manipulators: what their published tensions determine.

    Args:
        progress: told each stage.
    """
    progress("TD-CM I and II: friction and modulus for every offset")
    solved = family()
    progress("TD-CM I and II: one silicone for both")
    fits = shared_fits()
    progress("TD-CM I and II: loops")
    loops = {name: _loop_facts(name) for name in NAMES}
    equal_offset, _, equal_fit = _shared_best(fits, 0, same=True)
    equal = _equal_wraps(equal_fit, equal_offset)
    shared_table, shared_facts = _shared_table(fits)
    spans = _corner_spans(solved)
    lanes = sum(len(p.mu) for p in solved.pairs.values())
    met = sum(int(p.converged.sum()) for p in solved.pairs.values())
    same = next(f for f in shared_facts if f["one_offset"] and f["gravity"] == "no gravity")
    best = min(shared_facts, key=lambda f: f["rms_relative_error"])
    flat = fits.rms[0, :, 0]
    free = solved.pairs[NAMES[0], "no gravity"]
    text = [
        "The paper gives the bodies, the bores and two tensions each; r₁, r₂, E and μ are missing. We take "
        "r₁ = −|r|, r₂ = +|r|, the wave between the bores, and solve for the pair (μ, E) that meets both "
        f"tensions: {met} of {lanes} cases (|r|, gravity, manipulator) are met, each confirmed by a search "
        "for the switch. Only 7 to 13 mm lie in the wall: below, the tendon would hang in the 14 mm bore; "
        "above, it would leave the surface at the tip.",
        f"Without gravity, from |r| = {_mm(OFFSETS[0])} to {_mm(OFFSETS[-1])} μ changes by a factor of "
        f"{_factor(free.mu):.1f} and E by {_factor(free.E):.2f} (TD-CM I). Gravity changes them by up to "
        f"{100 * _largest_change(solved, 'mu'):.0f} % and {100 * _largest_change(solved, 'E'):.0f} % at |r| "
        "= 10 mm, so the orientation of the rig, which the text does not state, matters. The printed digits "
        "alone leave "
        + "; ".join(
            f"{name}: μ {_span(s['mu'])}, E {_span(1e-6 * np.asarray(s['E_Pa']))} MPa"
            for name, s in spans.items()
        )
        + " (|r| = 10 mm, no gravity).",
        f"One silicone can serve both: with one μ, one E and one |r| = {_mm(same['offset_I_m'])} the four "
        f"tensions are met within {same['largest_error_N']:.1f} N "
        f"({100 * same['largest_relative_error']:.1f} %), {100 * same['rms_relative_error']:.1f} % rms, and "
        f"every |r| does nearly as well ({100 * flat.min():.1f} to {100 * flat.max():.1f} %). With |r| of "
        f"each the best is {100 * best['rms_relative_error']:.1f} % rms ({best['gravity']}, "
        f"{_mm(best['offset_I_m'])} and {_mm(best['offset_II_m'])}). Yet the two pairs at |r| = 10 mm "
        f"differ by a factor of {float(solved.pair('TD-CM I').E / solved.pair('TD-CM II').E):.1f} in E: two "
        "tensions hold E loosely.",
    ]
    figures = [
        Figure(
            "manipulator-family",
            draw.plot_family(OFFSETS, solved.pairs),
            "μ and E that meet both published tensions, against the offset that is not published. Shaded: "
            "the tendon would lie in the bore.",
        ),
        Figure(
            "manipulator-loops",
            draw.plot_loops(
                {n: pulled_and_released(n) for n in NAMES},
                {n: pulled_and_released(n, 0.0) for n in NAMES},
                {n: loops[n]["T_base_switch_release_switch_N"] for n in NAMES},
                every=round(5.0 / FINE_STEP),
            ),
            "Loops of TD-CM I and II at |r| = 10 mm. Rings: at the paper's steps of 5 N. ×: T_base,switch.",
        ),
    ]
    return Study(
        title="The two fabricated manipulators",
        text=text,
        solved=(met + sum(f["converged"] for f in loops.values()), lanes + len(loops)),
        statements=_statements(solved, loops, equal),
        figures=figures,
        tables=[_family_table(solved), shared_table],
        facts={
            "offsets_m": OFFSETS.tolist(),
            "published_N": {n: p._asdict() for n, p in PUBLISHED.items()},
            "family": {
                f"{name}, {gravity}": {
                    "mu": p.mu.tolist(),
                    "E_Pa": p.E.tolist(),
                    "tip_angle_rad": p.tip_angle.tolist(),
                    "wrap_rad": p.wrap.tolist(),
                    "converged": p.converged.tolist(),
                }
                for (name, gravity), p in solved.pairs.items()
            },
            "one_silicone": shared_facts,
            "one_silicone_fits": {"solved": int(fits.converged.sum()), "of": int(fits.converged.size)},
            "rounding_of_readings": spans,
            "loops": loops,
            "equal_parameters": {
                "wrap_rad": [wrap for wrap, _ in equal],
                "tension_loss": [loss for _, loss in equal],
            },
        },
        robots={ROBOT_FILES[name]: config_text(solved_config(name)) for name in NAMES},
    )


def _factor(values: np.ndarray) -> float:
    """Largest over smallest."""
    return float(np.max(values) / np.min(values))


def _largest_change(solved: Family, field: str) -> float:
    """Largest relative change of a pair's field by gravity, at |r| = 10 mm."""
    changes = [
        getattr(solved.pair(name, gravity), field) / getattr(solved.pair(name), field) - 1
        for name in NAMES
        for gravity in GRAVITIES
    ]
    return float(np.max(np.abs(changes)))
