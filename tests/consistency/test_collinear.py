"""Bearings of a target on the line through its stations."""

from __future__ import annotations

import numpy as np

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


def test_lines_of_sight_along_one_line_are_no_other_convention() -> None:
    check = AngleConventionCheck(SCENE)
    rng, T = np.random.default_rng(3), 60
    t_ns, nothing = np.arange(T, dtype=np.int64) * 200_000_000, np.full(T, np.nan)
    parts = [
        Bearings.of(
            t_ns=t_ns,
            sensor=np.full(T, name),
            target_id=np.zeros(T, dtype=np.int32),
            seen=np.ones(T, dtype=np.bool_),
            score=nothing,
            bearing=wrap_angle(toward + SIGMA * rng.standard_normal(T)),
            sigma=np.full(T, SIGMA),
            u_px=nothing,
            sigma_px=nothing,
        )
        for name, toward in (("s0", 0.0), ("s1", -3.1))
    ]
    list(check.watch([Bearings.merge(parts)]))
    assert not [c for c in check.checks() if c.found]
