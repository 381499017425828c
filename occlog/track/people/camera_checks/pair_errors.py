"""Errors of single cameras, by least squares over people that two cameras locate.

Each camera locates a person by the feet on the ground and the head above them. Differences between two cameras are
explained by errors of their orientation, radial distortion, focal length, height and clock, and by the distance of the
feet from the lower edge; the normal equations sum over all pairs of cameras. Among the hypotheses of one error of one
camera, or of a movement during the recording, the one with the largest evidence is reported (MacKay 1992), with a prior
that allows all other parameters the size of usual calibration errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.track.methods.jipda.lasting_errors.normal_equations import newey_west

from .pair_overlap import FEET_HEIGHTS, BoxesOfCamera, ideal, located, located_by_ends, paired_rows, upright

BATCHES, ITERATIONS, MIN_PAIRS = 24, 2, 10
"""Batches of time, iterations of pairing and least squares, and pairs of boxes of two cameras that count."""
YAW, PITCH, RADIAL, FOCAL, HEIGHT, LATE, FEET, LOOSE = range(8)
OWN, COMMON = 6, 2
"""Numbers of parameters of a camera, and of those of all: feet, and how loose boxes are."""
PRIOR = np.array([0.03, 0.03, 0.2, 0.06, 0.1, 0.2, 0.1, 3.0])
"""Standard deviations of the parameters of pairs before any box: rotations [rad], coefficient of the squared radius,
share of the focal length, height of the camera in heights of people, delay [s], distance of the feet beyond the lower
edge (in addition to `FEET_HEIGHTS`) in heights of people, and distance of the upper and lower edges from the body
[px]."""
USUAL = np.array([0.1, 0.1, 0.15, 0.1, 0.2, 0.02])
"""Standard deviations of the errors of usual calibrations, relative to `PRIOR`: 0.17 degrees, 0.03, 0.6 %, 3 cm,
4 ms."""
FAULT = np.array([2.0, 2.0, 1.0, 1.5, 2.0, 1.0])
"""Those of an error that is to be stated."""
EDGE_PX, EDGE_SHARE, ACROSS = 3.0, 0.02, 0.7
"""Errors of upper and lower edges: pixels, and share of the height; those of middles, relative to these."""
BODY_HEIGHTS = np.array([0.03, 0.03, 0.015])
"""Errors of x, y and height by posture, in heights."""
MAX_CHI2, MAX_APART_HEIGHTS, SETTLED = 16.0, 1.2, 0.3
"""Boxes of two cameras that are of one person: squared distance in standard deviations, distance in heights, and share
of the prior standard deviations that is left after an iteration."""
STUDENT = 6.0
"""Weights fall with the squared distance over this, as those of Student's t."""
RADIUS_QUANTILE, MIN_OFFSET_HEIGHTS, MIN_SHARED_HEIGHTS = 0.95, 0.05, 0.1
"""Quantile of the boxes' radii at which an offset of the lens is stated, and the least that matters, in median heights
of boxes: smaller ones are no larger than errors of boxes."""
MAX_RADIAL = 0.6
"""Largest coefficient of a lens; otherwise there is another mistake."""
TILTED = 0.5
"""Standard deviation of a pitch that all cameras share, relative to `PRIOR`."""
MIN_INFLATION = 0.2
"""Least ratio of the variance of errors of boxes to the stated one."""
MOVED = 7.0
"""Logarithm of the odds of an error that lasts against a movement: errors that wander resemble movements."""
BODIES = 10.0
"""Logarithm of the odds against an error that lasts where one person is seen: a body unlike the model resembles it."""
MIN_LOG_RATIO, MIN_LOG_RATIO_ROTATED = 7.0, 0.0
"""Logarithm of the ratio of evidences from which an error is significant, and where cameras are known to seem rotated:
the question is then which error it is."""
AMBIGUOUS = 3.0
"""Logarithm of the ratio of evidences below which another error may as well be there instead."""
EDGE_BATCHES = 3
"""Least number of batches from the begin of the recording to a movement, and from there to its end."""
BASE_S = 0.4
"""Velocities are those between positions by one camera this time before and after."""
MAX_BEND_HEIGHTS, MAX_SPEED_HEIGHTS = 0.25, 2.0
"""Largest distance of a position from the middle of those two, and speed of people [heights/s]."""
STEP = 1e-3
"""Step of the difference quotients."""


class CameraError(NamedTuple):
    """A calibration error of one camera, or of all of them.

    Attributes:
        cameras: indices of the cameras.
        kind: index of its (first) parameter: `YAW` for a rotation, `RADIAL`, `FOCAL`, `HEIGHT` or `LATE`.
        values: (n, 1 or 2) size for each camera: yaw and pitch to add to points in the normalised image [rad], radial
            coefficient, share by which the stated focal length is too long, height above the stated one in heights of
            people, delay of its frames [s].
        since: index of the time step from which it holds; 0: always.
        log_ratio: logarithm of its evidence over that of usual errors alone.
        until: index of the time step up to which it holds; 0: to the end.
        rival: another lasting error, of another camera or kind, that explains nearly as much; None: none.
    """

    cameras: tuple[int, ...]
    kind: int
    values: Floats
    since: int
    log_ratio: float
    until: int = 0
    rival: CameraError | None = None

    @property
    def either(self) -> tuple[CameraError, ...]:
        """The error, and its rival if there is one."""
        return (self,) if self.rival is None else (self, self.rival)


class Evidence(NamedTuple):
    """Normal equations with a Gaussian prior of the parameters, and the evidence (marginal likelihood) of that model.

    Attributes:
        normal: (T, K, K + 1) rows (N, b) of each time step, about the calibration as stated.
        prior: (K, K) prior covariance of the K parameters; their prior mean is 0.
    """

    normal: Floats
    prior: Floats

    def solved(self) -> tuple[Floats, Floats, float]:
        """Return the posterior mean (K,) and covariance (K, K) of the parameters, and the log evidence."""
        N, b = self.normal[..., :-1].sum(axis=0), self.normal[..., -1].sum(axis=0)
        inside = np.eye(len(b)) + N @ self.prior
        covariance = self.prior @ np.linalg.inv(inside)
        x = covariance @ b
        return x, covariance, 0.5 * float(b @ x) - 0.5 * float(np.linalg.slogdet(inside)[1])


def fit_pairs(views: Sequence[BoxesOfCamera], t_ns: Ints, person_height: float, every: int = 1) -> Floats:
    """Return normal equations (T, K, K + 1) of the camera errors by time step, summed over all pairs of C cameras.

    K = C * `OWN` + `COMMON` parameters in units of `PRIOR`: for each camera yaw, pitch, radial coefficient, focal
    length, height and delay; then those of all boxes. The last column is the right-hand side.

    Args:
        views: cameras with their boxes.
        t_ns: (T,) times of the time steps.
        person_height: mean height of people in the scene's unit.
        every: every `every`-th time step counts.
    """
    cameras = [_LocatingCamera(view, t_ns, person_height, every) for view in views]
    steps = len(t_ns)
    C, count = len(cameras), OWN * len(cameras) + COMMON
    x = np.zeros(count)
    normal = np.zeros((steps, count, count + 1))
    for iteration in range(ITERATIONS):
        for c, camera in enumerate(cameras):
            camera.locate(np.append(x[OWN * c : OWN * (c + 1)], x[-COMMON:]) * PRIOR, SETTLED if iteration else 1.0)
        normal = np.zeros((steps, count, count + 1))
        for a, b in combinations(range(C), 2):
            own = np.r_[OWN * a : OWN * (a + 1), OWN * b : OWN * (b + 1), OWN * C : count]
            part = _of_pair(cameras[a], cameras[b], steps, person_height)
            normal[np.ix_(range(steps), own, np.r_[own, count])] += part
        normal[..., -1] += normal[..., :-1] @ x
        x = Evidence(normal, np.eye(count)).solved()[0]
    return normal


def camera_errors(
    normal: Floats, people: float, matters: Callable[[CameraError], bool], least: float = MIN_LOG_RATIO
) -> list[CameraError]:
    """Return the significant errors of cameras: the one with the largest evidence first, others given those before.

    Args:
        normal: (T, K, K + 1) normal equations from `fit_pairs`.
        people: number of people who are seen at once.
        matters: whether an error is large enough to be reported.
        least: logarithm of the ratio of evidences from which an error is significant.
    """
    K = normal.shape[1]
    C = K // OWN
    usual = np.diag(np.append(np.tile(USUAL, C), np.ones(COMMON)) ** 2)
    # Bodies that are unlike the model tilt all cameras alike
    usual[PITCH:-COMMON:OWN, PITCH:-COMMON:OWN] += TILTED**2
    now = Evidence(normal / _inflation(normal), usual)
    # A movement is no scatter
    now = now._replace(normal=normal / _inflation(normal, max(movements(now), key=_log_ratio, default=None)))
    out: list[CameraError] = []
    for _ in range(C):
        _, _, before = now.solved()
        lasting = sorted(static_errors(now, before, people), key=_log_ratio, reverse=True)
        best = max((*lasting, *movements(now)), key=_log_ratio)
        if best.log_ratio < least:
            break
        # With one error of a camera corrected the other ones are not linear any more
        if matters(best) and not {c for each in out for c in each.cameras} & set(best.cameras):
            close = (each for each in lasting if each.log_ratio > best.log_ratio - AMBIGUOUS)
            others = (each for each in close if each.kind != best.kind or not set(best.cameras) & set(each.cameras))
            out.append(best._replace(rival=None if best.since else next(filter(matters, others), None)))
        if best.since:
            break
        now = now._replace(prior=now.prior + _prior_of(best.cameras, best.kind, K))
    return out


def rotation(normal: Floats, camera: int) -> Floats:
    """Return yaw and pitch (2,) [rad] to add to a camera's points in the normalised image, by least squares.

    `normal` (T, K, K + 1) are the normal equations, of K parameters at T time steps, from `fit_pairs`; `camera` is the
    index of the camera.
    """
    x = Evidence(normal, np.eye(normal.shape[1])).solved()[0]
    own = _parameters([camera], YAW)[0]
    return np.asarray(x[own] * PRIOR[:RADIAL])


def _log_ratio(error: CameraError) -> float:
    """Return the logarithm of an error's evidence ratio, as a sort key."""
    return error.log_ratio


def _inflation(normal: Floats, movement: CameraError | None = None) -> float:
    """Return the factor by which variances of sums over time exceed those of independent errors (autocorrelation).

    Args:
        normal: (T, K, K + 1) normal equations of each time step.
        movement: a rotation during the recording that is estimated, too; None: none.
    """
    T, K = normal.shape[:2]
    if movement is not None:
        moved = np.r_[:K, _parameters(movement.cameras, movement.kind)[0]]
        normal = normal[:, moved][:, :, np.r_[moved, K]]
        normal[: movement.since, K:], normal[: movement.since, :, K:-1] = 0.0, 0.0
    batches = np.add.reduceat(normal, np.unique(np.arange(BATCHES) * T // BATCHES), axis=0)
    x = Evidence(batches, np.eye(normal.shape[1])).solved()[0]
    off = batches[:, :K, -1] - batches[:, :K, :-1] @ x
    nominal = np.einsum("bkk->k", batches[:, :K, :K])
    seen = nominal > 0.0
    if not seen.any():
        return 1.0
    return max(float(np.mean(newey_west(off[:, seen]) / nominal[seen])), MIN_INFLATION)


def _parameters(cameras: Sequence[int], kind: int) -> Ints:
    """Return the indices (n, 1 or 2), in the parameter vector, of a kind of error of n cameras.

    2 for `YAW`, a rotation (yaw and pitch).
    """
    own = [YAW, PITCH] if kind == YAW else [kind]
    numbers: Ints = np.array(cameras, dtype=np.int64)[:, None] * OWN + np.array(own, dtype=np.int64)
    return numbers


def _prior_of(cameras: Sequence[int], kind: int, count: int) -> Floats:
    """Return the prior covariance (K, K), K = `count`, of a hypothesised error of `kind`.

    The error is equal in all `cameras`.
    """
    out = np.zeros((count, count))
    for k, own in enumerate(_parameters(cameras, kind).T):
        out[np.ix_(own, own)] = FAULT[kind + k] ** 2
    return out


def static_errors(now: Evidence, before: float, people: float) -> Iterator[CameraError]:
    """Generate hypotheses of one error that lasts for the whole recording, with their evidence.

    A hypothesis concerns one camera, or the lenses of all.

    Args:
        now: normal equations and prior of usual errors.
        before: log evidence of usual errors alone.
        people: number of people who are seen at once.
    """
    K = now.normal.shape[1]
    every = tuple(range(K // OWN))
    summed = now._replace(normal=now.normal.sum(axis=0, keepdims=True))
    for cameras in (*((c,) for c in every), every):
        for kind in (YAW, RADIAL, FOCAL, HEIGHT, LATE) if len(cameras) == 1 else (RADIAL,):
            x, _, after = summed._replace(prior=now.prior + _prior_of(cameras, kind, K)).solved()
            own = _parameters(cameras, kind)
            scale = PRIOR[kind : kind + own.shape[1]]
            yield CameraError(cameras, kind, x[own] * scale, 0, after - before - BODIES / max(people, 1.0))


def movements(now: Evidence) -> Iterator[CameraError]:
    """Generate, for each camera, the hypothesis of one rotation during the recording, at the most probable time."""
    T, K = now.normal.shape[:2]
    x, covariance, _ = now.solved()
    margin = max(EDGE_BATCHES * T // BATCHES, 1)
    after = np.cumsum(now.normal[::-1], axis=0)[::-1][margin : T - margin]
    if not len(after):
        return
    for c in range(K // OWN):
        own = _parameters([c], YAW)[0]
        A = after[:, :, own]  # (S, K, 2)
        r = after[:, own, -1] - A.transpose(0, 2, 1) @ x
        D = A[:, own] - A.transpose(0, 2, 1) @ covariance @ A
        inside = np.eye(2) + D * FAULT[YAW] ** 2
        change = FAULT[YAW] ** 2 * np.linalg.solve(inside, r[..., None])[..., 0]
        gain = 0.5 * (r * change).sum(axis=1) - 0.5 * np.linalg.slogdet(inside)[1]
        s = int(np.argmax(gain))
        log_ratio = float(gain[s]) - float(np.log(len(gain))) - MOVED
        yield CameraError((c,), YAW, change[s][None] * PRIOR[:RADIAL], margin + s, log_ratio)


def lens_offset(view: BoxesOfCamera, coefficient: float) -> float:
    """Return the offset [px] by a radial coefficient k at the radius within which 95 % of the boxes' edges are.

    Points at the radius r of the normalised image are at r (1 + k r^2); k = `coefficient`.
    """
    radii = np.linalg.norm(ideal(view.camera, _edge_middles(view.boxes)), axis=1)
    return coefficient * float(np.nanquantile(radii, RADIUS_QUANTILE)) ** 3 * float(view.camera.focal_px.mean())


def lens_matters(view: BoxesOfCamera, coefficient: float, *, shared: bool) -> bool:
    """Return whether a radial error exceeds the errors of boxes, and is small enough for a lens.

    `coefficient` is k of r (1 + k r^2); `shared`: all cameras have the error, for which the limit is higher.
    """
    tall = float(np.median(view.boxes[:, 3] - view.boxes[:, 1]))
    least = MIN_SHARED_HEIGHTS if shared else MIN_OFFSET_HEIGHTS
    return abs(lens_offset(view, coefficient)) > least * tall and abs(coefficient) < MAX_RADIAL


def without_radial_error(view: BoxesOfCamera, coefficient: float) -> BoxesOfCamera:
    """Return the camera with boxes as they would be if images had the distortion that the calibration states.

    `coefficient` is k of the radial error r (1 + k r^2) in the normalised image.
    """
    camera = view.camera
    xy = ideal(camera, _edge_middles(view.boxes))
    xy = xy * (1.0 + coefficient * (xy**2).sum(axis=1, keepdims=True))
    points = camera.position + np.column_stack([xy, np.ones(len(xy))]) @ camera.rotation.T
    left, top, right, bottom = camera.project(points).reshape(4, -1, 2)
    return view._replace(boxes=np.column_stack([left[:, 0], top[:, 1], right[:, 0], bottom[:, 1]]))


def _edge_middles(boxes: Floats) -> Floats:
    """Return (4 n, 2) midpoints of the left, upper, right and lower edges of boxes (n, 4): all left ones first."""
    u, v = 0.5 * (boxes[:, 0] + boxes[:, 2]), 0.5 * (boxes[:, 1] + boxes[:, 3])
    edges = ((boxes[:, 0], v), (u, boxes[:, 1]), (boxes[:, 2], v), (u, boxes[:, 3]))
    return np.concatenate([np.column_stack(edge) for edge in edges])


class _LocatingCamera:
    """A camera with the people in its boxes, located by this camera alone; n boxes.

    `ends` (2, n, 2) are feet and heads in the normalised image, `people` (n, 3) x, y and height with `covariances`
    (n, 3, 3), `velocities` (n, 2) and `steps` (n,) the time steps; NaN: not located.
    """

    def __init__(self, view: BoxesOfCamera, t_ns: Ints, person_height: float, every: int) -> None:
        """Select the boxes that locate a person, and compute positions and velocities of the people.

        Args:
            view: camera with its boxes.
            t_ns: (T,) times of the time steps.
            person_height: mean height of people in the scene's unit.
            every: boxes of every `every`-th time step count; the others serve for velocities.
        """
        self.camera, self.height = view.camera, person_height
        people = located(view, person_height)
        known = np.isfinite(people).all(axis=1)
        people, boxes, steps = people[known, :2], view.boxes[known], view.steps[known]
        own = steps % every == 0
        self.velocities = _velocities(people, steps, own, t_ns, person_height)
        boxes, self.steps = boxes[own], steps[own]
        self.ends = upright(self.camera, boxes)
        self.errors, slopes = self.covariance(self.ends), self.slopes(self.ends, self.velocities)[..., :OWN]
        self.by_prior = slopes @ slopes.transpose(0, 2, 1)
        known = np.isfinite(self.errors).all(axis=(1, 2)) & np.isfinite(self.by_prior).all(axis=(1, 2))
        self.ends[:, ~known] = np.nan
        self.locate(np.zeros(len(PRIOR)), 1.0)

    def locate(self, values: Floats, prior: float) -> None:
        """Locate the people under assumed errors of the camera; write `people` and `covariances`.

        `values` (8,) are yaw, pitch, radial coefficient, focal length, height, delay, feet and looseness of boxes, with
        the remaining standard deviation `prior` times `PRIOR`.
        """
        self.people = self.located(self.ends, values)
        self.people[:, :2] += values[LATE] * self.velocities
        self.covariances = self.errors + prior**2 * self.by_prior

    def located(self, ends: Floats, values: Floats) -> Floats:
        """Return (..., n, 3) x, y and height of people by feet and heads (2, ..., n, 2) in the normalised image.

        `values` (8,) or (..., 1, 8) are assumed errors of the camera; the delay is not used.
        """
        feet, head = (
            xy * (1.0 + values[..., FOCAL] + values[..., RADIAL] * (xy**2).sum(axis=-1))[..., None]
            + values[..., :RADIAL]
            for xy in ends
        )
        loose = values[..., LOOSE] / float(self.camera.focal_px[1])
        feet[..., 1] -= loose
        head[..., 1] += loose
        beyond, raised = (FEET_HEIGHTS + values[..., FEET]) * self.height, values[..., HEIGHT] * self.height
        return located_by_ends(self.camera, feet, head, beyond, raised)

    def seen(self, people: Floats) -> Floats:
        """Return the projection (2, n, 2) of feet and heads of people (n, 3: x, y, height) to the normalised image."""
        feet = people * [1.0, 1.0, 0.0]
        at = (np.stack([feet, people]) - self.camera.position) @ self.camera.rotation
        return np.asarray(at[..., :2] / at[..., 2:])

    def slopes(self, ends: Floats, velocities: Floats) -> Floats:
        """Return derivatives (n, 3, 8) of x, y and height of people by the camera errors, per prior standard deviation.

        `ends` (2, n, 2) are feet and heads in the normalised image, `velocities` (n, 2) those of the people.
        """
        steps = STEP * np.eye(len(PRIOR))[:, None]
        apart = self.located(ends, steps) - self.located(ends, -steps)
        out = np.moveaxis(apart, 0, 2) / (2.0 * STEP)
        out[:, :2, LATE] = velocities
        return np.asarray(out * PRIOR)

    def covariance(self, ends: Floats) -> Floats:
        """Return covariances (n, 3, 3) of x, y and height of people due to errors of box edges and posture.

        `ends` (2, n, 2) are feet and heads in the normalised image.
        """
        none = np.zeros(len(PRIOR))
        sigma = np.hypot(EDGE_PX / self.camera.focal_px.mean(), EDGE_SHARE * (ends[0, :, 1] - ends[1, :, 1]))
        moves = (
            STEP * np.array([[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 0.0], [0.0, 1.0]]])[:, :, None]
        )
        apart = self.located(ends[:, None] + moves, none) - self.located(ends[:, None] - moves, none)
        by_edge = np.moveaxis(apart, 0, 2) / (2.0 * STEP) * [ACROSS, 1.0, 1.0] * sigma[:, None, None]
        body = np.diag((BODY_HEIGHTS * self.height) ** 2)
        return np.asarray(by_edge @ by_edge.transpose(0, 2, 1) + body)


def _velocities(people: Floats, steps: Ints, own: Bools, t_ns: Ints, person_height: float) -> Floats:
    """Return the velocity (n, 2) of each person in a camera's boxes, by the straightest line of boxes around it.

    0 for boxes without such a line.

    Args:
        people: (m, 2) positions.
        steps: (m,) time steps.
        own: (m,) whether a position is of one of the n boxes that count.
        t_ns: (T,) times of the time steps.
        person_height: mean height of people in the scene's unit.
    """
    T = len(t_ns)
    out = np.zeros((int(own.sum()), 2))
    lag = max(round(BASE_S * NS / max(float(np.median(np.diff(t_ns))), 1.0)), 1) if T > 1 else 1
    # No time step is farther away; times that hardly differ must not take the memory of all steps between
    lag = min(lag, max(T, 1))
    whole = _positions_by_step(people, steps, T + 2 * lag, lag)
    here, when = people[own], steps[own]
    before, after = whole[when][:, :, None], whole[when + 2 * lag][:, None]
    if not (len(here) and before.shape[1]):
        return out
    seconds = (t_ns[np.minimum(when + lag, T - 1)] - t_ns[np.maximum(when - lag, 0)]) / NS
    # Squares of two numbers: norms take four times as long
    farthest = MAX_SPEED_HEIGHTS * person_height * seconds
    fast = ((after - before) ** 2 @ [1.0, 1.0]) > (farthest**2)[:, None, None]
    bend = (0.5 * (before + after) - here[:, None, None]) ** 2 @ [1.0, 1.0]
    bend = np.where(fast | ~np.isfinite(bend), np.inf, bend).reshape(len(here), -1)
    best = np.argmin(bend, axis=1)
    k = np.arange(len(here))
    straight = bend[k, best] < (MAX_BEND_HEIGHTS * person_height) ** 2
    p, q = np.divmod(best, whole.shape[1])
    change = after[k, 0, q] - before[k, p, 0]
    out[straight] = (change / np.maximum(seconds, 1e-9)[:, None])[straight]
    return out


def _positions_by_step(people: Floats, steps: Ints, count: int, first: int) -> Floats:
    """Return positions (T, most people, 2) by time step, T = `count`, padded with NaN; row 0 is time step -`first`.

    `people` (m, 2) are positions, `steps` (m,) their time steps.
    """
    counts = np.bincount(steps + first, minlength=count)
    out = np.full((count, int(counts.max(initial=0)), 2), np.nan)
    order = np.argsort(steps, kind="stable")
    when = steps[order] + first
    out[when, np.arange(len(order)) - (np.cumsum(counts) - counts)[when]] = people[order]
    return out


def _of_pair(a: _LocatingCamera, b: _LocatingCamera, steps: int, person_height: float) -> Floats:
    """Return normal equations (T, K, K + 1) of a pair of cameras by time step, with K = 2 `OWN` + `COMMON`.

    Parameters are those of a, of b, and of all boxes; the last column is the right-hand side. All 0 for fewer than
    `MIN_PAIRS` pairs of boxes.

    Args:
        a: first camera, with the people that it locates.
        b: second camera.
        steps: T.
        person_height: mean height of people in the scene's unit; limits the distance of a pair.
    """
    out = np.zeros((steps, 2 * OWN + COMMON, 2 * OWN + COMMON + 1))
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
    velocities = 0.5 * (a.velocities[i] + b.velocities[j])
    first, second = a.slopes(ends[0], velocities), b.slopes(ends[1], velocities)
    G = np.concatenate([-first[..., :OWN], second[..., :OWN], second[..., OWN:] - first[..., OWN:]], axis=2)
    sums = G.transpose(0, 2, 1) @ weight @ np.concatenate([G, apart[..., None]], axis=2)
    there = np.isfinite(sums).all(axis=(1, 2))
    np.add.at(out, a.steps[i][there], sums[there])
    return out


def _of_one_person(a: _LocatingCamera, b: _LocatingCamera, farthest: float) -> tuple[Ints, Ints]:
    """Return row indices (i, j) of the people of two cameras that are the same person.

    These are mutual nearest neighbours by Mahalanobis distance, within a gate and the distance `farthest` [scene unit].
    """
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
