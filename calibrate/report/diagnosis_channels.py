"""Which channels of a diagnosed recording are shown, and under which names."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.answer.loop import Loop
from calibrate.inference.channels import quantity_of, words_of

# Channels shown of a recording without tip tension.
MOST = 4


def channels_shown(loop: Loop) -> list[int]:
    """Numbers of the channels that are shown: every tip tension; of others some, those that the base model
    misses by most.
    """
    tips = [c for c, name in enumerate(loop.channels) if quantity_of(name) == "T_tip"]
    if tips:
        return tips
    off = np.mean((loop.before - loop.recorded)[: loop.explained, loop.counted] ** 2, axis=1)
    sd = np.asarray([noise.sd for noise in loop.noise[: loop.explained]])
    return sorted(np.argsort(-off / sd**2)[:MOST].tolist())


class Named(NamedTuple):
    """How the figures of a channel are called: the ending of their names, and the words before captions."""

    ending: str
    whose: str


def named(loop: Loop, c: int, *, several: bool) -> Named:
    """What tells the figures of a channel from others.

    Args:
        loop: the recording.
        c: number of the channel.
        several: whether there are several recordings.
    """
    name, tendon = loop.channels[c], loop.pulls[loop.of[c]].tendon
    tip = quantity_of(name) == "T_tip"
    recording, own = [loop.name] * several, [tendon] * bool(tendon)
    said = [*recording, *(own if tip else [words_of(name).removeprefix("the ")])]
    ending = "".join(f"-{part}" for part in (*recording, *(own if tip else [name])))
    return Named(ending, f"{', '.join(said)}: " if said else "")
