"""The mechanics: one node equation, one march from the base to the tip, one implicit derivative.

`structure` determines what a compiled program contains, `node` has the equations of a node, `march` solves
them from the base to the tip, `search` finds the unknowns at the base, `solve` makes the solution
differentiable, `history` goes through load steps.
"""

from .bodies import metric_of
from .case import FOREVER, Load, Memory, complete, part_of, untouched
from .history import (
    NodalRobot,
    Step,
    Unloaded,
    advance,
    begin,
    loads_before,
    one_step,
    rest_state,
    steps,
)
from .mesh import increments
from .program_spec import ProgramSpec, SolverOptions, every, in_order

__all__ = [
    "FOREVER",
    "Load",
    "Memory",
    "NodalRobot",
    "ProgramSpec",
    "SolverOptions",
    "Step",
    "Unloaded",
    "advance",
    "begin",
    "complete",
    "every",
    "in_order",
    "increments",
    "loads_before",
    "metric_of",
    "one_step",
    "part_of",
    "rest_state",
    "steps",
    "untouched",
]
