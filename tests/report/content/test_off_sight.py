"""Tracks against lines of sight: residuals and distances are the same in chunks of any length."""

from __future__ import annotations

import numpy as np
import pytest
from bearing_scenes import CASES, Case

from occlog.consistency.verdict import ConsistencyEvidence
from occlog.evaluate.verdict import TrackProvenance
from occlog.records.tables import Bearings
from occlog.report.gather import BearingReference, Posts, ThinnedBearings, bearings_of


def labels(case: Case, kind: str) -> Case:
    """Bearings as they are, of no one, or of sensors of which each has its own times."""
    table = case.bearings
    columns = {c.name: getattr(table, c.name) for c in Bearings.columns()}
    if kind == "nobody's":
        columns["target_id"] = np.full(len(table), -1)
    if kind == "apart":
        _, sensor = np.unique(table.sensor, return_inverse=True)
        columns["t_ns"] = table.t_ns + sensor * 1_234_567
    return case._replace(bearings=Bearings.of(**columns).sorted())


def streamed(case: Case, rows: int = 10**6, most: int = 10**6) -> ThinnedBearings:
    """What is gathered of chunks of so many rows."""

    def chunks(table, count):
        return (table.take(slice(start, start + count)) for start in range(0, len(table), count))

    posts = Posts()
    for chunk in chunks(case.tracks, rows):
        posts.add(chunk)
    targets = tuple(np.unique(case.tracks.target_id).tolist())
    beside = BearingReference(
        lambda: chunks(case.tracks, rows), None, posts, ConsistencyEvidence(), TrackProvenance(), frozenset(targets)
    )
    moments = np.unique(case.tracks.t_ns)[::3]
    return bearings_of(lambda: chunks(case.bearings, rows + 1), case.place, targets, (moments, 2.5e8), beside, most)


@pytest.mark.parametrize("what", CASES)
@pytest.mark.parametrize("kind", ["nobody's", "apart"])
def test_figures_are_the_same_in_chunks_of_any_length(what: str, kind: str) -> None:
    case = labels(CASES[what](5), kind)
    whole = streamed(case)
    similar(streamed(case, 20 if kind == "apart" else 50), whole, case)
    assert any(each.any for each in whole.residuals.values())
    if kind != "nobody's" and what != "in space":
        assert any(each.rows > 20 for each in whole.sight.values())


def similar(found: ThinnedBearings, whole: ThinnedBearings, case: Case) -> None:
    """Figures and rows of both are the same."""
    for target in np.unique(case.tracks.target_id).tolist():
        got, wanted = found.residuals[target], whole.residuals[target]
        assert got.rows == wanted.rows
        for name, squares in wanted.squares.items():
            np.testing.assert_allclose(got.squares[name], squares, rtol=1e-8)
        for column in ("t_ns", "sensor"):
            np.testing.assert_array_equal(getattr(got.drawn, column), getattr(wanted.drawn, column))
        np.testing.assert_allclose(got.drawn.residual, wanted.drawn.residual, rtol=1e-8, atol=1e-9)
        near, far = found.sight[target], whole.sight[target]
        assert near.rows == far.rows
        np.testing.assert_array_equal(near.t_ns, far.t_ns)
        np.testing.assert_allclose(near.distance, far.distance, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(near.so_far, far.so_far, rtol=1e-7)
        assert (near.rms, near.high) == pytest.approx((far.rms, far.high), rel=1e-7, nan_ok=True)
    np.testing.assert_array_equal(found.table.t_ns, case.bearings.t_ns)


def test_of_long_tables_a_part_is_drawn_with_the_largest_and_figures_are_of_all() -> None:
    case = CASES["simulated"](5)
    most = len(case.bearings) // 5
    found, whole = streamed(case, 40, most), streamed(case)
    assert found.whole.every == 5
    target = int(case.tracks.target_id[0])
    got, wanted = found.residuals[target], whole.residuals[target]
    assert got.rows == wanted.rows
    assert len(got.drawn.t_ns) < 0.6 * len(wanted.drawn.t_ns)
    for sensor in range(len(case.place.cameras)):
        every = wanted.drawn.residual[wanted.drawn.sensor == sensor]
        drawn = got.drawn.residual[got.drawn.sensor == sensor]
        assert np.abs(drawn).max() == pytest.approx(np.abs(every).max(), rel=1e-8)
    near, far = found.sight[target], whole.sight[target]
    assert near.rows == far.rows > len(near.t_ns)
    assert near.distance.max() == pytest.approx(far.distance.max(), rel=1e-8)
    np.testing.assert_allclose(near.so_far, far.so_far[np.isin(far.t_ns, near.t_ns)], rtol=1e-8)
    assert (near.rms, near.high) == pytest.approx((far.rms, far.high), rel=1e-8)
    # Bearings that are drawn are those of times, with all sensors
    moments = np.unique(case.tracks.t_ns)[::3][:: found.every]
    assert set(np.unique(found.table.t_ns).tolist()) <= set(np.unique(case.bearings.t_ns).tolist())
    shown = case.bearings.take(np.isin(case.bearings.t_ns, moments))
    assert np.isin(shown.t_ns, found.table.t_ns).all()
    assert len(found.table) <= most


def test_places_are_interpolated_over_gaps_of_any_width() -> None:
    case = CASES["hand-made"](5)
    target = int(case.tracks.target_id[0])
    begin = int(case.tracks.t_ns[0])
    seconds = (case.tracks.t_ns - begin) / 1e9
    gap = case._replace(tracks=case.tracks.take((seconds < 4) | (seconds > 124)))
    got = streamed(gap, 7).residuals[target]
    wanted = streamed(gap).residuals[target]
    between = (wanted.drawn.t_ns > begin + 5 * 10**9) & (wanted.drawn.t_ns < begin + 123 * 10**9)
    assert between.sum() > 20
    np.testing.assert_array_equal(got.drawn.t_ns, wanted.drawn.t_ns)
    np.testing.assert_allclose(got.drawn.residual, wanted.drawn.residual, rtol=1e-6, atol=1e-9)
