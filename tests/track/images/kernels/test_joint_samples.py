"""The chain and the prior against overlap, against exact posteriors and plain forms."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.track.methods.images.kernels.joint_samples import crowding_of_samples, distinct_size, overlap, run_chain

DRAWS = 200_000


def disc(x, y, r):
    return np.array([x, y, r, r, 0.0])


def test_overlap_of_discs_is_the_area_in_common():
    rng = np.random.default_rng(1)
    points = 60.0 * rng.random((DRAWS, 2)) - 30.0
    for r, s, d in ((10, 10, 6), (10, 5, 7), (4, 12, 9), (8, 8, 15.5), (9, 3, 10)):
        inside = np.hypot(points[:, 0] + 5, points[:, 1]) <= r
        both = inside & (np.hypot(points[:, 0] + 5 - d, points[:, 1]) <= s)
        share = 3600.0 * both.mean() / (math.pi * min(r, s) ** 2)
        error = 3600.0 * math.sqrt(both.mean() / DRAWS) / (math.pi * min(r, s) ** 2)
        assert abs(overlap(disc(-5, 0, r), disc(d - 5, 0, s)) - share) < 4 * error


def test_overlap_has_its_limits():
    assert overlap(disc(0, 0, 5), disc(10, 0, 5)) == 0.0
    assert overlap(disc(0, 0, 5), disc(0, 0, 5)) == 1.0
    assert overlap(disc(0, 0, 5), disc(2, 1, 2)) == 1.0
    assert overlap(disc(0, 0, 5), disc(np.nan, 0, 5)) == 0.0


@given(st.lists(st.floats(1, 20), min_size=4, max_size=4), st.floats(-40, 40), st.floats(-40, 40), st.floats(-2, 2))
def test_overlap_is_symmetric_and_a_share(axes, x, y, rho):
    one, two = np.array([0.0, 0.0, axes[0], axes[1], rho]), np.array([x, y, axes[2], axes[3], -rho])
    assert overlap(one, two) == pytest.approx(overlap(two, one), abs=1e-9)
    assert 0.0 <= overlap(one, two) <= 1.0


def exact(places, prior, likelihood, strength):
    """Joint posterior over all combinations of places, written out."""
    n = len(prior)
    out = np.zeros((len(places),) * n)
    for combination in itertools.product(range(len(places)), repeat=n):
        p = math.prod(prior[i][k] * likelihood[i][k] for i, k in enumerate(combination))
        for a, b in itertools.combinations(range(n), 2):
            p *= math.exp(-strength * overlap(places[combination[a]], places[combination[b]]))
        out[combination] = p
    return out / out.sum()


def chain_shares(rng, places, prior, likelihood, strength, moves):
    """Shares of all combinations in the samples of a chain."""
    n, k = len(prior), len(places)
    owner = rng.integers(0, n, moves)
    drawn = [rng.choice(k, moves, p=p) for p in prior]
    which = np.concatenate([np.zeros(n, dtype=np.int64), np.choose(owner, drawn)])
    targets = np.concatenate([np.arange(n), owner])
    rows = run_chain(
        places[which], owner, np.log(likelihood[targets, which]), np.log(1.0 - rng.random(moves)), strength, 200, 1
    )
    return [tuple(s) for s in which[rows]]


@pytest.mark.parametrize(("n", "strength"), [(1, 0.0), (2, 0.0), (2, 3.0), (3, 2.0)])
def test_chain_has_the_exact_posterior(n, strength):
    """16 chains tell the error of each share."""
    rng = np.random.default_rng(10 + n)
    positions = np.array([disc(x, 0, 5) for x in (0, 4, 9)])
    prior = rng.dirichlet(np.full(3, 4.0), n)
    likelihood = rng.uniform(0.2, 1.0, (n, 3))
    want = exact(positions, prior, likelihood, strength)
    chains = np.zeros((16, *want.shape))
    for chain in chains:
        samples = chain_shares(rng, positions, prior, likelihood, strength, 1500)
        np.add.at(chain, tuple(np.array(samples).T), 1.0 / len(samples))
    error = chains.std(axis=0, ddof=1) / 4.0
    assert (abs(chains.mean(axis=0) - want) < 5.0 * error + 1e-3).all()


def test_moves_are_accepted_by_the_ratio():
    """Likelihood 1 to q: taken if u <= q; where the target would come upon another, if u <= q e^-strength."""
    far, near, at = disc(100, 0, 5), disc(50, 0, 5), disc(0, 0, 5)
    for log_q, new, factor in ((-0.7, near, 0.0), (-0.7, at, 2.0), (0.5, at, 2.0)):
        pool = np.array([far, at, new])
        for gap, taken in ((1e-9, True), (-1e-9, False)):
            u = np.array([log_q - factor - gap])
            rows = run_chain(pool, np.array([0]), np.array([0.0, 0.0, log_q]), u, factor, 0, 1)
            assert rows.tolist() == [[2 if taken else 0, 1]]


def test_samples_are_kept_after_the_burn_in_and_thinned():
    pool = np.array([disc(k, 0, 1) for k in range(11)])
    rows = run_chain(pool, np.zeros(10, dtype=np.int64), np.zeros(11), np.full(10, -1.0), 0.0, 3, 2)
    assert rows.tolist() == [[5], [7], [9]]
    assert (
        run_chain(pool, np.zeros(10, dtype=np.int64), np.zeros(11), np.full(10, 1.0), 0.0, 4, 3).tolist() == [[0]] * 2
    )


def test_crowding_is_the_sum_over_pairs():
    samples = np.random.default_rng(4).uniform(1, 12, (6, 4, 5))
    want = [sum(overlap(a, b) for a, b in itertools.combinations(s, 2)) for s in samples]
    assert crowding_of_samples(samples) == pytest.approx(want, rel=1e-12)
    assert crowding_of_samples(samples[:, :1]).tolist() == [0.0] * 6


def test_distinct_size_counts_equal_samples_once():
    rows = np.array([[0, 1], [0, 2], [0, 3], [0, 3]])
    assert distinct_size(rows) == pytest.approx([1.0, 16 / 6])
