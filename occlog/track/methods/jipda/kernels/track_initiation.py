"""Track initiation: new people that explain unassigned boxes of one or several cameras.

Each unassigned box proposes a person: the most probable position, height and width, with their covariance (Laplace
approximation). The boxes of the other cameras are then added one camera at a time: a visible person must be detected
with the detection probability, given the occlusion by other people. The result is the log odds of a new person against
all of these boxes being clutter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.core.numerics.jit import kernel

from .body_box import MODEL, POSITION_SOURCE, PackedCameras, box_and_slope
from .detections import (
    LOG_2PI,
    DetectorModel,
    PackedDetections,
    add_precision,
    biased,
    edge_noise,
    interpolate,
    log_clutter,
    log_density,
    position_noise,
)
from .linear import invert
from .visibility import COLUMNS, ROWS, centre_deviation, in_view, visibility

NEWTON_STEPS = 4
MIN_UNASSIGNED_PROBABILITY = 0.2
"""Minimum unassigned probability of a box that proposes a new person."""


class TrackedPeople(NamedTuple):
    """Existing tracks, projected into the L frames of a time step; N people.

    `existence` (N + 1,), expected `box` (L, N + 1, 4) [px], `depth` (L, N + 1) along the optical axis (negative: not in
    front of the camera), and standard deviations of the box's horizontal centre `across` (L, N + 1) [px] and of the
    depth `deep` (N + 1,). The last entry of each is free for a proposed new person.
    """

    existence: Floats  # (N + 1,)
    box: Floats  # (L, N + 1, 4) expected boxes; the last position is for a new target
    depth: Floats  # (L, N + 1) along the optical axis; negative: not in front of the camera
    across: Floats  # (L, N + 1) standard deviation of the box's middle, across the image [px]
    deep: Floats  # (N + 1,) standard deviation of the depth


class BirthIntensity(NamedTuple):
    """Expected numbers of new people since the last time step, as a map over the ground plane.

    `everywhere` is a uniform intensity [1/scene unit^2]; the intensities `at` (G,) are added at `centre` (G, 2),
    falling off as Gaussians of standard deviation `smooth`. `in_image` is the greatest expected number in one image: it
    bounds the intensity where people are small in the image.
    """

    everywhere: float  # a unit of area
    in_image: float  # in an image: what is far away and small in it counts less
    centre: Floats  # (G, 2) positions
    at: Floats  # (G,) also, a unit of area there, falling with the distance from it
    smooth: float  # as a Gaussian of this deviation


@kernel
def point_at_height(views: PackedCameras, c: int, u: float, v: float, z: float, position: Floats) -> bool:
    """Write the world x, y (2,) where the ray of pixel (u, v) of camera c meets the horizontal plane at height z.

    Return False, without writing, if that is behind the camera or the ray is parallel. Lens distortion is ignored: the
    position starts an iteration.
    """
    x = (u - views.principal[c, 0]) / views.focal[c, 0]
    y = (v - views.principal[c, 1]) / views.focal[c, 1]
    R = views.rotation[c]
    up = R[2, 0] * x + R[2, 1] * y + R[2, 2]
    if abs(up) < 1e-9:
        return False
    along = (z - views.position[c, 2]) / up
    if along <= 0.0:
        return False
    position[0] = views.position[c, 0] + along * (R[0, 0] * x + R[0, 1] * y + R[0, 2])
    position[1] = views.position[c, 1] + along * (R[1, 0] * x + R[1, 1] * y + R[1, 2])
    return True


@kernel
def arrivals_at(arrival: BirthIntensity, mean: Floats) -> float:
    """Return the birth intensity (expected new people per unit of area) at the position of the state `mean` (6,)."""
    expected_new = arrival.everywhere
    for g in range(arrival.centre.shape[0]):
        dx, dy = mean[0] - arrival.centre[g, 0], mean[1] - arrival.centre[g, 1]
        distance2 = (dx * dx + dy * dy) / (arrival.smooth * arrival.smooth)
        if arrival.at[g] > 0.0 and distance2 < 16.0:
            expected_new += arrival.at[g] * math.exp(-0.5 * distance2)
    return float(expected_new)


@kernel
def state_from_box(
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    body: Floats,
    arrival: BirthIntensity,
    c: int,
    j: int,
    mean: Floats,
    covariance: Floats,
) -> float:
    """Write the state and covariance of a new person that made box `j`; return the log marginal density of the box.

    The density is that of the box times the birth intensity, integrated over the state (Laplace approximation by four
    Gauss-Newton steps); NaN if no person can have made the box.

    Args:
        views: cameras and position sensors.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        body: (5,) mean height and its deviation, mean width and its deviation, deviation of a velocity per axis.
        arrival: expected numbers of new people.
        c: index of the box's camera.
        j: index of the box.
        mean: (6,) written: x, y, vx, vy, height, width.
        covariance: (6, 6) written.
    """
    box, usable = boxes.box[j], boxes.usable[j]
    if views.lens[c, MODEL] == POSITION_SOURCE:
        noise = np.empty((4, 4))
        position_noise(boxes, j, 1.0, noise)
        mean[0], mean[1], mean[2], mean[3], mean[4], mean[5] = box[0], box[1], 0.0, 0.0, body[0], body[2]
        covariance[:] = 0.0
        covariance[:2, :2] = noise[:2, :2]
        covariance[2, 2] = covariance[3, 3] = body[4] ** 2
        covariance[4, 4], covariance[5, 5] = body[1] ** 2, body[3] ** 2
        share = 1.0 / (views.size[c, 0] * views.size[c, 1])
        return math.log(min(arrivals_at(arrival, mean), arrival.in_image * share) + 1e-300)
    position = np.empty(2)
    middle = 0.5 * (box[0] + box[2])
    found = False
    if usable[3]:
        found = point_at_height(views, c, middle, box[3], 0.0, position)
    elif usable[1]:
        found = point_at_height(views, c, middle, box[1], body[0], position)
    if not found or not (usable[0] or usable[2]):
        return math.nan
    distance = math.hypot(position[0] - views.position[c, 0], position[1] - views.position[c, 1])
    if distance > views.range[c]:
        return math.nan
    mean[0], mean[1], mean[2], mean[3], mean[4], mean[5] = position[0], position[1], 0.0, 0.0, body[0], body[2]
    expected, slope, noise, drawn = np.empty(4), np.zeros((4, 6)), np.empty((4, 4)), np.empty(4)
    prior = np.array([0.0, 0.0, 1.0 / body[4] ** 2, 1.0 / body[4] ** 2, 1.0 / body[1] ** 2, 1.0 / body[3] ** 2])
    at = np.array([0.0, 0.0, 0.0, 0.0, body[0], body[2]])
    W = np.empty((4, 4))
    for _ in range(NEWTON_STEPS):
        if box_and_slope(views.lens[c], mean, 0.0, expected, slope) < 0.0:
            return math.nan
        biased(expected, rates.bias[c], drawn)
        edge_noise(drawn, rates, 1.0, noise)
        W[:] = 0.0
        add_precision(noise, usable, 1.0, W)
        information = slope.T @ W @ slope
        vector = slope.T @ W @ (box - drawn + slope @ mean)
        for k in range(6):
            information[k, k] += prior[k]
            vector[k] += prior[k] * at[k]
        log_determinant = invert(information, covariance)
        if math.isnan(log_determinant):
            return math.nan
        mean[:] = covariance @ vector
        mean[4], mean[5] = max(mean[4], 0.3 * body[0]), max(mean[5], 0.3 * body[2])
    if box_and_slope(views.lens[c], mean, 0.0, expected, slope) < 0.0:
        return math.nan
    biased(expected, rates.bias[c], drawn)
    # Density of the box at the best body times that of the body, and Laplace's volume without the velocity
    inverse = np.empty((4, 4))
    log_box, _ = log_density(box - drawn, inverse, usable, noise, np.zeros((4, 4)))
    high, wide = (mean[4] - body[0]) / body[1], (mean[5] - body[2]) / body[3]
    log_body = -0.5 * (high * high + wide * wide) - math.log(body[1] * body[3]) - LOG_2PI
    total: float = log_box + log_body + 2.0 * LOG_2PI - 0.5 * (log_determinant + 4.0 * math.log(body[4]))
    # Where a square unit is small in the image, fewer people are expected on it
    across, down = 0.5 * (slope[0] + slope[2]), slope[3]
    area = abs(across[0] * down[1] - across[1] * down[0]) / (views.size[c, 0] * views.size[c, 1])
    return total + math.log(min(arrivals_at(arrival, mean), arrival.in_image * area) + 1e-300)


@kernel
def predicted_targets(
    views: PackedCameras, boxes: PackedDetections, people: Floats, spread: Floats, existence: Floats
) -> TrackedPeople:
    """Project N existing tracks into each of the L frames of a time step.

    `people` are (N, 6) states x, y, vx, vy, height, width, `spread` (N,) standard deviations of their positions per
    axis, `existence` (N,) probabilities. Delays of frames are ignored.
    """
    L, N = boxes.camera.shape[0], people.shape[0]
    box, depth, across = np.empty((L, N + 1, 4)), np.empty((L, N + 1)), np.empty((L, N + 1))
    deep, there, slope = np.empty(N + 1), np.ones(N + 1), np.zeros((4, 6))
    for i in range(N):
        deep[i], there[i] = spread[i] + 0.1 * people[i, 5], existence[i]
        for l in range(L):  # noqa: E741 - a frame
            c = boxes.camera[l]
            depth[l, i] = box_and_slope(views.lens[c], people[i], 0.0, box[l, i], slope)
            if depth[l, i] > 0.0:
                across[l, i] = spread[i] * views.focal[c, 0] / depth[l, i]
    return TrackedPeople(there, box, depth, across, deep)


@kernel
def propose_track(
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    body: Floats,
    arrival: BirthIntensity,
    tracked: TrackedPeople,
    free: Floats,
    frame: int,
    seed: int,
    gate: float,
    mean: Floats,
    covariance: Floats,
    used: Floats,
) -> float:
    """Return the log odds that box `seed` and boxes of the other frames are of one new person; write its state.

    -inf if no person of plausible height can have made the box.

    Args:
        views: cameras and position sensors.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        body: (5,) mean height and its deviation, mean width and its deviation, deviation of a velocity per axis.
        arrival: expected numbers of new people.
        tracked: existing tracks, which may occlude the new person; their last entry is overwritten.
        free: (M,) probability that a box is of no tracked person.
        frame: index of the frame of box `seed`.
        seed: index of the box that proposes.
        gate: greatest squared Mahalanobis distance.
        mean: (6,) written: x, y, vx, vy, height, width.
        covariance: (6, 6) written.
        used: (M,) written: probability that each box is of the new person.
    """
    c = boxes.camera[frame]
    used[:] = 0.0
    log_seed = state_from_box(views, boxes, rates, body, arrival, c, seed, mean, covariance)
    if math.isnan(log_seed) or mean[4] > body[0] + 4.0 * body[1] or mean[4] < body[0] - 5.0 * body[1]:
        return -math.inf
    width, height = views.size[c]
    false = log_clutter(boxes.box[seed], boxes.usable[seed], width, height) + boxes.clutter[seed]
    N = tracked.deep.shape[0] - 1
    total = log_seed + math.log(max(free[seed], 1e-6)) - false
    used[seed] = 1.0
    information, vector = np.empty((6, 6)), np.empty(6)
    invert(covariance, information)
    vector[:] = information @ mean
    deep = tracked.deep
    slope, noise, drawn, inverse = np.zeros((4, 6)), np.empty((4, 4)), np.empty(4), np.empty((4, 4))
    cells, W = np.empty((ROWS, COLUMNS)), np.empty((4, 4))
    for l in range(boxes.camera.shape[0]):  # noqa: E741 - a frame
        c = boxes.camera[l]
        box, depth, across = tracked.box[l], tracked.depth[l], tracked.across[l]
        depth[N] = box_and_slope(views.lens[c], mean, 0.0, box[N], slope)
        if depth[N] < 0.0 or not in_view(views, c, mean[0], mean[1], box[N], cells):
            continue
        P = slope @ covariance @ slope.T
        across[N] = centre_deviation(P)
        deep[N] = math.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])) + 0.1 * mean[5]
        visible = visibility(views, c, mean, N, box, depth, across, deep, tracked.existence, cells)
        detection = rates.detection[c] * interpolate(rates.curve, visible)
        if l == frame:
            total += math.log(max(detection, 1e-6))
            continue
        biased(box[N], rates.bias[c], drawn)
        edge_noise(drawn, rates, 1.0, noise)
        best, best_j, summed = 0.0, -1, 0.0
        for j in range(boxes.first[l], boxes.first[l + 1]):
            if free[j] < 0.05:
                continue
            position_noise(boxes, j, 1.0, noise)
            off = boxes.box[j] - drawn
            if abs(off[0] + off[2]) > 4.0 * math.sqrt(gate * (across[N] * across[N] + noise[0, 0])):
                continue
            log_ratio, distance = log_density(off, inverse, boxes.usable[j], noise, P)
            if distance > gate:
                continue
            log_ratio -= log_clutter(boxes.box[j], boxes.usable[j], views.size[c, 0], views.size[c, 1])
            ratio = free[j] * math.exp(log_ratio - boxes.clutter[j])
            summed += ratio
            if ratio > best:
                best, best_j = ratio, j
        total += math.log(1.0 - detection + detection * summed)
        if best_j >= 0:
            p = detection * best / (1.0 - detection + detection * summed)
            used[best_j] = p
            if p > 0.5:
                position_noise(boxes, best_j, 1.0, noise)
                W[:] = 0.0
                add_precision(noise, boxes.usable[best_j], p, W)
                HW = slope.T @ W
                information += HW @ slope
                vector += HW @ (boxes.box[best_j] - drawn + slope @ mean)
                invert(information, covariance)
                mean[:] = covariance @ vector
    return float(total)


@kernel
def initiate_targets(
    views: PackedCameras,
    boxes: PackedDetections,
    rates: DetectorModel,
    body: Floats,
    arrival: BirthIntensity,
    people: Floats,
    spread: Floats,
    existence: Floats,
    free: Floats,
    gate: float,
    least: float,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Initiate K tracks from unassigned boxes, the most probable first.

    Args:
        views: cameras and position sensors.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        body: (5,) mean height and its deviation, mean width and its deviation, deviation of a velocity per axis.
        arrival: expected numbers of new people.
        people: (N, 6) states of the existing tracks.
        spread: (N,) standard deviations of these positions per axis.
        existence: (N,) existence probabilities of these tracks.
        free: (M,) probability that a box is of no existing track.
        gate: greatest squared Mahalanobis distance.
        least: log odds below which no track is initiated.

    Returns:
        Means (K, 6) x, y, vx, vy, height, width; covariances (K, 6, 6); log odds (K,) of a person against clutter;
        probabilities (K, M) that a box is of the new track.
    """
    M, L = boxes.box.shape[0], boxes.camera.shape[0]
    open_share = free.copy()
    frame_of = np.empty(M, dtype=np.int64)
    for l in range(L):  # noqa: E741 - a frame
        frame_of[boxes.first[l] : boxes.first[l + 1]] = l
    mean, covariance = np.zeros((M, 6)), np.zeros((M, 6, 6))
    odds, used = np.full(M, -np.inf), np.zeros((M, M))
    stale = np.zeros(M, dtype=np.bool_)
    tracked = predicted_targets(views, boxes, people, spread, existence)
    for j in range(M):
        if open_share[j] > MIN_UNASSIGNED_PROBABILITY:
            odds[j] = propose_track(
                views, boxes, rates, body, arrival, tracked, open_share, frame_of[j], j, gate,
                mean[j], covariance[j], used[j],
            )  # fmt: skip
    taken, final = np.zeros(M, dtype=np.int64), np.zeros(M)
    count = 0
    while True:
        j = int(np.argmax(odds)) if M > 0 else -1
        if j < 0 or odds[j] < least:
            break
        if stale[j]:
            # One of its boxes went to another person since: propose again
            stale[j] = False
            odds[j] = -np.inf
            if open_share[j] > MIN_UNASSIGNED_PROBABILITY:
                odds[j] = propose_track(
                    views, boxes, rates, body, arrival, tracked, open_share, frame_of[j], j, gate,
                    mean[j], covariance[j], used[j],
                )  # fmt: skip
            continue
        taken[count], final[count] = j, odds[j]
        count += 1
        r = 1.0 / (1.0 + math.exp(-odds[j]))
        odds[j] = -np.inf
        for k in range(M):
            if used[j, k] > 0.0:
                open_share[k] = max(open_share[k] - r * used[j, k], 0.0)
        for k in range(M):
            if odds[k] > -np.inf:
                for b in range(M):
                    if used[j, b] * used[k, b] > 0.01:
                        stale[k] = True
                        break
    rows = taken[:count]
    return mean[rows], covariance[rows], final[:count], used[rows]
