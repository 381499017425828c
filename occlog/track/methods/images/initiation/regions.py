"""Regions of a detector as ellipses, time step by time step, from tables of boxes or of clusters.

Regions of what moves in a recording's images, for trackers to begin from.

Background subtraction, [Qu] Sec. 4.2: masks of what is not the empty scene, in which colours of targets count.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Bools, Floats, Ints, Strings
from occlog.errors import InputError
from occlog.measure.clusters.person_size import SizeMap, constant_sizes
from occlog.measure.detect.by_background.learning import learn
from occlog.measure.detect.by_background.one_camera import known_sizes, plain_image
from occlog.measure.detect.by_background.stage import detect
from occlog.measure.detect.config import DetectConfig
from occlog.measure.epipolar.views import TrackedView
from occlog.measure.regions.background import DIFFERENCE, Subtractor, difference, foreground, make_subtractor
from occlog.measure.regions.regions import downscale
from occlog.records.frames import Frame, Image
from occlog.records.scene import Camera, Scene
from occlog.records.tables import Boxes, Views


class DetectorRegions(NamedTuple):
    """Regions found by a detector, as N ellipses (centre, half axes [px], angle [rad]) in time order.

    A row with `there` false is no region; it states that the detector processed the frame of this camera and time.
    """

    t_ns: Ints  # (N,)
    sensor: Strings  # (N,)
    ellipse: Floats  # (N, 5) see `occlog.core.image`
    there: Bools  # (N,) false: the row is no region: the detector processed the frame


def inscribed(left: Floats, top: Floats, width: Floats, height: Floats) -> Floats:
    """Return (N, 5) ellipses inscribed in upright boxes with the given left, top, width and height (N,) [px].

    An ellipse is (centre x, centre y, half width, half height, 0).
    """
    rows = [left + 0.5 * width, top + 0.5 * height, 0.5 * width, 0.5 * height, np.zeros(len(left))]
    return np.column_stack(rows)


def regions_of_boxes(chunks: Iterable[Boxes], min_confidence: float) -> Iterator[DetectorRegions]:
    """Generate regions from a detector's boxes with a confidence of at least `min_confidence`, or an unknown one.

    Rows without a box, and boxes of less confidence, only state that the frame was processed; frames without a row were
    not processed.
    """
    for c in chunks:
        there = (c.box >= 0) & ~(c.confidence < min_confidence)
        yield DetectorRegions(c.t_ns, c.sensor, inscribed(c.left_px, c.top_px, c.width_px, c.height_px), there)


def regions_of_views(chunks: Iterable[Views]) -> Iterator[DetectorRegions]:
    """Generate regions from clusters of foreground pixels, chunk by chunk, as ellipses inscribed in their boxes.

    Clusters that the fusion of detections added or removed (cause `recovered` or `removed`) only state that the frame
    was processed.
    """
    for c in chunks:
        there = ~np.isin(c.cause, ("recovered", "removed"))
        yield DetectorRegions(c.t_ns, c.sensor, inscribed(c.left_px, c.top_px, c.width_px, c.height_px), there)


@dataclass
class RegionStream:
    """Buffered stream of regions, read by time step.

    Attributes:
        chunks: regions in the order of time.
        sparse: the detector processed frames without a row too, and found no region there.
        met: number of regions of the time of a frame.
        read: number of regions read.
    """

    chunks: Iterator[DetectorRegions]
    sparse: bool
    met: int = 0
    read: int = 0
    _rows: OrderedDict[tuple[str, int], list[Floats]] = field(default_factory=OrderedDict)  # by (camera, time)
    _until: int | None = None  # time of the last row read
    _done: bool = False  # all rows are read

    def at(self, names: Sequence[str], t_ns: Ints) -> list[Floats | None]:
        """Return the regions (K, 5) of each view's frame; None without a frame, or if the detector did not process it.

        The regions returned, and those of earlier times, are removed from the buffer.

        Args:
            names: names of the V views.
            t_ns: (V,) times of their frames [ns], -1: none; times must not go back from call to call.
        """
        latest = int(t_ns.max())
        while not self._done and (self._until is None or self._until <= latest):
            self._pull()
        found = [self._take(name, t) if t >= 0 else None for name, t in zip(names, t_ns.tolist(), strict=True)]
        while self._rows and next(iter(self._rows))[1] <= latest:
            self._rows.popitem(last=False)
        return found

    def _pull(self) -> None:
        """Read one more chunk of regions into the buffer, or note that there is none left."""
        chunk = next(self.chunks, None)
        if chunk is None:
            self._done = True
            return
        columns = (chunk.t_ns.tolist(), chunk.sensor.tolist(), chunk.ellipse, chunk.there.tolist())
        for t, name, ellipse, there in zip(*columns, strict=True):
            rows = self._rows.setdefault((name, t), [])
            if there:
                rows.append(ellipse)
        self.read += int(chunk.there.sum())
        if len(chunk.t_ns):
            self._until = int(chunk.t_ns[-1])

    def _take(self, name: str, t_ns: int) -> Floats | None:
        """Return the regions (K, 5) of camera `name` at time `t_ns`, and remove them from the buffer.

        None if the detector did not process the frame, that is, without a row of this camera and time in a stream that
        is not sparse.
        """
        rows = self._rows.pop((name, t_ns), [] if self.sparse else None)
        if rows is None:
            return None
        self.met += len(rows)
        return np.array(rows).reshape(-1, 5)


SAMPLES = 40
"""First frames of each camera in which the size of what moves is measured, where it is not known."""
MIN_AREA = 5e-4
"""Least area of a blob that counts in that, as a share of the image."""


def moving_regions(
    frames: Callable[[], Iterable[Frame]], scene: Scene | None, views: Sequence[TrackedView], workers: int = 1
) -> Iterator[DetectorRegions]:
    """Generate the regions of moving people in all frames, in the order of time, by background subtraction.

    This is `occlog detect` with its defaults. Where neither a camera's pose nor the people seen give the size of a
    person, the regions are connected blobs of the usual size of what moves.

    Args:
        frames: makes an iterator over all frames of the views, in the order of time; called two or three times.
        scene: scene with the cameras' poses; None, or without some of the cameras: their poses are unknown.
        views: V views.
        workers: number of threads.
    """
    whole = with_cameras(scene, views)
    config = DetectConfig()
    learned, _ = learn(frames(), whole, config, (), workers)
    unknown = [v for v in views if v.name not in learned.sizes and _size(whole, v, config) is None]
    if unknown:
        config = replace(config, method="components")
        sizes = blob_sizes(frames(), learned.empty, unknown)
        learned = replace(learned, sizes={**learned.sizes, **sizes})
    yield from regions_of_views(part.views for part in detect(frames(), whole, config, workers, learned))


def _size(scene: Scene, view: TrackedView, config: DetectConfig) -> SizeMap | None:
    """Return the expected image sizes of people in a view, from the camera's pose; None if unknown."""
    return known_sizes(scene.camera(view.name), scene, (view.width, view.height), config)


def with_cameras(scene: Scene | None, views: Sequence[TrackedView]) -> Scene:
    """Return the scene with missing views added as cameras without a pose."""
    scene = Scene() if scene is None else scene
    known = [camera.name for camera in scene.cameras]
    new = [
        Camera(v.name, np.zeros(3), np.eye(3), np.ones(2), np.zeros(2), placed=False)
        for v in views
        if v.name not in known
    ]
    return replace(scene, cameras=(*scene.cameras, *new))


def blob_sizes(frames: Iterable[Frame], empty: Mapping[str, Image], views: Sequence[TrackedView]) -> dict[str, SizeMap]:
    """Return, by camera, a constant person size: the median height of blobs that differ from the empty scene.

    Args:
        frames: frames in the order of time; the first `SAMPLES` of each camera are used, undecodable ones omitted.
        empty: image of the empty scene of each camera, may be downscaled by a whole factor.
        views: views of the wanted sizes; a view without blobs gets none.
    """
    heights: dict[str, list[float]] = {view.name: [] for view in views}
    n_frames = dict.fromkeys(heights, 0)
    for frame in frames:
        if frame.sensor not in heights or n_frames[frame.sensor] == SAMPLES:
            continue
        n_frames[frame.sensor] += 1
        try:
            image = plain_image(frame.decode(), None)
        except InputError:
            continue
        heights[frame.sensor] += _heights(image, empty[frame.sensor])
        if all(n == SAMPLES for n in n_frames.values()):
            break
    return {
        view.name: constant_sizes((view.width, view.height), float(np.median(heights[view.name])))
        for view in views
        if heights[view.name]
    }


def _heights(image: Image, empty: Image) -> list[float]:
    """Return heights [px of `image`] of the blobs that differ from the `empty` scene and do not touch the image edge.

    Blobs below `MIN_AREA` of the image are omitted. `empty` may be downscaled by a whole factor; if its shape does not
    fit, there are no blobs.
    """
    factor = max(1, image.shape[0] // empty.shape[0])
    small = downscale(image, factor)
    if small.shape != empty.shape:
        return []
    mask = cv2.medianBlur((difference(small, empty) > DIFFERENCE).astype(np.uint8), 5)
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    left, top, width, height, area = stats[1:].T
    rows, columns = mask.shape
    inside = (left > 0) & (top > 0) & (left + width < columns) & (top + height < rows)
    return [float(h) * factor for h in height[inside & (area >= MIN_AREA * mask.size)]]


HISTORY = 5_000
"""Memory of the model [frames]; a person who stands still for a tenth of it becomes background."""
MAX_FOREGROUND_SHARE = 0.6
"""Share of foreground in an image above which the light has changed or the camera has moved: nothing is masked."""


class BackgroundModel(NamedTuple):
    """Background model of one camera, an OpenCV subtractor that `foreground_mask` updates with each image.

    `shape` is the height and width of the image of the empty scene, which may be downscaled.
    """

    subtractor: Subtractor
    shape: tuple[int, int]  # of the empty scene's image


def background_models(
    frames: Iterable[Frame], scene: Scene, views: Sequence[TrackedView], workers: int = 1
) -> tuple[BackgroundModel | None, ...]:
    """Learn the empty scene of each view and return its background model; None for a view without images.

    Args:
        frames: frames of all views, in the order of time.
        scene: scene with all views as cameras.
        views: V views.
        workers: number of threads.
    """
    config = DetectConfig()
    learned, _ = learn(frames, scene, config, (), workers)
    out: list[BackgroundModel | None] = []
    for view in views:
        empty = learned.empty.get(view.name)
        if empty is None:
            out.append(None)
            continue
        model = make_subtractor("mog2", HISTORY, None, True, empty)
        out.append(BackgroundModel(model, (empty.shape[0], empty.shape[1])))
    return tuple(out)


def foreground_mask(model: BackgroundModel | None, image: Image, number: int) -> Image | None:
    """Update the background model with an image, and return its foreground mask (H, W): 255 foreground, 0 background.

    None without a model, for an image of the wrong size, and for foreground above `MAX_FOREGROUND_SHARE` of the image.

    Args:
        model: background model of the camera, updated in place; None: no model.
        image: (H, W, 3) BGR or (H, W) grey; images come in time order.
        number: number of the frame.
    """
    if model is None:
        return None
    small = downscale(image, max(1, image.shape[0] // model.shape[0]))
    if small.shape[:2] != model.shape:
        return None
    found = foreground(model.subtractor, small, number, 5)
    if np.count_nonzero(found) > MAX_FOREGROUND_SHARE * found.size:
        return None
    if small.shape[:2] == image.shape[:2]:
        return found
    height, width = image.shape[:2]
    return cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST)  # type: ignore[no-any-return]
