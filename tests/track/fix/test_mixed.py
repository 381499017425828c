"""A position from bearings, ranges, strengths and differences: worked geometry, ambiguity, false ones, statistics."""

from __future__ import annotations

import numpy as np
import pytest

from occlog.filtering.likelihood.distances import (
    DIFFERENCE,
    LOGARITHM,
    RANGE,
    RangeMeasurements,
    information,
    no_measurements,
    residuals,
)
from occlog.track.methods.fix.estimators import Modes, modes, spread_of
from occlog.track.methods.fix.lines_and_distances import BearingLines, has_rival_mode, modes_of

BEND = 3.7
PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0], [10.0, 8.0]])
NO_LINES = BearingLines(np.empty((0, 2)), np.empty(0), np.empty(0), BEND)


def measured(
    kind: int, xy: np.ndarray, sigma: float, positions: np.ndarray = PLACES, rise2: float = 0.0
) -> RangeMeasurements:
    """Without errors, of all stations; differences are to the first."""
    own = positions[1:] if kind == DIFFERENCE else positions
    n = len(own)
    rows = RangeMeasurements(
        kind=np.full(n, kind),
        value=np.zeros(n),
        sigma=np.full(n, sigma),
        position=own,
        rise2=np.full(n, rise2),
        other=np.tile(positions[0], (n, 1)) if kind == DIFFERENCE else own,
        other_rise2=np.full(n, rise2),
        station=np.arange(n),
        bend=BEND,
    )
    return rows._replace(value=-residuals(rows, xy[None])[0] * sigma)


def test_two_ranges_say_two_places_and_the_covariance_holds_both() -> None:
    found = modes_of(NO_LINES, measured(RANGE, np.array([3.0, 4.0]), 0.05, PLACES[:2]))
    assert sorted(np.round(found.xy, 6).tolist()) == [[3.0, -4.0], [3.0, 4.0]]
    np.testing.assert_allclose(found.probability, [0.5, 0.5], atol=1e-6)
    away = found.xy[1] - found.xy[0]
    assert away @ np.linalg.solve(spread_of(found, pooled=True), away) < 5.991


def test_stations_on_a_line_do_not_tell_one_side_from_the_other() -> None:
    positions = np.array([[0.0, 0.0], [5.0, 0.0], [12.0, 0.0]])
    for kind in (RANGE, DIFFERENCE):
        found = modes_of(NO_LINES, measured(kind, np.array([4.0, 3.0]), 0.02, positions))
        assert sorted(np.round(found.xy, 4).tolist()) == [[4.0, -3.0], [4.0, 3.0]], kind


@pytest.mark.parametrize("kind", [RANGE, LOGARITHM, DIFFERENCE])
def test_without_errors_the_place_is_exact(kind: int) -> None:
    rng = np.random.default_rng(kind)
    for xy in rng.uniform([1, 1], [9, 7], (10, 2)):
        found = modes_of(NO_LINES, measured(kind, xy, 0.05, rise2=1.5))
        np.testing.assert_allclose(found.xy[0], xy, atol=1e-5)


def test_a_range_and_a_bearing_of_one_station_are_a_place() -> None:
    line = BearingLines(PLACES[:1], np.array([np.pi / 6]), np.array([0.01]), BEND)
    found = modes_of(line, measured(RANGE, np.array([4.0 * np.cos(np.pi / 6), 2.0]), 0.05, PLACES[:1]))
    np.testing.assert_allclose(found.xy, [[4.0 * np.cos(np.pi / 6), 2.0]], atol=1e-6)
    np.testing.assert_allclose(np.trace(found.covariance[0]), 0.05**2 + 0.04**2, rtol=0.01)


def test_one_false_range_of_five_is_found() -> None:
    positions = np.vstack([PLACES, [[5.0, 9.0]]])
    rows = measured(RANGE, np.array([3.0, 4.0]), 0.05, positions)
    rows.value[1] += 2.0  # a reflection
    found = modes_of(NO_LINES, rows)
    np.testing.assert_allclose(found.xy[0], [3.0, 4.0], atol=1e-6)
    assert (found.inlier_probability[0] > 0.5).tolist() == [True, False, True, True, True]


def test_one_range_tells_no_place_and_neither_does_nothing() -> None:
    assert modes_of(NO_LINES, measured(RANGE, np.array([3.0, 4.0]), 0.05, PLACES[:1])) is None
    two = measured(RANGE, np.array([3.0, 4.0]), 0.05, PLACES[[0, 0]])
    assert modes_of(NO_LINES, two) is None


def test_bearings_alone_give_what_they_give_without_distances() -> None:
    xy = np.array([4.0, 3.0])
    away = xy - PLACES
    bearings, sigma = np.arctan2(away[:, 1], away[:, 0]) + 1e-3, np.full(4, 0.01)
    one, other = (
        modes(PLACES, bearings, sigma, BEND),
        modes_of(BearingLines(PLACES, bearings, sigma, BEND), no_measurements(BEND)),
    )
    np.testing.assert_allclose(one.xy[0], other.xy[0], atol=1e-7)
    np.testing.assert_allclose(one.covariance[0], other.covariance[0], rtol=0.02)


@pytest.mark.parametrize(("kind", "sigma"), [(RANGE, 0.05), (RANGE, 1.5), (LOGARITHM, 0.3), (DIFFERENCE, 0.05)])
def test_normalised_squared_errors_are_those_of_two_degrees_of_freedom(kind: int, sigma: float) -> None:
    rng = np.random.default_rng(7)
    nees = []
    for _ in range(40):
        xy = rng.uniform([2, 2], [8, 6])
        exact = measured(kind, xy, sigma)
        found = modes_of(NO_LINES, exact._replace(value=exact.value + sigma * rng.standard_normal(len(exact.value))))
        away = found.xy[0] - xy
        nees.append(away @ np.linalg.solve(spread_of(found, pooled=False), away))
    error = np.std(nees) / np.sqrt(len(nees))
    assert abs(np.mean(nees) - 2.0) < 4.0 * error
    assert np.mean(np.array(nees) > 5.991) < 0.15


def false_at(rows: RangeMeasurements, n: int, by: float) -> RangeMeasurements:
    value = rows.value.copy()
    value[n] += by
    return rows._replace(value=value)


def test_with_one_of_three_differences_false_the_true_place_is_among_the_modes() -> None:
    # Two true ones remain, which cross at the place with residuals of 0: no mode is more probable
    rng = np.random.default_rng(5)
    for trial in range(12):
        xy = rng.uniform([1, 1], [9, 7])
        rows = measured(DIFFERENCE, xy, 0.05)
        wrong = false_at(rows, trial % 3, 3.0 if rows.value[trial % 3] < 0 else -3.0)
        found = modes_of(NO_LINES, wrong)
        assert np.hypot(*(found.xy - xy).T).min() < 1e-4, trial


def test_a_room_speaks_against_modes_outside_of_it_and_one_measurement_more_against_the_room() -> None:
    room = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]])
    two = measured(RANGE, np.array([3.0, 4.0]), 0.05, PLACES[:2])
    found = modes_of(NO_LINES, two, room)
    np.testing.assert_allclose(found.xy, [[3.0, 4.0]], atol=1e-6)  # the mirror image at (3, -4) is left out
    outside = modes_of(NO_LINES, measured(RANGE, np.array([3.0, -4.0]), 0.05), room)
    np.testing.assert_allclose(outside.xy[0], [3.0, -4.0], atol=1e-6)  # four that agree are believed
    # On the border nothing changes: half of the noise is outside of the wall
    border = modes_of(NO_LINES, false_at(measured(RANGE, np.array([5.0, 0.0]), 0.05), 2, 0.05), room)
    free = modes_of(NO_LINES, false_at(measured(RANGE, np.array([5.0, 0.0]), 0.05), 2, 0.05))
    np.testing.assert_allclose(border.xy[0], free.xy[0], atol=1e-6)


@pytest.mark.parametrize("aside", [0.01, 0.3, 3.0])
def test_where_circles_nearly_touch_the_spread_is_that_of_the_likelihood(aside: float) -> None:
    # Near the line of the stations ranges tell y^2: the Gaussian of the mode can be far longer than the likelihood
    rows = measured(RANGE, np.array([4.0, aside]), 0.05, np.array([[0.0, 0.0], [10.0, 0.0]]))
    found = modes_of(NO_LINES, rows)
    x, y = np.linspace(-0.5, 0.5, 401), np.linspace(-4.0, 4.0, 1601)
    at = np.stack(np.meshgrid(4.0 + x, y), axis=-1).reshape(-1, 2)
    at = (
        at[np.sign(at[:, 1]) == np.sign(found.xy[0, 1])] if aside > 1.0 else at
    )  # else the mirror image is the same hill
    weight = np.exp(-0.5 * (residuals(rows, at) ** 2).sum(axis=1))
    wanted = weight @ (at - found.xy[0]) ** 2 / weight.sum()
    np.testing.assert_allclose(np.diag(found.covariance[0]), wanted, rtol=0.1)


@pytest.mark.parametrize(
    ("residual", "believed", "elsewhere", "reported"),
    [
        ([0.5, -0.5, 0.8, 0.1], [1, 1, 1, 1], 0.0, False),
        ([0.5, -0.5, 0.8, 0.1], [1, 1, 1, 1], 0.02, False),
        ([0.5, -0.5, 0.8, 0.1], [1, 1, 1, 1], 0.06, True),
        ([0.5, -9.0, 0.8, 0.1], [1, 0, 1, 1], 0.02, True),
        ([2.3, -2.0, 0.8, 0.1], [1, 1, 1, 1], 0.0, True),  # 9.9 of two degrees of freedom
        ([2.3, -2.0, 0.8, 0.1], [1, 0, 1, 1], 0.0, False),  # 5.9 of one: passed by 1.5 %
        ([2.6, -2.0, 0.8, 0.1], [1, 0, 1, 1], 0.0, True),
        ([9.0, 9.0, 0.0, 0.0], [0, 0, 1, 1], 0.0, False),  # nothing is left to test
    ],
)
def test_other_places_and_a_large_scatter_contest_a_place(
    residual: list[float], believed: list[int], elsewhere: float, reported: bool
) -> None:
    one = np.zeros((1, 2)), np.eye(2)[None], np.array([believed], dtype=float), np.array([residual]), np.ones(1)
    assert has_rival_mode(Modes(*one, elsewhere)) == reported


def test_with_a_false_range_of_four_rows_that_nothing_contests_are_near_the_bound() -> None:
    rng, sigma = np.random.default_rng(11), 0.5
    squares, bounds, flags = [], [], []
    for trial in range(40):
        xy = rng.uniform([1, 1], [9, 7])
        rows = measured(RANGE, xy, sigma)
        rows.value[:] += sigma * rng.standard_normal(4)
        rows.value[trial % 4] = rng.uniform(0.0, 20.0)
        found = modes_of(NO_LINES, rows)
        squares.append(((found.xy[0] - xy) ** 2).sum())
        flags.append(
            has_rival_mode(found)
            or (found.inlier_probability[0] >= 0.5).sum() <= 2
            or found.probability[1:2].sum() > 0.05
        )
        true = np.delete(np.arange(4), trial % 4)
        bounds.append(np.trace(np.linalg.inv(information(rows.take(true), np.tile(xy, (3, 1))).sum(axis=0))))
    good = ~np.array(flags)
    ratio = np.sqrt(np.mean(np.array(squares)[good]) / np.mean(np.array(bounds)[good]))
    everything = np.sqrt(np.mean(squares) / np.mean(bounds))
    assert good.sum() >= 6
    assert ratio < 1.4
    assert everything > 2.0


@pytest.mark.parametrize("false", [0, 60])
def test_of_200_ranges_the_place_is_found_though_not_all_circles_are_crossed(false: int) -> None:
    rng = np.random.default_rng(24)
    positions, xy = rng.uniform(0.0, 100.0, (200, 2)), np.array([31.0, 64.0])
    rows = measured(RANGE, xy, 0.05, positions)
    value = rows.value + rng.normal(0.0, 0.05, 200)
    value[rng.permutation(200)[:false]] += rng.uniform(2.0, 30.0, false)
    found = modes_of(NO_LINES, rows._replace(value=value))
    # Half the true ranges fix each coordinate: 0.05 m / sqrt(n / 2), five standard deviations
    assert np.abs(found.xy[0] - xy).max() < 5.0 * 0.05 / np.sqrt(0.5 * (200 - false))
    assert np.count_nonzero(found.inlier_probability[0] > 0.5) == pytest.approx(200 - false, abs=3)
