"""Positions at other times than those at which they were sampled, with a stated limit.

Times are int64 nanoseconds.  Differences are taken as integers, so that they stay
exact at times since 1970 (a float64 resolves only about 200 ns there).
"""

from __future__ import annotations

import numpy as np

from occlog.array_types import Bools, Floats, Ints


def interpolate_positions(t_ns: Ints, known_t_ns: Ints, known: Floats, limit_ns: int) -> tuple[Floats, Bools]:
    """Interpolate positions linearly, and tell where they may be used.

    A time that is itself a sample is always good.  Between two samples the position is
    good when the samples are at most `limit_ns` apart.  Nothing is extrapolated.

    Args:
        t_ns: (N,) times asked for.
        known_t_ns: (M,) times of the samples, not falling; of equal times the last counts.
        known: (M, k) samples.
        limit_ns: widest gap between two samples that is bridged, >= 0 [ns].

    Returns:
        (N, k) positions, NaN where not good, and (N,) whether they are good.
    """
    out = np.full((len(t_ns), known.shape[1]), np.nan)
    if not len(known_t_ns) or not len(t_ns):
        return out, np.zeros(len(t_ns), dtype=np.bool_)
    before, after, fraction, gap = _bracket(t_ns, known_t_ns)
    inside = (t_ns >= known_t_ns[0]) & (t_ns <= known_t_ns[-1])
    good = inside & ((gap <= limit_ns) | (fraction == 0.0))
    b, a, w = before[good], after[good], fraction[good][:, None]
    out[good] = known[b] + w * (known[a] - known[b])
    return out, good


def hold_positions(t_ns: Ints, known_t_ns: Ints, known: Floats) -> Floats:
    """(N, k) positions interpolated over gaps of any width, held before the first and after the last sample.

    For quantities that only need a rough position; M must be at least 1.
    """
    before, after, fraction, _ = _bracket(t_ns, known_t_ns)
    w = np.clip(fraction, 0.0, 1.0)[:, None]
    held: Floats = known[before] + w * (known[after] - known[before])
    return held


def _bracket(t_ns: Ints, known_t_ns: Ints) -> tuple[Ints, Ints, Floats, Ints]:
    """Indices of the samples before and after, fraction of the way between them, and their distance [ns]."""
    before = np.clip(np.searchsorted(known_t_ns, t_ns, side="right") - 1, 0, len(known_t_ns) - 1)
    after = np.minimum(before + 1, len(known_t_ns) - 1)
    gap = known_t_ns[after] - known_t_ns[before]
    # Samples more than 292 years apart: their distance has no number, and is wider than any limit
    gap = np.where(gap < 0, np.iinfo(np.int64).max, gap)
    fraction = (t_ns - known_t_ns[before]) / np.maximum(gap, 1)
    return before, after, fraction, gap
