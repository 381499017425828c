"""Requests to cameras: where a target is, by one frame each of the two cameras that should tell it best.

A position that cameras found as a measurement of particles, and the variance that two cameras would give it.

[Lee] Sec. 3.2.2 puts the position found in the place of the estimate's and keeps the velocity;
`moved_to` does so with the particles.  `updated` takes the position for a measurement: a particle's
position and velocity follow by their correlation in the cloud's covariance.

States are [x, vx, y, vy].

When the filter asks cameras where its targets are, and what their answers do ([Lee] Sec. 3.3).

periodic  every so many seconds, for all targets.
printed   whenever [Lee] Eq. 3.14 (count), 3.15 (bearing) or 3.16 (ellipse) holds.
count     when the number of an array's bearings is another than in its scan before: Eq. 3.14 at its edges.
spread    for each target with a standard deviation of the position above a limit.

Where an array has more bearings than there are targets in its range, cameras are also asked what else
is there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from occlog.array_types import NS, Floats, Ints32
from occlog.core.geometry.triangulate import TRIANGULATED, distance2, triangulate
from occlog.core.geometry.visibility import Sensors, seen_from
from occlog.core.numerics.assignment import assign
from occlog.core.plane import inside_polygon
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED
from occlog.scans.grouping import Scan
from occlog.track.methods.apf.model import pack_sensors

from . import kernel as imm
from .config import ImmConfig
from .filter import Count, ImmState, ImmStepResult, TrackPosterior
from .tracks import TENTATIVE, UNLABELLED_TRACK, Track, track_at_position, track_on_bearing

PLACE = (0, 2)
"""Rows of the position in a state."""


def moved_to(states: Floats, position: Floats, covariance: Floats, normals: Floats) -> Floats:
    """Return (L, 4) states with positions drawn about a measured one and velocities unchanged, as in [Lee] Sec. 3.2.2.

    Args:
        states: (L, 4) states x, vx, y, vy of the particles.
        position: (2,) that cameras found.
        covariance: (2, 2) of the position, positive semi-definite.
        normals: (L, 2) standard normal draws.
    """
    out = states.copy()
    out[:, PLACE] = position + normals @ root(covariance).T
    return out


def updated(states: Floats, position: Floats, covariance: Floats, normals: Floats) -> Floats:
    """Return (L, 4) states after a measurement of the position: the ensemble Kalman update of the particles.

    Every particle has a measurement of its own, drawn about the position. The mean and covariance of the particles
    become those of the Kalman filter, up to the chance of the draws. Particles without extent stay where they are.

    Args:
        states: (L, 4) states x, vx, y, vy of the particles.
        position: (2,) that cameras found.
        covariance: (2, 2) of the position, positive semi-definite.
        normals: (L, 2) standard normal draws.
    """
    P = np.cov(states.T, bias=True)
    S = P[np.ix_(PLACE, PLACE)] + covariance
    # The pseudo-inverse, as cameras may be exact and the cloud may be a point.
    gain = P[:, PLACE] @ np.linalg.pinv(S, hermitian=True)
    # Draws without mean: the ensemble's mean is then the Kalman filter's.
    noise = (normals - normals.mean(axis=0)) @ root(covariance).T
    return np.asarray(states + (position + noise - states[:, PLACE]) @ gain.T)


def root(covariance: Floats) -> Floats:
    """Return the (2, 2) symmetric square root of a covariance, negative eigenvalues from rounding set to 0."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray((axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T)


def expected_variance(position: Floats, origins: Floats, sigmas: Floats) -> float:
    """Return the trace of the covariance of a position triangulated by two cameras; inf where the lines do not cross.

    Args:
        position: (2,) position of the target.
        origins: (2, 2) positions of the two cameras.
        sigmas: (2,) standard deviations of the cameras' bearings [rad], > 0.
    """
    away = position - origins
    r2 = np.maximum((away**2).sum(axis=1), 1e-300)
    g = np.column_stack([-away[:, 1], away[:, 0]]) / (r2 * sigmas)[:, None]
    information = g.T @ g
    det = float(np.linalg.det(information))
    trace = float(np.trace(information))
    return trace / det if det > 1e-12 * trace * trace else float("inf")


CAUSES = ("periodic", "count", "bearing", "ellipse", "spread")
SHARED = "shared"
"""Cause of a row about a target that no question was about, but that the frames show as well."""


class RequestMemory(NamedTuple):
    """Previous camera requests: what was requested, and when."""

    period_ns: int | None = None  # since when the period runs
    bearings: Mapping[int, int] = {}  # of each array, in its scan before
    refused: Mapping[int, int] = {}  # track -> when it was asked for in vain


class CameraQuestion(NamedTuple):
    """A request to cameras for the position of a known target, or of an unknown one on a line of sight.

    `causes` are the policies or triggers that asked; `label` is the identity that sensors give the target.
    """

    number: int  # TENTATIVE: a target that is not known yet
    causes: tuple[str, ...]
    label: int
    position: Floats  # (2,) where it is thought to be
    covariance: Floats  # (2, 2)


class CameraAnswer(NamedTuple):
    """Answer to a camera request: the position found with covariance and label.

    Position and covariance are None if nothing was found.
    """

    ask: CameraQuestion
    position: Floats | None  # (2,)
    covariance: Floats | None  # (2, 2)
    label: int


def requests_after_scan(
    state: ImmState, report: ImmStepResult, memory: RequestMemory, rng: Generator
) -> tuple[list[CameraQuestion], RequestMemory]:
    """Return the requests to cameras that are due after a scan, at most one for each track, and the updated memory.

    Args:
        state: state of the filter after the scan.
        report: result of the scan: posteriors, counts of bearings.
        memory: earlier requests.
        rng: generator for tentative tracks on lines of sight.
    """
    assert state.t_ns is not None
    config, t_ns = state.world.config, state.t_ns
    causes: dict[int, list[str]] = {b.number: [] for b in report.beliefs}
    unknown: list[Count] = []
    # Period
    since = t_ns if memory.period_ns is None else memory.period_ns
    if "periodic" in config.policies and t_ns - since >= config.period_s * NS:
        # The period runs on from its own end, not from this scan, so that it holds on average.
        since += math.floor((t_ns - since) / (config.period_s * NS)) * round(config.period_s * NS)
        for own in causes.values():
            own.append("periodic")
    # Number of bearings (Eq. 3.14)
    for count in report.counts:
        if _count_asks(config, count, memory):
            for belief in report.beliefs:
                if _reaches(state, count.array, belief):
                    causes[belief.number].append("count")
            if count.bearings > count.targets:
                unknown.append(count)
    # Bearing (Eq. 3.15), ellipse (Eq. 3.16) and spread of each target
    for belief in report.beliefs:
        causes[belief.number] += _own_causes(state, report, belief)
    # Questions, unless one about the same target was in vain a time step ago
    out = [
        CameraQuestion(b.number, tuple(dict.fromkeys(causes[b.number])), b.moved.track.label, *_where(b.estimate))
        for b in report.beliefs
        if causes[b.number] and t_ns - memory.refused.get(b.number, -(2**62)) >= config.min_request_interval_s * NS
    ]
    if unknown and t_ns - memory.refused.get(TENTATIVE, -(2**62)) >= config.min_request_interval_s * NS:
        out += _leads(state, report, unknown, rng)
    bearings = {**memory.bearings, **{c.array: c.bearings for c in report.counts}}
    return out, memory._replace(period_ns=since, bearings=bearings)


def other_targets(state: ImmState, report: ImmStepResult, asked: Sequence[CameraQuestion]) -> list[CameraQuestion]:
    """Return requests, with cause `SHARED`, about confirmed targets that `asked` does not name.

    The requested frames may show them, too. Empty if `config.update_other_targets` is false or nothing is asked.
    """
    if not state.world.config.update_other_targets or not asked:
        return []
    numbers = {a.number for a in asked}
    return [
        CameraQuestion(b.number, (SHARED,), b.moved.track.label, *_where(b.estimate))
        for b in report.beliefs
        if b.number not in numbers
    ]


def _count_asks(config: ImmConfig, count: Count, memory: RequestMemory) -> bool:
    """Return whether the number of an array's bearings is a cause to request cameras.

    With policy `printed` and its trigger `count` it is where the number differs from that of the targets in range
    ([Lee] Eq. 3.14); with policy `count` where it differs from that of the array's scan before.
    """
    if "printed" in config.policies and "count" in config.printed and imm.count_differs(count.bearings, count.targets):
        return True
    return "count" in config.policies and count.bearings != memory.bearings.get(count.array, count.targets)


def _own_causes(state: ImmState, report: ImmStepResult, belief: TrackPosterior) -> list[str]:
    """Return the causes (of `bearing`, `ellipse`, `spread`) to request cameras for one track after a scan.

    They are [Lee] Eqs. 3.15 and 3.16, and a standard deviation of the position above `request_sigma`.
    """
    config, estimate, found = state.world.config, belief.estimate, []
    if "printed" in config.policies and "bearing" in config.printed:
        arrays = ((sensor - state.world.cameras, heard) for sensor, heard in report.scan.by_sensor())
        if any(
            imm.outside_ranges(estimate.mean, heard.bearing, heard.sigma, state.world.positions[a])
            for a, heard in arrays
            if _reaches(state, a, belief)
        ):
            found.append("bearing")
    if "printed" in config.policies and "ellipse" in config.printed:
        predicted = imm.moments(belief.moved.predicted, belief.moved.prior)
        if imm.outside_ellipses(estimate.mean, predicted.means, predicted.covariances):
            found.append("ellipse")
    if "spread" in config.policies and imm.position_sigma_exceeds(estimate.covariance, config.request_sigma):
        found.append("spread")
    return found


def _reaches(state: ImmState, array: int, belief: TrackPosterior) -> bool:
    """Return whether the estimated position of a track is in the range of array number `array`."""
    away = belief.estimate.mean[::2] - state.world.positions[array]
    return math.hypot(*away) <= float(state.world.reach[array])


def _where(estimate: imm.ModelEstimates) -> tuple[Floats, Floats]:
    """Return position (2,) and covariance (2, 2) of an estimate."""
    return estimate.mean[::2], estimate.covariance[::2, ::2]


def _leads(state: ImmState, report: ImmStepResult, unknown: Iterable[Count], rng: Generator) -> list[CameraQuestion]:
    """Return requests about possible unknown targets: tentative tracks, or else bearings assigned to no target.

    Args:
        state: state of the filter after the scan.
        report: result of the scan.
        unknown: counts of the arrays with more bearings than targets in their range.
        rng: generator for the particles of new tentative tracks.
    """
    waiting = [t for t in state.tracks if t.number == TENTATIVE]
    if not waiting:
        waiting = [_lead(state, report.scan, count.array, i, rng) for count in unknown for i in count.free.tolist()]
    return [CameraQuestion(TENTATIVE, ("count",), t.label, *_middle(t)) for t in waiting]


def _lead(state: ImmState, scan: Scan, array: int, i: int, rng: Generator) -> Track:
    """Return a tentative track on the line of sight of bearing number `i` of array number `array` in the scan."""
    heard = dict(scan.by_sensor())[state.world.cameras + array]
    assert state.t_ns is not None
    return track_on_bearing(
        state.world, array, float(heard.bearing[i]), float(heard.sigma[i]), state.t_ns, UNLABELLED_TRACK, rng
    )


def _middle(track: Track) -> tuple[Floats, Floats]:
    """Return mean position (2,) and covariance (2, 2) of a track's particles."""
    xy = track.cloud.states[:, ::2]
    return xy.mean(axis=0), np.cov(xy.T, bias=True)


def apply_answer(
    state: ImmState, report: ImmStepResult, answers: Iterable[CameraAnswer], memory: RequestMemory, rng: Generator
) -> tuple[ImmState, ImmStepResult, RequestMemory]:
    """Return the state updated with the positions that cameras found, its report, and the memory of refused requests.

    A position of an unknown target begins a confirmed track in place of its tentative one.

    Args:
        state: state of the filter after the scan.
        report: result of the scan.
        answers: answers of the cameras, to requests of this time.
        memory: earlier requests.
        rng: generator of the random numbers drawn.
    """
    assert state.t_ns is not None
    config, t_ns, free = state.world.config, state.t_ns, state.free
    tracks, refused = list(state.tracks), dict(memory.refused)
    beliefs = {b.number: b for b in report.beliefs}
    for answer in answers:
        number = answer.ask.number
        # In vain: not asked again at once
        if answer.position is None or answer.covariance is None:
            refused[number] = t_ns
            continue
        refused.pop(number, None)
        # A new target in the place of its candidate
        if number == TENTATIVE:
            number = _number(answer.label, tracks, free)
            free = max(free, number + 1)
            new = track_at_position(state.world, answer.position, answer.covariance, number, answer.label, t_ns, rng)
            tracks = [t for t in tracks if not _same_lead(t, answer)] + [new]
            continue
        # A known target: its particles are updated with the position, or moved there
        k = next(i for i, t in enumerate(tracks) if t.number == number)
        tracks[k] = _fixed(config, tracks[k], answer, t_ns, rng)
        beliefs[number] = beliefs[number]._replace(estimate=_moments(tracks[k]))
    tracks.sort(key=lambda t: (t.number == TENTATIVE, t.number))
    updated = tuple(beliefs[n] for n in sorted(beliefs))
    return (
        state._replace(tracks=tuple(tracks), free=free),
        report._replace(beliefs=updated),
        memory._replace(refused={n: at for n, at in refused.items() if n in {TENTATIVE, *(t.number for t in tracks)}}),
    )


def _number(label: int, tracks: list[Track], free: int) -> int:
    """Return the number of a new track: its label, if no track has that number, else `free`."""
    return label if label != UNLABELLED_TRACK and all(t.number != label for t in tracks) else free


def _same_lead(track: Track, answer: CameraAnswer) -> bool:
    """Return whether a tentative track is the one that the answer's request was about, by its mean position."""
    return track.number == TENTATIVE and bool(np.array_equal(_middle(track)[0], answer.ask.position))


def _fixed(config: ImmConfig, track: Track, answer: CameraAnswer, t_ns: int, rng: Generator) -> Track:
    """Return a track updated with a position from cameras.

    The particles are changed by `moved_to` or `updated`, as the setting `camera_fix` states. The existence probability
    is then 1, `t_ns` the time of the last detection, and the track has the answer's label, if any.
    """
    assert answer.position is not None
    assert answer.covariance is not None
    change = moved_to if config.camera_fix == "replace" else updated
    normals = rng.standard_normal((len(track.cloud.states), 2))
    states = change(track.cloud.states, answer.position, answer.covariance, normals)
    label = track.label if answer.label == UNLABELLED_TRACK else answer.label
    return track._replace(cloud=track.cloud._replace(states=states), exists=1.0, met_ns=t_ns, label=label)


def _moments(track: Track) -> imm.ModelEstimates:
    """Return mean and covariance of a track's equally weighted particles."""
    states = track.cloud.states
    return imm.moments(states[None], np.full((1, len(states)), 1.0 / len(states)))


DEFAULT_BEARING_SIGMA_RAD = math.radians(1.0)
"""Standard deviation with which a camera is expected to tell a bearing before it has."""


MAX_SIGMA_RATIO = 2.0
"""Two cameras that are asked already will do if their deviation is at most this many times the best two's."""
MIN_VARIANCE = 1e-18
"""Added to variances, so that exact positions can be compared."""
Pair = tuple[int, int]


class CameraRequest(NamedTuple):
    """One output row of a request to cameras: answer, cameras asked, and the number of frames newly used."""

    answer: CameraAnswer
    cameras: tuple[str, ...]
    frames: int


class _CameraFix(NamedTuple):
    """C intersections of the lines of sight of two cameras, with covariances and the labels of the lines."""

    xy: Floats  # (C, 2)
    covariance: Floats  # (C, 2, 2)
    label: Ints32  # (C,)


class CameraRequests:
    """Frames of the cameras as answers to requests; only frames that are requested count as processed.

    `offered` is the number of frames that could have been requested.
    """

    def __init__(self, scene: Scene, config: ImmConfig) -> None:
        """Start without frames, with the cameras of the scene."""
        self._cameras, self._config = scene.cameras, config
        self._sensors: Sensors | None = pack_sensors(scene) if scene.cameras else None
        self._room = None if scene.room is None else np.ascontiguousarray(scene.room)
        self._frames: dict[int, Scan] = {}  # of each camera the last that its answer can be about: rows that are seen
        self._coming: dict[int, deque[Scan]] = {}  # later ones, by camera
        self.offered = 0  # frames that could have been asked for

    def put(self, scan: Scan) -> None:
        """Store the camera rows of a scan as frames, one for each camera; labels below 0 mean unlabelled.

        Frames become available after the setting `answer_delay_s`.
        """
        for camera, frame in scan.take(scan.sensor < len(self._cameras)).by_sensor():
            known = frame._replace(target_id=np.maximum(frame.target_id, UNLABELLED))
            self._coming.setdefault(camera, deque()).append(known)
            self.offered += 1
        self._arrive(scan.t_ns)

    def _arrive(self, t_ns: int) -> None:
        """Make the stored frames available that at `t_ns` are at least the response time (`answer_delay_s`) old."""
        latest = t_ns - round(self._config.answer_delay_s * NS)
        for camera, coming in self._coming.items():
            while coming and coming[0].t_ns <= latest:
                self._frames[camera] = coming.popleft()

    def ask(self, asks: Sequence[CameraQuestion], others: Sequence[CameraQuestion], t_ns: int) -> list[CameraRequest]:
        """Return the answers to all requests of one time, in their order, then other targets found in the same frames.

        Args:
            asks: requests, each about one target.
            others: targets that no request is about, which the same frames may show as well.
            t_ns: time of the requests [ns].
        """
        # Choose two cameras for each question
        self._arrive(t_ns)
        oldest = (self._config.max_frame_age_s + self._config.answer_delay_s) * NS
        fresh = [c for c, f in self._frames.items() if t_ns - f.t_ns <= oldest]
        pairs: list[Pair | None] = []
        for ask in asks:
            pairs.append(self._pair(ask, sorted(fresh), [p for p in pairs if p is not None]))
        # Cross the lines of sight of each pair's frames, and match what they show with the targets
        answers: dict[int, CameraAnswer] = {}
        more: dict[int, CameraRequest] = {}
        for pair in sorted({p for p in pairs if p is not None}):
            mine = [n for n, p in enumerate(pairs) if p == pair]
            rest = [k for k in range(len(others)) if k not in more]
            found = self._match([asks[n] for n in mine], [others[k] for k in rest], self._cross(pair, t_ns))
            answers |= zip(mine, found[: len(mine)], strict=True)
            for k, answer in zip(rest, found[len(mine) :], strict=True):
                if answer.position is not None:
                    more[k] = CameraRequest(answer, self._names(pair), 0)
        # Count every processed frame once
        out, used = [], set[int]()
        for n, (ask, cameras) in enumerate(zip(asks, pairs, strict=True)):
            new = set(cameras or ()) - used
            used |= new
            answer = answers.get(n, CameraAnswer(ask, None, None, UNLABELLED))
            out.append(CameraRequest(answer, self._names(cameras or ()), len(new)))
        return _once([*out, *(more[k] for k in sorted(more))])

    def _names(self, cameras: Sequence[int]) -> tuple[str, ...]:
        """Return the names of cameras given by number."""
        return tuple(self._cameras[c].name for c in cameras)

    def _pair(self, ask: CameraQuestion, fresh: list[int], asked: list[Pair]) -> Pair | None:
        """Return the two cameras with the smallest expected position error, preferably those that can see the position.

        Two cameras already requested are preferred if nearly as good. None if fewer than two have a recent frame.

        Args:
            ask: the request, with the expected position.
            fresh: numbers of the cameras with a recent frame.
            asked: pairs of cameras that earlier requests of this time use.
        """
        ranks = {pair: self._rank(ask.position, pair) for pair in combinations(fresh, 2)}
        if not ranks:
            return None
        best = min(ranks, key=lambda p: (ranks[p], p))
        for pair in asked:
            if ranks[pair][0] == ranks[best][0] and ranks[pair][1] <= MAX_SIGMA_RATIO**2 * ranks[best][1]:
                return pair
        return best

    def _rank(self, position: Floats, pair: Pair) -> tuple[int, float]:
        """Return how many of two cameras cannot see `position` (2,), and the variance expected of a triangulation."""
        assert self._sensors is not None
        at = np.ascontiguousarray(position[None])
        blind = sum(not seen_from(at, c, self._sensors)[0] for c in pair)
        origins = np.array([self._cameras[c].position[:2] for c in pair])
        return blind, expected_variance(position, origins, np.array([self._sigma(c) for c in pair]))

    def _sigma(self, camera: int) -> float:
        """Return the standard deviation of a camera's bearing [rad] from its stated noise.

        `DEFAULT_BEARING_SIGMA_RAD` if no noise is stated.

        Nothing of its frame is used, since the frame has not been requested yet.
        """
        c = self._cameras[camera]
        sigma = math.hypot(c.sigma_yaw, c.sigma_read_px / float(c.focal_px[0]))
        return sigma if sigma > 0.0 else DEFAULT_BEARING_SIGMA_RAD

    def _cross(self, pair: Pair, t_ns: int) -> _CameraFix:
        """Return intersections of the lines of sight in the last frames of two cameras, for equal labels.

        Unlabelled candidates are crossed in all pairs. Covariances include what targets may have walked up to `t_ns`.
        Intersections outside the room count for labelled targets only.
        """
        one, other = (self._frames[c] for c in pair)
        i, j = np.nonzero(one.target_id[:, None] == other.target_id)
        if not len(i):
            return _CameraFix(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, dtype=np.int32))
        label = one.target_id[i]
        origins = np.tile(np.array([self._cameras[c].position[:2] for c in pair]), (len(i), 1))
        azimuths = np.column_stack([one.bearing[i], other.bearing[j]]).ravel()
        sigmas = np.maximum(np.column_stack([one.sigma[i], other.sigma[j]]).ravel(), 1e-9)
        met = triangulate(origins, azimuths, sigmas, 2 * np.arange(len(i) + 1))
        good = met.status == TRIANGULATED
        if self._room is not None:
            inside = inside_polygon(np.where(good[:, None], met.xy, 0.0), self._room)
            good &= inside | (label != UNLABELLED)
        # The target has moved since the older frame was taken: widen the covariance by what it may have walked.
        age = max(t_ns - min(one.t_ns, other.t_ns), abs(one.t_ns - other.t_ns)) / NS
        moved = (self._config.sigma_initial_velocity * age) ** 2 * np.eye(2)
        return _CameraFix(met.xy[good], met.covariance[good] + moved, label[good])

    def _match(
        self, asks: Sequence[CameraQuestion], others: Sequence[CameraQuestion], found: _CameraFix
    ) -> list[CameraAnswer]:
        """Return an answer for each of `asks`, then of `others`, with the intersection assigned to it, if any.

        A target gets the intersection with its label if there is one, else the nearest within the gate; each
        intersection is used once. Known targets have priority over unknown ones.

        Args:
            asks: requests.
            others: other targets that the frames may show.
            found: intersections of lines of sight of two cameras, with covariances and labels.
        """
        # Match by label
        everyone = [*asks, *others]
        answers = [CameraAnswer(ask, None, None, UNLABELLED) for ask in everyone]
        free = np.ones(len(found.xy), dtype=np.bool_)
        for n, ask in enumerate(everyone):
            own = np.flatnonzero(free & (found.label == ask.label))
            if ask.label != UNLABELLED and len(own):
                answers[n] = _answer(ask, found, int(own[0]))
                free[own[0]] = False
        # A crossing with the label of a known target cannot belong to another target.
        free &= ~np.isin(found.label, [a.label for a in everyone if a.label != UNLABELLED])
        first = [n for n, a in enumerate(asks) if a.number != TENTATIVE]
        unknown = [n for n, a in enumerate(asks) if a.number == TENTATIVE]
        # Match the rest by distance, at the least cost within the gate
        for part in ([*first, *range(len(asks), len(everyone))], unknown):
            rows, columns = [n for n in part if answers[n].position is None], np.flatnonzero(free)
            if not rows or not len(columns):
                continue
            known, spread = (
                np.array([everyone[n].position for n in rows]),
                np.array([everyone[n].covariance for n in rows]),
            )
            cost = distance2(found.xy[columns], found.covariance[columns] + MIN_VARIANCE * np.eye(2), known, spread).T
            labelled = np.array([everyone[n].label != UNLABELLED for n in rows])
            barred = labelled[:, None] & (found.label[columns] != UNLABELLED)
            for r, c in zip(*assign(np.where(barred, np.inf, cost), self._config.gate**2), strict=True):
                answers[rows[r]] = _answer(everyone[rows[r]], found, int(columns[c]))
                free[columns[c]] = False
        return answers


def _answer(ask: CameraQuestion, found: _CameraFix, c: int) -> CameraAnswer:
    """Return the answer to a request, with position, covariance and label of intersection number `c` of `found`."""
    return CameraAnswer(ask, found.xy[c], found.covariance[c], int(found.label[c]))


def _once(requests: list[CameraRequest]) -> list[CameraRequest]:
    """Return the requests, in which an answer with the position of an earlier one is made empty."""
    seen: set[tuple[float, ...]] = set()
    out = []
    for request in requests:
        position = request.answer.position
        key = () if position is None else tuple(position.tolist())
        if key in seen:
            request = request._replace(answer=request.answer._replace(position=None, covariance=None))
        elif key:
            seen.add(key)
        out.append(request)
    return out
