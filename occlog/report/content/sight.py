"""Distances of tracks from lines of sight and from triangulated positions, and plane geometry for drawing."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.triangulate import TRIANGULATED, triangulate
from occlog.core.metrics.errors import Sum
from occlog.evaluate.errors.sums import quantiles_of
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Tracks

from .downsampled import largest

RAYS = 121


def visible_area(origin: Floats, yaw: float, fov: float, reach: float, walls: Floats) -> Floats:
    """Return the polygon that a sensor sees on the floor: its field of view cut off at walls.

    Args:
        origin: (2,) position of the sensor.
        yaw: azimuth of the optical axis [rad].
        fov: full opening angle [rad]; 2 pi or more is all around.
        reach: farthest distance, finite and > 0.
        walls: (S, 2, 2) ends of line segments that block lines of sight.

    Returns:
        (K, 2) corners, the sensor first (unless it sees all around).
    """
    half = min(fov / 2.0, np.pi)
    corners = walls.reshape(-1, 2) - origin
    toward = wrap_angle(np.arctan2(corners[:, 1], corners[:, 0]) - yaw)
    toward = np.concatenate([toward - 1e-6, toward + 1e-6])
    offsets = np.concatenate([np.linspace(-half, half, RAYS), toward[np.abs(toward) <= half]])
    azimuth = yaw + np.unique(offsets)
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    edge = origin + np.minimum(_hits(origin, direction, walls), reach)[:, None] * direction
    return edge if half >= np.pi else np.vstack([origin, edge])


def _hits(origin: Floats, direction: Floats, walls: Floats) -> Floats:
    """Return the distance (R,) along each ray to the nearest wall; inf without a wall.

    Args:
        origin: (2,) of all rays.
        direction: (R, 2) unit vectors.
        walls: (W, 2, 2) ends of each wall.
    """
    if not len(walls):
        return np.full(len(direction), np.inf)
    start, along = walls[:, 0] - origin, walls[:, 1] - walls[:, 0]
    cross = direction[:, :1] * along[:, 1] - direction[:, 1:] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        distance_along = (start[:, 0] * direction[:, 1:] - start[:, 1] * direction[:, :1]) / cross
    # A sensor may be mounted on the wall itself: such a wall does not hide anything from it.
    near = 1e-6 * (1.0 + np.abs(walls).max())
    hit = (distance > near) & (distance_along >= -1e-9) & (distance_along <= 1.0 + 1e-9)
    return np.asarray(np.where(hit, distance, np.inf).min(axis=1))


def edges_of(polygon: Floats) -> Floats:
    """Return the edges (K, 2, 2), begin and end of each, of a closed polygon with vertices (K, 2)."""
    return np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)


def sensor_positions(scene: Scene) -> dict[str, Floats]:
    """Return the ground position (2,) of each sensor with a known pose, by name: cameras, then arrays."""
    cameras = {c.name: c.ground for c in scene.cameras if c.placed}
    return cameras | {a.name: a.position[:2] for a in scene.arrays}


def positions_at(tracks: Tracks, target: int, t_ns: Ints) -> Floats:
    """Return positions (N, 2) of a target at times `t_ns` (N,), interpolated linearly; NaN outside its track."""
    rows = np.flatnonzero(tracks.target_id == target)
    if not len(rows):
        return np.full((len(t_ns), 2), np.nan)
    # Times relative to the track's start, so that a float carries nanoseconds.
    start = tracks.t_ns[rows[0]]
    known, wanted = (tracks.t_ns[rows] - start).astype(float), (t_ns - start).astype(float)
    return np.column_stack([np.interp(wanted, known, v[rows], left=np.nan, right=np.nan) for v in (tracks.x, tracks.y)])


@dataclass(frozen=True, eq=False)
class DirectionErrors:
    """Residuals of N bearings: measured minus expected direction of a target, sorted by time.

    `t_ns`: (N,) times [ns]; `sensor`: (N,) index into `names`; `residual`: (N,) in -pi to pi [rad]; `sigma`: (N,)
    stated standard deviations [rad].
    """

    t_ns: Ints
    sensor: Ints  # index into names
    names: tuple[str, ...]
    residual: Floats  # rad, in [-pi, pi)
    sigma: Floats  # rad


@dataclass(frozen=True, eq=False)
class LabelledSightings:
    """N detections with one label by sensors with known positions, sorted by time.

    `t_ns`: (N,) times [ns]; `sensor`: (N,) index into the names of `sensor_positions`; `bearing`: (N,) azimuth in the
    world [rad]; `sigma`: (N,) its standard deviation [rad].
    """

    t_ns: Ints  # (N,)
    sensor: Ints  # (N,) index into the names of `sensor_positions`
    bearing: Floats  # (N,) rad
    sigma: Floats  # (N,) rad


def lines_of_sight(bearings: Bearings, scene: Scene, labels: Iterable[int]) -> dict[int, LabelledSightings]:
    """Return, for each of the `labels`, the detections with that label by sensors that the scene has."""
    sensor = _index(bearings.sensor, tuple(sensor_positions(scene)))
    seen, out = bearings.seen & (sensor >= 0), {}
    for label in labels:
        rows = np.flatnonzero((bearings.target_id == label) & seen)
        out[label] = LabelledSightings(bearings.t_ns[rows], sensor[rows], bearings.bearing[rows], bearings.sigma[rows])
    return out


def label_of(target: int, labels: Collection[int]) -> int:
    """Return the label of the bearings to compare with a target: its identity if it is among `labels`, else -1."""
    return target if target in labels else UNLABELLED


def distance_to_lines(lines: LabelledSightings, estimate: Floats, scene: Scene, *, nearest: bool) -> DirectionErrors:
    """Return the residuals of bearings from estimates of the target [rad].

    Args:
        lines: N bearings.
        estimate: (N, 2) estimated positions at their times; bearings with NaN are omitted.
        scene: positions of the sensors.
        nearest: keep only the bearing with the smallest residual of each time and sensor.
    """
    known = sensor_positions(scene)
    origins = np.array(list(known.values())).reshape(-1, 2)[lines.sensor]
    delta = estimate - origins
    value = wrap_angle(lines.bearing - np.arctan2(delta[:, 1], delta[:, 0]))
    keep = np.flatnonzero(np.isfinite(value))
    if nearest:
        keep = _nearest(lines.t_ns, lines.sensor, value, keep)
    return DirectionErrors(
        t_ns=lines.t_ns[keep],
        sensor=lines.sensor[keep],
        names=tuple(known),
        residual=value[keep],
        sigma=lines.sigma[keep],
    )


def _nearest(t_ns: Ints, sensor: Ints, value: Floats, rows: Ints) -> Ints:
    """Return those of `rows` that have the smallest absolute `value` of their time and sensor, sorted.

    `t_ns`, `sensor` and `value` are (N,); `rows` are indices into them.
    """
    order = rows[np.lexsort([np.abs(value[rows]), sensor[rows], t_ns[rows]])]
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(t_ns[order]) != 0) | (np.diff(sensor[order]) != 0)
    return np.sort(order[first])


def _index(names: np.ndarray, known: tuple[str, ...]) -> Ints:
    """Return the index (N,) of each of `names` (N,) in `known`; -1 if missing."""
    unique, inverse = np.unique(names, return_inverse=True)
    numbers = np.array([known.index(n) if n in known else -1 for n in unique], dtype=np.int64)
    return numbers[inverse] if len(unique) else np.empty(0, np.int64)


def has_common_time(t_ns: Ints) -> Bools:
    """Return the mask (N,) of sorted times that occur more than once."""
    same = np.diff(t_ns) == 0
    return np.append(False, same) | np.append(same, False) if len(t_ns) else np.zeros(0, np.bool_)


def period_of(steps: Sequence[float]) -> int:
    """Return the scan period [ns] of sensors with the usual intervals `steps` [ns]: their median, at least 1."""
    return max(int(np.median(steps)) if len(steps) else 1, 1)


def scans(lines: LabelledSightings, period_ns: int | None, start_ns: int) -> tuple[Ints, Ints]:
    """Return the rows that form scans, sorted, and the number of the scan of each; a scan has each sensor at most once.

    A scan is all rows of equal time or, if sensors do not share times, all rows within one period.

    Args:
        lines: detections in the order of time.
        period_ns: length of a scan [ns]; None: sensors share their times.
        start_ns: begin of the first scan [ns].
    """
    scan = lines.t_ns if period_ns is None else (lines.t_ns - start_ns) // period_ns
    if not len(scan):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, first = np.unique(np.column_stack([scan, lines.sensor]), axis=0, return_index=True)
    first = np.sort(first)
    return first, scan[first]


def triangulate_scans(lines: LabelledSightings, rows: Ints, scan: Ints, scene: Scene) -> tuple[Ints, Floats]:
    """Triangulate each scan; return the first row (n,) and the position (n, 2) of those with lines of sight that meet.

    Args:
        lines: detections.
        rows: (k,) indices of those that are in a scan.
        scan: (k,) number of the scan of each, rising (see `scans`).
        scene: positions of the sensors.
    """
    origins = np.array(list(sensor_positions(scene).values())).reshape(-1, 2)[lines.sensor[rows]]
    _, first = np.unique(scan, return_index=True)
    starts = np.append(first, len(rows))
    meeting = triangulate(origins, lines.bearing[rows], lines.sigma[rows], starts=starts, loss="huber")
    met = meeting.status == TRIANGULATED
    return rows[first][met], meeting.xy[met]


@dataclass(frozen=True, eq=False)
class Residual:
    """Bearing residuals of one track, by sensor.

    Attributes:
        drawn: all residuals, or a part of them.
        rows: number of all residuals of each sensor.
        squares: (2,) sums of all squared residuals of each sensor, in rad^2 and in squared standard deviations.
        every: every k-th residual of a sensor is drawn.
    """

    drawn: DirectionErrors
    rows: Mapping[str, int]
    squares: Mapping[str, Floats]
    every: int = 1

    @property
    def any(self) -> bool:
        """Whether any sensor has a residual."""
        return any(self.rows.values())


def _squares(residual: Floats, sigma: Floats) -> Floats:
    """Return the sums (2,) of squared residuals [rad^2], and of squared residuals over their variances."""
    return np.asarray((np.column_stack([residual, residual / sigma]) ** 2).sum(axis=0))


@dataclass(frozen=True, eq=False)
class TriangulationDistances:
    """Distances of one track from triangulated positions.

    Attributes:
        t_ns: (D,) times of the distances that are drawn [ns].
        distance: (D,) these distances.
        so_far: (D,) root mean square of all distances up to each.
        rows: number of all distances.
        rms: root mean square of all; NaN without any.
        high: 95 % quantile of all; NaN without any.
        every: every k-th is drawn.
    """

    t_ns: Ints
    distance: Floats
    so_far: Floats
    rows: int
    rms: float
    high: float
    every: int = 1


@dataclass
class _Off:
    """Accumulated residuals of bearings, and distances from triangulated positions, of one target's track.

    Attributes:
        rows: number of residuals of each sensor.
        squares: (n, 2) sums of squared residuals of each of n sensors, in rad^2 and in squared standard deviations.
        drawn: residuals that are drawn.
        held: detections of the last scan, which may be incomplete, and the estimates at them; None: none.
        start_ns: time of the first scan [ns]; None: none yet.
        scans: number of triangulated scans.
        total: sum of squared distances.
        t_ns, distance, so_far: times [ns], distances and running RMS of the scans that are drawn.
    """

    rows: Ints
    squares: Floats
    drawn: list[DirectionErrors] = field(default_factory=list)
    held: tuple[LabelledSightings, Floats] | None = None  # lines of a scan that may not be over, and estimates at them
    start_ns: int | None = None
    scans: int = 0
    total: Sum = field(default_factory=Sum)
    t_ns: list[Ints] = field(default_factory=list)
    distance: list[Floats] = field(default_factory=list)
    so_far: list[Floats] = field(default_factory=list)


class BearingResidualStreams:
    """Accumulates bearing residuals, and distances from triangulated positions, over streams of tracks and bearings."""

    def __init__(
        self,
        scene: Scene,
        targets: Iterable[int],
        labels: Collection[int],
        periods_ns: Mapping[int, int | None],
        every: int = 1,
        in_memory: int = NUMBERS_IN_MEMORY,
    ) -> None:
        """Create empty statistics.

        Args:
            scene: the sensors.
            targets: identities of the tracked targets.
            labels: all target labels that occur in the bearings.
            periods_ns: targets to triangulate, with the length of a scan [ns] (see `scans`); None: sensors share times.
            every: every k-th residual of a sensor, and every k-th distance, is drawn, and the largest ones between.
            in_memory: how many distances are kept in memory.
        """
        self._scene, self._every, self._periods_ns = scene, every, periods_ns
        self._labels = {target: label_of(target, labels) for target in targets}
        count = len(sensor_positions(scene))
        self._off = {target: _Off(np.zeros(count, np.int64), np.zeros((count, 2))) for target in self._labels}
        self._spools = {target: Spool(in_memory // len(periods_ns)) for target in periods_ns}

    def add(self, tracks: Tracks, bearings: Bearings) -> None:
        """Add the bearings of a time interval; `tracks` must have all estimates in and around it."""
        lines = lines_of_sight(bearings, self._scene, set(self._labels.values()))
        for target, label in self._labels.items():
            own, mine = self._off[target], lines[label]
            estimate = positions_at(tracks, target, mine.t_ns)
            self._residuals(own, distance_to_lines(mine, estimate, self._scene, nearest=label == UNLABELLED))
            if target in self._periods_ns and label == target:
                self._distances(target, mine, estimate, last=False)

    def _residuals(self, own: _Off, found: DirectionErrors) -> None:
        number = np.zeros(len(found.sensor), dtype=np.int64)
        for i in np.unique(found.sensor).tolist():
            mine = found.sensor == i
            number[mine] = own.rows[i] + np.arange(np.count_nonzero(mine))
            own.rows[i] += int(np.count_nonzero(mine))
            own.squares[i] += _squares(found.residual[mine], found.sigma[mine])
        keep = number % self._every == 0
        keep |= largest(np.abs(found.residual), found.sensor, number // self._every)
        parts = (each[keep] for each in (found.t_ns, found.sensor, found.residual, found.sigma))
        t_ns, sensor, residual, sigma = parts
        own.drawn.append(DirectionErrors(t_ns, sensor, found.names, residual, sigma))

    def _distances(self, target: int, lines: LabelledSightings, estimate: Floats, *, last: bool) -> None:
        """Add the distances of a target's track from its triangulated positions at completed scans.

        Args:
            target: its identity.
            lines: N further detections.
            estimate: (N, 2) positions of the track at their times.
            last: whether the last scan is complete too.
        """
        own, period = self._off[target], self._periods_ns[target]
        if own.held is not None:
            lines, estimate = _joined(own.held[0], lines), np.concatenate([own.held[1], estimate])
        if not len(lines.t_ns):
            return
        own.start_ns = int(lines.t_ns[0]) if own.start_ns is None else own.start_ns
        over = len(lines.t_ns)
        if period is not None and not last:
            scan = (lines.t_ns - own.start_ns) // period
            over = int(np.searchsorted(scan, scan[-1]))
        own.held = _part(lines, slice(over, None)), estimate[over:]
        rows, scan = scans(_part(lines, slice(0, over)), period, own.start_ns)
        first, xy = triangulate_scans(lines, rows, scan, self._scene)
        found = np.hypot(*(estimate[first] - xy).T)
        finite = np.isfinite(found)
        t_ns, found = lines.t_ns[first][finite], found[finite]
        number = own.scans + np.arange(len(found))
        so_far = np.sqrt((own.total.value + np.cumsum(found**2)) / (number + 1))
        keep = (number % self._every == 0) | largest(found, np.zeros(len(found), np.int64), number // self._every)
        own.t_ns.append(t_ns[keep])
        own.distance.append(found[keep])
        own.so_far.append(so_far[keep])
        own.total.add(float(np.sum(found**2)))
        own.scans += len(found)
        self._spools[target].add(found)

    def finish(self) -> tuple[dict[int, Residual], dict[int, TriangulationDistances]]:
        """Return the residuals, and the distances from triangulated positions, by target."""
        names = tuple(sensor_positions(self._scene))
        off, separate = {}, {}
        for target, own in self._off.items():
            empty = (np.zeros(0, np.int64), np.zeros(0, np.int64), names, np.zeros(0), np.zeros(0))
            parts = [DirectionErrors(*empty), *own.drawn]
            columns = {
                c: np.concatenate([getattr(p, c) for p in parts]) for c in ("t_ns", "sensor", "residual", "sigma")
            }
            rows = {name: int(count) for name, count in zip(names, own.rows, strict=True)}
            squares = dict(zip(names, own.squares, strict=True))
            off[target] = Residual(DirectionErrors(names=names, **columns), rows, squares, self._every)
            if target in self._periods_ns:
                if own.held is not None:
                    nothing = _part(own.held[0], slice(0, 0))
                    self._distances(target, nothing, np.zeros((0, 2)), last=True)
                separate[target] = self._separations(own, self._spools[target])
        return off, separate

    def _separations(self, own: _Off, spool: Spool) -> TriangulationDistances:
        count = own.scans
        (high,) = quantiles_of(spool, [0.95])
        return TriangulationDistances(
            np.concatenate([np.zeros(0, np.int64), *own.t_ns]),
            np.concatenate([np.zeros(0), *own.distance]),
            np.concatenate([np.zeros(0), *own.so_far]),
            count,
            float(np.sqrt(own.total.value / count)) if count else float("nan"),
            high,
            self._every,
        )


def _part(lines: LabelledSightings, rows: slice) -> LabelledSightings:
    return LabelledSightings(lines.t_ns[rows], lines.sensor[rows], lines.bearing[rows], lines.sigma[rows])


def _joined(a: LabelledSightings, b: LabelledSightings) -> LabelledSightings:
    columns = ("t_ns", "sensor", "bearing", "sigma")
    return LabelledSightings(*(np.concatenate([getattr(a, c), getattr(b, c)]) for c in columns))
