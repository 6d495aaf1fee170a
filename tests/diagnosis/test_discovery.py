"""Laws of no catalogue: forms, where they are felt, what is told of them, and files that hold them."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest
from test_averaged import Linear

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.answer.result import Diagnosis
from calibrate.diagnosis.decision.decide import DISCOVERED
from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.hypotheses import base_numbers, is_friction, is_stiffness
from calibrate.diagnosis.laws import discovery
from calibrate.diagnosis.laws.discovery import (
    Felt,
    LawCandidate,
    _elsewhere,
    _nearest,
    _others,
    _ranked,
    _refused,
    _short_forms,
    discover,
    distilled,
    promising,
    with_laws,
)
from calibrate.diagnosis.laws.forms import (
    FORMS,
    coordinates,
    forms_for,
    hypothesis_of,
    law_of,
    smooth_of,
    waves,
)
from calibrate.diagnosis.laws.found import _curve, with_law
from calibrate.diagnosis.laws.places import LawPlace, places
from calibrate.diagnosis.likelihood.held_out import _when_known, folds
from calibrate.diagnosis.prepare import prepare
from calibrate.fitting.fit import part_of
from calibrate.inference.number import Number
from calibrate.inference.simulated_rig import SimulatedRig
from gtr_jax.config.config import config_text, parse_config
from gtr_jax.config.law_section import LawSection
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import Native, _needed, ready
from gtr_jax.simulation.programs import structure_with
from gtr_jax.terms.expression import evaluate
from gtr_jax.terms.law import check_law

SINE = {"kind": "straight-sine-straight", "r1": -0.01, "r2": 0.01, "w1": 0.03, "w2": 0.1}
PLACES = [
    LawPlace("friction", "T", 0.0, 40.0, 0.5, "dimensionless"),
    LawPlace("friction", "s", 0.0, 0.25, 0.5, "dimensionless"),
    LawPlace("friction", "t", 0.0, 90.0, 0.5, "dimensionless"),
    LawPlace("friction", "d", 0.0, 0.008, 0.5, "dimensionless"),
    LawPlace("tip_cell", "T", 0.0, 30.0, 0.9, "N"),
    LawPlace("base_cell", "T", 0.0, 40.0, 1.2, "N"),
    LawPlace("bending", "k", 0.0, 12.0, 4.0, "1/m"),
    LawPlace("bending", "s", 0.0, 0.25, 0.4, "dimensionless"),
    LawPlace("drag", "s", 0.0, 0.25, 4.0, "N/m"),
    LawPlace("strain", "T", 0.0, 40.0, 2e-3, "dimensionless"),
    LawPlace("tip_response", "l", 0.0, 9.6, 0.3, "dimensionless"),
    LawPlace("tip_cell", "t", 0.0, 90.0, 0.9, "N"),
    LawPlace("viscous", "v", 0.0, 0.004, 0.1, "dimensionless"),
]


def added(place, law, values, x):
    """What a law adds to what is there without it."""
    at = {"k": 1.0, "T": 7.0, place.of: x}
    found = np.broadcast_to(evaluate(law.tree, {**at, **values}, np), x.shape)
    return found - (at["T"] if "cell" in place.acts else 1.0 if place.acts == "friction" else 0.0)


@pytest.mark.parametrize("place", PLACES, ids=lambda p: p.name)
def test_the_text_of_a_form_is_the_form(place):
    x = np.linspace(place.low, place.high, 57)[1:]
    for form in forms_for(place):
        law, stays = law_of(place, form)
        h = hypothesis_of(place, form)
        for shapes in [form.grid[0], form.grid[-1], form.grid[len(form.grid) // 2]]:
            size = 0.2 * place.size
            own = {
                n.name: n.value(v)
                for n, v in zip(h.numbers, coordinates(place, form, size, shapes), strict=True)
            }
            values = {name.partition(".")[2]: value for name, value in {**stays, **own}.items()}
            expected = size * form.value((x - place.low) / place.span, *shapes)
            np.testing.assert_allclose(added(place, law, values, x), expected, atol=1e-9 * place.size)
            assert set(values) == {q.name for q in law.numbers}


@pytest.mark.parametrize("place", PLACES, ids=lambda p: p.name)
def test_forms_are_laws_that_a_robot_file_may_hold(place, make_config):
    for form in forms_for(place):
        law, stays = law_of(place, form)
        values = {name.partition(".")[2]: value for name, value in stays.items()}
        shapes = {
            "at": 0.5,
            "width": 0.1,
            "scale": 0.2,
            "first": 0.3,
            "last": 0.6,
            "edge": 0.01,
            "period": 0.9,
        }
        values |= {k: v * place.span for k, v in shapes.items() if any(q.name == k for q in law.numbers)}
        values |= {"size": 0.02 * place.size} | ({"phase": -0.4} if form.name in ("wave", "ringing") else {})
        values |= {"power": 0.7} if form.name == "power" else {}
        check_law(law, values)
        config = with_law(make_config(routing=SINE), law, values)
        again = parse_config(_parsed(config_text(config)))
        (section,) = (term for term in again.terms if isinstance(term, LawSection))
        assert section.law == law.text and section.parameters == pytest.approx(values)
    law, h = smooth_of(place)
    values = {name.partition(".")[2]: v for name, v in h.fixed.items()}
    values |= {n.name.partition(".")[2]: 0.01 * n.sd for n in h.numbers}
    # Elsewhere other numbers take what does not change.
    assert ("c0" in values) == (place.acts in ("drag", "tip_response", "viscous"))
    check_law(law, values)
    with_law(make_config(routing=SINE), law, values)


def _parsed(text):
    import tomllib

    return tomllib.loads(text)


@pytest.mark.parametrize("place", [p for p in PLACES if p.acts in ("tip_cell", "base_cell", "friction")])
def test_the_curve_of_a_law_is_what_it_adds(place):
    form = next(f for f in FORMS if f.name == "bump")
    law, _ = law_of(place, form)
    x = np.linspace(place.low, place.high, 50)
    values = {"size": 0.3, "at": 0.4 * place.span, "width": 0.1 * place.span}
    shown = _curve(law, values, place.of, x) - (1.0 if place.acts == "friction" else 0.0)
    np.testing.assert_allclose(shown, added(place, law, values, x), atol=1e-12)


def test_a_smooth_law_is_a_sum_of_cosines_without_mean():
    place = PLACES[0]
    law, h = smooth_of(place)
    x = np.linspace(place.low, place.high, 2001)
    values = {name.partition(".")[2]: v for name, v in h.fixed.items()}
    values |= {n.name.partition(".")[2]: 0.0 for n in h.numbers}
    c3 = added(place, law, values | {"c3": 0.1}, x)
    np.testing.assert_allclose(c3, 0.1 * np.cos(3 * np.pi * x / 40.0), atol=1e-12)
    assert [n.sd for n in h.numbers] == pytest.approx([0.5 / j for j in range(1, len(h.numbers) + 1)])


def planted(place, form, shapes, size, seed=2, rows=300):
    """Rows of a base model, in which a form at a place is hidden among tents with random effects."""
    rng = np.random.default_rng(seed)
    mu, tents = rng.standard_normal(rows), rng.standard_normal((rows, len(place.tents)))
    u = (place.tents - place.low) / place.span
    hidden = tents @ (size * form.value(u, *shapes))
    likelihood = Linear(0.3 * mu + hidden + rng.standard_normal(rows), {"mu": mu})
    head = likelihood.refit((), np.zeros(1))
    q, _ = np.linalg.qr(np.concatenate([head.jacobian, np.eye(1)]))
    across = np.concatenate([tents, np.zeros((1, tents.shape[1]))])
    across -= q @ (q.T @ across)
    toward = -across.T @ np.concatenate([head.rows, head.x])
    return head, Felt(place, across.T @ across, toward, tents, head.x, head.rows)


@pytest.mark.parametrize(
    ("name", "shapes"), [("wave", (0.21, 0.9)), ("bump", (0.4, 0.12)), ("step", (0.66, 0.05)), ("linear", ())]
)
def test_a_planted_form_is_felt_first(name, shapes):
    place = PLACES[0]
    form = next(f for f in FORMS if f.name == name)
    head, felt = planted(place, form, shapes, 0.6)
    found = promising(head, _ranked([felt]))
    first = found[0]
    assert first.form is not None and first.form.name == name
    law = first.law.name
    values = {n.name: n.value(x) for n, x in zip(first.hypothesis.numbers, first.start[1:], strict=True)}
    assert abs(values[f"{law}.size"]) == pytest.approx(0.6, rel=0.25)
    if name == "wave":
        assert values[f"{law}.period"] == pytest.approx(0.21 * 40.0, rel=0.05)
    assert found[-1].form is None and {c.place for c in found} == {place}


def test_a_cell_that_rings_is_felt_and_distilled():
    """Of how a cell responds there are forms that fade with the lag, and no others."""
    place = next(p for p in PLACES if p.acts == "tip_response")
    assert [form.name for form in forms_for(place)] == ["decay", "ringing"]
    assert not any(
        form.name == "ringing" for other in PLACES if other is not place for form in forms_for(other)
    )
    ringing = next(f for f in FORMS if f.name == "ringing")
    shapes = (0.12, 0.16, 0.5)
    head, felt = planted(place, ringing, shapes, 0.8)
    first = promising(head, _ranked([felt]))[0]
    assert first.form is ringing
    law = first.law.name
    values = {n.name: n.value(x) for n, x in zip(first.hypothesis.numbers, first.start[1:], strict=True)}
    assert values[f"{law}.period"] == pytest.approx(0.16 * 9.6, rel=0.15)
    u = np.linspace(0.0, 1.0, 201)
    nearest = ringing.grid[200]
    left, found, level, size, again = _short_forms(place, u, 0.2 * ringing.value(u, *nearest))[0]
    assert found is ringing and left < 1e-20 and level == 0.0
    np.testing.assert_allclose(size * ringing.value(u, *again), 0.2 * ringing.value(u, *nearest), atol=1e-12)


def test_a_place_is_ranked_where_it_promises_most_less_what_is_lost_there():
    """A law of a cell that promises more where friction is less counts, if the model is not worse there by as
    much.
    """
    place = next(p for p in PLACES if (p.acts, p.of) == ("tip_cell", "T"))
    bent = next(f for f in FORMS if f.name == "bent")
    _, here = planted(place, bent, (0.6,), -0.4 * place.span)
    wider = dataclasses.replace(place, high=1.5 * place.high)
    there = here._replace(place=wider, toward=2 * here.toward, x=here.x - 1.0)
    plain, more = _ranked([here])[0], _ranked([here, there])[0]
    assert plain.found[0][1] is bent and more.felt is there and more.score > plain.score
    lost = more.score - plain.score
    for share, best in ((0.9, there), (1.1, here)):
        (one,) = _ranked([here, there._replace(lost=share * lost)])
        assert one.felt.place is best.place
    # Its start is there, and its size a slope.
    head = SimpleNamespace(
        jacobian=np.zeros((len(here.rows), 1)), x=np.zeros(1), information=lambda: np.eye(1)
    )
    first = promising(cast(Any, head), _ranked([here, there]))[0]
    assert first.place is wider and first.form is bent
    assert first.hypothesis.numbers[0].unit == "dimensionless"
    assert first.hypothesis.numbers[0].value(first.start[1]) < -0.3


def test_other_places_go_on_by_what_a_brief_refit_makes_of_them(monkeypatch):
    """First order ranks a law that changes much behind laws that change little."""
    base, _ = planted(PLACES[0], FORMS[1], (), 0.6)
    names = ["friction-of-tension", "friction-of-place", "friction-of-drawn", "base-cell-of-tension"]
    felt = []
    for scale, name in zip((1.0, 0.9, 0.8, 0.7), names, strict=True):
        place = next(p for p in PLACES if p.name == name)
        _, f = planted(place, next(f for f in FORMS if f.name == "bump"), (0.4, 0.12), 0.6)
        felt.append(f._replace(toward=scale * f.toward))
    costs = {"friction-of-place": 900.0, "friction-of-drawn": 40.0, "base-cell-of-tension": 70.0}
    asked, asked_of = [], []

    def raced(likelihood, reference, items, most):
        asked.extend(own[-1].name for (own, _) in items)
        return [
            SimpleNamespace(names=(name,), cost=cost)
            for name in asked
            for start, cost in costs.items()
            if name.startswith(start)
        ]

    monkeypatch.setattr(discovery, "raced", raced)
    monkeypatch.setattr(discovery, "_likelihood_with", lambda likelihood, laws: asked_of.extend(laws))
    head = SimpleNamespace(
        names=(), cost=800.0, x=base.x, jacobian=base.jacobian, information=base.information
    )
    models = SimpleNamespace(likelihood=None, hypotheses=lambda names: [])
    found = _others(cast(Any, models), cast(Any, head), _ranked(felt)[1:])
    assert len(asked_of) == len(set(asked)) == 3 and not any(
        name.startswith("friction-of-tension") for name in asked
    )
    assert [entry.felt.place.name for entry in found] == ["friction-of-drawn", "base-cell-of-tension"]
    assert _others(cast(Any, models), cast(Any, head), []) == []


def test_a_model_is_felt_where_its_numbers_are_others():
    """Of all recordings, those that have a number of their own, too; where bounds or failures allow."""
    numbers = [
        Number(name="mu", unit="", centre=0.3, sd=0.5, log=True),
        Number(name="E@a", unit="Pa", centre=2e6, sd=0.5, log=True),
        Number(name="E@b", unit="Pa", centre=2e6, sd=0.03, log=True),
    ]
    head = SimpleNamespace(x=np.zeros(3), failed=1)

    def points(model, many):
        found = [SimpleNamespace(x=x, failed=k) for k, x in enumerate(many)]
        return [None, *found[1:]] if len(found) > 3 else found

    likelihood = SimpleNamespace(base=tuple(numbers), points=points)
    (_, one), (x, two) = _elsewhere(cast(Any, likelihood), cast(Any, head), (), is_stiffness, (0.5, 0.7, 0.8))
    assert [cast(Any, p).failed for p in (one, two)] == [0, 1]  # the third fails more often than the head
    assert x[0] == 0 and numbers[1].value(x[1]) == pytest.approx(1.4e6)
    assert x[2] == numbers[2].bounds[0]
    assert len(_elsewhere(cast(Any, likelihood), cast(Any, head), (), is_friction, (0.5, 0.5, 1.0))) == 1
    rigid = SimpleNamespace(base=(numbers[0],), points=points)
    assert (
        _elsewhere(
            cast(Any, rigid), cast(Any, SimpleNamespace(x=np.zeros(1), failed=0)), (), is_stiffness, (0.5,)
        )
        == []
    )


def test_viscous_friction_that_takes_more_than_there_is_is_refused():
    """Of several recordings with friction of their own the least counts."""
    place = next(p for p in PLACES if p.acts == "viscous")
    law, h = smooth_of(place)
    tried = LawCandidate(place, None, 20.0, law, h, np.zeros(2 + len(h.numbers)))
    fault = SimpleNamespace(fault=None)
    robot = SimpleNamespace(catalogue={law.name: fault}, backbone=SimpleNamespace(length=0.25))
    models = SimpleNamespace(likelihood=SimpleNamespace(rigs=[SimpleNamespace(robot=robot)]))
    own = tuple(Number(name=f"mu@{k}", unit="", centre=0.3, sd=0.5, log=True) for k in "ab")
    for least, refused in ((0.2, False), (0.1, True)):
        values = {"mu@a": 0.5, "mu@b": least, **h.fixed, **{n.name: 0.0 for n in h.numbers}}
        fitted = SimpleNamespace(numbers=own, values=values | {f"{law.name}.c0": -0.15})
        assert bool(_refused(cast(Any, models), tried, cast(Any, fitted))) == refused


def test_a_drag_is_never_negative():
    place = next(p for p in PLACES if p.acts == "drag")
    constant = next(f for f in FORMS if f.name == "constant")
    assert constant in forms_for(place) and constant not in forms_for(PLACES[0])
    for size in (0.6, -0.6):
        head, felt = planted(place, constant, (), size)
        found = [c for c in promising(head, _ranked([felt])) if c.form is not None]
        assert all(c.start[1] >= 0 for c in found)
        assert (size > 0) == any(c.form is constant for c in found)
    (number, *_) = hypothesis_of(place, constant).numbers
    assert number.lower == 0.0


def test_nothing_is_felt_in_noise():
    place = PLACES[0]
    head, felt = planted(place, FORMS[0], (), 0.0)
    assert promising(head, _ranked([felt])) == []


def test_a_robot_with_more_laws_is_the_same_robot(make_config):
    robot = gtr.build_robot(make_config(routing=SINE))
    laws = [place.tent() for place in PLACES]
    more = with_laws(robot, laws)
    T = jnp.asarray([0.0, 10.0, 30.0, 12.0, 5.0])
    np.testing.assert_allclose(gtr.simulate(more, T).T_tip, gtr.simulate(robot, T).T_tip, rtol=1e-12)
    assert [law.name for law in more.laws] == [place.tent().name for place in PLACES]


def recorded(config, law=None, values=None, samples=150, noise=0.02, seed=4, pose=None):
    """Two and a half loops at a finer mesh, with a law, and noise, of the tip's place [m] if it is shown."""
    whole = config if law is None else with_law(config, law, values or {})
    time = np.arange(samples) * 0.5
    T = np.interp(np.linspace(0, 6, samples), np.arange(7), [1, 30, 3, 22, 2, 26, 4])
    run = gtr.simulate(gtr.build_robot(whole, resolution=2.0), T, time=time)
    draw = np.random.default_rng(seed)
    return gtr.Recording(
        path=Path("r.csv"),
        sha256="",
        time=time,
        T_base=np.asarray(run.reading.T_base) + draw.normal(0, 0.2 * noise, samples),
        T_tip=np.asarray(run.reading.T_tip) + draw.normal(0, noise, samples),
        **({} if pose is None else dict(zip(("tip_x", "tip_y"), _shown(run, pose, draw), strict=True))),
    )


def _shown(run, noise, draw):
    return np.asarray(run.tip_pose)[:, :2].T + draw.normal(0, noise, (2, len(run.tip_pose)))


def likelihood_of(config, recording):
    """A rig of a recording and the base model's numbers there."""
    robot = gtr.build_robot(config)
    part, _ = part_of("r", robot, config, recording, (), noise_N=None, noise_base_N=None)
    return robot, SimulatedRig(part, robot), base_numbers(robot, {})


def beside_nothing(config, recording):
    """The law that is found beside the base model."""
    prepared = prepare(config, recording)
    assert not isinstance(prepared, Diagnosis)
    models = Models(prepared.likelihood, prepared.hypotheses)
    models.add([prepared.base])
    return discover(models, prepared.base, lambda line: None)


def test_places_cover_what_the_recording_does(make_config):
    config = make_config(routing=SINE)
    robot, rig, _ = likelihood_of(config, recorded(config))
    values = {"mu": float(robot.value("mu")), "E": float(robot.value("E"))}
    seen = rig(values)
    assert seen is not None
    fitted = SimpleNamespace(values=values, seen=(seen,))
    found = {p.name: p for p in places(robot, cast(Any, SimpleNamespace(rigs=(rig,))), cast(Any, fitted))}
    assert {
        "friction-of-tension",
        "friction-of-pressure",
        "friction-of-place",
        "tip-cell-of-tension",
        "tip-cell-of-time",
        "bending-of-curvature",
        "bending-of-place",
    } <= set(found)
    assert found["friction-of-time"].high == pytest.approx(74.5)
    assert found["friction-of-tension"].high == pytest.approx(30.0, abs=0.3)
    eq = gtr.equilibrium(robot, jnp.asarray(found["friction-of-tension"].high))
    there = np.diff(eq.s) > 0
    pressure = np.max((np.asarray(eq.tension)[1:] * np.diff(eq.wrap))[there] / np.diff(eq.s)[there])
    assert found["friction-of-pressure"].high == pytest.approx(pressure, rel=1e-3)
    assert found["friction-of-drawn"].high == pytest.approx(np.max(seen.values[4]))
    drawn = np.abs(np.diff(seen.values[4])) / 0.5
    assert 0.5 * drawn.max() < found["friction-of-speed"].high <= drawn.max()
    assert found["tip-response-of-lag"].high == pytest.approx(24.0)
    assert len(found["tip-response-of-lag"].tents) == 49  # one for each sample of 0.5 s
    assert "friction-of-cycle" in found and found["friction-of-cycle"].high == 3.0


def test_pieces_that_are_held_out_alternate():
    many = (20, 64, 160)
    likelihood = SimpleNamespace(rigs=[SimpleNamespace(part=SimpleNamespace(samples=n)) for n in many])
    found = folds(cast(Any, likelihood), pieces=True)
    assert len(found) == 4
    for k, n in enumerate(many):
        held = np.asarray([parts[k] for _, parts in found])
        np.testing.assert_array_equal(held.sum(axis=0), np.ones(n))
        np.testing.assert_array_equal(held.sum(axis=1), np.full(4, n // 4))
    assert list(np.flatnonzero(found[1][1][1])[:4]) == [2, 3, 10, 11]
    assert list(np.flatnonzero(found[0][1][2])[:6]) == [0, 1, 2, 3, 4, 20]


def test_times_of_a_law_are_known_where_cycles_are_left_out():
    place = next(p for p in PLACES if p.of == "t")
    form = next(f for f in FORMS if f.name == "stretch")
    h = hypothesis_of(place, form)
    fitted = SimpleNamespace(
        numbers=h.numbers, x=np.asarray([0.5, 0.1, 0.2, 0.0]), values={n.name: 7.0 for n in h.numbers}
    )
    (own,), start = _when_known([h], cast(Any, fitted))
    assert [n.name for n in own.numbers] == [h.numbers[0].name] and list(start) == [0.5]
    assert own.fixed[h.numbers[1].name] == 7.0


def test_a_wave_goes_on_from_the_starts_that_fit_best_as_they_are():
    """To first order several periods promise as much: simulated, they do not."""
    place = next(p for p in PLACES if p.of == "t")
    form, other = (next(f for f in FORMS if f.name == name) for name in ("wave", "step"))

    def candidate(form, k):
        law, h = law_of(place, form)[0], hypothesis_of(place, form)
        return LawCandidate(place, form, 20.0 - k, law, h, np.full(len(h.numbers), 0.01 * k))

    many = [candidate(form, k) for k in range(20)]
    few = [candidate(other, k) for k in range(2)]

    def simulated(values, names):
        return [None if k == 3 else (SimpleNamespace(k=k, failed=int(k == 8)),) for k in range(len(values))]

    likelihood = SimpleNamespace(
        base=(), simulated=simulated, rows=lambda seen: np.asarray([abs(seen[0].k - 9.2)])
    )
    head = SimpleNamespace(names=(), failed=0)
    kept = _nearest(cast(Any, likelihood), cast(Any, head), (), [*many, *few])
    places_of = [id(c) for c in (*many, *few)]
    assert [places_of.index(id(c)) for c in kept] == [5, 6, 7, 9, 10, 11, 12, 13, 20, 21]


@pytest.mark.parametrize("name", ["linear", "quadratic", "bump", "step", "decay", "kneed", "wave", "stretch"])
def test_a_curve_is_distilled_to_the_form_that_it_looks_like(name):
    """A level that the curve has beside the form is left to the friction coefficient."""
    place, u = PLACES[2], np.linspace(0.0, 1.0, 201)
    form = next(f for f in FORMS if f.name == name)
    shapes = form.grid[len(form.grid) // 2]
    whole = 0.8 * (1 + 0.3 * form.value(u, *shapes)) - 1
    left, first, level, size, found = _short_forms(place, u, whole)[0]
    assert first.name == name and left < 1e-20 * len(u)
    again = (1 + level) * (1 + size * form.value(u, *found)) - 1
    np.testing.assert_allclose(again, whole, atol=1e-9)
    # A wave half a period on is the same curve.
    assert (level, size, *found) == pytest.approx((-0.2, 0.3, *shapes)) or name == "wave"
    draw = np.random.default_rng(0)
    assert not _short_forms(place, u, draw.normal(size=len(u)))


@pytest.mark.parametrize("name", ["linear", "quadratic", "bump"])
def test_a_smooth_law_that_was_fitted_gives_starts_of_short_ones(name):
    """A sum of cosines without mean, as the fit leaves it."""
    place, u = PLACES[2], np.linspace(0.0, 1.0, 201)
    form = next(f for f in FORMS if f.name == name)
    shapes = (0.5, 0.3) if form.shapes else ()
    law, h = smooth_of(place)
    basis = np.cos(np.pi * np.outer(u, waves(place)))
    wanted = 0.4 * form.value(u, *shapes)
    of = np.linalg.lstsq(np.column_stack([basis, np.ones_like(u)]), wanted, rcond=None)[0][:-1]
    curve = {f"{law.name}.c{j}": float(c) for j, c in zip(waves(place), of, strict=True)}
    mu = Number(name="mu", unit="dimensionless", centre=0.3, sd=0.5, log=True)
    smooth = SimpleNamespace(x=np.concatenate([[0.1], of]), values=curve)
    head = SimpleNamespace(names=(), x=np.zeros(1))
    models = SimpleNamespace(fits={(law.name,): smooth}, likelihood=SimpleNamespace(base=(mu,)))
    tried = LawCandidate(place, None, 50.0, law, h, np.zeros(1 + len(of)))
    starts = distilled(cast(Any, models), cast(Any, head), [tried])
    start = next(c for c in starts if c.form is not None and c.form.name == name)
    numbers = start.hypothesis.numbers
    values = {n.name.rpartition(".")[2]: n.value(v) for n, v in zip(numbers, start.start[1:], strict=True)}
    stays = {k.rpartition(".")[2]: v for k, v in start.hypothesis.fixed.items()}
    x = np.linspace(place.low, place.high, len(u))
    friction = mu.value(start.start[0]) * (1 + added(place, start.law, {**stays, **values}, x))
    expected = mu.value(0.1) * (1 + basis @ of)
    assert np.max(np.abs(friction - expected)) < 0.05 * 0.3
    assert start.start[0] != pytest.approx(0.1)


@pytest.mark.slow
def test_a_law_outside_the_catalogue_is_found_and_lands_in_the_file(make_config):
    config = make_config(routing=SINE)
    place = LawPlace("friction", "t", 0.0, 74.5, 0.5, "dimensionless")
    law, _ = law_of(place, next(f for f in FORMS if f.name == "wave"))
    recording = recorded(config, law, {"size": 0.3, "period": 17.0, "phase": 0.7})
    found = calibrate.diagnose(config, recording)
    assert found.verdict == DISCOVERED, found.says
    told = found.discovered
    assert told is not None and (told.acts, told.of) == ("friction", "t") and told.takes > 0.8
    of = {c.name: c for c in found.parameters}
    period = of[f"{told.law.name}.period"]
    assert period.lower95 is not None and period.upper95 is not None
    assert period.lower95 < 17.0 < period.upper95 and period.upper95 - period.lower95 < 2.0
    assert of["mu"].averaged95 is not None and of["mu"].averaged95[0] < 0.3 < of["mu"].averaged95[1]
    assert found.named == [told.law.name] and "friction that depends on t" in found.says
    assert found.config is not None and found.config.laws[0].text == law.text
    assert np.all(told.lower <= told.upper) and told.x[0] == 0.0
    predicted = gtr.simulate(gtr.build_robot(found.config), recording.T_base, time=recording.time)
    assert np.sqrt(np.mean((np.asarray(predicted.reading.T_tip) - recording.T_tip) ** 2)) < 0.06
    assert found.to_json()["discovered"]["formula"] == law.text


@pytest.mark.slow
def test_friction_that_falls_for_a_while_within_one_cycle_is_found(make_config):
    """No other cycle holds it: it is judged on short pieces. What friction held relaxes where it falls, so
    that first order promises other stretches.
    """
    config = make_config(routing=SINE)
    place = LawPlace("friction", "t", 0.0, 89.5, 0.5, "dimensionless")
    law, _ = law_of(place, next(f for f in FORMS if f.name == "stretch"))
    truth = {"size": -0.45, "first": 36.0, "last": 52.0, "edge": 0.5}
    found = beside_nothing(config, recorded(config, law, truth, samples=180))
    assert found is not None and found.pieces and found.takes > 0.9
    assert (found.place.name, not found.form or found.form.name) == ("friction-of-time", "stretch")
    values = {name.rpartition(".")[2]: value for name, value in found.fitted.values.items()}
    assert values["first"] == pytest.approx(36.0, abs=1.0)
    assert -0.5 < values["size"] < -0.4


@pytest.mark.slow
def test_a_cell_that_reads_wrong_for_a_while_is_not_told_as_friction(make_config):
    """Of a short time friction may do nearly the same: then both are told."""
    config = make_config(routing=SINE)
    right = recorded(config, samples=120)
    assert right.time is not None
    for start, end, lasts in ((4.0, 7.0, False), (22.0, 34.0, True)):
        off = np.where((right.time > start) & (right.time < end), -0.4, 0.0)
        found = beside_nothing(config, dataclasses.replace(right, T_tip=right.T_tip + off))
        told = [] if found is None else [found.place.name, *(p.name for p in found.possible_places)]
        assert "tip-cell-of-time" in told or not (told or lasts)


@pytest.mark.slow
def test_waves_of_a_cell_that_pass_for_noise_are_found(make_config):
    """Steps of the tension are longer than a wave: neighbouring samples differ as if by chance."""
    config = make_config(routing=SINE)
    place = LawPlace("tip_cell", "T", 0.0, 30.0, 0.9, "N")
    law, _ = law_of(place, next(f for f in FORMS if f.name == "wave"))
    truth = {"size": 0.6, "period": 1.7, "phase": 0.0}
    recording = recorded(config, law, truth, samples=70, noise=0.05)
    found = beside_nothing(config, recording)
    assert found is not None and not found.pieces and found.takes > 0.9
    assert (found.place.name, not found.form or found.form.name) == ("tip-cell-of-tension", "wave")
    assert found.models.likelihood.noise[0][0].sd < 0.1


@pytest.mark.slow
def test_a_place_where_the_tendon_catches_is_found(make_config):
    config = make_config(routing=SINE, uncertainty={"backbone.youngs_modulus": 0.1})
    law, _ = law_of(PLACES[3], next(f for f in FORMS if f.name == "bump"))
    drawn = np.asarray(gtr.simulate(gtr.build_robot(config), np.asarray([0.0, 30.0])).displacement)[-1]
    truth = {"size": 0.8, "at": 0.5 * float(drawn), "width": 0.1 * float(drawn)}
    found = calibrate.diagnose(config, recorded(config, law, truth))
    assert found.verdict == DISCOVERED, found.says
    told = found.discovered
    assert told is not None and (told.acts, told.of) == ("friction", "d") and told.takes > 0.9
    assert told.values["at"] == pytest.approx(truth["at"], rel=0.05)
    assert found.held_out[-1]["chi2_per_n"] < 1.3


@pytest.mark.slow
def test_a_term_left_out_of_the_catalogue_is_found_as_a_law(make_config):
    truth = make_config(routing=SINE, terms=[{"kind": "adhesion", "drag": 15.0}])
    recording = recorded(truth)
    found = calibrate.diagnose(make_config(routing=SINE), recording, without=("adhesion",))
    held = found.held_out
    assert found.verdict != "adequate" and held[-1]["rms"] < 0.5 * held[0]["rms"], found.says


@pytest.mark.slow
def test_a_cell_that_saturates_is_told_without_the_term(make_config):
    """It asks for less friction than fits best without it, from where first order promises little of it."""
    truth = make_config(routing=SINE, terms=[{"kind": "saturation", "tip": 12.0}])
    recording = recorded(truth)
    assert recording.T_tip is not None and 11.9 < np.max(recording.T_tip) < 12.2
    found = beside_nothing(make_config(routing=SINE), recording)
    assert found is not None and found.takes > 0.95
    assert found.place.name == "tip-cell-of-tension" and found.form is not None
    values = {name.rpartition(".")[2]: value for name, value in found.fitted.values.items()}
    assert values["size"] == pytest.approx(-1.0, abs=0.05)
    assert values["at"] == pytest.approx(12.0, abs=0.1)
    assert values["mu"] == pytest.approx(0.3, rel=0.03)
    # The range of the law ends where the tension does, not where the cell ends.
    T = gtr.simulate(gtr.build_robot(truth), recording.T_base).T_tip
    assert found.place.high == pytest.approx(float(np.max(T)), rel=0.03)


@pytest.mark.slow
def test_friction_that_grows_with_the_speed_is_told_without_the_term(make_config):
    truth = make_config(routing=SINE, terms=[{"kind": "viscous-friction", "coefficient": 60.0}])
    found = calibrate.diagnose(make_config(routing=SINE), recorded(truth), without=("viscous-friction",))
    assert found.verdict == DISCOVERED, found.says
    told = found.discovered
    assert told is not None and (told.acts, told.of) == ("viscous", "v") and told.takes > 0.9
    assert "viscous friction that depends on v" in found.says
    end = told.x[-1]
    assert told.y[-1] == pytest.approx(60.0 * end, rel=0.1) and told.y[0] == 0.0
    assert found.config is not None and found.config.laws[0].acts == "viscous"


@pytest.mark.slow
def test_a_law_of_the_body_may_show_in_the_pose_alone(make_config):
    config = make_config(routing=SINE, uncertainty={"backbone.youngs_modulus": 0.2})
    at = gtr.equilibrium(gtr.build_robot(config), jnp.asarray(30.0))
    place = LawPlace("bending", "k", 0.0, float(np.max(np.abs(at.curvature))), 1.0, "1/m")
    law, stays = law_of(place, next(f for f in FORMS if f.name == "quadratic"))
    truth = {"size": 0.3 * place.high, **{name.rpartition(".")[2]: v for name, v in stays.items()}}
    found = beside_nothing(config, recorded(config, law, truth, pose=2e-5))
    assert found is not None and found.takes > 0.9
    told = {found.place.name, *(p.name for p in found.possible_places)}
    assert "bending-of-curvature" in told


@pytest.mark.slow
def test_a_law_is_found_in_a_long_recording(make_config):
    config = make_config(routing=SINE)
    place = LawPlace("friction", "T", 0.0, 30.0, 0.5, "dimensionless")
    law, _ = law_of(place, next(f for f in FORMS if f.name == "bump"))
    recording = recorded(config, law, {"size": 0.6, "at": 14.0, "width": 4.0}, samples=1200)
    found = calibrate.diagnose(config, recording)
    assert found.verdict == DISCOVERED, found.says
    told = found.discovered
    assert told is not None and (told.acts, told.of) == ("friction", "T")
    assert told.values["at"] == pytest.approx(14.0, abs=0.3)


def test_a_compiled_program_serves_robots_with_other_laws_and_other_ranges(make_config):
    robot = gtr.build_robot(make_config(routing=SINE))
    first, *others = (place.tent() for place in PLACES)
    wide = dataclasses.replace(PLACES[0], high=55.0, size=0.9).tent()
    assert wide.numbers != first.numbers and wide.equation == first.equation
    programs, T = set(), jnp.asarray([0.0, 10.0, 30.0, 12.0])
    for laws in ([first], [wide], [first, *others], [others[-1], first]):
        more = with_laws(robot, laws).with_values(**{f"{first.name}.size": 0.3, f"{first.name}.at": 20.0})
        more = more.with_values(**{f"{first.name}.width": 8.0})
        loads = loads_of(T, jnp.arange(4.0), None)
        structure = structure_with(more, [first.name])
        native = Native(more)
        given = _needed(structure, native._shapes)
        programs.add((given[0], given[1][0]))
        np.testing.assert_allclose(
            native(ready(more, loads.T_base), structure, loads).T_tip,
            gtr.simulate(more, T, time=jnp.arange(4.0)).T_tip,
            rtol=1e-9,
        )
    assert len(programs) == 1
