"""Covariances of places whose views may be on something else: Monte Carlo, and what they reduce to."""

import numpy as np
import pytest
from place_scenes import covariances, rig_of, room, room_rig, seen

from occlog.track.methods.images.ground.triangulation import (
    MET,
    TargetHeightPrior,
    ViewOdds,
    covariances_with_contradiction,
    triangulate_in_space,
)

HEIGHT = TargetHeightPrior(0.9, 0.1)
SINE = np.sin(np.radians(5.0))
AREAS = np.full(3, 640.0 * 480.0)


def contested(rng, n, wrong):
    """Places of n points, each view of which is on another point of the room with the probability `wrong`."""
    cameras = room_rig(rng, 3)
    points, others = room(rng, n), room(rng, 3 * n).reshape(n, 3, 3)
    points[:, 2], others[:, :, 2] = rng.normal(0.9, 0.1, n), 0.9
    cov = covariances(rng, n, 3)
    sights = seen(rng, cameras, points, cov)
    off = rng.random((n, 3)) < wrong
    for view, camera in enumerate(cameras):
        sights.pixels[off[:, view], view] = camera.project(others[off[:, view], view])
    return sights, rig_of(cameras), points, off


def on_the_floor(met, covariance, points):
    good = met.status == MET
    e = (met.xyz - points)[good, :2]
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(covariance[good][:, :2, :2]), e)


def test_covariances_hold_where_views_are_on_others():
    """A sixth of the views is on others; without the hypotheses the mean NEES is several times too large."""
    sights, rig, points, _ = contested(np.random.default_rng(1), 1500, 1 / 6)
    met = triangulate_in_space(sights, rig, HEIGHT)
    contest = covariances_with_contradiction(met, sights, rig, HEIGHT, ViewOdds(0.5, 1.0, AREAS), SINE)
    before, after = (on_the_floor(met, c, points) for c in (met.covariance, contest.covariance))
    assert before.mean() > 20.0
    assert after.mean() < 0.25 * before.mean()
    assert (after < 5.99).mean() > max(0.9, (before < 5.99).mean())


def test_covariances_of_views_that_are_right_hardly_change():
    sights, rig, points, _ = contested(np.random.default_rng(2), 1500, 0.0)
    met = triangulate_in_space(sights, rig, HEIGHT)
    contest = covariances_with_contradiction(met, sights, rig, HEIGHT, ViewOdds(0.5, 1.0, AREAS), SINE)
    assert 1.3 < on_the_floor(met, contest.covariance, points).mean() < 2.2
    assert (contest.contested > 0.5).mean() < 0.05


def test_views_on_others_are_contested():
    sights, rig, _, off = contested(np.random.default_rng(3), 500, 1 / 6)
    met = triangulate_in_space(sights, rig, HEIGHT)
    contest = covariances_with_contradiction(met, sights, rig, HEIGHT, ViewOdds(0.5, 1.0, AREAS), SINE)
    some = off.any(axis=1)
    assert np.mean(contest.contested[some] > 0.5) > 0.8
    assert np.mean(contest.contested[~some] > 0.5) < 0.05


def test_views_that_are_surely_right_keep_their_covariance():
    sights, rig, _, _ = contested(np.random.default_rng(4), 50, 0.3)
    met = triangulate_in_space(sights, rig, HEIGHT)
    contest = covariances_with_contradiction(met, sights, rig, HEIGHT, ViewOdds(1.0, 1.0, AREAS), SINE)
    assert np.array_equal(contest.covariance, met.covariance, equal_nan=True)
    assert np.array_equal(contest.contested, np.where(met.status == MET, 0.0, 1.0))


def test_single_views_are_not_contested():
    sights, rig, _, _ = contested(np.random.default_rng(5), 50, 0.0)
    alone = sights._replace(there=sights.there & (np.arange(3) == 1))
    met = triangulate_in_space(alone, rig, HEIGHT)
    contest = covariances_with_contradiction(met, alone, rig, HEIGHT, ViewOdds(0.5, 1.0, AREAS), SINE)
    assert np.array_equal(contest.covariance, met.covariance, equal_nan=True)
    assert not contest.contested.any()


@pytest.mark.parametrize("height", [HEIGHT, None])
def test_rows_do_not_depend_on_each_other(height):
    sights, rig, _, _ = contested(np.random.default_rng(6), 40, 0.3)
    odds = ViewOdds(0.5, 1.0, AREAS)
    met = triangulate_in_space(sights, rig, height)
    whole = covariances_with_contradiction(met, sights, rig, height, odds, SINE)
    for k in range(0, 40, 7):
        rows = np.arange(k, k + 1)
        one = covariances_with_contradiction(
            triangulate_in_space(sights.take(rows), rig, height), sights.take(rows), rig, height, odds, SINE
        )
        assert np.array_equal(one.covariance[0], whole.covariance[k], equal_nan=True)
