"""Whether two runs on the same recordings differ: an exact test of paired recordings, or of segments of time.

Figures such as MOTA are functions g of sums over frames.  A frame of run A and the same frame of run B stay together in
all that follows, so that what both find hard cancels.

    D = g(sum of B) - g(sum of A)
    u_t = grad g(M) . (B_t - A_t),  M half of the sum of both      what frame t adds to D, but for terms of third order

M stays where a part of A and the same part of B are exchanged, and u_t turns its sign: of runs that do not differ, all
exchanges are as probable.  That is tested exactly (`subset_means`), without an error that is estimated from few parts.

Where there are `MANY_RECORDINGS` or more, each recording is a part: what differs between recordings then counts, and a
statement is about recordings like these.  With fewer it is about these recordings alone.  Frames that follow each other
are alike, so that parts are then segments of frames, each `SEGMENT_LENGTHS` times as long as the integrated
autocorrelation time of u: segments are nearly independent (blocks as in Carlstein 1986).

Figures of identities are another matter: a target that has become another one stays that to the end, so that no two
segments of one recording are independent.  They are decided over recordings only.

The exact test of paired differences: how often as much comes out when each pair is exchanged, or not, by chance.

Of two runs that do not differ each part (a recording, a segment of time) could as well have come out the other way
round, so that the difference d_r of each part is as probable as -d_r.  Of all 2^N choices of signs the share of those
with a sum at least as large as the one that was observed is a p that keeps every level exactly, however the
differences are distributed (Fisher 1935, sec. 21; Pitman 1937).  No standard error is estimated: with the signs the
sum of squares stays, so that Student's t gives the same order.

Against a margin m it is d_r - m w_r that has either sign, with w_r the part's share.  A choice of signs that turns the
parts of a set S then has as large a sum exactly where m is at least the mean of S, sum(d_r) / sum(w_r): the means of
all subsets say all p and the confidence interval at once (the typical values of Hartigan 1969), and neither can
contradict the other.  Where there are too many subsets, some are drawn at random, and the observed one is counted with
them, so that p keeps its level, too (Phipson and Smyth 2010).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

ALL = 15
"""Most parts of which all subsets are taken."""
DRAWS = 2**ALL - 1
"""Subsets that are drawn at random of more parts."""
PER_DRAW = 512
"""Subsets of which the sums are made at a time."""
ROUNDING = 1e-9
"""Means that are this near to a margin, as a share of the largest of both, are at it."""


def subset_means(differences: Floats, weights: Floats, rng: np.random.Generator) -> Floats:
    """Return the (D,) sorted weighted means of all nonempty subsets of parts, or of random subsets of many parts.

    The mean of a subset is the sum of its differences over the sum of its weights.

    Args:
        differences: (N,) contribution of each part to a difference; N >= 1.
        weights: (N,) shares of the parts, > 0, with the sum 1.
        rng: source of random numbers, used if there are more than `ALL` parts.
    """
    count = len(differences)
    if count <= ALL:
        sums = np.zeros((2, 1))
        for each in zip(differences, weights, strict=True):
            sums = np.concatenate([sums, sums + np.array(each)[:, None]], axis=1)
        return np.sort(sums[0, 1:] / sums[1, 1:])
    parts = np.column_stack([differences, weights])
    found = []
    for first in range(0, DRAWS, PER_DRAW):
        size = min(PER_DRAW, DRAWS - first), -(-count // 8)
        taken = np.unpackbits(rng.integers(0, 256, size, dtype=np.uint8), axis=1, count=count)
        taken[~taken.any(axis=1)] = 1  # none of N > `ALL` parts: once in 2^N draws
        found.append(taken @ parts)
    sums = np.concatenate(found)
    return np.sort(sums[:, 0] / sums[:, 1])


def chance_above(means: Floats, margin: float) -> float:
    """Return the one-sided p-value of a mean difference above a margin: small if it is significantly above.

    The differences of the parts are symmetric about the margin under the hypothesis. `means` (D,) are the means of
    `subset_means`.
    """
    least = margin + ROUNDING * max(abs(margin), float(np.abs(means[[0, -1]]).max()))
    return float((np.searchsorted(means, least, side="right") + 1) / (len(means) + 1))


def chance_below(means: Floats, margin: float) -> float:
    """Return the one-sided p-value of a mean difference below a margin: small if it is significantly below.

    The differences of the parts are symmetric about the margin under the hypothesis. `means` (D,) are the means of
    `subset_means`.
    """
    return chance_above(-means[::-1], -margin)


def interval(means: Floats, level: float) -> tuple[float, float]:
    """Return the confidence interval (low, high) of a mean difference: the margins that the test does not reject.

    Each side has half of 1 - `level`. Unbounded where there are so few parts that no margin is rejected. `means` (D,)
    are the means of `subset_means`.
    """
    # Rejected are margins with fewer than k means at or below them
    k = int(np.floor(0.5 * (1.0 - level) * (len(means) + 1) + ROUNDING))
    return (float(means[k - 1]), float(means[-k])) if k > 0 else (-np.inf, np.inf)


Metric = Callable[[Floats], Floats]
"""(..., k) sums to (...) a figure."""
SEGMENT_LENGTHS = 5.0
MIN_SEGMENTS = 20
"""Fewest segments of time from which anything is concluded."""
MAX_SEGMENTS = 100
"""Most segments of all recordings: longer ones are never less independent."""
MANY_RECORDINGS = 8
"""Fewest recordings that are compared whole: all of them better come about by chance once in 256 times."""
STEP = 1e-6
NOT_KNOWN = (float("nan"),) * 4


class PairedDifference(NamedTuple):
    """Difference of run B from run A in one figure, with confidence interval and exact test.

    Attributes:
        a, b: the figure of each run.
        difference: b - a.
        low, high: confidence interval of the difference; NaN: too few parts.
        se: standard error of the difference; NaN: too few parts.
        p: two-sided p-value of the hypothesis that the runs do not differ; NaN: too few parts.
        segments: how many parts were compared, recordings or segments of time.
        recordings: whether each was a whole recording.
        drawn: (D,) sorted means of subsets of the parts, from which p is computed; (0,): no test.
    """

    a: float
    b: float
    difference: float
    low: float
    high: float
    se: float
    p: float
    segments: int
    recordings: bool
    drawn: Floats

    @property
    def least(self) -> float:
        """Return the smallest possible one-sided p-value for the number of parts; 0 if there was no test."""
        return 1.0 / (len(self.drawn) + 1) if len(self.drawn) else 0.0

    def below(self, margin: float) -> float:
        """Return the one-sided p-value of a difference below `margin`: small if significantly below; NaN: unknown.

        If no frame differs it is 0 or 1.
        """
        if len(self.drawn):
            return chance_below(self.drawn, margin)
        return float("nan") if np.isnan(self.p) else float(self.difference >= margin)

    def above(self, margin: float) -> float:
        """Return the one-sided p-value of a difference above `margin`: small if significantly above; NaN: unknown.

        If no frame differs it is 0 or 1.
        """
        if len(self.drawn):
            return chance_above(self.drawn, margin)
        return float("nan") if np.isnan(self.p) else float(self.difference <= margin)


def compare(
    a: Sequence[Floats],
    b: Sequence[Floats],
    metric: Metric,
    rng: np.random.Generator,
    level: float = 0.95,
    *,
    lasting: bool = False,
) -> PairedDifference:
    """Return the difference of a figure between two runs on the same frames, with confidence interval and p-value.

    Args:
        a: for each recording (T, k) the contributions of its frames to the k sums, of run A.
        b: those of run B, for the same frames.
        metric: function of sums (..., k) that returns the figure (...).
        rng: source of random numbers for subsets of many parts.
        level: confidence level of the interval.
        lasting: effects of a frame last to the end of the recording, as exchanges of identities do; segments of one
            recording are then not tested.

    Raises:
        ValueError: the runs are not of the same frames.
    """
    if len(a) != len(b) or any(x.shape != y.shape for x, y in zip(a, b, strict=True)):
        raise ValueError("runs are compared in the same frames")
    total = np.sum([x.sum(axis=0) for x in a], axis=0), np.sum([y.sum(axis=0) for y in b], axis=0)
    values = [float(metric(each)) for each in total]
    difference = values[1] - values[0]
    slope = _gradient(metric, 0.5 * (total[0] + total[1]))
    added = [(y - x) @ slope for x, y in zip(a, b, strict=True)]
    whole = sum(len(u) > 0 for u in added) >= MANY_RECORDINGS
    # Where a run has no figure nothing is decided, but its segments are cut all the same
    cut = _whole(added) if whole else _segments([np.nan_to_num(u) for u in added])
    count = len(cut)
    none = PairedDifference(values[0], values[1], difference, *NOT_KNOWN, count, whole, np.zeros(0))
    if difference == 0.0 and not any(u.any() for u in added):
        # Where no frame adds to a difference missing, and no test is needed
        return none._replace(low=0.0, high=0.0, se=0.0, p=1.0)
    if not np.isfinite(difference) or (not whole and (lasting or count < MIN_SEGMENTS)):
        return none
    parts = np.array([added[r][i:j].sum() for r, i, j in cut])
    weights = np.array([float(j - i) for _, i, j in cut])
    weights /= weights.sum()
    # Terms of third order, such as come of large differences, go to all parts
    parts += weights * (difference - parts.sum())
    means = subset_means(parts, weights, rng)
    low, high = interval(means, level)
    return none._replace(
        low=low,
        high=high,
        se=float(np.sqrt(count / (count - 1) * np.square(parts - weights * difference).sum())),
        p=min(1.0, 2.0 * min(chance_below(means, 0.0), chance_above(means, 0.0))),
        drawn=means,
    )


def _gradient(metric: Metric, at: Floats) -> Floats:
    """Return the gradient (k,) of a metric with respect to its k sums at `at` (k,), by central differences."""
    h = STEP * np.maximum(np.abs(at), 1.0)
    moves = np.diag(h)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((metric(at + moves) - metric(at - moves)) / (2 * h))


def _whole(added: Sequence[Floats]) -> list[tuple[int, int, int]]:
    """Return (recording, 0, number of frames) of each recording with frames; `added` has an array for each."""
    return [(r, 0, len(u)) for r, u in enumerate(added) if len(u)]


def _segments(added: Sequence[Floats]) -> list[tuple[int, int, int]]:
    """Return segments of recordings that are long relative to the correlation time.

    Args:
        added: what each frame adds, an array for each recording.

    Returns:
        Recording, first frame and frame after the last, of each segment.
    """
    frames = sum(len(u) for u in added)
    length = max(int(np.ceil(SEGMENT_LENGTHS * autocorrelation_time(added))), -(-frames // MAX_SEGMENTS))
    out = []
    for r, u in enumerate(added):
        if not len(u):
            continue
        ends = np.linspace(0, len(u), max(len(u) // length, 1) + 1).round().astype(int)
        out += [(r, int(i), int(j)) for i, j in pairwise(ends)]
    return out


def autocorrelation_time(series: Sequence[Floats], window: float = 5.0) -> float:
    """Return the integrated autocorrelation time [frames] of several series of one process; 1 if independent.

    The sum of autocorrelations is truncated at a lag of `window` times its value (Sokal 1997). 1 is the least value.
    """
    mean = float(np.concatenate(series).mean()) if sum(map(len, series)) else 0.0
    most = max((len(u) for u in series), default=0)
    covariance, weight = np.zeros(most), np.zeros(most)
    for u in series:
        size = 1 << max(2 * len(u) - 1, 1).bit_length()
        spectrum = np.fft.rfft(u - mean, size)
        covariance[: len(u)] += np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(u)]
        weight[: len(u)] += np.arange(len(u), 0, -1)
    if most == 0 or covariance[0] <= 0.0:
        return 1.0
    rho = covariance / covariance[0]
    tau = 2.0 * np.cumsum(rho) - 1.0
    reached: Ints = np.flatnonzero(np.arange(most) >= window * tau)
    return float(max(tau[reached[0]] if len(reached) else tau[-1], 1.0))
