"""Images of recordings and frames of linked videos are decoded in other processes, with limits."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from video_samples import number_shown, numbered, write_video

from occlog.errors import InputError
from occlog.io.frames import limits
from occlog.io.frames.codec import decode_image
from occlog.io.frames.decoders import subprocess_video as apart

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux has them")


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def test_images_are_those_decoded_here_and_may_be_drawn_upon() -> None:
    for image in (numbered(3), numbered(4)[:, :, 0].copy()):
        for kind in (".png", ".jpg"):
            data = cv2.imencode(kind, image)[1].tobytes()
            found = apart.decode_apart(data, "x")
            np.testing.assert_array_equal(found, decode_image(data, "x"))
            found[0] = 0


def test_one_process_serves_many_images_and_goes_on_after_a_bad_one() -> None:
    apart.decode_apart(png(numbered(1)), "x")
    (before,) = (d.process.pid for d in apart._idle)
    with pytest.raises(InputError, match=r"^r: camera a: frame 2: not an image"):
        apart.decode_apart(b"no image", "r: camera a: frame 2")
    assert number_shown(apart.decode_apart(png(numbered(5)), "x")) == 5
    assert [d.process.pid for d in apart._idle] == [before]


def test_damage_that_only_libjpeg_sees_is_reported() -> None:
    data = bytearray(cv2.imencode(".jpg", np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8))[1])
    data[len(data) // 2 : len(data) // 2 + 40] = b"\xff\xd0" * 20
    with pytest.raises(InputError, match=r"^x: the decoder met damage \("):
        apart.decode_apart(bytes(data), "x")


@LINUX
def test_a_crash_costs_one_image(monkeypatch: pytest.MonkeyPatch) -> None:
    apart.end_idle()
    apart.decode_apart(png(numbered(1)), "x")
    (decoder,) = apart._idle
    write = decoder._write

    def crash(*parts: bytes) -> None:
        os.kill(decoder.process.pid, signal.SIGSEGV)
        decoder.process.wait()
        write(*parts)

    monkeypatch.setattr(decoder, "_write", crash)
    with pytest.raises(InputError, match=r"^x: the decoder crashed \(SIGSEGV\)$"):
        apart.decode_apart(png(numbered(2)), "x")
    assert number_shown(apart.decode_apart(png(numbered(3)), "x")) == 3


@LINUX
def test_the_process_has_its_limits() -> None:
    apart.decode_apart(png(numbered(1)), "x")
    text = Path(f"/proc/{apart._idle[0].process.pid}/limits").read_text()
    soft = {line[:25].strip(): line[25:].split()[0] for line in text.splitlines()[1:]}
    assert soft["Max open files"] == str(limits.FILES)
    assert soft["Max file size"] == str(limits.WRITTEN)
    assert limits.MEMORY <= int(soft["Max address space"]) < limits.MEMORY * 1.1
    assert limits.SECONDS <= int(soft["Max cpu time"]) <= limits.SECONDS + 10


def test_a_video_begins_at_any_frame_and_again_after_it_was_closed(tmp_path: Path) -> None:
    video = apart.SubprocessVideo(write_video(tmp_path / "ffv1.mkv"))
    try:
        shown = [video.read(k) for k in (3, 4, 9)]
        assert [number_shown(image) for image in shown if image is not None] == [3, 4, 9]
        assert video.read(5) is None  # forwards only
        video.close()
        again = video.read(2)
        assert again is not None
        assert number_shown(again) == 2
    finally:
        video.close()
