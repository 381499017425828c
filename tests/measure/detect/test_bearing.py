from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detect_scenes import background, camera, frames, scene, walk

from occlog.core.geometry.camera import rotation_from_angles, wrap_angle
from occlog.measure.detect.bearing import (
    OUTLIER_RATIO,
    POSTURE_SHARE,
    TRUNCATION_PX,
    BearingNoise,
    shape_covariance,
    sights,
)
from occlog.measure.detect.by_background.stage import Learned, detect
from occlog.measure.detect.config import DetectConfig
from occlog.records.scene import Camera
from occlog.records.tables import Bearings


def tilted(pitch_deg: float = -25.0, roll_deg: float = 12.0, distortion: float = 0.0) -> Camera:
    return Camera(
        "t",
        np.array([1.0, 2.0, 3.0]),
        rotation_from_angles(2.9, np.radians(pitch_deg), np.radians(roll_deg)),
        np.array([400.0, 410.0]),
        np.array([320.0, 240.0]),
        (640, 480),
        sigma_read_px=2.0,
        distortion=np.array([distortion, 0.0, 0.0, 0.0, 0.0]),
    )


def flat(n: int) -> np.ndarray:
    return np.zeros((n, 3))


def test_all_points_of_a_vertical_line_have_one_bearing() -> None:
    cam = tilted(distortion=-0.1)
    pixels = cam.project(np.column_stack([np.full(5, -6.0), np.full(5, 3.5), np.linspace(0.0, 2.0, 5)]))
    got = sights(cam, pixels, flat(5), flat(5), flat(5))
    np.testing.assert_allclose(got.bearing, np.arctan2(1.5, -7.0), atol=1e-9)
    np.testing.assert_allclose(got.u_px, cam.u_px(got.bearing))


def test_the_uncertainty_is_that_of_many_disturbed_centres() -> None:
    # 20 000 draws give the standard deviation to 0.5 %; three times that is allowed.
    cam = tilted(distortion=-0.1)
    centre, cov = np.array([[420.0, 300.0]]), np.array([[9.0, 3.0, 60.0]])
    got = sights(cam, centre, cov, flat(1), flat(1))
    rng = np.random.default_rng(0)
    noise = rng.multivariate_normal([0, 0], [[9.0 + 4.0, 3.0], [3.0, 60.0 + 4.0]], 20_000)
    drawn = cam.bearings(centre + noise)
    assert wrap_angle(drawn - got.bearing).std() == pytest.approx(got.sigma[0], rel=0.015)
    assert cam.u_px(drawn).std() == pytest.approx(got.sigma_px[0], rel=0.03)


def test_a_level_camera_has_the_reading_noise_in_u_px() -> None:
    cam = tilted(0.0, 0.0)
    got = sights(cam, np.array([[320.0, 100.0], [500.0, 240.0]]), flat(2), flat(2), flat(2))
    np.testing.assert_allclose(got.sigma_px, 2.0, rtol=1e-5)
    np.testing.assert_allclose(got.u_px, [0.0, 180.0], atol=1e-9)
    np.testing.assert_allclose(got.sigma, 2.0 / 400.0 / (1 + (got.u_px / 400) ** 2), rtol=1e-5)


def test_a_region_wider_than_a_person_is_as_uncertain_as_its_extra_width() -> None:
    cam = tilted(0.0, 0.0)
    person = np.array([[25.0, 0.0, 400.0]])
    centre = np.array([[320.0, 240.0]])
    got = [sights(cam, centre, flat(1), np.array([[w, 0.0, 400.0]]), person).sigma_px[0] for w in (9.0, 25.0, 125.0)]
    np.testing.assert_allclose(got, [2.0, 2.0, np.sqrt(4.0 + 100.0)], rtol=1e-5)


def test_hidden_merged_and_cut_people_are_more_uncertain() -> None:
    person = np.tile([12.0, 1.0, 100.0], (5, 1))
    fill = np.array([1.0, 0.5, 1.5, 4.0, 1.0])
    cut = np.array([False, False, False, False, True])
    got = shape_covariance(person, fill, cut)
    c2 = [
        POSTURE_SHARE**2,
        POSTURE_SHARE**2 + (OUTLIER_RATIO / 2) ** 2,
        POSTURE_SHARE**2 + (OUTLIER_RATIO / 2) ** 2,
        POSTURE_SHARE**2 + OUTLIER_RATIO**2,
        POSTURE_SHARE**2 + TRUNCATION_PX**2,
    ]
    np.testing.assert_allclose(got, np.array(c2)[:, None] * person)


def test_a_camera_without_pose_gives_nan_and_no_regions_give_none() -> None:
    cam = tilted()
    assert all(
        np.isnan(v).all() for v in sights(replace(cam, placed=False), np.ones((2, 2)), flat(2), flat(2), flat(2))
    )
    assert all(v.shape == (0,) for v in sights(cam, np.empty((0, 2)), flat(0), flat(0), flat(0)))


@pytest.mark.jit
def test_errors_of_made_up_people_stay_within_what_is_stated() -> None:
    # Bodies here are symmetric, so what posture would add is missing: errors must be below the stated sigma.
    made_scene = scene(camera("a", 0.0, 0.0, 45.0, sigma_read_px=0.5), camera("b", 8.0, 0.0, 135.0, sigma_read_px=0.5))
    path = walk(30)
    learned = Learned(empty={c.name: background(c.name) for c in made_scene.cameras})
    parts = detect(frames(made_scene, 30, lambda k: [path[k]]), made_scene, DetectConfig(), 1, learned)
    got = Bearings.concat(p.bearings for p in parts)
    errors = []
    for row in range(len(got)):
        x, y, _ = path[int(got.t_ns[row] // 100_000_000)]
        cam = made_scene.camera(str(got.sensor[row]))
        errors.append(
            wrap_angle(got.bearing[row] - np.arctan2(y - cam.position[1], x - cam.position[0])) / got.sigma[row]
        )
    assert got.seen.all()
    assert np.sqrt(np.mean(np.square(errors))) < 0.8
    assert np.abs(np.mean(errors)) < 0.3


def test_a_given_noise_stands_for_posture_and_reading_and_a_scale_for_all() -> None:
    person, cut = np.tile([12.0, 1.0, 100.0], (2, 1)), np.array([False, True])
    given = BearingNoise(sigma_px=4.0)
    np.testing.assert_allclose(
        shape_covariance(person, np.ones(2), cut, given), [np.zeros(3), TRUNCATION_PX**2 * person[1]]
    )
    cam, centre = tilted(0.0, 0.0), np.array([[320.0, 240.0]])
    assert sights(cam, centre, flat(1), flat(1), flat(1), given).sigma_px[0] == pytest.approx(4.0, rel=1e-5)
    half = sights(cam, centre, flat(1), flat(1), flat(1), BearingNoise(scale=0.5))
    assert half.sigma_px[0] == pytest.approx(1.0, rel=1e-5)
    assert half.sigma[0] == pytest.approx(0.5 * sights(cam, centre, flat(1), flat(1), flat(1)).sigma[0])
