"""How alike the boxes of tracks look, against a slow evaluation box by box."""

import itertools

import numpy as np
import pytest
from floor_places import WALK, chain_with, places_at

from occlog.track.methods.jipda.association_features import feature_likelihood, log_ratio
from occlog.track.methods.jipda.batch.appearance import log_ratio_of_sum, sum_up
from occlog.track.methods.jipda.batch.mcmc_association import (
    NO_NODE,
    candidates,
    empty_link_cache,
    log_posterior,
    sweep,
    update_all_messages,
)

SUMS = np.array([[200.0, 180.0, 162.5], [300.0, 180.0, 111.0]])
"""Likenesses of 0.9 +- 0.05 to the same person, of 0.6 +- 0.1 to others."""


def vectors(n, K, rng, person=None):
    """Roots of histograms, those of a person alike."""
    clothes = rng.dirichlet(np.ones(K), n)
    person = np.arange(n) if person is None else person
    return np.sqrt(np.array([rng.dirichlet(30.0 * clothes[p] + 0.05) for p in person]))


def plain(sums, observations):
    """The same from all pairs of observations (n, K)."""
    n = len(observations)
    if n < 2:
        return 0.0
    same, other = sums[:, 1] / sums[:, 0]
    pairs = np.mean([one @ two for one, two in itertools.combinations(observations, 2)])
    # Of one person's boxes the pairs are as alike as `same` squared, of two people's as the product
    share = (pairs - same * other) / (same**2 - same * other)
    of_one, of_others = log_ratio(sums, np.array([same, other]))
    return (n - 1.0) * (share * of_one + (1.0 - share) * of_others)


@pytest.mark.parametrize("person", [[0], [0, 0], [0, 1], [0] * 8, [0, 0, 0, 0, 1, 1, 1, 1]], ids=str)
def test_boxes_are_worth_what_their_pairs_say(person):
    v = vectors(8, 6, np.random.default_rng(1), person)
    S = v.sum(axis=0)
    assert log_ratio_of_sum(feature_likelihood(SUMS), float(len(v)), float(S @ S)) == pytest.approx(
        plain(SUMS, v), abs=1e-9
    )
    assert log_ratio_of_sum(feature_likelihood(SUMS), 0.0, 0.0) == 0.0


def test_a_track_of_two_people_in_equal_parts_is_worth_half_of_either_kind():
    """All its boxes are rather like its mean, and none like half of the others."""
    sums = np.array([[400.0, 384.0, 370.0], [400.0, 0.0, 4.0]])
    same, other = log_ratio(sums, np.array([0.96, 0.0]))
    n, pairs = 40, 0.96**2
    pure = n + n * (n - 1) * pairs
    mixed = n + 2 * (n // 2) * (n // 2 - 1) * pairs
    assert log_ratio_of_sum(feature_likelihood(sums), float(n), pure) == pytest.approx((n - 1) * same)
    # Of 39 others 19 are the same person's
    assert log_ratio_of_sum(feature_likelihood(sums), float(n), mixed) == pytest.approx(19 * same + 20 * other)


def test_looks_that_tell_no_one_apart_are_worth_nothing():
    similar = np.array([[400.0, 240.0, 150.0], [400.0, 240.0, 150.0]])
    assert log_ratio_of_sum(feature_likelihood(similar), 10.0, 80.0) == 0.0


def coloured(rng, moments=6, bare=3):
    """Two people who walk side by side, a box or two a place; some places have none with an appearance."""
    n = 2 * moments
    count = rng.integers(1, 3, n).astype(float)
    count[rng.choice(n, bare, replace=False)] = 0.0
    observation = vectors(n, 5, rng, np.arange(n) % 2) * count[:, None]
    snapshot = np.repeat(np.arange(moments), 2)
    at = np.column_stack([0.25 * snapshot, np.where(np.arange(n) % 2, 0.3, -0.3)]) + rng.normal(0.0, 0.1, (n, 2))
    return snapshot, at, observation, count


def textbook(observation, count, after, used):
    """The log likelihood ratios of all tracks, each from its boxes."""
    out = 0.0
    for head in set(np.flatnonzero(used).tolist()) - {j for j in after if j != NO_NODE}:
        track = [head]
        while after[track[-1]] != NO_NODE:
            track.append(after[track[-1]])
        n, S = count[track].sum(), observation[track].sum(axis=0)
        if n >= 2.0:
            same, other = SUMS[:, 1] / SUMS[:, 0]
            share = ((S @ S - n) / (n * (n - 1.0)) / same - other) / (same - other)
            of_one, of_others = log_ratio(SUMS, np.array([same, other]))
            out += (n - 1.0) * (share * of_one + (1.0 - share) * of_others)
    return out


@pytest.mark.jit
def test_the_density_of_the_chain_is_that_of_places_times_that_of_looks_through_all_moves():
    rng = np.random.default_rng(2)
    moment, at, observation, count = coloured(rng)
    worths = np.full(len(moment), 4.0)
    places, bare = places_at(moment, at, worths, (observation, count), SUMS), places_at(moment, at, worths)
    looked = np.arange(7.0)[:, None]
    chain = chain_with([NO_NODE] * 12, [False] * 12, 5)
    listed = candidates(places, WALK, 1.5)
    known = empty_link_cache(listed)
    moved = 0
    for _ in range(20):
        moved += sweep(places, WALK, looked, listed, known, chain, 10.0, rng.random((40, 4)))
        after, used = chain.after.tolist(), chain.used.tolist()
        plain = chain_with(after, used)
        update_all_messages(bare, WALK, looked, plain)
        expected = log_posterior(bare, plain) + textbook(observation, count, after, used)
        update_all_messages(places, WALK, looked, chain)
        assert log_posterior(places, chain) == pytest.approx(expected, abs=1e-6)
    assert moved > 100
    # Sums that moves have kept are those of the tracks
    sweep(places, WALK, looked, listed, known, chain, 10.0, rng.random((40, 4)))
    fresh = chain_with(chain.after.tolist(), chain.used.tolist(), 5)
    for head in np.flatnonzero(chain.used & (chain.before == NO_NODE)).tolist():
        sum_up(places.similar, fresh.sums, fresh.before, fresh.after, head)
    for kept, made in zip(chain.sums, fresh.sums, strict=True):
        np.testing.assert_allclose(kept[chain.used], made[chain.used], atol=1e-12)


@pytest.mark.jit
def test_the_chain_visits_associations_as_often_as_places_and_looks_make_them_probable():
    rng = np.random.default_rng(3)
    observation = vectors(4, 5, rng, [0, 1, 0, 1])
    at = [[0.0, 0.0], [0.4, 0.0], [0.25, 0.1], [0.2, 0.2]]
    # Enough is known to count, and not so much that one association is all
    sums = np.array([[30.0, 27.0, 25.5], [30.0, 21.0, 16.5]])
    places = places_at([0, 0, 1, 1], at, np.full(4, 4.0), (observation, np.ones(4)), sums)
    looked = np.arange(3.0)[:, None]
    states = {}
    for one, other in itertools.product([NO_NODE, 2, 3], [NO_NODE, 2, 3]):
        if one == other != NO_NODE:
            continue
        after = (one, other, NO_NODE, NO_NODE)
        linked = {k for k, j in enumerate(after) if j != NO_NODE} | {one, other} - {NO_NODE}
        for used in itertools.product(*[[True] if k in linked else [False, True] for k in range(4)]):
            chain = chain_with(after, used, 5)
            update_all_messages(places, WALK, looked, chain)
            states[after, used] = log_posterior(places, chain)
    value = np.array(list(states.values()))
    probability = np.exp(value - value.max())
    probability /= probability.sum()
    listed = candidates(places, WALK, 1.5)
    known, chain = empty_link_cache(listed), chain_with([NO_NODE] * 4, [False] * 4, 5)
    visits = dict.fromkeys(states, 0)
    for _ in range(4000):
        sweep(places, WALK, looked, listed, known, chain, 1.0, rng.random((12, 4)))
        visits[tuple(chain.after.tolist()), tuple(chain.used.tolist())] += 1
    often = np.array(list(visits.values())) / 4000
    assert 0.5 * np.abs(often - probability).sum() < 0.05
    assert probability.max() < 0.95
