"""A scene and a scan as the arrays that the likelihood kernels want."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from occlog.array_types import Floats
from occlog.core.sight.visibility import Sensors, make_sensors
from occlog.filtering.likelihood.directions import Detection, Noise, PackedScan
from occlog.filtering.likelihood.distance_errors import direct
from occlog.filtering.likelihood.distances import Distances, linearise
from occlog.records.scene import Scene
from occlog.scans.scan import Scan
from occlog.track.interface import Estimate, Fit

from .config import ApfConfig

WIDEST = math.radians(170.0)
"""Fields of view are cut to this where the width of the image in z = f h/d is asked for."""
LEAST_SIGMA = 1e-9
"""Measurements without any noise get this much [px, rad], so that densities stay finite."""


def pack_sensors(scene: Scene, walls: Sequence[Sequence[Floats]] | None = None) -> Sensors:
    """Positions, fields of view and walls of all sensors; sound goes past walls and comes from everywhere.

    Args:
        scene: cameras and arrays.
        walls: what hides things from each camera; None: what the scene says of the camera's place.
    """
    cameras, arrays = scene.cameras, scene.arrays
    if walls is None:
        walls = [scene.blockers(c.ground) for c in cameras]
    places = [c.position[:2] for c in cameras] + [a.position[:2] for a in arrays]
    return make_sensors(
        np.array(places, dtype=np.float64).reshape(-1, 2),
        np.array([c.yaw for c in cameras] + [a.yaw for a in arrays], dtype=np.float64),
        np.array([c.fov for c in cameras] + [math.nan] * len(arrays), dtype=np.float64),
        np.array([c.range for c in cameras] + [a.range for a in arrays], dtype=np.float64),
        [*walls, *([()] * len(arrays))],
    )


def pack_noise(scene: Scene) -> Noise:
    """Calibration noise and image widths of all sensors."""
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
    return Noise(*(np.array(c, dtype=np.float64) for c in columns))


def read_noise(scene: Scene) -> Floats:
    """(S,) standard deviation [px] of a reading that does not bring its own."""
    return np.array([c.sigma_read_px for c in scene.cameras] + [0.0] * len(scene.arrays), dtype=np.float64)


def pack_scan(scan: Scan, read_px: Floats, use_score: bool) -> PackedScan:
    """The looks of a scan, as the likelihood kernels read them.

    Cameras count by pixels, with Eq. 2's variance; a bearing without pixels by its own sigma,
    which is taken to hold everything.

    Args:
        scan: rows by sensor.
        read_px: (S,) from `read_noise`, for rows without `sigma_px`.
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
        variance=np.maximum(np.where(pixel, sigma_px, scan.sigma[seen]), LEAST_SIGMA) ** 2,
        share=np.where(weigh, scan.score[seen], 1.0),
    )


def pack_detection(scene: Scene, config: ApfConfig, *, informed: bool) -> Detection:
    """Probabilities of detection and of false reports of all sensors.

    Args:
        scene: a camera's own probabilities come before those of the configuration.
        config: settings.
        informed: there are priors of the moving occluders, so "not seen" means something
            also where no probability of detection is given.
    """
    hit, miss, false, candidate = [], [], [], []
    own = [(c.detection, c.false_alarm) for c in scene.cameras] + [(None, None)] * len(scene.arrays)
    for detection, false_alarm in own:
        found = config.detection if detection is None else detection
        hit.append(1.0 if found is None else found)
        miss.append((0.0 if informed else 1.0) if found is None else 1.0 - found)
        candidate.append(config.candidate if found is None else found)
        false.append(config.false if false_alarm is None else false_alarm)
    return Detection(
        np.array(hit, dtype=np.float64),
        np.array(miss, dtype=np.float64),
        np.array(false, dtype=np.float64),
        config.soften,
        np.array(candidate, dtype=np.float64),
        np.full(len(own), config.clutter),
    )


def with_distances(estimate: Estimate, measured: Distances) -> Estimate:
    """The estimate with what it says of measurements of distances."""
    told = linearise(measured, estimate.xy[None])
    residual, gradient = told.residual[0], told.gradient[0]
    spread = np.einsum("ni,ij,nj->n", gradient, estimate.covariance, gradient)
    believed = direct(residual / np.sqrt(1.0 + spread), measured.errors.widened(1.0 + spread))
    looked = np.unique([*estimate.used, *measured.station.tolist()])
    saw = np.unique([*(estimate.seen_by or ()), *measured.station[believed >= 0.5].tolist()])
    return estimate._replace(
        n_looked=len(looked),
        n_seen=len(saw),
        used=tuple(looked.astype(int).tolist()),
        seen_by=tuple(saw.astype(int).tolist()),
        fit=Fit(
            row=np.zeros(len(residual), dtype=np.int64),
            sensor=measured.station,
            residual=residual,
            expected=np.maximum(1.0 - spread, 0.0),
            believed=believed,
        ),
    )
