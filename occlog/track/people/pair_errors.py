"""Errors of lens distortion, and cameras that moved, by least squares from people whom two cameras locate.

Each camera locates the person in a box by feet on the ground and head above them.  Where two cameras differ,
rotations of them, radial distortion that their calibrations lack, and the distance of the feet from the lower edge
explain it: the normal equations of all pairs of cameras, in batches of time, give these with standard errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.track.methods.jipda.normal_equations import MIN_BATCHES, solve_batches

from .pair_overlap import FEET_HEIGHTS, BoxesOfCamera, ideal, located, located_by_ends, paired_rows, upright

BATCHES, ITERATIONS, MIN_PAIRS = 24, 2, 10
"""Batches of time, iterations of pairing and least squares, and pairs of boxes of two cameras that count."""
YAW, PITCH, RADIAL, FEET = range(4)
OWN = 3
"""Parameters of a camera, before that of all: feet."""
PRIOR = np.array([0.03, 0.03, 0.2, 0.1])
"""Standard deviations of the parameters before any box: rotations [rad], coefficient of the squared radius, distance of
the feet beyond the lower edge (in addition to `FEET_HEIGHTS`) in heights of people."""
EDGE_PX, EDGE_SHARE, ACROSS = 3.0, 0.02, 0.7
"""Errors of upper and lower edges: pixels, and share of the height; those of middles, relative to these."""
BODY_HEIGHTS = np.array([0.03, 0.03, 0.015])
"""Errors of x, y and height by posture, in heights."""
MAX_CHI2, MAX_APART_HEIGHTS, SETTLED = 16.0, 1.2, 0.3
"""Boxes of two cameras that are of one person: squared distance in standard deviations, distance in heights, and share
of the prior standard deviations that is left after an iteration."""
STUDENT = 6.0
"""Weights fall with the squared distance over this, as those of Student's t."""
RADIUS_QUANTILE, MIN_OFFSET_HEIGHTS = 0.95, 0.05
"""Quantile of the boxes' radii at which the offset is stated, and the least that matters, in median heights of boxes:
smaller ones are no larger than errors of boxes."""
MAX_RADIAL, MIN_OF_ROTATION = 0.6, 2.0
"""Largest coefficient of a lens, and least offset relative to that by a rotation of any camera; otherwise there is
another mistake."""
LIMIT_FACTOR = 1.4
"""Ratio of critical values of Bartlett's weights over a quarter of the batches to those of Student's t (Kiefer and
Vogelsang 2005, Table 1: fixed b)."""
MIN_MOVEMENT = np.radians(1.0)
"""Least rotation during a recording that is stated [rad]."""
STEP = 1e-3
"""Step of the difference quotients."""


class RadialError(NamedTuple):
    """Radial distortion that a calibration lacks.

    Attributes:
        camera: its number.
        coefficient: k; points at the radius r of the ideal image are at r (1 + k r^2).
        offset_px: that offset at the radius within which 95 % of the camera's boxes are [px].
    """

    camera: int
    coefficient: float
    offset_px: float


class Movement(NamedTuple):
    """A rotation of a camera at a time of the recording.

    Attributes:
        camera: its number.
        share: of the time steps that are before.
        before, after: (2,) errors of yaw and pitch [rad]: what its points in the ideal image lack.
    """

    camera: int
    share: float
    before: Floats
    after: Floats


class PairFit(NamedTuple):
    """Parameters of C cameras.

    Attributes:
        values: (C, 4) least squares.
        limit: (C,) least significant coefficients of the radius.
        normal: (B, K, K + 1) normal equations of cameras as they are stated.
    """

    values: Floats
    limit: Floats
    normal: Floats


def fit_pairs(views: Sequence[BoxesOfCamera], steps: int, person_height: float) -> PairFit:
    """Least squares of all pairs of cameras.

    Args:
        views: cameras with their boxes.
        steps: number of time steps.
        person_height: in the scene's unit.
    """
    cameras = [_LocatingCamera(view, person_height) for view in views]
    C, count = len(cameras), OWN * len(cameras) + 1
    values, limit, first = np.zeros((C, len(PRIOR))), np.full(C, np.inf), None
    for _ in range(ITERATIONS):
        for c, camera in enumerate(cameras):
            camera.locate(values[c], 1.0 if first is None else SETTLED)
        normal = np.zeros((BATCHES, count, count + 1))
        for a, b in combinations(range(C), 2):
            own = np.r_[OWN * a : OWN * (a + 1), OWN * b : OWN * (b + 1), OWN * C]
            part = _of_pair(cameras[a], cameras[b], steps, person_height)
            normal[np.ix_(range(BATCHES), own, np.r_[own, count])] += part
        solution, found = solve_batches(normal, 1.0)
        values[:, :OWN] += solution[:-1].reshape(C, OWN) * PRIOR[:OWN]
        values[:, FEET] += solution[-1] * PRIOR[FEET]
        limit = LIMIT_FACTOR * found[RADIAL:-1:OWN] * PRIOR[RADIAL]
        first = normal if first is None else first
    return PairFit(values, limit, np.zeros((BATCHES, count, count + 1)) if first is None else first)


def movements(fit: PairFit) -> list[Movement]:
    """The camera that rotated most at one time, if significantly, one in a million by chance."""
    C = len(fit.values)
    parts = [(fit.normal[:s], fit.normal[s:]) for s in range(MIN_BATCHES, BATCHES - MIN_BATCHES + 1)]
    # The split with the least sum of squares
    split = max(range(len(parts)), key=lambda k: sum(_explained(part) for part in parts[k]))
    solved = [solve_batches(part, 1.0) for part in parts[split]]
    angles, limits = (np.array([each[n][:-1].reshape(C, OWN)[:, :RADIAL] for each in solved]) for n in (0, 1))
    change, limit = (
        np.abs(angles[1] - angles[0]) * PRIOR[:RADIAL],
        LIMIT_FACTOR * np.linalg.norm(limits, axis=0) * PRIOR[:RADIAL],
    )
    change[~(change > np.maximum(limit, MIN_MOVEMENT))] = 0.0
    if not change.any():
        return []
    c = int(np.argmax(np.linalg.norm(change, axis=1)))
    before, after = angles[:, c] * PRIOR[:RADIAL]
    return [Movement(c, (MIN_BATCHES + split) / BATCHES, before, after)]


def _explained(normal: Floats) -> float:
    """Squares that the least-squares solution of batches (B, K, K + 1) explains."""
    N, b = normal[..., :-1].sum(axis=0) + np.eye(normal.shape[1]), normal[..., -1].sum(axis=0)
    return float(b @ np.linalg.solve(N, b))


def radial_errors(views: Sequence[BoxesOfCamera], fit: PairFit) -> list[RadialError]:
    """Significant errors of radial distortion that matter, one in a million by chance."""
    values, limit = fit.values, fit.limit
    size = np.abs(values[:, RADIAL])
    rotations = np.abs(values[:, [YAW, PITCH]]).max(axis=1) * [view.camera.focal_px.mean() for view in views]
    out: list[RadialError] = []
    for c in np.flatnonzero((size > limit) & (size < MAX_RADIAL)).tolist():
        own, k = views[c], float(values[c, RADIAL])
        radii = np.linalg.norm(ideal(own.camera, _edge_middles(own.boxes)), axis=1)
        offset_px = k * float(np.nanquantile(radii, RADIUS_QUANTILE)) ** 3 * float(own.camera.focal_px.mean())
        tall = float(np.median(own.boxes[:, 3] - own.boxes[:, 1]))
        if abs(offset_px) > max(MIN_OFFSET_HEIGHTS * tall, MIN_OF_ROTATION * float(rotations.max())):
            out.append(RadialError(c, k, offset_px))
    return out


def without_radial_error(view: BoxesOfCamera, coefficient: float) -> BoxesOfCamera:
    """The camera with boxes as they would be if the calibration had the lens's distortion."""
    camera = view.camera
    xy = ideal(camera, _edge_middles(view.boxes))
    xy = xy * (1.0 + coefficient * (xy**2).sum(axis=1, keepdims=True))
    points = camera.position + np.column_stack([xy, np.ones(len(xy))]) @ camera.rotation.T
    left, top, right, bottom = camera.project(points).reshape(4, -1, 2)
    return view._replace(boxes=np.column_stack([left[:, 0], top[:, 1], right[:, 0], bottom[:, 1]]))


def _edge_middles(boxes: Floats) -> Floats:
    """(4 n, 2) middles of the left, upper, right and lower edges of boxes (n, 4)."""
    u, v = 0.5 * (boxes[:, 0] + boxes[:, 2]), 0.5 * (boxes[:, 1] + boxes[:, 3])
    edges = ((boxes[:, 0], v), (u, boxes[:, 1]), (boxes[:, 2], v), (u, boxes[:, 3]))
    return np.concatenate([np.column_stack(edge) for edge in edges])


class _LocatingCamera:
    """A camera, and the people in its boxes: feet and heads in the ideal image, and where these place them."""

    def __init__(self, view: BoxesOfCamera, person_height: float) -> None:
        """Take the boxes that locate a person."""
        self.camera, self.height = view.camera, person_height
        own = np.isfinite(located(view, person_height)).all(axis=1)
        boxes, self.steps = view.boxes[own], view.steps[own]
        self.ends = upright(self.camera, boxes)
        self.errors, slopes = self.covariance(self.ends), self.slopes(self.ends)[..., :OWN]
        self.by_prior = slopes @ slopes.transpose(0, 2, 1)
        known = np.isfinite(self.errors).all(axis=(1, 2)) & np.isfinite(self.by_prior).all(axis=(1, 2))
        self.ends[:, ~known] = np.nan
        self.locate(np.zeros(len(PRIOR)), 1.0)

    def locate(self, values: Floats, prior: float) -> None:
        """Locate the people with parameters (4,) that are uncertain by a share of the prior standard deviations."""
        self.people, self.covariances = self.located(self.ends, values), self.errors + prior**2 * self.by_prior

    def located(self, ends: Floats, values: Floats) -> Floats:
        """(n, 3) x, y and height of people by their feet and heads (2, n, 2), with the parameters (4,)."""
        feet, head = ends * (1.0 + values[RADIAL] * (ends**2).sum(axis=-1, keepdims=True)) + values[[YAW, PITCH]]
        return located_by_ends(self.camera, feet, head, (FEET_HEIGHTS + values[FEET]) * self.height)

    def seen(self, people: Floats) -> Floats:
        """(2, n, 2) feet and heads of people (n, 3) in the ideal image."""
        feet = people * [1.0, 1.0, 0.0]
        at = (np.stack([feet, people]) - self.camera.position) @ self.camera.rotation
        return np.asarray(at[..., :2] / at[..., 2:])

    def slopes(self, ends: Floats) -> Floats:
        """(n, 3, 4) derivatives of where people are by the parameters, in prior standard deviations."""
        steps = STEP * np.eye(len(PRIOR))
        parts = [self.located(ends, e) - self.located(ends, -e) for e in steps]
        return np.asarray(np.stack(parts, axis=2) * PRIOR / (2.0 * STEP))

    def covariance(self, ends: Floats) -> Floats:
        """(n, 3, 3) covariance of where people are, by errors of boxes and posture."""
        none = np.zeros(len(PRIOR))
        sigma = np.hypot(EDGE_PX / self.camera.focal_px.mean(), EDGE_SHARE * (ends[0, :, 1] - ends[1, :, 1]))
        moves = STEP * np.array([[[1.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 1.0]]])
        parts = [self.located(ends + m[:, None], none) - self.located(ends - m[:, None], none) for m in moves]
        by_edge = np.stack(parts, axis=2) / (2.0 * STEP) * [ACROSS, 1.0, 1.0] * sigma[:, None, None]
        body = np.diag((BODY_HEIGHTS * self.height) ** 2)
        return np.asarray(by_edge @ by_edge.transpose(0, 2, 1) + body)


def _of_pair(a: _LocatingCamera, b: _LocatingCamera, steps: int, person_height: float) -> Floats:
    """(B, 7, 8) normal equations of two cameras: their parameters, and that of all."""
    out = np.zeros((BATCHES, 2 * OWN + 1, 2 * OWN + 2))
    i, j = _of_one_person(a, b, MAX_APART_HEIGHTS * person_height)
    if len(i) < MIN_PAIRS:
        return out
    apart = a.people[i] - b.people[j]
    # Errors and slopes at the position by both cameras: at that by one of them they follow its error
    first, second = a.errors[i], b.errors[j]
    share = (second @ np.linalg.solve(first + second, apart[..., None]))[..., 0]
    ends = [each.seen(b.people[j] + share) for each in (a, b)]
    weight = np.linalg.inv(a.covariance(ends[0]) + b.covariance(ends[1]))
    weight /= (1.0 + np.einsum("ni,nij,nj->n", apart, weight, apart) / STUDENT)[:, None, None]
    first, second = a.slopes(ends[0]), b.slopes(ends[1])
    G = np.concatenate([-first[..., :OWN], second[..., :OWN], second[..., OWN:] - first[..., OWN:]], axis=2)
    sums = G.transpose(0, 2, 1) @ weight @ np.concatenate([G, apart[..., None]], axis=2)
    there = np.isfinite(sums).all(axis=(1, 2))
    np.add.at(out, (a.steps[i] * BATCHES // steps)[there], sums[there])
    return out


def _of_one_person(a: _LocatingCamera, b: _LocatingCamera, farthest: float) -> tuple[Ints, Ints]:
    """Rows of two cameras with people who are nearest to each other, and within a distance."""
    i, j = paired_rows(a.steps, b.steps)
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(a.people[i, :2] - b.people[j, :2], axis=1) < farthest  # not of those without a position
    i, j = i[near], j[near]
    apart = (a.people[i] - b.people[j])[..., None]
    chi2 = (apart * np.linalg.solve(a.covariances[i] + b.covariances[j], apart)).sum(axis=(1, 2))
    i, j, chi2 = (each[chi2 < MAX_CHI2] for each in (i, j, chi2))
    nearest = np.full(len(a.people), np.inf), np.full(len(b.people), np.inf)
    for best, own in zip(nearest, (i, j), strict=True):
        np.minimum.at(best, own, chi2)
    mutual = (chi2 <= nearest[0][i]) & (chi2 <= nearest[1][j])
    return i[mutual], j[mutual]
