"""Identification of motion: known models are found again, within the errors that the fit states."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.track.methods.map.fit_motion.em import e_step, em, fit_differences, fit_em, m_step, prepare
from occlog.track.methods.map.fit_motion.parameters import (
    Shape,
    build,
    expected,
    limits,
    names,
    regression,
    slope,
    start,
)
from occlog.track.methods.map.fit_motion.smoother import (
    MeasuredPath,
    make_nodes,
    median_step,
    split,
    transitions_by_differences,
)
from occlog.track.methods.map.kernels.gauss_markov import GaussMarkov, constant_velocity, transitions

SHAPES = [
    Shape(f, d, similar) for f in ("cv", "damped", "full") for d in ("white", "diagonal") for similar in (True, False)
]
SHAPES += [Shape(f, "full") for f in ("cv", "damped", "full")]


def walk(model: GaussMarkov, n: int, rng, noise: float = 0.0, dt=None, begin=(0, 1.0, 0, 0.5)) -> MeasuredPath:
    dt = np.full(n - 1, model.step_s) if dt is None else dt
    x, positions = np.array(begin, dtype=float), []
    positions.append(x)
    for A, sigma in zip(*transitions(model, dt), strict=True):
        x = A @ x + np.linalg.cholesky(sigma) @ rng.standard_normal(4)
        positions.append(x)
    t_ns = np.rint(np.concatenate([[0.0], np.cumsum(dt)]) * 1e9).astype(np.int64)
    return MeasuredPath(t_ns, np.array(positions)[:, [0, 2]] + noise * rng.standard_normal((n, 2)))


@pytest.mark.statistics
def test_constant_velocity_with_noise_is_found_within_the_stated_errors() -> None:
    """(Estimate - truth) / error has mean 0 and mean square 1 within 3 standard errors of these."""
    off, fits = [], 6
    for seed in range(fits):
        rng = np.random.default_rng(seed)
        paths = [walk(constant_velocity(0.4, 0.2, 0.25), 150, rng, noise=0.05) for _ in range(3)]
        fit = fit_em(paths, 0.25, Shape(), longest_gap_s=1.0)
        assert fit.converged
        off.append(
            [
                (fit.parameters[k] - v) / fit.errors[k]
                for k, v in (("acceleration", 0.4), ("jitter", 0.2), ("noise", 0.05))
            ]
        )
    off = np.array(off)
    assert off.shape == (fits, 3)
    assert (np.abs(off.mean(axis=0)) < 3 / np.sqrt(fits)).all()
    mean_square = np.mean(off**2, axis=0)
    assert (mean_square < 1 + 3 * np.sqrt(2 / fits)).all()
    assert (mean_square > max(1 - 3 * np.sqrt(2 / fits), 0.3)).all()


@pytest.mark.jit
def test_noise_is_not_taken_for_disturbance() -> None:
    """Differences take it so: their Sigma is several times too large; that of EM is right within 15 %."""
    rng = np.random.default_rng(5)
    model = constant_velocity(0.4, 0.0, 0.25)
    paths = [walk(model, 200, rng, noise=0.1) for _ in range(4)]
    em_fit = fit_em(paths, 0.25, Shape(), longest_gap_s=1.0)
    plain = fit_differences(paths, 0.25, Shape(), longest_gap_s=1.0)
    assert em_fit.model.sigma[1, 1] == pytest.approx(model.sigma[1, 1], rel=0.15)
    assert em_fit.noise == pytest.approx(0.1, rel=0.1)
    assert plain.model.sigma[1, 1] > 3 * model.sigma[1, 1]


@pytest.mark.statistics
def test_damped_motion_is_found() -> None:
    """Velocity that dies out at 0.5 per second: rate and a within 3 stated errors, A as the exact exponential."""
    rng = np.random.default_rng(7)
    step, rate = 0.2, 0.5
    a = np.exp(-rate * step)
    shape = Shape("damped")
    truth = build(shape, np.array([rate * step, np.log(0.02), np.log(0.1), 0.0]))
    D = np.array([1, 1 / step, 1, 1 / step])
    model = GaussMarkov(truth.A * np.outer(D, 1 / D), truth.sigma * np.outer(D, D), step)
    assert_allclose(model.A[:2, :2], [[1, (1 - a) / rate], [0, a]])
    paths = [walk(model, 300, rng, noise=0.02) for _ in range(3)]
    fit = fit_em(paths, step, shape, longest_gap_s=1.0)
    assert abs(fit.parameters["decay"] - rate) < 3 * fit.errors["decay"]
    assert fit.errors["decay"] < 0.15
    assert np.abs(fit.model.A - model.A).max() < 3 * fit.A_error.max()
    assert_allclose(fit.model.sigma, model.sigma, atol=4 * fit.sigma_error.max())


@pytest.mark.statistics
def test_free_A_is_found() -> None:
    """A spring and a cross term: every free entry within 4 stated errors, the others exact."""
    rng = np.random.default_rng(11)
    A = np.array([[1, 0.5, 0, 0], [-0.2, 0.9, 0.05, 0], [0, 0, 1, 0.5], [0, -0.1, -0.3, 0.8]])
    model = GaussMarkov(A, np.diag([0.02, 0.05, 0.02, 0.05]) ** 2, 0.5)
    paths = [walk(model, 250, rng, noise=0.02) for _ in range(4)]
    fit = fit_em(paths, 0.5, Shape("full", "diagonal"), longest_gap_s=3.0)
    assert fit.converged
    free = [1, 3]
    assert (np.abs(fit.model.A - A)[free] < 4 * fit.A_error[free]).all()
    assert (fit.model.A[[0, 2]] == A[[0, 2]]).all()
    assert fit.A_error[free].max() < 0.1


@pytest.mark.jit
def test_differences_with_free_A_and_sigma_are_least_squares() -> None:
    rng = np.random.default_rng(3)
    paths = [walk(constant_velocity(0.4, 0.1, 0.25), 80, rng) for _ in range(2)]
    fit = fit_differences(paths, 0.25, Shape("full", "full"), longest_gap_s=1.0)
    pairs = []
    for p in paths:
        v = (p.xy[2:] - p.xy[:-2]) / 0.5
        states = np.column_stack([p.xy[1:-1, 0], v[:, 0], p.xy[1:-1, 1], v[:, 1]])
        pairs.append((states[:-1], states[1:]))
    x, y = (np.concatenate(part) for part in zip(*pairs, strict=True))
    A = np.linalg.lstsq(x, y, rcond=None)[0].T
    rest = y - x @ A.T
    assert fit.transitions == len(x) == 2 * 77
    assert_allclose(fit.model.A, A, atol=1e-5)
    assert_allclose(fit.model.sigma, rest.T @ rest / len(x), rtol=2e-3, atol=1e-6)


@pytest.mark.parametrize(
    "shape", [s if k % 4 == 0 else pytest.param(s, marks=pytest.mark.statistics) for k, s in enumerate(SHAPES)], ids=str
)
def test_em_never_lowers_the_likelihood(shape: Shape) -> None:
    rng = np.random.default_rng(2)
    paths = [walk(constant_velocity(0.4, 0.1, 0.25), 60, rng, noise=0.05)]
    problem = prepare(paths, 0.25, shape, 1.0)
    _, trace = em(problem, start(shape, 0.3), 12)
    assert len(trace) > 3
    assert np.diff(trace).min() > -1e-7 * abs(trace[-1])


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_gradient_of_the_likelihood_is_that_of_the_expected_one(shape: Shape) -> None:
    """Fisher's identity, against differences of the log-likelihood itself."""
    rng = np.random.default_rng(4)
    problem = prepare([walk(constant_velocity(0.4, 0.1, 0.25), 60, rng, noise=0.05)], 0.25, shape, 1.0)
    theta = start(shape, 0.3) + 0.01 * rng.normal(size=len(names(shape)))
    have = slope(shape, theta, e_step(problem, theta)[1])
    h = 1e-5
    want = [(e_step(problem, theta + e)[0] - e_step(problem, theta - e)[0]) / (2 * h) for e in h * np.eye(len(theta))]
    assert_allclose(have, want, rtol=1e-4, atol=1e-3)


def test_regression_is_the_maximum_for_the_sigma_given() -> None:
    rng = np.random.default_rng(8)
    shape = Shape("full")
    problem = prepare([walk(constant_velocity(0.4, 0.1, 0.25), 80, rng, noise=0.05)], 0.25, shape, 1.0)
    theta = start(shape, 0.3)
    sums = e_step(problem, theta)[1]
    best = regression(shape, theta, sums)
    assert np.abs(slope(shape, best, sums)[:8]).max() < 1e-4 * np.abs(slope(shape, theta, sums)[:8]).max()
    assert expected(shape, m_step(shape, theta, sums), sums) >= expected(shape, best, sums)


def test_white_disturbance_is_that_of_the_motion_model() -> None:
    """In steps and scales of 1, `white` without decay is `constant_velocity`; with decay, by brute integration."""
    theta = np.array([np.log(0.3), np.log(0.7), 0.0])
    assert_allclose(build(Shape(), theta).sigma, constant_velocity(0.7, 0.3).sigma)
    assert_allclose(build(Shape(), theta).A, constant_velocity(0.7, 0.3).A)
    beta = 0.8
    s = (np.arange(20000) + 0.5) / 20000
    rows = np.stack([(1 - np.exp(-beta * s)) / beta, np.exp(-beta * s)])
    want = 0.49 * rows @ rows.T / 20000 + np.diag([0.09, 0])
    assert_allclose(build(Shape("damped"), np.array([beta, *theta])).sigma[2:, 2:], want, rtol=1e-7)


@pytest.mark.statistics
def test_unequal_steps_are_measured_where_they_are() -> None:
    """Times off by up to 0.3 steps: acceleration within 3 errors and 0.02, far better than taking them for equal."""
    rng = np.random.default_rng(9)
    dt = np.diff(np.arange(250) * 0.25 + rng.uniform(-0.075, 0.075, 250))
    paths = [walk(constant_velocity(0.4, 0.0, 0.25), 250, rng, noise=0.02, dt=dt) for _ in range(4)]
    fit = fit_em(paths, 0.25, Shape(), longest_gap_s=2.0)
    assert fit.parameters["acceleration"] == pytest.approx(0.4, abs=max(3 * fit.errors["acceleration"], 0.02))
    equal = [p._replace(t_ns=np.arange(250) * 250_000_000) for p in paths]
    wrong = fit_em(equal, 0.25, Shape(), longest_gap_s=2.0)
    assert fit.noise < 0.5 * wrong.noise or fit.log_likelihood > wrong.log_likelihood + 100


@pytest.mark.jit
def test_gaps_are_bridged_or_cut() -> None:
    rng = np.random.default_rng(10)
    path = walk(constant_velocity(0.4, 0.0, 0.25), 400, rng, noise=0.02)
    kept = np.ones(400, np.bool_)
    kept[50:53] = kept[200:260] = False
    path = MeasuredPath(path.t_ns[kept], path.xy[kept])
    fit = fit_em([path], 0.25, Shape(), longest_gap_s=1.25)
    assert (fit.trajectories, fit.measurements, fit.transitions) == (2, 337, 338)
    assert fit.parameters["acceleration"] == pytest.approx(0.4, abs=4 * fit.errors["acceleration"])


@pytest.mark.jit
def test_units_only_scale() -> None:
    """Feet and milliseconds: the same motion in other numbers."""
    rng = np.random.default_rng(12)
    path = walk(constant_velocity(0.4, 0.1, 0.25), 80, rng, noise=0.05)
    one = fit_em([path], 0.25, Shape("damped"), longest_gap_s=1.0)
    two = fit_em([MeasuredPath(path.t_ns * 2, path.xy * 3.0)], 0.5, Shape("damped"), longest_gap_s=2.0)
    assert two.noise == pytest.approx(3 * one.noise, rel=1e-4)
    D = np.array([3, 1.5, 3, 1.5])
    assert_allclose(two.model.sigma, one.model.sigma * np.outer(D, D), rtol=1e-3, atol=1e-12)
    assert two.log_likelihood == pytest.approx(one.log_likelihood - 2 * 80 * np.log(3))


@pytest.mark.jit
def test_given_noise_and_covariance_agree() -> None:
    rng = np.random.default_rng(13)
    path = walk(constant_velocity(0.4, 0.1, 0.25), 100, rng, noise=0.05)
    reported = fit_em([path], 0.25, Shape(noise=False), longest_gap_s=1.0, noise=0.05)
    stated = path._replace(cov=np.tile(0.0025 * np.eye(2), (100, 1, 1)))
    same = fit_em([stated], 0.25, Shape(noise=False), longest_gap_s=1.0)
    assert_allclose(reported.model.sigma, same.model.sigma)
    assert reported.noise is None
    with pytest.raises(ValueError, match="no covariance"):
        fit_em([path], 0.25, Shape(noise=False), longest_gap_s=1.0)


@pytest.mark.jit
def test_what_positions_do_not_decide_is_reported() -> None:
    """A free Sigma has directions that no position depends on: no standard error there."""
    rng = np.random.default_rng(14)
    paths = [walk(constant_velocity(0.4, 0.3, 0.25), 300, rng) for _ in range(3)]
    fit = fit_em(paths, 0.25, Shape("cv", "full", noise=False), longest_gap_s=1.0, noise=0.01)
    assert fit.undecided
    assert np.isnan(fit.sigma_error[0, 0])
    assert np.linalg.eigvalsh(fit.model.sigma).min() > 0


@pytest.mark.statistics
def test_exact_positions_have_no_noise() -> None:
    """Noise goes to (nearly) 0, and is reported as not stated from it."""
    rng = np.random.default_rng(1)
    paths = [walk(constant_velocity(0.4, 0.05, 0.25), 300, rng) for _ in range(4)]
    fit = fit_em(paths, 0.25, Shape(), longest_gap_s=1.0)
    assert fit.noise < 2e-3
    assert fit.parameters["acceleration"] == pytest.approx(0.4, abs=3 * fit.errors["acceleration"])


def test_too_little_is_refused() -> None:
    line = MeasuredPath(np.arange(8) * 10**9, np.column_stack([np.arange(8.0), np.zeros(8)]))
    with pytest.raises(ValueError, match="8 positions are too few"):
        fit_em([line], 1.0, Shape(), longest_gap_s=5.0)
    with pytest.raises(ValueError, match="5 transitions are too few"):
        fit_differences([line], 1.0, Shape(), longest_gap_s=5.0)
    still = MeasuredPath(np.arange(50) * 10**9, np.ones((50, 2)))
    with pytest.raises(ValueError, match="nothing moves"):
        fit_em([still], 1.0, Shape(), longest_gap_s=5.0)
    with pytest.raises(ValueError, match="two positions"):
        median_step([MeasuredPath(np.array([5]), np.zeros((1, 2)))])
    with pytest.raises(ValueError, match="0 positions"):
        fit_em([], 1.0, Shape(), longest_gap_s=5.0)


def test_nodes_take_the_nearest_position_and_count_the_others() -> None:
    t_ns = np.array([0, 92, 110, 140, 200, 900, 1000]) * 10**6
    path = MeasuredPath(t_ns, np.column_stack([t_ns / 1e9, np.zeros(7)]))
    nodes = make_nodes([path], 0.1, 0.5)
    assert nodes.first.tolist() == [True, False, False, True, False]
    assert nodes.seen.tolist() == [True] * 5
    assert nodes.skipped == 2
    assert_allclose(nodes.off, [0, -0.08, 0, 0, 0], atol=1e-12)
    assert [len(p.t_ns) for p in split(path, 0.5)] == [5, 2]
    assert median_step([path]) == pytest.approx(0.076)


def test_differences_are_not_taken_over_gaps() -> None:
    t_ns = np.concatenate([np.arange(10), np.arange(13, 20)]) * 10**8
    path = MeasuredPath(t_ns, np.column_stack([t_ns / 1e9, -2 * t_ns / 1e9]))
    x, y = transitions_by_differences([path], 0.1, 10.0)
    assert len(x) == 7 + 4
    assert_allclose(x[:, [1, 3]], np.tile([0.1, -0.2], (11, 1)))
    assert_allclose(y[:, 0] - x[:, 0], 0.1)


def test_limits_have_a_pair_for_each_parameter() -> None:
    for shape in SHAPES:
        assert len(limits(shape)) == len(names(shape)) == len(start(shape, 0.1)) == len(set(names(shape)))
