"""Boxes of one moment: which are of the people who are expected there, and whom the others show."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

from ..filter import CROWD, GATE, IN_IMAGE, LEAST_BIRTH, NEW_SHARE, State
from ..interface import WIDTH
from ..kernels.detections import Boxes, Rates
from ..kernels.joint import update
from ..kernels.newborn import Arrival, newborn
from ..people import DOUBLE
from .chains import NONE
from .places import factors, misses, visibilities

OWN = 0.5
"""A box is given to a person if it is theirs with a greater probability."""
LEAST_FIT = -30.0
"""Boxes whose log likelihood ratio to boxes of nobody is lower, wherever the person is, are not one person's: who was
expected far off, as after a pause, was linearised there."""
RARE = 0.05
"""Somebody new at a moment, against how crowded a place is where nobody has looked yet."""


class Found(NamedTuple):
    """People of one moment with boxes; N people, L looks, C cameras."""

    track: Ints  # (N,) track that expected them; NONE: nobody did
    mean: Floats  # (N, 6)
    given: Ints  # (L, N) box in each look; NONE: none
    J: Floats  # (N, 6, 6) factor of the state, as in `places`
    h: Floats  # (N, 6)
    c: Floats  # (N,)
    miss: Floats  # (N, C) log of the probability that a camera detects nobody there
    hint: Ints  # (N, 2 C) identity of the box of each camera by a tracker in its images, then by the filter; NONE
    look: Floats  # (N, K) sum of how the boxes look
    looks: Floats  # (N,) boxes of that sum


class Expected(NamedTuple):
    """N people who are expected at a moment."""

    track: Ints  # (N,)
    mean: Floats  # (N, 6)
    covariance: Floats  # (N, 6, 6)
    existence: Floats  # (N,) probability that they are there


class Seen(NamedTuple):
    """The same after the boxes; M boxes."""

    people: Expected
    share: Floats  # (N, M) probability that they are there and the box is theirs alone
    joint: Floats  # (N, M) the same, with a neighbour
    visible: Floats  # (L, N)

    def without(self, far: Ints) -> Seen:
        """The others."""
        stay = np.setdiff1d(np.arange(len(self.share)), far)
        p = self.people
        people = Expected(p.track[stay], p.mean[stay], p.covariance[stay], p.existence[stay])
        return Seen(people, self.share[stay], self.joint[stay], self.visible[:, stay])


def associate(state: State, boxes: Boxes, rates: Rates, people: Expected, bonus: Floats) -> Seen:
    """Update the people by the boxes of the moment, all cameras jointly, as the filter does."""
    after = update(
        people.mean, people.covariance, people.existence, state.views, boxes, rates, bonus, NEW_SHARE, GATE
    )  # fmt: skip
    who = Expected(people.track, after.mean, after.covariance, after.existence)
    there = after.existence[:, None]
    return Seen(who, there * after.share, there * after.joint, after.visible)


def find(state: State, boxes: Boxes, rates: Rates, hint: Ints, appearance: Floats, seen: Seen) -> Found:
    """Give boxes to the people whose they are, and make new people of those that are left.

    Args:
        state: of the filter.
        boxes: of the moment.
        rates: of the detectors.
        hint: (M, 2) identities of boxes, by trackers in the images and by the filter.
        appearance: (M, K) vectors of length 1; NaN: none.
        seen: who are believed to be there, after the boxes.
    """
    people, share, joint = seen.people, seen.share, seen.joint
    c = state.config
    body = np.array([c.height, c.sigma_height, c.width, c.sigma_width, c.speed])
    spread = np.sqrt(0.5 * (people.covariance[:, 0, 0] + people.covariance[:, 1, 1]))
    arrival = Arrival(
        everywhere=RARE * CROWD / state.metre**2,
        in_image=RARE * IN_IMAGE,
        centre=np.zeros((0, 2)),
        at=np.zeros(0),
        smooth=state.metre,
    )
    free = np.clip(1.0 - share.sum(axis=0) - 0.5 * joint.sum(axis=0), 0.0, 1.0)
    mean, covariance, odds, used = newborn(
        state.views, boxes, rates, body, arrival, people.mean, spread,
        people.existence, free, GATE, math.log(LEAST_BIRTH),
    )  # fmt: skip
    given = np.concatenate([best_boxes(boxes, share), best_boxes(boxes, used)], axis=1)
    track = np.concatenate([people.track, np.full(len(odds), NONE)])
    mean, covariance = np.concatenate([people.mean, mean]), np.concatenate([people.covariance, covariance])
    _join_doubles(mean, given, len(people.track))
    # Whoever is new may be nobody, and hides others half as much
    there = np.concatenate([people.existence, 0.5 / (1.0 + np.exp(-odds))])
    _, feet, detection = visibilities(state.views, boxes, rates, mean, covariance, there)
    # Who is in one box with a neighbour was not missed
    for look in range(len(boxes.camera)):
        here = slice(boxes.first[look], boxes.first[look + 1])
        detection[look, : len(joint)] *= 1.0 - np.minimum(joint[:, here].sum(axis=1), 1.0)
    rows = np.flatnonzero((given >= 0).any(axis=0))
    mean, given = mean[rows], np.ascontiguousarray(given[:, rows])
    J, h, constant = factors(
        state.views, boxes, rates, mean, given,
        np.ascontiguousarray(detection[:, rows]), np.ascontiguousarray(feet[:, rows]),
    )  # fmt: skip
    far = rows[(rows < len(people.track)) & (best_fit(J, h, constant) < LEAST_FIT)]
    if len(far):
        return find(state, boxes, rates, hint, appearance, seen.without(far))
    # Who hides a person hides them for a while: beside this moment they are missed as probably as at it, at least
    miss = misses(state.views, rates, mean)
    for look, camera in enumerate(boxes.camera.tolist()):
        miss[:, camera] = np.maximum(miss[:, camera], np.log1p(-detection[look, rows]))
    named = np.full((len(rows), 2, len(state.views.size)), NONE)
    for look, camera in enumerate(boxes.camera.tolist()):
        has = np.flatnonzero(given[look] >= 0)
        named[has, :, camera] = hint[given[look, has]]
    name_shared(named[:, 1], rows, joint, given, boxes)
    # How the boxes look, of those that have an appearance
    shows = np.append(np.isfinite(appearance).all(axis=1) & (appearance.shape[1] > 0), False)[given]
    vectors = np.append(np.nan_to_num(appearance), np.zeros((1, appearance.shape[1])), axis=0)[given]
    look, looks = (vectors * shows[..., None]).sum(axis=0), shows.sum(axis=0, dtype=np.float64)
    names = named.reshape(len(rows), 2 * len(state.views.size))
    return Found(track[rows], mean, given, J, h, constant, miss, names, look, looks)


def best_fit(J: Floats, h: Floats, c: Floats) -> Floats:
    """(N,) greatest value of each exponent c + h' s - s' J s / 2."""
    return np.asarray(c + 0.5 * np.einsum("ni,nij,nj->n", h, np.linalg.pinv(J, hermitian=True), h))


def name_shared(followed: Ints, rows: Ints, joint: Floats, given: Ints, boxes: Boxes) -> None:
    """Give people who share a box with a neighbour the filter's identity, that of most of their boxes; in place.

    Args:
        followed: (n, C) identities that the filter gives the boxes of people in each camera; NONE.
        rows: (n,) places of these people among all, of whom those who are expected come first.
        joint: (N, M) probability that a box is of a person who is expected and a neighbour.
        given: (L, n) box of each person alone in each look; NONE.
        boxes: of the moment.
    """
    for k in np.flatnonzero((rows < len(joint)) & (followed != NONE).any(axis=1)).tolist():
        names, often = np.unique(followed[k][followed[k] != NONE], return_counts=True)
        for look, camera in enumerate(boxes.camera.tolist()):
            here = slice(boxes.first[look], boxes.first[look + 1])
            if given[look, k] == NONE and joint[rows[k], here].sum() > OWN:
                followed[k, camera] = names[np.argmax(often)]


def _join_doubles(mean: Floats, given: Ints, known: int) -> None:
    """Give the boxes (L, N) of new people to whom they stand in, in looks that show no other box of theirs; in place.

    Args:
        mean: (N, 6) people, the new ones last.
        given: (L, N) box in each look; NONE.
        known: how many are not new.
    """
    for j in range(known, len(mean)):
        apart = np.hypot(*(mean[:j, :2] - mean[j, :2]).T)
        apart[(given[:, :j] == NONE).all(axis=0)] = np.inf
        i = int(np.argmin(apart)) if j else j
        if i < j and apart[i] < DOUBLE * mean[i, WIDTH]:
            given[:, i] = np.where(given[:, i] == NONE, given[:, j], given[:, i])
            given[:, j] = NONE


def best_boxes(boxes: Boxes, share: Floats) -> Ints:
    """(L, N) the box that is most probably each person's in each look; NONE if no share (N, M) is above `OWN`."""
    out = np.full((len(boxes.camera), len(share)), NONE)
    if not len(share):
        return out
    for look in range(len(boxes.camera)):
        first, stop = boxes.first[look], boxes.first[look + 1]
        if first == stop:
            continue
        here = share[:, first:stop]
        best = np.argmax(here, axis=1)
        # Of a person and of a box alike there is one best, or none
        who = np.arange(len(here))
        own = np.flatnonzero((here[who, best] > OWN) & (np.argmax(here, axis=0)[best] == who))
        out[look, own] = first + best[own]
    return out
