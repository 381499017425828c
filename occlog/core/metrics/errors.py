"""Metrics from errors, and one-to-one pairings.

Metrics over several tracks are computed from sums and counts (`ErrorSums`), never from means of the tracks' metrics, so
that a short track does not weigh as much as a long one. For data larger than memory: compensated sums, and exact
quantiles in passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from occlog.array_types import Floats, Ints
from occlog.core.numerics.assignment import maximum_weight_matching

CHI2_95_2D = -2.0 * math.log(0.05)
"""95 % quantile of chi-square with 2 degrees of freedom (5.991)."""

CHI2_95_3D = 7.814727903251179
"""95 % quantile of chi-square with 3 degrees of freedom."""


class ErrorSums(NamedTuple):
    """Number of position errors in the plane, and their sums of squares along x and y, from which RMSEs follow."""

    n: int
    square_x: float
    square_y: float

    @property
    def rmse(self) -> float:
        """Return the root mean squared distance ([Ercan] Sec. 6), in the unit of the errors; NaN without errors."""
        return self._root(self.square_x + self.square_y)

    @property
    def rmse_x(self) -> float:
        """Return the root mean squared error along x; NaN without errors."""
        return self._root(self.square_x)

    @property
    def rmse_y(self) -> float:
        """Return the root mean squared error along y; NaN without errors."""
        return self._root(self.square_y)

    def _root(self, total: float) -> float:
        """Return sqrt(total / number of errors); NaN without errors."""
        return math.sqrt(total / self.n) if self.n else math.nan


def error_sums(errors: Floats) -> ErrorSums:
    """Return number and sums of squares along x and y of position errors (N, 2)."""
    x, y = np.sum(errors**2, axis=0) if len(errors) else (0.0, 0.0)
    return ErrorSums(len(errors), float(x), float(y))


def add_sums(parts: Iterable[ErrorSums]) -> ErrorSums:
    """Return the total of several `ErrorSums`: numbers and sums of squares are added."""
    rows = list(parts)
    return ErrorSums(sum(p.n for p in rows), math.fsum(p.square_x for p in rows), math.fsum(p.square_y for p in rows))


def normalised_squared_errors(errors: Floats, covariances: Floats) -> Floats:
    """Return the NEES e^T P^-1 e of each error in the plane.

    It has a chi-square distribution with 2 degrees of freedom for a consistent filter.

    Args:
        errors: (N, 2) position errors e.
        covariances: (N, 2, 2) covariances P, positive semi-definite.

    Returns:
        (N,), NaN where P is singular to rounding.
    """
    pxx, pxy, pyy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    det = pxx * pyy - pxy**2
    regular = det > 1e-12 * pxx * pyy
    ex, ey = errors[:, 0], errors[:, 1]
    form = pyy * ex**2 - 2.0 * pxy * ex * ey + pxx * ey**2
    return np.asarray(np.where(regular, form / np.where(regular, det, 1.0), np.nan))


def normalised_squared_errors_in_space(errors: Floats, covariances: Floats) -> Floats:
    """Return the NEES e^T P^-1 e of each error in space.

    It has a chi-square distribution with 3 degrees of freedom for a consistent filter.

    Args:
        errors: (N, 3) position errors e, NaN where unknown.
        covariances: (N, 3, 3) covariances P, positive semi-definite, NaN where unknown.

    Returns:
        (N,), NaN where a value is unknown and where P is singular to rounding.
    """
    scale = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    known = np.isfinite(errors).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2)) & (scale > 0).all(axis=1)
    rows = np.flatnonzero(known)
    s = scale[rows]
    correlation = covariances[rows] / (s[:, :, None] * s[:, None, :])
    regular = np.linalg.det(correlation) > 1e-12
    e = (errors[rows] / s)[regular][:, :, None]
    out = np.full(len(errors), np.nan)
    out[rows[regular]] = np.sum(e * np.linalg.solve(correlation[regular], e), axis=(1, 2))
    return out


def quantile(values: Floats, q: float) -> float:
    """Return the quantile `q` (0 to 1) of finite values (n,), linearly interpolated; NaN without values."""
    return float(np.quantile(values, q)) if len(values) else math.nan


def ratio_or_nan(part: float, whole: float) -> float:
    """Return the ratio of part to whole; NaN if the whole is 0 or either is NaN."""
    return part / whole if whole else math.nan


def pair_within(cost: Floats, limit: float) -> list[tuple[int, int]]:
    """Return one-to-one pairs (row, column) that cost at most `limit`: as many as possible, then of least total cost.

    Args:
        cost: (n, m) non-negative; infinite or NaN where a pair is impossible.
        limit: largest cost of a pair.
    """
    allowed = cost <= limit
    if not allowed.any():
        return []
    # One more pair is worth more than any saving among the others.
    scale = min(cost.shape) * max(float(cost[allowed].max()), 1e-300) * 2.0
    rows, columns = linear_sum_assignment(np.where(allowed, cost, scale))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if allowed[i, j]]


def pair_tracks(squared_errors: Sequence[Sequence[Floats]]) -> list[tuple[int, int]]:
    """Return pairs (track, target), of indices, that give the smallest overall RMSE; by track.

    So that uncovered times are not rewarded, each covered time has the value c^2 - e^2, with c^2 twice the largest
    squared error, and the total value is maximised. If all tracks cover the same times this is the assignment with the
    least RMSE. Pairs share at least one time.

    Args:
        squared_errors: `[i][j]` squared errors of track i against target j at the times they share.
    """
    worst = max((float(e.max()) for row in squared_errors for e in row if len(e)), default=0.0)
    cells = [(i, j, e) for i, row in enumerate(squared_errors) for j, e in enumerate(row)]
    track, target = np.array([(i, j) for i, j, _ in cells], dtype=np.int64).reshape(-1, 2).T
    shared, squares = np.array([(len(e), float(e.sum())) for *_, e in cells]).reshape(-1, 2).T
    made = pair_by_sums(track, target, shared, squares, worst)
    return list(zip(track[made].tolist(), target[made].tolist(), strict=True))


def pair_by_sums(tracks: Ints, targets: Ints, shared: Floats, squares: Floats, worst: float) -> Ints:
    """Return indices of the pairs of tracks and targets that `pair_tracks` selects, given sums of squared errors.

    Args:
        tracks: (n,) number of the track of each possible pair.
        targets: (n,) number of its target; no pair occurs twice.
        shared: (n,) number of times that both share.
        squares: (n,) sum of squared errors at these times.
        worst: largest squared error of all possible pairs.
    """
    return maximum_weight_matching(tracks, targets, shared * (2.0 * worst + 1e-300) - squares)


def intersection_areas(a: Floats, b: Floats) -> Floats:
    """Return the (n, m) intersection areas of boxes a (n, 4) and b (m, 4): left, top, width, height."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, :2] + a[:, None, 2:], b[None, :, :2] + b[None, :, 2:])
    return np.asarray(np.prod(np.clip(high - low, 0.0, None), axis=2))


def intersection_over_union(a: Floats, b: Floats) -> Floats:
    """Return the (n, m) intersection over union of boxes a (n, 4) and b (m, 4): left, top, width, height."""
    shared = intersection_areas(a, b)
    union = np.prod(a[:, 2:], axis=1)[:, None] + np.prod(b[:, 2:], axis=1)[None, :] - shared
    return np.asarray(shared / union)


DIGIT = 16
"""Bits of a number that one pass of `quantiles` reads."""


class Sum:
    """Compensated sum (Neumaier 1974), nearly independent of the order of the parts."""

    def __init__(self) -> None:
        """Start at 0."""
        self._total = self._lost = 0.0

    def add(self, value: float) -> None:
        """Add a value, with the rounding error kept (Neumaier's compensated summation)."""
        total = self._total + value
        large, small = (self._total, value) if abs(self._total) >= abs(value) else (value, self._total)
        self._lost += (large - total) + small
        self._total = total

    def merge(self, other: Sum) -> None:
        """Add the total of another sum."""
        self.add(other._total)
        self.add(other._lost)

    @property
    def value(self) -> float:
        """Return the total of all values added, accurate beyond the rounding of each step."""
        return self._total + self._lost


def quantiles(blocks: Callable[[], Iterable[Floats]], count: int, shares: Sequence[float]) -> list[float]:
    """Return the quantiles of numbers that are generated in blocks, by `np.quantile`'s linear interpolation.

    The order statistics are found bit by bit, `DIGIT` bits in each of four passes over the numbers.

    Args:
        blocks: returns the finite numbers in blocks of any size; each call returns the same ones.
        count: total number of values, > 0.
        shares: quantile levels, 0 to 1.
    """
    positions = [share * (count - 1) for share in shares]
    wanted = sorted({min(int(position) + more, count - 1) for position in positions for more in (0, 1)})
    found = dict(zip(wanted, _ranked(blocks, np.array(wanted, dtype=np.int64)).tolist(), strict=True))
    out = []
    for position in positions:
        low, high = found[int(position)], found[min(int(position) + 1, count - 1)]
        part, difference = position - int(position), high - low
        # Rounded as NumPy rounds it: from the nearer end
        out.append(low + difference * part if part < 0.5 else high - difference * (1.0 - part))
    return out


def _ranked(blocks: Callable[[], Iterable[Floats]], ranks: Ints) -> Floats:
    """Return the (R,) order statistics with the ranks (R,), counted from 0, of the values in all blocks.

    `blocks` is called several times, and returns all values each time.
    """
    prefix, left = np.zeros(len(ranks), dtype=np.uint64), ranks.copy()
    for shift in range(64 - DIGIT, -1, -DIGIT):
        different, which = np.unique(prefix, return_inverse=True)
        counts = np.zeros((len(different), 1 << DIGIT), dtype=np.int64)
        for block in blocks():
            keys = _rising(block)
            digit = (keys >> np.uint64(shift)) & np.uint64((1 << DIGIT) - 1)
            above = keys >> np.uint64(shift + DIGIT) if shift + DIGIT < 64 else np.zeros_like(keys)
            for row, value in enumerate(different):
                counts[row] += np.bincount(digit[above == value].astype(np.int64), minlength=1 << DIGIT)
        below = np.cumsum(counts, axis=1)
        for n, row in enumerate(which.reshape(-1).tolist()):
            at = int(np.searchsorted(below[row], left[n], side="right"))
            left[n] -= below[row, at - 1] if at else 0
            prefix[n] = (prefix[n] << np.uint64(DIGIT)) | np.uint64(at)
    return _numbers(prefix)


MANY_GROUPS = 1 << 14


def group_medians(blocks: Callable[[], Iterable[tuple[Ints, Floats]]], counts: Ints) -> Floats:
    """Return the (G,) median of each group of numbers that are generated in blocks; NaN for a group without numbers.

    All groups are processed at once, 8 bits in each of eight passes (4 in sixteen for very many groups). The result is
    that of `np.median`.

    Args:
        blocks: returns blocks of group numbers (n,), 0 to G - 1, and finite numbers (n,); each call returns the same
            ones.
        counts: (G,) how many numbers each group has.
    """
    groups = len(counts)
    digit_bits = 8 if groups <= MANY_GROUPS else 4
    known = counts > 0
    left = np.stack([np.maximum(counts - 1, 0) // 2, counts // 2], axis=1)
    prefix = np.zeros((groups, 2), dtype=np.uint64)
    for shift in range(64 - digit_bits, -1, -digit_bits):
        found = np.zeros((2, groups << digit_bits), dtype=np.int64)
        for group, values in blocks():
            keys = _rising(values)
            digit = (keys >> np.uint64(shift)) & np.uint64((1 << digit_bits) - 1)
            above = keys >> np.uint64(shift + digit_bits) if shift + digit_bits < 64 else np.zeros_like(keys)
            index = (group << digit_bits) + digit.astype(np.int64)
            for which in (0, 1):
                mine = above == prefix[group, which]
                np.add.at(found[which], index[mine], 1)
        for which in (0, 1):
            below = np.cumsum(found[which].reshape(groups, 1 << digit_bits), axis=1)
            at = np.minimum((below <= left[:, which][:, None]).sum(axis=1), (1 << digit_bits) - 1)
            left[:, which] -= np.where(at > 0, below[np.arange(groups), np.maximum(at - 1, 0)], 0)
            prefix[:, which] = (prefix[:, which] << np.uint64(digit_bits)) | at.astype(np.uint64)
    low, high = _numbers(prefix[:, 0]), _numbers(prefix[:, 1])
    # NumPy takes the mean of the two in the middle
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, np.where(counts % 2 == 1, low, 0.5 * (low + high)), np.nan))


SIGN = np.uint64(1 << 63)


def _rising(values: Floats) -> np.ndarray:
    """Return unsigned integers (n,) with the order of the floats (n,), for radix selection."""
    bits = (np.ascontiguousarray(values) + 0.0).view(np.uint64)
    return np.where(bits & SIGN, ~bits, bits | SIGN)


def _numbers(keys: np.ndarray) -> Floats:
    """Return the floats (n,) of the unsigned integers (n,) that `_rising` made of them."""
    return np.where(keys & SIGN, keys & ~SIGN, ~keys).view(np.float64)
