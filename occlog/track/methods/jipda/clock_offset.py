"""Online estimate of the offsets of the cameras' clocks, from the residuals of boxes against the people's velocities.

A camera that is late by d shows people where they were: its residuals are -d v, v the velocity in the image.  The
tracks follow all cameras together, so that only differences are known: the median of the cameras is taken as right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from occlog.array_types import NS, Floats

BATCH_S = 1.0
"""Duration of a batch [s]: residuals are correlated in time, and standard errors come from batches."""
MAX_BATCHES = 60
"""Number of batches that count, the last ones: clocks drift."""
MIN_BATCHES = 8
"""Minimum number of batches of a camera for an estimate."""
MIN_OFFSET_S, MIN_SIGNIFICANCE = 0.03, 5.0
"""Offsets of at least this size and this number of standard errors are corrected."""


@dataclass(frozen=True)
class ClockStatistics:
    """Normal equations of C cameras in batches of time, and the offsets that follow."""

    batches: Floats  # (B, C, C + 1) sums of `clock_residuals`
    open: Floats  # (C, C + 1) of the batch that is not complete
    since_ns: int  # its begin; -1: none
    sums: Floats  # (C, 5) counts, residuals and velocities
    late: Floats  # (C,) corrected offsets [s], positive: the frames show what was earlier; 0: none
    error: Floats  # (C,) standard errors [s]; inf: not estimated

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
    late, error = clock_offsets(batches)
    return replace(known, batches=batches, open=np.zeros_like(normal), since_ns=t_ns, late=late, error=error)


def clock_offsets(batches: Floats) -> tuple[Floats, Floats]:
    """Return the offsets (C,) of the clocks that are significant, else 0, and their standard errors (C,).

    Args:
        batches: (B, C, C + 1) normal equations, in the order of time.
    """
    N, b = batches[..., :-1], batches[..., -1]
    C = b.shape[1]
    there = (np.einsum("bcc->bc", N) > 0.0).sum(axis=0) >= MIN_BATCHES
    late, error = np.zeros(C), np.full(C, np.inf)
    if there.sum() < 2:
        return late, error
    N, b = N[:, there][:, :, there], b[:, there]
    inverse = np.linalg.pinv(N.sum(axis=0), hermitian=True)
    d = inverse @ b.sum(axis=0)
    # Errors are correlated within a batch, and between neighbours
    off = b - N @ d
    scatter = off.T @ off
    lagged = off[1:].T @ off[:-1]
    covariance = inverse @ (scatter + np.maximum(np.diag(np.diag(lagged + lagged.T)), 0.0)) @ inverse
    late[there] = d - np.median(d)
    error[there] = np.sqrt(np.diag(covariance))
    significant = np.abs(late) >= np.maximum(MIN_OFFSET_S, MIN_SIGNIFICANCE * error)
    return np.where(significant, late, 0.0), error
