"""What a command answers: the facts as JSON, the verdict as a sentence, and one self-contained HTML page."""

from .page import Figure, Link, Report, Table, render, render_index
from .profile import profile
from .simulation import SimulationAnswer, answer_simulation, simulation_report

__all__ = [
    "Figure",
    "Link",
    "Report",
    "SimulationAnswer",
    "Table",
    "answer_simulation",
    "profile",
    "render",
    "render_index",
    "simulation_report",
]
