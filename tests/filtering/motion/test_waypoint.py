from __future__ import annotations

import numpy as np
import pytest

from occlog.core.plane import make_floor
from occlog.filtering.motion import waypoint
from occlog.filtering.motion.waypoint import CHANGE, TOWARDS, WAIT, WaypointModel, WaypointParticles

ROOM = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
PILLAR = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
PAPER = WaypointModel(1.0, 0.33, 0.7, 0.9, 0.05, 0.05, 0.9)
AT_ONCE = np.zeros(100_000)  # all changes are at the beginning of the step
FLOOR = make_floor(ROOM, [PILLAR])


def particles(n, xy=(20.0, 20.0), destination=(80.0, 20.0), speed=1.0, regime=TOWARDS):
    return WaypointParticles(
        np.tile(np.array(xy), (n, 1)),
        np.tile(np.array(destination), (n, 1)),
        np.full(n, speed),
        np.full(n, regime, dtype=np.int64),
    )


def run(n, motion, dt, steps, rng, waiting=0.0, **start):
    """Particles after some steps, with destinations anywhere in the room; a share of them waits at first."""
    p = particles(n, **start)
    if waiting:
        p = p._replace(regime=np.where(rng.random(n) < waiting, WAIT, p.regime))
    for _ in range(steps):
        arrived = waypoint.reached(p, motion, FLOOR)
        regime = waypoint.choose_regimes(p, arrived, dt, motion, rng.random(n))
        positions = rng.uniform(0, 100, (int(np.sum(regime == CHANGE)), 2))
        p = waypoint.move(p, regime, positions, AT_ONCE, rng.standard_normal((n, 2)), dt, motion)
    return p


def test_a_step_towards_the_destination_has_the_moments_of_equation_5():
    n = 200_000
    rng = np.random.default_rng(0)
    p = waypoint.move(
        particles(n, speed=2.0),
        np.zeros(n, dtype=np.int64),
        np.empty((0, 2)),
        AT_ONCE,
        rng.standard_normal((n, 2)),
        1.0,
        PAPER,
    )
    error = 4 * 0.33 / np.sqrt(n)  # 4 standard errors
    np.testing.assert_allclose(p.xy.mean(axis=0), [22.0, 20.0], atol=error)
    np.testing.assert_allclose(np.cov(p.xy.T), 0.33**2 * np.eye(2), atol=4 * 0.33**2 * np.sqrt(2 / n))
    # s' = (1 - phi) s + phi |x' - x|, as printed
    moved = np.hypot(*(p.xy - [20.0, 20.0]).T)
    np.testing.assert_allclose(p.speed, 0.3 * 2.0 + 0.7 * moved, rtol=1e-12)
    np.testing.assert_array_equal(p.destination, [[80.0, 20.0]] * n)


def test_a_waiting_particle_stays_and_a_changing_one_goes_to_its_new_destination():
    p = particles(3)
    regime = np.array([WAIT, CHANGE, CHANGE])
    after = waypoint.move(p, regime, np.array([[20.0, 90.0], [0.0, 20.0]]), AT_ONCE, np.zeros((3, 2)), 1.0, PAPER)
    np.testing.assert_allclose(after.xy, [[20.0, 20.0], [20.0, 21.0], [19.0, 20.0]])
    np.testing.assert_array_equal(after.destination, [[80.0, 20.0], [20.0, 90.0], [0.0, 20.0]])
    np.testing.assert_array_equal(after.regime, regime)
    np.testing.assert_array_equal(p.xy, [[20.0, 20.0]] * 3)  # the old particles are as they were


@pytest.mark.parametrize(("arrived", "probabilities"), [(False, [0.9, 0.05, 0.05]), (True, [0.05, 0.9, 0.05])])
def test_regimes_of_a_reference_step_have_the_papers_probabilities(arrived, probabilities):
    n = 100_000
    u = np.random.default_rng(1).random(n)
    regime = waypoint.choose_regimes(particles(n, regime=WAIT), np.full(n, arrived), 1.0, PAPER, u)
    share = np.bincount(regime, minlength=3) / n
    np.testing.assert_allclose(share, probabilities, atol=4 * 0.5 / np.sqrt(n))  # 4 standard errors


def test_between_decisions_the_last_regime_goes_on():
    n = 1000
    u = np.full(n, 0.99)  # no decision in a tenth of a reference step
    for regime, kept in ((WAIT, WAIT), (TOWARDS, TOWARDS), (CHANGE, TOWARDS)):
        chosen = waypoint.choose_regimes(particles(n, regime=regime), np.zeros(n, dtype=bool), 0.1, PAPER, u)
        assert set(chosen.tolist()) == {kept}


@pytest.mark.jit
@pytest.mark.parametrize("parts", [1, 4, 20])
def test_the_model_does_not_depend_on_how_a_second_is_cut(parts):
    """Share of changed destinations and times of the displacement after one reference step."""
    n, motion = 60_000, WaypointModel(1.0, 0.33, 0.1, 0.9, 0.05, 0.05, 0.9)
    p = run(n, motion, 1.0 / parts, parts, np.random.default_rng(parts), waiting=0.05, speed=1.5)
    went = p.xy - [20.0, 20.0]
    kept = np.all(p.destination == [80.0, 20.0], axis=1)
    # With many short steps a destination is kept with probability exp(-0.05) = 0.951 instead of 0.95.
    assert abs(kept.mean() - 0.95) < 0.0015 + 4 * np.sqrt(0.05 * 0.95 / n)
    # Who moved all the time or waited all the time has the mean and spread of Eq. 5; W is rarer than MTD.
    along, across = went[kept, 0], went[kept, 1]
    assert abs(along.mean() - 1.5 * 0.9 / 0.95) < 0.02 + 4 * 0.5 / np.sqrt(n)
    assert across.var() == pytest.approx(0.33**2 * 0.9 / 0.95, rel=0.03)
    assert p.speed.mean() == pytest.approx(1.5, abs=0.02)


@pytest.mark.jit
def test_the_speed_of_short_steps_does_not_run_away():
    """Written with |x' - x| / dt, the speed would grow by sigma / sqrt(dt) in every step."""
    motion = WaypointModel(1.0, 0.33, 0.3, 1.0, 0.0, 1.0, 0.0)
    speeds = {dt: run(4000, motion, dt, round(5 / dt), np.random.default_rng(3)).speed for dt in (1.0, 0.01)}
    assert speeds[0.01].mean() == pytest.approx(speeds[1.0].mean(), abs=0.05)
    assert speeds[0.01].std() == pytest.approx(speeds[1.0].std(), rel=0.1)


def test_a_destination_is_reached_within_a_reference_step_or_when_the_way_is_blocked():
    places = [(79.5, 20.0), (78.5, 20.0), (80.0, 20.0), (39.5, 50.0), (38.5, 50.0), (0.3, 50.0)]
    destinations = [(80.0, 20.0), (80.0, 20.0), (80.0, 20.0), (90.0, 50.0), (90.0, 50.0), (-50.0, 50.0)]
    n = len(places)
    p = particles(n)._replace(xy=np.array(places), destination=np.array(destinations))
    assert waypoint.reached(p, PAPER, FLOOR).tolist() == [True, False, True, True, False, True]


@pytest.mark.jit
def test_the_expected_position_is_the_mean_of_the_particles_that_keep_their_destination():
    n, dt = 200_000, 0.25
    motion = WaypointModel(1.0, 0.33, 0.1, 0.85, 0.0, 0.05, 0.9)
    for regime in (TOWARDS, WAIT):
        p = particles(n, speed=4.0, regime=regime)
        kappa = waypoint.expected_xy(p, np.zeros(n, dtype=bool), dt, motion)
        after = run(n, motion, dt, 1, np.random.default_rng(5), speed=4.0, regime=regime)
        np.testing.assert_allclose(after.xy.mean(axis=0), kappa[0], atol=4 * 0.6 / np.sqrt(n))
        np.testing.assert_array_equal(kappa, kappa[:1].repeat(n, axis=0))


def test_a_particle_at_its_destination_has_no_direction():
    p = particles(1, destination=(20.0, 20.0))
    np.testing.assert_array_equal(waypoint.expected_xy(p, np.array([True]), 1.0, PAPER), p.xy)
    after = waypoint.move(p, np.array([TOWARDS]), np.empty((0, 2)), AT_ONCE, np.zeros((1, 2)), 1.0, PAPER)
    np.testing.assert_array_equal(after.xy, p.xy)
    np.testing.assert_array_equal(waypoint.velocities(p), [[0.0, 0.0]])


def test_velocities_point_to_the_destination_and_vanish_while_waiting():
    p = particles(2, destination=(23.0, 24.0), speed=2.0)._replace(regime=np.array([TOWARDS, WAIT]))
    np.testing.assert_allclose(waypoint.velocities(p), [[1.2, 1.6], [0.0, 0.0]])


def test_new_particles_have_destinations_on_the_floor_and_positive_speeds():
    rng = np.random.default_rng(8)
    p = waypoint.start_particles(np.full((5000, 2), 20.0), FLOOR, 1.0, 1.0, rng)
    inside = (p.destination > 40).all(axis=1) & (p.destination < 60).all(axis=1)
    assert not inside.any()
    assert (p.speed >= 0).all()
    assert p.speed.std() > 0.5


def test_each_particle_that_changes_takes_the_next_destination():
    p = particles(4)
    regime = np.array([CHANGE, WAIT, CHANGE, CHANGE])
    new = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    moved = waypoint.move(p, regime, new, AT_ONCE, np.zeros((4, 2)), 1.0, PAPER)
    assert moved.destination.tolist() == [[1.0, 2.0], [80.0, 20.0], [3.0, 4.0], [5.0, 6.0]]


def test_the_new_speed_is_that_of_a_reference_step():
    """s' = (1 - phi) s + phi |s T e + v| / T, with T = 0.5 s and noise of the step across the way."""
    motion = PAPER._replace(reference_s=0.5)
    noise = np.array([[0.0, 3.0]])
    moved = waypoint.move(particles(1, speed=2.0), np.array([TOWARDS]), np.empty((0, 2)), AT_ONCE, noise, 0.25, motion)
    across = 0.33 * np.sqrt(0.25) * 3.0
    assert moved.speed[0] == pytest.approx(0.3 * 2.0 + 0.7 * np.hypot(2.0 * 0.5, across) / 0.5)
    np.testing.assert_allclose(moved.xy, [[20.0 + 2.0 * 0.25, 20.0 + across]])


@pytest.mark.parametrize(("distance", "reached"), [(2.0, False), (np.nextafter(2.0, 0.0), True), (0.0, True)])
def test_a_destination_a_whole_reference_step_away_is_not_reached_yet(distance, reached):
    p = particles(1, xy=(0.0, 20.0), destination=(distance, 20.0), speed=2.0)
    assert waypoint.reached(p, PAPER, FLOOR).tolist() == [reached]


@pytest.mark.parametrize("regime", [TOWARDS, WAIT])
def test_in_half_a_reference_step_half_of_the_particles_decide(regime):
    p = particles(1, speed=2.0, regime=regime)
    got = waypoint.expected_xy(p, np.array([False]), 0.5, PAPER)
    going = 0.5 * 0.9 + 0.5 * (regime == TOWARDS)
    np.testing.assert_allclose(got, [[20.0 + going * 2.0 * 0.5, 20.0]])
    # 0.9 go on, 0.05 change, 0.05 wait, each times one half; the rest does as before
    for limit, below, above in ((0.45, TOWARDS, CHANGE), (0.475, CHANGE, WAIT), (0.5, WAIT, regime)):
        for u, want in ((limit - 1e-9, below), (limit + 1e-9, above)):
            assert waypoint.choose_regimes(p, np.array([False]), 0.5, PAPER, np.array([u])).tolist() == [want]
