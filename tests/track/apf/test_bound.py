"""How near the filter comes to the best one, and to the bounds: what `python -m benchmarks track_bound` measures."""

from __future__ import annotations

import pytest
from places import EXAMPLES

from benchmarks.track.track_bound import ratios
from occlog.io.formats.scenes.scene import read_scene
from occlog.track.methods.apf.config import ApfConfig

ROOM = EXAMPLES / "room100.yaml"


@pytest.mark.statistics
@pytest.mark.jit
def test_rmse_is_near_that_of_a_filter_with_the_true_dynamics():
    """The bound knows the displacement, so that no filter attains it; the true dynamics can be attained."""
    found = ratios(read_scene(ROOM), 0.095, ApfConfig(), seeds=2, steps=120)
    # Over 200 steps, correlated over about 5, the ratio is known to about 0.035: both have the same bearings
    assert 0.93 < found.to_true_dynamics < 1.14
    assert 1.0 < found.true_to_bound < 1.5
    # What comes after a step tells more than the displacement that the bound of filtering knows
    assert found.smoothed_to_bound < 1.0
    assert 1.0 < found.smoothed_to_own_bound < 1.6
