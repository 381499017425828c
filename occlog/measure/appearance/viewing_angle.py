"""From which side a camera sees people: paths with headings, and viewing angles in bins ([Lee] Sec. 5.2.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Ints32
from occlog.core.numerics.interpolate import hold_positions, interpolate_positions


class Path(NamedTuple):
    """Where somebody was and headed."""

    t_ns: Ints  # (M,) rising
    xy: Floats  # (M, 2)
    heading: Floats  # (M, 2) unit vectors; NaN where it is not known


class Whereabouts(NamedTuple):
    """Everybody at some times; N times, K people."""

    identity: Ints32  # (K,) rising
    xy: Floats  # (N, K, 2) NaN: not there
    heading: Floats  # (N, K, 2) unit vectors, NaN: not known
    there: Bools  # (N, K)


def path_of(t_ns: Ints, xy: Floats, velocity: Floats, heading_ns: int, least_speed: float) -> Path:
    """Make a path of one person's rows.

    Args:
        t_ns: (M,) times, not falling; of equal times the last counts.
        xy: (M, 2) positions.
        velocity: (M, 2); NaN: take the difference of the positions half of `heading_ns` before and after.
        heading_ns: > 0.
        least_speed: people who are slower head nowhere.
    """
    last = np.append(np.diff(t_ns) > 0, True)
    t_ns, xy, velocity = t_ns[last], xy[last], velocity[last]
    unknown = np.isnan(velocity[:, 0] + velocity[:, 1])
    if unknown.any():
        # Central differences; at the ends of the path over what there is of it
        before = np.maximum(t_ns - heading_ns // 2, t_ns[0])
        after = np.minimum(t_ns + heading_ns // 2, t_ns[-1])
        moved = hold_positions(after, t_ns, xy) - hold_positions(before, t_ns, xy)
        with np.errstate(invalid="ignore", divide="ignore"):
            seconds: Floats = (after - before) / NS
            rate = moved / seconds[:, None]
        velocity = np.where(unknown[:, None], rate, velocity)
    with np.errstate(invalid="ignore", divide="ignore"):
        speed: Floats = np.hypot(velocity[:, 0], velocity[:, 1])
        heading = velocity / speed[:, None]
    heading[(speed < least_speed) | (speed == 0)] = np.nan
    return Path(t_ns, xy, heading)


def at_times(paths: dict[int, Path], t_ns: Ints, limit_ns: int) -> Whereabouts:
    """Everybody at times (N,), linear between their rows where these are at most `limit_ns` apart."""
    identity = np.array(sorted(paths), dtype=np.int32)
    n, k = len(t_ns), len(identity)
    xy, heading = np.full((n, k, 2), np.nan), np.full((n, k, 2), np.nan)
    there = np.zeros((n, k), dtype=np.bool_)
    for place, name in enumerate(identity.tolist()):
        path = paths[name]
        values, there[:, place] = interpolate_positions(
            t_ns, path.t_ns, np.column_stack([path.xy, path.heading]), limit_ns
        )
        xy[:, place] = values[:, :2]
        with np.errstate(invalid="ignore", divide="ignore"):
            heading[:, place] = values[:, 2:] / np.hypot(values[:, 2], values[:, 3])[:, None]
    return Whereabouts(identity, xy, heading, there)


def viewing_angles(xy: Floats, heading: Floats, camera: Floats) -> Floats:
    """Angles between headings and the directions to a camera, 0 (the front is seen) to pi (the back) [rad].

    Left and right are the same, since people are taken to be symmetric.

    Args:
        xy: (..., 2) places on the floor.
        heading: (..., 2) unit vectors; NaN: not known.
        camera: (2,) place on the floor.

    Returns:
        (...,) NaN where the heading is not known, or somebody stands under the camera.
    """
    to = camera - xy
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.sum(to * heading, axis=-1) / np.hypot(to[..., 0], to[..., 1])
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def angle_bins(angle: Floats, angles: int) -> Ints32:
    """Numbers n of viewing angles, 1 (front) to N (back), the nearest of (n - 1) pi / (N - 1) ([Lee] 5.6).

    Args:
        angle: [rad] 0 to pi; NaN: not known.
        angles: N; 1: all sides together, whatever the angle.

    Returns:
        0 where the angle is not known and N is above 1.
    """
    if angles == 1:
        return np.ones(np.shape(angle), dtype=np.int32)
    known = np.isfinite(angle)
    nearest = np.floor(np.where(known, angle, 0.0) * ((angles - 1) / np.pi) + 0.5)
    return np.where(known, np.minimum(nearest, angles - 1) + 1, 0).astype(np.int32)
