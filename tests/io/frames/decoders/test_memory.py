"""Images come through memory that two processes share: slots are lent, and nothing changes under whoever holds one."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_samples import numbered

from occlog.errors import InputError
from occlog.io.frames.codec import decode_image
from occlog.io.frames.decoders import memory
from occlog.io.frames.decoders.memory import LARGEST, MAX_SLOTS, MIN_SLOTS, SMALLEST, SharedImages, Slots, slot_size
from occlog.io.frames.decoders.process import DecodingJob, start_decoder
from occlog.io.frames.decoders.subprocess_video import SubprocessVideo, decode_apart, end_idle

pytestmark = pytest.mark.skipif(not memory.SHARED, reason="memory without a name is shared on Linux only")
SIZE = (640, 480)
BYTES = 3 * SIZE[0] * SIZE[1]


def two_sides(size: int) -> tuple[SharedImages, Slots]:
    """Both sides in one process; the decoder waits for what the other side frees."""
    asks = SharedImages()
    asks.cut(size)
    return asks, Slots(asks.file, size, asks.freed)


def test_only_images_between_the_two_sizes_take_slots() -> None:
    assert slot_size(SMALLEST // 4, 1) == 0
    assert slot_size(SMALLEST // 3 + 1, 1) == 3 * (SMALLEST // 3 + 1)
    assert slot_size(LARGEST // 3, 1) == 3 * (LARGEST // 3)
    assert slot_size(LARGEST // 3 + 1, 1) == 0
    assert slot_size(0, 0) == 0


@pytest.mark.parametrize(("size", "count"), [(SMALLEST, MAX_SLOTS), (memory.AHEAD // 5, 5), (LARGEST, MIN_SLOTS)])
def test_small_images_have_more_slots(size: int, count: int) -> None:
    asks, _ = two_sides(size)
    with closing(asks):
        assert os.fstat(asks.file).st_size == count * size


def test_the_size_of_the_memory_cannot_be_changed_by_the_other_process() -> None:
    asks, _ = two_sides(SMALLEST)
    with closing(asks):
        for size in (0, 100 * SMALLEST):
            with pytest.raises(PermissionError):
                os.ftruncate(asks.file, size)


def test_whoever_holds_images_keeps_them_however_many_follow() -> None:
    asks, decoder = two_sides(SMALLEST)
    held = []
    with closing(asks):
        for k in range(50):
            decoder.free(asks.freed())
            slot = decoder.deliver(np.full((300, 200), k, np.uint8))
            assert slot is not None
            held.append(asks.image(slot, (300, 200)))
    for k, image in enumerate(held):
        assert (image == k).all()


def test_slots_whose_images_no_one_holds_are_used_again_without_copies() -> None:
    asks, decoder = two_sides(SMALLEST)
    with closing(asks):
        places = set()
        for k in range(50):
            decoder.free(asks.freed())
            slot = decoder.deliver(np.full((300, 200), k, np.uint8))
            assert slot is not None
            image = asks.image(slot, (300, 200))
            assert not image.flags.owndata
            places.add(image.ctypes.data)
            part = image[10:20, 5]  # which holds it, too
            del image
            assert (part == k).all()
        assert len(places) <= MAX_SLOTS


def test_what_was_decoded_into_a_slot_is_not_copied_again() -> None:
    asks, decoder = two_sides(SMALLEST)
    with closing(asks):
        target = decoder.target((300, 200))
        assert target is not None
        target[:] = 7
        slot = decoder.deliver(target)
        assert slot is not None
        assert (asks.image(slot, (300, 200)) == 7).all()
        assert decoder.target((SMALLEST + 1, 1)) is None
        assert decoder.deliver(np.zeros((SMALLEST + 1, 1), np.uint8)) is None


def test_a_decoder_that_no_one_listens_to_ends() -> None:
    asks, decoder = two_sides(SMALLEST)
    with closing(asks), pytest.raises(BrokenPipeError):
        for _ in range(MAX_SLOTS + 1):
            decoder.deliver(np.zeros((300, 200), np.uint8))


def test_slots_that_a_decoder_makes_up_are_refused() -> None:
    asks, decoder = two_sides(SMALLEST)
    with closing(asks):
        slot = decoder.deliver(np.zeros((300, 200), np.uint8))
        assert slot is not None
        image = asks.image(slot, (300, 200))
        for number, shape in (
            (slot, (300, 200)),
            (MAX_SLOTS, (1,)),
            (-1, (1,)),
            (1, (SMALLEST + 1,)),
            (1, (0,)),
            (1, (-1,)),
        ):
            with pytest.raises(InputError, match="the decoder returned an image larger than its frames"):
                asks.image(number, shape)
        assert image.shape == (300, 200)


def frames_of(path: Path, count: int) -> list[np.ndarray]:
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    return [video.read()[1] for _ in range(count)]


def write_large(path: Path, count: int) -> Path:
    video = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 10.0, SIZE)
    for k in range(count):
        video.write(cv2.resize(numbered(k), SIZE))
    video.release()
    return path


@pytest.mark.parametrize("held", [True, False])
def test_frames_of_a_video_are_those_decoded_here(tmp_path: Path, held: bool) -> None:
    path = write_large(tmp_path / "v.avi", 30)
    with closing(SubprocessVideo(path)) as video:
        kept = []
        for k, expected in enumerate(frames_of(path, 30)):
            image = video.read(k)
            assert image is not None
            np.testing.assert_array_equal(image, expected)
            image[0] = 255  # may be drawn upon
            if held:
                kept.append((image, expected))
    for image, expected in kept:
        np.testing.assert_array_equal(image[1:], expected[1:])


def test_images_of_several_sizes_are_those_decoded_here() -> None:
    end_idle()
    for k, width in enumerate((640, 100, 800, 640, 2000)):
        image = cv2.resize(numbered(k), (width, width))
        for shown in (image, image[:, :, 0].copy()):
            data = cv2.imencode(".png", shown)[1].tobytes()
            np.testing.assert_array_equal(decode_apart(data, "x"), decode_image(data, "x"))
    end_idle()


def test_an_image_larger_than_its_slots_comes_through_the_pipe() -> None:
    job = DecodingJob(kind="messages", path="x", store="raw", quality=0, slot=slot_size(*SIZE))
    with closing(start_decoder(job)) as decoder:
        for width in (640, 900):
            image = cv2.resize(numbered(width // 100), (width, 480))
            data = cv2.imencode(".png", image)[1].tobytes()
            np.testing.assert_array_equal(decoder.image_of(data, "x"), image)
