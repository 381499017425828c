"""Bearings whose stated noise is smaller than any sensor's."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.consistency.bearings import MIN_SIGMA_RAD, SmallNoiseCheck
from occlog.records.tables import Bearings
from occlog.records.verdicts import findings


def bearings(sigma: float, u_px: float = np.nan) -> Bearings:
    of = {"t_ns": [0], "sensor": ["a"], "target_id": [0], "seen": [True], "score": [np.nan]}
    return Bearings.of(**of, bearing=[0.1], sigma=[sigma], u_px=[u_px], sigma_px=[np.nan])


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (bearings(1e-12), ["measurement-noise-small"]),
        (bearings(MIN_SIGMA_RAD), []),
        (bearings(1e-12, u_px=100.0), []),  # the reading's noise counts
    ],
)
def test_noise_that_no_sensor_has_is_reported(given: Bearings, expected: list[str]) -> None:
    sharp = SmallNoiseCheck()
    assert list(sharp.watch([given, given])) == [given, given]
    assert [f.id for f in findings(sharp.checks())] == expected
    assert all(
        f.text.startswith("2 bearings of a state standard deviations as small as 1e-12 rad")
        for f in findings(sharp.checks())
    )
