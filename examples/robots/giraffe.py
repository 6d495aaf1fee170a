"""A tendon in a sheath with a load cell at each end, as its rig recorded it: what the diagnosis says of it.

`python -m examples.robots.giraffe` reads the recording where it lies, and writes docs/robots/giraffe.md, and
a picture into out-robots. The recording has no licence and does not ship.
"""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

import calibrate
import gtr_jax as gtr
from calibrate import Diagnosis
from gtr_jax.files.numbers import measured_quantity, quantity
from gtr_jax.plots.style import BLUE, GREY, PALE, VERMILLION, styled

from .pages import elsewhere, interval, page, save, say, table, write

COLUMNS = "time=Time [s],T_base=data_0[gf],T_tip=data_2[gf]"


@styled
def picture(found: Diagnosis) -> Figure:
    """The recording over time, before and after, and what is left of it."""
    loop = found.loops[0]
    assert loop.time is not None
    fig = Figure(figsize=(9.6, 5.6), layout="constrained")
    top, below = fig.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    top.plot(loop.time, loop.recorded[0], color=VERMILLION, lw=2.5, label="recorded")
    top.plot(loop.time, loop.before[0], color=GREY, lw=1, label="friction alone")
    top.plot(loop.time, loop.after[0], color=BLUE, lw=1, label="with what was found")
    below.plot(loop.time, loop.before[0] - loop.recorded[0], color=GREY, lw=0.8)
    below.plot(loop.time, loop.after[0] - loop.recorded[0], color=BLUE, lw=0.8)
    for left in found.left_out:
        if left.start_s is not None and left.end_s is not None:
            for at in (top, below):
                at.axvspan(left.start_s, left.end_s, color=PALE, zorder=0)
    top.set_ylabel("tension at the tip [N]")
    below.set_ylabel("simulated − recorded [N]")
    below.set_xlabel("time [s]; grey: left out")
    top.legend(loc="upper left")
    return fig


def held_out(found: Diagnosis) -> tuple[float, float]:
    """Misfit of cycles that were not fitted, before and after [N], rms."""
    return found.held_out[0]["rms"], found.held_out[1]["rms"]


def _lines(texts: Sequence[str]) -> str:
    return "\n".join(f"- {text}" for text in texts) or "None."


def main() -> None:
    """Diagnose the recording, and write the page."""
    config = gtr.load_config(elsewhere("giraffe", "robot.toml"))
    recording = gtr.read_recording(elsewhere("giraffe", "loadcell_measurements.csv"), COLUMNS)
    say("giraffe: diagnosis, two minutes")
    found = calibrate.diagnose(config, recording, experiment=False)
    before, after = held_out(found)
    say(f"  {found.verdict}: {before:.3f} N before, {after:.3f} N after, on cycles that were not fitted")
    save(picture(found), "giraffe", shows_recording=True)
    rows = [
        [
            f"`{c.name}`",
            quantity(c.before, c.unit),
            measured_quantity(c.after, c.sd, c.unit),
            interval(c),
        ]
        for c in found.parameters
    ]
    write(
        "giraffe",
        page("giraffe").format(
            says=found.says,
            before=f"{before:.2f}",
            after=f"{after:.3f}",
            noise=f"{found.noise:.3f}",
            sets=_lines([" and ".join(f"`{name}`" for name in names) for names in found.confusion_set]),
            numbers=table(["number", "friction alone", "with what was found", "95 % interval"], rows),
            episodes=_lines([episode.says for episode in found.episodes]),
            left=_lines([left.why for left in found.left_out]),
        ),
    )


if __name__ == "__main__":
    main()
