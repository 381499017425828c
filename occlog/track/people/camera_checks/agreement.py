"""Consistency of cameras.

The checks state whether each camera detects the people that the other cameras detect, and name the cause if not.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.consistency.clock_offsets import cause_of, offset_words
from occlog.consistency.verdict import MIN_SAMPLES as FEWEST_BOXES
from occlog.consistency.verdict import exceeds_share
from occlog.core.plane import inside_polygon
from occlog.records.scene import Camera
from occlog.records.verdicts import Check, Severity, finding, outcome
from occlog.track.methods.jipda.interface import PositionSource, TrackSnapshot
from occlog.track.methods.jipda.lasting_errors.clock_offset import clock_drifts
from occlog.track.methods.jipda.lasting_errors.pose_offset import MIN_ANGLE

from ..frame_detections import BoxStatistics, FrameDetectionsWithIds
from ..rows import MIN_MAP_PROBABILITY, association_probability_by_camera
from .camera_faults import CameraFaults
from .clock_offset import ClockOffsetSearch

EXPLAINED, AGREES, ROTATED = "associated boxes", "detection rates of the cameras", "camera orientations"
CONFIRMED, IN_ROOM, FITS = "people seen by other cameras", "people in the room", "calibrations and files of boxes"
MIN_ROTATED_DEG = 1.0
"""Rotation about an axis [deg] from which a camera has moved; smaller ones are errors of a calibration."""
USUAL_ROTATION_DEG = 0.25
"""Errors of orientation by usual calibrations, and by bodies unlike the model [deg]: a camera has moved if its rotation
exceeds the least significant one by more."""
MAX_LIMIT_DEG = 1.0
"""Least significant rotation [deg] up to which the check of orientations applies."""
TIMES, BOXES = "camera clocks", "camera boxes"
GAPS = "times without boxes"
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
MAX_GAP_SHARE = 0.1
"""Share of a recording in which a camera may have no box though others see people in its view."""
MAX_DUPLICATE_SHARE = 0.2
"""Share of duplicate boxes above which a warning is given."""
MAX_COMMON_SIGMA_HEIGHTS = 0.04
"""Standard deviation of the common error of position, in heights of people, from which it is stated."""
MAX_OUTSIDE_SHARE = 0.01
"""Share of boxes outside the image above which a warning is given."""
MAX_UNASSOCIATED_SHARE = 0.5
"""Maximum share of boxes without an associated track."""
MIN_ASSOCIATED_SHARE = 0.1
"""Minimum share of the boxes of one camera that move, and have an associated track, if those of others have."""
MAX_SHARE_OF_A_SPOT = 0.1
"""Boxes at a spot of the image that has a larger share of a camera's boxes do not move."""
SPOT = 0.5
"""Size of such a spot, in widths and heights of the box."""
MAX_ROOM_MARGIN_HEIGHTS, MAX_OUTSIDE_ROOM_SHARE = 0.5, 0.05
"""Distance from the room, in heights of people, beyond which a person is outside, and the share of rows that may be."""


class CameraAgreement:
    """Counts, over time steps, of the people that each camera detects among those that another camera detects.

    From these, and from the filter's estimates of clock offsets and rotations, it checks whether cameras agree.
    """

    def __init__(
        self, views: Sequence[Camera | PositionSource], person_height: float = 1.7, room: Floats | None = None
    ) -> None:
        """Start all counts at 0.

        Args:
            views: cameras, then position sensors, by index.
            person_height: mean height of people in the scene's unit.
            room: (K, 2) polygon where people can be; None: not stated.
        """
        self._room, self._spots = room, [Counter[tuple[int, int]]() for _ in views]
        self.person_height = person_height
        self.names = [c.name for c in views]
        cameras = [c for c in views if not isinstance(c, PositionSource)]
        self.heights = [float(c.position[2]) for c in cameras]
        self._delays, self._faults = ClockOffsetSearch(cameras), CameraFaults(cameras, person_height)
        n, self.cameras = len(self.names), len(cameras)
        # What one odd camera alone sees is not expected of the others, where these are enough
        self.fewest = 2 if n > 3 else 1
        self.expected = np.zeros(n)
        self.met = np.zeros(n)
        self.used = np.zeros(n)
        self.confirmed, self.alone = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self.outside_room, self.rows, self.outside_by = 0, 0, np.zeros(n, dtype=np.int64)
        self.static = np.zeros(n, dtype=np.int64)
        self.late, self.late_limit = np.zeros(n), np.full(n, np.inf)
        self.clock_history, self.clock_times_s = np.zeros((0, n, n + 1)), np.zeros(0)
        self.angles, self.angles_limit = np.zeros((n, 2)), np.full((n, 2), np.inf)
        self.common_sigma, self.common_time_s = float("nan"), float("nan")

    def add(self, snapshot: TrackSnapshot, frames: Sequence[FrameDetectionsWithIds]) -> None:
        """Add the tracks of one time step, and the detections of its frames, to the counts."""
        if snapshot.detectors is not None:
            self.common_sigma, self.common_time_s = snapshot.detectors.common_sigma, snapshot.detectors.common_time_s
            self.static = np.maximum(self.static, snapshot.detectors.static_clutter)
            self.late, self.late_limit = snapshot.detectors.late, snapshot.detectors.late_limit
            self.clock_history, self.clock_times_s = snapshot.detectors.clock_history, snapshot.detectors.clock_times_s
            self.angles, self.angles_limit = snapshot.detectors.angles, snapshot.detectors.angles_limit
        # A box of two people who touch stands in the rows of both: each takes half of it
        support = snapshot.support
        np.add.at(self.used, support.camera, support.probability - 0.5 * support.joint)
        by = association_probability_by_camera(snapshot, len(self.names)) >= MIN_MAP_PROBABILITY
        in_images = [each for each in frames if each.detections.covariance is None]
        self._delays.add(snapshot, in_images, by[:, : self.cameras])
        self._faults.add(snapshot.t_ns, in_images)
        for each in in_images:
            self._spots[each.detections.camera].update(_spots(each.detections.boxes))
        if not len(snapshot.ids):
            return
        together = by.sum(axis=1) > 1
        self.confirmed += by[together].sum(axis=0)
        self.alone += by[~together].sum(axis=0)
        if self._room is not None:
            away = distance_outside(snapshot.mean[:, :2], self._room) > MAX_ROOM_MARGIN_HEIGHTS * self.person_height
            self.rows, self.outside_room = self.rows + len(away), self.outside_room + int(away.sum())
            self.outside_by += by[away].sum(axis=0)
        cameras = [each.detections.camera for each in frames]
        others = by.sum(axis=1)[:, None] - by >= self.fewest
        with np.errstate(invalid="ignore"):
            due = (snapshot.visibility >= MIN_VISIBILITY) & others
        for c in cameras:
            self.expected[c] += np.count_nonzero(due[:, c])
            self.met[c] += np.count_nonzero(due[:, c] & by[:, c])

    @property
    def shares(self) -> Floats:
        """(C,) detection rate of each camera.

        It is the share of the people detected by another camera and unoccluded in this one that the camera detects; NaN
        if fewer than `MIN_EXPECTED_DETECTIONS` are expected.
        """
        enough = self.expected >= MIN_EXPECTED_DETECTIONS
        return np.where(enough, self.met / np.maximum(self.expected, 1.0), np.nan)

    def person_heights(self) -> Floats:
        """Return (C,) median heights of people by the boxes of each camera [scene unit]; NaN: too few boxes."""
        return self._faults.heights()

    def checks(self, tally: BoxStatistics, unit: str = "m") -> tuple[Check, ...]:
        """Return all checks of the cameras, with their findings; causes stand before their consequences.

        Args:
            tally: counts of frames and boxes.
            unit: length unit of the scene, for messages.
        """
        boxes, whole = int(tally.boxes.sum()), tally.boxes + tally.outside + tally.twice
        known, angles = np.isfinite(self.shares), np.abs(self.angles[np.isfinite(self.angles_limit)])
        few = f"fewer than {MIN_EXPECTED_DETECTIONS} people seen elsewhere should be seen plainly in each camera"
        disjoint = [*self._disjoint_clocks(tally.first_ns, tally.last_ns)]
        found = (
            *outcome(
                EXPLAINED,
                self._unexplained(tally),
                unless=f"there are fewer than {FEWEST_BOXES} boxes" if boxes < FEWEST_BOXES else "",
                boxes=boxes,
            ),
            *outcome(AGREES, self._odd(tally), unless="" if known.any() else few),
            *outcome(CONFIRMED, self._unconfirmed(), unless="" if self.cameras > 1 else "there is one camera"),
            *outcome(IN_ROOM, self._outside(), unless="the scene has no room" if self._room is None else ""),
            *outcome(
                ROTATED,
                self._rotated(),
                unless=self._unknown_rotations(),
                largest_deg=float(np.degrees(angles.max(initial=0.0))),
                allowed=math.degrees(MIN_ANGLE),
            ),
            *outcome(
                TIMES,
                [*disjoint, *self._late()],
                unless="" if np.count_nonzero(tally.first_ns >= 0) > 1 else "there is one camera",
            ),
            *outcome(
                GAPS,
                () if disjoint else self._gaps(),
                unless="a camera has other times" if disjoint else "" if self.cameras > 1 else "there is one camera",
            ),
            *outcome(
                COMMON, self._common(unit), unless="" if np.isfinite(self.common_sigma) else "it is not estimated"
            ),
            *outcome(STATIC, self._static()),
            *outcome(BOXES, self._boxes(tally), unless="" if whole.any() else "there are no boxes"),
        )
        # Causes before their consequences
        causes = ("boxes-duplicated", "camera-times-disjoint", "camera-clock-offset")
        found = tuple(sorted(found, key=lambda check: check.id not in causes))
        if disjoint:
            return (*found, *outcome(FITS, (), unless="a camera has other times"))
        return (*outcome(FITS, self._causes(found, unit)), *found)

    def _common(self, unit: str) -> Iterator[Check]:
        """Generate a finding if the standard deviation of the position error common to all cameras is large.

        `unit` is the length unit, for the message.
        """
        if self.common_sigma > MAX_COMMON_SIGMA_HEIGHTS * self.person_height:
            sigma, time_s = self.common_sigma, self.common_time_s
            yield finding(COMMON, "common-position-error", sigma=sigma, unit=unit, time_s=time_s)

    def _static(self) -> Iterator[Check]:
        """Generate findings about cameras with static clutter: objects at fixed positions detected as people."""
        for name, count in zip(self.names, self.static.tolist(), strict=True):
            if count:
                yield finding(STATIC, "static-clutter", sensors=[name], count=count)

    def _late(self) -> Iterator[Check]:
        """Generate findings about cameras with a significant clock drift, or else clock offset.

        Both are by the filter's residuals.
        """
        drifts, limits = clock_drifts(self.clock_history, self.clock_times_s)
        span_s = float(np.ptp(self.clock_times_s)) if len(self.clock_times_s) else 0.0
        for c, (name, late_s, limit_s) in enumerate(
            zip(self.names, self.late.tolist(), self.late_limit.tolist(), strict=True)
        ):
            if drifts[c]:
                ppm, size = 1e6 * float(drifts[c]), f"{abs(float(drifts[c])) * span_s:.2g}"
                yield finding(
                    TIMES, "camera-clock-drift", sensors=[name], ppm=ppm, allowed=1e6 * float(limits[c]), size=size
                )
            elif late_s:
                words = offset_words(late_s)
                yield finding(TIMES, "camera-late", sensors=[name], late_s=late_s, allowed=limit_s, **words)

    def _boxes(self, tally: BoxStatistics) -> Iterator[Check]:
        """Generate findings about cameras without boxes, or with many duplicate boxes or boxes outside the image."""
        whole = tally.boxes + tally.outside + tally.twice
        for c, name in enumerate(self.names):
            if not whole[c] and whole.any():
                yield finding(BOXES, "no-boxes", sensors=[name])
            if tally.twice[c] > MAX_DUPLICATE_SHARE * whole[c]:
                yield _of_boxes(name, "boxes-duplicated", tally.twice[c], whole[c], MAX_DUPLICATE_SHARE)
            if tally.outside[c] > MAX_OUTSIDE_SHARE * whole[c]:
                yield _of_boxes(name, "boxes-outside-image", tally.outside[c], whole[c], MAX_OUTSIDE_SHARE)

    def _unexplained(self, tally: BoxStatistics) -> Iterator[Check]:
        """Generate findings if most boxes of all cameras, or nearly all moving ones of a camera, are of no track.

        The cause is wrong extrinsics, or boxes of objects that are not people.
        """
        boxes = int(tally.boxes.sum())
        unassociated = boxes - round(float(self.used.sum()))
        if boxes >= FEWEST_BOXES and exceeds_share(unassociated, boxes, MAX_UNASSOCIATED_SHARE):
            share = unassociated / boxes
            yield finding(EXPLAINED, "boxes-unassociated", share=share, boxes=boxes, allowed=MAX_UNASSOCIATED_SHARE)
            if buried := [name for name, height in zip(self.names, self.heights, strict=False) if height < 0.0]:
                yield finding(EXPLAINED, "camera-below-ground", sensors=buried)
        share_of = self.used / np.maximum(tally.boxes, 1)
        for c, name in enumerate(self.names[: self.cameras]):
            moving = self._moving(c)
            others = np.delete(share_of, c)[np.delete(tally.boxes, c) >= FEWEST_BOXES]
            trusted = len(others) and float(np.median(others)) > MAX_UNASSOCIATED_SHARE
            if trusted and moving >= FEWEST_BOXES and self.used[c] < MIN_ASSOCIATED_SHARE * moving:
                yield finding(
                    EXPLAINED,
                    "camera-unassociated",
                    sensors=[name],
                    count=moving - int(min(self.used[c], moving)),
                    boxes=moving,
                    allowed=1.0 - MIN_ASSOCIATED_SHARE,
                )

    def _causes(self, checks: Sequence[Check], unit: str) -> Iterator[Check]:
        """Generate the set-up mistakes that explain why boxes of cameras do not fit, or else errors of calibrations.

        `checks` are the findings of the other checks, `unit` is the length unit for messages.
        """
        mistakes = self._faults.found(unit, doubtful=any(check.status == "failed" for check in checks))
        for each in mistakes:
            names = [self.names[c] for c in each.cameras]
            yield finding(FITS, "camera-fits-if", sensors=names, fit=each.fit, now=each.now, change=each.words)
        rotated = any(check.id == "camera-rotated" and check.status == "failed" for check in checks)
        for cameras, words in [] if mistakes else self._faults.errors(unit, rotated=rotated):
            yield finding(FITS, "camera-error", sensors=[self.names[c] for c in cameras], change=words)

    def _gaps(self) -> Iterator[Check]:
        """Generate findings about cameras with a long interval without boxes.

        Others detect people in the camera's view meanwhile.
        """
        for gap in self._faults.gaps():
            name = self.names[gap.camera]
            yield finding(GAPS, "camera-gap", sensors=[name], begin_s=gap.begin_s, end_s=gap.end_s, people=gap.people)

    def _moving(self, camera: int) -> int:
        """Return the number of boxes of the camera with this index that are not static clutter.

        Boxes in spots of the image that hold more than `MAX_SHARE_OF_A_SPOT` of the camera's boxes are not counted.
        """
        counts = self._spots[camera]
        most = MAX_SHARE_OF_A_SPOT * counts.total()
        return sum(count for count in counts.values() if count <= most)

    def _unconfirmed(self) -> Iterator[Check]:
        """Generate findings about cameras with people that no other camera detects.

        A finding requires that others detect people in common.
        """
        for c, name in enumerate(self.names[: self.cameras]):
            others = np.delete(self.confirmed, c)
            if self.alone[c] >= FEWEST_BOXES and not self.confirmed[c] and others.max(initial=0) >= FEWEST_BOXES:
                yield finding(CONFIRMED, "camera-alone", sensors=[name], count=int(self.alone[c]))

    def _outside(self) -> Iterator[Check]:
        """Generate a finding if people are often outside the room, with the cameras that detect them there."""
        if exceeds_share(self.outside_room, self.rows, MAX_OUTSIDE_ROOM_SHARE):
            order = np.argsort(-self.outside_by, kind="stable")
            seen_by = [self.names[c] for c in order.tolist() if self.outside_by[c] > 0.5 * self.outside_by[order[0]]]
            yield finding(
                IN_ROOM,
                "people-outside-room",
                sensors=seen_by,
                count=self.outside_room,
                rows=self.rows,
                allowed=MAX_OUTSIDE_ROOM_SHARE,
            )

    def _odd(self, tally: BoxStatistics) -> Iterator[Check]:
        """Generate findings about cameras with a detection rate far below that of the others.

        If a clock offset explains the rate, the finding is about the offset. `tally` are counts of boxes.
        """
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
                    **offset_words(late),
                )

    def _unknown_rotations(self) -> str:
        """Return the reason why the orientation check does not apply; "" if it does.

        It does if rotations of `MAX_LIMIT_DEG` would be significant.
        """
        limits = np.degrees(self.angles_limit[: self.cameras, 0])
        known = limits[np.isfinite(limits)]
        if not len(known):
            return "no two cameras see the same people for 4 s"
        return f"only rotations above {known.max():.2g} deg would be found" if known.max() > MAX_LIMIT_DEG else ""

    def _rotated(self) -> Iterator[Check]:
        """Generate findings about cameras that the filter has found rotated against their calibration.

        A warning from `MIN_ROTATED_DEG`, and from `USUAL_ROTATION_DEG` above the least significant rotation on, else a
        note: small rotations are corrected by the filter.
        """
        least = np.maximum(MIN_ROTATED_DEG, np.degrees(self.angles_limit) + USUAL_ROTATION_DEG)
        for name, angles, limits in zip(self.names, np.degrees(self.angles), least, strict=True):
            if angles.any():
                severity: Severity = "warning" if (np.abs(angles) >= limits).any() else "note"
                yaw, pitch = angles.tolist()
                yield finding(ROTATED, "camera-rotated", severity, sensors=[name], yaw_deg=yaw, pitch_deg=pitch)

    def _disjoint_clocks(self, first_ns: Ints, last_ns: Ints) -> Iterator[Check]:
        """Generate findings about cameras that have no time in common with any other camera.

        `first_ns` and `last_ns` (C,) are the times of each camera's first and last frame; below 0: it has none.
        """
        there = np.flatnonzero(first_ns >= 0)
        for c in there.tolist():
            others = there[there != c]
            if len(others) and ((first_ns[others] > last_ns[c]) | (last_ns[others] < first_ns[c])).all():
                offset_s = float(first_ns[c] - first_ns[others].min()) / NS
                cause = cause_of(offset_s)
                yield finding(TIMES, "camera-times-disjoint", sensors=[self.names[c]], offset_s=offset_s, cause=cause)


def _spots(boxes: Floats) -> list[tuple[int, int]]:
    """Return cells (column, row) of an image grid that hold the centres of boxes (n, 4: left, top, right, bottom) [px].

    The cell size is `SPOT` times the box size, rounded to a power of two.
    """
    middle = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    size = np.maximum(boxes[:, 2:] - boxes[:, :2], 1.0)
    # Sizes in steps, so that spots are the same for boxes of about one size
    step = SPOT * np.exp2(np.round(np.log2(size)))
    return [(x, y) for x, y in np.floor(middle / step).astype(np.int64).tolist()]


def distance_outside(xy: Floats, room: Floats) -> Floats:
    """Return (n,) distances of points `xy` (n, 2) from the polygon `room` (K, 2); 0 inside."""
    start, along = room, np.roll(room, -1, axis=0) - room
    to = xy[:, None] - start
    share = np.clip(np.sum(to * along, axis=-1) / np.maximum(np.sum(along**2, axis=-1), 1e-30), 0.0, 1.0)
    distance = np.hypot(*np.moveaxis(to - share[..., None] * along, -1, 0)).min(axis=1)
    return np.where(inside_polygon(np.ascontiguousarray(xy), room), 0.0, distance)


def _of_boxes(name: str, id: str, count: int, boxes: int, allowed: float) -> Check:
    """Return the finding `id` that `count` of the `boxes` boxes of camera `name` have a fault.

    `allowed` is the acceptable share, 0 to 1.
    """
    return finding(BOXES, id, sensors=[name], count=int(count), boxes=int(boxes), share=count / boxes, allowed=allowed)
