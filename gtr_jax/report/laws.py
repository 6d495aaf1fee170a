"""What there is to say of laws at the command line: what a robot file may state, and what it states."""

from __future__ import annotations

from gtr_jax.config.config import RobotConfig
from gtr_jax.config.law_section import SIZE, LawSection
from gtr_jax.errors import InputError
from gtr_jax.plots.terms import Loops
from gtr_jax.robot.build import build_robot
from gtr_jax.terms.grammar import FUNCTIONS
from gtr_jax.terms.law import ACTS, VARIABLES

from .term_pages import both_runs, history
from .terms import EXAMPLE_OF_A_LAW, said_of, value_text, wrapped


def law_text() -> str:
    """What a law is, where it may act, of what, and an example."""
    rows = wrapped("law: ", "Physics of your own, as an expression in the robot file.", "")
    rows += ["", "acts on what, from which variables:"]
    for name, place in ACTS.items():
        null = place.neutral if isinstance(place.neutral, str) else f"{place.neutral:g}"
        unit = "a pure number" if place.unit == "dimensionless" else f"in {place.unit}"
        text = f"{place.says}, {unit}; {null} has no effect; of {', '.join(place.variables)}"
        rows += wrapped(f"{name}: ", text, "  ")
    rows += ["", "variables:"]
    for name, variable in VARIABLES.items():
        unit = "" if variable.unit == "dimensionless" else f" [{variable.unit}]"
        rows += wrapped(f"{name}{unit}: ", variable.says, "  ")
    functions = f"+ - * / ^ ( ) pi {' '.join(FUNCTIONS)}"
    rows += ["", *wrapped("written with: ", functions, "")]
    rows += wrapped(
        "parameters: ",
        f"every other key, with its unit; `{SIZE}` is one of them, and at {SIZE} = 0 the law has no effect. "
        "usual.NAME is the range of nine in ten values, its prior in a diagnosis; bounds.NAME its bounds; "
        "`log` names those that are estimated on a logarithmic scale.",
        "",
    )
    rows += ["", "in a robot file:", "", *EXAMPLE_OF_A_LAW]
    return "\n".join([*rows, "", "`gtr terms --law ROBOT.toml` draws what the laws of a file do to a loop."])


def laws_of(config: RobotConfig) -> list[LawSection]:
    """The laws of a robot file; InputError if it has none."""
    found = [term for term in config.terms if isinstance(term, LawSection)]
    if not found:
        raise InputError(
            f'{config.source}: states no law; add [[terms]] with kind = "law" (`gtr terms law` says how)'
        )
    return found


def law_description(config: RobotConfig, section: LawSection) -> str:
    """What a law of a robot file says, with the values of its parameters."""
    term = config.catalogue[section.id]
    rows = said_of(term)
    for q in term.quantities:
        value = f"{value_text(section.parameters[q.name], q.unit)}; usually "
        ends = " to ".join(value_text(end, q.unit) for end in q.usual)
        rows += wrapped(f"{q.name} = ", value + ends, "  ")
    return "\n".join(rows)


def shown_size(section: LawSection) -> float:
    """The size with which a law is drawn: its own, or a typical one where that is zero."""
    return section.parameters[SIZE] or section.as_law.size.typical


def law_loops(config: RobotConfig, section: LawSection, pull: float) -> Loops:
    """A load history of the robot of a file up to a tension [N], with and without one of its laws.

    Raises:
        InputError: the robot has several tendons, or one that is driven by displacement.
    """
    if config.tendons or config.tendon.drive != "tension":
        raise InputError(
            f"{config.source}: laws are drawn for a robot of one tendon that is driven by tension; copy the "
            "law into the file of one"
        )
    robot = build_robot(config)
    time, T_base = history(pull)
    cases = [robot.with_values(**{f"{section.id}.{SIZE}": size}) for size in (0.0, shown_size(section))]
    return both_runs(time, T_base, cases)
