"""Rows of the output tables from time steps: tracks, associations, events, and all tracks in every image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.records.declared.people import BOX, COASTING, GROUND, POSSIBLE_SWITCH, SINGLE_VIEW, words_of
from occlog.records.scene import Camera, CommonNoise
from occlog.records.tables import Associations, Events, PeopleTracks, PeopleViews
from occlog.track.methods.jipda.interface import HEIGHT, VX, VY, WIDTH, TrackSnapshot, X, Y
from occlog.track.methods.jipda.kernels.body_box import pack_views, project

from .frame_detections import FrameDetectionsWithIds

MIN_MAP_PROBABILITY = 0.5
"""A box is a person's if it is more probably of this person than not."""
QUALITY_FLAGS = (COASTING, SINGLE_VIEW, POSSIBLE_SWITCH)
"""Values of the column `quality_flags`, in the order of the column."""
COVARIANCES = {
    "cov_xx": (X, X),
    "cov_xy": (X, Y),
    "cov_yy": (Y, Y),
    "cov_x_vx": (X, VX),
    "cov_x_vy": (X, VY),
    "cov_y_vx": (Y, VX),
    "cov_y_vy": (Y, VY),
    "cov_vx_vx": (VX, VX),
    "cov_vx_vy": (VX, VY),
    "cov_vy_vy": (VY, VY),
}
"""Columns of the covariance by the indices of the state."""


class SnapshotWithDetections(NamedTuple):
    """Tracks after a time step (`snapshot`), with the detections of its frames."""

    snapshot: TrackSnapshot
    frames: Sequence[FrameDetectionsWithIds]


class SnapshotTables(NamedTuple):
    """Output tables of several time steps: tracks, associations (`support`), events, and tracks in the images.

    `views` is None if rows in the images are not requested.
    """

    tracks: PeopleTracks
    support: Associations
    events: Events
    views: PeopleViews | None


def association_probability_by_camera(snapshot: TrackSnapshot, cameras: int) -> Floats:
    """Return the probability (m, C) that camera C has a box of person m at a time step; C = `cameras`.

    It is the sum of the person's association probabilities in the camera, at most 1.
    """
    seen = np.zeros((len(snapshot.ids), cameras))
    np.add.at(seen, (snapshot.support.person, snapshot.support.camera), snapshot.support.probability)
    return np.minimum(seen, 1.0)


def tracks_of(
    seen: Sequence[SnapshotWithDetections],
    names: Sequence[str],
    cameras: int | None = None,
    common_noise: CommonNoise | None = None,
) -> PeopleTracks:
    """Return table `tracks`: a row for each person and time step.

    Args:
        seen: time steps with their detections.
        names: names of the cameras in use, then of position sensors, by index.
        cameras: number of cameras among them; None: all are cameras.
        common_noise: errors that all cameras have in common, which widen the covariances.
    """
    snapshots = [each.snapshot for each in seen if len(each.snapshot.ids)]
    if not snapshots:
        return PeopleTracks.empty()
    by = np.concatenate([association_probability_by_camera(m, len(names)) >= MIN_MAP_PROBABILITY for m in snapshots])
    mean = np.concatenate([m.mean for m in snapshots])
    covariance = np.concatenate([m.covariance for m in snapshots])
    if common_noise is not None:
        covariance = covariance + common_noise.covariances(mean)
    exchanged = [np.isin(m.ids, [e.id for e in m.events if e.kind == "possible_switch"]) for m in snapshots]
    # With one camera there is no other that could see them
    alone = (by.sum(axis=1) == 1) & (len(names) > 1) & by[:, :cameras].any(axis=1)
    return PeopleTracks.of(
        t_ns=np.repeat([m.t_ns for m in snapshots], [len(m.ids) for m in snapshots]),
        target_id=np.concatenate([m.ids for m in snapshots]).astype(np.int32),
        x=mean[:, X],
        y=mean[:, Y],
        vx=mean[:, VX],
        vy=mean[:, VY],
        **{name: covariance[:, i, j] for name, (i, j) in COVARIANCES.items()},
        existence_probability=np.concatenate([m.existence for m in snapshots]),
        height=mean[:, HEIGHT],
        width=mean[:, WIDTH],
        sd_height=np.sqrt(covariance[:, HEIGHT, HEIGHT]),
        sd_width=np.sqrt(covariance[:, WIDTH, WIDTH]),
        seen_by=words_of(by, names),
        quality_flags=words_of(np.column_stack([~by.any(axis=1), alone, np.concatenate(exchanged)]), QUALITY_FLAGS),
    )


def associations_of(seen: Sequence[SnapshotWithDetections], names: Sequence[str]) -> Associations:
    """Return table `associations`, sorted: a row for each box associated with a track.

    `names` are those of the cameras and position sensors, by index.
    """
    parts = [each for each in seen if len(each.snapshot.support.row)]
    if not parts:
        return Associations.empty()
    numbers = [_numbers(each) for each in parts]
    supports = [each.snapshot.support for each in parts]
    probability = np.concatenate([s.probability for s in supports])
    table = Associations.of(
        t_ns=np.repeat([each.snapshot.t_ns for each in parts], [len(s.row) for s in supports]),
        target_id=np.concatenate([each.snapshot.ids[each.snapshot.support.person] for each in parts]).astype(np.int32),
        sensor=np.array(names, dtype=np.str_)[np.concatenate([s.camera for s in supports])],
        frame=np.concatenate([frame for frame, _ in numbers]),
        box=np.concatenate([box for _, box in numbers]).astype(np.int32),
        probability=np.clip(probability, np.finfo(np.float64).tiny, 1.0),
    )
    return table.sorted()


def _numbers(each: SnapshotWithDetections) -> tuple[Ints, Ints]:
    """Return the frame number (k,) and the box number (k,) of each of the k associations of a time step."""
    row = np.concatenate([e.detections.row for e in each.frames])
    frame = np.repeat([e.frame for e in each.frames], [len(e.box) for e in each.frames])
    order = np.argsort(row)
    at = order[np.searchsorted(row, each.snapshot.support.row, sorter=order)]
    return frame[at], np.concatenate([e.box for e in each.frames])[at]


def events_of(seen: Sequence[SnapshotWithDetections]) -> Events:
    """Return table `events`: a row for each event of the time steps."""
    return Events.of_rows((each.snapshot.t_ns, *event) for each in seen for event in each.snapshot.events)


class ViewRows(NamedTuple):
    """n rows of people in frames, as columns.

    Time, camera index, frame number, identity, `box` (n, 4) left, top, right, bottom [px], `spread` (n, 3) xx, xy, yy
    of the covariance of its centre [px^2], `own`: whether a detected box of the camera is used, and visible share.
    """

    t_ns: Ints  # (n,)
    camera: Ints  # (n,)
    frame: Ints  # (n,)
    id: Ints  # (n,)
    box: Floats  # (n, 4)
    spread: Floats  # (n, 3) xx, xy, yy of the covariance of the box's centre
    own: Bools  # (n,) the camera has a box of the person, of which this is made
    visibility: Floats  # (n,)


def image_rows(
    t_ns: Ints,
    sensor: Strings,
    frame: Ints,
    id: Ints,
    box: Floats,
    covariance: Floats,
    mode: Strings,
    visibility: Floats,
    lifecycle: Strings | None = None,
) -> PeopleViews:
    """Return table `view_tracks` of n people in images, as ellipses inscribed in their boxes.

    Args:
        t_ns: (n,) times.
        sensor: (n,) names of the cameras.
        frame: (n,) numbers of the frames.
        id: (n,) identities.
        box: (n, 4) left, top, right, bottom [px].
        covariance: (n, 3) xx, xy, yy of the centre of the box [px^2].
        mode: (n,) column `likelihood_mode`: where the box is from.
        visibility: (n,) visible share.
        lifecycle: (n,) column `lifecycle`; None: empty.
    """
    n = len(id)
    nothing, unknown = np.full(n, ""), np.full(n, np.nan)
    left, top, right, bottom = box.T
    return PeopleViews.of(
        t_ns=t_ns,
        sensor=sensor,
        frame=frame,
        target_id=id.astype(np.int32),
        x_px=0.5 * (left + right),
        y_px=0.5 * (top + bottom),
        a_px=0.5 * (right - left),
        b_px=0.5 * (bottom - top),
        rho=np.zeros(n),
        cov_xx_px=covariance[:, 0],
        cov_xy_px=covariance[:, 1],
        cov_yy_px=covariance[:, 2],
        similarity=unknown,
        ess=unknown,
        likelihood_mode=mode,
        counterpart=nothing,
        neighbours=nothing,
        assisting_views=nothing,
        lifecycle=nothing if lifecycle is None else lifecycle,
        visibility=visibility,
    )


class TracksInViews:
    """Projects tracks into the images: weighted means of the detected box and the projection from the ground."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        """Prepare the projection; `cameras` have poses, and are in the order of the frames' camera indices."""
        self._names = np.array([c.name for c in cameras], dtype=np.str_)
        self._views = pack_views(cameras)

    def table(self, seen: Sequence[SnapshotWithDetections]) -> PeopleViews:
        """Return table `view_tracks`, sorted: a row for each person and camera frame with the person in its view."""
        parts = [
            self._in_frame(each.snapshot, frame)
            for each in seen
            if len(each.snapshot.ids)
            for frame in each.frames
            if frame.detections.covariance is None
        ]
        if not parts:
            return PeopleViews.empty()
        rows = ViewRows._make(np.concatenate(columns) for columns in zip(*parts, strict=True))
        table = image_rows(
            rows.t_ns, self._names[rows.camera], rows.frame, rows.id, rows.box, rows.spread,
            np.where(rows.own, BOX, GROUND), rows.visibility,
        )  # fmt: skip
        return table.sorted()

    def _in_frame(self, snapshot: TrackSnapshot, each: FrameDetectionsWithIds) -> ViewRows:
        """Return rows of all tracks of `snapshot` that are in the view of the camera frame `each`.

        They are projected from the ground plane at the frame's time; a detected box counts with the visible share as
        weight.
        """
        frame, c = each.detections, each.detections.camera
        there = np.flatnonzero(np.isfinite(snapshot.visibility[:, c]))
        # Project the people on the floor to the time of the frame
        found = np.zeros((len(there), 8))
        delay = (frame.t_ns - snapshot.t_ns) / NS
        project(self._views, c, snapshot.mean[there], snapshot.covariance[there], delay, found)
        # Take the camera's own boxes where it has some, as far as people are visible: a cover cuts the boxes of others
        box, visible = _map_boxes(snapshot, frame.row, c)[there], snapshot.visibility[there, c]
        own = box >= 0
        found[own, :4] += visible[own, None] * (frame.boxes[box[own]] - found[own, :4])
        good = np.flatnonzero(found[:, 7] > 0.0)
        n, there, found = len(good), there[good], found[good]
        return ViewRows(
            t_ns=np.full(n, frame.t_ns, dtype=np.int64),
            camera=np.full(n, c, dtype=np.int64),
            frame=np.full(n, each.frame, dtype=np.int64),
            id=snapshot.ids[there],
            box=found[:, :4],
            spread=found[:, 4:7],
            own=own[good],
            visibility=visible[good],
        )


def _map_boxes(snapshot: TrackSnapshot, row: Ints, camera: int) -> Ints:
    """Return the index (m,), in a frame, of the box associated with each of m people alone; -1: none.

    Its probability is at least `MIN_MAP_PROBABILITY`. `row` are the table rows of the frame's boxes, `camera` is the
    index of its camera.
    """
    out = np.full(len(snapshot.ids), -1, dtype=np.int64)
    s = snapshot.support
    mine = np.flatnonzero((s.camera == camera) & (s.probability - s.joint >= MIN_MAP_PROBABILITY))
    if len(mine):
        order = np.argsort(row)
        out[s.person[mine]] = order[np.searchsorted(row, s.row[mine], sorter=order)]
    return out
