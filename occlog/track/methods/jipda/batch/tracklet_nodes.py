"""Measurement factor of a person: the boxes of one time step as a function of the state, relative to clutter.

A box associated with a person is linearised about the person's estimated state: z = H s + v, v ~ N(0, R). The boxes of
a time step are then the factor exp(c + h' s - s' J s / 2) with J = sum H' R^-1 H and h = sum H' R^-1 z. The constant c
contains the densities and the probabilities of detections and missed detections, divided by the density of clutter.

Gait noise: the observed position is that of a smooth track plus e, which has a Student t distribution with `NU` degrees
of freedom: given a weight w it is normal with variance s^2 / w per axis. Weights and s^2 are estimated by expectation
maximisation (Lange, Little and Taylor 1989, Eqs. 4 and 5), with the track as estimated from all other nodes.
"""

from __future__ import annotations

import math

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from ..kernels.body_box import PackedCameras, box_and_slope, expected_box
from ..kernels.detections import (
    DetectorModel,
    PackedDetections,
    add_precision,
    biased,
    edge_noise,
    interpolate,
    log_clutter,
    position_noise,
)
from ..kernels.likelihood import outlier_density
from ..kernels.visibility import COLUMNS, ROWS, centre_deviation, in_view, occlude_by_static, visibility, visible_feet

LOG_2PI = math.log(2.0 * math.pi)
MAX_DETECTION_PROBABILITY = 0.995
"""Maximum detection probability of a person."""
MEAN_VISIBILITY = 0.85
"""Mean factor of the detection probability where occlusions are unknown."""


@kernel
def frame_visibilities(
    views: PackedCameras, boxes: PackedDetections, rates: DetectorModel, mean: Floats, covariance: Floats, there: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the visibility of N people in the L frames of a time step, each (L, N).

    Args:
        views: cameras and position sensors.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        mean: (N, 6) x, y, vx, vy, height, width.
        covariance: (N, 6, 6) covariances of these states.
        there: (N,) probability that each person is there and hides others.

    Returns:
        Expected visible shares (NaN: out of view), visible shares of the feet, and detection probabilities; the last
        two are 0 out of view.
    """
    L, N = boxes.camera.shape[0], mean.shape[0]
    visible, feet, detection = np.full((L, N), np.nan), np.zeros((L, N)), np.zeros((L, N))
    box, slope = np.empty((N, 4)), np.zeros((4, 6))
    depth, across, deep = np.empty(N), np.zeros(N), np.ones(N)
    cells = np.empty((ROWS, COLUMNS))
    for l in range(L):  # noqa: E741 - a frame
        c = boxes.camera[l]
        for i in range(N):
            depth[i] = box_and_slope(views.lens[c], mean[i], boxes.delay[l], box[i], slope)
            if depth[i] < 0.0:
                continue
            P = slope @ covariance[i] @ slope.T
            across[i] = centre_deviation(P)
            deep[i] = math.sqrt(0.5 * (covariance[i, 0, 0] + covariance[i, 1, 1])) + 0.1 * mean[i, 5]
            if not in_view(views, c, mean[i, 0], mean[i, 1], box[i], cells):
                depth[i] = -1.0
        for i in range(N):
            if depth[i] < 0.0:
                continue
            visible[l, i] = visibility(views, c, mean[i], i, box, depth, across, deep, there, cells)
            feet[l, i] = visible_feet(cells)
            detection[l, i] = min(
                rates.detection[c] * interpolate(rates.curve, visible[l, i]), MAX_DETECTION_PROBABILITY
            )
    return visible, feet, detection


@kernel
def missed_detection_log_probabilities(views: PackedCameras, rates: DetectorModel, mean: Floats) -> Floats:
    """Return log probabilities (N, C) that each camera does not detect a person with the state `mean` (N, 6).

    0 where the person is out of view. Other people are unknown: they hide as much as on average (`MEAN_VISIBILITY`).
    """
    N, C = mean.shape[0], views.size.shape[0]
    out = np.zeros((N, C))
    box, cells = np.empty(4), np.empty((ROWS, COLUMNS))
    for i in range(N):
        for c in range(C):
            if expected_box(views.lens[c], mean[i, 0], mean[i, 1], mean[i, 4], mean[i, 5], box) < 0.0:
                continue
            if not in_view(views, c, mean[i, 0], mean[i, 1], box, cells):
                continue
            occlude_by_static(views, c, mean[i, 0], mean[i, 1], mean[i, 4], mean[i, 5], cells)
            share = float(np.mean(cells))
            if share > 0.0:
                out[i, c] = math.log(
                    1.0
                    - MEAN_VISIBILITY
                    * min(rates.detection[c] * interpolate(rates.curve, share), MAX_DETECTION_PROBABILITY)
                )
        # All cameras may miss a person at once: the sum over cameras is that of both cases
        total = out[i].sum()
        if total < 0.0:
            out[i] *= math.log(rates.common_miss + (1.0 - rates.common_miss) * math.exp(total)) / total
    return out


@kernel
def factors(
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    mean: Floats,
    given: Ints,
    detection: Floats,
    feet: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Return the measurement factors exp(c + h' s - s' J s / 2) of N people: J (N, 6, 6), h (N, 6), c (N,).

    A factor is the likelihood ratio of a person's boxes and misses at one time step to clutter, as a function of the
    state s, linearised about `mean`.

    Args:
        views: cameras and position sensors.
        boxes: L frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        mean: (N, 6) states about which the boxes are linearised.
        given: (L, N) index of the box of each person in each frame; -1: missed.
        detection: (L, N) detection probabilities.
        feet: (L, N) visible shares of the feet.
    """
    L, N = given.shape
    J, h, c = np.zeros((N, 6, 6)), np.zeros((N, 6)), np.zeros(N)
    box, slope, drawn = np.empty(4), np.zeros((4, 6)), np.empty(4)
    noise, lasting, W = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    use = np.empty(4, dtype=np.bool_)
    for i in range(N):
        for l in range(L):  # noqa: E741 - a frame
            camera, j = boxes.camera[l], given[l, i]
            if j < 0:
                c[i] += math.log(1.0 - detection[l, i])
                continue
            if box_and_slope(views.lens[camera], mean[i], boxes.delay[l], box, slope) < 0.0:
                continue
            biased(box, rates.bias[camera], drawn)
            edge_noise(drawn, rates, 1.0, noise)
            edge_noise(drawn, rates, rates.lasting[camera] / rates.slow, lasting)
            lasting *= rates.slow
            if position_noise(boxes, j, 1.0, noise):
                lasting[:] = noise
            off = boxes.box[j] - drawn
            use[:] = boxes.usable[j]
            clutter = log_clutter(boxes.box[j], use, views.size[camera, 0], views.size[camera, 1]) + boxes.clutter[j]
            log_box = log_of(off, use, noise, W)
            cut = rates.cut * (1.0 - feet[l, i])
            log_box += math.log(1.0 - rates.wrong)
            if off[3] < 0.0:
                log_box += math.log(1.0 - cut)
            best, used = -1, use.sum()
            for e in range(4):
                # The box ends where the cover begins, or one edge is that of something else, if that is likelier
                chance = outlier_density(e, drawn, off[3], cut, rates.wrong if used > 3 else 0.0)
                if chance == 0.0 or not use[e]:
                    continue
                use[e] = False
                part = log_of(off, use, noise, W) + math.log(chance)
                use[e] = True
                if part > log_box:
                    log_box, best = part, e
            if best >= 0:
                use[best] = False
            # Errors that last count as often as they are new
            W[:] = 0.0
            add_precision(lasting, use, 1.0, W)
            z = off + slope @ mean[i]
            HW = slope.T @ W
            J[i] += HW @ slope
            h[i] += HW @ z
            # The density at s: that at the mean, with its exponent taken out, and the quadratic form at s = 0
            c[i] += log_box + 0.5 * (off @ W @ off) - 0.5 * (z @ W @ z)
            c[i] += math.log(max(detection[l, i], 1e-6)) - clutter
    return J, h, c


@kernel
def log_of(off: Floats, use: Bools, noise: Floats, W: Floats) -> float:
    """Return the Gaussian log density of the residuals `off` (4,) of a box's edges in `use` (4,).

    `noise` (4, 4) is their covariance; its inverse on the edges in use is written to `W` (4, 4), 0 elsewhere.
    """
    W[:] = 0.0
    add_precision(noise, use, 1.0, W)
    value = 0.0
    if noise[0, 1] != 0.0 and use[0] and use[1]:
        # Correlation of the axes of a position
        ratio = noise[0, 1] * noise[0, 1] / (noise[0, 0] * noise[1, 1])
        value -= 0.5 * math.log(1.0 - ratio)
    for axis in range(2):
        a, b = axis, axis + 2
        if use[a] and use[b]:
            value -= 0.5 * math.log(noise[a, a] * noise[b, b] - noise[a, b] * noise[a, b]) + LOG_2PI
        elif use[a]:
            value -= 0.5 * (math.log(noise[a, a]) + LOG_2PI)
        elif use[b]:
            value -= 0.5 * (math.log(noise[b, b]) + LOG_2PI)
    for a in range(4):
        for b in range(4):
            value -= 0.5 * off[a] * W[a, b] * off[b]
    return value


@kernel
def widen_by_gait(
    J: Floats, h: Floats, c: Floats, gait_variance: Floats, out_J: Floats, out_h: Floats, out_c: Floats
) -> None:
    """Convolve n factors exp(c + h' s - s' J s / 2) with gait noise of the position; write the new J, h and c.

    With e ~ N(0, S) added to the position, the factor's mean over e is, with A the columns of J for x and y and
    M = (S^-1 + J_xy)^-1: J - A M A', h - A M h_xy and c + (h_xy' M h_xy - log|I + S J_xy|) / 2.

    Args:
        J: (n, 6, 6) information matrices.
        h: (n, 6) information vectors.
        c: (n,) constants.
        gait_variance: (n,) variance S of the gait noise per axis, > 0.
        out_J: (n, 6, 6) written.
        out_h: (n, 6) written.
        out_c: (n,) written.
    """
    for k in range(c.shape[0]):
        a, b, d = 1.0 / gait_variance[k] + J[k, 0, 0], J[k, 0, 1], 1.0 / gait_variance[k] + J[k, 1, 1]
        det = a * d - b * b
        m00, m01, m11 = d / det, -b / det, a / det
        h0, h1 = h[k, 0], h[k, 1]
        g0, g1 = m00 * h0 + m01 * h1, m01 * h0 + m11 * h1
        out_c[k] = c[k] + 0.5 * (h0 * g0 + h1 * g1) - 0.5 * math.log(det * gait_variance[k] * gait_variance[k])
        for i in range(J.shape[1]):
            out_h[k, i] = h[k, i] - J[k, i, 0] * g0 - J[k, i, 1] * g1
            f0, f1 = J[k, i, 0] * m00 + J[k, i, 1] * m01, J[k, i, 0] * m01 + J[k, i, 1] * m11
            for j in range(J.shape[1]):
                out_J[k, i, j] = J[k, i, j] - f0 * J[k, 0, j] - f1 * J[k, 1, j]


NU = 3.0
INITIAL_SCALE_M = 0.03
"""Initial value of s [m]."""
MAX_SCALE_M = 0.2
"""s at most [m]."""
MIN_SCALE_M = 1e-3
"""s at least [m]."""
MIN_NODES = 50
"""Minimum number of positions for an estimate of the scale."""
EM_STEPS = 5


def gait_variances(
    J: Floats, h: Floats, mean: Floats, covariance: Floats, scale: float, metre: float
) -> tuple[Floats, float]:
    """Return the gait variances (n,) per axis of nodes about their smooth tracks, and the updated scale s^2.

    Student t noise by `EM_STEPS` of expectation maximisation; below `MIN_NODES` nodes the scale stays.

    Args:
        J: (n, 6, 6) information matrix of each node's boxes.
        h: (n, 6) information vector of each node's boxes.
        mean: (n, 6) smoothed state of the track at the node's time, without the node.
        covariance: (n, 6, 6) of `mean`.
        scale: s^2 before [scene unit^2].
        metre: length of a metre in the scene's unit.
    """
    if not len(J):
        return np.zeros(0), scale
    # The position by its boxes alone, its body being the walk's
    A, v = J.copy(), h.copy()
    for k in range(2, 6):
        weight = 1.0 / covariance[:, k, k]
        A[:, k, k] += weight
        v[:, k] += weight * mean[:, k]
    for k in range(2):
        A[:, k, k] += 1e-6 / metre**2
        v[:, k] += 1e-6 / metre**2 * mean[:, k]
    C = np.linalg.inv(A)
    off = (np.einsum("nij,nj->ni", C, v) - mean)[:, :2]
    S = C[:, :2, :2] + covariance[:, :2, :2]
    own = np.full(len(J), scale)
    one = np.eye(2)
    for _ in range(EM_STEPS):
        # Expectation of e' e, and of the weight
        gain = own[:, None, None] * np.linalg.inv(S + own[:, None, None] * one)
        e = np.einsum("nij,nj->ni", gain, off)
        square = (e**2).sum(axis=1) + own * (2.0 - np.trace(gain, axis1=1, axis2=2))
        weight = (NU + 2.0) / (NU + square / scale)
        # Maximisation
        if len(J) >= MIN_NODES:
            scale = float(
                np.clip(0.5 * np.mean(weight * square), (MIN_SCALE_M * metre) ** 2, (MAX_SCALE_M * metre) ** 2)
            )
        own = scale / weight
    return own, scale
