"""Births from regions, whose target they are, and the ends of trackers without support."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.epipolar.views import TrackedView, ViewGeometry
from occlog.records.tables import Boxes
from occlog.track.methods.images.initiation.births import (
    anchors,
    empty_candidates,
    initiate_and_terminate,
    loop_distances,
)
from occlog.track.methods.images.initiation.config import ViewsConfig
from occlog.track.methods.images.initiation.regions import DetectorRegions, RegionStream, regions_of_boxes

VIEWS = (TrackedView("a", 320, 240), TrackedView("b", 320, 240))
LEVEL = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rows of the images are epipolar lines: y is the same in both views."""
ROWS = ViewGeometry(
    np.stack([np.stack([np.full((3, 3), np.nan), LEVEL]), np.stack([LEVEL.T, np.full((3, 3), np.nan)])]), (None, None)
)
BLIND = ViewGeometry(np.full((2, 2, 3, 3), np.nan), (None, None))


def disc(x, y, r=10.0):
    return np.array([x, y, r, r, 0.0])


def rows(*ellipses):
    return np.array(ellipses).reshape(-1, 5)


def live(regions, config=None, geometry=ROWS, trackers=None, moments=10):
    """Births by time, where trackers stay where they were born."""
    config, trackers, state = config or ViewsConfig(), dict(trackers or {}), empty_candidates(2)
    births, ends = [], []
    for k in range(moments):
        state, initiated, ended = initiate_and_terminate(state, regions(k), trackers, VIEWS, geometry, config)
        births += [(k, b.view, b.target_id, b.ellipse[0]) for b in initiated]
        ends += [(k, key) for key in ended]
        trackers |= {(b.view, b.target_id): b.ellipse for b in initiated}
        for key in ended:
            del trackers[key]
    return births, ends


def test_a_region_seen_three_times_in_a_row_begins_a_tracker_once():
    births, ends = live(lambda k: [rows(disc(50 + k, 60)), rows()], ViewsConfig(max_coasting_frames=0))
    assert births == [(2, 0, 0, 52.0)]
    assert not ends


def test_a_region_that_flickers_does_not():
    births, _ = live(lambda k: [rows(disc(50, 60)) if k % 3 else rows(), rows()])
    assert not births


def test_frames_that_no_one_looked_at_do_not_count():
    births, _ = live(lambda k: [None if k in (1, 2, 3) else rows(disc(50, 60)), None])
    assert births == [(5, 0, 0, 50.0)]


def test_regions_at_trackers_cut_by_the_edge_or_too_small_begin_none():
    tracked = {(0, 7): disc(50, 60)}
    both = lambda k: [rows(disc(56, 60), disc(8, 100), disc(150, 100, 3.0), disc(310, 200)), rows()]  # noqa: E731
    assert not live(both, trackers=tracked)[0]
    births, _ = live(both, ViewsConfig(birth_allow_truncated=True), trackers=tracked)
    assert [b[3] for b in births] == [8.0, 310.0]


@pytest.mark.parametrize(
    ("region", "begins"),
    [
        (disc(150, 100, 4.0), True),
        (disc(150, 100, 4.0 - 1e-9), False),
        (disc(10.5, 100), True),
        (disc(10.5 - 1e-9, 100), False),
        (disc(320 - 1.5 - 10, 100), True),
        (disc(320 - 1.5 - 10 + 1e-9, 100), False),
        (disc(150, 240 - 1.5 - 10 + 1e-9), False),
        (disc(62.0 - 1e-9, 60), False),
        (disc(62.0 + 1e-9, 60), True),
    ],
)
def test_limits_of_size_edge_and_distance_from_trackers(region, begins):
    """Half width 4 px; 1 px from the outer edge of the image; 0.6 sums of radii from the tracker at (50, 60)."""
    births, _ = live(lambda k: [rows(region), rows()], trackers={(0, 7): disc(50, 60)})
    assert len(births) == begins


@pytest.mark.parametrize(("frames", "begins"), [(1, [0]), (4, [3])])
def test_a_tracker_begins_in_the_last_of_the_frames_in_a_row(frames, begins):
    births, _ = live(
        lambda k: [rows(disc(50, 60)), rows()], ViewsConfig(confirmation_frames=frames, max_coasting_frames=0)
    )
    assert [b[0] for b in births] == begins


def test_no_tracker_begins_with_no_birth_frames():
    assert live(lambda k: [rows(disc(50, 60)), rows()], ViewsConfig(confirmation_frames=0)) == ([], [])


def test_births_in_two_views_on_one_line_are_one_target():
    births, _ = live(lambda k: [rows(disc(50, 60), disc(90, 150)), rows(disc(200, 152), disc(20, 58))])
    named = {(view, x): target for _, view, target, x in births}
    assert len(births) == 4
    assert named[0, 50.0] == named[1, 20.0]
    assert named[0, 90.0] == named[1, 200.0]
    assert named[0, 50.0] != named[0, 90.0]


def test_a_view_that_sees_it_later_joins_its_target():
    births, _ = live(lambda k: [rows(disc(50, 60)), rows(disc(200, 60)) if k > 4 else rows()])
    assert births == [(2, 0, 0, 50.0), (7, 1, 0, 200.0)]


def test_a_target_whose_tracker_ended_in_this_moment_begins_in_the_next():
    state, there = empty_candidates(2, 1), {(0, 0): disc(50, 60)}
    for k in range(4):
        gone = {(1, 0)} if k == 2 else ()
        both = [rows(disc(50, 60)), rows(disc(90, 60))]
        state, initiated, _ = initiate_and_terminate(state, both, there, VIEWS, ROWS, ViewsConfig(), gone=gone)
        assert [(b.view, b.target_id) for b in initiated] == ([(1, 0)] if k == 3 else [])


def test_without_geometry_or_off_the_line_each_view_has_its_own_targets():
    together = lambda k: [rows(disc(50, 60)), rows(disc(200, 60))]  # noqa: E731
    assert {b[2] for b in live(together, geometry=BLIND)[0]} == {0, 1}
    assert {b[2] for b in live(lambda k: [rows(disc(50, 60)), rows(disc(200, 75))])[0]} == {0, 1}


def test_one_that_may_be_either_waits_and_then_takes_the_clearly_better():
    def regions(k):
        return [rows(disc(50, 60), disc(120, 67)), rows(disc(200, 60.5))]

    births, _ = live(regions, moments=20)
    assert births[2] == (14, 1, 0, 200.0)  # 3 frames and 12 more
    unclear, _ = live(lambda k: [rows(disc(50, 60), disc(120, 67)), rows(disc(200, 63))], moments=20)
    assert unclear[2] == (14, 1, 2, 200.0)


@pytest.mark.parametrize(("row", "target"), [(62.0, 0), (62.0 + 1e-6, 2)])
def test_the_best_fit_is_clear_up_to_half_of_the_second_one(row, target):
    """Targets in rows 60 and 66, radii of 8 px: the region is 2 px from one line and 4 px from the other."""
    births, _ = live(lambda k: [rows(disc(50, 60, 8.0), disc(120, 66, 8.0)), rows(disc(200, row, 8.0))], moments=20)
    assert births[2][1:3] == (1, target)


@pytest.mark.parametrize(("step", "begins"), [(20.0, True), (20.0 + 1e-6, False)])
def test_a_region_is_followed_while_it_touches_that_of_the_frame_before(step, begins):
    births, _ = live(lambda k: [rows(disc(50 + step * k, 60)), rows()], moments=3)
    assert len(births) == begins


def test_the_one_that_moves_off_the_line_is_reported_by_its_way():
    # Both fit at the end, but only one did in all three frames
    def regions(k):
        return [rows(disc(50, 60), disc(120, 100 - 13 * k)), rows(disc(200, 60)) if k > 0 else rows()]

    births, _ = live(regions, ViewsConfig(max_coasting_frames=0), moments=5)
    assert [b[1:3] for b in births if b[1] == 1] == [(1, births[0][2])]


def test_a_tracker_without_a_region_for_long_ends():
    tracked = {(0, 7): disc(50, 60), (1, 7): disc(50, 60)}
    _, ends = live(
        lambda k: [rows(disc(200, 60)), None],
        ViewsConfig(max_coasting_frames=4, confirmation_frames=99),
        trackers=tracked,
    )
    assert ends == [(3, (0, 7))]
    _, ends = live(
        lambda k: [rows(disc(65, 60)), rows()],
        ViewsConfig(max_coasting_frames=4, confirmation_frames=99),
        trackers=tracked,
    )
    assert ends == [(3, (1, 7))]
    assert not live(lambda k: [rows(), rows()], ViewsConfig(max_coasting_frames=0), trackers=tracked)[1]


def test_loop_distances_are_the_larger_of_both_in_radii():
    a, b = rows(disc(10, 60), disc(10, 60)), rows(disc(90, 75, 5.0), disc(0, 60))
    np.testing.assert_allclose(loop_distances(ROWS, 0, 1, a, b), [3.0, 0.0], atol=1e-12)


def box_rows(*values):
    t, sensor, box, left, confidence = zip(*values, strict=True)
    n = len(t)
    return Boxes.of(
        t_ns=np.array(t),
        sensor=list(sensor),
        frame=np.zeros(n, np.int64),
        box=np.array(box, np.int32),
        target_id=np.full(n, -1, np.int32),
        left_px=np.array(left),
        top_px=np.full(n, 5.0),
        width_px=np.full(n, 4.0),
        height_px=np.full(n, 6.0),
        confidence=np.array(confidence),
    )


def test_feed_gives_the_regions_of_a_frame_and_knows_who_looked():
    table = box_rows(
        (10, "a", 0, 1.0, 0.9),
        (10, "a", 1, 2.0, 0.1),
        (10, "b", -1, np.nan, np.nan),
        (20, "a", 0, 3.0, np.nan),
        (30, "c", 0, 4.0, 0.9),
        (40, "a", 0, 5.0, 0.9),
    )
    stream = RegionStream(regions_of_boxes(iter([table.take(slice(0, 2)), table.take(slice(2, 6))]), 0.3), False)
    first, second = stream.at(("a", "b"), np.array([10, 10]))
    np.testing.assert_allclose(first, [[3.0, 8.0, 2.0, 3.0, 0.0]])
    assert second.shape == (0, 5)
    assert stream.at(("a", "b"), np.array([30, -1])) == [None, None]
    assert stream.at(("a", "b"), np.array([40, 41]))[0].shape == (1, 5)
    assert stream.at(("a", "b"), np.array([99, 99])) == [None, None]
    assert (stream.read, stream.met) == (4, 2)


def test_a_sparse_feed_takes_frames_without_rows_for_looked_at():
    region = DetectorRegions(np.array([10]), np.array(["a"]), rows(disc(1, 2)), np.array([True]))
    stream = RegionStream(iter([region]), True)
    found = stream.at(("a", "b"), np.array([10, -1]))
    assert found[0].shape == (1, 5)
    assert found[1] is None
    assert stream.at(("a", "b"), np.array([20, 20]))[1].shape == (0, 5)


@pytest.mark.parametrize(
    ("name", "value"), [("confirmation_frames", -1), ("birth_min_confidence", 1.5), ("birth_min_distance", 0.0)]
)
def test_settings_have_limits(name, value):
    with pytest.raises(Exception, match=name):
        ViewsConfig(**{name: value})


def test_no_tracker_begins_where_none_is_wanted_but_they_end():
    config = ViewsConfig(confirmation_frames=0, max_coasting_frames=4)
    births, ends = live(lambda k: [rows(disc(200, 60)), rows()], config, trackers={(0, 7): disc(50, 60)})
    assert not births
    assert ends == [(3, (0, 7))]


@pytest.mark.parametrize("rho", [-1.5, -0.7, 0.0, 0.4, 1.2])
def test_the_bottom_is_the_lowest_point_of_an_ellipse(rho):
    turn = np.linspace(0, 2 * np.pi, 100_001)
    along, across = 20 * np.cos(turn), 7 * np.sin(turn)
    x, y = 50 + along * np.cos(rho) - across * np.sin(rho), 60 + along * np.sin(rho) + across * np.cos(rho)
    ellipse = np.array([[50.0, 60.0, 20.0, 7.0, rho]])
    np.testing.assert_allclose(anchors(ellipse, True)[0], [x[y.argmax()], y.max()], atol=0.01)
    np.testing.assert_array_equal(anchors(ellipse, False), [[50.0, 60.0]])


def test_people_are_joined_by_their_feet():
    """Of ellipses with feet on one line and middles far apart."""
    short, tall = np.array([50.0, 100.0, 5.0, 10.0, 0.0]), np.array([80.0, 70.0, 8.0, 40.0, 0.0])
    assert loop_distances(ROWS, 0, 1, short[None], tall[None], True)[0] < 1e-9
    for bottom, targets in ((False, 2), (True, 1)):
        state, initiated = empty_candidates(2), ()
        for _ in range(3):
            state, initiated, _ = initiate_and_terminate(
                state, [rows(short), rows(tall)], {}, VIEWS, ROWS, ViewsConfig(), bottom
            )
        assert len({b.target_id for b in initiated}) == targets
