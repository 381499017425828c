"""Filter of boxes in the image of one camera: one Kalman filter per person, one assignment per frame.

The family of SORT (Bewley et al. 2016).  Boxes of all confidences are assigned at once, by likelihood ratios in which
a box of low confidence counts less (ByteTrack, Zhang et al. 2022, has two stages for this).  A miss counts by the share
of the person that is not hidden, and by whether the frame before was a miss, too, so that people live on while
they are hidden.  After a gap a person may also have stopped: the last observation competes with the prediction
(observation-centric recovery, OC-SORT, Cao et al. 2023).  Existence is that of integrated PDA (Musicki et al. 1994).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import erf

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.track.methods.jipda.association_features import OTHER_TARGET, SAME_TARGET, log_ratio, similarity
from occlog.track.methods.jipda.interface import NO_ID, Event, FrameDetections

from .config import SortConfig
from .encounters import Encounters
from .kernels.boxes import (
    ASPECT,
    LOG_HEIGHT,
    MIN_ASPECT,
    X,
    boxes_of,
    inside_shares,
    intersections,
    overlaps,
    states_of,
    visible_shares,
)
from .kernels.motion import predicted, updated
from .learned import ImageDetectorStatistics

SIZE_NOISE_DENSITY = 5e-4
"""Spectral density of the acceleration of the logarithm of a height and of the ratio of width to height [1/s^3]."""
SIGMA_SIZE_RATE = 0.05
"""Standard deviation of the rates of both at the begin of a track [1/s]."""
TAIL = 20.0
"""Degrees of freedom of the t distribution of innovations, heavier in its tails than the normal one."""
GATE_CHI2 = 25.0
"""Largest squared Mahalanobis distance of a box and a track (four degrees of freedom)."""
STOPPED = 0.1
"""Probability that a person without a box has left the predicted path since the last box."""
SIGMA_STROLL = 0.5
"""Standard deviation of where such a person is after one second, in heights; it grows with the root of the time."""
MAX_BIRTH_OVERLAP = 0.7
"""A box that overlaps a track by more (intersection over union) begins none: it is the same person twice."""
MIN_BOXES = 2
"""Boxes that confirm a track, at least."""
TERMINATION_TENTATIVE, TERMINATION_CONFIRMED = 0.02, 1e-3
"""Existence probabilities below which a track ends."""
MIN_INSIDE = 0.3
"""Share of a box in the image below which the person has left, without a detection."""
MIN_VISIBLE_TO_LEARN = 0.8
"""Visible share from which the appearance of a person is learned."""
APPEARANCE_RATE = 0.1
"""Weight of a new box in a person's appearance."""
MAX_EXISTENCE = 1.0 - 1e-4
"""Largest existence probability."""


@dataclass
class Targets:
    """N tracks of one camera as arrays, confirmed and tentative.

    A state is (centre x, y [px], ln of the height [px], width / height), each with a rate [1/s].

    Attributes:
        key: (N,) number of each track, from the start of the filter.
        id: (N,) identity; -1: not confirmed.
        mean: (N, 4, 2) values and rates of the states.
        cov: (N, 4, 3) variance of the value, covariance, variance of the rate, for each coordinate.
        last: (N, 4) state after the last box.
        last_var: (N, 4) variances of the state after the last box.
        existence: (N,) probability that the person is there.
        boxes: (N,) number of boxes so far.
        coasting_s: (N,) time since the last box [s].
        appearance: (N, K) mean appearance; NaN: none.
    """

    key: Ints
    id: Ints
    mean: Floats
    cov: Floats
    last: Floats
    last_var: Floats
    existence: Floats
    boxes: Ints
    coasting_s: Floats
    appearance: Floats

    def take(self, rows: Bools | Ints) -> Targets:
        """Return the tracks selected by a mask (N,) or by indices."""
        return Targets(*(getattr(self, f.name)[rows] for f in fields(self)))

    def and_(self, others: Targets) -> Targets:
        """Return these tracks followed by `others`."""
        return Targets(*(np.concatenate([getattr(self, f.name), getattr(others, f.name)]) for f in fields(self)))


def no_targets(length: int) -> Targets:
    """Return an empty set of tracks, with appearance vectors of `length` numbers."""
    none, some = np.zeros(0, dtype=np.int64), np.zeros(0)
    wide = np.zeros((0, 4))
    return Targets(
        none, none.copy(), np.zeros((0, 4, 2)), np.zeros((0, 4, 3)), wide, wide.copy(), some, none.copy(), some.copy(),
        np.zeros((0, length)),
    )  # fmt: skip


class FrameTracks(NamedTuple):
    """Confirmed tracks after a frame: m rows, and h boxes of tentative tracks that may be confirmed later."""

    t_ns: int
    frame: int
    id: Ints  # (m,)
    boxes: Floats  # (m, 4) left, top, right, bottom
    variance: Floats  # (m, 2) of the centre, x and y
    detected: Bools  # (m,) whether a box of this frame is assigned
    visibility: Floats  # (m,) share that is not hidden by nearer people, by the prediction
    existence: Floats  # (m,)
    events: tuple[Event, ...]
    keys: Ints  # (h,) keys of tracks with a box in this frame
    of_keys: Ints  # (h,) index of the box in the frame


class _Scored(NamedTuple):
    """Scores of all pairs of N tracks and M boxes."""

    ratio: Floats  # (N, M) log likelihood ratio of the pair to a miss and clutter; -inf: beyond the gate
    similarities: Floats  # (N, M) similarity of appearance; NaN: not known
    stopped: Bools  # (N, M) the box is near the last one, and off the predicted path
    missed: Bools  # (N,) the track had no box in the frame before
    detection: Floats  # (N,) probability of detection


class SortFilter:
    """Tracker of the boxes of one camera: tracks, learned statistics of the detector, encounters of targets.

    `step` updates it in place by the boxes of a frame.
    """

    def __init__(self, config: SortConfig, size: tuple[int, int] | None = None) -> None:
        """Start without tracks.

        Args:
            config: settings of the method.
            size: width and height of the image [px]; None: the reach of the boxes so far.
        """
        self.config = config
        self.targets = no_targets(0)
        self.learned = ImageDetectorStatistics(config.detection_probability)
        self.confirmed: dict[int, int] = {}
        self._size = None if size is None else (float(size[0]), float(size[1]))
        self._reach = (1.0, 1.0)
        self._t_ns: int | None = None
        self._keys = self._ids = 0
        self._encounters = Encounters()

    @property
    def size(self) -> tuple[float, float]:
        """Return width and height of the image [px]; if not given, the right and lower ends of the boxes so far."""
        return self._reach if self._size is None else self._size

    def step(self, found: FrameDetections, frame: int) -> FrameTracks:
        """Update the tracks with a frame, and return the rows of confirmed tracks with the events of this frame.

        Frames come in time order, including those without boxes; boxes without extent are ignored.

        Args:
            found: boxes of the frame, with confidences and appearances.
            frame: number of the frame.
        """
        rows = np.flatnonzero((found.boxes[:, 2] - found.boxes[:, 0] > 0) & (found.boxes[:, 3] - found.boxes[:, 1] > 0))
        boxes, score, appearance = found.boxes[rows], found.score[rows], found.appearance[rows]
        self._widen(boxes, appearance)
        dt = 0.0 if self._t_ns is None else (found.t_ns - self._t_ns) / NS
        self._t_ns = found.t_ns
        if not len(boxes) and not len(self.targets.id):
            return self._empty(found.t_ns, frame)
        self._predict(dt)
        z, noise = states_of(boxes), self._noise(boxes)
        visible = visible_shares(boxes_of(self.targets.mean[..., 0]), self._weights())
        scored = self._score(z, noise, score, appearance, visible, dt)
        target, box = _assigned(scored.ratio)
        events = [*self._encounters.add(found.t_ns, self.targets.id, scored.ratio, target, box)]
        self._learn(scored, score, visible, target, box)
        self._update(z, noise, appearance, scored, visible, target, box, dt)
        detected = np.zeros(len(self.targets.id), dtype=np.bool_)
        detected[target] = True
        events += self._confirm()
        free = np.setdiff1d(np.arange(len(rows)), box)
        initiated = self._begin(free, boxes, z, noise, score, appearance)
        keys = np.concatenate([self.targets.key[target], self.targets.key[len(detected) :]])
        detected, visible = (
            np.append(detected, np.ones(len(initiated), dtype=np.bool_)),
            np.append(visible, np.ones(len(initiated))),
        )
        shown = self._shown(detected)
        out = self._rows(found.t_ns, frame, shown, detected, visible)
        events += self._end(detected)
        return out._replace(events=tuple(events), keys=keys, of_keys=rows[np.concatenate([box, initiated])])

    def _empty(self, t_ns: int, frame: int) -> FrameTracks:
        """Update the statistics of clutter with a frame without boxes and tracks, as `step` does."""
        none, no_rows = np.zeros(0), np.zeros(0, dtype=np.int64)
        self.learned.add_scores(none, no_rows, no_rows)
        events = self._encounters.add(t_ns, no_rows, np.zeros((0, 0)), no_rows, no_rows)
        shown = np.zeros(0, dtype=np.bool_)
        return self._rows(t_ns, frame, shown, shown, none)._replace(events=tuple(events))

    def finish(self) -> tuple[Event, ...]:
        """Return the events of the encounters that are going on at the end."""
        return tuple(self._encounters.finish())

    def _widen(self, boxes: Floats, appearance: Floats) -> None:
        """Update the largest right and lower ends of boxes, and set the length of appearance vectors once known.

        `boxes` (M, 4) are left, top, right, bottom [px], `appearance` (M, K).
        """
        if len(boxes):
            self._reach = (max(self._reach[0], boxes[:, 2].max()), max(self._reach[1], boxes[:, 3].max()))
        if appearance.shape[1] and not self.targets.appearance.shape[1]:
            nothing = np.full((len(self.targets.id), appearance.shape[1]), np.nan)
            self.targets = replace(self.targets, appearance=nothing)

    def _weights(self) -> Floats:
        """Return (N,) probabilities that a track occludes what is behind it: existence if confirmed, else 0."""
        return np.where(self.targets.id >= 0, self.targets.existence, 0.0)

    def _noise(self, boxes: Floats) -> Floats:
        """Return (M, 4) measurement variances of the states of `boxes` (M, 4): left, top, right, bottom [px].

        A state is centre x and y [px], ln of the height, width / height.
        """
        position = (self.config.sigma_position * (boxes[:, 3] - boxes[:, 1])) ** 2
        size = np.full(len(boxes), self.config.sigma_size**2)
        return np.column_stack([position, position, size, size])

    def _predict(self, dt: float) -> None:
        """Predict all tracks by `dt` [s], in place: states, covariances, existence and coasting time."""
        at, config = self.targets, self.config
        density = np.full((len(at.id), 4), SIZE_NOISE_DENSITY)
        density[:, :2] = (config.process_noise_density * np.exp(2.0 * at.mean[:, LOG_HEIGHT, 0]))[:, None]
        at.mean[..., 0] += dt * at.mean[..., 1]
        at.cov = predicted(at.cov, density, dt)
        at.existence = at.existence * np.exp(-dt / config.mean_dwell_s)
        at.coasting_s = at.coasting_s + dt

    def _score(
        self, z: Floats, noise: Floats, score: Floats, appearance: Floats, visible: Floats, dt: float
    ) -> _Scored:
        """Return log likelihood ratios of all pairs of N tracks and M boxes, and the terms they were computed from.

        Args:
            z: (M, 4) states of the boxes.
            noise: (M, 4) variances of these.
            score: (M,) confidences; NaN: unknown.
            appearance: (M, K) appearances of the boxes.
            visible: (N,) shares of the tracks that nearer people do not hide, 0 to 1.
            dt: time since the last frame [s].
        """
        at = self.targets
        inside = inside_shares(boxes_of(at.mean[..., 0]), self.size)
        # Who was missed in the frame before is missed again, unless the run of misses has ended since
        again = 1.0 - np.exp(-dt / self.config.miss_duration_s)
        missed = at.coasting_s > 1.5 * dt
        detection = self.learned.detection(visible * inside) * np.where(missed, again, 1.0)
        detection = np.clip(detection, 0.01, 0.99)
        ahead, distance = _likelihood(at.mean[..., 0], at.cov[..., 0], z, noise)
        last, away = _likelihood(at.last, self._strolled(), z, noise)
        coasts = missed[:, None]
        here, there = ahead + np.log(1.0 - STOPPED), last + np.log(STOPPED)
        ratio = np.where(coasts, np.logaddexp(here, there), ahead)
        near = np.where(coasts, np.minimum(distance, away), distance) < GATE_CHI2
        area = self.size[0] * self.size[1]
        ratio += (np.log(detection) - np.log1p(-detection))[:, None] + self.learned.log_score_ratio(score, area)[
            None, :
        ]
        similarities = similarity(at.appearance, appearance) if appearance.shape[1] else np.full(ratio.shape, np.nan)
        ratio += log_ratio(self.learned.similarities, np.where((at.boxes > 1)[:, None], similarities, np.nan))
        return _Scored(np.where(near, ratio, -np.inf), similarities, coasts & (there > here), missed, detection)

    def _strolled(self) -> Floats:
        """Return (N, 4) variances of the states of people who may have left the predicted path since their last box."""
        at = self.targets
        spread = (SIGMA_STROLL * np.exp(at.last[:, LOG_HEIGHT])) ** 2 * at.coasting_s
        size = SIGMA_SIZE_RATE**2 * (1.0 + at.coasting_s)
        return np.asarray(at.last_var + np.column_stack([spread, spread, size, size]))

    def _learn(self, scored: _Scored, score: Floats, visible: Floats, target: Ints, box: Ints) -> None:
        """Update the detector statistics from tracks that are certain.

        Args:
            scored: scores of all pairs of N tracks and M boxes.
            score: (M,) confidences of the boxes.
            visible: (N,) visible shares of the tracks.
            target: (k,) indices of the tracks with a box.
            box: (k,) index of each such track's box.
        """
        at, learned = self.targets, self.learned
        hit = np.zeros(len(at.id), dtype=np.bool_)
        hit[target] = True
        inside = inside_shares(boxes_of(at.mean[..., 0]), self.size) > 0.95
        sure = (at.id >= 0) & (at.existence > 0.9) & inside
        # After a hit only: misses come in runs
        fresh = sure & ~scored.missed
        learned.add_detections(visible[fresh], hit[fresh])
        confirmed = at.id[target] >= 0
        learned.add_scores(score, box[confirmed], np.setdiff1d(np.arange(len(score)), box))
        plain = confirmed & sure[target] & (visible[target] > MIN_VISIBLE_TO_LEARN) & (at.boxes[target] > 2)
        learned.add_similarity(SAME_TARGET, scored.similarities[target[plain], box[plain]])
        if plain.sum() > 1:
            cross = scored.similarities[np.ix_(target[plain], box[plain])]
            learned.add_similarity(OTHER_TARGET, cross[~np.eye(len(cross), dtype=np.bool_)])

    def _update(
        self, z: Floats, noise: Floats, appearance: Floats, scored: _Scored, visible: Floats,
        target: Ints, box: Ints, dt: float,
    ) -> None:  # fmt: skip
        """Update tracks by their boxes (Kalman update), and the existence of all tracks, in place.

        Args:
            z: (M, 4) states of the boxes.
            noise: (M, 4) variances of the states of the boxes.
            appearance: (M, K) appearances of the boxes.
            scored: scores of all pairs of N tracks and M boxes.
            visible: (N,) visible shares of the tracks.
            target: (k,) indices of the tracks with a box.
            box: (k,) index of each such track's box.
            dt: time since the last frame [s].
        """
        at = self.targets
        stopped = scored.stopped[target, box]
        mean, cov = updated(at.mean[target], at.cov[target], z[box], noise[box])
        if stopped.any():
            since = np.maximum(at.coasting_s[target[stopped]], max(dt, 1e-9))[:, None]
            again = _initiated(z[box[stopped]], noise[box[stopped]], 0.5 * self.config.sigma_speed)
            again[0][:, :2, 1] = ((z[box[stopped]] - at.last[target[stopped]]) / since)[:, :2]
            mean[stopped], cov[stopped] = again
        at.mean[target], at.cov[target] = mean, cov
        at.last[target], at.last_var[target] = mean[..., 0], cov[..., 0]
        at.boxes[target] += 1
        at.coasting_s[target] = 0.0
        odds = at.existence / (1.0 - at.existence) * (1.0 - scored.detection)
        odds[target] *= np.exp(np.clip(scored.ratio[target, box], -30.0, 30.0))
        at.existence = np.minimum(odds / (1.0 + odds), MAX_EXISTENCE)
        if appearance.shape[1]:
            plain = (visible[target] > MIN_VISIBLE_TO_LEARN) | np.isnan(at.appearance[target, 0])
            plain &= ~np.isnan(appearance[box]).any(axis=1)
            who, of = target[plain], box[plain]
            old = np.where(np.isnan(at.appearance[who]), appearance[of], at.appearance[who])
            at.appearance[who] = old + APPEARANCE_RATE * (appearance[of] - old)

    def _confirm(self) -> list[Event]:
        """Give identities to tentative tracks that exist with sufficient probability, in place; return the events."""
        at = self.targets
        new = np.flatnonzero(
            (at.id < 0) & (at.existence > self.config.confirmation_threshold) & (at.boxes >= MIN_BOXES)
        )
        events = []
        for k in new.tolist():
            at.id[k] = self._ids
            self.confirmed[int(at.key[k])] = self._ids
            events.append(Event("initiated", self._ids, NO_ID, float(at.existence[k])))
            self._ids += 1
        return events

    def _begin(self, free: Ints, boxes: Floats, z: Floats, noise: Floats, score: Floats, appearance: Floats) -> Ints:
        """Start tentative tracks at unassigned boxes, in place; return the indices of the boxes that began one.

        Args:
            free: indices of the unassigned boxes.
            boxes: (M, 4) of the frame: left, top, right, bottom [px].
            z: (M, 4) states of these.
            noise: (M, 4) variances of the states.
            score: (M,) confidences; NaN: unknown.
            appearance: (M, K) of the boxes.
        """
        at = self.targets
        initiated = free[~(score[free] < self.config.birth_score)]
        prior = self.learned.birth_probability(score[initiated])
        if len(at.id) and len(initiated):
            tracked = boxes_of(at.mean[..., 0])
            apart = overlaps(boxes[initiated], tracked).max(axis=1) < MAX_BIRTH_OVERLAP
            initiated, prior = initiated[apart], prior[apart]
            # A box on a person is rather a second box of that person than another person
            area = np.prod(boxes[initiated, 2:] - boxes[initiated, :2], axis=1)
            covered = (intersections(boxes[initiated], tracked) / area[:, None]).max(axis=1, initial=0.0)
            prior = prior * (1.0 - 0.9 * np.clip(covered, 0.0, 1.0))
        mean, cov = _initiated(z[initiated], noise[initiated], self.config.sigma_speed)
        n = len(initiated)
        self.targets = at.and_(
            Targets(
                key=self._keys + np.arange(n), id=np.full(n, -1, dtype=np.int64), mean=mean, cov=cov,
                last=z[initiated].copy(), last_var=noise[initiated].copy(), existence=prior,
                boxes=np.ones(n, dtype=np.int64), coasting_s=np.zeros(n), appearance=appearance[initiated].copy()
                if appearance.shape[1] else np.full((n, at.appearance.shape[1]), np.nan),
            )
        )  # fmt: skip
        self._keys += n
        return initiated

    def _shown(self, detected: Bools) -> Bools:
        """Return (N,) booleans: the track has an output row in this frame.

        Such tracks are confirmed, and have a box (`detected` (N,)) or are probably within a third of their width of the
        prediction.
        """
        at = self.targets
        width = np.exp(at.mean[:, LOG_HEIGHT, 0]) * np.maximum(at.mean[:, ASPECT, 0], MIN_ASPECT)
        found = match_probability(width, at.cov[:, X, 0]) * at.existence
        inside = inside_shares(boxes_of(at.mean[..., 0]), self.size) > MIN_INSIDE
        shown: Bools = (at.id >= 0) & (detected | (inside & (found > self.config.min_match_probability)))
        return shown

    def _rows(self, t_ns: int, frame: int, shown: Bools, detected: Bools, visible: Floats) -> FrameTracks:
        """Return the output rows of the tracks `shown` (N,), sorted by identity, without events and keys.

        Args:
            t_ns: time of the frame [ns].
            frame: number of the frame.
            shown: (N,) whether a track has a row.
            detected: (N,) whether it has a box in this frame.
            visible: (N,) share that nearer people do not hide.
        """
        at = self.targets
        rows = np.flatnonzero(shown)
        rows = rows[np.argsort(at.id[rows])]
        none = np.zeros(0, dtype=np.int64)
        return FrameTracks(
            t_ns, frame, at.id[rows], boxes_of(at.mean[rows, :, 0]), at.cov[rows, :2, 0], detected[rows],
            visible[rows], at.existence[rows], (), none, none,
        )  # fmt: skip

    def _end(self, detected: Bools) -> list[Event]:
        """Delete tracks that left the image, hardly exist or coasted for too long, in place; return the events.

        `detected` (N,): the track has a box in this frame.
        """
        at = self.targets
        least = np.where(at.id >= 0, TERMINATION_CONFIRMED, TERMINATION_TENTATIVE)
        left = inside_shares(boxes_of(at.mean[..., 0]), self.size) < MIN_INSIDE
        over = (at.existence < least) | (at.coasting_s > self.config.max_coasting_s) | (left & ~detected)
        ended = np.flatnonzero(over & (at.id >= 0))
        events = [Event("terminated", int(at.id[k]), NO_ID, float(at.existence[k])) for k in ended]
        self.targets = at.take(~over)
        return events


def match_probability(width: Floats, variance: Floats) -> Floats:
    """Return (N,) probabilities that a normal error of variance `variance` (N,) is within a third of `width` (N,)."""
    out: Floats = erf(width / 3.0 / np.sqrt(2.0 * variance))
    return out


def _initiated(z: Floats, noise: Floats, sigma_speed: float) -> tuple[Floats, Floats]:
    """Return initial means (n, 4, 2) and covariances (n, 4, 3) of n tracks from single boxes.

    Args:
        z: (n, 4) states of the boxes: centre [px], ln of the height, width / height.
        noise: (n, 4) variances of the states.
        sigma_speed: standard deviation of a speed per axis [box heights/s].
    """
    mean, cov = np.zeros((len(z), 4, 2)), np.zeros((len(z), 4, 3))
    mean[..., 0], cov[..., 0] = z, noise
    cov[:, :2, 2] = (sigma_speed**2 * np.exp(2.0 * z[:, LOG_HEIGHT]))[:, None]
    cov[:, 2:, 2] = SIGMA_SIZE_RATE**2
    return mean, cov


def _likelihood(mean: Floats, variance: Floats, z: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return (N, M) log likelihoods of M boxes for N tracks, and (N, M) squared Mahalanobis distances.

    Innovations have a Student t distribution with `TAIL` degrees of freedom.

    Args:
        mean: (N, 4) predicted states of the tracks.
        variance: (N, 4) variances of these.
        z: (M, 4) states of the boxes.
        noise: (M, 4) variances of these.
    """
    spread = variance[:, None, :] + noise[None]
    off = mean[:, None, :] - z[None]
    distance = (off * off / spread).sum(axis=2)
    log = -0.5 * (TAIL + 4.0) * np.log1p(distance / TAIL) - 0.5 * np.log(spread).sum(axis=2) - 2.0 * np.log(2.0 * np.pi)
    return log, distance


def _assigned(ratio: Floats) -> tuple[Ints, Ints]:
    """Return (k,) indices of tracks and (k,) of their boxes, the assignment with the largest sum of ratios.

    `ratio` (N, M) are log likelihood ratios; pairs with a ratio of 0 or less are not assigned.
    """
    gain = np.where(ratio > 0.0, ratio, 0.0)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    made = gain[rows, columns] > 0.0
    return rows[made].astype(np.int64), columns[made].astype(np.int64)
