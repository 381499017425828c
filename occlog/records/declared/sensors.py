"""Tables of sensor measurements, including true boxes. Conventions: see `tables`.

`Measurements` has ranges, signal strengths and time differences of stations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from occlog.array_types import Bools, Floats, Floats32, Ints, Ints32, Strings
from occlog.records.columns import ANY_WIDTH, ColumnTable, column, first_row

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


def _check_numbers(table: Boxes | Positions | Views, *ids: str) -> None:
    """InputError if a frame number is below 0 or not below `MAX_FRAMES`, or an identity below -1, which means none.

    `ids` are the columns with identities.
    """
    table.refuse(
        (table.frame < 0) | (table.frame >= MAX_FRAMES), f"frame {{frame}} must be from 0 and below {MAX_FRAMES}"
    )
    for name in ids:
        table.refuse(getattr(table, name) < -1, f"{name} {{{name}}} must be at least -1 (-1: none)")


def _check_sizes(table: Boxes | Views, boxes: Bools) -> None:
    """InputError if a coordinate or size is beyond +-`MAX_EDGE_PX`, or a box of the mask `boxes` (n,) has no size."""
    far = np.max(np.abs((table.left_px, table.top_px, table.width_px, table.height_px)), axis=0)
    if (wrong := far > MAX_EDGE_PX).any():
        reach = f"box that reaches to {far[first_row(wrong)]:g} px"
        table.refuse(wrong, f"{reach}; no image is larger than {MAX_EDGE_PX:g} px")
    table.refuse(
        boxes & ~((table.width_px > 0) & (table.height_px > 0)),
        "width and height of the box, {width_px:g} x {height_px:g} px, must be above 0",
    )


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

    t_ns: Ints = column("time since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera or array in the scene")
    target_id: Ints32 = column("target the measurement belongs to; -1 = not assigned")
    seen: Bools = column("true: a measurement; false: the sensor looked and did not see the target")
    bearing: Floats = column("azimuth of the line of sight from +x towards +y, in [-pi, pi)", "rad", nan="not seen")
    sigma: Floats = column("standard deviation of the bearing, > 0", "rad", nan="not seen")
    u_px: Floats = column(
        "horizontal offset from the principal point, to the right, in the undistorted and levelled image",
        "px",
        nan="not seen, or the sensor is not a camera",
    )
    sigma_px: Floats = column("standard deviation of u_px, > 0", "px", nan="not seen, or not a camera")
    score: Floats = column("similarity to the target or confidence, 0 to 1", nan="unknown or not seen")
    elevation: Floats = column(
        "of the line of sight above the horizontal plane, in [-pi/2, pi/2]",
        "rad",
        nan="not seen, or the sensor measures no elevation",
        optional=True,
    )
    sigma_elevation: Floats = column(
        "standard deviation of the elevation, > 0; of a tilted array both are about its own axes",
        "rad",
        nan="no elevation",
        optional=True,
    )
    cause: Strings = column(
        "what the fusion of detections did: empty, not fused; `kept`; `recovered`, put in where the camera missed the"
        " object; `removed`, declared false, so not of the target",
        optional=True,
    )

    def check(self) -> None:
        """InputError unless angles are in range, and a row has a bearing exactly if `seen` is true.

        Standard deviations must be positive, and an elevation requires its standard deviation and a detection.
        """
        self.refuse(self.target_id < -1, "target_id {target_id} must be at least -1")
        value = np.isfinite(self.bearing) & np.isfinite(self.sigma)
        self.refuse(
            value != self.seen, "seen is {seen} but bearing is {bearing}, sigma {sigma}; numbers if seen, else NaN"
        )
        self.refuse(self.sigma_px < MIN_SIGMA_PX, f"sigma_px {{sigma_px:g}} px must be at least {MIN_SIGMA_PX:g} px")
        self.refuse(
            self.seen & ~((np.abs(self.bearing) <= np.pi) & (self.sigma >= MIN_SIGMA_RAD)),
            f"bearing {{bearing:g}} rad must be in [-pi, pi), and sigma {{sigma:g}} rad at least {MIN_SIGMA_RAD:g} rad",
        )
        finite = np.isfinite(self.elevation)
        bad = (finite != np.isfinite(self.sigma_elevation)) | (finite & ~self.seen)
        with np.errstate(invalid="ignore"):
            bad |= finite & ~((np.abs(self.elevation) <= 0.5 * np.pi) & (self.sigma_elevation > 0))
        self.refuse(
            bad,
            "elevation {elevation:g} rad must be in [-pi/2, pi/2], and sigma_elevation {sigma_elevation:g} rad above "
            "0; both are NaN where seen is False",
        )


@dataclass(frozen=True, slots=True, eq=False)
class Views(ColumnTable):
    """People-sized foreground clusters (or detector boxes) of every camera and frame, with their lines of sight."""

    NAME: ClassVar[str] = "views"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "cluster")

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera in the scene")
    frame: Ints = column("number of the frame in the camera's stream, from 0")
    cluster: Ints32 = column("number of the cluster in the frame, from 0, by falling area")
    x_px: Floats = column("centre of the cluster in the image as recorded, to the right", "px")
    y_px: Floats = column("centre of the cluster in the image as recorded, down", "px")
    cov_xx_px: Floats = column("spread of the cluster's pixels", "px^2")
    cov_xy_px: Floats = column("spread of the cluster's pixels", "px^2")
    cov_yy_px: Floats = column("spread of the cluster's pixels", "px^2")
    left_px: Floats = column("left edge of the bounding box", "px")
    top_px: Floats = column("upper edge of the bounding box", "px")
    width_px: Floats = column("width of the bounding box, > 0", "px")
    height_px: Floats = column("height of the bounding box, > 0", "px")
    area_px: Floats = column("foreground pixels, or the box's area for a detector's box", "px^2")
    bearing: Floats = column(
        "azimuth of the line of sight through the centre, in [-pi, pi)", "rad", nan="camera without pose"
    )
    sigma: Floats = column("standard deviation of the bearing, > 0", "rad", nan="camera without pose")
    u_px: Floats = column("as in bearings", "px", nan="camera without pose")
    sigma_px: Floats = column("standard deviation of u_px, > 0", "px", nan="camera without pose")
    confidence: Floats = column("the detector's confidence, 0 to 1", nan="not from a detector")
    similarity: Floats = column("Bhattacharyya coefficient with the target's appearance, 0 to 1", nan="no appearance")
    target_id: Ints32 = column("target assigned to the cluster; -1 = another object, or not decided")
    appearance: Floats32 = column(
        "colour histogram, sums to 1: 8x8 hue-saturation bins, then 8 brightness bins of grey pixels",
        nan="no appearance",
        width=APPEARANCE_BINS,
    )
    cause: Strings = column(
        "what the fusion of detections did: empty, not fused; `kept`; `recovered`, put in where the camera missed the"
        " object; `removed`, declared false, so not of the target",
        optional=True,
    )
    tracklet_id: Ints32 = column(
        "identity that the source of the box gave, for example a tracker in this camera alone; -1 = none", optional=True
    )
    embedding: Floats32 = column(
        "how a network for re-identification describes who is in the box: a vector of length 1, of as many numbers as"
        " the network gives; empty in a table without any",
        nan="none of this box",
        width=ANY_WIDTH,
        optional=True,
    )

    def check(self) -> None:
        """InputError unless frames and identities are valid, and boxes are of plausible, positive size."""
        _check_numbers(self, "target_id")
        _check_sizes(self, np.ones(len(self), dtype=np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class Boxes(ColumnTable):
    """A person detector's boxes, or the true ones: ingested instead of, or in addition to, video.

    A frame without any box is one row with `box` = -1 and NaN elsewhere, so that
    "frame without detections" is distinguished from "no frame".
    """

    NAME: ClassVar[str] = "boxes"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "box")

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the camera in the scene")
    frame: Ints = column("number of the frame in the camera's stream, from 0")
    box: Ints32 = column("number of the box in the frame, from 0; -1 = the frame has no box")
    target_id: Ints32 = column("identity given by the source; -1 = none")
    left_px: Floats = column("left edge", "px", nan="the frame has no box")
    top_px: Floats = column("upper edge", "px", nan="the frame has no box")
    width_px: Floats = column("width, > 0", "px", nan="the frame has no box")
    height_px: Floats = column("height, > 0", "px", nan="the frame has no box")
    confidence: Floats = column("the detector's confidence, 0 to 1", nan="not given")

    def check(self) -> None:
        """InputError unless frames and identities are valid, and boxes are of plausible, positive size."""
        _check_numbers(self, "box", "target_id")
        _check_sizes(self, self.box >= 0)


@dataclass(frozen=True, slots=True, eq=False)
class TruthBoxes(Boxes):
    """True boxes of the targets in each view: the columns of `Boxes`, and the visible share of each target."""

    NAME: ClassVar[str] = "truth_boxes"
    VERSION: ClassVar[int] = 2

    visible: Floats = column(
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

    t_ns: Ints = column("time since the Unix epoch", "ns")
    sensor: Strings = column("name of the array in the scene")
    source_id: Ints32 = column("identity given by the source; -1 = none")
    azimuth: Floats = column("world azimuth from +x towards +y, in [-pi, pi)", "rad")
    elevation: Floats = column("above the horizontal plane, in [-pi/2, pi/2]", "rad", nan="planar array")
    sigma_azimuth: Floats = column("standard deviation, > 0", "rad", nan="not given: the array's noise applies")
    sigma_elevation: Floats = column("standard deviation, > 0", "rad", nan="not given or planar")
    confidence: Floats = column("strength of the peak, 0 to 1", nan="not given")

    def check(self) -> None:
        """InputError unless source numbers are valid, and azimuths are between -pi and pi."""
        self.refuse(self.source_id < -1, "source_id {source_id} must be at least -1")
        self.refuse(~(np.abs(self.azimuth) <= np.pi), "azimuth {azimuth:g} rad must be in [-pi, pi)")


@dataclass(frozen=True, slots=True, eq=False)
class Positions(ColumnTable):
    """Positions on the ground that a detector reports: a network for the ground plane, lidar, radar, ultra-wideband.

    A frame without any target is one row with `detection` = -1 and NaN elsewhere, as in `boxes`. The source need not be
    a sensor of the scene.
    """

    NAME: ClassVar[str] = "positions"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "detection")

    t_ns: Ints = column("time of the frame since the Unix epoch", "ns")
    sensor: Strings = column("name of the source; it need not be in the scene")
    frame: Ints = column("number of the frame of the source, from 0")
    detection: Ints32 = column("number of the position in the frame, from 0; -1 = the frame has none")
    target_id: Ints32 = column("identity given by the source; -1 = none")
    x: Floats = column("position in the world", "m", nan="the frame has no position")
    y: Floats = column("position in the world", "m", nan="the frame has no position")
    cov_xx: Floats = column("covariance of the position, > 0", "m^2", nan="not stated")
    cov_xy: Floats = column("covariance of the position", "m^2", nan="not stated")
    cov_yy: Floats = column("covariance of the position, > 0", "m^2", nan="not stated")
    confidence: Floats = column("the detector's confidence, 0 to 1", nan="not given")

    def check(self) -> None:
        """InputError unless identities and frames are valid.

        Rows have positions exactly if detected. A covariance that is stated must be positive definite.
        """
        _check_numbers(self, "detection", "target_id")
        there = np.isfinite(self.x) & np.isfinite(self.y)
        self.refuse(
            there != (self.detection >= 0),
            "detection {detection} at ({x:g}, {y:g}); x and y are numbers where detection is from 0, NaN where it is "
            "-1",
        )
        stated = np.isfinite(self.cov_xx)
        with np.errstate(invalid="ignore"):
            positive = (self.cov_xx > 0.0) & (self.cov_xx * self.cov_yy > self.cov_xy**2)
        self.refuse(
            (stated | np.isfinite(self.cov_yy)) & ~positive,
            "its covariance (cov_xx, cov_xy, cov_yy) is not positive definite; correct it, or set it to NaN (unknown)",
        )


@dataclass(frozen=True, slots=True, eq=False)
class Reads(ColumnTable):
    """Tags that readers detected: a row for each read; a reader that detects no tag has no row."""

    NAME: ClassVar[str] = "reads"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "tag")

    t_ns: Ints = column("time since the Unix epoch", "ns")
    sensor: Strings = column("name of the reader in the scene")
    tag: Strings = column("identity that the tag sends")
    target_id: Ints32 = column("target that carries the tag, >= 0")
    rssi: Floats = column("strength of the received signal", "dBm", nan="the reader does not measure it")

    def check(self) -> None:
        """InputError unless every row has a target (`target_id` at least 0)."""
        self.refuse(self.target_id < 0, "target_id {target_id} of tag {tag} must be at least 0")


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

    t_ns: Ints = column("time since the Unix epoch", "ns")
    sensor: Strings = column("name of the station in the scene")
    target_id: Ints32 = column("target that was measured, >= 0")
    range: Floats = column("distance from the station to the target, in space", "m", nan="not measured")
    sigma_range: Floats = column("its standard deviation, > 0", "m", nan="not stated")
    rssi: Floats = column("strength of the received signal", "dBm", nan="not measured")
    sigma_rssi: Floats = column("its standard deviation, shadowing included, > 0", "dB", nan="not stated")
    reference: Strings = column("the other station of a difference; empty where the row has none", optional=True)
    tdoa: Floats = column(
        "time of arrival at the station minus that at the reference", "s", nan="not measured", optional=True
    )
    sigma_tdoa: Floats = column("its standard deviation, > 0", "s", nan="not stated", optional=True)
    range_difference: Floats = column(
        "distance of the target from the station minus that from the reference", "m", nan="not measured", optional=True
    )
    sigma_range_difference: Floats = column("its standard deviation, > 0", "m", nan="not stated", optional=True)
    bearing: Floats = column(
        "azimuth of the target about the station, of a sensor that measures it with a range",
        "rad",
        nan="not measured",
        optional=True,
    )
    sigma_bearing: Floats = column("its standard deviation, > 0", "rad", nan="not stated", optional=True)

    def check(self) -> None:
        """InputError unless each row has a target, a value and positive standard deviations.

        A bearing requires a range; a difference requires a second station, in `reference`.
        """
        self.refuse(self.target_id < 0, "target_id {target_id} must be at least 0")
        for name in (*VALUES, *WITH_A_RANGE):
            self.refuse(getattr(self, f"sigma_{name}") <= 0, f"sigma_{name} {{sigma_{name}:g}} must be above 0")
        for name in WITH_A_RANGE:
            alone = np.isfinite(getattr(self, name)) & ~np.isfinite(self.range)
            self.refuse(alone, f"has a {name} without a range; put directions alone into a table of bearings")
        self.refuse(np.asarray(~self.present.any(axis=1)), f"has none of {', '.join(VALUES)}; leave the row out")
        differs = np.isfinite(self.tdoa) | np.isfinite(self.range_difference)
        self.refuse(
            differs & ((self.reference == "") | (self.reference == self.sensor)),
            "tdoa and range_difference are of two stations, but sensor is {sensor!r} and reference {reference!r}",
        )

    @property
    def present(self) -> Bools:
        """(N, 4) mask of the values that each row has, in the order range, rssi, tdoa, range_difference (`VALUES`)."""
        return np.column_stack([np.isfinite(getattr(self, name)) for name in VALUES])
