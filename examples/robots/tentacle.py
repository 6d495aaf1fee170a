"""A silicone tentacle, hanging, with two tendons and four markers: fitted to eight holds, predicting seven.

`python -m examples.robots.tentacle` writes tentacle/fitted.toml, and docs/robots/tentacle.md with its
picture.
"""

from __future__ import annotations

import csv
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

import calibrate
import gtr_jax as gtr
from gtr_jax.files.config import dump_config
from gtr_jax.plots.style import BLUE, GREY, INK, VERMILLION, styled

from .pages import HERE, numbers, page, save, say, table, write

FOLDER = HERE / "tentacle"
MARKERS = ("m1", "m2", "m3", "m4")
POSE = tuple(f"base_{axis}" for axis in "xyz") + tuple(f"base_rotation_{axis}" for axis in "xyz")
ANGLES = ("start_angle.left", "start_angle.right")
FORCE = tuple(f"tip_force_{axis}" for axis in "xyz")
# How well a base is mounted: standard deviations of its place [m] and its rotation vector [rad].
MOUNTED = {f"base.position.{i}": 0.01 for i in range(3)} | {f"base.rotation.{i}": 0.1 for i in range(3)}
# Each model with what it adds to the one before, what is free, and whether the body stretches.
MODELS = (
    ("modulus and density; the axis keeps its length", ("E", "density"), False),
    ("the axis is shortened by its tendons", ("E", "density"), True),
    ("base mounted within 10 mm and 6° of where it should be", ("E", "density", *POSE), True),
    ("tendons not at the angles drawn", ("E", "density", *POSE, *ANGLES), True),
    ("a force at the tip", ("E", "density", *POSE, *ANGLES, *FORCE), True),
    ("the arm is twisted as cast", ("E", "density", *POSE, *ANGLES, *FORCE, "natural_twist"), True),
)
# Holds of one commanded torque, which a fit to the others predicts: models are chosen by that.
LEVELS = (("m1u01", "m2u01"), ("m1u015", "m2u015"), ("m1u02", "m2u02"), ("m1u025", "m2u025"))
NETWORK, IDENTIFIED = 6.4, 15.8  # mm over 22 holds, of which the network was trained on 20; by SOURCE


def holds(name: str) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names of the holds, tensions [N], (K, 2), and places of the markers [m], (K, 4, 3)."""
    with (FOLDER / f"{name}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    tensions = [[float(row[f"T_base_N.{side}"]) for side in ("left", "right")] for row in rows]
    places = [[[float(row[f"{m}_{axis}_m"]) for axis in "xyz"] for m in MARKERS] for row in rows]
    return [row["hold"] for row in rows], np.array(tensions), np.array(places)


def predicted(robot: gtr.Robot, tensions: np.ndarray) -> np.ndarray:
    """Places of the markers [m], (K, 4, 3)."""
    run = gtr.simulate(robot, tensions)
    if not np.all(run.converged):
        raise SystemExit("a hold did not converge")
    return np.asarray(gtr.marker_places(robot, run))


def distances(robot: gtr.Robot, name: str) -> np.ndarray:
    """Of the markers from where they were seen [mm], (K, 4)."""
    _, tensions, seen = holds(name)
    return 1e3 * np.linalg.norm(predicted(robot, tensions) - seen, axis=-1)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def fitted(free: tuple[str, ...], stretches: bool, without: tuple[str, ...] = ()) -> Any:
    """A fit to the eight holds but for some, from the dimensions that the authors give."""
    config = gtr.load_config(FOLDER / "tentacle.toml")
    if config.backbone.extensible != stretches:
        config = config.with_values({"backbone.extensible": stretches})
    if set(POSE) <= set(free):
        config = config.with_deviations(MOUNTED)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "holds.csv"
        head, *lines = (FOLDER / "train.csv").read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if line.partition(",")[0] not in without]
        file.write_text("\n".join([head, *kept, ""]), encoding="utf-8")
        recording = gtr.read_recording(
            file, measured=True, tendons=config.tendon_names, markers=MARKERS, space=True
        )
    return calibrate.fit(config, recording, free=free)


def foretold(free: tuple[str, ...], stretches: bool) -> float:
    """Root mean square distance [mm] of the eight holds, those of each level predicted from the others."""
    names = holds("train")[0]
    each = np.full((len(names), len(MARKERS)), np.nan)
    for level in LEVELS:
        out = [names.index(name) for name in level]
        robot = fitted(free, stretches, level).robot
        each[out] = distances(robot, "train")[out]
    return rms(each)


def between() -> list[tuple[str, np.ndarray]]:
    """What no model tells: for each hold not trained on in which one tendon pulls by a tension between two of
    the eight, how far its markers [mm], (4,), are from a smooth curve through those of that tendon.
    """
    _, tensions, seen = holds("train")
    names, wanted, there = holds("test")
    found = []
    for name, pulls, places in zip(names, wanted, there, strict=True):
        (side,) = np.flatnonzero(pulls) if np.count_nonzero(pulls) == 1 else (-1,)
        own = tensions[:, side] > 0
        if side >= 0 and tensions[own, side].min() < pulls[side]:
            curve = PchipInterpolator(tensions[own, side], seen[own])
            found.append((name, 1e3 * np.linalg.norm(curve(pulls[side]) - places, axis=-1)))
    return found


@styled
def picture(plain: gtr.Robot, best: gtr.Robot) -> Figure:
    """Where the markers were, and where two models have them, of the holds not trained on, from the side."""
    names, tensions, seen = holds("test")
    fig = Figure(figsize=(9.6, 5.4), layout="constrained")
    axes = fig.subplots(2, 4, sharex=True, sharey=True).ravel()
    each = [
        (predicted(plain, tensions), GREY, "axis keeps its length"),
        (predicted(best, tensions), BLUE, "found"),
    ]
    for k, (at, name) in enumerate(zip(axes, names, strict=False)):
        for places, colour, label in each:
            at.plot(1e3 * places[k, :, 1], 1e3 * places[k, :, 2], "o-", color=colour, ms=4, lw=1, label=label)
        at.plot(1e3 * seen[k, :, 1], 1e3 * seen[k, :, 2], "x", color=VERMILLION, ms=7, mew=2, label="seen")
        left, right = tensions[k]
        at.set_title(f"{name}: {left:.1f} and {right:.1f} N", fontsize=9, color=INK)
        at.set_aspect("equal")
    axes[-1].axis("off")
    axes[-1].legend(*axes[0].get_legend_handles_labels(), loc="center")
    fig.supxlabel("y [mm]")
    fig.supylabel("z [mm]")
    return fig


def main() -> None:
    """Fit all models, and write the page."""
    gtr.enable_cache()
    fits, rows = [], []
    for says, free, stretches in MODELS:
        say(f"tentacle: {says}")
        found = fitted(free, stretches)
        train, test = (distances(found.robot, name) for name in ("train", "test"))
        fits.append((found, train, test))
        chosen = foretold(free, stretches)
        rows.append([says, str(len(free)), *(f"{d:.1f} mm" for d in (rms(train), chosen, rms(test)))])
        say(f"  {rms(train):.2f} mm trained, {chosen:.2f} mm by level, {rms(test):.2f} mm held out")
    best, train, test = fits[-1]
    dump_config(
        best.config,
        FOLDER / "fitted.toml",
        note="Fitted to the eight holds of train.csv by examples/robots/tentacle.py.",
    )
    save(picture(fits[0][0].robot, best.robot), "tentacle")
    names, tensions, _ = holds("test")
    by_hold = [
        [name, f"{left:.2f}, {right:.2f}", *(f"{d:.1f}" for d in own)]
        for name, (left, right), own in zip(names, tensions, test, strict=True)
    ]
    curves = between()
    write(
        "tentacle",
        page("tentacle").format(
            models=table(["model", "numbers", "trained on", "by level", "held out"], rows),
            numbers=numbers(best.estimates),
            holds=table(["hold", "tensions [N]", *MARKERS], by_hold),
            between=table(["hold", *MARKERS], [[n, *(f"{x:.1f}" for x in d)] for n, d in curves]),
            floor=f"{rms(np.concatenate([d for _, d in curves])):.1f}",
            first=f"{rms(fits[0][2]):.1f}",
            second=f"{rms(fits[1][2]):.1f}",
            third=f"{rms(fits[3][2]):.1f}",
            last=f"{rms(test):.1f}",
            network=NETWORK,
            identified=IDENTIFIED,
            worst=f"{test.max():.0f}",
            farthest=MARKERS[int(np.argmax(test.max(axis=0)))],
        ),
    )


if __name__ == "__main__":
    main()
