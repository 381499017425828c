"""Likelihood of distance measurements: ranges, signal strengths, and range differences.

Each measurement has a mean m(x) at a position x on the ground and Gaussian noise of a standard deviation that does
not depend on x:

    range       z = |x - p|                              [length]
    logarithm   z = log |x - p|                          a signal strength under the log-distance path loss
    difference  z = |x - p| - |x - q|                    a time difference times the speed of propagation
    azimuth     z = atan2(y - p_y, x - p_x)              [rad], with a range: `occlog.filtering.likelihood.azimuth`

Distances are in space, |x - p|^2 = (x - p_x)^2 + (y - p_y)^2 + h^2, with h the height of the station over the target.
A signal strength P - 10 n log10(d) [dBm] has the mean (ln 10 / 10 n) (P - rssi) of log d, and a standard deviation
scaled alike (`occlog.core.geometry.path_loss.log_distance`), so that its likelihood is exact.

Residuals r = (z - m(x)) / sigma have the density of `occlog.filtering.likelihood.distances`: Gaussian, late, or
false.

Errors of measurements of distances: Gaussian ones, signals that came by a detour, and false ones.

With u the residual in standard deviations, a value of a range has the density

    f(u) = (1 - w) N(u; 0, 1) + w E(u) + N(k; 0, 1),
    E(u) = l exp(l^2 / 2 - l u) Phi(u - l),   l = sigma / L,

E the sum of a standard normal and an exponential of mean L / sigma: an exponentially modified Gaussian (Grushka 1972).
A share w of the signals has no free path and comes later by a length of mean L, never earlier.  Of a difference the
signal at either station may be late: with d the chance (1 - w)^2 neither is, and since the difference of two equal
exponentials has an exponential tail on each side, E(u) and E(-u) have (1 - d) / 2 each.  A strength cannot be late.

N(k) is the constant of values that are false (another's pulse): at k standard deviations, on the side that no detour
explains, a value is as likely false as true.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.radio_defaults import NLOS_BIAS_SIGMAS

from . import azimuth
from .measurement_model import MeasurementModel, StationPositions

LOG_ROOT_2PI = 0.5 * math.log(2.0 * math.pi)
MAX_EXPONENT = 700.0
"""Exponents are not above this."""


class DistanceErrors(NamedTuple):
    """Error model of m measurements of distances: Gaussian, late (or early) by a detour, or false; arrays (m,).

    `bend`: residual [standard deviations] at which a value is as likely false as true. `late`, `early`: probabilities
    of a delay on either side. `rate`: standard deviation over mean delay.
    """

    bend: Floats  # k, > 0
    late: Floats  # chance of E(u), 0 to 1
    early: Floats  # chance of E(-u)
    rate: Floats  # l, > 0

    @property
    def tailed(self) -> bool:
        """Return whether any signal may have come by a detour (non-line-of-sight)."""
        return bool(self.late.any() or self.early.any())

    def widened(self, variance: Floats) -> DistanceErrors:
        """Return the error model of residuals that are divided by the root of `variance` (..., m).

        The variance is that of the noise (1) plus that of an uncertain position.
        """
        return self._replace(rate=self.rate * np.sqrt(variance))


class ScoreAndInformation(NamedTuple):
    """Score and information of measurements by their residuals u, for iteratively reweighted least squares.

    Arrays (..., m) of the shape of u. `slope` is the derivative of -log f by u, `weight` the curvature that counts,
    `direct` the probability that a value is neither false nor came by a detour.
    """

    slope: Floats  # derivative of -log f by u
    weight: Floats  # curvature that counts: 1 of a value without a detour, 0 to 1 of one that has it, 0 of a false one
    direct: Floats  # probability that a value is neither false nor came by a detour


def without_detours(bend: Floats) -> DistanceErrors:
    """Return the error model of m measurements that are Gaussian or false, without detours.

    `bend` (m,) are the residuals, in standard deviations, at which a measurement is as likely false as true.
    """
    none = np.zeros(len(bend))
    return DistanceErrors(bend, none, none, np.ones(len(bend)))


def log_density(u: Floats, errors: DistanceErrors, variance: Floats | float = 1.0) -> Floats:
    """Return the logarithm (..., m) of sqrt(2 pi) f(u), with f the density of residuals u.

    f is a mixture of a Gaussian, of late signals (exponentially modified Gaussian) and of a constant for false values.

    Args:
        u: (..., m) residuals in standard deviations.
        errors: error model of the m measurements.
        variance: (..., m) of the Gaussian part, in units of that of the noise; above 1 where the position is uncertain.
    """
    false = -0.5 * errors.bend**2
    gauss = -0.5 * u**2 / variance - 0.5 * np.log(variance)
    if not errors.tailed:
        return np.asarray(np.logaddexp(gauss, false))
    late, early = _tails(u, errors, variance)
    return np.asarray(np.logaddexp(np.logaddexp(_log_direct(errors) + gauss, false), np.logaddexp(late, early)))


def inlier_probability(u: Floats, errors: DistanceErrors) -> Floats:
    """Return (..., m) probabilities that measurements are neither false nor came by a detour.

    `u` (..., m) are residuals in standard deviations.
    """
    own = _log_direct(errors) - 0.5 * u**2
    others = np.broadcast_to(-0.5 * errors.bend**2, np.shape(own))
    if errors.tailed:
        others = np.logaddexp(others, np.logaddexp(*_tails(u, errors, 1.0)))
    return np.asarray(1.0 / (1.0 + np.exp(np.minimum(others - own, MAX_EXPONENT))))


def score_and_information(u: Floats, errors: DistanceErrors) -> ScoreAndInformation:
    """Return score and information of residuals `u` (..., m) in standard deviations, and their inlier probability.

    The score is the derivative of -log f. The information is the expected curvature over the components (direct, late,
    false), which is nonnegative; what is lost because the component is unknown is neglected, as usual.
    """
    own = inlier_probability(u, errors)
    if not errors.tailed:
        return ScoreAndInformation(own * u, own, own)
    whole = log_density(u, errors)
    late, early = (np.exp(part - whole) for part in _tails(u, errors, 1.0))
    after, after_bend = _tail_pull(u, errors.rate)
    before, before_bend = _tail_pull(-u, errors.rate)
    return ScoreAndInformation(
        own * u + late * after - early * before, own + late * after_bend + early * before_bend, own
    )


def _log_direct(errors: DistanceErrors) -> Floats:
    """Return (m,) logs of the probabilities that signals come without a detour."""
    return np.log1p(-np.minimum(errors.late + errors.early, 1.0 - 1e-12))


def _tails(u: Floats, errors: DistanceErrors, variance: Floats | float) -> tuple[Floats, Floats]:
    """Return log densities, times sqrt(2 pi), of the components of late and of early signals; -inf if absent.

    Args:
        u: (..., m) residuals in standard deviations.
        errors: shares and rate of both components.
        variance: variance of the Gaussian part, in the squared unit of u.
    """
    with np.errstate(divide="ignore"):
        late, early = np.log(errors.late), np.log(errors.early)
    return late + _log_tail(u, errors.rate, variance), early + _log_tail(-u, errors.rate, variance)


def _log_tail(u: Floats, rate: Floats, variance: Floats | float) -> Floats:
    """Return the log of sqrt(2 pi) E(u), the density of a normal plus an exponential variable at u (..., m).

    Args:
        u: (..., m) residuals in standard deviations.
        rate: (m,) rate of the exponential in this unit.
        variance: variance of the normal variable, in the squared unit of u.
    """
    root = np.sqrt(variance)
    return np.asarray(
        LOG_ROOT_2PI + np.log(rate) + 0.5 * rate**2 * variance - rate * u + log_ndtr(u / root - rate * root)
    )


def _tail_pull(u: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """Return the first and second derivative of -log E(u) by u, the second limited to 0 to 1.

    They are l - h and h (h + t), with t = u - l and h = N(t) / Phi(t), l the `rate` of the exponential; arrays (...,
    m).
    """
    t = u - rate
    h = np.exp(-0.5 * t**2 - LOG_ROOT_2PI - log_ndtr(t))
    return rate - h, np.clip(h * (h + t), 0.0, 1.0)


RANGE, LOGARITHM, DIFFERENCE = 0, 1, 2
"""Kinds of measurements."""
NEAREST = 1e-9
"""Squares of distances are not below this, so that a position at a station gives finite numbers."""


class RangeMeasurements(NamedTuple):
    """m measurements of distances of one target (ranges, logarithms, differences, azimuths), with error parameters."""

    kind: Ints  # (m,) index of `MODELS`: RANGE, LOGARITHM, DIFFERENCE, ...
    value: Floats  # (m,) z
    sigma: Floats  # (m,) > 0
    position: Floats  # (m, 2) of the station, p
    rise2: Floats  # (m,) square of its height over the target
    other: Floats  # (m, 2) q of a difference; else that of the station
    other_rise2: Floats  # (m,)
    station: Ints  # (m,) number of the station
    bend: float = 3.7  # standard deviations at which a measurement is as likely false as true
    late: float = 0.0  # share of signals that come by a detour, 0 to 1
    detour: float = math.nan  # mean length of detours; NaN: `NLOS_BIAS_SIGMAS` standard deviations of each measurement
    bias: float = (
        0.0  # standard deviation of a constant error of each station's ranges, to be estimated; 0: there is none
    )

    def take(self, rows: Bools | Ints | slice) -> RangeMeasurements:
        """Return the measurements selected by a mask or indices; the error parameters stay."""
        own = (self.kind, self.value, self.sigma, self.position, self.rise2, self.other, self.other_rise2, self.station)
        return RangeMeasurements._make((*(column[rows] for column in own), *self[COLUMNS:]))

    @property
    def geometry(self) -> StationPositions:
        """Return the positions of the stations of the measurements."""
        return StationPositions(self.position, self.rise2, self.other, self.other_rise2)

    @property
    def errors(self) -> DistanceErrors:
        """Return the error model of the m measurements, by their kinds.

        Ranges may be late; strengths and azimuths cannot; a difference may be too long or too short.
        """
        differs = self.kind == DIFFERENCE
        either = 0.5 * self.late * (2.0 - self.late)
        late = np.where(differs, either, np.where(DELAYED[self.kind], self.late, 0.0))
        rate = np.full(len(self.kind), 1.0 / NLOS_BIAS_SIGMAS) if math.isnan(self.detour) else self.sigma / self.detour
        return DistanceErrors(np.full(len(self.kind), self.bend), late, np.where(differs, either, 0.0), rate)


COLUMNS = 8
"""Fields of `RangeMeasurements` that have a value for each measurement."""


class LinearisedDistances(NamedTuple):
    """Residuals (L, m) and gradients (L, m, 2) of m measurements at L positions, in standard deviations."""

    residual: Floats  # (L, m) r
    gradient: Floats  # (L, m, 2) of m(x) / sigma


def concat(parts: list[RangeMeasurements]) -> RangeMeasurements:
    """Return several sets of measurements as one, in order; the error parameters are those of the last set."""
    columns = (np.concatenate(column) for column in zip(*(part[:COLUMNS] for part in parts), strict=True))
    return RangeMeasurements._make((*columns, *parts[-1][COLUMNS:]))


def no_measurements(bend: float, late: float = 0.0, detour: float = math.nan) -> RangeMeasurements:
    """Return an empty set of measurements with given error parameters.

    Args:
        bend: residual, in standard deviations, beyond which a measurement is rather false.
        late: share of late (non-line-of-sight) signals.
        detour: mean detour of late signals [length]; NaN: by default.
    """
    none, no_position, whole = np.empty(0), np.empty((0, 2)), np.empty(0, dtype=np.int64)
    return RangeMeasurements(whole, none, none, no_position, none, no_position, none, whole, bend, late, detour)


def linearise(rows: RangeMeasurements, xy: Floats) -> LinearisedDistances:
    """Return residuals and gradients of m measurements `rows` at L positions `xy` (L, 2).

    Both are in standard deviations of the measurements; gradients are those of the expected values.
    """
    return LinearisedDistances(*_residual(rows, xy[:, None, :]))


def residuals(rows: RangeMeasurements, xy: Floats) -> Floats:
    """Return (L, m) residuals of m measurements `rows` at L positions `xy` (L, 2), in standard deviations."""
    return linearise(rows, xy).residual


def log_likelihood(rows: RangeMeasurements, xy: Floats) -> Floats:
    """Return (L,) log-likelihoods of m measurements `rows` at positions `xy` (L, 2): log prod f(r) / sigma."""
    each = log_density(residuals(rows, xy), rows.errors) - LOG_ROOT_2PI - np.log(rows.sigma)
    return np.asarray(each.sum(axis=1))


def residuals_at_own_position(rows: RangeMeasurements, xy: Floats) -> tuple[Floats, Floats]:
    """Return residuals (m,) and gradients (m, 2) of m measurements, each at its own position of `xy` (m, 2).

    Both are in standard deviations.
    """
    return _residual(rows, xy)


def information(rows: RangeMeasurements, xy: Floats) -> Floats:
    """Return (m, 2, 2) Fisher information of m measurements about their own true positions `xy` (m, 2), if inliers."""
    gradient = residuals_at_own_position(rows, xy)[1]
    return np.asarray(gradient[:, :, None] * gradient[:, None, :])


def _residual(rows: RangeMeasurements, xy: Floats) -> tuple[Floats, Floats]:
    """Return residuals (..., m) of m measurements and gradients (..., m, 2) of their expected values.

    Both are in standard deviations. `xy` are positions (..., m, 2), one for each measurement, or (..., 1, 2), one for
    all.
    """
    kinds = np.unique(rows.kind).tolist()
    if len(kinds) == 1:
        mean, gradient = MODELS[kinds[0]].predict(xy, rows.geometry)
    else:
        shape = np.broadcast_shapes(xy.shape[:-1], rows.kind.shape)
        mean, gradient = np.empty(shape), np.empty((*shape, 2))
        for kind in kinds:
            own = rows.kind == kind
            at = xy if xy.shape[-2] == 1 else xy[..., own, :]
            mean[..., own], gradient[..., own, :] = MODELS[kind].predict(
                at, StationPositions(*(c[own] for c in rows.geometry))
            )
    off = rows.value - mean
    angular = ANGULAR[rows.kind]
    if angular.any():
        off = np.where(angular, wrap_angle(off), off)
    return off / rows.sigma, gradient / rows.sigma[:, None]


def _range(xy: Floats, at: StationPositions) -> tuple[Floats, Floats]:
    """Return distances (..., m) of positions from m stations, and their gradients (..., m, 2)."""
    return _distance(xy, at.position, at.rise2)


def _logarithm(xy: Floats, at: StationPositions) -> tuple[Floats, Floats]:
    """Return natural logs (..., m) of the distances of positions from m stations, and their gradients (..., m, 2)."""
    far, slope = _distance(xy, at.position, at.rise2)
    return np.log(far), slope / far[..., None]


def _difference(xy: Floats, at: StationPositions) -> tuple[Floats, Floats]:
    """Return (..., m) distances from m stations minus those from their references, and gradients (..., m, 2)."""
    far, slope = _distance(xy, at.position, at.rise2)
    other, other_slope = _distance(xy, at.other, at.other_rise2)
    return far - other, slope - other_slope


def _distance(xy: Floats, position: Floats, rise2: Floats) -> tuple[Floats, Floats]:
    """Return distances (..., m) of positions from m stations in space, and their gradients (..., m, 2) by the position.

    Args:
        xy: (..., m or 1, 2) positions on the ground.
        position: (m, 2) stations on the ground.
        rise2: (m,) squared differences of height.
    """
    away = xy - position
    distance = np.sqrt(np.maximum(away[..., 0] ** 2 + away[..., 1] ** 2 + rise2, NEAREST))
    return distance, away / distance[..., None]


MODELS = (
    MeasurementModel(_range, compiled=2, delayed=True),
    MeasurementModel(_logarithm, compiled=3),
    MeasurementModel(_difference, compiled=4, delayed=True),
    azimuth.MODEL,
)
"""Measurement models by kind."""
ANGULAR = np.array([model.angular for model in MODELS])
DELAYED = np.array([model.delayed for model in MODELS])
COMPILED = np.array([model.compiled for model in MODELS])
"""Fields of them, by kind."""
PLAIN = {model.column: kind for kind, model in enumerate(MODELS) if model.column is not None}
"""Kinds of columns with values used unchanged."""
