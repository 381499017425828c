"""Online estimation of the cameras' clock offsets, from the residuals of boxes along the velocities of people.

A camera that is late by d shows people where they were: its residuals are -d v, with v the velocity in the image.
Tracks follow all cameras together, so that only differences are observable: the median over cameras is set to 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import Floats

from .normal_equations import Batches, solve_batches

MIN_OFFSET_S = 0.03
"""Significant offsets of at least this size are corrected."""


@dataclass(frozen=True)
class ClockStatistics:
    """Normal equations of the clock offsets of C cameras in batches of time, and the resulting offsets."""

    batches: Batches  # sums of `clock_residuals`
    sums: Floats  # (C, 5) counts, residuals and velocities
    late: Floats  # (C,) corrected offsets [s], positive: the frames show what was earlier; 0: none
    limit: Floats  # (C,) least significant offsets [s]; inf: not estimated

    @property
    def centre(self) -> Floats:
        """(C, 4) mean residuals and mean velocities, which are subtracted."""
        return np.asarray(self.sums[:, 1:] / np.maximum(self.sums[:, :1], 1.0))


def prior_clocks(cameras: int) -> ClockStatistics:
    """Create the statistics of C cameras without data."""
    return ClockStatistics(Batches.of(cameras), np.zeros((cameras, 5)), np.zeros(cameras), np.full(cameras, np.inf))


def update_clocks(known: ClockStatistics, t_ns: int, normal: Floats, sums: Floats) -> ClockStatistics:
    """Return the statistics with a time step added; offsets are updated when a batch is complete.

    `normal` (C, C + 1) and `sums` (C, 5) are from `clock_residuals`, for the time step at `t_ns`.
    """
    batches = known.batches.add(t_ns, normal)
    known = replace(known, sums=known.sums + sums, batches=batches)
    if batches.since_ns != t_ns or not len(batches.kept):
        return known
    late, limit = clock_offsets(batches.kept)
    return replace(known, late=late, limit=limit)


def clock_offsets(batches: Floats) -> tuple[Floats, Floats]:
    """Clock offsets (C,) [s], 0 if not significant, and the significance limits (C,) [s].

    Args:
        batches: (B, C, C + 1) normal equations, in the order of time.
    """
    slope, limit = solve_batches(batches)
    there = np.isfinite(limit)
    if there.sum() < 2:
        return np.zeros(len(slope)), limit
    late = np.where(there, slope - np.median(slope[there]), 0.0)
    return np.where(np.abs(late) >= np.maximum(MIN_OFFSET_S, limit), late, 0.0), limit
