"""Small images that would take minutes to decode: each is lost, in one line."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
from apart import check_apart

from occlog.errors import ExitCode
from occlog.io.frames.codec import MAX_SCANS, image_damage


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
    told = check_apart("ingest", *words)
    assert told.code == ExitCode.BAD_INPUT
    assert f"scans; a JPEG image of at most {MAX_SCANS} was expected" in told.told


def test_progressive_images_are_read() -> None:
    assert image_damage(progressive(64, 1)) is None
