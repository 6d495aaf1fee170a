"""Cases of the blind benchmark made as rigs make recordings: long, driven by hand or motor, with several
effects of ordinary size at once, events, and instruments as they are; and the key, kept apart.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from . import events
from .cases import BUILDS, DRAWN_M, POSE_M, POSE_RAD, Build, Case, built, robot_file
from .effects import CATALOGUE, OUTSIDE, Scene
from .hand import drive, log_uniform
from .instruments import CELLS, Read, read
from .machine import Arm, Lost, march, run

# Share of the cases in which nothing is missing; of the others with two, three and four effects; and of those
# in which one effect is none of the catalogue's.
SOUND, SEVERAL, STRANGE = 0.2, (0.5, 0.35, 0.15), 0.25
# Shares with events, and with a sheath of fixed shape where the effects allow it.
EVENTFUL, SHEATHED = 0.45, 0.6
# What the instruments always do is not an effect: to name it is not wrong, and to leave it out is not either.
ALWAYS = ("time-skew", "zero-drift", "quantisation")
# Effects whose size goes by the bend of a body, or whose place in a sheath no cell sees.
BENDING = {"stiffening", "creep", "rubbing", "entry", "anchor", "patch", "kink", "snag"}
# Not drawn: what the instruments do anyway; forces on the body, which a long march takes too long for; what
# depends on a number of samples, not on time; and what neither cell sees.
LEFT_OUT = {
    "skew",
    "tip-drift",
    "base-drift",
    "contact",
    "gravity",
    "tip-load",
    "frozen",
    "ringing",
    "stretch",
}
# One effect by algebra where the cells alone see a tendon in a sheath of fixed shape: a gain of one cell, one
# over it of the other, and friction that differs between pull and release.
TWINS = frozenset({"tip-gain", "base-gain", "friction-asymmetry"})
# Ordinary size: root mean square of what an effect alone does to both cells, as a share of the largest T_tip;
# draws of its size before the case is given up, and steps of the history on which that is looked at.
ORDINARY, TRIES, THIN = (0.005, 0.08), 8, 120
# Error that Newton's method may leave, as a share of the largest tension.
WORST = 2e-4
SHEATH = Build("sheath", 0, (2, 2), (), {"offset": 0}, 1e9, 0, 40)


def kinds(rng: np.random.Generator, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """What the cases hide: "sound" or "rig", and the effects; every effect in its turn."""
    sound = round(SOUND * count)
    numbers = 2 + rng.choice(len(SEVERAL), size=count - sound, p=SEVERAL)
    decks: dict[bool, list[str]] = {True: [], False: []}
    found: list[tuple[str, tuple[str, ...]]] = [("sound", ())] * sound
    for number in numbers.tolist():
        strange, hidden = bool(rng.random() < STRANGE), list[str]()
        while len(hidden) < number:
            deck = decks[strange and not hidden]
            if not deck:
                names = OUTSIDE if strange and not hidden else CATALOGUE
                deck += [str(n) for n in rng.permutation([n for n in names if n not in LEFT_OUT])]
            name = deck.pop()
            if {term(name)} & {t for h in hidden for t in (TWINS if term(h) in TWINS else {term(h)})}:
                decks[False].insert(0, name)
                continue
            hidden.append(name)
        found.append(("rig", tuple(n for n in (*CATALOGUE, *OUTSIDE) if n in hidden)))
    return found


def term(effect: str) -> str:
    """The catalogue's name of an effect; its own where the catalogue has none."""
    return CATALOGUE[effect][0] if effect in CATALOGUE else effect


def make(kind: str, hidden: tuple[str, ...], rng: np.random.Generator) -> Case | None:
    """A case; None where the machine fails or an effect has no ordinary size: another must be drawn."""
    sheathed = not BENDING & set(hidden) and bool(rng.random() < SHEATHED)
    if sheathed:
        build, arm, robot = sheath(rng)
    else:
        build = BUILDS[int(rng.integers(len(BUILDS)))]
        arm, _ = built(build, rng, log_uniform(rng, 0.12, 0.42))
        robot = robot_file(build, down=False)
    driven = drive(rng, build.largest)
    time = driven.sampled
    plain = Scene(arm, time, np.interp(time, driven.time, driven.T_base), np.ones(len(time), int))
    thin = _thinned(plain)
    alone = march(_coarse(arm), time[thin], plain.T_base[thin])
    happened = events.draw(rng, driven, float(np.ptp(alone.drawn))) if rng.random() < EVENTFUL else []
    T_base = plain.T_base * np.prod([e.pull(time) for e in happened], axis=0)
    scene, sizes = dataclasses.replace(plain, T_base=T_base, cells=[]), {}
    for effect in hidden:
        size = _added(scene, effect, rng, plain, thin, alone.T_tip)
        if size is None:
            return None
        sizes[effect] = size
    if happened:
        events.happen(scene, happened)
    try:
        shown = run(scene.arm, time, T_base, most=WORST * build.largest)
    except Lost:
        return None
    true = {"T_base": T_base, "T_tip": shown.T_tip}
    for cell in scene.cells:
        true = cell(true)
    done = read(rng, time, true, build.largest)
    size = arm.length / 0.25
    posed = not sheathed and bool(rng.random() < 0.4)
    others = {}
    if posed:
        others |= {f"tip_{name}_m": (shown.pose[:, k], POSE_M * size) for k, name in enumerate("xy")}
        others["tip_angle_rad"] = shown.pose[:, 2], POSE_RAD
    if not sheathed and rng.random() < 0.5:
        others["displacement_m"] = shown.drawn, DRAWN_M * size
    key = {
        "kind": kind,
        "hidden": list(hidden),
        "terms": sorted({term(h) for h in hidden if h in CATALOGUE}),
        "outside": [h for h in hidden if h in OUTSIDE],
        "always": [*ALWAYS, *(["tendon-stretch"] if sheathed else []), *_once(hidden, happened)],
        "numbers": scene.hidden,
        "sizes": sizes,
        "robot": build.name,
        "by": driven.by,
        "seconds": float(time[-1]),
        "pose": posed,
        "displacement": "displacement_m" in others,
        "mu": arm.friction,
        "events": [{"kind": e.kind, "start_s": e.start, "end_s": e.end} for e in happened],
        "spoilt": done.spoilt,
        **done.told,
        "clean": {name: np.round(values[done.kept], 6).tolist() for name, values in true.items()},
        "newton": shown.worst,
    }
    return Case(robot, _rows(done, others, rng), key)


def _once(hidden: tuple[str, ...], happened: list[events.Event]) -> list[str]:
    """Terms that describe what happens once: neither asked for nor wrong where it does."""
    if "jolt" in hidden:
        return ["shaken-sheath", "sheath-moved"]
    return ["shaken-sheath"] if any(e.kind == "shaken" for e in happened) else []


def sheath(rng: np.random.Generator) -> tuple[Build, Arm, str]:
    """A sheath of fixed shape with a tendon that stretches, and its robot file."""
    length, turned = rng.uniform(0.4, 1.5), rng.uniform(3, 12)
    build = dataclasses.replace(SHEATH, length=1e3 * length, largest=log_uniform(rng, 8, 45))
    still = lambda s: np.zeros(np.shape(s))  # noqa: E731
    arm = Arm(
        length,
        lambda s: np.full(np.shape(s), 2e-3),
        still,
        build.E,
        still,
        rng.uniform(0.25, 1.1) / turned,
        build.links,
        stiffness=log_uniform(rng, 2e3, 3e4),
        fixed=turned / length,
    )
    lines = [
        "schema = 1",
        'name = "sheath"',
        "",
        "[backbone]",
        f'length = "{build.length:.6g} mm"',
        'outer_radius = "2 mm"',
        'youngs_modulus = "1 GPa"',
        f'natural_curvature = "{turned / length:.6g} rad/m"',
        "rigid = true",
        "",
        "[routing]",
        'kind = "parallel"',
        'offset = "0 mm"',
        "",
        "[tendon]",
        "friction_coefficient = 0.1",
        "",
    ]
    return build, arm, "\n".join(lines)


def _coarse(arm: Arm) -> Arm:
    """Of half the links."""
    return dataclasses.replace(arm, links=arm.links // 2)


def _thinned(scene: Scene) -> np.ndarray:
    """Samples that are even along the way of the base tension and in time."""
    way = np.cumsum(np.abs(np.diff(scene.T_base, prepend=scene.T_base[0])))
    along = way / way[-1] + scene.time / scene.time[-1]
    return np.unique(np.searchsorted(along, np.linspace(0, along[-1], THIN)).clip(0, len(along) - 1))


def _added(scene: Scene, effect: str, rng, plain: Scene, thin: np.ndarray, T_tip: np.ndarray) -> float | None:
    """Add an effect of ordinary size to a scene; what it alone moves, or None if no draw is of such a size.
    `T_tip` [N] is without it, at the samples `thin` of the plain scene.
    """
    drawn = CATALOGUE[effect][1] if effect in CATALOGUE else OUTSIDE[effect]
    time, largest = plain.time[thin], float(T_tip.max())
    still = {"T_base": plain.T_base, "T_tip": np.interp(plain.time, time, T_tip)}
    for _ in range(TRIES):
        seed = int(rng.integers(2**32))
        own = dataclasses.replace(plain, cells=[], hidden={})
        drawn(own, np.random.default_rng(seed))
        if own.cells:
            seen = own.cells[0](still)
            change = np.hypot(*(seen[cell][thin] - still[cell][thin] for cell in CELLS))
        else:
            change = march(_coarse(own.arm), time, plain.T_base[thin]).T_tip - T_tip
        size = float(np.sqrt(np.mean(change**2))) / largest
        if ORDINARY[0] < size < ORDINARY[1]:
            before, scene.hidden = scene.hidden, {}
            drawn(scene, np.random.default_rng(seed))
            scene.hidden = before | {f"{effect}.{k}": v for k, v in scene.hidden.items()}
            return size
    return None


def _rows(done: Read, others: dict[str, tuple[np.ndarray, float]], rng) -> list[dict[str, str]]:
    """The recording as text."""
    columns = {"time_s": [f"{t:.5f}" for t in done.time.tolist()]}
    columns |= {f"{cell}_N": [f"{v:.5f}" for v in done.cells[cell].tolist()] for cell in CELLS}
    for name, (clean, sd) in others.items():
        noisy = clean[done.kept] + sd * rng.normal(size=len(done.kept))
        columns[name] = [f"{v:.6g}" for v in noisy.tolist()]
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
