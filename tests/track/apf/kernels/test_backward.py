"""Parents drawn backwards: against a brute-force form of the kernel, and at its limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import CHANGE, TOWARDS, WAIT, WaypointModel
from occlog.track.methods.apf.kernels.backward_simulation import density_on_segment, parents_of
from occlog.track.methods.apf.smoother import kernel_variance

PAPER = WaypointModel(1.0, 0.33, 0.7, 0.9, 0.05, 0.05, 0.9, sigma_waiting=0.1)
PEOPLE = WaypointModel(1.0, 0.1, 0.0, 0.7, 0.25, 0.05, 0.9, sigma_velocity=0.5, sigma_waiting=0.05)
STAND = PEOPLE._replace(wait_s=10.0, sigma_creep=0.3)
TURN = STAND._replace(uniform_change=True)


def states_near(L, rng):
    """(L, 5) states side by side, with velocities of many directions."""
    xy, angle, speed = rng.normal([10.0, 10.0], 0.03, (L, 2)), rng.normal(0.3, 0.3, L), rng.uniform(0.7, 1.3, L)
    return np.column_stack([xy, speed * np.cos(angle), speed * np.sin(angle), speed])


def brute_force(later, regime, states, was, chances, dt, motion, width2):
    """(L,) densities of a later state given each of those before, from the equations of the module."""
    p0, gain, left = waypoint.gather(dt, motion)
    place2, velocity2 = width2  # the kernel's is the least width of a place, and adds to a velocity that is exact
    p0 = max(p0, place2)
    x, c, s = later[:2], later[2:4], later[4]
    out = []
    for state, r, chance in zip(states, was, chances, strict=True):
        x0, c0, s0 = state[:2], state[2:4], state[4]
        if regime == WAIT and motion.wait_s > 0:
            place, pull, rest = waypoint.waiting_noise(dt, motion, r == WAIT)
            place, rest = max(place, place2), max(rest, velocity2)
            c0 = c0 * (r == WAIT)
            v = x - x0 - c0 * dt
            density = multivariate_normal.pdf(v, np.zeros(2), place * np.eye(2))
            out.append(chance[WAIT] * density * multivariate_normal.pdf(c, c0 + pull * v, rest * np.eye(2)))
        elif regime == WAIT:
            place = multivariate_normal.pdf(x, x0, max(motion.sigma_waiting**2 * dt, place2) * np.eye(2))
            out.append(chance[WAIT] * place * multivariate_normal.pdf(c, c0, velocity2 * np.eye(2)))
        elif regime == TOWARDS:
            v = x - x0 - c0 * dt
            place = multivariate_normal.pdf(v, np.zeros(2), p0 * np.eye(2))
            out.append(
                chance[TOWARDS] * place * multivariate_normal.pdf(c, c0 + gain * v, (left + velocity2) * np.eye(2))
            )
        elif motion.uniform_change:
            # Midpoints of many parts of the step; the velocity before is 0 only in the paper's wait
            u = (np.arange(2000) + 0.5)[:, None] / 2000
            held = c0 * (r != WAIT or motion.wait_s > 0)
            v = x - x0 - dt * (u * held + (1 - u) * s0 * c / s)
            place = multivariate_normal.pdf(v, np.zeros(2), p0 * np.eye(2)).mean()
            speed = norm.pdf(s, s0, np.sqrt(left + gain**2 * waypoint.gather(dt, motion)[0] + velocity2))
            out.append(chance[CHANGE] * place * speed)
        else:
            v = x - x0 - s0 * dt * c / s
            place = multivariate_normal.pdf(v, np.zeros(2), p0 * np.eye(2))
            # The part of the noise along the way changes the speed
            speed = norm.pdf(s, s0 + gain * (v @ c) / s, np.sqrt(left + velocity2))
            out.append(chance[CHANGE] * place * speed)
    return np.array(out)


@pytest.mark.parametrize("motion", [PAPER, PEOPLE, STAND, TURN, PAPER._replace(uniform_change=True)])
@pytest.mark.parametrize(
    ("regime", "seed", "place2"), [(TOWARDS, 0, 0.0), (CHANGE, 1, 0.03), (WAIT, 2, 0.0), (WAIT, 3, 0.03)]
)
def test_parents_are_drawn_by_the_density_of_the_step(seed, place2, regime, motion):
    rng, L, M, dt = np.random.default_rng(seed), 12, 250, 0.4
    states, was, width2 = states_near(L, rng), rng.integers(0, 3, L), (place2, 0.2)
    chances = rng.dirichlet(np.ones(3), L)
    own = int(rng.integers(L))
    later = states[own].copy()
    if regime != WAIT or (motion.wait_s > 0 and was[own] == WAIT):
        later[:2] += dt * later[2:4]
    elif motion.wait_s > 0:
        later[2:4] *= 0.1
    candidates = rng.integers(0, L, 30)
    drawn = parents_of(
        np.tile(later, (M, 1)),
        np.full(M, regime),
        np.full(M, own),
        states,
        was,
        chances,
        candidates,
        dt,
        motion,
        width2,
        (np.arange(M) + 0.5) / M,
    )
    density = brute_force(later, regime, states, was, chances, dt, motion, width2)
    counts = np.bincount(candidates, minlength=L) + (np.arange(L) == own)
    share = counts * density / (counts @ density)
    # Evenly spaced numbers: each of its candidates is drawn as often as its share, but for one at either end
    found = np.bincount(drawn, minlength=L)
    assert (np.abs(found - share * M) <= counts + 1e-9).all()
    assert (share * M > 1.0).sum() > 2


def test_the_density_on_a_segment_is_the_mean_of_normal_densities_along_it():
    rng, u = np.random.default_rng(3), (np.arange(20_000) + 0.5)[:, None] / 20_000
    for length, variance in ((1e-9, 0.04), (0.01, 0.04), (0.3, 0.04), (3.0, 0.04), (3.0, 1e-3)):
        for _ in range(5):
            w = length * rng.normal(size=2)
            x = rng.uniform() * w + 1.5 * np.sqrt(variance) * rng.normal(size=2)
            wanted = np.exp(-0.5 * np.sum((x - u * w) ** 2, axis=1) / variance).mean()
            assert density_on_segment(*x, *w, variance) == pytest.approx(wanted, rel=1e-5)


@pytest.mark.parametrize("regime", [TOWARDS, CHANGE, WAIT])
def test_a_parent_stays_where_no_density_allows_any(regime):
    rng = np.random.default_rng(0)
    states = states_near(5, rng)
    later = states[[2]] + [[500.0, 0.0, 0.0, 0.0, 0.0]]
    drawn = parents_of(
        later, np.array([regime]), np.array([2]), states, np.full(5, WAIT), np.full((5, 3), 1 / 3), np.arange(5), 0.4,
        PEOPLE, (0.0, 0.1), np.array([0.5]),
    )  # fmt: skip
    assert drawn.tolist() == [2]


def test_a_particle_that_cannot_do_what_was_done_is_no_parent():
    states = np.tile(states_near(1, np.random.default_rng(0)), (3, 1))
    chances = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.2, 0.0, 0.8]])
    u = np.linspace(0.0, 0.999, 400)
    later, own = np.tile(states[0], (400, 1)), np.zeros(400, dtype=np.int64)
    drawn = parents_of(
        later,
        np.full(400, WAIT),
        own,
        states,
        np.zeros(3, dtype=np.int64),
        chances,
        np.arange(3),
        0.4,
        PEOPLE,
        (0.0, 0.1),
        u,
    )
    assert set(drawn.tolist()) == {1, 2}
    assert np.mean(drawn == 1) == pytest.approx(1 / 1.8, abs=0.01)


def test_without_noise_while_waiting_the_parent_of_one_that_waits_is_at_its_place():
    states = states_near(50, np.random.default_rng(1))
    still = PEOPLE._replace(sigma_waiting=0.0)
    own = np.arange(50)
    drawn = parents_of(
        states,
        np.full(50, WAIT),
        own,
        states,
        np.full(50, WAIT),
        np.full((50, 3), 1 / 3),
        own,
        0.4,
        still,
        (0.0, 0.1),
        np.full(50, 0.3),
    )
    assert drawn.tolist() == own.tolist()


def test_the_kernels_width_is_silvermans_for_equal_weights_and_counts_effective_particles():
    rng = np.random.default_rng(2)
    states = np.column_stack([np.zeros((1000, 2)), rng.normal([1.0, -2.0], 0.4, (1000, 2)), np.ones(1000)])
    equal = np.full(1000, 1e-3)
    states[:, :2] = rng.normal(5.0, 0.1, (1000, 2))
    variance = np.array([0.5 * np.trace(np.cov(part.T, bias=True)) for part in (states[:, :2], states[:, 2:4])])
    # h = sigma (4 / (n (d + 2)))^(1 / (d + 4)), d = 4
    silverman = variance * (4 / (1000 * 6)) ** (2 / 8)
    assert kernel_variance(states, equal) == pytest.approx(silverman, rel=1e-9)
    half = np.where(np.arange(1000) < 500, 2e-3, 0.0)
    few = 0.5 * np.trace(np.cov(states[:500, 2:4].T, bias=True)) * (4 / (500 * 6)) ** (2 / 8)
    assert kernel_variance(states, half)[1] == pytest.approx(few, rel=1e-9)


def test_particles_of_one_place_and_velocity_have_a_kernel_without_width():
    states = np.tile([1.0, 2.0, 0.6, 0.8, 1.0], (10, 1))
    assert kernel_variance(states, np.full(10, 0.1)) == pytest.approx((0.0, 0.0), abs=1e-12)
