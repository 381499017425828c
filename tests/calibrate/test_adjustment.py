"""Bundle adjustment: derivatives by difference quotients, and steps by dense normal equations."""

from __future__ import annotations

import numpy as np
import pytest
from walking_people import cameras, people

from occlog.array_types import Floats
from occlog.calibrate.adjustment import (
    FOCAL,
    LATE,
    PARAMETERS,
    RADIAL,
    SHIFT,
    TURN,
    BodyPrior,
    NoiseModel,
    Observations,
    _Adjustment,
    changed,
    rotation_of,
)
from occlog.calibrate.kernels import boxes_and_slopes
from occlog.track.methods.jipda.kernels.body_box import pack_views

BODY = BodyPrior(1.7, 0.1, 0.55, 0.15, 0.3, 1.0)
STEPS = 6


def observed(late: Floats) -> tuple[Observations, Floats]:
    """All boxes of four people at six times, without errors, by cameras with late clocks; and the true states."""
    t: Floats = 0.4 * np.arange(STEPS, dtype=np.float64)
    at, after = people(t), people(t + 1e-4)
    P = at.shape[1]
    states = np.zeros((P * STEPS, 6))
    states[:, :2] = at.swapaxes(0, 1).reshape(-1, 2)
    states[:, 2:4] = ((after - at) / 1e-4).swapaxes(0, 1).reshape(-1, 2)
    states[:, 4], states[:, 5] = np.repeat([1.6, 1.7, 1.75, 1.8], STEPS), 0.5
    camera, knot = (a.ravel() for a in np.meshgrid(np.arange(3), np.arange(P * STEPS), indexing="ij"))
    box, slope = np.zeros((len(camera), 4)), np.zeros((len(camera), 4, 6))
    good = np.zeros(len(camera), dtype=np.bool_)
    delay = np.zeros(len(camera))
    boxes_and_slopes(pack_views(cameras()).lens, camera, states[knot], delay - late[camera], box, slope, good)
    use = np.repeat(good[:, None], 4, axis=1)
    return Observations(camera, knot, delay, box, use, STEPS * np.arange(P + 1), np.tile(t, P)), states


def problem(noise_px: float = 0.0) -> tuple[_Adjustment, Floats]:
    """Cameras that are off by 2 degrees and 0.2 m, the first one held; and the true offsets of the clocks."""
    rng = np.random.default_rng(1)
    late = np.array([0.0, 0.1, -0.15])
    seen, states = observed(late)
    seen = seen._replace(box=seen.box + rng.normal(0.0, noise_px, seen.box.shape))
    sigma = np.zeros((3, PARAMETERS))
    sigma[1:, TURN] = sigma[1:, SHIFT] = np.inf
    sigma[1:, FOCAL], sigma[1:, RADIAL], sigma[1:, LATE] = 0.1, 0.3, 0.5
    off = np.zeros((3, PARAMETERS))
    off[1:, :6] = rng.normal(0.0, 1.0, (2, 6)) * ([0.035] * 3 + [0.2] * 3)
    start = [changed(c, v) for c, v in zip(cameras(), off, strict=True)]
    return _Adjustment(
        start, seen, states + rng.normal(0.0, 0.03, states.shape), BODY, sigma, np.zeros(3), NoiseModel(2.0, 0.0)
    ), late


def test_gradient_is_that_of_the_cost() -> None:
    """With the states held, the right side is minus the gradient by difference quotients."""
    one, _ = problem(2.0)
    equations = one._equations(one.values, one.states)

    def right(k: int) -> float:
        camera, parameter = divmod(k, PARAMETERS)
        own = one.seen.camera == camera
        slope = one._camera_slopes(equations)[own, :, parameter]
        return float((slope * equations.weight[own] * equations.residual[own]).sum())

    for k in np.flatnonzero(one.free[:-1]):
        step = np.zeros(len(one.values))
        step[k] = 1e-6
        costs = [one._equations(one.values + sign * step, one.states).cost for sign in (1.0, -1.0)]
        assert right(int(k)) == pytest.approx(-(costs[0] - costs[1]) / 2e-6, rel=1e-4, abs=1e-2)


def test_step_is_that_of_dense_normal_equations() -> None:
    """Elimination of the paths gives the same step as all unknowns at once."""
    one, _ = problem(2.0)
    equations = one._equations(one.values, one.states)
    K, M = len(one.seen.time), len(one.values)
    size = 6 * K + M

    H, g = dense(one, equations, size, M, K)
    free = np.concatenate([np.flatnonzero(one.free), M + np.arange(6 * K)])
    x = np.zeros(size)
    x[free] = np.linalg.solve(H[np.ix_(free, free)], g[free])
    step, moved = one._step(equations, 0.0)
    np.testing.assert_allclose(step, x[:M], rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(moved.ravel(), x[M:], rtol=1e-5, atol=1e-7)


def dense(one: _Adjustment, equations, size: int, M: int, K: int) -> tuple[Floats, Floats]:  # type: ignore[no-untyped-def]
    """Normal equations of all unknowns, row by row of the measurements."""
    H, g = np.zeros((size, size)), np.zeros(size)
    slopes = one._camera_slopes(equations)

    def add(row: Floats, residual: float, weight: float) -> None:
        nonlocal H, g
        H += weight * np.outer(row, row)
        g += weight * residual * row

    for n, (camera, knot) in enumerate(zip(one.seen.camera, one.seen.knot, strict=True)):
        for edge in range(4):
            row = np.zeros(size)
            row[camera * PARAMETERS : (camera + 1) * PARAMETERS] = slopes[n, edge]
            row[M + 6 * knot : M + 6 * knot + 6] = equations.slope[n, edge]
            add(row, equations.residual[n, edge], equations.weight[n, edge])
    for k in range(M):
        if one.precision[k]:
            row = np.zeros(size)
            row[k] = 1.0
            add(row, -one.values[k], one.precision[k])
    for first in one.seen.first[:-1]:
        at, state = M + 6 * first, one.states[first]
        tall = np.zeros(size)
        tall[at + 4], tall[M - 1] = 1.0, -1.0
        add(tall, -(state[4] - BODY.height - one.values[-1]), 1.0 / BODY.sigma_height**2)
        for k, mean, sigma in ((5, BODY.width, BODY.sigma_width), (2, 0.0, 1.0), (3, 0.0, 1.0)):
            row = np.zeros(size)
            row[at + k] = 1.0
            add(row, mean - state[k], 1.0 / sigma**2)
    motion = one.motion
    for inner, F, P in zip(motion.inner, motion.transition, motion.precision, strict=True):
        J = np.zeros((6, size))
        J[:, M + 6 * inner : M + 6 * inner + 6] = -F
        J[:, M + 6 * inner + 6 : M + 6 * inner + 12] = np.eye(6)
        off = one.states[inner + 1] - F @ one.states[inner]
        H += J.T @ P @ J
        g -= J.T @ P @ off
    return H, g


def test_poses_and_clocks_are_found_without_noise() -> None:
    """From two degrees and 0.2 m off to the true poses, clocks and bodies."""
    one, late = problem()
    one.sigma[:] = 0.2
    free = one.free[:-1].reshape(3, PARAMETERS)
    free[:, [FOCAL, RADIAL]] = False
    found = one.run()
    for camera, true in zip(found.cameras, cameras(), strict=True):
        assert np.linalg.norm(camera.position - true.position) < 0.02
        assert np.abs(camera.rotation.T @ true.rotation - np.eye(3)).max() < 2e-3
    np.testing.assert_allclose(found.values[:, LATE], late, atol=0.01)


def test_rotation_is_about_the_axis() -> None:
    """A quarter turn about z takes x to y; small turns are linear."""
    np.testing.assert_allclose(
        rotation_of(np.array([0.0, 0.0, np.pi / 2])) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(rotation_of(np.array([1e-9, 0.0, 0.0]))[2, 1], 1e-9)
