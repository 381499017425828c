"""Candidates get the identity of the track they agree with."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tracker_scenes import SECOND, room100, with_array

from occlog.errors import InputError
from occlog.measure.associate.config import LabelConfig
from occlog.measure.associate.stage import ANY_DIRECTION, label
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Tracks
from occlog.simulate.config import ObserveConfig, WorldConfig
from occlog.simulate.sensors.cameras import observe
from occlog.simulate.stage import simulate_truth

SCENE = with_array(room100(pillar=False, cameras=3), (50.0, 50.0), sigma=0.05)  # cam1 to cam3 at y = 0
GATE = 3.0


def candidates(rows, sigma=0.02):
    """Rows (seconds, sensor, bearing or None[, target])."""
    rows = sorted(((*row, UNLABELLED)[:4] for row in rows), key=lambda row: (row[0], row[1], row[3]))
    t, sensor, bearing, target = zip(*rows, strict=True)
    seen = np.array([b is not None for b in bearing])
    value = np.array([np.nan if b is None else b for b in bearing], dtype=float)
    n = len(rows)
    return Bearings.of(
        t_ns=np.rint(np.array(t) * SECOND).astype(np.int64),
        sensor=list(sensor),
        target_id=list(target),
        seen=seen,
        bearing=value,
        sigma=np.where(seen, sigma, np.nan),
        u_px=np.where(seen, 7.0, np.nan),
        sigma_px=np.where(seen, 2.0, np.nan),
        score=np.full(n, np.nan),
    ).sorted()


def tracks(rows, cov=(1e-6, 0.0, 1e-6)):
    """Rows (seconds, target, x, y)."""
    t, target, x, y = zip(*sorted(rows), strict=True)
    n = len(rows)
    return Tracks.of(
        t_ns=np.rint(np.array(t) * SECOND).astype(np.int64),
        target_id=list(target),
        x=np.array(x, float),
        y=np.array(y, float),
        vx=np.zeros(n),
        vy=np.zeros(n),
        cov_xx=np.full(n, cov[0]),
        cov_xy=np.full(n, cov[1]),
        cov_yy=np.full(n, cov[2]),
    )


def ray(bearing, target, distance=50.0, t=0.0):
    """A track's row which cam1, at the origin, sees in a direction."""
    return (t, target, distance * np.cos(bearing), distance * np.sin(bearing))


def labelled(rows, paths, scene=SCENE, **options):
    """All rows (seconds, sensor, target, bearing or None), and candidates left."""
    parts = list(label([rows], [paths], scene, LabelConfig(**options)))
    table = Bearings.concat([p.bearings for p in parts])
    found = [
        (t / SECOND, s, k, round(b, 9) if seen else None)
        for t, s, k, seen, b in zip(
            table.t_ns.tolist(),
            table.sensor.tolist(),
            table.target_id.tolist(),
            table.seen.tolist(),
            table.bearing.tolist(),
            strict=True,
        )
    ]
    return found, sum(p.left for p in parts)


def test_the_sum_over_all_pairs_counts_not_the_nearest_pair():
    """0.53 is nearer to track 5 (0.54) than to track 2 (0.50), but then 0.59 is of no one."""
    rows = candidates([(0, "cam1", 0.53), (0, "cam1", 0.59), (0, "cam1", -1.2)])
    found, left = labelled(rows, tracks([ray(0.50, 2), ray(0.54, 5)]))
    assert found == [(0.0, "cam1", 2, 0.53), (0.0, "cam1", 5, 0.59)]
    assert left == 1


@pytest.mark.parametrize("sensor", ["cam1", "cam3", "array"])
@pytest.mark.parametrize(("cov", "turn"), [((4.0, 1.0, 2.0), 1), ((0.01, 0.0, 9.0), -1)])
def test_the_gate_is_in_standard_deviations_of_bearing_and_track_together(sensor, cov, turn):
    """Just within and just beyond; the spread by numerical derivatives of the bearing."""
    place = {"cam1": (0.0, 0.0), "cam3": (100.0, 0.0), "array": (50.0, 50.0)}[sensor]
    x, y = 30.0, 20.0

    def seen_at(x, y):
        return np.arctan2(y - place[1], x - place[0])

    step = 1e-5
    slope = np.array([seen_at(x + step, y) - seen_at(x - step, y), seen_at(x, y + step) - seen_at(x, y - step)])
    slope /= 2 * step
    matrix = np.array([[cov[0], cov[1]], [cov[1], cov[2]]])
    spread = np.sqrt(slope @ matrix @ slope + 0.02**2)
    for share, near in ((0.999, True), (1.001, False)):
        direction = seen_at(x, y) + turn * share * GATE * spread
        direction = (direction + np.pi) % (2 * np.pi) - np.pi
        found, left = labelled(candidates([(0, sensor, direction)]), tracks([(0, 4, x, y)], cov))
        assert found == [(0.0, sensor, 4, round(direction, 9) if near else None)]
        assert left == (0 if near else 1)


def test_the_gate_can_be_chosen():
    rows, path = candidates([(0, "cam1", 0.58)]), tracks([ray(0.5, 1)])
    assert labelled(rows, path)[0] == [(0.0, "cam1", 1, None)]
    assert labelled(rows, path, gate=4.1)[0] == [(0.0, "cam1", 1, 0.58)]


def test_a_difference_of_bearings_goes_around_the_circle():
    scene = with_array(room100(), (50.0, 50.0))
    rows = candidates([(0, "array", np.pi - 0.01)])
    path = tracks([(0, 1, 50 + 20 * np.cos(-np.pi + 0.01), 50 + 20 * np.sin(-np.pi + 0.01))])
    assert labelled(rows, path, scene)[0] == [(0.0, "array", 1, round(np.pi - 0.01, 9))]


def test_a_track_at_the_sensor_itself_may_be_in_any_direction():
    path = tracks([(0, 1, 50.0, 50.0)], (1.0, 0.0, 1.0))
    assert labelled(candidates([(0, "array", 3.0)]), path)[0] == [(0.0, "array", 1, 3.0)]
    assert labelled(candidates([(0, "array", 3.0)]), path, gate=3.0 / np.sqrt(ANY_DIRECTION) - 0.01)[1] == 1


def test_tracks_are_linear_between_their_rows_and_nowhere_else():
    path = tracks([(0, 1, 50, 10), (1, 1, 50, 30), (3, 1, 50, 30), (4, 1, 50, 40)])
    times = [-0.1, 0.0, 0.25, 1.0, 1.5, 3.0, 3.5, 4.0, 4.1]
    y = {0.0: 10, 0.25: 15, 1.0: 30, 1.5: 30, 3.0: 30, 3.5: 35, 4.0: 40, -0.1: 8, 4.1: 41}
    rows = candidates([(t, "cam1", float(np.arctan2(y[t], 50))) for t in times])
    found, left = labelled(rows, path)
    assert [f[0] for f in found] == [0.0, 0.25, 1.0, 3.0, 3.5, 4.0]  # not in the gap from 1 s to 3 s
    assert all(f[3] is not None for f in found)
    assert left == 3
    assert [f[0] for f in labelled(rows, path, max_gap_s=2.0)[0]] == [0.0, 0.25, 1.0, 1.5, 3.0, 3.5, 4.0]
    assert [f[0] for f in labelled(rows, path, max_gap_s=0.0)[0]] == [0.0, 1.0, 3.0, 4.0]


def test_the_covariance_between_rows_is_that_of_both_in_shares():
    ends = [tracks([(t, 1, 50, 0)], (0.0, 0.0, v)) for t, v in ((0, 1.0), (1, 25.0))]
    spread = np.sqrt((0.75 * 1.0 + 0.25 * 25.0) / 50.0**2 + 0.02**2)
    for share, near in ((0.999, True), (1.001, False)):
        rows = candidates([(0.25, "cam1", share * GATE * spread)])
        assert (labelled(rows, Tracks.concat(ends))[1] == 0) == near


def test_a_sensor_that_looked_and_has_no_candidate_says_not_seen():
    rows = candidates([(0, "cam1", 0.5), (0, "cam1", 1.3), (0, "cam2", None), (1, "cam1", -0.7)])
    path = tracks([ray(0.5, 1), ray(0.5, 1, t=1.0), ray(0.9, 3), ray(0.9, 3, t=1.0)])
    found, left = labelled(rows, path)
    assert found == [
        (0.0, "cam1", 1, 0.5),
        (0.0, "cam1", 3, None),
        (0.0, "cam2", 1, None),
        (0.0, "cam2", 3, None),
        (1.0, "cam1", 1, None),
        (1.0, "cam1", 3, None),
    ]
    assert left == 2  # cam3 and, at 1 s, cam2 had no frame and say nothing


def test_rows_with_a_label_stay_and_their_track_gets_no_other():
    rows = candidates([(0, "cam1", 0.6, 1), (0, "cam1", 0.5), (0, "cam2", None, 1), (0, "cam2", 0.1, 8)])
    found, left = labelled(rows, tracks([ray(0.5, 1)]))
    assert found == [(0.0, "cam1", 1, 0.6), (0.0, "cam2", 1, None), (0.0, "cam2", 8, 0.1)]
    assert left == 1
    table = Bearings.concat([p.bearings for p in label([rows], [tracks([ray(0.5, 4)])], SCENE, LabelConfig())])
    assert table.target_id.tolist() == [1, 4, 1, 4, 8]  # in the order of the key


def test_what_is_of_no_person_can_be_kept():
    rows = candidates([(0, "cam1", 0.5), (0, "cam1", 1.3), (5, "cam2", 0.2), (6, "cam2", None)])
    path = tracks([ray(0.5, 1)])
    assert labelled(rows, path)[0] == [(0.0, "cam1", 1, 0.5)]
    found, left = labelled(rows, path, keep_unassigned=True)
    assert found == [(0.0, "cam1", -1, 1.3), (0.0, "cam1", 1, 0.5), (5.0, "cam2", -1, 0.2), (6.0, "cam2", -1, None)]
    assert left == 2


def test_the_measurement_is_kept_as_it_is():
    rows = candidates([(0, "cam1", 0.5), (0, "cam2", 3.0)])
    (part,) = label([rows], [tracks([ray(0.5, 1)])], SCENE, LabelConfig())
    seen, unseen = part.bearings.take([0]), part.bearings.take([1])
    for name in ("bearing", "sigma", "u_px", "sigma_px"):
        assert getattr(seen, name)[0] == getattr(rows, name)[0]
        assert np.isnan(getattr(unseen, name)[0])
    assert (part.given.tolist(), part.missed.tolist(), part.left, part.frames) == ([1], [1], 1, 2)


def test_sensors_can_be_chosen_and_must_be_there():
    rows = candidates([(0, "cam1", 0.5), (0, "cam2", 2.0)])
    (part,) = label([rows], [tracks([ray(0.5, 1)])], SCENE, LabelConfig(), frozenset({"cam1"}))
    assert set(part.bearings.sensor.tolist()) == {"cam1"}
    with pytest.raises(InputError, match="row 1: no sensor 'cam2' in the scene"):
        list(label([rows], [tracks([ray(0.5, 1)])], Scene(cameras=SCENE.cameras[:1]), LabelConfig()))


def test_settings_and_tracks_that_make_no_sense_are_refused():
    with pytest.raises(InputError, match="gate is nan, must be finite and above 0"):
        LabelConfig(gate=float("nan"))
    with pytest.raises(InputError, match=r"max_gap_s is -1\.0"):
        LabelConfig(max_gap_s=-1.0)
    with pytest.raises(InputError, match="tracks: target_id is -1 at 0 s"):
        list(label([candidates([(0, "cam1", 0.5)])], [tracks([ray(0.5, -1)])], SCENE, LabelConfig()))


def slow(rows, path, gate):
    """Labels of every frame by trying all pairings; of equally many pairs the least sum."""
    places = {"cam1": (0, 0), "cam2": (50, 0), "cam3": (100, 0), "array": (50, 50)}
    out = []
    for t, s in sorted(set(zip(rows.t_ns.tolist(), rows.sensor.tolist(), strict=True))):
        mine = np.flatnonzero((rows.t_ns == t) & (rows.sensor == s))
        reported = set(rows.target_id[mine].tolist()) - {UNLABELLED}
        out += [(t, s, k, float(b)) for k, b in zip(rows.target_id[mine], rows.bearing[mine], strict=True) if k >= 0]
        free = [i for i in mine.tolist() if rows.target_id[i] < 0 and rows.seen[i]]
        at = {}
        for k in sorted(set(path.target_id.tolist()) - reported):
            own = path.take(path.target_id == k)
            place = np.searchsorted(own.t_ns, t)
            exact = t in own.t_ns.tolist()
            if exact or (0 < place < len(own) and own.t_ns[place] - own.t_ns[place - 1] <= SECOND):
                at[k] = [np.interp(t, own.t_ns, getattr(own, c)) for c in ("x", "y", "cov_xx", "cov_xy", "cov_yy")]

        def distance(i, k, s=s, at=at):
            x, y, xx, xy, yy = at[k]
            dx, dy = x - places[s][0], y - places[s][1]
            apart = np.angle(np.exp(1j * (rows.bearing[i] - np.arctan2(dy, dx))))
            gradient = np.array([-dy, dx]) / (dx**2 + dy**2)
            return apart**2 / (gradient @ np.array([[xx, xy], [xy, yy]]) @ gradient + rows.sigma[i] ** 2)

        names = list(at)
        best, chosen = (1, 0.0), {}
        for order in permutations([*free, *[None] * len(names)], len(names)):
            pairs = [(k, i) for k, i in zip(names, order, strict=True) if i is not None]
            costs = [distance(i, k) for k, i in pairs]
            score = (-len(pairs), sum(costs))
            if all(c <= gate**2 for c in costs) and score < best:
                best, chosen = score, dict(pairs)
        out += [(t, s, k, float(rows.bearing[chosen[k]]) if k in chosen else np.nan) for k in names]
    return sorted(out)


def random_case(seed):
    """Few tracks with gaps that begin and end, rows of all kinds, near to them or not."""
    rng = np.random.default_rng(seed)
    path, rows = [], []
    for k in range(int(rng.integers(1, 4))):
        xy, times = rng.uniform(20, 80, 2), np.unique(rng.integers(0, 12, 9)) * 0.5
        path += [(t, k, xy[0], xy[1] + t) for t in times.tolist()]
    for t in rng.permutation(24)[:8].tolist():
        for sensor in ("cam1", "cam2", "array"):
            kind = rng.integers(0, 4)
            if kind == 0:
                rows.append((t / 4, sensor, None))
            if kind == 1:
                rows.append((t / 4, sensor, float(rng.uniform(-3, 3)), int(rng.integers(0, 3))))
            for _ in range(int(rng.integers(1, 4)) if kind else 0):
                rows.append((t / 4, sensor, float(rng.uniform(0.1, 2.0))))
    return candidates(rows, 0.15), tracks(path, (9.0, -2.0, 4.0))


@pytest.mark.parametrize("seed", range(20))
def test_labels_are_those_of_trying_all_pairings(seed):
    rows, path = random_case(seed)
    table = Bearings.concat([p.bearings for p in label([rows], [path], SCENE, LabelConfig())])
    found = zip(
        table.t_ns.tolist(), table.sensor.tolist(), table.target_id.tolist(), table.bearing.tolist(), strict=True
    )
    want = slow(rows, path, GATE)
    assert repr(sorted(found)) == repr([(t, s, int(k), b) for t, s, k, b in want])


@given(
    seed=st.integers(0, 50),
    cuts=st.lists(st.floats(0, 1), max_size=5),
    others=st.lists(st.floats(0, 1), max_size=5),
    keep=st.booleans(),
    size=st.integers(1, 12),
)
def test_where_chunks_are_cut_does_not_matter(seed, cuts, others, keep, size):
    rows, path = random_case(seed)
    config = LabelConfig(keep_unassigned=keep)
    whole = list(label([rows], [path], SCENE, config))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("occlog.measure.associate.stage.ROWS_PER_PART", size)
        found = list(label(cut(rows, cuts), cut(path, others), SCENE, config))
    for column in Bearings.columns():
        a, b = (np.concatenate([getattr(p.bearings, column.name) for p in parts]) for parts in (whole, found))
        np.testing.assert_array_equal(a, b, err_msg=column.name)
    assert sum(p.left for p in whole) == sum(p.left for p in found)
    assert sum(p.frames for p in whole) == sum(p.frames for p in found)


def cut(table, shares):
    """Chunks of a table, some of them without rows."""
    bounds = [0, *sorted(round(s * len(table)) for s in shares), len(table)]
    return [table.take(slice(a, b)) for a, b in pairwise(bounds)]


def test_tracks_are_read_no_further_than_needed():
    """Of tracks over an hour, chunk after chunk, only those about the bearings are read."""
    read = []

    def chunks():
        for n in range(3600):
            read.append(n)
            yield tracks([ray(0.5, 1, t=float(n))])

    rows = [candidates([(t, "cam1", 0.5)]) for t in (10.0, 20.5, 100.0)]
    found = Bearings.concat([p.bearings for p in label(rows, chunks(), SCENE, LabelConfig())])
    assert found.target_id.tolist() == [1, 1, 1]
    assert len(read) == 103  # one more than a gap beyond the last row


def test_labels_of_a_simulated_recording_are_right():
    """Four targets that hide each other, a tenth missed, at low noise: 99 of 100 labels at least."""
    scene = room100(pillar=True, sigma_position=0.05, sigma_yaw=0.001, sigma_read_px=0.1)
    truth = list(simulate_truth(scene, WorldConfig(steps=600, targets=4), 5))
    reported = Bearings.concat(list(observe(scene, truth, ObserveConfig(miss_probability=0.1), 5)))
    free = replace(reported, target_id=np.full(len(reported), UNLABELLED, dtype=np.int32))
    rng, n = np.random.default_rng(6), sum(len(t) for t in truth)
    noise = 0.1 * rng.standard_normal((2, n))
    t_ns, target, x, y = (np.concatenate([getattr(t, c) for t in truth]) for c in ("t_ns", "target_id", "x", "y"))
    flat, variance = np.zeros(n), np.full(n, 0.01)
    paths = Tracks.of(
        t_ns=t_ns,
        target_id=target,
        x=x + noise[0],
        y=y + noise[1],
        vx=flat,
        vy=flat,
        cov_xx=variance,
        cov_xy=flat,
        cov_yy=variance,
    )
    found = Bearings.concat([p.bearings for p in label([free], [paths], scene, LabelConfig())])
    np.testing.assert_array_equal(found.t_ns, reported.t_ns)  # a row for every target and frame, seen or not
    np.testing.assert_array_equal(found.sensor, reported.sensor)
    np.testing.assert_array_equal(found.target_id, reported.target_id)
    right = (found.seen == reported.seen) & (~reported.seen | (found.bearing == reported.bearing))
    assert reported.seen.sum() > 8000
    assert right[found.seen].mean() >= 0.99
    assert right[reported.seen].mean() >= 0.99  # of three sigmas on one side or another 0.3 % are left out
