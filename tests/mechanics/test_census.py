"""Random robots with physics terms through closed loops: what physics demands of every one of them.

The whole census, of 2,200, is `python -m benchmarks.census`; `docs/mechanics.md` has its counts.
"""

import pytest

from benchmarks.census import SEED, allowed, census, changes_with_time, draw

COUNT = 250
UNSETTLED = {141, 233}  # presliding under a load: the only robots whose steps may be flagged,
MOST_UNSETTLED = 6  # and no more of them
MOST_AGAINST = 0.05  # largest step of the tip tension against the base's, over the largest base tension
SHEATHS = ("parallel", "cross")  # rigid ones in the test, to compile fewer programs


@pytest.fixture(scope="module")
def outcomes():
    drawn = (draw(SEED, i) for i in range(COUNT))
    return list(census(d for d in drawn if not d.rigid or d.kind in SHEATHS))


@pytest.mark.slow
def test_what_settles_is_finite_and_what_does_not_is_flagged(outcomes):
    assert all(o.seen.finite for o in outcomes)
    unsettled = {o.drawn.index: o.seen.unsettled for o in outcomes if o.seen.unsettled}
    assert unsettled.keys() <= UNSETTLED and sum(unsettled.values()) <= MOST_UNSETTLED, unsettled


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", ["tip tension against the base's", "energy given back", "tip tension above the base's"]
)
def test_physics_is_kept_or_a_law_says_why(outcomes, kind):
    unexplained = [o for o in outcomes if allowed(*o).get(kind) == ""]
    assert not unexplained, unexplained
    settled = [o for o in outcomes if not o.seen.unsettled]
    assert len(settled) > 200
    # Of robots on which time does not act, hardly any is excused; on the others it acts little.
    lasting = [o for o in settled if not changes_with_time(o.drawn)]
    assert sum(not allowed(*o) for o in lasting) > 0.95 * len(lasting)
    assert max(o.seen.against for o in settled) < MOST_AGAINST


def test_the_census_sees_energy_made_from_nothing():
    """A sound run, and the same one with its displacement turned round."""
    import dataclasses

    import jax.numpy as jnp

    from benchmarks.census import examined, simulated

    d = next(d for d in (draw(SEED, i) for i in range(COUNT)) if d.kind == "parallel" and not d.rigid)
    d = d._replace(terms=("adhesion",), values={k: v for k, v in d.values.items() if "." not in k})
    d = d._replace(values=d.values | {"adhesion.drag": 1.0})
    robot, run = simulated(d)
    assert not allowed(d, examined(d, robot, run))
    backwards = dataclasses.replace(run, displacement=jnp.max(run.displacement) - run.displacement)
    assert examined(d, robot, backwards).gained < -1e-2
    tip = run.T_tip.at[20].add(0.1 * d.T_base.max())
    assert allowed(d, examined(d, robot, dataclasses.replace(run, T_tip=tip)))
