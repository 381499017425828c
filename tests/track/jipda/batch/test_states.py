"""States of a track against the least squares solution of all its places at once."""

import numpy as np
import pytest
from floor_places import WALK, chain_with, places_at

from occlog.track.methods.jipda.batch.gaussian_messages import noise_of_walk
from occlog.track.methods.jipda.batch.mcmc_association import NO_NODE, update_all_messages
from occlog.track.methods.jipda.batch.states import states

MOMENTS = [1, 2, 5, 6]
TIME = 0.5 * np.arange(8)


def least_squares(places, left_out):
    """Mean and covariance of the states at all moments from 1 to 6, without the place of one of them."""
    n = 6
    information, vector = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
    prior = np.diag(WALK.prior)
    information[:6, :6] += prior
    vector[:6] += prior @ WALK.mean
    F, Q = np.eye(6), np.empty((6, 6))
    F[0, 2] = F[1, 3] = 0.5
    noise_of_walk(0.5, WALK.drift[0], Q)
    for k in range(n - 1):
        D = np.zeros((6, 6 * n))
        D[:, 6 * k : 6 * k + 6], D[:, 6 * k + 6 : 6 * k + 12] = -F, np.eye(6)
        information += D.T @ np.linalg.inv(Q) @ D
    for p, moment in enumerate(MOMENTS):
        if moment != left_out:
            at = slice(6 * (moment - 1), 6 * moment)
            information[at, at] += places.J[p]
            vector[at] += places.h[p]
    covariance = np.linalg.inv(information)
    return (covariance @ vector).reshape(n, 6), covariance


def track():
    rng = np.random.default_rng(5)
    at = np.column_stack([0.4 * np.array(MOMENTS), rng.normal(0.0, 0.2, 4)])
    places = places_at(MOMENTS, at, np.zeros(4))
    chain = chain_with([1, 2, 3, NO_NODE], [True] * 4)
    looked = np.arange(9.0)[:, None]
    update_all_messages(places, WALK._replace(reach=8), looked, chain)
    return places, chain


def test_a_state_is_that_of_least_squares_without_the_place_of_its_moment():
    places, chain = track()
    at = np.arange(8)
    rows = states(places, WALK, chain, TIME, at, at)
    assert rows.step.tolist() == [1, 2, 3, 4, 5, 6]
    assert rows.node.tolist() == [0, 1, NO_NODE, NO_NODE, 2, 3]
    assert rows.last.tolist() == [NO_NODE, 0, 1, 1, 1, 2]
    assert rows.next.tolist() == [1, 2, 2, 2, 3, NO_NODE]
    # The first time is left to the next test: there the prior of somebody new and the walk back meet
    for k in range(1, 6):
        mean, covariance = least_squares(places, rows.step[k])
        block = slice(6 * k, 6 * k + 6)
        np.testing.assert_allclose(rows.mean[k], mean[k], atol=1e-5)
        np.testing.assert_allclose(rows.covariance[k], covariance[block, block], atol=1e-5)


def test_beyond_its_ends_a_track_walks_on_and_is_less_certain():
    places, chain = track()
    at = np.arange(8)
    rows = states(places, WALK, chain, TIME, np.maximum(at - 1, 0), np.minimum(at + 1, 7))
    assert rows.step.tolist() == list(range(8))
    assert rows.inside.tolist() == [False, True, True, True, True, True, True, False]
    assert rows.mean[7, 0] == pytest.approx(rows.mean[6, 0] + 0.2, abs=0.4)
    assert rows.covariance[7, 0, 0] > rows.covariance[5, 0, 0]
    assert np.isfinite(rows.covariance[0]).all()
