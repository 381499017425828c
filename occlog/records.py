"""The tables that pass between stages: frozen column records, NumPy only, no file formats.

Each column states its dtype, unit and meaning once.  `occlog.io.parquet` and
`occlog.io.recording` derive their schemas from the same declaration, and
`schemas/` publishes them.

Conventions (all tables)
    * `t_ns` is int64 nanoseconds since the Unix epoch; rows are ordered by it.
    * World frame: x, y on the ground, z up, in the scene's length unit (metres unless
      the scene says otherwise).  Angles are radians from +x towards +y in [-pi, pi).
    * Pixels carry `_px`; x to the right, y down, the centre of the first pixel is (0, 0).
    * NaN is allowed only in columns declared with `nan=...`, which says what it means.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .columns import (
    Bools,
    Floats,
    Floats32,
    Ints,
    Ints32,
    Strings,
    Table,
    check_order,
    column,
    first_row,
)
from .errors import InputError
from .view_records import Failures, ViewTracks

APPEARANCE_BINS = 72
"""Length of an appearance histogram: 8 x 8 hue-saturation bins, then 8 brightness bins of grey pixels."""

UNLABELLED = -1
"""`target_id` of a measurement that has not been assigned to a target."""


@dataclass(frozen=True, slots=True, eq=False)
class Bearings(Table):
    """What each sensor says about the direction of a target.

    A camera that delivered a frame but did not see the target has a row with
    `seen` false: that is information.  A camera without a frame has no row.
    Rows with `target_id` = -1 are candidates that may come from any object; a sensor
    may have several of them at one time.
    """

    NAME: ClassVar[str] = "bearings"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the camera or array in the scene")
    target_id: Ints32 = column("i4", "1", "target the measurement belongs to; -1 = not assigned")
    seen: Bools = column("?", "1", "true: a measurement; false: the sensor looked and did not see the target")
    bearing: Floats = column("f8", "rad", "azimuth of the sight line from +x towards +y, in [-pi, pi)", nan="not seen")
    sigma: Floats = column("f8", "rad", "standard deviation of the bearing, > 0", nan="not seen")
    u_px: Floats = column(
        "f8", "px", "horizontal offset from the principal point, to the right, in the undistorted and levelled image",
        nan="not seen, or the sensor is not a camera",
    )  # fmt: skip
    sigma_px: Floats = column("f8", "px", "standard deviation of u_px, > 0", nan="not seen, or not a camera")
    score: Floats = column("f8", "1", "likeness to the target or confidence, 0 to 1", nan="unknown or not seen")
    elevation: Floats = column(
        "f8", "rad", "of the sight line above the horizontal plane, in [-pi/2, pi/2]",
        nan="not seen, or the sensor tells none", optional=True,
    )  # fmt: skip
    sigma_elevation: Floats = column(
        "f8", "rad", "standard deviation of the elevation, > 0; of a tilted array both are about its own axes",
        nan="no elevation", optional=True,
    )  # fmt: skip
    cause: Strings = column(
        "U", "1",
        "what the fusion of detections did: empty, not fused; `kept`; `recovered`, put in where the camera missed the "
        "object; `removed`, declared false, so not of the target",
        optional=True,
    )  # fmt: skip

    def check(self) -> None:
        """Times in order, angles wrapped, measurements complete where seen and absent where not."""
        check_order(self)
        value = np.isfinite(self.bearing) & np.isfinite(self.sigma)
        if (wrong := value != self.seen).any():
            row = first_row(wrong)
            raise InputError(f"Bearings: row {row}: seen is {bool(self.seen[row])} but bearing is {self.bearing[row]}")
        if (wrong := self.sigma_px <= 0).any():
            row = first_row(wrong)
            raise InputError(f"Bearings: row {row}: sigma_px {self.sigma_px[row]:g} px must be above 0")
        bad = self.seen & ~((np.abs(self.bearing) <= np.pi) & (self.sigma > 0))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Bearings: row {row}: bearing {self.bearing[row]:g} rad must be in [-pi, pi) "
                f"and sigma {self.sigma[row]:g} rad above 0"
            )
        told = np.isfinite(self.elevation)
        bad = (told != np.isfinite(self.sigma_elevation)) | (told & ~self.seen)
        with np.errstate(invalid="ignore"):
            bad |= told & ~((np.abs(self.elevation) <= 0.5 * np.pi) & (self.sigma_elevation > 0))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Bearings: row {row}: elevation {self.elevation[row]:g} rad must be in [-pi/2, pi/2] of a row that is "
                f"seen, and sigma_elevation {self.sigma_elevation[row]:g} rad above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Views(Table):
    """People-sized clusters (or detector boxes) of every camera and frame."""

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
        "f8", "rad", "azimuth of the sight line through the centre, in [-pi, pi)", nan="camera without pose"
    )
    sigma: Floats = column("f8", "rad", "standard deviation of the bearing, > 0", nan="camera without pose")
    u_px: Floats = column("f8", "px", "as in bearings", nan="camera without pose")
    sigma_px: Floats = column("f8", "px", "standard deviation of u_px, > 0", nan="camera without pose")
    confidence: Floats = column("f8", "1", "the detector's confidence, 0 to 1", nan="not from a detector")
    likeness: Floats = column(
        "f8", "1", "Bhattacharyya coefficient with the target's appearance, 0 to 1", nan="no appearance"
    )
    target_id: Ints32 = column("i4", "1", "target that the cluster was told to be; -1 = another object, or not decided")
    appearance: Floats32 = column(
        "f4", "1", "colour histogram, sums to 1: 8x8 hue-saturation bins, then 8 brightness bins of grey pixels",
        nan="no appearance", width=APPEARANCE_BINS,
    )  # fmt: skip
    cause: Strings = column(
        "U", "1",
        "what the fusion of detections did: empty, not fused; `kept`; `recovered`, put in where the camera missed the "
        "object; `removed`, declared false, so not of the target",
        optional=True,
    )  # fmt: skip

    def check(self) -> None:
        """Times in order, boxes of positive size."""
        check_order(self)
        bad = ~((self.width_px > 0) & (self.height_px > 0))
        if bad.any():
            row = first_row(bad)
            raise InputError(
                f"Views: row {row}: box of {self.width_px[row]:g} x {self.height_px[row]:g} px must have a size above 0"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Boxes(Table):
    """A person detector's boxes, or the true ones: what is ingested instead of, or beside, video.

    A frame without any box is one row with `box` = -1 and NaN elsewhere, so that
    "looked, saw nobody" is kept apart from "no frame".
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
        """Times in order, boxes of positive size."""
        check_order(self)
        bad = (self.box >= 0) & ~((self.width_px > 0) & (self.height_px > 0))
        if bad.any():
            row = first_row(bad)
            size = f"{self.width_px[row]:g} x {self.height_px[row]:g} px"
            raise InputError(f"{type(self).__name__}: row {row}: box of {size} must have a size above 0")


@dataclass(frozen=True, slots=True, eq=False)
class TruthBoxes(Boxes):
    """True boxes of the targets in each view (columns of `Boxes`, and what is visible of them)."""

    NAME: ClassVar[str] = "truth_boxes"
    VERSION: ClassVar[int] = 2

    visible: Floats = column(
        "f8", "1", "visible share of the part that is in the image, 0 to 1", nan="the frame has no box, or not known",
        optional=True,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Doa(Table):
    """Directions of arrival from microphone arrays (or any direction finder)."""

    NAME: ClassVar[str] = "doa"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "sensor", "source_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    sensor: Strings = column("U", "1", "name of the array in the scene")
    source_id: Ints32 = column("i4", "1", "identity given by the source; -1 = none")
    azimuth: Floats = column("f8", "rad", "world azimuth from +x towards +y, in [-pi, pi)")
    elevation: Floats = column("f8", "rad", "above the horizontal plane, in [-pi/2, pi/2]", nan="planar array")
    sigma_azimuth: Floats = column("f8", "rad", "standard deviation, > 0", nan="not given: the array's noise applies")
    sigma_elevation: Floats = column("f8", "rad", "standard deviation, > 0", nan="not given or planar")
    confidence: Floats = column("f8", "1", "strength of the peak, 0 to 1", nan="not given")

    def check(self) -> None:
        """Times in order, azimuths wrapped."""
        check_order(self)
        bad = ~(np.abs(self.azimuth) <= np.pi)
        if bad.any():
            row = first_row(bad)
            raise InputError(f"Doa: row {row}: azimuth {self.azimuth[row]:g} rad must be in [-pi, pi)")


@dataclass(frozen=True, slots=True, eq=False)
class Occluders(Table):
    """Gaussian priors of the moving occluders' positions.

    A row holds everything that is known at its time: an occluder that has no row then is
    not there.  A time at which there is known to be none is one row with `occluder_id` = -1
    and NaN elsewhere, so that it is kept apart from a time at which nothing is known.
    A covariance of 0 says that the position is known.
    """

    NAME: ClassVar[str] = "occluders"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    occluder_id: Ints32 = column("i4", "1", "number of the occluder; -1 = there is none at that time")
    x: Floats = column("f8", "m", "mean position", nan="there is none")
    y: Floats = column("f8", "m", "mean position", nan="there is none")
    cov_xx: Floats = column("f8", "m^2", "position covariance", nan="there is none")
    cov_xy: Floats = column("f8", "m^2", "position covariance", nan="there is none")
    cov_yy: Floats = column("f8", "m^2", "position covariance", nan="there is none")

    def check(self) -> None:
        """Times in order, numbers where there is an occluder, covariances positive semi-definite up to rounding."""
        check_order(self)
        there: Bools = np.isfinite(self.x + self.y + self.cov_xx + self.cov_xy + self.cov_yy)
        _check_there(self, self.occluder_id, there)
        with np.errstate(invalid="ignore"):
            det = self.cov_xx * self.cov_yy - self.cov_xy**2
            bad = (self.cov_xx < 0) | (self.cov_yy < 0) | (det < -1e-9 * (self.cov_xx * self.cov_yy + 1e-300))
        if bad.any():
            raise InputError(f"Occluders: row {first_row(bad)}: the covariance is not positive semi-definite")


@dataclass(frozen=True, slots=True, eq=False)
class Hulls(Table):
    """Polygons on the ground in which the moving occluders are: the visual hull of several views.

    An occluder is anywhere in its polygon with equal probability.  As in `Occluders` a time
    without any is one row with `occluder_id` = -1.
    """

    NAME: ClassVar[str] = "hulls"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "occluder_id", "corner")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    occluder_id: Ints32 = column("i4", "1", "number of the occluder; -1 = there is none at that time")
    corner: Ints32 = column("i4", "1", "number of the corner, from 0, counter-clockwise")
    x: Floats = column("f8", "m", "position of the corner", nan="there is none")
    y: Floats = column("f8", "m", "position of the corner", nan="there is none")

    def check(self) -> None:
        """Times in order, corners from 0 on and at least three of them."""
        check_order(self)
        _check_there(self, self.occluder_id, np.isfinite(self.x) & np.isfinite(self.y))
        if not len(self):
            return
        fresh = np.ones(len(self), dtype=np.bool_)
        fresh[1:] = (np.diff(self.t_ns) != 0) | (np.diff(self.occluder_id) != 0)
        starts = np.flatnonzero(fresh)
        sizes = np.diff(np.append(starts, len(self)))
        bad = self.corner != np.arange(len(self)) - np.repeat(starts, sizes)
        bad |= np.repeat(sizes < 3, sizes) & (self.occluder_id >= 0)
        if bad.any():
            raise InputError(
                f"Hulls: row {first_row(bad)}: corners must be numbered 0, 1, 2, ... and be at least three a polygon"
            )


def _check_there(table: Table, identity: Ints32, there: Bools) -> None:
    """InputError where an occluder has no place or a row that says "none" has one."""
    if (wrong := (identity >= 0) != there).any():
        row = first_row(wrong)
        raise InputError(
            f"{type(table).__name__}: row {row}: occluder_id is {identity[row]}, "
            f"so x and y {'must be numbers' if identity[row] >= 0 else 'must be NaN'}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Truth(Table):
    """True positions on the ground of the targets and of the objects that hide them."""

    NAME: ClassVar[str] = "truth"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity; targets and occluders share one numbering")
    role: Strings = column("U", "1", "`target` or `occluder`")
    x: Floats = column("f8", "m", "position")
    y: Floats = column("f8", "m", "position")
    z: Floats = column("f8", "m", "height of the point above the ground", nan="not known")

    def check(self) -> None:
        """Times in order, known roles."""
        check_order(self)
        bad = ~np.isin(self.role, ("target", "occluder"))
        if bad.any():
            raise InputError(
                f"Truth: row {first_row(bad)}: role {self.role[first_row(bad)]!r} must be target or occluder"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Tracks(Table):
    """Estimated states on the ground, or in space, with their covariance."""

    NAME: ClassVar[str] = "tracks"
    VERSION: ClassVar[int] = 3
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity of the track")
    x: Floats = column("f8", "m", "estimated position")
    y: Floats = column("f8", "m", "estimated position")
    vx: Floats = column("f8", "m/s", "estimated velocity", nan="the method does not estimate it")
    vy: Floats = column("f8", "m/s", "estimated velocity", nan="the method does not estimate it")
    cov_xx: Floats = column("f8", "m^2", "position covariance")
    cov_xy: Floats = column("f8", "m^2", "position covariance")
    cov_yy: Floats = column("f8", "m^2", "position covariance")
    cov_x_vx: Floats = column(
        "f8", "m^2/s", "covariance of position and velocity", nan="the method does not estimate it", optional=True
    )
    cov_x_vy: Floats = column(
        "f8", "m^2/s", "covariance of position and velocity", nan="the method does not estimate it", optional=True
    )
    cov_y_vx: Floats = column(
        "f8", "m^2/s", "covariance of position and velocity", nan="the method does not estimate it", optional=True
    )
    cov_y_vy: Floats = column(
        "f8", "m^2/s", "covariance of position and velocity", nan="the method does not estimate it", optional=True
    )
    cov_vx_vx: Floats = column(
        "f8", "m^2/s^2", "velocity covariance", nan="the method does not estimate it", optional=True
    )
    cov_vx_vy: Floats = column(
        "f8", "m^2/s^2", "velocity covariance", nan="the method does not estimate it", optional=True
    )
    cov_vy_vy: Floats = column(
        "f8", "m^2/s^2", "velocity covariance", nan="the method does not estimate it", optional=True
    )
    z: Floats = column("f8", "m", "estimated height", nan="the method tracks on the ground", optional=True)
    vz: Floats = column("f8", "m/s", "estimated velocity", nan="the method does not estimate it", optional=True)
    cov_xz: Floats = column("f8", "m^2", "position covariance", nan="the method tracks on the ground", optional=True)
    cov_yz: Floats = column("f8", "m^2", "position covariance", nan="the method tracks on the ground", optional=True)
    cov_zz: Floats = column("f8", "m^2", "position covariance", nan="the method tracks on the ground", optional=True)

    def check(self) -> None:
        """Times in order, covariances positive semi-definite up to rounding."""
        check_order(self)
        det = self.cov_xx * self.cov_yy - self.cov_xy**2
        slack = 1e-9 * (self.cov_xx * self.cov_yy + 1e-300)
        bad = ~((self.cov_xx >= 0) & (self.cov_yy >= 0) & (det >= -slack)) | (self.cov_zz < 0)
        if bad.any():
            raise InputError(f"Tracks: row {first_row(bad)}: the covariance is not positive semi-definite")


@dataclass(frozen=True, slots=True, eq=False)
class Diagnostics(Table):
    """How a filter fared at each step."""

    NAME: ClassVar[str] = "diagnostics"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity of the track")
    ess: Floats = column(
        "f8", "1", "effective sample size of the weights, 1 to the number of particles",
        nan="the method has no particles",
    )  # fmt: skip
    log_likelihood: Floats = column(
        "f8", "1",
        "log of the predictive likelihood of the scan; of a batch method and `fix`: of the likelihood at the estimate",
        nan="no measurement had weight",
    )  # fmt: skip
    n_looked: Ints32 = column("i4", "1", "sensors that delivered a frame in the scan")
    n_seen: Ints32 = column("i4", "1", "sensors that saw the target")
    fallback: Strings = column(
        "U", "1",
        "empty, `sir` (auxiliary stage skipped), `restart` (particles drawn anew), `gap` (the same after a long gap); "
        "of a batch method `unobservable` (the position is hardly known), `contradiction` (constraints that no place "
        "holds were left out, with what was seen then), `wall` (no way around a wall was found) or `unfinished` (the "
        "search did not converge); of `fix` `pair` (two lines, whose spread is as stated) or `stated` (the spread was "
        "not found)",
    )  # fmt: skip
    cameras: Strings = column("U", "1", "sensors used in the scan, separated by commas")
    n_offered: Ints32 = column("i4", "1", "sensors that had a frame since the last row, asked for it or not")
    selected: Strings = column("U", "1", "cameras selected, separated by commas; empty: no selection")
    predicted_mse: Floats = column(
        "f8", "m^2", "mean square error expected of the cameras selected since the last row",
        nan="none was selected anew",
    )  # fmt: skip

    def check(self) -> None:
        """Times in order."""
        check_order(self)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration(Table):
    """Errors of the sensors' poses, true minus stated, as a filter that estimates them has them after each scan."""

    NAME: ClassVar[str] = "calibration"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id", "sensor")

    t_ns: Ints = column("i8", "ns", "time of the scan since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity of the track; every track has its own estimates")
    sensor: Strings = column("U", "1", "name of the camera or array in the scene")
    dx: Floats = column("f8", "m", "error of the position: add it to the scene's")
    dy: Floats = column("f8", "m", "error of the position: add it to the scene's")
    dyaw: Floats = column("f8", "rad", "error of the yaw: add it to the scene's")
    sd_dx: Floats = column("f8", "m", "standard deviation")
    sd_dy: Floats = column("f8", "m", "standard deviation")
    sd_dyaw: Floats = column("f8", "rad", "standard deviation")

    def check(self) -> None:
        """Times in order."""
        check_order(self)


@dataclass(frozen=True, slots=True, eq=False)
class Errors(Table):
    """Estimate minus truth at each time of the estimate."""

    NAME: ClassVar[str] = "errors"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("i8", "ns", "time of the estimate since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity of the target")
    x: Floats = column("f8", "m", "estimated position")
    y: Floats = column("f8", "m", "estimated position")
    truth_x: Floats = column("f8", "m", "true position, interpolated to the time of the estimate")
    truth_y: Floats = column("f8", "m", "true position, interpolated to the time of the estimate")
    error_x: Floats = column("f8", "m", "estimate minus truth")
    error_y: Floats = column("f8", "m", "estimate minus truth")
    error: Floats = column("f8", "m", "distance between estimate and truth on the ground")
    nees: Floats = column("f8", "1", "normalised squared error e' P^-1 e", nan="the covariance is singular")
    z: Floats = column("f8", "m", "estimated height", nan="no height is estimated", optional=True)
    truth_z: Floats = column("f8", "m", "true height", nan="not known", optional=True)
    error_z: Floats = column("f8", "m", "estimate minus truth", nan="either is not known", optional=True)
    error_space: Floats = column(
        "f8", "m", "distance between estimate and truth in space", nan="no height is known", optional=True
    )
    nees_space: Floats = column(
        "f8", "1", "normalised squared error in space", nan="no height is known, or the covariance is singular",
        optional=True,
    )  # fmt: skip

    def check(self) -> None:
        """Times in order."""
        check_order(self)


@dataclass(frozen=True, slots=True, eq=False)
class Bound(Table):
    """Posterior Cramer-Rao bound of the position for the sensors that really saw the target."""

    NAME: ClassVar[str] = "bound"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("i8", "ns", "time since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity of the target")
    bound_xx: Floats = column("f8", "m^2", "lower bound of the error covariance")
    bound_xy: Floats = column("f8", "m^2", "lower bound of the error covariance")
    bound_yy: Floats = column("f8", "m^2", "lower bound of the error covariance")
    bound: Floats = column("f8", "m", "square root of bound_xx + bound_yy: lower bound of the RMSE on the ground")
    n_seen: Ints32 = column("i4", "1", "sensors that saw the target")
    bound_xz: Floats = column(
        "f8", "m^2", "lower bound of the error covariance", nan="a bound on the ground", optional=True
    )
    bound_yz: Floats = column(
        "f8", "m^2", "lower bound of the error covariance", nan="a bound on the ground", optional=True
    )
    bound_zz: Floats = column(
        "f8", "m^2", "lower bound of the error covariance", nan="a bound on the ground", optional=True
    )
    bound_space: Floats = column(
        "f8", "m", "square root of the trace in space: lower bound of the RMSE there", nan="a bound on the ground",
        optional=True,
    )  # fmt: skip

    def check(self) -> None:
        """Times in order."""
        check_order(self)


@dataclass(frozen=True, slots=True, eq=False)
class Cooperation(Table):
    """When a tracker of sounds asked cameras where its targets are, why, and what they said.

    Each row is one request for one target; several at one time share their frames, which
    are counted in the first of them.
    """

    NAME: ClassVar[str] = "cooperation"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("i8", "ns", "time of the request since the Unix epoch")
    target_id: Ints32 = column("i4", "1", "identity of the track; -1 = asked for whoever is there")
    cause: Strings = column(
        "U",
        "1",
        "what made it ask: `periodic`, `count`, `bearing`, `ellipse`, `spread`, several separated by commas; "
        "`shared`: nobody asked, but frames that were looked at show it",
    )
    cameras: Strings = column("U", "1", "cameras that were asked, separated by commas")
    frames: Ints32 = column("i4", "1", "frames that were asked for, answered or not; 0: counted in another row")
    answered: Bools = column("?", "1", "the cameras localised the target")
    x: Floats = column("f8", "m", "position that they found", nan="not answered")
    y: Floats = column("f8", "m", "position that they found", nan="not answered")
    cov_xx: Floats = column("f8", "m^2", "position covariance", nan="not answered")
    cov_xy: Floats = column("f8", "m^2", "position covariance", nan="not answered")
    cov_yy: Floats = column("f8", "m^2", "position covariance", nan="not answered")

    def check(self) -> None:
        """Times in order, a place where and only where there was an answer."""
        check_order(self)
        if (wrong := self.answered != np.isfinite(self.x + self.y)).any():
            row = first_row(wrong)
            raise InputError(f"Cooperation: row {row}: answered is {self.answered[row]} but x is {self.x[row]:g}")


TABLES: dict[str, type[Table]] = {
    table.NAME: table
    for table in (
        Bearings,
        Views,
        Boxes,
        TruthBoxes,
        Doa,
        Occluders,
        Hulls,
        Truth,
        Tracks,
        Diagnostics,
        Calibration,
        Errors,
        Bound,
        Cooperation,
        ViewTracks,
        Failures,
    )
}
"""Every table by the name that its files carry."""
