"""A recording to go through on the page of its inspection: both cells over time, and the loop."""

from __future__ import annotations

import numpy as np

from gtr_jax.plots.chart import Chart, Column, Line, Span, clock_of
from gtr_jax.plots.style import GREY, INK, ORANGE, PURPLE, VERMILLION
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import playback

from ..inspection import Inspection
from .figures import PHASES

MOST_SPANS = 200  # stretches that are told apart by colour, the longest


def inspection_playback(found: Inspection, recording: Recording, *, named: str) -> Playback:
    """The samples of a recording, with what was found of each.

    Args:
        found: what was inspected.
        recording: the same, as it was read.
        named: its name where there are several, else "".
    """
    assert recording.T_tip is not None
    across, along = clock_of(recording.time, len(recording))
    base = Column("T_base", "N", np.asarray(recording.T_base))
    tip = Column("T_tip", "N", np.asarray(recording.T_tip))
    words = np.asarray(["", *(PHASES[phase] for phase in sorted(PHASES))])[found.phases.label]
    charts = [
        Chart(
            "Tensions",
            along,
            "tension [N]",
            [Line(across, base, INK, "dashed"), Line(across, tip, VERMILLION)],
            spans=_spans(found, across.values),
        ),
        Chart(
            "Loop",
            "tension at the base [N]",
            "tension at the tip [N]",
            [Line(base, tip, GREY, "dots", phases=words)],
        ),
    ]
    ending = f"-{named}" if named else ""
    return playback(
        charts,
        clock=across,
        told=[base, tip],
        unit="sample",
        first=int(np.argmax(recording.T_base)),
        stills=[f"loop{ending}"],
        title=named,
    )


def _spans(found: Inspection, at: np.ndarray) -> list[Span]:
    """Holds, stuck readings and gaps, the longest of them, in the order of time."""
    stuck = [s.where for cell in (found.base, found.tip) for s in (*cell.saturated, *cell.dead)]
    spans = [
        *(Span(float(at[h.first]), float(at[h.last]), "hold", "", ORANGE) for h in found.holds),
        *(Span(float(at[w.first]), float(at[w.last]), "stuck", "", PURPLE) for w in stuck),
        *(
            Span(gap.start_s, gap.end_s, "gap", "", GREY)
            for gap in found.sampling.gaps
            if gap.start_s is not None and gap.end_s is not None
        ),
    ]
    longest = sorted(spans, key=lambda s: s.start - s.end)[:MOST_SPANS]
    return sorted(longest, key=lambda s: s.start)
