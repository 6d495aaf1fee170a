"""The movie of a simulation: which steps it shows, and what it says of each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gtr_jax.numbers import number
from gtr_jax.plots.movie import FRAMES, Loop, write_movie

from .motion import moved
from .simulation_answer import SimulationAnswer


def simulation_movie(path: Path, answer: SimulationAnswer) -> None:
    """Write the movie of a simulation, GIF or MP4 by the ending of its path."""
    run, K = answer.run, len(answer.run.T_base)
    T_base, T_tip = (np.asarray(T).reshape(K, -1) for T in (run.T_base, run.T_tip))
    names = answer.robot.tendon_names or ("",)

    def says(step: int) -> str:
        base, tip = ([number(float(T), "N", 3) for T in own[step]] for own in (T_base, T_tip))
        rows = zip(names, base, tip, strict=True)
        ends = ", ".join(f"{name} {own} at the base, {far} at the tip".strip() for name, own, far in rows)
        return f"step {step + 1} of {K}: {ends}"

    body, postures, steps = moved(answer.robot, run, first=answer.top, most=FRAMES)
    write_movie(
        path,
        body,
        [posture._replace(name=says(int(k))) for k, posture in zip(steps, postures, strict=True)],
        steps=steps.tolist(),
        loop=Loop(T_base, T_tip, None if answer.several else np.asarray(answer.phases)),
        space=answer.robot.space,
    )
