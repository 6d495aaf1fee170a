"""A plan as a page: the experiment as an instruction for the rig, what it would show, and the others."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from calibrate.inference.channels import ORIENTATION, quantity_of, unit_of, words_of
from gtr_jax.numbers import display_unit, measured_quantity, number, quantity
from gtr_jax.recordings.formats.quantities import QUATERNION, column_of
from gtr_jax.report.page import Figure, Report, Section, Table

from ..planning.candidates import Candidate, listed
from ..planning.choice import Ranked
from ..planning.disturbed import corners
from ..planning.plan import Plan
from ..planning.words import TELLS
from ..planning.worth import ENOUGH, pairs, worth_of_separation
from . import plan_figures as draw
from .diagnosis_figures import plot_history

# Experiments that are listed.
LISTED = 12


def plan_report(plan: Plan, name: str, steps: Sequence[str]) -> Report:
    """Instruction, figures and tables of a plan.

    Args:
        plan: from `calibrate.planning.plan`.
        name: of the robot.
        steps: what to do, a sentence each, from `steps_of`.
    """
    tables, drive, expected = [], *_figures(plan)
    if plan.chosen is not None:
        rows = [(f"{k}.", step) for k, step in enumerate(steps, start=1)]
        tables = [Table("What to do", ("", ""), rows), *_corners(plan)]
    more = Section(
        title="Why this experiment",
        verdict=_why(plan),
        figures=[expected],
        tables=[*_told(plan), *_narrowed(plan), _catalogue(plan), _models(plan)],
    )
    return Report(
        title=f"{name}: what to measure next",
        verdict=plan.says,
        warnings=plan.warnings,
        figures=[drive],
        tables=tables,
        sections=[more],
    )


def _why(plan: Plan) -> str:
    """What the catalogue was judged by."""
    count, models = len(plan.ranked), plan.opened.models
    if plan.opened.rivals:
        return (
            f"{count} experiments were simulated under each of {len(models)} models that may be true. What "
            "counts is how far apart their readings stay once each model has followed the others."
        )
    return f"{count} experiments were simulated. What counts is how much they would narrow the intervals."


def steps_of(plan: Plan, *, file: str, then: str) -> list[str]:
    """What to do at the rig, a sentence or two each; none where no experiment settles anything.

    Args:
        plan: the plan.
        file: name of the file that holds the load history.
        then: what to do with the recording that is then there.
    """
    c = plan.chosen
    if c is None:
        return []
    robot = plan.opened.models[0].robot
    steps = [_prepare(c, plan), _read(c, plan)]
    if c.weight is None:
        what = "displacement" if _by_displacement(plan) else "base tension"
        unit = "m" if what == "displacement" else "N"
        own = c.drive[:, _driven(c)]
        rates = np.abs(np.diff(own)) / np.maximum(np.diff(c.time), 1e-12)
        by = f" of {robot.tendon_names[_driven(c)]}" if robot.tendon_names else ""
        steps.append(
            f"Let the rig follow {file}: {quantity(float(c.time[-1]), 's', 3)}, the {what}{by} up to "
            f"{quantity(float(own.max()), unit, 3)}, at most {_rate(float(rates.max()), unit)}, straight "
            "between the corners below."
        )
        steps.append(
            "Record from the first moment to the last without a break, with the time of each sample; "
            f"{len(c.time)} samples are enough if one falls on each corner, more are better."
        )
    else:
        steps.append(f"Hang the weights of {file} and write down, for each, what both cells show.")
    return [*steps, then]


def _prepare(c: Candidate, plan: Plan) -> str:
    if not c.done:
        as_it_was = (
            "it was for the recordings so far" if plan.opened.command else "the robot file describes it"
        )
        return f"Leave the rig as {as_it_was}."
    return f"Do this to the rig first: {c.done}."


def columns_wanted(c: Candidate, plan: Plan) -> dict[str, str]:
    """The columns that the recording of an experiment needs: quantities, as a mapping names them, and the
    headers that the steps ask for.
    """
    drive = "displacement" if _by_displacement(plan) else "T_base"
    names = plan.opened.models[0].robot.tendon_names
    wanted = ["time", *([f"{drive}.{name}" for name in names] or [drive])]
    wanted += [name for name in c.sd if quantity_of(name) != drive]
    if any(name.startswith(ORIENTATION) for name in plan.opened.noise):
        wanted += QUATERNION  # which a plan does not count, and a fit compares
    return {name: _header(name) for name in wanted}


def _read(c: Candidate, plan: Plan) -> str:
    columns = columns_wanted(c, plan).values()
    before = " beside what was recorded so far" if plan.opened.command else " beside the tensions"
    added = f" New{before}: {listed(c.added)}." if c.added else ""
    return f"Record the columns {', '.join(columns)}.{added}"


def _header(channel: str) -> str:
    quantity_name, _, tendon = channel.partition(".")
    header = column_of(quantity_name).header
    return f"{header}.{tendon}" if tendon else header


def _rate(rate: float, unit: str) -> str:
    display, size = display_unit(unit)
    return number(rate / size, f"{display}/s", 3)


def _by_displacement(plan: Plan) -> bool:
    c = plan.ranked[0].candidate
    return plan.opened.models[0].robot.tendons[_driven(c)].drive == "displacement"


def _driven(c: Candidate) -> int:
    """Number of the tendon that an experiment drives."""
    return int(np.argmax(np.ptp(c.drive, axis=0)))


def _corners(plan: Plan) -> list[Table]:
    """Where the load history bends, for who drives by hand."""
    c = plan.chosen
    if c is None:
        return []
    if c.weight is not None:
        rows = [
            (number(t, "s", 4), quantity(float(b), "N", 3), quantity(float(w), "N", 3))
            for t, b, w in zip(c.time, c.drive[:, 0], c.weight, strict=True)
        ]
        return [Table("The weights", ("time", "on the base cell", "on the tip cell"), rows)]
    own = c.drive[:, _driven(c)]
    unit = "m" if _by_displacement(plan) else "N"
    rows = [
        (number(float(c.time[k]), "s", 4), quantity(float(own[k]), unit, 3)) for k in corners(c.time, own)
    ]
    return [Table("The corners of the load history", ("time", "to"), rows)]


def telling_channel(plan: Plan) -> int:
    """Number of the channel, among those of the chosen experiment, in which the models stay apart most."""
    e, c = plan.expected, plan.ranked[0].candidate
    sd = np.asarray([c.sd[name] for name in e.channels])
    off = (e.after - e.after[:1]) / sd[:, None]
    return int(np.argmax(np.sum(off**2, axis=(0, 2)))) if len(off) > 1 else 0


def _figures(plan: Plan) -> tuple[Figure, Figure]:
    """What is driven, and what would be read."""
    c, e, robot = plan.ranked[0].candidate, plan.expected, plan.opened.models[0].robot
    names = list(robot.tendon_names) or [""]
    if c.weight is not None:
        history = plot_history(c.time, c.drive[:, 0], c.weight)
    else:
        drawn = [tendon.drive == "displacement" for tendon in robot.tendons]
        several = len(names) > 1 or any(drawn)
        history = plot_history(c.time, c.drive if several else c.drive[:, 0], drawn=drawn, names=names)
    k = telling_channel(plan)
    channel, sd = e.channels[k], c.sd[e.channels[k]]
    display, size = display_unit(unit_of(channel))
    by_draw = _by_displacement(plan)
    own = c.drive[:, _driven(c)] if c.weight is None else c.time
    along = "displacement [mm]" if by_draw else "tension at the base [N]"
    labels = (
        along if c.weight is None else "time [s]",
        f"{words_of(channel)} [{display}]",
        f"left after a refit [{display}]",
    )
    drawn_rows = draw.plot_expected(
        1e3 * own if by_draw else own,
        e.rows[:, k] / size,
        [m.name for m in plan.opened.models],
        left=(c.time, (e.after[:, k] - e.after[:1, k]) / size) if plan.opened.rivals else None,
        sd=sd / size,
        labels=labels,
    )
    caption = f"What {words_of(channel)} would be"
    if plan.opened.rivals:
        first = plan.opened.models[0].name
        caption += (
            f" under each model, and below what each would leave if {first} were true and it were refitted; "
            "the band is two standard deviations of the noise."
        )
    else:
        caption += " under the model as it is known so far."
    title = "The experiment" if plan.chosen is not None else "The best experiment of the catalogue"
    return (
        Figure("next-experiment", history, f"{title}: {c.in_words}."),
        Figure("expected", drawn_rows, caption),
    )


def _told(plan: Plan) -> list[Table]:
    """How far the chosen experiment, and the best for each pair, hold the rivals apart."""
    if not plan.opened.rivals:
        return []
    models = plan.opened.models
    rows = [
        (
            f"{models[i].name} / {models[j].name}",
            f"{plan.ranked[0].separation[i, j]:.1f}",
            f"{plan.best_of[i, j]:.1f}",
        )
        for i, j in itertools.combinations(range(len(models)), 2)
    ]
    note = (
        f"In standard errors, once either is refitted to what the other would show; {TELLS:g} tell them "
        "apart. All that is known of their numbers so far is counted."
    )
    heads = ("rivals", "this experiment", "the best of the catalogue")
    return [Table("What it would tell apart", heads, rows, note=note)]


def _narrowed(plan: Plan) -> list[Table]:
    if plan.opened.rivals:
        return []
    first, best = plan.opened.models[0], plan.ranked[0]
    rows = [
        (n.name, measured_quantity(n.centre, before, n.unit), measured_quantity(n.centre, after, n.unit))
        for n, before, after in zip(first.numbers, first.sd, best.sd, strict=True)
    ]
    note = (
        "Standard deviations, from the Fisher information of all recordings so far, of what is known "
        "beforehand, and of the experiment, if the model is right and only noise is added."
    )
    return [Table("What it would narrow", ("number", "now", "with this experiment"), rows, note=note)]


def _catalogue(plan: Plan) -> Table:
    rows = [
        (own.candidate.in_words, quantity(float(own.candidate.time[-1]), "s", 3), *_tells(plan, own))
        for own in plan.ranked[:LISTED]
    ]
    heads = ("pairs told apart", "mean distance") if plan.opened.rivals else ("standard deviations with it",)
    note = "Ranked by what they tell, less the effort of changing the rig or adding an instrument."
    if plan.opened.rivals:
        note += (
            f" Mean distance: over all pairs, in standard errors, of which {ENOUGH:g} are enough. Those with "
            "a star are computed to first order only, which says too much where models follow each other far."
        )
    if len(plan.ranked) > len(rows):
        note += f" {len(plan.ranked) - len(rows)} more are in next.json."
    return Table("The catalogue", ("experiment", "takes", *heads), rows, note=note)


def _tells(plan: Plan, own: Ranked) -> tuple[str, ...]:
    """What an experiment tells, as cells of the table."""
    if not plan.opened.rivals:
        numbers = zip(plan.opened.models[0].numbers, own.sd, strict=True)
        return (
            ", ".join(
                f"{n.name} {quantity(float(sd), n.unit, 2)}" for n, sd in numbers if n.name in plan.wanted
            ),
        )
    both = pairs(own.separation)
    star = "" if own.confirmed else "*"
    mean = worth_of_separation(own.separation, 0.0)
    return (f"{int(np.sum(both > TELLS))} of {len(both)}{star}", f"{mean:.1f}{star}")


def _models(plan: Plan) -> Table:
    rows = [
        (
            m.name,
            m.file,
            number(m.probability, digits=2) if plan.opened.rivals else "",
            ", ".join(
                f"{n.name} = {measured_quantity(n.centre, sd, n.unit)}"
                for n, sd, own in zip(m.numbers, m.sd, m.asked, strict=True)
                if own
            ),
        )
        for m in plan.opened.models
    ]
    heads = ("model", "file", "probability" if plan.opened.rivals else "", "numbers")
    return Table("What is still open", heads, rows)
