"""What an inspection shows in pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from gtr_jax.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PHASE_COLOUR,
    PURPLE,
    VERMILLION,
    figure,
    legend_above,
    line_by_phase,
    phase_keys,
    styled,
)
from gtr_jax.recordings.cleaning.masking import Masked
from gtr_jax.recordings.recording import Recording
from gtr_jax.recordings.signals.differences import MAD_TO_SD, third_differences
from gtr_jax.recordings.signals.turning import extremes

from ..inspection import Inspection
from ..sampling import GAP
from ..slip import HOLD, PULLING, RELEASING, SLACK, TRANSITION

BLOCKS = 1500
"""Blocks that a long recording is cut into to be drawn, with both extremes of each: two to a pixel."""
PHASES = {
    PULLING: "pulling",
    RELEASING: "releasing",
    TRANSITION: "transition",
    HOLD: "rest",
    SLACK: "rest",
}
HELD = "#F6EBD2"
MOST_NAMED, CLOSE_CYCLES = 24, 4  # cycles that are numbered, and about as many in a close-up of more
CLOSE_UPS, AROUND = 6, 12  # glitches that are shown, and samples to each side
RATE_BINS = 8
EVEN = 0.02  # spread of the sampling steps, as a share of their median, up to which they are all alike


def thinned(*channels: np.ndarray) -> np.ndarray:
    """Samples that keep every extreme of every channel, (K,) each, as far as a picture can show them."""
    return np.unique(np.concatenate([extremes(x, BLOCKS) for x in channels]))


def clock(recording: Recording) -> tuple[np.ndarray, str]:
    """Time [s] of the samples, or their number where there is no clock, and what it is called."""
    if recording.time is None:
        return np.arange(len(recording), dtype=float), "sample"
    return recording.time, "time [s]"


def close_up(found: Inspection) -> slice:
    """Samples of a few cycles around the largest peak."""
    cycles = found.cycles.cycles
    largest = max(range(len(cycles)), key=lambda i: cycles[i].peak_N)
    first, last = max(largest - CLOSE_CYCLES // 2, 0), min(largest + CLOSE_CYCLES // 2, len(cycles) - 1)
    return slice(cycles[first].where.first, cycles[last].where.last + 1)


@styled
def plot_channels(recording: Recording, found: Inspection, *, rows: slice = slice(None)) -> Figure:
    """Both cells over time, the phase of each sample below, and everything odd marked.

    Args:
        recording, found: what was inspected, and what was found.
        rows: samples that are shown; all unless given.
    """
    fig, (axes, strip) = figure(4.2, 2, sharex=True, height_ratios=(12, 1))
    t, name = clock(recording)
    T_base, T_tip = recording.T_base, recording.T_tip
    assert T_tip is not None
    shown = np.arange(len(recording))[rows]
    at = shown[thinned(T_base[rows], T_tip[rows])]
    gaps = found.sampling.gaps
    for values, colour in ((T_base, INK), (T_tip, VERMILLION)):
        axes.plot(*_broken(t[at], values[at], [g.start_s for g in gaps]), color=colour, linewidth=1.0)
    keys: list[Any] = [
        Line2D([], [], color=INK, label="base"),
        Line2D([], [], color=VERMILLION, label="tip"),
    ]
    low, high = min(T_base.min(), T_tip.min()), max(T_base.max(), T_tip.max())
    axes.set_ylim(low - 0.06 * (high - low), high + 0.12 * (high - low))
    if gaps:
        _bands(axes, [(g.start_s or 0.0, g.end_s or 0.0) for g in gaps], color=PALE, hatch="///")
        keys.append(Patch(facecolor=PALE, hatch="///", label="gap"))
    if found.holds:
        _bands(axes, [(t[h.first], t[h.last]) for h in found.holds], color=HELD)
        keys.append(Patch(facecolor=HELD, label="hold"))
    stuck = [s for cell in (found.base, found.tip) for s in (*cell.saturated, *cell.dead)]
    for cell, values in ((found.base, T_base), (found.tip, T_tip)):
        for s in (*cell.saturated, *cell.dead):
            own = s.where.rows
            axes.plot(t[own], values[own], color=PURPLE, linewidth=5, alpha=0.6, solid_capstyle="butt")
    if stuck:
        keys.append(Line2D([], [], color=PURPLE, linewidth=5, alpha=0.6, label="stuck"))
    if _mark_left_out(axes, recording):
        keys.append(_cross("left out"))
    named = [c for c in enumerate(found.cycles.cycles, 1) if shown[0] <= c[1].peak <= shown[-1]]
    for number, cycle in named if len(named) <= MOST_NAMED else ():
        axes.annotate(
            str(number),
            (t[cycle.peak], cycle.peak_N),
            xytext=(0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=8,
            color=GREY,
        )
    axes.set_ylabel("tension [N]")
    label = found.phases.label
    _strip(strip, t[rows], label[rows])
    if t[shown[-1]] > t[shown[0]]:
        axes.set_xlim(float(t[shown[0]]), float(t[shown[-1]]))
    strip.set_xlabel(name)
    words = np.asarray([PHASES[p] for p in np.unique(label[rows]).tolist()])
    legend_above(fig, [*keys, *phase_keys(words)])
    return fig


def _bands(axes: Axes, spans: Sequence[tuple[float, float]], **style: Any) -> None:
    """Bands of the height of the axes from one time to another: all of them as one artist, of which there may
    be thousands.
    """
    bars = [(float(start), float(end - start)) for start, end in spans]
    axes.broken_barh(bars, (0, 1), transform=axes.get_xaxis_transform(), linewidth=0, zorder=0, **style)


def _broken(t: np.ndarray, x: np.ndarray, starts: Sequence[float | None]) -> tuple[np.ndarray, np.ndarray]:
    """A line that is interrupted after each of these times."""
    places = [int(np.searchsorted(t, s, side="right")) for s in starts if s is not None]
    return np.insert(t, places, np.nan), np.insert(x, places, np.nan)


def _mark_left_out(axes: Axes, recording: Recording) -> bool:
    """Crosses where samples were left out, at the value they had as far as the axes reach."""
    t, _ = clock(recording)
    low, high = axes.get_ylim()
    edge = 0.03 * (high - low)
    masked = [m for m in recording.masked if m.time is not None and m.channel in ("T_base", "T_tip")]
    if not masked:
        return False
    for name in sorted({m.channel for m in masked}):
        own = [m for m in masked if m.channel == name]
        at, values = _values(recording, t, own)
        axes.plot(
            at,
            np.clip(values, low + edge, high - edge),
            marker="x",
            color=PURPLE,
            markersize=7,
            markeredgewidth=1.8,
            linestyle="",
            zorder=5,
        )
    return True


def _values(recording: Recording, t: np.ndarray, masked: Sequence[Masked]) -> tuple[np.ndarray, np.ndarray]:
    """When samples of one channel were left out, and what it showed there; about what its neighbours show if
    that was nothing.
    """
    at = np.array([m.time[0] for m in masked if m.time is not None])
    between = np.interp(at, t, getattr(recording, masked[0].channel))
    return at, between + np.nan_to_num([m.size for m in masked])


def _cross(label: str) -> Line2D:
    return Line2D(
        [], [], marker="x", color=PURPLE, markersize=7, markeredgewidth=1.8, linestyle="", label=label
    )


def _strip(axes: Axes, t: np.ndarray, label: np.ndarray) -> None:
    """The phases as a strip of colours."""
    order = list(PHASES)
    colours = ListedColormap([PHASE_COLOUR[PHASES[p]] for p in order])
    columns = np.linspace(t[0], t[-1], 2001)
    middle = 0.5 * (columns[1:] + columns[:-1])
    own = label[np.minimum(np.searchsorted(t, middle), len(t) - 1)]
    axes.pcolormesh(columns, [0.0, 1.0], own[None, :] - 1, cmap=colours, vmin=-0.5, vmax=len(order) - 0.5)
    axes.set_yticks([])
    axes.grid(False)
    axes.spines["left"].set_visible(False)


@styled
def plot_loop(recording: Recording, found: Inspection) -> Figure:
    """Tip against base tension, coloured by phase, and the mean ratios of the branches."""
    fig, (axes,) = figure(4.0)
    T_base, T_tip = recording.T_base, recording.T_tip
    assert T_tip is not None
    at = thinned(T_base, T_tip)
    words = np.asarray([PHASES[p] for p in found.phases.label[at].tolist()])
    line_by_phase(axes, T_base[at], T_tip[at], words, width=1.2)
    keys = phase_keys(words)
    axes.set_xlim(min(0.0, float(T_base.min())), None)
    axes.set_ylim(min(0.0, float(T_tip.min())), max(1.05 * float(T_tip.max()), 1e-9))
    friction = found.friction
    if friction.mu_theta is not None and friction.both is not None:
        zeros = [(c.zero_before or c.zero_after) for c in (found.base, found.tip)]
        zero_base, zero_tip = (0.0 if z is None else z.value_N for z in zeros)
        reach = np.asarray([0.0, float(T_base.max()) - zero_base])
        for sign in (-1, 1):
            ratio = np.exp(friction.both + sign * friction.mu_theta)
            axes.plot(
                zero_base + reach,
                zero_tip + ratio * reach,
                color=GREY,
                linestyle=(0, (4, 3)),
                linewidth=1.1,
                zorder=1.5,
            )
        keys.append(
            Line2D([], [], color=GREY, linestyle=(0, (4, 3)), linewidth=1.1, label="ratio of the branches")
        )
    axes.set_xlabel("tension at the base $T_{base}$ [N]")
    axes.set_ylabel("tension at the tip $T_{tip}$ [N]")
    legend_above(fig, keys)
    return fig


@styled
def plot_ratio(recording: Recording, found: Inspection) -> Figure:
    """T_tip/T_base of slip on both branches against the base tension, and the middle between them."""
    fig, (axes,) = figure(3.2)
    friction, phases = found.friction, found.phases
    assert recording.T_tip is not None
    zeros = [(c.zero_before or c.zero_after) for c in (found.base, found.tip)]
    base, tip = (
        T - (0.0 if z is None else z.value_N)
        for T, z in zip((recording.T_base, recording.T_tip), zeros, strict=True)
    )
    middle = phases.steps.mean(axis=1).astype(int)
    keys = []
    for phase, ratio, colour, name in (
        (PULLING, friction.pulling, BLUE, "pulling"),
        (RELEASING, friction.releasing, GREEN, "releasing"),
    ):
        own = middle[(phases.of_step == phase) & (base[middle] > friction.T_base[0]) & (tip[middle] > 0)]
        own = own[:: max(len(own) // 3000, 1)]
        axes.plot(base[own], tip[own] / base[own], ".", color=colour, alpha=0.3, markersize=3)
        axes.plot(friction.T_base, ratio, "o-", color=colour, markersize=4, linewidth=1)
        keys.append(
            Line2D([], [], color=colour, marker="o", markersize=4, label=f"{name}, median at each level")
        )
    if friction.mu_theta is not None and friction.both is not None:
        for sign in (-1, 1):
            axes.axhline(
                np.exp(friction.both + sign * friction.mu_theta), color=GREY, linestyle=(0, (4, 3)), lw=1.1
            )
        axes.axhline(np.exp(friction.both), color=GREY, linewidth=0.8)
    axes.axhline(1.0, color=INK, linewidth=0.8)
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.8), max(high, 1.25))
    _plain_ticks(axes.yaxis, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
    axes.set_xlabel("tension at the base $T_{base}$ [N]")
    axes.set_ylabel("$T_{tip}/T_{base}$ [–], log scale")
    legend_above(fig, keys)
    return fig


def _plain_ticks(axis: Axis, at: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Ticks of a logarithmic axis at these multiples of powers of ten, written out."""
    axis.set_major_locator(LogLocator(subs=at))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


@styled
def plot_steps(time: np.ndarray, found: Inspection) -> Figure:
    """How often which step of time occurs."""
    fig, (axes,) = figure(2.4)
    steps = 1e3 * np.diff(time)
    usual = 1e3 / (found.sampling.rate_Hz or 1.0)
    low, high = float(steps.min()), float(steps.max())
    uneven = high - low > EVEN * usual
    if not uneven:
        low, high = usual * 0.9, usual * 1.1
    axes.hist(np.clip(steps, low, high), bins=np.linspace(low, high, 122).tolist(), color=BLUE, log=uneven)
    keys = []
    if high > GAP * usual:
        axes.axvline(GAP * usual, color=VERMILLION, linewidth=1.2)
        keys = [Line2D([], [], color=VERMILLION, label=f"gap: {GAP:g} median steps")]
    axes.set_xlabel("step from sample to sample [ms]")
    axes.set_ylabel("samples, log scale" if uneven else "samples")
    if keys:
        legend_above(fig, keys)
    return fig


@styled
def plot_rates(recording: Recording, found: Inspection) -> Figure:
    """How fast the base tension moves, and how much each cell scatters from sample to sample at that rate."""
    fig, (rates, scatter) = figure(4.2, 2, sharex=True)
    time, steps = recording.time, found.phases.steps
    assert time is not None and recording.T_tip is not None
    spans = time[steps[:, 1]] - time[steps[:, 0]]
    able = spans > 0
    steps, spans = steps[able], spans[able]
    rate = (recording.T_base[steps[:, 1]] - recording.T_base[steps[:, 0]]) / spans
    size = np.maximum(np.abs(rate), 1e-12)
    low, high = np.percentile(size, (1, 100))
    edges = np.geomspace(max(low, 1e-4 * high), 1.01 * high, 41)
    for sign, colour, name in ((1, BLUE, "pulling"), (-1, GREEN, "releasing")):
        own = size[np.sign(rate) == sign]
        rates.hist(own, bins=edges.tolist(), color=colour, alpha=0.6, label=name)
    rates.set_ylabel("steps of tension")
    rates.legend()
    rates.set_xscale("log")
    rates.yaxis.set_major_locator(MaxNLocator(integer=True))
    at, own = _scatter(recording.T_base, recording.T_tip, steps, size, edges)
    for values, colour, cell in zip(own, (INK, VERMILLION), (found.base, found.tip), strict=True):
        end = {"T_base": "base", "T_tip": "tip"}[cell.name]
        scatter.plot(at, 1e3 * values, "o-", color=colour, markersize=4, linewidth=1, label=end)
        scatter.axhline(1e3 * cell.noise.white_N, color=colour, linestyle=(0, (1, 2)), linewidth=1)
    _plain_ticks(scatter.xaxis)
    if np.any(np.concatenate(own) > 0):
        scatter.set_yscale("log")
        _plain_ticks(scatter.yaxis)
    scatter.set_ylabel("scatter [mN], log scale")
    scatter.set_xlabel("size of the rate of the base tension [N/s], log scale")
    scatter.legend()
    return fig


def _scatter(
    T_base: np.ndarray, T_tip: np.ndarray, steps: np.ndarray, size: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Scatter from sample to sample by rate: the middles of the bins, and that of both cells in each."""
    of_sample = np.full(len(T_base), np.nan)
    lengths = steps[:, 1] - steps[:, 0]
    places = (
        np.repeat(steps[:, 0], lengths)
        + np.arange(lengths.sum())
        - np.repeat(np.concatenate([[0], np.cumsum(lengths)[:-1]]), lengths)
    )
    of_sample[places] = np.repeat(size, lengths)
    rate = of_sample[2:-1]
    bins = np.geomspace(edges[0], edges[-1], RATE_BINS + 1)
    which = np.searchsorted(bins, rate) - 1
    at, found = [], ([], [])
    thirds = third_differences(T_base), third_differences(T_tip)
    for i in range(RATE_BINS):
        own = which == i
        if np.count_nonzero(own) >= 12:
            at.append(np.sqrt(bins[i] * bins[i + 1]))
            for values, third in zip(found, thirds, strict=True):
                values.append(MAD_TO_SD * np.median(np.abs(third[own])))
    return np.asarray(at), (np.asarray(found[0]), np.asarray(found[1]))


@styled
def plot_delay(found: Inspection) -> Figure:
    """Correlation of the rates of the two cells by the lag of the tip."""
    fig, (axes,) = figure(2.4)
    delay = found.delay
    axes.plot(1e3 * delay.lags_s, delay.correlations, "o-", color=BLUE, markersize=4, linewidth=1)
    axes.axvline(0.0, color=INK, linewidth=0.8)
    if delay.seconds is not None and delay.sd_s is not None:
        at, sd = 1e3 * delay.seconds, 1e3 * delay.sd_s
        axes.axvspan(at - 2 * sd, at + 2 * sd, color=ORANGE, alpha=0.35, linewidth=0)
        axes.axvline(at, color=ORANGE, linewidth=1.5)
    axes.set_xlabel("lag of the tip behind the base [ms]")
    axes.set_ylabel("correlation of the rates [–]")
    return fig


@styled
def plot_left_out(recording: Recording, chosen: Sequence[Masked]) -> Figure:
    """Close-ups of samples that were left out, with both cells around them."""
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)
    fig = Figure(figsize=(5.2, 0.5 + 1.7 * rows), layout="constrained")
    panels = fig.subplots(rows, columns, squeeze=False).ravel()
    t, _ = clock(recording)
    for axes, m in zip(panels, chosen, strict=False):
        assert m.time is not None
        middle = int(np.searchsorted(t, m.time[0]))
        own = slice(max(middle - AROUND, 0), middle + AROUND)
        for name, colour in (("T_base", INK), ("T_tip", VERMILLION)):
            axes.plot(t[own], getattr(recording, name)[own], ".-", color=colour, markersize=3, linewidth=0.8)
        axes.plot(*_values(recording, t, [m]), "x", color=PURPLE, markersize=7, markeredgewidth=1.8)
        axes.set_title(f"{m.channel}, row {m.rows[0]}", fontsize=8, loc="left")
        axes.tick_params(labelsize=7)
        axes.locator_params(axis="x", nbins=3)
    for axes in panels[len(chosen) :]:
        axes.set_visible(False)
    fig.supxlabel("time [s]", fontsize=9, color=INK)
    fig.supylabel("tension [N]", fontsize=9, color=INK)
    return fig
