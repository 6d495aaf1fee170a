"""What the diagnosis says of labelled recordings: `python -m benchmarks.labelled FOLDER [CASE ...]`.

FOLDER holds a folder for each case: robot.toml, recording.csv and truth.json. The diagnosis was developed on
such recordings: this is not a proof of it, but shows what a change of it does.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import calibrate
import gtr_jax as gtr
from gtr_jax.cache import enable_cache

ELSEWHERE = {
    "point-friction-base": "local-friction",
    "point-friction-tip": "local-friction",
    "patch-friction": "local-friction",
}
COLUMNS = (
    *("case", "samples", "truth", "√Δχ² left", "verdict", "named, or set", "μ before → after (truth)"),
    *("held out [N]", "s"),
)


def row(folder: Path) -> tuple[bool, str]:
    """Whether the verdict is right, and a line of the table."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    robot, recording = gtr.load_config(folder / "robot.toml"), gtr.read_recording(folder / "recording.csv")
    began = time.perf_counter()
    found = calibrate.diagnose(robot, recording, experiment=False)
    took = time.perf_counter() - began
    effects = {str(ELSEWHERE.get(name, name)) for name in truth["effects"]}
    sets = [set(s) for s in found.confusion_set]
    if not effects:
        right = found.verdict == "adequate"
    elif any(name.startswith("strange") for name in effects):
        right = found.verdict == "unexplained"
    else:
        right = effects in sets
    mu = found.parameters[0]
    held = " → ".join(f"{h['rms']:.3f}" for h in found.held_out)
    said = " or ".join(" + ".join(sorted(s)) for s in sets) or "–"
    left = truth.get("sqrt_delta_chi2")
    cells = (
        folder.name,
        str(len(recording)),
        " + ".join(sorted(effects)) or "sound",
        "–" if left is None else f"{left:.1f}",
        ("" if right else "✗ ") + found.verdict,
        said,
        f"{mu.before:.3f} → {mu.after:.3f} ({truth['mu']:.3f})",
        held,
        f"{took:.0f}",
    )
    return right, "| " + " | ".join(cells) + " |"


def main(arguments: list[str]) -> None:
    """Print the table."""
    enable_cache()
    root, chosen = Path(arguments[0]), arguments[1:]
    folders = sorted(f for f in root.iterdir() if (f / "truth.json").exists())
    folders = [f for f in folders if not chosen or f.name in chosen]
    print(f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS), sep="\n", flush=True)
    right = 0
    for folder in folders:
        good, line = row(folder)
        right += good
        print(line, flush=True)
    print(f"\n{right} of {len(folders)} as they should be.", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
