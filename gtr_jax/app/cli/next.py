"""`gtr next`: what to measure next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError

from .options import Quantity, check_noise, output_option

if TYPE_CHECKING:
    from calibrate.planning import Opened, Plan

HISTORY, NEW = "next-experiment.csv", "NEW.csv"
# Decimals, in SI, of what the rig is changed by: the cosine of a right angle is not quite zero.
ROUNDED = 12


@click.command("next")
@click.argument(
    "sources", nargs=-1, required=True, metavar="FOLDER | ROBOT.toml ...", type=click.Path(path_type=Path)
)
@click.option(
    "--max-tension",
    "largest",
    type=Quantity("N", "TENSION"),
    help="Base tension not to exceed.  [default: the largest that was recorded; robot files alone need it]",
)
@click.option(
    "--duration",
    "longest",
    type=Quantity("s", "TIME"),
    help="Longest time that an experiment may take, as 10min; load histories that take longer are driven "
    "faster.",
)
@click.option(
    "--for",
    "wanted",
    metavar="NAMES",
    default="",
    help="Numbers whose intervals are to narrow: mu,E.  [default: all that was fitted, and that they no "
    "longer trade off]",
)
@click.option(
    "--as-it-is",
    is_flag=True,
    help="Change neither the rig nor the instruments: only load histories are proposed.",
)
@click.option(
    "--noise",
    type=Quantity("N", "SD"),
    help="With robot files: standard deviation of a reading of either load cell.  [default: 1 % of "
    "--max-tension]",
)
@output_option
def next_(
    sources: Sequence[Path],
    largest: float | None,
    longest: float | None,
    wanted: str,
    as_it_is: bool,
    noise: float | None,
    output: Path,
    force: bool,
) -> int:
    """Find the experiment that tells most about what is still open, and write its load history for the rig.

    FOLDER is the run folder of a diagnosis or of a fit. Where a diagnosis leaves rivals, experiments are
    simulated under each of them, and the one that tells them apart best is chosen; else the one that narrows
    the intervals most. Several robot files are rivals; a single one is planned for from its own numbers.
    """
    from gtr_jax.cache import enable_cache

    from .progress import Progress
    from .run_folder import RunFolder

    check_noise(noise, None)
    for name, value in (("--max-tension", largest), ("--duration", longest)):
        if value is not None and value <= 0:
            raise InputError(f"{name}: must be above 0, is {value:g}; leave it out, or give more")
    opened, inputs = _opened(sources, largest, noise)
    folder = RunFolder(output, inputs, force=force)
    enable_cache()
    with Progress() as progress:
        answer = solve(
            opened,
            largest=largest,
            longest=longest,
            wanted=tuple(name.strip() for name in wanted.split(",") if name.strip()),
            as_it_is=as_it_is,
            progress=progress,
        )
        progress("drawing")
        with folder.write() as part:
            write_answer(part, answer, folder.settings())
    for line in summary(answer, output):
        click.echo(line)
    click.echo(f"report: {output / 'report.html'}")
    return 0


def _opened(
    sources: Sequence[Path], largest: float | None, noise: float | None
) -> tuple[Opened, dict[str, Path]]:
    """What is open, and the files that say so."""
    from calibrate.planning import open_files, open_folder
    from calibrate.planning.opened import DIAGNOSIS, FIT

    for path in sources:
        if not path.exists():
            raise InputError(f"{path}: no such folder or file; give the run folder of a diagnosis or a fit")
    folders = [path for path in sources if path.is_dir()]
    if not folders:
        opened = open_files(sources, largest=largest, noise=noise)
        return opened, {f"robot {i + 1}": path for i, path in enumerate(sources)}
    if len(sources) > 1:
        raise InputError(f"{folders[0]}: is a folder; give one run folder, or robot files")
    if noise is not None:
        raise InputError(f"--noise: {folders[0]} gives the noise of its recordings; leave it out")
    opened = open_folder(folders[0])
    answer = next(folders[0] / name for name in (DIAGNOSIS, FIT) if (folders[0] / name).is_file())
    models = {f"robot {i + 1}": folders[0] / model.file for i, model in enumerate(opened.models)}
    return opened, {"answer": answer, **models}


def solve(opened: Opened, *, progress: Any, **options: Any) -> Plan:
    """Plan, reporting progress."""
    from calibrate.planning import plan

    return plan(opened, progress=progress, **options)


def summary(answer: Plan, output: Path) -> list[str]:
    """The experiment and what to do, as lines for the terminal."""
    from calibrate.report.plan import steps_of

    steps = steps_of(answer, file=str(output / HISTORY), then=then(answer))
    lines = [f"{answer.verdict}: {answer.says}"]
    lines += [f"{k}. {step}" for k, step in enumerate(steps, start=1)]
    return [*lines, *(f"warning: {text}" for text in answer.warnings)]


def rig_files(answer: Plan) -> dict[str, Any]:
    """The robot file of each model for the rig as it is in the experiment, by file name; none where the rig
    stays as it is, or only its cells are checked.
    """
    chosen = answer.chosen
    if chosen is None or chosen.joins or chosen.weight is not None:
        return {}
    found = {}
    for model in answer.opened.models:
        keys = {n.name: n.key for n in model.numbers}
        values = {
            keys.get(name, f"terms.{name}"): round(value, ROUNDED)
            for name, value in chosen.changed(model.values).items()
            if value != model.values.get(name)
        }
        found[f"next-{Path(model.file).stem}.toml"] = model.config.with_values(values)
    return found


def then(answer: Plan) -> str:
    """What to do with the recording that the experiment gives, in a sentence or two."""
    chosen, opened = answer.chosen, answer.opened
    if chosen is None:
        return ""
    if chosen.weight is not None:
        return (
            "Compare what the cells show with the picture; state what they add as terms of the robot file "
            "('gtr terms' lists them), and diagnose the recordings again."
        )
    files = list(rig_files(answer)) or ([] if opened.command else [m.file for m in opened.models])
    if len(files) > 1:
        other = "The rig is then another one, which these files describe. " if chosen.done else ""
        return (
            f"{other}Diagnose the new recording with each of {', '.join(files)}: the answer is adequate for "
            "the one that is right."
        )
    if files:
        return f"Then run: {shlex.join(['gtr', 'fit', files[0], NEW, '-o', 'OUT'])}"
    from calibrate.report.plan import columns_wanted

    command = again(opened, columns_wanted(chosen, answer))
    left_out = (
        f" --drop would leave the same stretch out of {NEW} too: write it under [clean] into a mapping "
        "file of "
        "the recording that it is meant for."
        if any(word.partition("=")[0] == "--drop" for word in shlex.split(opened.command))
        else ""
    )
    return f"Then run: {command}{'.' if left_out else ''}{left_out}"


def again(opened: Opened, wanted: Mapping[str, str]) -> str:
    """The command that answered so far, with the new recording among the others.

    Args:
        opened: what is open, and the command.
        wanted: quantities of the new recording and their headers. Where the others are mapped, each has a
            mapping of its own then, and this is the one of the new recording.
    """
    words, kept, mappings = iter(shlex.split(opened.command)), [], []
    for word in words:
        if word in ("-o", "--output"):
            next(words, None)
        elif word == "--columns":
            mappings.append(next(words, ""))
        elif word.startswith("--columns="):
            mappings.append(word.partition("=")[2])
        elif not word.startswith("--output=") and word not in ("--force", "--next"):
            kept.append(word)
    places = [i for i, word in enumerate(kept) if word in opened.recordings]
    last = max(places, default=len(kept) - 1)
    if mappings:
        mappings = mappings * len(places) if len(mappings) == 1 else mappings
        mappings.append(",".join(f"{quantity}={header}" for quantity, header in wanted.items()))
    options = [part for mapping in mappings for part in ("--columns", mapping)]
    settles = ["--settles", opened.source] if opened.rivals else []
    return shlex.join([*kept[: last + 1], NEW, *kept[last + 1 :], *options, *settles, "-o", "OUT"])


def write_answer(folder: Path, answer: Plan, settings: dict[str, Any]) -> None:
    """Write all that a plan leaves into a folder."""
    from calibrate.report.plan import plan_report, steps_of
    from gtr_jax.config.config import config_text, dump_config
    from gtr_jax.recordings.recording import write_recording

    from .run_folder import write_json, write_report

    models = answer.opened.models
    files = rig_files(answer)
    for (name, config), model in zip(files.items(), models, strict=False):
        note = f"{model.file} of {answer.opened.source} with {answer.ranked[0].candidate.done}."
        dump_config(config, folder / name, note=note)
    if answer.chosen is not None:
        write_recording(folder / HISTORY, _to_drive(answer))
    steps = steps_of(answer, file=HISTORY, then=then(answer))
    write_json(folder / "next.json", {**answer.to_json(), "steps": steps, "settings": settings})
    config = models[0].config
    write_report(folder, plan_report(answer, config.name, steps), settings, config_text(config))


def _to_drive(answer: Plan) -> dict[str, Any]:
    """The columns of the load history: what drives each tendon, or the weights to hang on the cells."""
    chosen, robot = answer.chosen, answer.opened.models[0].robot
    assert chosen is not None
    if chosen.weight is not None:
        return {
            "time": chosen.time,
            "weight_base_N": chosen.drive[:, 0],
            "weight_tip_N": chosen.weight,
        }
    columns: dict[str, Any] = {"time": chosen.time}
    for tendon, own in zip(robot.tendons, chosen.drive.T, strict=True):
        header = "displacement_m" if tendon.drive == "displacement" else "T_base_N"
        columns[f"{header}.{tendon.name}" if robot.tendon_names else header] = own
    return columns
