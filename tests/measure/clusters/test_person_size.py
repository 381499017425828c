from __future__ import annotations

import cv2
import numpy as np
import pytest

from occlog.core.geometry.camera import rotation_from_angles
from occlog.measure.clusters.person_size import (
    SizeMap,
    cell_centres,
    constant_sizes,
    grid_cell,
    make_prior,
    sizes_from_camera,
)
from occlog.measure.regions.background import observed_sizes, person_like_blobs
from occlog.measure.regions.regions import ForegroundRegions, downscale, downscale_factor, downscale_sizes, enlarge
from occlog.records.scene import Camera

SIZE = (640, 480)


def camera(z: float, pitch_deg: float, roll_deg: float = 0.0) -> Camera:
    return Camera(
        "c",
        np.array([0.0, 0.0, z]),
        rotation_from_angles(0.3, np.radians(pitch_deg), np.radians(roll_deg)),
        np.array([500.0, 500.0]),
        np.array([319.5, 239.5]),
        SIZE,
    )


def at(sizes: SizeMap, pixel: np.ndarray) -> int:
    return grid_cell(make_prior(sizes, 1, 0, 0.1), *pixel)


@pytest.mark.parametrize("distance", [8.0, 12.0, 18.0])
@pytest.mark.parametrize("roll_deg", [0.0, 20.0])
def test_a_camera_that_looks_down_knows_the_size_at_each_place(distance: float, roll_deg: float) -> None:
    cam = camera(5.0, -20.0, roll_deg)
    spot = np.array([distance * np.cos(0.35), distance * np.sin(0.35)])
    foot, head, middle = cam.project(np.array([[*spot, 0.0], [*spot, 1.7], [*spot, 0.85]]))
    sizes = sizes_from_camera(cam, SIZE, 1.7, 60.0)
    k = at(sizes, middle)
    xx, xy, yy = sizes.cov[k]
    axis = (head - foot) / np.hypot(*(head - foot))
    along = np.sqrt(12 * (axis @ np.array([[xx, xy], [xy, yy]]) @ axis))
    # A grid cell is 1/24 of the image: the size at its centre may differ by a few per cent.
    assert along == pytest.approx(np.hypot(*(head - foot)), rel=0.12)
    # The long axis of the person's pixels is the image of a vertical line.
    _, vectors = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    assert abs(vectors[:, 1] @ axis) > np.cos(np.radians(4.0))
    assert sizes.spread[k] < 0.2


def test_a_camera_of_unknown_height_knows_only_the_range_of_sizes() -> None:
    low = sizes_from_camera(camera(0.0, 0.0), SIZE, 1.7, 20.0)
    known = sizes_from_camera(camera(5.0, -20.0), SIZE, 1.7, 20.0)
    assert np.median(low.spread) > 0.5
    assert np.median(known.spread) < 0.2
    assert np.isfinite(low.cov).all()
    assert (low.mass > 0).all()


def test_a_smaller_room_gives_larger_people_where_the_distance_is_not_known() -> None:
    cam = camera(0.0, 0.0)
    near, far = (sizes_from_camera(cam, SIZE, 1.7, reach) for reach in (6.0, 60.0))
    assert np.all(near.mass > far.mass)
    assert np.median(near.spread) < np.median(far.spread)


def test_every_place_has_a_size_whatever_the_pose() -> None:
    for pitch in (-80.0, -40.0, 0.0, 30.0):
        sizes = sizes_from_camera(camera(3.0, pitch), SIZE, 1.7, 30.0)
        assert np.isfinite(sizes.cov).all()
        assert (sizes.cov[:, 0] * sizes.cov[:, 2] - sizes.cov[:, 1] ** 2 > 0).all()
        assert (sizes.mass > 0).all()


def test_constant_sizes_are_those_of_a_box() -> None:
    sizes = constant_sizes(SIZE, 120.0)
    assert np.allclose(sizes.cov[:, 2], 120**2 / 12)
    assert sizes.width_px == pytest.approx(0.34 * 120)
    assert np.allclose(sizes.mass, 0.6 * 0.34 * 120 * 120)


def test_cell_centres_cover_the_image_evenly() -> None:
    (rows, columns), centres = cell_centres((640, 480))
    assert (rows, columns) == (18, 24)
    np.testing.assert_allclose(centres.mean(axis=0), [319.5, 239.5])
    prior = make_prior(constant_sizes((640, 480), 100), 1, 0, 0.1)
    assert [grid_cell(prior, *c) for c in centres] == list(range(rows * columns))
    assert grid_cell(prior, -50.0, 1e6) == (rows - 1) * columns


def scene_of_walkers(n: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Samples in which people stand alone, 0.2 px taller for every row that their feet are lower."""
    empty = cv2.GaussianBlur(np.random.default_rng(0).integers(80, 180, (480, 640, 3), dtype=np.uint8), (0, 0), 4)
    rng = np.random.default_rng(1)
    samples = []
    for _ in range(n):
        image = empty.copy()
        for x in (100, 300, 500):
            feet = int(rng.integers(200, 460))
            height = int(20 + 0.2 * feet)
            cv2.ellipse(image, (x, feet - height // 2), (height // 6, height // 2), 0, 0, 360, (10, 10, 10), -1)
        samples.append(image)
    return samples, empty


def test_observed_people_give_the_line_of_heights() -> None:
    samples, empty = scene_of_walkers(12)
    blobs = person_like_blobs(samples, empty)
    assert len(blobs) == 36
    sizes = observed_sizes(SIZE, blobs)
    assert sizes is not None
    for feet in (220, 320, 440):
        height = 20 + 0.2 * feet
        k = at(sizes, np.array([300.0, feet - height / 2]))
        assert np.sqrt(12 * sizes.cov[k, 2]) == pytest.approx(height, rel=0.06)
    assert sizes.spread[0] == pytest.approx(0.1, abs=0.03)


def test_few_people_give_their_median_height_everywhere() -> None:
    sizes = observed_sizes(SIZE, np.array([[300.0, 80.0], [400.0, 90.0], [310.0, 100.0]]))
    assert sizes is not None
    np.testing.assert_allclose(np.sqrt(12 * sizes.cov[:, 2]), 90.0)


def test_no_one_seen_gives_no_sizes() -> None:
    samples, empty = scene_of_walkers(2)
    wide = empty.copy()
    wide[200:230, 100:400] = 0  # a car, not a person
    assert len(person_like_blobs([empty, wide], empty)) == 0
    assert observed_sizes(SIZE, np.empty((0, 2))) is None
    assert len(person_like_blobs(samples, empty)) == 6


@pytest.mark.parametrize(("width_px", "factor"), [(10.0, 1), (150.0, 1), (210.0, 2), (450.0, 4), (5000.0, 8)])
def test_images_are_shrunk_as_far_as_people_stay_wide(width_px: float, factor: int) -> None:
    assert downscale_factor(width_px) == factor


def test_shrunk_pixels_are_means_and_results_come_back_to_the_whole_image() -> None:
    image = np.random.default_rng(0).integers(0, 255, (23, 31, 3), dtype=np.uint8)
    small = downscale(image, 3)
    assert small.shape == (7, 10, 3)
    want = image[:21, :30].reshape(7, 3, 10, 3, 3).mean(axis=(1, 3))
    assert np.abs(small - want).max() <= 0.5 + 1e-9
    # One shrunk pixel is a square of 3 x 3 pixels.
    one = ForegroundRegions(
        np.array([[4.0, 2.0]]),
        np.zeros((1, 3)),
        np.array([[3.5, 1.5, 1.0, 1.0]]),
        np.ones(1),
        np.ones(1),
        np.array([[2.0, 0.5, 3.0]]),
        np.zeros((1, 72)),
    )
    got = enlarge(one, 3)
    y, x = np.mgrid[6:9, 12:15]
    np.testing.assert_allclose(got.means, [[x.mean(), y.mean()]])
    np.testing.assert_allclose(got.covs, [[x.var(), 0.0, y.var()]])
    np.testing.assert_allclose(got.boxes, [[11.5, 5.5, 3.0, 3.0]])
    assert got.mass.tolist() == [9.0]
    np.testing.assert_allclose(got.person, [[18.0, 4.5, 27.0]])
    assert enlarge(one, 1) is one


def test_shrunk_size_maps_keep_place_and_shape() -> None:
    sizes = constant_sizes((640, 480), 400.0)
    small = downscale_sizes(sizes, 4)
    assert small.image_size == (160, 120)
    np.testing.assert_allclose(np.sqrt(12 * small.cov[:, 2]), 100.0)
    np.testing.assert_allclose(small.mass * 16, sizes.mass)


def test_a_camera_that_looks_straight_up_shows_no_one_who_stands():
    with pytest.raises(ValueError, match="no person can stand"):
        sizes_from_camera(camera(3.0, 90.0), SIZE, 1.7, 30.0)


def test_cells_behind_a_camera_that_looks_down_take_the_sizes_of_their_neighbours():
    sizes = sizes_from_camera(camera(6.0, -75.0), SIZE, 1.7, 30.0)
    assert np.isfinite(sizes.cov).all()
    assert (sizes.mass > 0).all()
