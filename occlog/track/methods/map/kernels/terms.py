"""Values and derivatives of the terms of a trajectory's cost; see `occlog.track.methods.map.kernels.problem`."""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats
from occlog.core.numerics.jit import kernel

from .problem import CAUCHY, HUBER, MIXTURE, BearingLinesByStep, ChainSteps, HalfPlanes, QuadraticPriors

TINY = 1e-150
"""Squares of distances are not below this, so that a state in a camera gives large numbers, not none."""


@kernel
def log_odds_offset(k: float, lean: float) -> float:
    """Return the parameter k' of the mixture loss for log odds that are shifted by `lean`.

    With parameter k the log odds of a true bearing at residual 0 are k^2 / 2; k' |k'| / 2 is k^2 / 2 + `lean`, so that
    k' is negative where that sum is.
    """
    if lean == 0.0:
        return k
    k2 = k * k + 2.0 * lean
    return math.copysign(math.sqrt(abs(k2)), k2)


@kernel
def loss_value(r: float, loss: int, k: float) -> float:
    """Return the loss of a residual r [standard deviations], as a negative log likelihood up to a constant.

    `loss` is SQUARE, HUBER, CAUCHY or MIXTURE, `k` its parameter; the mixture's may be negative, as `log_odds_offset`
    gives it.
    """
    if loss == HUBER and abs(r) > k:
        return k * (abs(r) - 0.5 * k)
    if loss == CAUCHY:
        return 0.5 * k * k * math.log1p((r / k) ** 2)
    if loss == MIXTURE:
        # log(1 + e^a) - log(1 + e^b), a the log odds that the line is true at r, b those at 0
        k2 = k * abs(k)
        a, b = 0.5 * (k2 - r * r), 0.5 * k2
        return max(b, 0.0) + math.log1p(math.exp(-abs(b))) - (max(a, 0.0) + math.log1p(math.exp(-abs(a))))
    return 0.5 * r * r


@kernel
def inlier_probability(r: float, k: float) -> float:
    """Return the probability that a bearing with residual r [standard deviations] is true, by the mixture loss.

    It is 1/2 at |r| = k; a negative k means log odds of -k^2 / 2 at r = 0.
    """
    a = 0.5 * (k * abs(k) - r * r)
    return 1.0 / (1.0 + math.exp(-a)) if a >= 0.0 else math.exp(a) / (1.0 + math.exp(a))


@kernel
def loss_slopes(r: float, loss: int, k: float) -> tuple[float, float, float]:
    """Return the first and second derivative of the loss at residual r, and the IRLS weight (first derivative over r).

    `loss` is SQUARE, HUBER, CAUCHY or MIXTURE, `k` its parameter [standard deviations].
    """
    if loss == HUBER and abs(r) > k:
        return math.copysign(k, r), 0.0, k / abs(r)
    if loss == CAUCHY:
        q = 1.0 + (r / k) ** 2
        return r / q, (1.0 - (r / k) ** 2) / (q * q), 1.0 / q
    if loss == MIXTURE:
        w = inlier_probability(r, k)
        return w * r, w - w * (1.0 - w) * r * r, w
    return r, 1.0, 1.0


@kernel
def in_camera(lines: BearingLinesByStep, n: int, X: Floats) -> tuple[float, float]:
    """Return the position of bearing `n`'s state in its sensor's frame: offset h left of the axis, distance d along it.

    X (T, 4) are states x, vx, y, vy; the axis is the optical axis, or the measured direction.
    """
    t = lines.step[n]
    dx, dy = X[t, 0] - lines.position[n, 0], X[t, 2] - lines.position[n, 1]
    c, s = lines.axis[n, 0], lines.axis[n, 1]
    return c * dy - s * dx, c * dx + s * dy


@kernel
def residual(lines: BearingLinesByStep, n: int, h: float, d: float) -> float:
    """Return the residual of bearing `n`, in standard deviations, for a state at offset `h` and distance `d`.

    `h` is to the left of the bearing's axis, `d` along it.
    """
    if lines.direction[n]:
        return math.atan2(h, d) / math.sqrt(lines.c0[n])
    missed: float = lines.focal[n] * h - lines.reading[n] * d
    return missed / math.sqrt(max(lines.c0[n] * d * d + lines.c1[n], TINY))


@kernel
def residuals(lines: BearingLinesByStep, X: Floats) -> Floats:
    """Return (N,) residuals of all bearings at states X (T, 4), in standard deviations."""
    out = np.empty(lines.step.shape[0])
    for n in range(out.shape[0]):
        h, d = in_camera(lines, n, X)
        out[n] = residual(lines, n, h, d)
    return out


@kernel
def losses(lines: BearingLinesByStep, X: Floats, loss: int, k: float) -> Floats:
    """Return (N,) losses of all bearings at states X (T, 4).

    `loss` is SQUARE, HUBER, CAUCHY or MIXTURE, `k` its parameter [standard deviations].
    """
    out = np.empty(lines.step.shape[0])
    for n in range(out.shape[0]):
        h, d = in_camera(lines, n, X)
        out[n] = loss_value(residual(lines, n, h, d), loss, log_odds_offset(k, lines.lean[n]))
    return out


@kernel
def inlier_probabilities(lines: BearingLinesByStep, X: Floats, k: float) -> Floats:
    """Return (N,) probabilities that bearings are true at states X (T, 4), by the mixture loss: 1/2 at residual k.

    0 behind the camera of a pixel reading.
    """
    out = np.empty(lines.step.shape[0])
    for n in range(out.shape[0]):
        h, d = in_camera(lines, n, X)
        out[n] = (
            inlier_probability(residual(lines, n, h, d), log_odds_offset(k, lines.lean[n]))
            if d > 0.0 or lines.direction[n]
            else 0.0
        )
    return out


@kernel
def depths(lines: BearingLinesByStep, X: Floats) -> Floats:
    """Return (N,) distances of the states in X (T, 4) along the axis of each bearing; negative behind the sensor."""
    out = np.empty(lines.step.shape[0])
    for n in range(out.shape[0]):
        out[n] = in_camera(lines, n, X)[1]
    return out


@kernel
def lines_cost(lines: BearingLinesByStep, X: Floats, loss: int, k: float) -> float:
    """Return the cost of all bearings at states X (T, 4): losses, log standard deviations and volume terms.

    `loss` is SQUARE, HUBER, CAUCHY or MIXTURE, `k` its parameter [standard deviations]; inf behind a camera with a
    volume term.
    """
    total = 0.0
    for n in range(lines.step.shape[0]):
        h, d = in_camera(lines, n, X)
        total += loss_value(residual(lines, n, h, d), loss, log_odds_offset(k, lines.lean[n]))
        if lines.volume[n] > 0.0:
            total += -lines.volume[n] * math.log(d) if d > 0.0 else math.inf
        if lines.c1[n] > 0.0 and lines.c0[n] > 0.0:
            total += 0.5 * math.log(lines.c0[n] + lines.c1[n] / (d * d))
    return total


@kernel
def chain_cost(steps: ChainSteps, X: Floats) -> float:
    """Return the cost of the first state's prior and of the motion steps at states X (T, 4) x, vx, y, vy."""
    total = 0.0
    for i in range(4):
        e = 0.0
        for j in range(i + 1):
            e += steps.whiten_first[i, j] * (X[0, j] - steps.mean[j])
        total += 0.5 * e * e
    nu = np.empty(4)
    for t in range(steps.kind.shape[0]):
        A, W = steps.A[steps.kind[t]], steps.whiten[steps.kind[t]]
        for i in range(4):
            nu[i] = X[t + 1, i] - A[i, 0] * X[t, 0] - A[i, 1] * X[t, 1] - A[i, 2] * X[t, 2] - A[i, 3] * X[t, 3]
        for i in range(4):
            e = 0.0
            for j in range(i + 1):
                e += W[i, j] * nu[j]
            total += 0.5 * e * e
    return total


@kernel
def add_chain(steps: ChainSteps, X: Floats, g: Floats) -> None:
    """Add the gradient of the motion chain's cost at states X (T, 4) to `g` (T, 4), in place."""
    e = np.empty(4)
    for i in range(4):
        e[i] = 0.0
        for j in range(i + 1):
            e[i] += steps.whiten_first[i, j] * (X[0, j] - steps.mean[j])
    for i in range(4):
        for j in range(i + 1):
            g[0, j] += steps.whiten_first[i, j] * e[i]
    nu, w = np.empty(4), np.empty(4)
    for t in range(steps.kind.shape[0]):
        A, U = steps.A[steps.kind[t]], steps.whiten[steps.kind[t]]
        for i in range(4):
            nu[i] = X[t + 1, i] - A[i, 0] * X[t, 0] - A[i, 1] * X[t, 1] - A[i, 2] * X[t, 2] - A[i, 3] * X[t, 3]
        w[:] = 0.0
        for i in range(4):
            e[i] = 0.0
            for j in range(i + 1):
                e[i] += U[i, j] * nu[j]
            for j in range(i + 1):
                w[j] += U[i, j] * e[i]
        for i in range(4):
            g[t + 1, i] += w[i]
            g[t, i] -= A[0, i] * w[0] + A[1, i] * w[1] + A[2, i] * w[2] + A[3, i] * w[3]


@kernel
def priors_cost(hints: QuadraticPriors, X: Floats) -> float:
    """Return the sum of the quadratic terms of positions at states X (T, 4)."""
    total = 0.0
    for m in range(hints.step.shape[0]):
        t = hints.step[m]
        dx, dy = X[t, 0] - hints.position[m, 0], X[t, 2] - hints.position[m, 1]
        bent = hints.bend[m, 0] * dx * dx + 2.0 * hints.bend[m, 1] * dx * dy + hints.bend[m, 2] * dy * dy
        total += hints.slope[m, 0] * dx + hints.slope[m, 1] * dy + 0.5 * bent
    return total


@kernel
def add_priors(hints: QuadraticPriors, X: Floats, g: Floats, H: Floats) -> None:
    """Add the derivatives of the quadratic terms of positions at X (T, 4) to `g` (T, 4) and `H` (T, 3), in place.

    `H` is the Hessian by position: xx, xy, yy.
    """
    for m in range(hints.step.shape[0]):
        t = hints.step[m]
        dx, dy = X[t, 0] - hints.position[m, 0], X[t, 2] - hints.position[m, 1]
        g[t, 0] += hints.slope[m, 0] + hints.bend[m, 0] * dx + hints.bend[m, 1] * dy
        g[t, 2] += hints.slope[m, 1] + hints.bend[m, 1] * dx + hints.bend[m, 2] * dy
        for i in range(3):
            H[t, i] += hints.bend[m, i]


@kernel
def barrier_cost(planes: HalfPlanes, X: Floats) -> float:
    """Return the logarithmic barrier at states X (T, 4): minus the sum of log distances inside the half-planes.

    It is inf outside one of them.
    """
    total = 0.0
    for m in range(planes.step.shape[0]):
        t = planes.step[m]
        s = planes.normal[m, 0] * X[t, 0] + planes.normal[m, 1] * X[t, 2] - planes.offset[m]
        if s <= 0.0:
            return math.inf
        total -= math.log(s)
    return total


@kernel
def add_lines(lines: BearingLinesByStep, X: Floats, loss: int, k: float, exact: float, g: Floats, H: Floats) -> None:
    """Add the derivatives of the bearings' cost to `g` (T, 4) and, by position, to `H` (T, 3), in place.

    Args:
        lines: N bearings.
        X: (T, 4) states.
        loss: SQUARE, HUBER, CAUCHY or MIXTURE.
        k: parameter of the loss.
        exact: 1: second derivatives; 0: those of Gauss and Newton with reweighting, which are never negative for the
            losses; a mixture in between.
        g: (T, 4) gradient, changed in place.
        H: (T, 3) Hessian xx, xy, yy, changed in place.
    """
    for n in range(lines.step.shape[0]):
        h, d = in_camera(lines, n, X)
        r, rh, rd, rhh, rhd, rdd = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if lines.direction[n]:
            q, a = max(h * h + d * d, TINY), 1.0 / math.sqrt(lines.c0[n])
            r, rh, rd = a * math.atan2(h, d), a * d / q, -a * h / q
            rhh, rhd, rdd = -2.0 * a * h * d / (q * q), a * (h * h - d * d) / (q * q), 2.0 * a * h * d / (q * q)
        else:
            w2 = max(lines.c0[n] * d * d + lines.c1[n], TINY)
            w = math.sqrt(w2)
            r = (lines.focal[n] * h - lines.reading[n] * d) / w
            v = lines.c0[n] * d / w2  # derivative of log w
            vd = lines.c0[n] / w2 - 2.0 * v * v
            rh, rd = lines.focal[n] / w, -lines.reading[n] / w - r * v
            rhd = -rh * v
            rdd = lines.reading[n] / w * v - rd * v - r * vd
        first, second, weight = loss_slopes(r, loss, log_odds_offset(k, lines.lean[n]))
        gh, gd = first * rh, first * rd
        curved, bent = weight + exact * (second - weight), exact * first
        hh, hd, dd = curved * rh * rh + bent * rhh, curved * rh * rd + bent * rhd, curved * rd * rd + bent * rdd
        if lines.c1[n] > 0.0 and lines.c0[n] > 0.0:  # 1/2 log(c0 + c1 / d^2)
            w2 = lines.c0[n] * d * d + lines.c1[n]
            gd -= lines.c1[n] / (d * w2)
            dd += lines.c1[n] * (3.0 * lines.c0[n] * d * d + lines.c1[n]) / (d * d * w2 * w2)
        if lines.volume[n] > 0.0:
            gd -= lines.volume[n] / d
            dd += lines.volume[n] / (d * d)
        c, s, t = lines.axis[n, 0], lines.axis[n, 1], lines.step[n]
        g[t, 0] += -s * gh + c * gd
        g[t, 2] += c * gh + s * gd
        H[t, 0] += s * s * hh - 2.0 * s * c * hd + c * c * dd
        H[t, 1] += -s * c * hh + (c * c - s * s) * hd + s * c * dd
        H[t, 2] += c * c * hh + 2.0 * s * c * hd + s * s * dd


@kernel
def add_planes(planes: HalfPlanes, X: Floats, mu: float, multiplier: Floats, g: Floats, H: Floats) -> None:
    """Add the barrier's primal-dual derivatives to `g` (T, 4) and `H` (T, 3), in place.

    With slack s and normal n of a constraint: g - mu / s n, H + multiplier / s n n'; H has the columns xx, xy, yy.

    Args:
        planes: M half-planes.
        X: (T, 4) states.
        mu: weight of the barrier.
        multiplier: (M,) Lagrange multipliers.
        g: changed in place.
        H: changed in place.
    """
    for m in range(planes.step.shape[0]):
        t, n0, n1 = planes.step[m], planes.normal[m, 0], planes.normal[m, 1]
        s = n0 * X[t, 0] + n1 * X[t, 2] - planes.offset[m]
        g[t, 0] -= mu / s * n0
        g[t, 2] -= mu / s * n1
        q = multiplier[m] / s
        H[t, 0] += q * n0 * n0
        H[t, 1] += q * n0 * n1
        H[t, 2] += q * n1 * n1


@kernel
def in_front(lines: BearingLinesByStep, X: Floats) -> Bools:
    """Return a mask (N,): the state of the bearing, in X (T, 4), is in front of its sensor."""
    out = np.empty(lines.step.shape[0], dtype=np.bool_)
    for n in range(out.shape[0]):
        out[n] = in_camera(lines, n, X)[1] > 0.0
    return out


@kernel
def leverages(lines: BearingLinesByStep, X: Floats, loss: int, k: float, C: Floats) -> Floats:
    """Return (N,) leverages of the bearings, w J' C J, 0 to 1 up to linearisation.

    w is the IRLS weight of the loss (`loss`: SQUARE, HUBER, CAUCHY or MIXTURE, `k` its parameter), J the gradient of
    the residual at X (T, 4), and C (T, 4, 4) the covariances of the states.
    """
    out = np.empty(lines.step.shape[0])
    for n in range(out.shape[0]):
        t = lines.step[n]
        h, d = in_camera(lines, n, X)
        if lines.direction[n]:
            q, a = max(h * h + d * d, TINY), 1.0 / math.sqrt(lines.c0[n])
            r, rh, rd = a * math.atan2(h, d), a * d / q, -a * h / q
        else:
            w2 = max(lines.c0[n] * d * d + lines.c1[n], TINY)
            r = (lines.focal[n] * h - lines.reading[n] * d) / math.sqrt(w2)
            rh, rd = lines.focal[n] / math.sqrt(w2), -lines.reading[n] / math.sqrt(w2) - r * lines.c0[n] * d / w2
        weight = loss_slopes(r, loss, log_odds_offset(k, lines.lean[n]))[2]
        c, s = lines.axis[n, 0], lines.axis[n, 1]
        gu, gv = -s * rh + c * rd, c * rh + s * rd
        out[n] = weight * (gu * gu * C[t, 0, 0] + 2.0 * gu * gv * C[t, 0, 2] + gv * gv * C[t, 2, 2])
    return out
