"""Settings of the fusion of tracks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class TrackFusionConfig(Settings):
    """Settings of the fusion of tracks of several groups of cameras; lengths in the scene's unit, times in seconds."""

    OWNER: ClassVar[str] = "fuse tracks"

    gate: float = option_setting(
        4.0,
        "Gate in standard deviations: two tracks this close together or closer are of one person. Larger values "
        "join more tracks.",
        above=0,
    )
    sigma_registration: float = option_setting(
        0.7,
        "Registration error: standard deviation, per axis, between the positions that two groups of cameras give "
        "one person because of their poses.",
        unit="length",
        at_least=0,
        people=0.1,
    )
    comparison_window_s: float = setting(
        2.0, "Time over which two tracks are compared, half of it before and half after.", unit="s", above=0
    )
    max_gap_s: float = setting(
        1.0, "Maximum gap in a track to interpolate by a straight line.", unit="s", at_most=1e9, at_least=0
    )
    window_s: float | None = setting(
        None,
        "Times closer together are one time step.",
        unit="s",
        at_least=0,
        option="--window",
        nothing="just under half the shortest period",
    )
