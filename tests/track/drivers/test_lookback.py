"""Rows that wait for what comes after them: order, lag, what is held; by a method whose way back is plain to see."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pytest
from tracker_scenes import SECOND, observe, room100, walk

from occlog.records.tables import Bearings, Diagnostics, Tracks
from occlog.track.backward_smoother import BackwardSmoother, backward_smoother
from occlog.track.drivers.online import track_online
from occlog.track.drivers.rows import ROWS_PER_CHUNK, EstimateRow
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.interface import Estimate, HeightEstimate, Online, SmoothedState, Smoothing
from occlog.track.smoothing_and_lag import MAX_SMOOTHING_STEPS, SmoothingConfig

SCENE = room100(pillar=False)


@dataclass(frozen=True)
class Settings(SmoothingConfig):
    """Of the method below."""


class Seen(NamedTuple):
    """State: how many scans there were, and the time of the last."""

    scans: int
    t_ns: int


def estimate(t_ns, n=0):
    return Estimate(
        xy=np.array([t_ns / SECOND, 0.0]),
        velocity=np.zeros(2),
        covariance=np.eye(2),
        ess=7.0,
        log_likelihood=-1.0,
        n_observing=1,
        n_detected=1,
        fallback=f"step {n}",
        used=(0,),
    )


def step(state, scan, _rng):
    state = Seen(state.scans + 1, scan.t_ns)
    return state, estimate(scan.t_ns, state.scans)


def back(traces, _config, rng):
    """y: how many steps came after; vx: how many before among those that wait; vy: a random number."""
    rest = len(traces) - 1
    return [
        SmoothedState(np.array([t / SECOND, rest - k]), np.array([k, rng.random()]), 2.0 * np.eye(2))
        for k, t in enumerate(traces)
    ]


WAY_BACK = Smoothing(wanted=lambda config: config, trace=lambda state: state.t_ns, back=back)
METHOD = Online(
    config=Settings,
    init=lambda _scene, _config, _rng: Seen(0, 0),
    step=step,
    started=lambda _: False,
    smoothing=WAY_BACK,
)


def seen(steps, target=0, every=1, first=0):
    """Bearings of a target at every so many seconds."""
    rng = np.random.default_rng(target)
    table = observe(SCENE, walk(steps, rng), rng, target=target)
    return replace(table, t_ns=table.t_ns * every + first * SECOND)


def run(bearings, config, seed=0):
    parts = list(track_online(bearings, SCENE, METHOD, TrackingTask(config, seed)))
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts), parts


def feed(config, times, target=0, seed=0):
    """Rows given out after each row of one target that went in, those that were left, and how many waited at most."""
    held, given, most = BackwardSmoother(WAY_BACK, config, seed), [], 0
    for t in times:
        held.add(EstimateRow(target, t, estimate(t), 1), Seen(0, t))
        given += held.settled(t)
        most = max(most, held.held)
    return given, held.rest(), most


def test_without_smoothing_nothing_waits() -> None:
    assert backward_smoother(WAY_BACK, Settings(), 0) is None
    assert backward_smoother(None, Settings(smooth=True), 0) is None
    assert backward_smoother(WAY_BACK, Settings(smooth=True), 0) is not None
    assert backward_smoother(WAY_BACK, Settings(lag_s=1.0), 0) is not None


def test_smoothed_rows_know_everything_that_came_after_them() -> None:
    tracks, diagnostics, _ = run([seen(9)], Settings(smooth=True))
    assert (tracks.t_ns // SECOND).tolist() == list(range(9))
    assert tracks.y.tolist() == list(range(8, -1, -1))
    assert set(tracks.cov_xx.tolist()) == {2.0}
    # How the filter fared stays what it was
    assert diagnostics.fallback.tolist() == [f"step {n}" for n in range(1, 10)]
    assert set(diagnostics.ess.tolist()) == {7.0}


@pytest.mark.parametrize("config", [Settings(smooth=True), Settings(lag_s=3.0), Settings(lag_s=0.1)])
def test_rows_of_targets_at_different_rates_come_in_the_order_of_time(config) -> None:
    bearings = [Bearings.merge([seen(40, 0), seen(8, 1, every=5, first=2), seen(14, 2, every=2, first=1)])]
    tracks, _, _ = run(bearings, config)
    keys = list(zip(tracks.t_ns.tolist(), tracks.target_id.tolist(), strict=True))
    assert keys == sorted(keys)
    plain, _, _ = run(bearings, Settings())
    assert keys == list(zip(plain.t_ns.tolist(), plain.target_id.tolist(), strict=True))


def test_a_target_that_leaves_does_not_hold_the_others_back_for_longer_than_the_lag() -> None:
    held, config = {}, Settings(lag_s=4.0)
    queue = BackwardSmoother(WAY_BACK, config, 0)
    for second in range(60):
        for target in (0, 1):
            if target == 0 or second < 5:
                queue.add(EstimateRow(target, second * SECOND, estimate(second * SECOND), 1), Seen(0, second * SECOND))
        given = queue.settled(second * SECOND)
        held[second] = queue.held
        assert all(row.t_ns <= (second - 4) * SECOND for row in given)
    assert max(held.values()) < 4 * 9 + 5


@pytest.mark.parametrize("lag", [1.0, 4.0, 7.5])
def test_a_row_waits_for_what_comes_within_its_lag_and_at_most_three_times_that(lag) -> None:
    times = [k * SECOND for k in range(50)]
    given, rest, most = feed(Settings(lag_s=lag), times)
    after = np.array([row.estimate.xy[1] for row in given])
    assert after.min() >= lag
    assert after.max() <= 3 * lag + 1
    assert most <= 3 * lag + 2
    # Those at the end of the record have what there is
    assert [row.estimate.xy[1] for row in rest] == list(range(len(rest) - 1, -1, -1))
    assert [row.t_ns for row in given + rest] == times


def test_rows_are_given_out_once_they_span_three_lags_and_not_before() -> None:
    config = Settings(lag_s=2.0)
    assert feed(config, [0, 6 * SECOND - 1])[0] == []
    given, rest, _ = feed(config, [0, 6 * SECOND])
    assert [row.t_ns for row in given] == [0]
    assert [row.t_ns for row in rest] == [6 * SECOND]
    # A row exactly one lag before the last has seen enough
    given, _, _ = feed(config, [0, 4 * SECOND, 4 * SECOND + 1, 6 * SECOND])
    assert [row.t_ns for row in given] == [0, 4 * SECOND]


def test_with_a_lag_a_row_is_smoothed_one_and_a_half_times_on_average() -> None:
    lengths: list[int] = []

    def counted(traces, config, rng):
        lengths.append(len(traces))
        return back(traces, config, rng)

    held, n = BackwardSmoother(WAY_BACK._replace(back=counted), Settings(lag_s=5.0), 0), 2000
    for t in range(0, n * SECOND // 10, SECOND // 10):
        held.add(EstimateRow(0, t, estimate(t), 1), Seen(0, t))
        held.settled(t)
    held.rest()
    assert sum(lengths) / n == pytest.approx(1.5, abs=0.05)


@pytest.mark.parametrize("lag", [39.0, 100.0])
def test_a_lag_that_covers_the_record_is_smoothing_of_everything(lag) -> None:
    bearings = [Bearings.merge([seen(40, 0), seen(30, 1)])]
    late, whole = run(bearings, Settings(lag_s=lag))[0], run(bearings, Settings(smooth=True))[0]
    for name in ("t_ns", "target_id", "x", "y", "vx", "vy", "cov_xx"):
        np.testing.assert_array_equal(getattr(late, name), getattr(whole, name))


def test_what_waits_does_not_grow_with_the_record() -> None:
    found = {n: feed(Settings(lag_s=5.0), [k * SECOND // 5 for k in range(n)])[2] for n in (200, 2000)}
    assert found[200] == found[2000]
    assert found[2000] <= 77


def test_without_a_lag_no_more_than_the_most_steps_wait() -> None:
    times = [k * SECOND for k in range(MAX_SMOOTHING_STEPS + 10)]
    assert feed(Settings(smooth=True), times[: MAX_SMOOTHING_STEPS - 1])[0] == []
    given, rest, most = feed(Settings(smooth=True), times)
    assert most == MAX_SMOOTHING_STEPS - 1  # with the next row the first half goes
    assert len(given) == MAX_SMOOTHING_STEPS // 2
    assert min(row.estimate.xy[1] for row in given) == MAX_SMOOTHING_STEPS // 2
    assert [row.t_ns for row in given + rest] == times


def test_a_target_that_is_gone_for_more_than_three_lags_does_not_wait() -> None:
    config = Settings(lag_s=2.0)
    queue = BackwardSmoother(WAY_BACK, config, 0)
    queue.add(EstimateRow(0, 0, estimate(0), 1), Seen(0, 0))
    assert queue.settled(6 * SECOND) == []
    assert [row.t_ns for row in queue.settled(6 * SECOND + 1)] == [0]
    assert queue.held == 0


def test_rows_come_in_chunks_while_the_record_lasts() -> None:
    steps = ROWS_PER_CHUNK + 200
    table = seen(steps)
    few = table.take(table.sensor == "cam1")
    _, _, parts = run([few], Settings(lag_s=3.0))
    assert len(parts) > 1
    assert sum(len(p.tracks) for p in parts) == steps


def test_random_numbers_of_a_target_do_not_depend_on_the_others() -> None:
    config = Settings(smooth=True)
    together, alone = run([Bearings.merge([seen(6, 0), seen(6, 3)])], config)[0], run([seen(6, 3)], config)[0]
    np.testing.assert_array_equal(together.vy[together.target_id == 3], alone.vy)
    assert not np.array_equal(run([seen(6, 3)], config, seed=1)[0].vy, alone.vy)


def test_a_height_is_smoothed_along() -> None:
    def with_height(traces, _config, _rng):
        return [
            SmoothedState(np.zeros(2), np.zeros(2), np.eye(2), HeightEstimate(3.0, 0.5, np.ones(3))) for _ in traces
        ]

    queue = BackwardSmoother(WAY_BACK._replace(back=with_height), Settings(smooth=True), 0)
    queue.add(EstimateRow(0, 0, estimate(0), 1), Seen(0, 0))
    assert queue.rest()[0].estimate.height.z == 3.0
