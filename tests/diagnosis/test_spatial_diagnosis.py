"""Diagnoses of robots in space, and of robots with several tendons."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run_gtr

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.hypotheses.hypotheses import base_numbers, catalogue
from calibrate.diagnosis.outside.sanity import faults
from calibrate.fitting.fit import part_of
from calibrate.inference.channels import CHANNELS
from calibrate.inference.instruments import instruments, leading
from calibrate.inference.load_history import padded_history
from calibrate.inference.predictor import shown
from calibrate.inference.samples import some_samples
from calibrate.inference.simulated_readings import SimulatedReadings
from calibrate.inference.simulated_rig import SimulatedRig, program_for, programs_of
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_with

HELIX = {"kind": "helix", "radius": 0.008, "turns": 0.9, "start_angle": 0.7}
SOFT = {"outer_radius": [0.012, 0.012], "youngs_modulus": 1.2e6, "poissons_ratio": 0.4, "density": 0.0}
ARM = {"routing": HELIX, "backbone": SOFT, "space": True}
K = 48
WAY = np.linspace(0.0, 3.4 * np.pi, K)
PULLED, CLOCK = 0.3 + 2.8 * (1 - np.cos(WAY)), 0.5 * np.arange(K)


def tendons(routings, **more):
    return [
        {"name": name, "friction_coefficient": 0.25, "preload": 0.5, "routing": routing, **more}
        for name, routing in routings.items()
    ]


def three(**more):
    angles = dict(zip("abc", (0.0, 2.1, 4.2), strict=True))
    routings = {n: {"kind": "straight", "radius": 0.008, "angle": a} for n, a in angles.items()}
    return {"backbone": SOFT, "tendons": tendons(routings, **more), "space": True}


def pair():
    sides = {"left": 0.01, "right": -0.01}
    return {"tendons": tendons({n: {"kind": "parallel", "offset": r} for n, r in sides.items()})}


def pulls(n):
    """Base tensions of n tendons, pulled one after the other [N], (K, n)."""
    return 0.5 + 1.5 * (1 - np.cos(WAY[:, None] - 2 * np.pi * np.arange(n) / n))


def recording(robot, T_base, path, *, noise=0.01, displacement=None, seed=3):
    """What noisy instruments read of a robot."""
    run = gtr.simulate(robot, T_base, time=CLOCK, displacement=displacement)
    assert run.converged.all()
    rng = np.random.default_rng(seed)

    def read(values, sd):
        return np.asarray(values) + sd * rng.normal(size=np.shape(values))

    columns = {
        "time": CLOCK,
        "T_base": read(run.reading.T_base, noise),
        "T_tip": read(run.reading.T_tip, noise),
        "displacement": read(run.displacement, 1e-5 if displacement is None else 1e-6),
    }
    axes = "xyz" if robot.space else "xy"
    place = read(run.tip_position, 1e-4)
    columns |= {f"tip_{axis}": place[:, i] for i, axis in enumerate(axes)}
    gtr.write_recording(path, columns, tendons=robot.tendon_names)
    return gtr.read_recording(path, space=True, tendons=robot.tendon_names)


@pytest.mark.parametrize(
    "name",
    ["helix", "three", *(pytest.param(name, marks=pytest.mark.slow) for name in ("drawn", "anchored"))],
)
def test_native_steps_in_space_are_the_traced_ones(make_robot, name):
    T, drawn = PULLED[:14], None
    if name in ("helix", "anchored"):
        more = {"tendon": {"to": 0.19}} if name == "anchored" else {"base": {"rotation": [0.1, 0.4, 0.0]}}
        robot = make_robot(0.35, **ARM, **more)
    else:
        drive = {"drive": "displacement", "axial_stiffness": 4e3} if name == "drawn" else {}
        robot, T = make_robot(0.35, **three(**drive)), pulls(3)[:14]
    if name == "drawn":
        drawn = 1e-3 * np.stack([1 - np.cos(0.4 * np.arange(14) + k) for k in range(3)], axis=1)
    how = gtr.SolverOptions(atol=1e-11)
    traced = gtr.simulate(robot, T, displacement=drawn, solver=how)
    ways = T if drawn is None else drawn
    loads = loads_of(jnp.asarray(T), jnp.arange(14.0), None)
    given = None if drawn is None else jnp.asarray(drawn)
    found = steps_natively(robot, structure_with(robot, ()), loads, how, given)
    assert np.ptp(ways) > 0 and found.converged.all() and found.shape is not None
    rtol, atol = (1e-10, 1e-12) if drawn is None else (1e-7, 1e-8)
    for quantity in ("T_base", "T_tip", "displacement", "tip_pose", "slip_front", "slip_direction"):
        np.testing.assert_allclose(getattr(found, quantity), getattr(traced, quantity), rtol=rtol, atol=atol)
    np.testing.assert_allclose(found.shape.position[:, -1], traced.tip_position, rtol=rtol, atol=atol)
    np.testing.assert_allclose(found.shape.rotation[:, -1], traced.tip_rotation, rtol=rtol, atol=atol)


class TestRig:
    def test_it_shows_what_a_fit_compares(self, make_config, tmp_path):
        marker = {"name": "m1", "at": 0.125, "offset": [0.0, 0.0, 0.012]}
        config = make_config(**ARM, markers=[marker])
        robot = gtr.build_robot(config, resolution=0.35)
        run = gtr.simulate(robot, PULLED, time=CLOCK)
        history = padded_history(PULLED, CLOCK, None)
        names = ("T_tip", "tip_x", "tip_y", "tip_z", "displacement", "m1_x", "m1_y", "m1_z")
        want = np.asarray(shown(robot, history, names)[0])[:, :K]
        table = dict(zip(names, want, strict=True))
        columns = {"T_base": PULLED, "time": CLOCK} | {n: v for n, v in table.items() if n[0] != "m"}
        path = tmp_path / "r.csv"
        gtr.write_recording(path, columns | {f"{n}_m": v for n, v in table.items() if n[0] == "m"})
        given = gtr.read_recording(path, space=True, markers=("m1",))
        part, _ = part_of("r", robot, config, given, None, noise_base_N=0.0)
        assert set(part.channels) == set(names) and run.converged.all()
        rig = SimulatedRig(part, robot)
        seen = rig({})
        assert seen is not None and rig.channels == names
        np.testing.assert_allclose(seen.values[rig.where], part.recorded, atol=1e-9)
        again = SimulatedReadings.of(seen.flat(), K)
        assert again is not None and again.slips.shape == (K,)
        np.testing.assert_array_equal(again.values, seen.values)

    def test_of_several_tendons_it_shows_each(self, make_config, tmp_path):
        config = make_config(**three())
        robot = gtr.build_robot(config, resolution=0.35)
        part, _ = part_of("r", robot, config, recording(robot, pulls(3), tmp_path / "r.csv"), None)
        rig = SimulatedRig(part, robot)
        seen = rig({"mu.b": 0.4, "crosstalk.share": 0.02})
        other = robot.with_values(**{"mu.b": 0.4, "crosstalk.share": 0.02})
        assert seen is not None and seen.slips.shape == seen.direction.shape == (K, 3)
        want = np.asarray(shown(other, padded_history(part.drive, CLOCK, None), rig.channels)[0])[:, :K]
        np.testing.assert_allclose(seen.values, want, rtol=1e-7, atol=1e-8)
        again = SimulatedReadings.of(seen.flat(), K)
        assert again is not None
        np.testing.assert_array_equal(again.slips, seen.slips)
        shifted = rig({}, (0.0, 0.1, 0.0))
        plain = rig({})
        assert shifted is not None and plain is not None
        assert np.mean(shifted.values[1] - plain.values[1]) > 10 * abs(
            np.mean((shifted.values - plain.values)[0])
        )

    @pytest.mark.slow
    def test_a_pair_in_one_plane_obeys_the_law_of_the_robot_without_terms(self, make_config, tmp_path):
        config = make_config(**pair())
        robot = gtr.build_robot(config, resolution=0.35)
        part, _ = part_of("r", robot, config, recording(robot, pulls(2), tmp_path / "r.csv"), None)
        rig = SimulatedRig(part, robot)
        seen = rig({})
        assert seen is not None and () not in programs_of(robot)
        want = np.asarray(shown(robot, padded_history(part.drive, CLOCK, None), rig.channels)[0])[:, :K]
        np.testing.assert_allclose(seen.values, want, atol=1e-9)


def test_what_is_compared(make_robot):
    assert instruments(make_robot(), ("T_tip",)) == CHANNELS
    names = instruments(make_robot(**three()), ("T_tip.a", "tip_rotation_x"))
    assert names[:6] == ("T_tip.a", "T_tip.b", "T_tip.c", "tip_x", "tip_y", "tip_z")
    assert names[6:] == ("displacement.a", "displacement.b", "displacement.c", "tip_rotation_x")
    drawn = make_robot(**three(drive="displacement"))
    assert instruments(drawn, ())[6:] == ("T_base.a", "T_base.b", "T_base.c")


def test_hypotheses_are_those_that_have_a_law_in_space(make_robot):
    given = {"timed": True, "largest_tip": 5.0, "bend": 5.0, "displaced": True}
    travel = np.array([[0.25, 0.0, 0.0], [0.2, -0.03, 0.04]])
    one = {h.name: h for h in catalogue(make_robot(**ARM), travel=travel, **given)}
    assert {n.name for n in one["tip-load"].numbers} == {"tip-load.x", "tip-load.y", "tip-load.z"}
    fixed = one["contact"].fixed
    angle, elevation = fixed["contact.angle"], fixed["contact.elevation"]
    way = [np.cos(elevation) * np.cos(angle), np.cos(elevation) * np.sin(angle), np.sin(elevation)]
    np.testing.assert_allclose(way, [0.0, -0.6, 0.8], atol=1e-12)
    several = {h.kind for h in catalogue(make_robot(**three()), travel=travel, **given)}
    assert {h.kind for h in one.values()} - several == {"contact", "viscoelastic-body"}
    numbers = [n.name for n in base_numbers(make_robot(**three()), {})]
    assert numbers == ["mu.a", "mu.b", "mu.c", "E"]
    robot = make_robot(**ARM)
    assert program_for(robot, ("tip-load",)) == ("tip-load", "gravity-error")
    assert set(program_for(robot, ("presliding", "tip-load"))) >= {"presliding", "tip-load"}


def test_samples_and_sanity_of_several_tendons(make_config, tmp_path):
    config = make_config(**pair())
    robot = gtr.build_robot(config, resolution=0.35)
    T = pulls(2)
    T[:, 1] = 1.0  # held
    read = recording(robot, T, tmp_path / "r.csv", noise=0.0)
    part, _ = part_of("r", robot, config, read, None, noise_base_N=0.0)
    assert faults(part) == [] and leading(part) == 0
    kept = some_samples(part, 20)
    assert kept[0] == 0 and kept[-1] == K - 1 and len(kept) < K
    assert np.any(np.abs(kept - np.argmax(T[:, 0])) <= 1)
    silent = part.recorded.copy()
    silent[0] = 1.0
    (said,) = faults(dataclasses.replace(part, recorded=silent))
    assert "the tip tension of left never changes" in said


def test_a_rigid_sheath_of_several_tendons_is_refused(make_config, tmp_path):
    body = {"rigid": True, "natural_curvature": 4.0, "youngs_modulus": None}
    config = make_config(backbone=body, **pair())
    read = gtr.Recording(
        T_base=pulls(2), T_tip=0.8 * pulls(2), path=tmp_path / "r.csv", sha256="", tendons=("left", "right")
    )
    with pytest.raises(gtr.InputError, match=r"rigid sheath of 2 tendons, which act by themselves"):
        calibrate.diagnose(config, read)


@pytest.mark.slow
def test_a_sound_helix_is_adequate_and_an_effect_in_space_is_named(make_config, tmp_path, capsys):
    config = make_config(**ARM)
    true = {"mu": 0.21, "E": 1.13e6}
    sound = recording(
        gtr.build_robot(config, resolution=1.37).with_values(**true), PULLED, tmp_path / "s.csv"
    )
    found = calibrate.diagnose(config, sound)
    assert found.verdict == "adequate", found.says
    after = {c.name: c for c in found.parameters}
    for name, value in true.items():
        sd = after[name].sd
        assert sd is not None and after[name].after == pytest.approx(value, abs=4 * sd)
    hidden = gtr.build_robot(config, resolution=1.37).with_values(**true, **{"tip-load.z": 0.1})
    recording(hidden, PULLED, tmp_path / "h.csv")
    gtr.dump_config(config, tmp_path / "robot.toml")
    done = run_gtr(capsys, "diagnose", tmp_path / "robot.toml", tmp_path / "h.csv", "-o", tmp_path / "out")
    assert done.status == 0, done.err
    answer = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert answer["named"] == ["tip-load"], answer["says"]
    assert answer["parameters"]["tip-load.z"]["value"] == pytest.approx(0.1, abs=0.01)
    assert answer["parameters"]["tip-load.z"]["unit"] == "N"
    assert answer["where"] and {w["unit"] for w in answer["where"]} <= {"N", "m", "rad"}


@pytest.mark.slow
def test_an_effect_on_a_pair_of_tendons_is_in_the_set(make_config, tmp_path, capsys):
    config = make_config(**pair())
    true = {"mu.left": 0.21, "mu.right": 0.28, "E": 1.0e6, "crosstalk.share": 0.03}
    recording(gtr.build_robot(config, resolution=1.37).with_values(**true), pulls(2), tmp_path / "p.csv")
    gtr.dump_config(config, tmp_path / "robot.toml")
    done = run_gtr(capsys, "diagnose", tmp_path / "robot.toml", tmp_path / "p.csv", "-o", tmp_path / "out")
    assert done.status == 0, done.err
    answer = json.loads((tmp_path / "out/diagnosis.json").read_text())
    # Each tendon carries about as much as the other: a gain of either cell does nearly the same.
    told = [answer["named"], *answer["confusion_set"]]
    assert answer["verdict"] in ("missing-physics", "ambiguous") and ["crosstalk"] in told, answer["says"]
    header = (tmp_path / "out/diagnosis.csv").read_text().splitlines()[0]
    assert "T_base_N.left" in header and "T_tip_after_N.right" in header and "phase.right" in header
    assert {w.get("tendon") for w in answer["where"]} <= {"left", "right"}
    assert any(part["part"].startswith("right, pulling") for part in answer["friction_by_part"])
    assert (tmp_path / "out/loop-left.png").exists() and (tmp_path / "out/residual-right.png").exists()
