"""How large the noise of bearings is, learned from how far the sight lines of three or more sensors miss one another.

Two sight lines in a plane always meet, n of them leave n - 2 degrees of freedom.  The squares of a scan's residuals at
the least-squares point, over their stated variances, sum up to S.  Where stated standard deviations are to be
multiplied by s, S / s^2 has a chi-squared distribution of n - 2 degrees; where a bearing is false, the square root of S
is anywhere up to the largest there is.  s and the share of scans with a false bearing are found by expectation
maximisation of this mixture, from the median of S over that of the distribution: s^2 is the sum of all S over that of
the degrees of freedom, each by the probability that the scan has no false bearing.

Errors of the poses are in it, as they are for a filter.  What is wrong in the same way in all sensors is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, gammaln

from occlog.array_types import Floats, Ints
from occlog.core.metrics.sums import Sum, group_medians
from occlog.core.sight import triangulate
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Sensor
from occlog.io.files.put_aside.spool import IN_MEMORY, Spool
from occlog.records.tables import Bearings

from .scans import Scans

Metrics = dict[str, float]

FEWEST_SCANS = 20
"""From fewer scans no noise is learned."""
FALSE = 0.2
"""Share of scans with a false bearing at first."""
FAR = 20.0
"""False bearings leave up to so many standard deviations at least: what lies at the end of honest noise is none."""
LEAST_FALSE, TINY = 1e-9, 1e-30
"""Neither share is less; nor is a square over its variance."""
STARTS, DECIDED = (1.0, 0.01, 0.0001), 10.0
"""The search begins at these shares of the median, in which most scans may have a false bearing; a later start counts
if its likelihood is greater by this logarithm."""
SETTLED = 1e-5
"""The search ends where s^2 changes by less than this share of it, ..."""
ITERATIONS = 200
"""... or after so many steps."""


class NoiseFigures:
    """Gathers by how far the sight lines of scans miss one another, while scans stream by."""

    def __init__(self, config: EvaluateConfig, in_memory: int = IN_MEMORY) -> None:
        """No scan yet; `in_memory`: how many numbers of a kind are kept in memory."""
        self._config = config
        self._squares, self._degrees, self._sigma_px = (Spool(in_memory) for _ in range(3))

    def see(self, rows: Bearings) -> None:
        """Some more labelled rows, of scans or not."""
        self._sigma_px.add(rows.sigma_px[np.isfinite(rows.sigma_px)])

    def update(self, scans: Scans, sensors: Mapping[str, Sensor]) -> None:
        """Some more scans of a target, by sensors with these names."""
        origins = np.array([sensors[name].ground for name in scans.rows.sensor.tolist()]).reshape(-1, 2)
        squares, degrees = _misses(scans, origins, self._config)
        self._squares.add(squares)
        self._degrees.add(degrees.astype(np.float64))

    def result(self) -> Metrics:
        """The figures; none where no scan of three lines met."""
        if not self._squares.count:
            return {}
        squares, degrees = self._squares.whole, self._degrees.whole
        if squares is not None and degrees is not None:
            scale = noise_scale(squares, degrees.astype(np.int64))
        else:
            scale = noise_scale_of_many(self._blocks, self._squares.count)
        known = self._sigma_px.count > 0
        return {
            "noise_scans": self._squares.count,
            "noise_scale": scale,
            "noise_px": scale * median_of(self._sigma_px) if known else float("nan"),
        }

    def _blocks(self) -> Iterator[tuple[Floats, Floats]]:
        return zip(self._squares.blocks(), self._degrees.blocks(), strict=True)


def noise_scale(squares: Floats, degrees: Ints, near: float | None = None) -> float:
    """The factor on stated standard deviations; NaN from fewer than `FEWEST_SCANS` scans.

    Args:
        squares: (S,) sums of squared residuals over stated variances.
        degrees: (S,) of freedom, >= 1.
        near: it is near to this, as that of most of the scans is; None: nothing is known.
    """
    if len(squares) < FEWEST_SCANS:
        return float("nan")
    return noise_scale_of_many(lambda: [(squares, degrees.astype(np.float64))], len(squares), near)


def _points(degrees: Floats | Ints, chance: float) -> Floats:
    """(S,) what a chi-squared number of so many degrees, >= 1, is above with this probability."""
    most = int(degrees.max(initial=1))
    return np.asarray(chdtri(np.arange(1, most + 1), chance)[degrees.astype(np.int64) - 1])


def noise_scale_of_many(
    blocks: Callable[[], Iterable[tuple[Floats, Floats]]], count: int, near: float | None = None
) -> float:
    """`noise_scale` of numbers that come in blocks.

    Args:
        blocks: gives squares and degrees of freedom, the same every time.
        count: how many there are, at least `FEWEST_SCANS`.
        near: as there.
    """

    def shares() -> Iterator[tuple[Ints, Floats]]:
        for square, degree in blocks():
            yield np.zeros(len(square), dtype=np.int64), square / _points(degree, 0.5)

    most = max(float(square.max(initial=0.0)) for square, _ in blocks())
    if near:
        return math.sqrt(_fitted(blocks, count, near**2, most).scale2)
    median = float(group_medians(shares, np.array([count]))[0])
    if median == 0.0:
        return 0.0
    found = [_fitted(blocks, count, share * median, most) for share in STARTS]
    best = found[0]
    for one in found[1:]:
        best = one if one.log_likelihood > best.log_likelihood + DECIDED else best
    return math.sqrt(best.scale2)


class Fit(NamedTuple):
    """A local maximum of the likelihood."""

    scale2: float
    log_likelihood: float


def _fitted(blocks: Callable[[], Iterable[tuple[Floats, Floats]]], count: int, start: float, most: float) -> Fit:
    """Where the search from a factor on the variances ends; `most`: the largest sum of squares."""
    scale2, false, reach = start, FALSE, math.sqrt(max(most, FAR**2 * start))
    for _ in range(ITERATIONS):
        total, expected, honest, fit = Sum(), Sum(), Sum(), Sum()
        for square, degree in blocks():
            density = (1.0 - false) * _density(square, degree, scale2)
            whole = density + false / reach
            believed = density / whole
            total.add(float(np.dot(believed, square)))
            expected.add(float(np.dot(believed, degree)))
            honest.add(float(believed.sum()))
            fit.add(float(np.log(whole).sum()))
        before, scale2 = scale2, max(total.value / max(expected.value, TINY), TINY * start)
        false = float(np.clip(1.0 - honest.value / count, LEAST_FALSE, 1.0 - LEAST_FALSE))
        if abs(scale2 - before) <= SETTLED * before:
            break
    return Fit(scale2, fit.value)


def _density(squares: Floats, degrees: Floats, scale2: float) -> Floats:
    """(S,) densities of the roots of sums of squared residuals that have no false bearing.

    Args:
        squares: (S,) sums of squared residuals over stated variances.
        degrees: (S,) of freedom.
        scale2: factor on the variances.
    """
    root = np.sqrt(np.maximum(squares / scale2, TINY))
    log_density = (degrees - 1.0) * np.log(root) - 0.5 * root**2 - (0.5 * degrees - 1.0) * math.log(2.0)
    return np.asarray(np.exp(log_density - gammaln(0.5 * degrees)) / math.sqrt(scale2))


def _misses(scans: Scans, origins: Floats, config: EvaluateConfig) -> tuple[Floats, Ints]:
    """Sums of squared residuals and degrees of freedom of one target's scans that met with three lines or more."""
    rows, starts = scans.rows, scans.starts
    found = triangulate.sight_lines_meet(
        origins, rows.bearing, rows.sigma, starts=starts, loss="gauss", min_crossing=config.lines_min_crossing
    )
    size = np.diff(starts)
    scan = np.repeat(np.arange(len(size)), size)
    good = (size > 2) & (found.status == triangulate.MET)
    each = np.where(good[scan], (found.residual / rows.sigma) ** 2, 0.0)
    return np.bincount(scan, weights=each, minlength=len(size))[good], size[good] - 2
