"""Small images that would take minutes to decode: each is lost, in one line."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from apart import check_apart

from occlog.errors import ExitCode
from occlog.io.frames.codec import MAX_SCANS, image_damage
from occlog.io.frames.limits import MAX_PIXELS


def progressive(side: int, times: int) -> bytes:
    """A JPEG image whose scans stand there so many times, and which says that it has this many pixels a side."""
    _, image = cv2.imencode(".jpg", np.zeros((64, 64, 3), np.uint8), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    data = image.tobytes()
    size, scans = data.index(b"\xff\xc2") + 5, data.index(b"\xff\xda")
    head = data[:size] + struct.pack(">HH", side, side) + data[size + 4 : scans]
    return head + data[scans:-2] * times + data[-2:]


def test_scans_without_end_are_not_decoded(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    (folder / "0.jpg").write_bytes(progressive(9900, 3000))
    words = ["--images", f"a={folder}", "--fps", "10", "--allow-uncalibrated", "-o", tmp_path / "r.mcap"]
    outcome = check_apart("ingest", *words)
    assert outcome.code == ExitCode.BAD_INPUT
    assert f"scans; a JPEG image of at most {MAX_SCANS} was expected" in outcome.output


def bitmap(side: int) -> bytes:
    """A kilobyte of run lengths that is a BMP image with so many pixels a side, all black."""
    head = struct.pack("<IiiHHIIiiII", 40, side, side, 1, 8, 1, 2, 0, 0, 256, 0)
    return b"BM" + struct.pack("<IHHI", 1080, 0, 0, 1078) + head + bytes(1024) + b"\0\1"


def fax(side: int) -> bytes:
    """The same as a TIFF image."""
    _, image = cv2.imencode(".tif", np.zeros((64, 64), np.uint8))
    data = bytearray(image.tobytes())
    (at,) = struct.unpack_from("<I", data, 4)
    for k in range(struct.unpack_from("<H", data, at)[0]):
        tag, kind = struct.unpack_from("<HH", data, at + 2 + 12 * k)
        if tag in (256, 257):
            struct.pack_into("<I" if kind == 4 else "<H", data, at + 10 + 12 * k, side)
    return bytes(data)


@pytest.mark.parametrize(("name", "data"), [("0.bmp", bitmap(20000)), ("0.tif", fax(20000))])
def test_the_limit_of_pixels_holds_for_every_kind(tmp_path: Path, name: str, data: bytes) -> None:
    """Of those but PNG and JPEG images of a billion pixels were decoded, in 3 GB."""
    folder = tmp_path / "images"
    folder.mkdir()
    (folder / name).write_bytes(data)
    words = ["--images", f"a={folder}", "--fps", "10", "--allow-uncalibrated", "-o", tmp_path / "r.mcap"]
    outcome = check_apart("ingest", *words)
    assert outcome.code == ExitCode.BAD_INPUT
    assert f"has more pixels than the limit, {MAX_PIXELS}" in outcome.output


def test_progressive_images_are_read() -> None:
    assert image_damage(progressive(64, 1)) is None
