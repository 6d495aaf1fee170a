"""What every figure owes its reader: nothing is cut off."""

import numpy as np
import pytest

from calibrate.report.fit_figures import plot_time
from gtr_jax.simulation.phases import PULLING, RELEASING, REST, TRANSITION


@pytest.mark.parametrize("phases", [[PULLING], [PULLING, TRANSITION, RELEASING, REST]])
def test_a_legend_lies_within_the_figure(phases):
    t = np.arange(40.0)
    fig = plot_time(t, t, t, simulated=t, phases=np.repeat(phases, 40 // len(phases)))
    (legend,) = fig.legends
    fig.canvas.draw()
    box = legend.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= fig.bbox.width
    assert len(legend.get_texts()) == 2 + len(phases)
