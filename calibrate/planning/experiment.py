"""The experiment that would tell rivals apart."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from calibrate.diagnosis.decision.decide import UNEXPLAINED, Decision
from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.inference.channels import Orientation, quantity_of
from calibrate.inference.number import values_in
from calibrate.inference.parallel import in_parallel
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import SimulatedRig, valued
from gtr_jax.recordings.base_tension import BaseTension, exact
from gtr_jax.simulation.sensing import cells_show

from .load_histories import checks, menu
from .ways_to_drive import Values, ways_to_drive

# Standard deviation assumed for instruments that were not used: m, m, m, rad, m.
POSE_NOISE = {"tip_x": 3e-4, "tip_y": 3e-4, "tip_z": 3e-4, "tip_angle": 5e-3, "displacement": 1e-4}
# Noise of a cell at the tip where none was, as a share of the largest tension.
CELL_NOISE = 2e-3
# Rivals to separate, the most probable ones.
MOST_RIVALS = 3
# Step of the finite differences, in coordinates.
STEP = 0.05
# Separation [standard errors] above which more brings no advantage.
ENOUGH = 6.0
REMOVED, ALL_REMOVED = "the tendon taken off", "the tendons taken off"


@dataclasses.dataclass(frozen=True, eq=False)
class Experiment:
    """What to measure next.

    Attributes:
        says: in a sentence.
        separates: the models it tells apart, by names of hypotheses.
        expected_probability: expected probability of the true model after the experiment.
        time: of the load history [s], (K,).
        T_base: what to drive: base tensions [N], or displacements [m] of tendons that these drive, (K,
            *tendons); for a check of the cells, the weight on the base cells, (K,).
        T_tip: for a check of the cells, the weight on the tip cells [N], (K,); else None.
        record: channels to record.
        menu: all that was considered, with the separation each reaches [standard errors].
    """

    says: str
    separates: list[tuple[str, ...]]
    expected_probability: float
    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray | None
    record: tuple[str, ...]
    menu: list[tuple[str, float]]


class _Option(NamedTuple):
    """Something to measure: what it is, what is done to the rig ("" for nothing), its load history, the
    channels to record, those of them that the recording did not have, and what it would show under some
    values, in standard deviations of the noise.
    """

    name: str
    done: str
    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray | None
    record: tuple[str, ...]
    added: tuple[str, ...]
    shows: Callable[[Values], np.ndarray | None]

    @property
    def needs(self) -> list[str]:
        """All it takes beyond another load history."""
        return [self.done] * bool(self.done) + ["more recorded"] * bool(self.added)


def _driven(rig: SimulatedRig, load: np.ndarray, tendon: int) -> Observation:
    """The recording with one of its tendons driven along a history of shares of its largest drive, (K,), and
    the others at rest; without its readings.
    """
    part = rig.part

    def drive(i: int) -> BaseTension:
        T = part.drives[i].T_base
        return exact(load * float(T.max()) if i == tendon else np.full(len(load), float(T.min())))

    orientation = None
    if part.orientation is not None:
        unturned = np.broadcast_to(np.eye(3), (len(load), 3, 3))
        orientation = Orientation(unturned, np.zeros((len(load), 3)))
    return dataclasses.replace(
        part,
        T_base=drive(0),
        others=tuple(drive(i) for i in range(1, len(part.drives))),
        time=None,
        trial=None,
        left_out=None,
        origin=None,
        orientation=orientation,
    )


def _options(models: Models, rig: SimulatedRig) -> list[_Option]:
    part, noise = rig.part, models.likelihood.noise[0]
    clock = part.time
    # As many samples as the likelihood simulates: no other program is compiled.
    duration = 20.0 if clock is None else max(float(clock[-1] - clock[0]) / 6, 1.0)
    n = len(part.drives)
    largest = max((float(np.max(T)) for T in part.pulled or part.recorded[: part.tips]), default=1.0)
    # Where there is no cell at the tip, one may be added.
    tip = max((own.sd for own in noise[: part.tips]), default=CELL_NOISE * largest)
    sd = dict.fromkeys(rig.channels[:n], tip)
    if not rig.robot.backbone.rigid:
        sd |= {c: POSE_NOISE[quantity_of(c)] for c in rig.channels if quantity_of(c) in POSE_NOISE}
    sd |= dict(zip(part.channels, [own.sd for own in noise], strict=True))
    every = tuple(c for c in rig.channels if c in sd)
    found = []
    for tendon in range(n):
        drive = part.drives[tendon].T_base
        # Shares of the largest tension; a robot of one tendon is driven in newtons throughout.
        most = 1.0 if part.others or not part.pulled else float(drive.max())
        histories = menu(most, part.samples, duration)
        for name, done, changed in ways_to_drive(list(histories), rig.robot, largest):
            if tendon and done:
                continue
            time, load = histories[name]
            driven = dataclasses.replace(_driven(rig, load / most, tendon), time=time)
            if most != 1.0:
                driven = dataclasses.replace(driven, T_base=exact(load))
            other = SimulatedRig(driven, rig.robot, rig.more, rig.cache)
            # Simulated once, whatever of it is recorded.
            seen = functools.cache(lambda values, other=other: other(dict(values)))
            for channels in dict.fromkeys((tuple(part.channels), every)):

                def shows(values, seen=seen, changed=changed, channels=channels):
                    shown = seen(tuple(changed(values).items()))
                    if shown is None or shown.failed:
                        return None
                    return np.concatenate([shown.values[rig.channels.index(c)] / sd[c] for c in channels])

                added = tuple(c for c in channels if c not in part.channels)
                whose = f" by {part.robot.tendon_names[tendon]}" if part.others else ""
                found.append(
                    _Option(
                        name=name + whose,
                        done=done,
                        time=time,
                        T_base=driven.drive,
                        T_tip=None,
                        record=channels,
                        added=added,
                        shows=shows,
                    )
                )
    bases = [
        drive.sd
        for drive, tendon in zip(part.drives, part.robot.tendons, strict=True)
        if tendon.drive == "tension" and drive.sd > 0
    ]
    sd_base = max(*bases, 1e-6) if bases else tip
    several = len(part.robot.tendon_names)
    for name, (time, base, weight) in checks(largest, duration).items():

        def cells(values, time=time, base=base, weight=weight):
            robot = valued(rig.robot, values_in(values, part.name))
            on = [jnp.asarray(np.tile(w[:, None], (1, several)) if several else w) for w in (base, weight)]
            shown = cells_show(robot, on[0], on[1], jnp.asarray(time))
            each = np.asarray(shown.T_base) / sd_base, np.asarray(shown.T_tip) / tip
            return np.concatenate([np.ravel(values) for values in each])

        found.append(
            _Option(
                name=name,
                done=REMOVED if n == 1 else ALL_REMOVED,
                time=time,
                T_base=base,
                T_tip=weight,
                record=("T_base", "T_tip"),
                added=(),
                shows=cells,
            )
        )
    return found


def _separation(option: _Option, rivals: Sequence[Fitted]) -> float:
    """Least distance [standard errors] between any two rivals after one is refitted to the other, within what
    the present recordings say about its numbers.
    """
    shown = []
    for f in rivals:
        start = option.shows(f.values)
        if start is None:
            return np.inf
        columns = []
        for i, n in enumerate(f.numbers):
            there = option.shows(dict(f.values) | {n.name: n.value(f.x[i] + STEP)})
            if there is None:
                return np.inf
            columns.append((there - start) / STEP)
        shown.append((start, np.stack(columns, axis=1)))
    least = np.inf
    for a, b in itertools.permutations(range(len(rivals)), 2):
        off, J = shown[a][0] - shown[b][0], shown[b][1]
        follow = np.linalg.solve(J.T @ J + rivals[b].information(), J.T @ off)
        least = min(least, np.sqrt(max(float(off @ off - follow @ (J.T @ off)), 0.0)))
    return float(least)


def propose(models: Models, decision: Decision, rig: SimulatedRig) -> Experiment | None:
    """Choose what to measure, and how, that separates the rivals most (T-optimality)."""
    rivals = [models.fits[tuple(sorted(names))] for names in decision.confusion[:MOST_RIVALS]]
    if len(rivals) < 2:
        ranked = [f for f in models.ranked() if f.names != decision.chosen.names]
        rivals = [decision.chosen, *ranked[:1]]
    if len(rivals) < 2:
        return None
    options = _options(models, rig)
    reached = in_parallel(lambda option: _separation(option, rivals), options)
    scored = [(v, o) for v, o in zip(reached, options, strict=True) if np.isfinite(v)]
    if not scored:
        return None
    # Prefer what needs nothing beyond a load history, if it separates the rivals well enough.
    scored.sort(key=lambda s: (-min(s[0], ENOUGH) + 0.5 * len(s[1].needs), -s[0], s[1].name))
    least, best = scored[0]
    expected = 1 / (1 + (len(rivals) - 1) * np.exp(-0.5 * min(least, 20.0) ** 2))
    which = " and ".join(" + ".join(f.names) if f.names else "nothing missing" for f in rivals)
    verb = "would tell" if least > 3 else "is the best of the menu, but would hardly tell"
    return Experiment(
        says=f"{_in_words(best)}: it {verb} {which} apart ({least:.1f} standard errors)."
        + ("" if decision.verdict == UNEXPLAINED else _then(best)),
        separates=[f.names for f in rivals],
        expected_probability=float(expected),
        time=best.time,
        T_base=best.T_base,
        T_tip=best.T_tip,
        record=best.record,
        menu=[(", ".join((o.name, *o.needs)), v) for v, o in scored],
    )


def _in_words(option: _Option) -> str:
    """The experiment as an instruction."""
    if option.T_tip is not None:
        return f"Take the tendon{'s' if option.done == ALL_REMOVED else ''} off and {option.name}"
    done = f", with {option.done}" if option.done else ""
    also = f", and record {', '.join(c.replace('_', ' ') for c in option.added)}" if option.added else ""
    return f"Drive {option.name}{done}{also}"


def _then(option: _Option) -> str:
    """What to do with a new recording that cannot be diagnosed together with the present ones."""
    if option.T_tip is not None or not option.done:
        return ""
    return (
        " Diagnose that recording with diagnosed.toml, changed to say so: the answer is adequate if what the "
        "file holds is right."
    )
