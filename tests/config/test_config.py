"""Robot files: units, defaults, round trip, and one line for everything that can be wrong in one."""

import dataclasses
import json
import math
import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from gtr_jax.config.channel_check import check_channel
from gtr_jax.config.config import dump_config, load_config, parse_config
from gtr_jax.config.schema import json_schema
from gtr_jax.config.sections import LoadsConfig
from gtr_jax.errors import InputError, InputWarning
from gtr_jax.terms import REGISTRY
from gtr_jax.units import convert, parse_quantity, quantity_text, to_si

SHARED_ROBOTS = sorted((Path(__file__).parents[3] / "shared/data").glob("**/robot.toml"))

SCHEMA = Path(__file__).parents[2] / "docs/robot.schema.json"

ROBOT = """
schema = 1
name = "tdcm-1"

[backbone]
length = "250 mm"
outer_radius = ["20 mm", "13 mm"]
bores = [
  { from = "0 mm", to = "20 mm", diameter = "14 mm" },
  { from = "80 mm", to = "25 cm", diameter = 0.014 },
]
youngs_modulus = "1.06 MPa"
density = "1070 kg/m^3"

[routing]
kind = "straight-sine-straight"
r1 = "-10 mm"
r2 = "10 mm"
w1 = "20 mm"
w2 = "80 mm"

[tendon]
friction_coefficient = 0.36

[loads]
gravity_angle = "-90 deg"
tip_force = ["0 N", "-0.2 N"]

[uncertainty]
youngs_modulus = "10 %"
"""
TABLE = '[routing]\nkind = "table"\n'


def write(folder, text=ROBOT, name="robot.toml"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def with_routing(routing):
    return re.sub(r"\[routing\].*?(?=\[tendon\])", lambda _: f"{routing}\n", ROBOT, flags=re.DOTALL)


def fault(folder, text):
    """The error message of a robot file, which must be one line that begins with the file's name."""
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


def test_values_are_si(tmp_path):
    robot = load_config(write(tmp_path))
    assert robot.schema_version == 1
    assert robot.backbone.outer_radius == (0.02, 0.013)
    assert [(b.from_, b.to, b.diameter) for b in robot.backbone.bores] == [
        (0, 0.02, 0.014),
        (0.08, 0.25, 0.014),
    ]
    assert robot.backbone.youngs_modulus == 1.06e6
    assert robot.routing.kind == "straight-sine-straight" and robot.routing.r1 == -0.01
    assert robot.loads.gravity_angle == pytest.approx(-math.pi / 2, rel=1e-15)
    assert robot.loads.tip_force == (0.0, -0.2)
    assert (robot.tendon.preload, robot.loads.tip_moment, robot.backbone.natural_curvature) == (0.0, 0.0, 0.0)
    assert robot.uncertainty == {"backbone.youngs_modulus": 0.1}
    assert robot.source == str(tmp_path / "robot.toml")


def test_one_outer_radius_stands_for_both_ends(tmp_path):
    robot = load_config(write(tmp_path, ROBOT.replace('["20 mm", "13 mm"]', '"20 mm"')))
    assert robot.backbone.outer_radius == (0.02, 0.02)


@pytest.mark.parametrize(
    ("value", "si", "expected"),
    [
        ("250 mm", "m", 0.25),
        ("300mm", "m", 0.3),
        ("−1e2 mm", "m", -0.1),
        ("5 gf", "N", 0.04903325),
        ("2 N m", "N m", 2.0),
        ("2 Nm", "N m", 2.0),
        ("11.7 1/m", "rad/m", 11.7),
        ("180°", "rad", math.pi),
        ("0.36", "dimensionless", 0.36),
        (3, "m", 3.0),
    ],
)
def test_quantities(value, si, expected):
    assert parse_quantity(value, si) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "si", "says"),
    [
        ("250 mmm", "m", "unknown unit 'mmm'; write for example \"250 mm\""),
        ("5 kg", "m", "'kg' is not a unit of a length; write for example \"250 mm\""),
        ("5 g", "N", "grams-force are written gf"),
        ("250", "m", "'250' carries no unit; write for example \"250 mm\""),
        ("long", "m", "cannot read 'long' as a length"),
        ("1 m ** (", "m", "unknown unit"),
        (True, "m", "expected a length, found True"),
        (None, "N", "expected a force, found None"),
        (math.nan, "Pa", "nan is not a finite number"),
        ("1e999 m", "m", "not a finite number"),
        (10**400, "Pa", f"1{58 * '0'}… is not a finite number; write for example"),
        (1e308, "m", "1e+308 is more than can be computed with (1e+30 in SI units); write for example"),
        ("1e306 km", "m", "1e306 km is not a finite number"),
        ("5 9**9**9", "m", "unknown unit '9**9**9'"),  # which pint would compute
    ],
)
def test_wrong_quantities(value, si, says):
    with pytest.raises(InputError, match=re.escape(says)) as caught:
        to_si(value, si, "robot.toml: backbone.length")
    assert str(caught.value).startswith("robot.toml: backbone.length: ")


def test_quantity_text_reads_back_to_the_same_float():
    for value in np.random.default_rng(1).lognormal(0.0, 8.0, 200):
        for si in ("m", "rad", "Pa", "N", "rad/m", "dimensionless"):
            assert parse_quantity(quantity_text(float(value), si), si) == value
    assert quantity_text(0.013, "m") == "13 mm"


def test_convert_takes_arrays():
    np.testing.assert_array_equal(convert(np.array([300.0, 13.0]), "mm", "m"), [0.3, 0.013])


@pytest.mark.parametrize(
    "routing",
    [
        '[routing]\nkind = "converging-sine"\nR_max = "15 mm"\nr_min = "7.5 mm"\nn_sine = 10\nsigma = 0.1',
        '[routing]\nkind = "crossing-sine"\nR_max = "20 mm"\nr_min = "8 mm"\nn_sine = 5',
        '[routing]\nkind = "parallel"\noffset = "7.123456789012345 mm"',
        TABLE + 'knots = [["0 mm", "10 mm"], ["0.1 m", 0.003], ["250 mm", "-2 mm"]]',
    ],
)
def test_a_dumped_robot_loads_back_equal(tmp_path, routing):
    text = with_routing(routing).replace(
        "density", 'natural_curvature = [["0 mm", "1 rad/m"], ["250 mm", "90 deg/m"]]\ndensity'
    )
    robot = load_config(write(tmp_path, text))
    dump_config(robot, tmp_path / "dumped" / "robot.toml")
    assert load_config(tmp_path / "dumped" / "robot.toml") == robot
    assert 'length = "250 mm"' in (tmp_path / "dumped" / "robot.toml").read_text()


def test_dump_leaves_the_old_file_when_it_fails(tmp_path, monkeypatch):
    path = write(tmp_path)
    robot = load_config(path)

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        dump_config(robot, path)
    assert path.read_text() == ROBOT
    assert list(tmp_path.iterdir()) == [path]


def test_a_routing_file_is_read_beside_the_robot_file(tmp_path):
    write(tmp_path, "s_mm,R_mm\n0,10\n100,3\n250,-2\n", "route.csv")
    robot = load_config(write(tmp_path, with_routing(TABLE + 'file = "route.csv"')))
    assert robot.routing.kind == "table" and robot.routing.file is None
    assert robot.routing.knots == ((0.0, 0.01), (0.1, 0.003), (0.25, -0.002))
    assert robot.with_values({"friction_coefficient": 0.1}).routing == robot.routing


def test_with_values_takes_what_a_file_leaves_open(tmp_path):
    robot = load_config(write(tmp_path))
    changed = robot.with_values(
        {"loads.tip_force.2": 0.02, "loads.tip_moment.0": 0.01, "tendon.axial_stiffness": "5 kN"}
    )
    assert changed.loads.tip_force == (*robot.loads.tip_force, 0.02)
    assert changed.loads.tip_moment == (0.01, 0.0, robot.loads.tip_moment)
    assert changed.tendon.axial_stiffness == 5e3
    assert robot.with_values({"tip_moment.2": 0.2}).loads.tip_moment == (0.0, 0.0, 0.2)
    for both in (
        {"loads.tip_moment": 0.1, "loads.tip_moment.2": 0.2},
        {"tip_force.2": 1.0, "tip_force": [0, 1]},
    ):
        with pytest.raises(InputError, match="say the same; give one of the two"):
            robot.with_values(both)
    with pytest.raises(InputError, match=r"unknown key 'loads\.tip_force\.3'"):
        robot.with_values({"loads.tip_force.3": 0.02})


def test_with_values(tmp_path):
    robot = load_config(write(tmp_path))
    changed = robot.with_values(
        {
            "tendon.friction_coefficient": 0.3,
            "youngs_modulus": "2 MPa",
            "outer_radius.1": 0.012,
            "backbone.bores.0.to": "30 mm",
            "loads.tip_moment": 0.01,
        }
    )
    assert changed.tendon.friction_coefficient == 0.3
    assert changed.backbone.youngs_modulus == 2e6
    assert changed.backbone.outer_radius == (0.02, 0.012)
    assert changed.backbone.bores[0].to == 0.03
    assert changed.loads.tip_moment == 0.01
    assert robot.tendon.friction_coefficient == 0.36
    assert changed.source == robot.source and changed != robot
    assert robot.with_values({}) == robot
    for values, says in [
        (
            {"tendon.friction": 0.3},
            "unknown key 'tendon.friction'; did you mean 'tendon.friction_coefficient'?",
        ),
        ({"diameter": 0.01}, "may be any of backbone.bores.0.diameter, backbone.bores.1.diameter"),
        ({"routing.w1": "90 mm"}, "routing.w1: w1 = 90 mm must be less than w2 = 80 mm"),
    ]:
        with pytest.raises(InputError, match=re.escape(says)) as caught:
            robot.with_values(values)
        assert str(caught.value).startswith(robot.source)


def test_numbers_by_dotted_key(tmp_path):
    numbers = load_config(write(tmp_path)).numbers()
    assert numbers["backbone.bores.1.from"] == 0.08
    assert numbers["tendon.friction_coefficient"] == 0.36
    assert not any(key.startswith("uncertainty") or key == "schema" for key in numbers)


FAULTS = {
    "unknown key": (
        ("friction_coefficient =", "friction_coeficient ="),
        "tendon: unknown key 'friction_coeficient'; did you mean 'friction_coefficient'?",
    ),
    "unknown section": (("[loads]", "[load]"), "unknown key 'load'; did you mean 'loads'?"),
    "missing key": (
        ('length = "250 mm"\n', ""),
        "backbone: missing key 'length'; add for example length = \"250 mm\"",
    ),
    "missing section": (
        ("[tendon]\nfriction_coefficient = 0.36\n", ""),
        "missing key 'tendon'; add for example [tendon]",
    ),
    "missing schema": (("schema = 1", ""), "missing key 'schema'; add for example schema = 1"),
    "other schema": (("schema = 1", "schema = 2"), "schema: expected 1, found 2"),
    "missing kind": (
        ('kind = "straight-sine-straight"\n', ""),
        "routing: missing key 'kind'; one of straight-sine",
    ),
    "unknown kind": (
        ('"straight-sine-straight"', '"straight-sine"'),
        "routing.kind: unknown kind 'straight-sine'; did you mean 'straight-sine-straight'?",
    ),
    "missing in routing": (
        ('w2 = "80 mm"\n', ""),
        "routing: missing key 'w2'; add for example w2 = \"80 mm\"",
    ),
    "unknown unit": (
        ('"250 mm"', '"250 mmm"'),
        "backbone.length: unknown unit 'mmm'; write for example \"250 mm\"",
    ),
    "wrong dimension": (
        ('"1.06 MPa"', '"1.06 N"'),
        "backbone.youngs_modulus: 'N' is not a unit of a pressure",
    ),
    "no unit": (('"-0.2 N"', '"-0.2"'), "loads.tip_force[1]: '-0.2' carries no unit"),
    "three radii": (
        ('"13 mm"]', '"13 mm", "1 mm"]'),
        "backbone.outer_radius: too many values, found ['20 mm',",
    ),
    "no radii": (('["20 mm", "13 mm"]', "[]"), "backbone.outer_radius[0]: too few values, found []"),
    "one pair": (
        ("density", "natural_curvature = [0, 1]\ndensity"),
        "backbone.natural_curvature[0]: expected a list in brackets, found 0",
    ),
    "name": (('"tdcm-1"', "1"), "name: expected a text in quotes, found 1"),
    "bore without end": (
        ('to = "20 mm", ', ""),
        "backbone.bores[0]: missing key 'to'; add for example to = \"20 mm\"",
    ),
    "negative E": (
        ('"1.06 MPa"', '"-1.06 MPa"'),
        "backbone.youngs_modulus: must be positive, is -1.06e+06 Pa",
    ),
    "no E": (
        ('youngs_modulus = "1.06 MPa"\n', ""),
        "backbone: missing key 'youngs_modulus'; add for example",
    ),
    "no length": (('"250 mm"', '"0 mm"'), "backbone.length: must be positive, is 0 m"),
    "nan": (("0.36", "nan"), "tendon.friction_coefficient: nan is not a finite number"),
    "negative friction": (("0.36", "-0.36"), "tendon.friction_coefficient: cannot be negative, is -0.36"),
    "negative preload": (("0.36", '0.36\npreload = "-1 N"'), "tendon.preload: cannot be negative"),
    "negative density": (('"1070', '"-1070'), "backbone.density: cannot be negative"),
    "gravity without density": (
        ('density = "1070 kg/m^3"\n', ""),
        "backbone: missing key 'density', which gravity_angle",
    ),
    "load on a sheath": (
        ("density", "rigid = true\ndensity"),
        "loads.gravity_angle: has no effect on a backbone with rigid",
    ),
    "rigid by word": (
        ("density", 'rigid = "yes"\ndensity'),
        "backbone.rigid: expected true or false, found 'yes'",
    ),
    "w1 above w2": (
        ('w1 = "20 mm"', 'w1 = "90 mm"'),
        "routing.w1: w1 = 90 mm must be less than w2 = 80 mm; swap",
    ),
    "w2 outside": (('w2 = "80 mm"', 'w2 = "280 mm"'), "routing.w2: 280 mm lies outside the backbone"),
    "bore wider than body": (
        ("diameter = 0.014", "diameter = 0.027"),
        "backbone.bores[1].diameter: the bore is 27 mm wide and the body 26 mm at s = 250 mm; narrow",
    ),
    "bore outside": (
        ('to = "25 cm"', 'to = "26 cm"'),
        "backbone.bores[1]: runs from 80 mm to 260 mm, outside the backbone",
    ),
    "bore backwards": (
        ('from = "0 mm"', 'from = "30 mm"'),
        "backbone.bores[0]: runs from 30 mm to 20 mm; 'from' must lie",
    ),
    "bores overlap": (
        ('from = "80 mm"', 'from = "10 mm"'),
        "backbone.bores[1]: starts at 10 mm, before bores[0] ends at 20 mm",
    ),
    "curvature short": (
        ("density", 'natural_curvature = [[0, 1], ["100 mm", 2]]\ndensity'),
        "backbone.natural_curvature: knots span 0 mm to 100 mm; they must cover 0 mm to 250 mm",
    ),
    "curvature unit": (
        ("density", 'natural_curvature = [[0, 1], ["250 mm", "2 mm"]]\ndensity'),
        "backbone.natural_curvature[1][1]: 'mm' is not a unit of a curvature",
    ),
    "uncertain unknown": (
        ('youngs_modulus = "10 %"', "youngs_moduls = 0.1"),
        "uncertainty: unknown key 'youngs_moduls'; did you mean 'youngs_modulus'?",
    ),
    "uncertain unit": (
        ('youngs_modulus = "10 %"', 'youngs_modulus = "5 deg"'),
        "uncertainty.youngs_modulus: 'deg' is not a unit of a pressure",
    ),
    "uncertain zero": (('"10 %"', "0.0"), "uncertainty.youngs_modulus: must be positive"),
    "uncertain twice": (
        ('"10 %"', '0.1\n"backbone.youngs_modulus" = 0.2'),
        "uncertainty.backbone.youngs_modulus: backbone.youngs_modulus is given twice; remove one",
    ),
    "a term": (
        ("[uncertainty]", '[[terms]]\nkind = "tip-gian"\n[uncertainty]'),
        "terms[0].kind: unknown kind 'tip-gian'; the terms, nearest first: tip-gain, ",
    ),
    "a term twice": (
        ("[uncertainty]", 2 * '[[terms]]\nkind = "tip-gain"\ngain = 1.02\n' + "[uncertainty]"),
        "terms[1].kind: 'tip-gain' is given twice; remove one",
    ),
    "a term without its number": (
        ("[uncertainty]", '[[terms]]\nkind = "tip-gain"\n[uncertainty]'),
        "terms[0]: missing key 'gain'; add for example gain = 1.03",
    ),
    "a term's unit": (
        ("[uncertainty]", '[[terms]]\nkind = "tip-offset"\nforce = "3 mm"\n[uncertainty]'),
        "terms[0].force: 'mm' is not a unit of a force",
    ),
    "a term's bounds": (
        ("[uncertainty]", '[[terms]]\nkind = "tip-gain"\ngain = 0\n[uncertainty]'),
        "terms.tip-gain.gain: must be above 0, is 0; correct it",
    ),
    "a term without kind": (
        ("[uncertainty]", "[[terms]]\ngain = 1.02\n[uncertainty]"),
        "terms[0]: missing key 'kind'; one of presliding",
    ),
    "section is a number": (("[loads]", "[x]\n"), "unknown key 'x'"),
    "not TOML": (("[loads]", "[loads"), "not TOML: "),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_take_one_line(tmp_path, name):
    (old, new), says = FAULTS[name]
    assert ROBOT.count(old) >= 1
    assert fault(tmp_path, ROBOT.replace(old, new, 1)).startswith(says)


def test_several_faults_are_counted(tmp_path):
    says = fault(tmp_path, ROBOT.replace('"250 mm"', '"250 mmm"').replace("0.36", '"0.36 N"'))
    assert says.startswith("backbone.length: ") and says.endswith("(and 1 more)")


def test_a_section_that_is_no_table(tmp_path):
    text = "tendon = 3\n" + ROBOT.replace("[tendon]\nfriction_coefficient = 0.36\n", "")
    assert fault(tmp_path, text) == "tendon: expected a table of keys and values, found 3"


@pytest.mark.parametrize(
    ("routing", "says"),
    [
        ("knots = [[0.0, 0.01]]", "routing.knots: needs at least two knots, has 1"),
        (
            "knots = [[0.0, 0.01], [0.2, 0.01], [0.1, 0.01], [0.25, 0.01]]",
            "routing.knots[2]: s = 100 mm follows 200 mm; s must increase",
        ),
        (
            "knots = [[0.01, 0.01], [0.25, 0.01]]",
            "routing.knots: knots span 10 mm to 250 mm; they must cover 0 mm to 250 mm",
        ),
        ("", "routing: missing key 'knots'; add for example knots = [["),
        (
            'knots = [[0, 0], [0.25, 0]]\nfile = "route.csv"',
            "routing: has both 'knots' and 'file'; remove one",
        ),
        ('file = "absent.csv"', "no such file; check the path"),
        ('file = "route.csv"', "route.csv: row 3, column 'R_mm': expected a number, found 'x'"),
        (
            'file = "unnamed.csv"',
            "unnamed.csv: needs one column for s; columns found: a, b; name them s_mm,R_mm",
        ),
        ("file = 3", "routing: file: expected the name of a CSV file, found 3"),
    ],
)
def test_faulty_tables(tmp_path, routing, says):
    write(tmp_path, "s_mm,R_mm\n0,10\n100,x\n", "route.csv")
    write(tmp_path, "a,b\n0,10\n", "unnamed.csv")
    assert says in fault(tmp_path, with_routing(TABLE + routing))


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "the file is empty"), (b" \n", "the file is empty"), (b"\xff\xfe\x00", "not a text file")],
)
def test_files_that_are_no_robot(tmp_path, content, says):
    path = tmp_path / "robot.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(f"{path}: {says}")):
        load_config(path)


def test_absent_file_and_folder(tmp_path):
    with pytest.raises(InputError, match=r"absent\.toml: no such file; check the path"):
        load_config(tmp_path / "absent.toml")
    with pytest.raises(InputError, match="cannot be read"):
        load_config(tmp_path)


def test_channel_must_stay_inside_the_body(tmp_path):
    robot = load_config(write(tmp_path))
    check_channel(robot, lambda s: np.full_like(s, 0.0129))
    with pytest.raises(InputError) as caught:
        check_channel(robot, lambda s: np.full_like(s, -0.0165))
    assert str(caught.value).startswith(
        f"{robot.source}: routing: the tendon leaves the body at s = 250 mm, where it runs "
        "16.5 mm from the axis and the outer radius is 13 mm; "
    )
    with pytest.raises(InputError, match="s = 100 mm"):
        check_channel(robot, lambda s: 0.03 * np.exp(-(((s - 0.1) / 0.01) ** 2)))
    with pytest.raises(InputError, match="no finite offset"):
        check_channel(robot, lambda s: np.full_like(s, np.nan))


def test_channel_is_checked_at_narrow_knots(tmp_path):
    knots = "knots = [[0, 0], [0.1, 0], [0.10003, 0.03], [0.10006, 0], [0.25, 0]]"
    robot = load_config(write(tmp_path, with_routing(TABLE + knots)))
    s, offset = np.array([[0, 0], [0.1, 0], [0.10003, 0.03], [0.10006, 0], [0.25, 0]]).T
    with pytest.raises(InputError, match=r"s = 100\.03 mm"):
        check_channel(robot, lambda at: np.interp(at, s, offset), points=11)


def test_a_sheath_needs_no_modulus():
    robot = parse_config(
        {
            "schema": 1,
            "backbone": {
                "length": 1.0,
                "outer_radius": "2 mm",
                "natural_curvature": "11.7 rad/m",
                "rigid": True,
            },
            "routing": {"kind": "parallel", "offset": 0},
            "tendon": {"friction_coefficient": 0.06},
        }
    )
    assert robot.backbone.youngs_modulus == 0.0 and robot.loads == LoadsConfig()
    check_channel(robot, np.zeros_like)


@pytest.mark.skipif(not SCHEMA.exists(), reason="needs the repository's docs")
def test_schema_in_the_docs_is_current():
    assert (
        json.loads(SCHEMA.read_text(encoding="utf-8")) == json_schema()
    )  # renew: python -m gtr_jax.config.schema


def test_schema_admits_numbers_and_unit_strings():
    schema = json_schema()
    assert schema["additionalProperties"] is False
    assert set(schema["required"]) == {"schema", "backbone"}
    assert schema["oneOf"] == [{"required": ["routing", "tendon"]}, {"required": ["tendons"]}]
    backbone = schema["$defs"]["BackboneConfig"]
    number, text = backbone["properties"]["length"]["anyOf"]
    assert number["type"] == "number" and text["type"] == "string"
    assert re.search(text["pattern"], "250 mm") and not re.search(text["pattern"], "250")
    assert set(schema["$defs"]["BoreConfig"]["properties"]) == {"from", "to", "diameter"}
    assert schema["$defs"]["TableRouting"]["required"] == ["kind"]
    json.dumps(schema)


@pytest.mark.skipif(not SHARED_ROBOTS, reason="needs the shared data beside the repository")
def test_shared_robots_load_and_dump(tmp_path):
    for path in SHARED_ROBOTS:
        robot = load_config(path)
        dump_config(robot, tmp_path / "robot.toml")
        assert load_config(tmp_path / "robot.toml") == robot


def test_deviations_with_units_of_any_number(tmp_path):
    text = ROBOT.replace(
        'youngs_modulus = "10 %"',
        '"backbone.outer_radius.1" = "0.1 mm"\n"loads.tip_force.1" = "0.02 N"\nE = "5 %"\nmu = 0.1\n'
        '"tip-offset.force" = "0.1 N"\ngravity_angle = "5 deg"\n[[terms]]\nkind = "tip-offset"\nforce = 0',
    )
    (tmp_path / "robot.toml").write_text(text)
    config = load_config(tmp_path / "robot.toml")
    assert config.deviation("backbone.outer_radius.1") == pytest.approx(1e-4)
    assert config.deviation("loads.tip_force.1") == pytest.approx(0.02)
    assert config.deviation("terms.tip-offset.force") == pytest.approx(0.1)
    assert config.deviation("loads.gravity_angle") == pytest.approx(np.radians(5))
    assert config.deviation("backbone.youngs_modulus") == pytest.approx(0.05 * config.backbone.youngs_modulus)
    assert config.deviation("tendon.friction_coefficient") == pytest.approx(0.036)
    dump_config(config, tmp_path / "again.toml")
    assert load_config(tmp_path / "again.toml") == config
    assert not config.without_deviations(config.uncertainty).uncertainty


def spoilt(folder, old, new):
    """What is said of the robot file of these tests with one text for another."""
    assert old in ROBOT
    path = folder / "robot.toml"
    path.write_text(ROBOT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message and len(message) < 300 + len(str(path))
    return message.removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("schema = 1", f"schema = 1{400 * '9'}", "schema: 1999"),
        (
            "schema = 1",
            f"schema = 0x{5000 * 'f'}",
            "schema: an integer of thousands of digits has too many digits",
        ),
        ("schema = 1", f"schema = {5000 * '9'}", "not TOML: Exceeds the limit"),
        ('length = "250 mm"', f"length = 1{400 * '0'}", "backbone.length: 1000"),
        (
            'outer_radius = ["20 mm", "13 mm"]',
            "outer_radius = 1e308",
            "backbone.outer_radius[0]: 1e+308 is more",
        ),
        ('outer_radius = ["20 mm", "13 mm"]', 'outer_radius = "1e308 mm"', "1e308 mm is more than can"),
        (
            'outer_radius = ["20 mm", "13 mm"]',
            "outer_radius = 1e-80",
            "is 1e-80 m, too small to compute with",
        ),
        ('"1.06 MPa"', "1e-200", "backbone.youngs_modulus: 1e-200 Pa leaves a bending stiffness of"),
        ('"10 %"', f"1{400 * '0'}", "uncertainty.youngs_modulus: 1000"),
        ('"10 %"', 300 * "[" + 300 * "]", "uncertainty.youngs_modulus: expected"),
        ('"10 %"', 9000 * "[", "not TOML: brackets nested too deep"),
    ],
)
def test_numbers_beyond_floats_take_one_line(tmp_path, old, new, says):
    assert says in spoilt(tmp_path, old, new)


@pytest.mark.parametrize(("kind", "first"), [("presiding", "presliding"), ("my-own-law", "")])
def test_an_unknown_term_is_told_the_terms_and_not_the_routings(kind, first):
    with pytest.raises(InputError) as caught:
        parse_config(tomllib.loads(ROBOT) | {"terms": [{"kind": kind}]})
    says = str(caught.value).partition(f"terms[0].kind: unknown kind '{kind}'; the terms, nearest first: ")[2]
    names = says.split(", ")
    assert set(names) == {*REGISTRY, "law"} and names[0].startswith(first)


def test_a_term_that_the_files_do_not_know_is_told_the_terms(monkeypatch):
    """One that was registered after the classes of the file were made."""
    own = dataclasses.replace(REGISTRY["tip-gain"], id="my-own-law")
    monkeypatch.setitem(REGISTRY, "my-own-law", own)
    with pytest.raises(InputError, match=r"unknown kind 'my-own-law'; the terms, nearest first: ") as caught:
        parse_config(tomllib.loads(ROBOT) | {"terms": [{"kind": "my-own-law"}]})
    assert "parallel" not in str(caught.value) and "presliding" in str(caught.value)


def test_what_is_uncertain_of_a_list_is_so_of_each_of_its_numbers(make_config):
    config = make_config(uncertainty={"outer_radius": "0.1 mm", "mu": 0.1})
    assert config.deviation("backbone.outer_radius.0") == pytest.approx(1e-4)
    assert config.deviation("backbone.outer_radius.1") == pytest.approx(1e-4)
    with pytest.raises(InputError, match=r"outer_radius\.0 is given twice"):
        make_config(uncertainty={"outer_radius": "0.1 mm", "outer_radius.0": "0.2 mm"})


@pytest.mark.parametrize(
    "written, words", [("1 250 mm", "two numbers"), ("250 ± 1 mm", "deviation.*uncertainty")]
)
def test_a_second_number_is_not_dropped(make_config, written, words):
    with pytest.raises(InputError, match=words) as refused:
        make_config(backbone={"length": written})
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            'length = "250 mm"',
            "length = 250",
            'backbone.length: 250 m is very large for such a robot; if 250 mm is meant, write "250 mm"',
        ),
        ('length = "250 mm"', 'length = "120 m"', 'if 120 mm is meant, write "120 mm"'),
        (
            '["20 mm", "13 mm"]',
            "[20, 13]",
            "backbone.outer_radius.1: 13 m is very large for such a robot; if 13 mm is meant",
        ),
        (
            '"1.06 MPa"',
            "1.06",
            "backbone.youngs_modulus: 1.06 Pa is very small for such a robot; if 1.06 MPa is meant",
        ),
        ('"1.06 MPa"', '"1060 TPa"', "1.06e+15 Pa is very large for such a robot; correct it, or its unit"),
        (
            '"1070 kg/m^3"',
            "1.07",
            "backbone.density: 1.07 kg/m^3 is very small for such a robot; if 1.07 g/cm^3 is meant",
        ),
        (
            '"-90 deg"',
            "-90",
            "loads.gravity_angle: -90 rad is very large for such a robot; if -90 deg is meant",
        ),
        (
            "= 0.36",
            "= 36",
            "tendon.friction_coefficient: 36 is very large for such a robot; if 36 % is meant",
        ),
        (
            '"10 %"',
            "10",
            "uncertainty.backbone.youngs_modulus: 10 is very large for such a robot; if 10 % is meant",
        ),
    ],
)
def test_sizes_that_no_such_robot_has_are_pointed_out(old, new, says, tmp_path):
    """A number without its unit is valid SI, and the robot is computed with all the same."""
    text = ROBOT.replace(old, new, 1)
    assert text != ROBOT
    if "length" in old:  # so that the rest fits into the body
        text = re.sub("bores = .*?\n]\n", "", text, flags=re.DOTALL)
    with pytest.warns(InputWarning) as given:
        load_config(write(tmp_path, text))
    assert any(says in str(warning.message) for warning in given), [str(w.message) for w in given]
    assert all(str(warning.message).startswith(f"{tmp_path / 'robot.toml'}: ") for warning in given)
