"""Selection of frames by number, for all cameras or per camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class FrameChoice:
    """A selection of frames by ranges first <= number < stop.

    Attributes:
        common: range of the cameras without one of their own; None: all of their frames.
        own: range by camera.
    """

    common: tuple[int, int] | None = None
    own: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def of(self, camera: str | None) -> tuple[int, int] | None:
        """Range (first, stop) selected for a camera, or for all (`camera` None); None: all frames."""
        return self.common if camera is None else self.own.get(camera, self.common)

    def takes(self, camera: str, number: int) -> bool:
        """Whether frame `number` of a camera is selected."""
        chosen = self.of(camera)
        return chosen is None or chosen[0] <= number < chosen[1]

    def __bool__(self) -> bool:
        """Whether any frames are selected; otherwise all are used."""
        return self.common is not None or bool(self.own)

    def __str__(self) -> str:
        """Format the ranges in the syntax of the option `frames`: `0:100, cam2=50:100`."""
        common = [] if self.common is None else [f"{self.common[0]}:{self.common[1]}"]
        return ", ".join([*common, *(f"{name}={first}:{stop}" for name, (first, stop) in self.own.items())])


ALL_FRAMES = FrameChoice()
"""The choice of every frame."""
