"""The filter that is expected: closed forms, every possible turn written out, and errors as large as it says."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from occlog.array_types import Floats
from occlog.plan.filtering import ExpectedPosteriors, FilterNoise, Motion, Reports, errors_along, noise_of, step_noise

DT = 0.1


def reports_of(information: Floats, seed: int = 0) -> Reports:
    chance = np.random.default_rng(seed).standard_normal((2, *information.shape[1:]))
    return Reports(information, noise_of(information, chance))


def sharp(seen: Floats, many: int, variance: float) -> Floats:
    """(3, many, T) information of places that are measured in both directions at steps (T,) with sight."""
    out = np.zeros((3, many, len(seen)))
    out[0] = out[2] = seen / variance
    return out


def walkers(motion: Motion, dt: float, steps: int, many: int) -> Floats:
    """(many, steps, 2) places of walkers who turn at random to velocities of a normal."""
    rng = np.random.default_rng(4)
    deviation, turn = motion.speed * math.sqrt(0.5), -math.expm1(-motion.turns * dt)
    x, v = rng.standard_normal((many, 2)), deviation * rng.standard_normal((many, 2))
    path = [x]
    for _ in range(steps - 1):
        new = deviation * rng.standard_normal((many, 2))
        v = np.where(rng.random((many, 1)) < turn, new, v)
        path.append(path[-1] + dt * v + motion.sigma * math.sqrt(dt) * rng.standard_normal((many, 2)))
    return np.ascontiguousarray(np.stack(path, axis=1))


def test_a_place_measured_ever_again_settles_where_the_equations_of_riccati_and_lyapunov_say():
    """Gains are those of a filter that expects noise, errors those of a walk that has less."""
    variance, sigma_v, sigma_a, sigma = 0.01, 0.1, 0.5, 0.05
    information = sharp(np.ones(600), 1, variance)
    ways, start = np.zeros((1, 600, 2)), (np.zeros(2), np.eye(2))
    motion = Motion(1.2, 1e-9, sigma)
    found = errors_along(ways, reports_of(information), start, motion, FilterNoise(sigma_v, sigma_a), DT).covariance[
        0, 0
    ]
    # One axis, written out
    F, H = np.array([[1.0, DT], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    white = np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]])
    believed = sigma_a**2 * white + np.diag([sigma_v**2 * DT, 0.0])
    P = solve_discrete_are(F.T, H.T, believed, np.array([[variance]]))
    K = P @ H.T / (P[0, 0] + variance)
    left = np.eye(2) - K @ H
    true = left @ np.diag([sigma**2 * DT, 0.0]) @ left.T + variance * K @ K.T
    R = solve_discrete_lyapunov(left @ F, true)
    np.testing.assert_allclose(found, R[0, 0] * np.eye(2), rtol=1e-6, atol=1e-12)
    assert R[0, 0] < 0.9 * P[0, 0] * variance / (P[0, 0] + variance)


def all_turns(ways: Floats, reports: Reports, prior: Floats, motion: Motion, dt: float) -> ExpectedPosteriors:
    """Mean and covariance of the last place over a Kalman filter for each set of steps at which a target may turn."""
    steps, turn, fresh = ways.shape[1], -math.expm1(-motion.turns * dt), 0.5 * motion.speed**2
    F = np.eye(4) + dt * np.eye(4, k=2)
    place, covariance = [], []
    for i in range(len(ways)):
        log, means, spreads = [], [], []
        for turns in itertools.product((False, True), repeat=steps - 1):
            x, P, chance = np.zeros(4), np.zeros((4, 4)), 0.0
            P[:2, :2], P[2:, 2:] = prior, fresh * np.eye(2)
            for t in range(steps):
                if t:
                    chance += math.log(turn if turns[t - 1] else 1.0 - turn)
                    if turns[t - 1]:
                        x, P = np.array([*x[:2], 0.0, 0.0]), P.copy()
                        P[:2, 2:], P[2:, :2], P[2:, 2:] = 0.0, 0.0, fresh * np.eye(2)
                    x, P = F @ x, F @ P @ F.T + np.diag([motion.sigma**2 * dt] * 2 + [0.0, 0.0])
                xx, xy, yy = reports.information[:, i, t]
                reported = np.array([[xx, xy], [xy, yy]])
                if not reported.any():
                    continue
                # Measurements along the axes of the information, one by one
                values, axes = np.linalg.eigh(reported)
                z = axes.T @ (reported @ ways[i, t] + reports.noise[:, i, t])
                for value, axis, measured in zip(values, axes.T, z, strict=True):
                    if value < 1e-9:
                        continue
                    h = np.array([*axis, 0.0, 0.0])
                    S = h @ P @ h + 1.0 / value
                    off = measured / value - h @ x
                    chance += -0.5 * math.log(S) - 0.5 * off**2 / S
                    x, P = x + P @ h * off / S, P - np.outer(P @ h, h @ P) / S
            log.append(chance)
            means.append(x[:2])
            spreads.append(P[:2, :2])
        weight = np.exp(np.array(log) - max(log))
        weight /= weight.sum()
        mean = weight @ np.array(means)
        off = np.array(means) - mean
        place.append([mean])
        covariance.append([np.einsum("k,kij->ij", weight, np.array(spreads) + off[:, :, None] * off[:, None])])
    return ExpectedPosteriors(np.array(place), np.array(covariance))


def test_a_few_hypotheses_stand_for_every_possible_turn():
    """Eight steps among them some that one camera alone sees and some that none does, against 128 sets of turns."""
    motion, dt, steps, many = Motion(1.2, 0.4, 0.05), 0.4, 8, 20
    ways = walkers(motion, dt, steps, many)
    information = sharp(np.array([1, 1, 1, 1, 0, 0, 1, 0]), many, 0.02)
    information[:, :, 4] = np.array([40.0, 20.0, 10.0])[:, None]
    reports = reports_of(information)
    found = errors_along(ways, reports, (np.zeros(2), np.eye(2)), motion, FilterNoise(0.0, 0.0), dt)
    exact = all_turns(ways, reports, np.eye(2), motion, dt)
    spread = np.sqrt(np.trace(exact.covariance[:, 0], axis1=1, axis2=2))
    off = np.hypot(*(found.position - exact.position)[:, 0].T)
    assert np.median(off / spread) < 0.02
    assert math.sqrt(np.mean(off**2)) < 0.1 * math.sqrt(np.mean(spread**2))
    reported = np.trace(found.covariance[:, 0], axis1=1, axis2=2)
    assert math.sqrt(reported.mean()) == pytest.approx(math.sqrt(np.mean(spread**2)), rel=0.03)


@pytest.mark.parametrize("belief", [FilterNoise(0.0, 0.0), FilterNoise(0.1, 0.5)])
def test_errors_are_as_large_as_they_are_reported_to_be(belief: FilterNoise):
    """Seen by two, by none, by one and by none again, 4000 walkers; error bars of the ratios are 0.4 to 2 %."""
    motion, steps, many = Motion(1.2, 0.4, 0.05), 100, 4000
    ways = walkers(motion, DT, steps, many)
    t = np.arange(steps)
    information = sharp((t < 50) | ((t >= 60) & (t < 70)), many, 0.01)
    information[0, :, 70:90] = 100.0
    found = errors_along(ways, reports_of(information), (np.zeros(2), np.eye(2)), motion, belief, DT, keep=60)
    square = np.sum((found.position - ways[:, 40:]) ** 2, axis=-1).mean(axis=0)
    reported = np.trace(found.covariance, axis1=-2, axis2=-1).mean(axis=0)
    for part in (slice(0, 10), slice(10, 20), slice(30, 50), slice(50, 60)):
        assert math.sqrt(square[part].mean()) == pytest.approx(math.sqrt(reported[part].mean()), rel=0.1)


def test_who_is_seen_to_walk_straight_on_by_one_camera_is_not_thought_to_turn():
    """The best linear filter, whose velocity is noise, is eleven times as unsure along the sight line after 2 s."""
    motion, steps = Motion(1.2, 0.5, 0.02), 70
    ways = np.zeros((1, steps, 2))
    ways[0, :, 1] = 1.2 * DT * np.arange(steps)
    information = sharp(np.ones(steps), 1, 1e-4)
    information[0, :, 50:] = 0.0
    reports = Reports(information, np.zeros((2, 1, steps)))
    found = errors_along(ways, reports, (np.zeros(2), np.eye(2)), motion, FilterNoise(0.0, 0.0), DT).covariance[0, 0]
    # Velocity of the linear filter: an Ornstein-Uhlenbeck process of the same second moments
    r, fresh, k = motion.turns, 0.5 * motion.speed**2, 20 * DT
    linear = fresh * (2.0 * (k - (1.0 - math.exp(-r * k)) / r) / r - ((1.0 - math.exp(-r * k)) / r) ** 2)
    assert math.sqrt(found[0, 0]) < 0.2 * math.sqrt(linear)


def test_no_one_seen_is_as_far_off_as_the_room_is_wide_and_the_velocity_of_many_turns_makes():
    motion, steps = Motion(1.2, 0.5, 0.05), 60
    nothing = np.zeros((3, 1, steps))
    found = errors_along(
        np.zeros((1, steps, 2)), reports_of(nothing), (np.ones(2), 4.0 * np.eye(2)), motion, FilterNoise(0.0, 0.0), DT
    )
    # Steps of a velocity that is drawn again with a probability at each
    stay = math.exp(-motion.turns * DT)
    lags = np.abs(np.subtract.outer(np.arange(steps - 1), np.arange(steps - 1)))
    moved = 0.5 * motion.speed**2 * DT**2 * np.sum(stay**lags)
    expected = 4.0 + moved + motion.sigma**2 * DT * (steps - 1)
    np.testing.assert_allclose(found.covariance[0, 0], expected * np.eye(2), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.position[0, 0], np.ones(2), atol=1e-12)


def test_noise_has_the_covariance_of_the_information():
    information = np.broadcast_to(np.array([4.0, -1.0, 2.0])[:, None, None], (3, 1, 200_000)).copy()
    noise = reports_of(information).noise[:, 0]
    np.testing.assert_allclose(np.cov(noise), [[4.0, -1.0], [-1.0, 2.0]], atol=0.05)
    assert not reports_of(np.zeros((3, 1, 5))).noise.any()


def test_noise_of_a_step_is_that_of_many_small_ones():
    whole = step_noise(0.05, 0.5, 0.7, 0.1)
    P, F, tiny = np.zeros((2, 2)), np.array([[1.0, 0.1 / 200], [0.0, 1.0]]), step_noise(0.05, 0.5, 0.7, 0.1 / 200)
    for _ in range(200):
        P = F @ P @ F.T + np.array([[tiny.position, tiny.both], [tiny.both, tiny.velocity]])
    np.testing.assert_allclose(P, [[whole.position, whole.both], [whole.both, whole.velocity]], rtol=1e-9)
