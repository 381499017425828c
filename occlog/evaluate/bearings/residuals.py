"""Evaluation of bearings and distance measurements: detections, bound, triangulation residuals, noise.

Tracks are also compared with triangulated positions, which needs no ground truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.consistency.verdict import ConsistencyEvidence
from occlog.core.geometry import triangulate
from occlog.core.metrics.errors import Sum, ratio_or_nan
from occlog.errors import option
from occlog.evaluate.errors.bound import BoundDimensions, Bounds
from occlog.evaluate.errors.information import DistancesOfTargets
from occlog.evaluate.errors.sums import quantiles_of
from occlog.evaluate.errors.survey import EvaluationChunk, EvaluationSurvey, SegmentTables
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.observations import SensorObservationSet, observe
from occlog.evaluate.matching.path_outline import NEAR_NS, OCCLUDER, TARGET, TruthOutlines
from occlog.evaluate.matching.paths import ObjectPath, SensorGeometry, paths_of, sensors_of
from occlog.evaluate.sources import EvaluationSources, rows_of
from occlog.evaluate.verdict import SightEvidence, in_rows_of
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.columns import ColumnTable
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene
from occlog.records.tables import LAST, Bearings, Diagnostics, Errors, TableBuffer

from .detections import DetectionFigures
from .held_out import HeldOutFigures
from .noise import MeasuredNoise, NoiseFigures, NoiseFromTruth, ScanCuts, Scans, labelled

Metrics = dict[str, float]


class TriangulationSeries(NamedTuple):
    """Triangulated positions of one target, one for each of S scans (`xy` and `covariance` are NaN where rejected).

    `t_ns`: (S,) mean time [ns]; `xy`: (S, 2) in the world; `covariance`: (S, 2, 2); `status`: (S,) code of
    `core.triangulate.STATUS`; `n_lines`: (S,) number of lines of sight; `residual`: (R,) angles [rad] of all lines of
    accepted scans with three lines or more.
    """

    t_ns: Ints  # (S,) mean time of the scan's lines
    xy: Floats  # (S, 2)
    covariance: Floats  # (S, 2, 2)
    status: Ints  # (S,) see `core.triangulate.STATUS`
    n_lines: Ints  # (S,)
    residual: Floats  # (R,) of the lines of scans that met with more than two lines [rad]


def triangulated_points(bearings: Bearings, scene: Scene, config: EvaluateConfig) -> dict[int, TriangulationSeries]:
    """Triangulate every target from its labelled bearings; return the positions by identity of the target.

    Held-out sensors are skipped, as are scans with fewer than `triangulation_min_sensors` lines of sight.
    """
    rows = labelled(bearings, config)
    sensors = sensors_of(scene, np.unique(rows.sensor).tolist())
    return {scans.target: triangulate_scan(scans, sensors, config) for scans in ScanCuts(config).update(rows, LAST)}


def triangulate_scan(
    scans: Scans, sensors: Mapping[str, SensorGeometry], config: EvaluateConfig
) -> TriangulationSeries:
    """Triangulate a target in each of its scans with at least `triangulation_min_sensors` lines of sight.

    `sensors`: by name.
    """
    rows, starts = scans.rows, scans.starts
    size = np.diff(starts)
    keep = size >= config.triangulation_min_sensors
    rows, size = rows.take(np.repeat(keep, size)), size[keep]
    starts = np.concatenate([[0], np.cumsum(size)])
    origins = np.array([sensors[name].ground for name in rows.sensor.tolist()]).reshape(-1, 2)
    found = triangulate.triangulate(
        origins,
        rows.bearing,
        rows.sigma,
        starts=starts,
        loss=config.triangulation_loss,
        min_crossing=config.triangulation_min_angle,
    )
    scan = np.repeat(np.arange(len(size)), size)
    since = np.bincount(scan, weights=(rows.t_ns - rows.t_ns[starts[scan]]).astype(np.float64), minlength=len(size))
    t_ns = rows.t_ns[starts[:-1]] + np.rint(since / np.maximum(size, 1)).astype(np.int64)
    checked = (size > 2) & (found.status == triangulate.TRIANGULATED)
    return TriangulationSeries(
        t_ns=t_ns,
        xy=found.xy,
        covariance=found.covariance,
        status=found.status,
        n_lines=size,
        residual=found.residual[checked[scan]],
    )


class TriangulationFigures:
    """Accumulates distances of tracks from triangulated positions over a stream of scans."""

    def __init__(self, unit: str, config: EvaluateConfig, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Start without scans.

        Args:
            unit: unit of lengths, part of the names of figures.
            config: loss and minimum angle of the triangulation, and largest gap of tracks that is interpolated.
            in_memory: how many numbers of a kind are kept in memory; more go to a temporary file.
        """
        self._unit, self._config = unit, config
        self._total = self._met = self._within = self._residuals = 0
        self._distance, self._spread = Spool(in_memory), Spool(in_memory)
        self._squares, self._residual_squares = Sum(), Sum()

    def update(self, scans: Scans, sensors: Mapping[str, SensorGeometry], path: ObjectPath | None) -> None:
        """Triangulate further scans of a target, and compare them with its track.

        Args:
            scans: scans of the target.
            sensors: by name.
            path: the track, at least around the scans; None: the target has no track.
        """
        found = triangulate_scan(scans, sensors, self._config)
        met = found.status == triangulate.TRIANGULATED
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
            if self._config.triangulation_tolerance is not None:
                self._within += int(np.count_nonzero(distance <= self._config.triangulation_tolerance))

    def result(self) -> Metrics:
        """Return the figures of triangulation by name; an empty mapping without scans."""
        if not self._total:
            return {}
        unit, compared = self._unit, self._distance.count
        largest, high, middle = quantiles_of(self._distance, (1.0, 0.95, 0.5))
        out: Metrics = {
            "triangulation_scans": self._total,
            "triangulation_refused": self._total - self._met,
            "triangulation_compared": compared,
            f"triangulation_distance_max_{unit}": largest,
            f"triangulation_distance_p95_{unit}": high,
            f"triangulation_distance_median_{unit}": middle,
            f"triangulation_distance_rms_{unit}": math.sqrt(ratio_or_nan(self._squares.value, compared)),
            f"triangulation_sigma_median_{unit}": quantiles_of(self._spread, (0.5,))[0],
            "triangulation_residual_rms_mrad": 1e3
            * math.sqrt(ratio_or_nan(self._residual_squares.value, self._residuals)),
        }
        if self._config.triangulation_tolerance is not None:
            out["triangulation_share_within"] = ratio_or_nan(self._within, compared)
        return out


class AgainstBearings:
    """Accumulates all figures that need bearings or distance measurements, interval by interval.

    They are: detections against truth, Cramer-Rao bound, triangulation against tracks, held-out sensors, and noise of
    bearings. Call `begin`, `update` for each interval, `finish`; then read the figures.
    """

    def __init__(
        self,
        sources: EvaluationSources,
        known: EvaluationSurvey,
        outlines: TruthOutlines,
        scene: Scene,
        config: EvaluateConfig,
        *,
        with_positions: bool = False,
    ) -> None:
        """Create empty statistics.

        Args:
            sources: inputs: either bearings with tracks, with a truth, or with both; or measurements with a truth.
            known: identities and times of tracks and truth.
            outlines: coarse paths of the true objects.
            scene: the sensors.
            config: gates, limits, bound.
            with_positions: whether the noise of cameras is measured at true positions; needs a truth.
        """
        self._sources, self._known, self._outlines = sources, known, outlines
        self._scene, self._config = scene, config
        self._sensors: dict[str, SensorGeometry] = {}
        self._cuts, self._noise = ScanCuts(config), NoiseFigures(config)
        sees = sources.bearings is not None
        self._intersection = (
            TriangulationFigures(scene.length_unit, config) if sees and sources.tracks is not None else None
        )
        held_out = bool(config.held_out) and self._intersection is not None
        self._held_out = HeldOutFigures(scene, sorted(known.tracks), config) if held_out else None
        self._detections = DetectionFigures() if sees and sources.truth is not None else None
        self._noise_from_truth = NoiseFromTruth(scene) if with_positions else None
        self._bound: Bounds | None = None
        self._labels: dict[int, int] = {}
        self._sight: SightEvidence | None = None
        self._distances: DistancesOfTargets | None = None
        self._unmatched = 0
        self._labelled = False
        self.rows = 0
        """Bearings so far."""

    def begin(self, pairs: Mapping[int, int], evidence: ConsistencyEvidence, *, high_tracks: bool) -> SegmentTables:
        """Open bearings and measurements; return the tables to read along with tracks and truth.

        Args:
            pairs: target of each track, by identity.
            evidence: receives what bearings say about the consistency of the tracks.
            high_tracks: whether any track has a height.
        """
        sources, config = self._sources, self._config
        self._bearings = TableBuffer(rows_of(sources.bearings), Bearings)
        self._measurements = TableBuffer(
            rows_of(None if sources.measured is None else sources.measured.rows), Measurements
        )
        self._diagnostics: TableBuffer[Diagnostics] | None = None
        margin_ns = 0
        if self._intersection is not None:
            self._sight = SightEvidence(evidence, self._scene, sources.made, config.held_out)
            margin_ns = self._sight.margin_ns
            if sources.diagnostics is not None and evidence.rows == self._known.estimates:
                rows = in_rows_of(rows_of(sources.tracks), sources.diagnostics())
                self._diagnostics = TableBuffer(rows, Diagnostics)
        if sources.truth is not None:
            taken = set(pairs.values())
            targets = self._outlines.labels(TARGET)
            # A number below 0 is no identity in bearings, though a track may have it
            known = {track: target for track, target in pairs.items() if track >= 0}
            self._labels = {k: k for k in targets if k >= 0 and k not in taken} | known
            ways = BoundDimensions.of(config, high=high_tracks and bool(self._outlines.high))
            self._bound = Bounds(self._scene, config, self._outlines.high, ways)
            if sources.measured is not None:
                how = sources.measured.config, sources.measured.radio
                self._distances = DistancesOfTargets(self._labels, self._scene, *how)
        sides: list[TableBuffer[Any]] = [self._bearings, *([] if self._diagnostics is None else [self._diagnostics])]
        margins_ns = [margin_ns] * len(sides)
        if self._distances is not None:
            sides, margins_ns = [*sides, self._measurements], [*margins_ns, 0]
        return SegmentTables(
            sides,
            margins_ns,
            tracks_ns=max(config.bridge_ns + self._cuts.window_ns + 1, margin_ns),
            truth_ns=0 if sources.truth is None else self._around_ns,
        )

    @property
    def _around_ns(self) -> int:
        """Margin [ns] around a section within which truth samples are needed."""
        gaps = self._outlines.gaps_ns(OCCLUDER, {})
        return max(NEAR_NS, self._config.limit_ns or 0, *self._known.gaps_ns.values(), *gaps.values()) + 1

    def update(self, part: EvaluationChunk, errors: Errors, late: Bools) -> None:
        """Add the next time interval (`part`), with the errors of its estimates.

        `late`: (n,) mask of the n errors that are after the settling time.
        """
        rows, config = part.limits.of(self._bearings), self._config
        self.rows += len(rows)
        new = set(np.unique(rows.sensor).tolist()) - set(self._sensors)
        self._sensors |= sensors_of(self._scene, new) if new else {}
        own = labelled(rows, config)
        self._noise.see(own)
        self._labelled = self._labelled or len(own) > 0
        tracks = self._tracks_about(part)
        for scans in self._cuts.update(own, part.limits.end):
            self._noise.update(scans, self._sensors)
            if self._intersection is not None:
                self._intersection.update(scans, self._sensors, tracks.get(scans.target))
        if self._held_out is not None:
            self._held_out.update(rows, tracks)
        if self._sight is not None:
            self._sight.update(part.limits, part.sides[0], self._bearings, self._diagnostics)
        if self._bound is not None:
            targets, others = self._true_paths(part)
            observations = self._observe(rows, targets, others)
            if self._detections is not None:
                self._detections.update(observations)
            if self._noise_from_truth is not None:
                self._noise_from_truth.update(observations)
            known = np.isin(rows.target_id, list(self._labels))
            self._unmatched += int(np.count_nonzero((rows.target_id >= 0) & ~known))
            counted = {name: found for name, found in observations.items() if name not in config.held_out}
            measured = None if self._distances is None else self._distances.add(part.limits.of(self._measurements))
            self._bound.update(counted, self._sensors, errors, late, targets, measured)

    def _tracks_about(self, part: EvaluationChunk) -> Mapping[int, ObjectPath]:
        """Return the tracks by identity, around all scans that end in the interval `part`.

        Scans may have begun before the interval. Empty if tracks are not compared with triangulated positions.
        """
        if self._intersection is None:
            return {}
        return paths_of(part.limits.about(part.sides[0], self._config.bridge_ns + self._cuts.window_ns + 1))

    def _true_paths(self, part: EvaluationChunk) -> tuple[dict[int, ObjectPath], dict[int, ObjectPath]]:
        """Return the true paths of targets, and of moving occluders, by identity, around the interval `part`.

        Far from the interval only coarse samples are in them.
        """
        around = self._around_ns
        near = part.limits.about(part.sides[1], around)
        limits = (part.limits.begin - around, LAST if part.limits.end == LAST else part.limits.end + around)
        gaps = (self._outlines.gaps_ns(role, self._known.gaps_ns) for role in (TARGET, OCCLUDER))
        targets, others = (
            self._outlines.paths(near, limits, role, gap) for role, gap in zip((TARGET, OCCLUDER), gaps, strict=True)
        )
        return targets, others

    def _observe(
        self, rows: Bearings, targets: Mapping[int, ObjectPath], others: Mapping[int, ObjectPath]
    ) -> dict[str, SensorObservationSet]:
        return {
            name: observe(
                self._sensors[name], rows.take(rows.sensor == name), self._labels, targets, others, self._config
            )
            for name in np.unique(rows.sensor).tolist()
        }

    def finish(self, take: Callable[[ColumnTable], None]) -> None:
        """Finish after the last interval, and pass the rows of the Cramer-Rao bound to `take`, in chunks.

        Raises:
            InputError: the bound cannot be computed (`Bounds.finish`), or ranges or range differences are implausible.
        """
        if self._distances is not None:
            self._distances.finish()
        if self._sight is not None:
            self._sight.finish()
        if self._bound is not None:
            self._bound.finish(take)

    @property
    def bound_rows(self) -> int:
        """Number of rows of the bound (CRLB); 0 if none is computed."""
        return 0 if self._bound is None else self._bound.rows

    def against_truth(self) -> Metrics:
        """Return the figures of detections and of the bound by name; empty without truth."""
        if self._bound is None:
            return {}
        metrics: Metrics = {}
        if self._detections is not None:
            metrics = {**self._detections.result(), "bearings_unmatched": self._unmatched}
        return metrics | self._bound.result(self._scene.length_unit)

    def settled_bound(self) -> Metrics:
        """Return the figures of the bound over the time after the settling time, by name; empty without a bound."""
        return self._bound.result(self._scene.length_unit, late=True) if self._bound and self._bound.rows else {}

    def noise(self) -> Metrics:
        """Return the noise of bearings as estimated from triangulation residuals, by name.

        Empty without scans in which three lines of sight meet.
        """
        return self._noise.result()

    def meeting(self) -> Metrics:
        """Return the figures of triangulation against tracks, and of held-out sensors; empty without tracks."""
        found = {} if self._intersection is None else self._intersection.result()
        return found if self._held_out is None else found | self._held_out.result()

    def noise_at_known_positions(self) -> dict[str, MeasuredNoise]:
        """Return the noise of each camera, measured where the target's true position is known.

        Empty unless it was requested.

        Raises:
            InputError: no camera has enough readings.
        """
        return {} if self._noise_from_truth is None else self._noise_from_truth.noise()

    def note(self) -> str:
        """Reason why no track was compared with triangulated positions, with the remedy."""
        return no_intersection(self._labelled, self._config)


def no_intersection(labelled: bool, config: EvaluateConfig) -> str:
    """Return the reason why no track was compared with triangulated positions, with the remedy.

    Args:
        labelled: whether any bearing states its target.
        config: time window and minimum number of sensors of a scan.
    """
    if labelled:
        return (
            f"warning: at no time bearings of one target come from {config.triangulation_min_sensors} sensors within "
            f"{config.triangulation_window_s:g} s, so that nothing is compared; widen it (triangulation_window_s)"
        )
    return (
        "warning: no bearing has a target label, so that tracks are not compared with bearings; label them with "
        f"`occlog label`, or take the numbers of sources for targets ({option('doa_labels')})"
    )
