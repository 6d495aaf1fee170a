"""`python -m benchmarks.spatial_fits -o FOLDER`: how often intervals of fits in space hold the truth.

Recordings of helical tendons in soft arms by an independent simulator (`spatial_machine.py`): friction,
modulus, Poisson's ratio and the helix are drawn at random, and so is how far the robot file is off them. The
tension at base and tip, the displacement, and the tip's place and orientation are recorded, all with noise.
All five numbers are fitted without priors. The run resumes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from scipy.spatial.transform import Rotation

import calibrate
import gtr_jax as gtr
from gtr_jax.atomic_write import write_atomically
from gtr_jax.config.config import parse_config

from .spatial_machine import LINKS, Arms, Run, simulate

RESULTS = Path(__file__).parent / "results/spatial_fits.md"
LENGTH, OUTER_RADIUS = 0.25, 0.012
# Standard deviations of the readings: tension [N], displacement [m], place [m], rotation [rad].
FORCE, DRAWN, PLACE, TURN = 0.01, 1e-5, 1e-4, 2e-3
FREE = ("mu", "E", "nu", "radius", "start_angle")


def history(rng: np.random.Generator) -> np.ndarray:
    """Base tensions [N] of 64 samples, (64,): a pull, a release, a smaller pull, and a hold in between."""
    top, low = rng.uniform(6.0, 10.0), rng.uniform(0.3, 2.0)
    again = rng.uniform(0.6, 0.9) * top
    legs = [(0.0, top, 24), (top, low, 20), (low, again, 14), (again, again, 6)]
    return np.concatenate([np.linspace(a, b, n + 1)[(k > 0) :] for k, (a, b, n) in enumerate(legs)])[:64]


def drawn(runs: int, seed: int) -> tuple[Arms, np.ndarray]:
    """Arms, and their histories, (64, runs)."""
    rng = np.random.default_rng(seed)
    truth = [
        Arms(
            length=np.array(LENGTH),
            outer_radius=np.array(OUTER_RADIUS),
            inner_radius=np.array(0.0),
            E=np.array(np.exp(rng.normal(np.log(1.2e6), 0.2))),
            nu=np.array(rng.uniform(0.2, 0.45)),
            radius=np.array(rng.uniform(6e-3, 9e-3)),
            turns=np.array(rng.uniform(0.7, 1.4)),
            start_angle=np.array(rng.uniform(0.4, 1.2)),
            mu=np.array(rng.uniform(0.1, 0.4)),
        )
        for _ in range(runs)
    ]
    arms = Arms(**{name: np.array([getattr(arm, name) for arm in truth]) for name in vars(truth[0])})
    return arms, np.stack([history(rng) for _ in range(runs)], axis=1)


def robot_file(arms: Arms, k: int, rng: np.random.Generator) -> dict[str, Any]:
    """What somebody would write of arm k: friction, modulus, Poisson's ratio and channel are a little off."""
    return {
        "schema": 1,
        "name": "arm",  # one for all, or each would be compiled anew
        "backbone": {
            "length": LENGTH,
            "outer_radius": OUTER_RADIUS,
            "youngs_modulus": float(arms.E[k] * np.exp(0.15 * rng.normal())),
            "poissons_ratio": float(np.clip(arms.nu[k] + 0.05 * rng.normal(), 0.0, 0.49)),
        },
        "routing": {
            "kind": "helix",
            "radius": float(arms.radius[k] * np.exp(0.03 * rng.normal())),
            "turns": float(arms.turns[k]),
            "start_angle": float(arms.start_angle[k] + 0.03 * rng.normal()),
        },
        "tendon": {"friction_coefficient": float(arms.mu[k] * np.exp(0.3 * rng.normal()))},
    }


def example(path: Path, links: int) -> None:
    """Write a recording of the arm in examples/helix.toml, whose friction and modulus are not those of the
    file.
    """
    rng = np.random.default_rng(7)
    numbers = {
        "length": LENGTH,
        "outer_radius": OUTER_RADIUS,
        "inner_radius": 0.003,
        "E": 1.31e6,
        "nu": 0.5,
        "radius": 8e-3,
        "turns": 0.5,
        "start_angle": np.radians(30.0),
        "mu": 0.24,
    }
    arms = Arms(**{name: np.array([value]) for name, value in numbers.items()})
    T_base = history(rng)[:, None]
    rows = read_by(simulate(arms, T_base, links), T_base, 0, rng)
    gtr.write_recording(path, {name: np.round(values, 6) for name, values in rows.items()})


def read_by(run: Run, T_base: np.ndarray, k: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """What noisy instruments read of arm k, by quantity of a recording, (K,) each."""
    K = len(T_base)
    wrong = Rotation.from_rotvec(TURN * rng.normal(size=(K, 3)))
    quaternion = (Rotation.from_rotvec(run.rotation[:, k]) * wrong).as_quat()
    columns = {
        "time": 0.5 * np.arange(K),
        "T_base": T_base[:, k] + FORCE * rng.normal(size=K),
        "T_tip": run.T_tip[:, k] + FORCE * rng.normal(size=K),
        "displacement": run.displacement[:, k] + DRAWN * rng.normal(size=K),
    }
    place = run.tip[:, k] + PLACE * rng.normal(size=(K, 3))
    columns |= {f"tip_{axis}": place[:, i] for i, axis in enumerate("xyz")}
    return columns | {f"tip_q{axis}": quaternion[:, i] for i, axis in enumerate("xyzw")}


def make(folder: Path, runs: int, seed: int, links: int) -> None:
    """Write a robot file, a recording and the truth of each run."""
    arms, T_base = drawn(runs, seed)
    run = simulate(arms, T_base, links)
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        own = folder / f"run-{k:03d}"
        own.mkdir(parents=True, exist_ok=True)
        gtr.write_recording(own / "recording.csv", read_by(run, T_base, k, rng))
        truth = {name: float(getattr(arms, name)[k]) for name in FREE}
        gtr.dump_config(parse_config(robot_file(arms, k, rng), source="robot.toml"), own / "robot.toml")
        write_atomically(own / "truth.json", json.dumps(truth, indent=1) + "\n")


def answer(own: Path) -> dict[str, Any]:
    """Fit one recording."""
    config = gtr.load_config(own / "robot.toml")
    recording = gtr.read_recording(own / "recording.csv", space=True)
    began = time.process_time()
    fit = calibrate.fit(config, recording, free=FREE)
    return {
        "converged": fit.converged,
        "verdict": fit.verdict,
        "truth": json.loads((own / "truth.json").read_text()),
        "found": {e.name: (e.value, e.sd, e.lower95, e.upper95) for e in fit.estimates},
        "chi2_per_n": fit.chi2_per_n,
        "seconds": time.process_time() - began,
    }


def page(answers: list[dict[str, Any]], seed: int, links: int) -> str:
    """The table, in Markdown."""
    good = [a for a in answers if a["converged"]]
    lines = [
        f"Seed {seed}, {links} links; {len(answers)} recordings, {len(good)} fits converged.",
        "",
        "| number | intervals | hold the truth | error over its sd, rms | mean | typical sd |",
        "|---|---|---|---|---|---|",
    ]
    for name in FREE:
        rows = [(a["truth"][name], *a["found"][name]) for a in good if a["found"][name][1]]
        held = sum(low <= true <= high for true, _, _, low, high in rows)
        z = np.array([(value - true) / sd for true, value, sd, _, _ in rows])
        share = np.median([sd / abs(true) for true, _, sd, _, _ in rows])
        low, high = stats.binomtest(held, len(rows)).proportion_ci(method="exact")
        lines.append(
            f"| {name} | {len(rows)} | {100 * held / len(rows):.0f} % ({100 * low:.0f}–{100 * high:.0f}) | "
            f"{np.sqrt(np.mean(z**2)):.2f} | {np.mean(z):+.2f} | {100 * share:.2g} % |"
        )
    return "\n".join(lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    """Make the recordings, fit them, print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.spatial_fits", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, help="folder of recordings and answers")
    parser.add_argument("--example", type=Path, help="write examples/helix-recording.csv, and no more")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--runs", type=int, default=100, help="recordings")
    parser.add_argument("--links", type=int, default=LINKS, help="links of the machine")
    parser.add_argument("--write", action="store_true", help=f"write the table into {RESULTS.name}")
    args = parser.parse_args(argv)
    if args.example:
        example(args.example, args.links)
        return 0
    if args.output is None:
        parser.error("-o: give a folder of recordings and answers")
    if not (args.output / "run-000").exists():
        make(args.output, args.runs, args.seed, args.links)
    answers = []
    for own in sorted(args.output.glob("run-*"))[: args.runs]:
        target = own / "answer.json"
        if not target.exists():
            write_atomically(target, json.dumps(answer(own), indent=1) + "\n")
            print(f"{own.name} done", file=sys.stderr, flush=True)
        answers.append(json.loads(target.read_text()))
    text = page(answers, args.seed, args.links)
    print(text)
    if args.write:
        RESULTS.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
