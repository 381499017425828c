"""Alignment of tracks and truth: constant delay, and wrong times, units or axes.

The delay is estimated from the errors of pairs, by regression on the velocity of the target. If hardly any target has
an estimate nearby, other units and origins of time, units of length, axes, rotations and translations are tried on a
sample of both tables; the first that makes them agree is reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from occlog.array_types import NS, Floats, Ints, Ints32
from occlog.consistency.clock_offsets import cause_of
from occlog.errors import option
from occlog.evaluate.matching.paths import ObjectPath
from occlog.io.files.input_units import TIMES
from occlog.records.columns import rows_by_label
from occlog.records.tables import Errors, Tracks, Truth
from occlog.records.verdicts import Check, finding, outcome
from occlog.settings import METRES

DELAY, ALIGNMENT = "delay against the truth", "times, unit and axes of the truth"
"""Names of checks."""
WINDOW_NS = 2 * NS
"""Errors of a time interval are one sample of the delay: errors last."""
MAX_WINDOWS = 4096
"""More windows are joined in pairs."""
MIN_WINDOWS = 6
"""Minimum number of windows for a delay."""
FALSE_PROBABILITY = 1e-4
"""Probability with which errors without a delay are taken for one."""
MIN_GAIN, MIN_STEPS, LARGE_GAIN = 0.25, 0.6, 0.5
"""Share of the squared errors that a delay must explain to matter; a filter lags by a part of a time step in turns, so
that a delay of less than this part of a step must explain the second share."""
HALF_STEP_NS = NS // 10
"""Velocities of targets are differences of positions this time before and after."""

DAY_S, MAX_DAYS = 86_400.0, 2.0
DAYS = {"Excel": 25_569.0, "MATLAB": 719_529.0, "Julian dates": 2_440_587.5, "modified Julian dates": 40_587.0}
"""Day 0 of Unix time in serial days of programs."""


class Delay(NamedTuple):
    """A constant delay of the tracks.

    Attributes:
        seconds: the delay [s]; positive: estimates are those of an earlier time.
        sigma: its standard error [s].
        gain: share of the squared errors, without their mean, that it explains.
        limit: multiple of its standard error that the estimate exceeds with `FALSE_PROBABILITY` if there is no delay.
    """

    seconds: float
    sigma: float
    gain: float
    limit: float


class ClockDrift(NamedTuple):
    """A delay of the tracks that changes linearly with time.

    Attributes:
        rate: its change [s/s].
        sigma: the standard error of the change [s/s].
        gain: share of the squared errors, without their mean, that the delay and its change explain.
        limit: multiple of its standard error that the change exceeds with `FALSE_PROBABILITY` if there is none.
        without: RMSE of the pairs without the delay, in the unit of lengths.
    """

    rate: float
    sigma: float
    gain: float
    limit: float
    without: float

    def matters(self, constant: Delay) -> bool:
        """Whether the change is significant, and halves the squared errors that a constant delay leaves."""
        halved = 1.0 - self.gain < LARGE_GAIN * (1.0 - constant.gain)
        return abs(self.rate) > self.limit * self.sigma and halved


class DelaySums:
    """Sums over pairs of estimate and target, by intervals of time, from which the delay is estimated.

    An estimate with delay tau has the error -tau v on a target with velocity v. The regression of errors on velocities
    has a constant term, since a translation is not a delay. Standard errors are cluster-robust: errors within an
    interval may be correlated (Liang & Zeger 1986).
    """

    def __init__(self) -> None:
        """Create sums without pairs."""
        self._width, self._step_ns = WINDOW_NS, 0.0
        # Of each window: n, sums of v (2), e (2), v v, e v, e e
        self._windows: dict[int, Floats] = {}

    def update(self, t_ns: Ints, error: Floats, velocity: Floats) -> None:
        """Add n pairs of an estimate and a true position.

        Args:
            t_ns: (n,) times [ns].
            error: (n, 2) estimate minus truth.
            velocity: (n, 2) of the targets [length/s]; pairs with NaN are skipped.
        """
        good = np.isfinite(velocity).all(axis=1) & np.isfinite(error).all(axis=1)
        e, v = error[good], velocity[good]
        columns = (np.ones(len(e)), *v.T, *e.T, np.sum(v * v, axis=1), np.sum(e * v, axis=1), np.sum(e * e, axis=1))
        times = np.unique(t_ns[good])
        self._step_ns = max(self._step_ns, float(np.median(np.diff(times)))) if len(times) > 1 else self._step_ns
        windows, number = np.unique(t_ns[good] // self._width, return_inverse=True)
        sums = np.stack([np.bincount(number, column, len(windows)) for column in columns], axis=1)
        for window, row in zip(windows.tolist(), sums, strict=True):
            self._windows[window] = self._windows.get(window, 0.0) + row
        while len(self._windows) > MAX_WINDOWS:
            self._width *= 2
            before, self._windows = self._windows, {}
            for window, row in before.items():
                self._windows[window // 2] = self._windows.get(window // 2, 0.0) + row

    def estimate(self) -> Delay | None:
        """Return the estimated delay; None with fewer than `MIN_WINDOWS` intervals, or targets of constant velocity."""
        centred = self._centred()
        if centred is None:
            return None
        _, ve, v2, left, _ = centred
        slope, windows = ve.sum() / v2.sum(), len(ve)
        variance = np.sum((ve - slope * v2) ** 2) / v2.sum() ** 2 * windows / (windows - 1)
        return Delay(-float(slope), math.sqrt(variance), float(slope**2 * v2.sum() / left), _limit(windows - 1))

    def drift(self) -> ClockDrift | None:
        """Return the estimated linear change of the delay; None as for `estimate`, or if it is not determined."""
        centred = self._centred()
        if centred is None:
            return None
        seconds, ve, v2, left, mean_square = centred
        X = np.column_stack([np.ones(len(ve)), seconds - np.average(seconds, weights=v2)])
        normal = X.T @ (v2[:, None] * X)
        if np.linalg.cond(normal) > 1e12:
            return None
        slopes = np.linalg.solve(normal, X.T @ ve)
        scores = X * (ve - v2 * (X @ slopes))[:, None]
        inverse, windows = np.linalg.inv(normal), len(ve)
        covariance = inverse @ scores.T @ scores @ inverse * windows / (windows - 2)
        explained = float(slopes @ X.T @ ve)
        without = math.sqrt(max(mean_square * (1.0 - explained / left), 0.0))
        return ClockDrift(
            -float(slopes[1]), math.sqrt(covariance[1, 1]), explained / left, _limit(windows - 2), without
        )

    def _centred(self) -> tuple[Floats, Floats, Floats, float, float] | None:
        """Return sums over pairs with errors and velocities less their means.

        None with fewer than `MIN_WINDOWS` intervals, or targets of constant velocity.

        Returns:
            (W,) times of the intervals [s], (W,) sums of products of velocity and error in them, (W,) of squared
            velocities, the sum of all squared errors, and that over the number of pairs.
        """
        keys = sorted(self._windows)
        sums = np.array([self._windows[k] for k in keys]).reshape(-1, 8)
        if len(sums) < MIN_WINDOWS:
            return None
        n, v, e, vv, _, ee = _parts(sums.sum(axis=0))
        v_mean, e_mean = v / n, e / n
        spread, left = vv - n * v_mean @ v_mean, ee - n * e_mean @ e_mean
        if not (spread > 1e-9 * max(vv, 1e-30) and left > 0.0):
            return None
        counts, vs, es = sums[:, 0], sums[:, 1:3], sums[:, 3:5]
        ve = sums[:, 6] - vs @ e_mean - es @ v_mean + counts * (v_mean @ e_mean)
        v2 = sums[:, 5] - 2.0 * vs @ v_mean + counts * (v_mean @ v_mean)
        return (np.array(keys) - keys[0]) * (self._width / NS), ve, v2, float(left), float(left / n)

    def checks(self, unit: str) -> tuple[Check, ...]:
        """Return the check of the delay, with a warning if it is significant and explains enough of the errors.

        `unit`: unit of lengths, for the message.
        """
        found = self.estimate()
        if found is None:
            return outcome(DELAY, (), unless="too few pairs with a target that moves")
        short = abs(found.seconds) < MIN_STEPS * self._step_ns / NS
        large = found.gain > (LARGE_GAIN if short else MIN_GAIN)
        matters = abs(found.seconds) > found.limit * found.sigma and large
        reported = [_delayed(found, *self._rmse(found), unit)] if matters else []
        drift = self.drift()
        if drift is not None and drift.matters(found):
            reported = [_drifting(drift, self._rmse(found)[0], unit)]
        return outcome(DELAY, reported, delay_s=found.seconds, sigma_s=found.sigma)

    def _rmse(self, found: Delay) -> tuple[float, float]:
        """Return the RMSE of the pairs, and what it would be without the delay `found`, in the unit of lengths."""
        n, _, _, vv, ev, ee = _parts(np.sum(list(self._windows.values()), axis=0))
        without = ee + 2.0 * found.seconds * ev + found.seconds**2 * vv
        return math.sqrt(ee / n), math.sqrt(max(without, 0.0) / n)


def _delayed(found: Delay, rmse: float, without: float, unit: str) -> Check:
    return finding(
        DELAY,
        "tracks-delayed",
        delay_s=abs(found.seconds),
        sigma_s=found.sigma,
        side="behind" if found.seconds > 0.0 else "ahead of",
        rmse=rmse,
        without=without,
        unit=unit,
    )


def _drifting(found: ClockDrift, rmse: float, unit: str) -> Check:
    return finding(
        DELAY,
        "tracks-clock-drift",
        ppm=1e6 * abs(found.rate),
        side="fast" if found.rate > 0.0 else "slow",
        rmse=rmse,
        without=found.without,
        unit=unit,
    )


def _limit(degrees: float) -> float:
    """Return the multiple of a standard error that Student's t exceeds with `FALSE_PROBABILITY`, on both sides."""
    return -float(stdtrit(degrees, 0.5 * FALSE_PROBABILITY))


def _parts(total: Floats) -> tuple[float, Floats, Floats, float, float, float]:
    return float(total[0]), total[1:3], total[3:5], float(total[5]), float(total[6]), float(total[7])


def velocities(paths: Mapping[int, ObjectPath], labels: Ints | Ints32, t_ns: Ints, limit_ns: int | None) -> Floats:
    """Return the true velocity (n, 2) of each target at each time [length/s], by central differences.

    NaN unless the truth is known before and after.

    Args:
        paths: true paths by label.
        labels: (n,) target of each row.
        t_ns: (n,) times [ns].
        limit_ns: largest gap that is interpolated [ns]; None: that of the path.
    """
    out = np.full((len(t_ns), 2), np.nan)
    for label, rows in rows_by_label(labels):
        if label in paths:
            after, before = (paths[label].at(t_ns[rows] + step, limit_ns)[0] for step in (HALF_STEP_NS, -HALF_STEP_NS))
            out[rows] = (after - before) / (2.0 * HALF_STEP_NS / NS)
    return out


MAX_SAMPLE = 20_000
"""Rows of each table, from its begin, that are compared."""
MAX_TOLERANCE_S = 1.0
"""Largest time between two positions that are compared."""
QUERIES = 300
"""Positions of each side that are looked up in the other."""
MIN_MET, MIN_MORE = 0.5, 0.3
"""Share of positions that meet with a change of times or axes, and how much more that is than without it."""
NARROW = 0.25
"""Share of the gate that is tried, too: in crowds somebody is within the gate anywhere."""
MIN_OVERLAP = 0.2
"""Time that both tables must share, over the shorter one."""
TIMES_S = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "minutes": 60.0, "hours": 3600.0, "days": 86_400.0}
"""Units of times, but seconds [s]."""
TIME_UNITS = tuple(factor for unit in TIMES_S.values() for factor in (unit, 1.0 / unit))
LENGTH_UNITS = (1e-3, 1e3, 1e-2, 1e2, 0.1, 10.0, 0.3048, 1.0 / 0.3048, 0.0254, 1.0 / 0.0254)
GRID = {0.0254: 0.025, 1.0 / 0.0254: 40.0}
"""Cells of 2.5 cm, in which data sets of people number the floor, by the factor of inches, which is close to them."""
MAX_STEPS = 600
"""Shifts to each side that are tried."""
MAX_RATE, MIN_RATE = 100.0, 0.02
"""Largest ratio of frame rates, and smallest relative difference of them, that is tried."""
ANGLES = 360
"""Rotations that are tried."""
AXES = {
    "": ((1, 0), (0, 1)),
    "x negated": ((-1, 0), (0, 1)),
    "y negated": ((1, 0), (0, -1)),
    "x and y exchanged": ((0, 1), (1, 0)),
    "x and y negated": ((-1, 0), (0, -1)),
    "x and y exchanged and negated": ((0, -1), (-1, 0)),
    "(x, y) as (y, -x)": ((0, 1), (-1, 0)),
    "(x, y) as (-y, x)": ((0, -1), (1, 0)),
}
"""Changes of axes, simplest first, with their matrices."""


class PositionSamples(NamedTuple):
    """Positions xy (n, 2) in the world at nondecreasing times t (n,) [s], of any number of objects."""

    t: Floats
    xy: Floats

    @property
    def step(self) -> float:
        """Median interval between successive distinct times [s]; 0 with a single time."""
        times = np.unique(self.t)
        return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


class Alternative(NamedTuple):
    """A transform of the tracks that may make them agree with the truth.

    Attributes:
        id: id of the finding.
        change: description.
        met: F1 score, 0 to 1, of agreeing positions after it.
        units: units that the factor of times or lengths stands for, with their sizes; empty: there is no factor.
        factor: of the tracks' times or lengths.
        which: file with times in days.
    """

    id: str
    change: str
    met: float
    units: Mapping[str, float] = MappingProxyType({})
    factor: float = 1.0
    which: str = ""

    @property
    def remedy(self) -> str:
        """What to do about another unit: of which file it is, and how to state or convert it."""
        for unit, size in self.units.items():
            for name, scale in (("tracks", self.factor), ("a truth", 1.0 / self.factor)):
                if abs(scale / size - 1.0) < 1e-6 and unit in (*METRES, *TIMES):
                    column = f"{'x' if unit in METRES else 't'}_{unit}"
                    return f"for {name} in {unit}: write {column}, or {option('input_units')} FILE:{unit}"
                if abs(scale / size - 1.0) < 1e-6:
                    return f"for {name} in {unit}: multiply the times by {size:g}"
        return "convert the file that is not in the unit of the scene"


def sample_of(chunks: Iterable[Tracks] | Iterable[Truth], role: str = "target") -> tuple[PositionSamples, Floats]:
    """Return positions, and heights z (n,), of the first rows of a table, up to `MAX_SAMPLE`.

    Of a truth only rows with this `role` count; rows without x or y are skipped.
    """
    parts, count = [(np.zeros(0, np.int64), np.zeros((0, 3)))], 0
    for rows in chunks:
        own = rows.role == role if isinstance(rows, Truth) else np.ones(len(rows), dtype=np.bool_)
        parts.append((rows.t_ns[own], np.column_stack([rows.x, rows.y, rows.z])[own]))
        count += int(own.sum())
        if count >= MAX_SAMPLE:
            break
    t_ns, xyz = (np.concatenate(column)[:MAX_SAMPLE] for column in zip(*parts, strict=True))
    good = np.isfinite(xyz[:, :2]).all(axis=1)
    return PositionSamples(t_ns[good] / NS, xyz[good, :2]), xyz[good, 2]


def alternative(
    tracks: PositionSamples,
    truth: PositionSamples,
    gate: float,
    given: tuple[PositionSamples, PositionSamples] | None = None,
) -> tuple[Alternative, float, float] | None:
    """Find the simplest transform of the tracks after which they agree with the truth; None if none helps.

    Args:
        tracks: estimates.
        truth: true positions.
        gate: largest distance of agreeing positions; if nothing fits, the share `NARROW` of it is tried.
        given: estimates and true positions for the comparison without a transform; None: `tracks` and `truth`.

    Returns:
        The transform, the F1 score without it (over the whole time), and the gate that was used.
    """
    given = (tracks, truth) if given is None else given
    if not (len(tracks.t) and len(truth.t)):
        return None
    for near in (gate, NARROW * gate):
        now, best = _met(*given, near), None
        for each in _changes(tracks, truth, near):
            if each.met >= max(MIN_MET, now + MIN_MORE) and (best is None or each.met > best.met + 0.1):
                best = each
        if best is not None:
            return best, _met(*given, near, whole=True), near
    return None


def _changes(tracks: PositionSamples, truth: PositionSamples, gate: float) -> Iterator[Alternative]:
    """Generate transforms of the tracks that may explain a misfit, each with its F1 score after it.

    They change times, unit, axes or rotation; simplest first. `gate`: largest distance of positions that agree.
    """
    yield Alternative("axes-differ", "", _met(tracks, truth, gate))  # of a truth other than the given one
    yield from _changes_of_time(tracks, truth, gate)
    for scale, (name, matrix) in product((1.0, *LENGTH_UNITS), AXES.items()):
        met = _met(*_scaled(tracks, truth, scale, matrix), gate)
        if scale in GRID and met >= MIN_MET:
            near = {s: _met(*_scaled(tracks, truth, s, matrix), NARROW**2 * gate) for s in (scale, GRID[scale])}
            scale = max(near, key=lambda s: near[s])
        words = [f"lengths times {scale:.6g}"] if scale != 1.0 else []
        id = "length-unit-differs" if scale != 1.0 else "axes-differ"
        yield Alternative(id, " and ".join([*words, *([name] if name else [])]), met, METRES, scale)
    yield from _rotations(tracks, truth, gate)


def _scaled(
    tracks: PositionSamples, truth: PositionSamples, scale: float, matrix: Sequence[Sequence[float]]
) -> tuple[PositionSamples, PositionSamples]:
    """Return tracks with their axes changed by `matrix` (2, 2) and lengths times `scale`, and the truth.

    In the larger unit of both, as the gate is a length that people are apart.
    """
    turned = PositionSamples(tracks.t, min(scale, 1.0) * tracks.xy @ np.array(matrix, dtype=np.float64).T)
    return turned, PositionSamples(truth.t, truth.xy / max(scale, 1.0))


def _changes_of_time(tracks: PositionSamples, truth: PositionSamples, gate: float) -> Iterator[Alternative]:
    ours, theirs = tracks.step, truth.step
    first, begin = tracks.t[0], truth.t[0]
    for program, epoch in DAYS.items():
        words = f"times as days of {program}"
        for which, days, other in (("tracks", tracks, truth), ("truth", truth, tracks)):
            if abs(days.t[0] - other.t[0] / DAY_S - epoch) < MAX_DAYS:
                seconds = PositionSamples(DAY_S * (days.t - epoch), days.xy)
                yield Alternative("times-in-days", words, _met(seconds, other, gate), which=which)
    for factor in (1.0, *TIME_UNITS):
        if factor != 1.0 and not (ours and theirs and 1.0 / 3.0 < factor * ours / theirs < 3.0):
            continue
        id, words = "time-unit-differs", f"times multiplied by {factor:g}"
        if factor != 1.0:
            # Times count from 0, or from the first one
            for start in (0.0, first):
                met = _met(_timed(tracks, factor, start, start), truth, gate)
                yield Alternative(id, words, met, TIMES_S, factor)
        shift, met = _best_shift(_timed(tracks, factor, first, begin), truth, gate)
        if factor == 1.0:
            shift += begin - first
            size = f"{shift:+.3f}".rstrip("0").rstrip(".")
            id, words = "times-shifted", f"times shifted by {size} s{cause_of(shift)}"
        yield Alternative(id, words, met, TIMES_S, factor)
    spans = [each.t[-1] - each.t[0] for each in (tracks, truth)]
    ratio = spans[1] / spans[0] if min(spans) > 0.0 else 1.0
    if 1.0 / MAX_RATE < ratio < MAX_RATE and abs(ratio - 1.0) > MIN_RATE:
        words = f"times multiplied by {ratio:.4g} from the first one on"
        yield Alternative("frame-rate-differs", words, _met(_timed(tracks, ratio, first, begin), truth, gate))


def _timed(tracks: PositionSamples, factor: float, start: float, begin: float) -> PositionSamples:
    """Return the tracks with the times begin + factor (t - start); `start` and `begin` in [s]."""
    return PositionSamples(begin + factor * (tracks.t - start), tracks.xy)


def _tolerance(tracks: PositionSamples, truth: PositionSamples) -> float:
    """Return the tolerance [s]: estimates and true positions further apart in time are not compared.

    It is about half the longer of their median intervals, at most `MAX_TOLERANCE_S`.
    """
    return min(0.51 * max(tracks.step, truth.step, 1e-6), MAX_TOLERANCE_S)


def _spread(rows: Ints, count: int = QUERIES) -> Ints:
    """Return at most `count` of the rows (n,), evenly spaced."""
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).round().astype(np.int64)]


def _met(tracks: PositionSamples, truth: PositionSamples, gate: float, *, whole: bool = False) -> float:
    """Return the F1 score, 0 to 1, of positions that have a counterpart within the distance `gate` on each axis.

    The counterpart may also be about half a sampling interval earlier or later (`_tolerance`). The score is over the
    time that both have in common, or over all their time (`whole`); 0 if they have too little in common. At most
    `QUERIES` positions of each side are looked up.
    """
    tolerance = _tolerance(tracks, truth)
    rows = _common(tracks, truth, tolerance)
    if rows is None:
        return 0.0
    if whole:
        rows = [np.arange(len(each.t)) for each in (tracks, truth)]
    scale = np.array([1.0 / tolerance, 1.0 / gate, 1.0 / gate])
    ours, theirs = (
        np.column_stack([each.t, each.xy])[own] * scale for each, own in zip((tracks, truth), rows, strict=True)
    )
    shares = [_share_near(here, there) for here, there in ((ours, theirs), (theirs, ours))]
    return 2.0 * shares[0] * shares[1] / max(sum(shares), 1e-9)


def _common(tracks: PositionSamples, truth: PositionSamples, tolerance: float) -> list[Ints] | None:
    """Return the indices of the rows of `tracks` and of `truth` in their common time; None if that is too short.

    That is below the share `MIN_OVERLAP` of the shorter of both. `tolerance`: time [s] by which the common time is
    extended on both sides.
    """
    first, last = max(tracks.t[0], truth.t[0]) - tolerance, min(tracks.t[-1], truth.t[-1]) + tolerance
    shorter = min(each.t[-1] - each.t[0] for each in (tracks, truth))
    if last - first < MIN_OVERLAP * shorter + 2.0 * tolerance * (shorter > 0.0) or last < first:
        return None
    rows = [np.arange(*np.searchsorted(each.t, [first, last])) for each in (tracks, truth)]
    return rows if all(len(own) for own in rows) else None


def _best_shift(tracks: PositionSamples, truth: PositionSamples, gate: float) -> tuple[float, float]:
    """Return the shift [s] to add to the tracks' times so that most positions agree, and the F1 score with it.

    `gate`: largest distance of positions that agree. Multiples of the sampling interval up to `MAX_STEPS` are tried.
    """
    step = max(tracks.step, truth.step)
    if not step:
        return 0.0, _met(tracks, truth, gate)
    scale = np.array([1.0 / _tolerance(tracks, truth), 1.0 / gate, 1.0 / gate])
    tree = cKDTree(np.column_stack([tracks.t, tracks.xy]) * scale)
    rows = _spread(np.arange(len(truth.t)), 60)
    points = np.column_stack([truth.t, truth.xy])[rows] * scale
    shifts = sorted((step * np.arange(-MAX_STEPS, MAX_STEPS + 1)).tolist(), key=abs)
    counts = [np.count_nonzero(np.isfinite(_distance(tree, points - [shift * scale[0], 0.0, 0.0]))) for shift in shifts]
    best = shifts[int(np.argmax(counts))]
    met = {shift: _met(PositionSamples(tracks.t + shift, tracks.xy), truth, gate) for shift in (0.0, best)}
    shift = max(met, key=met.__getitem__)
    return shift, met[shift]


def tracks_per_target(tracks: PositionSamples, truth: PositionSamples, gate: float) -> float:
    """Return the median number of tracks near a true position, per true target near it; NaN without a common time.

    Near are positions within `gate` on each axis and `WINDOW_STEPS` sampling intervals; the two sampling rates may
    differ. In a crowd other targets are near, too, and so are their tracks.
    """
    step = max(tracks.step, truth.step)
    rows = _common(tracks, truth, _tolerance(tracks, truth))
    if rows is None or not (tracks.step and truth.step):
        return math.nan
    scale = np.array([1.0 / (WINDOW_STEPS * step), 1.0 / gate, 1.0 / gate])
    ours, theirs = (np.column_stack([each.t, each.xy]) * scale for each in (tracks, truth))
    chosen = theirs[_spread(rows[1])]
    near = [
        cKDTree(each).query_ball_point(chosen, 1.0, p=np.inf, return_length=True) * own.step
        for each, own in ((ours, tracks), (theirs, truth))
    ]
    return float(np.median(near[0] / near[1]))


def share_with_tracks(tracks: PositionSamples, others: PositionSamples, gate: float) -> float:
    """Return the share of positions `others` with a track within `gate` on each axis at about that time; 0 without."""
    if not (len(tracks.t) and len(others.t)):
        return 0.0
    scale = np.array([1.0 / _tolerance(tracks, others), 1.0 / gate, 1.0 / gate])
    ours, theirs = (np.column_stack([each.t, each.xy]) * scale for each in (tracks, others))
    return _share_near(theirs, ours)


def _share_near(here: Floats, there: Floats) -> float:
    """Return the share of points `here` (n, d), of at most `QUERIES`, with one of `there` within 1 on each axis."""
    return float(np.mean(np.isfinite(_distance(cKDTree(there), here[_spread(np.arange(len(here)))]))))


def _distance(tree: cKDTree, points: Floats) -> Floats:
    """Return the maximum-norm distance (n,) of points (n, d) to the nearest one of the tree; inf if above 1."""
    return np.asarray(tree.query(points, p=np.inf, distance_upper_bound=1.0)[0], dtype=np.float64)


def _rotations(tracks: PositionSamples, truth: PositionSamples, gate: float) -> Iterator[Alternative]:
    """Generate two transforms of the tracks with their F1 scores: the best translation, and the best rigid transform.

    The latter is a rotation or reflection with a translation, by a Hough transform over `ANGLES` angles. `gate`:
    largest distance of positions that agree.
    """
    tolerance = _tolerance(tracks, truth)
    rows = _common(tracks, truth, tolerance)
    if rows is None:
        return
    chosen = _spread(rows[1])
    low, high = (np.searchsorted(tracks.t, truth.t[chosen] + side) for side in (-tolerance, tolerance))
    pairs = [(n, m) for n, a, b in zip(chosen, low, high, strict=True) for m in range(a, min(b, a + 40))]
    if not pairs:
        return
    theirs, ours = np.array(pairs, dtype=np.int64).T
    q, p = truth.xy[theirs], tracks.xy[ours]
    most, angle, mirror, shift = 0, 0.0, 1.0, np.zeros(2)
    for sign, degrees in product((1.0, -1.0), range(ANGLES)):
        apart: Floats = q - p @ _turn(math.radians(degrees), sign).T
        cells = np.round(apart / gate).astype(np.int64) @ [1 << 20, 1]
        values, counts = np.unique(cells, return_counts=True)
        if counts.max() > most:
            most, angle, mirror = int(counts.max()), math.radians(degrees), sign
            shift = np.median(apart[cells == values[counts.argmax()]], axis=0)
        if not degrees and sign > 0.0:  # a small turn may put more pairs into one cell than no turn
            moved = _met(PositionSamples(tracks.t, tracks.xy + shift), truth, gate)
            yield Alternative("axes-differ", f"moved by ({shift[0]:.3g}, {shift[1]:.3g})", moved)
    met = _met(PositionSamples(tracks.t, tracks.xy @ _turn(angle, mirror).T + shift), truth, gate)
    mirrored = "y negated, " if mirror < 0.0 else ""
    turned = f"turned by {math.degrees(angle):.0f} degrees and " if angle else ""
    words = f"{mirrored}{turned}moved by ({shift[0]:.3g}, {shift[1]:.3g})"
    yield Alternative("axes-differ", words, met)


def _turn(angle: float, mirror: float) -> Floats:
    """Return the matrix (2, 2) that negates y if `mirror` is -1 (else 1), then rotates by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s * mirror], [s, c * mirror]])


def _y_up(positions: PositionSamples, z: Floats) -> PositionSamples | None:
    """Return positions (x, z) for (x, y) if z has a wider range than y, so that y may be up; None otherwise.

    `z`: (n,) heights.
    """
    if not (len(z) and np.isfinite(z).all() and np.ptp(z) > np.ptp(positions.xy[:, 1])):
        return None
    return PositionSamples(positions.t, np.column_stack([positions.xy[:, 0], z]))


MIN_MOTA = 0.2
"""MOTA below which another time, unit or frame is looked for."""
MAX_PRECISION, MIN_TRACKS = 0.7, 1.7
"""Precision below which tracks of several runs are looked for, and tracks per true position from which there are."""
MIN_TRACKED_OCCLUDERS = 0.5
"""Share of the occluders of a truth with a track from which it is stated."""
SAME_PERSON = 0.5
"""Share of the gate within which two tracks are of one person; in crowds other people are within the gate."""
WINDOW_STEPS = 2.5
"""Half width of the window in which positions are counted, in sampling intervals."""


class TruthAlignment:
    """Checks whether tracks and truth have the same times, unit and axes."""

    def __init__(self, sources: Callable[[], tuple[Iterable[Tracks], Iterable[Truth]]], gate: float, unit: str) -> None:
        """Start without pairs.

        Args:
            sources: returns chunks of tracks and of truth, in the order of time; called only if they disagree.
            gate: largest distance of positions that agree.
            unit: unit of lengths.
        """
        self._sources, self._gate, self._unit = sources, gate, unit
        self._delay = DelaySums()

    def update(self, errors: Errors, paths: Mapping[int, ObjectPath], limit_ns: int | None) -> None:
        """Add errors of estimates to the estimate of the delay.

        Args:
            errors: rows of the errors.
            paths: true paths by identity, around these times, for the velocities.
            limit_ns: largest gap of a path that is interpolated [ns]; None: the path's own.
        """
        error = np.column_stack([errors.error_x, errors.error_y])
        self.update_pairs(errors.target_id, errors.t_ns, error, paths, limit_ns)

    def update_pairs(
        self, targets: Ints | Ints32, t_ns: Ints, error: Floats, paths: Mapping[int, ObjectPath], limit_ns: int | None
    ) -> None:
        """Add n pairs of estimate and target to the estimate of the delay.

        Args:
            targets: (n,) identity of each target.
            t_ns: (n,) times [ns].
            error: (n, 2) estimate minus truth.
            paths: true paths by identity, for the velocities.
            limit_ns: largest gap of a path that is interpolated [ns]; None: the path's own.
        """
        self._delay.update(t_ns, error, velocities(paths, targets, t_ns, limit_ns))

    def checks(self, metrics: Mapping[str, float]) -> tuple[Check, ...]:
        """Return the checks of a delay of the tracks, and of other times, units or axes that fit the truth better.

        `metrics`: figures of the evaluation by name; MOTA or the median error decides whether the latter is searched
        for.
        """
        return (*self._delay.checks(self._unit), *outcome(ALIGNMENT, self._elsewhere(metrics)))

    def _elsewhere(self, metrics: Mapping[str, float]) -> Iterator[Check]:
        mota = metrics.get("mota", math.nan)
        if metrics.get("precision", 1.0) < MAX_PRECISION and metrics.get("recall", 0.0) > MIN_MET:
            (tracks, _), (truth, _) = (sample_of(each) for each in self._sources())
            gate = SAME_PERSON * self._gate
            count = tracks_per_target(tracks, truth, gate)
            if count >= MIN_TRACKS:
                yield finding(ALIGNMENT, "tracks-doubled", count=count, gate=gate, unit=self._unit)
                return
            occluders, _ = sample_of(self._sources()[1], "occluder")
            if (share := share_with_tracks(tracks, occluders, gate)) >= MIN_TRACKED_OCCLUDERS:
                yield finding(ALIGNMENT, "occluders-tracked", share=share)
        far = mota < MIN_MOTA if math.isfinite(mota) else metrics.get(f"error_median_{self._unit}", 0.0) > self._gate
        inside, outside = metrics.get("estimates", math.inf), metrics.get("estimates_without_truth", 0.0)
        if far or inside < MIN_OVERLAP * (inside + outside):
            yield from self.found()

    def found(self) -> Iterator[Check]:
        """Generate the warning with the simplest transform of the tracks after which they agree with the truth.

        Generates nothing if none helps. If the truth or the tracks have z over a wider range than y, (x, z) is tried
        first as the ground plane (y may be up).
        """
        (tracks, height), (truth, z) = (sample_of(each) for each in self._sources())
        planes = {"": (tracks, truth)}
        if (ground := _y_up(truth, z)) is not None:
            planes = {"x and z of the truth for its x and y (y up)": (tracks, ground)} | planes
        if (ground := _y_up(tracks, height)) is not None:
            planes = {"x and z of the tracks for their x and y (y up)": (ground, truth)} | planes
        for words, (ours, theirs) in planes.items():
            found = alternative(ours, theirs, self._gate, (tracks, truth))
            if found is None:
                continue
            best, now, gate = found
            change = ", ".join(part for part in (words, best.change) if part)
            yield finding(
                ALIGNMENT,
                best.id,
                met=best.met,
                now=now,
                change=change,
                gate=gate,
                unit=self._unit,
                remedy=best.remedy,
                which=best.which,
            )
            return
