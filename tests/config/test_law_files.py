"""Laws in robot files: what is read and written, what is refused in one line, and what `gtr terms` says."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import run_gtr
from laws import table

import gtr_jax as gtr
from gtr_jax.config.config import config_text, dump_config, load_config, parse_config
from gtr_jax.config.law_section import MOST_PARAMETERS, LawSection
from gtr_jax.config.schema import json_schema
from gtr_jax.errors import InputError
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.sweep.axes import axes_of
from gtr_jax.sweep.config import parse_sweep
from gtr_jax.terms import REGISTRY
from gtr_jax.terms.law import ACTS

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples/tdcm-1-law.toml"
SEAL = table(name="seal", acts="drag", law="size * exp(-p / fade)", size="2 N/m", fade="0.04 N/mm")


@pytest.fixture(scope="module")
def plain():
    """The example as it is read, without its law."""
    return {k: v for k, v in tomllib.loads(EXAMPLE.read_text()).items() if k != "terms"}


def of(plain, *terms, **more):
    return parse_config({**plain, **more, "terms": list(terms)})


def the_law(config):
    (found,) = (term for term in config.terms if isinstance(term, LawSection))
    return found


def test_the_example_is_the_planar_example_with_a_law(plain):
    config, without = load_config(EXAMPLE), load_config(ROOT / "examples/tdcm-1.toml")
    assert config.model_dump(exclude={"terms"}) == without.model_dump(exclude={"terms"})
    (law,) = config.laws
    assert (law.name, law.acts, law.size.name) == ("seal", "drag", "size")
    robot = gtr.load_robot(EXAMPLE)
    assert robot.acting == ("seal",) and robot.laws == config.laws
    assert [*robot.catalogue] == ["seal", *REGISTRY]


def test_a_law_is_read_in_si(plain):
    law = the_law(of(plain, SEAL))
    assert law.parameters == {"size": 2.0, "fade": 40.0}
    assert law.units == {"size": "N/m", "fade": "N/m"}
    # Unless the file says otherwise: sizes of a drag are not negative, and a scale stays positive.
    assert law.bounds == {"size": (0.0, np.inf), "fade": (0.0, np.inf)}
    assert law.log == ("fade",)
    assert law.usual == {"size": pytest.approx((0.2, 6.0)), "fade": pytest.approx((8.0, 200.0))}
    size, fade = law.as_law.numbers
    assert (size.null, size.size, size.lower, size.upper) == (0.0, True, 0.0, None)
    assert (fade.null, fade.size, fade.log) == (pytest.approx(40.0), False, True)


def test_a_law_is_told_its_priors(plain):
    given = table(
        acts="friction",
        law="1 + size * sin(2 * pi * s / period + phase)",
        size=0,
        period="20 mm",
        phase=0.0,
        usual={"size": [-0.3, 0.3], "period": ["5 mm", "50 mm"], "phase": [-3, 3]},
        bounds={"phase": [-3.2, 3.2], "size": [-1, float("inf")]},
        says="Ribs of the channel.",
    )
    law = the_law(of(plain, given))
    size, period, phase = law.as_law.numbers
    assert (size.lower, size.upper, size.usual) == (-1.0, None, (-0.3, 0.3))
    assert (period.unit, period.log, period.lower) == ("m", True, 0.0)
    assert (phase.lower, phase.upper, phase.log) == (-3.2, 3.2, False)
    assert law.id == "law" and law.as_law.says == "Ribs of the channel."


@pytest.mark.parametrize(
    "given",
    [
        SEAL,
        table(acts="viscous", law="size * v^(1/2)", size="0.3 s^0.5/m^0.5"),
        table(acts="bending", law="size*k*abs(k)", size=0.1, units={"size": "m"}, usual={"size": [-1, 1]}),
        table(acts="friction", law="1 + size * tanh(t / late)", size=-0.2, late="2 min", says="It runs in."),
        table(acts="tip_cell", law="T + size*sin(T/a)", size="30 gf", a="2 N", bounds={"a": [1, 9]}),
    ],
    ids=lambda given: given["acts"],
)  # fmt: skip
def test_a_law_written_is_the_law_read(plain, tmp_path, given):
    config = of(plain, given)
    dump_config(config, tmp_path / "robot.toml")
    again = load_config(tmp_path / "robot.toml")
    assert again == config and again.laws == config.laws
    assert config_text(again) == config_text(config)
    law = the_law(config)
    moved = config.with_values({f"terms.{law.id}.size": 1.1 * law.parameters["size"]})
    assert the_law(moved).parameters == law.parameters | {"size": 1.1 * law.parameters["size"]}
    # Another value is no other law, so that nothing is compiled again.
    assert moved.laws == config.laws
    assert parse_config(json.loads(config.model_dump_json(by_alias=True, exclude_none=True))) == config


def test_several_laws_have_names(plain):
    config = of(plain, SEAL, {**SEAL, "name": "grease-2"}, {"kind": "wear", "rate": 0.02})
    assert [law.name for law in config.laws] == ["seal", "grease-2"]
    assert {"terms.seal.size", "terms.grease-2.fade", "terms.wear.rate"} <= config.numbers().keys()
    known = parameters_of(gtr.build_robot(config))
    assert known["seal.fade"].term is not None and known["seal.fade"].term.id == "seal"
    assert known["mu"].term is None and known["wear.rate"].term is REGISTRY["wear"]
    assert (known["seal.fade"].unit, known["seal.fade"].lower) == ("N/m", 0.0)


def test_what_is_uncertain_of_a_law(plain):
    config = of(plain, SEAL, uncertainty={"terms.seal.size": "0.5 N/m", "seal.fade": "10 %"})
    assert config.deviation("terms.seal.size") == 0.5
    assert config.deviation("terms.seal.fade") == pytest.approx(4.0)
    fold = table(name="fold", acts="bending", law="size * tanh(k / at)", size="0.5 1/m", at="2 1/m")
    assert of(plain, fold, uncertainty={"fold.at": "0.1 1/m"}).deviation("terms.fold.at") == 0.1


def test_a_law_is_swept(plain):
    robot = gtr.build_robot(of(plain, SEAL))
    data = {"schema": 1, "robot": "r.toml", "outputs": ["T_tip"], "history": {"pull": 20.0}}
    vary = {"seal.size": ["1 N/m", "0.004 N/mm"], "terms.seal.fade": {"from": 10, "to": 90, "count": 3}}
    size, fade = axes_of(parse_sweep({**data, "vary": vary}), robot, "N")
    assert size.values is not None and size.values.tolist() == pytest.approx([1.0, 4.0])
    assert fade.parameter.name == "seal.fade" and fade.parameter.term is robot.catalogue["seal"]
    with pytest.raises(InputError, match=r"vary.*seal.size"):
        axes_of(parse_sweep({**data, "vary": {"seal.size": [-1.0, 1.0]}}), robot, "N")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"acts": "dragg"}, "terms[0].acts: expected"),
        ({"law": None}, "terms[0].law: expected a text in quotes"),
        ({"law": "size * exp(-p)"}, "terms.seal.law: does not contain its parameter fade"),
        ({"law": "size * exp(-p / fade) * k"}, "terms.seal.law: k is not known to drag, which knows p, T, v"),
        ({"law": "size * exp(-p / fate)"}, "terms.seal.law: unknown name 'fate'; did you mean 'fade'?"),
        ({"law": "size * exp(-T / fade)"}, "terms.seal.law: exp takes a pure number"),
        ({"law": "fade + size"}, "terms.seal.law: with size = 0 gives 40 instead of 0"),
        ({"law": "size * __import__('os').getcwd()"}, "terms.seal.law: cannot read"),
        ({"law": "(" * 99 + "size" + ")" * 99}, "terms.seal.law: is nested deeper than 25 levels"),
        ({"law": "size^9^9^9^9 * fade"}, "terms.seal.law: 'size^9^9^9^9' raises N/m to a power"),
        ({"law": "size * exp(-p / fade)" + " + 0" * 200}, "terms.seal.law: has 8"),
        ({"name": "wear"}, "terms[0]: name: 'wear' is a term of the catalogue; take small letters"),
        ({"name": "My Seal"}, "terms[0]: name: 'My Seal' is not a valid name of a law; take small letters"),
        ({"name": 3}, "terms[0].name: expected a text in quotes"),
        ({"size": None}, "terms[0]: size: expected a pure number"),
        ({"size": "2 N/m/m"}, "terms.seal.law: is in N/m^2, but drag needs N/m"),
        ({"size": "2 parsnip"}, "terms[0]: size: unknown unit 'parsnip'"),
        ({"size": "2 degC"}, "terms[0]: size: 'degC' is not made of force, length and time"),
        ({"size": "-1 N/m"}, "terms.seal.size: must be at least 0, is -1"),
        ({"fade": "0 N/m"}, "terms[0]: usual.fade: is needed where fade is zero"),
        ({"size": "0 N/m"}, "terms[0]: usual.size: is needed where size is zero"),
        ({"usual": {"sise": [0, 1]}}, "terms[0]: usual: no parameter 'sise'; did you mean 'size'?"),
        ({"usual": {"size": ["1 N/m"]}}, "terms[0]: usual.size: expected two values in brackets"),
        ({"usual": {"size": [2.0, 1.0]}}, "terms[0]: usual.size: the first value must be below the second"),
        (
            {"usual": {"size": ["1 N", "2 N"]}},
            "terms[0]: usual.size: 'N' is not a unit of a force per length",
        ),
        ({"usual": {"size": [0, float("inf")]}}, "terms[0]: usual.size: inf is not a finite number"),
        ({"usual": [1, 2]}, "terms[0]: usual: expected a table of parameters"),
        ({"bounds": {"size": [0.0, 1.0]}}, "terms.seal.size: must be at most 1, is 2"),
        ({"log": ["size"]}, "terms[0]: log: size may be zero; leave it out"),
        ({"log": "fade"}, "terms[0]: log: expected names of parameters in brackets"),
        ({"log": ["fad"]}, "terms[0]: log: expected names of parameters in brackets; there are size, fade"),
        ({"units": {"size": "parsnip"}}, "terms[0]: size: unknown unit 'parsnip'"),
        ({"a-b": 1.0}, "terms[0]: 'a-b' cannot be a parameter"),
        ({f"x{i}": 1.0 for i in range(MOST_PARAMETERS)}, "terms[0]: has 14 parameters; 12 are the most"),
    ],
)
def test_a_wrong_law_takes_one_line(plain, change, says):
    with pytest.raises(InputError) as caught:
        of(plain, {**SEAL, **change})
    assert str(caught.value).startswith(f"robot: {says}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("key", "example"), [("size", 'size = "2 N/m"'), ("acts", "acts"), ("law", "law")])
def test_a_law_lacks_nothing(plain, key, example):
    with pytest.raises(InputError, match=rf"terms\[0\]: missing key '{key}'.*add for example {example}"):
        of(plain, {k: v for k, v in SEAL.items() if k != key})


def test_laws_stand_once_and_beside_no_number_of_the_robot(plain):
    with pytest.raises(
        InputError,
        match=r"terms\[1\].name: 'seal' is given twice; give each law its "
        r"own name",
    ):
        of(plain, SEAL, SEAL)
    two = {k: v for k, v in plain.items() if k not in ("routing", "tendon")}
    tendons = [
        {"name": name, "friction_coefficient": 0.3, "routing": {"kind": "parallel", "offset": f"{R} mm"}}
        for name, R in (("size", 8), ("right", -8))
    ]
    named = gtr.build_robot(of(two, {**SEAL, "name": "mu"}, tendons=tendons))
    with pytest.raises(InputError, match=r"terms\.mu\.size: the robot has a number mu\.size already; rename"):
        parameters_of(named)


@pytest.mark.parametrize(
    ("law", "stiffness", "says"),
    [
        ("size * k * abs(k)", "0.01 N m^2", ""),
        ("size * k^2", "0.01 N m^2", "terms.fold: does not change its sign with k"),
        ("size * k * abs(k)", ["0.01 N m^2", "0.02 N m^2"], "terms.fold: is for sections that are as stiff"),
    ],
)
def test_bending_laws_in_space_are_odd_and_of_round_sections(plain, law, stiffness, says):
    body = {k: v for k, v in plain["backbone"].items() if k not in ("youngs_modulus", "bores")}
    body |= {"bending_stiffness": stiffness, "torsional_stiffness": "0.01 N m^2"}
    fold = table(name="fold", acts="bending", law=law, size="0.02 m")
    if not says:
        assert of(plain, fold, space=True, backbone=body).in_space
        return
    with pytest.raises(InputError, match=says):
        of(plain, fold, space=True, backbone=body)


def test_a_law_that_bends_has_no_place_in_a_rigid_sheath(plain):
    fold = table(name="fold", acts="bending", law="size * k^3", size="0.02 m^2")
    with pytest.raises(InputError, match=r"terms\.fold: has no effect on a backbone with rigid = true"):
        of(plain, fold, backbone=RIGID)


RIGID = {"length": "250 mm", "outer_radius": "13 mm", "rigid": True, "natural_curvature": "8 rad/m"}
PRESLIDING = {"kind": "presliding", "length": "0.6 mm"}


def test_a_tendon_that_does_not_stretch_cannot_slip_in_a_rigid_sheath(plain):
    with pytest.raises(InputError, match=r"terms\.presliding: no tendon slips in a rigid sheath"):
        of(plain, SEAL, PRESLIDING, backbone=RIGID)
    of(plain, SEAL, PRESLIDING, {"kind": "tendon-stretch", "compliance": 1e-4}, backbone=RIGID)


@pytest.mark.parametrize(
    ("acts", "law", "size", "able"),
    [
        ("viscous", "size * v", "20 s/m", False),
        ("friction", "1 + size * tanh(v / v0)", "0.2", False),
        ("friction", "1 + size * exp(-v / v0)", "0.2", True),
        ("drag", "size * tanh(v / v0)", "2 N/m", False),
    ],
)
def test_a_law_of_a_speed_that_there_never_is_is_refused(plain, acts, law, size, able):
    """In a rigid sheath, unless it says something of a tendon at rest too."""
    known = {"v0": "1 mm/s"} if "v0" in law else {}
    own = table(name="film", acts=acts, law=law, size=size, **known)
    if able:
        of(plain, own, backbone=RIGID)
        return
    with pytest.raises(InputError, match=r"terms\.film: no tendon slips in a rigid sheath"):
        of(plain, own, backbone=RIGID)
    of(plain, own)


@pytest.mark.slow
def test_a_tendon_that_stretches_by_a_law_slips_in_a_rigid_sheath(plain):
    spring = table(name="spring", acts="strain", law="size * T", size="5e-5 1/N")
    stretch = {"kind": "tendon-stretch", "compliance": 5e-5}
    robots = [gtr.build_robot(of(plain, term, PRESLIDING, backbone=RIGID)) for term in (spring, stretch)]
    ours, theirs = (gtr.simulate(robot, [0.0, 10.0, 20.0, 12.0]).T_tip for robot in robots)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


def test_the_schema_knows_laws():
    law = json_schema()["$defs"]["LawSection"]
    assert law["properties"]["kind"]["const"] == "law"
    assert law["properties"]["acts"]["enum"] == [*ACTS]
    assert {*law["required"]} == {"kind", "acts", "law", "size"}
    # Every other key is a parameter: a number or a text with a unit.
    number = {"anyOf": [{"type": "number"}, {"type": "string"}]}
    assert law["additionalProperties"] == number
    assert law["properties"]["usual"]["additionalProperties"]["items"] == number
    assert all(said["description"] for said in law["properties"].values())


def test_gtr_terms_says_what_laws_are(capsys):
    said = run_gtr(capsys, "terms", "law")
    assert said.status == 0
    for word in ("viscous", "base_cell", "p [N/m]", "at size = 0", "tanh", 'kind = "law"', "usual.size"):
        assert word in said.out, word
    (shown,) = tomllib.loads(said.out.partition("in a robot file:\n")[2].rpartition("\n\n`gtr")[0])["terms"]
    assert LawSection.model_validate(shown).checked().name == "seal"
    assert "law: Physics of your own" in run_gtr(capsys, "terms").out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("lax",), "terms: no term 'lax'; did you mean 'law'?"),
        (("law", "--law", EXAMPLE), "terms: KIND has no effect beside --law"),
        (("--pull", "3 N"), "terms: --pull has no effect without --law"),
        (("--pictures", "x"), "terms: --pictures has no effect without --law"),
        (("--law", ROOT / "examples/tdcm-1.toml"), "states no law; add [[terms]] with kind = "),
        (("--law", EXAMPLE, "--pull", "-3"), "--pull: must be above 0 N, is -3 N"),
        (("--law", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_gtr_terms_refuses_in_one_line(capsys, arguments, says):
    said = run_gtr(capsys, "terms", *arguments)
    assert said.status == 2 and says in said.err and said.err.count("\n") == 1


def test_gtr_diagnose_refuses_to_leave_out_what_is_no_term(capsys, tmp_path):
    rig = ROOT / "examples/rig"
    given = ("diagnose", rig / "robot.toml", rig / "monday.csv", "-o", tmp_path / "out")
    said = run_gtr(capsys, *given, "--without", "wear, local-fiction")
    assert said.status == 2
    assert said.err.endswith(
        "no term 'local-fiction'; the nearest are local-friction, viscous-friction, stribeck-friction\n"
    )


def test_gtr_terms_draws_the_laws_of_a_file(capsys, tmp_path):
    said = run_gtr(capsys, "terms", "--law", EXAMPLE, "--pictures", tmp_path / "pictures")
    assert said.status == 0, said.err
    assert "fade = 40 N/m; usually 10 N/m to 200 N/m" in said.out
    assert f"picture, with size 6 N/m: {tmp_path / 'pictures/seal.png'}" in said.out
    assert (tmp_path / "pictures/seal.png").read_bytes().startswith(b"\x89PNG")
