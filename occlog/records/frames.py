"""A video frame on its way from a recording to the detector; and numbers of skipped frames from provenance.

A table of regions has no rows for frames without detections; the provenance distinguishes these from lost frames.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
"""(height, width, 3) BGR, or (height, width) grey."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame of one camera, which is decoded only on request.

    `t_ns` is its time [ns since the Unix epoch], `sensor` the name of the camera, `index` its number from 0. `decode`
    returns the image; it must be called at most once, in the order of `index` for each camera (compressed video can
    only be decoded forwards), and raises InputError for a frame that cannot be decoded. `encoded` is the compressed
    image as recorded, usually PNG or JPEG; None: the frame is in a video.
    """

    t_ns: int
    sensor: str
    index: int
    decode: Callable[[], Image]
    encoded: bytes | None = None


LEFT_OUT = "frames_left_out"
"""Parameter of provenance: (first, last) number of each segment, by the name of the camera."""


def skipped_frames_of(parameters: Mapping[str, object]) -> dict[str, object]:
    """Entry `frames_left_out` of a provenance, as a dict to add to that of a derived table; {} without one.

    `parameters` are the provenance parameters of the source table.
    """
    return {LEFT_OUT: parameters[LEFT_OUT]} if LEFT_OUT in parameters else {}


def gaps_of(parameters: Mapping[str, object]) -> dict[str, list[tuple[int, int]]]:
    """Sorted ranges (first, last) of skipped frame numbers by camera.

    They are read from the entry `frames_left_out` of the `parameters` of a provenance. Empty if `parameters` have no
    such entry; cameras with malformed ranges are omitted.
    """
    value = parameters.get(LEFT_OUT)
    if not isinstance(value, Mapping):
        return {}
    return {
        str(name): sorted((int(first), int(last)) for first, last in each)
        for name, each in value.items()
        if all(isinstance(s, list | tuple) and len(s) == 2 and all(isinstance(n, int) for n in s) for s in each)
    }


def inside(segments: list[tuple[int, int]], number: int) -> bool:
    """Whether a number is in one of the sorted, disjoint ranges (first, last), both ends included."""
    k = bisect_right(segments, (number, 2**63)) - 1
    return k >= 0 and number <= segments[k][1]
