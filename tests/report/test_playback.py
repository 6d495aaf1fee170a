"""The histories that reports play: what stands in the page."""

import json
import re

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.plots.style import PHASE_COLOUR
from gtr_jax.report.motion import kept_steps
from gtr_jax.report.page import Report, render
from gtr_jax.report.playback import kept_samples
from gtr_jax.report.simulation_answer import LONG, _at_rest
from tests.histories import SETTINGS, made_up


def test_columns_hold_the_history_to_the_digits_shown():
    data = made_up(301, first=150).data
    by_label = {column["label"]: np.array(column["values"], float) for column in data["columns"]}
    assert data["of"] == 301 and data["numbers"] == list(range(1, 302)) and data["first"] == 150
    np.testing.assert_allclose(by_label["T_base"][150], 40.0, rtol=1e-12)
    np.testing.assert_allclose(by_label["T_tip"], 0.7 * by_label["T_base"], rtol=1e-4, atol=1e-9)
    assert np.isnan(by_label["gap"][260]) and np.isfinite(by_label["gap"][240])
    loop, tensions, rest = data["charts"]
    assert not loop["clock"] and tensions["clock"] and rest["clock"]
    x = data["columns"][tensions["lines"][0]["x"]]
    assert (x["label"], x["unit"]) == ("time", "s") and data["columns"][data["clock"]] is x
    (phases,) = data["phases"]
    names = [phases["names"][int(digit)] for digit in phases["of"]]
    assert names[10] == "pulling" and names[150] == "rest" and names[-1] == "releasing"
    assert phases["colours"] == [PHASE_COLOUR[name] for name in phases["names"]]


def test_a_long_history_keeps_its_peaks_and_says_how_many_samples_it_shows():
    base = np.abs(np.sin(np.linspace(0, 40 * np.pi, 50_000)))
    base[31_234] = 3.0  # a lone peak
    other = np.full(50_000, np.nan)
    other[:40_000] = np.cos(np.linspace(0, 7, 40_000))
    other[11_111] = -5.0
    kept = kept_samples([base, other], 2000)
    assert 1500 < len(kept) <= 2002 and kept[0] == 0 and kept[-1] == 49_999
    assert {11_111, 31_234} <= set(kept.tolist())
    assert np.all(np.diff(kept) > 0)
    long = made_up(50_000, first=12_345)
    assert len(long.data["numbers"]) <= 4003 and long.data["numbers"][long.data["first"]] == 12_346
    assert f"{len(long.data['numbers']):,} of 50,000 samples are shown." in long.caption
    assert "samples are shown" not in made_up(2000).caption


def test_bodies_are_kept_where_they_move():
    share = np.concatenate([np.zeros(500), np.linspace(0, 1, 100), np.ones(400), np.linspace(1, 0, 1000)])
    along = np.linspace(0, 0.2, 30)
    position = np.stack([share[:, None] * along, 0 * share[:, None] * along], axis=-1)
    tension = share[:, None, None] * np.ones((1, 1, 30))
    kept = kept_steps(position, tension, 777, 100)
    assert {0, 777, 1999} <= set(kept.tolist()) and len(kept) <= 102
    between = np.diff(share[kept])
    assert np.max(np.abs(between)) < 2 / 98 + 1 / 99, (
        "no step is farther from the next than a share and a sample"
    )
    assert np.sum((kept > 0) & (kept < 499)) <= 1 and np.sum((kept > 620) & (kept < 980)) <= 2
    assert kept_steps(position[:50], tension[:50], 0, 100).tolist() == list(range(50))


def test_a_page_with_a_history_keeps_its_pictures_and_loads_nothing():
    played = made_up(20, stills=["loop"])
    html = render(Report(title="t", verdict="v", playbacks=[played]), SETTINGS, None)
    assert "http://" not in html and "https://" not in html and "</script>" in html
    (embedded,) = re.findall(r'<script type="application/json">(.*?)</script>', html)
    assert json.loads(embedded) == json.loads(json.dumps(played.data))
    assert Report(title="t", verdict="v", playbacks=[played]).stills == {"loop"}


@pytest.mark.parametrize(
    "term", [{"viscous-friction.coefficient": 20.0}, {"viscoelastic-body.ratio": 0.2}, {}], ids=str
)
def test_a_robot_at_rest_has_slack_tendons_and_has_crept_to_the_end(make_robot, term):
    """Though it was strung, and its history is fast."""
    robot = make_robot(0.3, tendon={"preload": 5.0}).with_values(**term)
    rest = _at_rest(robot, jnp.linspace(0.0, 20.0, 6), 1e-3 * np.arange(6.0))
    wanted = gtr.equilibrium(robot, 0.0)
    assert bool(rest.converged) and float(rest.T_tip) == 0.0
    np.testing.assert_allclose(rest.angle, wanted.angle, atol=1e-9)
    for steps in (1, LONG + 1):
        other = _at_rest(robot, jnp.ones(steps), np.arange(1.0 * steps))
        np.testing.assert_allclose(other.angle, wanted.angle, atol=1e-9)
