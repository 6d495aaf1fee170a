"""`python -m benchmarks.space_census [--count N] [--seed S] [--resume]`: random robots in space, of one to
four tendons, half of them under gravity and a force at the tip, pulled through loops that close, and their
mirror images.

The base tensions rise to random sizes and then go round and round, each tendon with a phase of its own.
Counted are

- steps that do not converge (all are flagged), by what the robot is;
- robots whose body, loads and tendons give back more over a loop than was put in: work at the base less the
  growth of the energy stored in the body and of that of the loads;
- robots whose mirror image does not mirror: tip tension or place of the tip.

Robots of one number of tendons share a mesh and the kinds of their channels, hence a program; they run in
lanes, the mirror image of each beside it.
"""

from __future__ import annotations

import argparse
import functools
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax.config.config import parse_config
from gtr_jax.mechanics.mesh import increments
from gtr_jax.robot.robot import Robot, sections

RESULTS = Path(__file__).parent / "results/space-census.md"
COUNT, SEED, LANES = 10_000, 1, 50
LEG, ROUNDS = 6, 3  # load steps of the first pull and of half a loop; loops
LENGTH, RADIUS = 0.25, 0.012
LARGEST_TURN = 2.5  # rad, by which the largest base tensions would bend the robot without friction
GIVES_BACK = 1e-3  # of the work of the first pull: least that counts as given back
MIRRORS = 1e-6  # of the largest base tension, and of the length: most by which a mirror image may differ
CHANNELS: tuple[dict[str, Any], ...] = (
    {"kind": "helix", "radius": 0.008, "turns": 1.0, "start_angle": 0.5, "tip_radius": 0.007},
    {
        "kind": "curve",
        "knots": [[0.0, 0.006, 0.0], [0.08, 0.0, 0.008], [0.17, -0.004, 0.002], [0.25, 0.0, 0.007]],
    },
    {"kind": "straight", "radius": 0.008, "angle": 2.0},
    {"kind": "crossing-sine", "R_max": 0.01, "r_min": 0.007, "n_sine": 3, "plane_angle": 0.7},
)


class Drawn(NamedTuple):
    """Random robots of one program: their numbers by name, (lanes,) each, and histories of their base
    tensions [N], (lanes, K, *tendons).
    """

    tendons: int
    loaded: bool
    values: dict[str, np.ndarray]
    T_base: np.ndarray


class Seen(NamedTuple):
    """What the runs of random robots show, (lanes,) each.

    Attributes:
        unsettled: steps that are flagged.
        finite: whether the others are finite.
        gained: energy given back by the loop that gives back most, over the work of the first pull.
        back: largest slip at a base against its pull or release in a step, over its range.
        tension, place: most by which the mirror image differs, over the largest base tension and the length.
    """

    unsettled: np.ndarray
    finite: np.ndarray
    gained: np.ndarray
    back: np.ndarray
    tension: np.ndarray
    place: np.ndarray


@functools.cache
def template(tendons: int, loaded: bool) -> Robot:
    """The robot whose numbers are drawn."""
    names = "abcd"[:tendons]
    data: dict[str, Any] = {
        "schema": 1,
        "name": f"{tendons} tendons{', loaded' * loaded}",
        "space": True,
        "backbone": {
            "length": LENGTH,
            "outer_radius": [RADIUS, RADIUS],
            "youngs_modulus": 1e6,
            "density": 1000.0,
            "natural_twist": 0.1,
            "natural_curvature_y": 0.1,
            "natural_curvature": 0.1,
        },
        "loads": {"gravity": [0.0, 0.0, -9.81], "tip_force": [0.01, 0.01, 0.01]} if loaded else {},
    }
    each = [
        {"name": n, "friction_coefficient": 0.3, "routing": r} for n, r in zip(names, CHANNELS, strict=False)
    ]
    if tendons == 1:
        data |= {"routing": CHANNELS[0], "tendon": {"friction_coefficient": 0.3}}
    else:
        data |= {"tendons": each}
    return gtr.build_robot(parse_config(data))


def draw(seed: int, index: int, tendons: int, loaded: bool) -> Drawn:
    """The random robots of a number."""
    rng, n = np.random.default_rng([seed, index]), LANES
    arm = 0.9 * RADIUS
    E_I = np.pi / 4 * RADIUS**4
    values: dict[str, np.ndarray] = {"nu": rng.uniform(0.2, 0.5, n)}

    def set_for(k: int, **numbers):
        ending = "" if tendons == 1 else f".{'abcd'[k]}"
        values.update({f"{name}{ending}": value for name, value in numbers.items()})

    for k in range(tendons):
        set_for(k, mu=np.exp(rng.uniform(np.log(0.05), np.log(0.6), n)))
    set_for(
        0,
        radius=rng.uniform(0.3, 1.0, n) * arm,
        tip_radius=rng.uniform(0.3, 1.0, n) * arm,
        turns=rng.uniform(-1.5, 1.5, n),
        start_angle=rng.uniform(-np.pi, np.pi, n),
    )
    if tendons > 1:
        knots = rng.uniform(-0.6, 0.6, (2, 4, n)) * arm
        set_for(1, **{f"knot_{axis}_{j}": knots[i, j] for i, axis in enumerate("yz") for j in range(4)})
    if tendons > 2:
        set_for(2, radius=rng.uniform(0.3, 1.0, n) * arm, angle=rng.uniform(-np.pi, np.pi, n))
    if tendons > 3:
        set_for(
            3,
            R_max=rng.uniform(0.5, 1.0, n) * arm,
            r_min=rng.uniform(0.3, 0.9, n) * arm,
            n_sine=rng.integers(1, 5, n).astype(float),
            plane_angle=rng.uniform(-np.pi, np.pi, n),
        )
    top = np.exp(rng.uniform(np.log(1.0), np.log(20.0), (n, tendons)))
    EI = top.sum(axis=1) * 0.6 * arm * LENGTH / rng.uniform(0.2, LARGEST_TURN, n)
    values["E"] = EI / E_I
    bent = np.where(rng.random(n) < 0.3, 1.0, 0.0) / LENGTH
    for name in ("natural_twist", "natural_curvature_y", "natural_curvature"):
        values[name] = bent * rng.uniform(-1.0, 1.0, n)
    if loaded:
        way = rng.normal(size=(2, 3, n))
        way /= np.linalg.norm(way, axis=1)[:, None]
        sag = rng.uniform(0.0, 2.0, n) * np.where(rng.random(n) < 0.7, 1.0, 0.0)
        values["density"] = np.minimum(sag * EI / (9.81 * np.pi * RADIUS**2 * LENGTH**3), 4000.0)
        force = rng.uniform(0.0, 1.0, n) * np.where(rng.random(n) < 0.7, 1.0, 0.0) * EI / LENGTH**2
        for i, axis in enumerate("xyz"):
            values[f"gravity_{axis}"] = 9.81 * way[0, i]
            values[f"tip_force_{axis}"] = force * way[1, i]
    steps = np.arange(2 * LEG * ROUNDS + 1) / (2 * LEG)
    phase = np.where(np.arange(tendons) == 0, 0.0, rng.uniform(0, 1, (n, tendons)))
    low = rng.uniform(0.0, 0.8, (n, tendons))
    swing = np.abs(2 * np.mod(steps[None, :, None] + phase[:, None, :], 1.0) - 1)  # 1 at the top, 0 below
    loops = top[:, None, :] * (low[:, None, :] + (1 - low[:, None, :]) * swing)
    rise = np.linspace(0, 1, LEG + 1)[None, :-1, None] * loops[:, :1]
    T_base = np.concatenate([rise, loops], axis=1)
    return Drawn(tendons, loaded, values, T_base[..., 0] if tendons == 1 else T_base)


def mirrored(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The numbers of the mirror images in the plane of x and y."""
    turned = ("turns", "start_angle", "angle", "plane_angle", "natural_twist", "natural_curvature_y")

    def flips(name: str) -> bool:
        plain = name.partition(".")[0]
        return plain in turned or plain.startswith("knot_z") or plain in ("gravity_z", "tip_force_z")

    return {name: -v if flips(name) else v for name, v in values.items()}


@functools.cache
def program(tendons: int, loaded: bool):
    """Runs of robots side by side."""
    robot = template(tendons, loaded)

    def one(values, T_base):
        own = robot.with_values(**values)
        run = gtr.simulate(own, T_base, with_terms=False)
        s = sections(own)

        def total(values):
            return jnp.sum(increments(s.mesh.weights, values))

        assert run.shape is not None
        bent = (run.shape.strain - s.rest[None]) ** 2 / s.compliance[None] / 2
        force = jnp.stack(s.force, axis=-1)
        loads = jnp.sum(run.shape.rotation[..., 0] * force[None], axis=-1)
        stored = jax.vmap(total)(jnp.sum(bent, axis=-1) - loads)
        return run.T_tip, run.displacement, run.tip_position, run.converged, stored

    return jax.jit(jax.vmap(one))


def examined(d: Drawn) -> Seen:
    """What the runs of random robots and of their mirror images show."""
    run = program(d.tendons, d.loaded)
    tip, drawn, place, settled, stored = map(np.asarray, run(d.values, d.T_base))
    other = list(map(np.asarray, run(mirrored(d.values), d.T_base)))
    lanes, steps = settled.shape
    T, tip, drawn = (v.reshape(lanes, steps, -1) for v in (d.T_base, tip, drawn))
    work = np.sum(0.5 * (T[:, 1:] + T[:, :-1]) * np.diff(drawn, axis=1), axis=-1)
    pull = np.maximum(np.abs(work[:, :LEG]).sum(axis=1), 1e-15)
    loops = [
        work[:, k : k + 2 * LEG].sum(axis=1) - (stored[:, k + 2 * LEG] - stored[:, k])
        for k in range(LEG, steps - 2 * LEG, 2 * LEG)
    ]
    way = np.sign(np.diff(T, axis=1))
    span = np.maximum(np.ptp(drawn, axis=1), 1e-15)
    back = np.maximum(0.0, -way * np.diff(drawn, axis=1)).max(axis=1) / span
    both = settled & other[3]
    apart = np.abs(tip - other[0].reshape(tip.shape)).max(axis=-1)
    moved = np.linalg.norm(place - other[2] * [1.0, 1.0, -1.0], axis=-1)
    finite = np.isfinite(tip).all(axis=-1) & np.isfinite(place).all(axis=-1) & np.isfinite(stored)
    return Seen(
        unsettled=(~settled).sum(axis=1),
        finite=np.all(finite | ~settled, axis=1),
        gained=-np.min(loops, axis=0) / pull,
        back=back.max(axis=-1),
        tension=np.where(both, apart, 0.0).max(axis=1) / T.max(axis=(1, 2)),
        place=np.where(both, moved, 0.0).max(axis=1) / LENGTH,
    )


def census(count: int, seed: int, known: int = 0) -> Iterator[tuple[Drawn, Seen]]:
    """Random robots and what they show, batch by batch, of every number of tendons by turns; on from as many
    as are known.
    """
    for index in range(known // LANES, -(-count // LANES)):
        tendons, loaded = 1 + index // 2 % 4, bool(index % 2)
        d = draw(seed, index, tendons, loaded)
        yield d, examined(d)


def counted(d: Drawn, seen: Seen) -> Counter[tuple[int, bool, str]]:
    """How many robots show what, by number of tendons and whether loads act."""
    settled = seen.unsettled == 0
    gives = settled & (seen.gained > GIVES_BACK)
    found = {
        "robots": np.ones_like(settled),
        "steps": np.full(settled.shape, d.T_base.shape[1]),
        "unsettled robots": ~settled,
        "unsettled steps": seen.unsettled,
        "not finite": ~seen.finite,
        "energy given back": gives,
        "of them with slip against the pull": gives & (seen.back > 1e-2),
        "mirror image differs": settled & ((seen.tension > MIRRORS) | (seen.place > MIRRORS)),
    }
    return Counter({(d.tendons, d.loaded, name): int(v.sum()) for name, v in found.items()})


def table(total: Counter[tuple[int, bool, str]]) -> str:
    """The counts as markdown."""
    names = list(dict.fromkeys(name for _, _, name in total))
    groups = sorted({key[:2] for key in total})
    lines = ["| tendons | loads | " + " | ".join(names) + " |", "|" + "---|" * (len(names) + 2)]
    for tendons, loaded in groups:
        cells = [str(total[tendons, loaded, name]) for name in names]
        lines.append(f"| {tendons} | {'yes' if loaded else 'no'} | " + " | ".join(cells) + " |")
    whole = [str(sum(total[*group, name] for group in groups)) for name in names]
    return "\n".join([*lines, "| all | | " + " | ".join(whole) + " |"]) + "\n"


def read_table(text: str) -> Counter[tuple[int, bool, str]]:
    """The counts of a table."""
    header, _, *rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    return Counter(
        {
            (int(tendons), loads == "yes", name): int(value)
            for tendons, loads, *values in rows
            if tendons != "all"
            for name, value in zip(header[2:], values, strict=True)
        }
    )


def robots(total: Counter[tuple[int, bool, str]]) -> int:
    """How many were counted."""
    return sum(v for (_, _, name), v in total.items() if name == "robots")


def main(arguments: list[str] | None = None) -> int:
    """Count, and write the table after every batch."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.space_census", description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--resume", action="store_true", help="count on from the table that a run of the default seed left"
    )
    given = parser.parse_args(arguments)
    if given.resume and given.seed != SEED:
        parser.error(f"the table that is counted on from is of the seed {SEED}")
    total: Counter[tuple[int, bool, str]] = Counter()
    if given.resume and RESULTS.exists():
        total = read_table(RESULTS.read_text())
    for d, seen in census(given.count, given.seed, robots(total)):
        total.update(counted(d, seen))
        for i in np.flatnonzero((seen.unsettled > 0) | (seen.gained > GIVES_BACK)):
            print(d.tendons, d.loaded, i, *(f"{name} {getattr(seen, name)[i]:.3g}" for name in Seen._fields))
        print(robots(total), "robots", flush=True)
        RESULTS.write_text(table(total))
    print(table(total))
    return 0


if __name__ == "__main__":
    sys.exit(main())
