"""One camera's frames: which images are taken, which frames are lost, and how large people are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from detect_scenes import background, camera, scene

from occlog.errors import InputError, spelled
from occlog.measure.detect.by_background.one_camera import (
    BLOCK,
    UNKNOWN_SIDE_PX,
    CameraState,
    check_background,
    check_size,
    joined,
    known_sizes,
    numbers_of,
    plain_image,
    process,
    segments,
    shrink_of,
)
from occlog.measure.detect.config import MAX_FOREGROUND, DetectConfig
from occlog.records.frames import Frame
from occlog.records.losses import Loss

CAMERA = camera("a", 0.0, 0.0, 45.0)
PLACE = scene(CAMERA)
WIDTH, HEIGHT = CAMERA.image_size or (0, 0)


def frame(number: int, image: np.ndarray) -> Frame:
    return Frame(number * 10**8, "a", number, lambda: image)


def state(**options: object) -> CameraState:
    """A camera that starts from an image of the empty scene."""
    config = DetectConfig(**options)  # type: ignore[arg-type]
    return CameraState(CAMERA, PLACE, config, empty=background("a"))


@pytest.mark.parametrize("shape", [(4, 6), (4, 6, 1), (4, 6, 3), (4, 6, 4)])
def test_grey_and_colour_images_become_grey_or_three_channels(shape: tuple[int, ...]) -> None:
    got = plain_image(np.full(shape, 7, dtype=np.uint8), None)
    assert got.shape == ((4, 6) if shape in ((4, 6), (4, 6, 1)) else (4, 6, 3))
    assert got.dtype == np.uint8
    assert (got == 7).all()


@pytest.mark.parametrize("shape", [(4,), (4, 6, 2), (0, 6), (4, 6, 3, 1)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"neither grey \(H, W\) nor colour"):
        plain_image(np.zeros(shape, dtype=np.uint8), None)


def test_sixteen_bits_want_to_know_how_many_count() -> None:
    """The significant bits are scaled to 8; what is above them is white."""
    image = np.array([[0, 1023, 1024, 65535]], dtype=np.uint16)
    with pytest.raises(InputError, match=r"16-bit image: .*bit-depth"):
        plain_image(image, None)
    assert plain_image(image, 10).tolist() == [[0, 255, 255, 255]]
    assert plain_image(image, 16).tolist() == [[0, 3, 4, 255]]
    with pytest.raises(InputError, match="image of float64"):
        plain_image(image.astype(np.float64), 10)


def test_images_may_be_cut_by_less_than_a_block_and_never_larger_than_the_scene_says() -> None:
    check_size(CAMERA, (WIDTH, HEIGHT))
    check_size(CAMERA, (WIDTH - BLOCK + 1, HEIGHT - BLOCK + 1))
    for size in ((WIDTH - BLOCK, HEIGHT), (WIDTH, HEIGHT - BLOCK), (WIDTH + 1, HEIGHT)):
        with pytest.raises(InputError, match="but the scene states"):
            check_size(CAMERA, size)
    check_size(replace(CAMERA, image_size=None), (WIDTH + 1, HEIGHT))


def test_sizes_come_from_the_option_in_pixels_or_else_from_the_pose() -> None:
    size = (WIDTH, HEIGHT)
    fixed = known_sizes(CAMERA, PLACE, size, DetectConfig(person_height_px=50.0))
    assert fixed is not None
    assert np.ptp(fixed.mass) == 0.0
    assert known_sizes(CAMERA, PLACE, size, DetectConfig()) is not None
    nowhere = replace(CAMERA, placed=False)
    assert known_sizes(nowhere, PLACE, size, DetectConfig()) is None
    units = replace(PLACE, length_unit="unit")
    assert known_sizes(CAMERA, units, size, DetectConfig()) is None
    assert known_sizes(CAMERA, units, size, DetectConfig(person_height=1.7)) is not None


def test_images_of_people_of_unknown_size_are_shrunk_to_a_longest_side() -> None:
    nowhere = replace(CAMERA, placed=False)
    for side, factor in ((UNKNOWN_SIDE_PX, 1), (2 * UNKNOWN_SIDE_PX, 2), (100, 1)):
        assert shrink_of(nowhere, PLACE, (side, 100), DetectConfig()) == factor
    assert shrink_of(nowhere, PLACE, (side, 100), DetectConfig(downscale=3)) == 3


def test_frames_lost_in_a_row_for_one_reason_are_one_loss() -> None:
    lost = [(3, "torn"), (4, "torn"), (5, "small"), (6, "torn"), (8, "torn")]
    got = [(loss.place, loss.what, loss.count) for loss in segments("a", lost)]
    assert got == [
        ("frames 3 to 4", "torn", 2),
        ("frame 5", "small", 1),
        ("frame 6", "torn", 1),
        ("frame 8", "torn", 1),
    ]
    assert segments("a", []) == ()
    assert [numbers_of(loss) for loss in segments("a", lost)] == [(3, 4), (5, 5), (6, 6), (8, 8)]
    assert numbers_of(Loss("a", "after frame 3", "torn")) is None


def changed(share: float) -> np.ndarray:
    """The empty scene with its lower rows, that share of the image, in white."""
    image = background("a").copy()
    image[round((1.0 - share) * HEIGHT) :] = 255
    return image


@pytest.mark.jit
def test_a_frame_with_too_much_foreground_is_lost() -> None:
    below = process(state(shadows=False), [frame(0, changed(MAX_FOREGROUND - 0.05))])
    above = process(state(shadows=False), [frame(0, changed(MAX_FOREGROUND + 0.05))])
    assert [len(b.found) for b in (below, above)] == [1, 0]
    assert below.losses == ()
    assert "foreground covers more than 60% of the image" in above.losses[0].what


@pytest.mark.jit
def test_warmup_counts_frames_only_without_an_image_of_the_empty_scene() -> None:
    frames = [frame(k, background("a")) for k in range(4)]
    taught = process(CameraState(CAMERA, PLACE, DetectConfig(warmup=3)), frames)
    assert (taught.warmup, len(taught.found)) == (3, 1)
    started = process(state(warmup=3), frames)
    assert (started.warmup, len(started.found)) == (0, 4)


@pytest.mark.jit
def test_an_image_of_another_size_than_the_first_is_lost() -> None:
    got = process(state(), [frame(0, background("a")), frame(1, background("a")[:-2])])
    assert len(got.found) == 1
    assert (
        f"image is {WIDTH} x {HEIGHT - 2} px in colour, the camera's first was {WIDTH} x {HEIGHT}" in got.losses[0].what
    )


@pytest.mark.parametrize(
    ("kind", "size", "factor", "wanted"), [("mog2", (9990, 9990), 1, 2), ("knn", (10003, 5112), 1, 2)]
)
def test_backgrounds_of_images_beyond_the_limit_are_refused(
    kind: str, size: tuple[int, int], factor: int, wanted: int
) -> None:
    """KNN ended the process with a segmentation fault, MOG2 with an error of OpenCV after 3 GB."""
    with pytest.raises(InputError) as raised:
        check_background(CAMERA, kind, size, factor)
    assert raised.value.id == "input-too-large"
    assert spelled(str(raised.value)).endswith(f"--downscale {wanted} or more")
    check_background(CAMERA, kind, size, wanted)


def test_frames_that_are_lost_in_batches_that_go_on_are_one_loss() -> None:
    parts = [*segments("a", [(n, "light") for n in range(8)]), *segments("b", [(5, "light")])]
    parts += [*segments("a", [(8, "light"), (9, "light"), (10, "size")]), Loss("a", "header", "damaged")]
    parts += [*segments("a", [(12, "light")]), *segments("a", [(13, "light")])]
    got = [(loss.source, loss.place, loss.what, loss.count) for loss in joined(parts)]
    assert got == [
        ("a", "frames 0 to 9", "light", 10),
        ("b", "frame 5", "light", 1),
        ("a", "frame 10", "size", 1),
        ("a", "header", "damaged", 0),
        ("a", "frames 12 to 13", "light", 2),
    ]
