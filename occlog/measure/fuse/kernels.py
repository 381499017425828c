"""Kernels of detection fusion ([Lee] Ch. 4): global decision by likelihood ratio, lines of sight, Kalman prediction.

All cameras search for one object. Arrays have N times and J cameras. A local detection is a ground position; a NaN row
is a frame without detection. A camera without a frame, or that cannot see the position, is excluded by `observing`.
Also: distances of lines of sight from a position, their intersection, and the state of a target between detections. R
lines each start at a sensor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.geometry.triangulate import TRIANGULATED, triangulate

Codes = NDArray[np.int8]

EDGE = 1e-12
"""Probabilities are kept this far from 0 and 1, so that every logarithm is finite (at most 27.6)."""

NOT_LOOKING = 0
NOTHING = 1
KEPT = 2
RECOVERED = 3
REMOVED_FALSE = 4
REMOVED_FAR = 5
CAUSES = (
    "camera did not look",
    "nothing detected, and no object declared",
    "detected near the global position",
    "missed by this camera, declared by the others",
    "no object declared",
    "far from the global position",
)
"""Meanings of the numbers in `FusionDecisions.cause`."""


class FusionDecisions(NamedTuple):
    """Global decision of [Lee] Ch. 4 at each of N times, and what becomes of each detection of J cameras.

    Attributes:
        declared: (N,) whether an object is declared (hypothesis G_1).
        value: (N,) natural-log odds of its presence (Eq. 4.13).
        xy: (N, 2) global position in scene units; NaN where no detection was used.
        prior: (N,) prior probability P_1 of its presence.
        quality: (N, J) quality W of each detection, 0 to 1; NaN without detection.
        cause: (N, J) index into `CAUSES`.
    """

    declared: Bools
    value: Floats
    xy: Floats
    prior: Floats
    quality: Floats
    cause: Codes

    @property
    def kept(self) -> Bools:
        """(N, J) mask of local detections that are kept."""
        return np.asarray(self.cause == KEPT)

    @property
    def recovered(self) -> Bools:
        """(N, J) mask of cameras that missed a declared object, to which the global position is assigned."""
        return np.asarray(self.cause == RECOVERED)

    @property
    def removed(self) -> Bools:
        """(N, J) mask of removed detections: no object is declared, or they are beyond the gate of its global position.

        With the cause REMOVED_FAR the camera still gets the global position of the declared object as its detection.
        """
        return np.asarray((self.cause == REMOVED_FALSE) | (self.cause == REMOVED_FAR))


def quality(positions: Floats, predicted: Floats, sigma: float) -> Floats:
    """(N, J) quality W in [0, 1] of local detections: Gaussian weight by distance from the prediction ([Lee] Eq. 4.20).

    NaN without detection; 1/2, which states nothing, where the prediction is unknown.

    Args:
        positions: (N, J, 2) ground positions detected by J cameras; NaN: none.
        predicted: (N, 2) predicted ground positions; NaN: unknown.
        sigma: standard deviation of detections from the prediction [length], > 0.
    """
    weight = np.exp(-_exponent(positions, predicted[:, None, :], sigma))
    known = _detected(predicted)[:, None]
    return np.where(_detected(positions), np.where(known, weight, 0.5), np.nan)


def fused_position(positions: Floats, predicted: Floats, sigma: float) -> Floats:
    """(N, 2) mean of the detections weighted by quality W; NaN with no detection ([Lee] Eq. 4.22).

    Weights are computed relative to the largest of the time, so that they do not all underflow for distant detections.
    Where the prediction is NaN the weights are equal.

    Args:
        positions: (N, J, 2) ground positions detected by J cameras; NaN: none.
        predicted: (N, 2) predicted ground positions; NaN: unknown.
        sigma: standard deviation of detections from the prediction [length], > 0.
    """
    detected = _detected(positions)
    exponent = np.where(detected, np.nan_to_num(_exponent(positions, predicted[:, None, :], sigma)), np.inf)
    least = np.min(exponent, axis=-1, keepdims=True, initial=np.inf)
    weight = np.exp(-(exponent - np.where(np.isfinite(least), least, 0.0)))
    total = weight.sum(axis=-1)[:, None]
    summed = (weight[..., None] * np.where(detected[..., None], positions, 0.0)).sum(axis=1)
    return np.where(total > 0.0, summed / np.where(total > 0.0, total, 1.0), np.nan)


def prior_present(fused: Floats, predicted: Floats, sigma: float, edge: float = EDGE) -> Floats:
    """(N,) prior probability P_1 = w(n) that the object is present, in [edge, 1 - edge] ([Lee] Eqs. 4.23-4.24).

    It is the Gaussian weight of the distance between both positions; 1/2 if one of them is NaN.

    Args:
        fused: (N, 2) global position.
        predicted: (N, 2) predicted position.
        sigma: standard deviation of detections from the prediction [length], > 0.
        edge: distance kept from 0 and 1, where P_1 / P_0 would be 0 or infinite.
    """
    weight = np.exp(-_exponent(fused, predicted, sigma))
    return np.clip(np.where(np.isfinite(weight), weight, 0.5), edge, 1.0 - edge)


def decision_value(
    detected: Bools,
    qualities: Floats,
    prior: ArrayLike,
    p_miss: ArrayLike,
    p_false: ArrayLike,
    observing: Bools | None = None,
    base: float = math.e,
    edge: float = EDGE,
) -> Floats:
    """(N,) log odds that an object is present, by qualities of detections; above 0 it is declared ([Lee] Eq. 4.13).

    A detection contributes log (1 - P_M)/P_F, the correct form of Eq. 4.11, where the thesis prints (1 - P_F)/P_F.
    Probabilities are clipped to [edge, 1 - edge], so that terms are finite. Without cameras the prior decides.

    Args:
        detected: (N, J) mask of detections.
        qualities: (N, J) quality W of each detection; ignored where nothing was detected.
        prior: P_1, probability that an object is present, one number or (N,).
        p_miss: P_M, probability of a missed detection, one number, (J,) or (N, J).
        p_false: P_F, probability of a false alarm, one number, (J,) or (N, J).
        observing: (N, J) mask of cameras that count; None: all.
        base: base of the logarithm; 10 for the values of the thesis' case studies.
        edge: distance of probabilities from 0 and 1.
    """
    weight = _log_odds(np.where(detected, qualities, 0.5), edge)
    return weighted_value(detected, weight, prior, p_miss, p_false, observing=observing, edge=edge) / math.log(base)


def weighted_value(
    detected: Bools,
    weight: Floats,
    prior: ArrayLike,
    p_miss: ArrayLike,
    p_false: ArrayLike,
    *,
    observing: Bools | None = None,
    edge: float = EDGE,
) -> Floats:
    """(N,) natural-log odds that an object is present: prior log odds plus one term for each of J cameras.

    A detection adds log (1 - P_M)/P_F + weight, a miss log P_M/(1 - P_F). With weight 0 this is [Lee] Eq. 4.3, with
    weight log W/(1 - W) Eq. 4.13. Above 0 the object is declared.

    Args:
        detected: (N, J) mask of detections.
        weight: (N, J) log odds added for each detection; ignored where nothing was detected.
        prior: probability that an object is present, one number or (N,).
        p_miss: P_M, probability of a missed detection, one number, (J,) or (N, J).
        p_false: P_F, probability of a false alarm, one number, (J,) or (N, J).
        observing: (N, J) mask of cameras that count; None: all.
        edge: probabilities are clipped to [edge, 1 - edge].
    """
    miss, false = (np.clip(np.asarray(p, dtype=np.float64), edge, 1.0 - edge) for p in (p_miss, p_false))
    hit_term = np.log1p(-miss) - np.log(false) + weight
    miss_term = np.log(miss) - np.log1p(-false)
    term = np.where(detected, hit_term, miss_term)
    if observing is not None:
        term = np.where(observing, term, 0.0)
    return np.asarray(_log_odds(np.asarray(prior, dtype=np.float64), edge) + term.sum(axis=-1))


def fuse(
    positions: Floats,
    predicted: Floats,
    sigma: float,
    p_miss: ArrayLike,
    p_false: ArrayLike,
    gate: float,
    observing: Bools | None = None,
    reach: float = math.inf,
) -> FusionDecisions:
    """Global decision at each time by [Lee] Eqs. 4.13 and 4.20-4.24, and classification of local detections.

    Without a detection no object is declared. The quality of a single detection is used twice, as W and as P_1: near
    the prediction it outvotes several misses. Without a prediction (NaN) all W and P_1 are 1/2: the rule of Eq. 4.3
    with equal priors.

    Args:
        positions: (N, J, 2) ground positions detected by J cameras; NaN: none.
        predicted: (N, 2) predicted ground positions; NaN: unknown.
        sigma: standard deviation of detections from the prediction [length], > 0.
        p_miss: P_M, probability of a missed detection, one number, (J,) or (N, J).
        p_false: P_F, probability of a false alarm, one number, (J,) or (N, J).
        gate: a detection farther than this from the global position of a declared object is removed [length].
        observing: (N, J) mask of cameras that count; detections of others are ignored. None: all.
        reach: a detection farther than this from the predicted position counts as missed in the decision and in the
            global position [length]. Infinite as in the thesis, where one far detection can outvote many good ones,
            because its log W/(1 - W) has no lower bound.
    """
    took_part = np.ones(positions.shape[:2], dtype=np.bool_) if observing is None else observing
    local = np.where(took_part[..., None], positions, np.nan)
    beyond = _distance(local, predicted[:, None, :]) > reach
    used = np.where(beyond[..., None], np.nan, local)
    xy = fused_position(used, predicted, sigma)
    prior = prior_present(xy, predicted, sigma)
    qualities = quality(local, predicted, sigma)
    detected = _detected(used)
    value = decision_value(detected, qualities, prior, p_miss, p_false, took_part)
    declared = (value > 0.0) & detected.any(axis=1)
    return FusionDecisions(declared, value, xy, prior, qualities, _causes(local, xy, declared, took_part, gate))


def _causes(positions: Floats, xy: Floats, declared: Bools, observing: Bools, gate: float) -> Codes:
    """(N, J) index into `CAUSES` for each camera at each time, as int8.

    Args:
        positions: (N, J, 2) ground positions detected by J cameras; NaN: none.
        xy: (N, 2) global positions.
        declared: (N,) mask of times at which an object is declared.
        observing: (N, J) mask of cameras that take part.
        gate: detections farther than this from the global position are removed [length].
    """
    far = _distance(positions, xy[:, None, :]) > gate
    if_declared = np.where(_detected(positions), np.where(far, REMOVED_FAR, KEPT), RECOVERED)
    if_not = np.where(_detected(positions), REMOVED_FALSE, NOTHING)
    cause = np.where(declared[:, None], if_declared, if_not)
    return np.where(observing, cause, NOT_LOOKING).astype(np.int8)


def _log_odds(p: Floats, edge: float) -> Floats:
    """Log odds log p/(1 - p), with p clipped to [edge, 1 - edge]."""
    inner = np.clip(p, edge, 1.0 - edge)
    return np.asarray(np.log(inner) - np.log1p(-inner))


def _exponent(a: Floats, b: Floats, sigma: float) -> Floats:
    """Exponents |a - b|^2 / (2 sigma^2) of Gaussian weights, for positions a and b (..., 2); shape (...)."""
    return np.asarray(((a - b) ** 2).sum(axis=-1) / (2.0 * sigma**2))


def _distance(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1]))


def _detected(positions: Floats) -> Bools:
    """Mask of shape (...) of positions (..., 2) with finite coordinates."""
    return np.asarray(np.isfinite(positions).all(axis=-1))


NEAREST = 1e-6
"""Positions this near to a sensor count as so far off [length]; they have no direction."""


class LocalDirections(NamedTuple):
    """R local detections as lines of sight on the ground, some with the distance of the object.

    Attributes:
        sensor: (R,) index of the sensor.
        origin: (R, 2) its ground position.
        azimuth, sigma: (R,) azimuth in the world and its standard deviation, above 0 [rad].
        distance, sigma_distance: (R,) distance along the ground and its standard deviation [length]; NaN: unknown.
    """

    sensor: Ints
    origin: Floats
    azimuth: Floats
    sigma: Floats
    distance: Floats
    sigma_distance: Floats

    def take(self, rows: Ints | Bools) -> LocalDirections:
        """The directions of a mask or of indices."""
        return LocalDirections(
            sensor=self.sensor[rows],
            origin=self.origin[rows],
            azimuth=self.azimuth[rows],
            sigma=self.sigma[rows],
            distance=self.distance[rows],
            sigma_distance=self.sigma_distance[rows],
        )


class PositionWithCovariance(NamedTuple):
    """Position (2,) on the ground with its covariance (2, 2), in the scene's length unit."""

    xy: Floats  # (2,)
    cov: Floats  # (2, 2)


def deviations(sight: LocalDirections, position: PositionWithCovariance) -> tuple[Floats, Floats]:
    """Offsets of R lines of sight from a position on the ground, and the variances of the lines themselves.

    The covariance of the position is not used.

    Returns:
        (R, 2) offsets across and along each line [length]; across is infinite for a line that points away from the
        position, along is 0 where the distance is unknown. (R, 2) variances of both [length^2].
    """
    away = position.xy - sight.origin
    r = np.maximum(np.hypot(away[:, 0], away[:, 1]), NEAREST)
    residual = wrap_angle(sight.azimuth - np.arctan2(away[:, 1], away[:, 0]))
    ahead = np.abs(residual) < 0.5 * np.pi
    across = np.where(ahead, r * np.sin(residual), np.inf)
    known = np.isfinite(sight.distance)
    along = np.where(known, sight.distance - r * np.cos(residual), 0.0)
    variance = np.column_stack([(r * sight.sigma) ** 2, np.where(known, sight.sigma_distance**2, 0.0)])
    return np.column_stack([across, along]), variance


def misfit(sight: LocalDirections, position: PositionWithCovariance, extra: float = 0.0) -> Floats:
    """(R,) squared Mahalanobis distances of R local detections from a position on the ground.

    Chi-square with one degree of freedom for a line of sight, two for one with a known distance; infinite for a line
    that points away. The covariances of detection and position are added, and `extra` [length^2] on both axes.
    """
    offset, variance = deviations(sight, position)
    c, s = np.cos(sight.azimuth), np.sin(sight.azimuth)
    turn = np.stack([np.column_stack([-s, c]), np.column_stack([c, s])], axis=1)  # rows: across, along
    both = turn @ (position.cov + extra * np.eye(2)) @ turn.transpose(0, 2, 1)
    both[:, 0, 0] += variance[:, 0]
    both[:, 1, 1] += variance[:, 1]
    finite = np.isfinite(offset[:, 0])
    a, b = np.where(finite, offset[:, 0], 0.0), offset[:, 1]
    xx, xy, yy = both[:, 0, 0], both[:, 0, 1], both[:, 1, 1]
    point = (yy * a * a - 2.0 * xy * a * b + xx * b * b) / np.maximum(xx * yy - xy * xy, 1e-300)
    known = np.isfinite(sight.distance)
    line = a * a / np.maximum(xx, 1e-300)
    return np.where(finite, np.where(known, point, line), np.inf)


def meet(sight: LocalDirections, min_crossing: float) -> PositionWithCovariance | None:
    """Position with covariance from the local detections of one object; None if they determine none.

    The intersection of the lines of sight (Gaussian errors) where they intersect; otherwise the inverse-covariance
    weighted mean of the detections with a known distance.

    Args:
        sight: local detections of one object.
        min_crossing: lines that cross at smaller angles do not intersect [rad].
    """
    rows = np.array([0, len(sight.azimuth)])
    found = triangulate(sight.origin, sight.azimuth, sight.sigma, rows, "gauss", min_crossing)
    if found.status[0] == TRIANGULATED:
        return PositionWithCovariance(found.xy[0], found.covariance[0])
    known = np.isfinite(sight.distance)
    if not known.any():
        return None
    xy, cov = points(sight.take(known))
    weight = np.linalg.inv(cov)
    total = np.linalg.inv(weight.sum(axis=0))
    return PositionWithCovariance(total @ np.einsum("rij,rj->i", weight, xy), total)


def points(sight: LocalDirections) -> tuple[Floats, Floats]:
    """Ground positions (R, 2) of R local detections with known distances, and their covariances (R, 2, 2)."""
    c, s = np.cos(sight.azimuth), np.sin(sight.azimuth)
    xy = sight.origin + sight.distance[:, None] * np.column_stack([c, s])
    across, along = (sight.distance * sight.sigma) ** 2, sight.sigma_distance**2
    xx, yy = along * c * c + across * s * s, along * s * s + across * c * c
    cross = (along - across) * c * s
    return xy, np.stack([xx, cross, cross, yy], axis=1).reshape(-1, 2, 2)


class MotionEstimate(NamedTuple):
    """State x, y, vx, vy of an object on the ground with nearly constant velocity, at the time `t_ns` [ns].

    Mean (4,) and covariance (4, 4), in the scene's length unit and seconds.
    """

    t_ns: int
    mean: Floats  # (4,)
    cov: Floats  # (4, 4)

    @property
    def position(self) -> PositionWithCovariance:
        """Position of the estimate, with its covariance."""
        return PositionWithCovariance(self.mean[:2], self.cov[:2, :2])


def begin(t_ns: int, position: PositionWithCovariance, speed: float) -> MotionEstimate:
    """Initiate a target at a position and time [ns]; velocity components are 0 with standard deviation `speed`."""
    cov = np.zeros((4, 4))
    cov[:2, :2], cov[2, 2], cov[3, 3] = position.cov, speed**2, speed**2
    return MotionEstimate(t_ns, np.append(position.xy, [0.0, 0.0]), cov)


def ahead(motion: MotionEstimate, t_ns: int, acceleration: float) -> MotionEstimate:
    """Predict the motion of an object to the time `t_ns` [ns] by nearly constant velocity ([Lee] Eq. 4.19).

    `acceleration` is the spectral density of white acceleration noise [length^2/s^3].
    """
    dt = (t_ns - motion.t_ns) * 1e-9
    step = np.eye(4)
    step[0, 2] = step[1, 3] = dt
    noise = acceleration * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return MotionEstimate(t_ns, step @ motion.mean, step @ motion.cov @ step.T + np.kron(noise, np.eye(2)))


def corrected_by_place(motion: MotionEstimate, position: PositionWithCovariance) -> MotionEstimate:
    """Kalman update of the motion of an object by a position measured at the time of the state."""
    return _corrected(motion, np.eye(2, 4), position.xy - motion.mean[:2], position.cov)


def corrected_by_line(motion: MotionEstimate, sight: LocalDirections) -> MotionEstimate:
    """Kalman update of the motion of an object by lines of sight measured at its time, one after the other.

    Distances of the detections are not used. Lines that point away from the object are omitted.
    """
    for row in range(len(sight.azimuth)):
        offset, variance = deviations(sight.take(np.array([row])), motion.position)
        away = motion.mean[:2] - sight.origin[row]
        beta = float(np.arctan2(away[1], away[0]))
        H = np.array([[-np.sin(beta), np.cos(beta), 0.0, 0.0]])
        if np.isfinite(offset[0, 0]):
            motion = _corrected(motion, H, offset[0, :1], variance[:1, :1])
    return motion


def _corrected(motion: MotionEstimate, H: Floats, innovation: Floats, R: Floats) -> MotionEstimate:
    """Kalman update (Joseph form) of the state x, y, vx, vy; its time is unchanged.

    Args:
        motion: predicted state.
        H: (m, 4) measurement matrix.
        innovation: (m,) measured minus predicted.
        R: (m, m) covariance of the measurement.
    """
    P = motion.cov
    gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    rest = np.eye(4) - gain @ H
    return MotionEstimate(motion.t_ns, motion.mean + gain @ innovation, rest @ P @ rest.T + gain @ R @ gain.T)
