"""A tendon-driven arm that shares nothing with `gtr_jax`: numpy and scipy, no equation or mesh in common.

The arm is a chain of rigid links with springs at the joints. The tendon is an elastic thread that runs
straight between guides on the links; its natural length flows from segment to segment through the guides,
where friction holds the tensions apart by the turning of the thread. All is marched in time by implicit
steps: tensions T of the segments and flows v through the guides, both unknown, in one banded system. Friction
is Coulomb's, regularised: its sign is tanh(v/V), so that even a locked guide creeps a little.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_banded

# Newton's method: iterations, and change of a tension, in newtons, that is small enough.
MOST, SMALL = 40, 1e-8
# Flow at which friction is nearly whole [m/s]: far below any that matters.
CREEP = 1e-9


@dataclasses.dataclass(frozen=True)
class Arm:
    """What is built.

    Attributes:
        length: [m].
        outer: outer radius [m] at arc length s.
        bore: bore radius [m] at arc length s.
        modulus: Young's [Pa].
        offset: of the thread's channel from the midline [m] at arc length s.
        friction: coefficient [-].
        links: how many; edges of bores and channel should fall between them.
        stiffness: of the thread, force per strain [N].
    """

    length: float
    outer: Callable[[np.ndarray], np.ndarray]
    bore: Callable[[np.ndarray], np.ndarray]
    modulus: float
    offset: Callable[[np.ndarray], np.ndarray]
    friction: float
    links: int = 200
    stiffness: float = 3e5


@dataclasses.dataclass(frozen=True)
class Shown:
    """What ideal instruments show, one row per time.

    Attributes:
        T_base, T_tip: tensions [N], (K,).
        pose: of the tip [m, m, rad], (K, 3).
        drawn: thread drawn out at the base [m], (K,).
        worst: largest error that Newton's method left [N].
    """

    T_base: np.ndarray
    T_tip: np.ndarray
    pose: np.ndarray
    drawn: np.ndarray
    worst: float


class Chain:
    """The arm's joints, springs and guides."""

    def __init__(self, arm: Arm):
        n, h = arm.links, arm.length / arm.links
        self.n, self.h, self.arm = n, h, arm
        joint = np.arange(n) * h
        around = np.clip(joint[:, None] + h * np.linspace(-0.5, 0.5, 5), 0, arm.length)
        second = np.pi / 4 * (arm.outer(around) ** 4 - arm.bore(around) ** 4)
        compliance = np.mean(1 / (arm.modulus * second), axis=1) * h
        compliance[[0, -1]] *= 0.5, 1.5  # half a link to the clamp, and half of one beyond the last joint
        self.compliance = compliance
        self.R = arm.offset((np.arange(n) + 0.5) * h)
        self.ends = arm.offset(np.asarray([0.0, arm.length]))
        rise = arm.offset(np.asarray([1e-6]))[0] - self.ends[0]
        self.inlet = np.arctan2(rise, 1e-6)

    def segments(self, bend: np.ndarray):
        """Of the thread across each joint: length, direction against the link before and behind, and
        lever about the joint.
        """
        h, R = self.h, self.R
        before = np.concatenate([[self.ends[0]], R[:-1]])
        start = np.where(np.arange(self.n) == 0, 0.0, -0.5 * h)
        c, s = np.cos(bend), np.sin(bend)
        x, y = 0.5 * h * c - R * s, 0.5 * h * s + R * c  # the guide behind, seen from the joint
        dx, dy = x - start, y - before
        length = np.hypot(dx, dy)
        angle = np.arctan2(dy, dx)
        lever = (y * dx - x * dy) / length
        return length, angle, angle - bend, lever

    def bent(self, T: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """Bend of each joint under the tensions of the segments that cross them, by Newton's method."""
        for _ in range(30):
            error = bend - self.compliance * T * self.segments(bend)[3]
            step = 1e-7
            slope = 1 - self.compliance * T * (
                self.segments(bend + step)[3] - self.segments(bend - step)[3]
            ) / (2 * step)
            change = error / slope
            bend = bend - change
            if np.max(np.abs(change)) < 1e-13:
                break
        return bend


class March:
    """A chain marched in time.

    Attributes:
        T: tensions of the segments [N].
        flow: of thread through the guides towards the base [m/s].
        bend: of the joints [rad].
        kept: natural length of thread in each segment [m].
        drawn: thread drawn out at the base [m].
    """

    def __init__(self, arm: Arm):
        self.arm, self.chain = arm, Chain(arm)
        n = self.chain.n
        self.T, self.flow, self.bend = np.full(n + 1, 1e-6), np.zeros(n + 1), np.zeros(n)
        rise, ahead = self.chain.ends[1] - self.chain.R[-1], 0.5 * self.chain.h
        self.last, self.last_angle = np.hypot(ahead, rise), np.arctan2(rise, ahead)
        self.bend, self.kept, _ = self.natural(self.T, self.bend)
        self.drawn = 0.0

    def natural(self, T: np.ndarray, bend: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bend under tensions, natural length that each segment then holds, and its slope with them."""
        chain, K = self.chain, self.arm.stiffness
        bend = chain.bent(T[:-1], bend)
        step = 1e-5 * np.maximum(T[:-1], 1e-2)
        above = chain.bent(T[:-1] + step, bend)
        here = np.append(chain.segments(bend)[0], self.last)
        there = np.append(chain.segments(above)[0], self.last)
        step = np.append(step, 1e-5)
        held = here / (1 + T / K)
        return bend, held, (there / (1 + (T + step) / K) - held) / step

    def step(self, dt: float, base: float, halvings: int = 8) -> float:
        """Go on by dt to a base tension, in parts where that is too much at once; the error left [N]."""
        found = self._newton(dt, base)
        if found[0] > SMALL * max(base, 1.0) and halvings:
            middle = 0.5 * (base + self.base)
            first = self.step(0.5 * dt, middle, halvings - 1)
            return max(first, self.step(0.5 * dt, base, halvings - 1))
        error, self.T, self.flow, self.bend, self.kept = found
        self.drawn += dt * self.flow[0]
        self.base = base
        return error

    base = 1e-6

    def _newton(self, dt: float, base: float):
        T, flow, bend, error = self.T, self.flow, self.bend, np.inf
        for _ in range(MOST):
            bend, held, slope = self.natural(T, bend)
            _, angle, behind, _ = self.chain.segments(bend)
            ahead = np.append(angle[1:], self.last_angle)
            turning = np.abs(np.concatenate([[angle[0] - self.chain.inlet], ahead - behind]))
            grip = self.arm.friction * turning
            sign = np.tanh(flow / CREEP)
            front = np.concatenate([[base], T[:-1]])
            passed = front * np.exp(-grip * sign)
            out = np.append(flow[1:], 0.0)
            wrong = np.stack([T - passed, (held - self.kept) - dt * (out - flow)], axis=1)
            # Unknown in turn: the flow through a guide, and the tension behind it.
            bands = np.zeros((5, 2 * len(T)))
            at = 2 * np.arange(len(T))
            bands[2, at] = passed * grip * (1 - sign**2) / CREEP
            bands[1, at + 1] = 1.0
            bands[3, at[1:] - 1] = -np.exp(-grip[1:] * sign[1:])
            bands[2, at + 1] = slope
            bands[3, at] = dt
            bands[1, at[1:]] = -dt
            change = solve_banded((2, 2), bands, -wrong.ravel())
            move, pull = change[0::2], change[1::2]
            share = min(1.0, 0.5 * max(base, 1.0) / max(float(np.max(np.abs(pull))), 1e-300))
            # A flow that would turn stops first, where friction has a slope.
            moved = flow + share * move
            turns = (flow * moved < 0) & (np.abs(flow) > 2 * CREEP)
            flow, T = np.where(turns, 0.0, moved), np.maximum(T + share * pull, 1e-9)
            error = float(np.max(np.abs(pull)))
            if not turns.any() and error < SMALL * max(base, 1.0):
                break
        bend, held, _ = self.natural(T, bend)
        return error, T, flow, bend, held


def march(arm: Arm, time: np.ndarray, T_base: np.ndarray) -> Shown:
    """Run a history of the base tension [N] over time [s], (K,) each."""
    machine, rows = March(arm), []
    steps = np.diff(time, prepend=time[0] - (time[1] - time[0]))
    for dt, base in zip(steps.tolist(), np.maximum(T_base, 1e-6).tolist(), strict=True):
        error = machine.step(dt, base)
        phi, h = np.cumsum(machine.bend), machine.chain.h
        tip = h * np.sum(np.cos(phi)), h * np.sum(np.sin(phi)), phi[-1]
        rows.append((machine.T[-1], *tip, machine.drawn, error))
    table = np.asarray(rows)
    return Shown(T_base, table[:, 0], table[:, 1:4], table[:, 4], float(table[:, 5].max()))


def run(arm: Arm, time: np.ndarray, T_base: np.ndarray) -> Shown:
    """The same of infinitely many links, extrapolated from as many as the arm has and twice as many: the
    chain's error falls as one over their number.
    """
    few, many = (march(dataclasses.replace(arm, links=n), time, T_base) for n in (arm.links, 2 * arm.links))
    return Shown(
        T_base,
        2 * many.T_tip - few.T_tip,
        2 * many.pose - few.pose,
        2 * many.drawn - few.drawn,
        max(few.worst, many.worst),
    )
