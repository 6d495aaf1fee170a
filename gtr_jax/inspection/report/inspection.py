"""An inspection in words, pictures and tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtr_jax.errors import listed
from gtr_jax.numbers import measured, number
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Figure, Report, Section, Table

from ..cell import Cell
from ..findings import PROBLEM
from ..inspection import Inspection
from ..mapping import Mapping
from ..sampling import GAP
from ..slip import NAMES
from ..zero import Zero
from . import figures as draw
from .playback import inspection_playback

LISTED = 40
"""Rows of the longest table."""


def inspection_report(
    found: Sequence[Inspection],
    recordings: Sequence[Recording],
    *,
    names: Sequence[str],
    mappings: Sequence[Mapping],
) -> Report:
    """The page of one inspection or of several.

    Args:
        found: inspections.
        recordings: what was inspected, in the same order.
        names: what the recordings are called, one different from another.
        mappings: which of its columns were taken for what, of each.
    """
    several = len(found) > 1
    sections = [
        Section(
            title=name,
            verdict=own.says,
            warnings=[
                *([f"Confirm in columns.toml: {' '.join(mapping.doubts)}"] if mapping.doubts else []),
                *(f"{f.says} {f.remedy}".rstrip() for f in own.findings if f.severity == PROBLEM),
            ],
            figures=_figures(own, recording, f"-{name}" if several else ""),
            tables=[*_tables(own), _columns(mapping)],
        )
        for own, recording, name, mapping in zip(found, recordings, names, mappings, strict=True)
    ]
    playbacks = [
        inspection_playback(own, recording, named=name if several else "")
        for own, recording, name in zip(found, recordings, names, strict=True)
    ]
    if several:
        problems = [
            name
            for own, name in zip(found, names, strict=True)
            if any(f.severity == PROBLEM for f in own.findings)
        ]
        verdict = f"{len(found)} recordings: " + (
            f"look at {', '.join(problems)} before use." if problems else "no problem found in any."
        )
        return Report(title="Inspection", verdict=verdict, sections=sections, playbacks=playbacks)
    (one,) = sections
    return Report(
        title=f"{one.title}: inspection",
        verdict=one.verdict,
        warnings=one.warnings,
        figures=one.figures,
        tables=one.tables,
        playbacks=playbacks,
    )


def _columns(mapping: Mapping) -> Table:
    """Which column was taken for what."""
    rows = [(t.quantity, t.header, t.unit or "time stamps", t.why) for t in mapping.taken]
    note = f"Unused: {listed(mapping.unused)}." if mapping.unused else ""
    return Table("Columns", ("quantity", "column", "unit", "why"), rows, note=note)


def _figures(found: Inspection, recording: Recording, ending: str) -> list[Figure]:
    shown = [
        Figure(
            f"channels{ending}",
            draw.plot_channels(recording, found),
            "Both cells over time. The strip shows the phase: in pulling and releasing the tip follows the "
            "base; in transition friction holds it; at rest the base stands still, or the tendon "
            "is slack. Numbers count the pulls.",
        ),
        *_close_up(found, recording, ending),
        Figure(
            f"loop{ending}",
            draw.plot_loop(recording, found),
            "The loop. Dashed: the mean ratio of the two tensions on pull and on release.",
        ),
    ]
    if found.friction.mu_theta is not None or np.any(np.isfinite(found.friction.pulling)):
        shown.append(
            Figure(
                f"ratio{ending}",
                draw.plot_ratio(recording, found),
                "The ratio of the two tensions where the tendon slips. Friction that is the same both ways "
                "puts release as far above 1 as pull below; by Coulomb's law in a channel of fixed shape "
                "both are level.",
            )
        )
    glitches = [m for m in recording.masked if m.size == m.size and m.time is not None]
    largest = sorted(glitches, key=lambda m: -abs(m.size))[: draw.CLOSE_UPS]
    if largest:
        chosen = sorted(largest, key=lambda m: m.rows)
        shown.append(
            Figure(
                f"left-out{ending}",
                draw.plot_left_out(recording, chosen),
                f"The {len(chosen)} largest of {len(glitches)} glitches and dropouts (cross), all left out.",
            )
        )
    if recording.time is not None and found.sampling.rate_Hz is not None:
        shown.append(
            Figure(
                f"steps{ending}",
                draw.plot_steps(recording.time, found),
                "Steps from sample to sample, of the samples that were kept.",
            )
        )
        if found.cycles.rates_N_per_s:
            shown.append(
                Figure(
                    f"rates{ending}",
                    draw.plot_rates(recording, found),
                    "How fast the base tension moves (in steps of the same change of tension), and the "
                    "scatter of each cell from sample to sample at that rate. Dotted: at rest.",
                )
            )
    if found.delay.lags_s.size:
        shown.append(
            Figure(
                f"delay{ending}",
                draw.plot_delay(found),
                "The rates of the two cells, correlated where the tendon slips. The peak is the delay "
                "(band: two standard errors).",
            )
        )
    return shown


def _close_up(found: Inspection, recording: Recording, ending: str) -> list[Figure]:
    """A few cycles, where the picture of all is too dense to tell one from another."""
    if len(found.cycles.cycles) <= draw.MOST_NAMED:
        return []
    drawn = draw.plot_channels(recording, found, rows=draw.close_up(found))
    return [Figure(f"cycles{ending}", drawn, "The same, around the largest pull.")]


def _tables(found: Inspection) -> list[Table]:
    return [
        Table(
            "Findings",
            ("", "what", "what to do"),
            [(f.severity, f.says, f.remedy) for f in found.findings],
        ),
        Table(
            "What can be learnt from it",
            ("to know", "", "what it takes"),
            [(n.question, "there" if n.there else "missing", n.says) for n in found.needs],
        ),
        _sampling(found),
        _cells(found),
        _load(found),
        _cycles(found),
    ]


def _sampling(found: Inspection) -> Table:
    s = found.sampling
    rows = [("samples", str(s.samples)), ("left out", str(sum(m.samples for m in found.masked)))]
    if s.rate_Hz is not None:
        rows += [
            ("duration", number(s.duration_s, "s", 5)),
            ("rate (median)", number(s.rate_Hz, "Hz")),
            *((f"step, {p}", number(1e3 * v, "ms")) for p, v in s.step_s.items()),
            ("jitter", f"{100 * (s.jitter or 0):.2g} % of the step"),
            (f"gaps (above {GAP:g} median steps)", f"{len(s.gaps)}, {number(s.missing_s, 's', 3)} in all"),
            ("stamps that repeat", str(s.repeated)),
            ("stamps that run backwards", str(s.reversed)),
        ]
    rows.append(("delay of the tip's cell", _delay(found)))
    return Table("Sampling", ("", ""), rows)


def _delay(found: Inspection) -> str:
    late = found.delay
    if late.seconds is None or late.sd_s is None:
        return f"not determined: {late.why_not}"
    return f"{measured(1e3 * late.seconds, 1e3 * late.sd_s, 'ms')} ({late.pieces} pieces of slip)"


def _cells(found: Inspection) -> Table:
    cells = found.base, found.tip

    def row(name: str, values: Sequence[str]) -> tuple[str, ...]:
        return (name, *values)

    def stuck(cell: Cell, kind: str) -> str:
        own = getattr(cell, kind)
        return f"{len(own)}, {sum(len(s.where) for s in own)} samples" if own else "none"

    rows = [
        row("range", [f"{number(c.lowest_N, digits=3)} to {number(c.highest_N, 'N')}" for c in cells]),
        row("resolution", [number(c.resolution_N, "N", 3) if c.resolution_N else "none seen" for c in cells]),
        row("noise from sample to sample, at rest", [number(c.noise.white_N, "N", 2) for c in cells]),
        row("noise that is slower, at rest", [number(c.noise.slow_N, "N", 2) for c in cells]),
        row("noise from sample to sample, in motion", [number(c.noise.moving_N, "N", 2) for c in cells]),
        row("zero before", [_zero(c.zero_before) for c in cells]),
        row("zero after", [_zero(c.zero_after) for c in cells]),
        row(
            "drift of the zero",
            [measured(c.drift_N, c.drift_sd_N, "N") if c.drift_N is not None else "–" for c in cells],
        ),
        row("stretches at the end of the range", [stuck(c, "saturated") for c in cells]),
        row("dead stretches", [stuck(c, "dead") for c in cells]),
    ]
    note = f"Noise from: base, {found.base.noise.source}; tip, {found.tip.noise.source}."
    return Table("The cells", ("", "base", "tip"), rows, note=note)


def _zero(zero: Zero | None) -> str:
    return "–" if zero is None else measured(zero.value_N, zero.sd_N, "N")


def _load(found: Inspection) -> Table:
    load = found.cycles
    rows = [
        ("pulls", str(len(load.cycles))),
        ("of them inner loops", str(load.inner)),
        ("cycles that repeat", ", ".join(map(str, load.repeats[:LISTED])) or "none"),
        ("holds", str(len(found.holds))),
        *((f"rate of the base, {p} of the way", number(v, "N/s", 3)) for p, v in load.rates_N_per_s.items()),
        *((f"samples in {name}", f"{100 * found.phases.share(p):.3g} %") for p, name in NAMES.items()),
    ]
    friction = found.friction
    if friction.mu_theta is not None:
        rows += [
            ("apparent mu·theta", measured(friction.mu_theta, friction.mu_theta_sd)),
            ("half the sum of ln(T_tip/T_base)", measured(friction.both, friction.both_sd)),
        ]
    return Table("The load", ("", ""), rows)


def _cycles(found: Inspection) -> Table:
    heads = ("", "from [N]", "peak [N]", "to [N]", "tip at the peak [N]", "pull [N/s]", "release [N/s]", "")
    rows = [
        (
            str(i),
            *(number(v, digits=3) for v in (c.from_N, c.peak_N, c.to_N, c.tip_N)),
            *(number(v, digits=3) for v in (c.pull_N_per_s, c.release_N_per_s)),
            "inner loop" if c.inner else "",
        )
        for i, c in enumerate(found.cycles.cycles[:LISTED], 1)
    ]
    more = len(found.cycles.cycles) - LISTED
    return Table("Cycles", heads, rows, note=f"And {more} more." if more > 0 else "")
