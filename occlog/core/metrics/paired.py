"""Whether two runs on the same recordings differ: a paired, studentised bootstrap over stretches of time.

Figures such as MOTA are functions g of sums over frames.  A frame of run A and the same frame of run B stay together in
all that follows, so that what both find hard cancels.

    D = g(sum of B) - g(sum of A)
    u_t = grad g(sum of B) . B_t - grad g(sum of A) . A_t      influence of frame t on D, to first order

Frames that follow each other are alike, so that stretches of frames are drawn and not frames: each `STRETCHES_APART`
times as long as the integrated autocorrelation time of u.  Stretches are then nearly independent; their sums of u give
the standard error of D, and D / se is compared with its distribution when stretches are drawn with replacement (Efron
and Tibshirani 1993, ch. 12; blocks as in Carlstein 1986).  Where there are `MANY_RECORDINGS` or more, each recording
is one stretch: what differs between recordings then counts, and a statement is about recordings like these.  With fewer
it is about these recordings alone.

Figures of identities are another matter: a target that has become another one stays that to the end, so that no two
stretches of one recording are independent.  They are decided over recordings only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

Metric = Callable[[Floats], Floats]
"""(..., k) sums to (...) a figure."""
STRETCHES_APART = 5.0
FEWEST = 20
"""Fewest stretches of time from which anything is concluded."""
MOST = 100
"""Most stretches of all recordings: longer ones are never less independent."""
MANY_RECORDINGS = 10
"""Fewest recordings that are drawn whole."""
DRAWS = 4999
STEP = 1e-6
NOT_KNOWN = (float("nan"),) * 4


class Difference(NamedTuple):
    """How much run B is above run A in one figure.

    Attributes:
        a, b: the figure of each run.
        difference: b - a.
        low, high: confidence interval of the difference; NaN: too few stretches.
        se: standard error of the difference; NaN likewise.
        p: probability of a difference at least as large, either way, of runs that do not differ; NaN likewise.
        stretches: of time that were drawn.
        recordings: whether each was a whole recording.
        drawn: (D,) how far differences of drawn stretches were from this one, in their standard errors.
    """

    a: float
    b: float
    difference: float
    low: float
    high: float
    se: float
    p: float
    stretches: int
    recordings: bool
    drawn: Floats

    def below(self, margin: float) -> float:
        """Probability of a difference as far below of runs that differ by `margin`; NaN: not known."""
        return self._chance(margin, -1.0)

    def above(self, margin: float) -> float:
        """Probability of a difference as far above of runs that differ by `margin`; NaN: not known."""
        return self._chance(margin, 1.0)

    def _chance(self, margin: float, sign: float) -> float:
        if not np.isfinite(self.se):
            return float("nan")
        away = sign * (self.difference - margin)
        if self.se == 0.0:
            return 0.0 if away > 0 else 1.0
        return _share(sign * self.drawn >= away / self.se)


def compare(
    a: Sequence[Floats],
    b: Sequence[Floats],
    metric: Metric,
    rng: np.random.Generator,
    level: float = 0.95,
    *,
    lasting: bool = False,
) -> Difference:
    """Compare a figure of two runs.

    Args:
        a: for each recording (T, k) what each frame adds to the sums, of run A.
        b: the same of run B, of the same frames.
        metric: the figure of sums.
        rng: draws stretches.
        level: of the confidence interval.
        lasting: what happens in a frame counts to the end of the recording, as exchanges of identities do.

    Raises:
        ValueError: the runs are not of the same frames.
    """
    if len(a) != len(b) or any(x.shape != y.shape for x, y in zip(a, b, strict=True)):
        raise ValueError("runs are compared in the same frames")
    total = np.sum([x.sum(axis=0) for x in a], axis=0), np.sum([y.sum(axis=0) for y in b], axis=0)
    values = [float(metric(each)) for each in total]
    difference = values[1] - values[0]
    slopes = [_gradient(metric, each) for each in total]
    influence = [y @ slopes[1] - x @ slopes[0] for x, y in zip(a, b, strict=True)]
    whole = len(a) >= MANY_RECORDINGS
    # Where a run has no figure nothing is decided, but its stretches are cut all the same
    cut = _whole(influence) if whole else _stretches([np.nan_to_num(u) for u in influence])
    count = len(cut)
    none = Difference(
        values[0], values[1], difference, *NOT_KNOWN, stretches=count, recordings=whole, drawn=np.zeros(0)
    )
    if not np.isfinite(difference) or (not whole and (lasting or count < FEWEST)):
        # Where no frame adds to a difference there is none, and no test is needed
        same = difference == 0.0 and not any(u.any() for u in influence)
        return none._replace(low=0.0, high=0.0, se=0.0, p=1.0) if same else none
    parts = [np.array([each[r][i:j].sum(axis=0) for r, i, j in cut]) for each in (a, b)]
    share = np.array([influence[r][i:j].sum() for r, i, j in cut])
    se = _error(share[None])[0]
    if se == 0.0:
        return none._replace(low=difference, high=difference, se=0.0, p=1.0 if difference == 0.0 else 0.0)
    drawn = rng.integers(0, count, (DRAWS, count))
    # How often each stretch is drawn: sums of draws without a copy of every stretch that is drawn
    times = np.zeros((DRAWS, count))
    np.add.at(times, (np.arange(DRAWS)[:, None], drawn), 1.0)
    found = metric(times @ parts[1]) - metric(times @ parts[0])
    errors = _error(share[drawn])
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (found - difference) / errors
    t = t[np.isfinite(t)]
    here = difference / se
    low, high = np.quantile(t, [0.5 + level / 2, 0.5 - level / 2])
    return none._replace(
        low=difference - float(low) * se,
        high=difference - float(high) * se,
        se=float(se),
        p=_share(np.abs(t) >= abs(here)),
        drawn=t,
    )


def _share(hits: np.ndarray) -> float:
    """Share of draws, with the one that was observed among them: a test at a level keeps that level."""
    return float((np.count_nonzero(hits) + 1) / (len(hits) + 1))


def _gradient(metric: Metric, at: Floats) -> Floats:
    """Slope of a metric at sums, by central differences."""
    h = STEP * np.maximum(np.abs(at), 1.0)
    moves = np.diag(h)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((metric(at + moves) - metric(at - moves)) / (2 * h))


def _error(share: Floats) -> Floats:
    """Standard error of the sum of stretches, the last axis."""
    count = share.shape[-1]
    return np.asarray(np.sqrt(count * share.var(axis=-1, ddof=1)))


def _whole(influence: Sequence[Floats]) -> list[tuple[int, int, int]]:
    return [(r, 0, len(u)) for r, u in enumerate(influence)]


def _stretches(influence: Sequence[Floats]) -> list[tuple[int, int, int]]:
    """Recording, first frame and end of each stretch: long beside what is alike, of about one length."""
    frames = sum(len(u) for u in influence)
    length = max(int(np.ceil(STRETCHES_APART * autocorrelation_time(influence))), -(-frames // MOST))
    out = []
    for r, u in enumerate(influence):
        ends = np.linspace(0, len(u), max(len(u) // length, 1) + 1).round().astype(int)
        out += [(r, int(i), int(j)) for i, j in pairwise(ends)]
    return out


def autocorrelation_time(series: Sequence[Floats], window: float = 5.0) -> float:
    """Integrated autocorrelation time [frames] of series of one process: 1 if frames are independent.

    The sum of autocorrelations is cut where it has gone on for `window` times itself (Sokal 1997).
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
