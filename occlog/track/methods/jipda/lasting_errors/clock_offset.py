"""Online estimation of the cameras' clock offsets and drifts, from residuals of boxes along the velocities of people.

A camera that is late by d shows people where they were: its residuals are -d v, with v the velocity in the image.
Tracks follow all cameras together, so that only differences are observable: the median over cameras is set to 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Floats

from .normal_equations import MAX_BATCHES, MIN_BATCHES, Batches, solve_batches

MIN_OFFSET_S = 0.03
"""Significant offsets of at least this size are corrected, and drifts by as much in the recording are stated."""
MIN_DRIFT_S = 20.0
"""Least duration of a recording [s] of which drifts are estimated."""


@dataclass(frozen=True)
class ClockStatistics:
    """Normal equations of the clock offsets of C cameras in batches of time, and the resulting offsets.

    `batches` are the recent sums, `sums` (C, 5) the count, residuals and velocities of all boxes; `late` (C,) the
    offsets [s] that are corrected (positive: frames show what was earlier; 0: none) and `limit` (C,) the least
    significant ones (infinite: not estimated). `history` (B, C, C + 1) and `history_s` (B,) are coarser sums over the
    whole recording and their times [s], each of `merged` batches, of which the last one has `waiting`.
    """

    batches: Batches  # sums of `clock_residuals`
    sums: Floats  # (C, 5) counts, residuals and velocities
    late: Floats  # (C,) corrected offsets [s], positive: the frames show what was earlier; 0: none
    limit: Floats  # (C,) least significant offsets [s]; inf: not estimated
    history: Floats  # (B, C, C + 1) of the whole recording, each the sum of as many batches
    history_s: Floats  # (B,) their mean times [s]
    merged: int = 1  # batches in each sum
    waiting: int = 0  # batches in the last sum

    @property
    def centre(self) -> Floats:
        """Mean residuals (u, v) [box heights] and mean velocities (u, v) [box heights/s] of each camera, (C, 4)."""
        return np.asarray(self.sums[:, 1:] / np.maximum(self.sums[:, :1], 1.0))


def prior_clocks(cameras: int) -> ClockStatistics:
    """Return the clock statistics of C = `cameras` cameras without data: no corrections, infinite limits."""
    batches = Batches.of(cameras)
    return ClockStatistics(
        batches, np.zeros((cameras, 5)), np.zeros(cameras), np.full(cameras, np.inf), batches.kept, np.zeros(0)
    )


def update_clocks(known: ClockStatistics, t_ns: int, normal: Floats, sums: Floats) -> ClockStatistics:
    """Return the clock statistics with a time step added; offsets are solved again when a batch is complete.

    Args:
        known: statistics before; not changed.
        t_ns: time of the time step.
        normal: (C, C + 1) normal equations of the offsets from this time step, by `clock_residuals`.
        sums: (C, 5) number of boxes, sums of residuals and of velocities, by `clock_residuals`.
    """
    batches = known.batches.add(t_ns, normal)
    known = replace(known, sums=known.sums + sums, batches=batches)
    if batches.since_ns != t_ns or not len(batches.kept):
        return known
    late, limit = clock_offsets(batches.kept)
    return replace(_with_history(known, batches.kept[-1], t_ns / NS), late=late, limit=limit)


def _with_history(known: ClockStatistics, batch: Floats, t_s: float) -> ClockStatistics:
    """Return the statistics with a batch (C, C + 1), complete at `t_s` [s], added to the history of the recording.

    The last sum is filled until it has as many batches as the others; at `MAX_BATCHES` sums, neighbours are merged in
    pairs.
    """
    history, times, merged, waiting = known.history, known.history_s, known.merged, known.waiting
    if len(history) and waiting < merged:
        history, times = history.copy(), times.copy()
        history[-1] += batch
        times[-1] += (t_s - times[-1]) / (waiting + 1)
        return replace(known, history=history, history_s=times, waiting=waiting + 1)
    if len(history) == MAX_BATCHES:
        history, times, merged = history[::2] + history[1::2], 0.5 * (times[::2] + times[1::2]), 2 * merged
    history, times = np.concatenate([history, batch[None]]), np.append(times, t_s)
    return replace(known, history=history, history_s=times, merged=merged, waiting=1)


def clock_drifts(history: Floats, t_s: Floats) -> tuple[Floats, Floats]:
    """Return the drifts (C,) of the clocks [s/s], 0 if not significant, and their significance limits (C,) [s/s].

    Each clock has an offset that is linear in time. Drifts are relative to the median, or to the first of two cameras;
    errors of velocities can make them too small, by up to two fifths. Without `MIN_BATCHES` over `MIN_DRIFT_S`, or
    with fewer than two cameras, drifts are 0 and limits infinite.

    Args:
        history: (B, C, C + 1) normal equations of offsets, in the order of time.
        t_s: (B,) their times [s].
    """
    C = history.shape[1]
    none = np.zeros(C), np.full(C, np.inf)
    if len(t_s) < MIN_BATCHES or np.ptp(t_s) < MIN_DRIFT_S:
        return none
    half = 0.5 * float(np.ptp(t_s))
    x = ((t_s - t_s[0]) / half - 1.0)[:, None, None]
    N, b = history[..., :-1], history[..., -1:]
    slopes, limits = solve_batches(np.block([[N, x * N, b], [x * N, x**2 * N, x * b]]))
    drift, limit = slopes[C:], limits[C:]
    there = np.isfinite(limit)
    if there.sum() < 2:
        return none
    if there.sum() == 2:
        drift, limit = drift - drift[there][0], 2.0 * limit
    else:
        drift = drift - np.median(drift[there])
    found = there & (np.abs(drift) >= np.maximum(0.5 * MIN_OFFSET_S, limit))
    return np.where(found, drift, 0.0) / half, limit / half


def clock_offsets(batches: Floats) -> tuple[Floats, Floats]:
    """Return the clock offsets (C,) [s], relative to their median, 0 if not significant, and their limits (C,) [s].

    A limit is the least significant offset; infinite: not estimated. With fewer than two estimated cameras all are 0.

    Args:
        batches: (B, C, C + 1) normal equations N d = b as rows (N, b), in the order of time.
    """
    slope, limit = solve_batches(batches)
    there = np.isfinite(limit)
    if there.sum() < 2:
        return np.zeros(len(slope)), limit
    late = np.where(there, slope - np.median(slope[there]), 0.0)
    return np.where(np.abs(late) >= np.maximum(MIN_OFFSET_S, limit), late, 0.0), limit
