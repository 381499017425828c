"""Settings of the comparison of two runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class RunComparisonConfig(Settings):
    """Settings of the comparison of two runs: distances for matching and for divergence, in the scene's unit."""

    OWNER: ClassVar[str] = "two runs side by side"

    match_distance: float | None = option_setting(
        None,
        "Match threshold: a track matches a target, or a track of the other run, within this distance.",
        unit="length",
        above=0,
        people=1.0,
        shown="1 m",
    )
    divergence_distance: float | None = option_setting(
        None,
        "Runs diverge where the positions of a person differ by more than this, or only one run has a track.",
        unit="length",
        above=0,
        people=0.5,
        shown="0.5 m",
    )
    min_duration_s: float = setting(
        1.0,
        "Track changes of a person that last less than this are counted, but not listed.",
        unit="s",
        at_most=1e9,
        at_least=0,
        option="--min-duration",
    )
