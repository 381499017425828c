"""Fisher information of measurements about target positions, and motion model and prior of the bound.

The information of a camera is that of Eq. 2 of [Ercan] with the bearing's own read noise, about (x, y)
only.  Directions without pixels have their standard deviations, which are of angles about the sensor's
own z axis, whatever its pose ([Lee] Eq. 2.40).

`DistancesOfTargets` packs distance measurements of true targets from a stream.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.bounds import in_plane as crlb
from occlog.core.bounds import in_space as bounds3d
from occlog.errors import InputError, option
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.observations import SensorObservations
from occlog.evaluate.matching.paths import ObjectPath, SensorGeometry
from occlog.filtering.likelihood.distances import RangeMeasurements
from occlog.filtering.likelihood.distances import information as distance_information
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene
from occlog.records.tables import Bound
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import (
    LastReads,
    Radio,
    RangeDifferenceCheck,
    make_stations,
    pack,
    with_strengths,
)


def ground_information(sensor: SensorGeometry, seen: SensorObservations) -> Floats:
    """Return the Fisher information (N, 2, 2) of one sensor's bearings about the target's (x, y).

    Elevations inform about the height only. In the frame of a tilted array the world azimuth has errors of both of its
    angles: both are used at the true height (or at that of the measured elevation), and the height is eliminated (Schur
    complement). The result is the information of the azimuth with its actual variance.
    """
    information = _without_pixels(sensor, seen)
    if sensor.camera is None:
        return information
    pixels = np.isfinite(seen.sigma_px)
    return np.asarray(np.where(pixels[:, None, None], _of_pixels(sensor, seen, pixels), information))


def space_information(sensor: SensorGeometry, seen: SensorObservations) -> Floats:
    """Return the Fisher information (N, 3, 3) of all measurements of one sensor about the target's (x, y, z).

    Rows without elevation, and planar arrays (with world azimuths), contribute the azimuth only.
    """
    pixels = np.isfinite(seen.sigma_px) & (sensor.camera is not None)
    tells = np.isfinite(seen.elevation)
    sigma_theta = np.where(pixels, np.inf, seen.sigma)
    sigma_phi = np.where(tells, seen.sigma_elevation, np.inf)
    xyz = np.column_stack([seen.xy, seen.z])
    total = bounds3d.direction_information(
        xyz, position=sensor.position, rotation=np.eye(3), sigma_theta=sigma_theta, sigma_phi=sigma_phi
    )
    if not sensor.upright:
        own = bounds3d.direction_information(
            xyz, position=sensor.position, rotation=sensor.rotation, sigma_theta=sigma_theta, sigma_phi=sigma_phi
        )
        total = np.where(tells[:, None, None], own, total)
    if pixels.any():
        total[:, :2, :2] += np.where(pixels[:, None, None], _of_pixels(sensor, seen, pixels), 0.0)
    return total


def _of_pixels(sensor: SensorGeometry, seen: SensorObservations, pixels: Bools) -> Floats:
    camera = sensor.camera
    assert camera is not None
    noise = np.where(pixels, seen.sigma_px, 1.0)
    return crlb.camera_information(
        seen.xy,
        position=sensor.ground,
        yaw=camera.yaw,
        focal_px=float(camera.focal_px[0]),
        sigma_position=camera.sigma_position,
        sigma_yaw=camera.sigma_yaw,
        sigma_read_px=noise,
    )


def _without_pixels(sensor: SensorGeometry, seen: SensorObservations) -> Floats:
    by_azimuth = crlb.bearing_information(seen.xy, sensor.ground, seen.sigma)
    tells = np.isfinite(seen.elevation)
    if sensor.upright or not tells.any():
        return by_azimuth
    flat = np.hypot(*(seen.xy - sensor.ground).T)
    z = np.where(np.isnan(seen.z), sensor.height + flat * np.tan(seen.elevation), seen.z)
    xyz = np.column_stack([seen.xy, np.where(tells, z, sensor.height)])
    sigma_phi = np.where(tells, seen.sigma_elevation, np.inf)
    whole = bounds3d.direction_information(
        xyz, position=sensor.position, rotation=sensor.rotation, sigma_theta=seen.sigma, sigma_phi=sigma_phi
    )
    return np.asarray(np.where(tells[:, None, None], bounds3d.ground_information(whole), by_azimuth))


class StationMeasurements(NamedTuple):
    """m distance measurements of true targets from stations.

    `t_ns`: (m,) times [ns]; `target`: (m,) identities in the truth; `distances`: the measurements.
    """

    t_ns: Ints  # (m,)
    target: Ints  # (m,) identity in the truth
    distances: RangeMeasurements  # m measurements


def distances_in_space() -> InputError:
    """Return the error (InputError) that distances cannot be used for a bound in space."""
    return InputError(
        f"evaluate: measured distances enter only the bound on the ground; give {option('bound_dimension')} ground",
        id="not-applicable",
    )


def dimension(target: int, *, high: bool, in_space: bool, config: EvaluateConfig) -> int:
    """Return the dimension of a target's bound, 2 (ground) or 3 (space).

    With the setting `auto` it is 3 if an error in space is known. InputError if it is 3 and no true height is known.

    Args:
        target: identity in the truth.
        high: whether its true height is known at some time.
        in_space: whether one of its errors is in space.
        config: has `bound_dimension`.
    """
    if config.bound_dimension == "ground" or (config.bound_dimension == "auto" and not in_space):
        return 2
    if not high:
        raise InputError(
            f"truth: target {target} has no height (z), which a bound in space needs; "
            f"give {option('bound_dimension')} ground",
            id="missing-value",
        )
    return 3


def bound_table(t_ns: Ints, target: int, covariance: Floats, smoothed: Floats, n_seen: Ints) -> Bound:
    """Return table rows of the bound of a target at T times.

    Args:
        t_ns: (T,) times [ns].
        target: its identity.
        covariance: (T, d, d) filtering bound of the position, d = 2 or 3.
        smoothed: (T, d, d) smoothing bound of the position.
        n_seen: (T,) number of measurements at each time.
    """
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    space = {}
    if covariance.shape[1] == 3:
        zz = covariance[:, 2, 2]
        space = {
            "bound_xz": covariance[:, 0, 2],
            "bound_yz": covariance[:, 1, 2],
            "bound_zz": zz,
            "bound_space": np.sqrt(xx + yy + zz),
            "smoothed_zz": smoothed[:, 2, 2],
            "smoothed_space": np.sqrt(np.trace(smoothed, axis1=1, axis2=2)),
        }
    return Bound.of(
        t_ns=t_ns,
        target_id=np.full(len(t_ns), target, dtype=np.int32),
        bound_xx=xx,
        bound_xy=xy,
        bound_yy=yy,
        bound=np.sqrt(xx + yy),
        n_detected=n_seen.astype(np.int32),
        smoothed_xx=smoothed[:, 0, 0],
        smoothed_xy=smoothed[:, 0, 1],
        smoothed_yy=smoothed[:, 1, 1],
        smoothed=np.sqrt(smoothed[:, 0, 0] + smoothed[:, 1, 1]),
        **space,
    )


def information_of(
    times: Ints, observations: Mapping[str, SensorObservations], sensors: Mapping[str, SensorGeometry], d: int
) -> tuple[Floats, Ints]:
    """Return the Fisher information (T, d, d) about a target's position at each time, and the number of bearings (T,).

    Args:
        times: (T,) increasing times [ns], among them those of all observations.
        observations: observations of the target, by sensor.
        sensors: by name.
        d: 2 on the ground, 3 in space.
    """
    total, n_seen = np.zeros((len(times), d, d)), np.zeros(len(times), dtype=np.int64)
    of_sensor = space_information if d == 3 else ground_information
    for name, all_observations in observations.items():
        seen = all_observations.take(counted(all_observations))
        at = np.searchsorted(times, seen.t_ns)
        np.add.at(total, at, of_sensor(sensors[name], seen))
        np.add.at(n_seen, at, 1)
    return total, n_seen


def add_distances(
    information: Floats,
    n_seen: Ints,
    times: Ints,
    measured: StationMeasurements,
    target: int,
    path: ObjectPath,
    config: EvaluateConfig,
) -> None:
    """Add the Fisher information of a target's distance measurements at its true positions, in place.

    Args:
        information: (T, 2, 2) at each time; changed.
        n_seen: (T,) numbers of measurements; increased.
        times: (T,) increasing times [ns], among them those of the measurements.
        measured: measurements of all targets.
        target: identity of the target.
        path: its true positions; measurements at times without one are skipped.
        config: largest gap that is interpolated.
    """
    own = measured.target == target
    t_ns = measured.t_ns[own]
    xy, known = path.at(t_ns, config.limit_ns)
    rows = measured.distances.take(own).take(known)
    at = np.searchsorted(times, t_ns[known])
    np.add.at(information, at, distance_information(rows, xy[known]))
    np.add.at(n_seen, at, 1)


def counted(observations: SensorObservations) -> Bools:
    """Return the mask (N,) of reported bearings that can be of the target: it is in view, or they are in the gate."""
    return observations.reported & (observations.in_view | observations.hit)


def motion_of(information: Floats, dt: Floats, scene: Scene, config: EvaluateConfig) -> tuple[Floats, Floats, Floats]:
    """Return the inputs of the recursion of the bound: information about the state, transition matrices, process noise.

    Args:
        information: (T, d, d) Fisher information about the position.
        dt: (T,) time since the step before [s]; 0 for the first.
        scene: its unit of lengths is that of the process noise.
        config: the motion.

    Returns:
        Three arrays (T, n, n); n is d for motion `waypoint`, else 2d: position, then velocity.
    """
    if config.motion == "waypoint":
        usual = EvaluateConfig.in_unit(scene.length_unit)
        sigma_v = (
            usual.process_noise_position if config.process_noise_position is None else config.process_noise_position
        )
        return information, *crlb.known_drift_steps(dt, sigma_v or 0.0, information.shape[1])
    return bounds3d.motion_steps(information, dt, config.process_noise_density)


def prior_of(d: int, scene: Scene, config: EvaluateConfig) -> Floats:
    """Return the prior covariance (n, n) of the state: the position as configured, else uniform in the room.

    Args:
        d: 2 on the ground, 3 in space; n is d for motion `waypoint`, else 2d (position, then velocity).
        scene: floor polygon and height of the room.
        config: covariances and motion.
    """
    position = np.zeros((d, d))
    if config.prior_covariance is None:
        position[:2, :2] = crlb.polygon_covariance(scene.region)
    else:
        xx, xy, yy = config.prior_covariance
        position[:2, :2] = [[xx, xy], [xy, yy]]
    if d == 3:
        position[2, 2] = scene.room_height**2 / 12.0 if config.prior_variance_z is None else config.prior_variance_z
    if config.motion == "waypoint":
        return position
    out = np.zeros((2 * d, 2 * d))
    out[:d, :d], out[d:, d:] = position, config.sigma_initial_velocity**2 * np.eye(d)
    return out


class DistancesOfTargets:
    """Converts a stream of distance measurements, or signal strengths, into distances of true targets to stations."""

    def __init__(
        self, labels: Mapping[int, int], scene: Scene, config: DistanceMeasurementConfig, radio: Radio | None
    ) -> None:
        """Start without measurements.

        Args:
            labels: identity in the measurements to identity in the truth; rows of other identities are skipped.
            scene: the stations.
            config: settings for what the measurements do not state, such as standard deviations.
            radio: a fitted path loss model; None: from the scene and the settings.
        """
        self._labels, self._config, self._radio = labels, config, radio
        self._stations = make_stations(scene, config, radio)
        self._last: LastReads = {}
        self._differences = RangeDifferenceCheck()

    def add(self, rows: Measurements) -> StationMeasurements:
        """Convert further rows, which are whole time steps, in the order of time; return the distances of true targets.

        Raises:
            InputError: a station is unknown or a measurement is invalid (as `pack`).
        """
        own = rows.take(np.isin(rows.target_id, list(self._labels)))
        own = with_strengths(own, self._config, self._radio, self._last)
        row, found = pack(own, self._stations, self._config, self._radio, self._differences)
        target = np.array([self._labels[k] for k in own.target_id[row].tolist()], dtype=np.int64)
        return StationMeasurements(own.t_ns[row], target, found)

    def finish(self) -> None:
        """Check the range differences after the last row.

        Raises:
            InputError: most of them exceed the distance of their stations.
        """
        self._differences.refuse()
