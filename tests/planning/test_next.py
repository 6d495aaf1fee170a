"""What to measure next: closed forms of what an experiment is worth, and plans for what is open."""

import json
import shlex
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from calibrate.diagnosis.answer.earlier import settle
from calibrate.inference.number import Number
from calibrate.planning import open_files, open_folder, plan
from calibrate.planning.candidates import candidates
from calibrate.planning.disturbed import corners, disturbances, whitening
from calibrate.planning.model import OpenModel
from calibrate.planning.outcome import Trial, Weighed
from calibrate.planning.worth import apart, sd_after, separations, worth_of_narrowing
from gtr_jax.app.cli.next import rig_files
from gtr_jax.config.config import dump_config
from tests.command_line import RECORDED, RECORDING, run_gtr

SHEATH = {
    "length": 1.0,
    "outer_radius": 0.002,
    "natural_curvature": 1.2,
    "rigid": True,
    "youngs_modulus": None,
}
SHEATH |= {"density": None}


@pytest.fixture
def sheath(make_config, tmp_path):
    """Write the robot file of a rigid sheath with some terms, under a name."""

    def write(name, *terms, **loads):
        config = make_config(
            backbone=SHEATH, routing={"kind": "parallel", "offset": 0.0}, terms=list(terms), loads=loads
        )
        dump_config(config, tmp_path / f"{name}.toml")
        return tmp_path / f"{name}.toml"

    return write


def test_the_distance_left_is_that_of_a_least_squares_fit():
    rng = np.random.default_rng(0)
    a, b, J = rng.normal(size=30), rng.normal(size=30), rng.normal(size=(30, 3))
    root = rng.normal(size=(3, 3))
    stacked = np.concatenate([J, root])
    target = np.concatenate([a - b, np.zeros(3)])
    x, *_ = np.linalg.lstsq(stacked, target, rcond=None)
    left = np.linalg.norm(target - stacked @ x)
    assert apart(a, b, J, root.T @ root) == pytest.approx(left, rel=1e-10)
    # A model that can show what the other shows is at no distance, unless its numbers are known.
    assert apart(b + J @ np.array([1.0, 2.0, 3.0]), b, J, np.zeros((3, 3))) == pytest.approx(0.0, abs=1e-6)
    assert apart(b + J[:, 0], b, J, 1e12 * np.eye(3)) == pytest.approx(np.linalg.norm(J[:, 0]), rel=1e-6)


def model(information, name="one", probability=1.0):
    """A model of two numbers, 2.0 and 5.0, in steps of 0.1 and 0.5."""
    numbers = tuple(
        Number(name=key, unit="", centre=value, sd=step, log=False)
        for key, value, step in (("mu", 2.0, 0.1), ("E", 5.0, 0.5))
    )
    nothing = cast(Any, None)
    told = np.asarray(information, float)
    return OpenModel(name, f"{name}.toml", probability, nothing, nothing, numbers, told, np.ones(2, bool))


def test_intervals_narrow_as_information_adds_up():
    open_ = model([[4.0, 0.0], [0.0, 1.0]])
    np.testing.assert_allclose(open_.sd, [0.05, 0.5])
    slopes = np.array([[np.sqrt(12.0), 0.0]] + 3 * [[0.0, 1.0]])
    np.testing.assert_allclose(sd_after(open_, slopes), [0.025, 0.25])
    both, of_first = np.array([True, True]), np.array([True, False])
    for each in (True, False):
        worth = worth_of_narrowing(open_, slopes, both, each=each, effort=0.0)
        assert worth == pytest.approx(np.log(2))
        assert worth_of_narrowing(open_, slopes, of_first, each=each, effort=0.5) < worth
    # One combination of two numbers that trade off is not known: to read it narrows both intervals, and the
    # volume by half as much for each of them.
    traded = model([[100.0, -99.9], [-99.9, 100.0]])
    along = np.array([[3.0, 3.0]])
    volume = worth_of_narrowing(traded, along, both, each=False, effort=0.0)
    assert volume == pytest.approx(0.25 * np.log(18.1 / 0.1), rel=1e-6)
    assert 2 * volume == pytest.approx(
        worth_of_narrowing(traded, along, both, each=True, effort=0.0), rel=0.05
    )
    across = np.array([[3.0, -3.0]])
    assert worth_of_narrowing(traded, across, both, each=False, effort=0.0) < 0.1 * volume


def test_separations_take_the_model_that_follows_better():
    free, held = model(np.zeros((2, 2)) + 1e-9 * np.eye(2)), model(1e9 * np.eye(2), name="two")
    J = np.eye(4)[:, :2]
    a, b = np.array([1.0, 1.0, 0.0, 2.0]), np.zeros(4)
    found = separations(
        [held.information, free.information], [Weighed(rows, J, lambda rows: rows) for rows in (a, b)]
    )
    np.testing.assert_allclose(found, [[0.0, 2.0], [2.0, 0.0]], atol=1e-6)


def test_the_catalogue_keeps_to_the_limits_of_the_rig(sheath):
    opened = open_files([sheath("one")], largest=30.0, noise=0.02)
    every = candidates(opened, largest=12.0, longest=45.0)
    histories = [c for c in every if c.weight is None]
    assert len(every) - len(histories) == 2 and len({c.name for c in histories}) == 10
    for c in every:
        assert np.all(np.diff(c.time) > 0) and c.time[-1] <= 45.0 + 1e-9, c.name
        assert c.drive.min() >= 0 and c.drive.max() <= 12.0 + 1e-9, c.name
        assert np.isclose(c.drive.max(), 12.0) or "low" in c.name or "nothing" in c.name, c.name
    # Of a rigid sheath only tensions can be read, and no weight bends it.
    assert {*histories[0].sd} == {"T_tip"} and not any(c.added or c.done for c in histories)


def test_gains_of_the_cells_are_told_apart_by_known_weights_alone(sheath):
    # T_tip = gain T_base exp(-+ mu theta), whichever of the cells the gain is of.
    files = [
        sheath("tip", {"kind": "tip-gain", "gain": 1.05}),
        sheath("base", {"kind": "base-gain", "gain": 1 / 1.05}),
    ]
    opened = open_files(files, largest=20.0, noise=0.02)
    found = plan(opened)
    assert found.verdict == "settles" and found.chosen is not None and found.chosen.weight is not None
    assert found.says.startswith("Take the tendon off and hang known weights")
    histories = [r for r in found.ranked if r.candidate.weight is None]
    assert max(r.separation[0, 1] for r in histories) < 0.1
    # Without them nothing tells, and the plan says so.
    stays = plan(opened, as_it_is=True)
    assert stays.verdict == "settles-nothing" and stays.chosen is None
    assert "No experiment of the catalogue tells tip and base apart" in stays.says


def test_friction_that_wears_is_told_from_friction_that_drifts_by_cycles_at_another_rate(sheath):
    files = [
        sheath("wears", {"kind": "wear", "rate": 0.02}),
        sheath("drifts", {"kind": "friction-drift", "rate": "0.001 1/s"}),
    ]
    found = plan(open_files(files, largest=20.0, noise=0.02), as_it_is=True)
    assert found.verdict == "settles" and found.ranked[0].confirmed and found.ranked[0].least > 3
    # One pull and one release at one rate cannot tell cycles from time.
    loop = next(r for r in found.ranked if r.candidate.name.startswith("one slow loop"))
    assert loop.least < found.ranked[0].least
    # A model that is refitted is nearer to the other than before.
    left = found.expected.after[1] - found.expected.after[0]
    plain = found.expected.rows[1] - found.expected.rows[0]
    assert 0 < np.sum(left**2) < np.sum(plain**2)


@pytest.mark.slow
def test_a_fit_is_planned_for_by_what_it_knows(tmp_path, capsys):
    fitted = run_gtr(capsys, "fit", RECORDED, RECORDING, "-o", tmp_path / "fit")
    assert fitted.status == 0, fitted.err
    answer = json.loads((tmp_path / "fit" / "fit.json").read_text())
    outcome = run_gtr(capsys, "next", tmp_path / "fit", "-o", tmp_path / "next", "--max-tension", "30N")
    assert outcome.status == 0, outcome.err
    assert outcome.out.startswith("narrows: Drive ") and "NEW.csv" in outcome.out and "gtr fit" in outcome.out
    told = json.loads((tmp_path / "next" / "next.json").read_text())
    # What is known before is what the fit says is known.
    numbers = told["models"][0]["numbers"]
    for name, own in answer["parameters"].items():
        assert numbers[name]["sd"] == pytest.approx(own["sd"], rel=0.02), name
        assert told["chosen"]["sd_after"][name] < own["sd"]
    history = np.genfromtxt(tmp_path / "next" / "next-experiment.csv", delimiter=",", names=True)
    assert history["T_base_N"].max() == pytest.approx(30.0) and np.all(np.diff(history["time_s"]) > 0)
    gtr.read_recording(tmp_path / "next" / "next-experiment.csv", need_tip=False)
    for name in ("report.html", "expected.png", "next-experiment.png", "run.json"):
        assert (tmp_path / "next" / name).stat().st_size > 100, name
    # A number by itself.
    one = run_gtr(capsys, "next", tmp_path / "fit", "-o", tmp_path / "one", "--for", "mu", "--as-it-is")
    assert one.status == 0 and json.loads((tmp_path / "one" / "next.json").read_text())[
        "numbers_to_narrow"
    ] == ["mu"]


def test_a_rig_that_is_changed_has_robot_files_that_say_so(make_config, tmp_path):
    config = make_config(loads={"gravity_angle": "-90 deg"}, terms=[{"kind": "tip-load", "y": -0.02}])
    dump_config(config, tmp_path / "pulled.toml")
    opened = open_files([tmp_path / "pulled.toml"], largest=8.0, noise=0.2)
    every = [c for c in candidates(opened) if c.done and c.weight is None]
    assert len({c.done for c in every}) == 2 and not any(c.joins for c in every)
    weighed = next(c for c in every if "hung" in c.done)
    (name, found), *more = rig_files(cast(Any, SimpleNamespace(chosen=weighed, opened=opened))).items()
    assert name == "next-pulled.toml" and not more
    hung = float(weighed.done.split()[3])
    assert found.term_values["tip-load"]["y"] == pytest.approx(-0.02 - hung)
    assert found.with_values({"terms.tip-load.y": -0.02}).numbers() == config.numbers()
    turned = next(c for c in every if "turned" in c.done)
    found = rig_files(cast(Any, SimpleNamespace(chosen=turned, opened=opened)))[name]
    assert found.term_values["tip-load"] == {"x": pytest.approx(-0.02), "y": pytest.approx(0.0), "z": 0.0}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["."], "holds neither diagnosis.json nor fit.json"),
        ([".", "robot.toml"], "is a folder; give one run folder, or robot files"),
        (["robot.toml"], "--max-tension: robot files do not say how far the rig may pull"),
        (["robot.toml", "--max-tension", "0"], "--max-tension: must be above 0"),
        (
            ["robot.toml", "--max-tension", "20N", "--for", "muu"],
            "--for: no free number 'muu'; did you mean 'mu'",
        ),
        (["robot.toml", "other.toml", "--max-tension", "20N", "--for", "mu"], "which of 2 models is right"),
        ([".", "--noise", "0.1N"], "leave it out"),
        (["robot.toml", "absent.toml", "--max-tension", "20N"], "absent.toml: no such folder or file"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_line(
    sheath, tmp_path, capsys, monkeypatch, arguments, says
):
    monkeypatch.chdir(tmp_path)
    sheath("robot")
    sheath("other", {"kind": "tip-gain", "gain": 1.05})
    outcome = run_gtr(capsys, "next", *arguments, "-o", "out")
    assert outcome.status == 2 and outcome.err.startswith("error: ") and outcome.err.count("\n") == 1
    assert says in outcome.err, outcome.err
    assert not (tmp_path / "out").exists()


def test_folders_that_leave_nothing_to_plan_with(tmp_path):
    (tmp_path / "diagnosis.json").write_text('{"verdict": "unexplained", "robot_files": []}')
    with pytest.raises(gtr.InputError, match="the verdict is 'unexplained', and no model is left"):
        open_folder(tmp_path)
    (tmp_path / "diagnosis.json").write_text('{"verdict": "adequate"}')
    with pytest.raises(gtr.InputError, match="has no 'robot_files', which gtr next needs; run the command"):
        open_folder(tmp_path)
    (tmp_path / "diagnosis.json").write_text("[1")
    with pytest.raises(gtr.InputError, match="cannot be read"):
        open_folder(tmp_path)


@pytest.mark.parametrize(
    ("named", "confusion", "says"),
    [
        (["wear"], [["wear"]], "is settled: it is wear."),
        ([], [["wear"], ["presliding"]], "is still open: wear or presliding."),
        ([], [["presliding"], ["contact"]], "wear is ruled out; presliding is still open."),
        (["contact"], [["contact"]], "is ruled out altogether: the answer is now contact."),
        ([], [], "is ruled out altogether: the answer is now 'adequate'."),
    ],
)
def test_what_became_of_the_rivals_of_an_earlier_diagnosis(named, confusion, says):
    rivals = [
        SimpleNamespace(names=("wear",), probability=0.9, delta=10.0),
        SimpleNamespace(names=("presliding.gradual",), probability=0.1, delta=6.0),
    ]
    answer = SimpleNamespace(named=named, confusion_set=confusion, rivals=rivals, verdict="adequate")
    found = settle("out", [(("wear",), 0.5), (("presliding",), 0.4)], cast(Any, answer))
    assert found.says.endswith(says)
    assert [r.behind for r in found.rivals] == pytest.approx([0.0, 8.0])
    assert [r.after for r in found.rivals] == [0.9, 0.1]


def test_disturbances_that_many_readings_share_are_whitened():
    rng = np.random.default_rng(1)
    D, v = rng.normal(size=(20, 3)), rng.normal(size=20)
    covariance = np.eye(20) + D @ D.T
    white = whitening(D)
    assert np.sum(white(v) ** 2) == pytest.approx(v @ np.linalg.solve(covariance, v), rel=1e-10)
    np.testing.assert_allclose(white(white(covariance)), np.eye(20), atol=1e-9)
    np.testing.assert_array_equal(whitening(np.zeros((20, 0)))(v), v)


def test_an_error_of_the_base_tension_stays_where_friction_holds_the_tip(sheath):
    # Tip at half the base tension while pulling, held on the way back: the error of the peak is what is left.
    opened = open_files([sheath("one")], largest=10.0, noise=0.02)
    own = next(c for c in candidates(opened) if c.name.startswith("one slow loop"))
    drive = own.drive[:, 0]
    peak = int(np.argmax(drive))
    tip = np.where(np.arange(len(drive)) <= peak, 0.5 * drive, 0.5 * drive.max())
    part = Trial(opened.models[0], own, ("T_tip",), 0.1).part
    (found,) = disturbances(own, part, ("T_tip",), tip[None], 0.1)
    assert corners(own.time, drive).tolist() == [0, peak, len(drive) - 1] and found.shape == (len(drive), 3)
    sd = np.sqrt(np.sum(found**2, axis=1))
    np.testing.assert_allclose(sd[peak:], sd[peak])
    # Straight lines through readings: at the corner in the middle 0.1 N over the root of their information.
    K = len(drive)
    hats = np.stack([np.interp(np.arange(K), [0, peak, K - 1], unit) for unit in np.eye(3)], axis=1)
    assert sd[peak] == pytest.approx(0.5 * 0.1 * np.sqrt(np.linalg.inv(hats.T @ hats)[1, 1]), rel=1e-6)
    assert sd.max() < 0.05


def recorded(robot, T, time, path, seed):
    """Write what both cells would record of a load history, with noise; and return the path."""
    rng = np.random.default_rng(seed)
    T, time = jnp.asarray(T), jnp.asarray(time)
    noise = rng.normal(size=(2, len(T))) * np.array([[0.01], [0.02]])
    T_tip = np.asarray(gtr.simulate(robot, T, time=time).T_tip)
    gtr.write_recording(path, {"time": time, "T_base": np.asarray(T) + noise[0], "T_tip": T_tip + noise[1]})
    return path


@pytest.mark.slow
def test_the_experiment_that_is_proposed_settles_what_the_diagnosis_left_open(sheath, tmp_path, capsys):
    # At one rate, friction that changes with every cycle changes with time as well: which, no one can tell.
    robot = sheath("robot")
    truth = gtr.load_robot(sheath("truth", {"kind": "wear", "rate": 0.03}))
    T = np.concatenate([np.linspace(1.0, 20.0, 31), np.linspace(20.0, 1.0, 31)[1:]] * 2)
    old = recorded(truth, T, 0.5 * np.arange(len(T)), tmp_path / "old.csv", seed=1)
    first, second = tmp_path / "first", tmp_path / "second"
    before = run_gtr(capsys, "diagnose", robot, old, "-o", first)
    assert before.out.startswith("ambiguous"), before.out
    sets = json.loads((first / "diagnosis.json").read_text())["confusion_set"]
    assert sorted(sets) == [["friction-drift"], ["wear"]]
    planned = run_gtr(capsys, "next", first, "-o", tmp_path / "next")
    assert planned.out.startswith("settles: Drive ") and f"NEW.csv --settles {first}" in planned.out
    history = np.genfromtxt(tmp_path / "next" / "next-experiment.csv", delimiter=",", names=True)
    new = recorded(truth, history["T_base_N"], history["time_s"], tmp_path / "new.csv", seed=2)
    after = run_gtr(capsys, "diagnose", robot, old, new, "--settles", first, "-o", second)
    assert after.out.startswith("missing-physics: Missing: wear"), after.out
    assert f"What {first} left open" in after.out and "is settled: it is wear." in after.out
    told = json.loads((second / "diagnosis.json").read_text())["settles"]
    assert {r["terms"][0]: r["status"] for r in told["rivals"]} == {
        "wear": "named",
        "friction-drift": "ruled out",
    }
    assert {r["terms"][0] for r in told["rivals"] if r["after"] > 0.01} == {"wear"}
    assert "What these recordings settle" in (second / "report.html").read_text()
    # A diagnosis that leaves nothing open has nothing to settle.
    refused = run_gtr(capsys, "diagnose", robot, new, "--settles", second, "-o", tmp_path / "third")
    assert refused.status == 2 and "left no rivals (its verdict is 'missing-physics')" in refused.err


@pytest.mark.slow
def test_an_interval_narrows_as_the_plan_says(sheath, tmp_path, capsys):
    robot, first, second = sheath("robot"), tmp_path / "first", tmp_path / "second"
    truth = gtr.load_robot(robot)
    T = np.concatenate([np.linspace(1.0, 20.0, 31), np.linspace(20.0, 1.0, 31)[1:]])
    old = recorded(truth, T, 0.5 * np.arange(len(T)), tmp_path / "old.csv", seed=3)
    assert run_gtr(capsys, "fit", robot, old, "-o", first).status == 0
    planned = run_gtr(capsys, "next", first, "-o", tmp_path / "next", "--max-tension", "40N")
    assert planned.out.startswith("narrows: "), planned.err
    told = json.loads((tmp_path / "next" / "next.json").read_text())
    history = np.genfromtxt(tmp_path / "next" / "next-experiment.csv", delimiter=",", names=True)
    new = recorded(truth, history["T_base_N"], history["time_s"], tmp_path / "new.csv", seed=4)
    assert run_gtr(capsys, "fit", robot, old, new, "-o", second).status == 0
    came = json.loads((second / "fit.json").read_text())["parameters"]["mu"]["sd"]
    before = told["models"][0]["numbers"]["mu"]["sd"]
    assert came == pytest.approx(told["chosen"]["sd_after"]["mu"], rel=0.3) and came < 0.7 * before


@pytest.mark.parametrize(
    ("given", "each"),
    [
        ("--columns 'T_base=data_0[gf],T_tip=data_1[gf]'", ["T_base=data_0[gf],T_tip=data_1[gf]"] * 2),
        ("--columns=a.toml --columns b.toml", ["a.toml", "b.toml"]),
        ("", []),
    ],
)
def test_the_command_at_the_end_maps_each_recording_as_it_is(given, each, tmp_path):
    """The mapping of the recordings so far does not fit the columns that the new one is asked for."""

    from gtr_jax.app.cli.next import again
    from gtr_jax.recordings.formats.quantities import QUATERNION, column_of
    from gtr_jax.recordings.recording import read_recording

    opened: Any = SimpleNamespace(
        command=f"gtr fit robot.toml one.csv two.csv {given} --free mu -o out --force",
        recordings=("one.csv", "two.csv"),
        rivals=False,
    )
    names = ["time", "T_base", "T_tip", "tip_x", "tip_y", "tip_z", *QUATERNION]
    wanted = {name: column_of(name).header for name in names}
    words = shlex.split(again(opened, wanted))
    assert words[:6] == ["gtr", "fit", "robot.toml", "one.csv", "two.csv", "NEW.csv"]
    assert words[6:8] == ["--free", "mu"] and words[-2:] == ["-o", "OUT"]
    mappings = words[9:-2:2]
    if not each:
        assert mappings == []
        return
    assert words[8:-2:2] == ["--columns"] * 3 and mappings[:2] == each
    path = tmp_path / "NEW.csv"
    rows = [",".join(wanted.values()), *(f"{i},1,0.5,0.1,0.2,0.3,1,0,0,0" for i in range(9))]
    path.write_text("\n".join(rows) + "\n")
    recording = read_recording(path, mappings[2], space=True)
    assert recording.T_base[0] == 1.0 and recording.time is not None and recording.time[-1] == 8.0
