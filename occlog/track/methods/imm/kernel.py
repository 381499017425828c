"""Particle filter of several motion models for one target and unlabelled bearings ([Lee] Sec. 3.2-3.3).

L particles are moved under each of J models (Eq. 3.3) and weighed by each of N bearings, any
of which may be the target's (Eqs. 3.5-3.6); L are drawn again.  With w_m^i(l) the weight of
particle l of model m for bearing i, normalised over all three, the estimate is

    beta_m^i = sum_l w,  mu_m = sum_i beta_m^i,  mean = sum w x,

not that of Eqs. 3.7-3.11 as printed, which are no average of x.  Bearings are atan2 about
the sensor and differences are wrapped.  Every bearing is taken to be of this target: the
caller omits those of other targets and echoes, and `log_evidence` measures how well the
rest fits.

States are [x, vx, y, vy]; models are rows of `turns`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.geometry.camera import wrap_angle
from occlog.core.numerics.jit import array_kernel, kernel
from occlog.filtering.motion.coordinated_turn import move_under_all
from occlog.filtering.particles import systematic_ancestors

CHI2_95 = -2.0 * math.log(0.05)
"""5.991: squared radius of the ellipse that holds 95 % of a Gaussian in the plane."""
MIN_LOG_WEIGHT = -708.0
"""Weights are 0 below the exponential of this, the least that is a normal number."""
RANGE_SIGMAS = 2.0
"""Half width of the 95 % range of a bearing, as printed in [Lee] Eq. 3.15."""


class ImmParticles(NamedTuple):
    """L equally weighted particles [x, vx, y, vy] of a target after a step, each with its motion model in the step."""

    states: Floats  # (L, 4)
    models: Ints  # (L,) model each was moved under; read only if there are switching probabilities


class MotionModels(NamedTuple):
    """J motion models of a target for one step, with the noise of the step and switching probabilities.

    `models` (J, 3) has a lateral acceleration and one along x and y for each; `root` (2, 2) is the Cholesky factor of
    the noise of position and velocity per axis.
    """

    models: Floats  # (J, 3)
    root: Floats  # (2, 2) noise of this step
    switching: Floats | None = None  # (J, J) P(now v | before u), rows sum to 1; None: every model alike


class ImmNoise(NamedTuple):
    """Random numbers of one step of J models and L particles."""

    normals: Floats  # (J, L, 4) standard normal
    u: float  # from U[0, 1)
    picks: Floats  # (L,) from U[0, 1)


class Weights(NamedTuple):
    """Weights of L particles under J models after N bearings, and the log likelihood of the bearings."""

    each: Floats  # (N, J, L) w_m^i(l) of Eq. 3.6, sum 1
    total: Floats  # (J, L) sum over i; the weights before the bearings if missing
    log_evidence: float  # log of sum over i of the predicted density of bearing i [1/rad]; 0 if missing


class ModelEstimates(NamedTuple):
    """Weighted mean and covariance of [x, vx, y, vy] after a step, in total and for each of J motion models.

    Those of a model of zero weight are NaN.
    """

    mean: Floats  # (4,)
    covariance: Floats  # (4, 4)
    mu: Floats  # (J,) probability of each model, sum 1
    means: Floats  # (J, 4) of each model
    covariances: Floats  # (J, 4, 4) of each model


class ImmStep(NamedTuple):
    """Result of one filter step: particles, estimate, and the predicted particles with weights.

    The ellipses of [Lee] Eq. 3.16 are those of the predicted particles: `moments(predicted, prior)`.
    """

    cloud: ImmParticles
    estimate: ModelEstimates
    predicted: Floats  # (J, L, 4)
    prior: Floats  # (J, L) weights of the predicted particles before the bearings
    weights: Weights


def draw(rng: np.random.Generator, models: int, particles: int) -> ImmNoise:
    """Return the random numbers of one step for J = `models` models and L = `particles` particles."""
    return ImmNoise(rng.standard_normal((models, particles, 4)), float(rng.random()), rng.random(particles))


def step(
    cloud: ImmParticles,
    motion: MotionModels,
    dt: float,
    draws: ImmNoise,
    *,
    bearing: Floats,
    sigma: Floats,
    position: Floats,
) -> ImmStep:
    """Return the result of one step of the filter for one target and one sensor, [Lee] Eqs. 3.3-3.6.

    Args:
        cloud: the particles after the step before.
        motion: models and noise.
        dt: time since the step before [s].
        draws: random numbers, from `draw`.
        bearing: (N,) measured bearings [rad], in any order.
        sigma: (N,) standard deviations of the bearings [rad], > 0.
        position: (2,) position of the sensor.
    """
    # Propose: every particle under every model (Eq. 3.3)
    predicted = move_under_all(cloud.states, motion.models, dt, motion.root, draws.normals)
    prior = prior_weights(cloud.models, len(motion.models), motion.switching)
    # Weigh by every bearing (Eqs. 3.4-3.6)
    weights = update_weights(predicted, prior, bearing, sigma, position)
    # Resample: systematic
    rows, models = resample(weights.total, draws.u, draws.picks)
    cloud = ImmParticles(taken(predicted, models, rows), models)
    return ImmStep(cloud, moments(predicted, weights.total), predicted, prior, weights)


def prior_weights(models: Ints, count: int, switching: Floats | None) -> Floats:
    """Return (J, L) normalised weights of L particles moved under each of J models, before any bearing.

    Args:
        models: (L,) model of each particle in the step before.
        count: number J of models.
        switching: (J, J) probabilities of a model now (columns) given that before (rows); None: equal weights, as in
            [Lee].
    """
    if switching is None:
        return np.full((count, len(models)), 1.0 / (count * len(models)))
    return np.ascontiguousarray(switching[models].T) / len(models)


def update_weights(predicted: Floats, prior: Floats, bearing: Floats, sigma: Floats, position: Floats) -> Weights:
    """Return the weights of particles after the bearings of one sensor, [Lee] Eqs. 3.4-3.6 in the log domain.

    Args:
        predicted: (J, L, 4) particles [x, vx, y, vy].
        prior: (J, L) weights before.
        bearing: (N,) measured bearings [rad], in any order; without any the weights stay as they are.
        sigma: (N,) standard deviations [rad], > 0.
        position: (2,) position of the sensor.
    """
    if len(bearing) == 0:
        return Weights(np.zeros((0, *prior.shape)), prior, 0.0)
    x0, y0 = position
    # NumPy's arctan2 is several times as fast as that of a compiled loop.
    at = np.arctan2(predicted[..., 2] - y0, predicted[..., 0] - x0)
    each, top = _log_weights(at, prior, wrap_angle(bearing), sigma, np.log(sigma))
    total, mass = _times_prior(each, top, prior)
    each /= mass
    return Weights(each, total / mass, top + math.log(mass) - 0.5 * math.log(2.0 * math.pi))


@array_kernel
def _log_weights(at: Floats, prior: Floats, angle: Floats, sigma: Floats, scale: Floats) -> tuple[Floats, float]:
    """Return (N, J, L) log likelihoods of N bearings at particles, up to a constant, and the largest of all.

    They are -inf where the prior is 0, so that an impossible particle does not set the scale.

    Args:
        at: (J, L) bearings of the particles in [-pi, pi].
        prior: (J, L) weights.
        angle: (N,) measured bearings in [-pi, pi].
        sigma: (N,) standard deviations [rad].
        scale: (N,) logarithms of `sigma`.
    """
    N, (J, L) = angle.shape[0], prior.shape
    each = np.empty((N, J, L))
    top = -math.inf
    for i in range(N):
        for m in range(J):
            for l in range(L):  # noqa: E741 - the paper's letter
                off = abs(angle[i] - at[m, l])
                off = min(off, 2.0 * math.pi - off) / sigma[i]
                log_weight = -0.5 * off * off - scale[i] if prior[m, l] > 0.0 else -math.inf
                each[i, m, l] = log_weight
                top = max(top, log_weight)
    return each, top


@array_kernel
def _times_prior(each: Floats, top: float, prior: Floats) -> tuple[Floats, float]:
    """Convert log weights `each` (N, J, L) to weights times the prior (J, L), in place.

    Return their sums over the N bearings, (J, L), and the total. `top` is the largest log weight, taken as 0;
    exponentials of negligible weights are skipped.
    """
    N, J, L = each.shape
    total = np.zeros((J, L))
    mass = 0.0
    for i in range(N):
        for m in range(J):
            for l in range(L):  # noqa: E741 - the paper's letter
                log_weight = each[i, m, l] - top
                each[i, m, l] = math.exp(log_weight) * prior[m, l] if log_weight > MIN_LOG_WEIGHT else 0.0
                total[m, l] += each[i, m, l]
                mass += each[i, m, l]
    return total, mass


def moments(particles: Floats, weights: Floats) -> ModelEstimates:
    """Return mean and covariance of weighted particles, in total and for each of J motion models.

    `particles` (J, L, 4) are [x, vx, y, vy], `weights` (J, L) sum to 1. Those of a model of zero weight are NaN.
    """
    mu, means, covariances = _moments(particles, weights)
    some = mu > 0.0
    mean = mu[some] @ means[some]
    off = means[some] - mean
    covariance = np.einsum("m,mab->ab", mu[some], covariances[some]) + (mu[some] * off.T) @ off
    return ModelEstimates(mean, covariance, mu, means, covariances)


@array_kernel
def _moments(x: Floats, w: Floats) -> tuple[Floats, Floats, Floats]:
    """Return total weights (J,), means (J, 4) and covariances (J, 4, 4) of the particles of each of J models.

    `x` are (J, L, 4) particles, `w` (J, L) weights; mean and covariance are NaN for a model without weight.
    """
    J, L = w.shape
    mu, means, covariances = np.zeros(J), np.full((J, 4), math.nan), np.full((J, 4, 4), math.nan)
    for m in range(J):
        total = s0 = s1 = s2 = s3 = 0.0
        for l in range(L):  # noqa: E741 - the paper's letter
            total += w[m, l]
            s0 += w[m, l] * x[m, l, 0]
            s1 += w[m, l] * x[m, l, 1]
            s2 += w[m, l] * x[m, l, 2]
            s3 += w[m, l] * x[m, l, 3]
        mu[m] = total
        if not total > 0.0:
            continue
        m0, m1, m2, m3 = s0 / total, s1 / total, s2 / total, s3 / total
        c00 = c10 = c11 = c20 = c21 = c22 = c30 = c31 = c32 = c33 = 0.0
        for l in range(L):  # noqa: E741
            o0, o1, o2, o3 = x[m, l, 0] - m0, x[m, l, 1] - m1, x[m, l, 2] - m2, x[m, l, 3] - m3
            w0, w1, w2, w3 = w[m, l] * o0, w[m, l] * o1, w[m, l] * o2, w[m, l] * o3
            c00 += w0 * o0
            c10 += w1 * o0
            c11 += w1 * o1
            c20 += w2 * o0
            c21 += w2 * o1
            c22 += w2 * o2
            c30 += w3 * o0
            c31 += w3 * o1
            c32 += w3 * o2
            c33 += w3 * o3
        means[m] = np.array([m0, m1, m2, m3])
        lower = np.array([[c00, c10, c20, c30], [c10, c11, c21, c31], [c20, c21, c22, c32], [c30, c31, c32, c33]])
        covariances[m] = lower / total
    return mu, means, covariances


def resample(weights: Floats, u: float, picks: Floats) -> tuple[Ints, Ints]:
    """Return rows and models, (n,) each, of n particles drawn from (J, L) weights of sum 1.

    Rows are drawn systematically by their weight over all models, the model of each by a draw of its own. Without
    bearings every row is so kept exactly once, under any model.

    Args:
        weights: (J, L) weights of L particles under J models.
        u: one draw from U[0, 1).
        picks: (n,) draws from U[0, 1).
    """
    rows = systematic_ancestors(weights.sum(axis=0), len(picks), u)
    return rows, _models_of(weights, rows, picks)


@kernel
def taken(predicted: Floats, models: Ints, rows: Ints) -> Floats:
    """Return (n, 4) particles: predicted[models[i], rows[i]] of `predicted` (J, L, 4)."""
    out = np.empty((rows.shape[0], 4))
    for i in range(rows.shape[0]):
        for a in range(4):
            out[i, a] = predicted[models[i], rows[i], a]
    return out


@kernel
def _models_of(weights: Floats, rows: Ints, picks: Floats) -> Ints:
    """Return (n,) a model for each of `rows` (n,), drawn by the weights (J, L) of that row.

    `picks` (n,) are draws from U[0, 1). Models of zero weight are never drawn.
    """
    J, n = weights.shape[0], rows.shape[0]
    models = np.empty(n, dtype=np.int64)
    for i in range(n):
        whole = 0.0
        for m in range(J):
            whole += weights[m, rows[i]]
        point, passed, chosen = picks[i] * whole, 0.0, -1
        for m in range(J):
            w = weights[m, rows[i]]
            # The last with weight is taken where rounding lets the point be at the sum.
            if w > 0.0 and (chosen < 0 or passed <= point):
                chosen = m
            passed += w
        models[i] = max(chosen, 0)
    return models


def count_differs(bearings: int, objects: int) -> bool:
    """Return whether the number of bearings differs from that of the known targets, [Lee] Eq. 3.14."""
    return bearings != objects


def outside_ranges(mean: Floats, bearing: Floats, sigma: Floats, position: Floats) -> bool:
    """Return whether the bearing of an estimate is in no measured bearing's 95 % range, [Lee] Eq. 3.15, wrapped.

    True without bearings.

    Args:
        mean: (4,) estimate [x, vx, y, vy].
        bearing: (N,) measured bearings [rad].
        sigma: (N,) standard deviations [rad].
        position: (2,) position of the sensor.
    """
    expected = math.atan2(mean[2] - position[1], mean[0] - position[0])
    off = np.abs(wrap_angle(bearing - expected))
    return bool(np.all(off > RANGE_SIGMAS * sigma))


def outside_ellipses(mean: Floats, means: Floats, covariances: Floats) -> bool:
    """Return whether the position of an estimate is in no model's 95 % ellipse, [Lee] Eq. 3.16.

    Args:
        mean: (4,) estimate [x, vx, y, vy].
        means: (J, 4) means of the models' particles; a model with NaN has no ellipse.
        covariances: (J, 4, 4) covariances of the models' particles; without extent the ellipse is a line or a point.
    """
    for centre, covariance in zip(means[:, ::2], covariances[:, ::2, ::2], strict=True):
        if np.isnan(centre).any():
            continue
        values, axes = np.linalg.eigh(covariance)
        along = axes.T @ (mean[::2] - centre)
        # Lengths below rounding of the position count as none.
        reach = np.maximum(values, (1e-12 * (1.0 + np.abs(centre).max())) ** 2)
        if np.sum(along * along / reach) <= CHI2_95:
            return False
    return True


def position_sigma(covariance: Floats) -> float:
    """Return the root of the trace of the position covariance [length], from a (4, 4) covariance of [x, vx, y, vy]."""
    return math.sqrt(max(0.0, float(covariance[0, 0] + covariance[2, 2])))


def position_sigma_exceeds(covariance: Floats, limit: float) -> bool:
    """Return whether the root of the trace of the position covariance, of (4, 4) `covariance`, is above `limit`."""
    return position_sigma(covariance) > limit
