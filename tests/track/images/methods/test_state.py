"""Trackers are added, paired, removed; clocks of views that do not all have a frame."""

import numpy as np
import pytest
from view_states import (
    BLIND,
    BLUE,
    LEVEL,
    PERIOD_NS,
    RED,
    ROWS,
    UNKNOWN,
    VIEWS,
    changed,
    disc,
    frames_at,
    painted,
    state_of,
)

from occlog.measure.epipolar.views import ViewGeometry
from occlog.track.methods.images.interface import Birth
from occlog.track.methods.images.kernels.appearance import colour_similarity
from occlog.track.methods.images.methods.config import BmctConfig, IdmotConfig, MipfConfig
from occlog.track.methods.images.methods.state import (
    INTERVALS,
    LONGEST,
    FrameClock,
    add_trackers,
    advance_clock,
    ages,
    end_trackers,
    gaps,
    initial_state,
    keep_trackers,
    keys_of,
    with_geometry,
)

LEFT, RIGHT = disc(40.0, 40.0), disc(80.0, 60.0)
BOTH = painted((LEFT, RED), (RIGHT, BLUE))
FOUR = [(0, 1, LEFT), (0, 2, RIGHT), (1, 1, LEFT), (1, 2, RIGHT)]
FEW = BmctConfig(particles=6)


def four():
    return state_of(FEW, FOUR, (BOTH, BOTH))


def test_a_new_state_has_no_trackers_and_paths_as_long_as_the_memory():
    assert initial_state(VIEWS, BLIND, MipfConfig(particles=7)).trackers.particles.shape == (0, 7, 5)
    for memory in (1, 8):
        state = initial_state(VIEWS, BLIND, IdmotConfig(memory=memory))
        state = add_trackers(state, frames_at(0, BOTH, None), [Birth(0, 1, LEFT)])
        assert state.trackers.path.shape == (1, memory, 2)


def test_a_matrix_known_one_way_serves_the_other_way_transposed():
    one_way = ViewGeometry(np.array([[UNKNOWN, LEVEL + 1.0], [UNKNOWN, UNKNOWN]]), (None, None))
    matrices = initial_state(VIEWS, one_way, FEW).geometry.fundamental
    np.testing.assert_array_equal(matrices[1, 0], (LEVEL + 1.0).T)
    np.testing.assert_array_equal(matrices[0, 1], LEVEL + 1.0)
    assert np.isnan(matrices[[0, 1], [0, 1]]).all()


def test_trackers_are_ordered_by_view_and_target_and_paired():
    state = state_of(FEW, [FOUR[3], FOUR[0], FOUR[2], FOUR[1], (1, 7, disc(20.0, 20.0))], (BOTH, BOTH))
    t = state.trackers
    assert keys_of(t) == [(0, 1), (0, 2), (1, 1), (1, 2), (1, 7)]
    assert t.counterpart.tolist() == [[-1, 2], [-1, 3], [0, -1], [1, -1], [-1, -1]]


def test_a_new_tracker_is_at_its_ellipse_at_rest_and_looks_like_its_target():
    t = four().trackers
    np.testing.assert_array_equal(t.particles, np.repeat(t.estimate[:, None], 6, axis=1))
    np.testing.assert_array_equal(t.estimate[:, :4], np.array([LEFT, RIGHT, LEFT, RIGHT])[:, :4])
    np.testing.assert_array_equal(t.axes, t.estimate[:, 2:])
    assert not t.velocity.any()
    assert not t.path.any()
    assert not t.weak.any()
    assert (t.similarities == 1.0).all()
    np.testing.assert_allclose(t.colours.sum(axis=1), 1.0)


def test_births_replace_trackers_of_the_same_view_and_target():
    state = four()
    again = add_trackers(state, frames_at(1, BOTH, BOTH), [Birth(0, 1, RIGHT)])
    assert keys_of(again.trackers) == keys_of(state.trackers)
    np.testing.assert_array_equal(again.trackers.estimate[0], RIGHT)
    # The pair of the new tracker has not been checked; the other pair keeps its status.
    assert again.trackers.checked.tolist() == [[False, False], [False, True], [False, False], [True, False]]
    assert again.trackers.good.tolist() == again.trackers.checked.tolist()
    assert add_trackers(state, frames_at(1, BOTH, BOTH), []) is state


def test_a_birth_in_a_view_without_a_frame_is_an_error():
    with pytest.raises(ValueError, match="view 1 has no frame"):
        add_trackers(four(), frames_at(1, BOTH, None), [Birth(1, 3, LEFT)])


@pytest.mark.parametrize(("rows", "similarities"), [(slice(32, 40), 1.0), (slice(32, 49), 1.0), (slice(32, 34), None)])
def test_colours_of_a_masked_target_are_wholly_alike_where_as_much_of_it_is_left(rows, similarities):
    """Half of the ellipse is masked at birth; later the rows of `rows` are left."""
    mask, later = (np.zeros((90, 120), dtype=np.uint8) for _ in range(2))
    mask[32:40], later[rows] = 1, 1
    plain, config = painted((disc(40.0, 40.0, 30.0), RED)), MipfConfig(particles=2, halves=0.0, pixel_step=1)
    state = initial_state(VIEWS, BLIND, config)
    state = add_trackers(state, frames_at(0, plain, None, masks=(mask, None)), [Birth(0, 1, LEFT)])
    other = add_trackers(state, frames_at(1, plain, None, masks=(later, None)), [Birth(0, 2, LEFT)])
    share = [1.0 / t.colours.sum() for t in (state.trackers, keep_trackers(other, np.array([False, True])).trackers)]
    bins = other.bins[0]
    found = colour_similarity(bins, LEFT[None], np.zeros(1, int), state.trackers.colours, np.zeros(1, bool), 1)[0]
    assert found == pytest.approx(similarities if similarities is not None else np.sqrt(share[1] / share[0]))


def test_removed_trackers_are_forgotten_and_other_keys_change_nothing():
    state = changed(four(), streak=np.array([[0, 3], [0, 4], [5, 0], [6, 0]]))
    assert end_trackers(state, [(0, 9), (1, 7)]) is state
    after = end_trackers(state, [(0, 1)]).trackers
    assert keys_of(after) == [(0, 2), (1, 1), (1, 2)]
    assert after.counterpart.tolist() == [[-1, 2], [-1, -1], [0, -1]]
    assert after.streak.tolist() == [[0, 4], [0, 0], [6, 0]]
    assert after.good.tolist() == [[False, True], [False, False], [True, False]]
    assert len(keep_trackers(state, np.zeros(4, dtype=bool)).trackers.view) == 0


def clock(last, *intervals):
    """Clock of one view, times and intervals in frame periods."""
    known = np.full((1, INTERVALS), np.nan)
    known[0, len(known[0]) - len(intervals) :] = np.array(intervals) * PERIOD_NS
    return FrameClock(np.array([last * PERIOD_NS if last >= 0 else -1]), known)


def test_age_is_counted_in_the_median_of_the_last_intervals():
    assert ages(clock(4, 2.0, 2.0, 9.0), 7 * PERIOD_NS) == 1.5
    # Of an even number the upper one of the two in the middle counts
    assert ages(clock(4, 1.0, 3.0), 7 * PERIOD_NS) == 1.0
    assert ages(clock(4), 99 * PERIOD_NS) == 1.0
    assert ages(clock(-1, 2.0), 99 * PERIOD_NS) == 1.0


@pytest.mark.parametrize(
    ("age", "gap"), [(0.2, 1.0), (1.4, 1.0), (1.6, 2.0), (9.4, 9.0), (LONGEST, LONGEST), (LONGEST + 0.6, LONGEST)]
)
def test_gaps_are_whole_frames_from_one_to_the_longest(age, gap):
    assert gaps(clock(0, 1.0), round(age * PERIOD_NS)) == gap


def test_clocks_take_in_frames_once_and_only_of_views_that_have_one():
    state = initial_state(VIEWS, BLIND, FEW)
    for period in range(INTERVALS + 3):
        state = advance_clock(state, frames_at(period, BOTH, BOTH if period % 2 else None))
        again = advance_clock(state, frames_at(period, BOTH, BOTH))
        np.testing.assert_array_equal(again.clock.t_ns[0], state.clock.t_ns[0])
        np.testing.assert_array_equal(again.clock.interval_ns[0], state.clock.interval_ns[0])
    assert state.clock.t_ns.tolist() == [(INTERVALS + 2) * PERIOD_NS] * 2
    assert (state.clock.interval_ns[0] == PERIOD_NS).all()
    known = state.clock.interval_ns[1][np.isfinite(state.clock.interval_ns[1])]
    assert known.tolist() == [2 * PERIOD_NS] * 5


def test_counterparts_stay_good_until_the_matrix_is_gone_both_ways():
    state = changed(four(), streak=np.array([[0, 3], [0, 4], [5, 0], [6, 0]]))
    one_way = ROWS._replace(fundamental=np.array([[UNKNOWN, UNKNOWN], [LEVEL.T, UNKNOWN]]))
    kept = with_geometry(state, one_way)
    np.testing.assert_array_equal(kept.trackers.good, state.trackers.good)
    np.testing.assert_array_equal(kept.trackers.streak, state.trackers.streak)
    np.testing.assert_array_equal(kept.geometry.fundamental[0, 1], LEVEL)
    blind = with_geometry(state, BLIND).trackers
    assert not blind.good.any()
    assert not blind.checked.any()
    assert not blind.streak.any()
    np.testing.assert_array_equal(blind.counterpart, state.trackers.counterpart)
