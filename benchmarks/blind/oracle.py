"""What any diagnosis could find in a case: the misfit that refitting the base model leaves, noise aside, and
by how much the nearest rival of the effect that is hidden stays behind it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gtr_jax as gtr
from calibrate.diagnosis.hypotheses.hypotheses import base_numbers
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.follow import dimensions_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.prepare import deviations_of, hypotheses_of
from calibrate.diagnosis.screening.screen import STARTS_EACH, screen
from calibrate.diagnosis.search.search import refit_best
from calibrate.fitting.fit import part_of
from calibrate.inference.simulated_rig import SimulatedRig
from gtr_jax.recordings.signals.noise import Noise

from .effects import CATALOGUE

# Rivals refitted to find the nearest, and friction coefficients to refit the base model from.
NEAREST, OTHERS = 6, (0.1, 0.2, 0.35, 0.6)
SEVERAL = ("pair", "triple")


def left(folder: Path, key: dict[str, Any]) -> dict[str, float]:
    """Of a case's noise-free readings, its key, and the noise that its readings have:

    Returns:
        "information", the root of the sum of squares, in variances of the noise, that the base model leaves
        once mu, E and the uncertain dimensions are refitted; the rms of T_tip with the true mu and E,
        "raw_rms_N", and refitted, "refit_rms_N"; "concealment", the share that refitting hides; and of a
        single effect "own" and "rival", the roots of the sums of squares that the best fit of its own term
        and of a term of another kind leave, and "apart", that of their difference, 0 where the rival leaves
        less. Of several effects "own", what the best fit of all their terms leaves, and "least_part", the
        root of what is left in addition without the one of them that is missed least.
    """
    config = gtr.load_config(folder / "robot.toml")
    # All readings, those too that the diagnosis takes for glitches: the key has all.
    recording = gtr.read_recording(folder / "recording.csv", keep_glitches=True)
    robot = gtr.build_robot(config)
    channels = tuple(key["clean"])
    part, _ = part_of("clean", robot, config, recording, channels)
    clean = np.stack([np.asarray(key["clean"][name]) for name in part.channels])
    noise = [_noise(row) for row in part.recorded - clean]
    # The base tension as it was, its knots and noise as they are estimated.
    base = dataclasses.replace(part.T_base, T_base=np.asarray(key["T_base"]))
    part = dataclasses.replace(part, recorded=clean, T_base=base)
    dimensions = dimensions_of(config, robot)
    rig = SimulatedRig(part, robot, [d.name for d in dimensions])
    likelihood = Likelihood((rig,), base_numbers(robot, deviations_of(config, robot)), tuple(dimensions))
    values = {n.name: key[n.name] for n in likelihood.base}
    true = rig(values)
    if true is None:
        raise RuntimeError(f"{folder}: the base model cannot be simulated with the true mu and E")
    likelihood = likelihood.weighed(values, [true], [noise])
    found = _least(likelihood, np.asarray([n.at(values[n.name]) for n in likelihood.base]))
    if found is None:
        raise RuntimeError(f"{folder}: the base model cannot be refitted")
    off = [s.values[rig.where][0] - clean[0] for s in (true, found.seen[0])]
    raw, refit = (float(np.sqrt(np.mean(o**2))) for o in off)
    return {
        "information": float(np.sqrt(found.cost)),
        "raw_rms_N": raw,
        "refit_rms_N": refit,
        "concealment": float(np.clip(1 - refit / max(raw, 1e-12), 0, 1)),
        "noise_N": float(np.hypot(noise[0].sd, key["sd_base"])),
        **(_rivalry(likelihood, found, key["terms"][0]) if key["kind"] == "single" else {}),
        **(_parts(likelihood, found, key["hidden"]) if key["kind"] in SEVERAL else {}),
    }


def _least(likelihood: Likelihood, true: np.ndarray) -> Fitted | None:
    """The base model refitted from the true numbers, and from other friction coefficients: where friction and
    modulus make up for an effect together, the true ones lie in another valley.
    """
    starts = [true, *(np.asarray([likelihood.base[0].at(mu), *true[1:]]) for mu in OTHERS)]
    fits = [likelihood.refit((), start, most=12, exact=False) for start in starts]
    best = min((f for f in fits if f is not None), key=lambda f: f.cost, default=None)
    return best and likelihood.refit((), best.x, most=30)


def _noise(row: np.ndarray) -> Noise:
    """Noise as it is, not as it looks."""
    sd = float(np.std(row))
    return Noise(sd, float(np.clip(np.mean(row[1:] * row[:-1]) / max(sd**2, 1e-300), 0.0, 0.8)))


def _parts(likelihood: Likelihood, base: Fitted, hidden: Sequence[str]) -> dict[str, float]:
    """What the terms of the hidden effects leave together, and how much each is missed beside the others; see
    `left`. Each may be added last.
    """
    terms = [CATALOGUE[effect][0] for effect in hidden]
    hypotheses = hypotheses_of(likelihood.rigs[0].part.robot, base, [likelihood.rigs[0].part])
    of = {h.name: h for h in hypotheses}

    @functools.cache
    def best(places: frozenset[int]) -> Fitted:
        fits = []
        for last in places:
            parent = best(places - {last})
            head, taken = [of[name] for name in parent.names], {n.name for n in parent.numbers}
            own = [h for h in hypotheses if h.kind == terms[last] and not taken & {n.name for n in h.numbers}]
            screened = screen(likelihood, parent, own, head=head)
            fits += [parent, *refit_best(likelihood, head, parent, screened, STARTS_EACH)]
        return min(fits, key=lambda f: f.cost, default=base)

    every = frozenset(range(len(terms)))
    whole = best(every).cost
    missed = [max(best(every - {place}).cost - whole, 0.0) for place in every]
    return {"own": float(np.sqrt(whole)), "least_part": float(np.sqrt(min(missed)))}


def _rivalry(likelihood: Likelihood, base: Fitted, truth: str) -> dict[str, float]:
    """What the term that is hidden leaves, and the best of the others; see `left`."""
    hypotheses = hypotheses_of(likelihood.rigs[0].part.robot, base, [likelihood.rigs[0].part])
    screened = screen(likelihood, base, hypotheses)
    own = [s for s in screened if s.hypothesis.kind == truth]
    others = [s for s in screened if s.hypothesis.kind != truth][:NEAREST]
    least = []
    for some in (own, others):
        fits = refit_best(likelihood, (), base, some, STARTS_EACH) if some else []
        least.append(min([base.cost, *(f.cost for f in fits)]))
    apart = max(least[1] - least[0], 0.0)
    return {k: float(np.sqrt(v)) for k, v in (("own", least[0]), ("rival", least[1]), ("apart", apart))}
