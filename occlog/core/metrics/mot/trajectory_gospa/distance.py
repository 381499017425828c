"""Trajectory GOSPA: one distance between the true trajectories and the tracks, with a price for every change of track.

Garcia-Fernandez, Rahmathullah and Svensson 2020, "A metric on the space of finite sets of trajectories for evaluation
of multi-target tracking algorithms", IEEE Trans. Signal Processing 68; its relaxation as a linear program, which is a
metric, too, and equal to the combinatorial form where the program's solution is whole numbers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools
from occlog.core.metrics.mot.frame_pairs import Frames
from occlog.core.metrics.mot.trajectory_gospa.cuts import (
    CHANGE,
    FREE,
    Pairs,
    Pieces,
    Pins,
    delimiters,
    enough_gain,
    pieces_of,
    sure_stretches,
)
from occlog.core.metrics.mot.trajectory_gospa.program import solve
from occlog.core.metrics.sums import Sum


class TrajectoryGospa(NamedTuple):
    """The metric to the power of p, summed over all frames, and its parts, which add up to it; unit^p each.

    Attributes:
        total: the sum; the metric is its p-th root.
        localisation: distances of targets from their tracks.
        missed: c^p / 2 for each target in each frame without a track.
        false: c^p / 2 for each track in each frame without a target.
        switch: gamma^p for each change from one track to another, half of it for one from or to none.
        p: exponent.
    """

    total: float
    localisation: float
    missed: float
    false: float
    switch: float
    p: float


class TrajectoryCosts:
    """Trajectory GOSPA of frames that come in parts, in the order of time.

    What is sure is added up at once.  What is not is kept until nothing that comes later can have a part in it: until
    the targets and tracks of the piece are sure of somebody again, or have no rows any more.
    """

    def __init__(self, frames: int, targets: int, tracks: int, cutoff: float, switch: float, p: float = 2.0) -> None:
        """No frames yet.

        Args:
            frames: number of all frames.
            targets: number of all targets.
            tracks: number of all tracks.
            cutoff: largest distance that counts, c > 0, unit of the distance.
            switch: price of a change of track, gamma > 0, unit of the distance.
            p: exponent, >= 1.

        Raises:
            ValueError: an option is outside its range.
        """
        if not (0 < cutoff < np.inf and 0 < switch < np.inf and 1 <= p < np.inf):
            raise ValueError(f"cutoff {cutoff:g} and switch {switch:g} must be above 0, p {p:g} at least 1")
        self._frames, self._cutoff, self._p = frames, cutoff, p
        self._most, self._switch = cutoff**p, switch**p
        self._rows = np.zeros(2, dtype=np.int64)  # of the truth, of tracks
        self._over = np.zeros(targets, dtype=np.bool_), np.zeros(tracks, dtype=np.bool_)
        self._cost, self._weight, self._changes = Sum(), Sum(), Sum()
        self._runs = _NO_PAIRS  # for each run that may go on its last row of which it is known whether it is sure
        self._sure = np.zeros(0, dtype=np.int64)  # of these rows: 1 or 0
        self._later = _NO_PAIRS  # rows that are sure if their run goes on
        self._loose = _NO_PAIRS  # rows that are not sure, and not solved
        none = np.zeros(0, dtype=np.int64)
        self._pins = Pins.of(none, none, none, none)
        self._finished = False

    def update(self, frames: Frames, first: int, over: tuple[Bools, Bools] | None = None) -> None:
        """Some more frames, with numbers of targets and tracks that stay the same.

        Args:
            frames: truth and tracks.
            first: number of frames before them.
            over: of each target and of each track whether no row of it is to come; None: that is not known.
        """
        self._rows += [len(frames.truth), len(frames.track)]
        self._over = self._over if over is None else over
        self._tell_sure(meetings(frames, self._cutoff, self._p, first))
        self._solve()

    def merge(self, other: TrajectoryCosts) -> None:
        """Take in another recording, with no target and no track in common; no frame is added after it."""
        for each in (self, other):
            each._finish()
        self._rows = self._rows + other._rows
        self._cost.merge(other._cost)
        self._weight.merge(other._weight)
        self._changes.merge(other._changes)

    def _finish(self) -> None:
        """Solve what is left, once all frames were added."""
        if self._finished:
            return
        targets, tracks = self._over
        self._over, self._finished = (np.ones_like(targets), np.ones_like(tracks)), True
        self._tell_sure(_NO_PAIRS)
        self._solve()

    def result(self) -> TrajectoryGospa:
        """The metric of all frames, after which none can be added."""
        self._finish()
        half, weight = 0.5 * self._most, self._weight.value
        n, m = self._rows.tolist()
        parts = self._cost.value, half * (n - weight), half * (m - weight), 0.5 * self._switch * self._changes.value
        return TrajectoryGospa(sum(parts), *parts, self._p)

    def _tell_sure(self, new: Pairs) -> None:
        """Add up the rows that are sure, and sort the others into those that may become so and those that will not."""
        rows = Pairs._make(np.concatenate(column) for column in zip(self._runs, self._later, new, strict=True))
        order = np.lexsort((rows.time, rows.track, rows.truth))
        known = np.append(self._sure, np.full(len(order) - len(self._sure), -1))[order]
        rows, told = rows.take(order), known >= 0
        sure = sure_stretches(rows, self._most, self._switch, known)
        # A stretch that begins with a row that was told before goes on with the pin of the pair that is the last one
        goes_on = told[sure.first]
        found = sure.pins(rows)
        pins = self._pins
        by_pair: dict[tuple[int, int], int] = {}
        if goes_on.any():
            for n in np.argsort(pins.first, kind="stable").tolist():
                by_pair[int(pins.truth[n]), int(pins.track[n])] = n
        for k in np.flatnonzero(goes_on).tolist():
            pins.last[by_pair[int(found.truth[k]), int(found.track[k])]] = found.last[k]
        self._pins = Pins._make(np.concatenate([a, b[~goes_on]]) for a, b in zip(pins, found, strict=True))
        certain = sure.rows & ~told
        self._cost.add(float(rows.cost[certain].sum()))
        self._weight.add(float(np.count_nonzero(certain)))
        # A run goes on where its last row is the last one of both, who meet nobody else in it and have rows to come
        latest = sure.alone & ~self._over[0][rows.truth] & ~self._over[1][rows.track]
        for key in (rows.truth, rows.track):
            last = np.full(int(key.max(initial=-1)) + 1, -1, dtype=np.int64)
            np.maximum.at(last, key, rows.time)
            latest &= rows.time == last[key]
        run = np.cumsum(sure.begins) - 1
        may = np.isin(run, run[latest])
        later = may & ~sure.rows & ~told & (sure.gained >= enough_gain(self._switch))
        self._later = rows.take(later)
        self._loose = self._loose.joined(rows.take(~sure.rows & ~told & ~later))
        # Of each run that may go on the last row that is told, which stands for all before it
        keep = may & ~later
        keep[:-1] &= ~(keep[1:] & (run[1:] == run[:-1])) if len(keep) else True
        kept = rows.take(keep)
        self._runs, self._sure = kept._replace(cost=self._most - sure.gained[keep]), sure.rows[keep].astype(np.int64)

    def _solve(self) -> None:
        """Solve what nothing that comes later has a part in, and forget it."""
        pieces = pieces_of(self._loose, self._pins, self._frames, self._over)
        done = np.zeros(len(pieces.final), dtype=np.bool_)
        done[(pieces.kind != FREE) & pieces.final] = True
        self._changes.add(float(np.count_nonzero((pieces.kind == CHANGE) & pieces.final)))
        weights = np.ones(len(self._loose.time))
        free = np.flatnonzero(pieces.kind == FREE)
        for block in pieces.take(free).blocks():
            part = pieces.take(free[block])
            if not part.final.all():
                continue
            done[free[block]] = True
            if len(block) > 1 or 0 in (part.before[0], part.behind[0]):  # else they belong together all the time
                self._changes.add(solve(self._loose, part, self._most, self._switch, weights))
        gone = np.zeros(len(weights) + 1, dtype=np.int64)
        np.add.at(gone, pieces.first[done], 1)
        np.add.at(gone, pieces.last[done], -1)
        solved = np.cumsum(gone)[:-1] > 0
        self._cost.add(float(weights[solved] @ self._loose.cost[solved]))
        self._weight.add(float(weights[solved].sum()))
        self._loose = self._loose.take(~solved)
        self._forget(pieces, done)

    def _forget(self, pieces: Pieces, done: Bools) -> None:
        """Let go of pins about which everything is done, and which end no piece that is not."""
        pins = self._pins
        pins.behind[pieces.pin_before[done & (pieces.pin_before >= 0)]] = True
        pins.before[pieces.pin_behind[done & (pieces.pin_behind >= 0)]] = True
        needed = ~(pins.before & pins.behind) | delimiters(pieces.take(~done), pins)
        for key, over in zip((pins.truth, pins.track), self._over, strict=True):
            for own in pins.by(key).values():
                needed[own[-1]] |= not over[key[own[-1]]]
        self._pins = Pins._make(column[needed] for column in pins)


def trajectory_gospa(frames: Frames, cutoff: float, switch: float, p: float = 2.0) -> TrajectoryGospa:
    """Compute trajectory GOSPA of all frames.

    With W_t(i, j) >= 0 the weight with which target i has track j in frame t, sums over j and over i at most 1, it is
    the minimum over W of

        sum over t of [sum over pairs of W_t(i, j) min(d, c)^p + c^p / 2 (weight of targets without a track + weight of
        tracks without a target)] + gamma^p / 2 sum over t, i, j of |W_t+1(i, j) - W_t(i, j)|.

    Pairs that never are nearer than c have no weight.  In frames in which a pair is not nearer than c its weight
    neither costs nor saves anything but the change, so that one unknown serves a whole stretch of them: the weight that
    is least anywhere in it leaves most to others and changes no more.  Pairs that share no target and no track, not
    even by way of others, are solved apart.

    Args:
        frames: truth and tracks.
        cutoff: largest distance that counts, c > 0, unit of the distance.
        switch: price of a change of track, gamma > 0, unit of the distance.
        p: exponent, >= 1.

    Raises:
        ValueError: an option is outside its range.
        RuntimeError: the linear program has no solution, which cannot be.
    """
    sums = TrajectoryCosts(len(frames.frame), len(frames.truth_key), len(frames.track_key), cutoff, switch, p)
    sums.update(frames, 0)
    return sums.result()


def meetings(frames: Frames, cutoff: float, p: float, first: int = 0) -> Pairs:
    """Rows that are nearer than the cutoff; `first` is the number of frames before these."""
    none = np.zeros(0, dtype=np.int64)
    found = [(none, none, none, np.zeros(0))]
    for t in frames.meeting():
        left, right = frames.rows(t)
        distance = frames.compare(t)[0]
        i, j = np.nonzero(distance < cutoff)
        at = np.full(len(i), first + t, dtype=np.int64)
        found.append((frames.truth[left][i], frames.track[right][j], at, distance[i, j] ** p))
    truth, track, time, cost = (np.concatenate(column) for column in zip(*found, strict=True))
    order = np.lexsort((time, track, truth))
    return Pairs(truth[order], track[order], time[order], cost[order])


_NONE = np.zeros(0, dtype=np.int64)
_NO_PAIRS = Pairs(_NONE, _NONE, _NONE, np.zeros(0))
