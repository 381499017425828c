"""Numbers of skipped frames: missing in the recording, or unusable."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator

from occlog.records.frames import LEFT_OUT, Frame
from occlog.records.losses import Loss
from occlog.records.tables import Boxes

from .by_background.one_camera import numbers_of

MAX_SEGMENTS = 10_000
"""Sections of a camera that are listed; numbers with more gaps count something else than frames."""


class SkippedFrames:
    """Records which frame numbers of a stream are missing in the recording or could not be used.

    Frames numbered in steps (0, 5, 10) have no gaps.

    Attributes:
        frames: number of frames by camera that passed.
    """

    def __init__(self) -> None:
        """Create an empty list of skipped frames."""
        self.frames: Counter[str] = Counter()
        self._last: dict[str, int] = {}
        self._step: dict[str, int] = {}  # that divides all differences of the numbers of a camera
        self._gaps: dict[str, list[tuple[int, int]]] = {}
        self._lost: dict[str, list[tuple[int, int]]] = {}

    def watch(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Generate the frames unchanged, and record their numbers on the way."""
        for frame in frames:
            self._see(frame.sensor, frame.index)
            yield frame

    def watch_boxes(self, chunks: Iterable[Boxes]) -> Iterator[Boxes]:
        """Generate chunks of boxes unchanged, and record their frame numbers on the way."""
        for chunk in chunks:
            for sensor, number in dict.fromkeys(zip(chunk.sensor.tolist(), chunk.frame.tolist(), strict=True)):
                self._see(sensor, number)
            yield chunk

    def lost(self, losses: Iterable[Loss]) -> None:
        """Add the frames of losses made by `segments`; other losses, and those of unknown cameras, are ignored."""
        for loss in losses:
            if (numbers := numbers_of(loss)) is not None and loss.source in self._last:
                segments = self._lost.setdefault(loss.source, [])
                if len(segments) <= MAX_SEGMENTS:
                    segments.append(numbers)

    def _see(self, sensor: str, number: int) -> None:
        self.frames[sensor] += 1
        last = self._last.get(sensor)
        self._last[sensor] = number
        if last is None or number <= last:
            return
        self._step[sensor] = math.gcd(self._step.get(sensor, 0), number - last)
        if number == last + 1:
            return
        gaps = self._gaps.setdefault(sensor, [])
        if len(gaps) > MAX_SEGMENTS:
            self._gaps[sensor] = gaps = self._without_steps(sensor)
        if len(gaps) <= MAX_SEGMENTS:
            gaps.append((last + 1, number - 1))

    def _without_steps(self, sensor: str) -> list[tuple[int, int]]:
        """Gaps (first and last frame) of a camera that are larger than the usual step of its numbers."""
        step = self._step.get(sensor, 1)
        return [(first, last) for first, last in self._gaps.get(sensor, ()) if last - first + 2 > step]

    def parameters(self) -> dict[str, object]:
        """Skipped frames for the provenance: by camera, sorted pairs of first and last number; empty if no gaps."""
        skipped = {name: sorted({*self._without_steps(name), *self._lost.get(name, ())}) for name in sorted(self._last)}
        skipped = {name: each for name, each in skipped.items() if 0 < len(each) <= MAX_SEGMENTS}
        return {LEFT_OUT: skipped} if skipped else {}
