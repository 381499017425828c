"""The posterior Cramer-Rao bound for the sensors that really saw the targets, and RMSE against it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..columns import Floats, Ints
from ..core import crlb
from ..core.metrics import ratio
from ..records import Bound, Errors, Truth
from ..scene import Scene
from .evaluate_config import NS, EvaluateConfig, default_sigma_v
from .evaluate_looks import Looks, SensorLooks
from .evaluate_paths import Path, Sensor, paths_of, sensors_of

Metrics = dict[str, float]


def compute_bound(
    looks: Mapping[str, SensorLooks], truth: Truth, errors: Errors, scene: Scene, config: EvaluateConfig
) -> Bound:
    """Bound of every target at the times of its errors, or at those of its looks if it has no errors.

    The recursion starts with the prior at the target's first look and takes in every
    bearing that was of the target, at the target's true position.  A labelled bearing
    counts unless the target was out of the field of view and the bearing away from it,
    as such a bearing cannot be of the target.
    """
    targets = paths_of(truth, "target")
    sensors = sensors_of(scene, looks)
    parts = [
        _bound_of(k, path, looks, sensors, errors.t_ns[errors.target_id == k], scene, config)
        for k, path in targets.items()
    ]
    return Bound.merge(parts)


def _bound_of(
    target: int,
    path: Path,
    looks: Mapping[str, SensorLooks],
    sensors: Mapping[str, Sensor],
    wanted: Ints,
    scene: Scene,
    config: EvaluateConfig,
) -> Bound:
    mine = {name: found.looks.take(found.looks.target == target) for name, found in looks.items()}
    looked = np.unique(np.concatenate([np.zeros(0, np.int64), *(m.t_ns for m in mine.values())]))
    if not len(looked):
        return Bound.empty()
    wanted = wanted[wanted >= looked[0]] if len(wanted) else looked
    times = np.union1d(looked, wanted)
    information, n_seen = _information(times, mine, sensors)
    covariance = _recursion(times, information, scene, config)
    rows = np.searchsorted(times, wanted)
    rows = rows[path.at(wanted, config.limit_ns)[1]]
    kept = covariance[rows]
    return Bound.of(
        t_ns=times[rows],
        target_id=np.full(len(rows), target, dtype=np.int32),
        bound_xx=kept[:, 0, 0],
        bound_xy=kept[:, 0, 1],
        bound_yy=kept[:, 1, 1],
        bound=np.sqrt(kept[:, 0, 0] + kept[:, 1, 1]),
        n_seen=n_seen[rows].astype(np.int32),
    )


def _information(times: Ints, looks: Mapping[str, Looks], sensors: Mapping[str, Sensor]) -> tuple[Floats, Ints]:
    """(T, 2, 2) information of all bearings at each time, and how many there were."""
    total, n_seen = np.zeros((len(times), 2, 2)), np.zeros(len(times), dtype=np.int64)
    for name, all_looks in looks.items():
        seen = all_looks.take(all_looks.reported & (all_looks.in_view | all_looks.hit))
        at = np.searchsorted(times, seen.t_ns)
        np.add.at(total, at, sensor_information(sensors[name], seen))
        np.add.at(n_seen, at, 1)
    return total, n_seen


def sensor_information(sensor: Sensor, seen: Looks) -> Floats:
    """(N, 2, 2) Fisher information of the bearings of one sensor; the one place that knows kinds of sensors.

    Cameras count by Eq. 2 with the bearing's own read noise; directions without pixels by their standard deviation.
    """
    by_angle = crlb.bearing_information(seen.xy, sensor.ground, seen.sigma)
    camera = sensor.camera
    if camera is None:
        return by_angle
    pixels = np.isfinite(seen.sigma_px)
    by_pixel = crlb.camera_information(
        seen.xy,
        sensor.ground,
        camera.yaw,
        float(camera.focal_px[0]),
        camera.sigma_position,
        camera.sigma_yaw,
        np.where(pixels, seen.sigma_px, 1.0),
    )
    return np.asarray(np.where(pixels[:, None, None], by_pixel, by_angle))


def _recursion(times: Ints, information: Floats, scene: Scene, config: EvaluateConfig) -> Floats:
    """(T, 2, 2) bounds of the position, with the motion of the configuration."""
    dt = np.diff(times, prepend=times[0]) / NS
    if config.prior_cov is None:
        P0 = crlb.polygon_covariance(scene.region)
    else:
        xx, xy, yy = config.prior_cov
        P0 = np.array([[xx, xy], [xy, yy]])
    if config.motion == "waypoint":
        sigma_v = default_sigma_v(scene.length_unit) if config.sigma_v is None else config.sigma_v
        return crlb.posterior_bound(information, *crlb.known_drift_steps(dt, sigma_v), P0)
    prior = np.diag([0.0, 0.0, config.sigma_speed**2, config.sigma_speed**2])
    prior[:2, :2] = P0
    wide = np.zeros((len(times), 4, 4))
    wide[:, :2, :2] = information
    steps = crlb.constant_velocity_steps(dt, config.acceleration_density)
    return crlb.posterior_bound(wide, *steps, prior)[:, :2, :2]


def bound_metrics(errors: Errors, bound: Bound, unit: str) -> Metrics:
    """Root of the mean bound and RMSE over it, over the times that both have, for all targets and for each."""
    out = _ratio(errors, bound, unit, "")
    for k in np.unique(bound.target_id).tolist():
        mine = errors.take(errors.target_id == k)
        out |= _ratio(mine, bound.take(bound.target_id == k), unit, f"_target_{k}")
    return out


def _ratio(errors: Errors, bound: Bound, unit: str, whose: str) -> Metrics:
    if not len(errors):
        return {f"bound_rmse{whose}_{unit}": math.sqrt(ratio(float(np.sum(bound.bound**2)), len(bound)))}
    place = {key: n for n, key in enumerate(zip(bound.t_ns.tolist(), bound.target_id.tolist(), strict=True))}
    shared = [place.get(key, -1) for key in zip(errors.t_ns.tolist(), errors.target_id.tolist(), strict=True)]
    rows = np.array(shared, dtype=np.int64)
    both = rows >= 0
    least = math.sqrt(ratio(float(np.sum(bound.bound[rows[both]] ** 2)), int(both.sum())))
    rmse = math.sqrt(ratio(float(np.sum(errors.error[both] ** 2)), int(both.sum())))
    return {
        f"bound_rmse{whose}_{unit}": least,
        f"bound_ratio{whose}": ratio(rmse, least),
        f"bound_estimates{whose}": int(both.sum()),
    }
