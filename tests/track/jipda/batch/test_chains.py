"""The Markov chain against the enumeration of all associations of a few places."""

import itertools
from collections import Counter

import numpy as np
import pytest
from floor_places import WALK, chain_with, places_at

from occlog.track.methods.jipda.batch.mcmc_association import (
    LOG_RATIO_OTHER_FILTER_ID,
    LOG_RATIO_SAME_FILTER_ID,
    NO_NODE,
    can_link,
    candidates,
    empty_link_cache,
    log_link_prior,
    log_posterior,
    sweep,
    update_all_messages,
)
from occlog.track.methods.jipda.target_set import CONSTANT_VELOCITY, MANOEUVRE, POSTURE_CHANGE


def all_states(places, looked):
    """Every association and its log probability."""
    n = len(places.step)
    options = [[NO_NODE, *(j for j in range(n) if can_link(places, WALK, i, j))] for i in range(n)]
    out = {}
    for after in itertools.product(*options):
        taken = [j for j in after if j != NO_NODE]
        if len(set(taken)) < len(taken):
            continue
        linked = {i for i, j in enumerate(after) if j != NO_NODE} | set(taken)
        for used in itertools.product(*[[True] if k in linked else [False, True] for k in range(n)]):
            chain = chain_with(after, used)
            update_all_messages(places, WALK, looked, chain)
            out[after, used] = log_posterior(places, chain)
    return out


@pytest.mark.jit
def test_the_chain_visits_every_association_as_often_as_it_is_probable():
    places = places_at([0, 0, 1, 1], [[0.0, 0.0], [0.9, 0.0], [0.3, 0.1], [0.8, 0.2]], [1.0, 2.0, 1.5, 0.5])
    looked = np.arange(3.0)[:, None]
    states = all_states(places, looked)
    value = np.array(list(states.values()))
    probability = np.exp(value - value.max())
    probability /= probability.sum()
    listed = candidates(places, WALK, 1.5)
    known = empty_link_cache(listed)
    chain = chain_with([NO_NODE] * 4, [False] * 4)
    rng = np.random.default_rng(0)
    visits = Counter()
    runs = 4000
    for _ in range(runs):
        sweep(places, WALK, looked, listed, known, chain, 1.0, rng.random((12, 4)))
        visits[tuple(chain.after.tolist()), tuple(chain.used.tolist())] += 1
    often = np.array([visits[key] / runs for key in states])
    assert sum(visits[key] for key in states) == runs
    # Total variation: as small as that of as many draws that are nearly independent
    assert 0.5 * np.abs(often - probability).sum() < 0.05
    assert np.abs(often - probability).max() < 0.03


def test_an_exchange_of_tails_keeps_the_messages_of_both_tracks():
    rng = np.random.default_rng(3)
    moment = np.repeat(np.arange(12), 2)
    at = np.column_stack([0.25 * moment, np.where(np.arange(24) % 2, 0.3, -0.3)]) + rng.normal(0.0, 0.1, (24, 2))
    places = places_at(moment, at, np.full(24, 4.0))
    looked = np.arange(13.0)[:, None]
    after = [i + 2 if i < 22 else NO_NODE for i in range(24)]
    chain = chain_with(after, [True] * 24)
    update_all_messages(places, WALK, looked, chain)
    listed = candidates(places, WALK, 1.5)
    known = empty_link_cache(listed)
    assert sweep(places, WALK, looked, listed, known, chain, 30.0, rng.random((400, 4))) > 5
    fresh = chain_with(chain.after.tolist(), chain.used.tolist())
    assert (fresh.before == chain.before).all()
    update_all_messages(places, WALK, looked, fresh)
    assert log_posterior(places, chain) == pytest.approx(log_posterior(places, fresh), abs=1e-4)
    np.testing.assert_allclose(chain.J[chain.used], fresh.J[fresh.used], rtol=1e-5, atol=1e-6)


def test_two_people_who_cross_keep_their_ways():
    t = np.arange(9.0)
    one, other = np.column_stack([0.5 * t, 0.3 * t]), np.column_stack([0.5 * t, 2.4 - 0.3 * t])
    positions = places_at(np.repeat(np.arange(9), 2), np.stack([one, other], 1).reshape(-1, 2), np.full(18, 6.0))
    looked = np.arange(10.0)[:, None]
    # At the crossing, in the middle, both turn back
    after = [i + 2 for i in range(16)] + [NO_NODE, NO_NODE]
    after[8], after[9] = 11, 10
    chain = chain_with(after, [True] * 18)
    update_all_messages(positions, WALK, looked, chain)
    listed = candidates(positions, WALK, 1.5)
    known = empty_link_cache(listed)
    sweep(positions, WALK, looked, listed, known, chain, 0.1, np.random.default_rng(0).random((600, 4)))
    # Which of the two places where they meet is whose, nothing says
    after = chain.after
    assert [after[after[6]], after[after[7]]] == [10, 11]
    assert after[:6].tolist() == [2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize(
    ("other", "begins", "worth"),
    [
        (0, 0.0, LOG_RATIO_SAME_FILTER_ID),
        (1, 0.0, LOG_RATIO_OTHER_FILTER_ID),
        (1, 0.4999, LOG_RATIO_OTHER_FILTER_ID),
        (1, 0.5001, 0.0),
        (NO_NODE, 0.0, 0.0),
    ],
    ids=["same", "both at a time", "the other begins before it ends", "the other begins after it", "not followed"],
)
def test_what_the_filter_followed_speaks_for_links(other, begins, worth):
    places = places_at([0, 2], np.zeros((2, 2)), np.zeros(2))
    looked = np.arange(4.0)[:, None]
    without = log_link_prior(places, WALK, looked, 0, 1)
    hint = np.array([[NO_NODE, 0], [NO_NODE, other]])
    life = np.array([[0.0, 0.5], [begins, 1.0]])
    assert log_link_prior(places._replace(hint=hint, life=life), WALK, looked, 0, 1) - without == pytest.approx(worth)


@pytest.mark.parametrize(
    ("at", "body", "model"),
    [
        ((0.5, 0.0), (1.7, 0.5), CONSTANT_VELOCITY),
        ((0.0, 1.5), (1.7, 0.5), MANOEUVRE),
        ((0.5, 0.0), (0.5, 1.2), POSTURE_CHANGE),
    ],
)
def test_people_walk_on_turn_or_bend_before_the_next_place(at, body, model):
    walk = WALK._replace(often=np.array([0.0, 0.05, 1e-3]))
    places = places_at([0, 1, 2, 3], [[-1.0, 0.0], [-0.5, 0.0], [0.0, 0.0], at], np.ones(4))
    places = places._replace(J=20.0 * places.J, h=20.0 * places.h)
    places.h[3] = places.J[3] @ [*at, 0.0, 0.0, *body]
    looked = np.arange(5.0)[:, None]
    chain = chain_with([1, 2, 3, NO_NODE], [True] * 4)
    # The models are chosen by the messages of all places, which are made first
    for _ in range(2):
        update_all_messages(places, walk, looked, chain)
    assert chain.model[2] == model
    assert chain.model[3] == CONSTANT_VELOCITY
