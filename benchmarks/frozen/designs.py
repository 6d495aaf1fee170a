"""Frozen designs: the target that ships with the examples."""

from __future__ import annotations

import numpy as np

from .case import EXAMPLES, Answers, Case, flattened

LEFT_OUT = ("seconds", "evaluations", "settled", "lanes")


def designed(robot: str, target: str) -> Answers:
    """Everything that `design.json` holds in numbers, and the verdict."""
    import design

    found = design.optimise(EXAMPLES / robot, EXAMPLES / target)
    data = found.to_json()
    kept = flattened(data, LEFT_OUT)
    kept["verdict"] = np.asarray(data["verdict"])
    kept["bindings"] = np.asarray([b["name"] for b in data["binding"]], dtype=str)
    return kept


def cases() -> list[Case]:
    """All designs."""
    floors = {"verification.*": 1e-6}
    return [Case("design", "s-bend", lambda: designed("tdcm-1.toml", "tdcm-1-target.toml"), 1e-6, floors)]
