"""Settings of tracking in images that are not the method's: images, and births and ends of trackers from detections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from occlog.settings import Settings, setting


@dataclass(frozen=True)
class ViewsConfig(Settings):
    """Settings around the trackers."""

    OWNER: ClassVar[str] = "tracking in images"

    bits: int | None = setting(
        None, "Significant bits of 16-bit images.", at_least=8, at_most=16, nothing="such images are refused"
    )
    background: bool = setting(False, "Colours of the empty scene, learnt in a first look, are not those of a target.")
    birth_frames: int = setting(
        3, "Frames in a row in which a region that no tracker explains must be seen; 0: none begins.", at_least=0
    )
    birth_wait: int = setting(
        12, "More frames to wait where it may be any of several targets of other views.", at_least=0
    )
    birth_apart: float = setting(
        0.6, "Nearer to a tracker than this, in sums of radii, a region is explained by it.", above=0
    )
    birth_size: float = setting(4.0, "Smallest half width and half height of a region.", unit="px", above=0)
    birth_confidence: float = setting(0.3, "Least confidence of a detector's box.", at_least=0, at_most=1)
    birth_cut: bool = setting(False, "Regions that the image's edge cuts may begin a tracker.")
    support_frames: int = setting(
        40, "Frames without a region at it after which a tracker is lost; 0: never.", at_least=0
    )
