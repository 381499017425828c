"""Online estimate of the offsets of the cameras' clocks, from the residuals of boxes against the people's velocities.

A camera that is late by d shows people where they were: its residuals are -d v, v the velocity in the image.  The
tracks follow all cameras together, so that only differences are known: the median of the cameras is taken as right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Floats

from .normal_equations import BATCH_S, MAX_BATCHES, solve_batches

MIN_OFFSET_S = 0.03
"""Significant offsets of at least this size are corrected."""


@dataclass(frozen=True)
class ClockStatistics:
    """Normal equations of C cameras in batches of time, and the offsets that follow."""

    batches: Floats  # (B, C, C + 1) sums of `clock_residuals`
    open: Floats  # (C, C + 1) of the batch that is not complete
    since_ns: int  # its begin; -1: none
    sums: Floats  # (C, 5) counts, residuals and velocities
    late: Floats  # (C,) corrected offsets [s], positive: the frames show what was earlier; 0: none
    limit: Floats  # (C,) least significant offsets [s]; inf: not estimated

    @property
    def centre(self) -> Floats:
        """(C, 4) mean residuals and velocities."""
        return np.asarray(self.sums[:, 1:] / np.maximum(self.sums[:, :1], 1.0))


def prior_clocks(cameras: int) -> ClockStatistics:
    """Create the statistics of C cameras without data."""
    none = np.zeros((cameras, cameras + 1))
    return ClockStatistics(
        none[None][:0], none, -1, np.zeros((cameras, 5)), np.zeros(cameras), np.full(cameras, np.inf)
    )


def update_clocks(known: ClockStatistics, t_ns: int, normal: Floats, sums: Floats) -> ClockStatistics:
    """Update the statistics with a time step (`clock_residuals`); offsets follow when a batch is complete."""
    since = t_ns if known.since_ns < 0 else known.since_ns
    known = replace(known, open=known.open + normal, sums=known.sums + sums, since_ns=since)
    if t_ns - since < BATCH_S * NS:
        return known
    batches = np.concatenate([known.batches, known.open[None]])[-MAX_BATCHES:]
    late, limit = clock_offsets(batches)
    return replace(known, batches=batches, open=np.zeros_like(normal), since_ns=t_ns, late=late, limit=limit)


def clock_offsets(batches: Floats) -> tuple[Floats, Floats]:
    """Return the offsets (C,) of the clocks that are significant, else 0, and the limits (C,) of significance.

    Args:
        batches: (B, C, C + 1) normal equations, in the order of time.
    """
    slope, limit = solve_batches(batches)
    there = np.isfinite(limit)
    if there.sum() < 2:
        return np.zeros(len(slope)), limit
    late = np.where(there, slope - np.median(slope[there]), 0.0)
    return np.where(np.abs(late) >= np.maximum(MIN_OFFSET_S, limit), late, 0.0), limit
