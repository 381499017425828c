from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heard_scenes import NS, ROOM, line, room, rows, table

from occlog.errors import InputError, UsageError
from occlog.records.tables import Bearings, Cooperation, Tracks
from occlog.track.drivers.stage import track
from occlog.track.drivers.tracking import TrackingTask
from occlog.track.methods.imm.config import ImmConfig

pytestmark = pytest.mark.jit
SCENE = room()
TWO = {0: line(5, 8, 0.2, 0.1), 1: line(14, 12, -0.2, -0.1)}
CONFIG = replace(ImmConfig.in_unit("m"), particles=200)


def run(bearings, config=CONFIG, scene=SCENE, seed=0, **more):
    parts = list(track(bearings, scene, TrackingTask(config, seed, method="imm", **more)))
    asked = [p.cooperation for p in parts if p.cooperation is not None]
    return Tracks.concat([p.tracks for p in parts]), Cooperation.concat(asked), parts


def errors(tracks, number, path):
    own = tracks.take(tracks.target_id == number)
    truth = np.array([path(t / NS) for t in own.t_ns.tolist()])
    return np.hypot(own.x - truth[:, 0], own.y - truth[:, 1]), own.t_ns / NS


def nearest(tracks, path, since=0.0):
    """Number of the track nearest to a path, and its errors from a time on."""
    found = {k: errors(tracks, k, path) for k in np.unique(tracks.target_id).tolist()}
    late = {k: e[t >= since] for k, (e, t) in found.items() if (t >= since).any()}
    best = min(late, key=lambda k: float(np.median(late[k])))
    return best, late[best]


@pytest.fixture(scope="module")
def two():
    return rows(SCENE, TWO, cameras=True)


@pytest.fixture(scope="module")
def tracked(two):
    return run([two])


def test_unlabelled_directions_of_two_arrays_become_tracks(tracked):
    tracks, asked, _ = tracked
    assert np.unique(tracks.target_id).tolist() == [0, 1]
    for path in TWO.values():
        _, off = nearest(tracks, path, since=5.0)
        # Two arrays of 2 degrees at 10 m tell a place to 0.3 m; a track is no worse than one scan.
        assert np.sqrt(np.mean(off**2)) < 0.6
    assert len(asked) == 0
    assert not np.isnan(tracks.vx).any()


def test_chunks_do_not_matter(two, tracked):
    parts = [two.take(slice(n, n + 37)) for n in range(0, len(two), 37)]
    assert_same(run(parts)[0], tracked[0])


def test_the_order_of_unlabelled_rows_does_not_matter(two, tracked):
    order = np.lexsort((np.random.default_rng(3).random(len(two)), two.t_ns))
    assert_same(run([two.take(order)])[0], tracked[0])


def test_the_seed_decides(two, tracked):
    assert_same(run([two])[0], tracked[0])
    assert not np.array_equal(run([two], seed=1)[0].x, tracked[0].x)


def assert_same(a, b):
    for c in Tracks.columns():
        np.testing.assert_array_equal(getattr(a, c.name), getattr(b, c.name))


def test_no_one_is_reported_before_he_is_confirmed(tracked):
    # The first scan makes a track, two more confirm it.
    assert tracked[0].t_ns.min() == round(0.4 * NS)
    strict, _, _ = run([rows(SCENE, TWO)], replace(CONFIG, confirmation_hits=10))
    assert strict.t_ns.min() == round(1.8 * NS)


def test_false_directions_are_no_one():
    rng = np.random.default_rng(5)
    false = table([(n * NS // 5, "a1", -1, rng.uniform(-3, 3), 0.03) for n in range(0, 100, 10)])
    tracks, _, parts = run([Bearings.merge([rows(SCENE, {0: TWO[0]}), false])])
    assert np.unique(tracks.target_id).tolist() == [0]
    assert len(parts) == 1


def test_who_comes_later_is_a_track_of_his_own():
    tracks, _, _ = run([rows(SCENE, TWO, sounds=lambda k, t: k == 0 or t >= 8.0)])
    number, _ = nearest(tracks, TWO[1], since=15.0)
    assert number == 1
    assert 8.0 < errors(tracks, 1, TWO[1])[1].min() < 9.5


def test_who_falls_silent_keeps_his_number():
    tracks, _, _ = run([rows(SCENE, TWO, seconds=16, sounds=lambda k, t: k == 0 or not 6.0 < t < 9.0)])
    before = tracks.take(tracks.t_ns <= 6 * NS)
    assert nearest(before, TWO[1], 3.0)[0] == nearest(tracks, TWO[1], 13.0)[0]
    own = errors(tracks, nearest(tracks, TWO[1], 13.0)[0], TWO[1])[1]
    assert ((own > 6.0) & (own < 9.0)).sum() >= 14  # he is reported all the while


def test_who_is_silent_for_long_is_forgotten():
    config = replace(CONFIG, max_coasting_s=3.0)
    tracks, _, _ = run([rows(SCENE, TWO, sounds=lambda k, t: k == 0 or t < 6.0)], config)
    number, _ = nearest(tracks.take(tracks.t_ns <= 6 * NS), TWO[1], 3.0)
    assert errors(tracks, number, TWO[1])[1].max() == pytest.approx(9.0, abs=0.5)


def test_silence_of_all_is_gone_through():
    tracks, _, _ = run([rows(SCENE, TWO, seconds=10, sounds=lambda k, t: not 4.0 < t < 7.0)])
    times = np.unique(tracks.t_ns)
    np.testing.assert_array_equal(np.diff(times), NS // 5)


def test_labels_are_kept():
    labelled = rows(SCENE, {7: TWO[0], 3: TWO[1]}, labels=True, seconds=8)
    tracks, _, _ = run([labelled])
    assert np.unique(tracks.target_id).tolist() == [3, 7]
    for k, path in ((7, TWO[0]), (3, TWO[1])):
        off, t = errors(tracks, k, path)
        assert np.median(off[t > 4]) < 0.6


def test_arrays_need_not_be_heard_at_the_same_time():
    scene = room()
    late = rows(scene, TWO)
    shift = np.where(late.sensor == "a2", 70_000_000, 0)
    order = np.argsort(late.t_ns + shift, kind="stable")
    moved = replace(late, t_ns=late.t_ns + shift).take(order)
    tracks, _, _ = run([moved])
    assert np.unique(tracks.target_id).tolist() == [0, 1]
    assert np.median(nearest(tracks, TWO[0], 5.0)[1]) < 0.6


def test_two_who_are_heard_as_one_stay_two():
    """They pass each other, seen from the only array; while within its resolution one direction is heard."""
    text = ROOM.replace("a2, position: [18, 3, 1], sigma_deg: 2", "a2, position: [18, 3, 1], sigma_deg: 2, range: 0.1")
    text = text.replace("position: [2, 2, 1], sigma_deg: 2", "position: [2, 2, 1], sigma_deg: 1, resolution_deg: 6")
    scene = room(text)
    paths = {0: line(8, 4, 0.0, 0.4), 1: line(12, 12, 0.0, -0.4)}
    merged = one_direction(rows(scene, paths, seconds=20), np.radians(6))
    config = replace(
        CONFIG,
        start=(8, 4, 0.3, 0, 0.4, 0.1, 12, 12, 0.3, 0, -0.4, 0.1),
        process_noise_velocity=0.05,
        turn_acceleration=0.05,
    )
    tracks, _, _ = run([merged], config, scene)
    assert (np.bincount(tracks.target_id[tracks.t_ns > 18 * NS]) > 0).sum() == 2
    for k in (0, 1):
        off, t = errors(tracks, k, paths[k])
        assert off[t > 18].mean() < 3.0


def one_direction(bearings, resolution):
    out = []
    for t in np.unique(bearings.t_ns).tolist():
        own = bearings.take(bearings.t_ns == t)
        if len(own) == 2 and abs(own.bearing[0] - own.bearing[1]) < resolution:
            out.append((t, "a1", -1, own.bearing.mean(), own.sigma[0]))
        else:
            out += [(t, "a1", -1, b, s) for b, s in zip(own.bearing, own.sigma, strict=True)]
    return table(out)


def test_starts_of_several_targets_are_taken():
    config = replace(CONFIG, association="any", start=(5, 8, 0.1, 0.2, 0.1, 0.0, 14, 12, 0.1, -0.2, -0.1, 0.0))
    tracks, _, _ = run([rows(SCENE, TWO, seconds=4)], config)
    assert tracks.t_ns[0] == 0
    for k, path in TWO.items():
        assert errors(tracks, k, path)[0].max() < 1.0


def test_cameras_are_asked_when_the_policy_says_so_and_only_then(two, tracked):
    config = replace(CONFIG, cooperate="periodic", period_s=4.0)
    tracks, asked, parts = run([two], config)
    assert np.unique(asked.t_ns).tolist() == [t * NS for t in (4, 8, 12, 16, 20)]
    assert asked.answered.all()
    # Two frames a time; a third where another camera tells the second target's place twice as well.
    assert asked.frames[::2].tolist() == [2] * 5
    assert set(asked.frames[1::2].tolist()) <= {0, 1}
    assert sum(p.offered for p in parts) == 3 * 101
    for k in (0, 1):
        off, t = errors(tracks, nearest(tracks, TWO[k])[0], TWO[k])
        at = np.isin(np.rint(t * NS), asked.t_ns)
        assert off[at].max() < 0.25  # two lines of 0.002 rad, and the gain of a cloud that knows it to 0.3 m
    assert_same(run([two], replace(CONFIG, cooperate="none"))[0], tracked[0])


def test_whom_cameras_find_is_a_track_with_its_label():
    """A third whose place only the cameras can tell, as one array alone hears."""
    text = ROOM.replace("{name: a2, position: [18, 3, 1], sigma_deg: 2", "{name: a2, position: [18, 3, 1], range: 0.1")
    scene = room(text)
    config = replace(CONFIG, cooperate="count", birth_probability=0.0)
    tracks, asked, _ = run([rows(scene, {5: TWO[0]}, cameras=True, seconds=6)], config, scene)
    assert asked.target_id[0] == -1
    assert asked.cause[0] == "count"
    assert asked.answered[0]
    assert np.unique(tracks.target_id).tolist() == [5]
    assert errors(tracks, 5, TWO[0])[0][0] < 0.5


def test_what_is_missing_is_reported():
    cameras = rows(SCENE, TWO, cameras=True)
    with pytest.raises(InputError, match="no row is of a microphone array"):
        run([cameras.take(np.char.startswith(cameras.sensor, "c"))])
    with pytest.raises(UsageError, match="requires two cameras with a pose; 1 in use have one"):
        run([cameras], replace(CONFIG, cooperate="spread"), sensors=frozenset({"a1", "c1"}))


@pytest.mark.parametrize("more", [{"smooth": True}, {"lag_s": 2.0}], ids=["all", "lag"])
def test_what_is_heard_later_tells_of_a_place_as_well(two, tracked, more):
    tracks, _, parts = run([two], config=replace(CONFIG, **more))
    np.testing.assert_array_equal(tracks.t_ns, tracked[0].t_ns)
    np.testing.assert_array_equal(tracks.target_id, tracked[0].target_id)
    assert sum(len(p.diagnostics) for p in parts) == len(tracks)
    for path in TWO.values():
        filtered, smoothed = nearest(tracked[0], path, since=2.0)[1], nearest(tracks, path, since=2.0)[1]
        assert np.sqrt(np.mean(smoothed**2)) < 0.85 * np.sqrt(np.mean(filtered**2))


def test_rows_with_a_lag_come_in_the_order_of_time(two):
    t_ns, given = two.t_ns, -1

    def feed():
        for n in range(0, len(t_ns), 50):
            yield two.take(slice(n, n + 50))

    config = replace(CONFIG, lag_s=1.0)
    for part in track(feed(), SCENE, TrackingTask(config, 0, method="imm")):
        assert (np.diff(part.tracks.t_ns) >= 0).all()
        assert part.tracks.t_ns[0] >= given
        given = int(part.tracks.t_ns[-1])
    assert given == t_ns[-1]
