"""Constant range errors of stations: antenna delays, offsets of cables and clocks.

As in `occlog.consistency.systematic_errors` the error of a track, a position and a velocity within a short window, is
eliminated from the residuals of ranges and bearings. The remaining residuals of a station's ranges are noise and its
constant error. These errors are often equal in all stations, so that all are estimated jointly. A target that stands,
or walks where errors of stations are alike, does not determine all of them: stations are then selected one after the
other. Standard errors are the larger of those by the noise and those by the scatter between blocks of the recording
(White 1980, A heteroskedasticity-consistent covariance matrix estimator, Econometrica 48(4)).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.filtering.likelihood.distances import DELAYED, DIFFERENCE, concat, residuals_at_own_position
from occlog.records.scene import Scene
from occlog.records.tables import Tracks
from occlog.records.verdicts import Check, finding, outcome
from occlog.scans.grouping import ScanMeasurements

from .bearings import StatedResiduals
from .estimates import MAX_SIGMA_RAD
from .range_readings import RangeReadings
from .systematic_errors import (
    MAX_FOUND,
    MEDIAN,
    MIN_FREEDOM,
    MIN_RANK,
    MIN_SHARE_LEFT,
    MIN_SHARE_OF_NOISE,
    RIVAL_GAIN,
    linearised_bearings,
    local_lines,
    rival_words,
)

RANGE_BIASES = "errors of ranges"
"""Name of the check."""
WINDOW_S = 2.0
"""Time in which the error of a track is linear [s]."""
MAX_RESIDUAL = 4.0
"""Residuals farther from the median of their station by that many of their median deviations are of false ranges."""
MIN_SIGMAS = 5.0
"""Minimum number of standard errors of an error that is found."""
PRIOR_SIGMAS = 100.0
"""Prior standard deviation of errors, in standard deviations of the ranges."""
MAX_BLOCKS = 256
"""Sums of windows that are kept; neighbours are added where there are more."""
MIN_SENSORS = 3
"""Sensors and stations that measure in a window; two always agree on a position."""
MIN_BLOCKS = 8
"""Windows that are needed."""
AS_WELL = 2.0
"""Another position of a station explains its ranges as well if that leaves at most this times the misfit."""
MAX_STATIONS = 40
"""Stations that are judged, the first ones that measure."""


class RangeBias(NamedTuple):
    """Constant error of the ranges of a station [length], with its standard error and the size that matters.

    The size is above 0 for ranges that are too long. `rivals` are stations with ranges that may be the wrong ones
    instead.
    """

    station: str
    size: float  # by how much they are too long
    error: float  # its standard error
    limit: float  # size that matters
    rivals: tuple[str, ...] = ()


class BlockSums(NamedTuple):
    """Normal equations of the errors of S stations, summed over a block of windows."""

    normal: Floats  # (S, S)
    right: Floats  # (S,)

    def plus(self, other: BlockSums) -> BlockSums:
        """Return the sums of this block and another one."""
        return BlockSums(self.normal + other.normal, self.right + other.right)


class RangeBiases:
    """Normal equations of the constant range errors of all stations, accumulated chunk by chunk."""

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        """Start without residuals.

        Args:
            scene: cameras and microphone arrays.
            names: names of the stations, in the order in which measurements number them.
        """
        self._names = names
        self._origin = {c.name: c.position[:2] for c in scene.cameras}
        self._origin |= {a.name: a.position[:2] for a in scene.arrays}
        self._column: dict[int, int] = {}
        self._blocks: list[BlockSums] = []
        self._square = self._freedom = 0.0
        self.readings = RangeReadings(names)
        self._counts, self._weights = np.zeros(MAX_STATIONS), np.zeros(MAX_STATIONS)  # sums of 1 and of 1 / sigma^2

    def add(
        self, tracks: Tracks, stated: Sequence[StatedResiduals], measured: Sequence[tuple[int, ScanMeasurements]]
    ) -> None:
        """Add the residuals at further estimates, in the order of time.

        Args:
            tracks: estimates.
            stated: residuals of bearings at them.
            measured: times [ns] and measurements of distances up to the last of them.
        """
        if not measured:
            return
        self.readings.add(measured)
        t_ns = np.repeat([t for t, _ in measured], [len(one.target_id) for _, one in measured])
        target = np.concatenate([one.target_id for _, one in measured])
        rows = concat([one.distances for _, one in measured])
        ranges = DELAYED[rows.kind] & (rows.kind != DIFFERENCE)
        for number in np.unique(target[ranges]).tolist():
            own, of = np.flatnonzero(ranges & (target == number)), np.flatnonzero(tracks.target_id == number)
            if len(of) < 3:
                continue
            track = tracks.take(of)
            inside = (t_ns[own] >= track.t_ns[0]) & (t_ns[own] <= track.t_ns[-1])
            own = own[inside]
            seconds = (track.t_ns - track.t_ns[0]) / NS
            xy = np.column_stack([track.x, track.y])
            path, at = local_lines(seconds, xy), (t_ns[own] - track.t_ns[0]) / NS
            there = np.column_stack([np.interp(at, seconds, column) for column in path.T])
            residual, gradient = residuals_at_own_position(rows.take(own), there)
            station, sigma = rows.station[own], rows.sigma[own]
            found = [
                np.column_stack([at, residual, gradient, sigma, self._columns_of(station)])[_usable(station, residual)]
            ]
            for sensor, one in enumerate(stated):
                if one.target == number and one.sensor in self._origin and len(one.residual):
                    index = np.searchsorted(track.t_ns, one.t_ns)
                    off, slope = linearised_bearings(one, self._origin[one.sensor], xy[index], path[index])
                    columns = [seconds[index], off, slope, one.sigma, np.full(len(off), -1.0 - sensor)]
                    keep = (one.sigma <= MAX_SIGMA_RAD) & _usable(np.zeros(len(off), dtype=np.int64), off)
                    found.append(np.column_stack(columns)[keep])
            everything = np.concatenate(found)
            everything = everything[np.argsort(everything[:, 0], kind="stable")]
            for window in np.split(everything, np.flatnonzero(np.diff(everything[:, 0] // WINDOW_S)) + 1):
                self._add_window(window)

    def _columns_of(self, station: Ints) -> Floats:
        """Return (N,) columns of stations in the normal equations; -1 for stations beyond the first `MAX_STATIONS`.

        `station` (N,) are numbers of stations; new ones get the next column.
        """
        for number in np.unique(station).tolist():
            if number not in self._column and len(self._column) < MAX_STATIONS:
                self._column[number] = len(self._column)
        return np.array([float(self._column.get(number, -1)) for number in station.tolist()])

    def _add_window(self, rows: Floats) -> None:
        """Add N measurements of one target in one window, with its position and velocity eliminated.

        Args:
            rows: (N, 6) time [s], residual and its gradient by x and y in standard deviations, the standard deviation,
                and the column of the station; below 0: another number of each sensor with bearings.
        """
        column = rows[:, 5].astype(np.int64)
        own = np.flatnonzero(column >= 0)
        if not len(own) or len(np.unique(column)) < MIN_SENSORS:
            return
        # Eliminate position and velocity
        G, after = rows[:, 2:4], rows[:, 0] - rows[:, 0].mean()
        u, s, _ = np.linalg.svd(np.column_stack([G, G * after[:, None]]), full_matrices=False)
        u = u[:, s > MIN_RANK * s[0]]
        if u.shape[1] >= len(rows):
            return
        X = np.zeros((len(rows), MAX_STATIONS))
        X[own, column[own]] = 1.0 / rows[own, 4]
        np.add.at(self._counts, column[own], 1.0)
        np.add.at(self._weights, column[own], rows[own, 4] ** -2)
        X, y = X - u @ (u.T @ X), rows[:, 1] - u @ (u.T @ rows[:, 1])
        self._blocks.append(BlockSums(X.T @ X, X.T @ y))
        self._square += float(y @ y)
        self._freedom += len(rows) - u.shape[1]
        if len(self._blocks) == MAX_BLOCKS:
            self._blocks = [a.plus(b) for a, b in zip(self._blocks[::2], self._blocks[1::2], strict=True)]

    def found(self) -> list[RangeBias]:
        """Return the significant errors that are large enough to matter.

        If a joint estimate of all stations has such errors, they are returned in the order of the stations. Otherwise
        stations are selected one after the other, the most significant first, `MAX_FOUND` at most.
        """
        S, K = len(self._column), len(self._blocks)
        if max(MIN_BLOCKS, S + 2) > K or self._freedom - S < MIN_FREEDOM:
            return []
        noise = np.sqrt(self._counts[:S] / np.maximum(self._weights[:S], 1e-300))
        limit = MIN_SHARE_OF_NOISE * noise
        names = [self._names[number] for number in self._column]
        size, error = self._fitted(list(range(S)))
        large = (np.abs(size) > MIN_SIGMAS * error) & (np.abs(size) > limit)
        if large.any():
            columns = zip(names, size.tolist(), error.tolist(), limit.tolist(), large.tolist(), strict=True)
            return [RangeBias(name, value, sigma, least) for name, value, sigma, least, matters in columns if matters]
        out: list[RangeBias] = []
        taken: list[int] = []
        while len(taken) < min(MAX_FOUND, S):
            tried = [s for s in range(S) if s not in taken and self._determined(taken, s)]
            fits = {s: [float(column[-1]) for column in self._fitted([*taken, s])] for s in tried}
            gain = {s: (size / error) ** 2 for s, (size, error) in fits.items()}
            best = max(gain, key=gain.__getitem__, default=-1)
            if best < 0 or gain[best] < MIN_SIGMAS**2 or abs(fits[best][0]) < limit[best]:
                break
            rivals = tuple(names[s] for s in tried if s != best and gain[s] > gain[best] - RIVAL_GAIN)
            out.append(RangeBias(names[best], fits[best][0], fits[best][1], float(limit[best]), rivals))
            taken.append(best)
        return out

    def _fitted(self, chosen: Sequence[int]) -> tuple[Floats, Floats]:
        """Return sizes (k,) and standard errors (k,) of the errors of k stations if all others have none.

        `chosen` are their columns in the normal equations.
        """
        K, k = len(self._blocks), len(chosen)
        normals = np.array([block.normal[np.ix_(chosen, chosen)] for block in self._blocks])
        rights = np.array([block.right[chosen] for block in self._blocks])
        # The weights of the prior: 1 / sigma^2 of a range
        prior = self._weights[chosen] / np.maximum(self._counts[chosen], 1.0) / PRIOR_SIGMAS**2
        P = np.linalg.inv(normals.sum(axis=0) + np.diag(prior))
        size = P @ rights.sum(axis=0)
        left = max((self._square - float(size @ rights.sum(axis=0))) / (self._freedom - k), 1.0)
        scores = rights - normals @ size
        scatter = K / (K - k) * P @ (scores.T @ scores) @ P
        return size, np.sqrt(np.maximum(left * np.diag(P), np.diag(scatter)))

    def _determined(self, taken: Sequence[int], column: int) -> bool:
        """Return whether tracks and the errors of the stations `taken` do not explain any error of one more station.

        `taken` and `column` are columns in the normal equations.
        """
        normal = np.sum([block.normal for block in self._blocks], axis=0)
        explained = normal[column, taken] @ np.linalg.pinv(normal[np.ix_(taken, taken)]) @ normal[taken, column]
        return bool(normal[column, column] - explained > MIN_SHARE_LEFT * self._weights[column])

    def checks(self, unit: str, *, estimated: bool = False) -> tuple[Check, ...]:
        """Return the check of constant range errors, with a finding for each station with ranges too long or too short.

        Args:
            unit: unit of lengths.
            estimated: the method has estimated and removed these errors.
        """
        if estimated:
            return outcome(RANGE_BIASES, (), unless="the method estimates them")
        few = "too few ranges of several stations at one time" if self._freedom < MIN_FREEDOM else ""
        reading = self.readings.checks(unit)
        if any(check.found for check in reading):
            return *reading, *outcome(RANGE_BIASES, (), unless="ranges meet in another reading")
        return *reading, *outcome(RANGE_BIASES, self._findings(unit), unless=few)

    def _findings(self, unit: str) -> Iterator[Check]:
        """Generate a finding for each significant error; lengths are in `unit`."""
        found = self.found()
        # Where tracks follow wrong ranges, the station alone has its error from where ranges meet
        alone = self.readings.one_station() if len(found) == 1 else None
        for one in found:
            rivals = [f"those of {name}" for name in one.rivals]
            if alone is not None and alone.station == one.station:
                if abs(alone.bias - one.size) > MIN_SIGMAS * alone.error:
                    one = one._replace(size=alone.bias, error=alone.error)
                if alone.moved_misfit <= AS_WELL * alone.bias_misfit:
                    rivals.insert(0, f"the station is moved by {alone.offset_words(unit)}")
            yield finding(
                RANGE_BIASES,
                "range-bias",
                sensors=[one.station],
                size=abs(one.size),
                sense="long" if one.size > 0.0 else "short",
                error=one.error,
                allowed=one.limit,
                unit=unit,
                rivals=rival_words(rivals),
            )


def _usable(station: Ints, residual: Floats) -> Bools:
    """Return (N,) booleans: the residual is near the median of those of its station; others are false measurements.

    `station` (N,) are numbers of stations, `residual` (N,) in standard deviations.
    """
    keep = np.ones(len(residual), dtype=np.bool_)
    for number in np.unique(station).tolist():
        own = station == number
        away = np.abs(residual[own] - np.median(residual[own]))
        keep[own] = away <= MAX_RESIDUAL * max(float(np.median(away)) / MEDIAN, 1.0)
    return keep
