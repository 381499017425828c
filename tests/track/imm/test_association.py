from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.stats import norm

from occlog.track.methods.imm import association
from occlog.track.methods.imm.association import (
    Direction,
    bearing_fit,
    direction,
    joint_data_association,
    merge_probability,
    merged_bearing_density,
    reweigh,
)

CLUTTER = 0.05


def bearings(*degrees, sigma=3.0):
    angle = np.radians(np.array(degrees, dtype=float))
    return {"bearing": angle, "sigma": np.full(len(degrees), math.radians(sigma)), "position": np.zeros(2)}


def cloud(rng, x, y, L=4, extent=1.0):
    states = rng.normal(size=(1, L, 4))
    states[..., 0] = x + extent * states[..., 0]
    states[..., 2] = y + extent * states[..., 2]
    weights = rng.random((1, L))
    return states, weights / weights.sum()


def by_all_events(alone, unheard, shared, apart, clutter):
    """Every event by a product over choices; [Fortmann 1983] with bearings that two targets may share."""
    K, N = alone.shape
    a, u, s, total = np.zeros((K, N)), np.zeros(K), np.zeros((K, K, N)), 0.0
    for choice in itertools.product(range(-1, N), repeat=K):
        users = [[k for k in range(K) if choice[k] == i] for i in range(N)]
        if any(len(w) > 2 for w in users):
            continue
        weight = 1.0
        for k in range(K):
            if choice[k] < 0:
                weight *= unheard[k]
        for i, w in enumerate(users):
            weight *= clutter[i] if not w else alone[w[0], i] if len(w) == 1 else shared[w[0], w[1], i]
        lone = [w[0] for w in users if len(w) == 1]
        for k, b in itertools.combinations(lone, 2):
            weight *= apart[k, b]
        total += weight
        for k in range(K):
            u[k] += weight * (choice[k] < 0)
        for i, w in enumerate(users):
            if len(w) == 1:
                a[w[0], i] += weight
            if len(w) == 2:
                s[w[0], w[1], i] += weight
                s[w[1], w[0], i] += weight
    return a / total, u / total, s / total, math.log(total)


def problem(rng, K, N, gaps=0.3):
    alone = rng.random((K, N)) * (rng.random((K, N)) > gaps)
    shared = rng.random((K, K, N)) * (rng.random((K, K, N)) > gaps)
    shared = 0.5 * (shared + shared.transpose(1, 0, 2))
    shared[np.arange(K), np.arange(K)] = 0.0
    apart = rng.random((K, K))
    return alone, rng.random(K) + 0.01, shared, 0.5 * (apart + apart.T), 0.1 + rng.random(N)


@pytest.mark.parametrize("K", [0, 1, 2, 3])
@pytest.mark.parametrize("N", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_association_is_that_of_all_events(K, N, seed):
    given = problem(np.random.default_rng([seed, K, N]), K, N)
    found, (a, u, s, total) = joint_data_association(*given), by_all_events(*given)
    np.testing.assert_allclose(found.alone, a, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found.unheard, u, rtol=1e-12)
    np.testing.assert_allclose(found.shared, s, rtol=1e-12, atol=1e-15)
    assert found.log_evidence == pytest.approx(total, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_probabilities_of_a_target_sum_to_one(seed):
    alone, unheard, shared, apart, clutter = problem(np.random.default_rng(seed), 4, 3)
    found = joint_data_association(alone, unheard, shared, apart, clutter)
    np.testing.assert_allclose(found.alone.sum(axis=1) + found.unheard + found.shared.sum(axis=(1, 2)), 1.0, rtol=1e-12)


def test_with_too_many_events_the_least_likely_are_left_out(monkeypatch):
    monkeypatch.setattr(association, "MAX_JOINT_EVENTS", 20)
    rng = np.random.default_rng(0)
    alone = 1e-9 * rng.random((4, 4)) + np.diag([5.0, 6.0, 7.0, 8.0])
    none = np.zeros((4, 4, 4))
    found = joint_data_association(alone, np.full(4, 0.1), none, np.ones((4, 4)), np.full(4, CLUTTER))
    exact = by_all_events(alone, np.full(4, 0.1), none, np.ones((4, 4)), np.full(4, CLUTTER))
    np.testing.assert_allclose(found.alone, exact[0], atol=1e-7)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("reach", [6.0, math.inf])
def test_weights_are_those_of_the_joint_posterior(seed, reach):
    """Two targets, all pairs of particles, all events: no resolution, so that the marginals are exact."""
    rng = np.random.default_rng(seed)
    heard = bearings(30.0, 45.0, 200.0, sigma=10.0)
    clouds = [cloud(rng, 4.0, 2.0), cloud(rng, 3.0, 4.0)]
    detection, N = np.array([0.9, 0.7]), 3
    each = [bearing_fit(x, w, **heard, reach=reach) for x, w in clouds]
    fit = np.array([h.fit for h in each])
    alone = detection[:, None] * fit
    unheard = 1.0 - detection * np.array([h.reached for h in each])
    found = joint_data_association(alone, unheard, np.zeros((2, 2, N)), np.ones((2, 2)), np.full(N, CLUTTER))
    post = [np.zeros(4), np.zeros(4)]
    for p, q in itertools.product(range(4), repeat=2):
        like = 0.0
        for i, j in itertools.product(range(-1, N), repeat=2):
            if i == j and i >= 0:
                continue
            w = 1.0
            for k, (particle, choice) in enumerate(((p, i), (q, j))):
                d = each[k].each[:, 0, particle], detection[k] * each[k].within[0, particle]
                w *= 1.0 - d[1] if choice < 0 else detection[k] * d[0][choice]
            like += w * CLUTTER ** (N - (i >= 0) - (j >= 0))
        mass = clouds[0][1][0, p] * clouds[1][1][0, q] * like
        post[0][p] += mass
        post[1][q] += mass
    for k in range(2):
        got = reweigh(clouds[k][1], each[k], detection[k], found.alone[k], found.unheard[k], ())
        np.testing.assert_allclose(got[0], post[k] / post[k].sum(), rtol=1e-10)
    assert found.log_evidence == pytest.approx(math.log(post[0].sum()), abs=1e-10)


def test_densities_wrap_and_end_at_the_range():
    x = np.zeros((1, 2, 4))
    x[0, :, 0], x[0, :, 2] = (-4.0, -40.0), (0.05, 0.5)
    heard = bearing_fit(x, np.full((1, 2), 0.5), **bearings(-179.0), reach=10.0)
    sigma = math.radians(3.0)
    off = math.radians(181.0) - math.atan2(0.05, -4.0)
    expected = math.exp(-0.5 * (off / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    np.testing.assert_allclose(heard.each, [[[expected, 0.0]]], rtol=1e-9)
    assert heard.reached == 0.5


def test_two_targets_heard_as_one_by_drawing_them():
    """Target 1 at 10 degrees, target 2 Gaussian about 11: density of their middle, given that they are near.

    The other is taken as uniform within the resolution where it is near, which is rough: within 15 %.
    """
    rng = np.random.default_rng(4)
    sigma, resolution = math.radians(2.0), math.radians(3.0)
    angle1, n = math.radians(10.0), 400_000
    angle2 = math.radians(11.0) + math.radians(2.0) * rng.standard_normal(n)
    near = np.abs(angle2 - angle1) < resolution
    one = np.zeros((1, 1, 4))
    one[0, 0, 0], one[0, 0, 2] = 10 * math.cos(angle1), 10 * math.sin(angle1)
    other = np.zeros((1, 4000, 4))
    other[0, :, 0], other[0, :, 2] = 10 * np.cos(angle2[:4000]), 10 * np.sin(angle2[:4000])
    for at in (8.0, 10.0, 12.0):
        observation = bearings(at, sigma=2.0)
        a, b = (
            bearing_fit(one, np.ones((1, 1)), **observation, reach=math.inf),
            bearing_fit(other, np.full((1, 4000), 1 / 4000), **observation, reach=math.inf),
        )
        heard = {"bearing": observation["bearing"], "sigma": observation["sigma"]}
        middle = 0.5 * (angle1 + angle2)
        z = (math.radians(at) - middle) / sigma
        exact = float(np.mean(np.exp(-0.5 * z * z) / (sigma * math.sqrt(2 * math.pi)) * near))
        pair = direction(a, np.ones((1, 1))), direction(b, np.full((1, 4000), 1 / 4000))
        assert merged_bearing_density(a, *pair, **heard, resolution=resolution)[0, 0, 0] == pytest.approx(
            exact, rel=0.15
        )
    assert not merged_bearing_density(a, *pair, **heard, resolution=0.0).any()


@pytest.mark.parametrize(("gap", "some"), [(0.2 + 3.0 * 0.08 - 1e-9, True), (0.2 + 3.0 * 0.08 + 1e-9, False)])
def test_two_targets_are_heard_as_one_up_to_three_deviations_beyond_the_resolution(gap, some):
    """Normal density of the wider variance times the probability that the other is within the resolution."""
    one, heard = np.zeros((1, 1, 4)), {"bearing": np.array([0.3]), "sigma": np.array([0.07])}
    one[0, 0, 0], one[0, 0, 2] = math.cos(0.1), math.sin(0.1)
    fit = bearing_fit(one, np.ones((1, 1)), **heard, position=np.zeros(2), reach=math.inf)
    for sign in (-1.0, 1.0):
        pair = Direction(0.1, 0.05), Direction(0.1 + sign * gap, 0.03)
        near = norm.cdf((0.2 - gap) / 0.03) - norm.cdf((-0.2 - gap) / 0.03)
        wanted = norm.pdf(0.2, 0.0, math.sqrt(0.07**2 + 0.2**2 / 12.0)) * near
        got = merged_bearing_density(fit, *pair, **heard, resolution=0.2)
        assert got[0, 0, 0] == pytest.approx(wanted if some else 0.0, rel=1e-6)


def test_directions_are_means_around_the_circle():
    """The spread is that of a wrapped normal; the standard error of 20,000 draws is 0.5 %."""
    angle = math.pi + 0.3 * np.random.default_rng(0).standard_normal(20_000)
    x = np.zeros((1, 20_000, 4))
    x[0, :, 0], x[0, :, 2] = np.cos(angle), np.sin(angle)
    weights = np.full((1, 20_000), 1 / 20_000)
    found = direction(bearing_fit(x, weights, **bearings(), reach=math.inf), weights)
    assert abs(math.remainder(found.centre - math.pi, 2 * math.pi)) < 0.01
    assert found.spread == pytest.approx(0.3, rel=0.02)


def test_close_by_is_the_probability_of_a_normal():
    off = np.array([[0.0, 0.3, -2.0]])
    draws = np.random.default_rng(1).normal(size=1_000_000)
    # Standard error at most 5e-4
    expected = [[np.mean(np.abs(o + 0.5 * draws) < 0.4) for o in off[0]]]
    np.testing.assert_allclose(merge_probability(off, 0.5, 0.4), expected, atol=2e-3)


def test_nothing_heard_pushes_particles_out_of_range():
    x = np.zeros((1, 2, 4))
    x[0, :, 0] = 5.0, 15.0
    weights = np.full((1, 2), 0.5)
    silent = bearing_fit(x, weights, **bearings(), reach=10.0)
    got = reweigh(weights, silent, 0.9, np.empty(0), 1.0, ())
    np.testing.assert_allclose(got, [[0.1 / 1.1, 1.0 / 1.1]])


@pytest.mark.parametrize("K", [12, 16, 24])
def test_many_targets_far_apart_are_all_heard(K):
    """Beyond 15 targets all events of one cluster would be too many; far apart they do not form one."""
    angle = np.arange(K) * 2.0 * np.pi / K
    off = np.abs(np.angle(np.exp(1j * (angle[:, None] - angle))))
    sigma = math.radians(3.0)
    alone = 0.95 * np.exp(-0.5 * (off / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)
    found = joint_data_association(alone, np.full(K, 0.05), np.zeros((K, K, K)), np.ones((K, K)), np.full(K, 0.016))
    assert np.diag(found.alone).min() > 0.99
    assert found.unheard.max() < 0.01


def test_of_many_targets_on_one_bearing_none_is_left_out_while_another_has_a_choice(monkeypatch):
    monkeypatch.setattr(association, "MAX_JOINT_EVENTS", 8)
    rng = np.random.default_rng(3)
    alone = rng.uniform(0.5, 1.0, (3, 4))
    groups = association._groups(alone > 0.0, alone / CLUTTER)
    assert sorted(k for group, _ in groups for k in group.tolist()) == [0, 1, 2]
    assert all(own.any(axis=1).all() for _, own in groups)
    for group, own in groups:
        assert np.prod(1.0 + own.sum(axis=1)) <= 8
        np.testing.assert_array_equal(own[np.arange(len(group)), alone[group].argmax(axis=1)], True)
