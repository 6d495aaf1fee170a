"""What would tell numbers apart is said only where it does: no experiment that the model calls useless."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from calibrate.fitting import identifiability
from calibrate.fitting.identifiability import remedy, singular
from calibrate.planning import open_files, plan
from gtr_jax.config.config import dump_config
from tests.rigs import recording

SHEATH: Any = {"length": 1.0, "outer_radius": 0.002, "natural_curvature": 2.0, "rigid": True}
SHEATH |= {"youngs_modulus": None, "density": None}
ROUTING = {"kind": "parallel", "offset": 0.0}
NAMES = ("mu", "tip-gain.gain", "friction-asymmetry.ratio")
# Rates of change of ln(T_tip/T_base), pulling and releasing, by the logarithms of the numbers.
PULLING, RELEASING = np.array([-0.4, 1.0, 0.0]), np.array([0.4, 1.0, 0.4])


def told(monkeypatch, more):
    """What is said where a measurement with this information is offered beside both ratios."""
    monkeypatch.setattr(identifiability, "_measurements", lambda *_: iter([("a pull", more)]))
    known = 1e6 * (np.outer(PULLING, PULLING) + np.outer(RELEASING, RELEASING))
    assert singular(known) and not singular(known + np.eye(3))
    at: Any = SimpleNamespace(log=np.ones(3, bool), reference=np.ones(3))
    setup: Any = SimpleNamespace(parts=(None,), names=list(NAMES))
    return remedy(setup, [at], np.zeros(3), known, [0.02], [0, 1, 2])


def test_a_measurement_is_named_if_each_number_is_known_with_it(monkeypatch):
    third = np.array([1.0, 0.0, 0.0])
    assert told(monkeypatch, 1e4 * np.outer(third, third)).startswith(
        "a pull would tell them apart (mu to 1 %"
    )
    # More of the same, an effect of the size of rounding, and one that leaves a factor of three open.
    assert told(monkeypatch, 1e8 * np.outer(PULLING, PULLING)) == ""
    assert told(monkeypatch, 1e-9 * np.outer(third, third)) == ""
    assert told(monkeypatch, 1e-1 * np.outer(third, third)) == ""


@pytest.mark.slow
def test_a_plan_does_not_narrow_what_acts_alike(make_config, tmp_path):
    # Over a wide step a plan's readings cross kinks, and seem to tell three numbers from two ratios.
    terms = [{"kind": "tip-gain", "gain": 1.001}, {"kind": "friction-asymmetry", "ratio": 1.001}]
    config = make_config(backbone=SHEATH, routing=ROUTING, terms=terms, loads={})
    dump_config(config, tmp_path / "sheath.toml")
    found = plan(open_files([tmp_path / "sheath.toml"], largest=15.0, noise=0.02), as_it_is=True)
    sd = dict(zip([n.name for n in found.opened.models[0].numbers], found.ranked[0].sd, strict=True))
    assert sd.keys() == set(NAMES) and found.ranked[0].confirmed
    for name, value in (("tip-gain.gain", 1.0), ("friction-asymmetry.ratio", 1.0)):
        assert sd[name] > 0.1 * value  # neither is known, whatever the load history


@pytest.mark.slow
def test_no_pull_tells_three_numbers_from_two_ratios(make_config):
    config = make_config(backbone=SHEATH, routing=ROUTING)
    loop = np.concatenate([np.linspace(0.5, 15, 24), np.linspace(15, 0.5, 24)[1:]])
    run = gtr.simulate(gtr.build_robot(config), loop)
    T_tip = np.asarray(run.T_tip) + 0.02 * np.random.default_rng(0).standard_normal(len(loop))
    fit = calibrate.fit(config, recording({"T_base": loop, "T_tip": T_tip}), free=NAMES)
    assert not fit.converged and "only in combination" in fit.verdict
    assert "would tell" not in fit.verdict
    assert "a larger pull would not tell them apart" in fit.verdict
