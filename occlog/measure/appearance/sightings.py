"""What boxes show: colours, of which track they are, and from which side the camera sees it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bytes, Floats, Ints, Ints32
from occlog.core.image.colour_density import bins_of, colour_counts, density
from occlog.errors import InputError
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Camera, Scene
from occlog.records.tables import APPEARANCE_BINS, Boxes, Tracks, Truth, Views

from .box_tracks import covered, expected_boxes, tracks_of_boxes
from .config import SightingConfig
from .viewing_angle import Path, at_times, path_of, viewing_angles

NOBODY = -1
VIEWS_LEVELS = 8
"""Levels of the histograms that `views` hold."""


class FrameBoxes(NamedTuple):
    """The boxes of one frame; n boxes."""

    t_ns: int
    sensor: str
    frame: int
    box: Ints32  # (n,)
    identity: Ints32  # (n,) as the source says; NOBODY: none
    edges: Floats  # (n, 4) left, top, right, bottom [px]
    density: Floats  # (n, m) colours, where the table has them; (n, 0): the image is wanted
    pixels: Ints  # (n,) that made them


class Sighting(NamedTuple):
    """What the boxes of one frame show; n boxes."""

    boxes: FrameBoxes
    track: Ints32  # (n,) NOBODY: of no track
    angle: Floats  # (n,) viewing angle [rad]; NaN: not known
    covered: Floats  # (n,) share that a nearer box covers
    density: Floats  # (n, m); NaN: no pixels
    pixels: Ints  # (n,)


@dataclass
class SightingTally:
    """What was found while frames stream by.

    Attributes:
        frames, boxes: of those with boxes.
        of_tracks: boxes that are of a track.
        missing: boxes of a camera whose frame is not among the images.
        undecoded: frames of a camera that cannot be decoded.
        last_ns: time of the last frame; -1: none.
    """

    frames: int = 0
    boxes: int = 0
    of_tracks: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    undecoded: Counter[str] = field(default_factory=Counter)
    last_ns: int = -1

    def losses(self) -> tuple[Loss, ...]:
        """What could not be used."""
        gone = [Loss(name, "boxes", "there is no frame of that number", n) for name, n in sorted(self.missing.items())]
        bad = [Loss(name, "frames", "cannot be decoded", n) for name, n in sorted(self.undecoded.items())]
        return (*gone, *bad)


def boxes_of_frames(chunks: Iterable[Boxes] | Iterable[Views]) -> Iterator[FrameBoxes]:
    """Boxes frame by frame, in the order of time and of names; frames without boxes are left out.

    Regions that the fusion of detections put in or took out are left out, too.
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
    """Parts that never end amid the rows of one time."""
    held: Boxes | Views | None = None
    for chunk in chunks:
        whole = chunk if held is None else type(chunk).concat([held, chunk])  # type: ignore[list-item]
        if not len(whole):
            continue
        if (np.diff(whole.t_ns) < 0).any():
            raise InputError("boxes: times go back; sort the rows by t_ns")
        cut = int(np.searchsorted(whole.t_ns, whole.t_ns[-1]))
        if cut:
            yield whole.take(slice(0, cut))
        held = whole.take(slice(cut, None))
    if held is not None:
        yield held


def paths_of_rows(table: Tracks | Truth, config: SightingConfig) -> dict[int, Path]:
    """Paths of everybody in a table, by identity; true positions have no velocity of their own."""
    unknown = np.full((len(table), 2), np.nan)
    velocity = unknown if isinstance(table, Truth) else np.column_stack([table.vx, table.vy])
    return _paths(table.target_id, table.t_ns, np.column_stack([table.x, table.y]), velocity, config)


def paths_of_boxes(chunks: Iterable[Boxes] | Iterable[Views], scene: Scene, config: SightingConfig) -> dict[int, Path]:
    """Paths of the identities that boxes have: the floor below the middle of their lower edges.

    Of one time the mean over the cameras; boxes whose lower edge does not meet the floor are left out.
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
    place = np.zeros((different.shape[1], 2))
    np.add.at(place, code.reshape(-1), np.concatenate(xy))
    place /= count[:, None]
    return _paths(different[0].astype(np.int32), different[1], place, np.full(place.shape, np.nan), config)


def _paths(identity: Ints32, t_ns: Ints, xy: Floats, velocity: Floats, config: SightingConfig) -> dict[int, Path]:
    heading_ns = round(config.heading_s * NS)
    out = {}
    for name in np.unique(identity).tolist():
        own = np.flatnonzero(identity == name)
        own = own[np.argsort(t_ns[own], kind="stable")]
        out[name] = path_of(t_ns[own], xy[own], velocity[own], heading_ns, config.least_speed)
    return out


def sightings(
    boxes: Iterable[FrameBoxes],
    images: Iterable[Frame],
    paths: dict[int, Path],
    scene: Scene,
    config: SightingConfig,
    *,
    levels: int,
    own_identity: bool,
    tally: SightingTally,
) -> Iterator[Sighting]:
    """See what boxes show, frame by frame.

    Args:
        boxes: in the order of time; those of cameras that the scene does not have are an error.
        images: frames in the order of time; not read where boxes bring their colours.
        paths: of tracks, by identity.
        scene: must have the cameras.
        config: settings.
        levels: of the densities.
        own_identity: the identities of boxes are those of tracks; else boxes are of the tracks where they lie.
        tally: brought up to date.

    Raises:
        InputError: a camera that the scene does not have, or colours of other levels.
    """
    cameras = {c.name: c for c in scene.cameras}
    stream = _Images(images, tally)
    for each in boxes:
        if each.sensor not in cameras:
            raise InputError(f"boxes: no camera {each.sensor!r} in the scene; it has {', '.join(cameras)}")
        tally.frames += 1
        tally.boxes += len(each.box)
        colours, pixels = each.density, each.pixels
        if colours.shape[1] and colours.shape[1] != bins_of(levels):
            raise InputError(
                f"boxes: their colours are in {APPEARANCE_BINS} bins ({VIEWS_LEVELS} levels), but {bins_of(levels)} "
                f"({levels} levels) are wanted; learn with {VIEWS_LEVELS} levels, or give boxes with their images"
            )
        if not colours.shape[1]:
            image = stream.at(each)
            if image is None:
                continue
            counts = np.stack([colour_counts(*in_ellipse(image, edges), levels) for edges in each.edges])
            colours, pixels = density(counts), counts.sum(axis=1)
        track, angle = _seen_tracks(each, paths, cameras[each.sensor], config, own_identity)
        tally.of_tracks += int(np.count_nonzero(track != NOBODY))
        tally.last_ns = each.t_ns
        yield Sighting(each, track, angle, covered(each.edges), colours, np.where(np.isnan(colours[:, 0]), 0, pixels))


def in_ellipse(image: Image, edges: Floats) -> tuple[Bytes, Bytes]:
    """The part of an image that a box holds, and a mask of the pixels in the ellipse that touches its edges.

    Args:
        image: (height, width, 3) BGR or (height, width) grey.
        edges: (4,) left, top, right, bottom [px]; a box that reaches over the image is cut.
    """
    left, top, right, bottom = edges.tolist()
    height, width = image.shape[:2]
    x0, y0 = int(np.clip(np.ceil(left), 0, width)), int(np.clip(np.ceil(top), 0, height))
    x1, y1 = int(np.clip(np.floor(right) + 1, x0, width)), int(np.clip(np.floor(bottom) + 1, y0, height))
    x = (np.arange(x0, x1) - 0.5 * (left + right)) / (0.5 * (right - left))
    y = (np.arange(y0, y1) - 0.5 * (top + bottom)) / (0.5 * (bottom - top))
    return image[y0:y1, x0:x1], (x[None, :] ** 2 + y[:, None] ** 2 <= 1.0).astype(np.uint8)


def _seen_tracks(
    boxes: FrameBoxes, paths: dict[int, Path], camera: Camera, config: SightingConfig, own_identity: bool
) -> tuple[Ints32, Floats]:
    """(n,) track of each box, NOBODY for none, and (n,) viewing angle."""
    n = len(boxes.box)
    if not paths or not camera.has_height:
        identity = boxes.identity if own_identity else np.full(n, NOBODY, dtype=np.int32)
        return identity, np.full(n, np.nan)
    states = at_times(paths, np.array([boxes.t_ns]), round(config.max_gap_s * NS))
    if own_identity:
        place = np.minimum(np.searchsorted(states.identity, boxes.identity), len(states.identity) - 1)
        place = np.where(states.identity[place] == boxes.identity, place, -1)
        track = boxes.identity
    else:
        place = tracks_of_boxes(
            boxes.edges, expected_boxes(camera, states.xy[0], config.person_height), config.least_overlap
        )
        track = np.where(place >= 0, states.identity[place], np.int32(NOBODY))
    angle = viewing_angles(states.xy[0, place], states.heading[0, place], camera.ground)
    return track, np.where(place >= 0, angle, np.nan)


class _Images:
    """Images as a stream; holds those of the time that is asked for."""

    def __init__(self, frames: Iterable[Frame], tally: SightingTally) -> None:
        """Nothing is read yet."""
        self._frames, self._tally = iter(frames), tally
        self._held: dict[tuple[str, int], Frame] = {}
        self._next: Frame | None = None
        self._time = -1

    def at(self, boxes: FrameBoxes) -> Image | None:
        """The image of a frame; times must not fall.  None, and counted, where there is none."""
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
