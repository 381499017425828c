"""Measurement models of cameras and arrays, with derivatives and variances ([Ercan] Eqs. 1 and 2).

Also the interface of measurement models of stations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import second_order_variance, wrap_angle
from occlog.core.geometry.visibility import Sensors, seen_from
from occlog.core.plane import Floor, on_floor

from .directions import MIN_DEPTH, MIN_DEPTH_RATIO, PackedScan, PoseNoise


class MeasurementWorld(NamedTuple):
    """Sensors with their noise, and the region where a target can be."""

    sensors: Sensors
    noise: PoseNoise
    floor: Floor


class LinearisedRows(NamedTuple):
    """R measurements of directions in a scan (pixels and bearings) in columns, prepared for linearisation."""

    sensor: Ints  # (R,)
    pixel: Bools  # (R,) true: z [px], false: a bearing [rad]
    value: Floats  # (R,)
    variance: Floats  # (R,) of reading [px^2], or of the bearing in all [rad^2]
    labelled: Bools  # (R,) false: a candidate, which may be of anything

    def take(self, which: Bools | Ints) -> LinearisedRows:
        """Return the rows selected by a mask or by indices `which`; these are not changed."""
        return LinearisedRows._make(column[which] for column in self)


def rows_of(packed: PackedScan) -> LinearisedRows:
    """Return the M measurements of a packed scan as rows for linearisation, in their order."""
    count = np.diff(packed.first)
    sensor, labelled = np.repeat(packed.sensor, count), np.repeat(packed.labelled, count)
    return LinearisedRows(sensor, packed.pixel, packed.value, packed.variance, labelled)


def offsets(xy: Floats, rows: LinearisedRows, world: MeasurementWorld) -> tuple[Floats, Floats]:
    """Return (..., R) offsets h across (left) and d along the optical axes of the rows' sensors, [Ercan] Fig. 2.

    `xy` (..., 2) are positions; h and d are lengths.
    """
    away = xy[..., None, :] - world.sensors.xy[rows.sensor]
    c, s = world.sensors.axis[rows.sensor].T
    return c * away[..., 1] - s * away[..., 0], c * away[..., 0] + s * away[..., 1]


def measured(xy: Floats, rows: LinearisedRows, world: MeasurementWorld) -> tuple[Floats, Bools]:
    """Return (L, R) noise-free measurements [px or rad] of positions by the sensors of R rows, and a mask (L, R).

    The mask is of possible measurements: a pixel needs a position in front of the camera (d > 0); where it is false the
    value has no meaning.

    Args:
        xy: (L, 2) positions.
        rows: R rows; their values do not count.
        world: positions, axes and focal lengths of the sensors.
    """
    h, d = offsets(xy, rows, world)
    ahead = ~rows.pixel | (d > np.maximum(MIN_DEPTH_RATIO * np.abs(h), MIN_DEPTH))
    ratio = world.noise.focal_px[rows.sensor] * h / np.where(ahead & rows.pixel, d, 1.0)
    c, s = world.sensors.axis[rows.sensor].T
    azimuth = np.arctan2(c * h + s * d, c * d - s * h)
    return np.where(rows.pixel, ratio, azimuth), ahead


def azimuths(rows: LinearisedRows, world: MeasurementWorld) -> Floats:
    """Return (R,) azimuths of the rows' lines of sight in the world [rad]."""
    yaw = np.arctan2(world.sensors.axis[rows.sensor, 1], world.sensors.axis[rows.sensor, 0])
    f = np.where(rows.pixel, world.noise.focal_px[rows.sensor], 1.0)
    return np.where(rows.pixel, yaw + np.arctan2(rows.value, f), rows.value)


def residuals(expected: Floats, rows: LinearisedRows) -> Floats:
    """Return (..., R) measured minus `expected` values [px or rad]; those of bearings are wrapped to [-pi, pi)."""
    off = rows.value - expected
    return np.where(rows.pixel, off, wrap_angle(off))


def linearised(xy: Floats, rows: LinearisedRows, world: MeasurementWorld) -> tuple[Floats, Floats]:
    """Return (..., R, 2) derivatives of measurements by the position, and their variances (..., R), [Ercan] Eq. 2.

    Both are in px or rad, as the rows. Pixels need positions in front of the camera.

    Args:
        xy: (..., 2) positions.
        rows: R rows.
        world: positions, axes and errors of the sensors.
    """
    h, d = offsets(xy, rows, world)
    c, s = world.sensors.axis[rows.sensor].T
    f = world.noise.focal_px[rows.sensor]
    d1 = np.where(rows.pixel, d, 1.0)
    ratio = h / d1
    # z = f h / d: dz = f (dh - z / f dd) / d
    reading = (f / d1)[..., None] * (np.column_stack([-s, c]) - ratio[..., None] * np.column_stack([c, s]))
    away = xy[..., None, :] - world.sensors.xy[rows.sensor]
    r2 = np.maximum((away**2).sum(axis=-1), MIN_DEPTH)
    bearing = np.stack([-away[..., 1], away[..., 0]], axis=-1) / r2[..., None]
    spread = 1.0 + ratio**2
    pose = spread * world.noise.sigma_yaw[rows.sensor] ** 2 + (world.noise.sigma_position[rows.sensor] / d1) ** 2
    return (
        np.where(rows.pixel[:, None], reading, bearing),
        np.where(rows.pixel, rows.variance + f**2 * spread * pose, rows.variance),
    )


class Linearisation(NamedTuple):
    """R measurements of directions linearised at the position `at`: residuals, derivatives and variances."""

    at: Floats  # (2,)
    residual: Floats  # (R,) what was measured less what is expected there
    ahead: Bools  # (R,) the sensor could measure it
    H: Floats  # (R, 2) derivatives
    R: Floats  # (R,) variances

    def take(self, which: Bools | Ints) -> Linearisation:
        """Return the measurements selected by a mask or indices; the position stays."""
        own = self.residual[which], self.ahead[which], self.H[which], self.R[which]
        return Linearisation(self.at, *own)

    def innovation(self, mean: Floats) -> Floats:
        """Return (R,) measured values minus those expected for a state with `mean` (n,), position first."""
        return np.asarray(self.residual - self.H @ (mean[:2] - self.at))


def linearise(at: Floats, rows: LinearisedRows, world: MeasurementWorld) -> Linearisation:
    """Linearise R measurements at the position `at` (2,), with the sensor poses and systematic errors of `world`."""
    expected, ahead = measured(at[None], rows, world)
    return Linearisation(at, residuals(expected[0], rows), ahead[0], *linearised(at, rows, world))


def near_sensor_variance(xy: Floats, covariance: Floats, rows: LinearisedRows, world: MeasurementWorld) -> Floats:
    """Return (R,) second-order variances of measurements of a Gaussian position, [px^2] or [rad^2], as the rows.

    Args:
        xy: (2,) mean.
        covariance: (2, 2) of the position.
        rows: R rows.
        world: positions, axes and focal lengths of the sensors.
    """
    angle = second_order_variance(xy - world.sensors.xy[rows.sensor], covariance)
    if not rows.pixel.any():
        return angle
    h, d = offsets(xy, rows, world)
    before = rows.pixel & (d > np.maximum(MIN_DEPTH_RATIO * np.abs(h), MIN_DEPTH))
    px = world.noise.focal_px[rows.sensor] * (1.0 + (h / np.where(before, d, 1.0)) ** 2)
    return angle * np.where(before, px**2, 1.0)


def visible(xy: Floats, rows: LinearisedRows, world: MeasurementWorld) -> Bools:
    """Return (L, R) booleans: the sensors of R rows can see positions `xy` (L, 2).

    The positions are on the floor, in field of view and range, and not behind walls or static occluders.
    """
    xy = np.ascontiguousarray(xy)
    free = on_floor(xy, world.floor.room, world.floor.walls, world.floor.starts)
    columns = [free & seen_from(xy, int(i), world.sensors) for i in rows.sensor]
    return np.column_stack(columns) if columns else np.empty((len(xy), 0), dtype=np.bool_)


class StationPositions(NamedTuple):
    """Positions of the stations of m measurements of distances, and of their reference stations, on the ground.

    `rise2` and `other_rise2` are the squares of their heights over the target.
    """

    position: Floats  # (m, 2) of the station, p
    rise2: Floats  # (m,) square of its height over the target
    other: Floats  # (m, 2) of the reference of a difference, q; else that of the station
    other_rise2: Floats  # (m,)


class MeasurementModel(NamedTuple):
    """Interface of a measurement model: z = h(x) + noise.

    `predict(xy, geometry)` gives h (..., m) at positions (..., m or 1, 2) and its gradient (..., m, 2).
    """

    predict: Callable[[Floats, StationPositions], tuple[Floats, Floats]]
    compiled: int  # the kind by which `occlog.track.methods.apf.kernels.importance.linearise` knows it
    angular: bool = False  # residuals are wrapped to [-pi, pi)
    delayed: bool = False  # a signal without a free path comes late, so that values are too long
    column: str | None = None  # of the table `measurements`, for values that are taken as they stand there
