"""Liu & Alambeigi, RA-L 2022, reproduced: the behind of `gtr paper` and of the page "The paper" in the docs.

Each part is a `Study`: text whose numbers are computed in the run, what the paper states beside what the
simulator gives, figures and tables. `studies` runs them all, `pages` writes them down.
"""

from __future__ import annotations

from collections.abc import Callable

from .study import Statement, Study

__all__ = ["Statement", "Study", "studies"]


def studies(progress: Callable[[str], None]) -> list[Study]:
    """Run every part of the reproduction.

    Args:
        progress: told each stage.
    """
    from .antagonist_study import study_antagonists
    from .histories import study_histories
    from .loads import study_loads
    from .manipulator_study import study_manipulators
    from .path_study import study_paths
    from .printed_study import study_printed

    parts = (
        *(study_paths, study_printed, study_manipulators),
        *(study_histories, study_loads, study_antagonists),
    )
    return [part(progress) for part in parts]
