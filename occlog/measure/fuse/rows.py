"""Rows of bearings and views after fusion: kept, removed, recovered in place, or added.

Also the division of views and bearings into whole time steps.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.measure.detections import Detections
from occlog.records.tables import UNLABELLED, Bearings, Views

from .kernels import PositionWithCovariance
from .views import PlacedCameras, expected_sight, recovered_views, views_of

T = TypeVar("T", Views, Bearings)


@dataclass(frozen=True, eq=False)
class FusionPart:
    """Chunk of whole time steps of detections from cameras.

    Fields: views and bearings sorted by time; row of the first bearing of each of M time steps, then the number of rows
    (M + 1,); the input chunk with its losses and numbers of frames.
    """

    views: Views
    bearings: Bearings
    starts: Ints  # (M + 1,) of the bearings; 0 first, number of rows last
    losses: Detections  # with them: losses and numbers of frames


def whole_time_steps(parts: Iterable[Detections], window_ns: int) -> Iterator[FusionPart]:
    """Rechunk detections into parts of whole time steps, independent of the input's chunk borders.

    Bearings at most `window_ns` [ns] after the first of a time step belong to it, unless a sensor would report at two
    times. Views go with the bearings of their times.

    Raises:
        InputError: times go back from one part to the next.
    """
    views, bearings = Views.empty(), Bearings.empty()
    for part in parts:
        views, bearings = _joined(views, part.views), _joined(bearings, part.bearings)
        starts = time_step_rows(bearings, window_ns)
        cut = int(starts[-2]) if len(bearings) else 0  # the last time step may go on in the next part
        first_ns = int(bearings.t_ns[cut]) if len(bearings) else None
        over = len(views) if first_ns is None else int(np.searchsorted(views.t_ns, first_ns))
        whole = starts[:-1] if len(bearings) else starts
        yield FusionPart(views.take(slice(0, over)), bearings.take(slice(0, cut)), whole, part)
        views, bearings = views.take(slice(over, None)), bearings.take(slice(cut, None))
    nothing = Detections(Views.empty(), Bearings.empty(), (), 0, 0)
    yield FusionPart(views, bearings, time_step_rows(bearings, window_ns), nothing)


def _joined(held: T, more: T) -> T:
    if len(held) and len(more) and more.t_ns[0] < held.t_ns[-1]:
        raise InputError(
            f"{held.NAME}: time {time_words(more.t_ns[0])} is earlier than the preceding "
            f"{time_words(held.t_ns[-1])}; sort the "
            "rows by t_ns",
            id="unsorted-times",
        )
    return type(held).concat([held, more.sorted()])


def time_step_rows(bearings: Bearings, window_ns: int) -> Ints:
    """(M + 1,) first rows of the M time steps of sorted bearings, then the number of rows.

    A time step ends `window_ns` [ns] after its first row, or before a sensor reports at a second time. With
    `window_ns` 0 each different time is one step.
    """
    t = bearings.t_ns
    if not len(t):
        return np.zeros(1, dtype=np.int64)
    if window_ns == 0:
        return np.concatenate([[0], np.flatnonzero(np.diff(t)) + 1, [len(t)]]).astype(np.int64)
    starts = [0]
    spoke: dict[str, int] = {}
    for row, (t_ns, sensor) in enumerate(zip(t.tolist(), bearings.sensor.tolist(), strict=True)):
        if t_ns - int(t[starts[-1]]) > window_ns or spoke.get(sensor, t_ns) != t_ns:
            starts.append(row)
            spoke = {}
        spoke[sensor] = t_ns
    return np.array([*starts, len(t)], dtype=np.int64)


def in_step(views: Iterable[Views], bearings: Iterable[Bearings]) -> Iterator[Detections]:
    """Combine the streams of two tables: each chunk of bearings with the views up to its last time.

    Views after the last bearing follow in chunks without bearings. Losses and numbers of frames are empty.
    """
    ahead = iter(views)
    held = Views.empty()
    for chunk in bearings:
        if not len(chunk):
            continue
        last = int(chunk.t_ns[-1])
        while not len(held) or held.t_ns[-1] <= last:
            more = next(ahead, None)
            if more is None:
                break
            held = Views.concat([held, more])
        over = int(np.searchsorted(held.t_ns, last, side="right"))
        yield Detections(held.take(slice(0, over)), chunk, (), 0, 0)
        held = held.take(slice(over, None))
    for more in (held, *ahead):
        yield Detections(more, Bearings.empty(), (), 0, 0)


KEPT, RECOVERED, REMOVED = "kept", "recovered", "removed"
CAUSES = (KEPT, RECOVERED, REMOVED)


class FusionRows:
    """Collects the decisions of the fusion about the rows of one part, and builds the changed tables from them."""

    def __init__(self, part: FusionPart, cameras: PlacedCameras, camera_of: Ints) -> None:
        """Start without decisions.

        Args:
            part: whole time steps with N bearings.
            cameras: calibrated cameras.
            camera_of: (N,) index into `cameras` of each bearing's sensor; -1: another sensor.
        """
        self.bearings, self.cameras, self.camera_of = part.bearings, cameras, camera_of
        n = len(part.bearings)
        self.cause = np.full(n, "", dtype="U9")
        self.dropped = np.zeros(n, dtype=np.bool_)
        self._sight: dict[int, tuple[float, float, float, float]] = {}  # rows that are recovered in place
        self._new: list[tuple[int, int, int, PositionWithCovariance]] = []  # time, camera, target, position
        self._fresh: set[tuple[int, int]] = set()  # time and camera of recovered candidates
        self._views, self._view_of = part.views, views_of(part.views, part.bearings)

    def keep(self, rows: Ints) -> None:
        """Mark the detections `rows` as kept."""
        self.cause[rows] = KEPT

    def remove(self, rows: Ints) -> None:
        """Mark the detections `rows` as removed, since other cameras contradict them."""
        self.cause[rows] = REMOVED

    def recover(self, t_ns: int, camera: int, target: int, position: PositionWithCovariance, row: int | None) -> None:
        """Record a recovered detection at the global position for a camera that missed an object.

        Args:
            t_ns: time of the camera's frame [ns].
            camera: index of the camera.
            target: identity, or `UNLABELLED`.
            position: global position of the object.
            row: row of the camera's missed detection of this target, which is overwritten; None: a new row is added.
        """
        self._new.append((t_ns, camera, target, position))
        if target == UNLABELLED:
            self._fresh.add((t_ns, camera))
        if row is not None:
            self._sight[row] = expected_sight(self.cameras.placed[camera], position)

    def tidy_candidates(self, first: int, last: int) -> None:
        """Drop superfluous "not detected" rows of each camera's unlabelled candidates in one time step.

        A camera with a kept or recovered candidate loses all of them, any other keeps one. To be called after all
        decisions of the time step, with rows `first` <= row < `last`.
        """
        rows = np.arange(first, last)
        mine = rows[(self.bearings.target_id[first:last] == UNLABELLED) & (self.camera_of[first:last] >= 0)]
        for camera in np.unique(self.camera_of[mine]).tolist():
            own = mine[self.camera_of[mine] == camera]
            gone = own[~self.bearings.seen[own] | (self.cause[own] == REMOVED)]
            if len(gone) < len(own) or (int(self.bearings.t_ns[own[0]]), camera) in self._fresh:
                self.dropped[gone] = True
            else:
                removed = gone[self.cause[gone] == REMOVED]
                stays = removed[0] if len(removed) else gone[0]
                self.dropped[gone[gone != stays]] = True

    def tables(self, frames: dict[str, int]) -> tuple[Views, Bearings]:
        """Return the views and bearings after the decisions, with recovered rows.

        Args:
            frames: number of the last frame of each camera by name so far; updated in place.
        """
        views = self._changed_views()
        added = recovered_views(self._new, self.cameras, self._views, self.bearings, frames)
        return Views.merge([views, added]), Bearings.merge([self._changed_bearings(), self._new_bearings()])

    def counts(self) -> Ints:
        """(C, 3) numbers of kept, recovered and removed detections of each camera."""
        out = np.zeros((len(self.cameras.placed), 3), dtype=np.int64)
        for column, cause in ((0, KEPT), (2, REMOVED)):
            np.add.at(out[:, column], self.camera_of[self.cause == cause], 1)
        np.add.at(out[:, 1], np.array([n[1] for n in self._new], dtype=np.int64), 1)
        return out

    def of_targets(self) -> Ints:
        """(C, 2) numbers of kept and removed labelled detections of each camera."""
        out = np.zeros((len(self.cameras.placed), 2), dtype=np.int64)
        for column, cause in enumerate((KEPT, REMOVED)):
            np.add.at(
                out[:, column], self.camera_of[(self.cause == cause) & (self.bearings.target_id != UNLABELLED)], 1
            )
        return out

    def _changed_bearings(self) -> Bearings:
        b = self.bearings
        cause = self.cause.copy()
        seen = b.seen & (cause != REMOVED)
        columns = {
            name: np.where(seen, getattr(b, name), np.nan)
            for name in ("bearing", "sigma", "u_px", "sigma_px", "score", "elevation", "sigma_elevation")
        }
        for row, sight in self._sight.items():
            seen[row], cause[row] = True, RECOVERED
            for name, value in zip(("bearing", "sigma", "u_px", "sigma_px"), sight, strict=True):
                columns[name][row] = value
            columns["score"][row] = np.nan
        return replace(b, seen=seen, cause=cause.astype(np.str_), **columns).take(~self.dropped)

    def _new_bearings(self) -> Bearings:
        """Bearings of recovered detections for which the input has no row of that camera, time and target."""
        values = {
            (int(self.bearings.t_ns[r]), int(self.camera_of[r]), int(self.bearings.target_id[r])) for r in self._sight
        }
        rows = [n for n in self._new if n[:3] not in values]
        if not rows:
            return Bearings.empty()
        sights = np.array([expected_sight(self.cameras.placed[camera], position) for _, camera, _, position in rows])
        n = len(rows)
        return Bearings.of(
            t_ns=np.array([r[0] for r in rows]),
            sensor=np.array([self.cameras.placed[r[1]].name for r in rows]),
            target_id=np.array([r[2] for r in rows], dtype=np.int32),
            seen=np.ones(n, dtype=np.bool_),
            bearing=sights[:, 0],
            sigma=sights[:, 1],
            u_px=sights[:, 2],
            sigma_px=sights[:, 3],
            score=np.full(n, np.nan),
            cause=np.full(n, RECOVERED),
        )

    def _changed_views(self) -> Views:
        v = self._views
        there = self._view_of >= 0
        cause = np.full(len(v), "", dtype="U9")
        cause[self._view_of[there]] = self.cause[there]
        removed: Bools = cause == REMOVED
        target = np.where(removed, UNLABELLED, v.target_id).astype(np.int32)
        return replace(v, cause=cause.astype(np.str_), target_id=target)


def distances(part: FusionPart, feet: Floats) -> Floats:
    """(N, 2) distance along the ground and its standard deviation for each of N bearings; NaN where unknown.

    `feet` (V, 2) has the distance and its standard deviation for each of the V views of the part [length].
    """
    view = views_of(part.views, part.bearings)
    out = np.full((len(part.bearings), 2), np.nan)
    out[view >= 0] = feet[view[view >= 0]]
    return out
