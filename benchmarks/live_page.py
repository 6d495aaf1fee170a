"""The live page: how long after a slider was moved the new shape is there, computed and in the browser."""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import gtr_jax as gtr
from gtr_jax.app.view.histories import History, pull_and_release, recorded, usual_pull
from gtr_jax.app.view.model import Setting, simulated
from gtr_jax.app.view.postures import drawing
from gtr_jax.interpreters import python, surroundings

from .browser import chromium, found
from .speed import Metric

EXAMPLES = Path(__file__).parents[1] / "examples"
CASES = {
    "tdcm-1": [EXAMPLES / "tdcm-1.toml"],
    "580 samples": [EXAMPLES / "rig/robot.toml", EXAMPLES / "rig/monday.csv"],
    "helix": [EXAMPLES / "helix.toml"],
    "antagonists": [EXAMPLES / "antagonists.toml"],
}
TARGET = 50.0  # ms from a slider to the shape
MOVES = 30
# Moves a slider to and fro, and says how long each time it took until the new midline was drawn and until the
# new curves were: to the end of the frame that shows them.
SCRIPT = """
const [name, low, high, moves, done] = arguments
const model = name => Bokeh.documents[0].get_model_by_name(name)
const slider = model(name), watched = [model("midline"), model("samples")], took = []
let began = 0, missing = 0
function drawn(which) {
  requestAnimationFrame(() => setTimeout(() => {
    const now = performance.now() - began
    if (!isNaN(took.at(-1)[which])) return
    took.at(-1)[which] = now
    missing -= 1
    if (missing > 0) return
    if (took.length == moves) done(took); else setTimeout(move, 200)
  }))
}
function move() {
  took.push([NaN, NaN])
  missing = 2
  began = performance.now()
  slider.value = low + (high - low) * ((took.length * 7) % moves) / moves
}
watched.forEach((source, which) => source.properties.data.change.connect(() => drawn(which)))
move()
"""


def _computed(setting: Setting, history: History, name: str) -> list[float]:
    """Milliseconds that curves and drawing take for each of some values of a number."""
    value, took = float(setting.robot.value(name)), []
    for factor in np.linspace(0.8, 1.2, MOVES + 2):
        began = time.perf_counter()
        curves = simulated(setting.with_value(name, factor * value), history)
        drawing(curves, curves.largest)
        took.append(1e3 * (time.perf_counter() - began))
    return took[2:]  # the first moves compile


def _in_browser(files: list[Path], name: str, paths: tuple[str, str]) -> np.ndarray:
    """Milliseconds from moves of a slider in a browser until the new shape was drawn, and until the new
    curves were, (moves, 2).
    """
    with tempfile.TemporaryDirectory() as folder:
        command = python("-m", "gtr_jax", "view", *map(str, files), "--no-browser", "-o", f"{folder}/out")
        with subprocess.Popen(
            command, env=surroundings(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        ) as served:
            assert served.stdout is not None
            address = re.search(r"http:\S+", served.stdout.readline())
            assert address is not None
            try:
                with chromium(paths, Path(folder) / "profile") as chrome:
                    chrome.get(address[0])
                    status = "return globalThis.Bokeh?.documents[0]?.get_model_by_name('status')?.text ?? ''"
                    while "load steps" not in chrome.execute_script(status):
                        time.sleep(0.1)
                    time.sleep(2.0)
                    value = float(gtr.load_robot(files[0]).value(name))
                    took = chrome.execute_async_script(SCRIPT, name, 0.8 * value, 1.2 * value, MOVES + 2)
            finally:
                served.terminate()
    return np.asarray(took[2:], float)


def _metric(
    name: str, took: Sequence[float] | np.ndarray, note: str, target: float | None = TARGET
) -> Metric:
    spread = f"{note}; median of {len(took)} moves, the shortest {min(took):.0f} ms"
    return Metric(name, float(np.median(took)), "ms", target=target, note=spread)


def view(quick: bool) -> Iterator[Metric]:
    """A slider of `gtr view` moved: the median of some moves, as a user feels it."""
    for case, files in CASES.items():
        setting = Setting.of(gtr.load_config(files[0]))
        name = next(own for own in ("mu", "mu.left") if own in gtr.parameters_of(setting.robot))
        if len(files) > 1:
            history = recorded(setting.robot, gtr.read_recording(files[1]))
        else:
            history = pull_and_release(setting.robot, 0, usual_pull(setting.robot, 0), 0.0)
        took = _computed(setting, history, name)
        yield _metric(f"view.{case}", took, f"curves and shape, {len(history)} steps")
        if quick:
            return
        paths = found()
        if paths is not None:
            shape, rest = _in_browser(files, name, paths).T
            yield _metric(f"view.{case}.shape drawn", shape, "from the move to the end of the frame")
            yield _metric(f"view.{case}.curves drawn", rest, "the same, of the curves", None)


GROUPS = {"view": view}
