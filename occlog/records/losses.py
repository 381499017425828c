"""Input losses: listed in every output, and reported by exit code 3 of commands that process the rest."""

from __future__ import annotations

from dataclasses import asdict, dataclass

MINOR_SHARE = 0.001
"""Share of detections that may be lost with exit code 0."""
OUTSIDE_IMAGE = "wholly outside the image"
"""Prefix of messages on boxes of a camera outside its image."""


@dataclass(frozen=True, slots=True)
class Loss:
    """A part of the input that could not be used.

    Attributes:
        source: file or sensor.
        place: where in it (frame, byte offset, row, time).
        what: what is missing and why.
        count: how many items (frames, messages, rows) were lost; 0 when that cannot be known.
        total: number of detections among which these were; 0: recorded data was lost.
    """

    source: str
    place: str
    what: str
    count: int = 0
    total: int = 0

    @property
    def minor(self) -> bool:
        """Whether at most the share `MINOR_SHARE` of the detections was lost, so that the exit code stays 0.

        False if the number lost, or the number of detections among which it is, is 0 (unknown or not detections).
        """
        return 0 < self.count <= MINOR_SHARE * self.total

    def __str__(self) -> str:
        lost = f" ({self.count} lost)" if self.count else ""
        return f"{self.source}: {self.place}: {self.what}{lost}"

    def as_dict(self) -> dict[str, str | int]:
        """JSON-compatible values by name of the field; `total` is omitted if it is 0."""
        return {name: value for name, value in asdict(self).items() if value or name != "total"}
