"""A body's stiffness may be said by a modulus, by EI, by rows of it, or by pieces: a fit gives the same
answer, and nothing takes one way of saying it for granted.
"""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.hypotheses.hypotheses import base_numbers, catalogue
from calibrate.inference.setup import check_tension
from gtr_jax.config.config import parse_config
from gtr_jax.errors import InputError
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.parameters import parameter
from gtr_jax.robot.stiffness import largest_modulus, stiffness_of, strain_per_tension

LENGTH, RADIUS, E = 0.25, 0.01, 1e6
EI = E * np.pi / 4 * RADIUS**4
STRIP = {"kind": "rectangle", "height": 5e-3, "width": 10e-3}
STRIP_E = EI * 12 / (STRIP["width"] * STRIP["height"] ** 3)
PIECE = {"from": 0.1, "to": LENGTH}
# The same body, and what a fit of it frees.
WAYS = {
    "modulus": ({"youngs_modulus": E}, "E"),
    "stiffness": ({"bending_stiffness": EI}, "EI"),
    "rows": ({"bending_stiffness": [[0.0, EI], [0.1, EI], [LENGTH, EI]]}, "stiffness_factor"),
    "section": ({"youngs_modulus": STRIP_E, "section": STRIP}, "E"),
    "pieces": ({"bending_stiffness": EI, "sections": [PIECE | {"youngs_modulus": E}]}, "stiffness_factor"),
    "one piece": (
        {"youngs_modulus": 5.0, "sections": [PIECE | {"from": 0.0, "bending_stiffness": EI}]},
        "stiffness_factor",
    ),
}
LOOP = np.concatenate([np.linspace(0.0, 20.0, 9), np.linspace(20.0, 3.0, 9)])


def config(body, space=False, **more):
    body = {"length": LENGTH, "outer_radius": RADIUS} | body
    return parse_config(
        {
            "schema": 1,
            "backbone": body,
            "routing": {"kind": "parallel", "offset": 8e-3} | ({"plane_angle": 0.4} if space else {}),
            "tendon": {"friction_coefficient": 0.3},
            **more,
        }
    )


@pytest.mark.parametrize("way", WAYS)
def test_the_numbers_that_say_how_stiff_a_body_is(way):
    robot = build_robot(config(WAYS[way][0]))
    assert stiffness_of(robot) == [WAYS[way][1]]
    assert strain_per_tension(robot, robot.tendons[0]) == pytest.approx(
        8e-3 * (STRIP["height"] / 2 if way == "section" else RADIUS) / EI
    )
    assert largest_modulus(robot.backbone) == pytest.approx(STRIP_E if way == "section" else E)


def fitted(way, space):
    """The truth of a recording of the body by its modulus, on the same mesh, as a fit finds it: friction, and
    stiffness over the true one.
    """
    body, free = WAYS[way]
    split = [PIECE | {"outer_radius": RADIUS}] if "0.1" in str(body) else []
    truth = config({"youngs_modulus": 0.8 * E, "sections": split}, space=space)
    own = {"resolution": 0.3}
    run = gtr.simulate(build_robot(truth, **own).with_values(mu=0.36), LOOP)
    axes = ("tip_x", "tip_y", "tip_z") if space else ("tip_x", "tip_y")
    tip: dict[str, Any] = {
        name: np.asarray(values) for name, values in zip(axes, run.tip_position.T, strict=False)
    }
    recording = gtr.Recording(
        T_base=LOOP,
        T_tip=np.asarray(run.T_tip),
        path=Path("rec.csv"),
        sha256="",
        **tip,
    )
    fit = calibrate.fit(
        build_robot(config(body, space=space), **own), recording, noise_N=0.02, noise_base_N=0.0
    )
    assert fit.converged, fit.verdict
    return fit["mu"].value, fit[free].value / fit[free].initial / 0.8


@pytest.mark.parametrize(
    "way", [w if w in ("stiffness", "rows") else pytest.param(w, marks=pytest.mark.slow) for w in WAYS]
)
def test_a_fit_does_not_ask_how_the_stiffness_is_said(way):
    assert fitted(way, space=False) == pytest.approx((0.36, 1.0), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["modulus", "rows"])
def test_nor_does_one_in_space(way):
    assert fitted(way, space=True) == pytest.approx((0.36, 1.0), rel=1e-6)


def test_tensions_that_no_such_robot_takes_are_refused_whatever_says_its_stiffness():
    """With the number that is to be corrected."""
    for way, (body, free) in WAYS.items():
        robot = build_robot(config(body))
        most = 2.0 / strain_per_tension(robot, robot.tendons[0])
        check_tension(np.full(100, 0.99 * most), robot, "rec.csv", robot.tendons[0])
        with pytest.raises(InputError, match=rf"1\.5 times the most .* correct {parameter(robot, free).key}"):
            check_tension(np.full(100, 1.5 * most), robot, "rec.csv", robot.tendons[0])
        (mu, stiffness) = base_numbers(robot, {})
        assert (mu.name, stiffness.name, stiffness.unit) == ("mu", free, parameter(robot, free).unit), way


def test_the_modulus_of_another_body_is_answered_with_the_number_it_has():
    for body, free in WAYS.values():
        if not body.get("youngs_modulus"):
            with pytest.raises(InputError, match=rf"name {free} instead"):
                parameter(build_robot(config(body)), "E")


def test_what_only_metal_does_is_tried_of_a_body_as_stiff_as_metal():
    given = {"timed": False, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    for stiffness, tried in ((1e9 * np.pi / 4 * RADIUS**4, True), (EI, False)):
        robot = build_robot(config({"bending_stiffness": stiffness}))
        assert ("superelastic" in {h.kind for h in catalogue(robot, **given)}) is tried


def test_a_factor_scales_every_stiffness():
    body = WAYS["rows"][0] | {"torsional_stiffness": 1e-3, "sections": [PIECE | {"youngs_modulus": 2 * E}]}
    plain = build_robot(config(body, space=True))
    twice = build_robot(config(body | {"stiffness_factor": 2.0}, space=True))
    s = jnp.asarray([0.05, 0.2])
    within = jnp.asarray([[False, True]])
    for one, two in zip(
        plain.backbone.stiffnesses(s, within), twice.backbone.stiffnesses(s, within), strict=True
    ):
        assert jnp.array_equal(2 * one, two)
    assert float(plain.value("stiffness_factor")) == 1.0
    assert plain.with_values(stiffness_factor=2.0).value("stiffness_factor") == 2.0


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ({"youngs_modulus": E, "stiffness_factor": 2.0}, "leave stiffness_factor out"),
        ({"bending_stiffness": EI, "stiffness_factor": 2.0}, "leave stiffness_factor out"),
        (WAYS["rows"][0] | {"stiffness_factor": -1.0}, "must be positive"),
        ({"rigid": True, "stiffness_factor": 2.0}, "has no effect"),
    ],
)
def test_a_factor_belongs_to_several_numbers(body, says):
    with pytest.raises(InputError, match=says):
        config(body)


def test_a_factor_is_written_and_read(tmp_path):
    given = config(WAYS["rows"][0]).with_values({"backbone.stiffness_factor": 1.25})
    gtr.dump_config(given, tmp_path / "robot.toml")
    assert gtr.load_config(tmp_path / "robot.toml") == given
    assert config(WAYS["rows"][0], uncertainty={"stiffness_factor": 0.2}).deviation(
        "backbone.stiffness_factor"
    ) == pytest.approx(0.2)
