"""A diagnosed recording to go through on the page: loop, course and what is left, without and with what was
missing, and the body.
"""

from __future__ import annotations

import numpy as np

from calibrate.diagnosis.answer.loop import Loop
from calibrate.diagnosis.answer.result import Diagnosis
from gtr_jax.plots.chart import clock_of
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import playback
from gtr_jax.robot.build import build_robot

from .diagnosis_channels import channels_shown
from .diagnosis_channels import named as naming
from .diagnosis_charts import diagnosis_charts, models_of
from .fit_charts import Over, channel_chart
from .fit_playback import OTHERS
from .recording_motion import Motion, motion_along


def diagnosis_playback(answer: Diagnosis, loop: Loop, *, named: str, most: int) -> Playback:
    """One recording beside the models.

    Args:
        answer: the diagnosis.
        loop: the recording.
        named: name of the recording where there are several, else "".
        most: steps at which the body is shown.
    """
    clock, along = clock_of(loop.time, loop.recorded.shape[1])
    shown = channels_shown(loop)
    charts = diagnosis_charts(answer, loop, shown, range(len(loop.pulls)), (clock, along))
    others = [c for c in range(len(loop.channels)) if c not in shown]
    motion = _motion(answer, loop)
    own = [naming(loop, c, several=bool(named)).ending for c in shown]
    return playback(
        [
            charts.loop,
            charts.course,
            charts.left,
            *(
                channel_chart(
                    loop.channels[c],
                    Over(clock, clock, along),
                    loop.recorded[c],
                    models_of(answer, loop, c),
                )
                for c in others[:OTHERS]
            ),
        ],
        clock=clock,
        told=charts.columns,
        unit="sample",
        first=0 if motion is None else int(motion.samples[motion.top]),
        body=None if motion is None else motion.body(most),
        stills=[f"{what}{o}" for what in ("loop", "time") for o in own],
        title=named,
    )


def _motion(answer: Diagnosis, loop: Loop) -> Motion | None:
    """The robot that is shown, with the numbers of this recording, moved along it; None where there is none
    or not all that drives its tendons is known.
    """
    own = [f.config for f in answer.files if f.settled and f.recording == loop.name]
    config = next(iter(own), answer.config)
    if config is None or len(loop.pulls) != len(config.strung):
        return None
    drives = [np.asarray(pull.drive) for pull in loop.pulls]
    drive = np.stack(drives, axis=1) if config.tendon_names else drives[0]
    return motion_along(build_robot(config), drive, loop.time)
