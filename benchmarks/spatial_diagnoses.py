"""`python -m benchmarks.spatial_diagnoses -o FOLDER`: diagnoses in space, and of robots of several tendons.

Three robots: a helical tendon in a soft arm, recorded by an independent simulator (`spatial_machine.py`)
whose load cells may be wrong; a pair of tendons in one plane, and three tendons in space, recorded by this
simulator on another mesh. Friction and modulus are drawn at random and not told, and nothing, or one effect,
is hidden. Tensions, displacements and the tip's place are recorded, all with noise. The run resumes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import calibrate
import gtr_jax as gtr
from gtr_jax.atomic_write import write_atomically
from gtr_jax.config.config import parse_config

from .spatial_fits import DRAWN, FORCE, LENGTH, OUTER_RADIUS, PLACE
from .spatial_machine import Arms
from .spatial_machine import simulate as simulate_arms

RESULTS = Path(__file__).parent / "results/spatial_diagnoses.md"
LINKS, MESH, SAMPLES, STEP_S = 120, 1.37, 90, 0.5
# What is hidden: ranges of the size, of either sign where the second number is True.
OF_CELLS = {
    "crosstalk": ("share", (0.02, 0.04), False),
    "tip-gain": ("gain", (1.04, 1.08), False),
    "tip-offset": ("force", (0.1, 0.3), True),
}
OF_ROBOTS = {
    "friction-asymmetry": ("ratio", (1.15, 1.4), False),
    "stiffening": ("coefficient", (0.004, 0.02), False),
    "tip-load": ("y", (0.05, 0.15), True),
    "crosstalk": OF_CELLS["crosstalk"],
}
HIDDEN = {"helix": OF_CELLS, "pair": OF_ROBOTS, "three": OF_ROBOTS}


def cases(each: int, sound: int) -> list[tuple[str, str]]:
    """Robot and what is hidden, "" for nothing, of every case: of each robot so many sound ones, and so many
    of every effect.
    """
    return [
        (robot, effect)
        for robot, hidden in HIDDEN.items()
        for effect in [*([""] * sound), *(name for name in hidden for _ in range(each))]
    ]


def robot_file(robot: str) -> dict[str, Any]:
    """A robot as its file says, with friction and modulus that are only roughly right."""
    body = {"length": LENGTH, "outer_radius": OUTER_RADIUS, "youngs_modulus": 1.2e6, "poissons_ratio": 0.4}
    said: dict[str, Any] = {"schema": 1, "name": robot, "backbone": body}
    if robot == "helix":
        said["routing"] = {"kind": "helix", "radius": 0.008, "turns": 0.9, "start_angle": 0.7}
        return said | {"tendon": {"friction_coefficient": 0.25}}
    if robot == "pair":
        del body["poissons_ratio"]
        routings = {
            "left": {"kind": "parallel", "offset": 0.008},
            "right": {"kind": "parallel", "offset": -0.008},
        }
    else:
        angles = dict(zip("abc", np.radians([0.0, 120.0, 240.0]).tolist(), strict=True))
        routings = {n: {"kind": "straight", "radius": 0.008, "angle": a} for n, a in angles.items()}
    said["tendons"] = [
        {"name": name, "friction_coefficient": 0.25, "preload": 0.5, "routing": routing}
        for name, routing in routings.items()
    ]
    return said


def history(tendons: int, rng: np.random.Generator) -> np.ndarray:
    """Base tensions [N], (SAMPLES, tendons): each tendon is pulled and released about twice, one after the
    other.
    """
    way = np.linspace(0.0, 2.5 * 2 * np.pi, SAMPLES)
    phases = 2 * np.pi * np.arange(tendons) / tendons
    top = rng.uniform(3.5, 5.0, tendons) * (1.6 if tendons == 1 else 1.0)
    rising = np.minimum(way / 2.0, 1.0)[:, None]
    return 0.5 + 0.5 * top * (1 - np.cos(way[:, None] - phases)) * rising


def record(robot: str, effect: str, seed: int) -> tuple[gtr.RobotConfig, dict[str, np.ndarray]]:
    """The robot file of a case, and the columns of its recording."""
    rng = np.random.default_rng(seed)
    config = parse_config(robot_file(robot), source="robot.toml")
    tendons = max(len(config.tendon_names), 1)
    T, time_s = history(tendons, rng), STEP_S * np.arange(SAMPLES)
    E, mu = 1.2e6 * np.exp(0.1 * rng.normal()), rng.uniform(0.15, 0.35, tendons)
    size = 0.0
    if effect:
        name, (low, high), either = HIDDEN[robot][effect]
        size = rng.uniform(low, high) * (rng.choice([-1.0, 1.0]) if either else 1.0)
        effect = f"{effect}.{name}"
    if robot == "helix":
        numbers = {"length": LENGTH, "outer_radius": OUTER_RADIUS, "inner_radius": 0.0, "E": E, "nu": 0.4}
        numbers |= {"radius": 0.008, "turns": 0.9, "start_angle": 0.7, "mu": mu[0]}
        run = simulate_arms(Arms(**{k: np.array([v]) for k, v in numbers.items()}), T, LINKS)
        tip = {
            "": run.T_tip,
            "crosstalk.share": run.T_tip + size * T,
            "tip-gain.gain": run.T_tip * size,
            "tip-offset.force": run.T_tip + size,
        }[effect][:, 0]
        made = {"T_base": T[:, 0], "T_tip": tip, "displacement": run.displacement[:, 0]}
        place = run.tip[:, 0]
    else:
        true = {"E": E} | {f"mu.{n}": m for n, m in zip(config.tendon_names, mu, strict=True)}
        model = gtr.build_robot(config, resolution=MESH)
        run = gtr.simulate(model.with_values(**true, **({effect: size} if effect else {})), T, time=time_s)
        if not np.all(run.converged):
            raise RuntimeError(f"{robot} with {effect} of {size:g}: a step did not converge")
        made = {
            "T_base": T,
            "T_tip": np.asarray(run.reading.T_tip),
            "displacement": np.asarray(run.displacement),
        }
        place = np.asarray(run.tip_position)
    noise = {"T_base": FORCE, "T_tip": FORCE, "displacement": DRAWN}
    columns = {name: rows + noise[name] * rng.normal(size=rows.shape) for name, rows in made.items()}
    read = place + PLACE * rng.normal(size=place.shape)
    axes = "xyz" if config.in_space else "xy"
    return config, {"time": time_s} | columns | {f"tip_{axis}": read[:, i] for i, axis in enumerate(axes)}


def answer(own: Path, robot: str, effect: str, seed: int) -> dict[str, Any]:
    """Record a case and diagnose it."""
    config, columns = record(robot, effect, seed)
    own.mkdir(parents=True, exist_ok=True)
    gtr.write_recording(own / "recording.csv", columns, tendons=config.tendon_names)
    gtr.dump_config(config, own / "robot.toml")
    recording = gtr.read_recording(own / "recording.csv", space=True, tendons=config.tendon_names)
    began = time.process_time()
    found = calibrate.diagnose(config, recording, experiment=False)
    return {
        "robot": robot,
        "hidden": effect,
        "verdict": found.verdict,
        "says": found.says,
        "named": found.named,
        "set": found.confusion_set,
        "seconds": time.process_time() - began,
    }


def scored(a: dict[str, Any]) -> str:
    """How an answer stands to the truth."""
    if not a["hidden"]:
        return "adequate" if a["verdict"] == "adequate" else "false alarm"
    if a["named"] == [a["hidden"]]:
        return "named"
    if any(a["hidden"] in names for names in a["set"]):
        return "in a set"
    return "missed" if a["verdict"] == "adequate" else "unexplained" if not a["named"] else "wrong"


def page(answers: list[dict[str, Any]], seed: int) -> str:
    """The table, in Markdown."""
    seconds = [a["seconds"] for a in answers]
    lines = [
        f"Seed {seed}; {len(answers)} recordings of {SAMPLES} samples. CPU time of a diagnosis: median "
        f"{np.median(seconds):.0f} s, most {max(seconds):.0f} s (the first of each robot compiles).",
        "",
        "| robot | hidden | cases | adequate | named exactly | in a set | missed | unexplained | wrong |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for robot, hidden in HIDDEN.items():
        for effect in ("", *hidden):
            mine = [scored(a) for a in answers if (a["robot"], a["hidden"]) == (robot, effect)]
            kinds = ("adequate", "named", "in a set", "missed", "unexplained", "wrong")
            counts = " | ".join(str(mine.count(kind)) for kind in kinds)
            if mine:
                lines.append(f"| {robot} | {effect or 'nothing'} | {len(mine)} | {counts} |")
    return "\n".join(lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Make the recordings, diagnose them, print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.spatial_diagnoses", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of recordings and answers")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sound", type=int, default=3, help="sound recordings of each robot")
    parser.add_argument("--each", type=int, default=1, help="recordings of each effect of each robot")
    parser.add_argument("--robots", default=",".join(HIDDEN), help="which robots, with commas between")
    parser.add_argument("--write", action="store_true", help=f"write the table into {RESULTS.name}")
    args = parser.parse_args(argv)
    answers = []
    for k, (robot, effect) in enumerate(cases(args.each, args.sound)):
        if robot not in args.robots.split(","):
            continue
        own = args.output / f"{k:02d}-{robot}-{effect or 'sound'}"
        target = own / "answer.json"
        if not target.exists():
            found = answer(own, robot, effect, 1000 * args.seed + k)
            write_atomically(target, json.dumps(found, indent=1) + "\n")
            print(f"{own.name}: {scored(found)}, {found['seconds']:.0f} s", file=sys.stderr, flush=True)
        answers.append(json.loads(target.read_text()))
    text = page(answers, args.seed)
    print(text)
    if args.write:
        RESULTS.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
