"""What a diagnosis, a fit, or robot files by themselves leave open: the models, the rig and its noise."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibrate.inference.channels import quantity_of
from calibrate.inference.number import OWN
from gtr_jax import InputError, Recording, load_config, read_recording
from gtr_jax.config.references import referenced
from gtr_jax.recordings.formats.text import read_text

from .load_histories import pace_of
from .model import OpenModel, known_beforehand, open_model

DIAGNOSIS, FIT = "diagnosis.json", "fit.json"
# Readings of a new recording.
READINGS = 140
# Most rivals that are planned with, the most probable first.
MOST = 5
# A tension at the tip is read to this share of the largest at the base where no recording tells.
TENSION_SD = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Opened:
    """What is open, and the rig on which it may be settled.

    Attributes:
        source: the folder, or the files, in words.
        verdict: what was answered so far, in a sentence; "" of robot files alone.
        models: that may be true, the most probable first.
        noise: standard deviation of each channel that was recorded, SI, by name, correlation counted in.
        noise_drive: standard deviation of a reading of what drives the tendons, SI.
        largest: what drives each tendon at most, a tension [N] or a displacement [m].
        resting: the same at least.
        pace: seconds of a loop that is neither slow nor fast.
        recordings: files that were recorded so far, as they were named.
        command: line that answered so far; "" of robot files alone.
        left_out: sentences on what is left out of the plan.
    """

    source: str
    verdict: str
    models: tuple[OpenModel, ...]
    noise: dict[str, float]
    noise_drive: float
    largest: np.ndarray
    resting: np.ndarray
    pace: float
    recordings: tuple[str, ...] = ()
    command: str = ""
    left_out: tuple[str, ...] = ()

    @property
    def rivals(self) -> bool:
        """Whether it is open which of several models is true."""
        return len(self.models) > 1


def open_folder(folder: str | os.PathLike[str]) -> Opened:
    """What the run folder of a diagnosis or a fit leaves open.

    Raises:
        InputError: it is neither, or explains nothing, or is of several robots, or of an earlier version.
    """
    folder = Path(folder)
    for name, read in ((DIAGNOSIS, _of_diagnosis), (FIT, _of_fit)):
        if (folder / name).is_file():
            return read(folder, _answer(folder / name))
    raise InputError(
        f"{folder}: holds neither {DIAGNOSIS} nor {FIT}; give the run folder of gtr diagnose or gtr fit, or "
        "robot files"
    )


def open_files(
    files: Sequence[str | os.PathLike[str]], *, largest: float | None, noise: float | None
) -> Opened:
    """What robot files that are rivals of each other leave open, or one file by itself: friction, stiffness,
    the numbers of its terms, and what `[uncertainty]` names.

    Args:
        files: of robots that tension drives.
        largest: base tension not to exceed [N].
        noise: standard deviation of a reading of either cell [N]; a hundredth of `largest` unless given.

    Raises:
        InputError: a file is refused, no largest tension is given, or displacement drives a tendon.
    """
    paths = [Path(file) for file in files]
    if largest is None:
        raise InputError("--max-tension: robot files do not say how far the rig may pull; give it, as 45N")
    models = []
    for path in paths:
        config = load_config(path)
        names, information = known_beforehand(config)
        model = open_model(
            path.stem,
            str(path),
            config,
            probability=1 / len(paths),
            names=names,
            information=information,
        )
        if any(tendon.drive == "displacement" for tendon in model.robot.tendons):
            raise InputError(
                f"{path}: displacement drives a tendon, and no recording shows how far; give the run "
                "folder of a diagnosis or a fit"
            )
        models.append(model)
    if len({model.robot.tendon_names for model in models}) > 1:
        raise InputError(f"{paths[-1]}: has other tendons than {paths[0]}; rivals are models of one robot")
    tendons = len(models[0].robot.tendons)
    tips = [f"T_tip.{name}" for name in models[0].robot.tendon_names] or ["T_tip"]
    return Opened(
        source=" and ".join(map(str, paths)),
        verdict="",
        models=tuple(models),
        noise=dict.fromkeys(tips, noise or TENSION_SD * largest),
        noise_drive=noise or TENSION_SD * largest,
        largest=np.full(tendons, largest),
        resting=np.zeros(tendons),
        pace=pace_of(None),
    )


def _answer(path: Path) -> dict[str, Any]:
    text, _ = read_text(path)
    try:
        found = json.loads(text)
    except ValueError as fault:
        raise InputError(f"{path}: cannot be read ({fault}); run the command that wrote it again") from None
    if not isinstance(found, dict):
        raise InputError(f"{path}: is not an answer of gtr; give the run folder of gtr diagnose or gtr fit")
    return found


def _entry(answer: Mapping[str, Any], key: str, path: Path) -> Any:
    if answer.get(key) is None:
        raise InputError(f"{path}: has no '{key}', which gtr next needs; run the command that wrote it again")
    return answer[key]


def _of_diagnosis(folder: Path, answer: Mapping[str, Any]) -> Opened:
    path = folder / DIAGNOSIS
    files = _entry(answer, "robot_files", path)
    if not files:
        raise InputError(
            f"{path}: the verdict is '{answer.get('verdict')}', and no model is left to plan with; "
            "look at its report for what to mend first"
        )
    rivals = [f for f in files if not f["settled"]]
    several = {f["recording"] for f in files} - {None}
    last = [r["name"] for r in _entry(answer, "recordings", path)][-1] if several else None
    chosen = [f for f in files[1:] if f["recording"] == last] if rivals else []
    chosen = sorted(chosen, key=lambda f: -f["probability"])
    left_out = []
    if len(chosen) > MOST:
        names = ", ".join(_held(f) for f in chosen[MOST:])
        left_out.append(f"The plan uses the {MOST} most probable of {len(chosen)} rivals, without {names}.")
    if several:
        left_out.append(f"Numbers that differ between the recordings are taken from {last}, the last one.")
    if not chosen:
        chosen = [next((f for f in files[::-1] if f["recording"] == last), files[0])]
    models = [_model(folder, f, path) for f in chosen[:MOST]]
    noise = _noise(answer, path)
    return _opened(folder, answer, answer["says"], models, noise, "diagnosis", tuple(left_out))


def _held(file: Mapping[str, Any]) -> str:
    return " with ".join(file["holds"]) or "nothing missing"


def _model(folder: Path, file: Mapping[str, Any], path: Path) -> OpenModel:
    known = _entry(file, "information", path)
    names, matrix = _shared(known["names"], np.asarray(known["matrix"], float), file["recording"])
    return open_model(
        _held(file),
        file["file"],
        load_config(referenced(file["file"], folder, str(path))),
        probability=float(file["probability"]),
        names=names,
        information=matrix,
    )


def _shared(names: Sequence[str], matrix: np.ndarray, recording: str | None) -> tuple[list[str], np.ndarray]:
    """The numbers that a new recording shares, under their own names: those of all recordings, and those of
    one of them where each has its own; and the information about these, the others being free.
    """
    kept = [i for i, n in enumerate(names) if OWN not in n or n.partition(OWN)[2] == recording]
    rest = [i for i in range(len(names)) if i not in kept]
    own = [names[i].partition(OWN)[0] for i in kept]
    whole = matrix[np.ix_(kept, kept)]
    if rest:
        cross = matrix[np.ix_(kept, rest)]
        whole = whole - cross @ np.linalg.pinv(matrix[np.ix_(rest, rest)]) @ cross.T
    return own, whole


def _of_fit(folder: Path, answer: Mapping[str, Any]) -> Opened:
    path = folder / FIT
    known = _entry(answer, "information", path)
    recordings = _entry(answer, "recordings", path)
    fitted = sorted(folder.glob("fitted*.toml"))
    if len(fitted) != 1:
        raise InputError(
            f"{folder}: is of {len(fitted)} robots; fit one of them by itself and give that folder"
            if fitted
            else f"{folder}: has no fitted.toml; run gtr fit again"
        )
    last = recordings[-1]["name"]
    names, matrix = _shared(known["names"], np.asarray(known["matrix"], float), last)
    left_out = ()
    if len(names) < len(known["names"]):
        left_out = (f"Numbers that each recording has for itself are taken from {last}, the last one.",)
    free = [name.partition(OWN)[0] for name in answer["settings"]["free"]]
    model = open_model(
        "the fitted model",
        fitted[0].name,
        load_config(fitted[0]),
        names=names,
        information=matrix,
        asked=free,
    )
    noise = _noise(answer, path)
    return _opened(folder, answer, answer["verdict"], [model], noise, "fit", left_out)


def _noise(answer: Mapping[str, Any], path: Path) -> dict[str, float]:
    """Standard deviation of each recorded channel, SI, of the recording in which it is largest; of correlated
    readings as large as if they were independent.
    """
    found: dict[str, float] = {}
    for recording in _entry(answer, "recordings", path):
        tau = float(recording.get("samples_per_independent", 1.0))
        for name, own in recording["channels"].items():
            rho = float(own.get("correlation", 0.0))
            grown = (1 + rho) / (1 - rho) if "correlation" in own else tau
            noise = recording.get("noise_N") if own["sd"] is None and quantity_of(name) == "T_tip" else None
            sd = float(own["sd"] or noise or 0.0) * float(np.sqrt(max(grown, 1.0)))
            found[name] = max(found.get(name, 0.0), sd)
    return {name: sd for name, sd in found.items() if sd > 0}


def _opened(
    folder: Path,
    answer: Mapping[str, Any],
    says: str,
    models: Sequence[OpenModel],
    noise: dict[str, float],
    stem: str,
    left_out: tuple[str, ...],
) -> Opened:
    driven = [_driven(path, models[0]) for path in sorted(folder.glob(f"{stem}*.csv"))]
    if not driven:
        raise InputError(f"{folder}: has no {stem}.csv, which tells how far the rig pulls; run gtr again")
    largest = np.max([np.max(rows, axis=0) for rows, _ in driven], axis=0)
    resting = np.min([np.min(rows, axis=0) for rows, _ in driven], axis=0)
    lasts = [float(np.ptp(time)) for _, time in driven if time is not None]
    settings = answer.get("settings", {})
    paths = {role: own["path"] for role, own in settings.get("inputs", {}).items()}
    return Opened(
        source=str(folder),
        verdict=says,
        models=tuple(models),
        noise=noise,
        noise_drive=max(float(r.get("noise_base_N") or 0.0) for r in answer["recordings"]),
        largest=np.atleast_1d(largest),
        resting=np.atleast_1d(resting),
        pace=pace_of(lasts[-1] if lasts else None),
        recordings=tuple(path for role, path in paths.items() if role.startswith("recording")),
        command=settings.get("command") or f"gtr {stem.replace('diagnosis', 'diagnose')} ROBOT.toml REC.csv",
        left_out=left_out,
    )


def _driven(path: Path, model: OpenModel) -> tuple[np.ndarray, np.ndarray | None]:
    """What drove each tendon in a recording, (K, tendons), and its times [s], (K,), if it has any."""
    robot = model.robot
    found: Recording = read_recording(
        path, need_tip=False, tendons=robot.tendon_names, keep_glitches=True, space=True
    )
    K = len(found)
    columns = []
    for i, tendon in enumerate(robot.tendons):
        every = found.displacement if tendon.drive == "displacement" else found.T_base
        columns.append(np.asarray(every, float).reshape(K, -1)[:, i])
    return np.stack(columns, axis=1), found.time
