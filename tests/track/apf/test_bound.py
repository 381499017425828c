"""How near the filter comes to the best one, and to the bounds: what `python -m benchmarks track_bound` measures."""

from __future__ import annotations

from dataclasses import replace

import pytest
from places import EXAMPLES

from benchmarks.track.track_bound import ratios
from occlog.io.scenes.scene import read_scene
from occlog.track.apf.config import ApfConfig

ROOM = EXAMPLES / "room100.yaml"


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize("pillar", [True, False])
def test_rmse_is_near_that_of_a_filter_with_the_true_dynamics(pillar):
    """The bound knows the displacement, so that no filter attains it; the true dynamics can be attained."""
    scene = read_scene(ROOM)
    scene = scene if pillar else replace(scene, occluders=())
    found = ratios(scene, 0.095, ApfConfig(), seeds=6, steps=120)
    # Over 600 steps, correlated over about 5, the ratio is known to about 0.02: both have the same bearings
    assert 0.96 < found.to_true_dynamics < 1.1
    assert 1.0 < found.true_to_bound < 1.5
    # What comes after a step tells more than the displacement that the bound of filtering knows
    assert found.smoothed_to_bound < 1.0
    assert 1.0 < found.smoothed_to_own_bound < 1.6
