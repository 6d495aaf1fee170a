"""Random robots in space through closed loops; the whole census is `python -m benchmarks.space_census`."""

import numpy as np
import pytest

from benchmarks import space_census
from benchmarks.space_census import (
    GIVES_BACK,
    MIRRORS,
    SEED,
    counted,
    draw,
    examined,
    mirrored,
    read_table,
    robots,
    table,
)


@pytest.mark.slow
@pytest.mark.parametrize(("tendons", "loaded"), [(1, False), (1, True), (3, False)])
def test_random_robots_settle_lose_energy_and_mirror(tendons, loaded):
    seen = examined(draw(SEED, 0, tendons, loaded))
    assert seen.finite.all() and not seen.unsettled.any()
    assert np.all((seen.gained < GIVES_BACK) | (seen.back > 1e-2))
    assert seen.tension.max() < MIRRORS and seen.place.max() < MIRRORS


def test_a_mirror_image_of_a_mirror_image_is_the_robot():
    d = draw(SEED, 3, 4, True)
    other = mirrored(d.values)
    assert {"turns", "angle.c", "plane_angle.d", "knot_z_0.b", "gravity_z", "natural_twist"} - set(other) == {
        "turns"
    }
    flipped = {name for name, v in d.values.items() if np.any(other[name] != v)}
    assert {"turns.a", "angle.c", "plane_angle.d", "knot_z_0.b", "gravity_z"} <= flipped
    assert not flipped & {"knot_y_0.b", "gravity_y", "natural_curvature", "radius.a", "E"}
    assert all(np.array_equal(mirrored(other)[name], v) for name, v in d.values.items())


@pytest.mark.parametrize(("ahead", "gives"), [(-1, True), (1, False)])
def test_the_census_sees_energy_made_from_nothing(monkeypatch, ahead, gives):
    """A displacement that goes before its tension gives energy back at every loop; one behind it takes it."""

    def run(values, T_base):
        nothing = np.zeros(T_base.shape)
        return (
            T_base,
            1e-3 * np.roll(T_base, ahead, axis=1),
            np.zeros((*T_base.shape, 3)),
            np.ones(T_base.shape, bool),
            nothing,
        )

    monkeypatch.setattr(space_census, "program", lambda tendons, loaded: run)
    d = draw(SEED, 0, 1, False)
    total = counted(d, examined(d))
    assert total[1, False, "robots"] == 50
    assert total[1, False, "energy given back"] == (50 if gives else 0)
    assert "| all | | 50 |" in table(total)
    assert read_table(table(total)) == total and robots(total) == 50
