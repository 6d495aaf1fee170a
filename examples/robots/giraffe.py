"""A tendon in a sheath with a load cell at each end, as its rig recorded it: what the diagnosis says of it.

`python -m examples.robots.giraffe` reads the recording where it lies, and writes docs/robots/giraffe.md with
a picture that shows none of it; one that does goes to out-robots. The recording has no licence and does not
ship.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

import calibrate
import gtr_jax as gtr
from calibrate import Diagnosis
from calibrate.diagnosis.answer.change import Change
from calibrate.diagnosis.hypotheses.hypotheses import FARTHEST
from calibrate.diagnosis.outside.episodes import WORDS
from gtr_jax.numbers import measured_quantity, quantity
from gtr_jax.plots.shape import Posture, Pressed, plot_shape
from gtr_jax.plots.style import BLUE, GREY, PALE, VERMILLION, styled

from .pages import elsewhere, interval, page, save, say, table, write

COLUMNS = "time=Time [s],T_base=data_0[gf],T_tip=data_2[gf]"
PULLED = 10.0  # N at the base, in the picture of the sheath
# Tensions of the recording in the words of a diagnosis: these stay out of the repository.
RECORDED = re.compile(r", -?[\d.]+ to -?[\d.]+ N at the base")


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


def sheath(robot: gtr.Robot) -> Figure:
    """The sheath, and what the tendon does to it while it is pulled: of the robot file alone."""
    state = gtr.equilibrium(robot, PULLED)
    pressed = Pressed("", state, gtr.channel_forces(state))
    return plot_shape(
        [Posture("sheath", state)], radius=np.asarray(robot.backbone.radius(state.s)), pressed=[pressed]
    )


def between(number: Change) -> str:
    """The 95 % interval of a number, and whether it is at an end of the values that are allowed."""
    at_end = number.after is not None and number.after in (number.lower95, number.upper95)
    return interval(number) + (" (at the end of its range)" if at_end else "")


def held_out(found: Diagnosis) -> tuple[float, float]:
    """Misfit of cycles that were not fitted, before and after [N], rms."""
    return found.held_out[0]["rms"], found.held_out[1]["rms"]


def _lines(texts: Sequence[str]) -> str:
    return "\n".join(f"- {text}" for text in texts) or "None."


def main() -> None:
    """Diagnose the recording, and write the page."""
    config = gtr.load_config(elsewhere("giraffe", "robot.toml"))
    robot = gtr.build_robot(config)
    save(sheath(robot), "giraffe-sheath")
    recording = gtr.read_recording(elsewhere("giraffe", "loadcell_measurements.csv"), COLUMNS)
    say("giraffe: diagnosis, minutes")
    found = calibrate.diagnose(config, recording, experiment=False)
    before, after = held_out(found)
    say(f"  {found.verdict}: {before:.3f} N before, {after:.3f} N after, on cycles that were not fitted")
    save(picture(found), "giraffe", shows_recording=True)
    rows = [
        [
            f"`{c.name}`",
            quantity(c.before, c.unit),
            measured_quantity(c.after, c.sd, c.unit),
            between(c),
        ]
        for c in found.parameters
    ]
    assert recording.time is not None
    seconds, length = float(np.ptp(recording.time)), config.backbone.length
    bent = float(gtr.equilibrium(robot, 0.0).angle[-1])
    write(
        "giraffe",
        page("giraffe").format(
            length=length,
            bent=bent,
            around=bent / (2 * np.pi),
            seconds=seconds,
            rate=(len(recording.time) - 1) / seconds,
            says=RECORDED.sub("", found.says),
            pulled=f"{PULLED:g}",
            farthest=FARTHEST,
            before=f"{before:.2f}",
            after=f"{after:.3f}",
            noise=f"{found.noise:.3f}",
            sets=_lines([" and ".join(f"`{name}`" for name in names) for names in found.confusion_set]),
            numbers=table(["number", "friction alone", "with what was found", "95 % interval"], rows),
            episodes=_lines(
                [
                    f"{e.start_s:.2f} to {e.end_s:.2f} s: simulated minus recorded "
                    f"{quantity(e.mean_N, 'N', 2)} in the mean, {100 * e.share:.0f} % of the misfit; "
                    f"{WORDS[e.kind]}"
                    for e in found.episodes
                ]
            ),
            left=_lines([f"{left.when}: {quantity(left.size, left.unit, 2)} rms" for left in found.left_out]),
        ),
    )


if __name__ == "__main__":
    main()
