"""A tendon-driven arm that shares nothing with `gtr_jax`: numpy and scipy, no equation or mesh in common.

The arm is a chain of rigid links with springs at the joints. The tendon is an elastic thread that runs
straight between guides on the links; its natural length flows from segment to segment through the guides,
where friction holds the tensions apart by the turning of the thread. All is marched in time by implicit
steps: tensions T of the segments and flows v through the guides, both unknown, in one banded system. Friction
is Coulomb's, regularised: its sign is tanh(v/V), so that even a locked guide creeps a little. `Laws` is what
acts beyond that; forces on the body are found by repeating a step until they fit the shape.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_banded

# Newton's method: iterations, and change of a tension, in newtons, that is small enough.
MOST, SMALL = 40, 1e-8
# Flow at which friction is nearly whole [m/s]. At 1e-9 locked stretches creep by 30 mN of 9 N at a reversal.
CREEP = 1e-12


# Repeats of a step until the forces on the body fit its shape, and change of a bend [rad] that is small.
REPEATS, FITS = 60, 1e-9
LEAST = 1e-9


@dataclasses.dataclass(frozen=True)
class Guides:
    """What friction at the guides may depend on, (n + 1,) each but the first four.

    Attributes:
        time: since the start [s].
        cycle: way of the base tension over twice its range.
        drawn: thread drawn out at the base [m].
        dt: time step [s].
        place: arc length [m].
        flow: of the thread towards the base [m/s].
        sense: of the flow, -1 to 1.
        tension: on the base side [N].
        pressure: per length of channel [N/m].
        rested: time since the thread last slipped there [s].
        speed: of the thread in the step before [m/s].
    """

    time: float
    cycle: float
    drawn: float
    dt: float
    place: np.ndarray
    flow: np.ndarray
    sense: np.ndarray
    tension: np.ndarray
    pressure: np.ndarray
    rested: np.ndarray
    speed: np.ndarray


@dataclasses.dataclass(frozen=True)
class Shape:
    """The body bent: its joints [m], (n, 2), directions of the links [rad], (n,), and its tip [m], (2,)."""

    joints: np.ndarray
    directions: np.ndarray
    tip: np.ndarray


@dataclasses.dataclass(frozen=True)
class Laws:
    """What acts beyond Coulomb friction and linear springs.

    Attributes:
        friction: factor on the coefficient, one each.
        drag: along the channel, whatever the tension [N/m].
        entry, exit: coefficient times turning ahead of the channel and at the anchor.
        wrap: factor on the turning under a tension [N].
        give: slips [m] after which friction elements, equal shares of it, give way.
        spring: curvature [1/m] that the springs of the joints feel beyond their own, and what they remember:
            from the curvature, what was remembered, and the time step.
        remembers: how many numbers that is per joint.
        forces: on the body: from the shape, forces [N] at places [m], (m, 2) each, and the links they are on.
        feed: thread [m] that the tip's end has given since the start, of the time [s]; none: it stands still.
    """

    friction: Callable[[Guides], np.ndarray | float] | None = None
    drag: float = 0.0
    entry: float = 0.0
    exit: float = 0.0
    wrap: Callable[[np.ndarray], np.ndarray] | None = None
    give: tuple[float, ...] = ()
    spring: Callable[[np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]] | None = None
    remembers: int = 0
    forces: Callable[[Shape], tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None
    feed: Callable[[float], float] | None = None


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
        laws: what acts beyond.
        fixed: curvature of a sheath whose shape is fixed [1/m]; of a body that bends, None.
    """

    length: float
    outer: Callable[[np.ndarray], np.ndarray]
    bore: Callable[[np.ndarray], np.ndarray]
    modulus: float
    offset: Callable[[np.ndarray], np.ndarray]
    friction: float
    links: int = 200
    stiffness: float = 3e5
    laws: Laws = Laws()
    fixed: float | None = None


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
        share = np.ones(n)
        share[[0, -1]] = 0.5, 1.5  # half a link to the clamp, and half of one beyond the last joint
        self.compliance, self.width = compliance * share, h * share
        self.R = arm.offset((np.arange(n) + 0.5) * h)
        self.ends = arm.offset(np.asarray([0.0, arm.length]))
        self.fixed = None if arm.fixed is None else arm.fixed * self.width
        # The guides behind the joints: their offsets, and where they are along the link.
        self.behind = np.concatenate([[self.ends[0]], self.R[:-1]])
        self.start = np.where(np.arange(n) == 0, 0.0, -0.5 * h)
        rise = arm.offset(np.asarray([1e-6]))[0] - self.ends[0]
        self.inlet = np.arctan2(rise, 1e-6)

    def segments(self, bend: np.ndarray):
        """Of the thread across each joint: length, direction against the link before and behind, and
        lever about the joint.
        """
        x, y, dx, dy = self._across(bend)
        length, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
        return length, angle, angle - bend, (y * dx - x * dy) / length

    def lever(self, bend: np.ndarray) -> np.ndarray:
        """Of the thread across each joint, about the joint."""
        x, y, dx, dy = self._across(bend)
        return (y * dx - x * dy) / np.hypot(dx, dy)

    def _across(self, bend: np.ndarray):
        """The guide ahead of each joint, seen from the joint, and from the guide behind it."""
        half, R = 0.5 * self.h, self.R
        c, s = np.cos(bend), np.sin(bend)
        x, y = half * c - R * s, half * s + R * c
        return x, y, x - self.start, y - self.behind

    def bent(self, T: np.ndarray, bend: np.ndarray, outer: np.ndarray, extra) -> np.ndarray:
        """Bend of each joint under the tensions of the segments that cross them and outer moments, by
        Newton's method; extra gives the curvature that its spring feels beyond its own.
        """
        if self.fixed is not None:
            return self.fixed
        pull, step = self.compliance * T, 1e-7
        given = self.compliance * outer
        around = np.asarray([[0.0], [step], [-step]])
        for _ in range(30):
            bends = bend + around
            more = 0.0
            if extra is not None:
                more = self.width * np.stack([extra(kappa) for kappa in bends / self.width])
            error, above, below = bends + more - pull * self.lever(bends) - given
            change = error * 2 * step / (above - below)
            bend = bend - np.clip(change, -0.1, 0.1)
            if np.max(np.abs(change)) < 1e-13:
                break
        return bend

    def shape(self, bend: np.ndarray) -> Shape:
        """Where the joints and the tip are."""
        directions = np.cumsum(bend)
        ahead = np.full(self.n, self.h)
        ends = np.cumsum(ahead[:, None] * np.stack([np.cos(directions), np.sin(directions)], axis=1), axis=0)
        return Shape(np.concatenate([np.zeros((1, 2)), ends[:-1]]), directions, ends[-1])

    def moments(self, bend: np.ndarray, forces) -> np.ndarray:
        """Moment about each joint of forces that hang on links beyond it."""
        shape = self.shape(bend)
        force, place, link = forces(shape)
        turn = np.zeros(self.n)
        carried = np.zeros((self.n, 2))
        np.add.at(turn, link, place[:, 0] * force[:, 1] - place[:, 1] * force[:, 0])
        np.add.at(carried, link, force)
        turn, carried = (np.cumsum(x[::-1], axis=0)[::-1] for x in (turn, carried))
        return turn - shape.joints[:, 0] * carried[:, 1] + shape.joints[:, 1] * carried[:, 0]


class March:
    """A chain marched in time.

    Attributes:
        T: tensions of the segments [N].
        flow: of thread through the guides towards the base [m/s].
        bend: of the joints [rad].
        kept: natural length of thread in each segment [m].
        drawn: thread drawn out at the base [m].
        time: since the start [s].
        way: that the base tension has gone [N].
    """

    def __init__(self, arm: Arm, span: float):
        self.arm, self.chain, self.span = arm, Chain(arm), span
        n = self.chain.n
        self.T, self.flow, self.bend = np.full(n + 1, 1e-6), np.zeros(n + 1), np.zeros(n)
        rise, ahead = self.chain.ends[1] - self.chain.R[-1], 0.5 * self.chain.h
        self.last, self.last_angle = np.hypot(ahead, rise), np.arctan2(rise, ahead)
        self.place = np.append((np.arange(n) + 0.5) * self.chain.h, arm.length) - 0.5 * self.chain.h
        self.outer, self.memory = np.zeros(n), np.zeros((arm.laws.remembers, n))
        self.elements = np.zeros((len(arm.laws.give), n + 1))
        self.rested, self.flow_before = np.zeros(n + 1), np.zeros(n + 1)
        self.time = self.way = self.drawn = 0.0
        self.base = 1e-6
        for _ in range(REPEATS if arm.laws.forces else 1):
            before = self.bend
            self.bend, self.kept = self.natural(self.T, self.bend, np.inf)
            if arm.laws.forces is None:
                break
            self.outer = self.chain.moments(self.bend, arm.laws.forces)
            if np.max(np.abs(self.bend - before)) < FITS:
                break
        self._remember(np.inf)

    def natural(self, T: np.ndarray, bend: np.ndarray, dt: float):
        """Bend under tensions, and natural length that each segment then holds."""
        bend = self.chain.bent(T[:-1], bend, self.outer, self._extra(dt))
        return bend, np.append(self.chain.segments(bend)[0], self.last) / (1 + T / self.arm.stiffness)

    def slope(self, T: np.ndarray, bend: np.ndarray, held: np.ndarray, dt: float) -> np.ndarray:
        """By how much the natural length held grows with each tension."""
        step = 1e-5 * np.maximum(T[:-1], 1e-2)
        above = self.chain.bent(T[:-1] + step, bend, self.outer, self._extra(dt))
        there = np.append(self.chain.segments(above)[0], self.last)
        step = np.append(step, 1e-5)
        return (there / (1 + (T + step) / self.arm.stiffness) - held) / step

    def _extra(self, dt: float):
        spring = self.arm.laws.spring
        return None if spring is None else lambda kappa: spring(kappa, self.memory, dt)[0]

    def _remember(self, dt: float) -> None:
        spring = self.arm.laws.spring
        if spring is not None:
            self.memory = spring(self.bend / self.chain.width, self.memory, dt)[1]

    def step(self, dt: float, base: float, halvings: int = 8) -> float:
        """Go on by dt to a base tension, in parts where that is too much at once; the error left [N]."""
        forces, outer = self.arm.laws.forces, self.outer
        found = self._newton(dt, base, self.T, self.flow, self.bend)
        if forces is not None:
            moved, before = np.inf, None
            for _ in range(REPEATS):
                wanted = self.chain.moments(found[3], forces)
                change = wanted - self.outer
                # A stop pushes back: the share of the change that is taken follows how the last one answered.
                share = 1.0
                if before is not None:
                    past, was = before
                    grown = change - was
                    share = float(
                        np.clip(-(was @ grown) / max(float(grown @ grown), 1e-300), 0.02, 1.5) * past
                    )
                    share = float(np.clip(share, 0.02, 1.5))
                before = (share, change)
                self.outer = self.outer + share * change
                again = self._newton(dt, base, *found[1:4])
                moved, found = float(np.max(np.abs(again[3] - found[3]))), again
                if moved < FITS:
                    break
            if moved > 1e3 * FITS:
                found = (np.inf, *found[1:])
        if found[0] > SMALL * max(base, 1.0) and halvings:
            self.outer = outer
            middle = 0.5 * (base + self.base)
            first = self.step(0.5 * dt, middle, halvings - 1)
            return max(first, self.step(0.5 * dt, base, halvings - 1))
        error, self.T, self.flow, self.bend, self.kept = found
        self.flow_before = self.flow
        self.elements = self._mobilised(self.flow, dt)
        slipping = np.abs(self.flow) * dt > 1e-7
        self.rested = np.where(slipping, 0.0, self.rested + dt)
        self.drawn += dt * self.flow[0]
        self.way += abs(base - self.base)
        self.time += dt
        self.base = base
        self._remember(dt)
        return error

    def _mobilised(self, flow: np.ndarray, dt: float) -> np.ndarray:
        give = np.asarray(self.arm.laws.give)[:, None]
        return np.clip(self.elements + dt * flow / give, -1.0, 1.0) if len(give) else self.elements

    def _passed(self, front, flow, turning, dt):
        """Tension behind each guide, of that ahead of it."""
        laws, chain = self.arm.laws, self.chain
        z = self._mobilised(flow, dt)
        # A guide whose elements have all given way still creeps, so that the flow is known.
        sense = np.tanh(flow / CREEP) if not len(z) else 0.999 * z.mean(axis=0) + 0.001 * np.tanh(flow / 1e-6)
        turning = turning if laws.wrap is None else turning * laws.wrap(front)
        grip = self.arm.friction * turning
        if laws.friction is not None:
            pressure = front * turning / chain.h
            cycle = self.way / (2 * self.span)
            now = Guides(
                self.time + dt,
                cycle,
                self.drawn,
                dt,
                self.place,
                flow,
                sense,
                front,
                pressure,
                self.rested,
                np.abs(self.flow_before),
            )
            grip = grip * laws.friction(now)
        grip = np.concatenate([[grip[0] + laws.entry], grip[1:-1], [grip[-1] + laws.exit]])
        return np.maximum(front * np.exp(-grip * sense) - laws.drag * chain.h * sense, LEAST)

    def _newton(self, dt: float, base: float, T: np.ndarray, flow: np.ndarray, bend: np.ndarray):
        error, feed = np.inf, self.arm.laws.feed
        given = 0.0 if feed is None else (feed(self.time + dt) - feed(self.time)) / dt
        for _ in range(MOST):
            bend, held = self.natural(T, bend, dt)
            slope = self.slope(T, bend, held, dt)
            _, angle, behind, _ = self.chain.segments(bend)
            ahead = np.append(angle[1:], self.last_angle)
            turning = np.abs(np.concatenate([[angle[0] - self.chain.inlet], ahead - behind]))
            front = np.concatenate([[base], T[:-1]])
            passed = self._passed(front, flow, turning, dt)
            small = 1e-3 * CREEP + 1e-6 * np.abs(flow)
            by_flow = (
                self._passed(front, flow + small, turning, dt)
                - self._passed(front, flow - small, turning, dt)
            ) / (2 * small)
            small = 1e-6 * front + 1e-12
            by_front = (self._passed(front + small, flow, turning, dt) - passed) / small
            out = np.append(flow[1:], given)
            wrong = np.stack([T - passed, (held - self.kept) - dt * (out - flow)], axis=1)
            # Unknown in turn: the flow through a guide, and the tension behind it.
            bands = np.zeros((5, 2 * len(T)))
            at = 2 * np.arange(len(T))
            bands[2, at] = -np.minimum(by_flow, -1e-12)
            bands[1, at + 1] = 1.0
            bands[3, at[1:] - 1] = -by_front[1:]
            bands[2, at + 1] = slope
            bands[3, at] = dt
            bands[1, at[1:]] = -dt
            change = solve_banded((2, 2), bands, -wrong.ravel())
            move, pull = change[0::2], change[1::2]
            share = min(1.0, 0.5 * max(base, 1.0) / max(float(np.max(np.abs(pull))), 1e-300))
            # A flow that would turn stops first, where friction has a slope.
            moved = flow + share * move
            turns = (flow * moved < 0) & (np.abs(flow) > 2 * CREEP)
            flow, T = np.where(turns, 0.0, moved), np.maximum(T + share * pull, LEAST)
            error = float(np.max(np.abs(pull)))
            if not turns.any() and error < SMALL * max(base, 1.0):
                break
        bend, held = self.natural(T, bend, dt)
        return error, T, flow, bend, held


class Lost(ArithmeticError):
    """Newton's method leaves more than was asked for."""


def march(arm: Arm, time: np.ndarray, T_base: np.ndarray, parts: int = 1, most: float = np.inf) -> Shown:
    """Run a history of the base tension [N] over time [s], (K,) each; every step in so many parts.

    Raises `Lost` where a step leaves an error of more than `most` [N].
    """
    machine, rows = March(arm, max(float(np.ptp(T_base)), 1e-6)), []
    steps = np.diff(time, prepend=time[0] - (time[1] - time[0]))
    for dt, base in zip(steps.tolist(), np.maximum(T_base, 1e-6).tolist(), strict=True):
        start = machine.base
        ways = start + (base - start) * np.arange(1, parts + 1) / parts
        error = max(machine.step(dt / parts, way) for way in ways.tolist())
        if error > most:
            raise Lost(f"{error:.2g} N at {machine.time:.3g} s")
        shape = machine.chain.shape(machine.bend)
        rows.append((machine.T[-1], *shape.tip, shape.directions[-1], machine.drawn, error))
    table = np.asarray(rows)
    return Shown(T_base, table[:, 0], table[:, 1:4], table[:, 4], float(table[:, 5].max()))


def run(arm: Arm, time: np.ndarray, T_base: np.ndarray, parts: int = 1, most: float = np.inf) -> Shown:
    """The same of infinitely many links, extrapolated from as many as the arm has and twice as many: the
    chain's error falls as one over their number.
    """
    few, many = (
        march(dataclasses.replace(arm, links=n), time, T_base, parts, most)
        for n in (arm.links, 2 * arm.links)
    )
    return Shown(
        T_base,
        2 * many.T_tip - few.T_tip,
        2 * many.pose - few.pose,
        2 * many.drawn - few.drawn,
        max(few.worst, many.worst),
    )
