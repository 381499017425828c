"""Requests to cameras: where a target is, by one frame each of the two cameras that should tell it best."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints32
from occlog.core.numerics.assignment import assign
from occlog.core.plane.polygons import inside_polygon
from occlog.core.sight.locate_sources import distance2
from occlog.core.sight.triangulate import MET, sight_lines_meet
from occlog.core.sight.visibility import Sensors, seen_from
from occlog.records.scene import Scene
from occlog.records.tables import UNLABELLED
from occlog.scans.scan import Scan
from occlog.track.apf.sensing import pack_sensors

from .after_fix import expected_variance
from .config import ImmConfig
from .tracks import UNNUMBERED
from .when_to_ask import Answer, Ask

UNKNOWN_SIGMA = math.radians(1.0)
"""Standard deviation with which a camera is expected to tell a bearing before it has."""


GOOD_ENOUGH = 2.0
"""Two cameras that are asked already will do if their deviation is at most this many times the best two's."""
LEAST = 1e-18
"""Added to variances, so that exact positions can be compared."""
Pair = tuple[int, int]


class CameraRequest(NamedTuple):
    """One row of `Cooperation`, with the answer."""

    answer: Answer
    cameras: tuple[str, ...]
    frames: int


class _Found(NamedTuple):
    """Where sight lines of two cameras cross."""

    xy: Floats  # (C, 2)
    covariance: Floats  # (C, 2, 2)
    label: Ints32  # (C,)


class CameraRequests:
    """The cameras' frames, of which only those that are asked for are looked at."""

    def __init__(self, scene: Scene, config: ImmConfig) -> None:
        """No frames yet."""
        self._cameras, self._config = scene.cameras, config
        self._sensors: Sensors | None = pack_sensors(scene) if scene.cameras else None
        self._room = None if scene.room is None else np.ascontiguousarray(scene.room)
        self._frames: dict[int, Scan] = {}  # of each camera the last that its answer can be about: rows that are seen
        self._coming: dict[int, deque[Scan]] = {}  # later ones, by camera
        self.offered = 0  # frames that could have been asked for

    def put(self, scan: Scan) -> None:
        """Keep the frames of every camera that answers can be about; labels below 0 are none."""
        for camera, frame in scan.take(scan.sensor < len(self._cameras)).by_sensor():
            known = frame._replace(target_id=np.maximum(frame.target_id, UNLABELLED))
            self._coming.setdefault(camera, deque()).append(known)
            self.offered += 1
        self._arrive(scan.t_ns)

    def _arrive(self, t_ns: int) -> None:
        """Let frames that are old enough take the place of those before them: an answer takes its time."""
        latest = t_ns - round(self._config.answer_s * NS)
        for camera, coming in self._coming.items():
            while coming and coming[0].t_ns <= latest:
                self._frames[camera] = coming.popleft()

    def ask(self, asks: Sequence[Ask], others: Sequence[Ask], t_ns: int) -> list[CameraRequest]:
        """Answers to all questions of one time, in their order, and then other targets found; frames count once.

        Args:
            asks: questions.
            others: targets that no question is about, which the same frames may show as well.
            t_ns: now.
        """
        # Choose two cameras for each question
        self._arrive(t_ns)
        oldest = (self._config.frame_age_s + self._config.answer_s) * NS
        fresh = [c for c, f in self._frames.items() if t_ns - f.t_ns <= oldest]
        pairs: list[Pair | None] = []
        for ask in asks:
            pairs.append(self._pair(ask, sorted(fresh), [p for p in pairs if p is not None]))
        # Cross the sight lines of each pair's frames, and match what they show with the targets
        answers: dict[int, Answer] = {}
        more: dict[int, CameraRequest] = {}
        for pair in sorted({p for p in pairs if p is not None}):
            mine = [n for n, p in enumerate(pairs) if p == pair]
            rest = [k for k in range(len(others)) if k not in more]
            found = self._match([asks[n] for n in mine], [others[k] for k in rest], self._cross(pair, t_ns))
            answers |= zip(mine, found[: len(mine)], strict=True)
            for k, answer in zip(rest, found[len(mine) :], strict=True):
                if answer.place is not None:
                    more[k] = CameraRequest(answer, self._names(pair), 0)
        # Count every frame that was looked at once
        out, used = [], set[int]()
        for n, (ask, cameras) in enumerate(zip(asks, pairs, strict=True)):
            new = set(cameras or ()) - used
            used |= new
            answer = answers.get(n, Answer(ask, None, None, UNLABELLED))
            out.append(CameraRequest(answer, self._names(cameras or ()), len(new)))
        return _once([*out, *(more[k] for k in sorted(more))])

    def _names(self, cameras: Sequence[int]) -> tuple[str, ...]:
        return tuple(self._cameras[c].name for c in cameras)

    def _pair(self, ask: Ask, fresh: list[int], asked: list[Pair]) -> Pair | None:
        """The two cameras whose sight lines should tell the place best, of those that can see it, or else of all.

        Two that are asked already will do if they tell it nearly as well.
        """
        ranks = {pair: self._rank(ask.place, pair) for pair in combinations(fresh, 2)}
        if not ranks:
            return None
        best = min(ranks, key=lambda p: (ranks[p], p))
        for pair in asked:
            if ranks[pair][0] == ranks[best][0] and ranks[pair][1] <= GOOD_ENOUGH**2 * ranks[best][1]:
                return pair
        return best

    def _rank(self, place: Floats, pair: Pair) -> tuple[int, float]:
        """How many of two cameras cannot see a place, and the variance with which they would tell it."""
        assert self._sensors is not None
        at = np.ascontiguousarray(place[None])
        blind = sum(not seen_from(at, c, self._sensors)[0] for c in pair)
        origins = np.array([self._cameras[c].position[:2] for c in pair])
        return blind, expected_variance(place, origins, np.array([self._sigma(c) for c in pair]))

    def _sigma(self, camera: int) -> float:
        """Noise that the camera is known to have: nothing of the frame is looked at before it is asked for."""
        c = self._cameras[camera]
        sigma = math.hypot(c.sigma_yaw, c.sigma_read_px / float(c.focal_px[0]))
        return sigma if sigma > 0.0 else UNKNOWN_SIGMA

    def _cross(self, pair: Pair, t_ns: int) -> _Found:
        """Where lines of two frames cross: equal labels, and every two candidates without."""
        one, other = (self._frames[c] for c in pair)
        i, j = np.nonzero(one.target_id[:, None] == other.target_id)
        if not len(i):
            return _Found(np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, dtype=np.int32))
        label = one.target_id[i]
        origins = np.tile(np.array([self._cameras[c].position[:2] for c in pair]), (len(i), 1))
        azimuths = np.column_stack([one.bearing[i], other.bearing[j]]).ravel()
        sigmas = np.maximum(np.column_stack([one.sigma[i], other.sigma[j]]).ravel(), 1e-9)
        met = sight_lines_meet(origins, azimuths, sigmas, 2 * np.arange(len(i) + 1))
        good = met.status == MET
        if self._room is not None:
            inside = inside_polygon(np.where(good[:, None], met.xy, 0.0), self._room)
            good &= inside | (label != UNLABELLED)
        # The target has moved since the older frame was taken: widen the covariance by what it may have walked.
        age = max(t_ns - min(one.t_ns, other.t_ns), abs(one.t_ns - other.t_ns)) / NS
        moved = (self._config.speed * age) ** 2 * np.eye(2)
        return _Found(met.xy[good], met.covariance[good] + moved, label[good])

    def _match(self, asks: Sequence[Ask], others: Sequence[Ask], found: _Found) -> list[Answer]:
        """What is found for each target: by label where it has one, else by distance; each crossing once.

        Known targets, asked for or not, go before those that are not known yet.
        """
        # Match by label
        everyone = [*asks, *others]
        answers = [Answer(ask, None, None, UNLABELLED) for ask in everyone]
        free = np.ones(len(found.xy), dtype=np.bool_)
        for n, ask in enumerate(everyone):
            own = np.flatnonzero(free & (found.label == ask.label))
            if ask.label != UNLABELLED and len(own):
                answers[n] = _answer(ask, found, int(own[0]))
                free[own[0]] = False
        # A crossing with the label of a known target cannot belong to another target.
        free &= ~np.isin(found.label, [a.label for a in everyone if a.label != UNLABELLED])
        first = [n for n, a in enumerate(asks) if a.number != UNNUMBERED]
        unknown = [n for n, a in enumerate(asks) if a.number == UNNUMBERED]
        # Match the rest by distance, at the least cost within the gate
        for part in ([*first, *range(len(asks), len(everyone))], unknown):
            rows, columns = [n for n in part if answers[n].place is None], np.flatnonzero(free)
            if not rows or not len(columns):
                continue
            known, spread = (
                np.array([everyone[n].place for n in rows]),
                np.array([everyone[n].covariance for n in rows]),
            )
            cost = distance2(found.xy[columns], found.covariance[columns] + LEAST * np.eye(2), known, spread).T
            labelled = np.array([everyone[n].label != UNLABELLED for n in rows])
            barred = labelled[:, None] & (found.label[columns] != UNLABELLED)
            for r, c in zip(*assign(np.where(barred, np.inf, cost), self._config.gate**2), strict=True):
                answers[rows[r]] = _answer(everyone[rows[r]], found, int(columns[c]))
                free[columns[c]] = False
        return answers


def _answer(ask: Ask, found: _Found, c: int) -> Answer:
    return Answer(ask, found.xy[c], found.covariance[c], int(found.label[c]))


def _once(requests: list[CameraRequest]) -> list[CameraRequest]:
    """The requests; a place that two of them found belongs to the first."""
    seen: set[tuple[float, ...]] = set()
    out = []
    for request in requests:
        place = request.answer.place
        key = () if place is None else tuple(place.tolist())
        if key in seen:
            request = request._replace(answer=request.answer._replace(place=None, covariance=None))
        elif key:
            seen.add(key)
        out.append(request)
    return out
