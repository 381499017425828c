"""What particles may do in a step, with noise of velocity and of waiting: moments, frequencies and densities."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.plane import make_floor
from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import CHANGE, MIN_STEP_VARIANCE, TOWARDS, WAIT, WaypointModel, WaypointParticles

ROOM = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
FLOOR = make_floor(ROOM, [])
PAPER = WaypointModel(1.0, 0.33, 0.7, 0.9, 0.05, 0.05, 0.9)
AT_ONCE = np.zeros(100_000)  # all changes are at the beginning of the step
PEOPLE = WaypointModel(1.0, 0.1, 0.0, 0.7, 0.25, 0.05, 0.9, sigma_velocity=0.5, sigma_waiting=0.05)
STAND = PEOPLE._replace(wait_s=10.0, sigma_creep=0.2)


def mixed(n, rng):
    """Particles in all regimes, some of which have no way to go."""
    xy = rng.uniform(20, 80, (n, 2))
    destination = np.where(rng.random((n, 1)) < 0.1, xy, rng.uniform(0, 100, (n, 2)))
    return WaypointParticles(xy, destination, rng.uniform(0, 2, n), rng.integers(0, 3, n))


def similar(n, regime=TOWARDS, speed=1.5):
    return WaypointParticles(
        np.tile([20.0, 20.0], (n, 1)), np.tile([60.0, 50.0], (n, 1)), np.full(n, speed), np.full(n, regime)
    )


@pytest.mark.jit
@pytest.mark.parametrize("dt", [0.04, 0.2, 1.0])
def test_what_noise_gathers_is_that_of_white_acceleration(dt):
    """Place and velocity of many short steps of a walk whose velocity diffuses."""
    rng, n, parts = np.random.default_rng(1), 40_000, 200
    h, q, p = dt / parts, PEOPLE.sigma_velocity, PEOPLE.sigma
    place, velocity = np.zeros(n), np.zeros(n)
    for _ in range(parts):
        place += h * velocity + p * np.sqrt(h) * rng.standard_normal(n)
        velocity += q * np.sqrt(h) * rng.standard_normal(n)
    variance, gain, left = waypoint.gather(dt, PEOPLE)
    found = np.cov(place, velocity)
    error = 5 * np.sqrt(2 / n) + 2 / parts
    assert variance == pytest.approx(found[0, 0], rel=error)
    assert gain * variance == pytest.approx(found[0, 1], rel=2 * error, abs=5 * np.sqrt(variance * q * q * dt / n))
    assert left + gain**2 * variance == pytest.approx(found[1, 1], rel=error)
    assert left >= 0.0


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_without_noise_of_the_velocity_the_gain_is_that_of_the_papers_speed(dt):
    motion = PAPER._replace(reference_s=2.0)
    assert waypoint.gather(dt, motion) == pytest.approx((0.33**2 * dt, 0.7 / 2.0, 0.0))


def test_noise_of_the_velocity_alone_leaves_a_quarter_of_its_variance():
    """White acceleration: place dt^3/3, both dt^2/2, velocity dt; given the place a quarter of dt is left."""
    variance, gain, left = waypoint.gather(0.4, PEOPLE._replace(sigma=0.0))
    assert (variance, gain, left) == pytest.approx((0.25 * 0.4**3 / 3, 1.5 / 0.4, 0.25 * 0.4 / 4))


@pytest.mark.jit
@pytest.mark.parametrize("dt", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("arrived", [False, True])
@pytest.mark.parametrize("regime", [TOWARDS, CHANGE, WAIT])
@pytest.mark.parametrize("motion", [PEOPLE, STAND])
def test_chances_are_the_frequencies_of_the_regimes(motion, regime, arrived, dt):
    n = 100_000
    there = np.full(n, arrived)
    drawn = waypoint.choose_regimes(similar(n, regime), there, dt, motion, np.random.default_rng(2).random(n))
    chances = waypoint.regime_probabilities(np.full(1, regime), there[:1], dt, motion)[0]
    assert chances.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(np.bincount(drawn, minlength=3) / n, chances, atol=4 * 0.5 / np.sqrt(n))


def test_chances_of_a_step_longer_than_the_reference_step_are_those_of_one():
    args = np.array([WAIT]), np.array([False])
    np.testing.assert_array_equal(
        waypoint.regime_probabilities(*args, 1.5, PEOPLE), waypoint.regime_probabilities(*args, 1.0, PEOPLE)
    )


@pytest.mark.jit
@pytest.mark.parametrize("before", [TOWARDS, WAIT])
@pytest.mark.parametrize("motion", [PAPER, PEOPLE, STAND])
@pytest.mark.parametrize("regime", [TOWARDS, CHANGE, WAIT])
def test_hypotheses_have_the_moments_of_the_particles_that_follow_them(regime, motion, before):
    n, dt, rng = 100_000, 0.4, np.random.default_rng(regime)
    goal = np.array([10.0, 35.0])
    one = similar(1, before)
    _, mean, variance = waypoint.hypotheses(one, np.array([False]), goal[None], AT_ONCE, dt, motion)
    goals = np.tile(goal, (n, 1))
    after = waypoint.move(
        similar(n, before), np.full(n, regime), goals, AT_ONCE, rng.standard_normal((n, 4)), dt, motion
    )
    spread = np.sqrt(variance[regime, 0])
    np.testing.assert_allclose(after.xy.mean(axis=0), mean[regime, 0], atol=max(4 * spread / np.sqrt(n), 1e-9))
    if variance[regime, 0] > MIN_STEP_VARIANCE:
        np.testing.assert_allclose(np.cov(after.xy.T), variance[regime, 0] * np.eye(2), atol=5 * spread**2 / np.sqrt(n))
    else:  # in the paper's model who waits does not move
        np.testing.assert_array_equal(after.xy, one.xy.repeat(n, axis=0))


@pytest.mark.jit
@pytest.mark.parametrize("before", [TOWARDS, WAIT])
@pytest.mark.parametrize("motion", [PAPER, STAND])
def test_changes_at_any_time_of_a_step_have_the_moments_of_short_steps(motion, before):
    """A particle that goes on for u of 400 short steps, u drawn evenly, and then to its new destination."""
    n, dt, parts, rng = 40_000, 0.4, 400, np.random.default_rng(11)
    one, goal = similar(1, before), np.array([10.0, 35.0])
    u = (rng.permutation(n) + 0.5) / n
    quiet = motion._replace(sigma=0.0, sigma_velocity=0.0, phi=0.0)
    regime, goals = np.full(n, CHANGE), np.tile(goal, (n, 1))
    after = waypoint.move(similar(n, before), regime, goals, u, np.zeros((n, 4)), dt, quiet)
    # Short steps of one particle, the first k of them as before
    old = waypoint.hypotheses(one, np.array([False]), goal[None], np.zeros(1), dt, quiet)[1]
    held = (old[WAIT if before == WAIT else TOWARDS, 0] - one.xy[0]) / parts
    new = (old[CHANGE, 0] - one.xy[0]) / parts
    path = np.array([one.xy[0] + k * held + (parts - k) * new for k in range(parts + 1)])
    np.testing.assert_allclose(after.xy.mean(axis=0), path.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(np.cov(after.xy.T), np.cov(path.T, bias=True), rtol=1e-2, atol=1e-9)
    # The approximations of all particles have the positions at which they change
    _, mean, variance = waypoint.hypotheses(similar(n, before), np.zeros(n, dtype=bool), goals, u, dt, quiet)
    np.testing.assert_allclose(mean[CHANGE], after.xy, atol=1e-9)
    assert (variance[CHANGE] == MIN_STEP_VARIANCE).all()


def test_hypotheses_of_a_particle_sum_to_one_and_are_never_without_variance():
    rng = np.random.default_rng(4)
    p = mixed(500, rng)
    arrived = waypoint.reached(p, PAPER, FLOOR)
    prior, mean, variance = waypoint.hypotheses(
        p, arrived, rng.uniform(0, 100, (500, 2)), AT_ONCE, 0.3, PAPER._replace(sigma=0)
    )
    np.testing.assert_allclose(prior.sum(axis=0), 1.0, atol=1e-12)
    assert (prior >= 0).all()
    assert (variance > 0).all()
    np.testing.assert_array_equal(mean[WAIT], p.xy)
    way = np.hypot(*(p.destination - p.xy).T)
    at = np.hypot(*(mean[TOWARDS] - p.xy).T)
    np.testing.assert_allclose(at, np.where(way > 0, 0.3 * p.speed, 0.0), atol=1e-9)


@pytest.mark.jit
def test_the_velocity_of_a_moving_particle_diffuses_and_turns_its_destination_with_it():
    n, dt, rng = 100_000, 0.5, np.random.default_rng(5)
    start = similar(n)
    before = waypoint.velocities(similar(1))[0]
    after = waypoint.move(
        start, np.full(n, TOWARDS), np.empty((0, 2)), AT_ONCE, rng.standard_normal((n, 4)), dt, PEOPLE
    )
    velocity = waypoint.velocities(after)
    error = 5 * PEOPLE.sigma_velocity * np.sqrt(dt) / np.sqrt(n)
    np.testing.assert_allclose(velocity.mean(axis=0), before, atol=error)
    expected = PEOPLE.sigma_velocity**2 * dt * np.eye(2)
    np.testing.assert_allclose(np.cov(velocity.T), expected, atol=6 * expected.max() / np.sqrt(n))
    # The destination is as far as it was from where the particle came to, and lies along the velocity
    far = np.hypot(*(start.destination - after.xy).T)
    np.testing.assert_allclose(np.hypot(*(after.destination - after.xy).T), far, rtol=1e-9)
    np.testing.assert_allclose(np.hypot(*velocity.T), after.speed, rtol=1e-9)


@pytest.mark.jit
def test_place_and_velocity_are_correlated_as_white_acceleration_correlates_them():
    n, dt, rng = 100_000, 0.5, np.random.default_rng(6)
    after = waypoint.move(
        similar(n), np.full(n, TOWARDS), np.empty((0, 2)), AT_ONCE, rng.standard_normal((n, 4)), dt, PEOPLE
    )
    velocity = waypoint.velocities(after)
    both = np.cov(after.xy[:, 0], velocity[:, 0])[0, 1]
    assert both == pytest.approx(PEOPLE.sigma_velocity**2 * dt**2 / 2, rel=0.05)


@pytest.mark.jit
def test_one_that_waits_jitters_and_keeps_speed_and_destination():
    n, dt, rng = 100_000, 0.2, np.random.default_rng(7)
    before = similar(n)
    after = waypoint.move(before, np.full(n, WAIT), np.empty((0, 2)), AT_ONCE, rng.standard_normal((n, 4)), dt, PEOPLE)
    expected = PEOPLE.sigma_waiting**2 * dt
    np.testing.assert_allclose(np.cov(after.xy.T), expected * np.eye(2), atol=6 * expected / np.sqrt(n))
    np.testing.assert_array_equal(after.speed, before.speed)
    np.testing.assert_array_equal(after.destination, before.destination)


def test_one_that_stands_decides_to_leave_once_in_the_time_it_waits_and_goes_elsewhere():
    for dt, leaves in ((0.2, 0.02), (1.0, 0.1)):
        for arrived in (False, True):
            chances = waypoint.regime_probabilities(np.array([WAIT]), np.array([arrived]), dt, STAND)[0]
            np.testing.assert_allclose(chances[[TOWARDS, CHANGE, WAIT]], [0.0, leaves, 1.0 - leaves])
    short = STAND._replace(wait_s=0.5)
    np.testing.assert_array_equal(
        waypoint.regime_probabilities(np.array([WAIT]), np.array([False]), 1.0, short)[0], [0.0, 1.0, 0.0]
    )


@pytest.mark.jit
@pytest.mark.parametrize("stood", [False, True])
def test_one_that_stands_creeps_as_white_acceleration_moves_it_and_keeps_its_speed(stood):
    n, dt, rng = 100_000, 0.5, np.random.default_rng(8)
    before = similar(n, WAIT if stood else TOWARDS)
    after = waypoint.move(before, np.full(n, WAIT), np.empty((0, 2)), AT_ONCE, rng.standard_normal((n, 4)), dt, STAND)
    creep = waypoint.headings(after, STAND)[:, 2:4]
    q = STAND.sigma_creep**2
    place = STAND.sigma_waiting**2 * dt + (q * dt**3 / 3 if stood else q * dt**2)
    both, velocity = (q * dt**2 / 2, q * dt) if stood else (q * dt, q)
    found = np.cov(after.xy[:, 0], creep[:, 0])
    np.testing.assert_allclose(found, [[place, both], [both, velocity]], atol=6 * velocity / np.sqrt(n))
    was = (before.destination[0] - before.xy[0]) / waypoint.WAITING_DESTINATION_S if stood else np.zeros(2)
    np.testing.assert_allclose(creep.mean(axis=0), was, atol=5 * np.sqrt(velocity / n))
    np.testing.assert_array_equal(after.speed, before.speed)


def test_one_that_stands_without_any_noise_stays_where_it_is():
    still = STAND._replace(sigma_waiting=0.0, sigma_creep=0.0)
    after = waypoint.move(similar(5), np.full(5, WAIT), np.empty((0, 2)), AT_ONCE, np.ones((5, 4)), 0.5, still)
    np.testing.assert_array_equal(after.xy, similar(5).xy)
    np.testing.assert_array_equal(waypoint.headings(after, still)[:, 2:4], 0.0)


@pytest.mark.parametrize("motion", [PEOPLE, STAND])
@pytest.mark.parametrize("seed", range(3))
def test_arriving_where_noise_leads_is_moving_there(seed, motion):
    """`move` draws the place and calls `arrive`; given the same places both give the same particles."""
    rng = np.random.default_rng(seed)
    p, n, dt = mixed(200, rng), 200, 0.3
    regime, noise, goals = rng.integers(0, 3, n), rng.standard_normal((n, 4)), rng.uniform(0, 100, (n, 2))
    moved = waypoint.move(p, regime, goals[regime == CHANGE], AT_ONCE, noise, dt, motion)
    _, mean, _ = waypoint.hypotheses(p, np.zeros(n, dtype=bool), goals, AT_ONCE, dt, motion)
    again = waypoint.arrive(p, regime, goals, mean[regime, np.arange(n)], moved.xy, noise[:, 2:], dt, motion)
    for a, b in zip(moved, again, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_without_the_added_noises_a_step_is_the_papers(seed):
    rng = np.random.default_rng(seed)
    p, n, dt = mixed(200, rng), 200, 0.5
    regime, noise, goals = rng.integers(0, 3, n), rng.standard_normal((n, 4)), rng.uniform(0, 100, (n, 2))
    after = waypoint.move(p, regime, goals[regime == CHANGE], AT_ONCE, noise, dt, PAPER)
    goal = np.where((regime == CHANGE)[:, None], goals, p.destination)
    way = goal - p.xy
    e = way / np.maximum(np.hypot(*way.T), 1e-300)[:, None]
    v = 0.33 * np.sqrt(dt) * noise[:, :2]
    moves = regime != WAIT
    xy = np.where(moves[:, None], p.xy + dt * p.speed[:, None] * e + v, p.xy)
    speed = 0.3 * p.speed + 0.7 * np.hypot(*(p.speed[:, None] * e + v).T)
    np.testing.assert_allclose(after.xy, xy, rtol=1e-12)
    np.testing.assert_allclose(after.speed, np.where(moves, speed, p.speed), rtol=1e-12)
    np.testing.assert_array_equal(after.destination, goal)


def test_headings_hold_place_and_velocity_also_of_those_that_wait():
    p = similar(3)._replace(regime=np.array([TOWARDS, CHANGE, WAIT]))
    np.testing.assert_allclose(waypoint.headings(p, PEOPLE), [[20.0, 20.0, 1.2, 0.9, 1.5]] * 3)
    still = p._replace(destination=p.xy)
    np.testing.assert_allclose(waypoint.headings(still, PEOPLE), [[20.0, 20.0, 0.0, 0.0, 1.5]] * 3)
