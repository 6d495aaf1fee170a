"""What the blind benchmark hides in its recordings: one effect or more, each drawn at random.

An effect changes the machine's laws, what the arm carries, or what the cells show. Laws are not those of the
catalogue word for word: friction elements in another number, a Stribeck curve of another form, creep of two
branches, a knee of another form, filters that smooth sample by sample. The names are the catalogue's where it
has the effect; those in `OUTSIDE` it does not have.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from .machine import Arm, Guides

# Share of the whole within which a reading of a saturated cell bends over.
KNEE = 0.02


@dataclasses.dataclass
class Scene:
    """What is being built, for effects to change.

    Attributes:
        arm: the machine.
        time: of the samples [s], (K,).
        T_base: true base tension [N], (K,).
        trial: of each sample, (K,).
        gravity: acceleration [m/s^2] and density [kg/m^3] of the machine: (x, y, density), or None.
        tip_force: dead force on the tip [N].
        stop: of the tip: stiffness [N/m], height [m] and side; or None.
        late: by how much the tip's cell is read late [s].
        cells: what the cells do to the readings, in order: each gets readings by name and returns them.
        hidden: what was drawn, for the key.
    """

    arm: Arm
    time: np.ndarray
    T_base: np.ndarray
    trial: np.ndarray
    gravity: tuple[float, float, float] | None = None
    tip_force: tuple[float, float] = (0.0, 0.0)
    stop: tuple[float, float, float] | None = None
    late: float = 0.0
    cells: list[Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]] = dataclasses.field(
        default_factory=list
    )
    hidden: dict[str, Any] = dataclasses.field(default_factory=dict)

    def law(self, **changes: Any) -> None:
        """Change laws; factors on friction and on turning multiply."""
        laws = self.arm.laws
        for name in ("friction", "wrap"):
            old, new = getattr(laws, name), changes.get(name)
            if old is not None and new is not None:
                changes[name] = lambda x, old=old, new=new: old(x) * new(x)
        for name in ("drag", "entry", "exit"):
            if name in changes:
                changes[name] = changes[name] + getattr(laws, name)
        if "spring" in changes and laws.spring is not None:
            changes["spring"], changes["remembers"] = _beside(
                (laws.spring, laws.remembers), (changes["spring"], changes.get("remembers", 0))
            )
        self.arm = dataclasses.replace(self.arm, laws=dataclasses.replace(laws, **changes))

    def draw(self, name: str, value: float) -> float:
        """Keep a drawn number for the key."""
        self.hidden[name] = float(value)
        return float(value)


def _beside(first, second):
    """Two springs beside each other."""
    (one, m), (two, n) = first, second

    def both(kappa, kept, dt):
        a, b = one(kappa, kept[:m], dt), two(kappa, kept[m:], dt)
        return a[0] + b[0], np.concatenate([a[1], b[1]])

    return both, m + n


def _log(rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sign(rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _bend(scene: Scene) -> float:
    """Rough largest change of curvature [1/m]."""
    arm = scene.arm
    s = np.linspace(0, arm.length, 101)
    second = np.pi / 4 * (arm.outer(s) ** 4 - arm.bore(s) ** 4)
    return float(0.6 * scene.T_base.max() * np.mean(np.abs(arm.offset(s)) / (arm.modulus * second)))


def presliding(scene, rng):
    length = scene.draw("length_m", _log(rng, 1e-4, 2e-3))
    scene.law(give=tuple(length * np.linspace(0.2, 2.6, 7)))


def viscous(scene, rng):
    c, power = scene.draw("coefficient", _log(rng, 3, 80)), scene.draw("power", rng.uniform(0.8, 1.1))
    mu = scene.arm.friction
    scene.law(friction=lambda g: 1 + c * np.abs(g.flow) * (np.abs(g.flow) / 1e-3 + 1e-6) ** (power - 1) / mu)


def stribeck(scene, rng):
    ratio, speed = scene.draw("ratio", _log(rng, 0.08, 0.6)), scene.draw("speed_m_s", _log(rng, 1e-4, 4e-3))
    scene.law(friction=lambda g: 1 + ratio / (1 + (g.speed / speed) ** 1.5))


def pressure(scene, rng):
    share, at = scene.draw("share", rng.uniform(0.3, 1.5)), scene.draw("pressure_N_m", _log(rng, 10, 150))
    scene.law(friction=lambda g: (1 + share / (1 + np.maximum(g.pressure, 0) / at)) / (1 + 0.3 * share))


def adhesion(scene, rng):
    scene.law(drag=scene.draw("drag_N_m", _log(rng, 0.4, 10)))


def asymmetry(scene, rng):
    ratio = scene.draw("ratio", float(np.exp(_sign(rng) * _log(rng, 0.04, 0.2))))
    scene.law(friction=lambda g: 1 + (ratio - 1) * 0.5 * (1 - g.sense))


def wear(scene, rng):
    rate = scene.draw("rate", _sign(rng) * _log(rng, 0.02, 0.12))
    scene.law(friction=lambda g: 1 + rate * 6 * (1 - np.exp(-g.cycle / 6)))


def drift(scene, rng):
    total = scene.draw("over_the_recording", _sign(rng) * _log(rng, 0.05, 0.4))
    end = float(scene.time[-1])
    scene.law(friction=lambda g: 1 + total * 1.3 * (g.time / end) / (1 + 0.3 * g.time / end))


def entry(scene, rng):
    scene.law(entry=scene.draw("base", _log(rng, 0.03, 0.35)))


def anchor(scene, rng):
    scene.law(exit=scene.draw("tip", _log(rng, 0.03, 0.35)))


def patch(scene, rng):
    length = scene.arm.length
    factor = scene.draw("factor", _log(rng, 1.6, 4) if rng.random() < 0.7 else rng.uniform(0.2, 0.6))
    middle = scene.draw("middle_m", length * rng.uniform(0.15, 0.85))
    width = scene.draw("width_m", length * rng.uniform(0.08, 0.25))
    edge = 0.1 * width

    def rough(g: Guides):
        inside = np.tanh((g.place - middle + width / 2) / edge) - np.tanh(
            (g.place - middle - width / 2) / edge
        )
        return 1 + (factor - 1) * 0.5 * inside

    scene.law(friction=rough)


def clearance(scene, rng):
    share, at = scene.draw("share", _log(rng, 0.08, 0.5)), scene.draw("tension_N", _log(rng, 1, 12))
    scene.law(wrap=lambda T: 1 - share * T**2 / (T**2 + at**2))


def stretch(scene, rng):
    compliance = scene.draw("compliance_1_N", _log(rng, 3e-5, 5e-4))
    scene.arm = dataclasses.replace(scene.arm, stiffness=1 / compliance)


def stiffening(scene, rng):
    at_most = scene.draw("at_largest_bend", _log(rng, 0.08, 0.6))
    far = _bend(scene)
    k0 = far / np.arccosh(1 + at_most)
    scene.law(spring=lambda kappa, kept, dt: (kappa * (np.cosh(np.clip(kappa / k0, -5, 5)) - 1), kept))


def creep(scene, rng):
    ratio, slow = scene.draw("ratio", _log(rng, 0.06, 0.6)), scene.draw("time_s", _log(rng, 2, 60))
    times = np.asarray([slow / 2, slow * 2])[:, None]

    def branches(kappa, kept, dt):
        q, before = kept[:2], kept[2]
        share = 0.0 if np.isinf(dt) else 1 / (1 + dt / times)
        q = share * (q + 0.5 * ratio * (kappa - before))
        return q.sum(axis=0), np.concatenate([q, kappa[None]])

    scene.law(spring=branches, remembers=3)


def rubbing(scene, rng):
    ratio = scene.draw("ratio", _log(rng, 0.05, 0.5))
    wide = scene.draw("curvature", _bend(scene) * _log(rng, 0.05, 0.4))
    give = wide * np.asarray([0.3, 0.8, 1.4, 2.2])[:, None]

    def layers(kappa, kept, dt):
        z = kept[:4] + (kappa - kept[4]) / give
        z = np.clip(z, -1, 1)
        return ratio * np.mean(give * z, axis=0), np.concatenate([z, kappa[None]])

    scene.law(spring=layers, remembers=5)


def tip_load(scene, rng):
    size, way = scene.draw("size_N", _log(rng, 0.02, 0.3)), rng.uniform(-np.pi, np.pi)
    scene.hidden["way_rad"] = float(way)
    scene.tip_force = (size * np.cos(way), size * np.sin(way))


def gravity_error(scene, rng):
    assert scene.gravity is not None
    x, y, density = scene.gravity
    turn, weight = rng.normal(0, 0.5), float(np.exp(rng.normal(0, 0.2)))
    turn, weight = scene.draw("turned_rad", turn), scene.draw("weight", weight)
    c, s = np.cos(turn), np.sin(turn)
    scene.gravity = ((c * x - s * y) * weight, (s * x + c * y) * weight, density)


def contact(scene, rng):
    # `cases` sets the height, a share of where the tip goes freely.
    scene.stop = (scene.draw("stiffness_N_m", _log(rng, 20, 300)), rng.uniform(0.35, 0.85), 0.0)


def _cell(name: str, change: Callable[[np.ndarray, dict[str, np.ndarray]], np.ndarray]):
    return lambda shown: shown | {name: change(shown[name], shown)}


def _gains(scene, rng, name):
    gain = scene.draw("gain", float(np.exp(_sign(rng) * _log(rng, 0.01, 0.12))))
    scene.cells.append(_cell(name, lambda T, _: gain * T))


def base_gain(scene, rng):
    _gains(scene, rng, "T_base")


def tip_gain(scene, rng):
    _gains(scene, rng, "T_tip")


def base_offset(scene, rng):
    offset = scene.draw("offset_N", _sign(rng) * _log(rng, 0.1, 1.2))
    scene.cells.append(_cell("T_base", lambda T, _: T + offset))


def tip_offset(scene, rng):
    offset = scene.draw("offset_N", _sign(rng) * _log(rng, 0.05, 0.8))
    scene.cells.append(_cell("T_tip", lambda T, _: T + offset))


def _drifts(scene, rng, name):
    total = scene.draw("over_the_recording_N", _sign(rng) * _log(rng, 0.1, 1.0))
    way = scene.time / scene.time[-1]
    scene.cells.append(_cell(name, lambda T, _: T + total * way * (1.15 - 0.15 * way)))


def tip_drift(scene, rng):
    _drifts(scene, rng, "T_tip")


def base_drift(scene, rng):
    _drifts(scene, rng, "T_base")


def crosstalk(scene, rng):
    share = scene.draw("share", _sign(rng) * _log(rng, 0.008, 0.06))
    scene.cells.append(_cell("T_tip", lambda T, shown: T + share * shown["T_base"]))


def saturation(scene, rng):
    share = scene.draw("share_of_largest", rng.uniform(0.6, 0.95))

    def over(T, _):
        top, soft = share * T.max(), KNEE * share * T.max()
        return T - soft * np.logaddexp(0, (T - top) / soft)

    scene.cells.append(_cell("T_tip", over))


def _filtered(T, time, seconds):
    """Two equal poles."""
    steps, one, two = np.diff(time), [T[0]], [T[0]]
    for dt, now in zip(steps, T[1:], strict=True):
        share = -np.expm1(-dt / (0.5 * seconds))
        one.append(one[-1] + share * (now - one[-1]))
        two.append(two[-1] + share * (one[-1] - two[-1]))
    return np.asarray(two)


def _filters(scene, rng, name):
    seconds = scene.draw("time_s", _log(rng, 0.4, 5) * float(np.median(np.diff(scene.time))))
    scene.cells.append(_cell(name, lambda T, _: _filtered(T, scene.time, seconds)))


def tip_filter(scene, rng):
    _filters(scene, rng, "T_tip")


def base_filter(scene, rng):
    _filters(scene, rng, "T_base")


def skew(scene, rng):
    scene.late = scene.draw(
        "delay_s", _sign(rng) * _log(rng, 0.3, 2.5) * float(np.median(np.diff(scene.time)))
    )


def _hysteretic(T, force, width):
    elements = width * np.asarray([0.4, 1.0, 1.8])
    z, before, shown = np.zeros(3), T[0], []
    for now in T:
        z, before = np.clip(z + (now - before) / elements, -1, 1), now
        shown.append(now - force * z.mean())
    return np.asarray(shown)


def tip_hysteresis(scene, rng):
    force, width = scene.draw("force_N", _log(rng, 0.1, 0.8)), scene.draw("width_N", _log(rng, 1.5, 6))
    scene.cells.append(_cell("T_tip", lambda T, _: _hysteretic(T, force, width)))


def base_hysteresis(scene, rng):
    force, width = scene.draw("force_N", _log(rng, 0.15, 1.0)), scene.draw("width_N", _log(rng, 2, 10))
    scene.cells.append(_cell("T_base", lambda T, _: _hysteretic(T, force, width)))


# Beyond the catalogue.


def breathing(scene, rng):
    size, period = scene.draw("size", rng.uniform(0.15, 0.45)), float(scene.time[-1]) / rng.uniform(2.5, 7)
    start = rng.uniform(0, 2 * np.pi)
    scene.hidden["period_s"] = period
    scene.law(friction=lambda g: 1 + size * np.sin(2 * np.pi * g.time / period + start))


def snag(scene, rng):
    """The thread catches on something at one stretch of its way."""
    size, place = scene.draw("size", rng.uniform(1.0, 3.0)), rng.uniform(0.25, 0.75)
    scene.hidden["place"] = float(place)
    reach = (
        0.5
        * _bend(scene)
        * scene.arm.length
        * float(np.mean(np.abs(scene.arm.offset(np.linspace(0, scene.arm.length, 50)))))
    )
    wide = 0.12 * reach
    scene.law(friction=lambda g: 1 + size * np.exp(-(((g.drawn - place * reach) / wide) ** 2)))


def ageing(scene, rng):
    """Friction at rest grows with the time of rest, and is lost in the first slip."""
    size, slow = scene.draw("size", rng.uniform(0.4, 1.2)), scene.draw("time_s", _log(rng, 5, 40))
    scene.law(friction=lambda g: 1 + size * g.rested / (g.rested + slow))


def jolt(scene, rng):
    """Friction jumps, and jumps back."""
    factor = scene.draw("factor", float(np.exp(_sign(rng) * rng.uniform(0.25, 0.7))))
    start, end = np.sort(rng.uniform(0.15, 0.95, 2)) * scene.time[-1]
    end = max(end, start + 0.15 * scene.time[-1])
    scene.hidden["from_s"], scene.hidden["to_s"] = float(start), float(end)
    scene.law(friction=lambda g: factor if start < g.time < end else 1.0)


def kink(scene, rng):
    """A short stretch of the body gives way beyond a bend."""
    soft, far = scene.draw("softening", rng.uniform(0.5, 0.8)), _bend(scene) * rng.uniform(0.3, 0.6)
    share = rng.uniform(0.1, 0.6)
    scene.hidden["place"] = float(share)

    def gives(kappa, kept, dt):
        n = kappa.shape[-1]
        there = np.abs((np.arange(n) + 0.5) / n - share) < 0.12
        over = np.maximum(np.abs(kappa) - far, 0.0) * np.sign(kappa)
        return np.where(there, -soft * over, 0.0), kept

    scene.law(spring=gives)


def ripple(scene, rng):
    """A cell whose gain waves with the load."""
    size, period = (
        scene.draw("size_N", rng.uniform(0.25, 0.8)),
        float(scene.T_base.max()) * rng.uniform(0.06, 0.2),
    )
    scene.hidden["period_N"] = period
    scene.cells.append(_cell("T_tip", lambda T, _: T + size * np.sin(2 * np.pi * T / period)))


def frozen(scene, rng):
    """Readings of the tip that stand still for a while, again and again."""
    K = len(scene.time)
    stands = np.zeros(K, bool)
    for _ in range(int(rng.integers(4, 8))):
        start = int(rng.integers(2, K - 8))
        stands[start : start + max(4, K // 20)] = True
    scene.hidden["samples"] = int(stands.sum())

    def stuck(T, _):
        last = np.maximum.accumulate(np.where(stands, 0, np.arange(K)))
        return T[last]

    scene.cells.append(_cell("T_tip", stuck))


def ringing(scene, rng):
    """An amplifier that swings after each change, some samples long."""
    swing = scene.draw("size", rng.uniform(0.5, 1.2))
    keep, turn = rng.uniform(0.75, 0.88), rng.uniform(0.8, 1.6)
    between = np.diff(scene.time, prepend=scene.time[0])
    onward = np.exp((np.log(keep) + 1j * turn) * between / np.median(between[1:]))

    def rings(T, _):
        state, found = 0j, []
        for change, on in zip(np.diff(T, prepend=T[0]), onward, strict=True):
            state = state * on + change
            found.append(state.imag)
        return T + swing * np.asarray(found) * 0.5

    scene.cells.append(_cell("T_tip", rings))


# Names of the catalogue's terms, and what draws each: laws first, then cells in the order of the chain.
CATALOGUE: dict[str, tuple[str, Callable[[Scene, np.random.Generator], None]]] = {
    "presliding": ("presliding", presliding),
    "viscous": ("viscous-friction", viscous),
    "stribeck": ("stribeck-friction", stribeck),
    "pressure": ("pressure-dependent-friction", pressure),
    "adhesion": ("adhesion", adhesion),
    "asymmetry": ("friction-asymmetry", asymmetry),
    "wear": ("wear", wear),
    "drift": ("friction-drift", drift),
    "entry": ("local-friction", entry),
    "anchor": ("local-friction", anchor),
    "patch": ("local-friction", patch),
    "clearance": ("clearance", clearance),
    "stretch": ("tendon-stretch", stretch),
    "stiffening": ("stiffening", stiffening),
    "creep": ("viscoelastic-body", creep),
    "rubbing": ("body-hysteresis", rubbing),
    "tip-load": ("tip-load", tip_load),
    "gravity": ("gravity-error", gravity_error),
    "contact": ("contact", contact),
    "crosstalk": ("crosstalk", crosstalk),
    "tip-hysteresis": ("cell-hysteresis", tip_hysteresis),
    "base-hysteresis": ("cell-hysteresis", base_hysteresis),
    "tip-gain": ("tip-gain", tip_gain),
    "base-gain": ("base-gain", base_gain),
    "tip-offset": ("tip-offset", tip_offset),
    "base-offset": ("base-offset", base_offset),
    "tip-drift": ("zero-drift", tip_drift),
    "base-drift": ("zero-drift", base_drift),
    "tip-filter": ("low-pass", tip_filter),
    "base-filter": ("low-pass", base_filter),
    "skew": ("time-skew", skew),
    "saturation": ("saturation", saturation),
}
OUTSIDE: dict[str, Callable[[Scene, np.random.Generator], None]] = {
    "breathing": breathing,
    "snag": snag,
    "ageing": ageing,
    "jolt": jolt,
    "kink": kink,
    "ripple": ripple,
    "frozen": frozen,
    "ringing": ringing,
}
# Those that need the machine marched in finer steps of time.
CREEPING = {"viscous", "stribeck", "creep", "ageing"}
