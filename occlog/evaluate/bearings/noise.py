"""Estimate the noise of bearings from the triangulation residuals of three or more sensors.

Two lines of sight in a plane always meet, n of them leave n - 2 degrees of freedom.  The squares of a scan's residuals
at the least-squares point, over their stated variances, sum up to S.  Where stated standard deviations are to be
multiplied by s, S / s^2 has a chi-squared distribution of n - 2 degrees; where a bearing is false, the square root of S
is anywhere up to the largest there is.  s and the share of scans with a false bearing are found by expectation
maximisation of this mixture, from the median of S over that of the distribution: s^2 is the sum of all S over that of
the degrees of freedom, each by the probability that the scan has no false bearing.

Errors of the poses are in it, as they are for a filter.  Errors common to all sensors are not.

Noise of each camera's readings, measured where the target's position is known ([Rahimi] Sec. 7), and a scene with it.

"We estimated Sigma_omega by averaging the measurement error at various known locations in the room, at various target
speeds."  The error of a reading holds everything: the image, the detector, and the faults of the camera's pose.
So in the scene that is written the errors of poses are 0, and `measurement_noise_px` is the standard deviation of
[Rahimi] Eq. 4.

Labelled bearings of each target in scans: rows that are so near in time that their lines of sight should meet.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, gammaln

from occlog.array_types import NS, Floats, Ints
from occlog.core.geometry import triangulate
from occlog.core.metrics.errors import Sum, group_medians, ratio_or_nan
from occlog.errors import InputError, option
from occlog.evaluate.errors.sums import median_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.observations import SensorObservationSet
from occlog.evaluate.matching.paths import SensorGeometry
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.scene import Scene
from occlog.records.tables import LAST, Bearings


class Scans(NamedTuple):
    """Complete scans of one target: groups of bearings of several sensors that are near in time.

    Attributes:
        target: its identity.
        rows: bearings in the order of time.
        starts: (S + 1,) first row of each of S scans, then the number of rows.
    """

    target: int
    rows: Bearings
    starts: Ints


def labelled(bearings: Bearings, config: EvaluateConfig) -> Bearings:
    """Return the rows that are detections with a target label, of sensors that are not held out."""
    return bearings.take(
        bearings.seen & (bearings.target_id >= 0) & ~np.isin(bearings.sensor, np.array(config.held_out, dtype=np.str_))
    )


class ScanCuts:
    """Groups the labelled bearings of a stream into scans; the result does not depend on the borders of its chunks."""

    def __init__(self, config: EvaluateConfig) -> None:
        """Create an empty buffer of rows, with the duration of a scan from the configuration."""
        self.window_ns = round(config.triangulation_window_s * NS)
        """Maximum duration of a scan."""
        self._held: dict[int, Bearings] = {}

    def update(self, rows: Bearings, end_ns: int) -> Iterator[Scans]:
        """Add rows, and generate for each target the scans that are now complete.

        Args:
            rows: labelled detections, not earlier than those of the call before.
            end_ns: no later row is before this time [ns]; `LAST`: no row follows.
        """
        held, self._held = self._held, {}
        for target in np.union1d(np.unique(rows.target_id), list(held)).astype(np.int64).tolist():
            own = rows.take(rows.target_id == target)
            own = Bearings.concat([held[target], own]) if target in held else own
            starts = scan_starts(own, self.window_ns)
            # The last scan may go on
            begin = int(starts[-2])
            if end_ns != LAST and end_ns <= int(own.t_ns[begin]) + self.window_ns:
                self._held[target] = own.take(slice(begin, None))
                own, starts = own.take(slice(0, begin)), starts[:-1]
            if len(own):
                yield Scans(target, own, starts)


def scan_starts(rows: Bearings, window_ns: int) -> Ints:
    """Divide the rows of one target into S scans; return the first row of each, then the number of rows (S + 1,).

    A scan lasts at most `window_ns` after its first row and holds each sensor at most once.
    """
    starts, begin, present = [0], 0, set[str]()
    times, sensors = rows.t_ns.tolist(), rows.sensor.tolist()
    for n, (t, sensor) in enumerate(zip(times, sensors, strict=True)):
        if n and (t - times[begin] > window_ns or sensor in present):
            starts.append(n)
            begin, present = n, set()
        present.add(sensor)
    return np.array([*starts, len(rows)] if len(rows) else [0], dtype=np.int64)


Metrics = dict[str, float]

MIN_SCANS = 20
"""Minimum number of scans to estimate noise from."""
INITIAL_OUTLIER_SHARE = 0.2
"""Share of scans with a false bearing initially."""
MIN_OUTLIER_RANGE_SIGMAS = 20.0
"""False bearings leave up to this many standard deviations at least: the tail of correct noise is no false bearing."""
MIN_SHARE, TINY = 1e-9, 1e-30
"""Neither share is less; nor is a square over its variance."""
STARTS, DECIDED = (1.0, 0.01, 0.0001), 10.0
"""The search begins at these shares of the median, in which most scans may have a false bearing; a later start counts
if its likelihood is greater by this logarithm."""
RELATIVE_TOLERANCE = 1e-5
"""The search ends where s^2 changes by less than this share of it, ..."""
ITERATIONS = 200
"""... or after this many steps."""


class NoiseFigures:
    """Estimates a common factor on the stated standard deviations of bearings, over a stream of scans.

    It is found from the residuals of lines of sight at their triangulated point, in scans of three sensors or more.
    """

    def __init__(self, config: EvaluateConfig, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Start without scans; up to `in_memory` numbers of each kind stay in memory."""
        self._config = config
        self._squares, self._degrees, self._sigma_px = (Spool(in_memory) for _ in range(3))

    def see(self, rows: Bearings) -> None:
        """Add the stated standard deviations [px] of labelled rows."""
        self._sigma_px.add(rows.sigma_px[np.isfinite(rows.sigma_px)])

    def update(self, scans: Scans, sensors: Mapping[str, SensorGeometry]) -> None:
        """Triangulate the scans of a target and add their residuals; `sensors`: by name."""
        origins = np.array([sensors[name].ground for name in scans.rows.sensor.tolist()]).reshape(-1, 2)
        squares, degrees = _misses(scans, origins, self._config)
        self._squares.add(squares)
        self._degrees.add(degrees.astype(np.float64))

    def result(self) -> Metrics:
        """Return number of scans, factor on the stated standard deviations, and the resulting noise [px], by name.

        The noise is NaN without pixels. Empty if no scan has three lines of sight that meet.
        """
        if not self._squares.count:
            return {}
        squares, degrees = self._squares.whole, self._degrees.whole
        if squares is not None and degrees is not None:
            scale = noise_scale(squares, degrees.astype(np.int64))
        else:
            scale = noise_scale_of_many(self._blocks, self._squares.count)
        known = self._sigma_px.count > 0
        return {
            "measurement_noise_scans": self._squares.count,
            "measurement_noise_scale": scale,
            "measurement_noise_px": scale * median_of(self._sigma_px) if known else float("nan"),
        }

    def _blocks(self) -> Iterator[tuple[Floats, Floats]]:
        return zip(self._squares.blocks(), self._degrees.blocks(), strict=True)


def noise_scale(squares: Floats, degrees: Ints, near: float | None = None) -> float:
    """Return the factor on the stated standard deviations that explains the residuals of scans.

    A mixture of scans with correct bearings (chi-square) and with false ones is fitted by expectation maximisation. NaN
    with fewer than `MIN_SCANS` scans.

    Args:
        squares: (S,) sum of squared residuals over stated variances, of each scan.
        degrees: (S,) degrees of freedom of each, >= 1.
        near: start of the fit, a factor known from most of the scans; None: starts from the median.
    """
    if len(squares) < MIN_SCANS:
        return float("nan")
    return noise_scale_of_many(lambda: [(squares, degrees.astype(np.float64))], len(squares), near)


def _points(degrees: Floats | Ints, chance: float) -> Floats:
    """Return the values (S,) that chi-square with `degrees` (S,) of freedom exceeds with the probability `chance`."""
    most = int(degrees.max(initial=1))
    return np.asarray(chdtri(np.arange(1, most + 1), chance)[degrees.astype(np.int64) - 1])


def noise_scale_of_many(
    blocks: Callable[[], Iterable[tuple[Floats, Floats]]], count: int, near: float | None = None
) -> float:
    """Return the factor on the stated standard deviations, as `noise_scale`, of data that is generated in blocks.

    Args:
        blocks: generates sums of squares (n,) and degrees of freedom (n,), the same at each call.
        count: number of all sums, at least `MIN_SCANS`.
        near: start of the fit, a factor known from most of the scans; None: starts from the median.
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


class NoiseFit(NamedTuple):
    """Local maximum of the likelihood of a mixture of measurement errors.

    Attributes:
        scale2: factor of the stated variances.
        log_likelihood: logarithm of the likelihood at the maximum.
    """

    scale2: float
    log_likelihood: float


def _fitted(blocks: Callable[[], Iterable[tuple[Floats, Floats]]], count: int, start: float, most: float) -> NoiseFit:
    """Fit the variance factor of a mixture of scans with and without a false bearing by expectation maximisation.

    Args:
        blocks: generates (sums of squared normalised residuals, their degrees of freedom); called once per iteration.
        count: number of all sums.
        start: initial variance factor.
        most: largest sum of squares, which limits the range of those with a false bearing.
    """
    scale2, false, reach = start, INITIAL_OUTLIER_SHARE, math.sqrt(max(most, MIN_OUTLIER_RANGE_SIGMAS**2 * start))
    for _ in range(ITERATIONS):
        total, expected, honest, fit = Sum(), Sum(), Sum(), Sum()
        for square, degree in blocks():
            density = (1.0 - false) * _density(square, degree, scale2)
            whole = density + false / reach
            inlier = density / whole
            total.add(float(np.dot(inlier, square)))
            expected.add(float(np.dot(inlier, degree)))
            honest.add(float(inlier.sum()))
            fit.add(float(np.log(whole).sum()))
        before, scale2 = scale2, max(total.value / max(expected.value, TINY), TINY * start)
        false = float(np.clip(1.0 - honest.value / count, MIN_SHARE, 1.0 - MIN_SHARE))
        if abs(scale2 - before) <= RELATIVE_TOLERANCE * before:
            break
    return NoiseFit(scale2, fit.value)


def _density(squares: Floats, degrees: Floats, scale2: float) -> Floats:
    """Return the densities (S,) of the roots of sums of squared residuals, without a false bearing.

    They have a scaled chi distribution.

    Args:
        squares: (S,) sums of squared residuals over stated variances.
        degrees: (S,) degrees of freedom.
        scale2: factor on the variances.
    """
    root = np.sqrt(np.maximum(squares / scale2, TINY))
    log_density = (degrees - 1.0) * np.log(root) - 0.5 * root**2 - (0.5 * degrees - 1.0) * math.log(2.0)
    return np.asarray(np.exp(log_density - gammaln(0.5 * degrees)) / math.sqrt(scale2))


def _misses(scans: Scans, origins: Floats, config: EvaluateConfig) -> tuple[Floats, Ints]:
    """Triangulate the scans of a target; return the squared residuals where three or more lines of sight meet.

    Args:
        scans: n bearings, grouped.
        origins: (n, 2) ground position of the sensor of each bearing.
        config: minimum angle between the lines.

    Returns:
        Sums (k,) of squared residuals over stated variances, and degrees of freedom (k,): number of lines minus 2.
    """
    rows, starts = scans.rows, scans.starts
    found = triangulate.triangulate(
        origins, rows.bearing, rows.sigma, starts=starts, loss="gauss", min_crossing=config.triangulation_min_angle
    )
    size = np.diff(starts)
    scan = np.repeat(np.arange(len(size)), size)
    good = (size > 2) & (found.status == triangulate.TRIANGULATED)
    each = np.where(good[scan], (found.residual / rows.sigma) ** 2, 0.0)
    return np.bincount(scan, weights=each, minlength=len(size))[good], size[good] - 2


MIN_READINGS = 60
"""Minimum number of readings of a camera to estimate its noise from."""
STRETCHES = 10
"""Sections of time that are skipped in turn for the error bar: errors of neighbouring frames are correlated."""
BIAS_SIGNIFICANCE = 3.0
"""A mean error of this many of its errors, and of half a standard deviation, is stated: the pose is off."""


class MeasuredNoise(NamedTuple):
    """Noise of the pixel measurements of one camera, from targets at known positions [px].

    `sigma`: standard deviation; `error`: its standard error; `bias`: mean residual; `bias_error`: standard error of
    that; `readings`: number of measurements.
    """

    sigma: float  # standard deviation about the truth
    error: float  # standard error of it
    bias: float  # mean
    bias_error: float
    readings: int


def measured_noise(residual_px: Floats) -> MeasuredNoise | None:
    """Return the noise of a camera's measurements, without false ones; None with fewer than `MIN_READINGS` of them.

    False measurements are excluded by the mixture of `noise_scale`. Standard errors are by a jackknife over `STRETCHES`
    intervals. `residual_px`: (n,) measured minus true [px], in the order of time.
    """
    n = len(residual_px)
    if n < MIN_READINGS:
        return None
    sigma = _sigma(residual_px)
    true = np.abs(residual_px) <= 4.0 * sigma
    parts = np.array_split(np.arange(n), STRETCHES)
    rest = [np.delete(residual_px, part) for part in parts]
    sigmas = np.array([_sigma(one, sigma) for one in rest])
    biases = np.array([one[np.abs(one) <= 4.0 * sigma].mean() for one in rest])
    return MeasuredNoise(sigma, _jackknife(sigmas), float(residual_px[true].mean()), _jackknife(biases), n)


def _measured_noise_of_many(residual_px: Spool) -> MeasuredNoise:
    """Return the noise of a camera's measurements, as `measured_noise`, from residuals [px] in a temporary file.

    The file is read several times, block by block. At least `MIN_READINGS` are needed.
    """
    n = residual_px.count
    # As `np.array_split` cuts them
    cuts = [n // STRETCHES * k + min(n % STRETCHES, k) for k in range(STRETCHES + 1)]
    spans = [(0, 0), *pairwise(cuts)]

    def without(first: int, stop: int) -> Iterator[Floats]:
        at = 0
        for block in residual_px.blocks():
            low, high = (min(max(cut - at, 0), len(block)) for cut in (first, stop))
            yield np.delete(block, slice(low, high))
            at += len(block)

    def scale(first: int, stop: int, near: float | None = None) -> float:
        def squares() -> Iterator[tuple[Floats, Floats]]:
            return ((one**2, np.ones(len(one))) for one in without(first, stop))

        return noise_scale_of_many(squares, n - (stop - first), near)

    whole = scale(*spans[0])
    sigmas = [whole, *(scale(*span, whole) for span in spans[1:])]

    def bias(first: int, stop: int) -> float:
        total, count = Sum(), 0
        for one in without(first, stop):
            true = one[np.abs(one) <= 4.0 * sigmas[0]]
            total.add(float(true.sum()))
            count += len(true)
        return ratio_or_nan(total.value, count)

    biases = [bias(*span) for span in spans]
    errors = (_jackknife(np.array(each[1:])) for each in (sigmas, biases))
    return MeasuredNoise(sigmas[0], next(errors), biases[0], next(errors), n)


def _sigma(residual_px: Floats, near: float | None = None) -> float:
    return noise_scale(residual_px**2, np.ones(len(residual_px), dtype=np.int64), near)


def _jackknife(without: Floats) -> float:
    """Return the jackknife standard error from estimates `without` (B,), each made without one of B parts of data."""
    B = len(without)
    return math.sqrt((B - 1) / B * float(((without - without.mean()) ** 2).sum()))


class NoiseFromTruth:
    """Accumulates residuals [px] of unoccluded targets at known positions, for each camera, over a stream."""

    def __init__(self, scene: Scene, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Start without readings.

        Args:
            scene: the cameras.
            in_memory: how many errors of all cameras are kept in memory; more go to files without names.
        """
        share = in_memory // max(len(scene.cameras), 1)
        self._residuals = {camera.name: Spool(share) for camera in scene.cameras}

    def update(self, observations: Mapping[str, SensorObservationSet]) -> None:
        """Add the residuals of further frames: of targets that should be visible and were reported.

        `observations`: by name of the sensor; sensors that are no cameras of the scene are skipped.
        """
        for name in observations.keys() & self._residuals.keys():
            own = observations[name].observations
            use = own.truth & own.visible & own.reported & np.isfinite(own.residual_px)
            # Labelled observations and those of candidates come one after the other, each in the order of time
            order = np.argsort(own.t_ns[use], kind="stable")
            self._residuals[name].add(own.residual_px[use][order])

    def noise(self) -> dict[str, MeasuredNoise]:
        """Return the measured noise of every camera with enough readings, by name.

        Raises:
            InputError: no camera has enough.
        """
        out = {}
        for name, residuals in self._residuals.items():
            whole = residuals.whole
            found = _measured_noise_of_many(residuals) if whole is None else measured_noise(whole)
            if found is not None and found.sigma > 0.0:
                out[name] = found
        if not out:
            raise InputError(
                f"{option('write_scene')}: no camera has {MIN_READINGS} bearings from images (u_px) of a visible "
                "target with a true position at that time; give more data",
                id="insufficient-data",
            )
        return out


def scene_with(scene: Scene, noise: Mapping[str, MeasuredNoise]) -> Scene:
    """Return the scene with the measured noise in the cameras that are in `noise` (by name), and pose errors of 0."""
    cameras = [
        replace(c, sigma_read_px=noise[c.name].sigma, sigma_position=0.0, sigma_yaw=0.0) if c.name in noise else c
        for c in scene.cameras
    ]
    return replace(scene, cameras=tuple(cameras))


def notes_of(scene: Scene, noise: Mapping[str, MeasuredNoise]) -> tuple[str, ...]:
    """Return notes for the user: cameras that keep their stated noise, and cameras with biased measurements."""
    kept = [c.name for c in scene.cameras if c.name not in noise]
    lines = []
    if kept:
        lines.append(
            f"{', '.join(kept)}: fewer than {MIN_READINGS} readings at known positions; the noise stays as it is stated"
        )
    for name, m in noise.items():
        if abs(m.bias) > max(BIAS_SIGNIFICANCE * m.bias_error, 0.5 * m.sigma):
            lines.append(
                f"warning: {name}: readings are {m.bias:+.2g} px off in the mean, of {m.sigma:.2g} px in all; its pose "
                "may be wrong, and no filter averages that out"
            )
    return tuple(lines)


def figures_of(noise: Mapping[str, MeasuredNoise]) -> dict[str, float]:
    """Return sigma, its standard error and the number of readings of each camera, by name of the figure."""
    out: dict[str, float] = {}
    for name, m in noise.items():
        out |= {
            f"noise_at_known_positions_sensor_{name}_px": m.sigma,
            f"noise_at_known_positions_error_sensor_{name}_px": m.error,
            f"noise_at_known_positions_readings_sensor_{name}": m.readings,
        }
    return out


def noise_comment(noise: Mapping[str, MeasuredNoise]) -> str:
    """Return comment lines (YAML) for a scene file that state the measured noise of each camera, by name."""
    lines = [
        "# noise measured at known positions (occlog evaluate), measurement_noise_px +- standard error (readings):"
    ]
    lines += [f"#   {name}: {m.sigma:.3g} +- {m.error:.2g} px ({m.readings})" for name, m in noise.items()]
    return "\n".join(lines) + "\n"
