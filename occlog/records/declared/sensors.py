"""Tables of sensor measurements, including true boxes. Conventions: see `tables`.

`Measurements` has ranges, signal strengths and time differences of stations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Floats32, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import ANY_WIDTH, ColumnTable, check_order, column, first_row

APPEARANCE_BINS = 72
"""Length of an appearance histogram: 8 x 8 hue-saturation bins, then 8 brightness bins of grey pixels."""

UNLABELLED = -1
"""`target_id` of a measurement that has not been assigned to a target."""


MIN_SIGMA_RAD = 1e-15
"""Smallest standard deviation of an angle: the resolution of an angle of 1 rad."""
MIN_SIGMA_PX = 1e-9
"""Smallest standard deviation of a reading in an image."""
MAX_FRAMES = 10**9
"""Frames that a camera can have: a year at 30 a second."""
MAX_EDGE_PX = 1e6
"""How far boxes may reach [px]: ten times the largest image, for boxes outside of it."""


def check_frames(frame: Ints, name: str) -> None:
    """InputError, with the first row, if a frame number in `frame` (n,) is below 0 or not below `MAX_FRAMES`.

    `name` is that of the table, for the message.
    """
    if (wrong := (frame < 0) | (frame >= MAX_FRAMES)).any():
        row = first_row(wrong)
        raise InputError(f"{name}: row {row}: frame {frame[row]} must be from 0 and below {MAX_FRAMES}")


def check_edges(edges: Sequence[Floats], name: str) -> None:
    """InputError, with the first row, if a box has a coordinate or size beyond +-`MAX_EDGE_PX`.

    Args:
        edges: columns (n,) of the boxes' coordinates and sizes [px].
        name: of the table, for the message.
    """
    far = np.max(np.abs(edges), axis=0)
    if (wrong := far > MAX_EDGE_PX).any():
        row = first_row(wrong)
        raise InputError(
            f"{name}: row {row}: box that reaches to {far[row]:g} px; no image is larger than {MAX_EDGE_PX:g} px"
        )


def check_ids(ids: Ints32, column: str, name: str) -> None:
    """InputError, with the first row, if an identity in `ids` (n,) is below -1, which means none.

    `column` and `name` (of the table) are for the message.
    """
    if (wrong := ids < -1).any():
        row = first_row(wrong)
        raise InputError(f"{name}: row {row}: {column} {ids[row]} must be at least -1 (-1: none)")


@dataclass(frozen=True, slots=True, eq=False)
class Bearings(ColumnTable):
    """Bearings (azimuths in the world) of targets from each sensor, with standard deviations.

    A camera that delivered a frame but did not detect the target has a row with `seen` false: that is information. A
    camera without a frame has no row. Rows with `target_id` = -1 are candidates that may come from any object; a sensor
    may have several of them at one time.
    """

    NAME: ClassVar[str] = "bearings"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")
    MEASURED: ClassVar[str] = "bearing"

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the camera or array in the scene")
    target_id: Ints32 = column("i4", "1", "target the measurement belongs to; -1 = not assigned")
    seen: Bools = column("?", "1", "true: a measurement; false: the sensor looked and did not see the target")
    bearing: Floats = column(
        "f8", "rad", "azimuth of the line of sight from +x towards +y, in [-pi, pi)", nan="not seen"
    )
    sigma: Floats = column("f8", "rad", "standard deviation of the bearing, > 0", nan="not seen")
    u_px: Floats = column(
        "f8",
        "px",
        "horizontal offset from the principal point, to the right, in the undistorted and levelled image",
        nan="not seen, or the sensor is not a camera",
    )
    sigma_px: Floats = column("f8", "px", "standard deviation of u_px, > 0", nan="not seen, or not a camera")
    score: Floats = column("f8", "1", "similarity to the target or confidence, 0 to 1", nan="unknown or not seen")
    elevation: Floats = column(
        "f8",
        "rad",
        "of the line of sight above the horizontal plane, in [-pi/2, pi/2]",
        nan="not seen, or the sensor measures no elevation",
        optional=True,
    )
    sigma_elevation: Floats = column(
        "f8",
        "rad",
        "standard deviation of the elevation, > 0; of a tilted array both are about its own axes",
        nan="no elevation",
        optional=True,
    )
    cause: Strings = column(
        "U",
        "1",
        "what the fusion of detections did: empty, not fused; `kept`; `recovered`, put in where the camera missed the "
        "object; `removed`, declared false, so not of the target",
        optional=True,
    )

    def check(self) -> None:
        """InputError unless times are in order, angles are in range, and a row has a bearing exactly if `seen` is true.

        Standard deviations must be positive, and an elevation requires its standard deviation and a detection.
        """
        check_order(self)
        check_ids(self.target_id, "target_id", "Bearings")
        value = np.isfinite(self.bearing) & np.isfinite(self.sigma)
        if (wrong := value != self.seen).any():
            row = first_row(wrong)
            raise InputError(
                f"Bearings: row {row}: seen is {bool(self.seen[row])} but bearing is {self.bearing[row]}, sigma "
                f"{self.sigma[row]}; numbers if seen, else NaN"
            )
        if (wrong := self.sigma_px < MIN_SIGMA_PX).any():
            row = first_row(wrong)
            raise InputError(
                f"Bearings: row {row}: sigma_px {self.sigma_px[row]:g} px must be at least {MIN_SIGMA_PX:g} px"
            )
        bad = self.seen & ~((np.abs(self.bearing) <= np.pi) & (self.sigma >= MIN_SIGMA_RAD))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Bearings: row {row}: bearing {self.bearing[row]:g} rad must be in [-pi, pi), and sigma "
                f"{self.sigma[row]:g} rad at least {MIN_SIGMA_RAD:g} rad"
            )
        finite = np.isfinite(self.elevation)
        bad = (finite != np.isfinite(self.sigma_elevation)) | (finite & ~self.seen)
        with np.errstate(invalid="ignore"):
            bad |= finite & ~((np.abs(self.elevation) <= 0.5 * np.pi) & (self.sigma_elevation > 0))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Bearings: row {row}: elevation {self.elevation[row]:g} rad must be in [-pi/2, pi/2], and "
                f"sigma_elevation {self.sigma_elevation[row]:g} rad above 0; both are NaN where seen is False"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Views(ColumnTable):
    """People-sized foreground clusters (or detector boxes) of every camera and frame, with their lines of sight."""

    NAME: ClassVar[str] = "views"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "cluster")

    t_ns: Ints = column("i8", "ns", "time of the frame since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the camera in the scene")
    frame: Ints = column("i8", "1", "number of the frame in the camera's stream, from 0")
    cluster: Ints32 = column("i4", "1", "number of the cluster in the frame, from 0, by falling area")
    x_px: Floats = column("f8", "px", "centre of the cluster in the image as recorded, to the right")
    y_px: Floats = column("f8", "px", "centre of the cluster in the image as recorded, down")
    cov_xx_px: Floats = column("f8", "px^2", "spread of the cluster's pixels")
    cov_xy_px: Floats = column("f8", "px^2", "spread of the cluster's pixels")
    cov_yy_px: Floats = column("f8", "px^2", "spread of the cluster's pixels")
    left_px: Floats = column("f8", "px", "left edge of the bounding box")
    top_px: Floats = column("f8", "px", "upper edge of the bounding box")
    width_px: Floats = column("f8", "px", "width of the bounding box, > 0")
    height_px: Floats = column("f8", "px", "height of the bounding box, > 0")
    area_px: Floats = column("f8", "px^2", "foreground pixels, or the box's area for a detector's box")
    bearing: Floats = column(
        "f8", "rad", "azimuth of the line of sight through the centre, in [-pi, pi)", nan="camera without pose"
    )
    sigma: Floats = column("f8", "rad", "standard deviation of the bearing, > 0", nan="camera without pose")
    u_px: Floats = column("f8", "px", "as in bearings", nan="camera without pose")
    sigma_px: Floats = column("f8", "px", "standard deviation of u_px, > 0", nan="camera without pose")
    confidence: Floats = column("f8", "1", "the detector's confidence, 0 to 1", nan="not from a detector")
    similarity: Floats = column(
        "f8", "1", "Bhattacharyya coefficient with the target's appearance, 0 to 1", nan="no appearance"
    )
    target_id: Ints32 = column("i4", "1", "target assigned to the cluster; -1 = another object, or not decided")
    appearance: Floats32 = column(
        "f4",
        "1",
        "colour histogram, sums to 1: 8x8 hue-saturation bins, then 8 brightness bins of grey pixels",
        nan="no appearance",
        width=APPEARANCE_BINS,
    )
    cause: Strings = column(
        "U",
        "1",
        "what the fusion of detections did: empty, not fused; `kept`; `recovered`, put in where the camera missed the "
        "object; `removed`, declared false, so not of the target",
        optional=True,
    )
    tracklet_id: Ints32 = column(
        "i4",
        "1",
        "identity that the source of the box gave, for example a tracker in this camera alone; -1 = none",
        optional=True,
    )
    embedding: Floats32 = column(
        "f4",
        "1",
        "how a network for re-identification describes who is in the box: a vector of length 1, of as many numbers as "
        "the network gives; empty in a table without any",
        nan="none of this box",
        width=ANY_WIDTH,
        optional=True,
    )

    def check(self) -> None:
        """InputError unless times are in order, frames and identities valid, and boxes of plausible, positive size."""
        check_order(self)
        check_frames(self.frame, "Views")
        check_ids(self.target_id, "target_id", "Views")
        check_edges((self.left_px, self.top_px, self.width_px, self.height_px), "Views")
        bad = ~((self.width_px > 0) & (self.height_px > 0))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Views: row {row}: width and height of the box, {self.width_px[row]:g} x {self.height_px[row]:g} "
                "px, must be above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Boxes(ColumnTable):
    """A person detector's boxes, or the true ones: ingested instead of, or in addition to, video.

    A frame without any box is one row with `box` = -1 and NaN elsewhere, so that
    "frame without detections" is distinguished from "no frame".
    """

    NAME: ClassVar[str] = "boxes"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "box")

    t_ns: Ints = column("i8", "ns", "time of the frame since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the camera in the scene")
    frame: Ints = column("i8", "1", "number of the frame in the camera's stream, from 0")
    box: Ints32 = column("i4", "1", "number of the box in the frame, from 0; -1 = the frame has no box")
    target_id: Ints32 = column("i4", "1", "identity given by the source; -1 = none")
    left_px: Floats = column("f8", "px", "left edge", nan="the frame has no box")
    top_px: Floats = column("f8", "px", "upper edge", nan="the frame has no box")
    width_px: Floats = column("f8", "px", "width, > 0", nan="the frame has no box")
    height_px: Floats = column("f8", "px", "height, > 0", nan="the frame has no box")
    confidence: Floats = column("f8", "1", "the detector's confidence, 0 to 1", nan="not given")

    def check(self) -> None:
        """InputError unless times are in order, frames and identities valid, and boxes of plausible, positive size."""
        check_order(self)
        name = type(self).__name__
        check_frames(self.frame, name)
        for key in ("box", "target_id"):
            check_ids(getattr(self, key), key, name)
        check_edges((self.left_px, self.top_px, self.width_px, self.height_px), name)
        bad = (self.box >= 0) & ~((self.width_px > 0) & (self.height_px > 0))
        if bad.any():
            row = first_row(bad)
            size = f"{self.width_px[row]:g} x {self.height_px[row]:g} px"
            raise InputError(f"{name}: row {row}: width and height of the box, {size}, must be above 0")


@dataclass(frozen=True, slots=True, eq=False)
class TruthBoxes(Boxes):
    """True boxes of the targets in each view: the columns of `Boxes`, and the visible share of each target."""

    NAME: ClassVar[str] = "truth_boxes"
    VERSION: ClassVar[int] = 2

    visible: Floats = column(
        "f8",
        "1",
        "visible share of the part that is in the image, 0 to 1",
        nan="the frame has no box, or not known",
        optional=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Doa(ColumnTable):
    """Directions of arrival (azimuth and elevation in the world) from microphone arrays or other direction finders."""

    NAME: ClassVar[str] = "doa"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "source_id")
    MEASURED: ClassVar[str] = "azimuth"

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the array in the scene")
    source_id: Ints32 = column("i4", "1", "identity given by the source; -1 = none")
    azimuth: Floats = column("f8", "rad", "world azimuth from +x towards +y, in [-pi, pi)")
    elevation: Floats = column("f8", "rad", "above the horizontal plane, in [-pi/2, pi/2]", nan="planar array")
    sigma_azimuth: Floats = column("f8", "rad", "standard deviation, > 0", nan="not given: the array's noise applies")
    sigma_elevation: Floats = column("f8", "rad", "standard deviation, > 0", nan="not given or planar")
    confidence: Floats = column("f8", "1", "strength of the peak, 0 to 1", nan="not given")

    def check(self) -> None:
        """InputError unless times are in order, source numbers are valid, and azimuths are between -pi and pi."""
        check_order(self)
        check_ids(self.source_id, "source_id", "Doa")
        bad = ~(np.abs(self.azimuth) <= np.pi)
        if bad.any():
            row = first_row(bad)
            raise InputError(f"Doa: row {row}: azimuth {self.azimuth[row]:g} rad must be in [-pi, pi)")


@dataclass(frozen=True, slots=True, eq=False)
class Positions(ColumnTable):
    """Positions on the ground that a detector reports: a network for the ground plane, lidar, radar, ultra-wideband.

    A frame without any target is one row with `detection` = -1 and NaN elsewhere, as in `boxes`. The source need not be
    a sensor of the scene.
    """

    NAME: ClassVar[str] = "positions"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "detection")

    t_ns: Ints = column("i8", "ns", "time of the frame since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the source; it need not be in the scene")
    frame: Ints = column("i8", "1", "number of the frame of the source, from 0")
    detection: Ints32 = column("i4", "1", "number of the position in the frame, from 0; -1 = the frame has none")
    target_id: Ints32 = column("i4", "1", "identity given by the source; -1 = none")
    x: Floats = column("f8", "m", "position in the world", nan="the frame has no position")
    y: Floats = column("f8", "m", "position in the world", nan="the frame has no position")
    cov_xx: Floats = column("f8", "m^2", "covariance of the position, > 0", nan="not stated")
    cov_xy: Floats = column("f8", "m^2", "covariance of the position", nan="not stated")
    cov_yy: Floats = column("f8", "m^2", "covariance of the position, > 0", nan="not stated")
    confidence: Floats = column("f8", "1", "the detector's confidence, 0 to 1", nan="not given")

    def check(self) -> None:
        """InputError unless times are in order, and identities and frames valid.

        Rows have positions exactly if detected. A covariance that is stated must be positive definite.
        """
        check_order(self)
        check_frames(self.frame, "Positions")
        for key in ("detection", "target_id"):
            check_ids(getattr(self, key), key, "Positions")
        there = np.isfinite(self.x) & np.isfinite(self.y)
        if (bad := there != (self.detection >= 0)).any():
            row = first_row(bad)
            raise InputError(
                f"Positions: row {row}: detection {self.detection[row]} at ({self.x[row]:g}, {self.y[row]:g}); x "
                "and y are numbers where detection is from 0, NaN where it is -1"
            )
        stated = np.isfinite(self.cov_xx)
        with np.errstate(invalid="ignore"):
            positive = (self.cov_xx > 0.0) & (self.cov_xx * self.cov_yy > self.cov_xy**2)
        if (bad := (stated | np.isfinite(self.cov_yy)) & ~positive).any():
            row = first_row(bad)
            raise InputError(
                f"Positions: row {row}: its covariance (cov_xx, cov_xy, cov_yy) is not positive definite; correct "
                "it, or set it to NaN (unknown)"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Reads(ColumnTable):
    """Tags that readers detected: a row for each read; a reader that detects no tag has no row."""

    NAME: ClassVar[str] = "reads"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "tag")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the reader in the scene")
    tag: Strings = column("U", "1", "identity that the tag sends")
    target_id: Ints32 = column("i4", "1", "target that carries the tag, >= 0")
    rssi: Floats = column("f8", "dBm", "strength of the received signal", nan="the reader does not measure it")

    def check(self) -> None:
        """InputError unless times are in order, and every row has a target (`target_id` at least 0)."""
        check_order(self)
        if (bad := self.target_id < 0).any():
            row = first_row(bad)
            raise InputError(
                f"Reads: row {row}: target_id {self.target_id[row]} of tag {self.tag[row]} must be at least 0"
            )


VALUES = ("range", "rssi", "tdoa", "range_difference")
"""Columns of which each row has at least one."""
WITH_A_RANGE = ("bearing",)
"""Columns of values that a sensor measures together with a range."""
DIFFERENCES = ("tdoa", "range_difference")
"""Columns of values that a reference belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class Measurements(ColumnTable):
    """Ranges, signal strengths and arrival-time differences of targets with known identity.

    Such targets are radio tags, beacons, or a single source of sound. A row has at least one of range, received power,
    time difference or range difference to another station; with a range it may have a bearing. A time difference in
    seconds becomes a length by the speed of propagation, which the table does not know.
    """

    NAME: ClassVar[str] = "measurements"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the station in the scene")
    target_id: Ints32 = column("i4", "1", "target that was measured, >= 0")
    range: Floats = column("f8", "m", "distance from the station to the target, in space", nan="not measured")
    sigma_range: Floats = column("f8", "m", "its standard deviation, > 0", nan="not stated")
    rssi: Floats = column("f8", "dBm", "strength of the received signal", nan="not measured")
    sigma_rssi: Floats = column("f8", "dB", "its standard deviation, shadowing included, > 0", nan="not stated")
    reference: Strings = column(
        "U", "1", "the other station of a difference; empty where the row has none", optional=True
    )
    tdoa: Floats = column(
        "f8",
        "s",
        "time of arrival at the station minus that at the reference",
        nan="not measured",
        optional=True,
    )
    sigma_tdoa: Floats = column("f8", "s", "its standard deviation, > 0", nan="not stated", optional=True)
    range_difference: Floats = column(
        "f8",
        "m",
        "distance of the target from the station minus that from the reference",
        nan="not measured",
        optional=True,
    )
    sigma_range_difference: Floats = column("f8", "m", "its standard deviation, > 0", nan="not stated", optional=True)
    bearing: Floats = column(
        "f8",
        "rad",
        "azimuth of the target about the station, of a sensor that measures it with a range",
        nan="not measured",
        optional=True,
    )
    sigma_bearing: Floats = column("f8", "rad", "its standard deviation, > 0", nan="not stated", optional=True)

    def check(self) -> None:
        """InputError unless times are in order, and each row has a target, a value and positive standard deviations.

        A bearing requires a range; a difference requires a second station, in `reference`.
        """
        check_order(self)
        bad: Bools = np.asarray(self.target_id < 0)
        if bad.any():
            row = first_row(bad)
            raise InputError(f"Measurements: row {row}: target_id {self.target_id[row]} must be at least 0")
        for name in (*VALUES, *WITH_A_RANGE):
            sigma: Floats = getattr(self, f"sigma_{name}")
            if (wrong := np.asarray(sigma <= 0)).any():
                row = first_row(wrong)
                raise InputError(f"Measurements: row {row}: sigma_{name} {sigma[row]:g} must be above 0")
        for name in WITH_A_RANGE:
            if (alone := np.isfinite(getattr(self, name)) & ~np.isfinite(self.range)).any():
                row = first_row(alone)
                raise InputError(
                    f"Measurements: row {row}: has a {name} without a range; put directions alone into a table of "
                    "bearings"
                )
        bad = np.asarray(~self.present.any(axis=1))
        if bad.any():
            row = first_row(bad)
            raise InputError(f"Measurements: row {row}: has none of {', '.join(VALUES)}; leave the row out")
        differs = np.isfinite(self.tdoa) | np.isfinite(self.range_difference)
        bad = differs & ((self.reference == "") | (self.reference == self.sensor))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Measurements: row {row}: tdoa and range_difference are of two stations, but sensor is "
                f"{str(self.sensor[row])!r} and reference {str(self.reference[row])!r}"
            )

    @property
    def present(self) -> Bools:
        """(N, 4) mask of the values that each row has, in the order range, rssi, tdoa, range_difference (`VALUES`)."""
        return np.column_stack([np.isfinite(getattr(self, name)) for name in VALUES])
