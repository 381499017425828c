"""Truth, tracks and sensors in the form used by `evaluate`: paths by identity, sensors by name."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.bounds.in_space import sight_angles
from occlog.core.geometry.camera import planar_offsets, wrap_angle
from occlog.core.geometry.visibility import behind_walls, in_view
from occlog.core.numerics.interpolate import hold_positions, interpolate_positions
from occlog.errors import InputError
from occlog.records.columns import rows_by_label
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Tracks, Truth

from .config import BRIDGE_S

MAX_GAP_STEPS = 1.5
"""Gaps of the truth of up to this many usual steps are bridged, ..."""
MIN_BRIDGE_S = 0.2
"""... all up to this, and none above `BRIDGE_S`, unless a width is given [s]."""


@dataclass(frozen=True, eq=False)
class ObjectPath:
    """Sampled positions of one object over time, interpolated between samples that are near enough in time.

    M samples with times `t_ns` [ns], nondecreasing, positions `xy` (M, 2), and heights `z` (M,), NaN where unknown.
    `gap_ns`: default for the widest interpolated gap [ns]; None: derived from the samples, which must then be all.
    """

    t_ns: Ints  # (M,) not falling
    xy: Floats  # (M, 2)
    z: Floats | None = None  # (M,) NaN where the height is not known; None: nowhere
    gap_ns: int | None = None  # `usual_gap_ns` of the whole, of which this is a part; None: this is the whole

    @property
    def high(self) -> Bools:
        """(M,) mask of the M samples with a known height."""
        return np.zeros(len(self.t_ns), dtype=np.bool_) if self.z is None else np.isfinite(self.z)

    @property
    def usual_gap_ns(self) -> int:
        """Default for the widest gap that is interpolated [ns]: 1.5 times the median interval, between 0.2 s and 1 s.

        So a missing sample is not bridged if samples are rare: at 2 Hz a gap of 1 s is long for a person.
        """
        if self.gap_ns is not None:
            return self.gap_ns
        return usual_gap_ns(float(np.median(np.diff(self.t_ns))) if len(self.t_ns) > 1 else math.inf)

    def at(self, t_ns: Ints, limit_ns: int | None) -> tuple[Floats, Bools]:
        """Return positions (N, 2) at the times `t_ns` (N,), interpolated, and the mask (N,) of known ones.

        Others are NaN. `limit_ns`: widest gap that is interpolated [ns]; None: `usual_gap_ns`. Nothing is extrapolated.
        """
        return interpolate_positions(t_ns, self.t_ns, self.xy, self.usual_gap_ns if limit_ns is None else limit_ns)

    def sampled(self, t_ns: Ints) -> Bools:
        """Return the mask (N,) of the times `t_ns` (N,) at which the path has a sample."""
        return np.isin(t_ns, self.t_ns)

    def roughly_at(self, t_ns: Ints) -> Floats:
        """Return positions (N, 2) at `t_ns` (N,), interpolated over gaps of any width, constant beyond the ends."""
        return hold_positions(t_ns, self.t_ns, self.xy)

    def height_at(self, t_ns: Ints, limit_ns: int | None) -> Floats:
        """Return the heights (N,) at `t_ns` (N,), interpolated between samples with a height; NaN if unknown.

        `limit_ns`: widest gap that is interpolated [ns]; None: `usual_gap_ns`.
        """
        known = self.high
        if self.z is None or not known.any():
            return np.full(len(t_ns), np.nan)
        limit = self.usual_gap_ns if limit_ns is None else limit_ns
        return interpolate_positions(t_ns, self.t_ns[known], self.z[known][:, None], limit)[0][:, 0]

    def rough_height_at(self, t_ns: Ints) -> Floats:
        """Return heights (N,) at `t_ns` (N,), interpolated over gaps of any width, constant beyond the ends.

        NaN without heights.
        """
        known = self.high
        if self.z is None or not known.any():
            return np.full(len(t_ns), np.nan)
        return hold_positions(t_ns, self.t_ns[known], self.z[known][:, None])[:, 0]


def usual_gap_ns(step_ns: float) -> int:
    """Return the default for the widest interpolated gap [ns] of samples with the usual interval `step_ns` [ns].

    1.5 times the interval, between 0.2 s and 1 s.
    """
    return round(min(max(MAX_GAP_STEPS * step_ns, MIN_BRIDGE_S * NS), BRIDGE_S * NS))


def paths_of(table: Truth | Tracks, role: str | None = None) -> dict[int, ObjectPath]:
    """Return the path of every identity in a table, sorted by identity.

    `role`: only rows of a truth with this role, `target` or `occluder`; None: all.
    """
    keep = np.ones(len(table), dtype=np.bool_)
    if role is not None and isinstance(table, Truth):
        keep = table.role == role
    t_ns, ids, xy = table.t_ns[keep], table.target_id[keep], np.column_stack([table.x, table.y])[keep]
    z = table.z[keep]
    return {name: ObjectPath(t_ns[rows], xy[rows], z[rows]) for name, rows in rows_by_label(ids)}


class ExpectedMeasurement(NamedTuple):
    """Noise-free measurements that a sensor should make of N positions.

    `bearing`: azimuth in the world [rad]; `u_px`: horizontal offset from the principal point, to the right [px], NaN if
    not in front of a camera; `variance_px`: of `u_px` by pose errors ([Ercan] Eq. 2 without read noise); `in_view`:
    mask, in the field of view and range; `clear`: mask, also not behind a wall or static occluder; `theta`, `phi`:
    azimuth about the sensor's own z axis and angle from that axis [rad], NaN without a height. All (N,) unless
    reshaped.
    """

    bearing: Floats  # (N,) azimuth [rad]
    u_px: Floats  # (N,) offset to the right; NaN where not in front, or not a camera
    variance_px: Floats  # (N,) of u_px by Eq. 2 without the read noise
    in_view: Bools  # (N,) in front, in the field of view and in range
    clear: Bools  # (N,) in view and not behind a wall or a static occluder
    theta: Floats  # (N,) azimuth about the sensor's own z axis [rad]; NaN where the height is not known
    phi: Floats  # (N,) angle from that axis [rad]; NaN where the height is not known

    def reshape(self, shape: tuple[int, ...]) -> ExpectedMeasurement:
        """Return a copy with all arrays reshaped to `shape`."""
        return ExpectedMeasurement._make(column.reshape(shape) for column in self)

    def take(self, rows: Ints) -> ExpectedMeasurement:
        """Return the entries at the indices `rows` of the first axis of all arrays."""
        return ExpectedMeasurement._make(column[rows] for column in self)


@dataclass(frozen=True, eq=False)
class SensorGeometry:
    """A camera or microphone array with the static polygons that occlude its view.

    `ground`: (2,) position and `height`, in the scene's unit; `camera`: None for an array; `reach`: maximum range;
    `walls`: vertices (n, 2) of each polygon; `rotation`: (3, 3) world from array, of a camera the identity; `upright`:
    whether the array's z axis is vertical.
    """

    name: str
    ground: Floats  # (2,)
    camera: Camera | None
    reach: float
    walls: tuple[Floats, ...]
    height: float = 0.0
    rotation: Floats = field(default_factory=lambda: np.eye(3))  # world-from-array; of a camera none: it is levelled
    upright: bool = True

    @property
    def position(self) -> Floats:
        """Position (3,) of the sensor in the world, in the scene's unit of length."""
        return np.append(self.ground, self.height)

    def expect(self, xy: Floats, z: Floats) -> ExpectedMeasurement:
        """Return the expected measurements of N positions `xy` (N, 2) at heights `z` (N,).

        NaN positions are not in view. If a height is unknown (NaN), the distance from an array is taken in the plane.
        """
        bearing = wrap_angle(np.arctan2(xy[:, 1] - self.ground[1], xy[:, 0] - self.ground[0]))
        theta, phi = sight_angles(np.column_stack([xy, z]), self.position, self.rotation)
        if self.camera is None:
            rise = np.where(np.isnan(z), 0.0, z - self.height)
            with np.errstate(invalid="ignore"):
                near = np.hypot(np.hypot(*(xy - self.ground).T), rise) <= self.reach
            nan = np.full(len(xy), np.nan)
            return ExpectedMeasurement(
                bearing=bearing, u_px=nan, variance_px=nan, in_view=near, clear=near, theta=theta, phi=phi
            )  # sound goes past walls
        camera, f = self.camera, float(self.camera.focal_px[0])
        h, d = planar_offsets(xy, self.ground, camera.yaw)
        view = in_view(h, d, camera.fov, self.reach)
        front = d > 0
        rho = np.where(front, h, np.nan) / np.where(front, d, 1.0)
        spread = (1.0 + rho**2) * camera.sigma_yaw**2 + (camera.sigma_position / np.where(front, d, 1.0)) ** 2
        clear = view.copy()
        clear[view] = ~behind_walls(self.ground, xy[view], self.walls)
        return ExpectedMeasurement(
            bearing=bearing,
            u_px=-f * rho,
            variance_px=f**2 * (1.0 + rho**2) * spread,
            in_view=view,
            clear=clear,
            theta=theta,
            phi=phi,
        )


def sensors_of(scene: Scene, names: Iterable[str], source: str = "bearings") -> dict[str, SensorGeometry]:
    """Return the geometry of the named sensors by name, sorted; InputError for one without a pose in the scene.

    `source`: what names them, for the message.
    """
    cameras = {c.name: c for c in scene.cameras if c.placed}
    arrays = {a.name: a for a in scene.arrays}
    out = {}
    for name in sorted(set(names)):
        if name in cameras:
            c = cameras[name]
            out[name] = SensorGeometry(
                name=name,
                ground=c.ground,
                camera=c,
                reach=c.range,
                walls=scene.blockers(c.ground),
                height=float(c.position[2]),
            )
        elif name in arrays:
            a = arrays[name]
            out[name] = SensorGeometry(
                name=name,
                ground=a.position[:2],
                camera=None,
                reach=a.range,
                walls=(),
                height=float(a.position[2]),
                rotation=a.rotation,
                upright=a.upright,
            )
        else:
            known = ", ".join([*cameras, *arrays]) or "none"
            raise InputError(
                f"{source}: sensor {name!r} is not in the scene, or has no pose; the scene has: {known}",
                id="unknown-sensor",
            )
    return out
