"""Scene and settings of method `apf` in the form of the kernels, and the likelihood of positions under them.

A scene and a scan as the arrays that the likelihood kernels want.

Particles in a scene without a room: drawn from the first scan, within what sensors can see.

In a room particles begin all over the floor.  Without one they may be as far as sensors see, and so few of them would
be near the target that the filter's first estimate would be a draw of chance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.geometry.visibility import ScanDirectionsInPlane, Sensors, ViewPrior, make_sensors
from occlog.core.occlusion.priors import Priors
from occlog.core.plane import Floor, make_floor, on_floor
from occlog.filtering.likelihood import distances
from occlog.filtering.likelihood.directions import (
    EXACT,
    INDEPENDENT,
    RECURSION,
    DetectionModel,
    Occlusion,
    PackedScan,
    PoseNoise,
    log_likelihood,
    log_likelihood_among,
)
from occlog.filtering.likelihood.distances import RangeMeasurements, inlier_probability, linearise
from occlog.filtering.motion.waypoint import WaypointModel
from occlog.records.scene import Scene
from occlog.scans.grouping import Scan
from occlog.track.interface import BearingResiduals, Estimate

from .config import FORMS, UNIFORM, ApfConfig
from .kernels import importance

WIDEST = math.radians(170.0)
"""Fields of view are cut to this where the width of the image in z = f h/d is asked for."""
MIN_SIGMA = 1e-9
"""Measurements without any noise get this much [px, rad], so that densities stay finite."""


def pack_sensors(scene: Scene, walls: Sequence[Sequence[Floats]] | None = None) -> Sensors:
    """Return positions, fields of view and walls of all sensors of a scene as arrays, cameras first.

    Microphone arrays hear in all directions and past walls.

    Args:
        scene: cameras and arrays.
        walls: polygons that hide things from each camera; None: the scene's static obstacles.
    """
    cameras, arrays = scene.cameras, scene.arrays
    if walls is None:
        walls = [scene.blockers(c.ground) for c in cameras]
    positions = [c.position[:2] for c in cameras] + [a.position[:2] for a in arrays]
    return make_sensors(
        np.array(positions, dtype=np.float64).reshape(-1, 2),
        np.array([c.yaw for c in cameras] + [a.yaw for a in arrays], dtype=np.float64),
        np.array([c.fov for c in cameras] + [math.nan] * len(arrays), dtype=np.float64),
        np.array([c.range for c in cameras] + [a.range for a in arrays], dtype=np.float64),
        [*walls, *([()] * len(arrays))],
    )


def pack_noise(scene: Scene) -> PoseNoise:
    """Return pose errors, focal lengths and image widths of all sensors as arrays, cameras first; 0 for arrays.

    The range of values of an array's bearing is 2 pi rad.
    """
    cameras, none = scene.cameras, [0.0] * len(scene.arrays)
    focal = [float(c.focal_px[0]) for c in cameras]
    fov = [c.fov for c in cameras]
    width_px = [2.0 * f * math.tan(0.5 * min(a, WIDEST)) for f, a in zip(focal, fov, strict=True)]
    columns = (
        focal + none,
        [c.sigma_position for c in cameras] + none,
        [c.sigma_yaw for c in cameras] + none,
        width_px + [1.0] * len(none),
        fov + [2.0 * math.pi] * len(none),
    )
    return PoseNoise(*(np.array(c, dtype=np.float64) for c in columns))


def read_noise(scene: Scene) -> Floats:
    """Return (S,) standard deviations [px] of pixel measurements that do not state their own; 0 for arrays."""
    return np.array([c.sigma_read_px for c in scene.cameras] + [0.0] * len(scene.arrays), dtype=np.float64)


def pack_scan(scan: Scan, read_px: Floats, use_score: bool) -> PackedScan:
    """Return the detections of a scan in the form of the likelihood kernels, by sensor.

    Detections with pixels count as pixels, with the variance of [Ercan] Eq. 2; others as bearings with their own sigma,
    which is taken to include pose errors.

    Args:
        scan: rows by sensor.
        read_px: (S,) reading noise from `read_noise`, for rows without `sigma_px`.
        use_score: weigh candidates by their score, where they have one.
    """
    start = np.flatnonzero(np.diff(scan.sensor, prepend=-1))
    seen = scan.seen
    before = np.concatenate([[0], np.cumsum(seen)])
    pixel = np.isfinite(scan.u_px[seen])
    sigma_px = scan.sigma_px[seen]
    sigma_px = np.where(np.isfinite(sigma_px), sigma_px, read_px[scan.sensor[seen]])
    weigh = np.isfinite(scan.score[seen]) & ~scan.labelled[seen] & use_score
    return PackedScan(
        sensor=scan.sensor[start],
        labelled=scan.labelled[start],
        first=np.concatenate([before[start], before[-1:]]),
        pixel=pixel,
        value=np.where(pixel, -scan.u_px[seen], scan.bearing[seen]),
        variance=np.maximum(np.where(pixel, sigma_px, scan.sigma[seen]), MIN_SIGMA) ** 2,
        share=np.where(weigh, scan.score[seen], 1.0),
    )


def pack_detection(scene: Scene, config: ApfConfig, *, informed: bool) -> DetectionModel:
    """Return the probabilities of detection and of false alarms of all sensors.

    Args:
        scene: a camera's own probabilities take precedence over those of the settings.
        config: settings of the method.
        informed: there are priors of the moving occluders, so that a missed detection is information even where no
            probability of detection is given.
    """
    hit, miss, false, candidate = [], [], [], []
    own = [(c.detection, c.false_alarm) for c in scene.cameras] + [(None, None)] * len(scene.arrays)
    for detection, false_alarm in own:
        found = config.detection_probability if detection is None else detection
        hit.append(1.0 if found is None else found)
        miss.append((0.0 if informed else 1.0) if found is None else 1.0 - found)
        candidate.append(config.candidate_detection_probability if found is None else found)
        false.append(config.false_alarm_probability if false_alarm is None else false_alarm)
    return DetectionModel(
        np.array(hit, dtype=np.float64),
        np.array(miss, dtype=np.float64),
        np.array(false, dtype=np.float64),
        config.out_of_view_likelihood,
        np.array(candidate, dtype=np.float64),
        np.full(len(own), config.clutter_rate),
    )


def with_distances(estimate: Estimate, measured: RangeMeasurements) -> Estimate:
    """Return the estimate with the residuals of distance measurements at its position, and the stations that were used.

    The residuals are normalised by the standard deviations stated; their expected variances after the fit and the
    probabilities that measurements are not false are added.
    """
    linearised = linearise(measured, estimate.xy[None])
    residual, gradient = linearised.residual[0], linearised.gradient[0]
    spread = np.einsum("ni,ij,nj->n", gradient, estimate.covariance, gradient)
    inlier = inlier_probability(residual / np.sqrt(1.0 + spread), measured.errors.widened(1.0 + spread))
    observing = np.unique([*estimate.used, *measured.station.tolist()])
    saw = np.unique([*(estimate.seen_by or ()), *measured.station[inlier >= 0.5].tolist()])
    return estimate._replace(
        n_observing=len(observing),
        n_detected=len(saw),
        used=tuple(observing.astype(int).tolist()),
        seen_by=tuple(saw.astype(int).tolist()),
        fit=BearingResiduals(
            row=np.zeros(len(residual), dtype=np.int64),
            sensor=measured.station,
            residual=residual,
            expected_variance=np.maximum(1.0 - spread, 0.0),
            inlier_probability=inlier,
        ),
    )


MAX_DESTINATION_S = 10.0
"""Without a room a new destination is at most as far as a target of usual speed comes in this time [s]."""


def max_destination_distance(scene: Scene, speed: float) -> float:
    """Return the largest distance of a new destination from a target, in a scene without a room.

    It is half the diagonal of the sensors' surroundings, or the way in `MAX_DESTINATION_S` at `speed` (of new
    particles) if that is more. Destinations all over a region that reaches farther on one side would nearly all lie in
    that direction.
    """
    return max(0.5 * float(np.hypot(*np.ptp(scene.surroundings, axis=0))), MAX_DESTINATION_S * speed)


def lines_of_sight(packed: PackedScan, sensors: Sensors, noise: PoseNoise, prior: ViewPrior) -> ScanDirectionsInPlane:
    """Return the directions of a scan's n measurements in the plane, with errors of reading and pose ([Ercan] Eq. 2).

    Args:
        packed: the scan.
        sensors: positions and axes of all S sensors.
        noise: errors of their poses and focal lengths.
        prior: states how far each sensor sees.
    """
    i = np.repeat(packed.sensor, np.diff(packed.first))
    f, yaw = np.where(packed.pixel, noise.focal_px[i], 1.0), np.arctan2(sensors.axis[i, 1], sensors.axis[i, 0])
    reading = np.sqrt(packed.variance)
    sigma = np.where(packed.pixel, np.hypot(reading * f / (f**2 + packed.value**2), noise.sigma_yaw[i]), reading)
    return ScanDirectionsInPlane(
        origin=sensors.xy[i],
        azimuth=np.where(packed.pixel, yaw + np.arctan2(packed.value, f), packed.value),
        sigma=sigma,
        sigma_origin=np.where(packed.pixel, noise.sigma_position[i], 0.0),
        far=prior.far[i],
        sensor=i,
    )


OCCLUDER_SUPPORT_SIGMAS, OCCLUDER_SUPPORT_SIGMAS_STAGE1 = 5.5, 3.5
"""Standard deviations at which a prior of an occluder counts as over; stage 1 only has to be near."""


class ApfModel(NamedTuple):
    """Scene and settings in the form of the kernels, with the occluder priors and distances of one scan."""

    config: ApfConfig
    floor: Floor
    sensors: Sensors
    noise: PoseNoise
    read_px: Floats
    motion: WaypointModel
    detection: DetectionModel
    informed: DetectionModel  # the same where there are priors of the moving occluders
    occlusion: Occlusion  # how priors of the moving occluders count
    views: ViewPrior | None = None  # where a target can be without a room; None: all over the floor
    wander: float = math.inf  # how far a new destination is, without a room
    priors: Priors | None = None  # those at the time of the scan
    measured: RangeMeasurements | None = None  # ranges and their like at the time of the scan


def make_model(scene: Scene, config: ApfConfig) -> ApfModel:
    """Return scene and settings in the form of the kernels, before the first scan."""
    return ApfModel(
        config=config,
        floor=make_floor(scene.region, [o.polygon for o in scene.occluders]),
        sensors=pack_sensors(scene),
        noise=pack_noise(scene),
        read_px=read_noise(scene),
        motion=motion_of(config),
        detection=pack_detection(scene, config, informed=False),
        informed=pack_detection(scene, config, informed=True),
        occlusion=occlusion_of(config),
        views=scene.views,
        wander=math.inf if scene.views is None else max_destination_distance(scene, config.initial_speed),
    )


def motion_of(config: ApfConfig) -> WaypointModel:
    """Return the parameters of the waypoint motion model that the settings state."""
    return WaypointModel(
        reference_s=config.reference_step_s,
        sigma=config.process_noise_position,
        phi=config.velocity_memory,
        towards=config.beta1,
        change=config.lambda1,
        towards_reached=config.beta2,
        change_reached=config.lambda2,
        sigma_velocity=config.process_noise_velocity,
        sigma_waiting=config.process_noise_waiting,
        wait_s=config.mean_wait_s,
        sigma_creep=config.process_noise_creep,
        uniform_change=config.change_time == UNIFORM,
    )


def occlusion_of(config: ApfConfig) -> Occlusion:
    """Return the settings of how occluder priors enter the likelihood."""
    kind = {"independent": INDEPENDENT, "recursion": RECURSION, "exact": EXACT}[config.likelihood]
    return Occlusion(
        kind,
        FORMS.index(config.occlusion_form),
        config.min_occlusion_probability,
        far=0.0,
        temper=config.occlusion_tempering,
    )


def likelihood(
    model: ApfModel,
    xy: Floats,
    packed_scan: PackedScan,
    far: float = OCCLUDER_SUPPORT_SIGMAS,
    *,
    anywhere: bool = False,
) -> Floats:
    """Return (L,) log-likelihoods of a scan at L positions, [Ercan] Eq. 6; -inf off the floor.

    Args:
        model: scene, settings, occluder priors and distances of the scan.
        xy: (L, 2) positions.
        packed_scan: the scan.
        far: standard deviations beyond which the prior of an occluder counts as 0.
        anywhere: positions off the floor are possible, too.
    """
    free = np.ones(len(xy), dtype=np.bool_) if anywhere else on_floor(xy, *model.floor)
    packed = packed_scan, model.sensors, model.noise, model.detection, free
    if model.priors is None:
        log_density = np.asarray(log_likelihood(xy, *packed))
    else:
        log_density = log_likelihood_among(xy, *packed, model.priors, model.occlusion._replace(far=far))
    # Radio and sound go past what hides targets
    return log_density if model.measured is None else log_density + distances.log_likelihood(model.measured, xy)


def evidence(model: ApfModel, packed: PackedScan) -> tuple[Ints, Floats]:
    """Return a scan's measurements for `importance.adapt`: `first` (K + 1,) and parameters `rows` (M, 12).

    Measurements of report k are rows first[k] to first[k + 1] - 1. Bearings and pixels come first, by sensor; each
    measurement of a distance follows as a report of its own.
    """
    rows = importance.measurements(packed, model.sensors, model.noise, model.detection)
    if model.measured is None:
        return packed.first, rows
    return importance.with_distances(packed.first, rows, model.measured)
