"""Association of the boxes of one time step with predicted people, and initiation of new people from the rest."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

from ..filter import (
    BIRTH_DENSITY_PER_M2,
    GATE_CHI2,
    MAX_BIRTHS_PER_IMAGE,
    MIN_EXISTENCE_TO_INITIATE,
    UNTRACKED_TO_CLUTTER_RATIO,
    JipdaState,
)
from ..interface import WIDTH
from ..kernels.detections import DetectorModel, PackedDetections
from ..kernels.joint_association import update_targets
from ..kernels.track_initiation import BirthIntensity, initiate_targets
from ..target_set import DUPLICATE_DISTANCE_WIDTHS
from .mcmc_association import NO_NODE
from .tracklet_nodes import factors, frame_visibilities, missed_detection_log_probabilities

MIN_ASSOCIATION_PROBABILITY = 0.5
"""A box is given to a person if it is theirs with a greater probability."""
MIN_LOG_FIT = -30.0
"""Minimum log likelihood ratio of a person's boxes to clutter, at the best position: a person who was
expected far off, as after a pause, was linearised there."""
NEW_TARGET_DENSITY_RATIO = 0.05
"""Number of new people at a time step, relative to the initial density of people."""


class AssociatedPeople(NamedTuple):
    """N people at one time step with their boxes in L frames of C cameras.

    `track` (N,) that predicted each (`NO_NODE`: newly initiated), `mean` (N, 6) the state about which the boxes are
    linearised, `given` (L, N) the box in each frame (`NO_NODE`: none), measurement factor exp(c + h' s - s' J s / 2) as
    `J` (N, 6, 6), `h` (N, 6), `c` (N,), `miss` (N, C) log probabilities of a miss, `hint` (N, 2 C) identities of the
    boxes by single-camera trackers, then by the filter, `appearance` (N, K) the sum of `n_vectors` (N,) unit vectors.
    """

    track: Ints  # (N,) track that predicted them; NO_NODE: no track did
    mean: Floats  # (N, 6)
    given: Ints  # (L, N) box in each frame; NO_NODE: no box
    J: Floats  # (N, 6, 6) factor of the state, as in `nodes`
    h: Floats  # (N, 6)
    c: Floats  # (N,)
    miss: Floats  # (N, C) log of the probability that a camera misses the person
    hint: Ints  # (N, 2 C) identity of the box of each camera by a tracker in its images, then by the filter; NO_NODE
    appearance: Floats  # (N, K) sum of the appearance vectors of the boxes
    n_vectors: Floats  # (N,) boxes of that sum


class PredictedPeople(NamedTuple):
    """N people predicted at a time step: number of the track (N,), state mean (N, 6) and covariance, existence (N,).

    A state is x, y, vx, vy, height, width.
    """

    track: Ints  # (N,)
    mean: Floats  # (N, 6)
    covariance: Floats  # (N, 6, 6)
    existence: Floats  # (N,) probability that they are there


class AssociatedBoxes(NamedTuple):
    """Result of the association of the M boxes of a time step's L frames with N people.

    `people` are updated by the boxes; `beta` (N, M) is the probability that the person exists and the box is theirs
    alone, `joint` (N, M) that it is merged with a neighbour's; `visible` (L, N) visible shares, NaN out of view.
    """

    people: PredictedPeople
    beta: Floats  # (N, M) probability that they are there and the box is theirs alone
    joint: Floats  # (N, M) the same, with a neighbour
    visible: Floats  # (L, N)

    def without(self, far: Ints) -> AssociatedBoxes:
        """Return the association without the people at the indices `far`."""
        stay = np.setdiff1d(np.arange(len(self.beta)), far)
        p = self.people
        people = PredictedPeople(p.track[stay], p.mean[stay], p.covariance[stay], p.existence[stay])
        return AssociatedBoxes(people, self.beta[stay], self.joint[stay], self.visible[:, stay])


def associate(
    state: JipdaState, boxes: PackedDetections, rates: DetectorModel, people: PredictedPeople, bonus: Floats
) -> AssociatedBoxes:
    """Update N people with the M boxes of one time step, by JIPDA over all cameras jointly as in the filter.

    Args:
        state: filter state; gives the cameras.
        boxes: frames of the time step, packed.
        rates: parameters of the cameras' detectors.
        people: predicted people.
        bonus: (N, M) log likelihood ratios of tracklet ids and appearance.

    Returns:
        Updated people, and association probabilities that include existence.
    """
    after = update_targets(
        people.mean, people.covariance, people.existence, state.views, boxes, rates, bonus,
        UNTRACKED_TO_CLUTTER_RATIO, GATE_CHI2, np.zeros((len(people.track), len(state.views.size)))
    )  # fmt: skip
    who = PredictedPeople(people.track, after.mean, after.covariance, after.existence)
    there = after.existence[:, None]
    return AssociatedBoxes(who, there * after.beta, there * after.joint, after.visible)


def assign_boxes(
    state: JipdaState,
    boxes: PackedDetections,
    rates: DetectorModel,
    hint: Ints,
    appearance: Floats,
    seen: AssociatedBoxes,
) -> AssociatedPeople:
    """Assign to predicted people the boxes that are most probably theirs; initiate people from unassigned boxes.

    Args:
        state: filter state; gives cameras and settings.
        boxes: frames of the time step with their M boxes, packed.
        rates: parameters of the cameras' detectors.
        hint: (M, 2) identities of boxes, by single-camera trackers and by the filter; NO_NODE: none.
        appearance: (M, K) unit vectors; NaN: none.
        seen: predicted people, updated with the boxes.

    Returns:
        People who have a box, predicted ones first; predicted people with boxes that fit nowhere (`MIN_LOG_FIT`) are
        omitted.
    """
    people, beta, joint = seen.people, seen.beta, seen.joint
    c = state.config
    body = np.array(
        [c.person_height, c.sigma_person_height, c.person_width, c.sigma_person_width, c.sigma_initial_velocity]
    )
    spread = np.sqrt(0.5 * (people.covariance[:, 0, 0] + people.covariance[:, 1, 1]))
    arrival = BirthIntensity(
        everywhere=NEW_TARGET_DENSITY_RATIO * BIRTH_DENSITY_PER_M2 / state.metre**2,
        in_image=NEW_TARGET_DENSITY_RATIO * MAX_BIRTHS_PER_IMAGE,
        centre=np.zeros((0, 2)),
        at=np.zeros(0),
        smooth=state.metre,
    )
    free = np.clip(1.0 - beta.sum(axis=0) - 0.5 * joint.sum(axis=0), 0.0, 1.0)
    mean, covariance, odds, used = initiate_targets(
        state.views, boxes, rates, body, arrival, people.mean, spread,
        people.existence, free, GATE_CHI2, math.log(MIN_EXISTENCE_TO_INITIATE),
    )  # fmt: skip
    given = np.concatenate([best_boxes(boxes, beta), best_boxes(boxes, used)], axis=1)
    track = np.concatenate([people.track, np.full(len(odds), NO_NODE)])
    mean, covariance = np.concatenate([people.mean, mean]), np.concatenate([people.covariance, covariance])
    _join_doubles(mean, given, len(people.track))
    # A new person may be clutter, and hides others half as much
    there = np.concatenate([people.existence, 0.5 / (1.0 + np.exp(-odds))])
    _, feet, detection = frame_visibilities(state.views, boxes, rates, mean, covariance, there)
    # Who is in one box with a neighbour was not missed
    for frame in range(len(boxes.camera)):
        here = slice(boxes.first[frame], boxes.first[frame + 1])
        detection[frame, : len(joint)] *= 1.0 - np.minimum(joint[:, here].sum(axis=1), 1.0)
    rows = np.flatnonzero((given >= 0).any(axis=0))
    mean, given = mean[rows], np.ascontiguousarray(given[:, rows])
    J, h, constant = factors(
        state.views, boxes, rates, mean, given,
        np.ascontiguousarray(detection[:, rows]), np.ascontiguousarray(feet[:, rows]),
    )  # fmt: skip
    far = rows[(rows < len(people.track)) & (best_fit(J, h, constant) < MIN_LOG_FIT)]
    if len(far):
        return assign_boxes(state, boxes, rates, hint, appearance, seen.without(far))
    # Who hides a person hides them for a while: they are missed at least as probably near it as at it
    miss = missed_detection_log_probabilities(state.views, rates, mean)
    for frame, camera in enumerate(boxes.camera.tolist()):
        miss[:, camera] = np.maximum(miss[:, camera], np.log1p(-detection[frame, rows]))
    named = np.full((len(rows), 2, len(state.views.size)), NO_NODE)
    for frame, camera in enumerate(boxes.camera.tolist()):
        has = np.flatnonzero(given[frame] >= 0)
        named[has, :, camera] = hint[given[frame, has]]
    assign_shared_boxes(named[:, 1], rows, joint, given, boxes)
    # Appearance of the boxes that have one
    shows = np.append(np.isfinite(appearance).all(axis=1) & (appearance.shape[1] > 0), False)[given]
    vectors = np.append(np.nan_to_num(appearance), np.zeros((1, appearance.shape[1])), axis=0)[given]
    frame, n_vectors = (vectors * shows[..., None]).sum(axis=0), shows.sum(axis=0, dtype=np.float64)
    names = named.reshape(len(rows), 2 * len(state.views.size))
    return AssociatedPeople(track[rows], mean, given, J, h, constant, miss, names, frame, n_vectors)


def best_fit(J: Floats, h: Floats, c: Floats) -> Floats:
    """Return (N,) maxima over the state s of the exponents c + h' s - s' J s / 2.

    J (N, 6, 6), h (N, 6) and c (N,) are measurement factors of N people.
    """
    return np.asarray(c + 0.5 * np.einsum("ni,nij,nj->n", h, np.linalg.pinv(J, hermitian=True), h))


def assign_shared_boxes(followed: Ints, rows: Ints, joint: Floats, given: Ints, boxes: PackedDetections) -> None:
    """Set the missing filter identity of each person who shares a box with a neighbour, in place.

    It becomes the identity that most of the person's other boxes have.

    Args:
        followed: (n, C) identities that the filter gives the boxes of people in each camera; NO_NODE: none; changed.
        rows: (n,) index of each of these people among all people; those below N were predicted.
        joint: (N, M) probability that a box is merged of a predicted person and a neighbour.
        given: (L, n) box of each person alone in each frame; NO_NODE: none.
        boxes: frames of the time step with their M boxes, packed.
    """
    for k in np.flatnonzero((rows < len(joint)) & (followed != NO_NODE).any(axis=1)).tolist():
        names, often = np.unique(followed[k][followed[k] != NO_NODE], return_counts=True)
        for frame, camera in enumerate(boxes.camera.tolist()):
            here = slice(boxes.first[frame], boxes.first[frame + 1])
            if given[frame, k] == NO_NODE and joint[rows[k], here].sum() > MIN_ASSOCIATION_PROBABILITY:
                followed[k, camera] = names[np.argmax(often)]


def _join_doubles(mean: Floats, given: Ints, known: int) -> None:
    """Move boxes of new people to a person at nearly the same position who has no box in the frame; in place.

    Args:
        mean: (N, 6) states of the people, new ones last.
        given: (L, N) box of each person in each frame; NO_NODE: none; changed.
        known: number of people who are not new.
    """
    for j in range(known, len(mean)):
        separation = np.hypot(*(mean[:j, :2] - mean[j, :2]).T)
        separation[(given[:, :j] == NO_NODE).all(axis=0)] = np.inf
        i = int(np.argmin(separation)) if j else j
        if i < j and separation[i] < DUPLICATE_DISTANCE_WIDTHS * mean[i, WIDTH]:
            given[:, i] = np.where(given[:, i] == NO_NODE, given[:, j], given[:, i])
            given[:, j] = NO_NODE


def best_boxes(boxes: PackedDetections, beta: Floats) -> Ints:
    """Return (L, N) index of the most probable box of each person in each frame; `NO_NODE`: none.

    It must have a probability `beta` (N, M) above `MIN_ASSOCIATION_PROBABILITY`, and the person be the likeliest of the
    box.
    """
    out = np.full((len(boxes.camera), len(beta)), NO_NODE)
    if not len(beta):
        return out
    for frame in range(len(boxes.camera)):
        first, stop = boxes.first[frame], boxes.first[frame + 1]
        if first == stop:
            continue
        here = beta[:, first:stop]
        best = np.argmax(here, axis=1)
        # Each person and each box has at most one best partner
        who = np.arange(len(here))
        own = np.flatnonzero((here[who, best] > MIN_ASSOCIATION_PROBABILITY) & (np.argmax(here, axis=0)[best] == who))
        out[frame, own] = first + best[own]
    return out
