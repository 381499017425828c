"""The choice of true sight lines against all subsets, crossings and costs against textbook forms."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.track.methods.map.kernels.gauss_markov import constant_velocity
from occlog.track.methods.map.kernels.problem import chain
from occlog.track.methods.map.kernels.ransac_path import (
    MAX_CROSSINGS,
    BearingHalfLines,
    _around,
    _births,
    _merge,
    agreed_path,
    candidates,
    crossing,
    empty_beam,
    inlier_cost,
    off_line,
    off_line2,
)

K = 3.7
GROUND = np.array([1.0, 2.0, 20.0])


def rays(step, sensor, place, angle, a=1e-4, b=0.0, reach=math.inf) -> BearingHalfLines:
    n = len(step)
    return BearingHalfLines(
        step=np.array(step, dtype=np.int64),
        sensor=np.array(sensor, dtype=np.int64),
        position=np.array(place, dtype=float).reshape(-1, 2),
        direction=np.column_stack([np.cos(angle), np.sin(angle)]),
        a=np.full(n, a),
        b=np.full(n, b),
        reach=np.full(n, reach),
    )


def towards(places, xy):
    away = np.asarray(xy, dtype=float) - np.asarray(places, dtype=float)
    return np.arctan2(away[:, 1], away[:, 0])


PLACES = np.array([[-5.0, 0.0], [5.0, 0.0], [0.0, -6.0]])


def walk(T: int, rng, false=()):
    """Three sensors point at a straight walk at 1 Hz; some sight lines are false."""
    truth = np.column_stack([-1.0 + 0.3 * np.arange(T), 1.0 + 0.1 * np.arange(T)])
    step = np.repeat(np.arange(T), 3)
    sensor = np.tile(np.arange(3), T)
    angle = towards(PLACES[sensor], truth[step]) + 0.01 * rng.standard_normal(3 * T)
    for n in false:
        angle[n] += 0.6
    made = rays(step, sensor, PLACES[sensor], angle)
    steps = chain(constant_velocity(0.3, 0.0, 1.0), np.ones(T - 1), np.zeros(4), np.diag([25.0, 1.0, 25.0, 1.0]))
    return made, np.searchsorted(step, np.arange(T + 1)), np.arange(T, dtype=float), steps, truth


def filter_cost(made: BearingHalfLines, first, steps, believed) -> float:
    """The cost of one choice by a plain Kalman filter from the prior of the first state."""
    x, P, total = steps.mean.copy(), steps.spread.copy(), 0.0
    for t in range(len(first) - 1):
        if t:
            A, Q = steps.A[steps.kind[t - 1]], steps.sigma[steps.kind[t - 1]]
            x, P = A @ x, A @ P @ A.T + Q
        for n in range(first[t], first[t + 1]):
            if not believed[n]:
                total += K**2
                continue
            c, s = made.direction[n]
            H = np.array([-s, 0.0, c, 0.0])
            along = np.array([c, 0.0, s, 0.0])
            forth = along @ x - np.array([c, s]) @ made.position[n]
            R = made.a[n] * (forth**2 + along @ P @ along) + made.b[n]
            e = H @ x - np.array([-s, c]) @ made.position[n]
            S = H @ P @ H + R
            total += e * e / S + math.log(S / R)
            gain = P @ H / S
            x, P = x - gain * e, P - np.outer(gain, gain) * S
    return total


@pytest.mark.parametrize("seed", range(3))
def test_lines_cross_with_the_errors_of_both_and_of_the_motion_between(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, places = rng.uniform(-3.0, 3.0, 2), PLACES[:2] + rng.normal(0.0, 0.5, (2, 2))
    made = rays([0, 0], [0, 1], places, towards(places, np.tile(at, (2, 1))))
    made = made._replace(a=np.array([0.01, 0.03]), b=np.array([0.2, 0.05]))
    x, y, sigma, area = crossing(made, 0, 1, 0.4)
    assert (x, y) == pytest.approx(tuple(at))
    one, two = made.a * np.sum((at - places) ** 2, axis=1) + made.b + [0.0, 0.4]
    sine = abs(np.linalg.det(made.direction))
    assert sigma == pytest.approx(math.sqrt(one + two) / sine)
    assert area == pytest.approx(math.sqrt(one * two) / sine)
    assert crossing(made, 1, 0, 0.4)[:2] == pytest.approx((x, y))


@pytest.mark.parametrize(("sine", "finite"), [(0.99e-3, False), (1.01e-3, True)])
def test_lines_at_an_angle_below_a_thousandth_do_not_cross(sine: float, finite: bool) -> None:
    made = rays([0, 0], [0, 1], [[0, 0], [0, -1]], [0.0, math.asin(sine)], a=0.01)
    assert (crossing(made, 0, 1, 0.0)[2] < math.inf) == finite


@pytest.mark.parametrize("angles", [(45.0, 45.0), (-45.0, -135.0), (135.0, 135.0)])
def test_parallel_lines_and_lines_that_part_do_not_cross(angles) -> None:
    made = rays([0, 0], [0, 1], [[0, 0], [4, 0]], np.radians(angles))
    if angles == (-45.0, -135.0):  # they cross below: in front of both
        assert crossing(made, 0, 1, 0.0)[1] == pytest.approx(-2.0)
        made = made._replace(direction=-made.direction * np.array([[1.0], [1.0]]))
        assert crossing(made, 0, 1, 0.0)[2] == math.inf
    else:
        assert crossing(made, 0, 1, 0.0)[2] == math.inf


def test_lines_cross_within_the_reach_of_both() -> None:
    far = math.sqrt(8.0)
    for reach, finite in ((far * (1 + 1e-9), True), (far * (1 - 1e-9), False)):
        made = rays([0, 0], [0, 1], [[0, 0], [4, 0]], np.radians([45.0, 135.0]), reach=reach)
        assert (crossing(made, 0, 1, 0.0)[2] < math.inf) == finite


def test_believing_costs_the_squared_distance_and_what_the_prediction_leaves_open() -> None:
    made = rays([0], [0], [[0, 0]], [0.0], a=0.01, b=0.02)
    x, P = np.array([3.0, 0.0, 0.5, 0.0]), np.diag([0.2, 1.0, 0.3, 1.0])
    cost, across, S = inlier_cost(made, 0, x, P)
    R = 0.01 * (9.0 + 0.2) + 0.02
    assert across == pytest.approx(0.5)
    assert pytest.approx(R + 0.3) == S
    assert cost == pytest.approx(0.25 / S + math.log(S / R))
    assert inlier_cost(made, 0, -x, P)[0] == math.inf
    # The reach ends three standard deviations of the distance beyond
    limit = 3.0 - 3.0 * math.sqrt(0.2)
    for reach, finite in ((limit + 1e-9, True), (limit - 1e-9, False)):
        assert (inlier_cost(made._replace(reach=np.array([reach])), 0, x, P)[0] < math.inf) == finite


def test_the_cost_of_a_position_is_its_squared_distance_from_a_line_with_its_own_variance() -> None:
    made = rays([0, 0], [0, 1], [[0, 0], [1.0, 2.0]], [0.0, math.atan2(4.0, 3.0)], a=0.01, b=0.02, reach=5.0)
    along, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    for distance in (1e-9, 2.0, 5.0):
        variance = 0.01 * distance**2 + 0.02
        xy = np.array([1.0, 2.0]) + distance * along + 0.3 * across
        square, vague = off_line2(made._replace(reach=np.full(2, 5.0 + 1e-9)), 1, *xy, 0.7)
        assert square == pytest.approx(0.3**2 / (variance + 0.7))
        assert vague == pytest.approx(math.log((variance + 0.7) / variance))
        assert off_line(made._replace(reach=np.full(2, 6.0)), 1, *xy, 0.7, 0.5) == pytest.approx(
            min(square + vague, 0.5)
        )
    for distance in (-1e-9, 5.0 + 1e-9):
        assert off_line2(made, 1, *(np.array([1.0, 2.0]) + distance * along), 0.7) == (math.inf, 0.0)


@pytest.mark.parametrize(
    ("t", "longest", "states"),
    [(0, 9.0, (0, 2)), (2, 9.0, (1, 3)), (4, 9.0, (2, 5)), (5, 9.0, (4, 5)), (5, 3.99, (5, 5)), (4, 1.0, (3, 4))],
)
def test_crossings_are_with_the_nearest_states_until_there_are_eight_lines(
    t: int, longest: float, states: tuple[int, int]
) -> None:
    first, seconds = np.array([0, 3, 6, 9, 11, 13, 19]), np.array([0.0, 1.0, 3.0, 5.5, 6.5, 10.5])
    assert _around(first, seconds, t, longest) == (first[states[0]], first[states[1] + 1])


@pytest.mark.parametrize(("reach", "far"), [(7.0, 7.0), (math.inf, 20.0)])
def test_lines_of_one_sensor_begin_hypotheses_along_them(reach: float, far: float) -> None:
    """At six distances up to the reach or the extent, with 35 % of each as the deviation along the line."""
    angles = np.array([0.4, 2.1])
    made = rays([0, 1, 1], [0, 0, 0], [[9, 9], [1.0, -2.0], [1.5, -2.0]], [0.0, *angles], a=1e-4, b=1e-2, reach=reach)
    beam = empty_beam()
    _births(beam, made, np.array([0, 1, 3]), np.array([0.0, 1.0]), 1, 5.0, 4, np.array([1.3, 2.0, 20.0]), K**2)
    wanted = [(n, far * 0.6**k) for n in range(2) for k in range(6, 0, -1)]
    for m, (n, d) in enumerate(wanted):
        turn = np.array([[math.cos(angles[n]), -math.sin(angles[n])], [math.sin(angles[n]), math.cos(angles[n])]])
        along, across = (0.35 * d) ** 2, 1e-4 * d**2 + 1e-2
        C = np.zeros((4, 4))
        C[np.ix_([0, 2], [0, 2])] = turn @ np.diag([along, across]) @ turn.T
        C[1, 1] = C[3, 3] = 1.3**2
        assert_allclose(beam.x[m, ::2], made.position[1 + n] + d * turn[:, 0])
        assert not beam.x[m, 1::2].any()
        assert_allclose(beam.P[m], C, atol=1e-15)
        assert beam.cost[m] == pytest.approx(5.0 + 2.0 * math.log(400.0 / math.sqrt(along * across)))
        assert (beam.bits[m], beam.parent[m]) == (1 << n, 4)
    assert np.isfinite(beam.cost).sum() == 12


def test_crossing_lines_begin_hypotheses_where_they_cross() -> None:
    """Two are with the line of the other state, which no hypothesis accepts."""
    at = np.array([1.0, 2.0])
    made = rays([0, 1, 1], [2, 0, 1], PLACES[[2, 0, 1]], towards(PLACES[[2, 0, 1]], [[1.0, 3.0], at, at]))
    first, seconds, ground, beam = np.array([0, 1, 3]), np.array([0.0, 1.0]), np.array([1.3, 2.0, 20.0]), empty_beam()
    found = np.empty((MAX_CROSSINGS, 7))
    count = candidates(made, first, seconds, 1, 1.3, 2.0, K**2, found)
    _births(beam, made, first, seconds, 1, 5.0, 4, ground, K**2)
    assert np.isfinite(beam.cost).sum() == count == 3
    for m in range(count):
        own = [int(n) - 1 for n in found[m, 5:] if n > 0]
        assert beam.bits[m] == sum(1 << n for n in own)
        assert_allclose(beam.x[m], [found[m, 0], 0.0, found[m, 1], 0.0])
        assert_allclose(beam.P[m], np.diag([found[m, 2] ** 2, 1.3**2] * 2))
        assert beam.cost[m] == pytest.approx(5.0 + 2.0 * math.log(400.0 / found[m, 3]))
        assert beam.parent[m] == 4


@pytest.mark.parametrize(("sigmas", "merged"), [(0.29, True), (0.31, False)])
@pytest.mark.parametrize("entry", range(4))
def test_hypotheses_nearer_than_three_tenths_of_the_smaller_deviation_are_one(
    sigmas: float, merged: bool, entry: int
) -> None:
    beam = empty_beam()
    for m, (cost, scale) in enumerate(((7.0, 4.0), (9.0, 1.0), (8.0, 1.0))):
        beam.cost[m], beam.P[m] = cost, scale * np.diag([1.0, 4.0, 9.0, 16.0])
    beam.x[1, entry] = sigmas * (entry + 1.0)
    beam.x[2, entry] = 50.0
    _merge(beam)
    assert beam.cost[:3].tolist() == [7.0, math.inf if merged else 9.0, 8.0]


@pytest.mark.parametrize("seed", range(3))
def test_candidates_are_the_crossings_on_which_most_agree_by_rising_cost(seed: int) -> None:
    """Of two states with five and four lines; those of the other state are off by the way at the typical speed."""
    rng, places = np.random.default_rng(seed), 6.0 * np.random.default_rng(seed).normal(size=(9, 2))
    angle = towards(places, np.tile([1.0, 2.0], (9, 1))) + 0.1 * rng.standard_normal(9)
    made = rays([0] * 4 + [1] * 5, [0, 1, 2, 3, 0, 1, 2, 3, 4], places, angle, a=0.01)
    first, seconds, speed, widest = np.array([0, 4, 9]), np.array([0.0, 0.8]), 0.7, 2.0
    moved2 = np.where(made.step == 1, 0.0, (0.8 * speed) ** 2)
    wanted = []
    for i in range(4, 9):
        for j in range(9):
            x, y, sigma, area = crossing(made, i, j, moved2[j])
            if made.sensor[i] != made.sensor[j] and (j < 4 or j > i) and sigma <= widest:
                cost = sum(off_line(made, n, x, y, moved2[n], K**2) for n in range(9))
                wanted.append([x, y, sigma, area, cost, i, j])
    out = np.empty((MAX_CROSSINGS, 7))
    assert candidates(made, first, seconds, 1, speed, widest, K**2, out) == MAX_CROSSINGS < len(wanted)
    assert_allclose(out, sorted(wanted, key=lambda row: row[4])[:MAX_CROSSINGS])


@pytest.mark.parametrize("false", [(), (4,), (0, 5), (1, 7, 8)])
def test_the_choice_is_the_best_of_all_subsets(false) -> None:
    made, first, seconds, steps, _ = walk(3, np.random.default_rng(len(false)), false)
    _, believed, cost = agreed_path(made, first, seconds, steps, GROUND, K)
    choices = (np.array(c) for c in itertools.product((False, True), repeat=9))
    best = min(choices, key=lambda c: filter_cost(made, first, steps, c))
    assert np.array_equal(believed, best)
    assert np.flatnonzero(~believed).tolist() == list(false)
    # Hypotheses that begin at a crossing know no more than the prior does.
    assert cost <= filter_cost(made, first, steps, best) + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_one_in_five_false_sight_lines_are_found_over_a_long_walk(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = 60
    false = np.flatnonzero(rng.random(3 * T) < 0.2)
    made, first, seconds, steps, truth = walk(T, rng, false)
    X, believed, _ = agreed_path(made, first, seconds, steps, GROUND, K)
    assert np.setxor1d(np.flatnonzero(~believed), false).size <= 2
    assert np.median(np.hypot(*(X[5:, ::2] - truth[5:]).T)) < 0.3


def test_states_without_sight_lines_are_passed() -> None:
    made, first, seconds, steps, truth = walk(20, np.random.default_rng(1))
    gone = (made.step < 3) | ((made.step > 8) & (made.step < 12)) | (made.step > 16)
    made = BearingHalfLines._make(column[~gone] for column in made)
    first = np.searchsorted(made.step, np.arange(21))
    X, believed, _ = agreed_path(made, first, seconds, steps, GROUND, K)
    assert believed.all()
    assert np.hypot(*(X[4:17, ::2] - truth[4:17]).T).max() < 1.0
    nothing = BearingHalfLines._make(column[:0] for column in made)
    X, believed, cost = agreed_path(nothing, np.zeros(21, dtype=np.int64), seconds, steps, GROUND, K)
    assert np.isfinite(X).all()
    assert (len(believed), cost) == (0, 0.0)


def test_a_target_that_is_elsewhere_all_at_once_is_found_again() -> None:
    made, first, seconds, steps, truth = walk(40, np.random.default_rng(2))
    truth[20:] += [4.0, 2.0]
    rng = np.random.default_rng(3)
    angle = towards(made.position, truth[made.step]) + 0.01 * rng.standard_normal(len(made.step))
    made = made._replace(direction=np.column_stack([np.cos(angle), np.sin(angle)]))
    _, believed, _ = agreed_path(made, first, seconds, steps, GROUND, K)
    assert believed[made.step < 20].mean() > 0.9
    assert believed[made.step >= 22].mean() > 0.9
