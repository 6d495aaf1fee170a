"""The speed metrics of the project: value, unit, target; compile time apart."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax.interpreters import python, surroundings
from gtr_jax.runtime import LOOP_OPTION, LOOPS

from . import measure, systems
from .systems import System

LANES = 10_000
SAMPLES = 1000


@dataclasses.dataclass(frozen=True)
class Metric:
    """One number to watch.

    Attributes:
        name: dotted.
        value: in `unit`; times are the shortest of repeats, warm.
        unit: e.g. "ms".
        direction: "lower" or "higher" is better.
        target: what the design asks for; None where it asks for nothing.
        cold: seconds of the first call, which compiles; None where that means nothing.
        gated: number that `--gate` compares with the baseline: a ratio taken within one run, never a raw
            time; None where the gate does not look.
        tolerance: share by which `gated` may be worse than the baseline.
        note: how it was measured.
    """

    name: str
    value: float
    unit: str
    direction: str = "lower"
    target: float | None = None
    cold: float | None = None
    gated: float | None = None
    tolerance: float = 0.6
    note: str = ""


def _time(name: str, timed: measure.Timed, unit: str, per: float = 1.0, **kw) -> Metric:
    """A metric from a time; gated as a ratio to the reference work timed right after it."""
    scale = {"s": 1.0, "ms": 1e3, "µs": 1e6}[unit]
    ratio = timed.warm / measure.reference_seconds(0.2)
    return Metric(name, timed.warm / per * scale, unit, cold=timed.cold, gated=ratio, **kw)


def equilibrium(quick: bool) -> Iterator[Metric]:
    """One frictional equilibrium, everything it offers, the robot's numbers traced."""
    for system, target in ((systems.TDCM_1, 0.1), (systems.CONE_WAVE, None), (systems.TDCM_1_LOADED, None)):
        robot = system.robot()
        timed = measure.timed(lambda r, T: gtr.equilibrium(r, T), robot, system.T_base)
        yield _time(f"equilibrium.{system.name}", timed, "ms", target=target, note=f"{_nodes(robot)} nodes")
        if quick:
            return


def _nodes(robot: gtr.Robot) -> int:
    return sum(robot.intervals) + len(robot.intervals)


def _lane(robot: gtr.Robot) -> Callable:
    def lane(x):
        eq = gtr.equilibrium(robot.with_values(mu=x["mu"], E=x["E"]), x["T_base"])
        return eq.T_tip, eq.tip_pose, eq.converged

    return lane


def _halves(batch) -> list:
    count = batch["mu"].shape[0]
    return [jax.tree_util.tree_map(lambda a, i=i: a[i : i + count // 2], batch) for i in (0, count // 2)]


def batch(quick: bool) -> Iterator[Metric]:
    """10^4 equilibria of different friction, modulus and tension, in several arrangements."""
    studied = ((systems.TDCM_1, 10.0),) if quick else ((systems.TDCM_1, 10.0), (systems.TDCM_1_LOADED, None))
    for system, target in studied:
        one = _lane(system.robot())
        lanes = systems.draws(system, LANES)
        halves = _halves(lanes)
        whole = jax.jit(jax.vmap(one))
        chunked = jax.jit(lambda b, one=one: jax.lax.map(one, b, batch_size=250))
        with ThreadPoolExecutor(2) as pool:

            def threads(fn, pool=pool, halves=halves):
                return lambda: list(pool.map(lambda half: jax.block_until_ready(fn(half)), halves))

            found = {
                "vmap": measure.timed(whole, lanes, jit=False),
                "lax.map over 250": measure.timed(chunked, lanes, jit=False),
                "vmap in two threads": measure.timed(threads(whole), jit=False),
                "lax.map over 250 in two threads": measure.timed(threads(chunked), jit=False),
            }
        best = min(found, key=lambda name: found[name].warm)
        yield _time(f"batch.{system.name}", found[best], "µs", LANES, target=target, note=f"fastest: {best}")
        for name, timed in found.items():
            yield Metric(f"batch.{system.name}.{name}", timed.warm / LANES * 1e6, "µs", cold=timed.cold)


def _gradient(robot: gtr.Robot, T_base) -> tuple:
    """Tip tension and its gradient in every number of the robot and in T_base."""
    numbers, structure = eqx.partition(robot, eqx.is_inexact_array)

    def T_tip(x):
        return gtr.equilibrium(eqx.combine(x[0], structure), x[1]).T_tip

    return jax.value_and_grad(T_tip)((numbers, T_base))


def gradient(quick: bool) -> Iterator[Metric]:
    """Value and gradient of all parameters against the value alone."""
    studied = (
        (systems.TDCM_1, systems.HELIX) if quick else (systems.TDCM_1, systems.TDCM_1_LOADED, systems.HELIX)
    )
    for system in studied:
        robot, T_base = system.robot(), jnp.asarray(system.T_base)

        def value(robot, T_base):
            return gtr.equilibrium(robot, T_base).T_tip

        forward = measure.timed(value, robot, T_base)
        both = measure.timed(_gradient, robot, T_base)
        yield _ratio(f"gradient.{system.name}", both, forward, 2.0)
        lanes = systems.draws(system, 1000)
        # Every lane a robot of its own in all its numbers, as in a sweep: nothing is shared between lanes.
        robots = jax.vmap(lambda x, robot=robot: robot.with_values(mu=x["mu"], E=x["E"]))(lanes)
        arrangements = {
            "vmap": jax.vmap,
            "lax.map over 250": lambda fn: lambda r, T: jax.lax.map(lambda x: fn(*x), (r, T), batch_size=250),
        }
        if robot.space:
            del arrangements["lax.map over 250"]  # JAX's cannot batch arrays without elements
        for name, arrange in arrangements.items():
            forward = measure.timed(arrange(value), robots, lanes["T_base"])
            both = measure.timed(arrange(_gradient), robots, lanes["T_base"])
            yield _ratio(f"gradient.{system.name}.{name}", both, forward, 2.0)


def _ratio(name: str, both: measure.Timed, forward: measure.Timed, target: float | None) -> Metric:
    ratio = both.warm / forward.warm
    return Metric(name, ratio, "x forward", target=target, cold=both.cold, gated=ratio, tolerance=0.4)


def _history(system: System) -> jnp.ndarray:
    turns = np.array([0.0, 1.0, 0.0, 1.0, 0.3, 1.0, 0.0]) * system.T_base
    return jnp.asarray(np.interp(np.linspace(0, 6, SAMPLES), np.arange(7), turns))


def history(quick: bool) -> Iterator[Metric]:
    """1,000 samples of pulls and releases; and with the gradient of a sum of squares in four parameters."""
    studied = (systems.TDCM_1, systems.CATHETER, systems.CONE_WAVE, systems.TDCM_1_LOADED)
    for system in studied[:1] if quick else studied:
        robot, T_base = system.robot(), _history(system)
        timed = measure.timed(gtr.simulate, robot, T_base, jit=False)
        yield _time(
            f"history.{system.name}", timed, "s", target=0.2, note=f"{_nodes(robot)} nodes, {SAMPLES} samples"
        )
    if quick:
        return
    robot, T_base = systems.TDCM_1.robot(), _history(systems.TDCM_1)

    def squares(x, T_base):
        return jnp.sum(gtr.simulate(robot.with_values(mu=x[0], E=x[1], r1=x[2], w1=x[3]), T_base).T_tip ** 2)

    x = jnp.stack([robot.value(name) for name in ("mu", "E", "r1", "w1")])
    forward = measure.timed(squares, x, T_base)
    yield _ratio("history.gradient", measure.timed(jax.value_and_grad(squares), x, T_base), forward, None)


def tendons(quick: bool) -> Iterator[Metric]:
    """1,000 samples of an antagonistic pair, one pulled and released beside the other, which is held; and of
    one of the two alone.
    """
    system = systems.ANTAGONISTS
    pulled = _history(system)
    pair = measure.timed(
        gtr.simulate, system.robot(), jnp.stack([pulled, jnp.full_like(pulled, 1.0)], axis=1), jit=False
    )
    alone = measure.timed(gtr.simulate, systems.ONE_OF_THEM.robot(), pulled, jit=False)
    yield _time(
        f"tendons.{system.name}", pair, "s", note=f"{_nodes(system.robot())} nodes, {SAMPLES} samples"
    )
    ratio = _ratio("tendons.pair against one", pair, alone, None)
    yield dataclasses.replace(ratio, unit="x one tendon")


_LOOPS = """
import os
os.environ["XLA_FLAGS"] = "--{option}={options}"
import gtr_jax as gtr, jax
from benchmarks import measure, speed, systems
system = systems.{system}
robot, T_base = system.robot(), speed._history(system)
one = measure.timed(lambda r, T: gtr.equilibrium(r, T), robot, system.T_base)
run = measure.timed(gtr.simulate, robot, T_base, jit=False)
def T_tip(mu):
    return gtr.equilibrium(robot.with_values(mu=mu), system.T_base).T_tip
slope = measure.timed(jax.grad(T_tip), 0.3)
print(one.warm, one.cold, run.warm, run.cold, slope.warm, slope.cold)
"""


def loops(quick: bool) -> Iterator[Metric]:
    """What it is worth to compile a loop into one kernel, and to compute nothing in it twice (see
    `gtr_jax.runtime`).
    """
    own = LOOPS[0].partition("=")[0] + "=1024"
    settings = {"XLA's own": [own], "one kernel": LOOPS[:1], "one kernel, nothing twice": LOOPS}
    for name in ("HELIX",) if quick else ("TDCM_1", "TDCM_1_LOADED", "HELIX"):
        for label, options in settings.items():
            script = _LOOPS.format(option=LOOP_OPTION, options=",".join(options), system=name)
            out = subprocess.run(
                python("-c", script), env=surroundings(), capture_output=True, text=True, check=True
            )
            one, one_cold, run, run_cold, slope, slope_cold = map(float, out.stdout.split())
            yield Metric(f"loops.equilibrium.{name}, {label}", one * 1e3, "ms", cold=one_cold)
            yield Metric(f"loops.gradient by mu.{name}, {label}", slope * 1e3, "ms", cold=slope_cold)
            yield Metric(f"loops.history.{name}, {label}", run, "s", cold=run_cold)


GROUPS: dict[str, Callable[[bool], Iterator[Metric]]] = {
    "equilibrium": equilibrium,
    "batch": batch,
    "gradient": gradient,
    "history": history,
    "tendons": tendons,
    "loops": loops,
}
