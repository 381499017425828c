"""The track stage with a method that wants whole stretches: order of rows, lags, pauses, chunks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracker_scenes import SECOND, observe, room100, walk

from occlog.errors import InputError, UsageError
from occlog.records.columns import ColumnTable
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Occluders, Tracks
from occlog.scans.grouping import Scan
from occlog.track.drivers.batch import track_batch
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.interface import Batch, OccluderTerms, SmoothedTrajectory
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.method import lag_ns
from occlog.track.methods.map.search.problem_of_record import begin

pytestmark = pytest.mark.jit

SCENE = room100(pillar=False)
CONFIG = MapConfig.in_unit("unit")
LAGGED = replace(CONFIG, lag_s=4.0)
NAMES = frozenset(c.name for c in SCENE.cameras)


def seen_walk(steps: int, target: int = 0, first: int = 0, seed: int = 0) -> Bearings:
    """A walk seen by all cameras from a time on [s]."""
    rng = np.random.default_rng([seed, target])
    made = observe(SCENE, walk(steps, rng), rng, target=target)
    return replace(made, t_ns=made.t_ns + first * SECOND)


def take_times(table: Bearings, times) -> Bearings:
    return table.take(np.isin(table.t_ns, np.asarray(times) * SECOND))


def whole(parts) -> tuple[Tracks, Diagnostics]:
    parts = list(parts)
    return Tracks.concat(p.tracks for p in parts), Diagnostics.concat(p.diagnostics for p in parts)


def by_map(chunks, config=CONFIG, **options):
    return whole(track(chunks, SCENE, TrackingTask(config, 0, method="map", **options)))


def same(a: ColumnTable, b: ColumnTable) -> bool:
    return all(np.array_equal(getattr(a, c.name), getattr(b, c.name), equal_nan=c.kind == "f8") for c in a.columns())


def keys(tracks: Tracks) -> list[tuple[int, int]]:
    return list(zip((tracks.t_ns // SECOND).tolist(), tracks.target_id.tolist(), strict=True))


class Calls:
    """A batch method that gives out times at once, as `batch_map` settles them, and remembers its calls."""

    def __init__(self, lag_s: float | None) -> None:
        self.lag_ns = None if lag_s is None else round(lag_s * SECOND)
        self.blocks: list[tuple[list[int], bool]] = []
        self.longest = 0
        self.method = Batch(
            config=type(CONFIG),
            begin=lambda *_: np.empty(0, np.int64),
            advance=self.advance,
            started=lambda _: False,
            lag_ns=lambda config: lag_ns(config.lag_s),
        )

    def advance(self, state, scans: Sequence[Scan], last: bool):
        t_ns = np.array([scan.t_ns for scan in scans], dtype=np.int64)
        self.blocks.append(((t_ns // SECOND).tolist(), last))
        times = np.concatenate([state, t_ns])
        self.longest = max(self.longest, len(times))
        assert (np.diff(times) > 0).all()
        T = len(times)
        keep = T if last else min(int(np.searchsorted(times, times[-1] - self.lag_ns, side="right")), T - 1)
        zeros, none = np.zeros((keep, 2)), np.zeros(keep, np.int64)
        out = SmoothedTrajectory(
            times[:keep],
            zeros,
            zeros,
            np.tile(np.eye(4), (keep, 1, 1)),
            np.zeros(keep),
            none,
            none,
            ("",) * keep,
            ((),) * keep,
            ((),) * keep,
            1,
            True,
        )
        return times[keep:], out

    def run(self, chunks, lag_s: float | None):
        config = replace(CONFIG, lag_s=lag_s)
        return list(track_batch(chunks, SCENE, self.method, TrackingTask(config, 0)))


@pytest.mark.parametrize("lag", [None, 4.0])
def test_a_row_for_every_scan_in_time_order_across_targets(lag: float | None) -> None:
    """Targets that begin and end at other times than the others."""
    made = Bearings.merge([seen_walk(20, 0), seen_walk(12, 3, first=5), seen_walk(6, 7, first=14)])
    tracks, diagnostics = by_map([made], replace(CONFIG, lag_s=lag))
    want = sorted({(int(t) // SECOND, int(k)) for t, k in zip(made.t_ns, made.target_id, strict=True)})
    assert keys(tracks) == want
    assert np.array_equal(tracks.t_ns, diagnostics.t_ns)
    assert np.array_equal(tracks.target_id, diagnostics.target_id)
    assert set(diagnostics.cameras.tolist()) == {",".join(f"cam{i}" for i in range(1, 9))}
    seen = [
        int(made.seen[(made.t_ns == t) & (made.target_id == k)].sum())
        for t, k in zip(tracks.t_ns, tracks.target_id, strict=True)
    ]
    assert diagnostics.n_detected.tolist() == seen


@given(st.lists(st.sets(st.integers(0, 40), min_size=1, max_size=30), min_size=1, max_size=4), st.floats(0.5, 15.0))
def test_rows_of_any_targets_come_once_and_in_order(present: list[set[int]], lag: float) -> None:
    """Whatever gaps they have; and nothing waits for longer than the lag, half of it, and a pause."""
    parts = [
        replace(take_times(seen_walk(41), sorted(times)), target_id=np.full(8 * len(times), k, np.int32))
        for k, times in enumerate(present)
    ]
    table, calls = Bearings.merge(parts), Calls(lag)
    out = calls.run([table], lag)
    got = [k for part in out for k in keys(part.tracks)]
    assert got == sorted((t, k) for k, times in enumerate(present) for t in times)
    assert calls.longest <= 1.5 * lag + 3
    each = []
    for part in parts:
        alone = Calls(lag)
        alone.run([part], lag)
        each += alone.blocks
    assert sorted(calls.blocks) == sorted(each)  # the same stretches as without the others


@pytest.mark.parametrize("lag", [2.0, 4.0, 7.0])
def test_rows_are_given_out_with_a_bounded_delay_and_memory(lag: float) -> None:
    """While the input is being read: the delay is the lag and half of it, and one step."""
    table, calls, now = seen_walk(60), Calls(lag), [0]

    def chunks():
        for t in range(60):
            now[0] = t
            yield take_times(table, [t])

    config = replace(CONFIG, lag_s=lag)
    waits = []
    for part in track_batch(chunks(), SCENE, calls.method, TrackingTask(config, 0)):
        if now[0] < 59:
            waits += (now[0] - part.tracks.t_ns / SECOND).tolist()
    assert lag <= min(waits)
    assert max(waits) <= 1.5 * lag + 2  # a group is complete when the next one begins
    assert calls.longest <= 1.5 * lag + 2
    assert sum(last for _, last in calls.blocks) == 1


def test_a_target_that_pauses_longer_than_the_lag_begins_again() -> None:
    """Without any row for so long it is ended; the other one goes on."""
    times = [*range(10), *range(20, 30)]
    paused, steady = take_times(seen_walk(30, 1), times), seen_walk(30, 2)
    tracks, _ = by_map([Bearings.merge([paused, steady])], LAGGED)
    assert keys(tracks) == sorted([(t, 1) for t in times] + [(t, 2) for t in range(30)])
    own = tracks.take(tracks.target_id == 1)
    before, after = (by_map([take_times(paused, part)], LAGGED)[0] for part in (times[:10], times[10:]))
    assert same(own.take(np.arange(20) >= 10), after)  # as if there had been nothing before
    assert same(own.take(np.arange(20) < 10), before)
    assert same(own, by_map([paused], LAGGED)[0])  # also where no one else tells that time passes


def test_the_start_is_where_a_target_is_at_first_only() -> None:
    """Who comes back after a pause may be anywhere."""
    path = seen_walk(8, 1)
    back = seen_walk(8, 1, first=40, seed=3)
    first, _ = by_map([path])
    config = replace(LAGGED, start=(float(first.x[0]), float(first.y[0]), 1e-3))
    tracks, _ = by_map([Bearings.merge([path, back])], config)
    free, _ = by_map([back], LAGGED)
    assert np.hypot(free.x[0] - first.x[0], free.y[0] - first.y[0]) > 5.0
    assert np.hypot(tracks.x[0] - first.x[0], tracks.y[0] - first.y[0]) < 1e-2
    assert same(tracks.take(tracks.t_ns >= 40 * SECOND), free)


def test_a_pause_shorter_than_the_lag_is_bridged() -> None:
    times = [*range(10), *range(13, 22)]
    calls = Calls(4.0)
    calls.run([Bearings.merge([take_times(seen_walk(22, 1), times), seen_walk(22, 2)])], 4.0)
    assert sum(last for _, last in calls.blocks) == 2  # each target ends once, at the end


def test_a_lag_shorter_than_the_steps_does_not_end_a_target_at_each_of_them() -> None:
    """Only its first row is alone, when no step of it is known yet."""
    calls = Calls(0.5)
    calls.run([seen_walk(10)], 0.5)
    assert sum(last for _, last in calls.blocks) == 2
    assert keys(by_map([seen_walk(10)], replace(CONFIG, lag_s=0.5))[0]) == [(t, 0) for t in range(10)]


@pytest.mark.parametrize("config", [CONFIG, LAGGED], ids=["whole", "lag"])
def test_the_track_does_not_depend_on_where_the_input_is_cut(config) -> None:
    made = Bearings.merge([seen_walk(14, 0), seen_walk(9, 2, first=3)])
    want = by_map([made], config)
    for rows in (1, 7, 64, 150):
        parts = [made.take(slice(a, a + rows)) for a in range(0, len(made), rows)]
        assert all(same(a, b) for a, b in zip(by_map(parts, config), want, strict=True))


@pytest.mark.parametrize("config", [CONFIG, LAGGED], ids=["whole", "lag"])
def test_each_target_has_the_track_it_has_alone(config) -> None:
    both, _ = by_map([Bearings.merge([seen_walk(15, 0), seen_walk(15, 5)])], config)
    for k in (0, 5):
        assert same(both.take(both.target_id == k), by_map([seen_walk(15, k)], config)[0])
        chosen, _ = by_map([Bearings.merge([seen_walk(15, 0), seen_walk(15, 5)])], config, targets=(k,))
        assert same(both.take(both.target_id == k), chosen)


def test_a_lag_gives_nearly_the_whole_track() -> None:
    """With all eight cameras a state hardly depends on what comes 8 s later: 0.1 of 100."""
    made = seen_walk(30)
    a, b = by_map([made])[0], by_map([made], replace(CONFIG, lag_s=8.0))[0]
    assert keys(a) == keys(b)
    assert np.hypot(a.x - b.x, a.y - b.y).max() < 0.1
    assert (np.abs(a.x - b.x) > 0.0).any()


def test_searches_are_counted_for_each_target() -> None:
    parts = list(
        track([Bearings.merge([seen_walk(30, 0), seen_walk(30, 1)])], SCENE, TrackingTask(LAGGED, 0, method="map"))
    )
    solves = [s for p in parts for s in p.solves]
    assert {s.target for s in solves} == {0, 1}
    assert all(s.converged and s.iterations > 0 for s in solves)
    assert sum(s.target == 0 for s in solves) > 5
    assert len(next(iter(track([seen_walk(30)], SCENE, TrackingTask(CONFIG, 0, method="map")))).solves) == 1


def test_occluders_come_with_the_scan_or_are_refused() -> None:
    chunk, zero = seen_walk(3), np.zeros(1)
    people = Occluders(
        t_ns=chunk.t_ns[:1],
        occluder_id=np.zeros(1, dtype=np.int32),
        x=zero,
        y=zero,
        cov_xx=zero,
        cov_xy=zero,
        cov_yy=zero,
    )
    calls = Calls(None)
    with pytest.raises(UsageError, match="does not use moving occluders"):
        list(track_batch([chunk], SCENE, calls.method, TrackingTask(CONFIG, 0, method="map"), [people]))
    met: list[bool] = []

    def advance(state, scans, last):
        met.extend(scan.occluders is not None for scan in scans)
        return calls.method.advance(state, scans, last)

    informed = calls.method._replace(advance=advance, occluders=lambda _: OccluderTerms(1.0, 1.5))
    list(track_batch([chunk], SCENE, informed, TrackingTask(CONFIG, 0, method="map"), [people]))
    assert met == [True, True, False]


def test_candidates_without_a_label_are_refused_or_left_out() -> None:
    made = seen_walk(6)
    boxes = replace(made, target_id=np.full(len(made), UNLABELLED, np.int32))
    with pytest.raises(InputError, match=f"none of {len(made)} candidates has a label.*`occlog label`"):
        by_map([boxes])
    with pytest.raises(InputError, match="no row is of the chosen targets"):
        by_map([made], targets=(4,))
    mixed = Bearings.merge([made, boxes])
    assert same(by_map([mixed])[0], by_map([made])[0])


def test_one_start_is_for_one_target() -> None:
    config = replace(CONFIG, start=(50.0, 50.0, 10.0))
    with pytest.raises(UsageError, match=r"choose one target, e\.g\. --target 5"):
        by_map([Bearings.merge([seen_walk(6, 0), seen_walk(6, 5)])], config)
    assert begin(SCENE, config).before.spread[0, 0] == 100.0


def test_a_target_that_is_hardly_ever_seen_holds_the_others_back_only_so_long() -> None:
    """Rows come out at most 1.5 + 4 lags (and one block) late, whatever pause another target had."""
    lag, last = 4.0, 300
    rare = replace(take_times(seen_walk(last), [0, 150]), target_id=np.full(16, 1, np.int32))
    table = Bearings.merge([seen_walk(last), rare])
    fed = [0]

    def chunks():
        for start in range(0, last, 4):
            fed[0] = start + 4
            yield take_times(table, range(start, start + 4))

    config = replace(CONFIG, lag_s=lag)
    parts = track_batch(chunks(), SCENE, Calls(lag).method, TrackingTask(config, 0))
    late = [fed[0] - int(part.tracks.t_ns[0]) // SECOND for part in parts]
    assert max(late) <= 5.5 * lag + lag / 2 + 4 + 1
