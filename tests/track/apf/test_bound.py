"""How near the filter comes to the posterior Cramer-Rao bound: what `python -m benchmarks track_bound` measures."""

from __future__ import annotations

from dataclasses import replace

import pytest
from places import EXAMPLES

from benchmarks.track.track_bound import ratio_of
from occlog.io.scenes.scene import read_scene
from occlog.track.apf.config import ApfConfig

ROOM = EXAMPLES / "room100.yaml"


@pytest.mark.slow
@pytest.mark.jit
@pytest.mark.parametrize(("pillar", "redirect", "limit"), [(True, 0.0, 1.3), (False, 0.0, 1.3), (True, 0.095, 1.37)])
def test_rmse_is_near_the_bound_averaged_over_ten_seeds(pillar, redirect, limit):
    """The bound knows the displacement; with a new destination every ten steps no filter can stay within 1.3."""
    scene = read_scene(ROOM)
    scene = scene if pillar else replace(scene, occluders=())
    ratio = ratio_of(scene, redirect, ApfConfig(), seeds=10, steps=150)
    # Over 1300 steps, correlated over about 5, the ratio is known to about 0.03.
    assert 1.0 < ratio < limit
