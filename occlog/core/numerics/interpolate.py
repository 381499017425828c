"""Interpolation of positions at other times than those sampled, with a limit on gaps.

Times are int64 nanoseconds; differences are computed as integers, so that they are exact at times since 1970 (float64
resolves about 200 ns there). Also positions of several objects on a common time grid, and at the times of sensor
frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from occlog.array_types import Bools, Floats, Ints


def interpolate_positions(t_ns: Ints, known_t_ns: Ints, known: Floats, limit_ns: int) -> tuple[Floats, Bools]:
    """Return linearly interpolated positions, with a mask of the valid ones.

    A time that is a sample is always valid. Between two samples the position is valid if they are at most `limit_ns`
    apart. There is no extrapolation.

    Args:
        t_ns: (N,) times [ns] of the positions.
        known_t_ns: (M,) times of the samples [ns], not decreasing; of equal times the last counts.
        known: (M, k) samples.
        limit_ns: widest gap between two samples that is bridged, >= 0 [ns].

    Returns:
        (N, k) positions, NaN where not valid, and (N,) whether they are valid.
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
    """Return positions (N, k) interpolated over gaps of any width, constant before the first and after the last sample.

    For quantities that need only a rough position.

    Args:
        t_ns: (N,) times [ns].
        known_t_ns: (M,) increasing times of the samples [ns], M at least 1.
        known: (M, k) the samples.
    """
    before, after, fraction, _ = _bracket(t_ns, known_t_ns)
    w = np.clip(fraction, 0.0, 1.0)[:, None]
    held: Floats = known[before] + w * (known[after] - known[before])
    return held


def _bracket(t_ns: Ints, known_t_ns: Ints) -> tuple[Ints, Ints, Floats, Ints]:
    """Return the samples before and after each time, the fraction of the way between them, and their distance [ns].

    Each is (N,); samples are given by their indices. The fraction is below 0 before the first sample; after the last
    one, both indices are the last and the fraction is the time since then in ns.

    Args:
        t_ns: (N,) times [ns].
        known_t_ns: (M,) increasing times of the samples [ns].
    """
    before = np.clip(np.searchsorted(known_t_ns, t_ns, side="right") - 1, 0, len(known_t_ns) - 1)
    after = np.minimum(before + 1, len(known_t_ns) - 1)
    gap = known_t_ns[after] - known_t_ns[before]
    # Samples more than 292 years apart: their distance has no number, and is wider than any limit
    gap = np.where(gap < 0, np.iinfo(np.int64).max, gap)
    fraction = (t_ns - known_t_ns[before]) / np.maximum(gap, 1)
    return before, after, fraction, gap


NO_LIMIT = np.iinfo(np.int64).max


class TimeGrid(NamedTuple):
    """Positions of n objects (targets and occluders) at C times, with further columns that change with time."""

    t_ns: Ints  # (C,) ascending
    ids: Ints  # (n,) ascending
    target: Bools  # (n,): a target, not an occluder
    xyz: Floats  # (C, n, k) x, y, z and whatever else changes with time; NaN where an object is absent


class SensorFrames(NamedTuple):
    """T frames of one sensor within a chunk of time: times, number of the first, and the objects' positions."""

    t_ns: Ints  # (T,)
    first: int  # number of the first of these frames in the sensor's stream
    xyz: Floats  # (T, n, k) the same at these times


def to_grid(t_ns: Ints, ids: NDArray[np.integer], target: Bools, xyz: Floats) -> TimeGrid:
    """Return R rows as a grid of distinct times and objects, both sorted; NaN where an object has no row.

    Of two rows for the same time and object the last is used.

    Args:
        t_ns: (R,) times [ns].
        ids: (R,) numbers of the objects.
        target: (R,) whether the object is a target.
        xyz: (R, 3) positions.
    """
    times, row = np.unique(t_ns, return_inverse=True)
    names, column = np.unique(ids, return_inverse=True)
    positions = np.full((len(times), len(names), 3), np.nan)
    positions[row, column] = xyz
    is_target = np.zeros(len(names), dtype=np.bool_)
    is_target[column[target]] = True
    return TimeGrid(times, names.astype(np.int64), is_target, positions)


def frame_times(start_ns: int, after_ns: int, last_ns: int, rate_hz: float) -> tuple[Ints, int]:
    """Return the frame times [ns] of a sensor in (`after_ns`, `last_ns`], and the number of the first of them.

    The number is 0 if there are none. Frame k, from 0, is at `start_ns` + round(k 1e9 / rate_hz).
    """
    period = 1e9 / rate_hz
    first = max(0, int((after_ns - start_ns) / period) - 1)
    numbers = np.arange(first, max(first, int((last_ns - start_ns) / period) + 2))
    times = start_ns + np.rint(numbers * period).astype(np.int64)
    inside = (times > after_ns) & (times <= last_ns)
    return times[inside], first + int(np.argmax(inside)) if inside.any() else 0


def frames_at(
    chunks: Iterable[TimeGrid], rates_hz: Sequence[float | None]
) -> Iterator[tuple[TimeGrid, list[SensorFrames]]]:
    """Generate each chunk of positions with the frames of every sensor.

    Positions between two times are interpolated linearly, also across the border of two chunks. Chunks without times
    are omitted. The first frame of a sensor is at the first time of the first chunk.

    Args:
        chunks: grids in the order of time.
        rates_hz: frames per second of each sensor; None: a frame at every time of the chunk.
    """
    last: TimeGrid | None = None
    start_ns, done = 0, 0
    for chunk in chunks:
        if not len(chunk.t_ns):
            continue
        if last is None:
            start_ns = int(chunk.t_ns[0])
        after_ns = start_ns - 1 if last is None else int(last.t_ns[-1])
        joined = chunk if last is None else _joined(last, chunk)
        found = []
        for rate in rates_hz:
            if rate is None:
                found.append(SensorFrames(chunk.t_ns, done, chunk.xyz))
            else:
                times, first = frame_times(start_ns, after_ns, int(chunk.t_ns[-1]), rate)
                found.append(SensorFrames(times, first, _places(joined, times)))
        yield chunk, found
        done += len(chunk.t_ns)
        last = chunk._replace(t_ns=chunk.t_ns[-1:], xyz=chunk.xyz[-1:])


def _joined(last: TimeGrid, chunk: TimeGrid) -> TimeGrid:
    """Return a chunk with the last row of the previous chunk in front; NaN for objects that are only in `chunk`."""
    before = np.full((1, *chunk.xyz.shape[1:]), np.nan)
    common, old, new = np.intersect1d(last.ids, chunk.ids, return_indices=True)
    if len(common):
        before[0, new] = last.xyz[-1, old]
    return chunk._replace(
        t_ns=np.concatenate([last.t_ns[-1:], chunk.t_ns]), xyz=np.concatenate([before, chunk.xyz], axis=0)
    )


def _places(grid: TimeGrid, times: Ints) -> Floats:
    """Return positions (T, n, k) of the objects of a grid at `times` (T,) [ns], interpolated over gaps of any width.

    NaN where an object is absent at a neighbouring time of the grid.
    """
    n, k = grid.xyz.shape[1:]
    flat = grid.xyz.reshape(len(grid.t_ns), n * k)
    positions, _ = interpolate_positions(times, grid.t_ns, flat, int(NO_LIMIT))
    return positions.reshape(len(times), n, k)
