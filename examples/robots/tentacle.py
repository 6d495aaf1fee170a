"""A silicone tentacle, hanging, with two tendons and four markers: fitted to eight holds, predicting seven.

`python -m examples.robots.tentacle` writes tentacle/fitted.toml, and docs/robots/tentacle.md with its
pictures.
"""

from __future__ import annotations

import csv
import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

import calibrate
import gtr_jax as gtr
from gtr_jax.config.config import dump_config
from gtr_jax.plots.straight import plot_straight
from gtr_jax.plots.style import BLUE, GREY, INK, VERMILLION, styled
from gtr_jax.plots.views import Posture, plot_views
from gtr_jax.report.spatial import strung_of

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
FULLEST = MODELS[-1][1]
# What else was tried beside the fullest model, or taken from it: what is free then.
TRIED = (
    ("without the tendons' angles", tuple(name for name in FULLEST if name not in ANGLES)),
    ("with an offset of the commanded tensions", (*FULLEST, "base-offset.force")),
    ("with a body that grows stiffer or softer as it bends", (*FULLEST, "stiffening.coefficient")),
)
SUSPECT = 1  # m2, which the holds not trained on show elsewhere
DRAWN = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 3.0]])  # N, of the shapes in the picture of the body
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
    return np.asarray(gtr.marker_places(robot, held(robot, tensions)))


def held(robot: gtr.Robot, tensions: np.ndarray) -> gtr.Simulation:
    """The robot in some holds of commanded tensions [N], (K, 2)."""
    run = gtr.simulate(robot, np.maximum(gtr.true_base(robot, tensions), 0.0))
    if not np.all(run.converged):
        raise SystemExit("a hold did not converge")
    return run


def apart(robot: gtr.Robot, name: str) -> np.ndarray:
    """Where the markers were seen, from where they are predicted [mm], (K, 4, 3)."""
    _, tensions, seen = holds(name)
    return 1e3 * (seen - predicted(robot, tensions))


def distances(robot: gtr.Robot, name: str) -> np.ndarray:
    """Of the markers from where they were seen [mm], (K, 4)."""
    return np.linalg.norm(apart(robot, name), axis=-1)


def moved(robot: gtr.Robot, name: str, which: int) -> tuple[np.ndarray, np.ndarray]:
    """Where a marker of a series seems to sit, from its place in the robot file [mm], (3,): along the body,
    to its left, across; and what is left of its errors once it is put there [mm], (K, 3). It is taken from
    the holds that it is compared with, and predicts nothing.

    Args:
        robot: the robot.
        name: of the series.
        which: index of the marker.
    """
    _, tensions, _ = holds(name)
    run = held(robot, tensions)
    there = np.asarray(gtr.marker_places(robot, run))[:, which]
    axes = []
    for axis in np.eye(3):
        each = list(robot.markers)
        each[which] = dataclasses.replace(each[which], offset=each[which].offset + jnp.asarray(axis))
        other = dataclasses.replace(robot, markers=tuple(each))
        axes.append(np.asarray(gtr.marker_places(other, run))[:, which] - there)
    frames = np.stack(axes, axis=1)  # (K, axis of the section, axis of the world)
    off = apart(robot, name)[:, which]
    by = np.einsum("kij,kj->ki", frames, off).mean(axis=0)
    return by, off - np.einsum("kij,i->kj", frames, by)


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


def held_out_error(free: tuple[str, ...], stretches: bool) -> float:
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


def body(robot: gtr.Robot) -> Figure:
    """The body in some holds, from three sides."""
    run = held(robot, DRAWN)
    assert run.shape is not None
    places = np.asarray(gtr.marker_places(robot, run))
    postures = [
        Posture(
            "at rest" if not any(pulls) else " and ".join(f"{pull:g}" for pull in pulls) + " N",
            np.asarray(run.shape.position[step]),
            np.asarray(run.shape.rotation[step]),
            np.asarray(run.tension[step]),
            places[step],
        )
        for step, pulls in enumerate(DRAWN)
    ]
    return plot_views(strung_of(robot, run), postures)


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


def by_marker(robot: gtr.Robot, train: np.ndarray, test: np.ndarray) -> str:
    """How far each marker was seen from where it is predicted, and how far apart it seems to sit in its
    section in the two series.

    Args:
        robot: the robot.
        train, test: from where it is predicted, of the holds trained on and of the others [mm], (K, 4, 3).
    """
    rows = []
    for k, name in enumerate(MARKERS):
        cells = [name]
        for off in (train[:, k], test[:, k]):
            cells += [f"{rms(np.linalg.norm(off, axis=-1)):.1f}", vector(off.mean(axis=0))]
        rows.append([*cells, f"{between_series(robot, k):.1f}"])
    both = [f"{rms(np.linalg.norm(off, axis=-1)):.1f}" for off in (train, test)]
    header = ["marker", "trained on: rms", "mean x, y, z", "held out: rms", "mean x, y, z", "moved by"]
    return table(header, [*rows, ["all", both[0], "", both[1], "", ""]])


def between_series(robot: gtr.Robot, which: int) -> float:
    """How far apart a marker seems to sit in its section in the two series [mm]."""
    (was, _), (now, _) = (moved(robot, name, which) for name in ("train", "test"))
    return float(np.linalg.norm(now - was))


def vector(values: np.ndarray) -> str:
    """Three numbers to a tenth, with a true minus."""
    return ", ".join(f"{value:.1f}" for value in values).replace("-", "\u2212")


def ends(values: Sequence[float] | np.ndarray) -> str:
    """The least and the largest, rounded, once where they are the same."""
    low, high = (f"{end:.0f}".replace("-", "−") for end in (np.min(values), np.max(values)))
    return low if low == high else f"{low} to {high}"


def row(says: str, free: tuple[str, ...], stretches: bool) -> tuple[Any, list[str]]:
    """A model fitted, and its row of the table."""
    say(f"tentacle: {says}")
    found = fitted(free, stretches)
    each = (
        rms(distances(found.robot, "train")),
        held_out_error(free, stretches),
        rms(distances(found.robot, "test")),
    )
    say("  {:.2f} mm trained, {:.2f} mm by level, {:.2f} mm held out".format(*each))
    return found, [says, str(len(free)), *(f"{distance:.1f} mm" for distance in each)]


def main() -> None:
    """Fit all models, and write the page."""
    gtr.enable_cache()
    fits, rows = zip(*(row(*model) for model in MODELS), strict=True)
    tried = [row(says, free, True)[1] for says, free in TRIED]
    best = fits[-1]
    dump_config(
        best.config,
        FOLDER / "fitted.toml",
        note="Fitted to the eight holds of train.csv by examples/robots/tentacle.py.",
    )
    save(plot_straight(gtr.load_robot(FOLDER / "tentacle.toml")), "tentacle-straight")
    save(body(best.robot), "tentacle-body")
    save(picture(fits[0].robot, best.robot), "tentacle")
    names, tensions, _ = holds("test")
    train, test = (apart(best.robot, name) for name in ("train", "test"))
    far = np.linalg.norm(test, axis=-1)
    by_hold = [
        [name, f"{left:.2f}, {right:.2f}", *(f"{d:.1f}" for d in own)]
        for name, (left, right), own in zip(names, tensions, far, strict=True)
    ]
    curves = between()
    passed = np.stack([distance for _, distance in curves])
    most = holds("train")[1]
    shorter = held(fits[1].robot, most).shape
    assert shorter is not None and shorter.stretch is not None
    left = moved(best.robot, "test", SUSPECT)[1]
    without = np.delete(far, SUSPECT, axis=1)
    twist = best["natural_twist"].value * best.config.backbone.length
    write(
        "tentacle",
        page("tentacle").format(
            models=table(["model", "numbers", "trained on", "by level", "held out"], rows),
            tried=table(["the fullest model", "numbers", "trained on", "by level", "held out"], tried),
            numbers=numbers(best.estimates),
            count=len(best.estimates),
            markers=by_marker(best.robot, train, test),
            holds=table(["hold", "tensions [N]", *MARKERS], by_hold),
            between=table(["hold", *MARKERS], [[n, *(f"{x:.1f}" for x in d)] for n, d in curves]),
            floor=f"{rms(passed):.1f}",
            passed=ends(passed[:, SUSPECT]),
            passed_tip=ends(passed[:, -1]),
            missed=ends(far[:, SUSPECT]),
            up_now=ends(test[:, SUSPECT, 2]),
            up_was=ends(train[:, SUSPECT, 2]),
            elsewhere=f"{between_series(best.robot, SUSPECT):.0f}",
            without=f"{rms(without):.1f}",
            moved=f"{rms(np.column_stack([without, np.linalg.norm(left, axis=-1)])):.1f}",
            suspect=MARKERS[SUSPECT],
            first=rows[0][-1],
            second=rows[1][-1],
            third=rows[3][-1],
            last=rows[-1][-1],
            level=rows[-1][-2],
            stiffened=tried[-1][-2],
            largest=f"{most.max():.1f}",
            shorter=f"{-100 * float(np.min(shorter.stretch)):.0f}",
            twist=f"{np.degrees(twist):.0f}",
            network=NETWORK,
            identified=IDENTIFIED,
            worst=f"{far.max():.0f}",
            farthest=MARKERS[int(np.argmax(far.max(axis=0)))],
        ),
    )


if __name__ == "__main__":
    main()
