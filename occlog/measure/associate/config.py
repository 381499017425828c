"""Settings of `occlog label`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class LabelConfig(Settings):
    """Gate for the association of a candidate with a track."""

    OWNER: ClassVar[str] = "label"

    gate: float = option_setting(
        3.0,
        "Gate in standard deviations for a candidate to agree with a track. Larger values label more candidates "
        "and mislabel more.",
        above=0,
    )
    max_gap_s: float = setting(
        1.0,
        "Maximum gap between two rows of a track to interpolate.",
        unit="s",
        at_least=0,
        at_most=1e9,
        option="--max-gap",
    )
    keep_unassigned: bool = option_setting(
        False, "Keep unassigned candidates, without a label.", shown="leave them out"
    )


@dataclass(frozen=True)
class NamingConfig(Settings):
    """Thresholds for identifying a track as a target of a gallery."""

    OWNER: ClassVar[str] = "naming"

    min_boxes: int = option_setting(
        10,
        "Minimum number of boxes of a track compared with a target, for the track to be identified as it.",
        at_least=1,
        metavar="N",
    )
