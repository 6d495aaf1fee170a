"""Terms of a user's own: what is checked, where they are found, and that no other program stands for them."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from gtr_jax import InputError, dump_config, register_term
from gtr_jax.terms import REGISTRY, Quantity, Term, own
from gtr_jax.terms.own import check_term, mark_of, outside_terms, terms_in

ROOT = Path(__file__).parents[2]
SEAL = ROOT / "examples" / "seal.py"
SIZE = Quantity("size", "N/m", 0.0, 2.0, "Force per length.", (0.2, 10.0), 0.0)
BASE = Term(
    id="my-drag",
    says="A drag.",
    law="dT/ds lowered by size",
    seen="Loss.",
    told_apart="Look.",
    quantities=(SIZE,),
    drag=lambda p, at: p["size"],
)


def changed(**changes):
    return dataclasses.replace(BASE, **changes)


def with_hook(**hooks):
    return changed(drag=None, **hooks)


@pytest.mark.parametrize(
    "kind", ["adhesion", "wear", "stribeck-friction", "stiffening", "tip-gain", "base-gain"]
)
def test_terms_of_the_catalogue_pass_as_a_users_own(kind):
    check_term(REGISTRY[kind], {}, "here")


def test_a_term_of_ones_own_passes():
    check_term(BASE, REGISTRY, "here")
    (seal,) = terms_in(SEAL)
    check_term(seal, REGISTRY, "here")


@pytest.mark.parametrize(
    ("term", "says"),
    [
        (changed(id="wear"), "there is a term of this name already; give it another id"),
        (changed(id="law"), "there is a term of this name already"),
        (changed(id="My Drag"), "is not a valid name of a term; write small letters"),
        (changed(quantities=()), "needs quantities, of which one at least is a size"),
        (
            changed(quantities=(dataclasses.replace(SIZE, unit="furlong"),)),
            "unit 'furlong' of size is unknown",
        ),
        (
            changed(quantities=(dataclasses.replace(SIZE, usual=(3.0, 1.0)),)),
            "must lie within its bounds, and usual",
        ),
        (changed(quantities=(dataclasses.replace(SIZE, null=-1.0),)), "must lie within its bounds"),
        (changed(quantities=(SIZE, SIZE)), "'size' is not a valid name of a number of its own"),
        (with_hook(), "has no hook, so that it does nothing; give it one of friction, by_pressure"),
        (with_hook(mobilise=lambda p, s, m: (s, m)), "'mobilise' is open to the terms of the catalogue only"),
        (changed(event=True), "'event' is open to the terms of the catalogue only"),
        (
            with_hook(base=lambda p, T, at: T * (1 + p["size"])),
            "base needs its inverse; give true_base as well",
        ),
        (with_hook(bend=lambda p, k, at: (p["size"] * k, at.kept)), "bend needs bend_in_space beside it"),
        (
            changed(drag=lambda p, at: p["size"] + 0.5),
            "drag must give 0 at null, and is 0.5 off it at size = 0",
        ),
        (with_hook(friction=lambda p, at: p["size"]), "friction must give 1 at null, and is 1 off it"),
        (with_hook(tip=lambda p, T, at: T + 1 + p["size"]), "tip must give what it is given at null"),
        (changed(drag=lambda p, at: p["size"] / p["size"]), "drag gives nan; keep it finite"),
        (changed(drag=lambda p, at: p["sise"]), "drag cannot be computed"),
        (changed(drag=lambda p, at: 1.0 if p["size"] > 0 else 0.0), "without branches on values"),
        (
            changed(drag=lambda p, at: p["size"] * at.channel.start),
            "set reads_channel=True if it depends on the",
        ),
        (
            with_hook(friction=lambda p, at: 1 + p["size"] * at.time),
            "friction depends on time; set timed=True",
        ),
        (
            with_hook(friction=lambda p, at: 1 + p["size"] * at.speed),
            "friction depends on the speed of the slip; set reads_speed=True",
        ),
        (
            with_hook(
                bend=lambda p, kappa, at: (p["size"] * at.place * kappa, at.kept), not_in_space="of the plane"
            ),
            "set by_place=True if it depends on the place",
        ),
        (changed(drag=lambda p, at: jnp.sqrt(p["size"])), "drag has no finite derivative at null"),
        ("my-drag", "expected a gtr_jax.terms.Term, found str"),
    ],
)
def test_what_is_no_term_is_refused_in_one_line(term, says):
    with pytest.raises(InputError) as refused:
        check_term(term, REGISTRY, "mine.py")
    assert str(refused.value).startswith("mine.py: ") and "\n" not in str(refused.value)
    assert says in str(refused.value), refused.value


def test_another_null_of_the_form_is_tried_as_well():
    fade = Quantity("fade", "N/m", 1.0, 5.0, "Form.", (2.0, 9.0), 0.5, size=False)
    leaves = changed(quantities=(SIZE, fade), drag=lambda p, at: p["size"] + (p["fade"] - 1.0))
    with pytest.raises(InputError, match="at size = 0, fade = 5"):
        check_term(leaves, REGISTRY, "mine.py")


def test_terms_are_registered_before_robot_files_are_read():
    import gtr_jax.config.sections  # noqa: F401

    with pytest.raises(InputError, match=r"robot files are read already.*right after 'import gtr_jax'"):
        register_term(BASE)
    assert "my-drag" not in REGISTRY


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x = 1 +", "fails"),
        ("import nothing_of_this_name", "No module named 'nothing_of_this_name'"),
        (
            "from gtr_jax.terms import Term\nTERM = Term(id='a', drg=1)",
            "unknown hook 'drg'; did you mean 'drag'?",
        ),
        (
            "from gtr_jax.terms import REGISTRY\nMINE = REGISTRY['wear']",
            "calls no term TERM, nor several TERMS",
        ),
    ],
)
def test_a_file_that_holds_no_term_is_refused(tmp_path, text, says):
    (tmp_path / "mine.py").write_text(text)
    with pytest.raises(InputError) as refused:
        terms_in(tmp_path / "mine.py")
    assert says in str(refused.value) and "mine.py" in str(refused.value) and "\n" not in str(refused.value)
    with pytest.raises(InputError, match="no such file"):
        terms_in(tmp_path / "absent.py")


def test_terms_are_found_in_packages_and_in_the_files_of_the_environment(monkeypatch):
    installed = SimpleNamespace(name="drags", value="drags:TERMS", load=lambda: [BASE])
    monkeypatch.setattr(own, "entry_points", lambda group: [installed] if group == "gtr_jax.terms" else [])
    monkeypatch.setenv("GTR_JAX_TERMS", str(SEAL))
    found = [(where, term.id) for where, term in outside_terms()]
    assert found == [("entry point drags = drags:TERMS", "my-drag"), (str(SEAL), "my-seal")]

    def broken():
        raise ImportError("no module drags")

    monkeypatch.setattr(installed, "load", broken)
    with pytest.raises(
        InputError, match=r"entry point drags = drags:TERMS: cannot be loaded \(.*no module drags"
    ):
        list(outside_terms())


def test_a_mark_tells_laws_of_one_name_apart():
    other = changed(drag=lambda p, at: 2.0 * p["size"])
    assert mark_of([BASE]) == mark_of([changed()]) != mark_of([other])

    # What a law holds counts, and what it calls.
    def times(factor):
        return changed(drag=lambda p, at: factor * p["size"])

    def by_way_of(helper):
        return changed(drag=lambda p, at: helper(p))

    assert mark_of([times(2.0)]) == mark_of([times(2.0)]) != mark_of([times(3.0)])
    assert mark_of([by_way_of(lambda p: p["size"])]) != mark_of([by_way_of(lambda p: 2 * p["size"])])
    assert mark_of([]) == "" and mark_of([changed(timed=True)]) != mark_of([BASE])


SESSION = """
import json, sys
import gtr_jax as gtr
import jax, numpy as np
jax.config.update("jax_compilation_cache_dir", sys.argv[2])
from gtr_jax.terms import Quantity, Term, REGISTRY

factor = float(sys.argv[1])
if factor:
    size = Quantity("size", "N/m", 0.0, 2.0, "Force per length.", (0.2, 10.0), 0.0)
    words = dict(says="A drag.", law="drag", seen="Loss.", told_apart="Look.")
    name = "aaa-drag" if factor < 2 else "zzz-drag"
    gtr.register_term(Term(id=name, quantities=(size,), drag=lambda p, at: factor * p["size"], **words))
    odd = lambda p, at: p["size"] * jax.lax.lgamma(1.0 + at.pressure)
    gtr.register_term(Term(id="odd-drag", quantities=(size,), drag=odd, **words))
    gtr.enable_cache()  # before or after terms are registered
    gtr.register_term(Term(id="my-drag", quantities=(size,), drag=lambda p, at: factor * p["size"], **words))

from gtr_jax.config.config import load_config
from gtr_jax.config.schema import json_schema
from gtr_jax.robot.build import build_robot
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_of

config = load_config(sys.argv[3])
T = jax.numpy.concatenate([jax.numpy.linspace(0.0, 20.0, 9), jax.numpy.linspace(20.0, 0.0, 9)])

def tip(**values):
    robot = build_robot(config.with_values(values))
    run = steps_natively(robot, structure_of(robot, None), loads_of(T, 1.0 * jax.numpy.arange(18), None))
    return np.asarray(run.T_tip).tolist()

found = {"plain": tip(), "adhesion": tip(**{"terms.adhesion.drag": 3.0})}
if factor:
    found["own"] = tip(**{"terms.my-drag.size": 3.0 / factor})
    found["whole"] = tip(**{"terms.my-drag.size": 3.0})
    assert '"my-drag"' in json.dumps(json_schema())
if factor > 1:
    try:
        tip(**{"terms.odd-drag.size": 3.0})
    except gtr.InputError as fault:
        found["says"] = str(fault)
from gtr_jax import stored
found["kept"] = stored._ours
print(json.dumps(found))
"""


@pytest.mark.slow
def test_no_program_of_another_term_stands_for_a_users_own(tmp_path, make_config):
    dump_config(make_config(), tmp_path / "robot.toml")

    def session(factor):
        words = [
            sys.executable,
            "-c",
            SESSION,
            str(factor),
            str(tmp_path / "cache"),
            str(tmp_path / "robot.toml"),
        ]
        done = subprocess.run(
            words, capture_output=True, text=True, cwd=ROOT, env=os.environ | {"GTR_JAX_TERMS": ""}
        )
        assert done.returncode == 0, done.stderr[-2000:]
        found = json.loads(done.stdout.splitlines()[-1])
        return {name: tip if name == "says" else np.asarray(tip) for name, tip in found.items()}

    one, two = session(1.0), session(2.0)
    # The same drag, whoever states it; and what is on disk of the first session is not taken for the second.
    for found in (one, two):
        np.testing.assert_allclose(found["own"], found["adhesion"], atol=1e-9)
        np.testing.assert_array_equal(found["plain"], one["plain"])
    np.testing.assert_allclose(one["whole"], one["own"], atol=1e-12)
    assert np.max(np.abs(two["whole"] - one["whole"])) > 0.05
    assert str(two["says"]).startswith(
        "term 'odd-drag': computes 'lgamma', which native code does not; write it with"
    )
    assert list((tmp_path / "cache").rglob("*.o"))
    assert not one["kept"] and not two["kept"]


def test_the_command_knows_the_terms_of_a_file(tmp_path):
    def run(*words):
        command = [sys.executable, "-m", "gtr_jax", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)

    told = run("terms", "my-seal", "--terms", SEAL)
    assert told.returncode == 0 and 'kind = "my-seal"' in told.stdout, told.stderr
    (tmp_path / "bad.py").write_text(SEAL.read_text().replace('p["size"] *', '1.0 + p["size"] *'))
    refused = run("terms", "--terms", tmp_path / "bad.py")
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1
    assert "term 'my-seal': drag must give 0 at null, and is 1 off it" in refused.stderr
