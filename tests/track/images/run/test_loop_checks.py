"""Loop checks of targets that stand free, and matrices that the first targets contradict."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.measure.epipolar.views import ViewGeometry
from occlog.track.methods.images.interface import Birth, TrackerOutlines
from occlog.track.methods.images.run.stage import check_births, check_outlines, drop_contradicted, gather, no_checks

LEVEL = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
NOTHING = np.full((3, 3), np.nan)
ROWS = ViewGeometry(np.stack([np.stack([NOTHING, LEVEL]), np.stack([LEVEL.T, NOTHING])]), (None, None))


def births(*rows):
    return [Birth(view, target, np.array([x, y, 10.0, 10.0, 0.0])) for view, target, x, y in rows]


def outlines(made):
    n = len(made)
    zeros = np.zeros(n, dtype=np.int64)
    return TrackerOutlines(
        np.array([b.view for b in made]),
        np.array([b.target_id for b in made]),
        np.array([b.ellipse for b in made]),
        np.ones((n, 3)),
        np.ones(n),
        np.ones(n),
        zeros,
        zeros,
        np.zeros((n, n), dtype=bool),
        np.zeros((n, 2), dtype=bool),
        zeros,
    )


def test_distance_is_in_radii_and_pixels_of_targets_in_both_views():
    made = births((0, 1, 50, 60), (1, 1, 200, 72), (0, 2, 90, 200), (1, 3, 90, 200))
    for checks in (check_births(made, ROWS), check_outlines(outlines(made), ROWS)):
        assert checks.first.tolist() == [0.0]
        assert checks.second.tolist() == [1.0]
        np.testing.assert_allclose(checks.radii, [1.2])
        np.testing.assert_allclose(checks.px, [12.0])


def test_targets_that_touch_another_do_not_count():
    made = births((0, 1, 50, 60), (0, 2, 65, 60), (1, 1, 200, 60), (1, 2, 100, 60), (0, 3, 200, 200), (1, 3, 20, 200))
    assert len(check_births(made, ROWS).radii) == 1


def test_nothing_to_check():
    assert len(check_births([], ROWS).radii) == 0
    assert len(gather([no_checks(), no_checks()]).px) == 0
    blind = ViewGeometry(np.full((2, 2, 3, 3), np.nan), (None, None))
    assert len(check_births(births((0, 1, 50, 60), (1, 1, 200, 60)), blind).radii) == 0


def wrong(*targets):
    """Births on lines that are 1.5 radii apart."""
    return births(*[(v, k, 50 * k + 20, 40 * k + 30 + 15 * v) for k in targets for v in (0, 1)])


def test_a_matrix_that_most_starts_contradict_is_not_used():
    good = births(*[(v, k, 50 * k + 20, 40 * k + 30) for k in range(4) for v in (0, 1)])
    kept, counts, dropped = drop_contradicted(ROWS, check_births(good, ROWS), {})
    assert not dropped
    assert counts == {(0, 1): (4, 0)}
    np.testing.assert_array_equal(kept.fundamental, ROWS.fundamental)
    kept, counts, dropped = drop_contradicted(ROWS, check_births(wrong(0, 1, 2), ROWS), {})
    assert dropped == ((0, 1),)
    assert np.isnan(kept.fundamental).all()
    assert np.isfinite(ROWS.fundamental[0, 1]).all()  # as it was


def test_fewer_than_three_targets_do_not_say_that_a_matrix_is_wrong_but_are_remembered():
    _, counts, dropped = drop_contradicted(ROWS, check_births(wrong(0, 1), ROWS), {})
    assert (counts, dropped) == ({(0, 1): (2, 2)}, ())
    assert drop_contradicted(ROWS, check_births(wrong(2), ROWS), counts)[1:] == ({(0, 1): (3, 3)}, ((0, 1),))
    # Three that are right have decided
    assert drop_contradicted(ROWS, check_births(wrong(2, 3, 4), ROWS), {(0, 1): (3, 1)})[1:] == (
        {(0, 1): (3, 1)},
        (),
    )


@pytest.mark.parametrize(("failed", "dropped"), [(2, ()), (3, ((0, 1),))])
def test_a_matrix_goes_when_more_than_half_of_the_starts_fail(failed, dropped):
    made = [
        *wrong(*range(failed)),
        *births(*[(v, k, 50 * k + 20, 40 * k + 30) for k in range(failed, 4) for v in (0, 1)]),
    ]
    assert drop_contradicted(ROWS, check_births(made, ROWS), {})[1:] == ({(0, 1): (4, failed)}, dropped)


@pytest.mark.parametrize(("off", "failed"), [(10.0, 0), (10.0 + 1e-6, 1)])
def test_a_check_fails_above_a_radius(off, failed):
    made = births((0, 1, 50, 60), (1, 1, 200, 60.0 + off))
    assert drop_contradicted(ROWS, check_births(made, ROWS), {})[1] == {(0, 1): (1, failed)}


def test_a_birth_is_checked_with_the_tracker_of_another_view():
    there = {(0, 1): births((0, 1, 50, 60))[0].ellipse, (0, 2): births((0, 2, 90, 20))[0].ellipse}
    late = births((1, 1, 200, 72))
    assert len(check_births(late, ROWS).radii) == 0
    np.testing.assert_allclose(check_births(late, ROWS, there).radii, [1.2])
    # Trackers of both views are no birth
    assert len(check_births(late, ROWS, {**there, (1, 2): there[0, 2]}).radii) == 1
    touched = {**there, (0, 3): births((0, 3, 55, 60))[0].ellipse}
    assert len(check_births(late, ROWS, touched).radii) == 0


def test_feet_are_compared_where_they_stand_for_targets():
    low = np.array([[50.0, 100.0, 5.0, 10.0, 0.0], [80.0, 70.0, 8.0, 40.0, 0.0]])
    made = [Birth(v, 1, ellipse) for v, ellipse in enumerate(low)]
    for check in (
        lambda bottom: check_births(made, ROWS, bottom=bottom),
        lambda bottom: check_outlines(outlines(made), ROWS, bottom),
    ):
        assert check(False).radii[0] > 1.0
        np.testing.assert_allclose(check(True).radii, [0.0], atol=1e-12)
