"""Figures of more numbers than memory holds: sums that lose nothing to rounding, and exact quantiles in passes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from occlog.array_types import Floats, Ints

DIGIT = 16
"""Bits of a number that one pass of `quantiles` looks at."""


class Sum:
    """A sum of parts with the rounding of each addition kept beside it (Neumaier 1974), so that parts may be any."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._total = self._lost = 0.0

    def add(self, value: float) -> None:
        """One more part."""
        total = self._total + value
        large, small = (self._total, value) if abs(self._total) >= abs(value) else (value, self._total)
        self._lost += (large - total) + small
        self._total = total

    def merge(self, other: Sum) -> None:
        """Add the parts of another sum."""
        self.add(other._total)
        self.add(other._lost)

    @property
    def value(self) -> float:
        """The sum."""
        return self._total + self._lost


def quantiles(blocks: Callable[[], Iterable[Floats]], count: int, shares: Sequence[float]) -> list[float]:
    """Quantiles as `np.quantile` has them, linearly interpolated, of numbers that come in blocks.

    The numbers of the places that are asked for are found bit by bit, `DIGIT` bits in each of four passes.

    Args:
        blocks: gives the same finite numbers each time, in blocks of any size.
        count: how many there are, > 0.
        shares: 0 to 1.
    """
    places = [share * (count - 1) for share in shares]
    wanted = sorted({min(int(place) + more, count - 1) for place in places for more in (0, 1)})
    found = dict(zip(wanted, _ranked(blocks, np.array(wanted, dtype=np.int64)).tolist(), strict=True))
    out = []
    for place in places:
        low, high = found[int(place)], found[min(int(place) + 1, count - 1)]
        part, apart = place - int(place), high - low
        # Rounded as NumPy rounds it: from the nearer end
        out.append(low + apart * part if part < 0.5 else high - apart * (1.0 - part))
    return out


def _ranked(blocks: Callable[[], Iterable[Floats]], ranks: Ints) -> Floats:
    """(R,) the numbers of these places in rising order."""
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
    """(G,) median of the numbers of each group, as `np.median` has it, of numbers that come in blocks; NaN without any.

    Numbers are found 8 bits in each of eight passes (of very many groups 4 in sixteen), as in `quantiles`, for all
    groups at once.

    Args:
        blocks: gives groups, 0 to G - 1, and finite numbers, (n,) each, the same every time.
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
            place = (group << digit_bits) + digit.astype(np.int64)
            for which in (0, 1):
                mine = above == prefix[group, which]
                np.add.at(found[which], place[mine], 1)
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
    """Whole numbers in the order of the values."""
    bits = (np.ascontiguousarray(values) + 0.0).view(np.uint64)
    return np.where(bits & SIGN, ~bits, bits | SIGN)


def _numbers(keys: np.ndarray) -> Floats:
    """The values of whole numbers that `_rising` made."""
    return np.where(keys & SIGN, keys & ~SIGN, ~keys).view(np.float64)
