"""Simulator of tendon-driven continuum manipulators with friction and hysteresis, differentiable through JAX.

Importing it switches JAX to 64-bit floats, which friction memory and implicit gradients need, and lets XLA
compile the march's loop whole (see `gtr_jax.runtime`): import it before computing anything with JAX.
"""

from .interruption import heed_in_the_command

heed_in_the_command()  # before anything heavy is imported

from .runtime import set_up  # noqa: E402

set_up()

from .errors import InputError  # noqa: E402
from .files.config import RobotConfig, dump_config, load_config  # noqa: E402
from .files.recording import Recording, read_recording, write_recording  # noqa: E402
from .mechanics import March  # noqa: E402
from .robot.backbone import Backbone  # noqa: E402
from .robot.build import build_robot, load_robot  # noqa: E402
from .robot.parameters import Parameter, parameters_of  # noqa: E402
from .robot.parts import Loads, Tendon  # noqa: E402
from .robot.robot import Robot  # noqa: E402
from .simulation.equilibrium import equilibrium  # noqa: E402
from .simulation.forces import ChannelForces, channel_forces  # noqa: E402
from .simulation.history import (  # noqa: E402
    Simulation,
    equilibrium_at,
    reading,
    simulate,
)
from .simulation.phases import Switch, label_phases, release_switch  # noqa: E402
from .simulation.sensing import Reading, true_base  # noqa: E402
from .simulation.solution import Equilibrium  # noqa: E402

__all__ = [
    "Backbone",
    "ChannelForces",
    "Equilibrium",
    "InputError",
    "Loads",
    "March",
    "Parameter",
    "Reading",
    "Recording",
    "Robot",
    "RobotConfig",
    "Simulation",
    "Switch",
    "Tendon",
    "build_robot",
    "channel_forces",
    "dump_config",
    "equilibrium",
    "equilibrium_at",
    "label_phases",
    "load_config",
    "load_robot",
    "parameters_of",
    "read_recording",
    "reading",
    "release_switch",
    "simulate",
    "true_base",
    "write_recording",
]
