"""Status of counterparts from loop check to loop check."""

from dataclasses import replace

import numpy as np
import pytest
from view_states import BLIND, BLUE, RED, ROWS, changed, disc, painted, state_of

from occlog.track.methods.images.interface import BAD, GOOD, NONE
from occlog.track.methods.images.methods.config import BmctConfig, CmctConfig
from occlog.track.methods.images.methods.restart import (
    assisting_views,
    check_loops,
    check_new_pairs,
    counterpart_status,
)

ONE, TWO = disc(40.0, 40.0), disc(80.0, 60.0)
BOTH = painted((ONE, RED), (TWO, BLUE))
FEW = BmctConfig(particles=2, bad_after=3, good_after=2)
FRESH = np.ones(3, dtype=bool)


def trio(config=FEW, row=40.0, geometry=ROWS):
    """A target in both views, in row 40 of view a and in such a row of view b; another one in view a only."""
    return state_of(config, [(0, 1, ONE), (0, 2, TWO), (1, 1, disc(70.0, row))], (BOTH, BOTH), geometry)


def put(state, row):
    """The state with the tracker of view b in another row."""
    estimate = state.trackers.estimate.copy()
    estimate[2, 1] = row
    return changed(state, estimate=estimate)


def checked(state, times, row):
    """The state after so many loop checks with the tracker of view b in this row."""
    state = put(state, row)
    for _ in range(times):
        state = state._replace(trackers=check_loops(state, FEW, FRESH))
    return state


@pytest.mark.parametrize(("row", "status"), [(40.0, GOOD), (48.0, GOOD), (48.001, BAD), (32.0, GOOD), (31.999, BAD)])
def test_the_first_check_decides_at_once_up_to_a_radius(row, status):
    assert counterpart_status(trio(row=row).trackers).tolist() == [status, NONE, status]


def test_a_good_counterpart_is_bad_after_so_many_failed_checks_in_a_row():
    state = trio()
    assert counterpart_status(checked(state, 2, 60.0).trackers)[0] == GOOD
    assert counterpart_status(checked(state, 3, 60.0).trackers)[0] == BAD
    # A check that holds in between starts the count again
    again = checked(checked(checked(state, 2, 60.0), 1, 40.0), 2, 60.0)
    assert counterpart_status(again.trackers)[0] == GOOD


def test_a_bad_counterpart_is_good_after_so_many_checks_that_hold():
    bad = checked(trio(), 3, 60.0)
    assert counterpart_status(checked(bad, 1, 40.0).trackers)[0] == BAD
    good = checked(bad, 2, 40.0).trackers
    assert counterpart_status(good).tolist() == [GOOD, NONE, GOOD]
    assert not good.streak.any()


@pytest.mark.parametrize("old", [0, 2])
def test_an_estimate_that_is_old_is_not_checked(old):
    state, fresh = put(trio(), 60.0), FRESH.copy()
    fresh[old] = False
    for _ in range(5):
        state = state._replace(trackers=check_loops(state, FEW, fresh))
    assert counterpart_status(state.trackers)[0] == GOOD
    assert assisting_views(state.trackers, fresh).tolist() == [
        [-1, 2 if old != 2 else -1],
        [-1, -1],
        [-1 if not old else 0, -1],
    ]


def test_pairs_that_were_checked_before_stay_as_they_are_when_new_pairs_are_checked():
    state = put(trio(), 60.0)
    after = check_new_pairs(state, FEW)
    assert after.good.tolist() == state.trackers.good.tolist()
    assert not after.streak.any()


def test_without_a_matrix_there_is_no_counterpart_that_can_be_checked():
    assert counterpart_status(trio(geometry=BLIND).trackers).tolist() == [NONE] * 3


def test_people_are_compared_by_their_lowest_points():
    """Ellipses of unequal height with the feet in one row, whose centres are 13 px apart."""
    tall, short = np.array([40.0, 40.0, 6.0, 20.0, 0.0]), np.array([70.0, 53.0, 4.0, 7.0, 0.0])
    births = [(0, 1, tall), (1, 1, short)]
    for config, status in ((CmctConfig(particles=2), BAD), (CmctConfig(particles=2, anchor="bottom"), GOOD)):
        state = state_of(replace(config, halves=0.0), births, (BOTH, BOTH))
        assert counterpart_status(state.trackers).tolist() == [status] * 2
