"""Labelling of candidates: assignment to the track with the most similar bearing."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Ints32
from occlog.core.geometry.camera import wrap_angle
from occlog.core.numerics.assignment import assign
from occlog.core.numerics.interpolate import interpolate_positions
from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED, Bearings, Tracks
from occlog.scans.grouping import checked, sensor_names

from .config import LabelConfig

ROWS_PER_PART = 4096
ANY_DIRECTION = np.pi**2 / 3.0
"""Variance of a direction of which nothing is known [rad^2]: no track is less certain, however near the sensor."""


class Labelled(NamedTuple):
    """Labelled bearings of complete time steps, with counts.

    `given` has the target of each candidate that got a label, `missed` that of each added row without detection; `left`
    counts candidates without a label, `frames` those with a track at their time.
    """

    bearings: Bearings
    given: Ints32  # target of each candidate that got a label
    missed: Ints32  # target of each "not seen" row that was added
    left: int  # candidates without a label
    frames: int  # with a track at their time


class _States(NamedTuple):
    """K tracks at N times: identities (K,), states (N, K, 5), and a mask (N, K) of those that exist.

    States are x, y, cov_xx, cov_xy, cov_yy in the world, NaN where a track does not exist.
    """

    target: Ints32  # (K,) ascending
    values: Floats  # (N, K, 5) x, y, cov_xx, cov_xy, cov_yy; NaN where the track is not
    there: Bools  # (N, K)


def label(
    bearings: Iterable[Bearings],
    tracks: Iterable[Tracks],
    scene: Scene,
    config: LabelConfig,
    sensors: Collection[str] | None = None,
) -> Iterator[Labelled]:
    """Generate the bearings with candidates labelled by the tracks that they agree with, sorted by time.

    In every frame of a sensor candidates are assigned one to one to the tracks at its time: the maximum number
    within the gate, then the least sum of squared normalised bearing differences. A track without a candidate gets
    a row without detection. Rows that have a label keep it, and exclude its track. The result is independent of
    chunk borders; memory is bounded.

    Args:
        bearings: chunks in the order of time.
        tracks: chunks in the order of time; interpolated linearly between their rows, not beyond.
        scene: has all sensors.
        config: gate, largest gap of a track, and whether unassigned candidates are kept.
        sensors: names of those to use; rows of others are skipped; None: all.

    Raises:
        InputError: a sensor that the scene does not have or that has no pose, a track with a negative identity, or
            times that go back.
    """
    names = frozenset(sensor_names(scene) if sensors is None else sensors)
    paths = _Paths(tracks, round(config.max_gap_s * NS))
    ground = {c.name: c.ground for c in scene.cameras} | {a.name: a.position[:2] for a in scene.arrays}
    for part in _whole_times(checked(bearings, scene, names)):
        used = part.take(np.isin(part.sensor, list(names))).sorted()
        if len(used):
            yield _label(used, paths, ground, config)


def _whole_times(chunks: Iterable[Bearings]) -> Iterator[Bearings]:
    """Rechunk bearings to about `ROWS_PER_PART` rows, with all rows of a time in one chunk."""
    rest = Bearings.empty()
    for chunk in chunks:
        table = Bearings.concat([rest, chunk])
        starts = np.append(0, np.flatnonzero(np.diff(table.t_ns)) + 1)
        first = 0
        while first < starts[-1]:
            index = int(np.searchsorted(starts, first + ROWS_PER_PART, side="right")) - 1
            cut = int(starts[index]) if starts[index] > first else int(starts[index + 1])
            yield table.take(slice(first, cut))
            first = cut
        rest = table.take(slice(first, None))  # the last time may go on in the next chunk
    if len(rest):
        yield rest


class _Paths:
    """Interpolates a stream of tracks at nondecreasing times; only the rows around them are in memory."""

    def __init__(self, chunks: Iterable[Tracks], limit_ns: int) -> None:
        """Start without reading tracks; their chunks are sorted by time.

        Tracks are not interpolated across gaps of more than `limit_ns` [ns].
        """
        self._chunks = iter(chunks)
        self._limit_ns = limit_ns
        self._held = Tracks.empty()

    def at(self, t_ns: Ints) -> _States:
        """Interpolate all tracks at the times `t_ns` (N,) [ns], nondecreasing within and across calls."""
        near = self._near(int(t_ns[0]) - self._limit_ns, int(t_ns[-1]) + self._limit_ns).with_covariance()
        target = np.unique(near.target_id)
        values, there = np.empty((len(t_ns), len(target), 5)), np.zeros((len(t_ns), len(target)), dtype=np.bool_)
        columns = np.column_stack([near.x, near.y, near.cov_xx, near.cov_xy, near.cov_yy])
        for k, name in enumerate(target.tolist()):
            own = near.target_id == name
            values[:, k], there[:, k] = interpolate_positions(t_ns, near.t_ns[own], columns[own], self._limit_ns)
        return _States(target, values, there)

    def _near(self, first_ns: int, last_ns: int) -> Tracks:
        """Read on, and return the track rows from `first_ns` to `last_ns` [ns], both included.

        Earlier rows are dropped for good. InputError for a negative identity.
        """
        parts = [self._held]
        while not len(parts[-1]) or parts[-1].t_ns[-1] <= last_ns:
            chunk = next(self._chunks, None)
            if chunk is None:
                break
            if (chunk.target_id < 0).any():
                row = int(np.flatnonzero(chunk.target_id < 0)[0])
                raise InputError(
                    f"tracks: target_id is {chunk.target_id[row]} at {time_words(chunk.t_ns[row])}; leave "
                    "out rows without an identity (0 or more)"
                )
            parts.append(chunk)
        held = Tracks.concat(parts)
        self._held = held.take(slice(int(np.searchsorted(held.t_ns, first_ns)), None))
        return self._held.take(slice(None, int(np.searchsorted(self._held.t_ns, last_ns, side="right"))))


def _label(table: Bearings, paths: _Paths, ground: dict[str, Floats], config: LabelConfig) -> Labelled:
    """Label the candidates of whole times, and add a row without detection for each track that a frame misses.

    `table` is sorted by time and sensor; `ground` has the ground position (2,) of each sensor by name.
    """
    # Frames: the rows of one sensor at one time
    fresh = np.ones(len(table), dtype=np.bool_)
    fresh[1:] = (np.diff(table.t_ns) != 0) | (table.sensor[1:] != table.sensor[:-1])
    first, frame = np.flatnonzero(fresh), np.cumsum(fresh) - 1
    # Interpolate the tracks at the frames' times
    states = paths.at(table.t_ns[first])
    positions = np.array([ground[name] for name in table.sensor[first].tolist()])
    # Gate and assign: squared normalised differences of bearings, one to one in each frame
    rows = np.flatnonzero(table.seen & (table.target_id == UNLABELLED))
    cost = _apart2(table, rows, frame[rows], states, positions)
    wanted = states.there & ~_labels_of(table, frame, len(first), states.target)
    picked, track = _assigned(cost, np.searchsorted(frame[rows], np.arange(len(first) + 1)), wanted, config.gate**2)
    target = table.target_id.copy()
    target[rows[picked]] = states.target[track]
    wanted[frame[rows[picked]], track] = False
    # Tracks without a candidate in a frame get a row that is not seen
    empty, missing = np.nonzero(wanted)
    keep = np.full(len(table), config.keep_unassigned) | (target != UNLABELLED)
    unseen = missed_detections(table.take(first[empty]), states.target[missing])
    return Labelled(
        bearings=Bearings.merge([replace(table, target_id=target).take(keep), unseen]),
        given=states.target[track],
        missed=unseen.target_id,
        left=len(rows) - len(picked),
        frames=int(np.count_nonzero(states.there.any(axis=1))),
    )


def _assigned(cost: Floats, bounds: Ints, wanted: Bools, gate: float) -> tuple[Ints, Ints]:
    """Assign candidates to tracks one to one in each frame; return indices of the assigned candidates and their tracks.

    Args:
        cost: (n, K) squared normalised bearing differences between candidates, frame after frame, and tracks.
        bounds: (frames + 1,) index of the first candidate of each frame, then n.
        wanted: (frames, K) mask of tracks that exist and have no labelled row in a frame.
        gate: largest cost of a pair.
    """
    rows, columns = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for n in np.flatnonzero(wanted.any(axis=1) & (np.diff(bounds) > 0)).tolist():
        tracks = np.flatnonzero(wanted[n])
        row, column = assign(cost[bounds[n] : bounds[n + 1], tracks], gate)
        rows.append(bounds[n] + row)
        columns.append(tracks[column])
    return np.concatenate(rows), np.concatenate(columns)


def _labels_of(table: Bearings, frame: Ints, frames: int, target: Ints32) -> Bools:
    """(frames, K) mask of the frames that already have a labelled row of each track.

    Args:
        table: n bearings.
        frame: (n,) frame of each row, 0 to `frames` - 1.
        frames: number of frames.
        target: (K,) sorted identities of the tracks.
    """
    labelled = np.zeros((frames, len(target)), dtype=np.bool_)
    rows = np.flatnonzero(np.isin(table.target_id, target))
    labelled[frame[rows], np.searchsorted(target, table.target_id[rows])] = True
    return labelled


def _apart2(table: Bearings, rows: Ints, frame: Ints, states: _States, positions: Floats) -> Floats:
    """(n, K) squared bearing differences between candidates and tracks, divided by their variances.

    The variance is that of the bearing and of the track across the line of sight, limited to `ANY_DIRECTION`.
    Infinite for an absent track.

    Args:
        table: bearings.
        rows: (n,) rows of the candidates in it.
        frame: (n,) frame of each candidate.
        states: tracks at the times of the frames.
        positions: (frames, 2) ground positions of the sensors of the frames.
    """
    x, y, cov_xx, cov_xy, cov_yy = np.moveaxis(states.values, 2, 0)
    dx, dy = x - positions[:, :1], y - positions[:, 1:]
    r2 = dx**2 + dy**2
    across = dy**2 * cov_xx - 2 * dx * dy * cov_xy + dx**2 * cov_yy
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = np.where(r2 > 0, np.minimum(across / r2**2, ANY_DIRECTION), ANY_DIRECTION)
    expected = np.arctan2(dy, dx)
    difference = wrap_angle(table.bearing[rows, None] - expected[frame])
    return np.where(states.there[frame], difference**2 / (variance[frame] + table.sigma[rows, None] ** 2), np.inf)


def missed_detections(rows: Bearings, target: Ints32) -> Bearings:
    """Rows without detection of the targets (n,), at the times and sensors of the n rows `rows`."""
    nothing = np.full(len(rows), np.nan)
    return Bearings(
        t_ns=rows.t_ns,
        sensor=rows.sensor,
        target_id=target,
        seen=np.zeros(len(rows), dtype=np.bool_),
        bearing=nothing,
        sigma=nothing,
        u_px=nothing,
        sigma_px=nothing,
        score=nothing,
    )
