"""Videos and images: frames that are promised and cannot be decoded, and frames at uneven times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.io.files.untrusted.inputs import check_input
from occlog.io.frames.decoders.apart import decode_apart
from occlog.io.frames.decoders.process import DecodingJob, start_decoder
from occlog.io.video.container import Container
from occlog.io.video.reader import read_container

from .findings import Findings

UNEVEN = 0.1
"""Intervals that differ by more than this share from the usual one are uneven: some files round times to ms."""
UNEVEN_SHARE = 0.05
"""From so many uneven intervals on the video is said to be."""
MAX_IMAGE_BYTES = 512 * 1024 * 1024


def look_at_video(path: Path, findings: Findings) -> None:
    """Decode all frames of a video, in a process of its own, and look at their times."""
    try:
        container = read_container(path)
        with start_decoder(
            DecodingJob(kind="video", path=str(path), start=0, stop=None, store="none", quality=95)
        ) as d:
            for _ in d.delivered():
                pass
    except InputError as error:
        findings.refused("unreadable", error)
        return
    for loss in d.losses:
        findings.add("video-frames", loss.place, loss.what, count=max(loss.count, 1))
    if container is not None:
        _look_at_times(container, findings)


def _look_at_times(container: Container, findings: Findings) -> None:
    if container.pts_ns is None or len(container.pts_ns) < 3:
        return
    steps = np.diff(container.pts_ns).astype(np.float64)
    usual = float(np.median(steps))
    if usual <= 0:
        return
    uneven = int((np.abs(steps - usual) > UNEVEN * usual).sum())
    if uneven > UNEVEN_SHARE * len(steps):
        value = f"{uneven} of {len(steps)} intervals; {steps.min() / NS:.4g} to {steps.max() / NS:.4g} s"
        findings.add("uneven-video", "", value, limit=f"{UNEVEN:.0%} from the usual {usual / NS:.4g} s")


def look_at_image(path: Path, findings: Findings) -> None:
    """Decode an image."""
    try:
        size = check_input(path, "an image").stat().st_size
        if size > MAX_IMAGE_BYTES:
            raise InputError(f"{path}: {size} bytes; the limit is {MAX_IMAGE_BYTES}")
        decode_apart(path.read_bytes(), str(path))
    except (InputError, OSError) as error:
        findings.refused("image", error)
