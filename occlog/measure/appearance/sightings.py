"""Sightings: appearances of boxes with their tracks and viewing angles.

Association of boxes with tracks, and whether a nearer person covers a box. Viewing angles from headings and camera
positions, in bins ([Lee] Sec. 5.2.1).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Bytes, Floats, Ints, Ints32
from occlog.core.image import bins_of, colour_counts, density
from occlog.core.numerics.assignment import assign
from occlog.core.numerics.interpolate import hold_positions, interpolate_positions
from occlog.errors import InputError, abridged, option
from occlog.io.files.timing.utc import time_words
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene
from occlog.records.tables import APPEARANCE_BINS, Boxes, Tracks, Truth, Views

from .config import SightingConfig

WIDTH = 0.3
"""Width of an upright person, as a share of the height."""
AROUND = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1)


def expected_boxes(camera: Camera, xy: Floats, height: float) -> Floats:
    """(K, 4) left, top, right, bottom [px] of upright people at positions `xy` (K, 2); NaN unless entirely in front.

    A person is a cylinder on the floor, of a height in scene units, `WIDTH` times as wide as high.
    """
    ring = xy[:, None] + 0.5 * WIDTH * height * AROUND
    rows = [np.concatenate([ring, np.full((*ring.shape[:2], 1), z)], axis=2) for z in (0.0, height)]
    points = np.concatenate(rows, axis=1)
    pixels: Floats = camera.project(points.reshape(-1, 3)).reshape(len(xy), -1, 2)
    return np.asarray(np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1))


def overlaps(a: Floats, b: Floats) -> Floats:
    """(n, K) intersection areas of boxes a (n, 4) and b (K, 4): left, top, right, bottom; 0 for NaN."""
    corner = np.minimum(a[:, None, 2:], b[None, :, 2:]) - np.maximum(a[:, None, :2], b[None, :, :2])
    return np.asarray(np.nan_to_num(np.prod(np.maximum(corner, 0.0), axis=2)))


def areas(boxes: Floats) -> Floats:
    """(n,) areas of boxes (n, 4): left, top, right, bottom."""
    return np.asarray((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]))


def tracks_of_boxes(boxes: Floats, expected: Floats, least_overlap: float) -> Ints:
    """(n,) index of the track assigned to each box, -1 for none: one to one, most pairs, then the greatest total IoU.

    Args:
        boxes: (n, 4) left, top, right, bottom [px] of detections in one frame.
        expected: (K, 4) left, top, right, bottom [px] predicted for K tracks; NaN: not in the image.
        least_overlap: minimum intersection over union (IoU) of a pair.
    """
    out = np.full(len(boxes), -1, dtype=np.int64)
    shared = overlaps(boxes, expected)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = shared / (areas(boxes)[:, None] + areas(expected)[None, :] - shared)
    row, column = assign(1.0 - np.nan_to_num(share), 1.0 - least_overlap)
    out[row] = column
    return out


def covered(boxes: Floats) -> Floats:
    """(n,) largest share of each of the boxes (n, 4) that one box of a nearer person covers, 0 to 1.

    A nearer person has lower feet in the image; boxes are left, top, right, bottom [px].
    """
    nearer = boxes[None, :, 3] > boxes[:, None, 3]
    share = np.where(nearer, overlaps(boxes, boxes), 0.0) / areas(boxes)[:, None]
    return np.asarray(share.max(axis=1, initial=0.0))


class PersonPath(NamedTuple):
    """Positions (M, 2) and headings (M, 2) of one person at M increasing times [ns], in the world.

    Headings are unit vectors, NaN where unknown.
    """

    t_ns: Ints  # (M,) ascending
    xy: Floats  # (M, 2)
    heading: Floats  # (M, 2) unit vectors; NaN where it is not known


class PeopleAtTimes(NamedTuple):
    """K people at N times: sorted identities (K,), positions and headings (N, K, 2), mask (N, K) of those that exist.

    Headings are unit vectors; NaN where unknown or absent.
    """

    identity: Ints32  # (K,) ascending
    xy: Floats  # (N, K, 2) NaN: not there
    heading: Floats  # (N, K, 2) unit vectors, NaN: not known
    there: Bools  # (N, K)


def path_of(t_ns: Ints, xy: Floats, velocity: Floats, heading_ns: int, least_speed: float) -> PersonPath:
    """Create the path of one person from its rows.

    Args:
        t_ns: (M,) nondecreasing times [ns]; of equal times the last counts.
        xy: (M, 2) positions.
        velocity: (M, 2) velocities [length/s]; NaN: from the positions `heading_ns` / 2 before and after.
        heading_ns: time over which positions are differenced [ns], > 0.
        least_speed: below this speed the heading is unknown (NaN) [length/s].
    """
    last = np.append(np.diff(t_ns) > 0, True)
    t_ns, xy, velocity = t_ns[last], xy[last], velocity[last]
    unknown = np.isnan(velocity[:, 0] + velocity[:, 1])
    if unknown.any():
        # Central differences; at the ends of the path over what there is of it
        before = np.maximum(t_ns - heading_ns // 2, t_ns[0])
        after = np.minimum(t_ns + heading_ns // 2, t_ns[-1])
        moved = hold_positions(after, t_ns, xy) - hold_positions(before, t_ns, xy)
        with np.errstate(invalid="ignore", divide="ignore"):
            seconds: Floats = (after - before) / NS
            rate = moved / seconds[:, None]
        velocity = np.where(unknown[:, None], rate, velocity)
    with np.errstate(invalid="ignore", divide="ignore"):
        speed: Floats = np.hypot(velocity[:, 0], velocity[:, 1])
        heading = velocity / speed[:, None]
    heading[(speed < least_speed) | (speed == 0)] = np.nan
    return PersonPath(t_ns, xy, heading)


def at_times(paths: dict[int, PersonPath], t_ns: Ints, limit_ns: int) -> PeopleAtTimes:
    """All people at the times `t_ns` (N,) [ns], linearly interpolated over gaps of at most `limit_ns` [ns].

    `paths` has the path of each person by identity.
    """
    identity = np.array(sorted(paths), dtype=np.int32)
    n, k = len(t_ns), len(identity)
    xy, heading = np.full((n, k, 2), np.nan), np.full((n, k, 2), np.nan)
    there = np.zeros((n, k), dtype=np.bool_)
    for index, name in enumerate(identity.tolist()):
        path = paths[name]
        values, there[:, index] = interpolate_positions(
            t_ns, path.t_ns, np.column_stack([path.xy, path.heading]), limit_ns
        )
        xy[:, index] = values[:, :2]
        with np.errstate(invalid="ignore", divide="ignore"):
            heading[:, index] = values[:, 2:] / np.hypot(values[:, 2], values[:, 3])[:, None]
    return PeopleAtTimes(identity, xy, heading, there)


def viewing_angles(xy: Floats, heading: Floats, camera: Floats) -> Floats:
    """Angles between headings and the directions to a camera, 0 (the front is visible) to pi (the back) [rad].

    Left and right are not distinguished, since people are taken as symmetric.

    Args:
        xy: (..., 2) positions on the floor.
        heading: (..., 2) unit vectors; NaN: unknown.
        camera: (2,) position of the camera on the floor.

    Returns:
        (...,) NaN where the heading is unknown, or the person is under the camera.
    """
    to = camera - xy
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.sum(to * heading, axis=-1) / np.hypot(to[..., 0], to[..., 1])
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def angle_bins(angle: Floats, angles: int) -> Ints32:
    """Indices of viewing angles, 1 (front) to N (back): n is nearest to (n - 1) pi / (N - 1) ([Lee] 5.6).

    Args:
        angle: viewing angles [rad], 0 to pi; NaN: unknown.
        angles: number N of indices; with 1 all are 1, also for unknown angles.

    Returns:
        Array of the shape of `angle`; 0 where the angle is unknown and N is above 1.
    """
    if angles == 1:
        return np.ones(np.shape(angle), dtype=np.int32)
    known = np.isfinite(angle)
    nearest = np.floor(np.where(known, angle, 0.0) * ((angles - 1) / np.pi) + 0.5)
    return np.where(known, np.minimum(nearest, angles - 1) + 1, 0).astype(np.int32)


NO_ID = -1
VIEWS_LEVELS = 8
"""Levels of the histograms that `views` hold."""


class FrameBoxes(NamedTuple):
    """The n boxes of one frame.

    Attributes:
        t_ns: time [ns].
        sensor, frame: name of the camera, and number of the frame.
        box: (n,) numbers of the boxes.
        identity: (n,) identity that the source states; -1 (`NO_ID`): none.
        edges: (n, 4) left, top, right, bottom [px].
        density: (n, m) normalised colour histograms; (n, 0) if they are to be taken from the image.
        pixels: (n,) numbers of pixels in the histograms.
    """

    t_ns: int
    sensor: str
    frame: int
    box: Ints32
    identity: Ints32
    edges: Floats
    density: Floats
    pixels: Ints


class Sighting(NamedTuple):
    """Appearances and viewing angles of the n boxes of one frame.

    Fields: the boxes; identity of each box's track, -1 for none; viewing angle [rad], NaN if unknown; share covered
    by a nearer box, 0 to 1; normalised colour histograms (n, m), NaN without pixels; numbers of pixels.
    """

    boxes: FrameBoxes
    track: Ints32  # (n,) NO_ID: of no track
    angle: Floats  # (n,) viewing angle [rad]; NaN: not known
    covered: Floats  # (n,) share that a nearer box covers
    density: Floats  # (n, m); NaN: no pixels
    pixels: Ints  # (n,)


@dataclass
class SightingTally:
    """Counts over a stream of frames with boxes.

    Attributes:
        frames: frames with boxes.
        boxes: boxes in them.
        of_tracks: boxes assigned to a track.
        missing: by camera, boxes of frames that are not among the images.
        undecoded: by camera, frames that cannot be decoded.
        last_ns: time of the last frame [ns]; -1: none.
    """

    frames: int = 0
    boxes: int = 0
    of_tracks: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    undecoded: Counter[str] = field(default_factory=Counter)
    last_ns: int = -1

    def losses(self) -> tuple[Loss, ...]:
        """Losses by camera: boxes of frames that are not among the images, and frames that cannot be decoded."""
        gone = [Loss(name, "boxes", "there is no frame of that number", n) for name, n in sorted(self.missing.items())]
        bad = [Loss(name, "frames", "cannot be decoded", n) for name, n in sorted(self.undecoded.items())]
        return (*gone, *bad)


def boxes_of_frames(chunks: Iterable[Boxes] | Iterable[Views]) -> Iterator[FrameBoxes]:
    """Generate boxes frame by frame, sorted by time and camera name; frames without boxes are skipped.

    Views that the fusion of detections recovered or removed are skipped, too. InputError if times go back.
    """
    for table in _whole_times(chunks):
        if isinstance(table, Views):
            rows = table.take(~np.isin(table.cause, ("recovered", "removed")))
            number, colours, pixels = rows.cluster, rows.appearance.astype(np.float64), np.rint(rows.area_px)
        else:
            rows = table.take(table.box >= 0)  # type: ignore[assignment]
            number, colours, pixels = rows.box, np.zeros((len(rows), 0)), np.zeros(len(rows))  # type: ignore[attr-defined]
        order = np.lexsort((number, rows.sensor, rows.t_ns))
        rows, number, colours, pixels = rows.take(order), number[order], colours[order], pixels[order]
        edges = np.column_stack([rows.left_px, rows.top_px, rows.left_px + rows.width_px, rows.top_px + rows.height_px])
        fresh = (np.diff(rows.t_ns) != 0) | (rows.sensor[1:] != rows.sensor[:-1])
        starts = np.flatnonzero(np.append(True, fresh)) if len(rows) else np.zeros(0, dtype=np.int64)
        for first, stop in pairwise([*starts.tolist(), len(rows)]):
            own = slice(first, stop)
            yield FrameBoxes(
                t_ns=int(rows.t_ns[first]),
                sensor=str(rows.sensor[first]),
                frame=int(rows.frame[first]),
                box=number[own],
                identity=rows.target_id[own],
                edges=edges[own],
                density=colours[own],
                pixels=pixels[own].astype(np.int64),
            )


def _whole_times(chunks: Iterable[Boxes] | Iterable[Views]) -> Iterator[Boxes | Views]:
    """Rechunk boxes so that all rows of a time are in one chunk; InputError if times go back."""
    held: Boxes | Views | None = None
    for chunk in chunks:
        if not len(chunk):
            continue
        if held is not None and chunk.t_ns[0] < held.t_ns[-1]:
            raise InputError(
                f"boxes: time {time_words(chunk.t_ns[0])} is earlier than the preceding {time_words(held.t_ns[-1])}; "
                "sort the rows by t_ns",
                id="unsorted-times",
            )
        whole = chunk if held is None else type(chunk).concat([held, chunk])  # type: ignore[list-item]
        cut = int(np.searchsorted(whole.t_ns, whole.t_ns[-1]))
        if cut:
            yield whole.take(slice(0, cut))
        held = whole.take(slice(cut, None))
    if held is not None:
        yield held


def paths_of_rows(table: Tracks | Truth, config: SightingConfig) -> dict[int, PersonPath]:
    """Paths of all people in a table, by identity; headings of true positions come from their differences."""
    unknown = np.full((len(table), 2), np.nan)
    velocity = unknown if isinstance(table, Truth) else np.column_stack([table.vx, table.vy])
    return _paths(table.target_id, table.t_ns, np.column_stack([table.x, table.y]), velocity, config)


def paths_of_boxes(
    chunks: Iterable[Boxes] | Iterable[Views], scene: Scene, config: SightingConfig
) -> dict[int, PersonPath]:
    """Path of each identity of boxes by identity: floor positions below the middle of their lower edges.

    Positions are averaged over the cameras at one time; boxes with a lower edge above the horizon, and cameras of
    unknown height, are skipped.
    """
    placed = {c.name: c for c in scene.cameras if c.has_height}
    identity, t_ns, xy = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    for boxes in boxes_of_frames(chunks):
        own = np.flatnonzero(boxes.identity >= 0)
        if boxes.sensor in placed and len(own):
            camera, edges = placed[boxes.sensor], boxes.edges[own]
            rays = camera.rays(np.column_stack([0.5 * (edges[:, 0] + edges[:, 2]), edges[:, 3]]))
            down = rays[:, 2] < 0
            reach = -camera.position[2] / rays[down, 2]
            xy.append(camera.ground + rays[down, :2] * reach[:, None])
            identity.append(boxes.identity[own][down])
            t_ns.append(np.full(int(down.sum()), boxes.t_ns))
    key = np.stack([np.concatenate(identity).astype(np.int64), np.concatenate(t_ns)])
    different, code, count = np.unique(key, axis=1, return_inverse=True, return_counts=True)
    position = np.zeros((different.shape[1], 2))
    np.add.at(position, code.reshape(-1), np.concatenate(xy))
    position /= count[:, None]
    return _paths(different[0].astype(np.int32), different[1], position, np.full(position.shape, np.nan), config)


def _paths(identity: Ints32, t_ns: Ints, xy: Floats, velocity: Floats, config: SightingConfig) -> dict[int, PersonPath]:
    heading_ns = round(config.heading_window_s * NS)
    out = {}
    for name in np.unique(identity).tolist():
        own = np.flatnonzero(identity == name)
        own = own[np.argsort(t_ns[own], kind="stable")]
        out[name] = path_of(t_ns[own], xy[own], velocity[own], heading_ns, config.min_speed)
    return out


def observe_boxes(
    boxes: Iterable[FrameBoxes],
    images: Iterable[Frame],
    paths: dict[int, PersonPath],
    scene: Scene,
    config: SightingConfig,
    *,
    levels: int,
    own_identity: bool,
    tally: SightingTally,
) -> Iterator[Sighting]:
    """Generate the sightings of boxes (appearance, track and viewing angle), frame by frame.

    Frames with an image that is missing or cannot be decoded are skipped and counted.

    Args:
        boxes: boxes of frames in the order of time.
        images: frames in the order of time; not read where boxes bring their colours.
        paths: paths of tracks, by identity.
        scene: scene with the cameras.
        config: settings of the association.
        levels: levels of hue, saturation and brightness of the histograms.
        own_identity: the boxes bring the identities of tracks; otherwise they are associated by position.
        tally: updated in place.

    Raises:
        InputError: a camera that the scene does not have, or colours in another number of levels.
    """
    cameras = {c.name: c for c in scene.cameras}
    stream = _Images(images, tally)
    for each in boxes:
        if each.sensor not in cameras:
            raise InputError(
                f"boxes: no camera {each.sensor!r} in the scene, which has {abridged(cameras)}; give its scene "
                f"({option('scene')})",
                id="unknown-sensor",
            )
        tally.frames += 1
        tally.boxes += len(each.box)
        colours, pixels = each.density, each.pixels
        if colours.shape[1] and colours.shape[1] != bins_of(levels):
            raise InputError(
                f"boxes: their colours are in {APPEARANCE_BINS} bins ({VIEWS_LEVELS} levels), but {bins_of(levels)} "
                f"({levels} levels) are requested; give {option('colour_levels')} {VIEWS_LEVELS}, or boxes with images",
                id="incompatible-inputs",
            )
        if not colours.shape[1]:
            image = stream.at(each)
            if image is None:
                continue
            counts = np.stack([colour_counts(*in_ellipse(image, edges), levels) for edges in each.edges])
            colours, pixels = density(counts), counts.sum(axis=1)
        track, angle = _seen_tracks(each, paths, cameras[each.sensor], config, own_identity)
        tally.of_tracks += int(np.count_nonzero(track != NO_ID))
        tally.last_ns = each.t_ns
        yield Sighting(each, track, angle, covered(each.edges), colours, np.where(np.isnan(colours[:, 0]), 0, pixels))


def in_ellipse(image: Image, edges: Floats) -> tuple[Bytes, Bytes]:
    """Part of an image inside a box, and the mask (0 or 1) of its pixels in the inscribed ellipse, of equal shape.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        edges: (4,) left, top, right, bottom [px]; a box that exceeds the image is clipped.
    """
    left, top, right, bottom = edges.tolist()
    height, width = image.shape[:2]
    x0, y0 = int(np.clip(np.ceil(left), 0, width)), int(np.clip(np.ceil(top), 0, height))
    x1, y1 = int(np.clip(np.floor(right) + 1, x0, width)), int(np.clip(np.floor(bottom) + 1, y0, height))
    x = (np.arange(x0, x1) - 0.5 * (left + right)) / (0.5 * (right - left))
    y = (np.arange(y0, y1) - 0.5 * (top + bottom)) / (0.5 * (bottom - top))
    return image[y0:y1, x0:x1], (x[None, :] ** 2 + y[:, None] ** 2 <= 1.0).astype(np.uint8)


def _seen_tracks(
    boxes: FrameBoxes, paths: dict[int, PersonPath], camera: Camera, config: SightingConfig, own_identity: bool
) -> tuple[Ints32, Floats]:
    """Identity (n,) of the track of each of n boxes, -1 for none, and viewing angles (n,) [rad], NaN if unknown.

    Args:
        boxes: boxes of one frame.
        paths: paths of people, by identity.
        camera: camera of the frame.
        config: height of people, largest gap of a path, and minimum IoU.
        own_identity: the boxes bring the identities of the paths; otherwise they are matched with predicted boxes.
    """
    n = len(boxes.box)
    if not paths or not camera.has_height:
        identity = boxes.identity if own_identity else np.full(n, NO_ID, dtype=np.int32)
        return identity, np.full(n, np.nan)
    states = at_times(paths, np.array([boxes.t_ns]), round(config.max_gap_s * NS))
    if own_identity:
        index = np.minimum(np.searchsorted(states.identity, boxes.identity), len(states.identity) - 1)
        index = np.where(states.identity[index] == boxes.identity, index, -1)
        track = boxes.identity
    else:
        index = tracks_of_boxes(
            boxes.edges, expected_boxes(camera, states.xy[0], config.person_height), config.iou_threshold
        )
        track = np.where(index >= 0, states.identity[index], np.int32(NO_ID))
    angle = viewing_angles(states.xy[0, index], states.heading[0, index], camera.ground)
    return track, np.where(index >= 0, angle, np.nan)


class _Images:
    """Reads a stream of images, sorted by time, and holds those of the current time."""

    def __init__(self, frames: Iterable[Frame], tally: SightingTally) -> None:
        """Start without reading images; `tally` counts, in place, missing ones and those that cannot be decoded."""
        self._frames, self._tally = iter(frames), tally
        self._held: dict[tuple[str, int], Frame] = {}
        self._next: Frame | None = None
        self._time = -1

    def at(self, boxes: FrameBoxes) -> Image | None:
        """Decoded image of the frame of `boxes`, of which times must not decrease; None if missing or damaged.

        Boxes without a frame, and frames that cannot be decoded, are counted in the tally.
        """
        if boxes.t_ns > self._time:
            self._held.clear()
            self._time = boxes.t_ns
        while True:
            frame = self._next if self._next is not None else next(self._frames, None)
            self._next = frame
            if frame is None or frame.t_ns > boxes.t_ns:
                break
            self._next = None
            self._held[frame.sensor, frame.index] = frame
        found = self._held.get((boxes.sensor, boxes.frame))
        if found is None:
            self._tally.missing[boxes.sensor] += len(boxes.box)
            return None
        try:
            return found.decode()
        except InputError:
            self._tally.undecoded[boxes.sensor] += 1
            return None
