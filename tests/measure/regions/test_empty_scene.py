from __future__ import annotations

import cv2
import numpy as np
import pytest

from occlog.measure.regions.background import empty_scene, motion_masks


def scene_image() -> np.ndarray:
    image = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (60, 100, 3), dtype=np.uint8), (0, 0), 3)
    return cv2.normalize(image, None, 40, 220, cv2.NORM_MINMAX)


def walk(places: list[int]) -> list[np.ndarray]:
    """A textured body 20 px wide at columns, in front of the scene."""
    cloth = np.random.default_rng(1).integers(0, 90, (40, 20, 3), dtype=np.uint8)
    frames = []
    for x in places:
        image = scene_image()
        image[10:50, x : x + 20] = cloth
        frames.append(image)
    return frames


def test_without_motion_it_is_the_lower_median() -> None:
    rng = np.random.default_rng(2)
    samples = [np.clip(100 + rng.integers(-3, 4, (20, 30, 3)), 0, 255).astype(np.uint8) for _ in range(8)]
    want = np.sort(np.stack(samples), axis=0)[3]
    np.testing.assert_array_equal(empty_scene(samples, 5.0), want)


def test_a_body_that_moves_on_the_spot_most_of_the_time_is_not_in_it() -> None:
    # 14 of 18 samples show the body near one place, always moving; a plain median shows it.
    places = [40, 44, 38, 43, 39, 44, 40, 45, 41, 37, 42, 38, 44, 40, 70, 74, 70, 75]
    samples = walk(places)
    plain = np.median(np.stack(samples), axis=0)
    got = empty_scene(samples, 10.0)
    wrong = [np.count_nonzero(np.abs(image - scene_image().astype(float)).max(axis=2) > 10) for image in (plain, got)]
    assert wrong[0] > 500
    assert wrong[1] < 5  # single pixels of the cloth may are alike in neighbouring samples


def test_a_body_that_never_moves_is_part_of_the_scene() -> None:
    samples = walk([40] * 8)
    np.testing.assert_array_equal(empty_scene(samples, 10.0), samples[0])


def test_what_always_moves_gets_the_median_of_all() -> None:
    samples = [np.full((10, 10, 3), v, dtype=np.uint8) for v in (10, 90, 20, 95, 30)]
    np.testing.assert_array_equal(empty_scene(samples, 4.0), np.full((10, 10, 3), 30))


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_samples_to_tell_motion_give_the_first(count: int) -> None:
    samples = walk([10, 60])[:count]
    np.testing.assert_array_equal(empty_scene(samples, 10.0), samples[0])


def test_grey_samples_give_a_grey_scene() -> None:
    samples = [np.full((8, 9), v, dtype=np.uint8) for v in (4, 5, 6)]
    assert empty_scene(samples, 3.0).tolist() == np.full((8, 9), 5).tolist()


def test_motion_masks_fill_a_body_between_its_edges() -> None:
    image = np.full((60, 100, 3), 128, dtype=np.uint8)
    samples = np.stack([image] * 3)
    for n, x in enumerate((40, 43, 46)):
        samples[n, 10:50, x : x + 12] = 20  # plain cloth: only edges change
    masks = motion_masks(samples, 14.0)
    assert masks[1, 15:45, 44:54].all()
    assert not masks[1, :, :25].any()
