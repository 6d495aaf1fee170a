"""Where the tip may be, given how well friction coefficient and modulus are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.numbers import number

from .model import states_of
from .objective import at_draw
from .option import Option, loads_of, pull_at
from .pose import distance, place_of, turn
from .problem import DesignProblem, wanted_pose
from .space import on_common_mesh
from .tensions import Pull


@dataclasses.dataclass(frozen=True, eq=False)
class Spread:
    """The tip at one target.

    Attributes:
        name: of the target; "tip" where none is a pose. T_base [N], of several tendons of each; branch.
        rms, worst: distance of the tip from where it is to be, or, of a goal, from where the nominal robot
            has it [m]: root mean square over what is not known, and largest on the ellipse.
        rms_turn, worst_turn: the same of the angle [rad].
        ellipse: tips on that ellipse [m], (8, axes).
    """

    name: str
    T_base: Pull
    branch: str
    rms: float
    worst: float
    rms_turn: float
    worst_turn: float
    ellipse: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Robustness:
    """What is not known, and where it puts the tip.

    Attributes:
        sd: relative standard deviations of friction coefficient and modulus. correlation: of the two.
        source: where they are from. deviations: how far the worst case looks.
        spreads: by target. converged: whether all was solved.
    """

    sd: tuple[float, float]
    correlation: float
    source: str
    deviations: float
    spreads: tuple[Spread, ...]
    converged: bool

    @property
    def open(self) -> str:
        """What is not known of the two, in words, and how well: "the modulus known to 20 %"."""
        return " and ".join(f"the {n} known to {number(100 * sd, '%', 3)}" for n, sd in self._named if sd > 0)

    @property
    def exact(self) -> str:
        """What is taken as exact, because nothing is said of it; "" if nothing is."""
        return " and ".join(f"the {name}" for name, sd in self._named if sd == 0)

    @property
    def _named(self) -> Iterator[tuple[str, float]]:
        return zip(("friction coefficient", "modulus"), self.sd, strict=True)


@eqx.filter_jit
def _poses_at(robot, objective, draws, T, released, largest):
    def one(draw):
        states = states_of(at_draw(objective, robot, draw), T, released, largest)
        return states.pose, states.converged

    return jax.lax.map(one, draws)


def robustness_of(problem: DesignProblem, option: Option) -> Robustness | None:
    """Spread of the tip at every target; None if nothing is uncertain."""
    known, target = problem.uncertainty, problem.target
    if not known.known:
        return None
    normal, shares = known.gaussian()
    edge, _ = known.edge(target.robust.deviations)
    draws = np.maximum(np.concatenate([normal, edge]), -0.95)
    robot = on_common_mesh(problem.space, option.config, 1.0)
    states = problem.objective.states
    T, released, largest = loads_of(problem, option.tensions)
    poses, ok = _poses_at(robot, problem.objective, jnp.asarray(draws), T, released, largest)
    poses = np.asarray(poses)
    nominal = np.asarray(option.states.pose)
    spreads = []
    asked = list(enumerate(problem.objective.wanted.pose_state)) or [(-1, i) for i in range(len(states))]
    for i, state in asked:
        pose = target.pose[i] if i >= 0 else None
        at = nominal[state].copy()
        if pose is not None:
            wanted = wanted_pose(pose, in_space=problem.space.config.in_space)
            at = np.where(np.isfinite(wanted), wanted, at)
        gap = poses[:, state] - at
        off = distance(gap)
        turned = turn(gap, direction=pose is not None and pose.turn == "direction")
        few = len(normal)
        spreads.append(
            Spread(
                f"pose[{i}]" if i >= 0 else "tip",
                pull_at(T, state),
                "releasing" if released[state] else "pulling",
                float(np.sqrt(shares @ off[:few] ** 2)),
                float(off[few:].max()),
                float(np.sqrt(shares @ turned[:few] ** 2)),
                float(turned[few:].max()),
                place_of(poses[few + 1 :, state]),
            )
        )
    return Robustness(
        (float(known.sd[0]), float(known.sd[1])),
        known.correlation,
        known.source,
        target.robust.deviations,
        tuple(spreads),
        bool(np.all(np.asarray(ok))),
    )
