"""`gtr demo`: a simulation; a recording with a concealed effect, fitted and diagnosed; and one whose cause is
in no catalogue.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .diagnose import solve as solve_diagnosis
from .diagnose import summary as diagnosis_summary
from .diagnose import write_answer as write_diagnosis
from .fit import solve as solve_fit
from .fit import summary as fit_summary
from .fit import write_answer as write_fit
from .options import output_option
from .simulate import pull_and_release
from .simulate import solve as solve_simulation
from .simulate import write_answer as write_simulation

if TYPE_CHECKING:
    from gtr_jax.report.page import Link

PULL = 45.0


@click.command()
@output_option
def demo(output: Path, force: bool) -> int:
    """Simulate a manipulator through a full loop; fit friction and modulus to the tensions of a recording,
    which a missing effect makes wrong though the fit looks good; diagnose it; and diagnose a recording whose
    cause is in no catalogue. All ship with the package.
    """
    from gtr_jax.cache import enable_cache
    from gtr_jax.config.config import load_config
    from gtr_jax.examples import (
        CONCEALED,
        CONCEALED_ROBOT,
        MADE_WITH,
        OUTSIDE,
        OUTSIDE_MADE_WITH,
        OUTSIDE_ROBOT,
        SIMULATED,
    )
    from gtr_jax.recordings.driving import Drive
    from gtr_jax.recordings.recording import read_recording
    from gtr_jax.report.page import render_index
    from gtr_jax.report.simulation import verdict

    from .progress import Progress
    from .run_folder import RunFolder

    config, robot, strange = map(load_config, (SIMULATED, CONCEALED_ROBOT, OUTSIDE_ROBOT))
    recording, unknown = read_recording(CONCEALED), read_recording(OUTSIDE)
    history = Drive(pull_and_release(PULL, 0.0, None), None)
    inputs = {"simulated robot": SIMULATED, "recorded robot": CONCEALED_ROBOT, "recording": CONCEALED}
    inputs |= {"robot of the third recording": OUTSIDE_ROBOT, "third recording": OUTSIDE}
    folder = RunFolder(output, inputs, force=force)
    enable_cache()
    with Progress() as progress:
        simulated = solve_simulation(config, history, progress=progress)
        fitted = solve_fit([robot], [recording], free=("mu", "E"), channels=(), progress=progress)
        diagnosed = solve_diagnosis(robot, [recording], progress=progress)
        discovered = solve_diagnosis(strange, [unknown], progress=progress)
        progress("drawing")
        with folder.write() as part:
            settings = folder.settings()
            for name in ("simulate", "fit", "diagnose", "discover"):
                (part / name).mkdir()
            write_simulation(part / "simulate", simulated, config, settings)
            write_fit(part / "fit", fitted, [recording], [robot], settings)
            write_diagnosis(part / "diagnose", diagnosed, robot, settings)
            write_diagnosis(part / "discover", discovered, strange, settings)
            told = [f"{found.verdict}: {found.says}" for found in (diagnosed, discovered)]
            links = _links(verdict(simulated), fitted.verdict, *told)
            page = render_index("gtr demo: simulate, fit, diagnose, discover", ABOUT, links)
            (part / "index.html").write_text(page, encoding="utf-8")
    click.echo(verdict(simulated))
    click.echo(f"report: {output / 'simulate/report.html'}")
    click.echo("The tensions of a recording, fitted with friction and modulus alone:")
    for line in fit_summary(fitted):
        click.echo(line)
    click.echo(f"report: {output / 'fit/report.html'}")
    click.echo("All of it, diagnosed:")
    for line in diagnosis_summary(diagnosed):
        click.echo(line)
    click.echo(f"The recording is another simulator's, with noise, made with {MADE_WITH}.")
    click.echo(f"report: {output / 'diagnose/report.html'}")
    click.echo("Another recording, whose cause is in no catalogue, diagnosed:")
    for line in diagnosis_summary(discovered):
        click.echo(line)
    click.echo(f"It is another simulator's too, made with {OUTSIDE_MADE_WITH}.")
    click.echo(f"report: {output / 'discover/report.html'}")
    click.echo(f"all four: {output / 'index.html'}")
    answers = (simulated, fitted, diagnosed, discovered)
    return 0 if all(answer.converged for answer in answers) else 1


ABOUT = (
    "Three commands on robots and recordings that ship with the package. The recordings are other "
    "simulators', with noise. The first was made with an effect that the model leaves out: the second report "
    "shows that a fit does not notice, the third that a diagnosis does. The second was made with friction "
    "that no catalogue holds: the fourth report finds it as a law."
)


def _links(simulated: str, fitted: str, diagnosed: str, discovered: str) -> list[Link]:
    """The four reports, in the order to read them, with what each answered."""
    from gtr_jax.report.page import Link

    return [
        Link(
            "gtr simulate",
            "simulate/report.html",
            "A manipulator pulled and released through a full loop: tension at the tip, shape, tension along "
            "the tendon.",
            simulated,
            [("simulate/loop.png", "tension at the tip against tension at the base")],
        ),
        Link(
            "gtr fit",
            "fit/report.html",
            "Friction and modulus fitted to the tensions of the recording alone. The fit looks good, and its "
            "numbers are wrong: something is missing from the model.",
            fitted,
            [("fit/fit.png", "the recording and the fitted model")],
        ),
        Link(
            "gtr diagnose",
            "diagnose/report.html",
            "The same recording with all it holds, diagnosed: which effect is missing, how large it is, what "
            "friction and modulus are with it, and what to measure next.",
            diagnosed,
            [("diagnose/loop.png", "the recording, and the model without and with what was missing")],
        ),
        Link(
            "gtr diagnose",
            "discover/report.html",
            "Another recording, whose cause no term of the catalogue describes: where it acts and of what it "
            "depends, as a law with numbers.",
            discovered,
            [("discover/loop.png", "the recording, and the model without and with the law")],
        ),
    ]
