"""Standard deviations of strengths whose shadowing lasts: closed forms, and the same however tables are cut."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import NS
from occlog.records.declared.sensors import Measurements
from occlog.scans.distance_measurements import SignalErrors, sigmas, with_sigmas


def reads(t_s: np.ndarray, sensor: list[str], target: list[int], sigma: np.ndarray) -> Measurements:
    nan = np.full(len(t_s), np.nan)
    return Measurements.of(
        t_ns=np.round(t_s * NS).astype(np.int64),
        sensor=sensor,
        target_id=target,
        range=nan,
        sigma_range=nan,
        rssi=np.full(len(t_s), -60.0),
        sigma_rssi=sigma,
    )


@pytest.mark.parametrize("dt_s", [0.1, 0.5, 3.0])
def test_the_mean_of_many_reads_has_the_variance_of_correlated_ones(dt_s: float) -> None:
    how, n = SignalErrors(noise_db=4.0, shadow_db=3.0, shadow_s=5.0), 20_000
    lags = np.arange(1, n)
    shadow = 9.0 * (n + 2.0 * ((n - lags) * np.exp(-lags * dt_s / 5.0)).sum()) / n  # n times the variance of the mean
    np.testing.assert_allclose(sigmas(how, np.array([dt_s])) ** 2, 16.0 + shadow, rtol=5e-3)


def test_reads_far_apart_and_first_ones_count_in_full() -> None:
    how = SignalErrors(noise_db=4.0, shadow_db=3.0, shadow_s=5.0)
    np.testing.assert_allclose(sigmas(how, np.array([1e3, np.inf])), 5.0)
    assert np.isfinite(sigmas(how, np.array([0.0]))).all()  # two reads at one time


def test_time_is_since_the_same_station_read_the_same_target_however_tables_are_cut() -> None:
    rng = np.random.default_rng(3)
    t_s = np.sort(rng.uniform(0, 20, 60))
    sensor, target = rng.choice(["a", "b"], 60).tolist(), rng.integers(0, 2, 60).tolist()
    reported = np.where(rng.random(60) < 0.2, 7.0, np.nan)
    whole = reads(t_s, sensor, target, reported)
    how = SignalErrors()
    found = with_sigmas(whole, how, {})
    before: dict[tuple[str, int], float] = {}
    for k in range(60):
        key = (sensor[k], target[k])
        wanted = sigmas(how, np.array([whole.t_ns[k] / NS - before.get(key, -np.inf)]))[0]
        assert found.sigma_rssi[k] == pytest.approx(7.0 if reported[k] == 7.0 else wanted, rel=1e-6)
        before[key] = whole.t_ns[k] / NS
    alone = with_sigmas(whole, how, None).sigma_rssi
    np.testing.assert_allclose(alone[np.isnan(reported)], np.hypot(how.noise_db, how.shadow_db))
    last: dict[tuple[str, int], int] = {}
    parts = [with_sigmas(whole.take(slice(k, k + 7)), how, last) for k in range(0, 60, 7)]
    np.testing.assert_array_equal(Measurements.concat(parts).sigma_rssi, found.sigma_rssi)
