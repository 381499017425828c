"""Settings of `occlog epipolar`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, option_setting, setting


@dataclass(frozen=True)
class EpipolarConfig(Settings):
    """Settings of the estimation of fundamental matrices from matches."""

    OWNER: ClassVar[str] = "epipolar"

    points: str = option_setting(
        "centres",
        "Points of each target to match: `centres`, or `ends` (top and bottom) for people.",
        choices=("centres", "ends"),
    )
    model: str = option_setting(
        "auto",
        "Model of the matches: `perspective`, `affine` (distant cameras with long lenses), or `auto`: affine unless "
        "perspective fits significantly better.",
        choices=("auto", "perspective", "affine"),
    )
    inlier_threshold_px: float = setting(
        3.0,
        "Inlier threshold: distance of a match from its epipolar line. Smaller values reject more matches.",
        unit="px",
        above=0,
        option="--inlier-threshold",
    )
    max_epipolar_error_px: float = setting(
        5.0,
        "Maximum expected error of the epipolar lines; a pair of views is refused if its matches give a larger one.",
        unit="px",
        above=0,
        option="--max-epipolar-error",
    )
