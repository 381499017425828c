"""Times to tables: starts, events, ends, births from a detector, one view and several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from occlog.errors import InputError
from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.records.declared.views import ViewTracks
from occlog.track.methods.images.initiation.config import ViewsConfig
from occlog.track.methods.images.initiation.regions import DetectorRegions, RegionStream
from occlog.track.methods.images.interface import FrameSet
from occlog.track.methods.images.methods.config import BmctConfig, MipfConfig
from occlog.track.methods.images.run.frame_synchronisation import FrameSetImages
from occlog.track.methods.images.run.stage import STEPS_PER_PART, TrackerStart, TrackingSetup, track_views

VIEWS = (TrackedView("b", 80, 60), TrackedView("a", 80, 60))
BLIND = ViewGeometry(np.full((2, 2, 3, 3), np.nan), (None, None))
IMAGE = np.zeros((60, 80, 3), np.uint8)
STILL = MipfConfig(particles=2, sigma_px=1e-9, sigma_axes_px=0.0, sigma_rho=0.0, halves=0.0)
"""A method whose trackers stay where they are, in images of one colour."""
HELPED = BmctConfig(particles=2, sigma_px=1e-9, sigma_axes_px=0.0, sigma_rho=0.0, halves=0.0, restart=False)
"""The same, in views that help each other."""


def moments(n, missing=(), other=()):
    """Moments in which the second view is 5 ns later; (moment, view) without a frame, moments of another colour."""
    for k in range(n):
        there, image = [(k, v) not in missing for v in range(2)], 255 - IMAGE if k in other else IMAGE
        yield FrameSetImages(
            FrameSet(
                100 * k + 5,
                np.array([k if t else -1 for t in there]),
                tuple(image if t else None for t in there),
            ),
            np.array([100 * k + 5 * v if t else -1 for v, t in enumerate(there)]),
            tuple((v, k, "gone") for v in range(2) if not there[v]),
        )


def start(view, frame, target, x=20.0, y=30.0):
    return TrackerStart(view, frame, target, np.array([x, y, 5.0, 4.0, 2.0]))


def tracked(n=6, starts=(), config=STILL, stream=None, missing=(), stage=None, other=(), **more):
    setup = TrackingSetup(VIEWS, BLIND, config, stage or ViewsConfig(), tuple(starts), **more)
    parts = list(track_views(moments(n, missing, other), setup, 1, stream))
    return parts, ViewTracks.concat([part.tracks for part in parts])


def rows(table, *names):
    return list(zip(*(getattr(table, name).tolist() for name in names), strict=True))


def test_the_first_row_is_the_start_with_the_ellipse_that_was_given():
    parts, table = tracked(3, [start(0, 0, 4), start(1, 1, 4, 30.0)], replace(STILL, sigma_px=1.0))
    assert rows(table, "t_ns", "sensor", "frame", "target_id", "lifecycle") == [
        (0, "b", 0, 4, "start"),
        (100, "b", 1, 4, ""),
        (105, "a", 1, 4, "start"),
        (200, "b", 2, 4, ""),
        (205, "a", 2, 4, ""),
    ]
    assert table.x_px[[0, 2]].tolist() == [20.0, 30.0]
    assert np.abs(table.x_px - [20.0, 20.0, 30.0, 20.0, 30.0]).max() < 10.0
    assert (table.x_px[[1, 3, 4]] != [20.0, 20.0, 30.0]).all()
    first = table.take(slice(0, 1))
    assert (first.likelihood_mode[0], first.similarity[0], first.cov_xx_px[0]) == ("", 1.0, 1.0)
    assert np.isnan(first.ess[0])
    np.testing.assert_allclose(first.rho, 2.0 - np.pi)
    assert parts[0].frames.tolist() == [3, 3]


def test_a_start_in_a_frame_that_was_lost_is_in_the_next_one():
    parts, table = tracked(4, [start(0, 1, 4)], missing={(1, 0)})
    assert rows(table, "frame", "lifecycle") == [(2, "start"), (3, "")]
    assert parts[0].lost == ((0, 1, "gone"),)


def test_a_view_without_a_frame_has_no_row():
    parts, table = tracked(4, [start(0, 0, 4), start(1, 0, 4)], missing={(2, 1), (3, 1)})
    assert rows(table.take(table.sensor == "a"), "frame") == [(0,), (1,)]
    assert parts[0].last_ns.tolist() == [300, 105]


def test_rows_are_in_order_by_camera_and_target_and_parts_are_cut_between_moments():
    n = STEPS_PER_PART + 3
    parts, table = tracked(n, [start(v, 0, t, 10 + 20 * t) for v in (0, 1) for t in (2, 0, 1)])
    assert len(parts) == 2
    keys = rows(table, "t_ns", "sensor", "target_id")
    assert keys == sorted(keys)
    assert len(table) == 6 * n


def test_a_tracker_that_was_lost_is_over_and_its_target_may_start_again():
    _, table = tracked(6, [start(0, 0, 4), start(0, 4, 4)], replace(STILL, max_lost_frames=2), other={1, 2})
    assert rows(table, "frame", "lifecycle") == [(0, "start"), (1, ""), (2, "terminated"), (4, "start"), (5, "")]
    # While it is still there nothing starts
    _, table = tracked(3, [start(0, 0, 4), start(0, 1, 4)])
    assert rows(table, "frame", "lifecycle") == [(0, "start"), (1, ""), (2, "")]


def regions(where):
    """Regions of the first view, (time, x) each."""
    if not where:
        return DetectorRegions(np.zeros(0, np.int64), np.empty(0, "U1"), np.zeros((0, 5)), np.zeros(0, bool))
    ellipse = np.array([[x, 30.0, 5.0, 5.0, 0.0] for _, x in where])
    return DetectorRegions(
        np.array([100 * k for k, _ in where]), np.full(len(where), "b"), ellipse, np.ones(len(where), bool)
    )


def test_trackers_are_born_and_ended_by_regions():
    stream = RegionStream(iter([regions([(k, 40.0) for k in range(5)])]), True)
    _, table = tracked(10, stream=stream, stage=ViewsConfig(max_coasting_frames=3), next_id=6)
    assert rows(table, "frame", "target_id", "lifecycle") == [
        (2, 6, "start"),
        (3, 6, ""),
        (4, 6, ""),
        (5, 6, ""),
        (6, 6, ""),
        (7, 6, "terminated"),
    ]


def test_a_tracker_ends_in_a_frame_of_its_view():
    stream = RegionStream(iter([regions([(k, 40.0) for k in range(5)])]), True)
    _, table = tracked(10, stream=stream, stage=ViewsConfig(max_coasting_frames=3), missing={(7, 0)})
    assert rows(table, "frame", "lifecycle") == [(2, "start"), (3, ""), (4, ""), (5, ""), (6, ""), (8, "terminated")]


LEVEL = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
NOTHING = np.full((3, 3), np.nan)
ROWS = ViewGeometry(np.stack([np.stack([NOTHING, LEVEL]), np.stack([LEVEL.T, NOTHING])]), (None, None))
"""Rows of the images are epipolar lines."""


def dropped(starts, missing=(), config=HELPED, **more):
    """Pairs of views whose matrix was dropped, and whether every tracker is without a counterpart at the end."""
    setup = TrackingSetup(VIEWS, ROWS, config, starts=tuple(starts), **more)
    parts = list(track_views(moments(12, missing), setup, 1))
    last = ViewTracks.concat([part.tracks for part in parts])
    alone = bool((last.counterpart[last.t_ns >= 1000] == "none").all())
    return [pair for part in parts for pair in part.dropped], alone


def test_starts_one_after_the_other_tell_of_a_matrix():
    """Three targets on lines 11 px apart; radii are 4.5 px."""
    places = [start(0, 0, t, 15 + 20 * t, 20.0) for t in range(3)]
    wrong = [start(1, 2 + t, t, 15 + 20 * t, 31.0) for t in range(3)]
    assert dropped(places + wrong) == ([(0, 1)], True)
    assert dropped(places + wrong[:2]) == ([], False)
    right = [s._replace(ellipse=places[0].ellipse) for s in wrong]
    assert dropped(places + right) == ([], False)
    assert dropped(places + wrong, config=STILL) == ([], False)
    # A view without a frame for long tells nothing of the births of another
    old = {(k, 0) for k in range(1, 12)}
    assert dropped(places + wrong, old) == ([], False)
    # The last birth is at 405 ns, when the view without frames is 405 ns old: 1.5 periods of 270 ns
    assert dropped(places + wrong, old, period_ns=(270, 1000)) == ([(0, 1)], True)
    assert dropped(places + wrong, old, period_ns=(269, 1000)) == ([], False)


def test_a_region_at_a_tracker_begins_no_other():
    stream = RegionStream(iter([regions([(k, 22.0) for k in range(9)])]), True)
    _, table = tracked(9, [start(0, 0, 1)], stream=stream, next_id=2)
    assert set(table.target_id.tolist()) == {1}


def test_nothing_to_track_gives_no_rows():
    parts, table = tracked(3)
    assert len(table) == 0
    assert parts[0].frames.tolist() == [3, 3]


def test_one_random_stream_and_equal_bytes_for_equal_seeds():
    first, second = (tracked(5, [start(0, 0, 1)])[1] for _ in range(2))
    for c in ViewTracks.columns():
        np.testing.assert_array_equal(getattr(first, c.name), getattr(second, c.name))


def test_identities_below_0_are_refused():
    _, table = tracked(2, [start(0, 0, 1)])
    columns = {c.name: getattr(table, c.name) for c in ViewTracks.columns()}
    with pytest.raises(InputError, match=r"ViewTracks: row 1: target_id -7 must be at least 0"):
        ViewTracks.of(**columns | {"target_id": np.array([1, -7])})
