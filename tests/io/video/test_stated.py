"""What a video states of its pictures: turned, mirrored, of oblong pixels, of few bits, interlaced."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_samples import HEIGHT, WIDTH, numbered, write_video

from occlog.errors import InputError
from occlog.io.frames.codec import Contents
from occlog.io.frames.decode import _Raw, _start_s
from occlog.io.frames.decoders.process import Decoder, start_decoder
from occlog.io.video.reader import read_container

ONE = 1 << 16
MATRICES = {0: (ONE, 0, 0, ONE), 90: (0, ONE, -ONE, 0), 180: (-ONE, 0, 0, -ONE), 270: (0, -ONE, ONE, 0)}
"""a, b, c, d of the display matrix by degrees clockwise."""


def decoded(path: Path) -> tuple[Decoder, list[np.ndarray]]:
    job = {"kind": "video", "path": str(path), "start": 0, "stop": None, "store": "raw", "quality": 95}
    with start_decoder(job) as running:
        return running, [frame.image.copy() for frame in running.delivered()]


def with_matrix(path: Path, a: int, b: int, c: int, d: int) -> Path:
    """A video with this display matrix."""
    data = bytearray(write_video(path, frames=3).read_bytes())
    at = data.find(b"tkhd") + 4 + 40
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(bytes(data))
    return path


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_rotation_by_the_display_matrix_is_applied_and_stated(tmp_path: Path, degrees: int) -> None:
    upright = decoded(with_matrix(tmp_path / "mp4v.mp4", *MATRICES[0]))
    assert upright[0].facts == []
    turned = decoded(with_matrix(tmp_path / "mp4v.mp4", *MATRICES[degrees]))
    assert turned[0].facts == [("pictures-turned", {"how": f"rotated by {degrees} deg"})]
    assert turned[0].size == ((HEIGHT, WIDTH) if degrees % 180 else (WIDTH, HEIGHT))
    assert np.array_equal(turned[1][0], np.rot90(upright[1][0], -degrees // 90))


@pytest.mark.parametrize(
    ("matrix", "how", "shown"),
    [
        ((-ONE, 0, 0, ONE), "left to right", lambda image: image[:, ::-1]),
        ((ONE, 0, 0, -ONE), "top to bottom", lambda image: image[::-1]),
        ((0, ONE, ONE, 0), "along the diagonal from top left", lambda image: image.swapaxes(0, 1)),
        ((0, -ONE, -ONE, 0), "along the diagonal from top right", lambda image: image[::-1, ::-1].swapaxes(0, 1)),
    ],
)
def test_a_mirror_in_the_display_matrix_is_applied_and_stated(
    tmp_path: Path, matrix: tuple[int, int, int, int], how: str, shown: Callable[[np.ndarray], np.ndarray]
) -> None:
    _, coded = decoded(with_matrix(tmp_path / "mp4v.mp4", *MATRICES[0]))
    running, images = decoded(with_matrix(tmp_path / "mp4v.mp4", *matrix))
    assert running.facts == [("pictures-turned", {"how": f"mirrored {how}"})]
    assert running.size == (images[0].shape[1], images[0].shape[0])
    assert all(np.array_equal(a, shown(b)) for a, b in zip(images, coded, strict=True))


def test_a_mirror_at_another_angle_is_stated_and_not_applied(tmp_path: Path) -> None:
    _, coded = decoded(with_matrix(tmp_path / "mp4v.mp4", *MATRICES[0]))
    running, images = decoded(with_matrix(tmp_path / "mp4v.mp4", -ONE, ONE, ONE, ONE))
    assert running.facts == [("pictures-not-turned", {"how": "mirrored at another angle"})]
    assert all(np.array_equal(a, b) for a, b in zip(images, coded, strict=True))


@pytest.mark.parametrize(
    ("matrix", "facts"),
    [
        ((2 * ONE, 0, 0, 2 * ONE), [("pictures-not-turned", {"how": "scaled by 2"})]),
        ((ONE, ONE // 2, 0, ONE), [("pictures-not-turned", {"how": "sheared"})]),
        ((0, 0, 0, 0), []),
        ((2 * ONE, 0, 0, ONE), [("pixels-not-square", {"across": 2.0, "down": 1.0})]),
        (
            (0, 2 * ONE, -ONE, 0),
            [("pictures-turned", {"how": "rotated by 90 deg"}), ("pixels-not-square", {"across": 1.0, "down": 2.0})],
        ),
        (
            (0, 2 * ONE, ONE, 0),
            [
                ("pictures-turned", {"how": "mirrored along the diagonal from top left"}),
                ("pixels-not-square", {"across": 1.0, "down": 2.0}),
            ],
        ),
    ],
)
@pytest.mark.parametrize("pasp", [False, True])
def test_a_display_matrix_that_scales_or_shears_is_stated(
    tmp_path: Path, matrix: tuple[int, int, int, int], facts: list[tuple[str, object]], *, pasp: bool
) -> None:
    """FFmpeg takes no scale from the matrix of a file that states square pixels (box pasp), as most do."""
    path = with_matrix(tmp_path / "mp4v.mp4", *matrix)
    if pasp:
        path.write_bytes(with_square_pixels(path.read_bytes()))
    running, _ = decoded(path)
    assert running.facts == facts


def with_square_pixels(data: bytes) -> bytes:
    """The content of an MP4 file with the index at its end, with a box pasp of 1:1 after the description of samples."""
    box = struct.pack(">I4sII", 16, b"pasp", 1, 1)
    end = data.find(b"stts") - 4
    out = bytearray(data[:end] + box + data[end:])
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"mp4v"):
        at = out.find(name, out.find(b"moov") - 4) - 4
        (size,) = struct.unpack_from(">I", out, at)
        struct.pack_into(">I", out, at, size + len(box))
    return bytes(out)


@pytest.mark.parametrize(("across", "down"), [(5, 4), (2, 1)])
def test_oblong_pixels_are_stated(tmp_path: Path, across: int, down: int) -> None:
    """A track header with another shape than the coded pictures."""
    path = with_matrix(tmp_path / "mp4v.mp4", *MATRICES[0])
    data = bytearray(path.read_bytes())
    at = data.find(b"tkhd") + 4 + 76
    data[at : at + 4] = struct.pack(">I", WIDTH * across // down << 16)
    path.write_bytes(bytes(data))
    running, images = decoded(path)
    assert running.facts == [("pixels-not-square", {"across": across, "down": down})]
    assert images[0].shape == (HEIGHT, WIDTH, 3)


def write_grey(path: Path, most: int, frames: int = 4) -> Path:
    """A video of 16 bits with values from 0 to `most`."""
    depth = [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U, cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"FFV1"), 10.0, (WIDTH, HEIGHT), depth)
    for index in range(frames):
        grey = cv2.cvtColor(numbered(index), cv2.COLOR_BGR2GRAY).astype(np.float64)
        writer.write(np.round(grey * most / grey.max()).astype(np.uint16))
    writer.release()
    return path


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_a_video_that_uses_few_of_16_bits_is_refused_as_images_are(tmp_path: Path, bits: int) -> None:
    with pytest.raises(InputError, match="values of 16 bits up to 4095 of 65535, which as 8 bits would be nearly"):
        decoded(write_grey(tmp_path / "g.mkv", 2**bits - 1))


def test_a_video_that_uses_14_of_16_bits_is_stated_to_be_dark(tmp_path: Path) -> None:
    running, _ = decoded(write_grey(tmp_path / "g.mkv", 2**14 - 1))
    ((id, values),) = running.facts
    assert id == "values-dim"
    assert values["most"] == pytest.approx(2**14, rel=0.02)


def test_a_video_of_all_16_bits_is_taken(tmp_path: Path) -> None:
    running, images = decoded(write_grey(tmp_path / "g.mkv", 2**16 - 1))
    assert running.facts == []
    assert max(int(image.max()) for image in images) >= 254


def test_the_stamp_of_the_first_frame_is_stated(tmp_path: Path) -> None:
    """FFmpeg begins MPEG-TS at a delay of 1.4 s; other containers begin at 0."""
    assert decoded(write_video(tmp_path / "a.ts", 5, "MPG2"))[0].start_s == pytest.approx(1.44, abs=0.06)
    assert decoded(write_video(tmp_path / "mp4v.mp4", 5))[0].start_s == pytest.approx(0.0, abs=0.02)


def test_the_first_frame_of_a_stream_without_stamps_has_no_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV gives -2^63 for it, as FFmpeg does for Theora in Ogg, which became a start 3e10 years ago."""
    monkeypatch.setattr(cv2, "CAP_PROP_PTS", 1, raising=False)

    class Capture:
        def get(self, key: int) -> float:
            return -(2.0**63) if key == 1 else 10.0

    first = _Raw(0, 0.0, "", lambda _: (None, ""))
    assert np.isnan(_start_s(Capture(), first))  # type: ignore[arg-type]


def test_frames_of_a_flash_video_that_begins_late_are_not_lost(tmp_path: Path) -> None:
    """Its duration counts from 0, as with B-frames; a video cut at the end is noticed."""
    data = bytearray(write_video(tmp_path / "a.flv", 40, "FLV1").read_bytes())
    at, ends = 13, []
    while at < len(data):
        kind, size = data[at], int.from_bytes(data[at + 1 : at + 4], "big")
        if kind == 9:
            stamp = int.from_bytes(data[at + 4 : at + 7], "big") + 500
            data[at + 4 : at + 7] = stamp.to_bytes(3, "big")
            ends.append(at + 15 + size)
        at += 15 + size
    duration = data.index(b"duration") + 9
    struct.pack_into(">d", data, duration, struct.unpack_from(">d", data, duration)[0] + 0.5)
    for stop, lost in ((len(data), 0), (ends[29], 10)):
        (tmp_path / "b.flv").write_bytes(bytes(data[:stop]))
        running, images = decoded(tmp_path / "b.flv")
        assert (len(images), sum(loss.count or 0 for loss in running.losses)) == (40 - lost, lost)


@pytest.mark.parametrize("name", ["inter.mp4", "m2inter.mkv"])
def test_interlaced_video_gives_pictures_or_a_refusal_with_the_remedy(shared_cases: Path, name: str) -> None:
    """OpenCV returns a buffer that nothing filled where FFmpeg does not convert an interlaced frame."""
    path = shared_cases / "v10-interlaced" / name
    try:
        _, images = decoded(path)
    except InputError as error:
        assert "interlaced" in str(error)
        assert f"ffmpeg -i {path} -vf bwdif=send_frame" in str(error)
        return
    assert len(images) == 100
    assert np.mean([image.mean() for image in images]) == pytest.approx(88, abs=3)


def test_a_16_bit_video_of_12_bits_is_refused(shared_cases: Path) -> None:
    with pytest.raises(InputError, match="values of 16 bits"):
        decoded(shared_cases / "v11-12-bit-video" / "g12_10.mkv")


def test_a_turned_video_says_so(shared_cases: Path) -> None:
    running, _ = decoded(shared_cases / "v23-turned-by-metadata" / "rot180.mp4")
    assert running.facts == [("pictures-turned", {"how": "rotated by 180 deg"})]


@pytest.mark.parametrize(
    ("level", "count", "fact"),
    [
        (0, 3, ("pictures-black", {"count": 3, "most": 0})),
        (100, 12, ("pictures-identical", {"count": 12})),
        (100, 3, None),
    ],
)
def test_black_and_identical_pictures_are_stated(
    tmp_path: Path, level: int, count: int, fact: tuple[str, object] | None
) -> None:
    """Images of 16 bits that are all 0 are no images of 12 bits, and were taken without a word; as videos were."""
    folder = tmp_path / "images"
    folder.mkdir()
    for index in range(count):
        cv2.imwrite(str(folder / f"{index}.png"), np.full((HEIGHT, WIDTH), level * 257, np.uint16))
    writer = cv2.VideoWriter(
        str(tmp_path / "v.mkv"), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"FFV1"), 10.0, (WIDTH, HEIGHT)
    )
    for _ in range(count):
        writer.write(np.full((HEIGHT, WIDTH, 3), level, np.uint8))
    writer.release()
    files = [(index, str(folder / f"{index}.png")) for index in range(count)]
    jobs = [
        {"kind": "images", "path": str(folder), "files": files, "store": "keep", "quality": 95},
        {"kind": "video", "path": str(tmp_path / "v.mkv"), "start": 0, "stop": None, "store": "none", "quality": 95},
    ]
    for job in jobs:
        with start_decoder(job) as running:
            assert len([*running.delivered()]) == count
        assert running.facts == ([] if fact is None else [fact])


@pytest.mark.parametrize(
    ("levels", "facts"),
    [
        ([90, 91, *[3] * 4, 92, 2, 93, *[0, 20]], [(2, 5), (9, 10)]),
        ([*[3] * 3, 90, 30], [(0, 2)]),
        ([90, 25, 26, 91], []),
        ([4] * 3, None),
    ],
)
def test_rows_of_black_images_are_stated(levels: list[int], facts: list[tuple[int, int]] | None) -> None:
    contents = Contents()
    for n, level in enumerate(levels):
        contents.add(np.full((16, 16, 3), level, np.uint8), n)
    if facts is None:
        assert contents.facts()[0][0] == "pictures-black"
    else:
        assert contents.facts() == [("pictures-black-run", {"first": a, "last": b}) for a, b in facts]


def test_black_images_are_one_lit_pixel_from_being_others() -> None:
    contents = Contents()
    image = np.zeros((32, 32), np.uint8)
    image[5, 3] = 200
    for n in range(3):
        contents.add(image if n else image + 50, n)
    assert contents.facts() == []


def inserted(data: bytes, box: bytes) -> bytes:
    """The content of an MP4 file with the index at its end, with a box after the description of samples."""
    return with_square_pixels(data).replace(struct.pack(">I4sII", 16, b"pasp", 1, 1), box.ljust(16, b"\0"))


@pytest.mark.parametrize(
    ("box", "how"),
    [
        (struct.pack(">I4sIB", 13, b"st3d", 0, 2) + struct.pack(">I", 8)[:3], "split into two views"),
        (struct.pack(">I4sI", 16, b"sv3d", 0), "unrolled from a sphere"),
        (struct.pack(">I4sI", 16, b"free", 0), ""),
    ],
)
def test_stereo_and_spherical_video_are_stated(tmp_path: Path, box: bytes, how: str) -> None:
    path = write_video(tmp_path / "mp4v.mp4", frames=3)
    path.write_bytes(inserted(path.read_bytes(), box))
    container = read_container(path)
    assert container is not None
    assert container.undone == how


def test_a_second_video_track_is_stated(tmp_path: Path) -> None:
    data = bytearray(write_video(tmp_path / "mp4v.mp4", frames=3).read_bytes())
    moov = data.find(b"moov") - 4
    trak = data.find(b"trak") - 4
    (size,) = struct.unpack_from(">I", data, trak)
    copy = data[trak : trak + size]
    struct.pack_into(">I", copy, copy.find(b"tkhd") + 16, 2)  # its number
    struct.pack_into(">I", data, moov, struct.unpack_from(">I", data, moov)[0] + size)
    (tmp_path / "two.mp4").write_bytes(bytes(data[: trak + size] + copy + data[trak + size :]))
    running, images = decoded(tmp_path / "two.mp4")
    assert running.facts == [("video-tracks", {"count": 2})]
    assert len(images) == 3


def test_a_file_of_sound_is_refused_as_such(tmp_path: Path) -> None:
    data = write_video(tmp_path / "mp4v.mp4", frames=3).read_bytes().replace(b"vide", b"soun")
    (tmp_path / "sound.mp4").write_bytes(data)
    with pytest.raises(InputError, match="no video track, as a file of sound"):
        decoded(tmp_path / "sound.mp4")
