"""Accuracy for a report: RMSE and bound over the times and targets that have both; filter diagnostics.

Also which track each error is of: errors name the true target, while tracks may have their own identities.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.metrics.errors import Sum
from occlog.io.files.spill import Spool
from occlog.records.tables import Bound, Diagnostics, Errors, Tracks

WHERE = ("", "_space")
KINDS = ("bound", "smoothed")


def _common_times(errors: Errors, bound: Bound, target: int, kind: str, where: str) -> tuple[Floats, Floats]:
    """Return the errors (n,) and bounds (n,) of a target at the n times that have both.

    Args:
        errors: errors of all targets.
        bound: bound of all targets.
        target: its identity.
        kind: column of the bound: `bound` (filtering) or `smoothed`.
        where: ending of the columns: empty on the ground, `_space` in space.
    """
    error, least = getattr(errors, f"error{where}"), getattr(bound, f"{kind}{where}")
    mine = (errors.target_id == target) & np.isfinite(error)
    its = (bound.target_id == target) & np.isfinite(least)
    _, e, b = np.intersect1d(errors.t_ns[mine], bound.t_ns[its], return_indices=True)
    return error[mine][e], least[its][b]


@dataclass
class _Sums:
    """Sums of squares of errors and bounds at times when a target has both.

    Attributes:
        rows: number of such times.
        errors: sum of squared errors.
        bounds: sum of squared bounds.
        known: whether any bound of this kind is known.
    """

    rows: int = 0
    errors: Sum = field(default_factory=Sum)
    bounds: Sum = field(default_factory=Sum)
    known: bool = False  # whether any bound of the kind is known


@dataclass
class _BoundSoFar:
    """Running sum of squares of a target's bounds.

    Attributes:
        rows: number of rows so far.
        squares: sum of squares by kind of bound (`KINDS`).
        smoothed: whether the bound of smoothing is known in all rows so far.
    """

    rows: int = 0
    squares: dict[str, Sum] = field(default_factory=lambda: {kind: Sum() for kind in KINDS})
    smoothed: bool = True  # whether all of it is known


class ErrorsAgainstBound:
    """Accumulates errors and bounds of each target at common times, over two streams read in step."""

    def __init__(self) -> None:
        """Create statistics without errors and bounds."""
        self._sums: dict[tuple[int, str, str], _Sums] = {}
        self._targets: dict[int, _BoundSoFar] = {}

    def add(self, errors: Errors, bound: Bound) -> Floats:
        """Add errors and bounds of a time interval.

        Return the running root mean square of the N rows of the bound (N, 2). It is over all rows of the same target so
        far, for the bounds of filtering and of smoothing.
        """
        out = np.full((len(bound), 2), np.nan)
        for target in np.unique(bound.target_id).tolist():
            for where in WHERE:
                for kind in KINDS:
                    self._pairs(errors, bound, target, kind, where)
            own = self._targets.setdefault(target, _BoundSoFar())
            rows = bound.target_id == target
            count = own.rows + np.arange(1, int(rows.sum()) + 1)
            for k, kind in enumerate(KINDS):
                squares = getattr(bound, kind)[rows] ** 2
                out[rows, k] = np.sqrt((own.squares[kind].value + np.cumsum(squares)) / count)
                own.squares[kind].add(float(squares.sum()))
            own.rows = int(count[-1])
            own.smoothed = own.smoothed and bool(np.isfinite(bound.smoothed[rows]).all())
        return out

    def _pairs(self, errors: Errors, bound: Bound, target: int, kind: str, where: str) -> None:
        found, least = _common_times(errors, bound, target, kind, where)
        sums = self._sums.setdefault((target, kind, where), _Sums())
        sums.rows += len(found)
        sums.errors.add(float(np.sum(found**2)))
        sums.bounds.add(float(np.sum(least**2)))
        rows = bound.target_id == target
        sums.known = sums.known or bool(np.isfinite(getattr(bound, f"{kind}{where}")[rows]).any())

    def figures(self, target: int | None = None, where: str = "", *, smoothed: bool = False) -> tuple[float, float]:
        """Return RMSE and root mean square bound over common times and targets; NaN without any.

        Args:
            target: only this one; None: all.
            where: `_space`: in space; empty: on the ground.
            smoothed: use the smoothing bound, if it is known.
        """
        mine = {key: sums for key, sums in self._sums.items() if key[2] == where and target in (None, key[0])}
        later = smoothed and any(sums.known for (_, kind, _), sums in mine.items() if kind == "smoothed")
        own = [sums for (_, kind, _), sums in mine.items() if kind == ("smoothed" if later else "bound")]
        rows = sum(sums.rows for sums in own)
        if not rows:
            return float("nan"), float("nan")
        return (
            float(np.sqrt(sum(sums.errors.value for sums in own) / rows)),
            float(np.sqrt(sum(sums.bounds.value for sums in own) / rows)),
        )

    def smooths(self, target: int) -> bool:
        """Return whether the smoothing bound of a target is known at all times."""
        return target in self._targets and self._targets[target].smoothed


MAX_LOOKUPS = 200
"""Errors of each target that are searched in the tracks, evenly sampled."""


def relabelled(found: Mapping[int, int | None]) -> bool:
    """Return whether tracks have identities of their own, other than those of their targets.

    `found`: track by target, the result of `matching_tracks`.
    """
    return any(target != track for target, track in found.items())


def matching_tracks(errors: Errors, tracks: Tracks) -> dict[int, int | None]:
    """Return the track that each true target's errors are of, found by estimates with equal time and position.

    Args:
        errors: errors of `occlog evaluate`, or some of them.
        tracks: in the order of time, or some of their times.

    Returns:
        Track by target; None if the errors of one target belong to several tracks. A target is missing if none of its
            estimates is among the tracks.
    """
    out: dict[int, int | None] = {}
    shared = np.isin(errors.t_ns, tracks.t_ns)
    for target in np.unique(errors.target_id).tolist():
        rows = np.flatnonzero(shared & (errors.target_id == target))
        some = np.unique(np.linspace(0, max(len(rows) - 1, 0), min(len(rows), MAX_LOOKUPS)).round().astype(np.int64))
        found: set[int] | None = None
        for k in rows[some].tolist():
            start, stop = np.searchsorted(tracks.t_ns, errors.t_ns[k] + np.array([0, 1])).tolist()
            there = (tracks.x[start:stop] == errors.x[k]) & (tracks.y[start:stop] == errors.y[k])
            names = set(tracks.target_id[start:stop][there].tolist())
            if names:
                found = names if found is None else found & names
        if found is not None:
            out[target] = target if target in found else found.pop() if len(found) == 1 else None
    return out


MARKS = 300
"""Fallbacks of a kind that are drawn."""


def has_particles(diagnostics: Diagnostics) -> bool:
    """Return whether the diagnostics are of a particle filter (they have effective sample sizes)."""
    return bool(np.isfinite(diagnostics.ess).any())


def deviation(tracks: Tracks) -> Floats:
    """Return the standard deviation (T,) of each of T positions: square root of the trace of the covariance."""
    return np.sqrt(tracks.cov_xx + tracks.cov_yy)


@dataclass(frozen=True, eq=False)
class Fallbacks:
    """Fallbacks of one kind in the filter diagnostics.

    Attributes:
        rows: number of all.
        t_ns: (M,) times [ns] of those that are drawn: all, or every k-th if there are many.
    """

    rows: int
    t_ns: Ints


@dataclass(frozen=True, eq=False)
class FilterDiagnostics:
    """Summary of all filter diagnostics.

    Attributes:
        rows: number of all rows.
        particles: whether they are of a particle filter.
        lowest: smallest effective sample size.
        fallbacks: by kind, sorted.
        doubtful: number of rows with a quality flag.
        doubts: kinds of quality flags, sorted.
    """

    rows: int
    particles: bool
    lowest: float
    fallbacks: Mapping[str, Fallbacks]
    doubtful: int
    doubts: tuple[str, ...]


class FilterDiagnosticsStreams:
    """Accumulated filter diagnostics: fallbacks with their times, quality flags, least effective sample size."""

    def __init__(self, in_memory: int = 1 << 16) -> None:
        """Create empty statistics; `in_memory`: how many times of each kind of fallback stay in memory."""
        self._in_memory = in_memory
        self._rows = self._doubtful = 0
        self._particles, self._lowest = False, np.inf
        self._start: int | None = None
        self._fallbacks: dict[str, Spool] = {}
        self._doubts: set[str] = set()

    def add(self, part: Diagnostics) -> None:
        """Add further rows, in the order of time."""
        if not len(part):
            return
        self._start = int(part.t_ns[0]) if self._start is None else self._start
        self._rows += len(part)
        self._particles = self._particles or has_particles(part)
        self._lowest = float(np.minimum(self._lowest, part.ess.min()))
        for kind in np.unique(part.fallback).tolist():
            if kind:
                # Times since the start, which a float carries to the nanosecond
                since = part.t_ns[part.fallback == kind] - self._start
                self._fallbacks.setdefault(kind, Spool(self._in_memory)).add(since.astype(np.float64))
        self._doubtful += int(np.count_nonzero(part.quality_flags != ""))
        self._doubts.update(kind for text in np.unique(part.quality_flags).tolist() if text for kind in text.split(","))

    def finish(self) -> FilterDiagnostics:
        """Return the summary of all rows."""
        fallbacks = {kind: self._drawn(times) for kind, times in sorted(self._fallbacks.items())}
        doubts = tuple(sorted(self._doubts))
        return FilterDiagnostics(self._rows, self._particles, self._lowest, fallbacks, self._doubtful, doubts)

    def _drawn(self, times: Spool) -> Fallbacks:
        every, count, parts = -(-times.count // MARKS), 0, list[Ints]()
        for block in times.blocks():
            parts.append(block[-count % every :: every].astype(np.int64) + (self._start or 0))
            count += len(block)
        return Fallbacks(count, np.concatenate(parts))
