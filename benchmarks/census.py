"""`python -m benchmarks.census [--count N] [--seed S] [--from I]`: random robots with one to three physics
terms of usual sizes, pulled, released and pulled again, and what the runs owe to physics.

Robots with every kind of routing, rigid and not, some with gravity or a force at the tip, and terms whose
numbers are drawn from their usual ranges go through a pull and two closed loops. Counted are

- steps that do not settle (all are flagged);
- robots whose tip tension falls while the base's rises, or rises while it falls;
- robots that give back more over a closed loop than was put in: the work at the base less what is stored
  more afterwards in body, loads, stop, tendon, and friction that is not yet exhausted;
- robots with a tip tension above the base's on the first pull.

Each is told apart by the law that allows it (`allowed`); what no law allows is a bug. The terms of the load
cells change no state and are left out, and so are `superelastic`, a law of metals (these bodies are soft),
and `hyperelastic`, which is `stiffening` on a body of one radius.
Robots of one kind of routing share a mesh, hence a program.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax.config.config import parse_config
from gtr_jax.mechanics import SolverOptions
from gtr_jax.mechanics.channel import tangent_lead
from gtr_jax.mechanics.mesh import increments
from gtr_jax.robot.robot import Robot, sections
from gtr_jax.simulation.history import Simulation
from gtr_jax.terms import REGISTRY, body_hysteresis, presliding, viscoelastic_body
from gtr_jax.terms.term import Bent, Quantity, Term
from gtr_jax.terms.unmoved import unmoved

RESULTS = Path(__file__).parent / "results/census.md"
COUNT, SEED = 2200, 1
LEG = 11  # load steps from one corner of the history to the next
LARGEST_TURN = 2.5  # rad, that the largest base tension would bend the robot by without friction
TURNS_STEPS = 1e-6  # of the largest base tension: least step of the tip's that counts as against the base's
GIVES_BACK = 1e-4  # of the work of a pull: least that counts as given back
SLIPS_BACK = 1e-2  # of the slip's range: slip against the pull beyond which friction held by tension errs
ROUTINGS = {
    "parallel": {"kind": "parallel", "offset": 0.008},
    "sine": {"kind": "straight-sine-straight", "r1": -0.01, "r2": 0.01, "w1": 0.03, "w2": 0.1},
    "wave": {"kind": "converging-sine", "R_max": 0.01, "r_min": 0.006, "n_sine": 6, "sigma": 0.3},
    "cross": {"kind": "crossing-sine", "R_max": 0.012, "r_min": 0.008, "n_sine": 4},
    "table": {"kind": "table", "knots": [[0.0, 0.006], [0.08, 0.01], [0.16, -0.004], [0.25, 0.008]]},
}
LENGTH = 0.25


class Drawn(NamedTuple):
    """A random robot: its parameters by name, SI, its terms, and its load history [N], [s]."""

    index: int
    kind: str
    rigid: bool
    values: dict[str, float]
    terms: tuple[str, ...]
    T_base: np.ndarray
    time: np.ndarray


@functools.cache
def template(kind: str, rigid: bool) -> Robot:
    """The robot of a kind of routing, whose numbers are drawn."""
    data = {
        "schema": 1,
        "name": f"{kind} {'sheath' if rigid else 'robot'}",
        "backbone": {
            "length": LENGTH,
            "outer_radius": [0.02, 0.014],
            "natural_curvature": 1.0,
            "density": 1070.0,
        }
        | ({"rigid": True} if rigid else {"youngs_modulus": 1e6}),
        "routing": ROUTINGS[kind],
        "tendon": {"friction_coefficient": 0.3},
        "loads": {} if rigid else {"gravity_angle": 0.0, "tip_force": [0.1, 0.1]},
    }
    return gtr.build_robot(parse_config(data))


def usual(rng: np.random.Generator, q: Quantity) -> float:
    """A usual size, on a logarithmic scale where the range is wide."""
    low, high = q.usual
    if q.log or (low > 0 and high / low >= 5):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return float(rng.uniform(low, high))


def drawn_term(rng: np.random.Generator, term: Term, length: float) -> dict[str, float]:
    """Usual numbers of a term on a body of some length [m], by name of the parameter."""
    p = {q.name: usual(rng, q) for q in term.quantities}
    if term.id == "local-friction":
        ends = np.sort(rng.uniform(0.0, length, 2))
        p["start"], p["end"] = float(ends[0]), float(ends[1])
    if term.id == "contact":  # a stop that the straight robot does not touch
        while p["distance"] < length * np.cos(p["angle"]):
            p = {q.name: usual(rng, q) for q in term.quantities}
    return {f"{term.id}.{name}": value for name, value in p.items()}


def draw(seed: int, index: int) -> Drawn:
    """The random robot of a number."""
    rng = np.random.default_rng([seed, index])
    kind = str(rng.choice(list(ROUTINGS)))
    rigid = bool(rng.random() < 0.2)
    length = LENGTH
    values: dict[str, float] = {}
    if kind != "table":
        length = values["length"] = float(rng.uniform(0.15, 0.4))
    radius = rng.uniform(0.013, 0.02)
    values["outer_radius_base"], values["outer_radius_tip"] = (
        float(radius),
        float(radius * rng.uniform(0.7, 1.0)),
    )
    arm = 0.9 * values["outer_radius_tip"]
    if kind == "parallel":
        offset = values["offset"] = float(rng.uniform(0.3, 1.0) * arm)
        mean = offset
    elif kind == "sine":
        values["r1"], values["r2"] = (
            float(x) for x in rng.uniform(0.4, 1.0, 2) * arm * rng.choice([-1, 1], 2)
        )
        w1, w2 = np.sort(rng.uniform(0.05, 0.95, 2))
        w2 = max(w2, w1 + 0.15)
        values["w1"], values["w2"] = float(w1 * length), float(min(w2, 1.0) * length)
        mean = 0.5 * (abs(values["r1"]) + abs(values["r2"]))
    elif kind in ("wave", "cross"):
        R_max = rng.uniform(0.5, 1.0) * arm
        if kind == "wave":
            values["sigma"] = float(rng.uniform(0.05, 0.5))
            R_max /= 1 + values["sigma"]
        values["R_max"], values["r_min"] = float(R_max), float(R_max * rng.uniform(0.5, 1.0))
        values["n_sine"] = float(rng.integers(1, 7 if kind == "wave" else 5))
        mean = R_max * (1.0 if kind == "wave" else 0.5)
    else:
        knots = rng.uniform(-1.0, 1.0, 4) * arm
        values |= {f"knot_{k}": float(R) for k, R in enumerate(knots)}
        mean = float(np.mean(np.abs(knots)))
    values["mu"] = float(np.exp(rng.uniform(np.log(0.05), np.log(0.6))))
    T_max = float(np.exp(rng.uniform(np.log(2.0), np.log(60.0))))
    values["natural_curvature"] = (
        float(rng.uniform(-2.0, 2.0) / length) if rigid or rng.random() < 0.3 else 0.0
    )
    if not rigid:
        inertia = np.pi * (0.5 * (values["outer_radius_base"] + values["outer_radius_tip"])) ** 4 / 4
        EI = T_max * max(mean, 0.2 * arm) * length / rng.uniform(0.2, LARGEST_TURN)
        values["E"] = float(EI / inertia)
        area = np.pi * radius**2
        loaded = rng.random() < 0.4
        sag = rng.uniform(0.0, 2.0) if loaded and rng.random() < 0.7 else 0.0
        values["density"] = float(min(sag * EI / (9.81 * area * length**3), 4000.0))
        values["gravity_angle"] = float(rng.uniform(-np.pi, np.pi))
        force = rng.uniform(0.0, 1.0) * EI / length**2 if loaded and rng.random() < 0.7 else 0.0
        angle = rng.uniform(-np.pi, np.pi)
        values["tip_force_x"], values["tip_force_y"] = (
            float(force * np.cos(angle)),
            float(force * np.sin(angle)),
        )
    known = [
        t
        for t in REGISTRY.values()
        if not (t.of_cells or t.event or t.id in ("superelastic", "hyperelastic"))
    ]
    if rigid:
        body = ("stiffening", "viscoelastic-body", "body-hysteresis", "tip-load", "gravity-error", "contact")
        known = [t for t in known if t.id not in body]
    chosen = [str(x) for x in rng.choice([t.id for t in known], rng.integers(1, 4), replace=False)]
    if rigid and "presliding" in chosen and "tendon-stretch" not in chosen:  # nothing else slips there
        chosen = (
            ["tendon-stretch", *chosen][:3]
            if "presliding" in chosen[:2]
            else ["presliding", "tendon-stretch"]
        )
    numbers = {term_id: drawn_term(rng, REGISTRY[term_id], length) for term_id in chosen}
    if rigid:  # no law of the slip's speed acts there, and a robot that has one is refused
        own = {
            kind: {key.partition(".")[2]: jnp.asarray(x) for key, x in of.items()}
            for kind, of in numbers.items()
        }
        chosen = [kind for kind in chosen if kind not in unmoved(REGISTRY, own, chosen, length)]
    for term_id in chosen:
        values |= numbers[term_id]
    low = float(rng.uniform(0.0, 0.5) * T_max) if rng.random() < 0.7 else 0.0
    corners = [0.0, T_max, low, T_max, low, T_max]
    T_base = np.concatenate(
        [[0.0], *(np.linspace(a, b, LEG + 1)[1:] for a, b in itertools.pairwise(corners))]
    )
    step = float(np.exp(rng.uniform(np.log(0.2), np.log(5.0))))
    return Drawn(index, kind, rigid, values, tuple(chosen), T_base, step * np.arange(len(T_base)))


def simulated(d: Drawn) -> tuple[Robot, Simulation]:
    """The robot, and its run with physics terms."""
    robot = template(d.kind, d.rigid).with_values(**d.values)
    # One program for all robots of a kind, whichever terms act.
    return robot.for_any_terms(), gtr.simulate(robot, d.T_base, time=d.time, with_terms=True)


@jax.jit
def stored(robot: Robot, run: Simulation):
    """Energy stored at each step [J], (K,): in the body, its creeping branch and its hysteresis, in dead
    loads, stop, tendon and anchor, and in friction that a slip has not yet exhausted.
    """
    s = sections(robot)
    w = s.mesh.weights
    terms = robot.terms
    stiff = jnp.where(s.compliance > 0, 1 / jnp.where(s.compliance > 0, s.compliance, 1.0), 0.0)

    def total(values):
        return jnp.sum(increments(w, values))

    def bent(kappa):
        e = kappa - s.rest
        return total(stiff * (e**2 / 2 + terms["stiffening"]["coefficient"] * e**4 / 4))

    body = jax.vmap(bent)(run.curvature)

    dt = jnp.diff(run.time, prepend=run.time[:1] - 1.0)

    def remembered(carry, x):
        kept, before = carry
        kappa, dt = x
        out = {
            name: law(terms[name], kappa, Bent(s.rest, before, kept[name], dt))[1]
            for name, law in laws.items()
        }
        return (out, kappa), out

    laws = {"viscoelastic-body": viscoelastic_body.bend, "body-hysteresis": body_hysteresis.bend}
    first = {name: jnp.zeros((REGISTRY[name].remembers, s.rest.shape[0])) for name in laws}
    kept = jax.lax.scan(remembered, (first, run.curvature[0]), (run.curvature, dt))[1]
    ve, bh = terms["viscoelastic-body"], terms["body-hysteresis"]
    ratio = jnp.where(ve["ratio"] > 0, ve["ratio"], 1.0)
    # Of the branches of the body, which follow their sum.
    each = len(viscoelastic_body.APART)
    more = jax.vmap(lambda q: total(stiff * jnp.sum(q[1:] ** 2, axis=0) / 2 / ratio * each))(
        kept["viscoelastic-body"]
    )
    more += (
        jax.vmap(lambda z: total(stiff * z[0] ** 2 / 2))(kept["body-hysteresis"])
        * bh["ratio"]
        * bh["curvature"] ** 2
    )
    x = jax.vmap(lambda phi: jnp.cumsum(increments(w, jnp.cos(phi))))(run.angle)
    y = jax.vmap(lambda phi: jnp.cumsum(increments(w, jnp.sin(phi))))(run.angle)
    along, across = s.force
    loads = -jax.vmap(lambda phi: total(along * jnp.cos(phi) + across * jnp.sin(phi)))(run.angle)
    c = terms["contact"]
    depth = x[:, -1] * jnp.cos(c["angle"]) + y[:, -1] * jnp.sin(c["angle"]) - c["distance"]
    stop = c["stiffness"] * jnp.where(depth > 0, depth, 0.0) ** 2 / 2
    st = terms["tendon-stretch"]
    strain = (
        st["compliance"] * jax.vmap(lambda T: total(T**2 / 2))(run.tension) + st["anchor"] * run.T_tip**2 / 2
    )
    ps = terms["presliding"]
    middle = 0.5 * (run.slip + jnp.concatenate([run.slip[:, :1], run.slip[:, :-1]], axis=1))
    slipped = jnp.diff(middle, axis=0, prepend=0 * middle[:1])

    def mobilised(was, slip):
        z = presliding.mobilise(ps, slip, was)[1]
        return z, z

    z = jax.lax.scan(mobilised, jnp.zeros((1 + len(presliding.BREAK_AWAY), s.rest.shape[0])), slipped)[1]
    share = ps["elements"] / len(presliding.BREAK_AWAY)
    springs = jnp.concatenate([(1 - ps["elements"])[None], share * jnp.asarray(presliding.BREAK_AWAY)])
    psi = jax.vmap(lambda phi, kappa: phi + tangent_lead(kappa, s.R))(run.angle, run.curvature)
    turn = jnp.abs(jnp.diff(psi, axis=1, prepend=psi[:, :1]))
    grip = robot.tendons[0].friction_coefficient * run.tension * turn
    springy = ps["length"] * jnp.einsum("j,kjn,kn->k", springs, z**2, grip) / 2
    return body + more + loads + stop + strain + springy


class Seen(NamedTuple):
    """What a run shows.

    Attributes:
        unsettled: steps that are flagged.
        finite: whether all settled steps are finite.
        against: largest step of the tip tension against the base's, over the largest base tension.
        above: most that the tip tension is above the base's on the first pull, over the same.
        gained: energy left behind by the closed loop that leaves least, over the work of a pull; negative
            where it gives more back than was put in.
        back: largest slip at the base against the pull or the release in a step, over its range.
    """

    unsettled: int
    finite: bool
    against: float
    above: float
    gained: float
    back: float


def examined(d: Drawn, robot: Robot, run: Simulation) -> Seen:
    """What a run shows."""
    T, tip, u = np.asarray(run.T_base), np.asarray(run.T_tip), np.asarray(run.displacement)
    settled, top = np.asarray(run.converged), T.max()
    finite = np.isfinite(tip) & np.isfinite(np.asarray(run.tension)).all(axis=1) & np.isfinite(u)
    way = np.sign(np.diff(T))
    U = np.asarray(stored(robot, run))
    work = 0.5 * (T[1:] + T[:-1]) * np.diff(u)
    left = [work[k : k + 2 * LEG].sum() - (U[k + 2 * LEG] - U[k]) for k in (LEG, 3 * LEG)]
    pull = max(np.abs(work[:LEG]).sum(), 1e-15)
    return Seen(
        # Not those that are flagged because they follow one.
        unsettled=int((~(np.asarray(run.residual_norm) <= SolverOptions().atol)).sum()),
        finite=bool(np.all(finite | ~settled)),
        against=float(max(0.0, np.max(-way * np.diff(tip)))) / top,
        above=float(np.max((tip - T)[: LEG + 1])) / top,
        gained=float(min(left)) / pull,
        back=float(max(0.0, np.max(-way * np.diff(u)))) / max(float(np.ptp(u)), 1e-15),
    )


def changes_with_time(d: Drawn) -> bool:
    """Whether a term of a robot depends on time, speed or cycle, which move its tip tension whichever way the
    base tension goes.
    """
    return any(REGISTRY[kind].timed or kind == "wear" for kind in d.terms)


def allowed(d: Drawn, seen: Seen) -> dict[str, str]:
    """What a run shows that needs a reason, and the law that allows it, "" if none does."""
    found: dict[str, str] = {}
    if seen.unsettled:
        softens = d.values.get("stiffening.coefficient", 0.0) < 0
        found["unsettled"] = "a body that softens gives way at its largest moment" if softens else ""
        return found
    if seen.against > TURNS_STEPS:
        stopped = "a stop bends what friction holds" if "contact" in d.terms else ""
        by_time = "friction or body changes with time" if changes_with_time(d) else stopped
        found["tip tension against the base's"] = by_time
    turned = seen.back > SLIPS_BACK and "presliding" not in d.terms
    if seen.gained < -GIVES_BACK:
        found["energy given back"] = "a load turns the slip against the pull" if turned else ""
    if seen.above > TURNS_STEPS:
        found["tip tension above the base's"] = "a load turns the slip against the pull" if turned else ""
    return found


class Outcome(NamedTuple):
    """A random robot and what its run shows."""

    drawn: Drawn
    seen: Seen


def census(drawn: Iterable[Drawn]) -> Iterator[Outcome]:
    """Simulate random robots, those of one program together."""
    for d in sorted(drawn, key=lambda d: (d.kind, d.rigid)):
        robot, run = simulated(d)
        yield Outcome(d, examined(d, robot, run))


def table(outcomes: list[Outcome]) -> str:
    """The counts as markdown."""
    counts = Counter(
        (kind, law or "none: a bug, or a limit of the solver")
        for o in outcomes
        for kind, law in allowed(*o).items()
    )
    steps = sum(o.seen.unsettled for o in outcomes)
    lines = [
        f"{len(outcomes)} robots of {5 * LEG + 1} steps; {steps} steps unsettled, all flagged.",
        "",
        "| what | law that allows it | robots |",
        "|---|---|---|",
        *(f"| {kind} | {law} | {count} |" for (kind, law), count in sorted(counts.items())),
    ]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Count, print what no law allows, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.census", description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--from", type=int, default=0, dest="start")
    given = parser.parse_args(arguments)
    outcomes = []
    for o in census(draw(given.seed, i) for i in range(given.start, given.start + given.count)):
        outcomes.append(o)
        if "" in allowed(*o).values():
            print(o.drawn.index, o.drawn.kind, o.drawn.rigid, o.drawn.terms, o.seen, flush=True)
    RESULTS.write_text(table(outcomes))
    print(table(outcomes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
