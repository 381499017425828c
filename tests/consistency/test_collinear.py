"""Bearings of a target on the line through its stations."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.consistency.bearings import AngleConventionCheck
from occlog.core.geometry.camera import wrap_angle
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.records.tables import Bearings

SCENE = scene_from_yaml(
    """occlog_scene: 1
length_unit: m
microphone_arrays:
- {name: s0, position: [0.5, 3.5, 1.5], yaw_deg: 0, planar: true, sigma_deg: 4}
- {name: s1, position: [8.5, 3.5, 1.5], yaw_deg: 180, planar: true, sigma_deg: 4}
""",
    "two arrays",
)
SIGMA = np.radians(4.0)


@pytest.mark.parametrize("seed", [0, 2, 5])
def test_lines_of_sight_along_one_line_are_no_other_convention(seed: int) -> None:
    """A walk 5 cm off the line through both stations: by noise alone, lines of sight meet behind them."""
    check, rng, T = AngleConventionCheck(SCENE), np.random.default_rng([seed, 22]), 60
    seconds, nothing = np.arange(T) * 0.2, np.full(T, np.nan)
    xy = np.column_stack([4.5 + (seconds - 6.0) * 0.4, np.full(T, 3.45)])
    parts = [
        Bearings.of(
            t_ns=np.rint(seconds * 1e9).astype(np.int64),
            sensor=np.full(T, a.name),
            target_id=np.zeros(T, dtype=np.int32),
            seen=np.ones(T, dtype=np.bool_),
            score=nothing,
            bearing=wrap_angle(np.arctan2(*(xy - a.position[:2]).T[::-1]) + SIGMA * rng.standard_normal(T)),
            sigma=np.full(T, SIGMA),
            u_px=nothing,
            sigma_px=nothing,
        )
        for a in SCENE.arrays
    ]
    list(check.watch([Bearings.merge(parts)]))
    assert not [c for c in check.checks() if c.found]
