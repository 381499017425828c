"""Correction of the times of frames for changed clocks, and sorting by the corrected times."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping

from occlog.scans.clocks import ClockCorrection

from .frame_detections import FrameDetectionsWithIds


def retimed(
    frames: Iterator[FrameDetectionsWithIds], changes: Mapping[int, ClockCorrection], count: int
) -> Iterator[FrameDetectionsWithIds]:
    """Generate frames at corrected times, sorted by these.

    A frame waits until no earlier one can follow.

    Args:
        frames: frames of all cameras, in the order of their uncorrected times.
        changes: change of the clock of each camera that has one, by camera index.
        count: number of cameras.
    """
    first: dict[int, int] = {}
    waiting: list[tuple[int, int, FrameDetectionsWithIds]] = []

    def changed(camera: int, t_ns: int) -> int:
        change = changes.get(camera)
        return t_ns if change is None else change.time(t_ns, first.get(camera, t_ns))

    for n, each in enumerate(frames):
        t_ns, camera = each.detections.t_ns, each.detections.camera
        first.setdefault(camera, t_ns)
        now = changed(camera, t_ns)
        heapq.heappush(waiting, (now, n, each._replace(detections=each.detections._replace(t_ns=now))))
        # Frames that come later have times from here on
        settled = min(changed(c, t_ns) for c in range(count))
        while waiting and waiting[0][0] < settled:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
