"""All parts of the reproduction.

Each is a `Study`: text whose numbers are computed in the run, what the paper states beside what the simulator
gives, figures and tables; `pages` writes them down.
"""

from __future__ import annotations

from collections.abc import Callable

from .antagonist_study import study_antagonists
from .histories import study_histories
from .loads import study_loads
from .manipulator_study import study_manipulators
from .path_study import study_paths
from .printed_study import study_printed
from .study import Study

PARTS = (study_paths, study_printed, study_manipulators, study_histories, study_loads, study_antagonists)


def studies(progress: Callable[[str], None]) -> list[Study]:
    """Run every part of the reproduction.

    Args:
        progress: told each stage.
    """
    return [part(progress) for part in PARTS]
