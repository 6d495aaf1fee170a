"""A body in space for the page: what `turning.js` needs to draw it at several steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gtr_jax.plots.views import Posture, Strung, drawn

from .page import Scene

PLACES = 60  # along the body
STEPS = 60  # most that can be looked at
SCALE = 0.01  # mm, to which places are rounded


def scene(body: Strung, postures: Sequence[Posture], *, first: int, caption: str) -> Scene:
    """A body that can be turned, at up to STEPS steps of its history.

    Args:
        body: the body and its channels.
        postures: its shape at every step, named.
        first: the step that is shown first; it is always among those kept.
        caption: what is seen.
    """
    count = min(len(postures), STEPS)
    kept = np.unique([*np.linspace(0, len(postures) - 1, count).round().astype(int), first])
    names = [{"label": postures[k].name} for k in kept]
    body_data = in_space(body, [postures[k] for k in kept])
    steps = [name | step for name, step in zip(names, body_data["steps"], strict=True)]
    return Scene(body_data | {"first": int(np.flatnonzero(kept == first)[0]), "steps": steps}, caption)


def in_space(body: Strung, postures: Sequence[Posture]) -> dict[str, Any]:
    """What `turning.js` reads of a body in each of some postures, but for labels."""
    shapes = [drawn(body, posture, PLACES, 1) for posture in postures]
    most = max(float(np.max(shape.tension)) for shape in shapes)
    at = shapes[0].s
    section = [np.stack([np.interp(at, body.s, own[:, i]) for i in range(2)], axis=1) for own in body.offsets]
    return {
        "scale": SCALE,
        "most": float(f"{most:.3g}"),
        "names": list(body.names),
        "radius": np.round(1e3 * np.interp(at, body.s, body.radius), 3).tolist(),
        "offsets": [np.round(1e3 * own, 3).ravel().tolist() for own in section],
        "ends": [int(np.sum(at <= end * (1 + 1e-9))) for end in body.ends],
        "steps": [
            {
                "place": whole_numbers(shape.middle, SCALE),
                "left": whole_numbers(shape.left, 1e-4),
                "up": whole_numbers(shape.up, 1e-4),
                "tension": [whole_numbers(own, (most or 1.0) / 1000) for own in shape.tension],
                "markers": whole_numbers(1e3 * posture.markers, SCALE),
            }
            for posture, shape in zip(postures, shapes, strict=True)
        ],
    }


def whole_numbers(values: np.ndarray, unit: float) -> list[int]:
    """Values in whole units, flat: short in a page."""
    return np.round(np.ravel(values) / unit).astype(int).tolist()
