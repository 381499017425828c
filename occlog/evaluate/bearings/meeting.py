"""Tracks against where the sight lines of all sensors meet: a check that needs no ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.core.metrics.errors import quantile, ratio, root_mean_square
from occlog.core.sight import triangulate
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import paths_of, sensors_of
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Tracks

Metrics = dict[str, float]


class Meetings(NamedTuple):
    """Where the sight lines to one target met, scan after scan; NaN where they were refused."""

    t_ns: Ints  # (S,) mean time of the scan's lines
    xy: Floats  # (S, 2)
    covariance: Floats  # (S, 2, 2)
    status: Ints  # (S,) see `core.triangulate.STATUS`
    n_lines: Ints  # (S,)
    residual: Floats  # (R,) of the lines of scans that met with more than two lines [rad]


def meeting_points(bearings: Bearings, scene: Scene, config: EvaluateConfig) -> dict[int, Meetings]:
    """Meeting points for every target that labelled bearings name, by its identity.

    Sensors held out are left out.  Scans with fewer than `lines_min_sensors` lines are not
    in the result.
    """
    use = bearings.seen & (bearings.target_id >= 0) & ~np.isin(bearings.sensor, config.held_out)
    rows = bearings.take(use)
    sensors = sensors_of(scene, np.unique(rows.sensor).tolist())
    grounds = {name: s.ground for name, s in sensors.items()}
    return {int(k): _meet(rows.take(rows.target_id == k), grounds, config) for k in np.unique(rows.target_id)}


def _meet(rows: Bearings, grounds: Mapping[str, Floats], config: EvaluateConfig) -> Meetings:
    starts = scan_starts(rows, round(config.lines_window_s * NS))
    size = np.diff(starts)
    keep = size >= config.lines_min_sensors
    rows, size = rows.take(np.repeat(keep, size)), size[keep]
    starts = np.concatenate([[0], np.cumsum(size)])
    origins = np.array([grounds[name] for name in rows.sensor.tolist()]).reshape(-1, 2)
    found = triangulate.sight_lines_meet(
        origins, rows.bearing, rows.sigma, starts=starts, loss=config.lines_loss, min_crossing=config.lines_min_crossing
    )
    scan = np.repeat(np.arange(len(size)), size)
    since = np.bincount(scan, weights=(rows.t_ns - rows.t_ns[starts[scan]]).astype(np.float64), minlength=len(size))
    t_ns = rows.t_ns[starts[:-1]] + np.rint(since / np.maximum(size, 1)).astype(np.int64)
    checked = (size > 2) & (found.status == triangulate.MET)
    return Meetings(
        t_ns=t_ns,
        xy=found.xy,
        covariance=found.covariance,
        status=found.status,
        n_lines=size,
        residual=found.residual[checked[scan]],
    )


def scan_starts(rows: Bearings, window_ns: int) -> Ints:
    """First row of each scan, then the number of rows.

    A scan lasts at most `window_ns` after its first row and holds each sensor at most once.
    """
    starts, begin, present = [0], 0, set[str]()
    times, sensors = rows.t_ns.tolist(), rows.sensor.tolist()
    for n, (t, sensor) in enumerate(zip(times, sensors, strict=True)):
        if n and (t - times[begin] > window_ns or sensor in present):
            starts.append(n)
            begin, present = n, set()
        present.add(sensor)
    return np.array([*starts, len(rows)] if len(rows) else [0], dtype=np.int64)


def meeting_metrics(tracks: Tracks, bearings: Bearings, scene: Scene, config: EvaluateConfig) -> Metrics:
    """Distances of the tracks from the meeting points of their own bearings' sight lines; empty without scans."""
    meetings = meeting_points(bearings, scene, config)
    total = sum(len(m.t_ns) for m in meetings.values())
    if not total:
        return {}
    paths = paths_of(tracks)
    distance = [np.zeros(0)]
    for target, m in meetings.items():
        if target in paths:
            xy, good = paths[target].at(m.t_ns, config.bridge_ns)
            good &= m.status == triangulate.MET
            distance.append(np.hypot(*(xy[good] - m.xy[good]).T))
    return _figures(np.concatenate(distance), list(meetings.values()), total, scene.length_unit, config)


def _figures(distance: Floats, meetings: list[Meetings], total: int, unit: str, config: EvaluateConfig) -> Metrics:
    met = sum(int(np.count_nonzero(m.status == triangulate.MET)) for m in meetings)
    spread = np.concatenate([np.sqrt(m.covariance[:, 0, 0] + m.covariance[:, 1, 1]) for m in meetings])
    out: Metrics = {
        "sight_lines_scans": total,
        "sight_lines_refused": total - met,
        "sight_lines_compared": len(distance),
        f"sight_lines_distance_max_{unit}": quantile(distance, 1.0),
        f"sight_lines_distance_p95_{unit}": quantile(distance, 0.95),
        f"sight_lines_distance_median_{unit}": quantile(distance, 0.5),
        f"sight_lines_distance_rms_{unit}": root_mean_square(distance),
        f"sight_lines_sigma_median_{unit}": quantile(spread[np.isfinite(spread)], 0.5),
        "sight_lines_residual_rms_mrad": 1e3 * root_mean_square(np.concatenate([m.residual for m in meetings])),
    }
    if config.lines_limit is not None:
        out["sight_lines_share_within"] = ratio(int(np.count_nonzero(distance <= config.lines_limit)), len(distance))
    return out
