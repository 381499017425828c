"""Directions against true ones: pairing, missed and false ones, times and sensors."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from occlog.evaluate.bearings.azimuths import doa_metrics, paired
from occlog.records.tables import Doa

NS = 1_000_000_000


def table(rows: list[tuple[float, str, float]]) -> Doa:
    """Directions of (seconds, sensor, degrees)."""
    rows = sorted(rows)
    n, none = len(rows), np.full(len(rows), np.nan)
    azimuth = (np.radians([r[2] for r in rows]) + np.pi) % (2 * np.pi) - np.pi
    return Doa.of(
        t_ns=np.array([round(r[0] * NS) for r in rows], dtype=np.int64),
        sensor=np.array([r[1] for r in rows], dtype=np.str_),
        source_id=np.full(n, -1, dtype=np.int32),
        azimuth=azimuth,
        elevation=none,
        sigma_azimuth=none,
        sigma_elevation=none,
        confidence=none,
    )


def test_pairing_is_the_best_of_all() -> None:
    rng = np.random.default_rng(0)
    for n, m in ((1, 1), (2, 3), (4, 4), (4, 2)):
        for _ in range(20):
            found, truth = rng.uniform(-np.pi, np.pi, n), rng.uniform(-np.pi, np.pi, m)
            got = paired(found, truth)
            assert (got.true, got.found, len(got.errors)) == (m, n, min(n, m))
            small, large = (found, truth) if n <= m else (truth, found)
            ways = permutations(range(max(n, m)), min(n, m))
            best = min(sum(1 - np.cos(small[i] - large[j]) for i, j in enumerate(way)) for way in ways)
            assert (1 - np.cos(got.errors)).sum() == pytest.approx(best, abs=1e-12)
            assert (np.abs(got.errors) <= np.pi).all()


def test_missed_and_false_directions_by_hand() -> None:
    truth = table([(0, "a", 179), (0, "a", 0), (1, "a", 90), (2, "a", 10), (9, "a", 5)])
    found = table([(0, "a", -178), (0, "a", 1), (0, "a", 60), (1, "a", 120), (2.3, "a", 10), (5, "a", 0)])
    got = doa_metrics(found, truth, np.radians(10.0), round(0.5 * NS))
    assert (got["doa_sets"], got["doa_sets_without_truth"]) == (4, 1)
    assert (got["doa_true"], got["doa_found"], got["doa_hits"], got["doa_missed"], got["doa_false"]) == (5, 5, 3, 2, 2)
    assert got["doa_recall"] == pytest.approx(0.6)
    assert got["doa_error_max_deg"] == pytest.approx(30.0)
    assert got["doa_error_median_deg"] == pytest.approx(2.0)
    assert got["doa_hits_rms_deg"] == pytest.approx(np.sqrt((9 + 1 + 0) / 3))
    assert got["doa_hits_bias_deg"] == pytest.approx(4 / 3)
    assert (got["doa_of_1_pairs"], got["doa_of_2_pairs"]) == (2, 2)
    assert got["doa_of_2_error_max_deg"] == pytest.approx(3.0)


def test_sensors_are_kept_apart_and_nothing_in_common_is_no_set() -> None:
    truth = table([(0, "a", 0), (0, "b", 90)])
    got = doa_metrics(table([(0, "b", 1), (0, "c", 0)]), truth, 0.1, NS)
    assert (got["doa_sets"], got["doa_missed"], got["doa_false"], got["doa_sets_without_truth"]) == (2, 2, 1, 1)
    got = doa_metrics(table([(0, "c", 0)]), table([]), 0.1, NS)
    assert got["doa_sets"] == 0
    assert np.isnan(got["doa_recall"])
