"""Settings of tracking in images that are not the method's: images, and births and ends of trackers from detections."""

from __future__ import annotations

from dataclasses import dataclass

from occlog.settings import check_settings


@dataclass(frozen=True)
class ViewsConfig:
    """Settings around the trackers; each may be given with --set."""

    bits: int | None = None  # significant bits of 16-bit images; None: they are refused
    background: bool = False  # colours of the empty scene, learnt in a first look, are none of a target
    birth_frames: int = 3  # frames in a row in which a region that no tracker explains must be seen; 0: none begins
    birth_wait: int = 12  # more frames to wait where it may be any of several targets of other views
    birth_apart: float = 0.6  # nearer to a tracker than this, in sums of radii, a region is explained by it
    birth_size: float = 4.0  # smallest half width and half height of a region [px]
    birth_confidence: float = 0.3  # least confidence of a detector's box
    birth_cut: bool = False  # regions that the image's edge cuts may begin a tracker
    support_frames: int = 40  # frames without a region at it after which a tracker is lost; 0: never

    def __post_init__(self) -> None:
        check_settings(
            self,
            "tracking in images",
            (
                ("bits", self.bits is None or 8 <= self.bits <= 16, "from 8 to 16"),
                ("birth_frames", self.birth_frames >= 0, "at least 0"),
                ("birth_wait", self.birth_wait >= 0, "at least 0"),
                ("birth_apart", self.birth_apart > 0, "above 0"),
                ("birth_size", self.birth_size > 0, "above 0 px"),
                ("birth_confidence", 0 <= self.birth_confidence <= 1, "from 0 to 1"),
                ("support_frames", self.support_frames >= 0, "at least 0"),
            ),
        )
