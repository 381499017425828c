"""JIPDA update by the frames of one time step: association in each image, given the other cameras.

Expectation propagation (Minka 2001) over the frames: each frame contributes a site to every person, a Gaussian factor
of the state in information form and a log-odds of existence. For each frame in turn, its site is removed from the
belief (the cavity), boxes and visibilities are predicted from the cavity, the boxes are associated jointly, and the
site is recomputed. In the second sweep the first frame uses the information of the last one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.core.numerics.jit import kernel, kernel_part

from .body_box import BOTTOM, MODEL, POSITION_SOURCE, PackedCameras, box_and_slope
from .detections import (
    DetectorModel,
    PackedDetections,
    add_precision,
    biased,
    edge_noise,
    interpolate,
    position_noise,
)
from .likelihood import Likelihoods, association_likelihood_ratios, position_likelihood_ratios
from .linear import cholesky, eigen, invert
from .merged_detections import add_edges_of_one, overlapping_pairs, pair_likelihoods, pair_messages
from .visibility import COLUMNS, ROWS, centre_deviation, in_view, visibility, visible_feet

SWEEPS = 2
NOISE_INFLATION = 2.0
"""Factor of the variance of edges in association: boxes have heavier tails than a normal distribution, and a person who
turns is off from the prediction in all cameras, which must not deny them the cameras' boxes."""
BLIND_FRAME_PROBABILITY = 0.01
"""Probability that a frame shows none of the people who are there: it was not recorded, or the lens is covered."""
MIN_MISS_PROBABILITY = 1e-6
"""Least probability of a missed detection."""
MIN_LIKELIHOOD_RATIO = 1e-12
"""Least likelihood ratio of existence."""
MAX_LOG_RATIO, MIN_COMMON_MISS = 600.0, 1e-250
"""Greatest log of a ratio, and least probability that all frames miss a person at once."""
MIN_ASSOCIATION = 0.02
"""Least association probability of a box that updates a state."""
ROUNDING = 1e-9
"""Share of a precision below which a negative information is rounding."""
DEPTH_OF_WIDTH = 0.1
"""Standard deviation of the depth of a body, in widths."""


class PredictedBoxes(NamedTuple):
    """Predictions of N people for one frame, from the belief without this frame's own factor (the cavity).

    State `mean` (N, 6) and `covariance`, `existence`, expected outline and its Jacobian H (N, 4, 6), the `box` (N, 4)
    [px] as the detector reports it, covariances (N, 4, 4) of its edges: `spread` H P H', `noise` in association and
    `update_noise` in the update; `depth` along the optical axis (negative: out of view), standard deviations of the
    centre across the image [px] and of the depth, and the probability that the feet are covered.
    """

    mean: Floats  # (N, 6)
    covariance: Floats  # (N, 6, 6)
    existence: Floats  # (N,)
    outline: Floats  # (N, 4) box of the body [px]
    slope: Floats  # (N, 4, 6) its Jacobian H
    box: Floats  # (N, 4) as the detector reports it: with the camera's bias
    spread: Floats  # (N, 4, 4) covariance H P H' of the expected edges
    noise: Floats  # (N, 4, 4) covariance of edges in association
    update_noise: Floats  # (N, 4, 4) the same in the update of the state
    depth: Floats  # (N,) along the optical axis; negative: out of view
    across: Floats  # (N,) standard deviation of the centre, across the image [px]
    deep: Floats  # (N,) standard deviation of the depth
    covered: Floats  # (N,) probability that the feet are covered


class BoxAssociation(NamedTuple):
    """Association probabilities of the m boxes of a frame with N people and K touching pairs, given that they exist.

    `beta` (N, m): the box is the person's alone; `joint` (K, 2, m): the box is the merged detection of the pair, given
    the existence of its first or second member; `ratio` (N,): likelihood ratio of existence by all boxes of the frame.
    """

    beta: Floats  # (N, m) the box is the person's alone
    joint: Floats  # (K, 2, m) the box is the first and the second one's of a pair together
    ratio: Floats  # (N,) likelihood ratio of existence, by all boxes of the frame


class MapHypothesis(NamedTuple):
    """Most probable hypothesis of each of N people in a frame, other than a miss: a box alone, or a merged one.

    Columns (N,): `probability`, `box` within the frame (-1: no box is possible), `pair` of a merged box (-1: the box is
    of the person alone), and `side`, 0 or 1: whether the person is the first or second of the pair.
    """

    probability: Floats  # (N,)
    box: Ints  # (N,) within the frame
    pair: Ints  # (N,) pair of whom it is the outline; -1: the box is of the person alone
    side: Ints  # (N,) 0: the person is the first of the pair, 1: the second


class StepStatistics(NamedTuple):
    """Expected counts of a time step from which detector parameters are learned; L frames, M boxes.

    `cuts` (2,): boxes that end where the cover of the feet begins, and boxes of people with covered feet; `wrong` (2,):
    boxes with an outlier edge, and all boxes; `odd` (M,): probability that an edge of the box is an outlier or cut;
    `merges` (L, 2): touching pairs detected as one box, and touching pairs detected at all.
    """

    cuts: Floats  # (2,) boxes that end where the cover of the feet begins, and boxes of people with covered feet
    wrong: Floats  # (2,) boxes with an outlier edge, and all boxes
    odd: Floats  # (M,) probability that an edge of the box is an outlier or cut, given its owner
    merges: Floats  # (L, 2) pairs who touch and are one box, and all pairs who touch and are detected


class JipdaResult(NamedTuple):
    """Result of the JIPDA update of N people by L frames with M boxes.

    Updated `mean` (N, 6), `covariance` and `existence`; `information` and `vector`, the product of all frames' Gaussian
    factors in information form; `missed` (N,), probability of a miss in all frames at once, given existence; `visible`
    and `detection` (L, N), visible share (NaN: out of view) and detection probability; `beta` and `joint` (N, M),
    association probabilities of a box alone and merged with a neighbour, given existence; `free` (M,), probability that
    a box is of none of the people; `owner` (M,), likeliest person (-1: none); and the counts of `StepStatistics`.
    """

    mean: Floats  # (N, 6)
    covariance: Floats  # (N, 6, 6)
    information: Floats  # (N, 6, 6) sum of all sites, in information form
    vector: Floats  # (N, 6)
    existence: Floats  # (N,)
    missed: Floats  # (N,) probability that a person who exists is missed in all frames at once
    visible: Floats  # (L, N) visible share; NaN: outside the image
    detection: Floats  # (L, N) probability of detection that was used; 0 outside the image
    beta: Floats  # (N, M) association probability of person and box, given that they exist
    joint: Floats  # (N, M) the same of the person and a neighbour together
    free: Floats  # (M,) probability that the box is of none of the people
    owner: Ints  # (M,) likeliest person; -1: none
    cuts: Floats  # (2,) as in `StepStatistics`
    odd: Floats  # (M,)
    wrong: Floats  # (2,)
    merges: Floats  # (L, 2)


@kernel_part
def predict_boxes(views: PackedCameras, c: int, delay: float, rates: DetectorModel, predicted: PredictedBoxes) -> None:
    """Write the expected boxes, their covariances and depths in a camera, predicted from the states in `predicted`.

    `existence` and `covered` are not written. People out of view get the depth -1, and nothing else.

    Args:
        views: cameras and position sensors.
        c: index of the camera.
        delay: how much later than the time step the frame is [s].
        rates: parameters of the cameras' detectors.
        predicted: `mean` and `covariance` are read, the other fields written.
    """
    m, P = predicted.mean, predicted.covariance
    cells = np.empty((ROWS, COLUMNS))
    for i in range(m.shape[0]):
        outline, slope, box = predicted.outline[i], predicted.slope[i], predicted.box[i]
        depth = box_and_slope(views.lens[c], m[i], delay, outline, slope)
        if depth <= 0.0 or not in_view(views, c, m[i, 0], m[i, 1], outline, cells):
            predicted.depth[i] = -1.0
            continue
        predicted.depth[i] = depth
        predicted.spread[i] = slope @ P[i] @ slope.T
        predicted.across[i] = centre_deviation(predicted.spread[i])
        if views.lens[c, MODEL] == POSITION_SOURCE:
            # The noise is that of each position
            predicted.deep[i], predicted.noise[i], predicted.update_noise[i] = 1.0, 0.0, 0.0
            box[:] = outline
            continue
        # Depth of the position on the ground along the optical axis
        fx, fy = views.rotation[c, 0, 2], views.rotation[c, 1, 2]
        predicted.deep[i] = math.sqrt(
            fx * fx * P[i, 0, 0] + 2.0 * fx * fy * P[i, 0, 1] + fy * fy * P[i, 1, 1] + (DEPTH_OF_WIDTH * m[i, 5]) ** 2
        )
        biased(outline, rates.bias[c], box)
        edge_noise(box, rates, 1.0, predicted.noise[i])
        predicted.noise[i] *= NOISE_INFLATION
        edge_noise(box, rates, rates.lasting[c] / rates.slow, predicted.update_noise[i])
        predicted.update_noise[i] *= rates.slow


@kernel_part
def detection_probabilities(
    views: PackedCameras, c: int, rates: DetectorModel, predicted: PredictedBoxes, visible: Floats, detection: Floats
) -> None:
    """Write the visible shares (N,) and detection probabilities (N,) of people in camera `c`, and `predicted.covered`.

    A detection probability is that of an unoccluded person times the detector's curve at the visible share; out of view
    it is 0, and the share NaN. `covered` is the probability that the feet are occluded.

    Args:
        views: cameras and static occluders.
        c: index of the camera.
        rates: parameters of the cameras' detectors.
        predicted: expected boxes and depths; `covered` is written.
        visible: (N,) written.
        detection: (N,) written.
    """
    cells = np.empty((ROWS, COLUMNS))
    p = predicted
    for i in range(p.mean.shape[0]):
        visible[i], detection[i], p.covered[i] = np.nan, 0.0, 0.0
        if p.depth[i] < 0.0:
            continue
        visible[i] = visibility(views, c, p.mean[i], i, p.outline, p.depth, p.across, p.deep, p.existence, cells)
        p.covered[i] = 1.0 - visible_feet(cells)
        detection[i] = rates.detection[c] * interpolate(rates.curve, visible[i])


@kernel_part
def unmerged_detection_probability(pair: Ints, merge: float, existence: Floats, detection: Floats) -> None:
    """Multiply the detection probabilities (N,) by the probability of not being merged with a neighbour, in place.

    Args:
        pair: (K, 2) indices of people who touch in the image.
        merge: probability that two people who touch are detected as one box.
        existence: (N,) existence probabilities.
        detection: (N,) changed.
    """
    for k in range(pair.shape[0]):
        a, b = pair[k]
        detection[a] *= 1.0 - merge * existence[b]
        detection[b] *= 1.0 - merge * existence[a]


@kernel_part
def missed_detection_ratio(existence: Floats, detection: Floats, frames: int) -> Floats:
    """Return log likelihood ratios of existence (N,) from a frame without boxes: all were missed, or it is blind.

    A ratio is log(1 - P_D), but at least log(`BLIND_FRAME_PROBABILITY`) over the expected number of detections (at
    least 1) and over `frames`: one blind event counts once for all people and all frames that are blind together.

    Args:
        existence: (N,) existence probabilities.
        detection: (N,) probabilities of detection P_D.
        frames: number of frames that are blind if this one is.
    """
    expected = 0.0
    for i in range(existence.shape[0]):
        expected += existence[i] * detection[i]
    least = math.log(BLIND_FRAME_PROBABILITY) / (max(expected, 1.0) * frames)
    log_odds = np.empty(existence.shape[0])
    for i in range(existence.shape[0]):
        log_odds[i] = max(math.log(max(1.0 - detection[i], MIN_MISS_PROBABILITY)), least)
    return log_odds


@kernel_part
def associate_frame(
    existence: Floats, detection: Floats, ratio: Floats, pair: Ints, pair_ratio: Floats, new: float
) -> BoxAssociation:
    """Associate the m boxes of a frame with N people and K pairs, by loopy belief propagation.

    With r the existence probability, P_D the detection probability, l the likelihood ratio and b the ratio of new
    people to clutter, the weight of "box j is person i's" against "i is missed and j is clutter or new" is r P_D l /
    ((1 - r P_D) (1 + b)). The result has association probabilities and likelihood ratios of existence.

    Args:
        existence: (N,) existence probabilities r.
        detection: (N,) detection probabilities P_D.
        ratio: (N, m) likelihood ratios l of person and box, against clutter.
        pair: (K, 2) indices of people who touch in the image.
        pair_ratio: (K, m) likelihood ratios of merged boxes, with the probabilities of detection and of merging.
        new: b, expected number of boxes of new people over that of clutter.
    """
    N, M, K = ratio.shape[0], ratio.shape[1], pair.shape[0]
    weight, pair_weight = np.zeros((N, M)), np.zeros((K, M))
    odds = existence / (1.0 - existence * detection)
    for i in range(N):
        missed = 1.0 - existence[i] * detection[i]
        for j in range(M):
            weight[i, j] = existence[i] * detection[i] * ratio[i, j] / (missed * (1.0 + new))
    for k in range(K):
        a, b = pair[k]
        chance = existence[a] / (1.0 - existence[a] * detection[a]) * existence[b] / (1.0 - existence[b] * detection[b])
        for j in range(M):
            pair_weight[k, j] = chance * pair_ratio[k, j]
    nu = pair_messages(weight, pair, pair_weight)
    # Likelihood ratio of existence: 1 - P_D and the sum over all hypotheses
    beta, joint, total = np.zeros((N, M)), np.zeros((K, 2, M)), 1.0 - detection
    for i in range(N):
        for j in range(M):
            beta[i, j] = detection[i] * ratio[i, j] / (1.0 + new) * nu.single[i, j]
            total[i] += beta[i, j]
    for k in range(K):
        for s in range(2):
            for j in range(M):
                joint[k, s, j] = odds[pair[k, 1 - s]] * pair_ratio[k, j] * nu.partner[k, 1 - s, j] * nu.pair[k, j]
                total[pair[k, s]] += joint[k, s, j]
    for i in range(N):
        beta[i] /= total[i]
    for k in range(K):
        for s in range(2):
            joint[k, s] /= total[pair[k, s]]
    return BoxAssociation(beta, joint, total)


@kernel_part
def map_hypothesis(beta: Floats, pair: Ints, joint: Floats) -> MapHypothesis:
    """Return the most probable box of each person, alone or merged with a neighbour.

    A miss is not compared; box -1 only where no box has a positive probability. `beta` (N, m) and `joint` (K, 2, m) are
    association probabilities given existence, `pair` (K, 2) the indices of the people of each pair.
    """
    N, M = beta.shape
    best, box = np.zeros(N), np.full(N, -1)
    of_pair, side = np.full(N, -1), np.zeros(N, dtype=np.int64)
    for i in range(N):
        for j in range(M):
            if beta[i, j] > best[i]:
                best[i], box[i] = beta[i, j], j
    for k in range(pair.shape[0]):
        for s in range(2):
            i = pair[k, s]
            for j in range(M):
                if joint[k, s, j] > best[i]:
                    best[i], box[i], of_pair[i], side[i] = joint[k, s, j], j, k, s
    return MapHypothesis(best, box, of_pair, side)


@kernel_part
def marginal_probabilities(
    existence: Floats, found: BoxAssociation, pair: Ints, beta: Floats, joint: Floats, free: Floats, owner: Ints
) -> None:
    """Write a frame's association probabilities by person and box, unassigned probabilities, and MAP assignments.

    Args:
        existence: (N,) existence probabilities before the frame.
        found: association of the frame, given existence.
        pair: (K, 2) indices of people who touch in the image.
        beta: (N, m) written: probability that a box is of the person alone, given existence.
        joint: (N, m) written: probability that a box is merged with a neighbour's, given existence.
        free: (m,) written: probability that a box is of none of the people.
        owner: (m,) written: index of the most probable person of each box alone; -1: none.
    """
    N, M = beta.shape
    beta[:], joint[:], free[:], owner[:] = found.beta, 0.0, 1.0, -1
    largest = np.zeros(M)
    for i in range(N):
        posterior = existence[i] * found.ratio[i] / (1.0 - existence[i] + existence[i] * found.ratio[i])
        for j in range(M):
            p = posterior * beta[i, j]
            free[j] -= p
            if p > largest[j]:
                largest[j], owner[j] = p, i
        for k in range(pair.shape[0]):
            for s in range(2):
                if pair[k, s] == i:
                    for j in range(M):
                        joint[i, j] += found.joint[k, s, j]
                        free[j] -= 0.5 * posterior * found.joint[k, s, j]
    for j in range(M):
        free[j] = max(free[j], 0.0)


@kernel
def add_hypothesis(
    precision: Floats, H: Floats, W: Floats, off: Floats, probability: float, first: Floats, second: Floats
) -> None:
    """Add the posterior of one association hypothesis to the moments of a Gaussian mixture, relative to the prior mean.

    Args:
        precision: (6, 6) inverse of the prior's covariance.
        H: (4, 6) Jacobian of the box edges.
        W: (4, 4) inverse covariance of the edges; zero rows for unobserved ones.
        off: (4,) observed minus expected edges [px].
        probability: probability of the hypothesis.
        first: (6,) first moment, changed in place.
        second: (6, 6) second moment, changed in place.
    """
    HW = H.T @ W
    P = precision + HW @ H
    invert(P, P)
    d = P @ (HW @ off)
    for a in range(6):
        first[a] += probability * d[a]
        for b in range(6):
            second[a, b] += probability * (P[a, b] + d[a] * d[b])


@kernel_part
def without_negative(information: Floats, P: Floats, precision: Floats) -> None:
    """Make an information matrix (6, 6) positive semidefinite, in place.

    Negative eigenvalues are set to 0 in coordinates in which P, the covariance of the belief without it, is the
    identity.

    Args:
        information: (6, 6) changed.
        P: (6, 6) covariance of the belief before this information is added.
        precision: (6, 6) inverse of P.
    """
    L, axes = np.empty((6, 6)), np.empty((6, 6))
    cholesky(P, L)
    A = L.T @ information @ L
    eigen(A, axes)
    back = precision @ (L @ axes)
    for k in range(6):
        for a in range(6):
            for b in range(6):
                information[a, b] -= min(A[k, k], 0.0) * back[a, k] * back[b, k]


@kernel_part
def expectation_propagation_site(
    predicted: PredictedBoxes,
    i: int,
    boxes: PackedDetections,
    start: int,
    stop: int,
    whole: Floats,
    outlier: Ints,
    beta: Floats,
    pair: Ints,
    joint: Floats,
    own: Floats,
    information: Floats,
    vector: Floats,
) -> None:
    """Write a frame's factor for person i (the site): a Gaussian in information form, `information` and `vector`.

    JPDA: the belief after the frame has mean and covariance of the mixture over all boxes and the missed detection; the
    site is that belief divided by the belief without the frame (the cavity). Directions in which the mixture is wider
    than the cavity get no information. A box with a possible outlier edge makes two hypotheses, one without this edge.

    Args:
        predicted: people in the frame, predicted from the cavity.
        i: index of the person.
        boxes: frames of the time step with their M boxes, packed.
        start: first box of the frame.
        stop: one after its last box; m boxes.
        whole: (m,) probability that no edge of a box is an outlier.
        outlier: (m,) index of the edge that may be one; -1: none.
        beta: (m,) association probabilities of boxes of the person alone, given existence.
        pair: (K, 2) indices of people who touch in the image.
        joint: (K, 2, m) association probabilities of merged boxes, given existence of the first or second of the pair.
        own: (K, 4) probability that an edge of a merged box is the first person's of the pair.
        information: (6, 6) written.
        vector: (6,) written.
    """
    box, usable = boxes.box[start:stop], boxes.usable[start:stop]
    noise, H, P, m = predicted.update_noise[i].copy(), predicted.slope[i], predicted.covariance[i], predicted.mean[i]
    precision = np.empty((6, 6))
    invert(P, precision)
    d, second, missed, W = np.zeros(6), np.zeros((6, 6)), 1.0, np.empty((4, 4))
    for j in range(box.shape[0]):
        off = box[j] - predicted.box[i]
        if beta[j] > MIN_ASSOCIATION:
            missed -= beta[j]
            position_noise(boxes, start + j, 1.0, noise)
            W[:] = 0.0
            add_precision(noise, usable[j], 1.0, W)
            add_hypothesis(precision, H, W, off, beta[j] * whole[j], d, second)
            if whole[j] < 1.0:
                use = usable[j].copy()
                use[outlier[j]] = False
                W[:] = 0.0
                add_precision(noise, use, 1.0, W)
                add_hypothesis(precision, H, W, off, beta[j] * (1.0 - whole[j]), d, second)
        for k in range(pair.shape[0]):
            for s in range(2):
                if pair[k, s] == i and joint[k, s, j] > MIN_ASSOCIATION:
                    missed -= joint[k, s, j]
                    W[:] = 0.0
                    add_edges_of_one(noise, usable[j], own[k], s == 0, 1.0, W)
                    add_hypothesis(precision, H, W, off, joint[k, s, j], d, second)
    if missed > 1.0 - MIN_ASSOCIATION:
        information[:], vector[:] = 0.0, 0.0
        return
    second += max(missed, 0.0) * P - np.outer(d, d)
    invert(second, information)
    information -= precision
    # Positive semidefinite, but for rounding, if it can be factorised with a trace of the cavity's information
    if math.isnan(invert(information + ROUNDING * precision, second)):
        without_negative(information, P, precision)
    vector[:] = information @ (m + d) + precision @ d


@kernel_part
def count_edges(
    boxes: PackedDetections,
    start: int,
    predicted: PredictedBoxes,
    likelihoods: Likelihoods,
    best: MapHypothesis,
    counts: StepStatistics,
) -> None:
    """Add the expected numbers of truncated and outlier edges of a frame's boxes to `counts`, in place.

    Each person's most probable box counts; merged boxes of two people are omitted.

    Args:
        boxes: frames of the time step with their M boxes, packed.
        start: index of the frame's first box.
        predicted: people in the frame.
        likelihoods: likelihood ratios and outlier probabilities of the frame's boxes.
        best: most probable box of each person.
        counts: `cuts`, `wrong` and `odd` are changed.
    """
    for i in range(predicted.mean.shape[0]):
        if best.probability[i] <= MIN_ASSOCIATION or best.pair[i] >= 0:
            continue
        j, p = best.box[i], best.probability[i] * best.probability[i]
        off = p * (1.0 - likelihoods.whole[i, j])
        ends = likelihoods.outlier[i, j] == BOTTOM and boxes.box[start + j, BOTTOM] < predicted.box[i, BOTTOM]
        if boxes.usable[start + j, BOTTOM] and predicted.covered[i] > 0.5:
            counts.cuts[0] += off if ends else 0.0
            counts.cuts[1] += p * predicted.covered[i]
        if not (ends and predicted.covered[i] > 0.1):
            counts.wrong[0] += p * predicted.existence[i] * (1.0 - likelihoods.whole[i, j])
        counts.wrong[1] += p * predicted.existence[i]
        counts.odd[start + j] += off


@kernel_part
def count_merges(existence: Floats, found: BoxAssociation, pair: Ints, merges: Floats) -> None:
    """Add the expected numbers of pairs detected as one box, and of pairs detected at all, to `merges` (2,), in place.

    `pair` (K, 2) are indices of people who touch in the image, `existence` (N,) existence probabilities, `found` the
    frame's association probabilities.
    """
    for k in range(pair.shape[0]):
        a, b = pair[k]
        certain = existence[a] * existence[b]
        merged = 0.5 * (found.joint[k, 0].sum() + found.joint[k, 1].sum())
        separate = max(found.beta[a].sum(), found.beta[b].sum())
        merges[0] += certain * merged
        merges[1] += certain * min(merged + separate, 1.0)


@kernel
def update_targets(
    mean: Floats,
    covariance: Floats,
    existence: Floats,
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    log_features: Floats,
    new: float,
    gate: float,
    hidden: Floats,
) -> JipdaResult:
    """Update N people by the frames of one time step, by expectation propagation with joint association in each frame.

    Args:
        mean: (N, 6) predicted x, y, vx, vy, height, width.
        covariance: (N, 6, 6) covariances of these states.
        existence: (N,) predicted existence probabilities.
        views: C cameras and position sensors.
        boxes: L frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        log_features: (N, M) log-likelihood ratios of tracklet ids, appearance and persistent clutter.
        new: expected number of boxes of people who are not among the N, relative to that of false alarms.
        gate: greatest squared Mahalanobis distance of a box.
        hidden: (N, C) probability that an unmodelled obstacle hides the person from the camera.
    """
    N, L, M = mean.shape[0], boxes.camera.shape[0], boxes.box.shape[0]
    m, P = mean.copy(), covariance.copy()
    information, vector = np.empty((N, 6, 6)), np.empty((N, 6))
    for i in range(N):
        invert(P[i], information[i])
        vector[i] = information[i] @ m[i]
    site, site_vector = np.zeros((L, N, 6, 6)), np.zeros((L, N, 6))
    log_odds, site_odds = np.log(existence) - np.log1p(-existence), np.zeros((L, N))
    visible, detection = np.full((L, N), np.nan), np.zeros((L, N))
    beta, joint, free, owner = np.zeros((N, M)), np.zeros((N, M)), np.ones(M), np.full(M, -1)
    counts = StepStatistics(cuts=np.zeros(2), wrong=np.zeros(2), odd=np.zeros(M), merges=np.zeros((L, 2)))
    predicted = PredictedBoxes(
        mean=np.empty((N, 6)),
        covariance=np.empty((N, 6, 6)),
        existence=np.empty(N),
        outline=np.empty((N, 4)),
        slope=np.zeros((N, 4, 6)),
        box=np.empty((N, 4)),
        spread=np.empty((N, 4, 4)),
        noise=np.empty((N, 4, 4)),
        update_noise=np.empty((N, 4, 4)),
        depth=np.empty(N),
        across=np.zeros(N),
        deep=np.ones(N),
        covered=np.zeros(N),
    )
    for sweep in range(SWEEPS):
        for l in range(L):  # noqa: E741 - a frame
            c, start, stop = boxes.camera[l], boxes.first[l], boxes.first[l + 1]
            width, height = views.size[c]
            # Cavity: the belief without the frame's site
            for i in range(N):
                if sweep > 0:
                    invert(information[i] - site[l, i], predicted.covariance[i])
                    predicted.mean[i] = predicted.covariance[i] @ (vector[i] - site_vector[l, i])
                else:
                    predicted.covariance[i], predicted.mean[i] = P[i], m[i]
                predicted.existence[i] = 1.0 / (1.0 + math.exp(-(log_odds[i] - site_odds[l, i])))
            # Predicted boxes, and probabilities of detection by the expected occlusion
            predict_boxes(views, c, boxes.delay[l], rates, predicted)
            detection_probabilities(views, c, rates, predicted, visible[l], detection[l])
            detection[l] *= 1.0 - hidden[:, c]
            above = views.lens[c, MODEL] == POSITION_SOURCE
            pair = (
                np.empty((0, 2), dtype=np.int64)
                if above
                else overlapping_pairs(predicted.outline, predicted.depth, predicted.across, predicted.existence)
            )
            unmerged_detection_probability(pair, rates.merge[c], predicted.existence, detection[l])
            if stop == start:
                odds = missed_detection_ratio(predicted.existence, detection[l], 1 if M > 0 else L)
                for i in range(N):
                    log_odds[i] += odds[i] - site_odds[l, i]
                    site_odds[l, i] = odds[i]
                continue
            # Association
            if above:
                likelihoods = position_likelihood_ratios(
                    predicted.box, predicted.spread, detection[l], boxes, start, stop, width * height, log_features,
                    gate, NOISE_INFLATION,
                )  # fmt: skip
            else:
                likelihoods = association_likelihood_ratios(
                    predicted.box, predicted.noise, predicted.spread, predicted.covered, detection[l],
                    boxes, start, stop, rates, width, height, log_features, gate,
                )  # fmt: skip
            pair_ratio, own = pair_likelihoods(
                pair, predicted.box, predicted.noise, predicted.spread, visible[l],
                boxes, start, stop, rates, c, width, height, new, gate,
            )  # fmt: skip
            found = associate_frame(predicted.existence, detection[l], likelihoods.ratio, pair, pair_ratio, new)
            marginal_probabilities(
                predicted.existence, found, pair,
                beta[:, start:stop], joint[:, start:stop], free[start:stop], owner[start:stop],
            )  # fmt: skip
            # Measurement update by all boxes
            best = map_hypothesis(found.beta, pair, found.joint)
            for i in range(N):
                odds_of = math.log(max(found.ratio[i], MIN_LIKELIHOOD_RATIO))
                log_odds[i] += odds_of - site_odds[l, i]
                site_odds[l, i] = odds_of
                information[i] -= site[l, i]
                vector[i] -= site_vector[l, i]
                expectation_propagation_site(
                    predicted, i, boxes, start, stop, likelihoods.whole[i],
                    likelihoods.outlier[i], found.beta[i], pair, found.joint, own, site[l, i], site_vector[l, i],
                )  # fmt: skip
                information[i] += site[l, i]
                vector[i] += site_vector[l, i]
                invert(information[i], P[i])
                m[i] = P[i] @ vector[i]
            if sweep == SWEEPS - 1 and not above:
                count_edges(boxes, start, predicted, likelihoods, best, counts)
                count_merges(predicted.existence, found, pair, counts.merges[l])
    # All frames may miss a person at once, as a detector does that fuses the cameras
    missed = np.empty(N)
    for i in range(N):
        prior = math.log(existence[i]) - math.log1p(-existence[i])
        independent = log_odds[i] - prior + math.log1p(-rates.common_miss)
        common = math.log(max(rates.common_miss, MIN_COMMON_MISS))
        missed[i] = 1.0 / (1.0 + math.exp(min(independent - common, MAX_LOG_RATIO)))
        log_odds[i] = prior + common - math.log(missed[i])
    return JipdaResult(
        mean=m,
        covariance=P,
        information=site.sum(axis=0),
        vector=site_vector.sum(axis=0),
        existence=1.0 / (1.0 + np.exp(-log_odds)),
        missed=missed,
        visible=visible,
        detection=detection,
        beta=beta,
        joint=joint,
        free=free,
        owner=owner,
        cuts=counts.cuts,
        odd=counts.odd,
        wrong=counts.wrong,
        merges=counts.merges,
    )
