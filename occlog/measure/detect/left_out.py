"""Numbers of frames at which nobody looked: they are not in the recording, or could not be used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from occlog.records.frames import Frame
from occlog.records.left_out_frames import LEFT_OUT
from occlog.records.losses import Loss
from occlog.records.tables import Boxes

from .one_camera import numbers_of

MOST = 10_000
"""Stretches of a camera that are listed; numbers with more gaps count something else than frames."""


class LeftOut:
    """Gathers the numbers while frames stream by."""

    def __init__(self) -> None:
        """Nothing was seen yet."""
        self._last: dict[str, int] = {}
        self._stretches: dict[str, list[tuple[int, int]]] = {}

    def watch(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Pass on the frames."""
        for frame in frames:
            self._see(frame.sensor, frame.index)
            yield frame

    def watch_boxes(self, chunks: Iterable[Boxes]) -> Iterator[Boxes]:
        """Pass on boxes, which have a row for each frame that a detector looked at, also for one without any."""
        for chunk in chunks:
            for sensor, number in dict.fromkeys(zip(chunk.sensor.tolist(), chunk.frame.tolist(), strict=True)):
                self._see(sensor, number)
            yield chunk

    def lost(self, losses: Iterable[Loss]) -> None:
        """Count frames that could not be used."""
        for loss in losses:
            if (numbers := numbers_of(loss)) is not None and loss.source in self._last:
                self._add(loss.source, *numbers)

    def _see(self, sensor: str, number: int) -> None:
        last = self._last.get(sensor)
        if last is not None and number > last + 1:
            self._add(sensor, last + 1, number - 1)
        self._last[sensor] = number

    def _add(self, sensor: str, first: int, last: int) -> None:
        stretches = self._stretches.setdefault(sensor, [])
        if len(stretches) <= MOST:
            stretches.append((first, last))

    def parameters(self) -> dict[str, object]:
        """What provenance says of it; nothing where no number is left out."""
        told = {name: sorted(each) for name, each in sorted(self._stretches.items()) if len(each) <= MOST}
        return {LEFT_OUT: told} if told else {}
