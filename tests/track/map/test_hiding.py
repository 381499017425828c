"""Moving occluders with priors: doubted bearings, and what "not seen" says of a place."""

from __future__ import annotations

import math

import numpy as np
import pytest
from map_scenes import place, record, scans_of
from numpy.testing import assert_allclose

from occlog.core.occlusion.occlusion_probability import IMPROVED, visibility_probability
from occlog.core.occlusion.priors import Priors, gaussian_priors
from occlog.track.interface import SmoothedTrajectory
from occlog.track.methods.map.config import MapConfig
from occlog.track.methods.map.kernels.interior_point import cost, derivatives
from occlog.track.methods.map.kernels.problem import MIXTURE, NO_PLANES, QuadraticPriors, TrajectoryProblem
from occlog.track.methods.map.kernels.terms import inlier_probability, log_odds_offset, loss_value
from occlog.track.methods.map.method import advance, begin
from occlog.track.methods.map.occlusion import OCCLUDER_SUPPORT_SIGMAS, cavity_distribution, matched, quadrature

CORNERS = ((-5, -4, 45), (5, -4, 135), (5, 4, 225), (-5, 4, -45))
ROOM = {"half": 6.0, "fov": np.radians(100.0), "sigma_read_px": 3.0}


def people(*positions: tuple[float, float], sigma: float = 0.0) -> Priors:
    """Half a metre wide each."""
    return gaussian_priors(np.array(positions, dtype=float), np.tile(sigma**2 * np.eye(2), (len(positions), 1, 1)), 0.5)


def made(blind=frozenset()):
    t = np.arange(0.0, 12.0, 0.25)
    xy = np.column_stack([2.0 * np.sin(0.4 * t), 1.5 * np.cos(0.3 * t)])
    scene = place(*CORNERS, **ROOM)
    return scene, record(scene, t, xy, noise=np.random.default_rng(3), blind=set(blind)), xy


def solve(scene, made, priors: Priors | None, **settings) -> SmoothedTrajectory:
    scans = [scan._replace(occluders=priors) for scan in scans_of(made)]
    return advance(begin(scene, MapConfig(occluder_diameter=0.5, **settings), False), scans, True)[1]


@pytest.mark.parametrize("initial", ["consensus", "axes"])
def test_occluders_far_away_change_next_to_nothing(initial: str) -> None:
    scene, rows, _ = made()
    alone = solve(scene, rows, None, initialisation=initial)
    among = solve(scene, rows, people((50.0, 50.0), sigma=0.3), initialisation=initial)
    assert_allclose(among.xy, alone.xy, atol=1e-4)
    assert_allclose(among.covariance, alone.covariance, rtol=1e-2, atol=1e-6)


@pytest.mark.jit
def test_bearings_through_a_wall_of_certain_occluders_are_not_believed() -> None:
    scene, rows, xy = made()
    # Shoulder to shoulder around the first camera
    angle = np.radians(np.arange(-10.0, 101.0, 5.0))
    wall = people(*(np.array([-5.0, -4.0]) + 1.5 * np.column_stack([np.cos(angle), np.sin(angle)])).tolist())
    out = solve(scene, rows, wall)
    assert out.fit is not None
    assert (out.fit.inlier_probability[out.fit.sensor == 0] < 0.5).all()
    assert (out.fit.inlier_probability[out.fit.sensor != 0] >= 0.5).mean() > 0.95
    assert np.hypot(*(out.xy - xy).T).mean() < 0.1


@pytest.mark.jit
def test_not_seen_behind_occluders_leaves_the_estimate_where_it_was() -> None:
    # For a while camera 1 alone sees it, and somebody stands before camera 0
    t = np.arange(0.0, 12.0, 0.25)
    lost = {(k, c) for k in np.flatnonzero((t > 4.0) & (t < 8.0)).tolist() for c in (0, 2, 3)}
    scene, rows, xy = made(lost)
    hidden = np.array([k for k, _ in lost])
    between = [(np.array(CORNERS[c][:2]) + xy[24]) / 2 for c in (0, 2, 3)]
    crowd = people(*[tuple(p) for p in between], sigma=0.4)
    out, silent = (
        solve(scene, rows, crowd, occlusion_tempering=1.0, use_missed_detections=unseen) for unseen in (True, False)
    )
    away, without = (np.hypot(*(o.xy - xy)[hidden].T).mean() for o in (out, silent))
    assert away < 1.1 * without
    assert out.converged


@pytest.mark.parametrize("seen", [True, False])
def test_the_term_of_a_well_known_place_has_the_slope_of_the_likelihood(seen: bool) -> None:
    priors, mean = people((1.0, 0.2), (2.0, -0.5), sigma=0.6), np.array([3.0, 0.1])

    def value(xy) -> np.ndarray:
        clear = visibility_probability(
            np.atleast_2d(xy), np.arange(len(np.atleast_2d(xy))), 0.0, 0.0, priors, IMPROVED, OCCLUDER_SUPPORT_SIGMAS
        )
        return -np.log(clear if seen else 1.0 - clear)

    covariance = 0.02**2 * np.array([[1.0, 0.3], [0.3, 0.8]])
    nodes, weights = quadrature()
    points = mean + nodes @ np.linalg.cholesky(covariance).T
    centre, slope, bend = matched(points, weights * np.exp(-value(points)), mean, covariance)
    h = 1e-4
    want = [(value(centre + h * e)[0] - value(centre - h * e)[0]) / (2.0 * h) for e in np.eye(2)]
    assert_allclose(slope, want, rtol=2e-3, atol=1e-4)
    assert np.linalg.eigvalsh(bend)[0] >= -1e-9


def test_a_gaussian_likelihood_is_matched_exactly_and_taken_out_again() -> None:
    mean, covariance = np.array([1.0, -2.0]), np.array([[0.5, 0.1], [0.1, 0.2]])
    H, p = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([1.2, -1.9])
    after = np.linalg.inv(np.linalg.inv(covariance) + H)
    there = after @ (np.linalg.solve(covariance, mean) + H @ p)
    nodes, weights = quadrature()
    # Points of the product itself, so that the moments are exact
    centre, slope, bend = matched(there + nodes @ np.linalg.cholesky(after).T, weights, mean, covariance)
    assert_allclose(bend, H, rtol=1e-9)
    assert_allclose(slope, H @ (centre - p), atol=1e-9)
    rest = cavity_distribution(there, after, (centre, slope, bend))
    assert rest is not None
    assert_allclose(rest[0], mean, atol=1e-9)
    assert_allclose(rest[1], covariance, atol=1e-9)
    assert cavity_distribution(there, np.linalg.inv(H), (p, slope, H)) is None


def test_a_term_is_part_of_the_cost_and_its_derivatives() -> None:
    from trajectory_reference import random_lines, random_steps

    rng = np.random.default_rng(0)
    X = rng.normal(size=(4, 4))
    bare = TrajectoryProblem(random_steps(rng, 4), random_lines(rng, X, 2.5), NO_PLANES, MIXTURE, 3.0)
    hints = QuadraticPriors(
        np.array([1, 3]), rng.normal(size=(2, 2)), rng.normal(size=(2, 2)), np.array([[2.0, 0.5, 1.0]] * 2)
    )
    reported = bare._replace(hints=hints)
    g, H = (a - b for a, b in zip(derivatives(reported, X, 0.0), derivatives(bare, X, 0.0), strict=True))
    assert_allclose(H[[1, 3]], hints.bend)
    assert not H[[0, 2]].any()
    for i in range(X.size):
        low, high = X.copy(), X.copy()
        low.flat[i] -= 1e-5
        high.flat[i] += 1e-5
        rise = [cost(reported, Y) - cost(bare, Y) for Y in (low, high)]
        assert (rise[1] - rise[0]) / 2e-5 == pytest.approx(g.flat[i], abs=1e-6)


def test_odds_lean_until_nothing_is_believed() -> None:
    assert log_odds_offset(3.7, 0.0) == 3.7
    assert inlier_probability(0.0, log_odds_offset(2.0, -2.0)) == 0.5
    assert inlier_probability(0.0, log_odds_offset(2.0, -2.0 - 1e-6)) < 0.5
    assert inlier_probability(0.0, log_odds_offset(2.0, math.log(0.1) - 2.0)) == pytest.approx(1.0 / 11.0)
    assert loss_value(0.0, MIXTURE, log_odds_offset(2.0, -9.0)) == pytest.approx(0.0, abs=1e-12)
