"""The verdict, from stated quantities alone."""

import dataclasses

import pytest

from calibrate.diagnosis.decision.verdict import Quantities, verdict

# One effect that explains nearly all, and no rival.
CLEAR = Quantities(
    effects=1,
    missing=0.999,
    drop=500.0,
    least_drop=36.0,
    left=(0.1, 0.5),
    base_left=(2.0, 50.0),
    may_stay=0.55,
    holds=0.99,
    rivals=1,
)
QUIET, LOUD = (0.1, 0.5), (1.5, 40.0)


@pytest.mark.parametrize(
    ("changes", "name", "shows_base"),
    [
        ({}, "missing-physics", False),
        ({"holds": 0.79}, "ambiguous", False),
        ({"rivals": 2}, "ambiguous", False),
        # Nothing is claimed that is not sure, or that gains little.
        ({"missing": 0.96, "base_left": QUIET}, "adequate", True),
        ({"drop": 35.0, "base_left": QUIET}, "adequate", True),
        ({"effects": 0, "base_left": QUIET}, "adequate", True),
        ({"missing": 0.96}, "unexplained", True),
        ({"missing": 0.96, "base_left": QUIET, "regular": True}, "unexplained", True),
        # What stays beside an effect speaks against it; not without significance, nor a small share.
        ({"left": LOUD}, "unexplained", False),
        ({"left": (1.5, 1.0)}, "missing-physics", False),
        ({"left": (1.5, 1.0), "regular": True}, "unexplained", False),
        ({"left": (1.0, 40.0)}, "missing-physics", False),
        ({"regular": True}, "missing-physics", False),
        # Effects that pay on unseen samples explain a part where structure is left, else all.
        ({"pays": True, "left": (1.0, 40.0)}, "partly-explained", False),
        ({"pays": True, "left": LOUD}, "unexplained", False),
        ({"pays": True, "left": LOUD, "may_stay": 0.8}, "partly-explained", False),
        ({"pays": True, "left": (1.0, 40.0), "missing": 0.9}, "unexplained", False),
        ({"pays": True}, "missing-physics", False),
        ({"pays": True, "rivals": 3}, "ambiguous", False),
        ({"law": True}, "discovered", False),
        # What differs between recordings is told where nothing else is missing.
        ({"differ": True, "missing": 0.5, "base_left": QUIET}, "recordings-differ", True),
        ({"differ": True}, "missing-physics", False),
        # What acts from outside is missing as well.
        ({"outside": True}, "partly-explained", False),
        ({"outside": True, "rivals": 2}, "partly-explained", False),
        ({"outside": True, "missing": 0.5, "base_left": QUIET}, "unexplained", True),
        ({"outside": True, "differ": True, "missing": 0.5, "base_left": QUIET}, "unexplained", True),
        ({"outside": True, "law": True}, "discovered", False),
    ],
)
def test_quantities_decide_the_verdict(changes, name, shows_base):
    found = verdict(dataclasses.replace(CLEAR, **changes))
    assert (found.name, found.shows_base) == (name, shows_base)
    assert found.reason


def test_a_verdict_says_why():
    assert "stands out" in verdict(CLEAR).reason
    assert "regularity" in verdict(dataclasses.replace(CLEAR, missing=0.1, regular=True)).reason
    assert "unseen" in verdict(dataclasses.replace(CLEAR, law=True)).reason
