"""Tendons within a bore, where nothing holds them: files that do not say how they run are warned of."""

import warnings

import pytest

from gtr_jax.errors import InputWarning
from gtr_jax.robot.build import build_robot

BORES = [{"from": 0.05, "to": 0.2, "diameter": 0.016}]
INSIDE = {"kind": "parallel", "offset": 0.006}
HELIX = {"kind": "helix", "radius": 0.006, "turns": 1.0, "start_angle": 0.0}


def said(config):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        build_robot(config)
    return [str(one.message) for one in found if one.category is InputWarning]


def test_a_tendon_in_the_free_space_of_a_bore_is_warned_of(make_config):
    config = make_config(routing=INSIDE, backbone={"bores": BORES})
    (text,) = said(config)
    for words in ("routing", "from s = 50 mm to 200 mm", "up to 2 mm from its wall", "guides", "clearance"):
        assert words in text


def test_only_where_it_lies_in_the_bore(make_config):
    ramp = {"kind": "table", "knots": [[0.0, 0.012], [0.25, 0.0]]}
    (text,) = said(make_config(routing=ramp, backbone={"bores": BORES}))
    assert "from s = 86.75 mm to 200 mm the" in text
    assert not said(make_config(routing={"kind": "parallel", "offset": 0.010}, backbone={"bores": BORES}))


@pytest.mark.parametrize(
    ("routing", "more"),
    [
        ({"kind": "parallel", "offset": 0.008}, {}),  # along the wall
        (INSIDE, {"terms": [{"kind": "clearance", "share": 0.1}]}),
        (INSIDE, {"backbone": {"rigid": True, "youngs_modulus": None, "density": None}}),
        (HELIX, {"tendon": {"guides": [0.05, 0.1, 0.15, 0.2]}, "space": True}),
    ],
    ids=["wall", "clearance", "sheath", "guides"],
)
def test_nothing_is_said_where_the_file_says_how_it_runs(make_config, routing, more):
    body = {"bores": BORES, **more.pop("backbone", {})}
    assert not said(make_config(routing=routing, backbone=body, **more))


def test_a_wavy_channel_is_told_by_its_longest_stretch(make_config):
    wave = {
        "kind": "table",
        "knots": [[0.0, 0.012], [0.06, 0.002], [0.1, 0.012], [0.2, 0.002], [0.25, 0.012]],
    }
    (text,) = said(make_config(routing=wave, backbone={"bores": BORES}))
    assert "and in 1 more stretch the tendon lies in a bore" in text
    first = float(text.partition("from s = ")[2].partition(" mm")[0])
    assert first > 100


def test_a_tendon_that_ends_where_a_bore_begins_lies_in_none(make_config):
    bore = [{"from": 0.05, "to": 0.25, "diameter": 0.016}]
    assert not said(make_config(routing=INSIDE, backbone={"bores": bore}, tendon={"to": 0.05}))


@pytest.mark.parametrize("kind", ["ring", "tube"])
def test_a_tube_is_hollow_all_along(make_config, kind):
    section = {"kind": kind, "outer_diameter": 0.016, "inner_diameter": 0.014}
    body = {"outer_radius": 0.01, "section": section}
    (text,) = said(make_config(routing={"kind": "parallel", "offset": 0.002}, backbone=body))
    assert "from s = 0 mm to 250 mm" in text
    assert not said(make_config(routing={"kind": "parallel", "offset": 0.0075}, backbone=body))


def test_of_several_tendons_the_one_is_named(make_config):
    tendons = [
        {"name": name, "friction_coefficient": 0.1, "routing": {"kind": "parallel", "offset": offset}}
        for name, offset in (("left", 0.010), ("right", -0.005))
    ]
    (text,) = said(make_config(backbone={"bores": BORES}, tendons=tendons))
    assert "tendons.right.routing" in text
