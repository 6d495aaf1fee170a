"""Sweeps: many robots, loads and histories computed side by side into a labelled store."""

from .config import SweepConfig, load_sweep, parse_sweep
from .run import sweep
from .store import open_sweep
from .task import Task, task_of

__all__ = ["SweepConfig", "Task", "load_sweep", "open_sweep", "parse_sweep", "sweep", "task_of"]
