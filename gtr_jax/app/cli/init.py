"""`gtr init`: a robot file from a few questions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gtr_jax.errors import InputError, nearest
from gtr_jax.interruption import interruption

if TYPE_CHECKING:
    from gtr_jax.config.config import RobotConfig

MODULUS, STIFFNESS, RIGID = "modulus", "stiffness", "rigid"
NONE = "none"
PLANE = (NONE, "+x", "-x", "+y", "-y")


class Answers:
    """Answers to questions: given as options, by default, or asked for.

    Args:
        given: values of the options, by name; None where not given.
        silent: whether defaults are taken instead of asking.
    """

    def __init__(self, given: Mapping[str, Any], *, silent: bool) -> None:
        self._given, self._silent = given, silent

    def __call__(
        self, option: str, says: str, default: str, check: Callable[[str], Any], *, own: str | None = None
    ) -> Any:
        """The checked answer to a question.

        Args:
            option: that gives it, without dashes.
            says: the question.
            default: answer that is offered.
            check: makes a value of the text; InputError where that fails, and the question is asked again.
            own: an answer that was given otherwise than as an option of its own.
        """
        name, unit = option.replace("-", "_"), _unit_of(default)
        given = own if own is not None else self._given.get(name)
        if given is not None or self._silent:
            if given is not None and unit and _is_bare(given):
                raise InputError(
                    f"--{option}: '{given}' carries no unit; write it too, as in '{default.replace(' ', '')}'"
                )
            return _named(check, f"--{option}")(default if given is None else given)

        def with_unit(text: str) -> Any:
            if unit and _is_bare(text):
                text = f"{text.strip()} {unit}"
                click.echo(f"taken as {text}", err=True)
            return check(text)

        return click.prompt(says, default=default, value_proc=_again(with_unit), err=True)


def _unit_of(default: str) -> str:
    """The unit of an answer that is offered; "" if it has none, or is not a quantity."""
    return default.partition(" ")[2] if _is_bare(default.partition(" ")[0], zero=True) else ""


def _is_bare(text: str, *, zero: bool = False) -> bool:
    """Whether an answer is a number without a unit; of zero, which needs none, only if `zero`."""
    try:
        return float(text) != 0 or zero
    except ValueError:
        return False


def _named(check: Callable[[str], Any], option: str) -> Callable[[str], Any]:
    def checked(text: str) -> Any:
        try:
            return check(text)
        except InputError as fault:
            raise InputError(f"{option}: {str(fault).removeprefix(': ')}") from None

    return checked


def _again(check: Callable[[str], Any]) -> Callable[[str], Any]:
    """The check as a prompt takes it, which asks again."""

    def checked(text: str) -> Any:
        try:
            return check(text)
        except InputError as fault:
            raise click.UsageError(str(fault)) from None

    return checked


def _amount(unit: str, *, above: bool = True, signed: bool = False) -> Callable[[str], float]:
    """A check of a quantity: above zero, or from zero on, or of any sign."""

    def check(text: str) -> float:
        from gtr_jax.units import parse_quantity

        try:
            value = float(text)
        except ValueError:
            value = parse_quantity(text.strip(), unit)
        if not signed and (value < 0 or (above and value == 0)):
            raise InputError(f"'{text}' must be {'above' if above else 'at least'} 0; correct it")
        return value

    return check


def _one_of(names: Sequence[str]) -> Callable[[str], str]:
    def check(text: str) -> str:
        if text.strip() not in names:
            near = nearest(text, names)
            hint = f"; did you mean '{near}'?" if near else ""
            raise InputError(f"must be one of {', '.join(names)}; got '{text}'{hint}")
        return text.strip()

    return check


def _names(text: str) -> list[str]:
    """Names of several tendons; none for one."""
    found = [name.strip() for name in text.split(",") if name.strip()]
    if text.strip() in ("", NONE) or not found:
        return []
    if len(found) == 1:
        raise InputError(f"'{found[0]}' is one name; give two or more with commas, or {NONE} for one tendon")
    return found


def _text(text: str) -> str:
    if not text.strip():
        raise InputError("needs a name; give one")
    return text.strip()


OPTIONS = (
    ("--name", "Name of the robot."),
    ("--length", "Arc length from base to tip, as 250mm."),
    ("--radius", "Outer radius at the base."),
    ("--tip-radius", "Outer radius at the tip."),
    ("--bore", "Diameter of a bore all along the axis; 0 for none."),
    ("--body", f"What is known of its stiffness: {MODULUS}, {STIFFNESS} (EI), or {RIGID} (a sheath)."),
    ("--modulus", "Young's modulus, as 1.06MPa."),
    ("--modulus-sd", "How well it is known: one standard deviation, as 20%; 0 for exactly."),
    ("--stiffness", "Bending stiffness EI, as 2e-3 'N m^2'."),
    ("--curvature", "Natural curvature of a rigid sheath, as '2 rad/m'."),
    ("--tendons", f"Names of several tendons, with commas; {NONE} for one."),
    ("--friction", "Coulomb friction coefficient between tendon and channel."),
    ("--drive", "What moves a tendon's end at the base: tension or displacement."),
    (
        "--gravity",
        "Direction of gravity in the axes of the base: none, +x (base tangent), -x, +y, -y, +z, -z.",
    ),
    ("--density", "Density, needed with gravity, as '1070 kg/m^3'."),
)


def _options(command: Callable) -> Callable:
    for name, says in reversed(OPTIONS):
        command = click.option(name, help=says, metavar="VALUE")(command)
    return command


@click.command()
@click.argument("path", metavar="ROBOT.toml", type=click.Path(path_type=Path))
@_options
@click.option(
    "--space/--plane",
    default=None,
    help="Whether the robot may leave its plane: a channel about the axis, or tendons around it.",
)
@click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="'KIND NAME=VALUE ...'",
    help="Channel of a tendon: 'parallel offset=8mm'. Give one for all tendons, or one for each in their "
    "order.",
)
@click.option("--yes", "silent", is_flag=True, help="Ask nothing: take the default of what is not given.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def init(
    path: Path, space: bool | None, channels: Sequence[str], silent: bool, force: bool, **given: str | None
) -> int:
    """Write ROBOT.toml from a few questions: body, channel, tendons. Every answer may be given as an option;
    quantities carry their unit (250mm). Each answer is checked at once; a number typed in without a unit
    takes that of the default shown.
    """
    from gtr_jax.config.config import dump_config
    from gtr_jax.config.plausible import implausible

    interruption.says = f"interrupted: {path} was not written"
    if path.suffix.lower() != ".toml":
        raise InputError(f"{path}: a robot file ends with .toml; name it {path.stem or 'robot'}.toml")
    if path.exists() and not force:
        if silent or not click.confirm(f"{path} is there already. Replace it?", err=True):
            raise InputError(f"{path}: is there already; choose another name, or replace it with --force")
    config = asked(Answers(given, silent=silent), path, space=space, channels=channels, silent=silent)
    for line in implausible(config):
        click.echo(f"warning: {line}", err=True)
    with interruption.writing(path):
        dump_config(config, path, note=f"Written by gtr init. {_columns(config)}")
    click.echo(f"robot: {path}")
    for line in hints(config, path):
        click.echo(line)
    return 0


def asked(
    ask: Answers, path: Path, *, space: bool | None, channels: Sequence[str], silent: bool
) -> RobotConfig:
    """The robot that the answers describe, checked as a file is.

    Raises:
        InputError: an option that is not an answer, or answers that do not make a robot.
    """
    from gtr_jax.config.config import parse_config
    from gtr_jax.config.new_robot import DIRECTIONS, FILE, robot_data
    from gtr_jax.config.references import chosen_by_user
    from gtr_jax.robot.build import build_robot
    from gtr_jax.robot.robot import STANDARD_GRAVITY

    name = ask("name", "name of the robot", "robot", _text)
    body, uncertainty = _body(ask)
    tendons = ask("tendons", f"several tendons: their names, with commas ({NONE} for one)", NONE, _names)
    if space is None:
        more = "its channel winds about the axis, or tendons lie around it"
        space = not silent and click.confirm(f"does it leave its plane ({more})?", default=False, err=True)
    friction = ask("friction", "Coulomb friction coefficient", "0.3", _amount("dimensionless", above=False))
    drive = ask(
        "drive", "what drives it, tension or displacement", "tension", _one_of(("tension", "displacement"))
    )
    gravity = NONE
    if not body.get("rigid"):
        directions = (NONE, *DIRECTIONS) if space else PLANE
        says = "gravity in the axes of the base (x along it, y to its left): " + ", ".join(directions)
        gravity = ask("gravity", says, NONE, _one_of(directions))
        if gravity != NONE:
            body["density"] = ask("density", "density", "1070 kg/m^3", _amount("kg/m^3"))
    said = _of_each(channels, max(len(tendons), 1))
    found: list[dict[str, Any]] = []

    def whole(own: dict[str, Any], number: int) -> RobotConfig:
        """The robot with the tendons so far."""
        data = robot_data(
            name=name,
            backbone=body,
            channels=[*found, own],
            tendons=tendons[: number + 1] if number else [],
            friction=friction,
            drive=drive,
            gravity=gravity,
            strength=STANDARD_GRAVITY,
            space=bool(space),
            uncertainty=uncertainty,
        )
        named = [path.parent / channel[FILE] for channel in (*found, own) if FILE in channel]
        with chosen_by_user(named):
            config = parse_config(data, source=str(path), folder=path.parent)
        build_robot(config)  # which sees whether the channel is inside the body
        return config

    config = None
    for number, own in enumerate(said):
        whose = f" of {tendons[number]}" if tendons else ""
        while True:
            channel = _channel(ask, own, body, bool(space), whose, (number, len(said)))
            if FILE in channel and not (path.parent / channel[FILE]).exists():
                # Beside the robot file, or else where the user is.
                here = Path(channel[FILE])
                channel[FILE] = str(here.resolve()) if here.exists() else channel[FILE]
            try:
                config = whole(channel, number)
                break
            except InputError as fault:
                if own or silent:
                    raise
                click.echo(f"Error: {fault}", err=True)
        found.append(channel)
    assert config is not None  # there is at least one tendon
    return config


def _body(ask: Answers) -> tuple[dict[str, Any], dict[str, Any]]:
    """The table of the body, and what is uncertain of it."""
    from gtr_jax.units import quantity_text

    length = ask("length", "length from base to tip", "250 mm", _amount("m"))
    radius = ask("radius", "outer radius at the base", "10 mm", _amount("m"))
    tip = ask("tip-radius", "outer radius at the tip", str(quantity_text(radius, "m")), _amount("m"))
    body: dict[str, Any] = {"length": length, "outer_radius": [radius, tip]}
    kind = ask(
        "body",
        f"its stiffness: {MODULUS} (Young's modulus), {STIFFNESS} (EI), or {RIGID} (a sheath of fixed shape)",
        MODULUS,
        _one_of((MODULUS, STIFFNESS, RIGID)),
    )
    if kind == RIGID:
        body |= {"rigid": True, "natural_curvature": ask("curvature", "its curvature", "0 rad/m", _signed)}
        return body, {}
    if kind == STIFFNESS:
        return body | {"bending_stiffness": ask("stiffness", "EI", "1e-3 N m^2", _amount("N m^2"))}, {}

    def bore(text: str) -> float:
        value = _amount("m", above=False)(text)
        if value >= 2 * min(radius, tip):
            raise InputError(f"'{text}' is not less than the diameter of the body; correct it, or give 0")
        return value

    diameter = ask("bore", "diameter of a bore along the axis (0 for none)", "0 mm", bore)
    if diameter:
        body["bores"] = [{"from": 0.0, "to": length, "diameter": diameter}]
    body["youngs_modulus"] = ask("modulus", "Young's modulus", "1 MPa", _amount("Pa"))
    says = "how well it is known, one standard deviation (0 for exactly)"
    sd = ask("modulus-sd", says, "20 %", _amount("dimensionless", above=False))
    return body, {"backbone.youngs_modulus": sd} if sd else {}


def _signed(text: str) -> float:
    return _amount("rad/m", signed=True)(text)


def _of_each(channels: Sequence[str], count: int) -> list[str]:
    """What is said of the channel of each tendon; "" where nothing is."""
    if len(channels) not in (0, 1, count):
        raise InputError(
            f"--channel: given {len(channels)} times for {count} tendon{'s'[: count - 1]}; give it once for "
            "all, or once for each in their order"
        )
    return list(channels) * count if len(channels) == 1 else list(channels) or [""] * count


def _channel(
    ask: Answers, said: str, body: Mapping[str, Any], space: bool, whose: str, which: tuple[int, int]
) -> dict[str, Any]:
    """The table of a channel, from what was said of it or from questions."""
    from gtr_jax.config.new_robot import FILE, asks, kinds

    own = said.replace(",", " ").split()
    known = kinds(space=space)
    says = f"channel{whose}: {', '.join(known)}"
    kind = ask("channel", says, known[0], _one_of(known), own=own[0] if own else None)
    numbers = {}
    for word in own[1:]:
        key, sign, value = word.partition("=")
        if not sign:
            raise InputError(f"--channel: '{word}' is not NAME=VALUE; write for example {kind} offset=8mm")
        numbers[key] = value
    channel: dict[str, Any] = {"kind": kind}
    wanted = asks(kind, length=body["length"], radius=min(body["outer_radius"]), tendon=which[0], of=which[1])
    for one in wanted:
        given = numbers.pop(one.key, None)
        if one.key == FILE:
            if said and given is None:
                raise InputError(
                    f"--channel: a {kind} needs the file of its knots, as '{kind} file=knots.csv'"
                )
            channel[FILE] = ask("channel", f"{one.says}{whose}", "knots.csv", _text, own=given)
        elif said and given is None:
            channel[one.key] = _amount(one.unit, signed=True)(str(one.default))
        else:
            says = f"{one.key}{whose}, {one.says}"
            check = _amount(one.unit, signed=True)
            channel[one.key] = ask("channel", says, str(one.default), check, own=given)
    # Whatever else a robot file may have in the table: the file's own check refuses what it does not know.
    return channel | numbers


def _columns(config: RobotConfig) -> str:
    """Which columns a recording of the robot needs, in a sentence."""
    from gtr_jax.config.new_robot import columns_of

    strings = config.tendons or (config.tendon,)
    drive = next((t.drive for t in strings if t is not None), "tension")
    needed, more = columns_of(
        config.tendon_names, drive=drive, rigid=config.backbone.rigid, space=config.in_space
    )
    beside = f" Useful besides: {', '.join(more)}." if more else ""
    return f"A recording of it has the columns {', '.join(needed)}.{beside}"


def hints(config: RobotConfig, path: Path) -> list[str]:
    """What to do next, as lines for the terminal."""
    drive = next((t.drive for t in config.tendons or (config.tendon,) if t is not None), "tension")
    amount = "5mm" if drive == "displacement" else "20N"
    whose = f" --tendon {config.tendon_names[0]}" if config.tendon_names else ""
    return [
        _columns(config),
        "Columns with other names or units are mapped: gtr inspect REC.csv -o OUT says how.",
        f"try it: gtr simulate {path}{whose} --pull {amount} --release 0 -o out/simulated",
        f"then:   gtr fit {path} REC.csv -o out/fitted",
    ]
