from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from occlog.measure.regions.background import Subtractor, foreground, has_colours, make_subtractor

SHAPE = (60, 80)


def scene_image(colour: bool = True) -> np.ndarray:
    rng = np.random.default_rng(3)
    image = cv2.GaussianBlur(rng.integers(0, 255, (*SHAPE, 3), dtype=np.uint8), (0, 0), 5)
    image = cv2.normalize(image, None, 60, 200, cv2.NORM_MINMAX)
    return image if colour else image[:, :, 0].copy()


def video(n: int, walker_from: int, colour: bool = True) -> list[np.ndarray]:
    """A noisy static scene that a bright block enters at a frame, to stay."""
    rng = np.random.default_rng(4)
    frames = []
    for t in range(n):
        image = scene_image(colour).astype(float)
        if t >= walker_from:
            image[20:50, 30:45] = 20.0 if not colour else (20.0, 20.0, 240.0)
        frames.append(np.clip(np.rint(image + rng.normal(0, 3, image.shape)), 0, 255).astype(np.uint8))
    return frames


def run(subtractor: Subtractor, frames: list[np.ndarray], clean_px: int = 3) -> np.ndarray:
    return np.stack([foreground(subtractor, f, k, clean_px) for k, f in enumerate(frames)])


@pytest.mark.parametrize("kind", ["mog2", "knn"])
@pytest.mark.parametrize("colour", [True, False])
def test_a_new_object_is_foreground_from_its_first_frame_and_nothing_else_is(kind: str, colour: bool) -> None:
    shadows = colour  # in a grey image a darker object may be a shadow
    subtractor = make_subtractor(kind, 500, None, shadows, scene_image(colour))
    masks = run(subtractor, video(12, 4, colour))
    assert set(np.unique(masks)) <= {0, 255}
    assert masks[:4].mean() < 0.002 * 255
    inside = masks[4:, 22:48, 32:43]
    assert inside.mean() > 0.95 * 255
    outside = masks[4:].copy()
    outside[:, 19:51, 29:46] = 0
    assert outside.mean() < 0.002 * 255


@pytest.mark.parametrize("kind", ["mog2", "knn"])
def test_started_from_the_empty_scene_who_stands_still_stays_foreground_longer(kind: str) -> None:
    frames = video(40, 10)
    with_start = run(make_subtractor(kind, 500, None, True, scene_image()), frames)
    without = run(make_subtractor(kind, 500, None, True), frames)
    assert with_start[30, 22:48, 32:43].mean() > 0.9 * 255
    # The automatic rate is still high 20 frames after the first.
    assert without[39, 22:48, 32:43].mean() < 0.1 * 255


def test_shadows_are_removed_only_if_asked_for() -> None:
    frames = video(6, 99)
    frames[5][20:50, 30:45] = (0.7 * frames[5][20:50, 30:45]).astype(np.uint8)
    for shadows, want in ((True, 0.0), (False, 255.0)):
        mask = run(make_subtractor("mog2", 500, None, shadows, scene_image()), frames)[5]
        assert abs(mask[22:48, 32:43].mean() - want) < 0.2 * 255


@pytest.mark.parametrize("kind", ["mog2", "knn"])
@pytest.mark.parametrize("channels", [1, 3])
def test_in_grey_images_smooth_darkening_is_shadow_and_rough_darkening_is_not(kind: str, channels: int) -> None:
    """A shadow is 0.7 of the scene; clothes are 0.25 to 0.95 of it from pixel to pixel."""
    frames = video(8, 99, colour=False)
    rng = np.random.default_rng(5)
    frames[6][20:50, 30:45] = np.rint(0.7 * frames[6][20:50, 30:45])
    frames[7][20:50, 30:45] = np.rint(rng.uniform(0.25, 0.95, (30, 15)) * frames[7][20:50, 30:45])
    start = scene_image(colour=False)
    if channels == 3:
        frames, start = [np.repeat(f[..., None], 3, axis=2) for f in frames], np.repeat(start[..., None], 3, axis=2)
    masks = run(make_subtractor(kind, 500, None, True, start), frames, 5)
    assert masks[6, 22:48, 32:43].mean() < 0.05 * 255
    assert masks[7, 22:48, 32:43].mean() > 0.7 * 255
    assert masks[:6].mean() < 0.002 * 255


def test_colours_are_those_of_more_than_a_thousandth_of_the_pixels() -> None:
    image = np.full((100, 100, 3), 90, np.uint8)
    assert not has_colours(image)
    assert not has_colours(image[:, :, 0])
    image[:, :, 2] += 2  # a tint of a codec
    assert not has_colours(image)
    image[40:60, 40:60, 2] = 200
    assert has_colours(image)


def test_the_median_filter_removes_speckle() -> None:
    frames = video(4, 99)
    frames[3][::7, ::7] = 255
    raw = run(make_subtractor("mog2", 500, None, True, scene_image()), frames, 0)[3]
    clean = run(make_subtractor("mog2", 500, None, True, scene_image()), frames, 3)[3]
    assert np.count_nonzero(raw) > 50
    assert np.count_nonzero(clean) == 0


@pytest.mark.parametrize("kind", ["mog2", "knn"])
def test_masks_do_not_depend_on_the_thread_or_on_other_models_at_work(kind: str) -> None:
    frames = video(30, 5)

    def one(seed: int) -> np.ndarray:
        return run(make_subtractor(kind, 50, None, True, None, seed), frames)

    alone = one(7)
    with ThreadPoolExecutor(3) as pool:
        for got in list(pool.map(one, [7, 8, 7, 9, 7]))[::2]:
            np.testing.assert_array_equal(got, alone)


def test_an_unknown_model_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="mog2, knn"):
        make_subtractor("gmm", 500, None, True)
