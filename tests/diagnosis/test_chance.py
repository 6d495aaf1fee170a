"""How large a misfit chance alone makes: limits that sound recordings exceed as seldom as they claim to."""

import numpy as np
import pytest

from calibrate.fitting.verdict import CHANCE, by_chance


@pytest.mark.parametrize(("degrees", "of_noise", "among"), [(40, 60, 1), (12, 20, 4), (300, 150, 7)])
def test_the_limit_is_exceeded_as_often_as_it_says(degrees, of_noise, among):
    random, times = np.random.default_rng(3), 200_000
    ratio = random.chisquare(degrees, (times, among)) / degrees
    ratio /= random.chisquare(of_noise, (times, among)) / of_noise  # the noise is itself estimated
    share = np.mean(ratio.max(axis=1) > by_chance(degrees, of_noise, among=among))
    assert abs(share - CHANCE) < 5 * np.sqrt(CHANCE / times)


def test_nothing_to_compare_with_says_nothing():
    assert by_chance(np.inf, 10.0, among=3) == 1.0
