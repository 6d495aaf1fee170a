"""A robot for MuJoCo: the chain settles where the simulator's body does, to second order in the links."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from command_line import run_gtr
from scipy.spatial.transform import Rotation

import gtr_jax as gtr
from benchmarks.mujoco_export import HANGING, Model, errors, robot
from gtr_jax.errors import InputError
from gtr_jax.export.chain import chain_of
from gtr_jax.export.mjcf import left_out, mjcf, shares_left
from tests.conftest import PARALLEL

FREE = {"tendon": {"friction_coefficient": 0.0}, "routing": PARALLEL}


def arc(kappa, end, length=0.25):
    """Tip, along and across, of a body bent to an arc up to an arc length, and straight beyond [m]."""
    turn, rest = kappa * end, length - end
    return np.array(
        [np.sin(turn) / kappa + rest * np.cos(turn), (1 - np.cos(turn)) / kappa + rest * np.sin(turn)]
    )


def test_a_pull_bends_the_chain_to_an_arc_to_second_order(make_config):
    """Of the curvature T R/EI (docs/mechanics.md), and a moment at the tip of M/EI more."""
    pytest.importorskip("mujoco")
    config = make_config(**FREE, backbone={"outer_radius": 0.012}, loads={"tip_moment": 0.01})
    EI = 1.06e6 * np.pi * 0.012**4 / 4
    off = []
    for links in (20, 40):
        tip = Model(mjcf(config, links=links)).settle([8.0])
        off.append(np.linalg.norm(tip[:2] - arc((8.0 * 0.008 + 0.01) / EI, 0.25)))
    assert off[1] < 1e-3
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.1)


def test_tendons_in_space_bend_the_chain_towards_them(make_config):
    """One anchored at 150 mm, its arc in the plane that it is in, seen from a base that is turned."""
    pytest.importorskip("mujoco")
    turned = Rotation.from_rotvec([0.2, -0.4, 0.7])
    tendons = [
        {
            "name": name,
            "friction_coefficient": 0.0,
            "routing": {"kind": "straight", "radius": 0.008, "angle": angle},
            "to": 0.15,
        }
        for name, angle in (("a", 0.4), ("b", 2.5))
    ]
    base = {"position": [0.1, 0.2, 0.3], "rotation": turned.as_rotvec().tolist()}
    config = make_config(tendons=tendons, backbone={"outer_radius": 0.012}, base=base)
    EI = 1.06e6 * np.pi * 0.012**4 / 4
    off = []
    for links in (15, 30):
        tip = Model(mjcf(config, links=links)).settle([0.0, 6.0])
        along, across = arc(6.0 * 0.008 / EI, 0.15)
        wanted = [along, across * np.cos(2.5), across * np.sin(2.5)]
        off.append(np.linalg.norm(tip - [0.1, 0.2, 0.3] - turned.apply(wanted)))
    assert off[1] < 5e-4
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.15)


@pytest.mark.slow
def test_the_chain_settles_as_the_body_of_the_simulator():
    pytest.importorskip("mujoco")
    for config, pull, links in (
        (robot("tdcm-1", friction=0.0), 10.0, (10, 20)),
        (robot("helix", friction=0.0, loads=HANGING), 6.0, (8, 16)),
    ):
        coarse, fine = (errors(config, [pull], count)[0] for count in links)
        assert fine < 3e-3
        assert coarse / fine == pytest.approx(4.0, rel=0.15)


@pytest.mark.slow
def test_a_body_that_stretches_bent_at_rest_with_a_payload(make_config):
    pytest.importorskip("mujoco")
    config = make_config(
        **FREE,
        backbone={"extensible": True, "natural_curvature": 3.0, "outer_radius": 0.012},
        loads={"gravity_angle": -1.2, "payload": 0.01, "tip_moment": 0.002},
        space=True,
    )
    assert errors(config, [2.0], 24)[0] < 2e-3


@pytest.mark.slow
def test_a_tendon_that_is_guided_by_disks(make_config):
    pytest.importorskip("mujoco")
    tendon = {"friction_coefficient": 0.0, "guides": [0.05, 0.1, 0.15, 0.2, 0.25]}
    config = make_config(tendon=tendon, routing={"kind": "straight", "radius": 0.008, "angle": 2.0})
    assert errors(config, [4.0], 50)[0] < 1e-3


def test_the_chain_weighs_what_the_body_weighs(make_robot):
    """A frustum's volume, its first moment and its inertia about the base, but for what is fixed to that."""
    body = make_robot(routing=PARALLEL)
    chain = chain_of(body, 40)
    L, (R, r) = 0.25, (0.02, 0.013)
    s = np.linspace(0.0, L, 200001)
    dm = 1070.0 * np.pi * (R + (r - R) * s / L) ** 2
    free = s >= 0.5 * L / 40
    mass = np.trapezoid(np.where(free, dm, 0.0), s)
    assert sum(link.mass for link in chain.links) == pytest.approx(mass, rel=1e-4)
    first = sum(link.mass * (link.start + link.centre[0]) for link in chain.links)
    assert first == pytest.approx(np.trapezoid(np.where(free, s * dm, 0.0), s), rel=1e-4)
    radius = R + (r - R) * s / L
    second = np.trapezoid(np.where(free, dm * (s**2 + radius**2 / 4), 0.0), s)
    about = sum(link.inertia[2, 2] + link.mass * (link.start + link.centre[0]) ** 2 for link in chain.links)
    assert about == pytest.approx(second, rel=1e-4)
    EI = 1.06e6 * np.pi / 4 * np.mean(radius[: 200001 // 40] ** -4.0) ** -1
    assert chain.links[0].stiffness[0] == pytest.approx(EI * 40 / L, rel=1e-4)


@pytest.mark.parametrize(
    ("section", "area", "about_y", "about_z"),
    [
        ({"kind": "rectangle", "height": 0.4e-3, "width": 10e-3}, 4e-6, 1e-10 / 3, 1.6e-13 / 3),
        (
            {"kind": "tube", "outer_diameter": 2e-3, "inner_diameter": 1e-3},
            np.pi * 0.75e-6,
            np.pi / 4 * 0.9375e-12,
            np.pi / 4 * 0.9375e-12,
        ),
    ],
    ids=["strip", "tube"],
)
def test_a_link_turns_by_the_section_that_carries_the_load(section, area, about_y, about_z, make_robot):
    """Its mass and its moments of inertia are those of a box or a tube, not of the envelope around it."""
    body = {"length": 0.2, "outer_radius": 8e-3, "density": 7800.0, "section": section}
    link = chain_of(make_robot(backbone=body, routing={"kind": "parallel", "offset": 5e-3}), 40).links[20]
    h = 0.2 / 40
    mass = 7800.0 * area * h
    along = mass * h**2 / 12
    wanted = [7800.0 * h * (about_y + about_z), 7800.0 * h * about_y + along, 7800.0 * h * about_z + along]
    assert link.mass == pytest.approx(mass)
    np.testing.assert_allclose(link.inertia, np.diag(wanted), rtol=1e-3, atol=1e-20)


def test_it_comes_to_rest_where_its_forces_balance(make_config):
    """By MuJoCo's own time steps, from the keyframe."""
    pytest.importorskip("mujoco")
    model = Model(mjcf(make_config(**FREE), links=12))
    moved = model.move(6.0, 1.0), model.move(6.0, 2.0)
    still = model.settle([6.0])
    assert np.linalg.norm(moved[1] - still) < 1e-6 < np.linalg.norm(moved[0] - moved[1])


def test_no_marker_has_the_name_of_another_site(make_config):
    """Whatever a marker is called: names of sites are one list in MuJoCo."""
    markers = [{"name": name, "at": 0.1} for name in ("world", "tendon_3", "base", "link_0", "rest")]
    text = mjcf(make_config(markers=markers, loads={"tip_force": [0.0, 0.1]}), links=4)
    names = [site.attrib["name"] for site in ET.fromstring(text).iter("site") if "name" in site.attrib]
    assert len(names) == len(set(names)) and {"world", "tendon_3"} < set(names)
    routings = ({"kind": "parallel", "offset": offset} for offset in (8e-3, -8e-3))
    tendons = [
        {"name": name, "friction_coefficient": 0.0, "routing": routing}
        for name, routing in zip(("tip_load", "other"), routings, strict=True)
    ]
    mjcf(make_config(tendons=tendons), links=4)
    with pytest.raises(InputError, match=r"tendons\.tip_load: .*rename it"):
        mjcf(make_config(tendons=tendons, loads={"tip_force": [0.0, 0.1]}), links=4)
    pytest.importorskip("mujoco")
    Model(text)


def test_friction_is_the_share_of_the_mean_tension(make_config):
    """Of a parallel tendon T = T_b/(1 + mu R T_b s/EI) (docs/mechanics.md)."""
    config = make_config(routing=PARALLEL, backbone={"outer_radius": 0.015})
    a = 0.3 * 0.008 * 10.0 * 0.25 / (1.06e6 * np.pi * 0.015**4 / 4)
    share = np.log1p(a) / a
    assert shares_left(gtr.build_robot(config), 10.0)[0] == pytest.approx(share, rel=1e-3)
    root = ET.fromstring(mjcf(config, links=4, friction_at=10.0))
    motor = root.find("actuator/motor")
    assert motor is not None and float(motor.attrib["gear"]) == pytest.approx(-share, rel=1e-3)


def test_what_is_left_out_is_said(make_config, capsys, tmp_path):
    terms = [{"kind": "presliding", "length": 1e-3}, {"kind": "tip-load", "x": 0.1}]
    config = make_config(routing=PARALLEL, terms=terms)
    assert left_out(config) == ["friction", "presliding"]
    assert left_out(config, friction_at=5.0)[0].startswith("friction's course")
    from gtr_jax.config.config import dump_config

    dump_config(config, tmp_path / "robot.toml")
    done = run_gtr(capsys, "export", tmp_path / "robot.toml", "-o", tmp_path / "robot.xml", "--links", "4")
    assert done.status == 0, done.err
    assert "left out" in done.out and "friction, presliding" in done.out
    root = ET.fromstring((tmp_path / "robot.xml").read_text())
    assert len(root.findall(".//joint")) == 4 and len(root.findall(".//tendon/spatial/site")) == 5
    load = root.find("actuator/motor[@name='tip_load']")
    assert load is not None and float(load.attrib["gear"].split()[0]) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"backbone": {"density": None}}, "backbone.density: MuJoCo needs masses"),
        ({"backbone": {"rigid": True, "natural_curvature": 1.0, "youngs_modulus": None}}, "backbone.rigid"),
    ],
)
def test_what_mujoco_cannot_move_is_refused(sections, says, make_config):
    with pytest.raises(InputError, match=says):
        mjcf(make_config(**sections))
