"""The update of everybody by the looks of one moment: association in each image, with what the other cameras say.

Each look leaves every person a message: a Gaussian factor of the state in information form, and the odds of existence.
When a look is gone through, its own message is taken out of the belief (the cavity), the people's boxes and what hides
whom are computed from the cavity, the boxes of the look are associated jointly, and the message is made anew.  Two
sweeps over the looks let the first look profit from the last one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.numerics.jit import kernel

from .body_box import Views, box_and_slope
from .linear import invert
from .merged import outline, own_edges, pair_messages, touching
from .visible_share import COLUMNS, ROWS, clear_cells, hide_behind, inside_image

LEFT_OUT = 1e10
"""Variance [px^2] of an edge that says nothing."""
LOG_LEFT_OUT = 0.5 * math.log(2.0 * math.pi * LEFT_OUT)
LOG_2PI = math.log(2.0 * math.pi)
SIZES = math.log(20.0)
"""Boxes of nobody are of any size, uniform in the logarithm over a factor of 20."""
SWEEPS = 2
WIDER = 2.0
"""Association takes the variance of edges so many times: boxes have heavier tails than a normal distribution, and a
person who turns is off from the prediction in all cameras alike, which the cameras' boxes must not be denied for."""
BLIND = 0.01
"""Probability that a frame shows nobody of all who are there: it was not recorded, or the lens is covered."""
LEAST_SHARE = 0.02
FAR_EDGE = 4.0
"""An edge may be wrong that is off by more than this squared number of standard deviations."""
"""An association that is less probable than this moves nobody."""


class Boxes(NamedTuple):
    """Looks of one moment, packed: L looks with M boxes in all."""

    camera: Ints  # (L,)
    delay: Floats  # (L,) later than the moment's time [s]
    first: Ints  # (L + 1,) boxes of look l are first[l] to first[l + 1] - 1
    box: Floats  # (M, 4)
    believed: Bools  # (M, 4) edges that the border of the image does not cut
    clutter: Floats  # (M,) log of the expected number of boxes of nobody like it in score, in the look


class Rates(NamedTuple):
    """What is known of each camera's detector; C cameras."""

    detection: Floats  # (C,) probability of detection of a person in plain view
    curve: Floats  # (K,) factor of it at the visible shares 0, 1 / (K - 1), .., 1
    cut: float  # probability that a box ends where the cover of the feet begins
    wrong: float  # probability that one edge of a box, any of the four, is anywhere
    bias: Floats  # (C, 4) middle and width across, middle and height down, in heights, widths, heights, heights
    noise: Floats  # (4, 2) variances of the same: constant [px^2], and share squared
    sway: float  # variance of either middle besides, in heights squared; its errors last
    lasting: Floats  # (C,) how many times as much it counts in an update
    merge: Floats  # (C,) probability that two people who touch in the image are one box
    slow: float  # how many times as much the noise counts in an update, whose errors go on from look to look


class Result(NamedTuple):
    """Everybody after the update; N people, L looks, M boxes."""

    mean: Floats  # (N, 6)
    covariance: Floats  # (N, 6, 6)
    information: Floats  # (N, 6, 6) what the looks say of the state, in information form
    vector: Floats  # (N, 6)
    existence: Floats  # (N,)
    visible: Floats  # (L, N) visible share; NaN: outside the image
    detection: Floats  # (L, N) probability of detection that was used; 0 outside the image
    share: Floats  # (N, M) probability that the box is of the person alone, given that they exist
    joint: Floats  # (N, M) the same of the person and a neighbour together
    free: Floats  # (M,) probability that the box is of none of the people
    owner: Ints  # (M,) likeliest person; -1: nobody
    cuts: Floats  # (2,) boxes that end where the cover of the feet begins, and boxes of people whose feet are covered
    odd: Floats  # (M,) probability that one edge of the box is wrong or cut, if it is its owner's
    wrong: Floats  # (2,) boxes with a wrong edge, and all boxes
    merges: Floats  # (L, 2) pairs who touch and are one box, and all pairs who touch and of whom there is a box


@kernel
def interpolate(curve: Floats, share: float) -> float:
    """The curve at a share between 0 and 1, linear between its values."""
    at = min(max(share, 0.0), 1.0) * (curve.shape[0] - 1)
    k = min(int(at), curve.shape[0] - 2)
    value: float = curve[k] + (at - k) * (curve[k + 1] - curve[k])
    return value


@kernel
def edge_noise(box: Floats, rates: Rates, lasting: float, noise: Floats) -> None:
    """Write the covariance (4, 4) of the edges of a box that is expected at `box` (4,).

    Middle and size across have independent errors, and so have middle and height: left = middle - width / 2.
    The sway of bodies counts `lasting` times.
    """
    width, height = box[2] - box[0], box[3] - box[1]
    noise[:] = 0.0
    for axis in range(2):
        size = width if axis == 0 else height
        middle = rates.noise[2 * axis, 0] + (rates.noise[2 * axis, 1] + lasting * rates.sway) * height * height
        whole = rates.noise[2 * axis + 1, 0] + rates.noise[2 * axis + 1, 1] * size * size
        a, b = axis, axis + 2
        noise[a, a] = noise[b, b] = middle + 0.25 * whole
        noise[a, b] = noise[b, a] = middle - 0.25 * whole


@kernel
def shifted(box: Floats, bias: Floats, out: Floats) -> None:
    """Write the box (4,) as the camera's detector is expected to draw it."""
    width, height = box[2] - box[0], box[3] - box[1]
    u, v = 0.5 * (box[0] + box[2]) + bias[0] * height, 0.5 * (box[1] + box[3]) + bias[2] * height
    half_w, half_h = 0.5 * width * (1.0 + bias[1]), 0.5 * height * (1.0 + bias[3])
    out[0], out[1], out[2], out[3] = u - half_w, v - half_h, u + half_w, v + half_h


@kernel
def log_density(off: Floats, innovation: Floats, use: Bools, noise: Floats, spread: Floats) -> tuple[float, float]:
    """Log density of the edges in use and their squared Mahalanobis distance; `innovation` (4, 4) gets the inverse.

    Args:
        off: (4,) edges minus expected.
        innovation: (4, 4) written: inverse of the innovation's covariance, with `LEFT_OUT` for edges that are not used.
        use: (4,) edges in use.
        noise: (4, 4) of the edges.
        spread: (4, 4) of the expected edges.
    """
    S = np.empty((4, 4))
    count = 0
    for a in range(4):
        for b in range(4):
            S[a, b] = spread[a, b] + noise[a, b]
        if not use[a]:
            S[a, a] += LEFT_OUT
            count += 1
    log_determinant = invert(S, innovation)
    distance = 0.0
    for a in range(4):
        for b in range(4):
            distance += off[a] * innovation[a, b] * off[b]
    return -0.5 * (distance + log_determinant + 4 * LOG_2PI) + count * LOG_LEFT_OUT, distance


@kernel
def log_nobody(box: Floats, use: Bools, width: float, height: float) -> float:
    """Log density of the edges in use of a box of nobody: anywhere in the image, of any size."""
    total = 0.0
    for axis in range(2):
        extent = width if axis == 0 else height
        a, b = axis, axis + 2
        if use[a] or use[b]:
            total -= math.log(extent)
        if use[a] and use[b]:
            total -= math.log(max(box[b] - box[a], 1.0) * SIZES)
    return total


@kernel
def precision(noise: Floats, use: Bools, share: float, out: Floats) -> None:
    """Add `share` times the inverse of the covariance of the edges in use to (4, 4) `out`."""
    for axis in range(2):
        a, b = axis, axis + 2
        if use[a] and use[b]:
            det = noise[a, a] * noise[b, b] - noise[a, b] * noise[a, b]
            out[a, a] += share * noise[b, b] / det
            out[b, b] += share * noise[a, a] / det
            out[a, b] -= share * noise[a, b] / det
            out[b, a] -= share * noise[a, b] / det
        elif use[a]:
            out[a, a] += share / noise[a, a]
        elif use[b]:
            out[b, b] += share / noise[b, b]


@kernel
def update(
    mean: Floats,
    covariance: Floats,
    existence: Floats,
    views: Views,
    boxes: Boxes,
    rates: Rates,
    bonus: Floats,
    birth: float,
    gate: float,
) -> Result:
    """Everybody after the looks of a moment.

    Args:
        mean: (N, 6) predicted.
        covariance: (N, 6, 6).
        existence: (N,).
        views: cameras.
        boxes: of the moment.
        rates: of the detectors.
        bonus: (N, M) logs of likelihood ratios of hints and appearance.
        birth: expected number of boxes of people who are not among the N, as a share of those of nobody.
        gate: greatest squared Mahalanobis distance of a box.
    """
    N, L, M = mean.shape[0], boxes.camera.shape[0], boxes.box.shape[0]
    m, P = mean.copy(), covariance.copy()
    information, vector = np.empty((N, 6, 6)), np.empty((N, 6))
    for i in range(N):
        invert(P[i], information[i])
        vector[i] = information[i] @ m[i]
    site, site_vector = np.zeros((L, N, 6, 6)), np.zeros((L, N, 6))
    log_odds = np.log(existence) - np.log1p(-existence)
    site_odds = np.zeros((L, N))
    visible, detection = np.full((L, N), np.nan), np.zeros((L, N))
    share, joint, free = np.zeros((N, M)), np.zeros((N, M)), np.ones(M)
    owner = np.full(M, -1)
    cuts, merges, wrong, odd = np.zeros(2), np.zeros((L, 2)), np.zeros(2), np.zeros(M)
    # Scratch
    box, slope, noise = np.empty((N, 4)), np.zeros((N, 4, 6)), np.empty((N, 4, 4))
    drawn, spread, lasting = np.empty((N, 4)), np.empty((N, 4, 4)), np.empty((N, 4, 4))
    depth, deep = np.full(N, -1.0), np.ones(N)
    across, there = np.zeros(N), np.zeros(N)
    cells = np.empty((ROWS, COLUMNS))
    feet, inside = np.zeros(N), np.zeros(N)
    cavity_m, cavity_P = np.empty((N, 6)), np.empty((N, 6, 6))
    inverse, work = np.empty((4, 4)), np.empty((6, 6))
    off, use = np.empty(4), np.empty(4, dtype=np.bool_)
    union, union_noise, union_spread = np.empty(4), np.empty((4, 4)), np.empty((4, 4))
    alone = np.empty(N)
    for sweep in range(SWEEPS):
        for l in range(L):  # noqa: E741 - a look
            c, start, stop = boxes.camera[l], boxes.first[l], boxes.first[l + 1]
            width, height = views.size[c]
            # Cavity: the belief without this look's message
            for i in range(N):
                if sweep > 0:
                    work[:] = information[i] - site[l, i]
                    invert(work, cavity_P[i])
                    cavity_m[i] = cavity_P[i] @ (vector[i] - site_vector[l, i])
                else:
                    cavity_P[i], cavity_m[i] = P[i], m[i]
                there[i] = 1.0 / (1.0 + math.exp(-(log_odds[i] - site_odds[l, i])))
                # Expected box
                depth[i] = box_and_slope(views.lens[c], cavity_m[i], boxes.delay[l], box[i], slope[i])
                if depth[i] > 0.0:
                    inside[i] = inside_image(box[i], width, height, cells)
                    spread[i] = slope[i] @ cavity_P[i] @ slope[i].T
                    across[i] = math.sqrt(0.25 * max(spread[i, 0, 0] + 2.0 * spread[i, 0, 2] + spread[i, 2, 2], 0.0))
                    # Depth along the optical axis, of the place on the floor
                    fx, fy = views.rotation[c, 0, 2], views.rotation[c, 1, 2]
                    deep[i] = math.sqrt(
                        fx * fx * cavity_P[i, 0, 0]
                        + 2.0 * fx * fy * cavity_P[i, 0, 1]
                        + fy * fy * cavity_P[i, 1, 1]
                        + (0.1 * cavity_m[i, 5]) ** 2
                    )
                    shifted(box[i], rates.bias[c], drawn[i])
                    edge_noise(drawn[i], rates, 1.0, noise[i])
                    noise[i] *= WIDER
                    edge_noise(drawn[i], rates, rates.lasting[c] / rates.slow, lasting[i])
                    lasting[i] *= rates.slow
                else:
                    inside[i] = 0.0
            # Visible shares and probabilities of detection
            for i in range(N):
                visible[l, i], detection[l, i], feet[i] = np.nan, 0.0, 0.0
                distance = math.hypot(cavity_m[i, 0] - views.position[c, 0], cavity_m[i, 1] - views.position[c, 1])
                if depth[i] < 0.0 or inside[i] == 0.0 or distance > views.range[c]:
                    depth[i] = -1.0
                    continue
            for i in range(N):
                if depth[i] < 0.0:
                    continue
                inside_image(box[i], width, height, cells)
                x, y = cavity_m[i, 0], cavity_m[i, 1]
                hide_behind(views, c, x, y, cavity_m[i, 4], cavity_m[i, 5], cells)
                clear_cells(i, box, depth, across, deep, there, cells)
                visible[l, i] = np.mean(cells)
                bottom = 0.0
                for column in range(COLUMNS):
                    bottom += cells[ROWS - 1, column]
                feet[i] = 1.0 - bottom / COLUMNS
                detection[l, i] = rates.detection[c] * interpolate(rates.curve, visible[l, i])
            # Who touches whom may be one box with them, and has none alone
            pair = touching(box, depth, across, there)
            K = len(pair)
            alone[:] = detection[l]
            for k in range(K):
                a, b = pair[k]
                alone[a] *= 1.0 - rates.merge[c] * there[b]
                alone[b] *= 1.0 - rates.merge[c] * there[a]
            detection[l] = alone
            if stop == start:
                # Nobody at all: everybody was missed, or the frame is blind, which counts once for all of them (and for
                # all looks, where all are so)
                expected = 0.0
                for i in range(N):
                    expected += there[i] * detection[l, i]
                least = math.log(BLIND) / (max(expected, 1.0) * (1 if M > 0 else L))
                for i in range(N):
                    odds = max(math.log(max(1.0 - detection[l, i], 1e-6)), least)
                    log_odds[i] += odds - site_odds[l, i]
                    site_odds[l, i] = odds
                continue
            # Likelihood ratios of boxes to nobody's, how far all edges count, and which one does not otherwise
            ratio = np.zeros((N, stop - start))
            whole, left_out = np.ones((N, stop - start)), np.full((N, stop - start), -1)
            for i in range(N):
                if detection[l, i] < 1e-4:
                    continue
                for j in range(start, stop):
                    far, used = 0, 0
                    for e in range(4):
                        off[e] = boxes.box[j, e] - drawn[i, e]
                        use[e] = boxes.believed[j, e]
                        used += 1 if use[e] else 0
                        if use[e] and off[e] * off[e] > 2.0 * gate * (spread[i, e, e] + noise[i, e, e]):
                            far += 1
                    if far > 1:
                        continue
                    nobody = log_nobody(boxes.box[j], use, width, height) + boxes.clutter[j]
                    log_full, distance = log_density(off, inverse, use, noise[i], spread[i])
                    full = math.exp(log_full - nobody + bonus[i, j]) if distance < gate else 0.0
                    cut, most = rates.cut * feet[i], 0.0
                    for e in range(4):
                        chance, extent = 0.0, drawn[i, 2 + e % 2] - drawn[i, e % 2]
                        if e == 3 and cut > 0.01 and off[3] < 0.0:
                            # The box may end where the cover begins: its lower edge is anywhere below the middle
                            chance = cut / (0.8 * extent)
                        elif used > 3 and off[e] * off[e] > FAR_EDGE * (spread[i, e, e] + noise[i, e, e]):
                            # The edge is that of something else, or of a part
                            chance = 0.25 * rates.wrong / (2.0 * extent)
                        if chance == 0.0 or not use[e]:
                            continue
                        use[e] = False
                        log_part, distance = log_density(off, inverse, use, noise[i], spread[i])
                        use[e] = True
                        part = chance * math.exp(log_part - nobody + bonus[i, j]) if distance < gate else 0.0
                        if part > most:
                            most, left_out[i, j - start] = part, e
                    if off[3] < 0.0:
                        full *= 1.0 - cut
                    full *= 1.0 - rates.wrong
                    ratio[i, j - start] = full + most
                    if most > 0.0:
                        whole[i, j - start] = full / (full + most)
            # The same of the outlines of two
            both, own = np.zeros((K, stop - start)), np.empty((K, 4))
            for k in range(K):
                a, b = pair[k]
                outline(a, b, drawn, noise, spread, union, union_noise, union_spread, own[k])
                seen = rates.detection[c] * interpolate(rates.curve, max(visible[l, a], visible[l, b]))
                for j in range(start, stop):
                    near = True
                    for e in range(4):
                        off[e] = boxes.box[j, e] - union[e]
                        use[e] = boxes.believed[j, e]
                        if use[e] and off[e] * off[e] > 2.0 * gate * (union_spread[e, e] + union_noise[e, e]):
                            near = False
                    if not near:
                        continue
                    nobody = log_nobody(boxes.box[j], use, width, height) + boxes.clutter[j]
                    log_full, distance = log_density(off, inverse, use, union_noise, union_spread)
                    if distance < gate:
                        both[k, j - start] = rates.merge[c] * seen * math.exp(log_full - nobody) / (1.0 + birth)
            # Marginals by belief propagation; a box may be of somebody new
            weight, weight_both = np.zeros_like(ratio), np.zeros_like(both)
            for i in range(N):
                missed = 1.0 - there[i] * detection[l, i]
                for j in range(stop - start):
                    weight[i, j] = there[i] * detection[l, i] * ratio[i, j] / (missed * (1.0 + birth))
            for k in range(K):
                a, b = pair[k]
                chance = there[a] / (1.0 - there[a] * detection[l, a]) * there[b] / (1.0 - there[b] * detection[l, b])
                for j in range(stop - start):
                    weight_both[k, j] = chance * both[k, j]
            nu = pair_messages(weight, pair, weight_both)
            mine = np.zeros((K, 2, stop - start))
            for j in range(start, stop):
                free[j] = 1.0
                owner[j] = -1
            best_share = np.zeros(stop - start)
            for i in range(N):
                total = 1.0 - detection[l, i]
                for j in range(stop - start):
                    total += detection[l, i] * ratio[i, j] / (1.0 + birth) * nu.single[i, j]
                # Boxes with a neighbour
                for k in range(K):
                    for s in range(2):
                        if pair[k, s] != i:
                            continue
                        other = pair[k, 1 - s]
                        chance = there[other] / (1.0 - there[other] * detection[l, other])
                        for j in range(stop - start):
                            mine[k, s, j] = chance * both[k, j] * nu.partner[k, 1 - s, j] * nu.pair[k, j]
                            total += mine[k, s, j]
                odds = math.log(max(total, 1e-12))
                log_odds[i] += odds - site_odds[l, i]
                site_odds[l, i] = odds
                posterior = there[i] * total / (1.0 - there[i] + there[i] * total)
                best, best_j = 0.0, -1
                for j in range(stop - start):
                    p = detection[l, i] * ratio[i, j] / (1.0 + birth) * nu.single[i, j] / total
                    share[i, start + j], joint[i, start + j] = p, 0.0
                    free[start + j] -= posterior * p
                    if posterior * p > best_share[j]:
                        best_share[j] = posterior * p
                        owner[start + j] = i
                    if p > best:
                        best, best_j = p, j
                best_k, best_s = -1, 0
                for k in range(K):
                    for s in range(2):
                        if pair[k, s] != i:
                            continue
                        for j in range(stop - start):
                            mine[k, s, j] /= total
                            joint[i, start + j] += mine[k, s, j]
                            free[start + j] -= 0.5 * posterior * mine[k, s, j]
                            if mine[k, s, j] > best:
                                best, best_j, best_k, best_s = mine[k, s, j], j, k, s
                # Message: the boxes with their shares
                information[i] -= site[l, i]
                vector[i] -= site_vector[l, i]
                site[l, i] = 0.0
                site_vector[l, i] = 0.0
                if best > LEAST_SHARE:
                    Hm = slope[i] @ cavity_m[i]
                    j = best_j
                    p = best * best
                    W = np.zeros((4, 4))
                    for e in range(4):
                        use[e] = boxes.believed[start + j, e]
                    if best_k >= 0:
                        own_edges(lasting[i], use, own[best_k], best_s == 0, p, W)
                    else:
                        if sweep == SWEEPS - 1:
                            ends = left_out[i, j] == 3 and boxes.box[start + j, 3] < drawn[i, 3]
                            if boxes.believed[start + j, 3] and feet[i] > 0.5:
                                cuts[0] += p * (1.0 - whole[i, j]) if ends else 0.0
                                cuts[1] += p * feet[i]
                            if not (ends and feet[i] > 0.1):
                                wrong[0] += p * there[i] * (1.0 - whole[i, j])
                            wrong[1] += p * there[i]
                            odd[start + j] += p * (1.0 - whole[i, j])
                        precision(lasting[i], use, p * whole[i, j], W)
                        if whole[i, j] < 1.0:
                            use[left_out[i, j]] = False
                            precision(lasting[i], use, p * (1.0 - whole[i, j]), W)
                    z = boxes.box[start + j] - drawn[i] + Hm
                    HW = slope[i].T @ W
                    site[l, i] += HW @ slope[i]
                    site_vector[l, i] += HW @ z
                information[i] += site[l, i]
                vector[i] += site_vector[l, i]
                if best > LEAST_SHARE or sweep > 0:
                    invert(information[i], P[i])
                    m[i] = P[i] @ vector[i]
            for j in range(start, stop):
                free[j] = max(free[j], 0.0)
            if sweep == SWEEPS - 1:
                for k in range(K):
                    a, b = pair[k]
                    certain = there[a] * there[b]
                    merged = 0.5 * (mine[k, 0].sum() + mine[k, 1].sum())
                    apart = max(share[a, start:stop].sum(), share[b, start:stop].sum())
                    merges[l, 0] += certain * merged
                    merges[l, 1] += certain * min(merged + apart, 1.0)
    return Result(
        mean=m,
        covariance=P,
        information=site.sum(axis=0),
        vector=site_vector.sum(axis=0),
        existence=1.0 / (1.0 + np.exp(-log_odds)),
        visible=visible,
        detection=detection,
        share=share,
        joint=joint,
        free=free,
        owner=owner,
        cuts=cuts,
        odd=odd,
        wrong=wrong,
        merges=merges,
    )
