"""Grouping of bearings into scans: rows of one time step, checked against the scene."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from occlog.array_types import Bools, Floats, Ints, Ints32
from occlog.core.occlusion.priors import Priors
from occlog.errors import InputError, UsageError, did_you_mean
from occlog.filtering.likelihood.distances import RangeMeasurements
from occlog.io.files.timing.utc import time_words
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings


class ScanMeasurements(NamedTuple):
    """m distance measurements of stations at one time, with the target of each."""

    target_id: Ints32  # (m,) >= 0
    distances: RangeMeasurements  # m measurements

    def of_target(self, target: int) -> ScanMeasurements | None:
        """Return the measurements of target `target`; None without any."""
        own = self.target_id == target
        return ScanMeasurements(self.target_id[own], self.distances.take(own)) if own.any() else None


class Scan(NamedTuple):
    """Measurements of all sensors at one time: R rows with the columns of the table `Bearings`, by sensor.

    A sensor has one row for each label, and a row for each candidate, or one that is not `seen`. A sensor without a row
    had no frame. A scan is a plain tuple of arrays, without the validation of tables, for speed.
    """

    t_ns: int
    sensor: Ints  # (R,) index in `sensor_names`, ascending
    target_id: Ints32  # (R,) UNLABELLED: a candidate that may be of any object
    seen: Bools  # (R,)
    bearing: Floats  # (R,) [rad]
    sigma: Floats  # (R,) [rad]
    u_px: Floats  # (R,) NaN where the sensor gives no pixels
    sigma_px: Floats  # (R,) NaN: the camera's read noise
    score: Floats  # (R,) NaN: unknown
    elevation: Floats  # (R,) [rad]; NaN: the sensor measures no elevation
    sigma_elevation: Floats  # (R,) [rad]
    occluders: Priors | None = None  # at this time; None: nothing is known about moving occluders
    measured: ScanMeasurements | None = None  # ranges and their like, of the same time; None: missing

    @classmethod
    def of(cls, t_ns: int, sensor: Sequence[int] | Ints, **columns: ArrayLike) -> Scan:
        """Return a scan made of array-likes; columns not given are unlabelled, seen, and NaN.

        Args:
            t_ns: time [ns].
            sensor: (n,) index of each row's sensor.
            **columns: (n,) other columns by name.
        """
        n = len(sensor)
        known = {"sensor": np.asarray(sensor, dtype=np.int64)}
        known |= {name: np.asarray(values, dtype=DTYPES.get(name, np.float64)) for name, values in columns.items()}
        blank = {"target_id": np.full(n, UNLABELLED, dtype=np.int32), "seen": np.ones(n, dtype=np.bool_)}
        return cls(t_ns, **dict.fromkeys(COLUMNS, np.full(n, np.nan)) | blank | known)

    @property
    def labelled(self) -> Bools:
        """Return (R,) booleans: the row is labelled with a target."""
        return np.asarray(self.target_id != UNLABELLED)

    def take(self, rows: Bools | Ints | slice) -> Scan:
        """Return the scan with the rows selected by a mask, a slice or indices; distances and occluders stay."""
        return Scan._make((self.t_ns, *(column[rows] for column in self[1:-2]), self.occluders, self.measured))

    def of_target(self, target: int) -> Scan | None:
        """Return a target's own rows and distances, and candidates of sensors without a row for it.

        None if there are none.
        """
        own = self.target_id == target
        rows, free = own, self.target_id == UNLABELLED
        if free.any():
            rows = own | (free & ~np.isin(self.sensor, self.sensor[own]))
        if self.measured is not None:
            measured = self.measured.of_target(target)
            some = self.take(rows)._replace(measured=measured)
            return some if rows.any() or measured is not None else None
        if rows.all():
            return self if len(rows) else None
        return self.take(rows) if rows.any() else None

    @property
    def targets(self) -> set[int]:
        """Return the identities of the targets in labelled rows or distance measurements."""
        named = set(self.target_id[self.labelled].tolist())
        return named if self.measured is None else named.union(self.measured.target_id.tolist())

    def by_sensor(self) -> Iterator[tuple[int, Scan]]:
        """Generate (index, scan) for each sensor with rows, in order; the scan has its `seen` rows, possibly none."""
        for sensor in np.unique(self.sensor).tolist():
            yield sensor, self.take((self.sensor == sensor) & self.seen)


DTYPES: dict[str, type[np.generic]] = {"target_id": np.int32, "seen": np.bool_}
"""Data types of the columns of a scan that are not floating-point."""
COLUMNS = tuple(name for name in Scan._fields if name not in ("t_ns", "occluders", "measured"))
"""Names of the columns of a scan: those of `Bearings`, but for the time and what the fusion did."""


def concat(scans: Sequence[Scan]) -> Scan:
    """Return the rows of several scans (at least one) as one; time and occluders are those of the last.

    Distance measurements are omitted.
    """
    columns = (np.concatenate(parts) for parts in zip(*(scan[1:-2] for scan in scans), strict=True))
    return Scan._make((scans[-1].t_ns, *columns, scans[-1].occluders, None))


def empty_scan(t_ns: int, sensors: Sequence[int]) -> Scan:
    """Return a scan at `t_ns` [ns] without any detection: an unlabelled, not seen row for each sensor.

    `sensors` are indices of sensors, increasing.
    """
    return Scan.of(t_ns, sensors, seen=np.zeros(len(sensors), dtype=np.bool_))


def sensor_names(scene: Scene) -> tuple[str, ...]:
    """Return the names of all sensors of a scene: cameras, then microphone arrays.

    `Scan.sensor` is an index into them.
    """
    return (*(c.name for c in scene.cameras), *(a.name for a in scene.arrays))


class BearingRows(NamedTuple):
    """Selection of rows of bearings: sensors by name, targets (None: all), and whether unlabelled rows count."""

    sensors: Collection[str]
    targets: Collection[int] | None = None  # labelled rows of others are omitted; None: all
    unlabelled: bool = True


def scans_of(chunks: Iterable[Bearings], scene: Scene, use: BearingRows, window_ns: int = 0) -> Iterator[Scan]:
    """Generate scans from bearings in the order of time; the result does not depend on the chunks.

    Args:
        chunks: bearings in the order of time.
        scene: must have the sensors.
        use: which rows to use.
        window_ns: rows at most this far apart [ns] form one scan, unless a sensor would have two times in it; the
            scan's time is that of its last row.

    Raises:
        InputError: a sensor that the scene does not have or that has no pose, times that go back from one chunk to the
            next, or two rows of a sensor for one target and time.
    """
    names = sensor_names(scene)
    unplaced = {c.name for c in scene.cameras if not c.placed} & set(use.sensors)
    rest, last_ns, count = Bearings.empty(), None, 0
    for chunk in chunks:
        if not len(chunk):
            continue
        _check_sensors(chunk, names, unplaced, count)
        if last_ns is not None and chunk.t_ns[0] < last_ns:
            raise InputError(
                f"bearings: row {count}: sensor {str(chunk.sensor[0])!r}: time {time_words(chunk.t_ns[0])} is earlier "
                f"than the preceding {time_words(last_ns)}; sort all rows by t_ns",
                id="unsorted-times",
            )
        last_ns, count = int(chunk.t_ns[-1]), count + len(chunk)
        table = Bearings.concat([rest, _chosen(chunk, use)])
        starts = _starts(table, window_ns)
        yield from _split(table, starts, names)
        # The last scan may go on in the next chunk.
        rest = table.take(slice(starts[-1], None)) if len(table) else table
    if len(rest):
        yield from _split(rest, [0, len(rest)], names)


def checked(chunks: Iterable[Bearings], scene: Scene, sensors: Collection[str]) -> Iterator[Bearings]:
    """Generate the chunks; InputError for rows of an unknown sensor, or of a camera in `sensors` without a pose."""
    names = sensor_names(scene)
    unplaced = {c.name for c in scene.cameras if not c.placed} & set(sensors)
    count = 0
    for chunk in chunks:
        _check_sensors(chunk, names, unplaced, count)
        count += len(chunk)
        yield chunk


def _check_sensors(chunk: Bearings, names: tuple[str, ...], unplaced: set[str], offset: int) -> None:
    """Raise InputError for a row of a sensor that is not in `names`, or is in `unplaced` (cameras without a pose).

    `offset` is the number of rows before the chunk, for the message.
    """
    found, first = np.unique(chunk.sensor, return_index=True)
    for name, row in zip(found.tolist(), (first + offset).tolist(), strict=True):
        if name not in names:
            raise InputError(
                f"bearings: row {row}: no sensor {name!r} in the scene; {did_you_mean(name, names, 'it has')}",
                id="unknown-sensor",
            )
        if name in unplaced:
            raise InputError(
                f"bearings: row {row}: camera {name!r} has no pose in the scene; add its position and yaw, "
                f"or leave {name} out",
                id="missing-pose",
            )


def _chosen(chunk: Bearings, use: BearingRows) -> Bearings:
    """Return the rows of a chunk that the selection `use` keeps."""
    keep = np.isin(chunk.sensor, list(use.sensors))
    if use.targets is not None:
        keep &= np.isin(chunk.target_id, [*use.targets, UNLABELLED])
    if not use.unlabelled:
        keep &= chunk.target_id != UNLABELLED
    return chunk if keep.all() else chunk.take(keep)


def _starts(table: Bearings, window_ns: int) -> list[int]:
    """Return the first rows of the scans in a table sorted by time; the last scan may go on in the next chunk.

    A scan ends `window_ns` after its first row, and before a second time of one sensor; with 0 it is of one time.
    """
    if window_ns == 0 or not len(table):
        return [0, *(np.flatnonzero(np.diff(table.t_ns)) + 1).tolist()]
    starts = [0]
    spoke: dict[str, int] = {}
    for row, (t_ns, sensor) in enumerate(zip(table.t_ns.tolist(), table.sensor.tolist(), strict=True)):
        if t_ns - table.t_ns[starts[-1]] > window_ns or spoke.get(sensor, t_ns) != t_ns:
            starts.append(row)
            spoke = {}
        spoke[sensor] = t_ns
    return starts


def _split(table: Bearings, starts: list[int], names: tuple[str, ...]) -> Iterator[Scan]:
    """Generate the scans between consecutive starts; rows from the last start on are omitted.

    InputError if a sensor has two rows for a target in a scan.

    Args:
        table: bearings, sorted by time.
        starts: first rows of the scans.
        names: names of all sensors, in the order of their indices.
    """
    n = starts[-1]
    if n == 0:
        return
    index_of = {name: i for i, name in enumerate(names)}
    found, inverse = np.unique(table.sensor[:n], return_inverse=True)
    sensor = np.array([index_of[name] for name in found.tolist()], dtype=np.int64)[inverse]
    scan = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    order = np.lexsort((table.target_id[:n], sensor, scan))
    _check_single(table, sensor, scan, order)
    columns = {name: getattr(table, name)[order] for name in COLUMNS if name != "sensor"}
    whole = Scan(t_ns=0, sensor=sensor[order], **columns)
    for first, last in pairwise(starts):
        yield whole.take(slice(first, last))._replace(t_ns=int(table.t_ns[last - 1]))


def _check_single(table: Bearings, sensor: Ints, scan: Ints, order: Ints) -> None:
    """Raise InputError if a sensor has two rows for a target in one scan.

    Args:
        table: bearings.
        sensor: (n,) index of each row's sensor.
        scan: (n,) number of each row's scan, nondecreasing.
        order: (n,) rows sorted by scan, sensor and target.
    """
    target = table.target_id[order]
    same = (np.diff(scan) == 0) & (np.diff(sensor[order]) == 0) & (np.diff(target) == 0)
    same &= target[1:] != UNLABELLED
    if same.any():
        row = int(order[1:][same][0])
        raise InputError(
            f"bearings: sensor {str(table.sensor[row])!r} has two rows of target {table.target_id[row]} at "
            f"{time_words(table.t_ns[row])}; keep one, or give candidates of unknown identity target_id -1",
            id="duplicate-row",
        )


def choose_sensors(
    scene: Scene, only: Iterable[str] = (), without: Iterable[str] = (), *, readers: bool = False
) -> frozenset[str]:
    """Return the names of the sensors to use; UsageError for an unknown name, or if none is left.

    Args:
        scene: has the sensors.
        only: names to choose from; empty: all.
        without: names to leave out.
        readers: tag readers count as sensors, too.
    """
    names = (*sensor_names(scene), *(r.name for r in scene.readers if readers))
    only, without = list(only), list(without)
    for name in (*only, *without):
        if name not in names:
            raise UsageError(
                f"no sensor {name!r} in the scene, to be used or omitted; {did_you_mean(name, names, 'it has')}",
                id="unknown-sensor",
            )
    used = frozenset(only or names) - frozenset(without)
    if not used:
        raise UsageError("all sensors are omitted, and none is left; omit fewer of them", id="too-few-sensors")
    return used
