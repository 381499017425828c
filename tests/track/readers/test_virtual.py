"""Method `virtual`: places by which readers read a tag."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from occlog.track.methods.readers.virtual_sensors import locate, virtual_sensors

LENS = virtual_sensors(np.array([[0.0, 0.0], [2.0, 0.0], [9.0, 0.0]]), np.array([1.5, 1.5, 1.0]))


def test_the_place_is_the_reference_point_of_the_one_virtual_sensor() -> None:
    found = locate(LENS, LENS.members, 1.0, 0.0)
    assert_allclose(found.xy, LENS.centroid, atol=1e-12)
    assert_allclose(found.covariance, LENS.covariance, atol=1e-12)
    assert found.matched.all()


def test_readers_that_cover_no_place_together_are_reported_and_the_nearest_sets_are_taken() -> None:
    found = locate(LENS, np.array([[True, False, True]]), 1.0, 0.0)
    assert not found.matched[0]
    # One reader differs: {1} and {3}; their areas weigh them
    single = [m.tolist() in ([True, False, False], [False, False, True]) for m in LENS.members]
    weights = LENS.area * single / (LENS.area * single).sum()
    assert_allclose(found.xy[0], weights @ LENS.centroid, atol=1e-12)


def test_probabilities_weigh_the_regions_by_bayes() -> None:
    p, q = 0.8, 0.1
    found = locate(LENS, np.array([[True, True, False]]), p, q)
    likelihood = [
        np.prod([p if m else q for m in member[:2]]) * ((1 - p) if member[2] else (1 - q)) for member in LENS.members
    ]
    weights = LENS.area * likelihood
    weights /= weights.sum()
    mean = weights @ LENS.centroid
    second = np.einsum("v,vij->ij", weights, LENS.covariance + np.einsum("vi,vj->vij", LENS.centroid, LENS.centroid))
    assert_allclose(found.xy[0], mean, rtol=1e-12)
    assert_allclose(found.covariance[0], second - np.outer(mean, mean), atol=1e-12)


def test_the_covariance_is_that_of_the_errors_of_tags_that_are_read_by_chance() -> None:
    rng = np.random.default_rng(2)
    positions = np.array([[2.0, 2.0], [5.0, 2.0], [2.0, 5.0], [5.0, 5.0]])
    room = np.array([[0.0, 0.0], [7.0, 0.0], [7.0, 7.0], [0.0, 7.0]])
    xy = rng.uniform(0.0, 7.0, (40_000, 2))
    inside = np.linalg.norm(xy[:, None] - positions, axis=2) <= 2.5
    xy, inside = xy[inside.any(axis=1)], inside[inside.any(axis=1)]
    seen = rng.random(inside.shape) < np.where(inside, 0.8, 0.1)
    regions = virtual_sensors(positions, np.full(4, 2.5), room)
    found = locate(regions, seen, 0.8, 0.1)
    error = xy - found.xy
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
    assert abs(nees.mean() - 2.0) < 0.05
