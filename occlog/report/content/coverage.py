"""Observation coverage for a report: frames and detections of each sensor over time.

Also camera selections: how often and how long each camera was selected, with expected and actual errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Bools, Ints, Strings
from occlog.core.metrics.errors import Sum, group_medians
from occlog.io.files.spill import Blocks, Records
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Diagnostics, Errors, Tracks

CELLS = 500
LOOK = np.dtype([("pair", "i8"), ("t_ns", "i8"), ("step", "f8"), ("seen", "?")])
"""Observation of a label by a sensor: the numbers of both, time, time since the previous one, and detected or not."""
Pair = tuple[str, int]
"""A sensor and a label of bearings."""
MAX_SENSORS, MAX_TARGETS = 60, 6
"""Sensors in a figure; targets with a separate figure."""


def scene_order(scene: Scene | None, found: Iterable[str]) -> tuple[str, ...]:
    """Return the names of a scene's sensors (cameras, then arrays), then those of `found` that it lacks."""
    known = [] if scene is None else [c.name for c in scene.cameras] + [a.name for a in scene.arrays]
    return (*known, *(n for n in found if n not in known))


@dataclass(frozen=True, eq=False)
class SensorSightings:
    """Frames of one sensor over time, and how many of them detected a target.

    Attributes:
        sensor: its name.
        edges: (C + 1,) borders of C time intervals [ns].
        observed: (C,) number of frames in each interval.
        seen: (C,) number of frames in each interval that detected the target.
        any_object: whether detections are unlabelled, so that they may be of any object.
    """

    sensor: str
    edges: Ints
    observed: Ints
    seen: Ints
    any_object: bool = False

    @property
    def share(self) -> float:
        """Share of the frames that detected the target, 0 to 1; NaN without frames."""
        frames = int(self.observed.sum())
        return float(self.seen.sum()) / frames if frames else float("nan")


def _nothing(sensor: str) -> SensorSightings:
    return SensorSightings(sensor, np.zeros(1, np.int64), np.empty(0, np.int64), np.empty(0, np.int64))


class _Cells:
    """Counts of frames and detections in `CELLS` intervals of equal length between two times [ns]."""

    def __init__(self, first: int, end: int) -> None:
        self.edges = np.linspace(first, end, CELLS + 1).astype(np.int64)
        self.observed, self.seen = np.zeros(CELLS, np.int64), np.zeros(CELLS, np.int64)

    def add(self, times: Ints, seen: Bools) -> None:
        cell = np.searchsorted(self.edges, times, side="right") - 1
        self.observed += np.bincount(cell, minlength=CELLS)[:CELLS]
        self.seen += np.bincount(cell, seen, CELLS)[:CELLS].astype(np.int64)


def _frame_cells(times: Ints, seen: Bools, period: int) -> tuple[Ints, Ints, Ints]:
    """Divide time into intervals in which a frame lasts, and gaps.

    A frame lasts until the next one, at most 1.5 times the usual period.

    Args:
        times: (n,) of the frames, rising [ns].
        seen: (n,) whether the target is detected.
        period: usual time between frames [ns].

    Returns:
        Borders (m + 1,) of intervals [ns], and for each (m,) 1 if a frame lasts, and 1 if it detects the target, else
            0.
    """
    longest = period + period // 2
    ends = np.append(np.minimum(times[1:], times[:-1] + longest), times[-1] + period)
    edges = np.unique(np.concatenate([times, ends]))
    start = edges[:-1]
    row = np.searchsorted(times, start, side="right") - 1
    inside = start < ends[row]
    return edges, inside.astype(np.int64), (inside & seen[row]).astype(np.int64)


@dataclass(frozen=True, eq=False)
class ObservationCoverage:
    """Summary of all bearings: which sensor detected which target when.

    Attributes:
        rows: number of bearings, detections or not.
        seen: number of detections.
        sensors: for each sensor the number of bearings and of detections, sorted by name.
        labels: identities of the targets that they are labelled with, ascending; -1: unlabelled.
        found: frames and detections over time, by (sensor, target).
    """

    rows: int
    seen: int
    sensors: Mapping[str, tuple[int, int]]
    labels: tuple[int, ...]
    found: Mapping[Pair, SensorSightings] = field(default_factory=dict)

    @property
    def watched(self) -> tuple[int, ...]:
        """Labels of bearings except -1 (any object); -1 only if there is no other."""
        return tuple(i for i in self.labels if i != UNLABELLED) or self.labels

    def sightings(self, sensor: str, target: int) -> SensorSightings:
        """Return frames and detections over time of one sensor and target; without intervals if there are none."""
        return self.found.get((sensor, target)) or _nothing(sensor)


def _by_sensor(names: Strings, which: Ints, seen: Bools) -> dict[str, tuple[int, int]]:
    rows, saw = np.bincount(which, minlength=len(names)), np.bincount(which[seen], minlength=len(names))
    return {str(name): (int(n), int(s)) for name, n, s in zip(names, rows, saw, strict=True)}


class ObservationStreams:
    """Accumulates observations over a stream of bearings, buffered on disk until the intervals are known."""

    def __init__(self, blocks: Blocks | None = None) -> None:
        """Start without bearings; `blocks`: buffer on disk for records of `LOOK`; None: a new one."""
        self.rows = self._seen = 0
        self._sensors: dict[str, tuple[int, int]] = {}
        self._pairs: dict[Pair, int] = {}
        self._ends: list[list[int]] = []  # of each pair: first time, last time, observations
        self._records = Blocks(LOOK) if blocks is None else blocks

    def add(self, bearings: Bearings) -> None:
        """Add the bearings of a further time interval."""
        self.rows += len(bearings)
        names, which = np.unique(bearings.sensor, return_inverse=True)
        for name, (rows, seen) in _by_sensor(names, which, bearings.seen).items():
            before = self._sensors.get(name, (0, 0))
            self._sensors[name] = before[0] + rows, before[1] + seen
            self._seen += seen
        keys, pair = np.unique(np.column_stack([which, bearings.target_id]), axis=0, return_inverse=True)
        pair = pair.reshape(-1)
        numbers = [self._pairs.setdefault((str(names[s]), int(t)), len(self._pairs)) for s, t in keys.tolist()]
        order = np.argsort(pair, kind="stable")
        starts = np.append(np.flatnonzero(np.diff(pair[order], prepend=-1)), len(order))
        parts = []
        for number, a, b in zip(numbers, starts[:-1].tolist(), starts[1:].tolist(), strict=True):
            parts.append(self._frames(number, bearings.t_ns[order[a:b]], bearings.seen[order[a:b]]))
        if parts:
            self._records.append(np.concatenate(parts))

    def _frames(self, number: int, t_ns: Ints, seen: Bools) -> Records:
        """Return records of the frames of a sensor for a target; several bearings in one frame give one record.

        Args:
            number: number of the pair of sensor and target, in the order of first use.
            t_ns: (n,) times, rising [ns].
            seen: (n,) whether the bearing is a detection.
        """
        times, first = np.unique(t_ns, return_index=True)
        if number == len(self._ends):
            self._ends.append([int(times[0]), int(times[0]), 0])
        ends = self._ends[number]
        out = np.empty(len(times), dtype=LOOK)
        out["pair"], out["t_ns"], out["seen"] = number, times, np.logical_or.reduceat(seen, first)
        out["step"] = np.diff(times, prepend=ends[1])
        if not ends[2]:
            out["step"][0] = np.nan
        ends[1], ends[2] = int(times[-1]), ends[2] + len(times)
        return out

    @property
    def labels(self) -> tuple[int, ...]:
        """Labels of bearings so far, sorted; -1: unlabelled."""
        return tuple(sorted({label for _, label in self._pairs}))

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of all sensors, sorted."""
        return tuple(sorted(self._sensors))

    def finish(self, sensors: Iterable[str], targets: Iterable[int]) -> ObservationCoverage:
        """Return the summary of all bearings, with frames and detections over time of the named sensors and targets.

        For a sensor without labelled bearings its unlabelled ones are used.
        """
        self._records.end()
        wanted: dict[Pair, tuple[int, bool]] = {}
        named = {sensor for sensor, label in self._pairs if label != UNLABELLED}
        targets = tuple(targets)
        for sensor in sensors:
            for target in targets:
                free = target != UNLABELLED and sensor not in named
                number = self._pairs.get((sensor, UNLABELLED if free else target))
                if number is not None:
                    wanted[sensor, target] = number, free
        found = self._sightings({number for number, _ in wanted.values()})
        series = {
            (sensor, target): SensorSightings(sensor, *found[number], free)
            for (sensor, target), (number, free) in wanted.items()
        }
        by_name = dict(sorted(self._sensors.items()))
        return ObservationCoverage(self.rows, self._seen, by_name, self.labels, series)

    def _sightings(self, wanted: set[int]) -> dict[int, tuple[Ints, Ints, Ints]]:
        """Return interval borders [ns], and counts of frames and detections in each, for the `wanted` numbers of pairs.

        A pair is a sensor and a label of bearings.
        """

        def steps() -> Iterator[tuple[Ints, np.ndarray]]:
            for number in range(self._records.count):
                rows = self._records.get(number)
                rows = rows[np.isfinite(rows["step"])]
                yield rows["pair"], rows["step"]

        counts = np.array([max(count - 1, 0) for *_, count in self._ends], dtype=np.int64)
        medians = group_medians(steps, counts) if len(counts) else np.zeros(0)
        cells: dict[int, _Cells] = {}
        frames: dict[int, list[Records]] = {}
        period = {n: max(int(medians[n]) if counts[n] else 0, 1) for n in wanted}
        for n in wanted:
            first, last, count = self._ends[n]
            if count > CELLS:
                cells[n] = _Cells(first, last + period[n])
            else:
                frames[n] = []
        for number in range(self._records.count):
            block = self._records.get(number)
            for n in np.unique(block["pair"]).tolist():
                if n in wanted:
                    own = block[block["pair"] == n]
                    if n in cells:
                        cells[n].add(own["t_ns"], own["seen"])
                    else:
                        frames[n].append(own)
        out = {n: (each.edges, each.observed, each.seen) for n, each in cells.items()}
        for n, parts in frames.items():
            rows = np.concatenate(parts)
            out[n] = _frame_cells(rows["t_ns"], rows["seen"], period[n])
        return out


Cameras = frozenset[str]


@dataclass(frozen=True, eq=False)
class Selections:
    """Camera selections for one target (methods that select cameras).

    Attributes:
        count: number of selections.
        times: (n + 1,) times [ns] of the n selections that are drawn, and of the last scan.
        chosen: names of the selected cameras of each of the n.
        shares: by camera, the share of the time from the first selection to the last scan for which it was selected.
        expected: RMS of the position error predicted at selections.
        found: RMS of the actual error at these times; NaN: unknown.
        what: what `found` is: `error`, `stated spread` (by the covariance), or empty if unknown.
    """

    count: int
    times: Ints
    chosen: tuple[Cameras, ...]
    shares: Mapping[str, float]
    expected: float
    found: float
    what: str


@dataclass
class _SelectionTarget:
    """Running statistics of the camera selections for one target.

    Attributes:
        count: number of selections.
        expected: sum of squares of the predicted position errors.
        first: time of the first selection [ns].
        since: time of the current selection [ns], and its cameras.
        last: time of the last scan [ns].
        selected_ns: how long each camera was selected [ns], by name.
        times: times of the selections that are drawn [ns].
        chosen: cameras of each of these selections.
        found: number and sum of squares of actual errors, by kind (`error`, `stated spread`).
    """

    count: int = 0
    expected: Sum = field(default_factory=Sum)
    first: int = 0
    since: tuple[int, Cameras] = (0, frozenset())  # the selection that holds
    last: int = 0
    selected_ns: dict[str, int] = field(default_factory=dict)
    times: list[int] = field(default_factory=list)
    chosen: list[Cameras] = field(default_factory=list)
    found: dict[str, tuple[int, Sum]] = field(default_factory=dict)

    def hold(self, until: int) -> None:
        """Add the duration up to the time `until` [ns] to the cameras of the current selection."""
        begin, cameras = self.since
        for name in cameras:
            self.selected_ns[name] = self.selected_ns.get(name, 0) + until - begin


class SelectionStreams:
    """Accumulates camera selections over a stream of filter diagnostics, with the actual errors at these times."""

    def __init__(self, every: int = 1) -> None:
        """Start without selections; every `every`-th one is drawn."""
        self._every = every
        self._targets: dict[int, _SelectionTarget] = {}

    def add(self, part: Diagnostics) -> None:
        """Add the camera selections in rows of diagnostics, in the order of time."""
        rows = np.isfinite(part.predicted_mse)
        for target in np.union1d(part.target_id[rows], np.array(list(self._targets), np.int64)).astype(int).tolist():
            mine = part.target_id == target
            if not mine.any():
                continue
            own = self._targets.setdefault(target, _SelectionTarget())
            chosen = np.flatnonzero(mine & rows)
            for row in chosen.tolist():
                t_ns, cameras = int(part.t_ns[row]), frozenset(part.selected[row].split(","))
                own.hold(t_ns)
                own.first = own.first if own.count else t_ns
                own.since = t_ns, cameras
                if own.count % self._every == 0:
                    own.times.append(t_ns)
                    own.chosen.append(cameras)
                own.count += 1
            own.expected.add(float(part.predicted_mse[chosen].sum()))
            own.last = int(part.t_ns[mine][-1])

    def came_out(self, part: Diagnostics, companion: Errors | Tracks) -> None:
        """Add the squared errors, or the traces of the covariances of tracks, at the times of selections.

        Args:
            part: diagnostics of a time interval.
            companion: errors or tracks of the same interval.
        """
        finite = np.isfinite(part.predicted_mse)
        for target in np.unique(part.target_id[finite]).tolist():
            at = np.isin(companion.t_ns, part.t_ns[finite & (part.target_id == target)])
            rows = at & (companion.target_id == target)
            if isinstance(companion, Errors):
                what, squares = "error", companion.error[rows] ** 2
            else:
                what, squares = "stated spread", companion.cov_xx[rows] + companion.cov_yy[rows]
            count, total = self._targets[target].found.setdefault(what, (0, Sum()))
            total.add(float(squares.sum()))
            self._targets[target].found[what] = count + len(squares), total

    @property
    def any(self) -> bool:
        """Whether cameras were selected for any target."""
        return bool(self._targets)

    def finish(self) -> dict[int, Selections]:
        """Return the summary of the selections for each target, sorted by target."""
        return {target: _finished(own) for target, own in sorted(self._targets.items())}


def _finished(own: _SelectionTarget) -> Selections:
    own.hold(own.last)
    whole = max(float(own.last - own.first), 1.0)
    what = next((what for what in ("error", "stated spread") if own.found.get(what, (0,))[0]), "")
    found = float("nan")
    if what:
        count, total = own.found[what]
        found = float(np.sqrt(total.value / count))
    return Selections(
        count=own.count,
        times=np.array([*own.times, own.last], dtype=np.int64),
        chosen=tuple(own.chosen),
        shares={name: spent / whole for name, spent in own.selected_ns.items()},
        expected=float(np.sqrt(own.expected.value / own.count)),
        found=found,
        what=what,
    )
