"""`python -m benchmarks.slip_march --reference DIR`: can physics beyond Coulomb friction be marched too?

Friction laws that ask for the slip of the tendon (presliding, rate) couple a node with all that lies between
it and the tip. But if the displacement at the base, u(0), is known, the slip

    u(s) = u(0) - int_0^s (nu_0 - nu) ds

is known from the base on, every law is local, and one march solves the equilibrium; u(L) = 0 then determines
u(0): one scalar equation, monotone, for Newton's method. This study solves the noise-free runs of the
independent simulator (DIR, one folder per physics term) in this way, for one tendon without external load,
and says how far it is from them. Where a term remembers tension, friction is held against the neighbouring
node here, not against the base as in the package.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax import channel
from gtr_jax.problem import offset_before
from gtr_jax.robot import sections

RESULTS = Path(__file__).parent / "results/slip_march.md"
NEWTON_AT_NODE, NEWTON_AT_BASE, CLOSED = 3, 30, 1e-12
MAXWELL = np.asarray([0.35, 0.8, 1.5, 2.8])


@dataclasses.dataclass(frozen=True)
class Physics:
    """Parameters of the reference runs, at their null values unless given; see the runs' README."""

    mu: float = 0.3
    x0: float = 0.0
    presliding_law: str = "dahl"
    mu_visc: float = 0.0
    stat_ratio: float = 0.0
    v_str: float = 1e-3
    p_exp: float = 1.0
    N_ref: float = 100.0
    adhesion: float = 0.0
    asym: float = 1.0
    pulley: float = 0.0
    tip_lump: float = 0.0
    patch: tuple[float, float, float] = (0.0, 0.0, 1.0)
    clearance: float = 0.0
    T_clear: float = 3.0
    stiffening: float = 0.0
    ve_ratio: float = 0.0
    ve_tau: float = 10.0


def _clipped(memory, low, high):
    return jnp.where(memory <= low, low, jnp.where(memory >= high, high, memory))


def _passed(p: Physics, T, wrap, length, s, speed, speed_before, sense):
    """Tension behind an interval whose friction is mobilised by `sense`, in [-1, 1]."""
    wrap = wrap * (1 - p.clearance * (1 - jnp.exp(-T / p.T_clear)))
    pressure = T * wrap / jnp.where(length > 0, length, 1.0)
    raised = jnp.maximum(pressure / p.N_ref, 1e-6) ** (p.p_exp - 1)
    mu = p.mu * jnp.where((s > p.patch[0]) & (s < p.patch[1]), p.patch[2], 1.0)
    mu = mu * (jnp.where(length > 0, raised, 1.0) if p.p_exp != 1.0 else 1.0)
    mu = mu * (1 + p.stat_ratio * jnp.exp(-((speed_before / p.v_str) ** 2))) + p.mu_visc * speed
    mu = mu * jnp.where(sense < 0, p.asym, 1.0)
    left = T * jnp.exp(-sense * mu * wrap) - sense * p.adhesion * length
    return jnp.where(left > 0, left, 0.0)


def _mobilised(p: Physics, before, slipped):
    """Mobilisation of friction after a slip: of the Dahl model, or of each Maxwell element."""
    if p.presliding_law == "maxwell-slip":
        return jnp.clip(before + slipped / (p.x0 * MAXWELL), -1, 1)
    sense = jnp.where(slipped >= 0, 1.0, -1.0)
    return sense - (sense - before) * jnp.exp(-jnp.abs(slipped) / p.x0)


def simulator(robot: gtr.Robot, p: Physics):
    """A compiled simulation: (K,) base tensions and steps of time to tip tension, tip angle, displacement,
    Newton steps and what is left of the closing equation.
    """
    s = sections(robot)
    rest_metric = channel.metric_factor(s.rest, s.R)
    middle = s.mesh.s - 0.5 * s.mesh.interval.length
    rows = (
        s.R,
        offset_before(s.R),
        s.mesh.weights,
        s.mesh.interval,
        s.compliance,
        s.rest,
        rest_metric,
        middle,
    )
    elements = len(MAXWELL) if p.presliding_law == "maxwell-slip" else 1

    def march(u_base, T_base, memory, dt):
        def node(carry, x):
            kappas, stretches, phi, T, u = carry
            (
                (R, R_before, w, between, compliance, rest, metric, at),
                (z, u_was, T_was, q_was, k_was, v_was),
            ) = x

            def balance(kappa):
                turn = w[0] * kappa + w[1] * kappas[0] + w[2] * kappas[1] + w[3] * kappas[2]
                wrap = channel.wrap_increment(turn, kappa, kappas[0], R, R_before, between)
                stretch = metric - channel.metric_factor(kappa, R)
                drawn = w[0] * stretch + w[1] * stretches[0] + w[2] * stretches[1] + w[3] * stretches[2]
                u_now = u - drawn
                slip = 0.5 * (u + u_now) - u_was
                speed = jnp.abs(slip) / dt

                def passed(sense):
                    return _passed(p, T, wrap, between.length, at, speed, v_was, sense)

                if p.x0 > 0:
                    z_now = _mobilised(p, z, slip)
                    tension = passed(jnp.mean(z_now))
                else:
                    z_now, tension = z, _clipped(T_was, passed(1.0), passed(-1.0))
                fading = jnp.exp(-dt / p.ve_tau)
                q = q_was * fading + p.ve_ratio * p.ve_tau / dt * (1 - fading) * (kappa - k_was)
                bent = kappa - rest
                error = bent * (1 + p.stiffening * bent**2) + q
                error = error - compliance * tension * channel.moment_arm(kappa, R)
                kept = (z_now, u_was + slip, tension, q, kappa, speed)
                return error, (tension, u_now, stretch, phi + turn, kept)

            kappa = rest
            for _ in range(2):
                kappa = rest + compliance * T * channel.moment_arm(kappa, R)
            for _ in range(NEWTON_AT_NODE):
                error, slope = jax.jvp(lambda k: balance(k)[0], (kappa,), (jnp.ones_like(kappa),))
                kappa = kappa - error / jnp.maximum(slope, 0.3)
            _, (tension, u_now, stretch, phi_now, kept) = balance(kappa)
            carry = (kappa, *kappas[:2]), (stretch, *stretches[:2]), phi_now, tension, u_now
            return carry, kept

        zero = jnp.zeros(())
        low, high = T_base * np.exp(-p.pulley), T_base * np.exp(p.pulley)
        entered = _clipped(memory[2][0], low, high) if p.pulley else T_base
        return jax.lax.scan(node, ((zero,) * 3, (zero,) * 3, zero, entered, u_base), (rows, memory))

    def step(carry, load):
        u, memory, T_tip = carry
        T_base, dt = load

        def improved(state):
            u, low, high, count, _ = state
            left, slope = jax.jvp(lambda u: march(u, T_base, memory, dt)[0][4], (u,), (jnp.ones_like(u),))
            low, high = jnp.where(left < 0, u, low), jnp.where(left > 0, u, high)
            new = u - left / slope
            outside = (new <= low) | (new >= high) | ~jnp.isfinite(new)
            both = jnp.isfinite(low) & jnp.isfinite(high)
            farther = jnp.where(jnp.isfinite(low), u + 1e-3, u - 1e-3)
            inside = jnp.where(both, 0.5 * (low + high), farther)
            return jnp.where(outside & (jnp.abs(left) > CLOSED), inside, new), low, high, count + 1, left

        def unsolved(state):
            return (jnp.abs(state[4]) > CLOSED) & (state[3] < NEWTON_AT_BASE)

        first = (u, -jnp.inf + 0 * u, jnp.inf + 0 * u, 0, jnp.ones_like(u))
        u, _, _, count, _ = jax.lax.while_loop(unsolved, improved, first)
        (_, _, phi, tension, left), memory = march(u, T_base, memory, dt)
        grip = np.exp(-p.tip_lump)
        T_tip = _clipped(T_tip, tension * grip, tension / grip) if p.tip_lump else tension
        return (u, memory, T_tip), (T_tip, phi, u, count, jnp.abs(left))

    nothing = jnp.zeros_like(s.rest)
    z = jnp.zeros((len(s.rest), elements))
    start = (jnp.zeros(()), (z, nothing, nothing, nothing, s.rest, nothing), jnp.zeros(()))
    return jax.jit(lambda T_base, dt: jax.lax.scan(step, start, (T_base, dt))[1])


def compared(folder: Path) -> str:
    """One run as a row of the table."""
    told = json.loads((folder / "physics.json").read_text())
    fields = {f.name for f in dataclasses.fields(Physics)}
    given: dict[str, Any] = {k: v for k, v in told["parameters"].items() if k in fields}
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in given.items()}
    robot, run = gtr.load_robot(folder / "robot.toml"), gtr.read_recording(folder / "recording.csv")
    T_base, clock = np.asarray(run.T_base), np.asarray(run.time)
    dt = np.diff(clock, prepend=2 * clock[0] - clock[1])
    simulate = simulator(robot, Physics(**values))
    jax.block_until_ready(simulate(T_base, dt))
    began = time.perf_counter()
    found = jax.block_until_ready(simulate(T_base, dt))
    seconds = time.perf_counter() - began
    T_tip, angle, u, count, left = map(np.asarray, found)
    off = np.abs(T_tip - np.asarray(run.T_tip))
    allowed = max(3 * told["change_from_half_mesh_N"], 0.002 * T_base.max())
    turned = np.max(np.abs(angle - np.asarray(run.tip_angle)))
    drawn, rms = np.max(np.abs(u - np.asarray(run.displacement))), np.sqrt(np.mean(off**2))
    return (
        f"| {folder.name} | {1e3 * off.max():.1f} | {1e3 * rms:.1f} | {1e3 * allowed:.0f} | "
        f"{1e3 * turned:.2f} | {1e6 * drawn:.0f} | {count.mean():.1f}, {count.max()} | {left.max():.0e} | "
        f"{1e3 * seconds / len(T_base):.2f} |"
    )


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.slip_march", description=__doc__)
    parser.add_argument("--reference", type=Path, required=True, metavar="DIR", help="the reference runs")
    args = parser.parse_args(argv)
    columns = (
        *("run", "worst T_tip [mN]", "rms [mN]", "allowed [mN]", "worst angle [mrad]"),
        *("worst displacement [µm]", "Newton steps at the base, most", "left of u(L) [m]", "ms per step"),
    )
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for folder in sorted(args.reference.iterdir()):
        if (folder / "physics.json").exists() and not gtr.load_robot(folder / "robot.toml").loaded:
            if folder.name not in ("contact", "tip-load"):  # an external force, which is not in this study
                lines.append(compared(folder))
                print(lines[-1], flush=True)
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
