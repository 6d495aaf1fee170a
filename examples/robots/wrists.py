"""Two notched wrists of nitinol: fitted to the first trial of each, predicting the others.

`python -m examples.robots.wrists` reads the recordings where they lie, and writes robot files into wrists,
and docs/robots/wrists.md with pictures that show no recording; one that does goes to out-robots. The
recordings have no licence and do not ship.
"""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import calibrate
import gtr_jax as gtr
from calibrate import Diagnosis, FitResult
from gtr_jax.config.config import dump_config
from gtr_jax.numbers import measured_quantity
from gtr_jax.robot.notches import remaining
from gtr_jax.robot.robot import sections

from .pages import HERE, insist, numbers, page, save, say, table, write
from .wrist_pictures import bodies, models, recorded
from .wrist_trials import (
    COUNT,
    NATURAL,
    WRISTS,
    Says,
    Trial,
    errors,
    interpolated,
    left_out,
    off,
    predicted,
    recording,
    scatter,
    trials,
)
from .wrist_verdicts import Remedy, alike, mended, nearly, settled, way

FOLDER = HERE / "wrists"
MATERIAL = ("E", "superelastic.softening", "superelastic.strain")
SHARED = (*MATERIAL, "mu")
REST_KEYS = tuple(f"backbone.notches.0.natural_angle.{i}" for i in range(COUNT))
# Each model with what is free of every wrist.
ALONE = (
    ("modulus", ("E",)),
    ("modulus and friction", ("E", "mu")),
    ("superelastic, no friction", MATERIAL),
    ("superelastic, with friction", SHARED),
)
# Models of both wrists together: what is free, and what of that each wrist has of its own.
TOGETHER = (
    ("one material and one friction for both", SHARED, ()),
    ("one material, each its own friction", SHARED, ("mu",)),
    ("one plateau and friction, each its own modulus", SHARED, ("E",)),
    ("one modulus and friction, each its own plateau", SHARED, MATERIAL[1:]),
    ("all shared, notches that bend shorter than they are cut", (*SHARED, "notches_end_correction"), ()),
)
RESTS = np.deg2rad(1.0)
REPEATED, SWAPPED = "no model: the first trial, interpolated", "the numbers of the other wrist alone"
(PLAIN, RUBBED, SOFTENED, FOUND), (ONE, HELD, STIFFER, YIELDING, SHORTER) = (
    tuple(says for says, *_ in several) for several in (ALONE, TOGETHER)
)
REMEDIES = {
    HELD: "a friction for each wrist",
    STIFFER: "a modulus for each wrist",
    YIELDING: "a plateau for each wrist",
    SHORTER: "one length by which all notches bend shorter",
}
NITINOL = 28e9  # Pa, the softest that textbooks have of it (martensite)
KNOWN = {"wrist90": "0.61", "wrist150": "1.14"}  # degrees, the authors' law by SOURCE


class Row(NamedTuple):
    """A model of both wrists: a robot of each; and rms errors [degrees] on the first trial, on the others,
    and on these from their own rest, of each wrist. None where there is none.
    """

    says: str
    robots: Mapping[str, gtr.Robot]
    errors: Mapping[str, tuple[float | None, float | None, float | None]]

    @property
    def cells(self) -> list[str]:
        """Of the table."""
        return [self.says, *(degrees(error) for wrist in WRISTS for error in self.errors[wrist])]


def degrees(error: float | None) -> str:
    """An error [degrees] as shown."""
    return "–" if error is None else f"{error:.2f}°"


def superelastic(config: gtr.RobotConfig) -> gtr.RobotConfig:
    """The robot with the term at usual values, to start from."""
    return config.with_values({"terms.superelastic.softening": 0.8, "terms.superelastic.strain": 0.025})


def alone(config: gtr.RobotConfig, first: gtr.Recording, free: Sequence[str]) -> FitResult:
    """A model fitted to one wrist."""
    if MATERIAL[1] in free:
        config = superelastic(config)
    if "mu" not in free:
        config = config.with_values({"friction_coefficient": 0.0})
    return calibrate.fit(config, first, free=(*free, *NATURAL))


def together(
    configs: Sequence[gtr.RobotConfig],
    first: Sequence[gtr.Recording],
    free: Sequence[str],
    own: Sequence[str],
) -> FitResult:
    """A model fitted to both wrists, with their own angles at rest and whatever else is their own."""
    return calibrate.fit(
        [superelastic(config) for config in configs],
        first,
        free=(*free, *NATURAL),
        per_robot=(*own, *NATURAL),
    )


def diagnosed(config: gtr.RobotConfig, first: gtr.Recording) -> Diagnosis:
    """What `gtr diagnose` says of a wrist, whose notches may be bent at rest by a degree more or less."""
    return calibrate.diagnose(config.with_deviations(rested(RESTS)), first)


def rested(angle: float) -> dict[str, float]:
    """The same number [rad] for the angle at rest of each notch, by dotted key."""
    return {key: angle for key in REST_KEYS}


def keep(config: gtr.RobotConfig, name: str, note: str) -> None:
    """A robot file among those that ship."""
    dump_config(config, FOLDER / f"{name}.toml", note=f"{note} By examples/robots/wrists.py.")


def for_a_third(both: FitResult, each: Mapping[str, FitResult]) -> gtr.RobotConfig:
    """The robot file of another wrist of this tube: the shared numbers, and how well they are known of it: to
    their errors in the joint fit, and by as much as the two wrists, fitted one by one, differ. At rest it is
    straight, give or take what the two were bent.
    """
    rests = [e.value for e in both.estimates if e.name.startswith(NATURAL)]
    known = {}
    for name in SHARED:
        one, other = (each[wrist][name].value for wrist in WRISTS)
        estimate = both[name]
        assert estimate.sd is not None
        known[estimate.key] = float(np.hypot(estimate.sd, (one - other) / np.sqrt(2)))
    config = both.recordings[0].config
    assert config is not None
    bent = rested(float(np.sqrt(np.mean(np.square(rests)))))
    named = config.model_copy(update={"name": "wrist-both"})
    return named.with_values(rested(0.0)).with_deviations(known | bent)


def row(says: str, robots: Mapping[str, gtr.Robot], seen: Mapping[str, Sequence[Trial]]) -> Row:
    """A model and its errors."""
    found = Row(says, robots, {w: _errors(functools.partial(predicted, robots[w]), seen[w]) for w in WRISTS})
    say("  " + ", ".join(found.cells))
    return found


def _errors(says: Says, seen: Sequence[Trial]) -> tuple[float, float, float]:
    return off(says, seen[:1]), off(says, seen[1:]), off(says, seen[1:], own_rest=True)


def swapped(fits: Mapping[str, FitResult], seen: Mapping[str, Sequence[Trial]]) -> Row:
    """Each wrist with the material and friction of the other, fitted to that alone, from its own rest."""
    robots, found = {}, {}
    for wrist, other in zip(WRISTS, WRISTS[::-1], strict=True):
        robots[wrist] = fits[wrist].robot.with_values(**{name: fits[other][name].value for name in SHARED})
        says = functools.partial(predicted, robots[wrist])
        found[wrist] = (None, None, off(says, seen[wrist], own_rest=True))
    return Row(SWAPPED, robots, found)


def by_trial(robots: Mapping[str, gtr.Robot], seen: Mapping[str, Sequence[Trial]]) -> str:
    """How far each trial is from the model that was fitted to the first, beside its own scatter."""
    rows = []
    for wrist in WRISTS:
        says = functools.partial(predicted, robots[wrist])
        for k, trial in enumerate(seen[wrist]):
            error = errors(says, [trial])
            rows.append(
                [
                    wrist,
                    f"{k + 1}" + (" (trained on)" if k == 0 else ""),
                    degrees(off(says, [trial])),
                    degrees(float(error.mean())).replace("-", "−"),
                    degrees(float(error.std())),
                    degrees(scatter([trial])),
                    degrees(left_out([trial])),
                ]
            )
    header = [
        "wrist",
        "trial",
        "rms error",
        "mean error",
        "rms about that mean",
        "from a curve fitted to it",
        "left out of that curve",
    ]
    return table(header, rows)


def in_order(rows: Mapping[str, Row]) -> str:
    """What each effect brings first, and what the other brings after it, in both orders, as a table."""
    cells = []
    for effects, steps in (
        ("friction, then plateau", (PLAIN, RUBBED, FOUND)),
        ("plateau, then friction", (PLAIN, SOFTENED, FOUND)),
    ):
        for wrist in WRISTS:
            each = [
                " → ".join(degrees(rows[step].errors[wrist][which]) for step in steps) for which in (0, 1)
            ]
            cells.append([wrist, effects, *each])
    return table(["wrist", "order", "trained on", "held out"], cells)


def first_of_two(rows: Mapping[str, Row]) -> str:
    """Which of plateau and friction, added alone, brings more on the trials trained on, of both wrists."""

    def trained(says: str) -> list[float]:
        return [error for wrist in WRISTS if (error := rows[says].errors[wrist][0]) is not None]

    plateau, friction = trained(SOFTENED), trained(RUBBED)
    if all(a < b for a, b in zip(plateau, friction, strict=True)):
        return "the plateau, then friction, in both wrists"
    if all(a > b for a, b in zip(plateau, friction, strict=True)):
        return "friction, then the plateau, in both wrists"
    return "not the same in both wrists"


def resting(each: Mapping[str, FitResult], both: FitResult) -> str:
    """The shared numbers beside those of each wrist alone, and how much of what is known of each comes from
    which: precisions of the fits to one wrist.
    """
    rows = []
    for name in SHARED:
        ones = [each[wrist][name] for wrist in WRISTS]
        precision = np.array([1 / (e.sd or np.inf) ** 2 for e in ones])
        shown = [measured_quantity(e.value, e.sd, e.unit) for e in (*ones, both[name])]
        rows.append([f"`{name}`", *shown, f"{100 * precision[1] / precision.sum():.0f} %"])
    return table(["number", *(f"{w} alone" for w in WRISTS), "both", f"rests on {WRISTS[1]} by"], rows)


def left(of: Row) -> float:
    """What is left on the trials trained on, both wrists together [degrees]."""
    each = [error for wrist in WRISTS if (error := of.errors[wrist][0]) is not None]
    return float(np.sqrt(np.mean(np.square(each))))


def held_out(of: Row) -> dict[str, float]:
    """Errors on the held-out trials of each wrist [degrees]."""
    return {wrist: error for wrist in WRISTS if (error := of.errors[wrist][1]) is not None}


def brought(rows: Mapping[str, Row]) -> str:
    """What is left on the trials trained on, both wrists together, by what each wrist has of its own."""
    cells = [
        [says, str(len(free) + len(differ)), degrees(left(rows[says]))] for says, free, differ in TOGETHER
    ]
    cells.append(["each wrist alone", str(2 * len(SHARED)), degrees(left(rows[FOUND]))])
    return table(["model", "numbers", "left"], cells)


def remedies(rows: Mapping[str, Row]) -> list[Remedy]:
    """What may be added to one set of numbers for both wrists, and what that brings."""
    return [
        Remedy(REMEDIES[says], len(free) + len(differ) - len(SHARED), left(rows[says]), held_out(rows[says]))
        for says, free, differ in TOGETHER
        if says in REMEDIES
    ]


def deeper(config: gtr.RobotConfig, softer: float) -> float:
    """How much deeper notches would be cut [m] to bend softer by a factor (below 1), by what they leave."""
    tube, depth = config.backbone, config.backbone.notches[0].depth
    radii = jnp.array([tube.outer_radius[0]]), jnp.array([tube.bores[0].diameter / 2])

    def second(cut: float) -> float:
        return float(remaining(*radii, jnp.asarray(cut)).second[0])

    cuts = np.linspace(depth, 1.1 * depth, 1001)
    return float(np.interp(-softer * second(depth), [-second(cut) for cut in cuts], cuts)) - depth


def strained(robot: gtr.Robot, T: float) -> float:
    """Largest strain [-] of what the notches leave, at a base tension [N]."""
    reach = sections(robot).reach
    assert reach is not None
    return float(np.max(np.abs(gtr.simulate(robot, np.array([0.0, T])).curvature[-1]) * reach))


def own(found: FitResult) -> dict[str, gtr.Robot]:
    """The robot of each wrist in a fit of both."""
    return {wrist: part.robot for wrist, part in zip(WRISTS, found.recordings, strict=True)}


def main() -> None:
    """Fit all models, and write the robot files and the page."""
    gtr.enable_cache()
    configs = {wrist: gtr.load_config(FOLDER / f"{wrist}.toml") for wrist in WRISTS}
    seen = {wrist: trials(wrist) for wrist in WRISTS}
    fits: dict[str, Any] = {}
    rows: dict[str, Row] = {}
    with tempfile.TemporaryDirectory() as temporary:
        first = {wrist: recording(wrist, seen[wrist][0], Path(temporary)) for wrist in WRISTS}
        lacks = {wrist: diagnosed(configs[wrist], first[wrist]) for wrist in WRISTS}
        for wrist, found in lacks.items():
            say(f"{wrist}: {found.says}")
        for says, free in ALONE:
            fits[says] = {w: alone(configs[w], first[w], free) for w in WRISTS}
            rows[says] = row(says, {w: fits[says][w].robot for w in WRISTS}, seen)
        for says, free, differ in TOGETHER:
            fits[says] = together([configs[w] for w in WRISTS], [first[w] for w in WRISTS], free, differ)
            rows[says] = row(says, own(fits[says]), seen)
    best, both = fits[FOUND], fits[ONE]
    for wrist in WRISTS:
        keep(best[wrist].config, f"{wrist}-fitted", f"Fitted to the first trial of {wrist}.")
        file = lacks[wrist].files[0]
        keep(
            file.config, f"{wrist}-diagnosed", f"Diagnosed on the first trial of {wrist}. {file.note}".strip()
        )
    third = for_a_third(both, best)
    keep(
        third,
        "wrist-both-fitted",
        "Fitted to the first trials of wrist90 and wrist150 together. For another wrist of this tube give "
        "its own height, spacing, depth, count and markers; here are those of wrist90. [uncertainty] counts "
        "in how much the two wrists differ.",
    )
    other = swapped(best, seen)
    itself = {w: (None, *_errors(functools.partial(interpolated, seen[w][0]), seen[w])[1:]) for w in WRISTS}
    repeated = Row(REPEATED, {}, itself)
    shown = {
        wrist: {RUBBED: rows[RUBBED].robots[wrist], "with the plateau of nitinol": rows[FOUND].robots[wrist]}
        for wrist in WRISTS
    }
    save(bodies(rows[FOUND].robots), "wrists-bodies")
    save(recorded(shown, seen), "wrists-recorded", shows_recording=True)
    save(models(shown, seen), "wrists")
    within = {wrist: [left_out([trial]) for trial in seen[wrist]] for wrist in WRISTS}
    strains: dict[str, float] = {}
    pooled = {wrist: left_out(seen[wrist][1:]) for wrist in WRISTS}
    gaps: dict[str, str] = {}
    for wrist in WRISTS:
        tag = wrist.removeprefix("wrist")
        for key, of in (
            ("off", rows[FOUND]),
            ("both", rows[ONE]),
            ("stiffer", rows[STIFFER]),
            ("itself", repeated),
        ):
            for part, error in zip(("trained", "out", "rest"), of.errors[wrist], strict=True):
                gaps[f"{key}_{part}_{tag}"] = degrees(error)
        mu, held = best[wrist]["mu"], fits[HELD][f"mu@{wrist}"]
        strains[wrist] = strained(best[wrist].robot, float(np.max(seen[wrist][0].T_base)))
        gaps |= {
            f"lacks{tag}": lacks[wrist].says,
            f"mu{tag}": measured_quantity(mu.value, mu.sd, ""),
            f"mu_own{tag}": measured_quantity(held.value, held.sd, ""),
            f"alone{tag}": numbers(best[wrist].estimates),
            f"known{tag}": KNOWN[wrist],
            f"strain{tag}": f"{100 * strains[wrist]:.0f} %",
            f"pooled{tag}": degrees(scatter(seen[wrist][1:])),
            f"pooled_out{tag}": degrees(pooled[wrist]),
            f"swapped{tag}": degrees(other.errors[wrist][2]),
            f"least{tag}": degrees(min(scatter([trial]) for trial in seen[wrist])),
            f"most{tag}": degrees(max(scatter([trial]) for trial in seen[wrist])),
            f"least_out{tag}": degrees(min(within[wrist])),
            f"most_out{tag}": degrees(max(within[wrist])),
        }
    header = ["model"] + [f"{w}: {what}" for w in WRISTS for what in ("trained on", "held out", "own rest")]
    shared = {
        says: numbers([e for e in fits[says].estimates if not e.name.startswith(NATURAL)])
        for says in (ONE, STIFFER, SHORTER)
    }
    stiff, soft = (fits[STIFFER][f"E@{wrist}"].value for wrist in WRISTS)
    mus = [best[wrist]["mu"] for wrist in WRISTS]
    first_effect = first_of_two(rows)
    insist(
        {
            "the plateau comes before friction": first_effect.startswith("the plateau"),
            "the first trials strain the notches far beyond the plateau": all(
                strains[wrist] > 2 * best[wrist][MATERIAL[2]].value for wrist in WRISTS
            ),
            "the wrists disagree in friction": abs(mus[1].value - mus[0].value)
            > 2 * np.linalg.norm([mu.sd or np.inf for mu in mus]),
            "wrist150 is the softer one": soft < stiff,
            "the modulus is well below that of nitinol": all(
                best[wrist]["E"].value < NITINOL / 2 for wrist in WRISTS
            ),
        }
    )
    may = remedies(rows)
    write(
        "wrists",
        page("wrists").format(
            models=table(header, [*(of.cells for of in rows.values()), other.cells, repeated.cells]),
            order=in_order(rows),
            first=first_effect,
            trials=by_trial(rows[FOUND].robots, seen),
            resting=resting(best, both),
            both=shared[ONE],
            shorter=shared[SHORTER],
            stiffer=shared[STIFFER],
            brought=brought(rows),
            softer=f"{100 * (1 - soft / stiff):.0f}",
            deeper=f"{1e6 * deeper(configs[WRISTS[1]], soft / stiff):.1f} µm",
            mended=mended(left(rows[ONE]), may),
            settled=settled(held_out(rows[ONE]), nearly(left(rows[ONE]), may)),
            way=way([mu.value for mu in mus], [fits[HELD][f"mu@{wrist}"].value for wrist in WRISTS]),
            alike=alike(pooled, {wrist: max(within[wrist][1:]) for wrist in WRISTS}),
            mu_both=measured_quantity(both["mu"].value, both["mu"].sd, ""),
            **gaps,
        ),
    )


if __name__ == "__main__":
    main()
