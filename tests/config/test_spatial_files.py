"""Robot files of spatial robots: what they hold, what leaves the plane, and one line for what is wrong."""

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.config.config import config_text
from gtr_jax.robot.clearance import distances
from gtr_jax.robot.robot import lay_out

SPATIAL = """
schema = 1
name = "three tendons"

[backbone]
length = "250 mm"
outer_radius = "12 mm"
youngs_modulus = "1.2 MPa"
density = "1070 kg/m^3"
poissons_ratio = 0.45
natural_twist = "1 rad/m"
natural_curvature_y = [["0 mm", "-2 rad/m"], ["130 mm", "-3 rad/m"], ["250 mm", "-1 rad/m"]]
natural_curvature = "3 rad/m"

[[backbone.sections]]
from = "50 mm"
to = "60 mm"
outer_radius = ["11 mm", "10.5 mm"]
youngs_modulus = "2 MPa"

[[backbone.sections]]
from = "100 mm"
to = "120 mm"
bending_stiffness = ["0.02 N m^2", "0.01 N m^2"]
torsional_stiffness = "0.008 N m^2"

[[tendons]]
name = "wound"
friction_coefficient = 0.3
drive = "displacement"
axial_stiffness = "5 kN"
free_length = "300 mm"
[tendons.routing]
kind = "helix"
radius = "8 mm"
tip_radius = "5 mm"
turns = 1.25
start_angle = "30 deg"

[[tendons]]
name = "short"
friction_coefficient = 0.2
to = "205 mm"
guides = ["40 mm", "80 mm", "205 mm"]
routing = { kind = "straight", radius = "7 mm", angle = "120 deg" }

[[tendons]]
name = "sine"
friction_coefficient = 0.2
routing = { kind = "crossing-sine", R_max = "8 mm", r_min = "6 mm", n_sine = 2, plane_angle = "45 deg" }

[[tendons]]
name = "free"
friction_coefficient = 0.2
[tendons.routing]
kind = "curve"
knots = [["0 mm", "-8 mm", "0 mm"], ["90 mm", "-7 mm", "-2 mm"], ["170 mm", "0 mm", "-6 mm"],
  ["250 mm", "6 mm", "0 mm"]]

[loads]
gravity = ["0 m/s^2", "0 m/s^2", "-9.81 m/s^2"]
tip_force = ["0 N", "-0.1 N", "0.2 N"]
tip_moment = ["1 mN m", "0 N m", "-2 mN m"]
payload = "5 g"

[base]
position = ["10 mm", "0 mm", "5 mm"]
rotation = ["0 deg", "90 deg", "0 deg"]

[[markers]]
name = "m1"
at = "129.1 mm"
offset = ["0 mm", "0 mm", "25 mm"]
"""


@pytest.fixture
def load(tmp_path):
    def read(text=SPATIAL, old="", new=""):
        assert old in text
        path = tmp_path / "robot.toml"
        path.write_text(text.replace(old, new, 1) if old else text, encoding="utf-8")
        return gtr.load_robot(path)

    return read


def test_a_spatial_file_becomes_a_robot(load):
    robot = load()
    assert robot.space and robot.loaded
    np.testing.assert_allclose(robot.loads.gravity_vector(), [0, 0, -9.81])
    np.testing.assert_allclose(robot.loads.tip_force, [0, -0.1, 0.2])
    np.testing.assert_allclose(robot.loads.tip_moment, [1e-3, 0, -2e-3])
    np.testing.assert_allclose(robot.base.rotation @ np.array([1.0, 0, 0]), [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(robot.base.position, [0.01, 0, 0.005])
    wound, short, sine, free = robot.tendons
    assert (wound.drive, short.drive) == ("displacement", "tension")
    assert (float(wound.axial_stiffness), float(wound.free_length)) == (5000.0, 0.3)
    assert np.isinf(short.axial_stiffness) and wound.to is None and float(short.to) == 0.205
    np.testing.assert_allclose(short.guides, [0.04, 0.08, 0.205])
    assert float(sine.routing.plane_angle) == pytest.approx(np.pi / 4)
    assert free.routing.knots_s.shape == (4,)
    assert robot.markers[0].name == "m1" and float(robot.markers[0].offset[2]) == 0.025


def test_stiffness_and_strain_by_pieces(load):
    body = load().backbone
    s = jnp.array([0.03, 0.055, 0.11])
    within = jnp.array([[False, True, False], [False, False, True]])
    round_, stiff, given = 1 / np.asarray(body.compliances(s, within))
    I = np.pi / 4 * 0.012**4
    np.testing.assert_allclose(round_, 1.2e6 * I * np.array([1 / 1.45, 1, 1]), rtol=1e-14)
    I = np.pi / 4 * 0.01075**4
    np.testing.assert_allclose(stiff, 2e6 * I * np.array([1 / 1.45, 1, 1]), rtol=1e-14)
    np.testing.assert_allclose(given, [0.008, 0.02, 0.01], rtol=1e-14)
    np.testing.assert_allclose(body.compliance(s, within), body.compliances(s, within)[:, 2], rtol=0)
    np.testing.assert_allclose(body.strain_at_rest(s)[0], [1, -2 - 3 / 13, 3], rtol=1e-14)
    np.testing.assert_allclose(body.radius(s), [0.012, 0.01075, 0.012])


def test_panels_end_at_pieces_and_knots(load):
    robot = load()
    at = lay_out(robot)
    s = np.asarray(at.mesh.s)
    for kink in (0.05, 0.06, 0.1, 0.12, 0.13):
        assert np.sum(np.abs(s - kink) < 1e-12) == 2
    np.testing.assert_array_equal(np.asarray(at.bored).sum(axis=1) > 0, [True, True])
    middle = 0.5 * (s[1:] + s[:-1])
    inside = np.diff(s) > 0
    np.testing.assert_array_equal(
        np.asarray(at.bored)[1, 1:][inside], ((middle > 0.1) & (middle < 0.12))[inside]
    )


def test_panels_end_at_ends_and_guides_of_tendons(load):
    robot = load()
    at = lay_out(robot)
    s = np.asarray(at.mesh.s)
    assert [np.sum(np.asarray(own)) > 0 for own in at.beyond] == [False, True, False, False]
    middle, inside = 0.5 * (s[1:] + s[:-1]), np.diff(s) > 0
    np.testing.assert_array_equal(np.asarray(at.beyond)[1, 1:][inside], (middle > 0.205)[inside])
    assert [own.shape[0] for own in at.guides] == [0, 3, 0, 0]
    for i, guide in enumerate((0.04, 0.08, 0.205)):
        np.testing.assert_array_equal(np.asarray(at.guides[1])[i, 1:][inside], (middle > guide)[inside])
        assert np.any(np.abs(s - guide) < 1e-12)


def test_a_table_of_stiffness_is_linear_between_its_rows(load):
    plane = PLANE.replace(
        'youngs_modulus = "1.2 MPa"',
        'bending_stiffness = [["0 mm", "0.02 N m^2"], ["100 mm", "0.01 N m^2"], ["250 mm", "0.01 N m^2"]]',
    )
    robot = load(plane)
    assert not robot.space and "E" not in gtr.parameters_of(robot)
    s = jnp.array([0.05, 0.2])
    np.testing.assert_allclose(1 / robot.backbone.compliance(s, jnp.zeros((0, 2), bool)), [0.015, 0.01])
    assert float(robot.with_values(EI_1=0.02).backbone.stiffness.bending[1]) == 0.02


def test_it_is_written_and_read_back(load, tmp_path):
    load()
    config = gtr.load_config(tmp_path / "robot.toml")
    (tmp_path / "again.toml").write_text(config_text(config), encoding="utf-8")
    assert gtr.load_config(tmp_path / "again.toml") == config


def test_every_number_of_it_has_a_name_and_a_key(load, tmp_path):
    robot = load()
    config = gtr.load_config(tmp_path / "robot.toml")
    numbers, found = config.numbers(), gtr.parameters_of(robot)
    for entry in found.values():
        if entry.key in numbers:
            assert float(robot.value(entry.name)) == pytest.approx(numbers[entry.key]), entry.name
        value = max(0.0123, entry.lower or 0.0)
        changed = robot.with_values(**{entry.name: value})
        assert float(changed.value(entry.name)) == pytest.approx(value), entry.name
        if entry.key in numbers and ".short." not in entry.name:
            value = numbers[entry.key]
            assert config.with_values({entry.key: value}).numbers()[entry.key] == value, entry.name
    assert all(found[name].key in numbers for name in NAMED.split())
    missed = set(numbers) - {entry.key for entry in found.values()}
    # Places of knots and of markers are fixed, and so is a table of natural strain.
    fixed = [key for key in missed if ".knots." in key and key.endswith(".0")]
    assert missed == {*fixed, *(k for k in missed if "natural_curvature_y" in k or k.startswith("markers."))}


NAMED = """
radius.wound tip_radius.wound turns.wound start_angle.wound EA.wound free_length.wound to.short guide_1.short
angle.short plane_angle.sine knot_y_1.free knot_z_2.free nu natural_twist natural_curvature tip_force_z
tip_moment_x gravity_z base_x base_rotation_y section_0_E section_1_EI_y section_1_EI_z section_1_GJ
"""
PLANE = """
schema = 1
[backbone]
length = "250 mm"
outer_radius = "12 mm"
youngs_modulus = "1.2 MPa"
density = "1000 kg/m^3"
[routing]
kind = "parallel"
offset = "8 mm"
[tendon]
friction_coefficient = 0.3
"""
LEAVING = {
    "turned": ('offset = "8 mm"', 'offset = "8 mm"\nplane_angle = "10 deg"', "routing.plane_angle"),
    "helix": (
        'kind = "parallel"\noffset = "8 mm"',
        'kind = "helix"\nradius = "8 mm"\nturns = 0',
        "routing.kind",
    ),
    "twisted": ("density", 'natural_twist = "1 rad/m"\ndensity', "backbone.natural_twist"),
    "pushed": ("[routing]", '[loads]\ntip_force = ["0 N", "0 N", "1 N"]\n[routing]', "loads.tip_force"),
    "turned at the tip": (
        "[routing]",
        '[loads]\ntip_moment = ["1 N m", "0 N m", "0 N m"]\n[routing]',
        "loads.tip_moment",
    ),
    "weighs": ("[routing]", '[loads]\ngravity = [0, 0, "-9.8 m/s^2"]\n[routing]', "loads.gravity"),
    "based": ("[routing]", '[base]\nrotation = [0, "1 deg", 0]\n[routing]', "base"),
    "driven": ("= 0.3", '= 0.3\ndrive = "displacement"', "tendon.drive"),
    "ended": ("= 0.3", '= 0.3\nto = "200 mm"', "tendon.to"),
    "a load across": (
        "[routing]",
        '[[terms]]\nkind = "tip-load"\nz = "0.05 N"\n[routing]',
        "terms.tip-load.z",
    ),
    "guided": ("= 0.3", '= 0.3\nguides = ["100 mm", "200 mm"]', "tendon.guides"),
    "said": ("schema = 1", "schema = 1\nspace = true", "space"),
}


@pytest.mark.parametrize("name", LEAVING)
def test_what_leaves_the_plane(name, load, tmp_path):
    old, new, key = LEAVING[name]
    robot = load(PLANE, old, new)
    assert robot.space and gtr.load_config(tmp_path / "robot.toml").leaves_plane == key
    assert robot.loads.tip_force.shape == robot.loads.tip_moment.shape == (3,)


def test_what_stays_in_the_plane(load):
    text = PLANE.replace(
        "[routing]",
        '[loads]\ngravity = [0, "-9.8 m/s^2", 0]\ntip_force = ["1 N", "2 N", 0]\n'
        'tip_moment = [0, 0, "3 N m"]\n[[markers]]\nname = "m1"\nat = "100 mm"\n[routing]',
    )
    robot = load(text)
    assert not robot.space
    np.testing.assert_allclose(robot.loads.more_gravity, [0, -9.8])
    np.testing.assert_allclose(robot.loads.tip_force, [1, 2])
    assert float(robot.loads.tip_moment) == 3.0


FAULTS = {
    "a term of one tendon": (
        "[base]",
        '[[terms]]\nkind = "contact"\nstiffness = "100 N/m"\n[base]',
        "terms.contact: bends the stretch that friction holds, which in space is computed for one tendon",
    ),
    "outside the body": (
        'tip_radius = "5 mm"',
        'tip_radius = "12.5 mm"',
        "tendons.wound.routing: the tendon leaves",
    ),
    "negative radius": (
        'radius = "8 mm"',
        'radius = "-8 mm"',
        "tendons.wound.routing.radius: cannot be negative",
    ),
    "knots": (
        '["90 mm", "-7',
        '["190 mm", "-7',
        "tendons.free.routing.knots[2]: s = 170 mm follows 190 mm; s must",
    ),
    "beyond the end": (
        'to = "205 mm"',
        'to = "255 mm"',
        "tendons.short.to: 255 mm lies outside the backbone",
    ),
    "guide beyond": (
        '"205 mm"]',
        '"215 mm"]',
        "tendons.short.guides: the last at 215 mm lies beyond the tendon's end",
    ),
    "guides back": (
        '["40 mm", "80 mm"',
        '["80 mm", "40 mm"',
        "tendons.short.guides[1]: 40 mm does not lie beyond 80",
    ),
    "guide at the base": (
        '["40 mm",',
        '["0 mm", "40 mm",',
        "tendons.short.guides[0]: 0 mm does not lie beyond the base",
    ),
    "two drives": (
        '"displacement"',
        '"both"',
        "tendons[0].drive: expected 'tension' or 'displacement', found 'both'",
    ),
    "stretch twice": (
        "[base]",
        '[[terms]]\nkind = "tendon-stretch"\ncompliance = "1e-4 1/N"\n[base]',
        "tendons.wound.axial_stiffness: says what terms.tendon-stretch.compliance says",
    ),
    "free but stiff": ('axial_stiffness = "5 kN"\n', "", "tendons.wound.free_length: has no effect without"),
    "rotated": (
        '"90 deg", "0',
        '"390 deg", "0',
        "base.rotation: a rotation vector of 390 deg is more than a full turn",
    ),
    "rotation of four": ('"0 deg"]', '"0 deg", "0 deg"]', "base.rotation: too many values"),
    "two vectors": (
        "payload",
        'gravity_angle = "-90 deg"\npayload',
        "loads.gravity: says what gravity_angle says",
    ),
    "weightless": ('density = "1070 kg/m^3"\n', "", "backbone: missing key 'density', which gravity needs"),
    "force of four": ('"0.2 N"]', '"0.2 N", "0 N"]', "loads.tip_force: too many values"),
    "ratio": ("= 0.45", "= 0.6", "backbone.poissons_ratio: must lie above -1 and be at most 0.5, is 0.6"),
    "pieces overlap": (
        'to = "60 mm"',
        'to = "160 mm"',
        "backbone.sections[1]: starts at 100 mm, before sections[0]",
    ),
    "no torsion": (
        'torsional_stiffness = "0.008 N m^2"\n',
        "",
        "backbone.sections[1]: missing key 'torsional_stiffness'",
    ),
    "piece of nothing": (
        'outer_radius = ["11 mm", "10.5 mm"]\nyoungs_modulus = "2 MPa"',
        "",
        "backbone.sections[0]: changes nothing",
    ),
    "marker outside": ('"129.1 mm"', '"329.1 mm"', "markers[0].at: 329.1 mm lies outside the backbone"),
    "marker twice": (
        "[[markers]]",
        '[[markers]]\nname = "M1"\nat = 0\n[[markers]]',
        "markers[1].name: 'm1' has the same",
    ),
    "marker tip": ('"m1"', '"tip"', "markers[0].name: 'tip' clashes with the column tip_x"),
    "marker named oddly": ('"m1"', '"1"', "markers[0].name: '1' cannot begin"),
    "the same channel": (
        'kind = "straight", radius = "7 mm", angle = "120 deg"',
        'kind = "crossing-sine", R_max = "8 mm", r_min = "6 mm", n_sine = 2, plane_angle = "45 deg"',
        "tendons.sine.routing: runs in the channel of tendons.short all along",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_takes_one_line(name, load, tmp_path):
    old, new, says = FAULTS[name]
    with pytest.raises(gtr.InputError) as caught:
        load(SPATIAL, old, new)
    message = str(caught.value)
    assert "\n" not in message and message.startswith(f"{tmp_path / 'robot.toml'}: {says}")


def test_channels_that_cross_are_found(load):
    text = """
[[tendons]]
name = "NAME"
friction_coefficient = 0.2
routing = { kind = "KIND" }
"""
    helix = 'helix", radius = "8 mm", turns = 0.85, start_angle = "0 deg'
    straight = 'straight", radius = "8 mm", angle = "120 deg'
    body = PLANE[: PLANE.index("[routing]")]
    strung = [text.replace("NAME", n).replace("KIND", k) for n, k in (("a", helix), ("b", straight))]
    found = distances(load(body + "".join(strung)))
    assert len(found) == 1 and found[0].at == pytest.approx(0.25 / 3 / 0.85, abs=1e-5)
    assert "channels of a and b run through one another" in found[0].says
    apart = distances(
        load(body + "".join(strung).replace('radius = "8 mm", angle', 'radius = "6 mm", angle'))
    )
    assert apart[0].least == pytest.approx(0.002, rel=1e-4) and not apart[0].says


def test_a_curve_is_read_from_a_file(load, tmp_path):
    (tmp_path / "route.csv").write_text("s_mm,y_mm,z_mm\n0,8,0\n100,0,8\n250,-8,0\n")
    robot = load(PLANE, 'kind = "parallel"\noffset = "8 mm"', 'kind = "curve"\nfile = "route.csv"')
    np.testing.assert_allclose(robot.routing.knots_z, [0, 0.008, 0])
    (tmp_path / "route.csv").write_text("s_mm,R_mm\n0,8\n250,-8\n")
    with pytest.raises(gtr.InputError, match=r"needs one column for y.*name them s_mm,y_mm,z_mm"):
        load(PLANE, 'kind = "parallel"\noffset = "8 mm"', 'kind = "curve"\nfile = "route.csv"')


def test_the_mesh_follows_the_turns_of_a_helix(load):
    old = 'kind = "parallel"\noffset = "8 mm"'
    few, many = (
        sum(load(PLANE, old, f'kind = "helix"\nradius = "8 mm"\nturns = {turns}').intervals)
        for turns in (1, 10)
    )
    assert few == 48 and many == 400
