"""The committed baseline, and the gate that compares a run with it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from . import measure
from .speed import Metric

BASELINE = Path(__file__).parent / "baseline.json"


def write_baseline(metrics: Sequence[Metric], path: Path = BASELINE) -> None:
    """Keep this run's metrics with the machine; those of groups that did not run stay as they were, with the
    date of their run.
    """
    machine = measure.machine()
    before = json.loads(path.read_text()) if path.exists() else {"metrics": {}}
    kept = {name: {"date": before["machine"]["date"]} | m for name, m in before["metrics"].items()}
    new = {
        m.name: {
            "value": float(f"{m.value:.4g}"),
            "unit": m.unit,
            "direction": m.direction,
            "tolerance": m.tolerance,
            "gated": None if m.gated is None else float(f"{m.gated:.4g}"),
            "target": m.target,
            "cold": None if m.cold is None else float(f"{m.cold:.3g}"),
            "note": m.note,
            "date": machine["date"],
        }
        for m in metrics
    }
    path.write_text(json.dumps({"machine": machine, "metrics": kept | new}, indent=1) + "\n")


def worse(metrics: Sequence[Metric], path: Path = BASELINE) -> list[str]:
    """One line for each gated metric that is worse than the baseline by more than its tolerance."""
    baseline = json.loads(path.read_text())["metrics"]
    lines = []
    for m in metrics:
        before = baseline.get(m.name, {}).get("gated")
        if m.gated is None or before is None:
            continue
        ratio = m.gated / before if m.direction == "lower" else before / m.gated
        if ratio > 1.0 + m.tolerance:
            lines.append(f"{m.name}: {ratio:.2f} times the baseline's ratio, {1 + m.tolerance:.2f} allowed")
    return lines
