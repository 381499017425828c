"""Observations: bearings that sensors reported of true targets, with the expected measurements.

An observation is one frame of a sensor with one true target: a labelled row (`target_id` >= 0, detected or not), or an
unlabelled candidate, paired one to one with the true objects of the frame. Residuals are reported minus expected
bearings, with a mask of those within the gate.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.projected_planes import direction, direction_angles, polar_from_elevation
from occlog.core.geometry.visibility import behind_objects
from occlog.core.metrics.errors import pair_within
from occlog.records.tables import Bearings

from .config import EvaluateConfig
from .paths import ExpectedMeasurement, ObjectPath, SensorGeometry


class BearingErrors(NamedTuple):
    """Residuals of bearings, reported minus expected, each of the shape (N,) or (N, M); NaN where nothing was reported.

    Of an array with elevations the azimuth is that about its own z axis (to which its noise refers), if the height of
    the object is known.

    Attributes:
        px: horizontal offset in the image [px].
        rad: residual of the azimuth [rad].
        normalised: residual of the azimuth over its standard deviation.
        elevation: residual of the elevation [rad]; NaN without elevation or height.
        elevation_normalised: residual of the elevation over its standard deviation.
    """

    px: Floats
    rad: Floats
    normalised: Floats
    elevation: Floats  # [rad] about the sensor's own z axis; NaN without elevation or height
    elevation_normalised: Floats

    @property
    def distance(self) -> Floats:
        """Normalised distance of the whole measurement (azimuth and elevation) [standard deviations]."""
        flat = np.abs(self.normalised)
        return np.where(np.isnan(self.elevation), flat, np.hypot(flat, self.elevation_normalised))


def residuals(rows: Bearings, expected: ExpectedMeasurement, sensor: SensorGeometry) -> BearingErrors:
    """Return the residuals of N bearings against expected measurements of N positions, or (N, M) of M objects.

    The residual [px] of a position that is not in front of the camera is infinite.
    """
    shape = (len(rows), *(1 for _ in expected.bearing.shape[1:]))
    columns = (rows.bearing, rows.u_px, rows.sigma_px, rows.sigma, rows.sigma_elevation)
    bearing, u_px, sigma_px, sigma, sigma_up = (c.reshape(shape) for c in columns)
    rad = wrap_angle(bearing - expected.bearing)
    up = np.full(expected.bearing.shape, np.nan)
    if np.isfinite(rows.elevation).any():
        across, up = _in_own_frame(rows, expected, sensor, shape)
        rad = np.where(np.isnan(up), rad, across)
    pixels = np.isfinite(u_px) & np.isfinite(sigma_px)
    behind = pixels & np.isnan(expected.u_px)
    px = np.where(behind, np.inf, u_px - expected.u_px)
    normalised = np.where(pixels, px / np.sqrt(expected.variance_px + sigma_px**2), rad / sigma)
    return BearingErrors(
        px=px,
        rad=rad,
        normalised=np.where(behind, np.inf, normalised),
        elevation=up,
        elevation_normalised=up / sigma_up,
    )


def _in_own_frame(
    rows: Bearings, expected: ExpectedMeasurement, sensor: SensorGeometry, shape: tuple[int, ...]
) -> tuple[Floats, Floats]:
    """Return residuals [rad] of azimuth and elevation about the sensor's own axes, each broadcast to `expected`.

    A line of sight near the sensor's z axis may be measured from beyond it, with an azimuth half a turn off; the nearer
    of both interpretations is used.

    Args:
        rows: n bearings with elevations.
        expected: measurements of the shape (n,) or (n, M).
        sensor: the sensor.
        shape: shape of the n rows for broadcasting, (n,) or (n, 1).
    """
    line = direction(rows.bearing, polar_from_elevation(rows.elevation)) @ sensor.rotation
    theta, phi = (angle.reshape(shape) for angle in direction_angles(line))
    sigma, sigma_up = rows.sigma.reshape(shape), rows.sigma_elevation.reshape(shape)
    across, up = wrap_angle(theta - expected.theta), expected.phi - phi
    beyond, over = wrap_angle(theta + np.pi - expected.theta), wrap_angle(expected.phi + phi)
    nearer = np.hypot(beyond / sigma, over / sigma_up) < np.hypot(across / sigma, up / sigma_up)
    return np.where(nearer, beyond, across), np.where(nearer, over, up)


def inside_gate(residual: BearingErrors, config: EvaluateConfig) -> Floats:
    """Return residuals as fractions of the gate (up to 1: within), in the shape of `residual`; NaN without a report.

    The gate is `gate_px` for pixels if it is set, else the ellipse of `gate_sigma` standard deviations in azimuth and
    elevation.
    """
    by_sigma = residual.distance / config.gate_sigma
    if config.gate_px is None:
        return by_sigma
    return np.asarray(np.where(np.isnan(residual.px), by_sigma, np.abs(residual.px) / config.gate_px))


def occluded_by_moving(
    sensor: SensorGeometry,
    t_ns: Ints,
    xy: Floats,
    target: int,
    everyone: Mapping[int, ObjectPath],
    config: EvaluateConfig,
) -> Bools:
    """Return the mask (N,) of times at which a moving object hides a target from a camera ([Ercan] Fig. 3).

    All are False for other sensors, or if the configuration states no diameter of the objects.

    Args:
        sensor: the sensor.
        t_ns: (N,) times [ns].
        xy: (N, 2) true positions of the target.
        target: its identity.
        everyone: true paths of all moving objects by identity.
        config: diameter, largest gap that is interpolated.
    """
    rest = [path for k, path in everyone.items() if k != target]
    if config.occluder_diameter is None or sensor.camera is None or not rest:
        return np.zeros(len(t_ns), dtype=np.bool_)
    positions = np.stack([path.at(t_ns, config.limit_ns)[0] for path in rest], axis=1)
    return behind_objects(sensor.ground, xy, positions, config.occluder_diameter)


class Paired(NamedTuple):
    """Result of pairing unlabelled bearings with true objects: one row for each frame and each target present.

    `rows`: the bearing paired with the target, or a row without a detection; `target`: (n,) identity of the target of
    each row; `stray`: number of bearings near no true object.
    """

    rows: Bearings  # the candidate paired with the target, or a `not seen` row
    target: Ints  # identity of the target of each row
    stray: int  # candidates that are near no true object


class _SensorFrames(NamedTuple):
    """N frames of a sensor with R bearings, compared with M true objects.

    `starts`: first row of each frame, then R; `present`: (N, M) mask, the object's position is known; `visible`: (N, M)
    mask, it is present and should be seen; `cost`: (R, M) residual over the gate, infinite above 1 or if impossible.
    """

    starts: list[int]  # first row of each frame, then the number of rows
    present: Bools  # (N, M) the object's position is known
    visible: Bools  # (N, M) and it should have been seen
    cost: Floats  # (R, M) residual of each row as a share of the gate; infinite where it cannot be


def match_candidates(
    sensor: SensorGeometry,
    rows: Bearings,
    labelled: Collection[tuple[int, int]],
    targets: Mapping[int, ObjectPath],
    everyone: Mapping[int, ObjectPath],
    config: EvaluateConfig,
) -> Paired:
    """Pair the unlabelled bearings of every frame one to one with true objects, first with visible ones.

    Occluded ones come second. A bearing is a false alarm (`stray`) only if it is near no true object, occluders
    included.

    Args:
        sensor: the sensor.
        rows: its unlabelled rows.
        labelled: (time [ns], target) for which a labelled row exists; they get no row here.
        targets: true paths of the targets by identity.
        everyone: true paths of targets and moving occluders.
        config: gates, limits.
    """
    frames = _compare(sensor, rows, everyone, config)
    names = list(everyone)
    is_target = np.array([k in targets for k in names], dtype=np.bool_)
    picked: list[tuple[int, int, bool]] = []  # row, target, whether that row is of the target
    stray = 0
    for n, (start, end) in enumerate(pairwise(frames.starts)):
        present = frames.present[n]
        if not (present & is_target).any():
            continue
        found = _pair(frames.cost[start:end], frames.visible[n])
        stray += int(np.count_nonzero(rows.seen[start:end])) - len(found)
        for j in np.flatnonzero(present & is_target).tolist():
            if (int(rows.t_ns[start]), names[j]) not in labelled:
                picked.append((start + found.get(j, 0), names[j], j in found))
    row, target, seen = (np.array(c) for c in zip(*picked, strict=True)) if picked else [np.zeros(0)] * 3
    chosen = _chosen(rows, row.astype(np.int64), seen.astype(np.bool_))
    return Paired(chosen, target.astype(np.int64), stray)


def _compare(
    sensor: SensorGeometry, rows: Bearings, everyone: Mapping[int, ObjectPath], config: EvaluateConfig
) -> _SensorFrames:
    times, first, frame = np.unique(rows.t_ns, return_index=True, return_inverse=True)
    shape = (len(times), len(everyone))
    positions, heights = np.full((*shape, 2), np.nan), np.full(shape, np.nan)
    hidden = np.zeros(shape, dtype=np.bool_)
    for j, (k, path) in enumerate(everyone.items()):
        positions[:, j], _ = path.at(times, config.limit_ns)
        heights[:, j] = path.height_at(times, config.limit_ns)
        hidden[:, j] = occluded_by_moving(sensor, times, positions[:, j], k, everyone, config)
    present = np.isfinite(positions[:, :, 0])
    expected = sensor.expect(positions.reshape(-1, 2), heights.ravel()).reshape(shape)
    cost = inside_gate(residuals(rows, expected.take(frame), sensor), config)
    possible = present[frame] & rows.seen[:, None] & (cost <= 1.0)
    starts = [*first.tolist(), len(rows)]
    return _SensorFrames(starts, present, present & expected.clear & ~hidden, np.where(possible, cost, np.inf))


def _pair(cost: Floats, visible: Bools) -> dict[int, int]:
    """Pair the bearings of one frame with true objects, visible ones first; return the bearing's index by object.

    Args:
        cost: (bearings, objects) residual over the gate; above 1, or infinite: no pair.
        visible: (objects,) mask of those that should be seen.
    """
    if not np.isfinite(cost).any():
        return {}
    found = {j: i for i, j in pair_within(np.where(visible, cost, np.inf), 1.0)}
    rest = cost.copy()
    rest[:, list(found)] = np.inf
    rest[list(found.values())] = np.inf
    return found | {j: i for i, j in pair_within(rest, 1.0)}


def _chosen(rows: Bearings, row: Ints, seen: Bools) -> Bearings:
    """Return the rows with the indices `row` (n,); measurements become NaN where the mask `seen` (n,) is False."""
    taken = rows.take(row)
    names = ("bearing", "sigma", "u_px", "sigma_px", "score", "elevation", "sigma_elevation")
    measured = {name: np.where(seen, getattr(taken, name), np.nan) for name in names}
    return Bearings(t_ns=taken.t_ns, sensor=taken.sensor, target_id=taken.target_id, seen=seen, **measured)


@dataclass(frozen=True, eq=False)
class SensorObservations:
    """N observations of one sensor: each is a frame with one true target, and its reported bearing, if any.

    All columns have N entries; residuals, noise and elevations are NaN where nothing was reported.

    Attributes:
        t_ns: time of the frame [ns].
        target: identity of the true target.
        truth: whether the true position at that time is known.
        xy: (N, 2) true position, interpolated over gaps of any width and constant beyond the ends of the path.
        z: true height; NaN if the truth has none.
        reported: whether a bearing was reported (for candidates: one was paired with the target).
        hit: whether that bearing is within the gate.
        visible: whether the target is in view and not occluded.
        in_view: whether the target is in the field of view, occluded or not.
        residual_px: reported minus true image coordinate u [px]; cameras only.
        residual: reported minus true azimuth [rad].
        normalised: residual over its standard deviation (for cameras by Eq. 2).
        sigma_px, sigma: standard deviations of the bearing [px] and [rad].
        elevation, sigma_elevation: reported elevation and its standard deviation [rad].
        residual_elevation: reported minus true elevation, about the sensor's own axes [rad].
        normalised_elevation: that residual over its standard deviation.
    """

    t_ns: Ints
    target: Ints  # identity in the truth
    truth: Bools  # whether the target's true position at that time is known
    xy: Floats  # (N, 2) true position, held where not known
    z: Floats  # true height, held likewise; NaN if the truth has none
    reported: Bools  # a bearing was reported (for candidates: one was paired with the target)
    hit: Bools  # it is within the gate of the true direction
    visible: Bools  # the target should have been seen
    in_view: Bools  # the target was in the field of view, hidden or not
    residual_px: Floats  # reported minus true u_px
    residual: Floats  # reported minus true azimuth [rad]
    normalised: Floats  # residual over its standard deviation (Eq. 2 for cameras)
    sigma_px: Floats
    sigma: Floats
    elevation: Floats  # as reported [rad]; NaN where none was
    sigma_elevation: Floats
    residual_elevation: Floats  # reported minus true, about the sensor's own axes [rad]
    normalised_elevation: Floats

    def take(self, rows: Bools) -> SensorObservations:
        """Return the observations selected by a mask (N,)."""
        return SensorObservations(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


class SensorObservationSet(NamedTuple):
    """Observations of one sensor in all of its frames.

    `observations`: of targets; `frames`: number of frames with a known truth; `stray`: number of unlabelled bearings in
    frames with a present target that are near no true object.
    """

    observations: SensorObservations
    frames: int  # with a known truth
    stray: int  # candidates in these frames that are near no true object


def observe(
    sensor: SensorGeometry,
    rows: Bearings,
    labels: Mapping[int, int],
    targets: Mapping[int, ObjectPath],
    others: Mapping[int, ObjectPath],
    config: EvaluateConfig,
) -> SensorObservationSet:
    """Compare one sensor's bearings with the truth; return an observation for each frame and target.

    Args:
        sensor: the sensor.
        rows: its bearings.
        labels: identity in the bearings to identity in the truth; rows of other identities are skipped.
        targets: true paths of the targets by identity.
        others: true paths of the moving occluders.
        config: gates, largest gap of the truth, diameter of moving objects.
    """
    everyone = {**targets, **others}
    known = rows.take(np.isin(rows.target_id, list(labels)))
    target = np.array([labels[k] for k in known.target_id.tolist()], dtype=np.int64)
    labelled = set(zip(known.t_ns.tolist(), target.tolist(), strict=True))
    paired = match_candidates(sensor, rows.take(rows.target_id < 0), labelled, targets, everyone, config)
    observations = _concat(
        _observations(sensor, known, target, everyone, config),
        _observations(sensor, paired.rows, paired.target, everyone, config),
    )
    return SensorObservationSet(observations, len(np.unique(observations.t_ns[observations.truth])), paired.stray)


def _concat(a: SensorObservations, b: SensorObservations) -> SensorObservations:
    return SensorObservations(**{n: np.concatenate([getattr(a, n), getattr(b, n)]) for n in a.__dataclass_fields__})


def _observations(
    sensor: SensorGeometry, rows: Bearings, target: Ints, everyone: Mapping[int, ObjectPath], config: EvaluateConfig
) -> SensorObservations:
    xy, truth = np.full((len(rows), 2), np.nan), np.zeros(len(rows), dtype=np.bool_)
    z = np.full(len(rows), np.nan)
    hidden = np.zeros(len(rows), dtype=np.bool_)
    for k in np.unique(target).tolist():
        mine = target == k
        xy[mine] = everyone[k].roughly_at(rows.t_ns[mine])
        z[mine] = everyone[k].rough_height_at(rows.t_ns[mine])
        truth[mine] = everyone[k].at(rows.t_ns[mine], config.limit_ns)[1]
        hidden[mine] = occluded_by_moving(sensor, rows.t_ns[mine], xy[mine], k, everyone, config)
    expected = sensor.expect(xy, z)
    residual = residuals(rows, expected, sensor)
    return SensorObservations(
        t_ns=rows.t_ns,
        target=target,
        truth=truth,
        xy=xy,
        z=z,
        reported=rows.seen,
        hit=rows.seen & (inside_gate(residual, config) <= 1.0),
        visible=expected.clear & ~hidden,
        in_view=expected.in_view,
        residual_px=residual.px,
        residual=residual.rad,
        normalised=residual.normalised,
        sigma_px=rows.sigma_px,
        sigma=rows.sigma,
        elevation=rows.elevation,
        sigma_elevation=rows.sigma_elevation,
        residual_elevation=residual.elevation,
        normalised_elevation=residual.elevation_normalised,
    )
