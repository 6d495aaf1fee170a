"""Simulator of tendon-driven continuum manipulators with friction and hysteresis, differentiable through JAX.

Importing this package switches JAX to 64-bit floats, which friction memory and implicit gradients need, and
makes XLA compile the loop of the march as one kernel (see `gtr_jax.runtime`). Import it before computing
anything with JAX; afterwards it warns, and is slower. The package itself imports nothing heavy; each name
below is imported from its file when it is first used.
"""

from .interpreters import leave_the_current_folder

leave_the_current_folder()  # before anything is imported that Python has not needed so far

from .interruption import heed_in_the_command  # noqa: E402

heed_in_the_command()  # before anything heavy is imported

from importlib import import_module  # noqa: E402
from typing import TYPE_CHECKING, Any  # noqa: E402

from .notebook import cards_come_with  # noqa: E402
from .runtime import set_up  # noqa: E402

set_up()


def _import_cards() -> None:
    from .report import object_cards  # noqa: F401


cards_come_with(_import_cards)

if TYPE_CHECKING:
    from .cache import enable_cache
    from .config.config import RobotConfig, dump_config, load_config
    from .errors import InputError
    from .inspection.inspection import Inspection, inspect
    from .mechanics.program_spec import SolverOptions
    from .recordings.recording import Recording, read_recording, write_recording
    from .robot.backbone import Backbone
    from .robot.build import build_robot, load_robot
    from .robot.parameters import Parameter, parameters_of
    from .robot.parts import Loads, Tendon
    from .robot.robot import Robot
    from .simulation.equilibrium import equilibrium
    from .simulation.forces import ChannelForces, channel_forces
    from .simulation.history import Simulation, equilibrium_at, reading, simulate
    from .simulation.markers import marker_angles, marker_places
    from .simulation.phases import label_phases
    from .simulation.release import Switch, release_switch
    from .simulation.sensing import Reading, true_base
    from .simulation.shape import Pose, Shape
    from .simulation.solution import Equilibrium
    from .terms import register_term

# The names of each file; a test checks this table against the imports above.
FILES = {
    "cache": ("enable_cache",),
    "errors": ("InputError",),
    "config.config": ("RobotConfig", "dump_config", "load_config"),
    "recordings.recording": ("Recording", "read_recording", "write_recording"),
    "inspection.inspection": ("Inspection", "inspect"),
    "mechanics.program_spec": ("SolverOptions",),
    "robot.backbone": ("Backbone",),
    "robot.build": ("build_robot", "load_robot"),
    "robot.parameters": ("Parameter", "parameters_of"),
    "robot.parts": ("Loads", "Tendon"),
    "robot.robot": ("Robot",),
    "simulation.equilibrium": ("equilibrium",),
    "simulation.forces": ("ChannelForces", "channel_forces"),
    "simulation.history": ("Simulation", "equilibrium_at", "reading", "simulate"),
    "simulation.markers": ("marker_angles", "marker_places"),
    "simulation.phases": ("label_phases",),
    "simulation.release": ("Switch", "release_switch"),
    "simulation.sensing": ("Reading", "true_base"),
    "simulation.shape": ("Pose", "Shape"),
    "simulation.solution": ("Equilibrium",),
    "terms": ("register_term",),
}
_FILE_OF = {name: file for file, names in FILES.items() for name in names}

__all__ = [
    "Backbone",
    "ChannelForces",
    "Equilibrium",
    "InputError",
    "Inspection",
    "Loads",
    "Parameter",
    "Pose",
    "Reading",
    "Recording",
    "Robot",
    "RobotConfig",
    "Shape",
    "Simulation",
    "SolverOptions",
    "Switch",
    "Tendon",
    "build_robot",
    "channel_forces",
    "dump_config",
    "enable_cache",
    "equilibrium",
    "equilibrium_at",
    "inspect",
    "label_phases",
    "load_config",
    "load_robot",
    "marker_angles",
    "marker_places",
    "parameters_of",
    "read_recording",
    "reading",
    "register_term",
    "release_switch",
    "simulate",
    "true_base",
    "write_recording",
]


def __getattr__(name: str) -> Any:
    """A name of this package, imported from its file."""
    if name not in _FILE_OF:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = getattr(import_module(f".{_FILE_OF[name]}", __name__), name)
    globals()[name] = value  # so that this function is not called again for this name
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
