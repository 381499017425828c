"""Motion of clouds of particles: against the formulas row by row, the plane's turns, and moments of the noise."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.array_types import Floats
from occlog.filtering.motion.coordinated_turn import move
from occlog.filtering.motion.white_acceleration import (
    AccelerationModel,
    drift,
    half_normals,
    known_jump,
    motion_noise,
    moved,
    moved_back,
    turn_jump,
)


def cloud(rng: np.random.Generator, particles: int, axes: int = 3) -> Floats:
    return rng.normal(size=(2 * axes, particles))


@pytest.mark.parametrize("particles", [1, 2, 5, 6])
def test_each_draw_serves_two_particles_with_opposite_signs(particles: int) -> None:
    rng = np.random.default_rng(particles)
    start, jump, dt = cloud(rng, particles), rng.normal(size=6), 0.4
    motion = AccelerationModel(np.zeros(3), np.array([0.5, 1.0, 2.0]))
    half = half_normals(particles, 6, rng)
    assert half.shape == (6, (particles + 1) // 2)
    normals = np.concatenate([half, -half], axis=1)[:, :particles]
    got = drift(start, dt, jump, motion_noise(motion, dt), half)
    for k, root in enumerate(motion_noise(motion, dt)):
        noise = root @ np.stack([normals[k], normals[3 + k]])
        np.testing.assert_allclose(got[k], start[k] + dt * start[3 + k] + jump[k] + noise[0], atol=1e-14)
        np.testing.assert_allclose(got[3 + k], start[3 + k] + jump[3 + k] + noise[1], atol=1e-14)


def test_the_noise_of_a_step_is_that_of_white_acceleration() -> None:
    density, dt = np.array([0.5, 2.0]), 0.7
    for q, root in zip(density, motion_noise(AccelerationModel(np.zeros(2), density), dt), strict=True):
        np.testing.assert_allclose(root @ root.T, q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))


def test_without_density_nothing_is_drawn_and_a_known_acceleration_moves_all() -> None:
    rng, acceleration, dt = np.random.default_rng(1), np.array([1.0, -2.0, 0.5]), 2.0
    start, untouched = cloud(rng, 7), np.random.default_rng(9)
    got = moved(start, AccelerationModel(acceleration, np.zeros(3)), dt, untouched, known_jump(acceleration, dt))
    assert untouched.random() == np.random.default_rng(9).random()
    np.testing.assert_allclose(got[:3], start[:3] + dt * start[3:] + dt**2 * acceleration[:, None])
    np.testing.assert_allclose(got[3:], start[3:] + 2.0 * dt * acceleration[:, None])


@pytest.mark.parametrize("lateral", [0.8, -0.8])
def test_a_turn_is_that_of_the_plane_about_the_chosen_axes(lateral: float) -> None:
    rng, dt = np.random.default_rng(2), 1.5
    start = cloud(rng, 20)
    start[3:, 0] = 0.0  # at rest: nothing turns
    motion = AccelerationModel(np.zeros(3), np.zeros(3), lateral, (2, 0))
    got = moved(start, motion, dt, rng)
    rows = start[[2, 5, 0, 3]].T  # [x, vx, y, vy] of axes 2 and 0
    model = np.array([lateral, 0.0, 0.0])
    np.testing.assert_allclose(got[[2, 5, 0, 3]].T, move(rows, model, dt, np.zeros((2, 2)), np.zeros_like(rows)))
    np.testing.assert_allclose(got[[1, 4]], [start[1] + dt * start[4], start[4]])
    np.testing.assert_array_equal(got[:, 0], start[:, 0])


@pytest.mark.parametrize(("acceleration", "turn"), [((1.0, -2.0, 0.5), 0.0), ((0.0, 0.0, 0.0), -0.7)])
def test_a_step_without_noise_is_undone_by_the_step_back(acceleration: tuple[float, ...], turn: float) -> None:
    rng, dt = np.random.default_rng(3), 1.3
    start, motion = cloud(rng, 9), AccelerationModel(np.array(acceleration), np.zeros(3), turn, (2, 0))
    np.testing.assert_allclose(moved_back(moved(start, motion, dt, rng), motion, dt), start, atol=1e-12)


def test_the_change_by_a_turn_of_a_known_velocity() -> None:
    velocity, lateral, dt = np.array([1.0, 0.5]), 0.9, 0.8
    row = np.array([[0.0, velocity[0], 0.0, velocity[1]]])
    x, vx, y, vy = move(row, np.array([lateral, 0.0, 0.0]), dt, np.zeros((2, 2)), np.zeros((1, 4)))[0]
    want = [x - dt * velocity[0], y - dt * velocity[1], vx - velocity[0], vy - velocity[1]]
    np.testing.assert_allclose(turn_jump(velocity, lateral, dt), want, atol=1e-15)
    np.testing.assert_array_equal(turn_jump(np.zeros(2), lateral, dt), 0.0)
