"""The result in words and tables; every number in it is read from the result."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from .problem import (
    BENDING_STIFFNESS,
    LENGTH,
    OFFSET,
    POISSONS_RATIO,
    RADIUS,
    YOUNGS_MODULUS,
    cheapest,
)

OURS = "gtr-jax"

NOTES = Path(__file__).with_name("notes.md")


def seconds(value: float) -> str:
    """A time with three digits and a fitting unit."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if value >= scale or unit == "µs":
            digits = max(0, 2 - math.floor(math.log10(value / scale)))
            return f"{value / scale:.{digits}f} {unit}"
    raise AssertionError


def power(level: float) -> str:
    """1e-4 as 10⁻⁴."""
    return "10" + f"{round(math.log10(level)):d}".translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _levels(found: dict[str, Any], problem: str) -> list[str]:
    levels = found["levels"]
    lines = [
        "| | " + " | ".join(f"error ≤ {power(v)}" for v in levels) + " |",
        "|---" * (1 + len(levels)) + "|",
    ]
    for name, solver in found["solvers"].items():
        if "failed" in solver:
            lines.append(f"| {name} | " + " | ".join(["not run"] * len(levels)) + " |")
            continue
        cells = []
        for level in levels:
            point = cheapest(solver["points"], problem, level)
            best = min((p["error"] for p in solver["points"] if p["problem"] == problem), default=None)
            if best is None:
                cells.append("not tried")
            elif point is None:
                cells.append(f"not reached (best {best:.1e})")
            else:
                cold = f", cold {seconds(point['cold_s'])}" if "cold_s" in point else ""
                cells.append(
                    f"**{seconds(point['warm_s'])}** ({point['setting']}; error {point['error']:.1e}{cold})"
                )
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def _batches(found: dict[str, Any], problem: str) -> list[str]:
    lines = ["| | setting | error | per lane | lanes | arranged |", "|---|---|---|---|---|---|"]
    for name, solver in found["solvers"].items():
        for b in solver.get("batches", ()):
            if b["problem"] == problem:
                point = next(
                    p for p in solver["points"] if (p["problem"], p["setting"]) == (problem, b["setting"])
                )
                share = "" if b["converged_share"] == 1 else f" ({b['converged_share']:.1%} converged)"
                lines.append(
                    f"| {name} | {b['setting']} | {point['error']:.1e} | **{seconds(b['lane_s'])}** "
                    f"| {b['count']:,}{share} | {b['arrangement']} |"
                )
    return lines if len(lines) > 2 else []


def _gradients(found: dict[str, Any], problem: str) -> list[str]:
    lines = ["| | setting | value | value and gradient |", "|---|---|---|---|"]
    for name, solver in found["solvers"].items():
        for p in solver.get("points", ()):
            if p["problem"] == problem and "gradient_s" in p:
                lines.append(
                    f"| {name} | {p['setting']} | {seconds(p['warm_s'])} | {seconds(p['gradient_s'])} |"
                )
    return lines if len(lines) > 2 else []


def _ratios(found: dict[str, Any], problem: str) -> str:
    """How the others' times compare with ours, level by level."""
    ours = found["solvers"].get(OURS, {}).get("points", [])
    said = []
    for level in found["levels"]:
        mine = cheapest(ours, problem, level)
        if mine is None:
            continue
        parts = []
        for name, solver in found["solvers"].items():
            theirs = cheapest(solver.get("points", []), problem, level) if name != OURS else None
            if theirs:
                parts.append(f"{name} {theirs['warm_s'] / mine['warm_s']:.2g}")
        if parts:
            said.append(f"{power(level)}: {', '.join(parts)}")
    return "Time of one warm solve over that of gtr-jax, by error — " + "; ".join(said) + "." if said else ""


def _notes(found: dict[str, Any]) -> str:
    """What each solves and how it was set up, with the numbers of this run."""
    solvers = found["solvers"]
    default = [
        f"{p['problem']} {seconds(p['closed_over_s'])}, {seconds(p['argument_s'])} with the robot passed as "
        f"an argument, {seconds(p['friction_s'])} at a friction coefficient of {p['friction_coefficient']:g}"
        for p in solvers.get(OURS, {}).get("default_mesh", [])
    ]
    full = [
        f"{p['setting']}: error {p['error']:.1e} in {seconds(p['warm_s'])}"
        for p in solvers.get("pyelastica", {}).get("points", [])
        if "full load" in p["setting"]
    ]
    return NOTES.read_text().format(
        default=f" At the default mesh: {'; '.join(default)}." if default else "",
        compression=found["tension_N"] / (YOUNGS_MODULUS * math.pi * RADIUS**2),
        full_load=f" ({'; '.join(full)}.)" if full else "",
    )


def markdown(found: dict[str, Any]) -> str:
    """The page."""
    m = found["machine"]
    versions = ", ".join(
        f"{name} {v}"
        for name, v in sorted(
            {
                name: v
                for solver in found["solvers"].values()
                for name, v in solver.get("versions", {}).items()
                if name != "jaxlib"
            }.items()
        )
    )
    lines = [
        "# Against peers",
        "",
        f"`python -m benchmarks.peers --write{' --quick' * found['quick']}` on {m['processor']}, "
        f"{m['cores']} cores, {m['date']}; Python {m['python']}, {versions}. "
        "Solvers run one after another, each in a process and, for the peers, an environment of its own.",
        "",
        f"A rod of {LENGTH:g} m and EI = {BENDING_STIFFNESS:.4g} N m², clamped, inextensible and "
        f"unshearable, with frictionless tendons: one parallel to its midline, {OFFSET * 1e3:g} mm off it, "
        f"under {found['tension_N']:g} N, which bends it in the plane; or others, as said, which take it out "
        f"of every plane (Poisson's ratio {POISSONS_RATIO:g}). The error is the tip's distance from the "
        "reference, over the length. Entered is the cheapest of the settings tried that reaches an error: "
        "in bold the warm time of one solve from the straight rod; cold includes compilation (pyelastica: "
        "import and numba, once).",
        "",
        "![error against time](peers.png)",
        "",
    ]
    for problem in found["problems"]:
        name, tip = problem["name"], ", ".join(f"{v:.9f}" for v in problem["tip_m"])
        loads = ", ".join(f"{f:g}" for f in problem["tip_force_N"])
        force = f", dead tip force ({loads}) N" if any(problem["tip_force_N"]) else ""
        channels = " ".join(f"{c}." for c in problem.get("channels", ()))
        lines += [f"## {name[0].upper()}{name[1:]}", "", f"{channels} Tip at ({tip}) m{force}.".strip(), ""]
        lines += [*_levels(found, name), ""]
        ratios = _ratios(found, name)
        if ratios:
            lines += [ratios, ""]
        batches = _batches(found, name)
        if batches:
            lines += [
                "Many tensions at once, each lane from the straight rod, the fastest of the arrangements "
                "tried on all cores; solve_bvp and pyelastica have no batch and take one lane after another:",
                "",
                *batches,
                "",
            ]
        gradients = _gradients(found, name)
        if gradients:
            lines += [
                "With the gradient of the tip's height in tension and modulus, in reverse mode through the "
                "implicit function theorem:",
                "",
                *gradients,
                "",
            ]
    lines += [_notes(found)]
    failed = [s["failed"] for s in found["solvers"].values() if "failed" in s]
    if failed:
        lines += ["Not run: " + "; ".join(failed) + ".", ""]
    return "\n".join(lines)
