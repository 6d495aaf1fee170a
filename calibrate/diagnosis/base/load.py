"""Load: recordings and their robot as what is compared, checked."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

from calibrate.diagnosis.outside.leave_out import Stretch, without
from calibrate.fitting.fit import channels_of, driven_as_recorded, part_of
from calibrate.inference.channels import CHANNELS
from calibrate.inference.free import distinct
from calibrate.inference.instruments import explained_first
from calibrate.inference.setup import Observation, check_columns, check_noise
from gtr_jax import InputError, Recording, Robot, RobotConfig, build_robot
from gtr_jax.errors import excerpt, nearest_first

# Names that a message offers for an unknown one.
NEAREST = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Loaded:
    """Recordings and their robot.

    Attributes:
        config: the robot file, or None.
        robot: on its own mesh, driven as recorded.
        recordings: as they were given.
        parts: what is compared of each, those with what is explained first.
        leave_out: what is simulated and not compared, by name of the recording.
        warnings: what the reader must know.
    """

    config: RobotConfig | None
    robot: Robot
    recordings: list[Recording]
    parts: list[Observation]
    leave_out: dict[str, list[Stretch]]
    warnings: list[str]


def load(
    robot: RobotConfig | Robot,
    recording: Recording | Sequence[Recording],
    channels: Sequence[str] | str | None,
    noise_N: float | None,
    noise_base_N: float | None,
    *,
    leave_out: Mapping[str, Sequence[Stretch]] | None,
    untried: Sequence[str],
) -> Loaded:
    """Recordings and their robot; arguments as of `prepare`."""
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    if not recordings:
        raise InputError("diagnose: no recording is given")
    config = robot if isinstance(robot, RobotConfig) else None
    fine = build_robot(robot) if isinstance(robot, RobotConfig) else robot
    _check_names(fine, untried)
    if fine.tendon_names and fine.backbone.rigid:
        raise InputError(
            f"diagnose: {fine.name} is a rigid sheath of {len(fine.tendons)} tendons, which act by "
            "themselves; diagnose each with a robot file of its own"
        )
    warnings: list[str] = []
    for k, r in enumerate(recordings):
        if (r.T_tip is None) != (recordings[0].T_tip is None):
            lacks, has = (r, recordings[0]) if r.T_tip is None else (recordings[0], r)
            raise InputError(
                f"{lacks.path}: no tip tension, which {has.path} has; map it with --columns "
                "'T_tip=NAME[N]', or diagnose each by itself"
            )
        check_columns(r, fine)
        same = fine.tendons
        fine, config, more = driven_as_recorded(fine, config, r)
        warnings += more
        if k and fine.tendons is not same and [t.drive for t in fine.tendons] != [t.drive for t in same]:
            raise InputError(
                f"{r.path}: displacement drives a tendon that tension drives in {recordings[0].path}; "
                "diagnose each by itself"
            )
    channels = channels_of(channels, recordings, [fine] * len(recordings))
    if channels is None and not (fine.space or fine.tendon_names):
        channels = (*CHANNELS, *(marker.name for marker in fine.markers))
    names = names_of(recordings)
    parts: list[Observation] = []
    for name, r in zip(names, recordings, strict=True):
        part, more = part_of(name, fine, config, r, channels, noise_N=noise_N, noise_base_N=noise_base_N)
        parts.append(part)
        warnings += more
    out = {part.name: list((leave_out or {}).get(part.name, ())) for part in parts}
    parts = [without(part, out[part.name]) for part in explained_first(parts)]
    check_noise(noise_N, parts)
    return Loaded(config, fine, recordings, parts, out, warnings)


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """Names of recordings, each once."""
    return distinct([r.path.stem for r in recordings])


def _check_names(robot: Robot, untried: Sequence[str]) -> None:
    """InputError if a name among the terms that are not tried belongs to no term."""
    for name in untried:
        if name not in robot.catalogue:
            near = ", ".join(nearest_first(excerpt(name), robot.catalogue)[:NEAREST])
            raise InputError(f"without: no term '{excerpt(name)}'; the nearest are {near}")
