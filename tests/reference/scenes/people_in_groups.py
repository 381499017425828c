"""Tracks of people who walk, as groups of cameras could have made them."""

from __future__ import annotations

import numpy as np

from occlog.array_types import NS, Floats
from occlog.records.tables import PeopleTracks


def walk(
    identity: int,
    times: Floats,
    start: tuple[float, float],
    velocity: tuple[float, float],
    *,
    sd: float = 0.1,
    camera: str = "cam1",
    velocities: bool = True,
) -> PeopleTracks:
    """A person who walks straight on, at times in seconds."""
    n, unknown = len(times), np.nan if not velocities else 0.0
    return PeopleTracks.of(
        t_ns=np.rint(times * NS).astype(np.int64),
        target_id=np.full(n, identity, dtype=np.int32),
        x=start[0] + velocity[0] * times,
        y=start[1] + velocity[1] * times,
        vx=np.full(n, velocity[0] + unknown),
        vy=np.full(n, velocity[1] + unknown),
        cov_xx=np.full(n, sd**2),
        cov_xy=np.zeros(n),
        cov_yy=np.full(n, sd**2),
        **{name: np.full(n, unknown) for name in ("cov_x_vx", "cov_x_vy", "cov_y_vx", "cov_y_vy", "cov_vx_vy")},
        **{name: np.full(n, 0.04 + unknown) for name in ("cov_vx_vx", "cov_vy_vy")},
        existence_probability=np.full(n, 0.9),
        height=np.full(n, 1.7),
        width=np.full(n, 0.5),
        sd_height=np.full(n, sd),
        sd_width=np.full(n, sd),
        seen_by=np.full(n, camera),
    )
