"""Global decision about one object at one time step, from the local detections of several cameras.

The decision follows [Lee] Ch. 4. A camera's detection is a line of sight, with a distance if the foot on the floor is
known. The global position is the intersection of agreeing lines, or else the mean of the feet, or else the prediction
updated by a line. The decision is Eq. 4.13 with the qualities W (Eq. 4.20) and the prior P_1 (Eqs. 4.23-4.24), which
fall with the distance to the prediction. Unlike in the thesis, distances are normalised by sigma together with the
errors of detection and prediction, and the position is weighted by errors rather than by W, since cameras measure
directions much better than distances. Unlabelled candidates are grouped on the ground, and their objects are tracked
over time steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.geometry.triangulate import NO_SOURCE, TRIANGULATED, SourceDirections, localise, triangulate
from occlog.core.numerics.assignment import assign

from .config import FuseConfig
from .kernels import (
    LocalDirections,
    MotionEstimate,
    PositionWithCovariance,
    ahead,
    begin,
    corrected_by_line,
    corrected_by_place,
    decision_value,
    meet,
    misfit,
    points,
)
from .views import PlacedCameras

CONFIRMATION_STEPS = 2
"""Time steps in which cameras must meet in an object before its prediction counts: any two lines cross somewhere."""
SAMPLES = 16
"""Positions along a lone line of sight at which each camera is asked whether it sees them."""


class ObjectMemory(NamedTuple):
    """What is kept of an object between time steps: its motion, if known, and two counts of time steps.

    `absent`: consecutive time steps without a declaration. `met`: time steps at which the detections of two or more
    cameras agreed on it; from `CONFIRMATION_STEPS` on the prediction of the motion is used.
    """

    motion: MotionEstimate | None = None
    absent: int = 0  # time steps in a row without a declaration
    met: int = 0  # time steps in which cameras met in it


class Decision(NamedTuple):
    """Decision about one object at one time step, from R local detections.

    Attributes:
        declared: whether the object is declared present.
        value: natural-log odds of its presence ([Lee] Eq. 4.13).
        position: global position; None without a declared object, or where a lone line of sight gives none.
        kept: (R,) mask of the detections that are kept.
        missed: indices of the cameras with a frame that see the position and have no kept detection.
        memory: memory of the object for the next time step.
    """

    declared: bool
    value: float
    position: (
        PositionWithCovariance | None
    )  # global position of a declared object; None: a lone line states no position
    kept: Bools
    missed: Ints
    memory: ObjectMemory

    @property
    def at(self) -> PositionWithCovariance:
        """Global position of the decision; ValueError if it has none. A decision with missed cameras always has one."""
        if self.position is None:
            raise ValueError("the decision states no position")
        return self.position


def decide(
    memory: ObjectMemory, t_ns: int, sight: LocalDirections, observing: Ints, cameras: PlacedCameras, config: FuseConfig
) -> Decision:
    """Decide whether an object is there, which of its detections are kept, and which cameras missed it ([Lee] Ch. 4).

    Args:
        memory: state of the object after the time steps before; empty for a new object.
        t_ns: time of the step [ns], later than the memory's.
        sight: R local detections of this object, at most one per camera; `sensor` is an index into `cameras`.
        observing: sorted indices into `cameras` of the cameras that delivered a frame.
        cameras: calibrated cameras with their probabilities of misses and false alarms.
        config: settings in the scene's unit.
    """
    # Predict ([Lee] Eq. 4.19); a prediction counts once cameras met in the object often enough.
    held = None if memory.motion is None else ahead(memory.motion, t_ns, config.process_noise_density)
    motion = held if memory.met >= CONFIRMATION_STEPS else None
    if not len(sight.azimuth):
        return _nothing(motion, memory, np.zeros(0, dtype=np.bool_), -math.inf, config)
    sigma2 = config.sigma_prediction**2
    # Gate: detections far from the prediction count as missed.
    near = np.ones(len(sight.azimuth), dtype=np.bool_)
    if motion is not None:
        off = misfit(sight, motion.position, sigma2)
        near = off <= config.detection_gate**2
    # Locate: the global position from the detections that agree.
    group = agreeing(sight, np.flatnonzero(near), motion, cameras, config)
    if not len(group) and motion is None:
        return _single_line_updates(sight, observing, cameras, config)
    position, after = _locate(motion, t_ns, sight.take(group), config)
    # Weigh: qualities W ([Lee] Eq. 4.20) and prior P_1 (Eqs. 4.23-4.24); 1/2 without a prediction.
    sees = np.array([bool(cameras.sees(position.xy[None], i)[0]) for i in observing.tolist()])
    used = near if motion is not None else np.isin(np.arange(len(near)), group)
    hit = np.isin(observing, sight.sensor[used])
    quality = np.full(len(observing), 0.5)
    prior = 0.5
    if motion is not None:
        quality[np.searchsorted(observing, sight.sensor)] = np.exp(-0.5 * off)
        prior = _prior(position, motion.position, sigma2)
    # Decide ([Lee] Eq. 4.13) over the cameras that detected the object or can see the position.
    p_miss, p_false = cameras.p_miss[observing], cameras.p_false[observing]
    value = float(decision_value(hit[None], quality[None], prior, p_miss, p_false, (hit | sees)[None])[0])
    if not (value > 0.0 and len(group)):
        return _nothing(motion, memory, np.zeros(len(near), dtype=np.bool_), value, config)
    # Remove detections off the global position; cameras that see it and have none left missed the object.
    kept = used & (_across(sight, position) <= config.gate)
    missed = observing[sees & ~np.isin(observing, sight.sensor[kept])]
    # Update the motion; an object that was not confirmed before is the same if it is within reach.
    met = memory.met + (len(group) > 1)
    if motion is None and held is not None:
        after, met = _predicted_object(held, after, position, memory, config)
    return Decision(True, value, position, kept, missed, ObjectMemory(after, 0, met))


def agreeing(
    sight: LocalDirections, rows: Ints, motion: MotionEstimate | None, cameras: PlacedCameras, config: FuseConfig
) -> Ints:
    """Select from the detections `rows` those that determine the global position; empty if they determine none.

    These are the lines that intersect at one position; without an intersection, the line nearest to the prediction;
    without a prediction, the largest set that agrees with one detection of known distance.

    Args:
        sight: local detections of one object at one time step.
        rows: indices into `sight` of the candidates.
        motion: motion predicted to this time; None: unknown.
        cameras: give the region in which objects can be.
        config: gate, and smallest angle of an intersection.
    """
    if len(rows) > 1:
        mine = sight.take(rows)
        position = _intersection(mine, motion, cameras, config)
        if position is not None:
            return rows[_across(mine, position) <= config.gate]
    if motion is not None and len(rows):
        return rows[[int(np.argmin(misfit(sight.take(rows), motion.position)))]]
    known = rows[np.isfinite(sight.distance[rows])]
    best = known[:0]
    for xy, cov in zip(*points(sight.take(known)), strict=True):
        same = known[misfit(sight.take(known), PositionWithCovariance(xy, cov)) <= config.gate**2]
        best = same if len(same) > len(best) else best
    return best


def _intersection(
    sight: LocalDirections, motion: MotionEstimate | None, cameras: PlacedCameras, config: FuseConfig
) -> PositionWithCovariance | None:
    """Position where most lines of sight intersect, on ties the nearest to the prediction; None if none intersect.

    All lines are tried first, with a chi-square limit on their residuals; if they disagree, subsets within the gate.
    `motion` is the prediction of the object, None if unknown; `cameras` gives the region in which it can be.
    """
    crossing = math.radians(config.min_triangulation_angle_deg)
    everything = triangulate(
        sight.origin, sight.azimuth, sight.sigma, np.array([0, len(sight.azimuth)]), "gauss", crossing
    )
    if everything.status[0] == TRIANGULATED:
        position = PositionWithCovariance(everything.xy[0], everything.covariance[0])
        if np.sum((everything.residual / sight.sigma) ** 2) <= config.gate**2 + len(sight.azimuth) - 2:
            return position
    known = NO_SOURCE if motion is None else motion.mean[None, :2]
    spread = np.empty((0, 2, 2)) if motion is None else motion.cov[None, :2, :2]
    lines = SourceDirections(sight.sensor, sight.origin, sight.azimuth, sight.sigma)
    found = localise(lines, known, spread, cameras.region, config.gate, crossing)
    if not len(found.xy):
        return None
    far = np.zeros(len(found.xy)) if motion is None else np.hypot(*(found.xy - motion.mean[:2]).T)
    best = int(np.lexsort((far, -found.arrays))[0])
    return PositionWithCovariance(found.xy[best], found.covariance[best])


def _locate(
    motion: MotionEstimate | None, t_ns: int, sight: LocalDirections, config: FuseConfig
) -> tuple[PositionWithCovariance, MotionEstimate]:
    """Global position of an object at `t_ns` [ns], and its motion updated by it.

    Where `sight` gives no position of its own, the prediction is updated by its lines, and its position is returned.
    `motion` is predicted to this time; None: the object is new, and its motion starts with zero velocity.
    Raises AssertionError if a new object has detections without a position.
    """
    position = meet(sight, math.radians(config.min_triangulation_angle_deg))
    if motion is None:
        if position is None:  # `agreeing` gives lines that meet, or distances
            raise AssertionError("detections without a position")
        return position, begin(t_ns, position, config.sigma_initial_velocity)
    if position is None:
        after = corrected_by_line(motion, sight)
        return after.position, after
    after = corrected_by_place(motion, position)
    return (position if len(sight.azimuth) > 1 else after.position), after


def _predicted_object(
    held: MotionEstimate,
    new: MotionEstimate,
    position: PositionWithCovariance,
    memory: ObjectMemory,
    config: FuseConfig,
) -> tuple[MotionEstimate, int]:
    """Motion and number of agreeing time steps of an object that is not confirmed yet, after one more global position.

    Within the detection gate of the prediction the motion is updated and the number is one larger; otherwise the
    detections are of a new object, with number 1.

    Args:
        held: motion predicted to this time.
        new: motion of a new object at the global position.
        position: global position of the detections.
        memory: holds the number of agreeing time steps so far.
        config: gate and standard deviation of the prediction.
    """
    away = position.xy - held.mean[:2]
    spread = held.position.cov + position.cov + config.sigma_prediction**2 * np.eye(2)
    if away @ np.linalg.solve(spread, away) > config.detection_gate**2:
        return new, 1
    return corrected_by_place(held, position), memory.met + 1


def _across(sight: LocalDirections, position: PositionWithCovariance) -> Floats:
    """(R,) absolute distances of lines of sight from a position in standard deviations; infinite if pointing away.

    Measured across the lines; known distances along them are ignored.
    """
    nothing = np.full(len(sight.azimuth), np.nan)
    return np.sqrt(misfit(sight._replace(distance=nothing, sigma_distance=nothing), position))


def _prior(position: PositionWithCovariance, predicted: PositionWithCovariance, sigma2: float) -> float:
    """Prior probability P_1 that an object is present, by its distance from the prediction ([Lee] Eqs. 4.23-4.24).

    exp(-d^2 / 2), in (0, 1], with the squared Mahalanobis distance d^2 of the global position under the covariance
    of the prediction plus `sigma2` [length^2] on both axes.
    """
    away = position.xy - predicted.xy
    spread = predicted.cov + sigma2 * np.eye(2)
    return float(np.exp(-0.5 * away @ np.linalg.solve(spread, away)))


def _nothing(
    motion: MotionEstimate | None, memory: ObjectMemory, kept: Bools, value: float, config: FuseConfig
) -> Decision:
    """Decision that no object is declared.

    The memory keeps the prediction with one more absent time step, or is empty without a prediction or after
    `max_coasting_steps` of them.

    Args:
        motion: motion of a confirmed object predicted to this time; None: none.
        memory: state of the object before.
        kept: (R,) mask of detections to keep.
        value: natural-log odds of the object's presence.
        config: settings, of which `max_coasting_steps` is used.
    """
    absent = memory.absent + 1
    after = (
        ObjectMemory()
        if motion is None or absent >= config.max_coasting_steps
        else ObjectMemory(motion, absent, memory.met)
    )
    return Decision(False, value, None, kept, np.zeros(0, dtype=np.int64), after)


def _single_line_updates(
    sight: LocalDirections, observing: Ints, cameras: PlacedCameras, config: FuseConfig
) -> Decision:
    """Decision about lines of sight that determine no position: each line is accepted or rejected by itself.

    `SAMPLES` positions are tried along a line. Cameras that see at least half of them count; those with a detection
    that agrees with one of them confirm, the others count as misses ([Lee] Eq. 4.3, equal priors). Declared if a
    line is kept; no position, no missed cameras, an empty memory. `observing` are the indices of the cameras that
    delivered a frame.
    """
    kept = np.zeros(len(sight.azimuth), dtype=np.bool_)
    values = np.empty(len(kept))
    for row in range(len(kept)):
        spots = cameras.along(sight.take(np.array([row])), SAMPLES)
        off = np.array([misfit(sight, PositionWithCovariance(xy, np.zeros((2, 2)))) for xy in spots])
        hit = np.isin(observing, sight.sensor[(off <= config.gate**2).any(axis=0) | (np.arange(len(kept)) == row)])
        sees = np.array([cameras.sees(spots, i).mean() >= 0.5 for i in observing.tolist()])
        half = np.full((1, len(observing)), 0.5)
        p_miss, p_false = cameras.p_miss[observing], cameras.p_false[observing]
        values[row] = decision_value(hit[None], half, 0.5, p_miss, p_false, (hit | sees)[None])[0]
        kept[row] = values[row] > 0.0
    return Decision(bool(kept.any()), float(values.max()), None, kept, np.zeros(0, dtype=np.int64), ObjectMemory())


class CandidateDecisions(NamedTuple):
    """Decisions about the unlabelled candidates of one time step.

    Attributes:
        objects: memories of the objects that stay tracked.
        decisions: pairs of a decision and the rows of the candidates that it is about.
        unassigned: rows of the candidates that no decision keeps.
    """

    objects: list[ObjectMemory]
    decisions: list[tuple[Decision, Ints]]
    unassigned: Ints


def fuse_candidates(
    objects: Sequence[ObjectMemory],
    t_ns: int,
    sight: LocalDirections,
    rows: Ints,
    observing: Ints,
    cameras: PlacedCameras,
    config: FuseConfig,
) -> CandidateDecisions:
    """Decide which objects are present at one time step, from detections without labels ([Lee] Ch. 4).

    First about each tracked object with the candidates near its prediction, then about groups of the other candidates,
    which may be new objects. A candidate is kept for one object at most.

    Args:
        objects: memories of the tracked objects, each with a motion, after earlier time steps.
        t_ns: time of the step [ns].
        sight: detections of a part of the recording, as bearings or positions of single cameras.
        rows: indices into `sight` of the candidates of this time step.
        observing: sorted indices of the cameras that delivered a frame.
        cameras: calibrated cameras.
        config: settings in the scene's unit.
    """
    # Decide about known objects with the candidates assigned to each.
    free = rows
    followed: list[ObjectMemory] = []
    decisions: list[tuple[Decision, Ints]] = []
    for memory, mine in zip(objects, _shared_out(objects, t_ns, sight, rows, config), strict=True):
        decision = decide(memory, t_ns, sight.take(mine), observing, cameras, config)
        decisions.append((decision, mine))
        free = free[~np.isin(free, mine[decision.kept])]
        if decision.memory.motion is not None:
            followed.append(decision.memory)
    # Group the rest, and decide about what each group may be of.
    for mine in _groups(sight, free, cameras, config):
        decision = decide(ObjectMemory(), t_ns, sight.take(mine), observing, cameras, config)
        decisions.append((decision, mine))
        free = free[~np.isin(free, mine[decision.kept])]
        if decision.memory.motion is not None:
            followed.append(decision.memory)
    return CandidateDecisions(followed, decisions, free)


def _shared_out(
    objects: Sequence[ObjectMemory], t_ns: int, sight: LocalDirections, rows: Ints, config: FuseConfig
) -> list[Ints]:
    """Assign candidates to tracked objects at `t_ns` [ns], one to one in each camera within the detection gate.

    `rows` are indices into `sight` of the candidates. Returns sorted indices into `sight` for each object.
    """
    out: list[list[int]] = [[] for _ in objects]
    if objects and len(rows):
        mine = sight.take(rows)
        cost = np.column_stack([_off(memory, t_ns, mine, config) for memory in objects])
        for camera in np.unique(mine.sensor).tolist():
            own = np.flatnonzero(mine.sensor == camera)
            for row, column in zip(*assign(cost[own], config.detection_gate**2), strict=True):
                out[int(column)].append(int(rows[own[row]]))
    return [np.array(sorted(r), dtype=np.int64) for r in out]


def _off(memory: ObjectMemory, t_ns: int, sight: LocalDirections, config: FuseConfig) -> Floats:
    if memory.motion is None:  # objects that are tracked have one
        return np.full(len(sight.azimuth), np.inf)
    position = ahead(memory.motion, t_ns, config.process_noise_density).position
    return misfit(sight, position, config.sigma_prediction**2)


def _groups(sight: LocalDirections, rows: Ints, cameras: PlacedCameras, config: FuseConfig) -> Iterator[Ints]:
    """Generate groups of candidates, as arrays of indices into `sight`, that may be of one object each.

    First groups of the candidates `rows` with intersecting lines, the largest first; then those with coincident feet on
    the floor; then each remaining one alone. A group has at most one candidate per camera.
    """
    left = rows
    for position in [*_intersections(sight.take(rows), cameras, config), *_standing(sight.take(rows))]:
        mine = _nearest(sight, left, position, config.gate)
        if len(mine):
            left = left[~np.isin(left, mine)]
            yield mine
    yield from left[:, None]


def _intersections(sight: LocalDirections, cameras: PlacedCameras, config: FuseConfig) -> list[PositionWithCovariance]:
    if len(np.unique(sight.sensor)) < 2:
        return []
    lines = SourceDirections(sight.sensor, sight.origin, sight.azimuth, sight.sigma)
    crossing = math.radians(config.min_triangulation_angle_deg)
    found = localise(lines, NO_SOURCE, np.empty((0, 2, 2)), cameras.region, config.gate, crossing)
    order = np.argsort(-found.arrays, kind="stable").tolist()
    return [PositionWithCovariance(found.xy[i], found.covariance[i]) for i in order]


def _standing(sight: LocalDirections) -> list[PositionWithCovariance]:
    return [
        PositionWithCovariance(xy, cov)
        for xy, cov in zip(*points(sight.take(np.isfinite(sight.distance))), strict=True)
    ]


def _nearest(sight: LocalDirections, rows: Ints, position: PositionWithCovariance, gate: float) -> Ints:
    """For each camera select the candidate nearest to a position; sorted indices into `sight`.

    `rows` are indices into `sight` of the candidates; those farther than `gate` standard deviations are not selected.
    """
    off = misfit(sight.take(rows), position)
    out = []
    for camera in np.unique(sight.sensor[rows]).tolist():
        own = np.flatnonzero((sight.sensor[rows] == camera) & (off <= gate**2))
        if len(own):
            out.append(int(rows[own[np.argmin(off[own])]]))
    return np.array(sorted(out), dtype=np.int64)
