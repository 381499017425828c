"""Bundle adjustment: derivatives by difference quotients, and steps by dense normal equations."""

from __future__ import annotations

import numpy as np
import pytest
from walking_people import cameras, people

from occlog.array_types import Floats
from occlog.calibrate.adjustment import (
    COMMON,
    DRIFT,
    FOCAL,
    LATE,
    PARAMETERS,
    RADIAL,
    SHIFT,
    TURN,
    Adjustment,
    BodyPrior,
    Clocks,
    NoiseModel,
    Observations,
    PathPrior,
    _time_factor,
    changed,
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


PASSING = PathPrior(0.2, 0.002, 4.0)
"""Paths of people who pass between views that are not shared."""


def problem(
    noise_px: float = 0.0,
    paths: PathPrior = PathPrior(),  # noqa: B008
    level: tuple[float, float] = (np.inf, np.inf),
) -> tuple[Adjustment, Floats]:
    """Cameras that are off by 2 degrees and 0.2 m, the first one held; and the true offsets of the clocks.

    With `paths` of a t distribution each time step is seen by one camera, in turn.
    """
    rng = np.random.default_rng(1)
    late = np.array([0.0, 0.1, -0.15])
    seen, states = observed(late)
    if np.isfinite(paths.degrees):
        mine = seen.knot % 3 == seen.camera
        seen = seen._replace(**{name: getattr(seen, name)[mine] for name in ("camera", "knot", "delay", "box", "use")})
    seen = seen._replace(box=seen.box + rng.normal(0.0, noise_px, seen.box.shape))
    sigma = np.zeros((3, PARAMETERS))
    sigma[1:, TURN] = sigma[1:, SHIFT] = np.inf
    sigma[1:, FOCAL], sigma[1:, RADIAL], sigma[1:, LATE] = 0.1, 0.3, 0.5
    sigma[1:, DRIFT] = 0.1
    off = np.zeros((3, PARAMETERS))
    off[1:, :6] = rng.normal(0.0, 1.0, (2, 6)) * ([0.035] * 3 + [0.2] * 3)
    start = [changed(c, v) for c, v in zip(cameras(), off, strict=True)]
    return Adjustment(
        start,
        seen,
        states + rng.normal(0.0, 0.03, states.shape),
        BODY,
        sigma,
        Clocks(np.zeros(3), np.zeros(3), 0.7),
        NoiseModel(2.0, 0.0),
        paths,
        level,
    ), late


def test_gradient_is_that_of_the_cost() -> None:
    """With the states held, the right side is minus the gradient by difference quotients, away from the start."""
    one, _ = problem(2.0)
    change = np.random.default_rng(2).normal(0.0, 1.0, len(one.values))
    change *= np.append(
        np.tile([0.01] * 6 + [0.02, 0.02, 0.05, 0.02, 0.01, 0.01, 0.1], 3), [0.05, 0.02, 0.02, 0.03, 0.03, 0.1]
    )
    one.values = np.where(one.free, change, 0.0)
    equations = one._equations(one.values, one.states)
    slopes = one._camera_slopes(equations) * (equations.weight * equations.residual)[:, :, None]

    def right(k: int) -> float:
        if k >= 3 * PARAMETERS:
            return float(slopes[:, :, k - 2 * PARAMETERS - 1].sum())
        camera, parameter = divmod(k, PARAMETERS)
        return float(slopes[one.seen.camera == camera, :, parameter].sum())

    for k in np.flatnonzero(one.free):
        if k == 3 * PARAMETERS:  # the mean height of people is no parameter of boxes
            continue
        step = np.zeros(len(one.values))
        step[k] = 1e-6
        costs = [one._equations(one.values + sign * step, one.states).cost for sign in (1.0, -1.0)]
        prior = -one.precision[k] @ one.values
        assert right(int(k)) + prior == pytest.approx(-(costs[0] - costs[1]) / 2e-6, rel=1e-4, abs=1e-2)


@pytest.mark.parametrize(("paths", "level"), [(PathPrior(), (np.inf, np.inf)), (PASSING, (0.01, 0.05))])
def test_step_is_that_of_dense_normal_equations(paths: PathPrior, level: tuple[float, float]) -> None:
    """Elimination of the paths gives the same step as all unknowns at once, also between views that are not shared."""
    one, _ = problem(2.0, paths, level)
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


def dense(one: Adjustment, equations, size: int, M: int, K: int) -> tuple[Floats, Floats]:  # type: ignore[no-untyped-def]
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
            row[camera * PARAMETERS : (camera + 1) * PARAMETERS] = slopes[n, edge, :PARAMETERS]
            row[M - COMMON + 1 : M] = slopes[n, edge, PARAMETERS:]
            row[M + 6 * knot : M + 6 * knot + 6] = equations.slope[n, edge]
            add(row, equations.residual[n, edge], equations.weight[n, edge])
    H[:M, :M] += one.precision
    g[:M] -= one.precision @ one.values
    for first in one.seen.first[:-1]:
        at, state = M + 6 * first, one.states[first]
        tall = np.zeros(size)
        tall[at + 4], tall[M - COMMON] = 1.0, -1.0
        add(tall, -(state[4] - BODY.height - one.values[-COMMON]), 1.0 / BODY.sigma_height**2)
        for k, mean, sigma in ((5, BODY.width, BODY.sigma_width), (2, 0.0, 1.0), (3, 0.0, 1.0)):
            row = np.zeros(size)
            row[at + k] = 1.0
            add(row, mean - state[k], 1.0 / sigma**2)
    motion = one.motion
    weights = motion.weights(one.states)
    for inner, F, precision, weight in zip(motion.inner, motion.transition, motion.precision, weights, strict=True):
        P = precision * np.repeat([weight, 1.0], [4, 2])[:, None]
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
    free = one.free[:-COMMON].reshape(3, PARAMETERS)
    free[:, [FOCAL, RADIAL, DRIFT]] = False
    found = one.run()
    for camera, true in zip(found.cameras, cameras(), strict=True):
        assert np.linalg.norm(camera.position - true.position) < 0.02
        assert np.abs(camera.rotation.T @ true.rotation - np.eye(3)).max() < 2e-3
    np.testing.assert_allclose(found.values[:, LATE], late, atol=0.01)


def test_drift_is_found_without_noise() -> None:
    """Clocks that are fast by 4 and slow by 3 percent, so that six time steps show it."""
    one, late = problem()
    drift = np.array([0.0, 0.04, -0.03])
    own, shown = one.seen.camera, one.seen.time[one.seen.knot] - late[one.seen.camera]
    true = Clocks(late, drift, one.clocks.origin)
    stamps = (shown + late[own] - drift[own] * true.origin) / (1.0 - drift[own])
    np.testing.assert_allclose(stamps - true.errors(own, stamps), shown, atol=1e-12)
    one.seen = one.seen._replace(delay=stamps - one.seen.time[one.seen.knot])
    one.sigma[:] = 0.2
    one.free[:-COMMON].reshape(3, PARAMETERS)[:, [FOCAL, RADIAL]] = False
    found = one.run()
    np.testing.assert_allclose(found.values[:, DRIFT], drift, atol=0.005)
    np.testing.assert_allclose(found.values[:, LATE], late, atol=0.01)


def test_absorbed_share_and_covariance_are_dense_ones() -> None:
    """The diagonal of the hat matrix of the paths, and the inverse of all normal equations."""
    one, _ = problem(2.0)
    one.precision[0, 0] = 1.0
    equations = one._equations(one.values, one.states)
    K, M = len(one.seen.time), len(one.values)
    H, _ = dense(one, equations, 6 * K + M, M, K)
    P, hat = np.linalg.inv(H[M:, M:]), np.zeros((len(one.seen.camera), 4))
    for n, knot in enumerate(one.seen.knot):
        own, J = slice(6 * knot, 6 * knot + 6), equations.slope[n]
        hat[n] = np.einsum("ei,ij,ej->e", J, P[own, own], J) * equations.weight[n]
    use = equations.weight > 0.0
    shares = [hat[:, e][use[:, e]].mean() for e in ([0, 2], [1, 3])]
    F, roots = one.motion.transition, np.linalg.cholesky(one.motion.precision[:, :4, :4])
    moved = []
    for inner, transition, root in zip(one.motion.inner, F, roots, strict=True):
        J = np.hstack([-transition, np.eye(6)])[:4]
        own = slice(6 * inner, 6 * inner + 12)
        moved.append(np.trace(root.T @ J @ P[own, own] @ J.T @ root) / 4)
    found, of_motion = one._absorbed(equations)
    np.testing.assert_allclose(found, shares, rtol=0.2)
    assert of_motion * one.motion.densities == pytest.approx(4.0 * np.sum(moved), rel=0.1)
    free = np.concatenate([np.flatnonzero(one.free), M + np.arange(6 * K)])
    count = np.count_nonzero(one.free[:-COMMON])
    inner = H[np.ix_(free, free)]
    bias = np.flatnonzero(one.sigma_bias)
    gain = np.linalg.solve(inner, H[np.ix_(free, bias)]) * one.sigma_bias[bias]
    expected = (np.linalg.inv(inner) + gain @ gain.T)[:count, :count]
    covariance = one._covariance(equations, np.ones(4))
    np.testing.assert_allclose(covariance[np.ix_(free[:count], free[:count])], expected, rtol=1e-3, atol=1e-9)


def test_time_factor_is_that_of_a_mean() -> None:
    """Variance of the mean of an AR(1) sequence against that of independent errors: (1 + a) / (1 - a)."""
    rng, a = np.random.default_rng(3), 0.6
    x = np.zeros((20_000, 1))
    for k in range(1, len(x)):
        x[k] = a * x[k - 1] + rng.normal()
    group = np.repeat(np.arange(20), 1000)
    assert _time_factor(x, group, float((x**2).sum())) == pytest.approx((1 + a) / (1 - a), rel=0.1)


def test_densities_of_paths_are_learned_between_views() -> None:
    """White acceleration and a random walk, of one camera with exact boxes and of changes with a known covariance."""
    rng = np.random.default_rng(4)
    one, _ = problem(0.0, PASSING)
    motion = one.motion.of(np.array([0.2, 0.4, 0.01]))
    assert motion.apart.all()
    L = len(motion.inner)
    changes = np.linalg.cholesky(np.linalg.inv(motion.precision)) @ rng.normal(0.0, 1.0, (150, L, 6, 1))
    changes *= np.sqrt(4.0 / rng.chisquare(4.0, (150, L, 1, 1)))
    now, starts = one.motion, np.zeros_like(one.states)
    for _ in range(40):
        total = np.zeros(3)
        for each in changes[..., 0]:
            states = starts.copy()
            for k, change in zip(now.inner, each, strict=True):
                states[k + 1] = now.transition[0] @ states[k] + change
            total += now.rescaled(states, np.zeros(3)).densities / len(changes)
        now = now.of(total)
    np.testing.assert_allclose(now.densities, [0.2, 0.4, 0.01], rtol=0.15)
