"""The robot files of a diagnosis: one for each of the rivals that are not told apart, and for each recording
where a number differs between them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.diagnosis.decision.decide import UNEXPLAINED, Decision
from calibrate.diagnosis.evidence.marginal import Marginal
from calibrate.diagnosis.laws.found import with_law
from calibrate.diagnosis.search.differ import Difference
from calibrate.inference.free import distinct
from calibrate.inference.number import values_in
from calibrate.inference.simulated_rig import of_each_tendon
from gtr_jax import InputError, Robot, RobotConfig
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.terms import Law

# First part of the names of the robot files.
STEM = "diagnosed"


@dataclasses.dataclass(frozen=True, eq=False)
class RobotFile:
    """A robot with what was found.

    Attributes:
        name: of the file.
        effects: hypotheses that are in it; none where nothing is missing.
        recording: whose numbers it has, where some differ between recordings; else "".
        probability: of the model.
        config: the robot.
        settled: False if it is one of several rivals that the recordings do not tell apart.
        numbers: names of the numbers that were fitted, p of them.
        information: about them, (p, p); see `Marginal.information`.
        note: what a user must know before using it, in sentences; "" if it is settled and the only file.
    """

    name: str
    effects: tuple[str, ...]
    recording: str
    probability: float
    config: RobotConfig
    settled: bool
    numbers: tuple[str, ...]
    information: np.ndarray
    note: str


def kinds(names: Sequence[str]) -> list[str]:
    """The terms to which hypotheses belong, each once."""
    return list(dict.fromkeys(name.partition(".")[0] for name in names))


def _labels(sets: Sequence[tuple[str, ...]]) -> list[str]:
    """A name for each set of hypotheses: its terms; where two sets have the same, the variants as well."""
    short = ["-and-".join(kinds(names)) for names in sets]
    return [
        label if short.count(label) == 1 else "-and-".join(name.replace(".", "-") for name in names)
        for label, names in zip(short, sets, strict=True)
    ]


def robot_files(
    decision: Decision,
    after: Marginal,
    refitted: Mapping[tuple[str, ...], Marginal],
    differ: Sequence[Difference],
    config: RobotConfig | None,
    fine: Robot,
    laws: Mapping[str, Law],
) -> tuple[list[RobotFile], list[str]]:
    """`diagnosed.toml` first, then those of the rivals and recordings, where there are several; none where
    nothing is explained or no robot file was given. And a sentence for values that do not make a robot file.

    Args:
        decision: the verdict, the model that is shown and its rivals.
        after, refitted: the model that is shown, and each rival, with all that is uncertain fitted together.
        differ: numbers that differ between the recordings.
        config, fine: the robot file, and the robot.
        laws: that were found, by name.
    """
    if config is None or decision.verdict == UNEXPLAINED:
        return [], []
    recordings = [rig.part.name for rig in after.likelihood.rigs] if differ else [""]
    sets = list(refitted)
    wanted = [("", after, recordings[0])]
    for label, model in zip(_labels(sets), refitted.values(), strict=True):
        wanted += [(f"{label}-{k}" if k else label, model, k) for k in recordings]
    if not sets and differ:
        wanted += [(k, after, k) for k in recordings]
    endings = ["", *distinct([ending for ending, _, _ in wanted[1:]])]
    found, warnings = [], []
    for ending, (_, model, recording) in zip(endings, wanted, strict=True):
        effects = model.fitted.names
        try:
            robot = _diagnosed(config, model, recording, fine, laws)
        except (InputError, KeyError) as fault:
            warnings.append(f"What was found cannot be written as a robot file: {fault}.")
            continue
        found.append(
            RobotFile(
                name=f"{STEM}-{ending}.toml" if ending else f"{STEM}.toml",
                effects=effects,
                recording=recording,
                probability=decision.probability[effects],
                config=robot,
                settled=not sets,
                numbers=tuple(n.name for n in model.fitted.numbers),
                information=model.information(),
                note="",
            )
        )
    noted = [dataclasses.replace(f, note=_note(f, found, differ)) for f in found]
    return noted, list(dict.fromkeys(warnings))


def _diagnosed(
    config: RobotConfig, model: Marginal, recording: str, fine: Robot, laws: Mapping[str, Law]
) -> RobotConfig:
    """The robot file with the numbers of a fit, those of one recording where they differ; the numbers that it
    called uncertain get the standard deviations of the fit.
    """
    known, fitted = parameters_of(of_each_tendon(fine)) | parameters_of(fine), model.fitted
    for name in [name for name in fitted.names if name in laws]:
        own = {q.name: fitted.values[f"{name}.{q.name}"] for q in laws[name].numbers}
        config = with_law(config, laws[name], own)
    values = {known[k].key: v for k, v in values_in(fitted.values, recording).items()}
    sds = values_in({n.name: model.sd(i) for i, n in enumerate(fitted.numbers)}, recording)
    left = {known[k].key: sd for k, sd in sds.items() if known[k].key in config.uncertainty}
    return config.with_values(values).with_deviations(left)


def holds(file: RobotFile) -> str:
    """What a file has beyond the base model, in words."""
    return " with ".join(file.effects) or "nothing missing"


def _note(
    file: RobotFile,
    files: Sequence[RobotFile],
    differ: Sequence[Difference],
) -> str:
    sentences = []
    if not file.settled:
        each = dict.fromkeys(f"{holds(f)} (probability {f.probability:.2f})" for f in files[1:])
        sentences.append(f"Not settled: these recordings cannot tell which is missing, {' or '.join(each)}.")
        sentences.append(f"This file holds {holds(file)}.")
    if differ:
        names = " and ".join(d.name for d in differ)
        sentences.append(f"{names} differ{'s' if len(differ) == 1 else ''} between the recordings.")
        sentences.append(f"This file has the values that fit {file.recording}.")
    others = [f.name for f in files if f is not file]
    if sentences and file is files[0]:
        sentences.append(f"One for each: {', '.join(others)}.")
    return " ".join(sentences)
