"""What a notebook shows of a fit and of a diagnosis."""

from __future__ import annotations

from calibrate.diagnosis.answer.result import Diagnosis
from calibrate.fitting.result import FitResult
from gtr_jax.notebook import draws
from gtr_jax.numbers import measured_quantity, quantity
from gtr_jax.plots.chart_figure import plot_charts
from gtr_jax.report.card import card
from gtr_jax.report.object_cards import DOTS
from gtr_jax.report.page import Figure, Report, Table

from .diagnosis import first_figure, numbers_table
from .fit import interval
from .fit_charts import fitted_tendon, loop_chart


@draws(FitResult)
def fit_card(fit: FitResult) -> str:
    """Verdict, the loop of the first tendon of the first recording, and the estimates."""
    rows = [
        (
            e.name,
            measured_quantity(e.value, e.sd, e.unit),
            interval(e.lower95, e.upper95, e.sd, e.unit),
            quantity(e.initial, e.unit),
        )
        for e in fit.estimates
    ]
    columns = ("", "fitted ± standard error", "95 % interval", "before")
    return card(
        Report(
            title="Fit",
            verdict=fit.verdict,
            warnings=fit.warnings,
            figures=_loop(fit) if fit.converged else [],
            tables=[Table("Estimates", columns, rows)],
        )
    )


def _loop(fit: FitResult) -> list[Figure]:
    fitted = fit.recordings[0]
    if not fitted.tips or fitted.robot.tendons[0].drive == "displacement":
        return []
    picture = plot_charts([loop_chart([fitted_tendon(fitted, 0, None)])], 3.9)
    whose = f"{fitted.name}: recorded" if len(fit.recordings) > 1 else "Recorded"
    return [Figure("fit", picture, f"{whose} tip tension, by phase, and the fitted model.", DOTS)]


@draws(Diagnosis)
def diagnosis_card(answer: Diagnosis) -> str:
    """What is missing, the picture that shows it best, and the numbers before and after."""
    picture = first_figure(answer)
    numbers = numbers_table(answer)
    return card(
        Report(
            title=f"Diagnosis: {answer.verdict}",
            verdict=answer.says,
            warnings=answer.warnings,
            figures=[] if picture is None else [picture],
            tables=[] if numbers is None else [numbers],
        )
    )
