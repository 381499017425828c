"""Settings of the fusion of tracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting


@dataclass(frozen=True)
class TrackFusionConfig(Settings):
    """Settings of the fusion of tracks; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "fuse tracks"

    gate: float = setting(
        4.0,
        "Two tracks are of one person if they are this many standard deviations apart or less.",
        above=0,
        option="--gate",
    )
    error: float = setting(
        0.7,
        "Standard deviation, per axis, of how far apart two groups of cameras put one person because of their poses.",
        unit="length",
        at_least=0,
        people=0.1,
        option="--error",
        metavar="LENGTH",
    )
    compare_s: float = setting(
        2.0, "Two tracks are compared over so long, half of it before and half after.", unit="s", above=0
    )
    gap_s: float = setting(
        1.0, "Longest gap in a track that is bridged by a straight line.", unit="s", at_most=1e9, at_least=0
    )
    window_s: float | None = setting(
        None,
        "Times this close together are one moment.",
        unit="s",
        at_least=0,
        option="--window",
        metavar="SECONDS",
        nothing="just under half the shortest period",
    )
