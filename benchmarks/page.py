"""`python -m benchmarks.page`: the committed baseline as a table, results/speed.md, and what pages of the
docs show of files.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from .gate import BASELINE
from .inclusions import ROOT, fill_all
from .measure import RESULTS

PAGE = RESULTS / "speed.md"


def table(baseline: dict[str, Any]) -> str:
    """The baseline as markdown."""
    machine = baseline["machine"]
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, jax {machine['versions']['jax']}.",
        "",
        "| what | value | target | cold | date | |",
        "|---|---|---|---|---|---|",
    ]
    for name, m in baseline["metrics"].items():
        target = m.get("target")
        sign = "≤" if m["direction"] == "lower" else "≥"
        missed = target is not None and (m["value"] > target if sign == "≤" else m["value"] < target)
        cells = (
            name,
            f"{_number(m['value'])} {m['unit']}".strip(),
            "" if target is None else f"{sign} {_number(target)}" + (", missed" if missed else ""),
            "" if m.get("cold") is None else f"{m['cold']:.3g} s",
            m.get("date", machine["date"]),
            m.get("note", ""),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"


def main() -> int:
    PAGE.write_text(table(json.loads(BASELINE.read_text(encoding="utf-8"))), encoding="utf-8")
    for page in fill_all():
        print(f"written: {page.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
