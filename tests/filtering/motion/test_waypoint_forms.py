"""Each step of random waypoints by its equations, a particle at a time."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.core.plane import make_floor
from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import (
    CHANGE,
    MIN_STEP_VARIANCE,
    TOWARDS,
    WAIT,
    WaypointModel,
    WaypointParticles,
)

PAPER = WaypointModel(1.2, 0.33, 0.7, 0.85, 0.05, 0.06, 0.9)
PEOPLE = WaypointModel(1.0, 0.1, 0.2, 0.7, 0.25, 0.05, 0.9, sigma_velocity=0.5, sigma_waiting=0.05)
STAND = PEOPLE._replace(wait_s=8.0, sigma_creep=0.2)
STILL = WaypointModel(1.0, 0.0, 0.7, 0.85, 0.05, 0.06, 0.9)
MODELS = pytest.mark.parametrize("motion", [PAPER, PEOPLE, STAND, STILL], ids=["paper", "people", "stand", "still"])
DT = 0.4


def particles(seed: int) -> tuple[WaypointParticles, Floats, Floats, Floats]:
    """Particles of all regimes, some at their destination; new destinations, shares of the step before, and numbers."""
    rng, n = np.random.default_rng(seed), 12
    xy, destination = rng.uniform(20.0, 80.0, (n, 2)), rng.uniform(0.0, 100.0, (n, 2))
    destination[:3] = xy[:3]
    made = WaypointParticles(xy, destination, rng.uniform(0.5, 2.0, n), np.arange(n) % 3)
    return made, rng.uniform(0.0, 100.0, (n, 2)), rng.random(n), rng.standard_normal((n, 4))


def direction(d: Floats) -> Floats:
    """Unit vector of d; 0 if d is."""
    return d / np.hypot(*d) if d.any() else np.zeros(2)


class Noise(NamedTuple):
    """Of a step: variance of the position, gain of the velocity, and what is left of its variance."""

    variance: float
    gain: float
    left: float


def noise_of(regime: int, before: int, motion: WaypointModel) -> Noise:
    """The conditional Gaussian of the velocity given the position."""
    if regime == WAIT:
        q, sigma, stood = motion.sigma_creep**2, motion.sigma_waiting, before == WAIT and motion.wait_s > 0
        Q = q * np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]] if stood else [[DT**2, DT], [DT, 1.0]])
    else:
        q, sigma = motion.sigma_velocity**2, motion.sigma
        Q = q * np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])
    xx = Q[0, 0] + sigma**2 * DT
    if q == 0.0:
        return Noise(xx, 0.0 if regime == WAIT else motion.phi / motion.reference_s, 0.0)
    return Noise(xx, Q[0, 1] / xx, Q[1, 1] - Q[0, 1] ** 2 / xx)


def velocity_before(p: WaypointParticles, i: int, motion: WaypointModel) -> Floats:
    if p.regime[i] == WAIT:
        return (p.destination[i] - p.xy[i]) / 10.0 if motion.wait_s > 0 else np.zeros(2)
    return p.speed[i] * direction(p.destination[i] - p.xy[i])


def expected(p: WaypointParticles, i: int, regime: int, goal: Floats, u: float, motion: WaypointModel) -> Floats:
    """Position after the step without noise."""
    if regime == WAIT:
        creeps = p.regime[i] == WAIT
        return p.xy[i] + DT * (velocity_before(p, i, motion) if creeps else np.zeros(2))
    if regime == TOWARDS:
        return p.xy[i] + DT * p.speed[i] * direction(p.destination[i] - p.xy[i])
    after = p.speed[i] * direction(goal - p.xy[i])
    return p.xy[i] + DT * (u * velocity_before(p, i, motion) + (1.0 - u) * after)


@MODELS
@pytest.mark.parametrize("regime", [TOWARDS, CHANGE, WAIT])
@pytest.mark.parametrize("seed", range(2))
def test_a_step_is_that_of_the_equations(seed: int, regime: int, motion: WaypointModel) -> None:
    p, goals, u, noise = particles(seed)
    n, changing = len(u), len(u) if regime == CHANGE else 0
    after = waypoint.move(p, np.full(n, regime), goals[:changing], u[:changing], noise, DT, motion)
    for i in range(n):
        mean, own = expected(p, i, regime, goals[i], u[i], motion), noise_of(regime, p.regime[i], motion)
        xy = mean + np.sqrt(own.variance) * noise[i, :2]
        np.testing.assert_allclose(after.xy[i], xy, rtol=1e-12)
        goal, speed = goals[i] if regime == CHANGE else p.destination[i], p.speed[i]
        v = own.gain * (xy - mean) + np.sqrt(own.left) * noise[i, 2:]
        if regime == WAIT:
            if motion.wait_s > 0:
                goal = xy + 10.0 * (v + (velocity_before(p, i, motion) if p.regime[i] == WAIT else 0.0))
        else:
            e, T = direction(goal - p.xy[i]), motion.reference_s
            speed = (1.0 - motion.phi) * speed + motion.phi * np.hypot(*(speed * T * e + xy - mean)) / T
            if motion.sigma_velocity > 0.0 and e.any():
                c = speed * e + v
                speed, goal = np.hypot(*c), xy + np.hypot(*(goal - xy)) * direction(c)
        np.testing.assert_allclose(after.destination[i], goal, rtol=1e-9)
        assert after.speed[i] == pytest.approx(speed)
    assert (after.regime == regime).all()


@MODELS
def test_new_destinations_are_taken_in_order_by_those_that_change_theirs(motion: WaypointModel) -> None:
    p, goals, u, noise = particles(2)
    regime = np.arange(len(u)) // 2 % 3
    own = np.flatnonzero(regime == CHANGE)
    after = waypoint.move(p, regime, goals[own], u[own], np.zeros_like(noise), DT, motion)
    for i, r in enumerate(regime):
        np.testing.assert_allclose(after.xy[i], expected(p, i, r, goals[i], u[i], motion))


@MODELS
@pytest.mark.parametrize("dt", [DT, 0.07, 1.5])
def test_probabilities_of_regimes_and_the_regimes_that_are_drawn_by_them(dt: float, motion: WaypointModel) -> None:
    m = 400
    u = (np.arange(m) + 0.5) / m
    for before, arrived in product((TOWARDS, CHANGE, WAIT), (False, True)):
        n = min(1.0, dt / motion.reference_s)
        towards, change = (
            (motion.towards_reached, motion.change_reached) if arrived else (motion.towards, motion.change)
        )
        wanted = n * np.array([towards, change, 1.0 - towards - change])
        wanted[WAIT if before == WAIT else TOWARDS] += 1.0 - n
        if before == WAIT and motion.wait_s > 0:
            wanted = np.array([0.0, dt / motion.wait_s, 1.0 - dt / motion.wait_s])
        got = waypoint.regime_probabilities(np.array([before]), np.array([arrived]), dt, motion)[0]
        np.testing.assert_allclose(got, wanted, atol=1e-12)
        p = WaypointParticles(np.zeros((m, 2)), np.ones((m, 2)), np.ones(m), np.full(m, before))
        drawn = waypoint.choose_regimes(p, np.full(m, arrived), dt, motion, u)
        assert (np.abs(np.bincount(drawn, minlength=3) - m * wanted) <= 1.0).all()


@MODELS
def test_hypotheses_are_the_regimes_with_their_positions_and_variances(motion: WaypointModel) -> None:
    p, goals, u, _ = particles(3)
    arrived = np.arange(len(u)) % 2 == 0
    prior, mean, variance = waypoint.hypotheses(p, arrived, goals, u, DT, motion)
    np.testing.assert_array_equal(prior.T, waypoint.regime_probabilities(p.regime, arrived, DT, motion))
    for i, r in product(range(len(u)), range(3)):
        np.testing.assert_allclose(mean[r, i], expected(p, i, r, goals[i], u[i], motion))
        wanted = max(noise_of(r, p.regime[i], motion).variance, MIN_STEP_VARIANCE)
        assert variance[r, i] == pytest.approx(wanted, rel=1e-9, abs=0.0)


@MODELS
def test_headings_and_expected_positions(motion: WaypointModel) -> None:
    p, *_ = particles(4)
    arrived = np.arange(len(p.speed)) % 2 == 0
    headings, velocities = waypoint.headings(p, motion), waypoint.velocities(p)
    kappa, n = waypoint.expected_xy(p, arrived, DT, motion), DT / motion.reference_s
    for i in range(len(p.speed)):
        v = p.speed[i] * direction(p.destination[i] - p.xy[i])
        creeps = p.regime[i] == WAIT and motion.wait_s > 0
        own = velocity_before(p, i, motion) if creeps else v
        np.testing.assert_allclose(headings[i], [*p.xy[i], *own, p.speed[i]])
        np.testing.assert_allclose(velocities[i], 0.0 if p.regime[i] == WAIT else v)
        beta = motion.towards_reached if arrived[i] else motion.towards
        share = n * beta + (1.0 - n) * (p.regime[i] != WAIT)
        np.testing.assert_allclose(kappa[i], p.xy[i] + share * DT * v)


def test_a_destination_is_reached_within_the_way_of_a_reference_step_or_where_the_room_ends() -> None:
    room = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
    xy = np.array([[50.0, 50.0], [50.0, 50.0], [99.0, 50.0], [97.0, 50.0], [50.0, 2.9], [50.0, 3.1]])
    away = np.array([[2.0, 1.2], [2.0, 1.4], [9.0, 0.0], [9.0, 0.0], [0.0, -9.0], [0.0, -9.0]])
    # The way of a reference step is 2.0 * 1.2 = 2.4
    p = WaypointParticles(xy, xy + away, np.full(6, 2.0), np.zeros(6, dtype=np.int64))
    p.speed[4:] = 2.5
    assert waypoint.reached(p, PAPER, make_floor(room, [])).tolist() == [True, False, True, False, True, False]
