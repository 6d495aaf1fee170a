"""Cross-sections by name: a strip or a tube that carries the load of a body with a wider outline."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.config.config import parse_config
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.shapes import Rectangle, Tube
from gtr_jax.robot.validity import is_robot

LENGTH, RADIUS, ARM, E = 0.2, 8e-3, 6e-3, 60e9
STRIP = {"kind": "rectangle", "height": 0.4e-3, "width": 10e-3}
PIPE = {"kind": "tube", "outer_diameter": 1.2e-3, "inner_diameter": 0.8e-3}


def config(section, **more):
    body = {"length": LENGTH, "outer_radius": RADIUS, "youngs_modulus": E, "section": section}
    return parse_config(
        {
            "schema": 1,
            "backbone": body | more.pop("backbone", {}),
            "routing": {"kind": "parallel", "offset": ARM} | more.pop("routing", {}),
            "tendon": {"friction_coefficient": 0.0},
            **more,
        }
    )


@pytest.mark.parametrize(
    ("section", "second"),
    [(STRIP, 10e-3 * 0.4e-3**3 / 12), (PIPE, np.pi / 64 * (1.2e-3**4 - 0.8e-3**4))],
    ids=["rectangle", "tube"],
)
def test_a_body_bends_by_the_section_that_carries_its_load(section, second):
    robot = build_robot(config(section))
    run = gtr.simulate(robot, np.array([0.0, 1.5]))
    np.testing.assert_allclose(run.curvature[1], 1.5 * ARM / (E * second), rtol=1e-9)
    name = f"section_{'height' if section is STRIP else 'outer_diameter'}"
    bent = gtr.simulate(
        robot.with_values(**{name: 1.1 * float(robot.value(name))}), np.array([1.5])
    ).curvature
    assert np.all(np.asarray(bent) < 0.8 * np.asarray(run.curvature[1]))


@pytest.mark.parametrize(("ratio", "factor"), [(1.0, 0.140577), (2.0, 0.228682), (10.0, 0.312325)])
def test_torsion_of_a_rectangle(ratio, factor):
    """J = factor times longer times thinner cubed, as tables of Saint-Venant's torsion have it."""
    for height, width in ((1.0, ratio), (ratio, 1.0)):
        twist, about_y, about_z = Rectangle(jnp.asarray(height), jnp.asarray(width)).stiffnesses(
            jnp.asarray(0.25)
        )
        assert float(twist) * 2.5 == pytest.approx(factor * ratio, rel=1e-5)
        assert float(about_y) == pytest.approx(height * width**3 / 12)
        assert float(about_z) == pytest.approx(width * height**3 / 12)
    rod = Tube(jnp.asarray(2.0), jnp.asarray(0.0)).stiffnesses(jnp.asarray(0.25))
    assert [float(v) for v in rod] == pytest.approx([np.pi / 4 / 1.25, np.pi / 4, np.pi / 4])


def test_in_space_a_strip_bends_over_its_thin_side():
    robot = build_robot(config(STRIP, routing={"plane_angle": np.pi / 2}))
    over, across = np.asarray(robot.backbone.compliances(jnp.zeros(1), jnp.zeros((0, 1), bool)))[0, 1:]
    assert across / over == pytest.approx(25.0**2)


def test_a_ring_is_a_tube_with_both_diameters():
    ring, pipe = (build_robot(config(section)).backbone.shape for section in (PIPE | {"kind": "ring"}, PIPE))
    assert isinstance(ring, Tube)
    assert eqx.tree_equal(ring, pipe)


def test_it_is_written_and_read(tmp_path):
    given = config(STRIP, name="strip").with_values({"backbone.section.height": 0.5e-3})
    gtr.dump_config(given, tmp_path / "robot.toml")
    assert gtr.load_config(tmp_path / "robot.toml") == given


@pytest.mark.parametrize(
    ("section", "wrong"),
    [
        (PIPE, ({"section_inner_diameter": 1.3e-3}, {"section_outer_diameter": 17e-3})),
        (STRIP, ({"section_width": 16.1e-3}, {"section_height": 13e-3})),
    ],
    ids=["tube", "strip"],
)
def test_a_sweep_marks_sections_that_no_body_has(section, wrong):
    """Those that a file is refused for: of a strip by its diagonal."""
    robot = build_robot(config(section))
    assert bool(is_robot(robot))
    for values in wrong:
        assert not bool(is_robot(robot.with_values(**values)))
        with pytest.raises(gtr.InputError):
            config(section).with_values({f"backbone.{k.replace('_', '.', 1)}": v for k, v in values.items()})
    if section is STRIP:
        assert bool(is_robot(robot.with_values(section_height=12e-3)))  # 15.6 mm from corner to corner


@pytest.mark.parametrize(
    ("section", "more", "words"),
    [
        ({"kind": "hexagon"}, {}, "backbone.section.kind: unknown kind 'hexagon'"),
        ({"height": 1e-3}, {}, "missing key 'kind'; one of tube, ring, rectangle"),
        ({"kind": "rectangle", "hieght": 1e-3, "width": 1e-3}, {}, "did you mean 'height'"),
        ({"kind": "rectangle", "height": 0.0, "width": 1e-3}, {}, "section.height: must be positive"),
        ({"kind": "tube", "outer_diameter": "1 deg"}, {}, "backbone.section.outer_diameter: "),
        ({**PIPE, "inner_diameter": 1.2e-3}, {}, "section.inner_diameter: is 1.2 mm"),
        ({**STRIP, "width": 17e-3}, {}, "the body 16 mm where it is thinnest"),
        (PIPE, {"youngs_modulus": 0.0, "bending_stiffness": 1e-3}, "keep one of the two"),
        (PIPE, {"bores": [{"from": 0.0, "to": 0.1, "diameter": 1e-3}]}, "not computed beside section"),
        ({"kind": "ring", "outer_diameter": 1e-3}, {}, "backbone.section: missing key 'inner_diameter'"),
        (PIPE, {"rigid": True}, "no effect on a backbone with rigid"),
    ],
)
def test_wrong_sections_are_refused(section, more, words):
    with pytest.raises(gtr.InputError) as error:
        config(section, backbone=more)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_round_law_is_refused_for_a_strip_in_space():
    with pytest.raises(gtr.InputError, match="a tube instead of a rectangle"):
        config(STRIP, space=True, terms=[{"kind": "superelastic", "softening": 0.8}])
