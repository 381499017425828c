"""Frames that cannot be decoded: nothing is shown of them, and they are listed as lost."""

from __future__ import annotations

from occlog.errors import InputError
from occlog.measure.detect.by_background.one_camera import stretches
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss

NO_IMAGE = "no image: lost"
"""What is said in place of an image."""


class LostFrames:
    """Decodes frames, and keeps which of those that were wanted could not be."""

    def __init__(self) -> None:
        """None yet."""
        self._why: dict[tuple[str, int], str] = {}
        self._missed: set[tuple[str, int]] = set()

    def image(self, frame: Frame) -> Image | None:
        """The image; None: it cannot be decoded."""
        try:
            return frame.decode()
        except InputError as error:
            # The message begins with file, camera and frame; without them equal reasons are equal
            self._why[frame.sensor, frame.index] = str(error).rsplit(": ", 1)[-1]
            return None

    def is_lost(self, sensor: str, index: int) -> bool:
        """Whether a frame could not be decoded."""
        return (sensor, index) in self._why

    def miss(self, sensor: str, index: int) -> None:
        """A frame is wanted: it counts as lost if it could not be decoded."""
        if self.is_lost(sensor, index):
            self._missed.add((sensor, index))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What was lost, by camera and number."""
        sensors = sorted({sensor for sensor, _ in self._missed})
        lost = {name: sorted(index for sensor, index in self._missed if sensor == name) for name in sensors}
        return tuple(
            loss for name, own in lost.items() for loss in stretches(name, [(n, self._why[name, n]) for n in own])
        )
