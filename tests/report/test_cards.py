"""What notebooks show of robots, simulations, fits, diagnoses and designs."""

import base64
import dataclasses
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from matplotlib.figure import Figure

import gtr_jax as gtr
from calibrate.report.cards import diagnosis_card, fit_card
from design.report.design import design_table
from gtr_jax.config.config import load_config
from gtr_jax.plots.straight import plot_straight
from gtr_jax.report import object_cards

ROOT = Path(__file__).parents[2]
HELIX, THREE = "examples/helix.toml", "examples/three-tendons.toml"
VOID = {"img", "br"}


class Whole(HTMLParser):
    """Every element that is opened is closed, and nothing is loaded from elsewhere."""

    def __init__(self):
        super().__init__()
        self.open, self.cells = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            assert name not in ("src", "href") or (value or "").startswith("data:")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.cells.append(data)


def shown(thing):
    html = thing._repr_html_()
    assert html is not None
    return html


def read(html):
    """The cells of the tables, once the card is known to be whole and to have its picture."""
    page = Whole()
    page.feed(html)
    assert not page.open
    (image,) = re.findall(r'src="data:image/png;base64,([^"]+)"', html)
    assert base64.b64decode(image).startswith(b"\x89PNG")
    return page.cells


def test_a_robot_shows_its_numbers_and_only_terms_that_act(make_robot):
    robot = make_robot(routing={"kind": "parallel", "offset": 0.01})
    cells = read(shown(robot))
    assert "mu" in cells and "tendon.friction_coefficient" in cells and "1.06 MPa" in cells
    assert not any("adhesion" in cell for cell in cells)
    cells = read(shown(robot.with_values(**{"adhesion.drag": 2.0})))
    assert "adhesion.drag" in cells and "stiffening.curvature" not in cells


@pytest.mark.parametrize("file", [HELIX, THREE])
def test_a_robot_file_shows_itself(file):
    config = load_config(file)
    html = shown(config)
    assert config.name in html and "in space" in html
    assert any(cell.startswith("mu") for cell in read(html))


def test_the_sides_of_a_body_hold_its_channels():
    robot = gtr.build_robot(load_config(HELIX))
    y, z = plot_straight(robot).axes
    lines = [next(line for line in ax.lines if np.size(line.get_xdata()) > 10) for ax in (y, z)]
    across = np.stack([np.asarray(line.get_ydata()) for line in lines])
    np.testing.assert_allclose(np.linalg.norm(across, axis=0), 8.0, rtol=1e-9)  # mm, from the axis
    assert "m1" in [text.get_text() for text in y.texts]


def test_a_simulation_shows_where_the_tip_goes_and_what_failed(make_robot):
    run = gtr.simulate(make_robot(routing={"kind": "parallel", "offset": 0.01}), np.array([0.0, 10.0, 5.0]))
    html = shown(run)
    cells = read(html)
    assert "3 load steps, all converged." in html and "10 N" in cells and "at the end" in cells
    failed = dataclasses.replace(run, result=_first_failed(run.result))
    assert "of which 1 did not converge" in shown(failed)


def _first_failed(result):
    bad = optx.RESULTS.nonlinear_max_steps_reached
    return jax.vmap(lambda first, r: optx.RESULTS.where(first, bad, r))(jnp.arange(3) == 0, result)


def test_nothing_is_drawn_while_jax_traces(make_robot):
    robot = make_robot(routing={"kind": "parallel", "offset": 0.01})
    seen = []

    def value(mu):
        seen.append(robot.with_values(mu=mu)._repr_html_())
        return mu

    jax.jit(value)(0.2)
    assert seen == [None]


def test_nothing_is_drawn_of_a_batch_or_of_a_part(make_robot):
    robot = make_robot(routing={"kind": "parallel", "offset": 0.01})
    run = gtr.simulate(robot, np.array([0.0, 10.0, 5.0]))
    many = jax.vmap(lambda mu: robot.with_values(mu=mu))(jnp.array([0.1, 0.2]))
    assert many._repr_html_() is None
    assert jax.tree_util.tree_map(lambda x: jnp.stack([x, x]), run)._repr_html_() is None
    assert eqx.partition(robot, eqx.is_array)[1]._repr_html_() is None
    for thing in (robot, run):
        assert eqx.filter_eval_shape(lambda thing=thing: thing)._repr_html_() is None


@pytest.mark.parametrize("space", [False, True])
def test_the_angle_of_the_tip_has_its_sign_in_the_plane_and_leaves_it_in_space(
    make_robot, monkeypatch, space
):
    drawn = []
    monkeypatch.setattr(object_cards, "plot_tendons", lambda *given: drawn.append(given) or Figure())
    angles = {"left": 0.5 * np.pi, "right": -0.5 * np.pi}
    tendons = [
        {
            "name": name,
            "friction_coefficient": 0.2,
            "routing": {"kind": "straight", "radius": 0.008, "angle": angle}
            if space
            else {"kind": "parallel", "offset": offset},
        }
        for (name, angle), offset in zip(angles.items(), (0.008, -0.008), strict=True)
    ]
    more = {"space": True, "backbone": {"outer_radius": 0.012, "poissons_ratio": 0.45}} if space else {}
    run = gtr.simulate(make_robot(tendons=tendons, **more), np.array([[0.0, 0.0], [0.0, 3.0], [2.0, 0.0]]))
    assert shown(run)
    ((_, _, angle, _),) = drawn
    if space:  # it leaves the plane of x and y, in which its projection does not turn
        assert np.all(angle[1:] > 0.1)
    else:
        np.testing.assert_array_equal(angle, np.asarray(run.tip_pose)[:, 2])
        assert angle[1] * angle[2] < 0


def test_a_fit_shows_its_loop_and_estimates(make_robot):
    estimate = SimpleNamespace(
        name="mu", value=0.3, sd=0.01, lower95=0.28, upper95=0.32, initial=0.2, unit="", note=""
    )
    T = np.linspace(0, 10, 12)
    tip = SimpleNamespace(simulated=0.8 * T, residual=np.full(12, 0.01))
    known = {"T_base": T, "band": 0.0 * T, "noise_N": 0.01, "phases": np.full(12, "pulling")}
    fitted = SimpleNamespace(name="r", robot=make_robot(), tips=[tip], channels={}, **known)
    fit = SimpleNamespace(
        estimates=[estimate], verdict="mu = 0.3 <so>.", warnings=[], converged=True, recordings=(fitted,)
    )
    html = fit_card(cast(Any, fit))
    assert "0.300 ± 0.010" in read(html) and "&lt;so&gt;" in html
    failed = SimpleNamespace(**{**vars(fit), "converged": False})
    assert "<img" not in fit_card(cast(Any, failed))


def test_a_diagnosis_shows_its_verdict_its_rivals_and_numbers():
    rivals = [
        SimpleNamespace(names=["presliding"], probability=0.7, delta=0.0),
        SimpleNamespace(names=[], probability=0.3, delta=1.7),
    ]
    change = SimpleNamespace(name="mu", unit="", before=0.3, after=0.24, sd=0.01, averaged95=(0.22, 0.26))
    answer = SimpleNamespace(
        verdict="missing-physics",
        says="Presliding <is> missing.",
        warnings=["Few samples."],
        rivals=rivals,
        parameters=[change],
        discovered=None,
        experiment=None,
        loops=[],
        named=["presliding"],
        confusion_set=[["presliding"]],
        pattern=None,
        strata=[],
    )
    html = diagnosis_card(cast(Any, answer))
    cells = read(html)
    assert "mu" in cells and "0.3" in cells and "0.240 ± 0.010" in cells and "0.220 to 0.260" in cells
    assert "Diagnosis: missing-physics" in html and "&lt;is&gt;" in html and "Few samples." in html
    bare = SimpleNamespace(**{**vars(answer), "rivals": rivals[:1], "parameters": []})
    html = diagnosis_card(cast(Any, bare))
    assert "<img" not in html and "<table" not in html


def test_a_design_lists_what_was_searched():
    variable = SimpleNamespace(name="r1", unit="m", lower=-0.01, upper=0.01)
    answer = SimpleNamespace(
        best=SimpleNamespace(values={"r1": 0.004}),
        tolerances=[],
        problem=SimpleNamespace(space=SimpleNamespace(all=[variable])),
    )
    table = design_table(cast(Any, answer))
    assert [tuple(row) for row in table.rows] == [("r1", "4 mm", "−10 mm … 10 mm")]


@pytest.mark.parametrize(
    "imports", ["import gtr_jax as gtr; Robot = gtr.Robot", "from gtr_jax.robot.robot import Robot"]
)
def test_what_draws_a_card_is_imported_when_a_notebook_asks(imports):
    code = (
        f"import sys; {imports}; from gtr_jax.robot.build import load_robot;"
        f"robot = load_robot('{HELIX}'); before = 'matplotlib' in sys.modules;"
        "html = robot._repr_html_(); print(isinstance(robot, Robot), before, 'A robot in space' in html)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == ["True", "False", "True"]


@pytest.mark.parametrize(
    ("kind", "card"),
    [
        ("calibrate.fitting.result.FitResult", "calibrate.report.cards"),
        ("calibrate.diagnosis.answer.result.Diagnosis", "calibrate.report.cards"),
        ("design.result.Design", "design.report.design"),
    ],
)
def test_the_door_of_a_package_brings_its_cards(kind, card):
    module, _, name = kind.rpartition(".")
    code = (
        "import contextlib, sys; from gtr_jax.notebook import as_card, card_of\n"
        f"from {module} import {name}\n"
        f"before = '{card}' in sys.modules\n"
        f"with contextlib.suppress(AttributeError): as_card({name}.__new__({name}))  # it has no numbers\n"
        f"print(before, card_of.dispatch({name}).__module__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split() == ["False", card]
