"""The tables of trackers on the ground or in space, and of their evaluation.  Conventions: see `tables`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from occlog.array_types import Bools, Floats, Ints, Ints32, Strings
from occlog.errors import InputError
from occlog.records.columns import ColumnTable, column, first_row, semidefinite

EXTERNAL = "not known: tracks of another program"
NOT_ESTIMATED = "the method does not estimate it"
ON_GROUND = "the method tracks on the ground"
UNRELIABLE = "why the position is not reliable, separated by commas; empty: no reason was found."


@dataclass(frozen=True, slots=True, eq=False)
class Tracks(ColumnTable):
    """Estimated states of targets on the ground, or in space: position, velocity and their covariance in the world."""

    NAME: ClassVar[str] = "tracks"
    VERSION: ClassVar[int] = 3
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")
    ONCE: ClassVar[bool] = True

    t_ns: Ints = column("time since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track")
    x: Floats = column("estimated position", "m")
    y: Floats = column("estimated position", "m")
    vx: Floats = column("estimated velocity", "m/s", nan=NOT_ESTIMATED)
    vy: Floats = column("estimated velocity", "m/s", nan=NOT_ESTIMATED)
    cov_xx: Floats = column("position covariance", "m^2", nan=EXTERNAL)
    cov_xy: Floats = column("position covariance", "m^2", nan=EXTERNAL)
    cov_yy: Floats = column("position covariance", "m^2", nan=EXTERNAL)
    cov_x_vx: Floats = column("covariance of position and velocity", "m^2/s", nan=NOT_ESTIMATED, optional=True)
    cov_x_vy: Floats = column("covariance of position and velocity", "m^2/s", nan=NOT_ESTIMATED, optional=True)
    cov_y_vx: Floats = column("covariance of position and velocity", "m^2/s", nan=NOT_ESTIMATED, optional=True)
    cov_y_vy: Floats = column("covariance of position and velocity", "m^2/s", nan=NOT_ESTIMATED, optional=True)
    cov_vx_vx: Floats = column("velocity covariance", "m^2/s^2", nan=NOT_ESTIMATED, optional=True)
    cov_vx_vy: Floats = column("velocity covariance", "m^2/s^2", nan=NOT_ESTIMATED, optional=True)
    cov_vy_vy: Floats = column("velocity covariance", "m^2/s^2", nan=NOT_ESTIMATED, optional=True)
    z: Floats = column("estimated height", "m", nan=ON_GROUND, optional=True)
    vz: Floats = column("estimated velocity", "m/s", nan=NOT_ESTIMATED, optional=True)
    cov_xz: Floats = column("position covariance", "m^2", nan=ON_GROUND, optional=True)
    cov_yz: Floats = column("position covariance", "m^2", nan=ON_GROUND, optional=True)
    cov_zz: Floats = column("position covariance", "m^2", nan=ON_GROUND, optional=True)

    def check(self) -> None:
        """InputError unless covariances are positive semidefinite (up to rounding) or NaN."""
        unknown = np.isnan(self.cov_xx) & np.isnan(self.cov_xy) & np.isnan(self.cov_yy)
        bad = ~(unknown | semidefinite(self.cov_xx, self.cov_xy, self.cov_yy)) | (self.cov_zz < 0)
        self.refuse(bad, "the covariance (cov_xx, cov_xy, cov_yy, cov_zz) is not positive semi-definite")

    def with_covariance(self) -> Self:
        """Return this table itself; InputError if any position has no covariance (`cov_xx` is NaN)."""
        if (unknown := np.isnan(self.cov_xx)).any():
            raise InputError(
                f"tracks: row {first_row(unknown)} (target {self.target_id[first_row(unknown)]}) has no "
                "covariance, which is required here; give columns cov_xx, cov_xy, cov_yy",
                id="missing-column",
            )
        return self


@dataclass(frozen=True, slots=True, eq=False)
class FusedTracks(Tracks):
    """Tracks in the world, fused from tracks in the images of several cameras; every command reads them as `Tracks`."""

    seen_by: Strings = column("views that made the position, separated by commas", optional=True)
    quality_flags: Strings = column(
        f"{UNRELIABLE} `single_view` (one view alone made it), `inconsistent_views` (a view is more likely on "
        "something else than not, or was omitted), `possible_switch` (the target is likely to have taken "
        "another one's identity)",
        optional=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class TagTracks(Tracks):
    """Tracks of radio tags, estimated from the reads of tag readers; every command reads them as `Tracks`."""

    read_by: Strings = column("readers that detected the tag, separated by commas", optional=True)
    refined_by: Strings = column("cameras that refined the position, separated by commas", optional=True)
    quality_flags: Strings = column(
        f"{UNRELIABLE} `no_matching_region` (no position is in the range of just these readers), `restart` (no "
        "particle explained the reads), `depleted` (fewer than ten effective particles: the covariance is unreliable)",
        optional=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class VirtualSensors(ColumnTable):
    """Regions into which the ranges of tag readers divide the floor.

    A row is the region that a set of readers covers and all others do not.
    """

    NAME: ClassVar[str] = "virtual_sensors"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "readers")

    t_ns: Ints = column("time of the first read since the Unix epoch; readers do not move", "ns")
    readers: Strings = column("readers that cover the region, and all others do not, separated by commas")
    count: Ints32 = column("number of these readers")
    area: Floats = column("area of the region", "m^2")
    x: Floats = column("centroid of the region, its reference point", "m")
    y: Floats = column("centroid of the region, its reference point", "m")
    cov_xx: Floats = column("covariance of a position that is even over the region", "m^2")
    cov_xy: Floats = column("covariance of a position that is even over the region", "m^2")
    cov_yy: Floats = column("covariance of a position that is even over the region", "m^2")

    def check(self) -> None:
        """InputError unless areas and numbers of readers are not negative."""
        self.refuse((self.area < 0.0) | (self.count < 0), "area and count must not be below 0")


@dataclass(frozen=True, slots=True, eq=False)
class Diagnostics(ColumnTable):
    """Diagnostics of a filter: a row per target and scan with likelihood, sensors used and quality flags."""

    NAME: ClassVar[str] = "diagnostics"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("time since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track")
    ess: Floats = column(
        "effective sample size of the weights, 1 to the number of particles", nan="the method has no particles"
    )
    log_likelihood: Floats = column(
        "log of the predictive likelihood of the scan; of a batch method and `fix`: of the likelihood at the estimate",
        nan="no measurement had weight",
    )
    n_observing: Ints32 = column("sensors that delivered a frame in the scan")
    n_detected: Ints32 = column("sensors that saw the target")
    fallback: Strings = column(
        "empty, `sir` (auxiliary stage skipped), `restart` (particles resampled), `gap` (the same after a long gap), "
        "`depleted` (fewer than ten effective particles: the covariance is unreliable); of a batch method "
        "`unobservable` (the position is hardly known), `infeasible_constraints` (constraints no position holds were "
        "omitted, with what was seen then), `no_path` (no way around a wall was found), `not_converged` (the search "
        "did not converge), `few_inliers` (fewer than half of the bearings are accepted) or `rival_mode` (another "
        "trajectory that is nearly as probable is elsewhere); of `fix` `two_lines` (two lines, with a spread as "
        "stated), `stated` (the spread was not found), `ambiguous` (measurements fit several positions), `unverified`"
        " (two measurements fix it, and none of the others agrees) or `possible_outlier` (one that is accepted may be"
        " false: another position is possible, or they scatter too much); of `ekf`, `ukf` and `iekf` `inflated` (most"
        " bearings disagreed with the prediction, which was made wider), `no_sigma_points` (no sigma point was left) "
        "or `infeasible` (the search ended where cameras cannot see)"
    )
    cameras: Strings = column("sensors used in the scan, separated by commas")
    n_available: Ints32 = column("sensors that had a frame since the last row, asked for it or not")
    selected: Strings = column("cameras selected, separated by commas; empty: no selection")
    predicted_mse: Floats = column(
        "mean square error expected of the cameras selected since the last row", "m^2", nan="no selection"
    )
    seen_by: Strings = column(
        "sensors that saw the target, separated by commas; empty: none, or the method does not report them",
        optional=True,
    )
    quality_flags: Strings = column(
        "why the estimate is not reliable, separated by commas; empty: no reason was found. `region_edge` (the target"
        " may be at the edge of the region that was guessed for a scene without a room), `single_sensor` (one sensor "
        "alone saw the target for long, which leaves its distance unknown), `out_of_view` (half or more of the "
        "sensors that report the target have it outside of their field of view or range), `undetected_in_view` "
        "(cameras with a plain view of the estimate missed the target too often, since it was last detected, for "
        "chance: with a probability of 1e-5), `inconsistent_sensor` (two thirds or more of what one sensor measured "
        "of the target in the last second, five bearings at least, are rejected), `exchanged_labels` (its labels and "
        "those of another target are exchanged here), `label_jump` (its label continues at another position, faster "
        "than targets move)",
        optional=True,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Particles(ColumnTable):
    """Particles of each target: weighted positions at each time."""

    NAME: ClassVar[str] = "particles"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id", "particle")

    t_ns: Ints = column("time of the estimate since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track")
    particle: Ints32 = column("number of the particle at that time, from 0; no particle keeps its number")
    x: Floats = column("position", "m")
    y: Floats = column("position", "m")
    weight: Floats = column("its weight; those of one target and time have the sum 1")

    def check(self) -> None:
        """InputError unless weights are from 0 to 1."""
        self.refuse(~((self.weight >= 0.0) & (self.weight <= 1.0 + 1e-9)), "weight {weight:g} must be 0 to 1")


@dataclass(frozen=True, slots=True, eq=False)
class Residuals(ColumnTable):
    """Normalised residual of each bearing that was used against the estimate, and its inlier probability."""

    NAME: ClassVar[str] = "residuals"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id", "sensor")

    t_ns: Ints = column("time of the estimate since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track")
    sensor: Strings = column("name of the camera or array in the scene")
    residual: Floats = column(
        "the bearing minus that of the estimate, in standard deviations as stated; without a sign where the estimate "
        "is not in front of the camera"
    )
    expected_variance: Floats = column(
        "variance that the residual has if the bearing is true: below 1, since the estimate follows it"
    )
    inlier_probability: Floats = column("probability that the bearing is true, given the estimate; 0 behind a camera")

    def check(self) -> None:
        """InputError unless inlier probabilities are from 0 to 1, and variances not negative."""
        bad = ~((self.inlier_probability >= 0.0) & (self.inlier_probability <= 1.0) & (self.expected_variance >= 0.0))
        self.refuse(bad, "inlier_probability must be 0 to 1 and expected_variance at least 0")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration(ColumnTable):
    """Errors of the sensors' poses, true minus stated, as a filter estimates them, with standard deviations.

    A row for each track and sensor after each scan.
    """

    NAME: ClassVar[str] = "calibration"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id", "sensor")

    t_ns: Ints = column("time of the scan since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track; every track has its own estimates")
    sensor: Strings = column("name of the camera or array in the scene")
    dx: Floats = column("error of the position: add it to the scene's", "m")
    dy: Floats = column("error of the position: add it to the scene's", "m")
    dyaw: Floats = column("error of the yaw: add it to the scene's", "rad")
    sd_dx: Floats = column("standard deviation", "m")
    sd_dy: Floats = column("standard deviation", "m")
    sd_dyaw: Floats = column("standard deviation", "rad")


@dataclass(frozen=True, slots=True, eq=False)
class Errors(ColumnTable):
    """Estimate minus truth at each time of an estimate, with the normalised estimation error squared (NEES)."""

    NAME: ClassVar[str] = "errors"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("time of the estimate since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the target")
    x: Floats = column("estimated position", "m")
    y: Floats = column("estimated position", "m")
    truth_x: Floats = column("true position, interpolated to the time of the estimate", "m")
    truth_y: Floats = column("true position, interpolated to the time of the estimate", "m")
    error_x: Floats = column("estimate minus truth", "m")
    error_y: Floats = column("estimate minus truth", "m")
    error: Floats = column("distance between estimate and truth on the ground", "m")
    nees: Floats = column("normalised squared error e' P^-1 e", nan="the covariance is singular")
    z: Floats = column("estimated height", "m", nan="no height is estimated", optional=True)
    truth_z: Floats = column("true height", "m", nan="not known", optional=True)
    error_z: Floats = column("estimate minus truth", "m", nan="either is not known", optional=True)
    error_space: Floats = column(
        "distance between estimate and truth in space", "m", nan="no height is known", optional=True
    )
    nees_space: Floats = column(
        "normalised squared error in space", nan="no height is known, or the covariance is singular", optional=True
    )


MIN_SMOOTHED = "with everything known that was seen later, too: lower bound of the error"
NO_SMOOTHED = "made by an older version"
NO_HEIGHT = "a bound on the ground"


@dataclass(frozen=True, slots=True, eq=False)
class Bound(ColumnTable):
    """Posterior Cramer-Rao bound of the position error, for the sensors that detected the target at each time."""

    NAME: ClassVar[str] = "bound"
    VERSION: ClassVar[int] = 2
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("time since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the target")
    bound_xx: Floats = column("lower bound of the error covariance", "m^2")
    bound_xy: Floats = column("lower bound of the error covariance", "m^2")
    bound_yy: Floats = column("lower bound of the error covariance", "m^2")
    bound: Floats = column("square root of bound_xx + bound_yy: lower bound of the RMSE on the ground", "m")
    n_detected: Ints32 = column("sensors that saw the target")
    bound_xz: Floats = column("lower bound of the error covariance", "m^2", nan=NO_HEIGHT, optional=True)
    bound_yz: Floats = column("lower bound of the error covariance", "m^2", nan=NO_HEIGHT, optional=True)
    bound_zz: Floats = column("lower bound of the error covariance", "m^2", nan=NO_HEIGHT, optional=True)
    bound_space: Floats = column(
        "square root of the trace in space: lower bound of the RMSE there",
        "m",
        nan=NO_HEIGHT,
        optional=True,
    )
    smoothed_xx: Floats = column(f"{MIN_SMOOTHED} covariance", "m^2", nan=NO_SMOOTHED, optional=True)
    smoothed_xy: Floats = column(f"{MIN_SMOOTHED} covariance", "m^2", nan=NO_SMOOTHED, optional=True)
    smoothed_yy: Floats = column(f"{MIN_SMOOTHED} covariance", "m^2", nan=NO_SMOOTHED, optional=True)
    smoothed: Floats = column(f"{MIN_SMOOTHED} RMSE on the ground", "m", nan=NO_SMOOTHED, optional=True)
    smoothed_zz: Floats = column(f"{MIN_SMOOTHED} covariance", "m^2", nan=NO_HEIGHT, optional=True)
    smoothed_space: Floats = column(f"{MIN_SMOOTHED} RMSE in space", "m", nan=NO_HEIGHT, optional=True)


@dataclass(frozen=True, slots=True, eq=False)
class Cooperation(ColumnTable):
    """Requests of an acoustic tracker to cameras for positions of its targets: cause, cameras, and the answer.

    Each row is one request for one target; several at one time share their frames, which are counted in the first of
    them.
    """

    NAME: ClassVar[str] = "cooperation"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "target_id")

    t_ns: Ints = column("time of the request since the Unix epoch", "ns")
    target_id: Ints32 = column("identity of the track; -1 = asked for whoever is there")
    cause: Strings = column(
        "what made it ask: `periodic`, `count`, `bearing`, `ellipse`, `spread`, several separated by commas; "
        "`shared`: not requested, but observed frames show it"
    )
    cameras: Strings = column("cameras that were asked, separated by commas")
    frames: Ints32 = column("frames that were asked for, answered or not; 0: counted in another row")
    answered: Bools = column("the cameras localised the target")
    x: Floats = column("position that they found", "m", nan="not answered")
    y: Floats = column("position that they found", "m", nan="not answered")
    cov_xx: Floats = column("position covariance", "m^2", nan="not answered")
    cov_xy: Floats = column("position covariance", "m^2", nan="not answered")
    cov_yy: Floats = column("position covariance", "m^2", nan="not answered")

    def check(self) -> None:
        """InputError unless exactly the answered requests have positions."""
        there = np.isfinite(self.x) & np.isfinite(self.y)
        self.refuse(
            self.answered != there,
            "answered is {answered} but x is {x:g}; x and y are numbers if answered, else NaN",
        )
