"""White noise from third differences: one estimate for all that need it."""

import numpy as np
import pytest

from gtr_jax.inspection.noise import noise
from gtr_jax.recordings.signals import noise as of_readings
from gtr_jax.recordings.signals.differences import MAD_TO_SD, from_differences, third_differences


def test_third_differences_cancel_what_is_smooth():
    k = np.arange(50.0)
    np.testing.assert_allclose(third_differences(3 - 2 * k + 0.5 * k**2), 0, atol=1e-11)
    assert third_differences(k**3)[7] == pytest.approx(6 / np.sqrt(20))
    assert third_differences(np.zeros((4, 9))).shape == (4, 6)


def test_the_noise_of_a_signal_with_turns_and_glitches():
    rng = np.random.default_rng(0)
    t = np.arange(20_000)
    x = 5 * np.abs((t / 400) % 2 - 1) + 0.02 * rng.standard_normal(len(t))
    assert from_differences(x) == pytest.approx(0.02, rel=0.03)
    assert np.std(third_differences(0.02 * rng.standard_normal(20_000))) == pytest.approx(0.02, rel=0.03)
    x[::500] += 40
    assert from_differences(x) == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize("K", range(4))
def test_the_noise_of_few_samples_is_none(K):
    assert from_differences(np.arange(float(K))) == 0


def test_all_that_estimate_noise_agree():
    x = 3 + 0.1 * np.random.default_rng(1).standard_normal(400)
    by_hand = MAD_TO_SD * np.median(np.abs(np.diff(x, 3))) / np.sqrt(20)
    assert from_differences(x) == pytest.approx(by_hand, rel=1e-12)
    assert of_readings.from_differences(x) == pytest.approx(by_hand, rel=1e-12)
    assert noise(x, []).white_N == pytest.approx(by_hand, rel=1e-12)
