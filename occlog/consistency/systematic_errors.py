"""Systematic errors of sensors: wrong yaw or clock, from the residuals of bearings of several sensors.

Within a second the error of a track is a position and a velocity, whatever motion model the method has. These four
parameters are eliminated from the residuals of the second. What remains are errors of the bearings: random ones, a yaw
error of a sensor (the same in all its bearings), and a clock delay (proportional to the rate of change of its bearing
to the target). Two lines of sight always meet, so that two sensors with one bearing each leave no residual.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.records.scene import Camera, MicrophoneArray, Scene
from occlog.records.tables import Tracks
from occlog.records.verdicts import Check, finding, outcome

from .bearings import StatedResiduals
from .clock_offsets import offset_words
from .estimates import MAX_SIGMA_RAD
from .sensor_noise import MAX_VARIANCE, SensorNoise

SYSTEMATIC, NOISE = "sensor errors", "sensor noise"
"""Names of the checks."""
WINDOW_S = 1.0
"""Time in which the error of a track is linear [s]."""
HALF_STEP_S = 0.5
"""Velocities are differences of positions this time before and after [s]."""
EPSILON_S = 1e-6
"""Least time between two positions [s]."""
MAX_RESIDUAL = 12.0
"""Residuals beyond that many times the median one of their sensor, or the one that is expected, are of false bearings,
and do not count."""
MEDIAN = 0.67
"""Median of the absolute value of a standard normal variable."""
MIN_RANK = 1e-3
"""Smallest singular value of the position and velocity that is eliminated, relative to the largest."""
MIN_FREEDOM = 40.0
"""Degrees of freedom that are left, at least."""
MIN_GAIN = 15.0
"""Squared normalised size of an error from which it is found: 3.9 standard errors."""
RIVAL_GAIN = 10.8
"""An error that explains the residuals as well, up to this much of chi-square, may be the true one instead."""
MIN_SHARE_OF_NOISE = 0.4
"""Size that matters, over the standard deviation of the sensor's bearings."""
STATED_DEVIATIONS = 3.0
"""Errors of poses within that many stated standard deviations are no finding."""
MIN_SHARE_LEFT = 0.02
"""Share of the squares of an error that no position, velocity or other error explains, at least."""
MAX_SENSORS = 40
"""Sensors that are compared, the first ones of the scene."""
MAX_FOUND = 3
"""Errors that are stated."""
TURNED, LATE = 0, 1
"""Kinds of errors: of the yaw [rad], and of the clock [s]."""


class SensorError(NamedTuple):
    """A systematic error of a sensor: of its yaw or of its clock.

    Attributes:
        sensor: name of the sensor.
        kind: `TURNED` (yaw) or `LATE` (clock).
        size: error of the bearings [rad], or how late the clock is [s].
        error: standard error of the size.
        noise: size from which the error matters, relative to the noise of a bearing.
        rivals: (sensor, kind) of errors that may be the true ones instead.
    """

    sensor: str
    kind: int
    size: float
    error: float
    noise: float
    rivals: tuple[tuple[str, int], ...] = ()


class SystematicErrors:
    """Normal equations of the yaw and clock errors of all sensors, accumulated chunk by chunk."""

    def __init__(self, scene: Scene) -> None:
        """Start without residuals.

        Args:
            scene: its sensors; a single sensor, and arrays that are not upright, are not judged.
        """
        sensors: list[Camera | MicrophoneArray] = [c for c in scene.cameras if c.placed]
        sensors += [a for a in scene.arrays if a.upright]
        self._sensors = {s.name: s for s in sensors[:MAX_SENSORS]}
        self._number = {name: n for n, name in enumerate(self._sensors)}
        S = len(self._sensors)
        self._normal, self._right = np.zeros((2 * S, 2 * S)), np.zeros(2 * S)
        self._scatter = np.zeros((3, 2 * S))  # sums over windows of u^2, u a, a^2: right sides u and diagonals a
        self._square = self._freedom = 0.0
        self._counts, self._away = np.zeros(S), np.zeros(S)  # bearings, and sums of their 1 / distance^2
        self._noise = SensorNoise(S)
        self._verified = False  # whether three sensors saw a target within a window
        self._scale = np.zeros(2 * S)  # sums of squares of what a unit of each error is, in standard deviations

    def add(self, tracks: Tracks, stated: Sequence[StatedResiduals]) -> None:
        """Add the residuals at further estimates, in the order of time; nothing with fewer than two sensors.

        `stated`: residuals with the standard deviations that are stated, by target and sensor.
        """
        if len(self._sensors) < 2:
            return
        for target in np.unique([one.target for one in stated]).tolist():
            of = np.flatnonzero(tracks.target_id == target)
            parts = [one for one in stated if one.target == target and one.sensor in self._sensors]
            if len(of) > 2:
                self._add_target(tracks.take(of), [self._usable(one) for one in parts if len(one.residual)])

    def _usable(self, one: StatedResiduals) -> StatedResiduals:
        """Return a copy of the residuals without outliers and without bearings of very large standard deviation."""
        size = np.abs(one.residual)
        use = (size <= MAX_RESIDUAL * max(float(np.median(size)), MEDIAN)) & (one.sigma <= MAX_SIGMA_RAD) | one.touched
        columns = one.t_ns[use], one.residual[use], one.sigma[use], one.touched[use]
        return StatedResiduals(one.target, one.sensor, *columns)

    def _add_target(self, tracks: Tracks, parts: Sequence[StatedResiduals]) -> None:
        """Add the bearings of one target to the normal equations of the yaw and clock errors of all sensors.

        Residuals are linearised about the estimates, in windows of `WINDOW_S`; windows of fewer than 3 bearings, or of
        one sensor, are omitted.

        Args:
            tracks: estimates of the target, by time.
            parts: residuals of its bearings by sensor.
        """
        xy, first = np.column_stack([tracks.x, tracks.y]), tracks.t_ns[0]
        seconds = (tracks.t_ns - first) / NS
        # Errors of estimates follow the bearings; those of lines through neighbours are smoother
        path = local_lines(seconds, xy)
        found = [np.empty((0, 9))]
        for one in parts:
            at, n = np.searchsorted(tracks.t_ns, one.t_ns), self._number[one.sensor]
            origin = self._sensors[one.sensor].position[:2]
            residual, gradient = linearised_bearings(one, origin, xy[at], path[at])
            r2 = np.maximum(np.sum((xy[at] - origin) ** 2, axis=1), 1e-24)
            turn = np.sum(gradient * _velocities(seconds, path, seconds[at]), axis=1)
            sensor = np.full(len(at), float(n))
            columns = [seconds[at], sensor, residual, gradient, -turn, one.sigma, 1.0 / r2, one.touched]
            found.append(np.column_stack(columns))
        rows = np.concatenate(found)
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        for window in np.split(rows, np.flatnonzero(np.diff(rows[:, 0] // WINDOW_S)) + 1):
            # Next to a sensor the estimate is not linear in any of the bearings
            if len(window) > 2 and not window[:, 8].any():
                self._add_window(window)

    def _add_window(self, rows: Floats) -> None:
        """Add N bearings of one target in one window, with its position and velocity eliminated.

        Args:
            rows: (N, 9) time [s], number of the sensor, residual, its gradient by x and y, its derivative by the
                lateness of the clock [1/s] (all in standard deviations), the standard deviation [rad], 1 / r^2, and
                whether the target touches the sensor.
        """
        names, at = np.unique(rows[:, 1].astype(np.int64), return_inverse=True)
        if len(names) < 2:
            return
        # Eliminate position and velocity
        n, G, after = len(names), rows[:, 3:5], rows[:, 0] - rows[:, 0].mean()
        u, s, _ = np.linalg.svd(np.column_stack([G, G * after[:, None]]), full_matrices=False)
        u = u[:, s > MIN_RANK * s[0]]
        if u.shape[1] >= len(rows):
            return
        X = np.zeros((len(rows), 2 * n))
        X[np.arange(len(rows)), at] = 1.0 / rows[:, 6]
        X[np.arange(len(rows)), n + at] = rows[:, 5]
        columns = np.concatenate([names, len(self._sensors) + names])
        self._scale[columns] += np.sum(X**2, axis=0)
        np.add.at(self._counts, names[at], 1.0)
        np.add.at(self._away, names[at], rows[:, 7])
        self._verified |= n > 2
        self._noise.add(names[at], rows[:, 2], u)
        X, y = X - u @ (u.T @ X), rows[:, 2] - u @ (u.T @ rows[:, 2])
        normal, right = X.T @ X, X.T @ y
        self._normal[np.ix_(columns, columns)] += normal
        self._right[columns] += right
        diagonal = np.diag(normal)
        self._scatter[:, columns] += np.stack([right**2, right * diagonal, diagonal**2])
        self._square += float(y @ y)
        self._freedom += len(rows) - u.shape[1]

    def found(self) -> list[SensorError]:
        """Return the significant errors that are large enough to matter, the most significant first.

        They are selected one after the other, each given those before (forward selection), `MAX_FOUND` at most.
        """
        S = len(self._sensors)
        out: list[SensorError] = []
        if self._freedom < MIN_FREEDOM:
            return out
        names, taken = list(self._sensors), np.zeros(2 * S, dtype=np.bool_)
        noise = max(self._square / self._freedom, 1.0)
        while len(out) < MAX_FOUND and not taken.all():
            size, error = self._sizes(taken, noise)
            gain = np.where(error > 0.0, (size / np.where(error > 0.0, error, 1.0)) ** 2, 0.0)
            best = int(np.argmax(gain))
            if gain[best] < MIN_GAIN:
                break
            limit = self._limit(best)
            taken[best] = True
            if abs(size[best]) <= limit:
                continue
            rivals = np.flatnonzero((gain > gain[best] - RIVAL_GAIN) & (np.arange(2 * S) != best))
            one = SensorError(names[best % S], best // S, float(size[best]), float(error[best]), limit)
            out.append(one._replace(rivals=tuple((names[k % S], int(k // S)) for k in rivals.tolist())))
        return out

    def _sizes(self, taken: Bools, noise: float) -> tuple[Floats, Floats]:
        """Return sizes (2 S,) and standard errors (2 S,) of the possible errors of S sensors: S yaws, then S clocks.

        Each is estimated jointly with the errors selected. Both are 0 for selected errors, and for those that the data
        do not determine.

        Args:
            taken: (2 S,) whether an error is selected.
            noise: least variance factor of the residuals.
        """
        size, error = np.zeros(len(taken)), np.zeros(len(taken))
        base = np.flatnonzero(taken)
        right, diagonal = self._right.copy(), np.diag(self._normal).copy()
        if len(base):
            whole = np.linalg.pinv(self._normal[np.ix_(base, base)])
            right -= self._normal[:, base] @ whole @ self._right[base]
            diagonal -= np.einsum("ij,jk,ik->i", self._normal[:, base], whole, self._normal[:, base])
        usable = ~taken & (diagonal > MIN_SHARE_LEFT * self._scale) & (diagonal > 0.0)
        size[usable] = right[usable] / diagonal[usable]
        # Where windows scatter more than their noise says, by how much they do
        alone = np.divide(self._right, np.diag(self._normal), out=np.zeros(len(taken)), where=usable)
        squares, products, weights = self._scatter
        scatter = squares - 2.0 * alone * products + alone**2 * weights
        factor = np.divide(scatter, np.diag(self._normal), out=np.zeros(len(taken)), where=usable)
        error[usable] = np.sqrt(np.maximum(factor, noise)[usable] / diagonal[usable])
        return size, error

    def _limit(self, k: int) -> float:
        """Return the smallest size of error number `k` to report, by the noise of the sensor's bearings and pose.

        Numbers 0 to S - 1 are the yaws of the S sensors, S to 2 S - 1 their clocks.
        """
        S = len(self._sensors)
        n = k % S
        # Root mean square of the error's column: what a unit of it is in standard deviations
        unit = math.sqrt(self._scale[k] / max(self._counts[n], 1.0))
        limit = MIN_SHARE_OF_NOISE / unit if unit > 0.0 else math.inf
        return max(limit, self._stated_turn(n)) if k < S else limit

    def _stated_turn(self, n: int) -> float:
        """Return the error [rad] of bearings of sensor number `n` that the stated noise of its pose may cause."""
        sensor = list(self._sensors.values())[n]
        if not isinstance(sensor, Camera):
            return 0.0
        shift = sensor.sigma_position * math.sqrt(self._away[n] / max(self._counts[n], 1.0))
        return STATED_DEVIATIONS * math.hypot(sensor.sigma_yaw, shift)

    def noisy(self) -> list[tuple[str, float]]:
        """Return name and factor of each sensor with bearings that scatter by this factor times the stated deviation.

        The factor of the standard deviation is significant, and large enough to matter.
        """
        S, names = len(self._sensors), list(self._sensors)
        turns = np.array([self._stated_turn(n) for n in range(S)])
        limit = MAX_VARIANCE + turns**2 * self._scale[:S] / np.maximum(self._counts, 1.0)
        return [(names[n], math.sqrt(variance)) for n, variance in self._noise.found(limit)]

    def checks(self, unless: str = "", *, ranges: bool = False) -> tuple[Check, ...]:
        """Return the checks of systematic errors and of noise, with findings for single sensors.

        Errors of yaws and clocks make bearings scatter, too: noise is not judged where such an error is found.

        Args:
            unless: why the noise is not judged; empty: it is.
            ranges: stations measured, too, so that two sensors with bearings are not alone.
        """
        few = "too few bearings of three sensors at one time" if self._freedom < MIN_FREEDOM else ""
        found = outcome(SYSTEMATIC, () if few or (ranges and not self._verified) else self._findings(), unless=few)
        unless = unless or ("" if self._noise.judged else "too few bearings of several sensors within a second")
        unless = "a sensor is off" if any(check.status == "failed" for check in found) else unless
        noisy = () if unless else self.noisy()
        allowed = math.sqrt(MAX_VARIANCE)
        return *found, *outcome(
            NOISE,
            (
                finding(NOISE, "sensor-noise-small", sensors=[name], factor=factor, allowed=allowed)
                for name, factor in noisy
            ),
            unless=unless,
        )

    def _findings(self) -> Iterator[Check]:
        """Generate a finding for each significant error, with others that may be the true one instead.

        If tracks explain any error, as no three sensors see a target within one window, one finding says so.
        """
        if not self._verified:
            names = [name for name, n in zip(self._sensors, self._counts.tolist(), strict=True) if n]
            yield finding(SYSTEMATIC, "sensors-unverified", sensors=names)
            return
        for one in self.found():
            unit = math.pi / 180.0 if one.kind == TURNED else 1.0
            others = [f"{'the yaw' if kind == TURNED else 'the clock'} of {name}" for name, kind in one.rivals]
            yield finding(
                SYSTEMATIC,
                "sensor-turned" if one.kind == TURNED else "sensor-late",
                sensors=[one.sensor],
                size=one.size / unit,
                error=one.error / unit,
                **offset_words(one.size),
                allowed=one.noise / unit,
                rivals=rival_words([f"{name} is off" for name in others]),
            )


def rival_words(others: Sequence[str]) -> str:
    """Return other explanations of an error as text in parentheses, two at most; empty if there are none."""
    return f" (or {', or '.join(others[:2])})" if others else ""


def linearised_bearings(one: StatedResiduals, origin: Floats, xy: Floats, path: Floats) -> tuple[Floats, Floats]:
    """Return normalised residuals (N,) of bearings at positions of a path, and gradients (N, 2) of the bearings there.

    Args:
        one: N residuals of bearings of one sensor at estimates.
        origin: (2,) position of the sensor.
        xy: (N, 2) the estimates.
        path: (N, 2) positions of the path at these times.
    """
    away = xy - origin
    r2 = np.maximum(np.sum(away**2, axis=1), 1e-24)
    gradient = np.column_stack([-away[:, 1], away[:, 0]]) / r2[:, None] / one.sigma[:, None]
    return one.residual + np.sum(gradient * (xy - path), axis=1), gradient


def local_lines(seconds: Floats, xy: Floats) -> Floats:
    """Return (T, 2) positions smoothed by a line fitted to the positions within `HALF_STEP_S` of each.

    Args:
        seconds: (T,) times [s], increasing.
        xy: (T, 2) positions.
    """
    first = np.searchsorted(seconds, seconds - HALF_STEP_S - EPSILON_S)
    end = np.searchsorted(seconds, seconds + HALF_STEP_S + EPSILON_S)
    out = xy.copy()
    for n, (a, b) in enumerate(zip(first.tolist(), end.tolist(), strict=True)):
        if b - a > 2:
            after = seconds[a:b] - seconds[a:b].mean()
            slope = after @ xy[a:b] / max(float(after @ after), EPSILON_S**2)
            out[n] = xy[a:b].mean(axis=0) + (seconds[n] - seconds[a:b].mean()) * slope
    return out


def _velocities(seconds: Floats, xy: Floats, at: Floats) -> Floats:
    """Return (N, 2) velocities of a track at N times, by central differences over +-`HALF_STEP_S`.

    Args:
        seconds: (T,) times of the track [s], increasing.
        xy: (T, 2) its positions.
        at: (N,) times [s].
    """
    early = np.maximum(at - HALF_STEP_S, seconds[0])
    late = np.minimum(at + HALF_STEP_S, seconds[-1])
    span = np.maximum(late - early, EPSILON_S)
    return np.column_stack([(np.interp(late, seconds, c) - np.interp(early, seconds, c)) / span for c in xy.T])
