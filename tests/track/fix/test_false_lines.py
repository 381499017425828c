"""Probabilities and second moments of lines of sight that are alone true, against an integral over a fine grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from occlog.track.methods.fix.estimators import modes
from occlog.track.methods.fix.false_lines import FalseLines, Region, depends_on_one, false_line_moment

REGION = Region(np.array([0.0, 0.0]), np.array([10.0, 8.0]))
SIGMA, BEND = 0.01, 3.7
SENSORS = np.array([[0.0, 0.0], [10.0, 0.0], [5.0, 8.0]])
STEP = 0.01


def towards(positions, xy):
    return np.arctan2(xy[1] - positions[:, 1], xy[0] - positions[:, 0])


def by_grid(found, positions, bearings, widths, false):
    """Share of the likelihood of positions more than 4 standard deviations from all modes, and its second moment."""
    x, y = np.meshgrid(np.arange(STEP / 2, 10.0, STEP), np.arange(STEP / 2, 8.0, STEP))
    xy = np.column_stack([x.ravel(), y.ravel()])
    likelihood, beyond = np.ones(len(xy)), np.ones(len(xy), dtype=bool)
    for position, bearing, width in zip(positions, bearings, widths, strict=True):
        off = bearing - np.arctan2(xy[:, 1] - position[1], xy[:, 0] - position[0])
        off = (off + np.pi) % (2 * np.pi) - np.pi
        density = np.exp(-0.5 * (off / SIGMA) ** 2) / (SIGMA * math.sqrt(2 * math.pi))
        likelihood *= (1.0 - false) * density + false / width
    for mode, covariance in zip(found.xy, found.covariance, strict=True):
        away = xy - mode
        beyond &= np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away) > 16.0
    away, rest = xy - found.xy[0], likelihood * beyond
    return rest.sum() / likelihood.sum(), np.einsum("n,ni,nj->ij", rest, away, away) / rest.sum()


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("false", [0.05, 0.2])
def test_probability_and_moment_are_those_of_a_grid(n: int, false: float) -> None:
    positions, widths = SENSORS[:n], np.full(n, 1.7)
    bearings = towards(positions, np.array([4.0, 3.0]))
    if n == 3:
        bearings[2] += 0.6  # two of three agree
    found = modes(positions, bearings, np.full(n, SIGMA), BEND)
    lines = FalseLines(widths, false, BEND, found=True)
    probability, second_moment = false_line_moment(found, positions, bearings, np.full(n, SIGMA), lines, REGION)
    share, second = by_grid(found, positions, bearings, widths, false)
    assert probability == pytest.approx(share, rel=0.15)
    assert_allclose(second_moment, second, rtol=0.15, atol=0.5)


def test_what_is_improbable_does_not_count_until_a_false_bearing_was_found() -> None:
    positions, sigma = SENSORS[:2], np.full(2, 0.005)
    bearings = towards(positions, np.array([4.0, 3.0]))
    found = modes(positions, bearings, sigma, BEND)
    lines = FalseLines(np.full(2, 1.7), 1e-3, BEND, found=False)
    probability, second_moment = false_line_moment(found, positions, bearings, sigma, lines, REGION)
    assert probability == 0.0
    assert not second_moment.any()
    lines = lines._replace(found=True)
    assert 0.0 < false_line_moment(found, positions, bearings, sigma, lines, REGION)[0] < 0.01


def test_two_lines_that_coincide_do_not_confirm_a_third() -> None:
    """Sensors that face each other have one line in common; the third bearing alone tells where on it."""
    positions, sigma = np.array([[0.0, 0.0], [10.0, 8.0], [10.0, 0.0]]), np.full(3, SIGMA)
    bearings = towards(positions, np.array([4.0, 3.3]))
    found = modes(positions, bearings, sigma, BEND)
    assert (found.inlier_probability[0] > 0.5).all()
    assert depends_on_one(found, positions, sigma)
    widths = np.full(3, 1.7)
    lines = FalseLines(widths, 0.1, BEND, found=True)
    probability, second_moment = false_line_moment(found, positions, bearings, sigma, lines, REGION)
    share, second = by_grid(found, positions, bearings, widths, 0.1)
    # The integral across two lines of equal width is up to 1.4 times too large
    assert 0.9 * share < probability < 1.6 * share
    assert_allclose(second_moment, second, rtol=0.3, atol=0.5)
    # Crossings at large angles confirm each other
    positions[1] = [5.0, 8.0]
    found = modes(positions, towards(positions, np.array([4.0, 3.3])), sigma, BEND)
    assert not depends_on_one(found, positions, sigma)


def test_lines_that_meet_outside_the_room_are_probably_false() -> None:
    positions, sigma = SENSORS[:2], np.full(2, 0.005)
    bearings = towards(positions, np.array([4.0, 12.0]))
    found = modes(positions, bearings, sigma, BEND)
    lines = FalseLines(np.full(2, 1.7), 0.05, BEND, found=True)
    probability, second_moment = false_line_moment(found, positions, bearings, sigma, lines, REGION)
    assert probability > 0.9
    # The room is 4 m and more away
    assert second_moment[1, 1] > 16.0
