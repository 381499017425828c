"""Which cameras agree with the others: whether those see who the others see."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.consistency.verdict import MIN_SAMPLES as FEWEST_BOXES
from occlog.consistency.verdict import exceeds_share
from occlog.records.scene import Camera
from occlog.records.verdicts import Check, finding, outcome
from occlog.track.methods.jipda.interface import PositionSource, TrackSnapshot
from occlog.track.methods.jipda.pose_offset import MIN_ANGLE

from .clock_offset import ClockOffsetSearch
from .frame_detections import BoxStatistics, FrameDetectionsWithIds
from .rows import MIN_MAP_PROBABILITY, detection_probability_by_camera

EXPLAINED, AGREES, ROTATED = "associated boxes", "detection rates of the cameras", "camera orientations"
MAX_LIMIT_DEG = 1.0
"""Least significant rotation [deg] up to which the check of orientations applies."""
TIMES, BOXES = "camera clocks", "camera boxes"
COMMON, STATIC = "common position error", "static clutter"
"""Names of checks."""
MIN_VISIBILITY = 0.8
"""A person so probably visible should be detected."""
MIN_EXPECTED_DETECTIONS = 50
"""Minimum number of people that a camera should have seen, for a check."""
MIN_RELATIVE_DETECTION_RATE = 0.5
"""Minimum detection rate of a camera, relative to that of the other cameras, to agree with them."""
CLOCK_CHECK_RELATIVE_RATE = 0.97
"""Relative detection rate below which a camera may have a wrong clock (tracks follow that camera, too)."""
MIN_DETECTION_RATE = 0.25
"""Minimum detection rate of a camera if no third camera allows a comparison."""
MAX_DUPLICATE_SHARE = 0.2
"""Share of duplicate boxes above which a warning is given."""
MAX_COMMON_SIGMA_HEIGHTS = 0.04
"""Standard deviation of the common error of position, in heights of people, from which it is stated."""
MAX_OUTSIDE_SHARE = 0.01
"""Share of boxes outside the image above which a warning is given."""
MAX_UNASSOCIATED_SHARE = 0.5
"""Maximum share of boxes without an associated track."""


class CameraAgreement:
    """Counts, over a stream of time steps, the people that each camera sees of those that another camera sees."""

    def __init__(self, views: Sequence[Camera | PositionSource], person_height: float = 1.7) -> None:
        """Start all counts at 0; `person_height` in the scene's unit."""
        self.person_height = person_height
        self.names = [c.name for c in views]
        cameras = [c for c in views if not isinstance(c, PositionSource)]
        self.heights = [float(c.position[2]) for c in cameras]
        self._delays = ClockOffsetSearch(cameras)
        n, self.cameras = len(self.names), len(cameras)
        # What one odd camera alone sees is not expected of the others, where these are enough
        self.fewest = 2 if n > 3 else 1
        self.expected = np.zeros(n)
        self.met = np.zeros(n)
        self.used = np.zeros(n)
        self.static = np.zeros(n, dtype=np.int64)
        self.late, self.late_limit = np.zeros(n), np.full(n, np.inf)
        self.angles, self.angles_limit = np.zeros((n, 2)), np.full((n, 2), np.inf)
        self.common_sigma, self.common_time_s = float("nan"), float("nan")

    def add(self, snapshot: TrackSnapshot, frames: Sequence[FrameDetectionsWithIds]) -> None:
        """Count a time step."""
        if snapshot.detectors is not None:
            self.common_sigma, self.common_time_s = snapshot.detectors.common_sigma, snapshot.detectors.common_time_s
            self.static = np.maximum(self.static, snapshot.detectors.static_clutter)
            self.late, self.late_limit = snapshot.detectors.late, snapshot.detectors.late_limit
            self.angles, self.angles_limit = snapshot.detectors.angles, snapshot.detectors.angles_limit
        # A box of two people who touch stands in the rows of both: each takes half of it
        support = snapshot.support
        np.add.at(self.used, support.camera, support.probability - 0.5 * support.joint)
        by = detection_probability_by_camera(snapshot, len(self.names)) >= MIN_MAP_PROBABILITY
        in_images = [each for each in frames if each.detections.covariance is None]
        self._delays.add(snapshot, in_images, by[:, : self.cameras])
        if not len(snapshot.ids):
            return
        cameras = [each.detections.camera for each in frames]
        others = by.sum(axis=1)[:, None] - by >= self.fewest
        with np.errstate(invalid="ignore"):
            due = (snapshot.visibility >= MIN_VISIBILITY) & others
        for c in cameras:
            self.expected[c] += np.count_nonzero(due[:, c])
            self.met[c] += np.count_nonzero(due[:, c] & by[:, c])

    @property
    def shares(self) -> Floats:
        """(C,) share of the people seen elsewhere and plainly visible that each camera sees; NaN: too few to tell."""
        enough = self.expected >= MIN_EXPECTED_DETECTIONS
        return np.where(enough, self.met / np.maximum(self.expected, 1.0), np.nan)

    def checks(self, tally: BoxStatistics) -> tuple[Check, ...]:
        """Checks of the cameras with their findings."""
        boxes, whole = int(tally.boxes.sum()), tally.boxes + tally.outside + tally.twice
        known, angles = np.isfinite(self.shares), np.abs(self.angles[np.isfinite(self.angles_limit)])
        few = f"fewer than {MIN_EXPECTED_DETECTIONS} people seen elsewhere should be seen plainly in each camera"
        return (
            *outcome(
                EXPLAINED,
                self._unexplained(tally),
                unless=f"there are fewer than {FEWEST_BOXES} boxes" if boxes < FEWEST_BOXES else "",
                boxes=boxes,
            ),
            *outcome(AGREES, self._odd(tally), unless="" if known.any() else few),
            *outcome(
                ROTATED,
                self._rotated(),
                unless=self._unknown_rotations(),
                largest_deg=float(np.degrees(angles.max(initial=0.0))),
                allowed=math.degrees(MIN_ANGLE),
            ),
            *outcome(
                TIMES,
                [*self._disjoint_clocks(tally.first_ns, tally.last_ns), *self._late()],
                unless="" if np.count_nonzero(tally.first_ns >= 0) > 1 else "there is one camera",
            ),
            *outcome(COMMON, self._common(), unless="" if np.isfinite(self.common_sigma) else "it is not estimated"),
            *outcome(STATIC, self._static()),
            *outcome(BOXES, self._boxes(tally), unless="" if whole.any() else "there are no boxes"),
        )

    def _common(self) -> Iterator[Check]:
        """State the error of position that all cameras share, if it is large."""
        if self.common_sigma > MAX_COMMON_SIGMA_HEIGHTS * self.person_height:
            yield finding(COMMON, "common-position-error", sigma=self.common_sigma, time_s=self.common_time_s)

    def _static(self) -> Iterator[Check]:
        """State the cameras with sources of static clutter."""
        for name, count in zip(self.names, self.static.tolist(), strict=True):
            if count:
                yield finding(STATIC, "static-clutter", sensors=[name], count=count)

    def _late(self) -> Iterator[Check]:
        """Find the cameras of which people are where they were, or will be, in the others."""
        for name, late_s, limit_s in zip(self.names, self.late.tolist(), self.late_limit.tolist(), strict=True):
            if late_s:
                yield finding(TIMES, "camera-late", sensors=[name], late_s=late_s, allowed=limit_s)

    def _boxes(self, tally: BoxStatistics) -> Iterator[Check]:
        """Cameras without boxes, with boxes twice, or outside the image."""
        whole = tally.boxes + tally.outside + tally.twice
        for c, name in enumerate(self.names):
            if not whole[c] and whole.any():
                yield finding(BOXES, "no-boxes", sensors=[name])
            if tally.twice[c] > MAX_DUPLICATE_SHARE * whole[c]:
                yield _of_boxes(name, "boxes-duplicated", tally.twice[c], whole[c], MAX_DUPLICATE_SHARE)
            if tally.outside[c] > MAX_OUTSIDE_SHARE * whole[c]:
                yield _of_boxes(name, "boxes-outside-image", tally.outside[c], whole[c], MAX_OUTSIDE_SHARE)

    def _unexplained(self, tally: BoxStatistics) -> Iterator[Check]:
        """Find whether most boxes are clutter: the extrinsics are wrong, or the boxes are of other objects."""
        boxes = int(tally.boxes.sum())
        unassociated = boxes - round(float(self.used.sum()))
        if boxes < FEWEST_BOXES or not exceeds_share(unassociated, boxes, MAX_UNASSOCIATED_SHARE):
            return
        share = unassociated / boxes
        yield finding(EXPLAINED, "boxes-unassociated", share=share, boxes=boxes, allowed=MAX_UNASSOCIATED_SHARE)
        if buried := [name for name, height in zip(self.names, self.heights, strict=False) if height < 0.0]:
            yield finding(EXPLAINED, "camera-below-ground", sensors=buried)

    def _odd(self, tally: BoxStatistics) -> Iterator[Check]:
        """Find cameras that do not see the people the others see, unless their boxes are omitted."""
        shares = self.shares
        for c, name in enumerate(self.names):
            if tally.outside[c] > tally.boxes[c]:
                continue
            others = np.delete(shares, c)
            others = others[np.isfinite(others)]
            limit = MIN_RELATIVE_DETECTION_RATE * float(np.median(others)) if len(others) > 1 else MIN_DETECTION_RATE
            usual = float(np.median(others)) if len(others) else 0.0
            late = (
                self._delays.late(c, self.fewest)
                if c < self.cameras and shares[c] < max(limit, CLOCK_CHECK_RELATIVE_RATE * usual)
                else float("nan")
            )
            if shares[c] < limit or np.isfinite(late):
                yield finding(
                    AGREES,
                    "camera-clock-offset" if np.isfinite(late) else "camera-inconsistent",
                    sensors=[name],
                    share=float(shares[c]),
                    others=usual,
                    allowed=limit,
                    late_s=late,
                )

    def _unknown_rotations(self) -> str:
        """Why rotations cannot be found; empty: those of `MAX_LIMIT_DEG` and more would be."""
        limits = np.degrees(self.angles_limit[: self.cameras, 0])
        known = limits[np.isfinite(limits)]
        if not len(known):
            return "no two cameras see the same people for 4 s"
        return f"only rotations above {known.max():.2g} deg would be found" if known.max() > MAX_LIMIT_DEG else ""

    def _rotated(self) -> Iterator[Check]:
        """Find the cameras with an orientation that is not that of the calibration."""
        for name, (yaw, pitch) in zip(self.names, np.degrees(self.angles).tolist(), strict=True):
            if yaw or pitch:
                yield finding(ROTATED, "camera-rotated", sensors=[name], yaw_deg=yaw, pitch_deg=pitch)

    def _disjoint_clocks(self, first_ns: Ints, last_ns: Ints) -> Iterator[Check]:
        """Find cameras without a time in common with another camera."""
        there = np.flatnonzero(first_ns >= 0)
        for c in there.tolist():
            others = there[there != c]
            if len(others) and ((first_ns[others] > last_ns[c]) | (last_ns[others] < first_ns[c])).all():
                offset_s = (first_ns[c] - first_ns[others].min()) / 1e9
                yield finding(TIMES, "camera-times-disjoint", sensors=[self.names[c]], offset_s=float(offset_s))


def _of_boxes(name: str, id: str, count: int, boxes: int, allowed: float) -> Check:
    """A finding of some of a camera's boxes."""
    return finding(BOXES, id, sensors=[name], count=int(count), boxes=int(boxes), share=count / boxes, allowed=allowed)
