"""Figures of the two fabricated manipulators and of external loads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtr_jax.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    VERMILLION,
    figure,
    line_by_phase,
    phase_keys,
    styled,
)
from gtr_jax.simulation.history import Simulation
from gtr_jax.simulation.phases import label_phases

NO_FRICTION = (0, (4, 3))
BORE_RADIUS = 7.0  # mm
_NAME_COLOUR = {"TD-CM I": BLUE, "TD-CM II": VERMILLION}
_GRAVITY_DASH = {
    "no gravity": "-",
    "pulled up": (0, (5, 2)),
    "pulled down": (0, (1, 1.3)),
    "hanging": (0, (5, 1.5, 1, 1.5)),
}
LOAD_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE)


def _legend(fig: Figure, keys: Sequence[Line2D], columns: int) -> None:
    fig.legend(
        handles=list(keys), loc="outside upper center", ncols=columns, handlelength=2.2, columnspacing=1.4
    )


@styled
def plot_family(offsets: np.ndarray, pairs: Mapping) -> Figure:
    """mu and E against |r|, for each manipulator and gravity.

    Args:
        offsets: |r| [m], (K,).
        pairs: by (name, gravity), with `mu` and `E` [Pa], (K,) each.
    """
    fig, (friction, modulus) = figure(6.0, 2, sharex=True)
    for (name, gravity), pair in pairs.items():
        look = {"color": _NAME_COLOUR[name], "linestyle": _GRAVITY_DASH[gravity], "linewidth": 1.8}
        friction.plot(1e3 * offsets, pair.mu, **look)
        modulus.plot(1e3 * offsets, 1e-6 * pair.E, **look)
    for axes in (friction, modulus):
        axes.axvspan(1e3 * offsets[0], BORE_RADIUS, color=PALE, alpha=0.5, linewidth=0, zorder=0)
        axes.set_xlim(1e3 * offsets[0], 1e3 * offsets[-1])
        axes.set_ylim(0, None)
    modulus.annotate(
        "in the bore", (0.5 * (1e3 * offsets[0] + BORE_RADIUS), 0.06), ha="center", fontsize=9, color=INK
    )
    friction.set_ylabel("friction coefficient μ")
    modulus.set_ylabel("modulus E [MPa]")
    modulus.set_xlabel("offset |r| [mm]")
    keys = [Line2D([], [], color=c, linewidth=2.2, label=n) for n, c in _NAME_COLOUR.items()]
    keys += [Line2D([], [], color=INK, linestyle=d, linewidth=1.6, label=g) for g, d in _GRAVITY_DASH.items()]
    _legend(fig, keys, 3)
    return fig


@styled
def plot_loops(
    runs: Mapping[str, Simulation],
    frictionless: Mapping[str, Simulation],
    switches: Mapping[str, float],
    *,
    every: int,
) -> Figure:
    """The loops above one another, with phases, readings, switch and the frictionless model.

    Args:
        runs, frictionless: one pull and release, by name.
        switches: T_base_switch [N], by name.
        every: steps between readings.
    """
    fig, rows = figure(6.8, len(runs), sharex=True, sharey=True)
    for axes, (name, run) in zip(rows, runs.items(), strict=True):
        T_base, T_tip, phases = np.asarray(run.T_base), np.asarray(run.T_tip), label_phases(run)
        top = int(np.argmax(T_base))
        free = frictionless[name]
        axes.plot(
            free.T_base[: top + 1], free.T_tip[: top + 1], color=GREY, linestyle=NO_FRICTION, linewidth=1.3
        )
        line_by_phase(axes, T_base, T_tip, phases)
        axes.plot(
            T_base[::every],
            T_tip[::every],
            linestyle="",
            marker="o",
            markersize=4.5,
            markerfacecolor="white",
            markeredgecolor=INK,
            markeredgewidth=0.9,
            zorder=4,
        )
        level = float(T_tip.max())
        axes.plot(switches[name], level, marker="x", color=INK, markersize=9, markeredgewidth=2.2, zorder=5)
        axes.annotate(
            f"$T_{{base,switch}}$ = {switches[name]:.1f} N",
            (switches[name], level),
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            color=INK,
        )
        axes.annotate(
            f"{level:.1f} N", (T_base[top], level), xytext=(3, -13), textcoords="offset points", color=INK
        )
        middle = 0.5 * (switches[name] + T_base[top])
        for state, x, y in (("I", 30.0, -7.0), ("II", middle, 4.0), ("III", 0.35 * switches[name], 6.0)):
            on = np.interp(x, T_base[: top + 1], T_tip[: top + 1]) if state == "I" else level
            if state == "III":
                on = np.interp(x, T_base[:top:-1], T_tip[:top:-1])
            axes.annotate(
                state,
                (x, on),
                xytext=(0, y) if state != "III" else (-9, y),
                textcoords="offset points",
                ha="left" if state == "I" else "center",
                va="top" if state == "I" else "bottom",
                fontsize=11,
                color=INK,
            )
        axes.set_ylabel("$T_{tip}$ [N]")
        axes.set_title(name, loc="left", fontsize=10, color=INK)
        axes.set_xlim(0, 49)
        axes.set_ylim(0, None)
    rows[-1].set_xlabel("tension at the base $T_{base}$ [N]")
    keys = phase_keys(label_phases(next(iter(runs.values())))[1:])
    keys.append(Line2D([], [], color=GREY, linestyle=NO_FRICTION, label="no friction"))
    _legend(fig, keys, 4)
    return fig


def _three_rows(rows: Sequence, x: np.ndarray, points, **look) -> None:
    """Tip tension, switch and tip angle against x, where solved."""
    ok = np.asarray(points.converged)
    for axes, values in zip(
        rows, (points.T_tip, points.T_base_switch, np.degrees(points.tip_angle)), strict=True
    ):
        axes.plot(x, np.where(ok, values, np.nan), **look)


def _name_three(rows: Sequence) -> None:
    for axes, label in zip(rows, ("$T_{tip}$ [N]", "$T_{base,switch}$ [N]", "tip angle [°]"), strict=True):
        axes.set_ylabel(label)


@styled
def plot_forces(forces: np.ndarray, points: Mapping) -> Figure:
    """Tip tension, switch and tip angle against the size of a tip force, by direction.

    Args:
        forces: [N], (K,).
        points: by direction, with `T_tip`, `T_base_switch` [N], `tip_angle` [rad], `converged`, (K,) each.
    """
    fig, rows = figure(6.6, 3, sharex=True)
    for colour, own in zip(LOAD_COLOURS, points.values(), strict=False):
        _three_rows(rows, forces, own, color=colour, linewidth=2.0)
    _name_three(rows)
    rows[-1].set_xlabel("force on the tip [N]")
    rows[-1].set_xlim(0, forces[-1])
    _legend(
        fig,
        [Line2D([], [], color=c, linewidth=2, label=n) for c, n in zip(LOAD_COLOURS, points, strict=False)],
        2,
    )
    return fig


@styled
def plot_gravity(angles: np.ndarray, points, unloaded) -> Figure:
    """The same against the direction of gravity, with the values without gravity dashed.

    Args:
        angles: from the base tangent [rad], (K,).
        points: as for `plot_forces`.
        unloaded: the same without gravity, (1,) each.
    """
    fig, rows = figure(6.2, 3, sharex=True)
    degrees = np.degrees(angles)
    _three_rows(rows, degrees, points, color=BLUE, linewidth=2.0)
    for axes, value in zip(
        rows, (unloaded.T_tip[0], unloaded.T_base_switch[0], np.degrees(unloaded.tip_angle[0])), strict=True
    ):
        axes.axhline(value, color=GREY, linestyle=NO_FRICTION, linewidth=1.3)
    _name_three(rows)
    rows[-1].set_xlabel("direction of gravity from the base tangent")
    rows[-1].set_xlim(0, 360)
    rows[-1].set_xticks(
        range(0, 361, 90), ["0°\nhanging", "90°\nhelps", "180°\nupright", "270°\nlifted", "360°"]
    )
    _legend(
        fig,
        [
            Line2D([], [], color=BLUE, linewidth=2, label="with its weight"),
            Line2D([], [], color=GREY, linestyle=NO_FRICTION, label="no gravity"),
        ],
        2,
    )
    return fig


@styled
def plot_loaded_loops(runs: Mapping[str, Simulation]) -> Figure:
    """Tip against base tension under several loads; steps that did not converge are left out.

    Args:
        runs: simulations by load, the first without.
    """
    fig, (axes,) = figure(4.3)
    for colour, (name, run) in zip((INK, *LOAD_COLOURS), runs.items(), strict=False):
        T_tip = np.where(np.asarray(run.converged), np.asarray(run.T_tip), np.nan)
        axes.plot(run.T_base, T_tip, color=colour, linewidth=1.7, label=name)
    axes.set_xlim(0, None)
    axes.set_ylim(0, None)
    axes.set_xlabel("tension at the base $T_{base}$ [N]")
    axes.set_ylabel("tension at the tip $T_{tip}$ [N]")
    handles, _ = axes.get_legend_handles_labels()
    fig.legend(handles=handles, loc="outside upper center", ncols=2, handlelength=1.8)
    return fig
