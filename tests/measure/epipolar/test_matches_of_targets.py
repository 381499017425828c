"""Matches of two views from tracks and true boxes."""

import numpy as np
import pytest
from epipolar_rigs import looking
from view_scenes import TICK, view_tracks, walks

from occlog.core.geometry.fundamental import epipolar_distances
from occlog.measure.epipolar.stage import MAX_MATCHES, estimated_pairs, matches_of_tracks
from occlog.records.declared.views import ViewTracks
from occlog.records.scene import Scene
from occlog.records.tables import TruthBoxes

CAMERAS = [looking(n, np.array(p), (0, 0, 1), 500.0) for n, p in (("a", [7.0, 0, 2.5]), ("b", [0, 7.0, 2.5]))]


def test_the_same_target_at_the_same_time_is_a_match():
    rows = view_tracks(CAMERAS, walks(50), np.random.default_rng(0), sigma=0.0)
    event = rows.lifecycle.astype("U10")
    event[(rows.t_ns == 3 * TICK) & (rows.target_id == 1) & (rows.sensor == "b")] = "terminated"
    rows = type(rows)(**{c.name: event if c.name == "lifecycle" else getattr(rows, c.name) for c in rows.columns()})
    parts = [rows.take(slice(k, k + 33)) for k in range(0, len(rows), 33)]
    (found,) = matches_of_tracks(parts, "here")
    assert (found.a, found.b, found.where, len(found.points_a)) == ("a", "b", "here: a and b", 99)
    points = walks(50).reshape(-1, 3)[np.arange(100) != 7]
    assert np.allclose(found.points_a, CAMERAS[0].project(points))
    assert np.allclose(found.points_b, CAMERAS[1].project(points))
    assert matches_of_tracks([rows.take(rows.sensor == "a")], "here") == ()


def test_the_ends_are_above_and_below_the_centre():
    rows = view_tracks(CAMERAS, walks(5), np.random.default_rng(0), sigma=0.0)
    (centres,), (ends,) = (matches_of_tracks([rows], "here", points) for points in ("centres", "ends"))
    assert len(ends.points_a) == 2 * len(centres.points_a)
    assert np.allclose(ends.points_a.reshape(-1, 2, 2).mean(axis=1), centres.points_a)
    assert np.allclose(np.diff(ends.points_b.reshape(-1, 2, 2), axis=1)[:, 0], [0, 80])


def people(heights, steps=60):
    """True boxes from feet to heads of people of some heights."""
    positions = walks(steps, len(heights)) * [1, 1, 0]
    parts = []
    for camera in CAMERAS:
        feet, heads = (camera.project((positions + up).reshape(-1, 3)) for up in (0, np.outer(heights, [0, 0, 1])))
        n = len(feet)
        parts.append(
            TruthBoxes.of(
                t_ns=np.repeat(np.arange(steps) * TICK, len(heights)),
                sensor=np.full(n, camera.name),
                frame=np.repeat(np.arange(steps), len(heights)),
                box=np.tile(np.arange(len(heights)), steps),
                target_id=np.tile(np.arange(len(heights)), steps),
                left_px=feet[:, 0] - 10,
                top_px=heads[:, 1],
                width_px=np.full(n, 20.0),
                height_px=feet[:, 1] - heads[:, 1],
                confidence=np.full(n, np.nan),
            )
        )
    return TruthBoxes.merge(parts), positions


def test_heads_and_feet_of_people_tell_the_matrix():
    boxes, positions = people(np.array([1.6, 1.75, 1.9]))
    matches = matches_of_tracks([boxes], "here", "ends")
    pair = estimated_pairs(matches, Scene(cameras=tuple(CAMERAS))).pairs[0]
    a, b = (camera.project(positions.reshape(-1, 3) + np.array([0, 0, 1.2])) for camera in CAMERAS)
    assert np.median(epipolar_distances(pair.matrix, a, b)) < 1.5


def test_of_very_many_some_moments_are_taken_with_all_targets():
    rows = view_tracks(CAMERAS, walks(1500), np.random.default_rng(0), sigma=0.0)
    (found,) = matches_of_tracks([rows], "here")
    assert len(found.points_a) == MAX_MATCHES
    exact = CAMERAS[0].project(walks(1500).reshape(-1, 3)).reshape(-1, 2, 2)
    pairs = found.points_a.reshape(-1, 2, 2)
    moments = np.abs(exact[:, 0] - pairs[:, None, 0]).max(axis=2).argmin(axis=1)
    assert np.allclose(pairs, exact[moments])
    assert (np.diff(moments) > 0).all()
    # From all over: of each 150 times 100, give or take 4 standard deviations of 5.8
    assert (np.abs(np.histogram(moments, 10, (0, 1500))[0] - 100) < 25).all()


@pytest.mark.parametrize("targets", [2, 3, 4])
@pytest.mark.parametrize("steps", [300, 2500])
def test_every_target_and_both_ends_are_taken_alike(targets, steps):
    """Targets are distinguished by their heights in the images."""
    n = 2 * steps * targets
    target = np.tile(np.arange(targets, dtype=np.int32), 2 * steps)
    one, blank = np.ones(n), np.full(n, "")
    rows = ViewTracks.of(
        t_ns=np.repeat(np.arange(steps), 2 * targets),
        sensor=np.tile(np.repeat(["a", "b"], targets), steps),
        frame=np.repeat(np.arange(steps), 2 * targets),
        target_id=target,
        x_px=one,
        y_px=100.0 * target + 50,
        a_px=9 * one,
        b_px=9 * one,
        rho=0 * one,
        cov_xx_px=one,
        cov_xy_px=0 * one,
        cov_yy_px=one,
        similarity=one,
        ess=one,
        likelihood_mode=blank,
        counterpart=blank,
        neighbours=blank,
        assisting_views=blank,
        lifecycle=blank,
    )
    (found,) = matches_of_tracks([rows], "here", "ends")
    values, counts = np.unique(found.points_a[:, 1], return_counts=True)
    assert values.tolist() == sorted(100.0 * k + 50 + side for k in range(targets) for side in (-9, 9))
    assert len(set(counts.tolist())) == 1
    assert counts.sum() == 2 * targets * min(steps, MAX_MATCHES // (2 * targets))


def test_views_whose_frames_have_times_of_their_own():
    rows = view_tracks(CAMERAS, walks(50), np.random.default_rng(0), sigma=0.0, delay_ns=TICK // 4)
    assert matches_of_tracks([rows], "here") == ()
    parts = [rows.take(slice(k, k + 33)) for k in range(0, len(rows), 33)]
    for window in (TICK // 4, TICK // 2):
        (found,) = matches_of_tracks(parts, "here", window_ns=window)
        assert np.allclose(found.points_a, CAMERAS[0].project(walks(50).reshape(-1, 3)))
        assert np.allclose(found.points_b, CAMERAS[1].project(walks(50).reshape(-1, 3)))
    # A view never speaks twice at one time
    (wide,) = matches_of_tracks(parts, "here", window_ns=10 * TICK)
    assert np.allclose(wide.points_b, found.points_b)
