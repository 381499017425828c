"""Tracking in the images of cameras without calibration: frames of boxes in, tables out.

Each camera is tracked separately, so an identity is valid in one camera only.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints, Strings
from occlog.records.declared.people import BOX, PREDICTED
from occlog.records.scene import Camera
from occlog.records.tables import Events, PeopleViews
from occlog.track.methods.jipda.interface import NO_ID
from occlog.track.methods.sort.config import SortConfig
from occlog.track.methods.sort.filter import FrameTracks, SortFilter
from occlog.track.methods.sort.kernels.boxes import visible_shares
from occlog.track.methods.sort.linking import Doubt, SmoothedTrack, TrackBoxes, linked, smoothed_track

from .frame_detections import FrameDetectionsWithIds
from .rows import image_rows

ROWS_PER_PART = 8192
"""Rows of a part, about."""
EventRow = tuple[int, str, int, int, float]


class ImageTracksPart(NamedTuple):
    """Tracks in the images and events of one part (interval of time) of the output, as tables."""

    tracks: PeopleViews
    events: Events


class Rows(NamedTuple):
    """n rows of tracks in the images, as columns.

    Time, camera name, frame number, identity (unique over all cameras), `boxes` (n, 4) left, top, right, bottom [px],
    `variance` (n, 2) of the centre [px^2], whether the box was detected in this frame, visible share, and whether the
    row is the first of its track.
    """

    t_ns: Ints
    sensor: Strings
    frame: Ints
    id: Ints
    boxes: Floats  # (n, 4) left, top, right, bottom
    variance: Floats  # (n, 2) of the centre
    detected: Bools
    visibility: Floats
    first: Bools  # the first row of its track


def track_in_images(
    frames: Iterable[FrameDetectionsWithIds], cameras: Sequence[Camera], config: SortConfig
) -> Iterator[ImageTracksPart]:
    """Track the boxes of each camera in its image, and generate tables in parts, in the order of time.

    Without smoothing memory does not grow with the recording; with smoothing all boxes are kept, and there is one part.

    Args:
        frames: frames in the order of time; their camera is an index in `cameras`.
        cameras: cameras; the image size is used where it is known.
        config: settings of the method.
    """
    trackers = [CameraTracks(camera, config) for camera in cameras]
    numbers = Identities()
    if config.smooth:
        for each in frames:
            trackers[each.detections.camera].keep(each)
        yield _smoothed(trackers, numbers)
        return
    rows: list[Rows] = []
    events: list[EventRow] = []
    last_ns = 0
    for each in frames:
        camera = each.detections.camera
        last_ns = each.detections.t_ns
        found = trackers[camera].step(each)
        rows.append(_rows_of(found, cameras[camera].name, camera, numbers))
        events += ((found.t_ns, *numbers.event(camera, event)) for event in found.events)
        if sum(len(part.id) for part in rows) >= ROWS_PER_PART:
            yield ImageTracksPart(_table(rows), Events.of_rows(events))
            rows, events = [], []
    for camera, tracker in enumerate(trackers):
        events += ((last_ns, *numbers.event(camera, event)) for event in tracker.filter.finish())
    yield ImageTracksPart(_table(rows), Events.of_rows(events))


class Identities:
    """Maps the identities of each camera's tracker to numbers that are unique over all cameras.

    Numbers are given from 0 in the order of first use.
    """

    def __init__(self) -> None:
        """Start without identities."""
        self._numbers: dict[tuple[int, int], int] = {}
        self._shown: set[int] = set()

    def of(self, camera: int, own: Iterable[int]) -> Ints:
        """Return the unique identities (n,) of a camera's own identities; unknown ones get the next numbers."""
        found = [self._numbers.setdefault((camera, k), len(self._numbers)) for k in own]
        return np.array(found, dtype=np.int64)

    def first(self, ids: Ints) -> Bools:
        """Return a mask (n,) of the identities that have not been output before, and mark them as output."""
        out = np.array([k not in self._shown for k in ids.tolist()], dtype=np.bool_)
        self._shown.update(ids.tolist())
        return out

    def event(self, camera: int, event: tuple[str, int, int, float]) -> tuple[str, int, int, float]:
        """Return an event (kind, identity, other identity, probability) with unique identities for the camera's own."""
        kind, own, other, probability = event
        me, another = int(self.of(camera, [own])[0]), NO_ID if other == NO_ID else int(self.of(camera, [other])[0])
        return kind, me, another, probability


class CameraTracks:
    """The image tracker of one camera, and the boxes of its tracks if these are to be smoothed."""

    def __init__(self, camera: Camera, config: SortConfig) -> None:
        """Create the tracker of a camera, without frames."""
        self.name, self.config = camera.name, config
        self.filter = SortFilter(config, camera.image_size)
        self.t_ns: list[int] = []
        self.frames: list[int] = []
        self._boxes: defaultdict[int, list[tuple[int, Floats, Floats]]] = defaultdict(list)

    def step(self, each: FrameDetectionsWithIds) -> FrameTracks:
        """Track the detections of one more frame, and return the frame's tracks."""
        return self.filter.step(each.detections, each.frame)

    def keep(self, each: FrameDetectionsWithIds) -> None:
        """Track the detections of one more frame, and keep the boxes of its tracks for smoothing."""
        index = len(self.t_ns)
        self.t_ns.append(each.detections.t_ns)
        self.frames.append(each.frame)
        found = self.step(each)
        for key, box in zip(found.keys.tolist(), found.of_keys.tolist(), strict=True):
            self._boxes[key].append((index, each.detections.boxes[box], each.detections.appearance[box]))

    def smoothed(self) -> tuple[list[tuple[TrackBoxes, SmoothedTrack]], list[Doubt]]:
        """Return the camera's linked and smoothed tracks, and the ambiguous links between their fragments.

        Each track is given with its boxes; only confirmed tracks are used.
        """
        tracks, row = [], 0
        for key, kept in self._boxes.items():
            if key in self.filter.confirmed:
                tracks.append(_boxes(kept, row))
                row += len(kept)
        times = (np.array(self.t_ns, dtype=np.int64) - (self.t_ns[0] if self.t_ns else 0)) / NS
        width, height = self.filter.size
        found, doubts = linked(tracks, times, self.config, self.filter.learned.similarities, width * height)
        return [(each, smoothed_track(each, times, self.config)) for each in found], doubts


def _boxes(kept: Sequence[tuple[int, Floats, Floats]], row: int) -> TrackBoxes:
    """Return the boxes of one track as columns.

    `kept` are (frame index, box (4,), appearance) of each frame; appearances of another length than the longest become
    NaN. `row` is the number of the first box among all boxes of the camera.
    """
    frame, boxes, appearance = zip(*kept, strict=True)
    length = max(len(each) for each in appearance)
    nothing = np.full(length, np.nan)
    return TrackBoxes(
        frame=np.array(frame, dtype=np.int64),
        boxes=np.array(boxes),
        appearance=np.array([each if len(each) == length else nothing for each in appearance]),
        row=row + np.arange(len(frame)),
    )


def _smoothed(trackers: Sequence[CameraTracks], numbers: Identities) -> ImageTracksPart:
    """Return the smoothed tracks and the events of all cameras; `numbers` makes identities unique over them.

    Events are `initiated`, `terminated`, and `possible_switch` at ambiguous links.
    """
    rows: list[Rows] = []
    events: list[EventRow] = []
    for camera, tracker in enumerate(trackers):
        tracks, doubts = tracker.smoothed()
        times, frames = np.array(tracker.t_ns, dtype=np.int64), np.array(tracker.frames, dtype=np.int64)
        of_row: dict[int, int] = {}
        for own, (boxes, track) in enumerate(tracks):
            of_row.update(dict.fromkeys(boxes.row.tolist(), own))
            shown = np.flatnonzero(track.shown)
            at = track.frame[shown]
            n = len(at)
            rows.append(
                Rows(
                    times[at], np.full(n, tracker.name), frames[at], np.repeat(numbers.of(camera, [own]), n),
                    track.boxes[shown], track.variance[shown], track.detected[shown], np.ones(n), np.arange(n) == 0,
                )
            )  # fmt: skip
            who = int(numbers.of(camera, [own])[0])
            events += [(int(times[at[0]]), "initiated", who, NO_ID, np.nan)]
            events += [(int(times[at[-1]]), "terminated", who, NO_ID, np.nan)]
        for doubt in doubts:
            pair = (of_row.get(doubt.row, NO_ID), of_row.get(doubt.other, NO_ID))
            if doubt.other < 0 and pair[0] != NO_ID:
                who = int(numbers.of(camera, pair[:1])[0])
                events.append((int(times[doubt.frame]), "possible_switch", who, NO_ID, doubt.probability))
            elif NO_ID not in pair and pair[0] != pair[1]:
                a, b = numbers.of(camera, pair).tolist()
                at_ns, p = int(times[doubt.frame]), doubt.probability
                events += [(at_ns, "possible_switch", a, b, p), (at_ns, "possible_switch", b, a, p)]
    return ImageTracksPart(_with_visibility(_table(rows)), Events.of_rows(events))


def _with_visibility(tracks: PeopleViews) -> PeopleViews:
    """Return the tracks with column `visibility`: the share of each box that no nearer track of its frame covers."""
    half = np.column_stack([tracks.a_px, tracks.b_px])
    centre = np.column_stack([tracks.x_px, tracks.y_px])
    boxes = np.concatenate([centre - half, centre + half], axis=1)
    visibility = np.ones(len(tracks))
    _, camera = np.unique(tracks.sensor, return_inverse=True)
    order = np.lexsort((tracks.target_id, camera, tracks.t_ns))
    cuts = np.flatnonzero((np.diff(tracks.t_ns[order]) != 0) | (np.diff(camera[order]) != 0)) + 1
    for rows in np.split(order, cuts) if len(order) else []:
        visibility[rows] = visible_shares(boxes[rows], np.ones(len(rows)))
    columns = {c.name: getattr(tracks, c.name) for c in PeopleViews.columns()}
    return PeopleViews.of(**{**columns, "visibility": visibility})


def _rows_of(found: FrameTracks, sensor: str, camera: int, numbers: Identities) -> Rows:
    """Return rows of the tracks of one frame of a camera.

    Args:
        found: tracks of the frame, with the camera's own identities.
        sensor: name of the camera.
        camera: its index.
        numbers: makes identities unique over all cameras; updated.
    """
    ids = numbers.of(camera, found.id.tolist())
    n = len(ids)
    return Rows(
        np.full(n, found.t_ns, dtype=np.int64), np.full(n, sensor), np.full(n, found.frame, dtype=np.int64), ids,
        found.boxes, found.variance, found.detected, found.visibility, numbers.first(ids),
    )  # fmt: skip


def _table(parts: Sequence[Rows]) -> PeopleViews:
    """Return the rows as table `view_tracks`, sorted by time, camera and identity.

    Each ellipse is inscribed in its box; the first row of a track has the lifecycle `start`.
    """
    some = [part for part in parts if len(part.id)]
    if not some:
        return PeopleViews.empty()
    whole = Rows._make(np.concatenate(columns) for columns in zip(*some, strict=True))
    order = np.lexsort((whole.id, whole.sensor, whole.t_ns))
    rows = Rows._make(values[order] for values in whole)
    covariance = np.column_stack([rows.variance[:, 0], np.zeros(len(rows.id)), rows.variance[:, 1]])
    return image_rows(
        rows.t_ns, rows.sensor, rows.frame, rows.id, rows.boxes, covariance, np.where(rows.detected, BOX, PREDICTED),
        np.clip(rows.visibility, 0.0, 1.0), np.where(rows.first, "start", ""),
    )  # fmt: skip
