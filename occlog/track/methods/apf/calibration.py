"""Errors of the cameras' poses, estimated while a target is tracked or before ([Ercan] Sec. 4.2 names both).

`joint`: after every scan the belief about the errors is updated (`occlog.track.methods.apf.kernels.pose_errors`);
the filter weighs its particles with corrected cameras, and with what is still uncertain about
them instead of `sigma_position` and `sigma_yaw`.  `initial`: the first `calibration_s` seconds
are tracked as without, then all their bearings are solved at once, and that stays.

Both compare errors that stay with errors resampled for every scan, which is what Eq. 2 states
(`PoseErrorBelief.log_odds`), and correct nothing while the latter explains the bearings better.

What cannot be observed (where all cameras together are) is an error of the track that more
scans do not make smaller; it is added to the covariance of the estimate, as a
Schmidt-Kalman filter does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats
from occlog.core.geometry.camera import angles_from_rotation, rotation_from_angles
from occlog.core.geometry.visibility import Sensors
from occlog.core.plane import inside_polygon
from occlog.filtering.likelihood.directions import PackedScan, PoseNoise
from occlog.filtering.particles import mean_and_covariance
from occlog.records.scene import Camera, Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import Estimate, SensorErrors
from occlog.track.methods.apf.kernels.pose_errors import (
    LabelledBearings,
    PoseErrorBelief,
    jacobians,
    prior_belief,
    residuals,
    solve,
    spread,
    update,
)

from .model import MIN_SIGMA, pack_sensors

MAX_CLOUD_ANGLE = 0.1
"""Particles this near together, relative to their distance, see a camera under one angle as far as Eq. 2 goes."""
REPACK_SHIFT_SIGMAS = 0.05
"""Corrected cameras are packed again when an estimate has moved by this share of its prior deviation."""
MIN_LOG_ODDS = 3.0
"""Log-odds from which on errors are taken to stay: 20 to 1."""
GATE_SIGMAS = 4.0
"""A bearing that misses the estimate by more standard deviations had no weight in it."""
MAX_INITIAL_SCANS = 1000
"""Scans that the initial phase keeps at most; of more every second is dropped, and so on."""


class StatedSensors(NamedTuple):
    """The S sensors of a scene (cameras, then arrays) with their poses as stated in the scene, in the kernels' form.

    `noise` has the errors of the stated poses, `positions` (S, 2) and `yaw` (S,) [rad] the poses on the ground,
    `read_px` (S,) the reading noise of the cameras [px].
    """

    scene: Scene
    sensors: Sensors
    noise: PoseNoise
    positions: Floats  # (S, 2)
    yaw: Floats  # (S,)
    focal_px: Floats  # (S,) 0: not a camera
    read_px: Floats  # (S,)


class InitialPhase(NamedTuple):
    """Data collected until time `until_ns` for an initial calibration: bearings and the filter's positions, by scan."""

    until_ns: int | None  # None: not begun
    scans: tuple[LabelledBearings, ...]
    positions: tuple[Floats, ...]


class PoseCalibration(NamedTuple):
    """State of the estimation of pose errors: belief about the errors, and the sensors corrected by them.

    `packed` (S, 3) are the errors (dx, dy, dyaw [rad]) by which `sensors` were corrected; `follows` (2, 3 S) is the
    derivative of the filter's position estimate by all pose errors.
    """

    stated: StatedSensors
    belief: PoseErrorBelief
    sensors: Sensors
    packed: Floats  # (S, 3) errors that `sensors` were corrected by
    phase: InitialPhase | None  # None: estimated jointly, or the phase is over
    fixed: bool  # true: the result of the phase stays
    follows: Floats  # (2, 3 S) how much of each error is in the estimate

    @property
    def converged(self) -> bool:
        """Return whether corrections are applied: any initial phase is over, and constant errors explain the bearings.

        Their log-odds against errors drawn independently at every scan must exceed `MIN_LOG_ODDS`.
        """
        return self.phase is None and self.belief.log_odds > MIN_LOG_ODDS


def begin(scene: Scene, noise: PoseNoise, read_px: Floats, sensors: Sensors, mode: str) -> PoseCalibration | None:
    """Return the pose calibration before the first scan; None in mode `none`.

    Args:
        scene: the sensors as stated.
        noise: errors of the stated poses and focal lengths, from `pack_noise` of the scene.
        read_px: (S,) reading noise [px], from `read_noise` of the scene.
        sensors: positions and fields of view, from `pack_sensors` of the scene.
        mode: `none`; `joint`: estimated with the track; `initial`: estimated at the start only.
    """
    if mode == "none":
        return None
    yaw = np.array([c.yaw for c in scene.cameras] + [a.yaw for a in scene.arrays], dtype=np.float64)
    stated = StatedSensors(scene, sensors, noise, sensors.xy, yaw, noise.focal_px, read_px)
    belief = prior_belief(noise.sigma_position, noise.sigma_yaw)
    phase = InitialPhase(None, (), ()) if mode == "initial" else None
    return PoseCalibration(stated, belief, sensors, belief.mean, phase, False, np.zeros((2, belief.mean.size)))


def corrected(calibration: PoseCalibration, xy: Floats, weights: Floats) -> tuple[Sensors, PoseNoise]:
    """Return the sensors with corrected poses, and the noise model with what remains uncertain about the poses.

    Where the particles are near together as seen from a sensor, the variance of a bearing to them is put into the yaw's
    variance; elsewhere the position's variance is the largest in any direction ([Ercan] Eq. 2). While nothing is
    corrected (`converged` is false), both are as stated.

    Args:
        calibration: calibration before the scan.
        xy: (L, 2) positions of the particles.
        weights: (L,) weights of the particles, sum 1.
    """
    if not calibration.converged:
        return calibration.stated.sensors, calibration.stated.noise
    mean, covariance = mean_and_covariance(weights, xy)
    belief = calibration.belief
    everyone = np.arange(len(belief.mean))
    away = np.hypot(*(mean - calibration.stated.positions).T)
    near_together = np.sqrt(np.trace(covariance)) < MAX_CLOUD_ANGLE * away
    angle2 = spread(mean, everyone, calibration.stated.positions, belief) if away.min() > 0 else np.zeros(len(away))
    blocks = belief.blocks
    position2 = np.linalg.eigvalsh(blocks[:, :2, :2])[:, -1]
    left = calibration.stated.noise._replace(
        sigma_position=np.where(near_together, 0.0, np.sqrt(np.maximum(position2, 0.0))),
        sigma_yaw=np.sqrt(np.maximum(np.where(near_together, angle2, blocks[:, 2, 2]), 0.0)),
    )
    return calibration.sensors, left


def corrected_scan(calibration: PoseCalibration, packed: PackedScan) -> PackedScan:
    """Return the packed scan with bearings turned by the estimated yaw errors and with scaled variances.

    The factor is `PoseErrorBelief.scale`. Pixels are not turned, since they are measured from the corrected optical
    axis. While nothing is corrected, `packed` itself is returned.
    """
    if not calibration.converged:
        return packed
    sensor = np.repeat(packed.sensor, np.diff(packed.first))
    turn = np.where(packed.pixel, 0.0, calibration.packed[sensor, 2])  # pixels are read from the corrected axis
    return packed._replace(value=packed.value + turn, variance=packed.variance * calibration.belief.scale)


def updated_calibration(
    calibration: PoseCalibration, scan: Scan, estimate: Estimate, seconds: float
) -> tuple[PoseCalibration, Estimate]:
    """Return the calibration updated with a scan, and the estimate with what pose errors add to its covariance.

    The estimate also gets the pose errors with their standard deviations.

    Args:
        calibration: calibration before the scan.
        scan: only its labelled bearings are used.
        estimate: estimate of the filter after the scan.
        seconds: length of the initial phase [s].
    """
    sights = _sights(scan, calibration.stated)
    after = _follow(calibration, sights, estimate)
    if after.phase is not None:
        after = _gather(after, sights, scan.t_ns, estimate.xy, seconds)
    elif not after.fixed:
        after = _packed(after._replace(belief=update(after.belief, sights, after.stated.positions, estimate.xy)))
    follows, belief, covariance = after.follows, after.belief, estimate.covariance
    if after.converged:
        covariance = covariance + follows @ belief.covariance @ follows.T
    deviation = np.sqrt(np.maximum(np.diag(belief.covariance), 0.0)).reshape(belief.mean.shape)
    return after, estimate._replace(covariance=covariance, calibration=SensorErrors(belief.mean, deviation))


def _gather(
    calibration: PoseCalibration, sights: LabelledBearings, t_ns: int, xy: Floats, seconds: float
) -> PoseCalibration:
    """Return the calibration with a scan added to its initial phase, or, once that is over, solved for the errors.

    Args:
        calibration: calibration before the scan.
        sights: the scan's labelled bearings.
        t_ns: time of the scan [ns].
        xy: (2,) the filter's estimate at that time.
        seconds: length of the phase, from its first scan [s].
    """
    phase = calibration.phase or InitialPhase(None, (), ())
    until = t_ns + round(seconds * NS) if phase.until_ns is None else phase.until_ns
    phase = InitialPhase(until, (*phase.scans, sights), (*phase.positions, xy))
    if len(phase.scans) > MAX_INITIAL_SCANS:
        phase = phase._replace(scans=phase.scans[::2], positions=phase.positions[::2])
    if t_ns < until:
        return calibration._replace(phase=phase)
    belief = solve(calibration.belief, phase.scans, calibration.stated.positions, np.array(phase.positions))
    return _packed(calibration._replace(belief=belief, phase=None, fixed=True))


def _follow(calibration: PoseCalibration, sights: LabelledBearings, estimate: Estimate) -> PoseCalibration:
    """Return the calibration with its `follows`, the derivative of the estimate by pose errors, updated for a scan.

    The gain of the particle filter is approximated by that of a Kalman filter with the same covariance; outlier
    bearings are taken to have no weight.

    Args:
        calibration: calibration before the scan.
        sights: the scan's labelled bearings.
        estimate: the filter's position and covariance after the scan.
    """
    belief, positions = calibration.belief, calibration.stated.positions
    if not len(sights.sensor) or np.hypot(*(estimate.xy - positions[sights.sensor]).T).min() == 0.0:
        return calibration
    by_target, by_error = jacobians(estimate.xy, positions[sights.sensor])
    variance = sights.variance * belief.scale + spread(estimate.xy, sights.sensor, positions, belief)
    about = variance + np.einsum("ni,ij,nj->n", by_target, estimate.covariance, by_target)
    miss = residuals(estimate.xy, sights, positions, calibration.packed)
    weight = np.where(miss**2 < GATE_SIGMAS**2 * about, 1.0 / variance, 0.0)
    gain = estimate.covariance @ (by_target * weight[:, None]).T
    taken = gain @ by_target
    most = max(1.0, float(np.max(np.abs(np.linalg.eigvals(taken)))))  # above 1: the particles are not Gaussian
    moved = np.zeros((2, *belief.mean.shape))
    moved[:, sights.sensor] = gain[:, :, None] * by_error / most
    follows = (np.eye(2) - taken / most) @ calibration.follows + moved.reshape(2, -1)
    return calibration._replace(follows=follows)


def _sights(scan: Scan, stated: StatedSensors) -> LabelledBearings:
    """Return the labelled detections of a scan as bearings [rad] by the stated yaw, with the variances of the readings.

    Pixels are converted by the focal length. A variance is at least `MIN_SIGMA` squared.
    """
    rows = np.flatnonzero(scan.labelled & scan.seen)
    sensor, u = scan.sensor[rows], scan.u_px[rows]
    pixel = np.isfinite(u)
    f = np.where(pixel, stated.focal_px[sensor], 1.0)
    sigma_px = np.where(np.isfinite(scan.sigma_px[rows]), scan.sigma_px[rows], stated.read_px[sensor])
    tangent = np.where(pixel, u, 0.0) / f
    bearing = np.where(pixel, stated.yaw[sensor] - np.arctan(tangent), scan.bearing[rows])
    sigma = np.where(pixel, sigma_px / (f * (1.0 + tangent**2)), scan.sigma[rows])
    return LabelledBearings(sensor, bearing, np.maximum(sigma, MIN_SIGMA) ** 2)


def _packed(calibration: PoseCalibration) -> PoseCalibration:
    """Return the calibration with sensors packed at their estimated poses.

    It is returned unchanged if no camera has moved by more than `REPACK_SHIFT_SIGMAS` prior standard deviations since
    the sensors were packed.
    """
    stated, mean = calibration.stated, calibration.belief.mean
    prior = np.array([(c.sigma_position, c.sigma_position, c.sigma_yaw) for c in stated.scene.cameras]).reshape(-1, 3)
    moved = np.abs(mean - calibration.packed)[: len(prior)]
    if np.all(moved <= REPACK_SHIFT_SIGMAS * prior):
        return calibration
    return calibration._replace(sensors=corrected_sensors(stated.scene, mean), packed=mean)


def corrected_sensors(scene: Scene, errors: Floats) -> Sensors:
    """Return the packed sensors of a scene, with cameras moved and turned by `errors` (S, 3): dx, dy, dyaw [rad].

    Static obstacles hide from a camera what they hide at its stated position, except an obstacle that the camera would
    be moved into.
    """
    moved = [_moved(c, e) for c, e in zip(scene.cameras, errors, strict=False)]
    walls = [
        tuple(w for w in scene.blockers(old.ground) if not inside_polygon(new.ground[None], w)[0])
        for old, new in zip(scene.cameras, moved, strict=True)
    ]
    return pack_sensors(replace(scene, cameras=tuple(moved)), walls)


def _moved(camera: Camera, error: Floats) -> Camera:
    """Return a camera moved by dx and dy on the ground and turned by dyaw [rad] about the vertical; `error` is (3,)."""
    yaw, pitch, roll = angles_from_rotation(camera.rotation)
    position = camera.position + np.array([error[0], error[1], 0.0])
    return replace(camera, position=position, rotation=rotation_from_angles(yaw + float(error[2]), pitch, roll))
