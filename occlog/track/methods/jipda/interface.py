"""Interface of the multi-person filter: frames of cameras in, time steps with all people out.

The filter (`filter.initial_state`, `filter.step`) takes the frames of one time step at a time, in the order of their
times. Batch association (`--smooth`, `--lag`) takes all frames and the filter's time steps, and returns revised time
steps. Neither uses tables: a box is identified by its row number in the table. Lengths are in the scene's unit, times
in nanoseconds or seconds as stated, pixels are those of the recorded image (distorted; the origin is the centre of the
upper left pixel).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints

X, Y, VX, VY, HEIGHT, WIDTH = range(6)
"""Indices of a person's state: position and velocity of the axis of an upright cylinder on the floor, its height and
its diameter."""
STATE_SIZE = 6
"""Numbers of a person's state."""
NO_ID = -1
"""Value of `hint` and `Event.other` without an identity."""


class FrameDetections(NamedTuple):
    """Boxes that a detector reported in one frame of one camera, at time `t_ns`: n boxes, or none (n = 0).

    A frame without boxes counts as evidence that no person was detected. `boxes` (n, 4) are left, top, right, bottom
    [px]; edges may lie outside the image, where a detector completes people who are cut by its border. Further columns
    per box: detector confidence 0 to 1 (NaN: none), tracklet id of a single-camera tracker (`NO_ID`: none), appearance
    vector (n, K) (NaN: none), row in the table of boxes. A sensor of ground positions uses this class, too: `boxes` are
    (x, y, x, y) in the scene's unit, and `covariance` (n, 3) has the columns xx, xy, yy.
    """

    t_ns: int
    camera: int  # index in the list of cameras of the filter
    boxes: Floats  # (n, 4) left, top, right, bottom [px]; left < right, top < bottom
    score: Floats  # (n,) confidence of the detector, 0 to 1; NaN: none
    tracklet_id: Ints  # (n,) tracklet id >= 0 of a single-camera tracker; NO_ID: no id
    appearance: Floats  # (n, K) histogram or embedding; NaN: none of this box; (n, 0): none at all
    row: Ints  # (n,) row of the box in its table
    covariance: Floats | None = None  # (n, 3) xx, xy, yy of positions on the ground, NaN: not stated; None: boxes


class PositionSource(NamedTuple):
    """A named sensor of positions on the ground: a ground-plane detector, lidar, radar, ultra-wideband.

    The filter treats it as a camera that sees the ground from above: its detections are `FrameDetections` with `boxes`
    (x, y, x, y) in the scene's unit instead of pixels, and `covariance`.
    """

    name: str


class DirectionsOfArrival(NamedTuple):
    """Azimuths (n,) that a microphone array heard at time `t_ns`, with standard deviations (n,) [rad].

    Azimuths are in the world's ground plane [rad]. `sensor` is the index of the array in the filter's list of arrays,
    and `row` (n,) the row of each direction in its table.
    """

    t_ns: int
    sensor: int  # index in the list of arrays
    bearing: Floats  # (n,) azimuth in the world [rad]
    sigma: Floats  # (n,) standard deviation [rad], > 0
    row: Ints  # (n,) row in its table


class BoxAssociations(NamedTuple):
    """Associations of boxes with tracks after one time step: k pairs of a track and a box, with probabilities.

    Columns (k,): index of the person in `TrackSnapshot.ids`, camera index, row of the box in its table, the probability
    that the box is of this person (alone or merged with a neighbour), and the part of it in which the box is a merged
    detection of this person and a neighbour.
    """

    person: Ints  # (k,) index in `TrackSnapshot.ids`
    camera: Ints  # (k,) index in the list of cameras
    row: Ints  # (k,) `FrameDetections.row` of the box
    probability: Floats  # (k,) that the box is of this person, alone or with a neighbour who touches them
    joint: Floats  # (k,) of it, with a neighbour; the rest sums over people of a box to at most 1


class Event(NamedTuple):
    """One event of a track at a time step: `kind` is `initiated`, `terminated` or `possible_switch`.

    `id` is the track. For the first two kinds `other` is `NO_ID` and `probability` is the track's existence probability
    then; for a possible identity switch `other` is the second track and `probability` that the two were exchanged.
    """

    kind: str  # `initiated`, `terminated`, or `possible_switch`: it may have been exchanged with `other`
    id: int
    other: int  # NO_ID unless the kind is `possible_switch`
    probability: float  # of existence at a birth or death; that the two were exchanged at a doubt


class DetectorEstimates(NamedTuple):
    """Online estimates of errors that all cameras share, of static clutter, clock offsets and rotations; C cameras.

    Fields: standard deviation per axis [scene unit] and correlation time [s] of the common position error; number of
    static clutter sources per camera; clock offsets (C,) [s] that are corrected (positive: frames show the past, 0:
    none) and their significance limits; the normal equations of these offsets over the recording; corrected rotations
    (C, 2) [rad] and their limits. A limit is infinite where nothing was estimated.
    """

    common_sigma: float  # standard deviation of the error of position that all cameras share, per axis
    common_time_s: float  # its correlation time [s]
    static_clutter: Ints  # (C,) number of established sources of static clutter
    late: Floats  # (C,) offsets [s] of the clocks that are corrected, positive: frames show what was earlier; 0: none
    late_limit: Floats  # (C,) least significant offsets [s]; inf: not estimated
    clock_history: Floats  # (B, C, C + 1) normal equations of the offsets in batches of the whole recording
    clock_times_s: Floats  # (B,) their times [s]
    angles: Floats  # (C, 2) corrected rotations [rad] about the vertical and the horizontal axis of the camera
    angles_limit: Floats  # (C, 2) least significant angles [rad]; inf: not estimated


class TrackSnapshot(NamedTuple):
    """All confirmed tracks after the frames of one time step `t_ns`; m people, C cameras.

    `ids` (m,) ascend and are never reused; `mean` (m, 6) is x, y, vx, vy, height, width in the world frame and the
    scene's unit, `covariance` (m, 6, 6); `existence` (m,) and `visibility` (m, C) are probabilities (visibility NaN: no
    frame of this camera, or the person is out of its view). `support` has the associated boxes, `events` the
    initiations and terminations at this time step, `detectors` the online estimates of detector errors (None: none).
    """

    t_ns: int
    ids: Ints  # (m,) identities of people who are confirmed, ascending; never used again after a death
    mean: Floats  # (m, 6) x, y, vx, vy, height, width
    covariance: Floats  # (m, 6, 6)
    existence: Floats  # (m,) probability that the person is there
    visibility: (
        Floats  # (m, C) probability of being visible in each camera; NaN: no frame, or the position is out of view
    )
    support: BoxAssociations
    events: tuple[Event, ...]
    detectors: DetectorEstimates | None = None  # None: the method estimates nothing of them


def no_associations() -> BoxAssociations:
    """Return `BoxAssociations` with no row (k = 0)."""
    none = np.zeros(0, dtype=np.int64)
    return BoxAssociations(none, none, none, np.zeros(0), np.zeros(0))
