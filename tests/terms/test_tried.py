"""What a diagnosis tries of each effect, as the file of the effect states it."""

import dataclasses

import numpy as np
import pytest

from calibrate.diagnosis.hypotheses.hypotheses import DELAYS, INSTRUMENT_NUMBERS, catalogue
from gtr_jax.errors import InputError
from gtr_jax.terms import REGISTRY, Prior, Quantity, Term, Tried, Variant
from gtr_jax.terms.own import check_term
from gtr_jax.terms.tried import At, Rig, Start, fault_of

GIVEN = {"timed": True, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0, "displaced": True}
SIZE = Quantity("size", "N/m", 0.0, 2.0, "Force per length.", (0.2, 10.0), 0.0)
FADE = Quantity("fade", "N/m", 40.0, 40.0, "Pressure over which it fades.", (10.0, 200.0), 1.0, size=False)


def large(rig: Rig) -> dict[str, Prior]:
    return {"size": Prior(sd=rig.largest_tip / rig.length)}


def slow_fading(at: At, rig: Rig) -> list[Start]:
    return [{"size": at["size"](1.0), "fade": 30.0}]


def misspelt(at: At, rig: Rig) -> list[Start]:
    return [{"size": at["sise"](1.0)}]


DRAG = Term(
    id="my-drag",
    says="A drag.",
    law="dT/ds lowered by size (1 + p/fade)",
    seen="Loss.",
    told_apart="Look.",
    quantities=(SIZE, FADE),
    tried=Tried(
        variants=(
            Variant(free=("size",)),
            Variant("fading", ("size", "fade"), large, slow_fading),
        )
    ),
    drag=lambda p, at: p["size"] * (1 + at.pressure / p["fade"]),
)


@pytest.mark.parametrize("kind", REGISTRY)
def test_every_effect_is_tried_as_its_file_says(make_robot, kind):
    term = REGISTRY[kind]
    typical = {q.name: q.typical for q in term.quantities}
    assert not fault_of(term.tried, typical, {term.id: typical}, event=term.event)
    robot = make_robot(backbone={"youngs_modulus": 50e9}, loads={"gravity_angle": "-90 deg"})
    found = {h.name: h for h in catalogue(robot, **GIVEN) if h.kind == kind}
    variants = () if term.event else term.tried.variants
    assert list(found) == [f"{kind}.{v.name}" if v.name else kind for v in variants]
    for variant, h in zip(variants, found.values(), strict=True):
        free = variant.free or tuple(q.name for q in term.quantities)
        assert [n.name for n in h.numbers] == [f"{kind}.{name}" for name in free]
        assert h.reads == {f"{kind}.{name}" for name in term.tried.shared}
        assert h.starts and all(set(start) == {n.name for n in h.numbers} for start in h.starts)
        assert not {*h.fixed} & {n.name for n in h.numbers}


def test_a_term_of_ones_own_is_tried_in_its_variants(make_robot, monkeypatch):
    check_term(DRAG, REGISTRY, "here")
    robot = make_robot()
    values = {**robot.terms, DRAG.id: {q.name: q.null for q in DRAG.quantities}}
    known = {DRAG.id: DRAG} | REGISTRY
    monkeypatch.setattr(type(robot), "catalogue", property(lambda self: known))
    monkeypatch.setattr("calibrate.diagnosis.hypotheses.hypotheses.every_for", lambda robot: (*known,))
    found = {h.name: h for h in catalogue(dataclasses.replace(robot, terms=values), **GIVEN)}
    plain, fading = found["my-drag"], found["my-drag.fading"]
    assert [n.name for n in plain.numbers] == ["my-drag.size"] and len(plain.starts) == 2
    size, fade = fading.numbers
    assert size.sd == 10.0 / float(robot.backbone.length) and fade.centre == 0.5 * (10.0 + 200.0)
    assert fading.starts == ({"my-drag.size": size.sd, "my-drag.fade": 30.0},)


@pytest.mark.parametrize(
    ("tried", "says"),
    [
        (Tried((Variant(free=("sise",)),)), "frees 'sise', which is none of its numbers"),
        (Tried(shared=("knee",)), "frees 'knee', which is none of its numbers"),
        (Tried((Variant(), Variant())), "two variants have one name"),
        (Tried((Variant(starts=lambda at, rig: [{"size": 1.0}]),)), "must give size, fade and nothing else"),
        (Tried((Variant(prior=lambda rig: {"sise": Prior()}),)), "the prior of 'sise' is for none"),
        (Tried((Variant(starts=misspelt),)), "cannot be computed ('sise')"),
    ],
)
def test_what_cannot_be_tried_is_refused_in_one_line(tried, says):
    with pytest.raises(InputError) as refused:
        check_term(dataclasses.replace(DRAG, tried=tried), REGISTRY, "here")
    assert says in str(refused.value) and "\n" not in str(refused.value)


def test_what_instruments_always_add():
    assert {"time-skew.delay", "zero-drift.tip", "zero-drift.base"} == INSTRUMENT_NUMBERS
    assert {"time-skew.delay"} == DELAYS
