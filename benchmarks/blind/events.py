"""What happens to a rig while it is recorded and no law describes: its tip end is moved from outside, or it
is shaken so that friction lets go.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .effects import Scene
from .hand import Drive, log_uniform

# Share of the largest tension above which events happen, and time between them [s].
LOADED, APART = 0.25, 2.0


@dataclasses.dataclass(frozen=True)
class Event:
    """One event.

    Attributes:
        kind: "tip-moved" or "shaken".
        start, end: [s].
        size: of a move, thread given [m]; of a shake, the share of friction that is left.
        back: whether the tip's end comes back, at the end.
        base: share of its tension that the base loses with it, for seconds afterwards.
    """

    kind: str
    start: float
    end: float
    size: float
    back: bool
    base: float

    def feed(self, time: float) -> float:
        """Thread that the tip's end has given [m]."""
        if self.kind != "tip-moved":
            return 0.0
        if not self.back:
            return self.size * float(_rise(time, self.start, self.end))
        quick = 0.2 * (self.end - self.start)
        there = _rise(time, self.start, self.start + quick) - _rise(time, self.end - quick, self.end)
        return self.size * float(there)

    def friction(self, time: float) -> float:
        """Factor on friction."""
        if self.kind != "shaken":
            return 1.0
        edge = 0.2 * (self.end - self.start)
        loose = _rise(time, self.start, self.start + edge) - _rise(time, self.end - edge, self.end)
        return 1 - (1 - self.size) * float(loose)

    def pull(self, time: np.ndarray) -> np.ndarray:
        """Factor on the base tension."""
        return 1 - self.base * (_rise(time, self.start, self.end) - _rise(time, self.end + 1, self.end + 5))


def _rise(time, start: float, end: float):
    """From 0 to 1, smoothly."""
    way = np.clip((time - start) / (end - start), 0, 1)
    return way * way * (3 - 2 * way)


def draw(rng: np.random.Generator, drive: Drive, give: float) -> list[Event]:
    """One to three events while the tendon is loaded; fewer where it hardly is. `give` is the thread [m] that
    the whole arm takes up under the largest tension.
    """
    T, found = drive.T_base, []
    loaded = drive.time[(T > LOADED * T.max()) & (drive.time < drive.sampled[-1] - APART)]
    for _ in range(int(rng.integers(1, 4))):
        start = float(rng.choice(loaded))
        if any(abs(start - e.start) < APART + e.end - e.start for e in found):
            continue
        load = float(np.interp(start, drive.time, T) / T.max())
        if rng.random() < 0.5:
            back = bool(rng.random() < 0.4)
            lasts = rng.uniform(0.5, 2.0) if back else log_uniform(rng, 0.04, 0.4)
            # More often let go than pulled.
            size = give * load * rng.uniform(0.05, 0.3) * (1 if rng.random() < 0.75 else -0.5)
            found.append(
                Event("tip-moved", start, start + lasts, size, back, rng.uniform(0, 0.15) * np.sign(size))
            )
        else:
            lasts = log_uniform(rng, 0.05, 0.5)
            rising = float(np.interp(start, drive.time, np.gradient(T))) > 0
            sag = rng.uniform(0, 0.04) * (1 if rising else -1)
            found.append(Event("shaken", start, start + lasts, rng.uniform(0.05, 0.7), False, sag))
    return sorted(found, key=lambda e: e.start)


def happen(scene: Scene, events: list[Event]) -> None:
    """Put events into the laws of the arm; the history of its base tension has them already."""
    if any(e.kind == "shaken" for e in events):
        scene.law(friction=lambda g: np.prod([e.friction(g.time) for e in events]))
    scene.law(feed=lambda time: sum(e.feed(time) for e in events))
