"""Two notched wrists of nitinol: fitted to the first trial of each, predicting the others.

`python -m examples.robots.wrists` reads the recordings where they lie, and writes docs/robots/wrists.md with
a picture that shows none of them; one that does goes to out-robots. They have no licence and do not ship.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import calibrate
import gtr_jax as gtr
from gtr_jax.files.config import dump_config
from gtr_jax.plots.style import BLUE, GREY, VERMILLION, styled

from .pages import HERE, elsewhere, numbers, page, save, say, table, write

WRISTS = ("wrist90", "wrist150")
COUNT = 5
NATURAL = tuple(f"notches_natural_angle_{i}" for i in range(COUNT))
MATERIAL = ("E", "superelastic.softening", "superelastic.strain")
# Each model with what is free of every wrist; the last two fit both wrists together.
ALONE = (
    ("modulus", ("E",)),
    ("modulus and friction", ("E", "mu")),
    ("superelastic, no friction", MATERIAL),
    ("superelastic, with friction", (*MATERIAL, "mu")),
)
TOGETHER = (
    ("one material and one friction for both", (*MATERIAL, "mu")),
    ("and notches that bend shorter than they are cut", (*MATERIAL, "mu", "notches_end_correction")),
)
RESTS = np.deg2rad(1.0)
REPEATED = "no model: the first trial, interpolated"
PLAIN, FOUND = ALONE[1][0], ALONE[3][0]
KNOWN = {"wrist90": "0.61", "wrist150": "1.14"}  # degrees, the authors' law by SOURCE


@dataclasses.dataclass(frozen=True)
class Trial:
    """Base tensions [N], (K,), and angles of the notches [rad], (K, 5)."""

    T_base: np.ndarray
    angles: np.ndarray


def trials(wrist: str) -> list[Trial]:
    """The trials of a wrist, in order."""
    with elsewhere("wrists", f"{wrist}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    found = []
    for name in dict.fromkeys(row["trial"] for row in rows):
        own = [row for row in rows if row["trial"] == name]
        angles = [[float(row[f"theta{i + 1}_deg"]) for i in range(COUNT)] for row in own]
        found.append(Trial(np.array([float(row["T_base_N"]) for row in own]), np.deg2rad(angles)))
    return found


def recording(wrist: str, trial: Trial, folder: Path) -> gtr.Recording:
    """A trial as a recording."""
    path = folder / f"{wrist}.csv"
    header = ",".join(["T_base_N", *(f"n{i + 1}_angle_rad" for i in range(COUNT))])
    np.savetxt(path, np.column_stack([trial.T_base, trial.angles]), delimiter=",", header=header, comments="")
    return gtr.read_recording(path, measured=True, markers=[f"n{i + 1}" for i in range(COUNT)])


def predicted(robot: gtr.Robot, trial: Trial, own_rest: bool) -> np.ndarray:
    """Angles of the notches [rad], (K, 5); with `own_rest` from the angles that the trial begins with."""
    if own_rest:
        robot = robot.with_values(**dict(zip(NATURAL, trial.angles[0], strict=True)))
    run = gtr.simulate(robot, np.maximum(trial.T_base, 0.0))
    if not np.all(run.converged):
        raise SystemExit("a step did not converge")
    return np.asarray(gtr.marker_angles(robot, run))


def interpolated(first: Trial, trial: Trial, own_rest: bool) -> np.ndarray:
    """What another trial says of the angles of the notches [rad], (K, 5), without any model, NaN beyond its
    tensions; with `own_rest` from the angles that the trial begins with.
    """
    order = np.argsort(first.T_base)
    T, angles = first.T_base[order], first.angles[order]
    found = np.stack([np.interp(trial.T_base, T, each, right=np.nan) for each in angles.T], axis=1)
    return found + trial.angles[0] - angles[0] if own_rest else found


def off(says: Callable[[Trial, bool], np.ndarray], several: Sequence[Trial], own_rest: bool = False) -> float:
    """Root mean square error of an angle [degrees]; where a trial's first row is its rest, of the others.

    Args:
        says: the angles [rad] of a trial, with or without its own rest, as `predicted` has them.
        several: the trials.
        own_rest: whether each trial's own rest is known.
    """
    errors = [(says(trial, own_rest) - trial.angles)[1 if own_rest else 0 :].ravel() for trial in several]
    return float(np.rad2deg(np.sqrt(np.nanmean(np.concatenate(errors) ** 2))))


def alone(config: gtr.RobotConfig, first: gtr.Recording, free: Sequence[str]) -> Any:
    """A model fitted to one wrist."""
    if MATERIAL[1] in free:
        config = superelastic(config)
    if "mu" not in free:
        config = config.with_values({"friction_coefficient": 0.0})
    return calibrate.fit(config, first, free=(*free, *NATURAL))


def keep(wrist: str, found: Any) -> None:
    """The fitted robot file of a wrist."""
    note = f"Fitted to the first trial of {wrist} by examples/robots/wrists.py."
    dump_config(found.config, HERE / "wrists" / f"{wrist}-fitted.toml", note=note)


def diagnosed(config: gtr.RobotConfig, first: gtr.Recording) -> str:
    """What `gtr diagnose` says of a wrist, whose notches may be bent at rest by a degree more or less."""
    angles = {f"backbone.notches.0.natural_angle.{i}": RESTS for i in range(COUNT)}
    return calibrate.diagnose(config.with_deviations(angles), first).says


def superelastic(config: gtr.RobotConfig) -> gtr.RobotConfig:
    """The robot with the term at usual values, to start from."""
    return config.with_values({"terms.superelastic.softening": 0.8, "terms.superelastic.strain": 0.025})


@styled
def picture(robots: dict[str, dict[str, gtr.Robot]]) -> Figure:
    """Angles of the notches against the base tension in the trials that were not trained on."""
    fig = Figure(figsize=(9.6, 6.4), layout="constrained")
    axes = fig.subplots(2, COUNT, sharex=True, sharey="row")
    for row, wrist in zip(axes, WRISTS, strict=True):
        later = trials(wrist)[1:]
        T = np.linspace(0.0, max(trial.T_base.max() for trial in later), 60)
        lines = {
            name: np.rad2deg(gtr.marker_angles(robot, gtr.simulate(robot, T)))
            for name, robot in robots[wrist].items()
        }
        for i, at in enumerate(row):
            for (name, line), colour in zip(lines.items(), (GREY, BLUE), strict=True):
                at.plot(T, line[:, i], color=colour, label=name)
            for trial in later:
                at.plot(
                    trial.T_base,
                    np.rad2deg(trial.angles[:, i]),
                    ".",
                    color=VERMILLION,
                    ms=4,
                    label="measured",
                )
            at.set_title(f"{wrist}, notch {i + 1}", fontsize=9)
        row[0].set_ylabel("angle of the notch [°]")
    fig.supxlabel("tension at the base [N]", fontsize=10)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    fig.legend(once.values(), once.keys(), loc="outside upper center", ncols=3)
    return fig


@styled
def models(robots: dict[str, dict[str, gtr.Robot]], seen: dict[str, list[Trial]]) -> Figure:
    """Angles of the notches of both models, and their held-out errors by notch."""
    fig = Figure(figsize=(9.6, 5.8), layout="constrained")
    axes = fig.subplots(2, 2, width_ratios=(3, 2))
    for (left, right), wrist in zip(axes, WRISTS, strict=True):
        T = np.linspace(0.0, 2.0, 60)
        for (name, robot), colour, width in zip(
            robots[wrist].items(), (GREY, BLUE), (-0.2, 0.2), strict=True
        ):
            angles = np.rad2deg(gtr.marker_angles(robot, gtr.simulate(robot, T)))
            for i in range(COUNT):
                left.plot(T, angles[:, i], color=colour, lw=1.4, label=name if i == 0 else None)
            errors = [predicted(robot, trial, False) - trial.angles for trial in seen[wrist][1:]]
            each = np.rad2deg(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
            right.bar(np.arange(1, COUNT + 1) + width, each, 0.38, color=colour)
        left.set_title(f"{wrist}: notches 1 (upper) to {COUNT} (lower)", fontsize=9)
        left.set_xlabel("tension at the base [N]")
        left.set_ylabel("angle of each notch [°]")
        right.set_title("trials that no model was fitted to", fontsize=9)
        right.set_xlabel("notch")
        right.set_ylabel("rms error [°]")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return fig


def _errors(says: Callable[[Trial, bool], np.ndarray], seen: Sequence[Trial]) -> list[str]:
    """Errors on the first trial, on the others, and on these from their own rest, as shown in the table."""
    errors = (off(says, seen[:1]), off(says, seen[1:]), off(says, seen[1:], own_rest=True))
    return [f"{error:.2f}°" for error in errors]


def main() -> None:
    """Fit all models, and write the page."""
    configs = {wrist: gtr.load_config(HERE / "wrists" / f"{wrist}.toml") for wrist in WRISTS}
    seen = {wrist: trials(wrist) for wrist in WRISTS}
    fits: list[tuple[str, dict[str, Any]]] = []
    with tempfile.TemporaryDirectory() as temporary:
        first = {wrist: recording(wrist, seen[wrist][0], Path(temporary)) for wrist in WRISTS}
        lacks = {w: diagnosed(configs[w], first[w]) for w in WRISTS}
        for wrist, says in lacks.items():
            say(f"{wrist}: {says}")
        for says, free in ALONE:
            say(f"wrists: {says}")
            fits.append((says, {w: alone(configs[w], first[w], free) for w in WRISTS}))
        for says, free in TOGETHER:
            say(f"wrists: {says}")
            found = calibrate.fit(
                [superelastic(configs[w]) for w in WRISTS],
                [first[w] for w in WRISTS],
                free=(*free, *NATURAL),
                per_robot=NATURAL,
            )
            fits.append((says, {w: found for w in WRISTS}))
    best, both = dict(fits)[FOUND], fits[-1][1]["wrist90"]
    for wrist in WRISTS:
        keep(wrist, best[wrist])
    rows, robots = [], {}
    for says, found in fits:
        cells = [says]
        for i, wrist in enumerate(WRISTS):
            each = found[wrist].recordings
            robot = each[i if len(each) > 1 else 0].robot
            robots.setdefault(wrist, {})[says] = robot
            cells += _errors(functools.partial(predicted, robot), seen[wrist])
        rows.append(cells)
        say("  " + ", ".join(cells[1:]))
    itself = [REPEATED]
    for wrist in WRISTS:
        itself += ["–", *_errors(functools.partial(interpolated, seen[wrist][0]), seen[wrist])[1:]]
    say("  " + ", ".join(itself))
    shown = {
        wrist: {
            "modulus and friction": robots[wrist][PLAIN],
            "with the plateau of nitinol": robots[wrist][FOUND],
        }
        for wrist in WRISTS
    }
    save(picture(shown), "wrists-recorded", shows_recording=True)
    save(models(shown, seen), "wrists")
    header = ["model"] + [
        f"{wrist}: {what}" for wrist in WRISTS for what in ("trained on", "held out", "own rest")
    ]

    def told(e: Any) -> str:
        return f"{e.value:.3f} ± {e.sd:.3f}"

    shared = [e for e in both.estimates if not e.name.startswith("notches_natural")]
    own = {cells[0]: cells for cells in rows}[FOUND]
    write(
        "wrists",
        page("wrists").format(
            models=table(header, [*rows, itself]),
            lacks90=lacks["wrist90"],
            lacks150=lacks["wrist150"],
            mu90=told(best["wrist90"]["mu"]),
            mu150=told(best["wrist150"]["mu"]),
            alone90=numbers(best["wrist90"].estimates),
            alone150=numbers(best["wrist150"].estimates),
            both=numbers(shared),
            known90=KNOWN["wrist90"],
            known150=KNOWN["wrist150"],
            off90=own[2],
            off150=own[5],
            rest90=own[3],
            rest150=own[6],
            both90=rows[-1][2],
            both150=rows[-1][5],
            itself90=itself[2],
            itself150=itself[5],
            itself_rest90=itself[3],
            itself_rest150=itself[6],
        ),
    )


if __name__ == "__main__":
    main()
