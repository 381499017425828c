from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occlog.filtering.motion.coordinated_turn import acceleration_root, move, move_under_all, three_models, turn_matrix

NONE = np.zeros((2, 2))


def quiet(states, model, dt):
    states = np.atleast_2d(np.asarray(states, dtype=float))
    return move(states, np.asarray(model, dtype=float), dt, NONE, np.zeros_like(states))


def by_small_steps(state, model, dt, n=2000):
    """The differential equation itself, by Runge-Kutta: acceleration at a right angle to the velocity plus an input."""
    lateral, ax, ay = model

    def slope(s):
        _, vx, _, vy = s
        rate = lateral / math.hypot(vx, vy) if lateral else 0.0
        return np.array([vx, -rate * vy + ax, vy, rate * vx + ay])

    s, h = np.array(state, dtype=float), dt / n
    for _ in range(n):
        k1 = slope(s)
        k2 = slope(s + 0.5 * h * k1)
        k3 = slope(s + 0.5 * h * k2)
        k4 = slope(s + h * k3)
        s = s + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return s


@pytest.mark.parametrize("model", [(0, 0, 0), (0.7, 0, 0), (-0.7, 0, 0), (0, 0.3, -0.2)])
@pytest.mark.parametrize("dt", [0.04, 1.0, 6.5])
def test_a_step_solves_the_equation_of_motion(model, dt):
    rng = np.random.default_rng(3)
    states = rng.normal(size=(4, 4)) * [5.0, 1.0, 5.0, 1.0]
    wanted = [by_small_steps(s, model, dt) for s in states]
    np.testing.assert_allclose(quiet(states, model, dt), wanted, rtol=1e-7, atol=1e-7)


@given(st.floats(0.05, 30.0), st.floats(-math.pi, math.pi), st.floats(0.01, 5.0), st.floats(0.01, 20.0), st.booleans())
def test_a_turn_is_a_circle_of_radius_v_squared_over_alpha(speed, heading, alpha, dt, left):
    lateral = alpha if left else -alpha
    vx, vy = speed * math.cos(heading), speed * math.sin(heading)
    radius = speed**2 / alpha
    side = 1.0 if left else -1.0
    centre = np.array([3.0 - side * radius * vy / speed, -2.0 + side * radius * vx / speed])
    angle = alpha * dt / speed * side
    c, s = math.cos(angle), math.sin(angle)
    x, _, y, _ = quiet([3.0, vx, -2.0, vy], [lateral, 0, 0], dt)[0]
    spoke = np.array([3.0, -2.0]) - centre
    wanted = centre + np.array([[c, -s], [s, c]]) @ spoke
    np.testing.assert_allclose([x, y], wanted, rtol=1e-9, atol=1e-9 * (1.0 + radius))


@given(st.floats(0.01, 10.0), st.floats(0.0, 10.0), st.floats(0.01, 50.0))
def test_a_turn_keeps_the_speed(speed, alpha, dt):
    moved = quiet([0.0, speed, 0.0, 0.3], [alpha, 0, 0], dt)[0]
    assert math.hypot(moved[1], moved[3]) == pytest.approx(math.hypot(speed, 0.3), rel=1e-12)


def test_models_are_named_by_the_way_they_really_turn():
    straight, clockwise, anticlockwise = three_models(0.5)
    east = [0.0, 1.0, 0.0, 0.0]
    np.testing.assert_allclose(quiet(east, straight, 2.0), [[2.0, 1.0, 0.0, 0.0]])
    assert np.all(quiet(east, clockwise, 1.0)[0, 2:] < 0.0)
    assert np.all(quiet(east, anticlockwise, 1.0)[0, 2:] > 0.0)
    # A quarter turn to the left, radius v^2 / alpha = 2: from (0, 0) going east to (2, 2) going north.
    quarter = quiet(east, anticlockwise, math.pi / 2 / 0.5)
    np.testing.assert_allclose(quarter, [[2.0, 0.0, 2.0, 1.0]], atol=1e-12)


@pytest.mark.parametrize("model", [(0, 0, 0), (0.9, 0, 0), (-0.9, 0, 0), (0, -0.4, 0.6)])
def test_two_half_steps_equal_one(model):
    states = np.random.default_rng(8).normal(size=(50, 4))
    halves = quiet(quiet(states, model, 0.65), model, 0.65)
    np.testing.assert_allclose(halves, quiet(states, model, 1.3), rtol=1e-11, atol=1e-11)


@given(st.floats(0.0, 1e-9), st.floats(0.0, 10.0))
def test_a_vanishing_turn_is_constant_velocity(alpha, dt):
    state = [1.0, 0.8, 2.0, -0.6]
    np.testing.assert_allclose(
        quiet(state, [alpha, 0, 0], dt)[0], [1.0 + 0.8 * dt, 0.8, 2.0 - 0.6 * dt, -0.6], atol=1e-7
    )


@given(st.sampled_from([0.0, 5e-324, 1e-300, 1e-170, 1e-30, 1e-13, 1e-9, 1e-4]), st.floats(-5.0, 5.0))
def test_a_vanishing_speed_leaves_the_target_where_it_is(speed, lateral):
    moved = quiet([1.0, speed, 2.0, -speed], [lateral, 0, 0], 1.5)[0]
    assert np.all(np.isfinite(moved))
    np.testing.assert_allclose(moved, [1.0, 0.0, 2.0, 0.0], atol=1.5 * 1.5 * speed + 1e-300)


def test_acceleration_moves_a_target_at_rest():
    np.testing.assert_allclose(quiet([0, 0, 0, 0], [0.0, 2.0, -1.0], 3.0), [[9.0, 6.0, -4.5, -3.0]])


@pytest.mark.parametrize("rate", [-1.3, -1e-9, 0.0, 1e-9, 0.2, 4.0])
def test_matrix_of_a_known_rate(rate):
    state = np.array([1.0, 0.6, -2.0, 0.8])  # speed 1: the lateral acceleration is the rate
    np.testing.assert_allclose(turn_matrix(rate, 1.7) @ state, quiet(state, [rate, 0, 0], 1.7)[0], rtol=1e-12)


def test_root_is_that_of_white_acceleration():
    for q, dt in [(0.3, 0.5), (2.0, 4.0)]:
        B = acceleration_root(q, dt)
        np.testing.assert_allclose(B @ B.T, q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), rtol=1e-12)
    assert not acceleration_root(1.0, 0.0).any()


def test_noise_is_added_axis_by_axis_and_model_by_model():
    rng = np.random.default_rng(5)
    states, normals, root = rng.normal(size=(30, 4)), rng.normal(size=(3, 30, 4)), np.array([[0.4, 0.1], [0.2, 0.7]])
    models = three_models(0.3)
    moved = move_under_all(states, models, 0.8, root, normals)
    for m in range(3):
        noise = np.concatenate([normals[m, :, :2] @ root.T, normals[m, :, 2:] @ root.T], axis=1)
        np.testing.assert_allclose(moved[m], quiet(states, models[m], 0.8) + noise, rtol=1e-12, atol=1e-12)


def test_the_three_models_are_constant_velocity_clockwise_and_anticlockwise():
    assert three_models(0.3).tolist() == [[0.0, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.3, 0.0, 0.0]]


def test_each_of_two_models_moves_all_particles():
    rng = np.random.default_rng(8)
    states, normals, root = rng.normal(size=(5, 4)), rng.normal(size=(2, 5, 4)), acceleration_root(0.2, 0.5)
    models = np.array([[0.4, 0.0, 0.0], [0.0, 0.1, -0.1]])
    got = move_under_all(states, models, 0.5, root, normals)
    assert got.shape == (2, 5, 4)
    for m in range(2):
        np.testing.assert_array_equal(got[m], move(states, models[m], 0.5, root, normals[m]))
