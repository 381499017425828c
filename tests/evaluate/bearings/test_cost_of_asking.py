from __future__ import annotations

import math

import numpy as np
import pytest

from occlog.evaluate.bearings.cost_of_asking import cooperation_figures
from occlog.records.tables import Cooperation, Tracks

NS = 1_000_000_000


def asked(*rows):
    """Rows (t [s], target, cause, frames, answered)."""
    t, target, cause, frames, answered = zip(*rows, strict=True)
    x = np.where(answered, 1.0, np.nan)
    return Cooperation.of(
        t_ns=[round(s * NS) for s in t],
        target_id=target,
        cause=cause,
        cameras=["a,b"] * len(t),
        frames=frames,
        answered=answered,
        x=x,
        y=x,
        cov_xx=x,
        cov_xy=0 * x,
        cov_yy=x,
    )


REQUESTS = asked(
    (1, 0, "spread", 2, True),
    (1, 1, "spread,count", 1, False),
    (1, 2, "shared", 0, True),
    (3, 0, "count", 2, True),
    (7, 1, "periodic", 2, True),
)


def test_requests_frames_and_causes_are_counted():
    found = cooperation_figures(REQUESTS)
    assert found["cooperation_requests"] == 4
    assert found["cooperation_answered"] == 3
    assert found["cooperation_shared"] == 1
    assert found["cooperation_frames"] == 7
    assert found["cooperation_requests_spread"] == 2
    assert found["cooperation_requests_count"] == 2
    assert found["cooperation_requests_periodic"] == 1
    assert found["cooperation_requests_ellipse"] == 0
    assert found["cooperation_period_s"] == pytest.approx(3.0)  # 6 s, two intervals


def test_the_period_is_that_of_the_tracks():
    n = np.full(2, 0.0)
    tracks = Tracks.of(t_ns=[0, 30 * NS], target_id=[0, 0], x=n, y=n, vx=n, vy=n, cov_xx=n, cov_xy=n, cov_yy=n)
    assert cooperation_figures(REQUESTS, tracks)["cooperation_period_s"] == pytest.approx(10.0)


def test_nothing_asked_is_no_period():
    found = cooperation_figures(Cooperation.empty())
    assert found["cooperation_requests"] == found["cooperation_frames"] == 0
    assert math.isnan(found["cooperation_period_s"])
