"""Settings of tracking in images that are not the method's: images, and births and ends of trackers from detections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting


@dataclass(frozen=True)
class ViewsConfig(Settings):
    """Settings common to all methods that track in images: image conversion, track initiation and termination."""

    OWNER: ClassVar[str] = "tracking in images"

    bit_depth: int | None = setting(
        None, "Significant bits of 16-bit images.", at_least=8, at_most=16, nothing="such images are refused"
    )
    background: bool = setting(
        False, "Exclude background colours, learnt in a first pass, from the colour model of targets."
    )
    confirmation_frames: int = setting(
        3,
        "Track initiation: consecutive frames with a region that no tracker explains. Higher values suppress false "
        "trackers and delay true ones; 0: no initiation.",
        at_least=0,
    )
    confirmation_wait_frames: int = setting(
        12,
        "Additional frames to wait where the region may belong to any of several targets of other views.",
        at_least=0,
    )
    birth_min_distance: float = setting(
        0.6, "A region nearer to a tracker than this multiple of the sum of their radii is explained by it.", above=0
    )
    birth_min_size_px: float = setting(4.0, "Minimum half width and half height of a region.", unit="px", above=0)
    birth_min_confidence: float = setting(0.3, "Minimum confidence of the box of a detector.", at_least=0, at_most=1)
    birth_allow_truncated: bool = setting(False, "Allow track initiation from regions truncated by the image border.")
    max_coasting_frames: int = setting(
        40,
        "Maximum coasting: terminate a tracker after this many frames without a supporting region; 0: never.",
        at_least=0,
    )
