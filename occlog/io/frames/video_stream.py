"""Recorded video of one camera: when its frames were taken.

The time of a frame comes from a sidecar file if there is one, else from the container's
time stamps, else from the frame rate.  Which one was used is written into the recording.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.io.files.times.frame_times import FrameTimes, as_rate, frames_to_ns
from occlog.io.video.container import Container
from occlog.io.video.reader import read_container

STAMPS = "container time stamps"


def sidecar_times(table_ns: Ints, name: str, start_ns: int = 0) -> FrameTimes:
    """Times of frames from a sidecar file (see `occlog.io.files.times.timestamps`)."""
    return FrameTimes(f"sidecar {name}", start_ns, table_ns)


def rate_times(rate: Fraction, origin: str, start_ns: int = 0, steps: Ints | None = None) -> FrameTimes:
    """Times of frames from a frame rate.

    Args:
        rate: frames per second.
        origin: who gave it.
        start_ns: time of the first frame.
        steps: (n,) how many intervals after the start each frame was taken; None: frame k after k of them.
    """
    source = f"frame rate {float(rate):.10g} fps ({origin})"
    if steps is None:
        return FrameTimes(source, start_ns, None, rate)
    return FrameTimes(f"{source}, with the intervals of dropped frames", start_ns, frames_to_ns(steps, rate))


def video_times(
    path: Path, stated_hz: float | None = None, *, fps: Fraction | None = None, start_ns: int = 0
) -> FrameTimes:
    """Times of the frames of a video that has no sidecar.

    Args:
        path: the video file.
        stated_hz: frame rate that the decoder found, for containers that only it can read.
        fps: frame rate given by the user, which is then taken instead of the container's stamps.
        start_ns: time of the first frame.

    Returns:
        Times whose `table_ns` and `rate` are both None where only the decoder knows the
        time stamps: containers other than MP4, MKV and AVI, and damaged ones.

    Raises:
        InputError: the file cannot be read, or its time stamps repeat and it states no frame rate.
    """
    container = read_container(path)
    if fps is not None:
        return rate_times(fps, "given", start_ns, None if container is None else container.steps)
    if container is None:
        return FrameTimes(STAMPS, start_ns)
    if container.stamped and _plausible(container):
        return FrameTimes(STAMPS, start_ns, container.pts_ns)
    rate = container.rate or (as_rate(stated_hz) if stated_hz else None)
    repeats = container.stamped and container.pts_ns is not None
    if rate is None:
        if repeats:
            raise InputError(f"{path}: the times of its frames repeat, and it states no frame rate; give one, or times")
        return FrameTimes(STAMPS, start_ns)
    origin = "time stamps of the file repeat" if repeats else "stated by the file"
    return rate_times(rate, origin, start_ns, container.steps)


def _plausible(container: Container) -> bool:
    """Whether the container gives every frame a time of its own."""
    return container.pts_ns is not None and bool((np.diff(container.pts_ns) > 0).all())
