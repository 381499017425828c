"""What to track in images, and what to write."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class ViewsRequest:
    """What to track in images, and how."""

    recording: Path
    scene: Path | None
    method: str
    settings: dict[str, str]
    initial: Path | None
    detections: Path | None
    fundamental: Path | None
    only: tuple[str, ...]  # cameras; empty: all
    without: tuple[str, ...]
    window_ns: int | None
    seed: int

    @property
    def paths(self) -> list[Path]:
        """All inputs, each once."""
        given = (self.recording, self.scene, self.initial, self.detections, self.fundamental)
        return list(dict.fromkeys(p for p in given if p is not None))

    @property
    def births(self) -> str:
        """Where trackers come from."""
        if self.initial is None:
            return "detections"
        return "initial" if self.detections is None else "both"


@dataclass(frozen=True)
class ViewsOutputs:
    """What to write."""

    tracks: Path
    world: Path | None = None
