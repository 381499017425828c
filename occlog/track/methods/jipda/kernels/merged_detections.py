"""Merged detections: one box for two people who overlap in the image.

A region-based detector reports two people who touch as one box, with edges of either. In addition to "box j is of
person i" there are hypotheses "box j is of persons a and b", each of which excludes all others of a, b and j. Marginals
are computed by belief propagation on the graph of binary hypotheses; without pairs they are those of `marginals`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel, kernel_part

from .detections import (
    DetectorModel,
    PackedDetections,
    add_axis_precision,
    interpolate,
    log_clutter,
    log_density,
)
from .likelihood import EDGE_GATE
from .marginals import CONVERGED, MAX_ITERATIONS
from .visibility import normal_cdf

MIN_PAIR_EXISTENCE = 0.2
"""Pairs are considered if both exist with at least this probability."""
MAX_PAIR_GAP = 0.1
"""Maximum gap between the boxes of people who touch, as a share of the narrower box."""
MIN_EDGE_OWNERSHIP = 0.5
"""Minimum probability that an edge of the outline is a person's, for an update."""


class PairMessages(NamedTuple):
    """Messages of belief propagation for N people, M boxes and K pairs, each from 0 (taken) to 1 (free).

    `single` (N, M): how free each box is for each person; `pair` (K, M): for each pair; `partner` (K, 2, M): how free
    the first and the second person of a pair are to share the box.
    """

    single: Floats  # (N, M) how free each box is for each person, 0 to 1
    pair: Floats  # (K, M) how free each box is for each pair
    partner: Floats  # (K, 2, M) how free the first and the second of a pair are to be in a box together


@kernel
def overlapping_pairs(box: Floats, depth: Floats, across: Floats, there: Floats) -> Ints:
    """Return (K, 2) indices of pairs of people with overlapping or touching boxes in an image, the lower index first.

    Args:
        box: (N, 4) expected left, top, right, bottom [px].
        depth: (N,) depth along the optical axis; negative: not in the image.
        across: (N,) standard deviations of the boxes' horizontal centres [px].
        there: (N,) existence probabilities; pairs with one below `MIN_PAIR_EXISTENCE` are omitted.
    """
    N = box.shape[0]
    pair, count = np.empty((N * N, 2), dtype=np.int64), 0
    for a in range(N):
        if depth[a] < 0.0 or there[a] < MIN_PAIR_EXISTENCE:
            continue
        for b in range(a + 1, N):
            if depth[b] < 0.0 or there[b] < MIN_PAIR_EXISTENCE:
                continue
            narrow = min(box[a, 2] - box[a, 0], box[b, 2] - box[b, 0])
            slack = math.sqrt(across[a] * across[a] + across[b] * across[b]) + MAX_PAIR_GAP * narrow
            if max(box[a, 0], box[b, 0]) - min(box[a, 2], box[b, 2]) > slack:
                continue
            if max(box[a, 1], box[b, 1]) > min(box[a, 3], box[b, 3]):
                continue
            pair[count, 0], pair[count, 1] = a, b
            count += 1
    return pair[:count].copy()


@kernel
def merged_box(
    a: int, b: int, drawn: Floats, noise: Floats, spread: Floats, box: Floats, whole: Floats, wide: Floats, own: Floats
) -> None:
    """Write the expected merged box of two people, its measurement and prediction covariance, and who owns each edge.

    Args:
        a: index of the first person.
        b: index of the second person.
        drawn: (N, 4) expected left, top, right, bottom of all people [px].
        noise: (N, 4, 4) measurement covariances of their edges.
        spread: (N, 4, 4) covariances of their expected edges.
        box: (4,) written: merged box, each edge that of the probable owner.
        whole: (4, 4) written: measurement covariance of its edges.
        wide: (4, 4) written: covariance of its expected edges.
        own: (4,) written: probability that an edge is the first person's.
    """
    for e in range(4):
        sign = -1.0 if e < 2 else 1.0
        deviation = math.sqrt(noise[a, e, e] + noise[b, e, e] + spread[a, e, e] + spread[b, e, e] + 1e-12)
        own[e] = normal_cdf(sign * (drawn[a, e] - drawn[b, e]) / deviation)
        box[e] = drawn[a, e] if own[e] >= 0.5 else drawn[b, e]
    for e in range(4):
        one = a if own[e] >= 0.5 else b
        for f in range(4):
            same = one == (a if own[f] >= 0.5 else b)
            whole[e, f] = noise[one, e, f] if same else 0.0
            wide[e, f] = spread[one, e, f] if same else 0.0


@kernel_part
def pair_likelihoods(
    pair: Ints,
    box: Floats,
    noise: Floats,
    spread: Floats,
    visible: Floats,
    boxes: PackedDetections,
    start: int,
    stop: int,
    rates: DetectorModel,
    c: int,
    width: float,
    height: float,
    new: float,
    gate: float,
) -> tuple[Floats, Floats]:
    """Return likelihood ratios (K, m) of a frame's m boxes as merged boxes of K pairs, and (K, 4) edge ownership.

    A ratio is against clutter or a new person, includes the probability that the pair is detected as one box, and is 0
    outside the gate. Ownership is the probability that an edge is the first person's.

    Args:
        pair: (K, 2) indices of people who touch in the image.
        box: (N, 4) expected left, top, right, bottom [px].
        noise: (N, 4, 4) measurement covariances of edges.
        spread: (N, 4, 4) covariances of the expected edges.
        visible: (N,) visible shares.
        boxes: frames of the time step with their M boxes, packed.
        start: first box of the frame.
        stop: one after its last box.
        rates: parameters of the cameras' detectors.
        c: index of the camera.
        width: width of the camera's image [px].
        height: height of the camera's image [px].
        new: expected number of boxes of new people, relative to that of false alarms.
        gate: greatest squared Mahalanobis distance.
    """
    ratio, own = np.zeros((pair.shape[0], stop - start)), np.empty((pair.shape[0], 4))
    union, union_noise, union_spread = np.empty(4), np.empty((4, 4)), np.empty((4, 4))
    off, use, inverse = np.empty(4), np.empty(4, dtype=np.bool_), np.empty((4, 4))
    for k in range(pair.shape[0]):
        a, b = pair[k]
        merged_box(a, b, box, noise, spread, union, union_noise, union_spread, own[k])
        seen = rates.detection[c] * interpolate(rates.curve, max(visible[a], visible[b]))
        for j in range(start, stop):
            near = True
            for e in range(4):
                off[e] = boxes.box[j, e] - union[e]
                use[e] = boxes.usable[j, e]
                if use[e] and off[e] * off[e] > EDGE_GATE * gate * (union_spread[e, e] + union_noise[e, e]):
                    near = False
            if not near:
                continue
            clutter = log_clutter(boxes.box[j], use, width, height) + boxes.clutter[j]
            log_full, distance = log_density(off, inverse, use, union_noise, union_spread)
            if distance < gate:
                ratio[k, j - start] = rates.merge[c] * seen * math.exp(log_full - clutter) / (1.0 + new)
    return ratio, own


@kernel
def add_edges_of_one(noise: Floats, use: Bools, own: Floats, first: bool, beta: float, out: Floats) -> None:
    """Add the inverse covariance of those edges of a merged box that belong to one person to `out` (4, 4), in place.

    Args:
        noise: (4, 4) measurement covariance of the person's edges left, top, right, bottom.
        use: (4,) edges in use.
        own: (4,) probabilities that the edges are the first person's of the pair.
        first: the person is the first of the pair; else the second.
        beta: weight, such as the probability of the merged detection.
        out: (4, 4) changed.
    """
    for axis in range(2):
        a, b = axis, axis + 2
        of_a, of_b = own[a] if first else 1.0 - own[a], own[b] if first else 1.0 - own[b]
        low, high = use[a] and of_a > MIN_EDGE_OWNERSHIP, use[b] and of_b > MIN_EDGE_OWNERSHIP
        both = beta * math.sqrt(of_a * of_b)
        add_axis_precision(noise, axis, low, high, beta * of_a, beta * of_b, both, out)


@kernel
def pair_messages(weight: Floats, pair: Ints, joint: Floats) -> PairMessages:
    """Return the messages of loopy belief propagation with boxes of one person and merged boxes of two.

    Args:
        weight: (N, M) odds that person i alone made box j, against that i made none and j is of no person.
        pair: (K, 2) indices of the people of each pair.
        joint: (K, M) odds that a pair made box j together, against that neither made any and j is of no person.
    """
    N, M = weight.shape
    K = pair.shape[0]
    single, both, partner = np.ones((N, M)), np.ones((K, M)), np.ones((K, 2, M))
    mu = np.zeros((N, M))
    total = np.empty(N)
    for _ in range(MAX_ITERATIONS):
        # How probable each person's hypotheses are together
        for i in range(N):
            total[i] = 1.0
            for j in range(M):
                total[i] += weight[i, j] * single[i, j]
        for k in range(K):
            for j in range(M):
                for s in range(2):
                    total[pair[k, s]] += joint[k, j] * partner[k, 1 - s, j] * both[k, j]
        # From people
        for i in range(N):
            for j in range(M):
                if weight[i, j] > 0.0:
                    mu[i, j] = weight[i, j] / max(total[i] - weight[i, j] * single[i, j], 1.0)
        new = np.ones((K, 2, M))
        for k in range(K):
            for j in range(M):
                if joint[k, j] > 0.0:
                    for s in range(2):
                        mine = joint[k, j] * partner[k, 1 - s, j] * both[k, j]
                        new[k, s, j] = 1.0 / max(total[pair[k, s]] - mine, 1.0)
        partner[:] = new
        # From boxes
        change = 0.0
        for j in range(M):
            taken = 1.0
            for i in range(N):
                taken += mu[i, j]
            for k in range(K):
                taken += joint[k, j] * partner[k, 0, j] * partner[k, 1, j]
            for i in range(N):
                if weight[i, j] > 0.0:
                    free = 1.0 / max(taken - mu[i, j], 1.0)
                    change = max(change, abs(free - single[i, j]))
                    single[i, j] = free
            for k in range(K):
                if joint[k, j] > 0.0:
                    free = 1.0 / max(taken - joint[k, j] * partner[k, 0, j] * partner[k, 1, j], 1.0)
                    change = max(change, abs(free - both[k, j]))
                    both[k, j] = free
        if change < CONVERGED:
            break
    return PairMessages(single, both, partner)
