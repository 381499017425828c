"""Likelihood ratios of boxes for one person against clutter, with possible outlier edges.

The likelihood of a box is a mixture: all edges are the person's, or one edge is an outlier: the lower edge of a box
that ends where the feet are occluded (uniform over the upper 80 % of the height), or any edge that belongs to something
else (uniform over twice the size). The likeliest outlier represents all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel, kernel_part

from .body_box import BOTTOM
from .detections import DetectorModel, PackedDetections, log_clutter, log_density

MIN_DETECTION = 1e-4
"""People with a lower probability of detection are not associated."""
MIN_COVERED_SHARE = 0.01
"""Boxes of people with feet covered with a lower probability do not end early."""
TRUNCATED_EXTENT, OUTLIER_EXTENT = 0.8, 2.0
"""Range of the lower edge of a box that ends early, and of an outlier, in sizes of the box."""
OUTLIER_CHI2 = 4.0
"""An edge may be an outlier beyond this squared number of standard deviations."""
MANOEUVRE_SHARE = 0.1
"""Share of positions that a manoeuvre moves farther than the prediction expects."""
EDGE_GATE = 2.0
"""One edge is gated at this multiple of the gate of all four."""


class Likelihoods(NamedTuple):
    """Likelihood ratios of the m boxes of a frame for N people, against clutter, with possible outlier edges.

    `ratio` (N, m) is 0 outside the gate; `whole` (N, m) is the probability that no edge is an outlier, given that the
    box is the person's, and `outlier` (N, m) the index (left, top, right, bottom) of the likeliest outlier edge; -1:
    none.
    """

    ratio: Floats  # (N, m) 0: outside the gate
    whole: Floats  # (N, m) probability that no edge is an outlier, given that the box is the person's
    outlier: Floats  # (N, m) likeliest outlier edge; -1: none


@kernel
def outlier_density(edge: int, box: Floats, below: float, cut: float, wrong: float) -> float:
    """Return the probability that an edge of a box is an outlier, times its density [1/px] then.

    A lower edge above the expected one may be where the cover of the feet begins; any edge may be something else's. The
    density is uniform; 0 for a position on the ground.

    Args:
        edge: index of the edge: left, top, right, bottom.
        box: (4,) expected box [px].
        below: observed minus expected lower edge [px]; negative: the box ends above the expected one.
        cut: probability that the box ends where the cover of the feet begins.
        wrong: probability that one of the four edges is something else's.
    """
    size = box[2 + edge % 2] - box[edge % 2]
    if size <= 0.0:  # a position on the ground
        return 0.0
    if edge == BOTTOM and cut > MIN_COVERED_SHARE and below < 0.0:
        return float(cut / (TRUNCATED_EXTENT * size))
    return float(0.25 * wrong / (OUTLIER_EXTENT * size))


@kernel_part
def association_likelihood_ratios(
    box: Floats,
    noise: Floats,
    spread: Floats,
    covered: Floats,
    detection: Floats,
    boxes: PackedDetections,
    start: int,
    stop: int,
    rates: DetectorModel,
    width: float,
    height: float,
    log_features: Floats,
    gate: float,
) -> Likelihoods:
    """Return likelihood ratios of the m boxes of a frame for N people against clutter, with possible outlier edges.

    Args:
        box: (N, 4) expected left, top, right, bottom [px].
        noise: (N, 4, 4) measurement covariances of edges.
        spread: (N, 4, 4) covariances of the expected edges.
        covered: (N,) probability that the feet are covered.
        detection: (N,) probabilities of detection; people below `MIN_DETECTION` are omitted.
        boxes: frames of the time step with their M boxes, packed.
        start: first box of the frame.
        stop: one after its last box.
        rates: parameters of the cameras' detectors.
        width: width of the image [px].
        height: height of the image [px].
        log_features: (N, M) log-likelihood ratios of tracklet ids and appearance.
        gate: greatest squared Mahalanobis distance.
    """
    N = box.shape[0]
    ratio = np.zeros((N, stop - start))
    whole, outlier = np.ones((N, stop - start)), np.full((N, stop - start), -1)
    off, use, inverse = np.empty(4), np.empty(4, dtype=np.bool_), np.empty((4, 4))
    for i in range(N):
        if detection[i] < MIN_DETECTION:
            continue
        for j in range(start, stop):
            far, used = 0, 0
            for e in range(4):
                off[e] = boxes.box[j, e] - box[i, e]
                use[e] = boxes.usable[j, e]
                used += 1 if use[e] else 0
                if use[e] and off[e] * off[e] > EDGE_GATE * gate * (spread[i, e, e] + noise[i, e, e]):
                    far += 1
            if far > 1:
                continue
            clutter = log_clutter(boxes.box[j], use, width, height) + boxes.clutter[j]
            log_full, distance = log_density(off, inverse, use, noise[i], spread[i])
            full = math.exp(log_full - clutter + log_features[i, j]) if distance < gate else 0.0
            cut, most = rates.cut * covered[i], 0.0
            for e in range(4):
                off_edge = used > 3 and off[e] * off[e] > OUTLIER_CHI2 * (spread[i, e, e] + noise[i, e, e])
                chance = outlier_density(e, box[i], off[BOTTOM], cut, rates.wrong if off_edge else 0.0)
                if chance == 0.0 or not use[e]:
                    continue
                use[e] = False
                log_part, distance = log_density(off, inverse, use, noise[i], spread[i])
                use[e] = True
                part = chance * math.exp(log_part - clutter + log_features[i, j]) if distance < gate else 0.0
                if part > most:
                    most, outlier[i, j - start] = part, e
            if off[BOTTOM] < 0.0:
                full *= 1.0 - cut
            full *= 1.0 - rates.wrong
            ratio[i, j - start] = full + most
            if most > 0.0:
                whole[i, j - start] = full / (full + most)
    return Likelihoods(ratio, whole, outlier)


@kernel_part
def position_likelihood_ratios(
    box: Floats,
    spread: Floats,
    detection: Floats,
    boxes: PackedDetections,
    start: int,
    stop: int,
    area: float,
    log_features: Floats,
    gate: float,
    inflation: float,
) -> Likelihoods:
    """Return likelihood ratios of the m ground positions of a frame for N people against clutter.

    A Gaussian mixture with a wide component for manoeuvres. Association uses one Gaussian per person, the merged motion
    models, in which a manoeuvre has hardly any weight. A share `MANOEUVRE_SHARE` of the innovations therefore gets the
    additional variance `PackedDetections.tail`.

    Args:
        box: (N, 4) expected positions x, y in the first two columns.
        spread: (N, 4, 4) covariances of the expected positions in the first two rows and columns.
        detection: (N,) probabilities of detection; people below `MIN_DETECTION` are omitted.
        boxes: frames of the time step with their M detections, packed.
        start: first position of the frame.
        stop: one after its last position.
        area: area [scene unit^2] in which false positions are uniform.
        log_features: (N, M) log-likelihood ratios of identities and appearance.
        gate: greatest squared Mahalanobis distance.
        inflation: factor of the measurement covariance of positions.
    """
    N, count = box.shape[0], stop - start
    ratio, whole, outlier = np.zeros((N, count)), np.ones((N, count)), np.full((N, count), -1)
    for i in range(N):
        if detection[i] < MIN_DETECTION:
            continue
        for j in range(start, stop):
            dx, dy = boxes.box[j, 0] - box[i, 0], boxes.box[j, 1] - box[i, 1]
            total, near = 0.0, False
            for k in range(2):
                more = boxes.tail[j] if k == 1 else 0.0
                xx = spread[i, 0, 0] + inflation * boxes.covariance[j, 0] + more
                xy = spread[i, 0, 1] + inflation * boxes.covariance[j, 1]
                yy = spread[i, 1, 1] + inflation * boxes.covariance[j, 2] + more
                det = xx * yy - xy * xy
                distance = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / det
                near = near or distance < gate
                share = MANOEUVRE_SHARE if k == 1 else 1.0 - MANOEUVRE_SHARE
                total += share * math.exp(-0.5 * distance) / (2.0 * math.pi * math.sqrt(det))
            if near:
                ratio[i, j - start] = total * area * math.exp(log_features[i, j] - boxes.clutter[j])
    return Likelihoods(ratio, whole, outlier)
