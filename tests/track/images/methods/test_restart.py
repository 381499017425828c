"""When a tracker restarts on an epipolar line, and where."""

from dataclasses import replace

import numpy as np
import pytest
from view_states import BLUE, RED, ROWS, H, W, changed, disc, frames_at, painted, state_of

from occlog.core.image import nearness
from occlog.track.methods.images.methods.config import BmctConfig
from occlog.track.methods.images.methods.restart import EVERY, OCCLUSION_RADII, SAME_TARGET_RADII, nearest, restart_one

ONE, TWO = disc(30.0, 40.0), disc(80.0, 44.0)
IMAGE = painted((ONE, RED), (TWO, BLUE))
CONFIG = BmctConfig(particles=4, restart_similarity=0.85)


def hijacked(config=CONFIG, at=TWO, births=None, image=IMAGE):
    """Trackers of two targets in both views; in view a that of the first is elsewhere, with bad counterparts."""
    state = state_of(config, births or [(0, 1, ONE), (0, 2, TWO), (1, 1, ONE), (1, 2, TWO)], (image, image))
    t = state.trackers
    estimate, good = t.estimate.copy(), t.good.copy()
    estimate[0, :2] = at[:2]
    good[0, 1] = good[2, 0] = False
    moving = {"velocity": np.ones_like(t.velocity), "path": np.ones_like(t.path), "weak": np.full(len(t.view), 3)}
    return changed(state, estimate=estimate, good=good, streak=np.where(t.checked, 2, 0), **moving)


def restarted(state, number=EVERY, images=(IMAGE, IMAGE)):
    """Rows of the trackers that are in other places after it, and the state."""
    after = restart_one(state, state.config, frames_at(1, *images, number=number))
    moved = (after.trackers.estimate != state.trackers.estimate).any(axis=1)
    return np.flatnonzero(moved).tolist(), after


def test_a_hijacked_tracker_goes_to_its_target_on_the_line_and_is_at_rest():
    state = hijacked()
    moved, after = restarted(state)
    assert moved == [0]
    t = after.trackers
    # On row 40, the line of the counterpart, at one of the places 2 px apart
    assert t.estimate[0, 1] == pytest.approx(40.0, abs=1e-9)
    assert abs(t.estimate[0, 0] - 30.0) <= 1.0
    np.testing.assert_array_equal(t.estimate[0, 2:], state.trackers.axes[0])
    np.testing.assert_array_equal(t.particles[0], np.repeat(t.estimate[:1], 4, axis=0))
    assert not t.velocity[0].any()
    assert not t.path[0].any()
    assert t.weak.tolist() == [0, 3, 3, 3]
    # Its counterparts are bad until checks in a row say otherwise; the other pair is left alone
    assert t.good.tolist() == [[False, False], [False, True], [False, False], [True, False]]
    assert t.streak.tolist() == [[0, 0], [0, 2], [0, 0], [2, 0]]
    assert t.checked.tolist() == state.trackers.checked.tolist()


def test_arguments_are_left_alone():
    state = hijacked()
    kept = [np.array(field) for field in state.trackers]
    restarted(state)
    assert all(np.array_equal(a, b) for a, b in zip(kept, state.trackers, strict=True))


@pytest.mark.parametrize("number", [EVERY - 1, EVERY + 1, 2 * EVERY - 1])
def test_places_are_tried_in_every_fifth_frame(number):
    assert restarted(hijacked(), number)[0] == []
    assert restarted(hijacked(), 2 * EVERY)[0] == [0]
    assert restarted(hijacked(), 0)[0] == [0]


def test_without_the_setting_or_a_bad_counterpart_or_a_frame_nothing_restarts():
    assert restarted(hijacked(replace(CONFIG, restart=False)))[0] == []
    state = hijacked()
    good = state.trackers.good.copy()
    good[0, 1] = True
    assert restarted(changed(state, good=good))[0] == []
    unchecked = np.zeros_like(state.trackers.checked)
    assert restarted(changed(state, checked=unchecked, good=unchecked))[0] == []
    assert restarted(state, images=(None, IMAGE))[0] == []


@pytest.mark.parametrize(
    ("radii", "similarities", "wrong"),
    [
        (SAME_TARGET_RADII, 0.85, False),
        (SAME_TARGET_RADII - 1e-9, 0.85, True),
        (2.0, 0.85, False),
        (2.0, np.nextafter(0.85, 0.0), True),
        (SAME_TARGET_RADII, np.nextafter(0.85, 0.0), True),
    ],
)
def test_a_tracker_is_wrong_on_another_one_or_on_something_of_other_colours(radii, similarities, wrong):
    state = hijacked(at=disc(80.0 - 16.0 * radii, 44.0))
    state = changed(state, similarities=np.array([similarities, 1.0, 1.0, 1.0]))
    assert restarted(state)[0] == ([0] if wrong else [])


@pytest.mark.parametrize(
    ("radii", "similarities", "guides"),
    [
        (2.0, 0.85, True),
        (2.0, np.nextafter(0.85, 0.0), False),
        (OCCLUSION_RADII, 1.0, False),
        (OCCLUSION_RADII + 1e-9, 1.0, True),
    ],
)
def test_a_counterpart_guides_when_it_is_clear_of_others_and_looks_right(radii, similarities, guides):
    state = hijacked()
    estimate = state.trackers.estimate.copy()
    estimate[3, :2] = estimate[2, :2] + [16.0 * radii, 0.0]
    state = changed(state, estimate=estimate, similarities=np.array([1.0, 1.0, similarities, 1.0]))
    assert restarted(state)[0] == ([0] if guides else [])


def test_nothing_restarts_where_fewer_than_half_of_the_pairs_of_the_views_are_good():
    """Then it may be the geometry that is wrong.  One of two is good at first; one of three is not half."""
    assert restarted(hijacked())[0] == [0]
    third = disc(60.0, 75.0)
    births = [(v, k, e) for v in (0, 1) for k, e in enumerate((ONE, TWO, third))]
    state = hijacked(births=births)
    assert restarted(state)[0] == [0]
    good = state.trackers.good.copy()
    good[2, 1] = good[5, 0] = False
    assert restarted(changed(state, good=good))[0] == []


def test_no_place_is_good_where_nothing_looks_like_the_target():
    gone = painted((TWO, BLUE))
    assert restarted(hijacked(), images=(gone, IMAGE))[0] == []


@pytest.mark.parametrize(("radii", "off"), [(0.2, None), (SAME_TARGET_RADII - 1e-9, 2.0), (SAME_TARGET_RADII, 0.0)])
def test_a_place_nearer_than_that_to_another_tracker_does_not_count(radii, off):
    """A third tracker stands below the target; places are 2 px apart, and one is at the target itself."""
    third = disc(30.0, 40.0 + 16.0 * radii)
    births = [(0, 1, ONE), (0, 2, TWO), (0, 3, third), (1, 1, ONE), (1, 2, TWO)]
    state = state_of(CONFIG, births, (IMAGE, IMAGE))
    estimate, good = state.trackers.estimate.copy(), state.trackers.good.copy()
    estimate[0, :2] = TWO[:2]
    good[0, 1] = good[3, 0] = False
    moved, after = restarted(changed(state, estimate=estimate, good=good))
    assert moved == ([] if off is None else [0])
    if off is not None:
        assert abs(after.trackers.estimate[0, 0] - 30.0) == pytest.approx(off)
        assert nearness(after.trackers.estimate[:3])[0, 2] >= SAME_TARGET_RADII - 1e-9


def test_the_line_is_tried_through_the_whole_image_and_not_beyond():
    for x in (9.0, W - 10.0):
        target = disc(x, 40.0)
        image = painted((target, RED), (TWO, BLUE))
        births = [(0, 1, target), (0, 2, TWO), (1, 1, target), (1, 2, TWO)]
        state = hijacked(births=births, image=image)
        after = restarted(state, images=(image, image))[1].trackers
        assert abs(after.estimate[0, 0] - x) <= 1.0
    # A line that does not meet the image
    above = ROWS._replace(fundamental=ROWS.fundamental.copy())
    above.fundamental[1, 0] = [[0, 0, 0], [0, 0, 1.0], [0, -1.0, -2.0 * H]]
    assert restarted(hijacked()._replace(geometry=above))[0] == []


def test_the_nearest_tracker_is_one_of_the_same_view():
    t = state_of(CONFIG, [(0, 1, ONE), (0, 2, disc(62.0, 40.0)), (1, 1, ONE)], (IMAGE, IMAGE)).trackers
    np.testing.assert_allclose(nearest(t), [2.0, 2.0, np.inf])
