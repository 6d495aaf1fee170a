"""The eight paths, told: what the paper states of Figs. 2 and 3 beside what the simulator predicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gtr_jax.config.config import config_text
from gtr_jax.numbers import number
from gtr_jax.report.page import Figure, Table

from . import path_figures as draw
from .paths import (
    HALF_DIGIT,
    PATHS,
    PUBLISHED_LOSS,
    PUBLISHED_LOST,
    SEGMENTS,
    T_BASE,
    WAVES,
    Solved,
    State,
    config_of,
    dimension,
    solved,
    states,
)
from .study import FITTED, Statement, Study

NEAR = 0.25  # of the crests' spacing: nearer to a crest than to where the wave crosses its mean

SHARED = 0.02  # half of what all of paths 5 to 8 have before the wave [m]


def facts_of(path: int, state: State) -> dict[str, Any]:
    """The numbers of one path."""
    pulled, free, forces = state.pulled, state.frictionless, state.forces
    friction, normal = np.asarray(forces.friction), np.asarray(forces.normal)
    curvature = np.asarray(pulled.curvature)
    signs = np.sign(curvature[np.abs(curvature) > 1e-6 * np.abs(curvature).max()])
    x, y, angle = (float(v) for v in pulled.tip_pose)
    return {
        "T_base_N": T_BASE[path],
        "T_tip_N": float(pulled.T_tip),
        "tension_loss": 1.0 - float(pulled.T_tip) / T_BASE[path],
        "wrap_rad": float(pulled.wrap[-1]),
        "tip_mm": [1e3 * x, 1e3 * y],
        "tip_angle_deg": float(np.degrees(angle)),
        "deflection_mm": 1e3 * float(np.hypot(x - float(pulled.s[-1]), y)),
        "frictionless_tip_mm": [1e3 * float(v) for v in free.tip_pose[:2]],
        "frictionless_tip_angle_deg": float(np.degrees(free.tip_pose[2])),
        "largest_normal_force_N_per_m": float(normal.max()),
        "largest_friction_N_per_m": float(friction.max()),
        "largest_friction_at_mm": 1e3 * float(forces.s[int(friction.argmax())]),
        "smallest_tension_loss_factor": float(np.min(np.asarray(forces.tension_loss_factor))),
        "largest_normal_projection_per_m": float(np.max(np.asarray(forces.normal_projection))),
        "changes_of_bend": int(np.sum(signs[1:] != signs[:-1])),
        "converged": bool(pulled.converged) and bool(free.converged),
    }


def crests(path: int, state: State) -> dict[str, Any]:
    """How far the local maxima of friction, and of the tendon's curvature, lie from the wave's crests and
    troughs, relative to the distance between these.
    """
    waves = dimension(path, "n_sine")
    length = float(state.pulled.s[-1])
    extremes = (np.arange(waves) + 0.5) * length / waves
    s = np.asarray(state.forces.s)

    def away(values) -> np.ndarray:
        values = np.asarray(values)
        peaks = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
        return np.min(np.abs(s[peaks][:, None] - extremes[None]), axis=1) / (length / waves)

    friction, curvature = away(state.forces.friction), away(state.forces.normal_projection)
    return {
        "maxima_of_friction": len(friction),
        "of_them_near_a_crest": int(np.sum(friction < NEAR)),
        "farthest_from_a_crest": float(np.max(friction)),
        "maxima_of_curvature": len(curvature),
        "of_curvature_near_a_crest": int(np.sum(curvature < NEAR)),
        "crests_and_troughs": int(waves),
    }


def segment_facts(path: int, state: State) -> dict[str, Any]:
    """How much each part of a straight-sine-straight path bends, and where it loses tension."""
    w1, w2 = dimension(path, "w1"), dimension(path, "w2")
    s, angle = np.asarray(state.pulled.s), np.asarray(state.pulled.angle)
    at_w1, at_w2 = (float(np.interp(w, s, angle)) for w in (w1, w2))
    lost = -np.diff(np.log(np.asarray(state.pulled.tension)))
    wave = (np.asarray(state.forces.s) > w1) & (np.asarray(state.forces.s) < w2)
    rate = np.where(np.asarray(state.forces.length) > 0, np.asarray(state.forces.friction_projection), 0.0)
    return {
        "bend_before_wave_deg": float(np.degrees(at_w1)),
        "bend_after_wave_deg": float(np.degrees(angle[-1] - at_w2)),
        "curvature_near_base_per_m": float(np.interp(SHARED, s, np.abs(np.asarray(state.pulled.curvature)))),
        "loss_inside_wave_share": float(lost[wave].sum() / lost.sum()),
        "steepest_loss_at_mm": 1e3 * float(state.forces.s[int(rate.argmax())]),
        "wave_mm": [1e3 * w1, 1e3 * w2],
    }


def _rising(values: Sequence[float]) -> bool:
    return bool(np.all(np.diff(values) > 0))


def _statements(facts: dict[int, dict], crest: dict[int, dict], segment: dict[int, dict]) -> list[Statement]:
    def of(key: str, paths: Sequence[int], text: str = "{:.1f}") -> str:
        return ", ".join(text.format(facts[p][key]) for p in paths)

    sines = (1, 2, 3)
    loss = [facts[p]["tension_loss"] for p in sines]
    angles = [facts[p]["tip_angle_deg"] for p in sines]
    free = [facts[p]["frictionless_tip_angle_deg"] for p in sines]
    moved = [facts[p]["deflection_mm"] for p in sines]
    lost = {p: facts[p]["T_base_N"] - facts[p]["T_tip_N"] for p in PUBLISHED_LOST}
    before = [abs(segment[p]["bend_before_wave_deg"]) for p in SEGMENTS]
    after = [segment[p]["bend_after_wave_deg"] for p in SEGMENTS]
    first = [segment[p]["curvature_near_base_per_m"] for p in SEGMENTS]
    final = [facts[p]["tension_loss"] for p in SEGMENTS]
    inside = [segment[p]["loss_inside_wave_share"] for p in SEGMENTS]
    return [
        Statement(
            "Path 1 loses 41.5 N and path 3 59.7 N of 60 N (69.2 % and 99.5 %).",
            f"{lost[1]:.1f} and {lost[3]:.1f} N; μ and E are chosen so.",
            FITTED if all(abs(lost[p] - PUBLISHED_LOST[p]) < 0.05 for p in lost) else False,
        ),
        Statement(
            "The loss rises with the amplitude σ of paths 1 to 3.",
            f"{', '.join(f'{100 * v:.1f} %' for v in loss)}; path 2 is predicted.",
            _rising(loss),
        ),
        Statement(
            "A larger σ bends the body less, because friction is larger.",
            f"The tip turns by {', '.join(f'{v:.0f}°' for v in angles)} and moves by "
            f"{', '.join(f'{v:.0f}' for v in moved)} mm. Without friction it would turn by "
            f"{', '.join(f'{v:.0f}°' for v in free)}: friction makes "
            f"{100 * (1 - (free[0] - free[2]) / (angles[0] - angles[2])):.0f} % of the difference.",
            _rising([-v for v in angles]) and _rising([-v for v in moved]),
        ),
        Statement(
            "Friction is largest at the crests and troughs of the wave, where the tendon's curvature is.",
            "Local maxima of friction that lie nearer to a crest or trough than to a crossing: "
            + ", ".join(
                f"path {p} {c['of_them_near_a_crest']} of {c['maxima_of_friction']}, at most "
                f"{100 * c['farthest_from_a_crest']:.0f} % of the spacing away"
                for p, c in crest.items()
            )
            + f". But {crest[1]['crests_and_troughs'] - crest[1]['maxima_of_friction']} of the "
            f"{crest[1]['crests_and_troughs']} crests and troughs of path 1 have none: with the smallest "
            "wave the bend of the body outweighs the channel's there.",
            all(c["of_them_near_a_crest"] == c["maxima_of_friction"] for c in crest.values()),
        ),
        Statement(
            "Path 4, which crosses the midline, bends in an undulating pattern of varying curvature.",
            f"The curvature changes sign {facts[4]['changes_of_bend']} times; paths 1 to 3: "
            f"{of('changes_of_bend', sines, '{}')} times.",
            facts[4]["changes_of_bend"] >= 4 and all(facts[p]["changes_of_bend"] == 0 for p in sines),
        ),
        Statement(
            "Paths 5 to 8: as the wave moves towards the tip, the parts near the base deform more.",
            f"The part before the wave turns by {', '.join(f'{v:.0f}°' for v in before)}. But that is its "
            f"length: over the first {2e3 * SHARED:.0f} mm, where all four have the same channel, the "
            f"curvature is the same (half way {first[0]:.2f} 1/m, {max(first) / min(first) - 1:.0e} apart), "
            "for without external load nothing there depends on what lies beyond.",
            _rising(before),
        ),
        Statement(
            "… and the parts near the tip bend less.",
            f"The part after the wave turns by {', '.join(f'{v:.0f}°' for v in after)}; the tip as a whole "
            f"by {of('tip_angle_deg', SEGMENTS, '{:.0f}°')}.",
            _rising([-v for v in after]),
        ),
        Statement(
            "The pattern of the tension moves with the wave.",
            "Tension falls most steeply at "
            + ", ".join(f"{segment[p]['steepest_loss_at_mm']:.0f}" for p in SEGMENTS)
            + " mm, in waves at "
            + ", ".join("{:.0f} to {:.0f}".format(*segment[p]["wave_mm"]) for p in SEGMENTS)
            + f" mm, which hold {100 * min(inside):.0f} to {100 * max(inside):.0f} % of the loss (of ln T). "
            f"The loss at the tip hardly changes: {', '.join(f'{100 * v:.1f} %' for v in final)}.",
            all(
                segment[p]["wave_mm"][0] <= segment[p]["steepest_loss_at_mm"] <= segment[p]["wave_mm"][1]
                for p in SEGMENTS
            ),
        ),
    ]


def _table(facts: dict[int, dict]) -> Table:
    rows = [
        [
            str(p),
            f"{f['T_base_N']:.0f}",
            f"{f['T_tip_N']:.2f}",
            f"{100 * f['tension_loss']:.1f} %" + (" (fitted)" if p in PUBLISHED_LOSS else ""),
            f"{f['wrap_rad']:.2f}",
            "{:.0f}, {:.0f}".format(*f["tip_mm"]),
            f"{f['tip_angle_deg']:.0f}°",
            f"{f['frictionless_tip_angle_deg']:.0f}°",
            f"{number(f['largest_friction_N_per_m'], digits=3)} at {f['largest_friction_at_mm']:.0f} mm",
        ]
        for p, f in facts.items()
    ]
    columns = ["path", "T_base [N]", "T_tip [N]", "loss", "wrap [rad]", "tip x, y [mm]", "tip", "no friction"]
    return Table(
        "The eight paths",
        [*columns, "largest f_f [N/m]"],
        rows,
        "No friction: angle of the tip in the frictionless Cosserat model, where T_tip = T_base.",
    )


def _span(values) -> str:
    return f"{number(float(np.min(values)), digits=3)} to {number(float(np.max(values)), digits=3)}"


def study_paths(progress: Callable[[str], None]) -> Study:
    """The eight paths of Table I in the one material that two published losses determine.

    Args:
        progress: told each stage.
    """
    progress("eight paths: modulus and friction from two published losses")
    found: Solved = solved()
    progress("eight paths: predictions")
    all_states = states()
    facts = {p: facts_of(p, all_states[p]) for p in PATHS}
    crest = {p: crests(p, all_states[p]) for p in WAVES}
    segment = {p: segment_facts(p, all_states[p]) for p in SEGMENTS}
    material = found.material
    apart = max(float(np.ptp(np.log(values))) for values in (found.starts.mu, found.starts.E))
    text = [
        "E and μ of these figures are not published. The two losses that are, "
        f"{100 * PUBLISHED_LOSS[1]:.1f} % on path 1 and {100 * PUBLISHED_LOSS[3]:.1f} % on path 3, "
        f"determine them: μ = {material.mu:.3f}, E = {1e-6 * material.E:.3f} MPa. "
        f"{int(found.starts.settled.sum())} of {len(found.starts.mu)} starts between μ 0.1 and 0.8, E 0.1 "
        f"and 2 MPa end there ({apart:.0e} apart). The printed digits (±{100 * HALF_DIGIT:g} %) leave μ "
        f"{_span(found.corners.mu)} and E {_span(1e-6 * found.corners.E)} MPa: path 3 fixes μ nearly alone, "
        "since a wave that steep turns the tendon whatever the body does, and path 1 then fixes E. All else "
        "is predicted.",
        "The channel's forces are drawn on the deformed shapes: the normal force to the side the tendon "
        "presses on, friction to the other. Without friction (dashed) the same tensions would bend the cone "
        "much farther.",
    ]
    figures = []
    for name, paths, number_of in (("waves", WAVES, 2), ("segments", SEGMENTS, 3)):
        own = {p: all_states[p] for p in paths}
        base = T_BASE[paths[0]]
        figures += [
            Figure(
                f"{name}-shapes",
                draw.plot_shapes(own),
                f"As Fig. {number_of}(a): shapes at {base:.0f} N with f_n (blue) and f_f (red) along the "
                "channel.",
            ),
            Figure(
                f"{name}-along",
                draw.plot_along(own),
                f"As Fig. {number_of}(b, c): tension, curvature of the tendon and wrap along the robot.",
            ),
        ]
    return Study(
        title="The eight paths of Table I",
        text=text,
        solved=(
            sum(f["converged"] for f in facts.values()) + int(found.starts.settled.sum()),
            len(facts) + len(found.starts.mu),
        ),
        statements=_statements(facts, crest, segment),
        figures=figures,
        tables=[_table(facts)],
        facts={
            "mu": float(material.mu),
            "E_Pa": float(material.E),
            "mu_within_rounding": [float(found.corners.mu.min()), float(found.corners.mu.max())],
            "E_within_rounding_Pa": [float(found.corners.E.min()), float(found.corners.E.max())],
            "starts_settled": int(found.starts.settled.sum()),
            "starts": len(found.starts.mu),
            "paths": {str(p): f | crest.get(p, {}) | segment.get(p, {}) for p, f in facts.items()},
        },
        robots={f"path-{p}.toml": config_text(solved_config(p, found)) for p in PATHS},
    )


def solved_config(path: int, found: Solved):
    """A path's robot file in the fitted material."""
    values = {
        "tendon.friction_coefficient": float(found.material.mu),
        "backbone.youngs_modulus": float(found.material.E),
    }
    return config_of(path).with_values(values)
