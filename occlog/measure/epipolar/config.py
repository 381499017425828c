"""Settings of `occlog epipolar`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting


@dataclass(frozen=True)
class EpipolarConfig(Settings):
    """Settings of the estimation of fundamental matrices from matches."""

    OWNER: ClassVar[str] = "epipolar"

    points: str = setting(
        "centres",
        "What to take of each target; of people take ends, their tops and bottoms.",
        choices=("centres", "ends"),
        option="--points",
    )
    model: str = setting(
        "auto",
        "Of matches; affine is for cameras far away with long lenses.",
        choices=("auto", "perspective", "affine"),
        option="--model",
    )
    threshold_px: float = setting(
        3.0,
        "Distance from its line beyond which a match does not agree.",
        unit="px",
        above=0,
        option="--threshold",
        metavar="PX",
    )
    max_error_px: float = setting(
        5.0,
        "Matches that leave a larger expected error of the lines are refused.",
        unit="px",
        above=0,
        option="--max-error",
        metavar="PX",
    )
