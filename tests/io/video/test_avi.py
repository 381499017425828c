"""Limits of the AVI parser, on files made byte by byte."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from video_samples import avi, jpeg

from occlog.errors import InputError
from occlog.io.frames.decode import decode, examine
from occlog.io.frames.streams import video_times
from occlog.io.video.container import MAX_FRAMES, Container
from occlog.io.video.reader import read_container

PICTURE = b"picture!"


def parsed(folder: Path, data: bytes) -> Container:
    path = folder / "v.avi"
    path.write_bytes(data)
    found = read_container(path)
    assert found is not None
    return found


def with_rate(scale: int, rate: int) -> bytes:
    """Three frames at `rate` / `scale` frames per second."""
    data = bytearray(avi([PICTURE] * 3))
    struct.pack_into("<II", data, data.index(b"vids") + 20, scale, rate)
    return bytes(data)


@pytest.mark.parametrize(("scale", "rate"), [(100, 1), (1, 1_000_000)])
def test_frame_rates_from_a_hundredth_to_a_million_are_read(tmp_path: Path, scale: int, rate: int) -> None:
    found = parsed(tmp_path, with_rate(scale, rate))
    assert (found.frames, found.rate, found.problems) == (3, Fraction(rate, scale), ())


@pytest.mark.parametrize(("scale", "rate"), [(101, 1), (1, 1_000_001)])
def test_other_frame_rates_are_a_damaged_header(tmp_path: Path, scale: int, rate: int) -> None:
    found = parsed(tmp_path, with_rate(scale, rate))
    assert found.frames is None
    assert f"a frame rate of {rate}/{scale}" in found.problems[-1][1]


@pytest.mark.parametrize(("scale", "rate"), [(0, 25), (1, 0), (0, 0)])
@pytest.mark.parametrize("period_us", [50_000, 0])
def test_a_file_without_a_frame_rate_needs_one(tmp_path: Path, scale: int, rate: int, period_us: int) -> None:
    """FFmpeg takes the period of the main header, and 25 fps without one."""
    data = bytearray(avi([jpeg(n) for n in range(3)]))
    struct.pack_into("<II", data, data.index(b"vids") + 20, scale, rate)
    struct.pack_into("<I", data, data.index(b"avih") + 8, period_us)
    found, path = parsed(tmp_path, bytes(data)), tmp_path / "v.avi"
    if period_us:
        assert (found.frames, found.rate, found.problems) == (3, Fraction(20), ())
        assert video_times(path).at(np.array([2])).tolist() == [100_000_000]
        assert [p.index for p in decode(examine(path), 0, None, lambda loss: None)] == [0, 1, 2]
        return
    assert found.frames is None
    with pytest.raises(InputError, match=r"states no frame rate, and AVI has no time stamps; give .*fps"):
        video_times(path)
    assert video_times(path, fps=Fraction(10)).at(np.array([2])).tolist() == [200_000_000]


def test_frames_are_announced_up_to_a_limit(tmp_path: Path) -> None:
    at_limit = parsed(tmp_path, avi([PICTURE] * 3, announced=MAX_FRAMES))
    assert (at_limit.frames, at_limit.problems) == (MAX_FRAMES, ())
    assert int(at_limit.broken.sum()) == MAX_FRAMES - 3
    beyond = parsed(tmp_path, avi([PICTURE] * 3, announced=MAX_FRAMES + 1))
    assert beyond.frames == 3
    assert beyond.problems == (("header", f"{MAX_FRAMES + 1} frames announced; that cannot be"),)


def test_a_frame_is_broken_when_its_last_byte_is_missing(tmp_path: Path) -> None:
    data = avi([PICTURE] * 3)
    last = data.rindex(PICTURE) + len(PICTURE)
    assert parsed(tmp_path, data[:last]).broken.tolist() == [False, False, False]
    assert parsed(tmp_path, data[: last - 1]).broken.tolist() == [False, False, True]


def test_a_change_of_the_palette_is_no_frame(tmp_path: Path) -> None:
    """Each was announced as a frame, and reported lost."""
    data = avi([PICTURE] * 2 + [b"palette!"] + [PICTURE], announced=3)
    place = data.index(b"palette!") - 8
    for at in (place, data.rindex(b"idx1") + 8 + 2 * 16):
        data = data[:at] + b"00pc" + data[at + 4 :]
    found = parsed(tmp_path, data)
    assert (found.frames, found.problems) == (3, ())


def test_the_header_and_a_video_stream_are_needed(tmp_path: Path) -> None:
    assert "the header is missing" in parsed(tmp_path, b"RIFF" + struct.pack("<I", 4) + b"AVI ").problems[-1][1]
    silent = avi([PICTURE] * 3).replace(b"vids", b"auds")
    assert "names no video stream" in parsed(tmp_path, silent).problems[-1][1]


def test_twelve_bytes_make_an_avi_file(tmp_path: Path) -> None:
    path = tmp_path / "v.avi"
    path.write_bytes(b"RIFF\4\0\0\0AVI")
    assert read_container(path) is None
    path.write_bytes(b"RIFF\4\0\0\0AVI ")
    assert read_container(path) is not None
