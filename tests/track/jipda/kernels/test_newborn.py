"""People whom no one tracks yet."""

from __future__ import annotations

import math

import jipda_reference as textbook
import numpy as np
import pytest
from crowds import cameras_around
from scipy.optimize import least_squares
from scipy.stats import multivariate_normal, norm

from occlog.array_types import Floats
from occlog.track.methods.jipda.kernels.body_box import PackedCameras, expected_box, pack_views
from occlog.track.methods.jipda.kernels.detections import DetectorModel, PackedDetections
from occlog.track.methods.jipda.kernels.track_initiation import (
    BirthIntensity,
    arrivals_at,
    initiate_targets,
    point_at_height,
    predicted_targets,
    propose_track,
    state_from_box,
)

VIEWS = pack_views(cameras_around(4, 10.0, 8.0))._replace(range=np.full(4, 40.0))
BODY = np.array([1.7, 0.12, 0.55, 0.12, 0.9])
NOISE = np.array([[8.0, 1e-4], [20.0, 4e-4], [6.0, 1e-4], [15.0, 2e-4]])
RATES = DetectorModel(
    np.full(4, 0.9),
    np.ones(6),
    0.0,
    0.0,
    np.zeros((4, 4)),
    NOISE,
    0.0,
    np.ones(4),
    merge=np.zeros(4),
    common_miss=0.0,
    slow=1.0,
)
PLACES = np.array([[4.0, 3.0], [6.5, 4.5]])


def boxes(people: Floats, cameras: tuple[int, ...] = (0, 1, 2, 3), height: float = 1.75) -> PackedDetections:
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
    return PackedDetections(np.arange(4), np.zeros(4), np.array(first), np.array(made).reshape(-1, 4),
                 np.ones((n, 4), dtype=bool), np.full(n, np.log(0.5)))  # fmt: skip


def found(made: PackedDetections, free: float = 1.0, everywhere: float = 0.01) -> tuple[Floats, Floats, Floats, Floats]:
    """New people, no one being there before."""
    arrival = BirthIntensity(everywhere, 10.0, np.zeros((0, 2)), np.zeros(0), 1.0)
    empty = np.zeros((0, 6)), np.zeros(0), np.zeros(0)
    n = len(made.box)
    return initiate_targets(VIEWS, made, RATES, BODY, arrival, *empty, np.full(n, free), 30.0, math.log(0.05))


def test_people_are_found_where_they_stand_each_once() -> None:
    mean, covariance, odds, used = found(boxes(PLACES))
    sure = np.flatnonzero(odds > 3.0)
    assert len(sure) == 2
    order = np.argsort(mean[sure, 0])
    np.testing.assert_allclose(mean[sure][order][:, :2], PLACES, atol=0.03)
    np.testing.assert_allclose(mean[sure, 4], 1.75, atol=0.03)
    assert used[sure].sum() == pytest.approx(8.0, abs=0.1)
    assert np.linalg.eigvalsh(covariance[sure]).min() > 0.0


def test_boxes_that_are_somebodys_propose_no_one() -> None:
    assert len(found(boxes(PLACES), free=0.1)[2]) == 0


def test_one_box_alone_proposes_a_person() -> None:
    mean, _, odds, used = found(boxes(PLACES[:1], cameras=(2,)), everywhere=1.0)
    np.testing.assert_allclose(mean[:, :2], PLACES[:1], atol=0.1)
    assert odds.shape == (1,)
    np.testing.assert_array_equal(used, [[1.0]])
    assert len(found(boxes(PLACES[:0]))[2]) == 0


def test_cameras_that_see_no_one_there_speak_against_it() -> None:
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


def test_arrivals_are_expected_within_four_deviations_of_where_people_came_from() -> None:
    """Of two such positions, the second one is 3 m, 4 m from the person: 2.5 m each to the deviation of 1.25 m."""
    centre, mean = np.array([[9.0, 9.0], [4.0, 5.0]]), np.array([1.0, 1.0, 0.5, 0.5, 1.7, 0.5])
    for smooth, more in ((2.5, math.exp(-2.0)), (5.0 / 3.999, math.exp(-0.5 * 3.999**2)), (1.25, 0.0), (1.1, 0.0)):
        arrival = BirthIntensity(0.2, 10.0, centre, np.array([0.0, 3e3]), smooth)
        assert arrivals_at(arrival, mean) == pytest.approx(0.2 + 3e3 * more, rel=1e-12)


def of_first_box(made: PackedDetections, views: PackedCameras = VIEWS, body: Floats = BODY) -> tuple[float, Floats]:
    """Log density and state of the person whom the box of camera 0 proposes."""
    mean, arrival = np.empty(6), BirthIntensity(0.02, 10.0, np.zeros((0, 2)), np.zeros(0), 1.0)
    return state_from_box(views, made, RATES, body, arrival, 0, 0, mean, np.empty((6, 6))), mean


def test_a_box_proposes_a_person_up_to_the_range_of_its_camera() -> None:
    made, foot = boxes(PLACES[:1]), np.empty(2)
    assert point_at_height(VIEWS, 0, 0.5 * (made.box[0, 0] + made.box[0, 2]), made.box[0, 3], 0.0, foot)
    distance = math.hypot(*(foot - VIEWS.position[0, :2]))
    for reach, some in ((distance, True), (np.nextafter(distance, 0.0), False)):
        views = VIEWS._replace(range=np.array([reach, 1.0, 1.0, 1.0]))
        assert math.isfinite(of_first_box(made, views)[0]) == some


def test_bodies_are_no_smaller_than_three_tenths_of_the_usual_one() -> None:
    """With deviations of 5 m the box alone decides the size, of which the half is then the limit."""
    made = boxes(PLACES[:1], height=0.6)
    body = np.array([1.9, 5.0, 1.5, 5.0, 0.9])
    np.testing.assert_allclose(of_first_box(made, body=body)[1][4:], [0.6, 0.5], atol=0.01)
    body = np.array([2.1, 5.0, 1.8, 5.0, 0.9])
    np.testing.assert_allclose(of_first_box(made, body=body)[1][4:], [0.63, 0.54], rtol=1e-12)


def test_the_odds_of_boxes_that_are_others_and_of_detectors_that_miss_all_are_limited() -> None:
    """One camera: the probability that the box is of no person, and that of detection, count 1e-6 at least."""
    made, odds = boxes(PLACES[:1], cameras=(0,)), []
    made = made._replace(camera=made.camera[:1], delay=made.delay[:1], first=made.first[:2])
    arrival = BirthIntensity(0.02, 10.0, np.zeros((0, 2)), np.zeros(0), 1.0)
    tracked = predicted_targets(VIEWS, made, np.zeros((0, 6)), np.zeros(0), np.zeros(0))
    for free, detection in ((1.0, 1.0), (0.0, 1.0), (1.0, 0.0)):
        rates = RATES._replace(detection=np.full(4, detection))
        out = np.empty(6), np.empty((6, 6)), np.empty(1)
        odds.append(propose_track(VIEWS, made, rates, BODY, arrival, tracked, np.array([free]), 0, 0, 30.0, *out))
    np.testing.assert_allclose(np.diff(odds), [math.log(1e-6), 0.0], atol=1e-9)


def test_the_line_of_sight_of_a_pixel_meets_a_plane_in_the_point_that_projects_to_it() -> None:
    camera, rng, found = cameras_around(4, 10.0, 8.0)[2], np.random.default_rng(0), np.empty(2)
    views = VIEWS._replace(focal=VIEWS.focal * [1.0, 1.1], principal=VIEWS.principal + np.array([5.0, -9.0]))
    for x, y, z in rng.uniform([2.0, 2.0, 0.0], [8.0, 6.0, 1.0], (5, 3)):
        q = camera.rotation.T @ (np.array([x, y, z]) - camera.position)
        u, v = views.focal[2] * q[:2] / q[2] + views.principal[2]
        assert point_at_height(views, 2, u, v, z, found)
        np.testing.assert_allclose(found, [x, y])


def test_a_line_of_sight_along_the_plane_meets_it_nowhere() -> None:
    level, place = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.full(2, np.nan)
    views = VIEWS._replace(rotation=np.tile(level, (4, 1, 1)))
    horizon = views.principal[0, 1]
    assert not point_at_height(views, 0, 0.0, horizon, 0.0, place)
    assert not point_at_height(views, 0, 0.0, horizon - 1.0, 0.0, place)
    # Up to a slope of 1e-9 of the line of sight
    focal = views.focal[0, 1]
    assert not point_at_height(views, 0, 0.0, horizon + 0.9e-9 * focal, 0.0, place)
    # From a camera in the plane no point of it is before the camera
    assert not point_at_height(views, 0, 0.0, horizon + 1.0, views.position[0, 2], place)
    assert np.isnan(place).all()
    assert point_at_height(views, 0, 0.0, horizon + 1.0, 0.0, place)
    assert point_at_height(views, 0, 0.0, horizon + 1.4e-9 * focal, 0.0, place)


def test_a_pixel_above_the_horizon_shows_no_floor() -> None:
    place = np.empty(2)
    assert point_at_height(VIEWS, 0, 640.0, 700.0, 0.0, place)
    assert not point_at_height(VIEWS, 0, 640.0, -900.0, 0.0, place)


@pytest.mark.parametrize(
    ("c", "believed"), [(0, (1, 1, 1, 1)), (1, (1, 1, 1, 1)), (2, (1, 0, 0, 1)), (3, (0, 1, 1, 0))]
)
def test_a_body_is_the_most_probable_one_with_laplaces_approximation(c: int, believed: tuple[int, ...]) -> None:
    camera, use = cameras_around(4, 10.0, 8.0)[c], np.array(believed, dtype=bool)
    made = boxes(PLACES[:1])
    z = made.box[c] + np.array([2.0, -3.0, 4.0, 1.0])
    made = made._replace(box=z[None].repeat(4, axis=0), usable=use[None].repeat(4, axis=0))
    mean, covariance = np.empty(6), np.empty((6, 6))
    arrival = BirthIntensity(0.02, 1e9, PLACES[:1] + np.array([[0.5, 0.0]]), np.array([0.01]), 0.7)
    got = state_from_box(VIEWS, made, RATES, BODY, arrival, c, c, mean, covariance)

    def box_of(body: Floats) -> Floats:
        return textbook.body_box(camera, *body)

    detector = textbook.Detector(0.9, np.ones(6), 0.0, 0.0, np.zeros(4), NOISE, 0.0, 1.0, 0.0, 1.0)
    best = np.delete(mean, [2, 3])
    R = textbook.edge_covariance(box_of(best), detector, 1.0)[np.ix_(use, use)]
    white = np.linalg.inv(np.linalg.cholesky(R))

    def off(body: Floats) -> Floats:
        return np.append(white @ (z - box_of(body))[use], (body[2:] - BODY[[0, 2]]) / BODY[[1, 3]])

    fit = least_squares(off, best + np.array([0.1, -0.1, 0.05, 0.02]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(best, fit.x, atol=2e-3)
    information = fit.jac.T @ fit.jac
    wanted = np.zeros((6, 6))
    wanted[np.ix_([0, 1, 4, 5], [0, 1, 4, 5])] = np.linalg.inv(information)
    wanted[2, 2] = wanted[3, 3] = BODY[4] ** 2
    np.testing.assert_allclose(covariance, wanted, rtol=0.02, atol=1e-6)
    np.testing.assert_array_equal(mean[2:4], 0.0)
    log = (
        multivariate_normal.logpdf(z[use], box_of(fit.x)[use], R)
        + norm.logpdf(fit.x[2:], BODY[[0, 2]], BODY[[1, 3]]).sum()
    )
    log += 2.0 * math.log(2.0 * math.pi) - 0.5 * np.linalg.slogdet(information)[1]
    away = math.hypot(*(fit.x[:2] - arrival.centre[0]))
    log_new = math.log(arrival.everywhere + arrival.at[0] * math.exp(-0.5 * (away / arrival.smooth) ** 2))
    assert got == pytest.approx(log + log_new, abs=0.02)
    # Where the image shows little floor, no more are expected than are for the whole image
    step = 1e-4 * np.eye(4)[:2]
    slopes = [(box_of(fit.x + s) - box_of(fit.x - s)) / 2e-4 for s in step]
    slope = np.array([[0.5 * (d[0] + d[2]), d[3]] for d in slopes])
    area = abs(np.linalg.det(slope)) / (camera.image_size[0] * camera.image_size[1])
    few = state_from_box(VIEWS, made, RATES, BODY, arrival._replace(in_image=1e-9), c, c, mean, covariance)
    assert few - got == pytest.approx(math.log(1e-9 * area) - log_new, abs=0.02)
