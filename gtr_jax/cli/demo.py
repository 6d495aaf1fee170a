"""`gtr demo`: a simulation, and a recording with a concealed effect, fitted and diagnosed."""

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
    which a missing effect makes wrong though the fit looks good; and diagnose it. All ship with the package.
    """
    from gtr_jax.examples import CONCEALED, CONCEALED_ROBOT, MADE_WITH, SIMULATED
    from gtr_jax.files.config import load_config
    from gtr_jax.files.driving import Drive
    from gtr_jax.files.recording import read_recording
    from gtr_jax.report.page import render_index
    from gtr_jax.report.simulation import verdict

    from .cache import enable_cache
    from .progress import Progress
    from .run_folder import RunFolder

    config, robot, recording = (
        load_config(SIMULATED),
        load_config(CONCEALED_ROBOT),
        read_recording(CONCEALED),
    )
    history = Drive(pull_and_release(PULL, 0.0, None), None)
    inputs = {"simulated robot": SIMULATED, "recorded robot": CONCEALED_ROBOT, "recording": CONCEALED}
    folder = RunFolder(output, inputs, force=force)
    enable_cache()
    with Progress() as progress:
        simulated = solve_simulation(config, history, progress=progress)
        fitted = solve_fit([robot], [recording], free=("mu", "E"), channels=(), progress=progress)
        diagnosed = solve_diagnosis(robot, [recording], progress=progress)
        progress("drawing")
        with folder.write() as part:
            settings = folder.settings()
            for name in ("simulate", "fit", "diagnose"):
                (part / name).mkdir()
            write_simulation(part / "simulate", simulated, config, settings)
            write_fit(part / "fit", fitted, [recording], [robot], settings)
            write_diagnosis(part / "diagnose", diagnosed, robot, settings)
            links = _links(verdict(simulated), fitted.verdict, f"{diagnosed.verdict}: {diagnosed.says}")
            page = render_index("gtr demo: simulate, fit, diagnose", ABOUT, links)
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
    click.echo(f"all three: {output / 'index.html'}")
    return 0 if simulated.converged and fitted.converged and diagnosed.converged else 1


ABOUT = (
    "Three commands on robots and a recording that ship with the package. The recording is another "
    "simulator's, with noise, made with an effect that the model leaves out: the second report shows that a "
    "fit does not notice, the third that a diagnosis does."
)


def _links(simulated: str, fitted: str, diagnosed: str) -> list[Link]:
    """The three reports, in the order to read them, with what each answered."""
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
    ]
