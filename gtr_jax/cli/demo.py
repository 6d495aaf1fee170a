"""`gtr demo`: a simulation and a fit of what ships with the package."""

from __future__ import annotations

from pathlib import Path

import click

from .fit import solve as solve_fit
from .fit import summary as fit_summary
from .fit import write_answer as write_fit
from .options import output_option
from .simulate import pull_and_release
from .simulate import solve as solve_simulation
from .simulate import write_answer as write_simulation

PULL = 45.0


@click.command()
@output_option
def demo(output: Path) -> int:
    """Simulate a manipulator through a full loop, and fit one to a recording; both ship with the package."""
    from gtr_jax.config import load_config
    from gtr_jax.examples import MADE_WITH, RECORDED, RECORDING, SIMULATED
    from gtr_jax.recording import read_recording

    from .cache import enable_cache
    from .progress import Progress
    from .run_folder import RunFolder

    config, recorded, recording = load_config(SIMULATED), load_config(RECORDED), read_recording(RECORDING)
    history = pull_and_release(PULL, 0.0, None)
    inputs = {"simulated robot": SIMULATED, "recorded robot": RECORDED, "recording": RECORDING}
    folder = RunFolder(output, inputs)
    enable_cache()
    with Progress() as progress:
        simulated = solve_simulation(config, history, progress=progress)
        fitted = solve_fit([recorded], [recording], free=("mu", "E"), progress=progress)
        progress("drawing")
        with folder.write() as part:
            settings = folder.settings()
            for name in ("simulate", "fit"):
                (part / name).mkdir()
            write_simulation(part / "simulate", simulated, config, settings)
            write_fit(part / "fit", fitted, [recording], [recorded], settings)
    from gtr_jax.report.simulation import verdict

    click.echo(verdict(simulated))
    click.echo(f"report: {output / 'simulate/report.html'}")
    for line in fit_summary(fitted):
        click.echo(line)
    click.echo(f"The recording is another simulator's, with noise, made with {MADE_WITH}.")
    click.echo(f"report: {output / 'fit/report.html'}")
    return 0 if simulated.converged and fitted.converged else 1
