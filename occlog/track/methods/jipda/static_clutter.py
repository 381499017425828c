"""Static clutter of one camera: pictures, statues, mirrors and screens that its detector takes for people.

One camera reports the same box again and again, and cameras with an unoccluded view of the position report none. A
person would have to be missed by each of these cameras independently, frame after frame. The log odds of static clutter
against a person are kept for every track, with the camera and the box. Something unknown may hide a person from a
camera for long, but hardly one who has been at this position since the track began and whom no other camera ever saw.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from occlog.array_types import Bools, Floats

from .detector_model import MIN_VISIBILITY_TO_LEARN, SAME_SOURCE_CHI2, squared_distance
from .kernels.detections import PackedDetections
from .kernels.joint_association import JipdaResult
from .target_set import PRIOR_STATIC_LOG_ODDS, TargetSet

MIN_LOG_ODDS, MAX_LOG_ODDS = -10.0, 20.0
"""Limits of the log odds of static clutter."""
MIN_HIT = 0.5
"""Association probability from which a camera supports a track."""
MISS_INTERVAL_S = 0.5
"""Misses are correlated in time: those of a camera count once in this interval [s]."""
MAX_MISS_EVIDENCE = 2.0
"""Greatest evidence of one missed detection: what a camera does not see may be hidden from it by something unknown."""
SUPPORT_EVIDENCE = 5.0
"""Evidence for a person of a box in another camera, or of a box that moved."""
MIN_STEPS_WALKED, WALKED_M = 3.0, 1.0
"""Minimum number of time steps with boxes, and minimum distance [m] from the first position, of a person who walked."""


def update_static_clutter(
    people: TargetSet,
    boxes: PackedDetections,
    at_source: Bools,
    result: JipdaResult,
    noise: Floats,
    interval: Floats,
    metre: float,
    cameras: int,
    hidden: Floats,
) -> TargetSet:
    """Return the tracks with updated log odds of being static clutter of one camera (a picture, statue or mirror).

    Boxes in other cameras and boxes that move lower the log odds; misses by other cameras with a view raise them. A
    track that walked to its position, where no clutter source was known, counts as a person unless two cameras with an
    unoccluded view miss it at this time step.

    Args:
        people: N tracks after the update.
        boxes: M boxes of the time step's L frames, packed.
        at_source: (M,) boxes at an established source of clutter.
        result: associations, visibilities and detection probabilities from the update.
        noise: (4, 2) variances of box centre and width, centre and height: constant [px^2], and factor of the squared
            size.
        interval: (C,) time since each camera's last frame [s]; may be infinite.
        metre: length of a metre in the scene's unit.
        cameras: number of views that are cameras; position sensors have the indices after them, and can confirm or deny
            a track but not be its source of static clutter.
        hidden: (N, C) probabilities of an unknown obstacle that the detection probabilities contain.
    """
    walked = np.hypot(*(people.mean[:, :2] - people.first).T) > WALKED_M * metre
    unconfirmed = ~walked & (people.static_log_odds >= PRIOR_STATIC_LOG_ODDS)
    known, denying = people.static_known.copy(), np.zeros(len(people.key), dtype=np.int64)
    camera, box, log_odds = people.static_camera.copy(), people.static_box.copy(), people.static_log_odds.copy()
    share = result.beta + result.joint
    for frame, c in enumerate(boxes.camera.tolist()):
        here = slice(boxes.first[frame], boxes.first[frame + 1])
        of = share[:, here]
        best = of.argmax(axis=1) if of.shape[1] else np.zeros(len(of), dtype=np.int64)
        hit = of.sum(axis=1) > MIN_HIT
        there = boxes.box[here][best] if of.shape[1] else np.zeros((len(of), 4))
        first = hit & ((camera < 0) | ((camera != c) & (log_odds <= MIN_LOG_ODDS))) & (c < cameras)
        own = hit & (camera == c)
        moved = own & (squared_distance(there, box, noise) > SAME_SOURCE_CHI2)
        log_odds[moved] -= SUPPORT_EVIDENCE
        log_odds[hit & (camera >= 0) & (camera != c)] -= SUPPORT_EVIDENCE
        camera[first] = c
        known[first | own] = at_source[here][best][first | own] if of.shape[1] else False
        box[first | own] = there[first | own]
        # Cameras in plain view that report nothing
        missed = ~hit & (camera >= 0) & (camera != c)
        missed &= np.nan_to_num(result.visible[frame]) > MIN_VISIBILITY_TO_LEARN
        shown = np.where(unconfirmed, 1.0 - hidden[:, c], 1.0)
        evidence = -np.log1p(-np.minimum(result.detection[frame] / shown, 0.999))
        weight = min(float(interval[c]) / MISS_INTERVAL_S, 1.0)
        denying += missed
        log_odds += np.where(missed, weight * np.minimum(evidence, MAX_MISS_EVIDENCE), 0.0)
    # One camera may be hidden by something unknown, two are not
    walked &= (people.steps > MIN_STEPS_WALKED) & ~known & (denying < 2)
    log_odds[walked & (log_odds < 0.0)] = MIN_LOG_ODDS
    return replace(
        people,
        static_camera=camera,
        static_box=box,
        static_known=known,
        static_log_odds=np.clip(log_odds, MIN_LOG_ODDS, MAX_LOG_ODDS),
    )


def is_a_person(log_odds: Floats) -> Floats:
    """Return (N,) probabilities that tracks are people and not static clutter, from log odds (N,) of static clutter."""
    return np.asarray(1.0 / (1.0 + np.exp(log_odds)))
