"""`python -m benchmarks.coverage`: how far the fitted friction is off, and how often its interval holds it.

Noise is added to runs of an independent simulator (rigid links, tendon through guides;
`tests/data/reference`), to both tensions, many times over; each noisy recording is fitted with the base
tension as an unknown and, for comparison, as if it were exact. The truth compared with is the fit to the run
without noise, which takes out the two simulators' discretisation errors.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import calibrate
import gtr_jax as gtr

RUNS = Path(__file__).parents[1] / "tests/data/reference"
RESULTS = Path(__file__).parent / "results/coverage.md"
RESOLUTION = 0.01  # N
LONG = 10_000


class Case(NamedTuple):
    """A reference run with noise: standard deviations of both cells [N], correlation from sample to sample,
    and samples per sample of the run.
    """

    run: str
    sd_base: float
    sd_tip: float
    correlation: float = 0.0
    denser: int = 1


CASES = (
    Case("coulomb", 0.1, 0.05),
    Case("coulomb", 0.1, 0.05, 0.4),
    Case("coulomb", 0.02, 0.05),
    Case("coulomb", 0.1, 0.05, denser=4),
    Case("coulomb", 0.1, 0.05, denser=60),
    Case("coulomb-crossing", 0.1, 0.05),
    Case("coulomb-cone-wave", 0.1, 0.05),
    Case("coulomb-gravity", 0.1, 0.05),
)


COLUMNS = (
    *("run", "σ base [N]", "σ tip [N]", "correlation", "samples", "base tension taken as"),
    *("bias", "scatter", "standard error", "in 95 %", "χ²/n"),
)


class Outcome(NamedTuple):
    """Of many fits: mean deviation of mu and its scatter, both relative, mean standard error, share of 95 %
    intervals that hold the truth, and mean chi2 per degree of freedom.
    """

    bias: float
    scatter: float
    standard_error: float
    coverage: float
    chi2: float


def recorded(case: Case) -> tuple[gtr.RobotConfig, gtr.Recording]:
    """The robot and the run without noise, with as many samples as the case asks for."""
    folder = RUNS / case.run
    run = gtr.read_recording(folder / "recording.csv")
    K = len(run.T_base)
    at = np.linspace(0, K - 1, case.denser * (K - 1) + 1)
    tensions = {name: np.interp(at, np.arange(K), getattr(run, name)) for name in ("T_base", "T_tip", "time")}
    plain = dataclasses.replace(
        run, **tensions, trial=None, tip_x=None, tip_y=None, tip_angle=None, displacement=None
    )
    return gtr.load_config(folder / "robot.toml"), plain


def noisy(case: Case, run: gtr.Recording, seed: int) -> gtr.Recording:
    """The run with noise on both tensions, rounded as a cell's amplifier does."""
    rng = np.random.default_rng(seed)

    def with_noise(T, sd):
        error = rng.normal(size=len(T))
        for k in range(1, len(T)):
            error[k] = case.correlation * error[k - 1] + np.sqrt(1 - case.correlation**2) * error[k]
        return np.round((np.asarray(T) + sd * error) / RESOLUTION) * RESOLUTION

    return dataclasses.replace(
        run, T_base=with_noise(run.T_base, case.sd_base), T_tip=with_noise(run.T_tip, case.sd_tip)
    )


def outcome(case: Case, draws: int, *, trust_base: bool = False) -> Outcome:
    """Fit so many noisy recordings."""
    config, run = recorded(case)
    base = 0.0 if trust_base else None
    truth = calibrate.fit(config, run, noise_base_N=0.0)["mu"].value
    fits = [calibrate.fit(config, noisy(case, run, seed), noise_base_N=base) for seed in range(draws)]
    found = [fit["mu"] for fit in fits]
    values = np.asarray([e.value for e in found])
    inside = [e.lower95 is not None and e.lower95 < truth < (e.upper95 or 0.0) for e in found]
    return Outcome(
        bias=float(values.mean() / truth - 1),
        scatter=float(values.std() / truth),
        standard_error=float(np.mean([e.sd or np.nan for e in found]) / truth),
        coverage=float(np.mean(inside)),
        chi2=float(np.mean([fit.chi2_per_n or np.nan for fit in fits])),
    )


def rows(draws: int) -> Iterator[str]:
    """The table, line by line."""
    yield f"| {' | '.join(COLUMNS)} |"
    yield "|" + "---|" * len(COLUMNS)
    for case in CASES:
        samples = len(recorded(case)[1].T_base)
        # Taken as exact, a long recording is simulated sample by sample: minutes, for what the others show.
        for trust in (False,) if samples > LONG else (False, True):
            o = outcome(case, draws, trust_base=trust)
            yield (
                f"| {case.run} | {case.sd_base:g} | {case.sd_tip:g} | {case.correlation:g} | {samples} | "
                f"{'exact' if trust else 'unknown'} | {100 * o.bias:+.2f} % | {100 * o.scatter:.2f} % | "
                f"{100 * o.standard_error:.2f} % | {100 * o.coverage:.0f} % | {o.chi2:.2f} |"
            )


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage", description=__doc__)
    parser.add_argument("--draws", type=int, default=100, help="noisy recordings per case")
    args = parser.parse_args(argv)
    lines = [f"Friction coefficient fitted to {args.draws} noisy recordings each.", ""]
    for line in rows(args.draws):
        print(line, flush=True)
        lines.append(line)
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
