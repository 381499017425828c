"""Matches of two views from tracks and true boxes."""

import numpy as np
from epipolar_rigs import looking
from view_scenes import TICK, view_tracks, walks

from occlog.core.epipolar import epipolar_distances
from occlog.records import TruthBoxes
from occlog.scene import Scene
from occlog.stages.epipolar import estimated_pairs
from occlog.stages.track_matches import MOST, matches_of_tracks

CAMERAS = [looking(n, np.array(p), (0, 0, 1), 500.0) for n, p in (("a", [7.0, 0, 2.5]), ("b", [0, 7.0, 2.5]))]


def test_the_same_target_at_the_same_time_is_a_match():
    rows = view_tracks(CAMERAS, walks(50), np.random.default_rng(0), sigma=0.0)
    event = rows.event.astype("U4")
    event[(rows.t_ns == 3 * TICK) & (rows.target_id == 1) & (rows.sensor == "b")] = "lost"
    rows = type(rows)(**{c.name: event if c.name == "event" else getattr(rows, c.name) for c in rows.columns()})
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
    places = walks(steps, len(heights)) * [1, 1, 0]
    parts = []
    for camera in CAMERAS:
        feet, heads = (camera.project((places + up).reshape(-1, 3)) for up in (0, np.outer(heights, [0, 0, 1])))
        n = len(feet)
        parts.append(
            TruthBoxes.of(
                t_ns=np.repeat(np.arange(steps) * TICK, len(heights)), sensor=np.full(n, camera.name),
                frame=np.repeat(np.arange(steps), len(heights)), box=np.tile(np.arange(len(heights)), steps),
                target_id=np.tile(np.arange(len(heights)), steps), left_px=feet[:, 0] - 10, top_px=heads[:, 1],
                width_px=np.full(n, 20.0), height_px=feet[:, 1] - heads[:, 1], confidence=np.full(n, np.nan),
            )
        )  # fmt: skip
    return TruthBoxes.merge(parts), places


def test_heads_and_feet_of_people_tell_the_matrix():
    boxes, places = people(np.array([1.6, 1.75, 1.9]))
    matches = matches_of_tracks([boxes], "here", "ends")
    pair = estimated_pairs(matches, Scene(cameras=tuple(CAMERAS))).pairs[0]
    a, b = (camera.project(places.reshape(-1, 3) + np.array([0, 0, 1.2])) for camera in CAMERAS)
    assert np.median(epipolar_distances(pair.matrix, a, b)) < 1.5


def test_of_very_many_some_are_taken_at_equal_steps():
    rows = view_tracks(CAMERAS, walks(1500), np.random.default_rng(0), sigma=0.0)
    (found,) = matches_of_tracks([rows], "here")
    assert len(found.points_a) == MOST
    exact = CAMERAS[0].project(walks(1500).reshape(-1, 3))
    assert np.allclose(found.points_a[0], exact[0])
    assert (np.abs(found.points_a[:, None] - exact).max(axis=2).min(axis=1) < 1e-6).all()
    assert np.abs(found.points_a[-1] - exact[-4:]).max(axis=1).min() < 1e-6
