"""Where the tendon channel runs in the body: its offset from the midline, with two derivatives."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Array, Float


class Offset(NamedTuple):
    """Channel offset R [m], slope R' [-] and second derivative R'' [1/m], each (N,); with several tendons
    (tendons, N).
    """

    value: Float[Array, "*tendons N"]
    slope: Float[Array, "*tendons N"]
    second: Float[Array, "*tendons N"]
