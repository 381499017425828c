"""The posterior Cramer-Rao bound, on the ground or in space, for the sensors that really saw the targets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..columns import Bools, Floats, Ints
from ..core import bounds3d, crlb
from ..errors import InputError
from ..records import Bound, Errors, Truth
from ..scene import Scene
from .evaluate_config import NS, EvaluateConfig, default_sigma_v
from .evaluate_information import ground_information, space_information
from .evaluate_looks import Looks, SensorLooks
from .evaluate_paths import Path, Sensor, paths_of, sensors_of
from .evaluate_space import in_space


def compute_bound(
    looks: Mapping[str, SensorLooks], truth: Truth, errors: Errors, scene: Scene, config: EvaluateConfig
) -> Bound:
    """Bound of every target at the times of its errors, or at those of its looks if it has no errors.

    The recursion starts with the prior at the target's first look and takes in every
    bearing that was of the target, at the target's true position.  A labelled bearing
    counts unless the target was out of the field of view and the bearing away from it,
    as such a bearing cannot be of the target.

    Raises:
        InputError: a bound in space is asked for, and the truth has no height of a target.
    """
    targets = paths_of(truth, "target")
    sensors = sensors_of(scene, looks)
    parts = [
        _bound_of(k, path, looks, sensors, errors.take(errors.target_id == k), scene, config)
        for k, path in targets.items()
    ]
    return Bound.merge(parts)


def _bound_of(
    target: int,
    path: Path,
    looks: Mapping[str, SensorLooks],
    sensors: Mapping[str, Sensor],
    errors: Errors,
    scene: Scene,
    config: EvaluateConfig,
) -> Bound:
    mine = {name: found.looks.take(found.looks.target == target) for name, found in looks.items()}
    looked = np.unique(np.concatenate([np.zeros(0, np.int64), *(m.t_ns for m in mine.values())]))
    if not len(looked):
        return Bound.empty()
    d = _dimension(target, path, errors, config)
    wanted = errors.t_ns[errors.t_ns >= looked[0]] if len(errors) else looked
    times = np.union1d(looked, wanted)
    information, n_seen = _information(times, mine, sensors, d)
    covariance = _recursion(times, information, scene, config)
    rows = np.searchsorted(times, wanted)
    rows = rows[path.at(wanted, config.limit_ns)[1]]
    return _table(times[rows], target, covariance[rows], n_seen[rows])


def _dimension(target: int, path: Path, errors: Errors, config: EvaluateConfig) -> int:
    """2 or 3: `auto` is in space for a target of whose errors one at least is."""
    if config.bound_in == "ground" or (config.bound_in == "auto" and not in_space(errors).any()):
        return 2
    if not path.high.any():
        raise InputError(
            f"truth: target {target} has no height (z), which a bound in space needs; give --bound-in ground"
        )
    return 3


def _table(t_ns: Ints, target: int, covariance: Floats, n_seen: Ints) -> Bound:
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    space = {}
    if covariance.shape[1] == 3:
        zz = covariance[:, 2, 2]
        space = {
            "bound_xz": covariance[:, 0, 2], "bound_yz": covariance[:, 1, 2], "bound_zz": zz,
            "bound_space": np.sqrt(xx + yy + zz),
        }  # fmt: skip
    return Bound.of(
        t_ns=t_ns,
        target_id=np.full(len(t_ns), target, dtype=np.int32),
        bound_xx=xx,
        bound_xy=xy,
        bound_yy=yy,
        bound=np.sqrt(xx + yy),
        n_seen=n_seen.astype(np.int32),
        **space,
    )


def _information(times: Ints, looks: Mapping[str, Looks], sensors: Mapping[str, Sensor], d: int) -> tuple[Floats, Ints]:
    """(T, d, d) information of all bearings at each time, and how many there were."""
    total, n_seen = np.zeros((len(times), d, d)), np.zeros(len(times), dtype=np.int64)
    of_sensor = space_information if d == 3 else ground_information
    for name, all_looks in looks.items():
        seen = all_looks.take(counted(all_looks))
        at = np.searchsorted(times, seen.t_ns)
        np.add.at(total, at, of_sensor(sensors[name], seen))
        np.add.at(n_seen, at, 1)
    return total, n_seen


def counted(looks: Looks) -> Bools:
    """(N,) bool: reports that can be of the target."""
    return looks.reported & (looks.in_view | looks.hit)


def _recursion(times: Ints, information: Floats, scene: Scene, config: EvaluateConfig) -> Floats:
    """(T, d, d) bounds of the position, with the motion of the configuration."""
    d = information.shape[1]
    dt = np.diff(times, prepend=times[0]) / NS
    P0 = _prior(d, scene, config)
    if config.motion == "waypoint":
        sigma_v = default_sigma_v(scene.length_unit) if config.sigma_v is None else config.sigma_v
        return crlb.posterior_bound(information, *crlb.known_drift_steps(dt, sigma_v, d), P0)
    prior = np.zeros((2 * d, 2 * d))
    prior[:d, :d], prior[d:, d:] = P0, config.sigma_speed**2 * np.eye(d)
    return bounds3d.motion_bound(information, dt, prior, config.acceleration_density)[:, :d, :d]


def _prior(d: int, scene: Scene, config: EvaluateConfig) -> Floats:
    """(d, d) covariance of the position at the first look: as told, else of a point anywhere in the room."""
    out = np.zeros((d, d))
    if config.prior_cov is None:
        out[:2, :2] = crlb.polygon_covariance(scene.region)
    else:
        xx, xy, yy = config.prior_cov
        out[:2, :2] = [[xx, xy], [xy, yy]]
    if d == 3:
        out[2, 2] = scene.room_height**2 / 12.0 if config.prior_z is None else config.prior_z
    return out
