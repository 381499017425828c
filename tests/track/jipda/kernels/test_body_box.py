"""The box of a body: against points of an ellipsoid, projected one by one by the scene's camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jipda_reference import outline_of

from occlog.array_types import Floats
from occlog.core.geometry.lens import distort
from occlog.records.scene import Camera, camera_rotation
from occlog.track.methods.jipda.kernels.body_box import (
    MIN_DEPTH_HEIGHTS,
    box_and_slope,
    distorted,
    expected_box,
    pack_views,
    project,
)

LENSES = {
    "ideal": (np.zeros(5), "brown"),
    "brown": (np.array([-0.25, 0.08, 0.001, -0.002, 0.01]), "brown"),
    "tsai": (np.array([0.06, 0.0, 0.0, 0.0, 0.0]), "tsai"),
    "fisheye": (np.array([-0.02, 0.03, -0.02, 0.004, 0.0]), "equidistant"),
    "opencv": (
        np.array([0.5, -0.3, 0.001, -0.002, 0.02, 0.75, -0.35, 0.015, 0.01, -0.002, -0.008, 0.003, 0.04, -0.03]),
        "opencv",
    ),
}


def camera(lens: str = "ideal", roll: float = 0.0, metre: float = 1.0) -> Camera:
    distortion, model = LENSES[lens]
    return Camera(
        "a",
        np.array([0.0, -6.0, 3.0]) * metre,
        camera_rotation(np.pi / 2, -0.35, roll),
        np.array([900.0, 950.0]),
        np.array([640.0, 360.0]),
        (1280, 720),
        distortion=distortion,
        distortion_model=model,
    )


def sampled(view: Camera, x: float, y: float, height: float, width: float) -> Floats:
    """Box around the pixels of many points of the ellipsoid."""
    around, up = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 400), np.linspace(0.0, np.pi, 400))
    points = np.column_stack(
        [
            x + 0.5 * width * (np.sin(up) * np.cos(around)).ravel(),
            y + 0.5 * width * (np.sin(up) * np.sin(around)).ravel(),
            0.5 * height * (1.0 + np.cos(up)).ravel(),
        ]
    )
    pixels = view.project(points)
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


@pytest.mark.parametrize("position", [(0.3, 1.0), (-2.0, 3.0), (1.5, -2.0)])
@pytest.mark.parametrize("roll", [0.0, 0.2])
def test_the_box_of_an_ideal_lens_is_that_of_the_ellipsoids_points(position: tuple[float, float], roll: float) -> None:
    view, box = camera(roll=roll), np.empty(4)
    assert expected_box(pack_views([view]).lens[0], *position, 1.7, 0.5, box) > 0.0
    np.testing.assert_allclose(box, sampled(view, *position, 1.7, 0.5), atol=0.05)


@pytest.mark.parametrize("lens", ["brown", "tsai", "fisheye", "opencv"])
def test_a_lens_moves_the_points_of_contact(lens: str) -> None:
    view, box = camera(lens), np.empty(4)
    expected_box(pack_views([view]).lens[0], 1.0, 1.0, 1.7, 0.5, box)
    # The points of contact of the distorted outline are others by little
    np.testing.assert_allclose(box, sampled(view, 1.0, 1.0, 1.7, 0.5), atol=0.5)


@pytest.mark.parametrize("lens", ["brown", "tsai", "fisheye", "opencv"])
def test_a_point_is_distorted_as_by_the_scenes_lens_and_in_a_straight_line_beyond_its_limit(lens: str) -> None:
    packed, (coefficients, model) = pack_views([camera(lens)]).lens[0], LENSES[lens]
    limit = min(packed[22], 5.0)
    packed[22] = limit
    for turn in np.linspace(0.0, 2.0 * np.pi, 7):
        ray = np.array([np.cos(turn), np.sin(turn)])
        edge = distort(limit * ray[None], coefficients, model)[0]
        for radius in (0.2, 0.5, 0.999 * limit):
            wanted = distort(radius * ray[None], coefficients, model)[0]
            np.testing.assert_allclose(distorted(packed, *(radius * ray)), wanted, atol=1e-7)
        np.testing.assert_allclose(distorted(packed, *(1.5 * limit * ray)), edge + 0.5 * limit * ray, atol=1e-7)
    np.testing.assert_allclose(
        distorted(packed, 0.0, 0.0), distort(np.zeros((1, 2)), coefficients, model)[0], atol=1e-12
    )


def test_a_lens_does_not_turn_back_outside_the_image() -> None:
    view, box = camera("brown"), np.empty(4)
    views = pack_views([view])
    last = -np.inf
    for x in (3.0, 6.0, 12.0, 24.0, 48.0):
        expected_box(views.lens[0], x, 1.0, 1.7, 0.5, box)
        assert box[0] > last
        last = box[0]


def test_a_lens_is_continued_by_a_straight_line_from_where_it_folds() -> None:
    """k1 alone folds at the radius 1 / sqrt(-3 k1), here between the corner of the image and 1.2 times as far."""
    folding = replace(camera("brown"), distortion=np.array([-0.22, 0.0, 0.0, 0.0, 0.0]))
    limit = pack_views([folding]).lens[0, 22]
    assert limit == pytest.approx(1.0 / np.sqrt(3 * 0.22), rel=0.01)


def test_a_wide_fisheye_is_continued_by_a_straight_line_from_80_degrees() -> None:
    wide = replace(camera("fisheye"), focal_px=np.full(2, 420.0))
    assert pack_views([wide]).lens[0, 22] == pytest.approx(np.tan(np.radians(80.0)), rel=1e-6)


def test_the_slope_is_the_derivative_of_the_box() -> None:
    views, box, slope = pack_views([camera("brown")]), np.empty(4), np.empty((4, 6))
    state, delay = np.array([0.5, 1.0, 0.7, -0.4, 1.7, 0.5]), 0.2
    box_and_slope(views.lens[0], state, delay, box, slope)
    for k in range(6):
        low, high, other = np.empty(4), np.empty(4), np.empty((4, 6))
        step = np.zeros(6)
        step[k] = 1e-3
        box_and_slope(views.lens[0], state + step, delay, high, other)
        box_and_slope(views.lens[0], state - step, delay, low, other)
        np.testing.assert_allclose(slope[:, k], (high - low) / 2e-3, rtol=1e-3, atol=0.02)


def test_centimetres_give_the_same_box() -> None:
    metres, centimetres = np.empty(4), np.empty(4)
    expected_box(pack_views([camera()]).lens[0], 1.0, 2.0, 1.7, 0.5, metres)
    depth = expected_box(pack_views([camera(metre=100.0)]).lens[0], 100.0, 200.0, 170.0, 50.0, centimetres)
    np.testing.assert_allclose(centimetres, metres, rtol=1e-12)
    assert depth > 100.0


def test_a_body_that_reaches_the_camera_has_no_box() -> None:
    level = Camera(
        "a", np.array([0.0, 0.0, 0.85]), camera_rotation(0.0, 0.0, 0.0), np.full(2, 900.0), np.zeros(2), (1280, 720)
    )
    views, box = pack_views([level]), np.empty(4)
    nearest = 0.25 + MIN_DEPTH_HEIGHTS * 1.7
    assert expected_box(views.lens[0], nearest + 1e-6, 0.0, 1.7, 0.5, box) > 0.0
    assert expected_box(views.lens[0], nearest - 1e-6, 0.0, 1.7, 0.5, box) == -1.0
    assert expected_box(views.lens[0], -3.0, 0.0, 1.7, 0.5, box) == -1.0
    # Within a step of the difference quotients, 1.7e-4 m, it has a box and no slope
    for further, depth in ((1.71e-4, nearest + 1.71e-4), (1.69e-4, -1.0), (-1e-4, -1.0)):
        state = np.array([nearest + further, 0.0, 0.0, 0.0, 1.7, 0.5])
        assert box_and_slope(views.lens[0], state, 0.0, box, np.empty((4, 6))) == pytest.approx(depth)


def test_a_body_as_near_as_the_limit_has_a_box() -> None:
    """Numbers without rounding: a height of 5 m, of which the twentieth part is 0.25 m, and a half width of 0.25 m."""
    camera = Camera("a", np.array([0.0, 0.0, 2.5]), camera_rotation(0.0, 0.0, 0.0), np.ones(2), np.zeros(2), (9, 9))
    lens, box = pack_views([camera]).lens[0], np.empty(4)
    assert expected_box(lens, 0.5, 0.0, 5.0, 0.5, box) == 0.5
    assert expected_box(lens, np.nextafter(0.5, 0.0), 0.0, 5.0, 0.5, box) == -1.0


@pytest.mark.parametrize("lens", ["ideal", "brown"])
def test_a_body_too_far_for_its_outline_has_no_box(lens: str) -> None:
    """Rounding leaves no tangents at some positions from 1e7 m on; no distance divides by zero."""
    packed, box, missing = pack_views([camera(lens)]).lens[0], np.empty(4), 0
    for distance in 10.0 ** np.arange(3.0, 14.0, 0.25):
        for x in distance * np.linspace(-0.5, 0.5, 21):
            depth = expected_box(packed, x, distance, 1.7, 0.5, box)
            assert depth == -1.0 or np.isfinite(box).all()
            missing += depth == -1.0
    assert missing > 0


def test_the_covariance_of_a_centre_in_the_image_is_that_of_the_state_through_the_jacobian() -> None:
    rng, view = np.random.default_rng(0), camera()
    half = rng.normal(0.0, 0.1, (2, 6, 6))
    mean = np.array([[0.3, 1.0, 0.5, -0.2, 1.7, 0.5], [0.0, -7.5, 0.0, 0.0, 1.7, 0.5]])
    P, out = half @ half.swapaxes(1, 2), np.zeros((2, 8))
    project(pack_views([view]), 0, mean, P, 0.3, out)
    box = outline_of(view, mean[0], 0.3)
    centre = np.array([[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]])
    J = np.column_stack([
        centre @ (outline_of(view, mean[0] + s, 0.3) - outline_of(view, mean[0] - s, 0.3)) / 2e-4
        for s in 1e-4 * np.eye(6)
    ])  # fmt: skip
    S = J @ P[0] @ J.T
    np.testing.assert_allclose(out[0, :4], box, rtol=1e-9)
    np.testing.assert_allclose(out[0, 4:7], [S[0, 0], S[0, 1], S[1, 1]], rtol=1e-5)
    middle = view.rotation.T @ (np.array([0.45, 0.94, 0.85]) - view.position)
    assert out[0, 7] == pytest.approx(middle[2])
    assert out[1, 7] == -1.0
    assert not out[1, :7].any()
