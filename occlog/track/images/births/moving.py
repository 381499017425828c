"""Regions of what moves in a recording's images, for trackers to begin from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from occlog.errors import InputError
from occlog.measure.clusters.person_size import SizeMap, constant_sizes
from occlog.measure.detect.by_background.learning import learn
from occlog.measure.detect.by_background.one_camera import known_sizes, plain_image
from occlog.measure.detect.by_background.stage import detect
from occlog.measure.detect.config import DetectConfig
from occlog.measure.epipolar.views import View
from occlog.measure.regions.empty_scene import difference
from occlog.measure.regions.observed_size import DIFFERENCE
from occlog.measure.regions.shrink import shrink
from occlog.records.frames import Frame, Image
from occlog.records.scene import Camera, Scene

from .regions import Regions, regions_of_views

SAMPLES = 40
"""First frames of each camera in which the size of what moves is measured, where it is not known."""
LEAST_AREA = 5e-4
"""Least area of a blob that counts in that, as a share of the image."""


def moving_regions(
    frames: Callable[[], Iterable[Frame]], scene: Scene | None, views: Sequence[View], workers: int = 1
) -> Iterator[Regions]:
    """Find people-sized regions in all frames as `occlog detect` does with its defaults, in the order of time.

    Where neither the cameras' poses nor the people seen give a size, the regions are connected
    blobs of the usual size of what moves.

    Args:
        frames: makes all frames of the views, in the order of time; called two or three times.
        scene: may lack cameras.
        views: V views.
        workers: threads.
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


def _size(scene: Scene, view: View, config: DetectConfig) -> SizeMap | None:
    """Sizes of people that follow from the camera's pose; None: unknown."""
    return known_sizes(scene.camera(view.name), scene, (view.width, view.height), config)


def with_cameras(scene: Scene | None, views: Sequence[View]) -> Scene:
    """Add the views that the scene lacks to it, as cameras without a pose."""
    scene = Scene() if scene is None else scene
    known = [camera.name for camera in scene.cameras]
    new = [
        Camera(v.name, np.zeros(3), np.eye(3), np.ones(2), np.zeros(2), placed=False)
        for v in views
        if v.name not in known
    ]
    return replace(scene, cameras=(*scene.cameras, *new))


def blob_sizes(frames: Iterable[Frame], empty: Mapping[str, Image], views: Sequence[View]) -> dict[str, SizeMap]:
    """Measure the median size of the blobs that differ from the empty scene, the same all over the image.

    Args:
        frames: in the order of time.
        empty: images of the empty scene, may be shrunk.
        views: whose sizes are wanted; a view without blobs gets none.
    """
    heights: dict[str, list[float]] = {view.name: [] for view in views}
    looked = dict.fromkeys(heights, 0)
    for frame in frames:
        if frame.sensor not in heights or looked[frame.sensor] == SAMPLES:
            continue
        looked[frame.sensor] += 1
        try:
            image = plain_image(frame.decode(), None)
        except InputError:
            continue
        heights[frame.sensor] += _heights(image, empty[frame.sensor])
        if all(n == SAMPLES for n in looked.values()):
            break
    return {
        view.name: constant_sizes((view.width, view.height), float(np.median(heights[view.name])))
        for view in views
        if heights[view.name]
    }


def _heights(image: Image, empty: Image) -> list[float]:
    """Heights [px] of blobs away from the edge of the image."""
    factor = max(1, image.shape[0] // empty.shape[0])
    small = shrink(image, factor)
    if small.shape != empty.shape:
        return []
    mask = cv2.medianBlur((difference(small, empty) > DIFFERENCE).astype(np.uint8), 5)
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    left, top, width, height, area = stats[1:].T
    rows, columns = mask.shape
    inside = (left > 0) & (top > 0) & (left + width < columns) & (top + height < rows)
    return [float(h) * factor for h in height[inside & (area >= LEAST_AREA * mask.size)]]
