"""Bearings whose stated noise is smaller than any sensor's."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.consistency.bearings import MIN_SIGMA_RAD, StatedNoiseCheck
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
    sharp = StatedNoiseCheck()
    assert list(sharp.watch([given, given])) == [given, given]
    assert [f.id for f in findings(sharp.checks())] == expected
    assert all(
        f.text.startswith("2 bearings of a state standard deviations as small as 1e-12 rad")
        for f in findings(sharp.checks())
    )


def walk(sigma: float, scatter: float) -> Bearings:
    """Bearings of a source that passes, ten a second, with errors of a scatter [rad]."""
    n, rng = 200, np.random.default_rng(1)
    bearing = 0.01 * np.arange(n) + rng.normal(0.0, scatter, n)
    blank = np.full(n, np.nan)
    return Bearings.of(
        t_ns=np.arange(n) * 100_000_000,
        sensor=["a"] * n,
        target_id=np.zeros(n, dtype=int),
        seen=[True] * n,
        score=blank,
        bearing=bearing,
        sigma=np.full(n, sigma),
        u_px=blank,
        sigma_px=blank,
    )


@pytest.mark.parametrize("scatter_deg", [1.0, 3.0, 5.0])
@pytest.mark.parametrize(
    ("factor", "unit"), [(np.pi / 180.0, "in radians"), (180.0 / np.pi, "in degrees"), (1.0, ""), (0.2, ""), (5.0, "")]
)
def test_sigma_in_another_unit_is_named_by_the_scatter(scatter_deg: float, factor: float, unit: str) -> None:
    scatter = np.radians(scatter_deg)
    noise = StatedNoiseCheck()
    list(noise.watch([walk(factor * scatter, scatter)]))
    found = findings(noise.checks())
    assert [f.id for f in found] == (["noise-unit"] if unit else [])
    assert all(unit in f.text and f.sensors == ("a",) for f in found)
