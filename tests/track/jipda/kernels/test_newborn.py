"""People whom nobody tracks yet."""

from __future__ import annotations

import math

import numpy as np
import pytest
from crowds import cameras_around

from occlog.array_types import Floats
from occlog.track.jipda.kernels.body_box import expected_box, pack_views
from occlog.track.jipda.kernels.detections import Boxes, Rates
from occlog.track.jipda.kernels.newborn import Arrival, newborn, on_floor

VIEWS = pack_views(cameras_around(4, 10.0, 8.0))._replace(range=np.full(4, 40.0))
BODY = np.array([1.7, 0.12, 0.55, 0.12, 0.9])
NOISE = np.array([[8.0, 1e-4], [20.0, 4e-4], [6.0, 1e-4], [15.0, 2e-4]])
RATES = Rates(
    np.full(4, 0.9), np.ones(6), 0.0, 0.0, np.zeros((4, 4)), NOISE, 0.0, np.ones(4), merge=np.zeros(4), slow=1.0
)
PLACES = np.array([[4.0, 3.0], [6.5, 4.5]])


def boxes(people: Floats, cameras: tuple[int, ...] = (0, 1, 2, 3), height: float = 1.75) -> Boxes:
    """True boxes of bodies of this height, 0.5 m wide."""
    made, first = [], [0]
    for c in range(4):
        for x, y in people:
            box = np.empty(4)
            expected_box(VIEWS.lens[c], x, y, height, 0.5, box)
            if c in cameras:
                made.append(box)
        first.append(len(made))
    n = len(made)
    return Boxes(np.arange(4), np.zeros(4), np.array(first), np.array(made).reshape(-1, 4),
                 np.ones((n, 4), dtype=bool), np.full(n, np.log(0.5)))  # fmt: skip


def found(made: Boxes, free: float = 1.0, everywhere: float = 0.01) -> tuple[Floats, Floats, Floats, Floats]:
    """New people, nobody being there before."""
    arrival = Arrival(everywhere, 10.0, np.zeros((0, 2)), np.zeros(0), 1.0)
    nobody = np.zeros((0, 6)), np.zeros(0), np.zeros(0)
    n = len(made.box)
    return newborn(VIEWS, made, RATES, BODY, arrival, *nobody, np.full(n, free), 30.0, math.log(0.05))


def test_people_are_found_where_they_stand_each_once() -> None:
    mean, covariance, odds, used = found(boxes(PLACES))
    sure = np.flatnonzero(odds > 3.0)
    assert len(sure) == 2
    order = np.argsort(mean[sure, 0])
    np.testing.assert_allclose(mean[sure][order][:, :2], PLACES, atol=0.03)
    np.testing.assert_allclose(mean[sure, 4], 1.75, atol=0.03)
    assert used[sure].sum() == pytest.approx(8.0, abs=0.1)
    assert np.linalg.eigvalsh(covariance[sure]).min() > 0.0


def test_boxes_that_are_somebodys_propose_nobody() -> None:
    assert len(found(boxes(PLACES), free=0.1)[2]) == 0


def test_cameras_that_see_nobody_there_speak_against_it() -> None:
    four = found(boxes(PLACES[:1]))[2].max()
    two = found(boxes(PLACES[:1], cameras=(0, 1)))[2].max()
    alone = found(boxes(PLACES[:1], cameras=(0,)))[2]
    assert four > two > alone.max(initial=-np.inf)
    assert alone.max(initial=-np.inf) < 0.0


def test_more_arrivals_raise_the_odds_by_as_much() -> None:
    low, high = found(boxes(PLACES[:1]), everywhere=0.001)[2].max(), found(boxes(PLACES[:1]), everywhere=0.002)[2].max()
    assert high - low == pytest.approx(math.log(2.0), abs=1e-6)


@pytest.mark.parametrize(("height", "count"), [(1.0, 0), (1.25, 1), (2.1, 1), (2.3, 0)])
def test_bodies_are_as_tall_as_people(height: float, count: int) -> None:
    # From five deviations below the usual height, 1.1 m, to four above it, 2.18 m
    odds = found(boxes(PLACES[:1], height=height))[2]
    assert (odds > 0.0).sum() == count


@pytest.mark.parametrize(("away", "more"), [(0.0, 1.0), (2.0, 0.135335), (4.1, 0.0)])
def test_arrivals_are_expected_within_four_deviations_of_where_people_came_from(away: float, more: float) -> None:
    made = boxes(PLACES[:1])
    nobody = np.zeros((0, 6)), np.zeros(0), np.zeros(0)
    odds = []
    for at in (0.0, 1e-3):
        arrival = Arrival(1e-3, 10.0, PLACES[:1] + np.array([0.0, away]), np.array([at]), 1.0)
        odds.append(newborn(VIEWS, made, RATES, BODY, arrival, *nobody, np.ones(4), 30.0, math.log(0.05))[2].max())
    assert odds[1] - odds[0] == pytest.approx(math.log(1.0 + more), abs=0.02)


def test_a_pixel_above_the_horizon_shows_no_floor() -> None:
    place = np.empty(2)
    assert on_floor(VIEWS, 0, 640.0, 700.0, 0.0, place)
    assert not on_floor(VIEWS, 0, 640.0, -900.0, 0.0, place)
