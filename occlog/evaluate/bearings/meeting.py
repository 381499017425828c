"""Tracks against where the sight lines of all sensors meet: a check that needs no ground truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.errors import ratio
from occlog.core.metrics.sums import Sum
from occlog.core.sight import triangulate
from occlog.evaluate.errors.sums import quantiles_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Path, Sensor, sensors_of
from occlog.io.files.put_aside.spool import IN_MEMORY, Spool
from occlog.records.pieces import LAST
from occlog.records.scene import Scene
from occlog.records.tables import Bearings

from .scans import ScanCuts, Scans, labelled

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
    rows = labelled(bearings, config)
    sensors = sensors_of(scene, np.unique(rows.sensor).tolist())
    return {scans.target: meet(scans, sensors, config) for scans in ScanCuts(config).update(rows, LAST)}


def meet(scans: Scans, sensors: Mapping[str, Sensor], config: EvaluateConfig) -> Meetings:
    """Meeting points of a target's scans, by sensors with these names."""
    rows, starts = scans.rows, scans.starts
    size = np.diff(starts)
    keep = size >= config.lines_min_sensors
    rows, size = rows.take(np.repeat(keep, size)), size[keep]
    starts = np.concatenate([[0], np.cumsum(size)])
    origins = np.array([sensors[name].ground for name in rows.sensor.tolist()]).reshape(-1, 2)
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


class MeetingFigures:
    """Gathers distances of tracks from where sight lines meet, while scans stream by."""

    def __init__(self, unit: str, config: EvaluateConfig, in_memory: int = IN_MEMORY) -> None:
        """No scan yet.

        Args:
            unit: of lengths.
            config: how sight lines meet, and how far apart samples of tracks may be.
            in_memory: how many numbers of a kind are kept in memory.
        """
        self._unit, self._config = unit, config
        self._total = self._met = self._within = self._residuals = 0
        self._distance, self._spread = Spool(in_memory), Spool(in_memory)
        self._squares, self._residual_squares = Sum(), Sum()

    def update(self, scans: Scans, sensors: Mapping[str, Sensor], path: Path | None) -> None:
        """Some more scans of a target, by sensors with these names, and its track, or the part of it about them."""
        found = meet(scans, sensors, self._config)
        met = found.status == triangulate.MET
        self._total, self._met = self._total + len(met), self._met + int(np.count_nonzero(met))
        spread = np.sqrt(found.covariance[:, 0, 0] + found.covariance[:, 1, 1])
        self._spread.add(spread[np.isfinite(spread)])
        self._residuals += len(found.residual)
        self._residual_squares.add(float(np.square(found.residual).sum()))
        if path is not None:
            xy, good = path.at(found.t_ns, self._config.bridge_ns)
            good &= met
            distance = np.hypot(*(xy[good] - found.xy[good]).T)
            self._distance.add(distance)
            self._squares.add(float(np.square(distance).sum()))
            if self._config.lines_limit is not None:
                self._within += int(np.count_nonzero(distance <= self._config.lines_limit))

    def result(self) -> Metrics:
        """The figures; none without scans."""
        if not self._total:
            return {}
        unit, compared = self._unit, self._distance.count
        largest, high, middle = quantiles_of(self._distance, (1.0, 0.95, 0.5))
        out: Metrics = {
            "sight_lines_scans": self._total,
            "sight_lines_refused": self._total - self._met,
            "sight_lines_compared": compared,
            f"sight_lines_distance_max_{unit}": largest,
            f"sight_lines_distance_p95_{unit}": high,
            f"sight_lines_distance_median_{unit}": middle,
            f"sight_lines_distance_rms_{unit}": math.sqrt(ratio(self._squares.value, compared)),
            f"sight_lines_sigma_median_{unit}": quantiles_of(self._spread, (0.5,))[0],
            "sight_lines_residual_rms_mrad": 1e3 * math.sqrt(ratio(self._residual_squares.value, self._residuals)),
        }
        if self._config.lines_limit is not None:
            out["sight_lines_share_within"] = ratio(self._within, compared)
        return out
