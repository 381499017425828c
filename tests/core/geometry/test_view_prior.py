"""Prior of a target by what sensors see, and places drawn along sight lines."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.core.geometry.visibility import (
    ScanDirectionsInPlane,
    ViewPrior,
    crossings,
    draw,
    initial_positions,
    log_density,
    prior_moments,
)

TWO = ViewPrior(
    origin=np.array([[0.0, 0.0], [10.0, 0.0]]),
    axis=np.array([np.pi / 2, np.pi]),
    fov=np.array([1.0, 2.0 * np.pi]),
    far=np.array([20.0, 8.0]),
    share=np.array([0.5, 0.5]),
    low=np.array([-2.0, -2.0]),
    high=np.array([12.0, 2.0]),
)


def lines(
    *rows: tuple[float, float, float], sigma: float = 0.01, far: float = 20.0, sensors=None
) -> ScanDirectionsInPlane:
    """Sight lines of rows x, y, azimuth."""
    table = np.array(rows).reshape(-1, 3)
    n = len(table)
    sensor = np.arange(n) if sensors is None else np.array(sensors)
    return ScanDirectionsInPlane(table[:, :2], table[:, 2], np.full(n, sigma), np.zeros(n), np.full(n, far), sensor)


def test_moments_are_those_of_draws() -> None:
    n = 200_000
    xy, (mean, covariance) = draw(n, TWO, np.random.default_rng(4)), prior_moments(TWO)
    away = xy - mean
    products = away[:, :, None] * away[:, None, :]
    assert np.all(np.abs(away.mean(axis=0)) < 4.0 * away.std(axis=0) / np.sqrt(n))  # 4 standard errors
    assert np.all(np.abs(products.mean(axis=0) - covariance) < 4.0 * products.std(axis=0) / np.sqrt(n))


def test_the_density_integrates_to_one_and_draws_follow_it():
    rng = np.random.default_rng(1)
    low, size = np.array([-25.0, -25.0]), np.array([50.0, 50.0])
    cells = low + size * rng.random((400_000, 2))
    density = np.exp(log_density(cells, TWO))
    assert density.mean() * size.prod() == pytest.approx(1.0, abs=0.03)
    xy = draw(100_000, TWO, rng)
    for at, radius in (((0.0, 10.0), 3.0), ((10.0, 0.0), 2.0), ((5.0, 0.0), 1.0)):
        share = np.mean(np.hypot(*(xy - at).T) < radius)
        inside = np.hypot(*(cells - at).T) < radius
        assert share == pytest.approx(density[inside].sum() / len(cells) * size.prod(), rel=0.1)


def test_a_place_is_possible_up_to_the_far_limit_and_the_border_of_the_field_of_view():
    prior = TWO._replace(share=np.array([1.0, 0.0]))
    just, beyond = 1.0 - 1e-6, 1.0 + 1e-6
    at = [[0.0, 20.0 * just], [0.0, 20.0 * beyond]]
    at += [[10.0 * np.sin(0.5 * k), 10.0 * np.cos(0.5 * k)] for k in (just, beyond)]
    assert np.isfinite(log_density(np.array(at), prior)).tolist() == [True, False, True, False]


def test_distances_of_a_single_sensor_are_even():
    xy = draw(50_000, TWO._replace(share=np.array([1.0, 0.0])), np.random.default_rng(2))
    far = xy[xy[:, 1] > 2.0]  # not of the box around the sensors
    r = np.hypot(*far.T)
    np.testing.assert_allclose(np.quantile(r[r > 4.0], (0.25, 0.5, 0.75)), (8.0, 12.0, 16.0), atol=0.2)


@pytest.mark.parametrize(
    "seen",
    [lines(), lines((0, 0, 1.5)), lines((0, 0, 1.2), (10, 0, 2.4)), lines((0, 0, 1.5), (10, 0, 1.5))],
    ids=["nothing", "one", "crossing", "parallel"],
)
def test_weighted_first_places_are_a_sample_of_the_prior(seen):
    rng = np.random.default_rng(3)
    xy, log_weights = initial_positions(200_000, seen, TWO, rng)
    w = np.exp(log_weights)
    assert w.mean() == pytest.approx(1.0, abs=0.02)
    free = draw(200_000, TWO, rng)
    for at, radius in (((0.0, 10.0), 4.0), ((3.5, 9.0), 2.0), ((10.0, 4.0), 3.0)):
        inside = np.hypot(*(xy - at).T) < radius
        assert np.sum(w[inside]) / len(xy) == pytest.approx(np.mean(np.hypot(*(free - at).T) < radius), rel=0.1)


def test_six_tenths_of_what_looks_are_where_two_lines_cross():
    seen = lines((0.0, 0.0, np.arctan2(6.0, 3.0)), (10.0, 0.0, np.arctan2(6.0, -7.0)))
    xy, _ = initial_positions(10_000, seen, TWO, np.random.default_rng(4))
    assert np.mean(np.hypot(*(xy - [3.0, 6.0]).T) < 1.0) > 0.5


def test_lines_cross_only_ahead_of_both_within_reach_and_of_different_sensors():
    rng = np.random.default_rng(5)
    ahead = ((0.0, 0.0, np.pi / 4), (10.0, 0.0, 3 * np.pi / 4))
    centre, covariance = crossings(lines(*ahead), rng)
    np.testing.assert_allclose(centre, [[5.0, 5.0]])
    # Spread 1.5 times wider than the lines' own: 1.5 x 0.01 rad x sqrt(50)
    np.testing.assert_allclose(covariance[0], (0.015**2 * 50.0) * np.eye(2), atol=1e-12)
    assert not len(crossings(lines(*ahead, sensors=[3, 3]), rng)[0])
    assert not len(crossings(lines(*ahead, far=7.0), rng)[0])  # sqrt(50) is 7.07
    assert len(crossings(lines(*ahead, far=7.1), rng)[0]) == 1
    behind = ((0.0, 0.0, np.pi / 4), (10.0, 0.0, -np.pi / 4))
    assert not len(crossings(lines(*behind), rng)[0])
    assert not len(crossings(lines((0.0, 0.0, 1.0), (10.0, 0.0, 1.0)), rng)[0])
    # 0.02 is the least sine of the angle between two lines that cross
    narrow = [(0.0, 0.0, 1.5), (0.1, 0.0, 1.5 + np.arcsin(0.0201))]
    assert len(crossings(lines(*narrow), rng)[0]) == 1
    assert not len(crossings(lines(narrow[0], (0.1, 0.0, 1.5 + np.arcsin(0.0199))), rng)[0])


def test_of_many_crossings_two_hundred_are_taken():
    azimuths = np.linspace(0.3, 1.2, 20)
    rows = [(0.0, 0.0, a) for a in azimuths] + [(10.0, 0.0, np.pi - a) for a in azimuths]
    seen = lines(*rows, sensors=[0] * 20 + [1] * 20, far=200.0)
    centre, _ = crossings(seen, np.random.default_rng(6))
    assert len(centre) == 200
    assert len(np.unique(centre.round(9), axis=0)) == 200
