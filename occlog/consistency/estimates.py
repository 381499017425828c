"""Quality flags of estimates, from the row, the scene and earlier detections.

The checks are functions of arrays that return masks; `QualityFlags` applies them to the rows of a run.

`SensorDisagreement` flags rows while one sensor contradicts the estimate, i.e. most of its recent measurements are
rejected: its clock, pose or labels are wrong, or the track follows other sensors that are wrong.

`EffectiveSampleSizes` is a histogram of effective sample sizes in bounded memory.

`PositionConsistency` compares positions from bearings alone with the scene. A filter with walls moves its estimate to
where no wall contradicts the detections, and one with a room keeps it inside; wrong walls thus leave small residuals
and large errors. The intersection of the accepted bearings of a time step, which depends on neither, reveals them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.visibility import ViewPrior, behind_walls
from occlog.core.plane import inside_polygon
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import Diagnostics, Residuals, Tracks
from occlog.scans.grouping import sensor_names

EXCHANGED_LABELS, LABEL_JUMP = "exchanged_labels", "label_jump"
"""Values of the column `quality_flags` of rows the labels of which are against the continuity of motion."""
REGION_EDGE, SINGLE_SENSOR, OUT_OF_VIEW, UNDETECTED_IN_VIEW, INCONSISTENT_SENSOR = (
    "region_edge",
    "single_sensor",
    "out_of_view",
    "undetected_in_view",
    "inconsistent_sensor",
)
"""Values of the column `quality_flags`, in the order of the column."""
ROW_FLAGS = (REGION_EDGE, SINGLE_SENSOR, OUT_OF_VIEW, UNDETECTED_IN_VIEW)
"""Flags that follow from the row, the scene and earlier detections."""
EDGE_SIGMAS = 2.0
"""Distance from the edge below which an estimate is at the edge, in standard deviations."""
VIEW_SIGMAS = 3.0
"""Distance from the view beyond which an estimate is out of view, in standard deviations."""
SINGLE_SENSOR_S = 5.0
"""Time after the last simultaneous detection by two sensors for which a single sensor suffices [s]."""
TOGETHER_S = 1.0
"""Two sensors see a target at once if they do within this time; so long a filter waits for a second one [s]."""
MIN_UNDETECTED_CAMERAS = 2
"""Cameras that observe a target in plain view without detecting it, at least."""
UNDETECTED_PROBABILITY = 1e-5
"""Probability of so many missed detections in a row below which the target is not where the estimate has it."""
MAX_DETECTION_PROBABILITY = 0.98
"""Upper limit of a camera's probability of detection, as misses are not independent."""
RESTART_FALLBACKS = ("restart", "gap")
"""Values of `fallback` of rows in which a filter has restarted."""


def near_edge(xy: Floats, covariance: Floats, region: Floats) -> Bools:
    """Return (N,) booleans: the estimate is at the edge of a region (within 2 standard deviations), or outside of it.

    Args:
        xy: (N, 2) estimated positions.
        covariance: (N, 2, 2) covariances of these.
        region: (K, 2) convex polygon, counter-clockwise.
    """
    edge = np.roll(region, -1, axis=0) - region
    inwards = np.column_stack([-edge[:, 1], edge[:, 0]]) / np.hypot(*edge.T)[:, None]
    depth = np.einsum("nki,ki->nk", xy[:, None] - region, inwards)
    sigma = np.sqrt(np.maximum(np.einsum("ki,nij,kj->nk", inwards, covariance, inwards), 0.0))
    return np.asarray(np.any(depth < EDGE_SIGMAS * sigma, axis=1))


def outside_view(xy: Floats, covariance: Floats, origin: Floats, yaw: float, fov: float, reach: float) -> Bools:
    """Return (N,) booleans: the estimate is clearly outside a sensor's field of view or beyond its range.

    Clearly means by more than 3 standard deviations.

    Args:
        xy: (N, 2) estimated positions.
        covariance: (N, 2, 2) covariances of these.
        origin: (2,) position of the sensor.
        yaw: azimuth of its axis [rad].
        fov: full field of view [rad]; from 2 pi on it sees all around.
        reach: greatest distance [length]; may be infinite.
    """
    away = xy - origin
    r = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-12)
    e = away / r[:, None]
    across = np.column_stack([-e[:, 1], e[:, 0]])
    sigma_r, sigma_across = (np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", u, covariance, u), 0.0)) for u in (e, across))
    off = np.abs(wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - yaw)) - 0.5 * fov
    at_edge = (fov < 2.0 * np.pi) & (off > VIEW_SIGMAS * np.arctan2(sigma_across, r))
    # Within its own uncertainty an estimate is at the sensor, in any direction
    at_edge &= r > VIEW_SIGMAS * sigma_r
    return np.asarray(at_edge | (r - reach > VIEW_SIGMAS * sigma_r))


def without_distance(xy: Floats, covariance: Floats, origin: Floats, far: float) -> Floats:
    """Return the (2, 2) covariance of an estimate at unknown distance from a single sensor.

    Along the line of sight it is the second moment, about the estimate, of a uniform prior from the sensor to its
    maximum range: the bearings of one sensor hardly determine the distance, and a small filter covariance there results
    from settings of motion and noise.

    Args:
        xy: (2,) estimated position.
        covariance: (2, 2) covariance of the filter; the result is not smaller.
        origin: (2,) position of the sensor.
        far: maximum range of the sensor [length].
    """
    away = xy - origin
    r = float(np.hypot(*away))
    e = away / r if r > 0.0 else np.array([1.0, 0.0])
    more = far**2 / 12.0 + (r - 0.5 * far) ** 2 - e @ covariance @ e
    return covariance + max(float(more), 0.0) * np.outer(e, e)


def covariances(tracks: Tracks) -> Floats:
    """Return the position covariances (N, 2, 2) of the rows of `tracks`."""
    return np.stack([tracks.cov_xx, tracks.cov_xy, tracks.cov_xy, tracks.cov_yy], axis=1).reshape(-1, 2, 2)


class RivalTrajectory(NamedTuple):
    """Another trajectory of a target nearly as probable as the reported one, and where the two differ.

    `excess` is by how much its negative log posterior is higher; `rows` of its `of` states, from `first_ns` to
    `last_ns` [ns], are significantly elsewhere, at most `distance` away.
    """

    excess: float  # by how much its negative log posterior is higher
    rows: int  # states at which it is significantly elsewhere
    of: int  # states in all
    distance: float  # largest distance
    first_ns: int  # first of these states
    last_ns: int  # last of them


class DetectionHistory(NamedTuple):
    """Last time at which each sensor detected a target, since its filter began or two sensors last detected it at once.

    At once means within `TOGETHER_S`, by sensors at different positions.
    """

    begun_ns: int  # when the filter began
    last_ns: dict[str, int]  # by sensor, since two of them saw it at once
    together_ns: int | None = None  # when two of them did; None: never since the filter began


class QualityFlags:
    """Sets the quality flags of a run's rows, chunk by chunk, with the detection history of each target."""

    def __init__(
        self, scene: Scene, *, online: bool, started: bool, distances: bool = False, occluders: bool = False
    ) -> None:
        """Start without rows.

        Args:
            scene: the sensors, and the region if there is no room.
            online: estimates use no later measurements: then a single sensor, and an edge of a guessed region, are
                flagged.
            started: the settings state where the target was initially.
            distances: stations measure distances, too, so that one sensor alone may determine a position.
            occluders: moving occluders are known, so that missed detections are not flagged.
        """
        self._distances = distances
        self._scene, self._online, self._started = scene, online, started
        self._views: ViewPrior | None = scene.views
        self._row = {name: i for i, name in enumerate(sensor_names(scene))}
        self._sensors: tuple[Camera | MicrophoneArray, ...] = (*scene.cameras, *scene.arrays)
        self._position = {s.name: (float(s.position[0]), float(s.position[1])) for s in self._sensors}
        self._seen: dict[int, DetectionHistory] = {}
        self._misses = None if occluders or distances else PlainViewMisses(scene)

    def judged(self, tracks: Tracks, diagnostics: Diagnostics) -> tuple[Tracks, Diagnostics]:
        """Return copies of the rows with quality flags, and with wider covariances where the distance is unknown.

        `diagnostics` are rows of the same estimates as `tracks`.
        """
        if not len(tracks):
            return tracks, diagnostics
        by = [tuple(name for name in text.split(",") if name) for text in diagnostics.seen_by.tolist()]
        xy, covariance = np.column_stack([tracks.x, tracks.y]), covariances(tracks)
        edge = alone = np.zeros(len(by), dtype=np.bool_)
        lone: dict[int, str] = {}
        if self._online and not self._distances:
            alone, lone = self._alone(diagnostics, by)
            tracks, covariance = self._widened(tracks, xy, covariance, lone)
        if self._online and self._views is not None:
            # An unknown distance reaches the edge in any case
            edge = near_edge(xy, covariance, self._scene.region)
            edge[list(lone)] = False
        outside = self._outside(xy, covariance, by)
        denied = np.zeros(len(by), dtype=np.bool_)
        if self._misses is not None:
            denied = self._misses.denied(xy, diagnostics, by)
        doubt = [
            ",".join(name for name, has in zip(ROW_FLAGS, row, strict=True) if has)
            for row in zip(edge.tolist(), alone.tolist(), outside.tolist(), denied.tolist(), strict=True)
        ]
        return tracks, diagnostics.with_columns(quality_flags=np.array(doubt, dtype=np.str_))

    def _outside(self, xy: Floats, covariance: Floats, by: list[tuple[str, ...]]) -> Bools:
        """Return (N,) booleans: at least half of the sensors that detected the target cannot see the estimate.

        Args:
            xy: (N, 2) estimated positions.
            covariance: (N, 2, 2) covariances of these.
            by: names of the sensors that detected the target, for each estimate.
        """
        saw, cannot = np.zeros(len(xy), dtype=np.int64), np.zeros(len(xy), dtype=np.int64)
        for c in self._sensors:
            rows = np.array([c.name in names for names in by], dtype=np.bool_)
            if rows.any():
                fov = c.fov if isinstance(c, Camera) else 2.0 * np.pi
                saw[rows] += 1
                cannot[rows] += outside_view(xy[rows], covariance[rows], c.position[:2], c.yaw, fov, c.range)
        return np.asarray((cannot > 0) & (2 * cannot >= saw))

    def _widened(self, tracks: Tracks, xy: Floats, covariance: Floats, lone: dict[int, str]) -> tuple[Tracks, Floats]:
        """Return tracks and covariances (N, 2, 2), widened in rows at unknown distance from a single sensor.

        Nothing is changed in a scene with a room, as its walls limit the distance.

        Args:
            tracks: N estimates.
            xy: (N, 2) their positions.
            covariance: (N, 2, 2) their covariances; changed in place.
            lone: name of the only sensor that has detected the target, by row.
        """
        if self._views is None or not lone:
            return tracks, covariance
        for n, name in lone.items():
            i = self._row[name]
            covariance[n] = without_distance(xy[n], covariance[n], self._views.origin[i], float(self._views.far[i]))
        columns = {c.name: getattr(tracks, c.name) for c in Tracks.columns()}
        columns |= {"cov_xx": covariance[:, 0, 0], "cov_xy": covariance[:, 0, 1], "cov_yy": covariance[:, 1, 1]}
        return Tracks(**{name: np.ascontiguousarray(values) for name, values in columns.items()}), covariance

    def _alone(self, diagnostics: Diagnostics, by: list[tuple[str, ...]]) -> tuple[Bools, dict[int, str]]:
        """Return (N,) booleans: sensors at a single position have detected the target for long; and the rows of these.

        Long is above `SINGLE_SENSOR_S` since two last detected it at once, or above `TOGETHER_S` since the filter began
        if two never did. Only in the latter case, without a known distance, the second result, a dict, has the sensor's
        name by row. The detection histories are updated in place.

        Args:
            diagnostics: N rows in the order of time.
            by: names of the sensors that detected the target, for each row.
        """
        alone = np.zeros(len(by), dtype=np.bool_)
        lone: dict[int, str] = {}
        rows = zip(
            diagnostics.t_ns.tolist(), diagnostics.target_id.tolist(), diagnostics.fallback.tolist(), by, strict=True
        )
        for n, (t_ns, target, fallback, names) in enumerate(rows):
            seen = self._seen.get(target)
            if seen is None or fallback in RESTART_FALLBACKS:
                seen = DetectionHistory(t_ns, {}, t_ns if self._started and seen is None else None)
            last = seen.last_ns | dict.fromkeys(names, t_ns)
            # Two sensors at one position determine the distance no better than one of them
            here = {self._position[s] for s, at in last.items() if t_ns - at <= TOGETHER_S * NS}
            seen = seen._replace(last_ns={}, together_ns=t_ns) if len(here) > 1 else seen._replace(last_ns=last)
            self._seen[target] = seen
            if seen.together_ns is None:
                late = t_ns - seen.begun_ns > TOGETHER_S * NS
            else:
                late = t_ns - seen.together_ns > SINGLE_SENSOR_S * NS
            alone[n] = late and len({self._position[s] for s in seen.last_ns}) == 1
            if alone[n] and seen.together_ns is None:
                lone[n] = next(iter(seen.last_ns))
        return alone, lone


class PlainViewMisses:
    """Counts how often cameras with an unoccluded view of a target missed it since any sensor detected it.

    It also learns each camera's probability of detection, from targets that another sensor detects.
    """

    def __init__(self, scene: Scene) -> None:
        """Start without rows.

        Args:
            scene: cameras, walls and static occluders.
        """
        self._cameras = [c for c in scene.cameras if c.placed]
        self._walls = {c.name: scene.blockers(c.ground) for c in self._cameras}
        # Of each camera: views in which another one detected the target, and in how many of these it did, too
        self._views: dict[str, tuple[int, int]] = {}
        self._log_odds: dict[int, tuple[float, frozenset[str]]] = {}  # of each target's misses, by which cameras

    def denied(self, xy: Floats, diagnostics: Diagnostics, by: list[tuple[str, ...]]) -> Bools:
        """Return (N,) booleans: cameras with an unoccluded view have missed the target more often than chance allows.

        At least `MIN_UNDETECTED_CAMERAS` have missed it since any sensor detected it, in a sequence of misses with a
        probability below `UNDETECTED_PROBABILITY`. The counts are updated in place.

        Args:
            xy: (N, 2) estimated positions.
            diagnostics: N rows, of which the column `cameras` has the sensors used.
            by: names of the sensors that detected the target, for each row.
        """
        count = np.array([len(names) for names in by], dtype=np.int64)
        in_view: dict[str, Bools] = {}
        for c in self._cameras:
            looked = np.array([c.name in text.split(",") for text in diagnostics.cameras.tolist()], dtype=np.bool_)
            in_view[c.name] = looked & self._plain(xy, c)
            saw = np.array([c.name in names for names in by], dtype=np.bool_)
            other = in_view[c.name] & (count - saw > 0)
            views, detected = self._views.get(c.name, (0, 0))
            self._views[c.name] = views + int(other.sum()), detected + int(np.count_nonzero(other & saw))
        out = np.zeros(len(by), dtype=np.bool_)
        if count.all():
            self._log_odds.clear()
            return out
        # One view more, half of which detects: without any, the probability of detection is a half
        miss = {
            name: math.log(1.0 - min((detected + 0.5) / (views + 1.0), MAX_DETECTION_PROBABILITY))
            for name, (views, detected) in self._views.items()
        }
        for n, target in enumerate(diagnostics.target_id.tolist()):
            if count[n]:
                self._log_odds.pop(target, None)
                continue
            names = frozenset(name for name, plain in in_view.items() if plain[n])
            if names:
                odds, before = self._log_odds.get(target, (0.0, frozenset()))
                odds, names = odds + math.fsum(miss[name] for name in names), names | before
                self._log_odds[target] = odds, names
                out[n] = odds < math.log(UNDETECTED_PROBABILITY) and len(names) >= MIN_UNDETECTED_CAMERAS
        return out

    def _plain(self, xy: Floats, camera: Camera) -> Bools:
        """Return (N,) booleans: position `xy` (N, 2) is in view and range of a camera, with no wall between.

        Walls are the scene's walls and static occluders.
        """
        away = xy - camera.ground
        off = np.abs(wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - camera.yaw))
        seen = (off <= 0.5 * camera.fov) & (np.hypot(away[:, 0], away[:, 1]) <= camera.range)
        return np.asarray(seen & ~behind_walls(camera.ground, xy, self._walls[camera.name]))


WINDOW_NS = NS
"""How far back bearings count [ns]."""
MIN_REJECTED_SHARE = 2.0 / 3.0
"""Share of a sensor's bearings of a target in this time that are rejected, from which it contradicts."""
MIN_REJECTED_BEARINGS = 5
"""Minimum number of rejected bearings of a sensor: single false ones are no contradiction."""


class SensorDisagreement:
    """Sets the flag `inconsistent_sensor` of a run's rows, chunk by chunk, from the residuals of the last second."""

    def __init__(self) -> None:
        """Start without residuals."""
        self._kept: list[Residuals] = []

    def judged(self, diagnostics: Diagnostics, residuals: Residuals) -> Diagnostics:
        """Return the diagnostics of the next rows, with the flag `inconsistent_sensor` set where a sensor contradicts.

        A sensor contradicts where at least two thirds of its bearings of the target in the last second are rejected,
        and at least `MIN_REJECTED_BEARINGS` of them.

        Args:
            diagnostics: rows in the order of time.
            residuals: residuals of bearings at these rows.
        """
        known = Residuals.concat([*self._kept, residuals])
        if not len(diagnostics):
            self._kept = [known]
            return diagnostics
        self._kept = [known.take(known.t_ns > diagnostics.t_ns[-1] - WINDOW_NS)]
        against = np.zeros(len(diagnostics), dtype=np.bool_)
        if np.count_nonzero(known.inlier_probability < 0.5) >= MIN_REJECTED_BEARINGS:
            for target in np.unique(diagnostics.target_id).tolist():
                rows = diagnostics.target_id == target
                against[rows] = _against(diagnostics.t_ns[rows], known.take(known.target_id == target))
        return flagged(diagnostics, against, INCONSISTENT_SENSOR)


def flagged(diagnostics: Diagnostics, rows: Bools, flag: str) -> Diagnostics:
    """Return diagnostics with the quality flag `flag` added where the mask `rows` (N,) is True."""
    if not rows.any():
        return diagnostics
    every = diagnostics.quality_flags.astype(object)
    every[rows] = [",".join(filter(None, (old, flag))) for old in every[rows].tolist()]
    return replace(diagnostics, quality_flags=every.astype(np.str_))


def _against(t_ns: Ints, residuals: Residuals) -> Bools:
    """Return (N,) booleans: at least two thirds of some sensor's recent bearings of one target were rejected.

    These are at least `MIN_REJECTED_BEARINGS`.

    Args:
        t_ns: (N,) times [ns]; recent is the `WINDOW_NS` before each.
        residuals: residuals of the target's bearings, by time.
    """
    out = np.zeros(len(t_ns), dtype=np.bool_)
    for name in np.unique(residuals.sensor).tolist():
        own = residuals.take(residuals.sensor == name)
        rejected = np.concatenate([[0], np.cumsum(own.inlier_probability < 0.5)])
        first, end = (np.searchsorted(own.t_ns, t, side="right") for t in (t_ns - WINDOW_NS, t_ns))
        many = rejected[end] - rejected[first]
        out |= (many >= MIN_REJECTED_BEARINGS) & (many >= MIN_REJECTED_SHARE * (end - first))
    return out


MIN_EFFECTIVE_SAMPLE_SIZE = 10.0
"""Minimum effective sample size for a meaningful covariance."""
BINS = 100
"""Bins per decade of effective sample size: quantiles are right to 2 %."""
DECADES = 8


class EffectiveSampleSizes:
    """Histogram of effective sample sizes in logarithmic bins, with their number `rows`.

    `few` counts those below `MIN_EFFECTIVE_SAMPLE_SIZE`.
    """

    def __init__(self) -> None:
        """Start without rows."""
        self.rows = self.few = 0
        self._sum = 0.0
        self._counts = np.zeros(BINS * DECADES + 1, dtype=np.int64)

    def add(self, ess: Floats) -> None:
        """Add effective sample sizes `ess` (n,); NaN (a method without particles) is omitted."""
        ess = ess[np.isfinite(ess)]
        self.rows += len(ess)
        self.few += int(np.count_nonzero(ess < MIN_EFFECTIVE_SAMPLE_SIZE))
        self._sum += float(ess.sum())
        bins = np.clip(np.log10(np.maximum(ess, 1.0)) * BINS, 0, len(self._counts) - 1)
        self._counts += np.bincount(bins.astype(np.int64), minlength=len(self._counts))

    @property
    def mean(self) -> float:
        """Return the mean effective sample size of all rows; NaN without rows."""
        return self._sum / self.rows if self.rows else math.nan

    @property
    def median(self) -> float:
        """Return the median effective sample size, to 2 %; NaN without rows."""
        if not self.rows:
            return math.nan
        middle = int(np.searchsorted(np.cumsum(self._counts), 0.5 * self.rows))
        return 10.0 ** ((middle + 0.5) / BINS) if middle else 1.0


CLEAR_SIGMAS = 2.0
"""Size of the ellipse that must be inside a region for a sure meeting position, in standard deviations."""
ELLIPSE_POINTS = 12
"""Points of that ellipse that are tested."""
STEPS = 3
"""Gauss-Newton steps from the estimate to the meeting position."""
MIN_INFORMATION_RATIO = 1e-3
"""Lines of sight do not meet if their information has axes with a ratio below this, squared."""
MAX_SIGMA_RAD = 0.2
"""Bearings with a larger standard deviation [rad] do not count: lines of sight of such errors are no straight lines."""
MAX_ELLIPSE_TO_RANGE = 0.5
"""A meeting position counts if its ellipse is smaller than this share of the distance of each of its sensors."""
CONVERGENCE_SIGMAS = 0.1
"""Convergence threshold of the last step of the search, in standard deviations."""
MIN_SHARE = 1e-9
"""A residual with no variance but the bearing's does not determine it; see `_bearings`."""


class BearingIntersection(NamedTuple):
    """Least-squares intersections of the accepted bearings of M rows of tracks, with points of their error ellipses.

    `row` (M,) are the rows, `xy` (M, 2) the positions, and `border` (M, `AROUND`, 2) points on the ellipse of
    `CLEAR_SIGMAS` standard deviations.
    """

    row: Ints  # (M,) rows of the tracks
    xy: Floats  # (M, 2)
    border: Floats  # (M, AROUND, 2) the ellipse of `CLEAR_SIGMAS` standard deviations


@dataclass
class PositionConsistency:
    """Counts rows of tracks with bearings that intersect where the scene excludes the target.

    Attributes:
        rows: rows with bearings of two sensors or more that intersect.
        outside: rows with an intersection clearly outside the room.
        hidden: by camera, rows in which it detected the target, and how many of these intersect clearly behind a wall
            for it; microphone arrays hear past walls.
    """

    rows: int = 0
    outside: int = 0
    hidden: dict[str, tuple[int, int]] = field(default_factory=dict)

    def add(self, tracks: Tracks, residuals: Residuals, scene: Scene) -> None:
        """Count intersections of the accepted bearings of each estimate: outside the room, or behind a camera's wall.

        Args:
            tracks: estimates.
            residuals: residuals of bearings at them; probably false ones are omitted.
            scene: sensors, room and walls; without room and walls nothing is counted.
        """
        sensors: dict[str, Floats] = {c.name: c.position[:2] for c in scene.cameras}
        sensors |= {a.name: a.position[:2] for a in scene.arrays}
        walls = {c.name: scene.blockers(c.ground) for c in scene.cameras}
        if not len(residuals) or (scene.room is None and not any(walls.values())):
            return
        used = residuals.take(residuals.inlier_probability >= 0.5)
        row = _rows(tracks, used)
        met = triangulate_rows(
            tracks, used, row, np.array([sensors[name] for name in used.sensor.tolist()]).reshape(-1, 2)
        )
        self.rows += len(met.row)
        if (room := scene.room) is not None:
            self.outside += int(np.count_nonzero(~_anywhere(met, partial(inside_polygon, polygon=room))))
        for name, polygons in walls.items():
            if polygons:
                saw = np.isin(met.row, row[used.sensor == name])
                own = BearingIntersection(met.row[saw], met.xy[saw], met.border[saw])
                behind = int(np.count_nonzero(~_anywhere(own, partial(_in_sight, sensors[name], polygons))))
                before = self.hidden.get(name, (0, 0))
                self.hidden[name] = before[0] + len(own.row), before[1] + behind


def triangulate_rows(tracks: Tracks, used: Residuals, row: Ints, origin: Floats) -> BearingIntersection:
    """Return least-squares positions from the bearings of each row of tracks with two non-parallel lines of sight.

    Args:
        tracks: estimates, from which the search begins.
        used: N residuals of bearings at them.
        row: (N,) row of the tracks of each residual.
        origin: (N, 2) positions of their sensors.
    """
    start = np.column_stack([tracks.x, tracks.y])
    bearing, sigma = _bearings(start[row], covariances(tracks)[row], origin, used)
    count, xy = len(tracks), start.copy()
    information = np.zeros((count, 2, 2))
    usable = sigma <= MAX_SIGMA_RAD
    row, origin, bearing, sigma = row[usable], origin[usable], bearing[usable], sigma[usable]
    good = np.zeros(count, dtype=np.bool_)
    step = np.zeros((count, 2))
    for _ in range(STEPS):
        away = xy[row] - origin
        r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
        g = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None] / sigma[:, None]
        off = wrap_angle(bearing - np.arctan2(away[:, 1], away[:, 0])) / sigma
        information, pull = np.zeros((count, 2, 2)), np.zeros((count, 2))
        np.add.at(information, row, g[:, :, None] * g[:, None, :])
        np.add.at(pull, row, g * off[:, None])
        trace = information[:, 0, 0] + information[:, 1, 1]
        good = np.linalg.det(information) > MIN_INFORMATION_RATIO * np.maximum(trace, 1e-300) ** 2
        step[good] = np.linalg.solve(information[good], pull[good][:, :, None])[:, :, 0]
        xy[good] += step[good]
    # Where lines of sight are nearly parallel, or the sensors near, the position is no linear function of the bearings
    good &= np.einsum("ni,nij,nj->n", step, information, step) < CONVERGENCE_SIGMAS**2
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, row, np.hypot(*(xy[row] - origin).T))
    least = np.linalg.eigvalsh(np.where(good[:, None, None], information, np.eye(2)))[:, 0]
    good &= MAX_ELLIPSE_TO_RANGE * nearest * np.sqrt(np.maximum(least, 0.0)) > CLEAR_SIGMAS
    found = np.flatnonzero(good)
    root = np.linalg.cholesky(np.linalg.inv(information[found]))
    angle = 2.0 * np.pi * np.arange(ELLIPSE_POINTS) / ELLIPSE_POINTS
    circle = CLEAR_SIGMAS * np.column_stack([np.cos(angle), np.sin(angle)])
    return BearingIntersection(found, xy[found], xy[found][:, None] + np.einsum("mij,aj->mai", root, circle))


def _bearings(xy: Floats, covariance: Floats, origin: Floats, used: Residuals) -> tuple[Floats, Floats]:
    """Reconstruct bearings (N,) and their standard deviations (N,) [rad] from normalised residuals.

    The expected variance of a residual is 1 - g'Pg / sigma^2, which is solved for sigma; NaN where it does not depend
    on sigma.

    Args:
        xy: (N, 2) estimated positions.
        covariance: (N, 2, 2) covariances P of these.
        origin: (2,) or (N, 2) position of the sensor.
        used: N residuals.
    """
    away = xy - origin
    r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
    g = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None]
    share = 1.0 - used.expected_variance
    usable = (share > MIN_SHARE) & (used.expected_variance > 0.0)
    square = np.einsum("ni,nij,nj->n", g, covariance, g)
    sigma = np.sqrt(np.divide(square, share, out=np.full(len(used), np.nan), where=usable))
    return np.arctan2(away[:, 1], away[:, 0]) + used.residual * sigma, sigma


def _rows(tracks: Tracks, used: Residuals) -> Ints:
    """Return (N,) indices of the rows of `tracks` to which the residuals `used` belong, by target and time."""
    order = np.lexsort((tracks.t_ns, tracks.target_id))
    row = np.empty(len(used), dtype=np.int64)
    for target in np.unique(used.target_id).tolist():
        of = order[tracks.target_id[order] == target]
        own = used.target_id == target
        row[own] = of[np.searchsorted(tracks.t_ns[of], used.t_ns[own])]
    return row


def _in_sight(origin: Floats, walls: Sequence[Floats], xy: Floats) -> Bools:
    """Return (N,) booleans: no wall (polygons `walls`) hides position `xy` (N, 2) from the `origin` (2,)."""
    return np.asarray(~behind_walls(origin, xy, walls))


def _anywhere(met: BearingIntersection, test: Callable[[Floats], Bools]) -> Bools:
    """Return (M,) booleans: a test of positions holds at the intersection or anywhere on its error ellipse.

    Args:
        met: M intersections.
        test: takes positions (n, 2), and returns (n,) booleans.
    """
    points = np.concatenate([met.xy[:, None], met.border], axis=1)
    return np.asarray(test(np.ascontiguousarray(points.reshape(-1, 2))).reshape(points.shape[:2]).any(axis=1))
