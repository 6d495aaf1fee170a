"""Cases of the blind benchmark: an arm, a load history, hidden effects, noise; and the key, kept apart.

Nothing of `gtr_jax` is imported here: the robot file and the recording are written as text.
"""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from .effects import CATALOGUE, CREEPING, OUTSIDE, Scene
from .machine import Arm, run

# Shares of the cases: nothing missing, one effect, two, three, and one beyond the catalogue.
SHARES = {"sound": 0.27, "single": 0.43, "pair": 0.10, "triple": 0.03, "outside": 0.17}
PROTOCOLS = ("staircase", "rich", "random")
# Of the file: relative standard deviations of E and of every dimension of the channel.
E_OFF, DIMENSION_OFF = 0.10, 0.01
OFF = ("r1", "r2", "offset", "R_max", "r_min")
# Noise of pose and displacement [m, rad].
POSE_M, POSE_RAD, DRAWN_M = 2e-4, 2e-3, 2e-5
# Steps between two samples in which the machine is marched where the cells are read at different times.
BETWEEN = 8
WITHOUT = "without.txt"  # beside a recording: the term that is left out
NASTY = ("plain", "noisy base", "heavy tails", "bad repeat", "grows with tension", "coarse")


@dataclasses.dataclass(frozen=True)
class Build:
    """A kind of robot: dimensions [mm], Young's modulus [Pa], largest base tension [N], and links of the
    machine, so many that bores and waves begin and end between two.
    """

    name: str
    length: float
    outer: tuple[float, float]
    bores: tuple[tuple[float, float, float], ...]
    routing: dict[str, float]
    E: float
    largest: float
    links: int


BUILDS = (
    Build(
        "one-bend",
        250,
        (20, 13),
        ((0, 20, 14), (80, 250, 14)),
        {"r1": -9, "r2": 9, "w1": 20, "w2": 80},
        1.5e6,
        45,
        100,
    ),
    Build(
        "two-bends",
        250,
        (20, 13),
        ((0, 70, 14), (155, 250, 14)),
        {"r1": -9, "r2": 9, "w1": 70, "w2": 155},
        1.5e6,
        45,
        100,
    ),
    Build("cone-wave", 400, (30, 15), (), {"r1": -14, "r2": 14, "w1": 200, "w2": 260}, 0.7e6, 40, 160),
    Build("cone-cross", 400, (30, 15), (), {"R_max": 20, "r_min": 8, "n_sine": 5}, 0.45e6, 35, 100),
    Build("catheter", 120, (3, 3), ((0, 120, 3),), {"offset": 2}, 40e6, 12, 60),
)


def built(build: Build, rng: np.random.Generator, mu: float) -> tuple[Arm, dict[str, float]]:
    """The arm as it came out, its dimensions off what the file will say; and its modulus and dimensions, SI,
    by the simulator's names.
    """

    def off() -> float:
        return float(1 + DIMENSION_OFF * rng.normal())

    L = build.length * 1e-3
    # Where the wave begins and ends falls between links, which the machine needs to be accurate.
    routing = {k: v * (off() if k in OFF else 1.0) for k, v in build.routing.items()}
    at_base, at_tip = (1e-3 * r * off() for r in build.outer)
    E = build.E * float(np.exp(E_OFF * rng.normal()))

    def offset(s):
        s = np.asarray(s, float)
        if "offset" in routing:
            return np.full(s.shape, 1e-3 * routing["offset"])
        if "R_max" in routing:
            envelope = routing["R_max"] + (routing["r_min"] - routing["R_max"]) * s / L
            return 1e-3 * envelope * np.sin(routing["n_sine"] * np.pi * s / L)
        w1, w2 = 1e-3 * routing["w1"], 1e-3 * routing["w2"]
        share = np.clip((s - w1) / (w2 - w1), 0, 1)
        return 1e-3 * (routing["r1"] + (routing["r2"] - routing["r1"]) * 0.5 * (1 - np.cos(np.pi * share)))

    def bore(s):
        s = np.asarray(s, float)
        found = np.zeros(s.shape)
        for start, end, diameter in build.bores:
            found = np.where((s >= 1e-3 * start) & (s < 1e-3 * end), 0.5e-3 * diameter, found)
        return found

    arm = Arm(L, lambda s: at_base + (at_tip - at_base) * s / L, bore, E, offset, mu, build.links)
    own = {"E": E, "outer_radius_base": at_base, "outer_radius_tip": at_tip}
    return arm, own | {k: 1e-3 * routing[k] for k in OFF if k in routing}


def protocol(name: str, largest: float, rng: np.random.Generator):
    """Time [s], base tension [N] and trial of a load history."""
    if name == "staircase":
        corners, steps = [0, 1, 0.12, 0.75, 0.03], (14, 14, 10, 11)
        parts = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(corners, corners[1:], steps, strict=False)]
        T = largest * np.append(np.concatenate(parts), 0.03)
        return rng.uniform(1.5, 3) * np.arange(len(T)), T, np.ones(len(T), int)
    if name == "random":
        T, time, now, at, dt = [0.0], [0.0], 0.0, 0.0, float(rng.uniform(0.4, 1.0))
        while len(T) < 110:
            goal = float(rng.uniform(0.02, 1.0))
            n = int(np.clip(abs(goal - at) * rng.uniform(10, 30), 2, 24))
            for k in range(1, n + 1):
                now += dt
                T.append(at + (goal - at) * k / n)
                time.append(now)
            at = goal
            if rng.random() < 0.25:
                for _ in range(int(rng.integers(3, 7))):
                    now += dt
                    T.append(at)
                    time.append(now)
        return np.asarray(time), largest * np.asarray(T), np.ones(len(T), int)
    T, time, trial, now = [], [], [], 0.0
    peak, low = float(rng.uniform(0.9, 1.0)), float(rng.uniform(0.05, 0.15))
    for k, (scale, dt) in enumerate(((1.0, 0.8), (1.0, 0.2), (0.6, 0.8)), start=1):
        corners = [low, peak, peak, 0.55, 0.8, 0.3, low] if k == 1 else [low, peak, peak, 0.45, 0.7, low]
        for a, b in itertools.pairwise(corners):
            n = 5 if a == b else max(4, round(26 * abs(b - a)))
            for j in range(n):
                T.append(scale * (a + (b - a) * j / n))
                time.append(now)
                trial.append(k)
                now += dt * (3 if a == b else 1)
    return np.asarray(time), largest * np.asarray(T), np.asarray(trial)


def coloured(rng: np.random.Generator, rho: float, K: int, heavy: bool) -> np.ndarray:
    """Noise of unit variance, neighbours correlated."""
    drawn = rng.standard_t(4, K) / np.sqrt(2) if heavy else rng.normal(size=K)
    found = np.empty(K)
    found[0] = drawn[0]
    for k in range(1, K):
        found[k] = rho * found[k - 1] + np.sqrt(1 - rho**2) * drawn[k]
    return found


def forces_on(scene: Scene, density: float, height: float | None):
    """Forces on the body of gravity, the tip load and a stop; None without any."""
    arm = scene.arm
    if scene.gravity is None and not any(scene.tip_force) and scene.stop is None:
        return None
    tip = np.asarray(scene.tip_force)

    def forces(shape):
        n = len(shape.directions)
        h = arm.length / n
        force, place, link = [tip], [shape.tip], [n - 1]
        if scene.stop is not None and height is not None:
            way = 1.0 if height > 0 else -1.0
            depth = max(way * shape.tip[1] - abs(height), 0.0)
            force.append(np.asarray([0.0, -way * scene.stop[0] * depth]))
            place.append(shape.tip)
            link.append(n - 1)
        force, place, link = np.asarray(force), np.asarray(place), np.asarray(link)
        if scene.gravity is not None:
            s = (np.arange(n) + 0.5) * h
            weight = density * np.pi * (arm.outer(s) ** 2 - arm.bore(s) ** 2) * h
            along = np.stack([np.cos(shape.directions), np.sin(shape.directions)], axis=1)
            force = np.concatenate([force, weight[:, None] * np.asarray(scene.gravity[:2])])
            place = np.concatenate([place, shape.joints + 0.5 * h * along])
            link = np.concatenate([link, np.arange(n)])
        return force, place, link

    return forces


def kinds(rng: np.random.Generator, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """What the cases hide: the kind of each, and its effects; singles and those outside in turn."""
    found: list[tuple[str, tuple[str, ...]]] = []
    names, strange = list(CATALOGUE), list(OUTSIDE)
    for kind, share in SHARES.items():
        n = round(share * count)
        turn = [*rng.permutation(names)] if kind != "outside" else [*rng.permutation(strange)]
        for k in range(n):
            if kind == "sound":
                hidden: tuple[str, ...] = ()
            elif kind in ("single", "outside"):
                hidden = (str(turn[k % len(turn)]),)
            else:
                hidden = several(rng, 2 if kind == "pair" else 3)
            found.append((kind, hidden))
    return found


def several(rng: np.random.Generator, n: int) -> tuple[str, ...]:
    """Names of n effects of different terms that one rig may have together."""
    while True:
        chosen = [str(c) for c in rng.permutation(list(CATALOGUE))[:n]]
        terms = {CATALOGUE[c][0] for c in chosen}
        if len(terms) == n and not {"contact", "gravity", "tip-load"} & set(chosen):
            return tuple(c for c in CATALOGUE if c in chosen)


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A recording and its key, and the term that whoever answers leaves out, if any."""

    robot: str
    rows: list[dict[str, Any]]
    key: dict[str, Any]
    without: str = ""


def make(kind: str, hidden: tuple[str, ...], rng: np.random.Generator) -> Case | None:
    """A case; None where the machine fails, so that another must be drawn."""
    heavy_loads = {"contact", "gravity", "tip-load"} & set(hidden)
    choices = [b for b in BUILDS if not (heavy_loads and b.name in ("cone-cross", "catheter"))]
    build = choices[int(rng.integers(len(choices)))]
    mu = float(np.exp(rng.uniform(np.log(0.12), np.log(0.42))))
    name = str(rng.choice(PROTOCOLS))
    timed = set(hidden) & {"viscous", "stribeck", "creep", "ageing", "jolt", "breathing", "wear", "drift"}
    if timed and name == "staircase":
        name = str(rng.choice(PROTOCOLS[1:]))
    posed = bool(rng.random() < 0.5) or bool(heavy_loads) or "stretch" in hidden
    arm, own = built(build, rng, mu)
    time, T_base, trial = protocol(name, build.largest, rng)
    down = "gravity" in hidden or (build.name in ("one-bend", "two-bends") and rng.random() < 0.1)
    scene = Scene(arm, time, T_base, trial, gravity=(0.0, -9.81, 1070.0) if down else None)
    for effect in hidden:
        drawn = OUTSIDE[effect] if kind == "outside" else CATALOGUE[effect][1]
        own_hidden, scene.hidden = scene.hidden, {}
        drawn(scene, rng)
        scene.hidden = own_hidden | {f"{effect}.{k}": v for k, v in scene.hidden.items()}
    height = None
    if scene.stop is not None:
        free = run(dataclasses.replace(scene.arm, links=build.links // 2), time, T_base)
        far = free.pose[int(np.argmax(np.abs(free.pose[:, 1]))), 1]
        height = float(scene.stop[1] * far)
        scene.hidden["contact.height_m"] = height
    forces = forces_on(scene, 1070.0, height)
    arm = scene.arm
    if forces is not None:
        arm = dataclasses.replace(arm, laws=dataclasses.replace(arm.laws, forces=forces))
    shown = run(arm, time, T_base, parts=4 if CREEPING & set(hidden) else 1)
    T_tip, worst = _late(arm, scene) if scene.late else (shown.T_tip, shown.worst)
    if not max(shown.worst, worst) < 1e-3 * build.largest or not np.all(np.isfinite([shown.T_tip, T_tip])):
        return None
    true = {"T_base": T_base, "T_tip": T_tip}
    for cell in scene.cells:
        true = cell(true)
    nasty = str(rng.choice(NASTY, p=[0.4, 0.15, 0.1, 0.1, 0.15, 0.1]))
    return _recorded(build, scene, shown, true, rng, kind, hidden, name, posed, down, nasty, mu, own)


def _late(arm: Arm, scene: Scene) -> tuple[np.ndarray, float]:
    """Tension at the tip when its cell is read [N], (K,), between the samples of the base, ahead of all that
    the cells do to it; and the error left [N].
    """
    K = len(scene.time)
    fine = np.interp(np.arange((K - 1) * BETWEEN + 1) / BETWEEN, np.arange(K), scene.time)
    shown = run(arm, fine, np.interp(fine, scene.time, scene.T_base))
    return np.interp(scene.time - scene.late, fine, shown.T_tip), shown.worst


def _recorded(build, scene, shown, true, rng, kind, hidden, name, posed, down, nasty, mu, own) -> Case:
    K, largest = len(scene.time), build.largest
    unit = largest / 45
    sd_tip = unit * float(np.exp(rng.uniform(np.log(0.02), np.log(0.08))))
    sd_base = unit * float(np.exp(rng.uniform(np.log(0.005), np.log(0.04))))
    if nasty == "noisy base":
        sd_base = unit * float(rng.uniform(0.08, 0.2))
    grain = unit * (0.05 if nasty == "coarse" else 0.01)
    scale = np.ones(K)
    if nasty == "grows with tension":
        scale = 0.4 + 1.2 * scene.T_base / largest
    if nasty == "bad repeat":
        last = scene.trial == scene.trial[-1] if scene.trial[-1] > 1 else np.arange(K) > 0.75 * K
        scale = np.where(last, 3.0, 1.0)
    heavy = nasty == "heavy tails"
    rho_tip, rho_base = float(rng.uniform(0, 0.5)), float(rng.uniform(0, 0.3))
    read = {
        "T_base": true["T_base"] + sd_base * scale * coloured(rng, rho_base, K, heavy),
        "T_tip": true["T_tip"] + sd_tip * scale * coloured(rng, rho_tip, K, heavy),
    }
    read = {k: grain * np.round(v / grain) for k, v in read.items()}
    clean = {"T_tip": true["T_tip"]}
    sds = {"T_tip": sd_tip}
    if posed:
        size = scene.arm.length / 0.25
        for k, channel in enumerate(("tip_x", "tip_y", "tip_angle")):
            sds[channel] = POSE_RAD if channel == "tip_angle" else POSE_M * size
            clean[channel] = shown.pose[:, k]
        sds["displacement"], clean["displacement"] = DRAWN_M * size, shown.drawn
    units = {"tip_x": "m", "tip_y": "m", "tip_angle": "rad", "displacement": "m"}
    rows = []
    for k in range(K):
        row = {"time_s": f"{scene.time[k]:.6g}", "T_base_N": f"{read['T_base'][k]:.4f}"}
        row |= {"T_tip_N": f"{read['T_tip'][k]:.4f}", "trial": str(int(scene.trial[k]))}
        for channel, unit_name in units.items() if posed else ():
            noisy = clean[channel][k] + sds[channel] * rng.normal()
            row[f"{channel}_{unit_name}"] = f"{noisy:.7g}"
        rows.append(row)
    terms = sorted({h if kind == "outside" else CATALOGUE[h][0] for h in hidden})
    key = {
        "kind": kind,
        "hidden": list(hidden),
        "terms": terms,
        "numbers": scene.hidden,
        "robot": build.name,
        "protocol": name,
        "pose": posed,
        "gravity": down,
        "noise": nasty,
        "mu": mu,
        "E": own["E"],
        "dimensions": {k: v for k, v in own.items() if k != "E"},
        "sd": sds,
        "sd_base": sd_base,
        "T_base": np.round(true["T_base"], 6).tolist(),
        "clean": {k: np.round(v, 8).tolist() for k, v in clean.items()},
        "newton": shown.worst,
    }
    return Case(robot_file(build, down), rows, key)


def robot_file(build: Build, down: bool) -> str:
    kind = "parallel" if "offset" in build.routing else "crossing-sine"
    kind = "straight-sine-straight" if "r1" in build.routing else kind
    bores = ", ".join(
        f'{{ from = "{a:g} mm", to = "{b:g} mm", diameter = "{d:g} mm" }}' for a, b, d in build.bores
    )
    routing = [f'{k} = "{v:g} mm"' if k != "n_sine" else f"{k} = {v:g}" for k, v in build.routing.items()]
    uncertain = [f"routing.{k}" for k in build.routing if k in OFF]
    return "\n".join(
        [
            "schema = 1",
            f'name = "{build.name}"',
            "",
            "[backbone]",
            f'length = "{build.length:g} mm"',
            f'outer_radius = ["{build.outer[0]:g} mm", "{build.outer[1]:g} mm"]   # base, tip',
            f"bores = [{bores}]",
            f'youngs_modulus = "{build.E / 1e6:g} MPa"',
            'density = "1070 kg/m^3"',
            "",
            "[routing]",
            f'kind = "{kind}"',
            *routing,
            "",
            "[tendon]",
            "friction_coefficient = 0.3",
            "",
            "[loads]",
            *(['gravity_angle = "-90 deg"   # from the base tangent'] if down else []),
            "",
            "[uncertainty]   # one standard deviation, relative",
            f"youngs_modulus = {E_OFF:g}",
            *[f'"{name}" = {DIMENSION_OFF:g}' for name in uncertain],
            f'"backbone.outer_radius.0" = {DIMENSION_OFF:g}',
            f'"backbone.outer_radius.1" = {DIMENSION_OFF:g}',
            "",
        ]
    )


def write(case: Case, folder: Path, key: Path) -> None:
    """Robot file and recording into a folder, the key elsewhere."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(case.robot, encoding="utf-8")
    if case.without:
        (folder / WITHOUT).write_text(case.without + "\n", encoding="utf-8")
    with (folder / "recording.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(case.rows[0]))
        writer.writeheader()
        writer.writerows(case.rows)
    key.parent.mkdir(parents=True, exist_ok=True)
    key.write_text(json.dumps(case.key), encoding="utf-8")
