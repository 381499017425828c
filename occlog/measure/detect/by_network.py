"""Detection of people with a neural network: frames to views (with colours and embeddings) and candidate bearings.

One thread decodes and resizes the frames, in order; the network, which has its own threads, runs in parallel. Frames of
one time are written together, so that the rows depend neither on the number of images that the network takes at a time
nor on that of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import cv2
import numpy as np

from occlog.array_types import Floats32
from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.measure.detections import Detections
from occlog.measure.networks.detector import Boxed, Embedder, NetworkDetector, Prepared
from occlog.measure.regions.box_appearance import box_appearance
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import APPEARANCE_BINS, Bearings, Boxes, Views

from .by_background.one_camera import check_size, plain_image, segments, size_in_words
from .config import BATCH, DetectConfig
from .from_boxes import detect_boxes

NOT_FINITE = "the network gives numbers that are not finite"


class _Ready(NamedTuple):
    """A decoded frame and its resized input for the network; or the reason why it could not be used.

    `lost` is that reason, empty for a good frame, of which alone `image` (BGR) and `prepared` are not None.
    """

    frame: Frame
    lost: str = ""
    image: Image | None = None
    prepared: Prepared | None = None


class DetectedFrame(NamedTuple):
    """A frame with its n boxes by decreasing area, or the reason why it could not be used.

    `lost` is that reason (empty: none), `boxed` then None; re-identification vectors (n, D) and colour histograms
    (n, 72) of the boxes.
    """

    frame: Frame
    lost: str
    boxed: Boxed | None
    embedding: Floats32  # (n, D), by box
    appearance: Floats32  # (n, 72), by box


def detect_by_network(
    frames: Iterable[Frame],
    scene: Scene,
    detector: NetworkDetector,
    embedder: Embedder | None = None,
    config: DetectConfig | None = None,
    *,
    rows: int = BATCH,
    shapes: dict[str, tuple[int, ...]] | None = None,
) -> Iterator[Detections]:
    """Generate boxes of a network as views and unlabelled candidate bearings, sorted by time.

    Frames that cannot be decoded, have another size than the camera's first, or for which the network returns
    non-finite numbers, are losses without rows.

    Args:
        frames: frames in the order of time; each camera's also in the order of its index.
        scene: scene with the cameras.
        detector: detection network.
        embedder: network that describes the appearance in the boxes; None: no embeddings.
        config: its `bit_depth`, `sigma_px` and `sigma_scale` are used.
        rows: minimum number of frames in a part.
        shapes: shape of each camera's first image in earlier frames by name, updated in place; None: these are the
            first frames.

    Raises:
        InputError: a frame's camera is not in the scene, an image does not fit its calibration, times go back, or the
            network fails.
    """
    config = config or DetectConfig()
    found = _detect_frames(frames, scene, detector, embedder, config, {} if shapes is None else shapes)
    yield from in_parts(found, scene, config, rows=rows)


def in_parts(
    frames: Iterable[DetectedFrame], scene: Scene, config: DetectConfig, *, rows: int = BATCH
) -> Iterator[Detections]:
    """Convert frames with boxes to views, candidate bearings and losses; frames of one time are in one part.

    A part has at least `rows` frames, except the last.

    Raises:
        InputError: times go back.
    """
    held: list[DetectedFrame] = []
    for seen in frames:
        if held and seen.frame.t_ns < held[-1].frame.t_ns:
            raise InputError(
                f"camera {seen.frame.sensor}: frame {seen.frame.index}: time {time_words(seen.frame.t_ns)} is before "
                f"{time_words(held[-1].frame.t_ns)} of the frame read before it; frames must come in the order of time",
                id="unsorted-times",
            )
        if len(held) >= rows and seen.frame.t_ns != held[-1].frame.t_ns:
            yield _part(held, scene, config)
            held = []
        held.append(seen)
    if held:
        yield _part(held, scene, config)


def _detect_frames(
    frames: Iterable[Frame],
    scene: Scene,
    detector: NetworkDetector,
    embedder: Embedder | None,
    config: DetectConfig,
    shapes: dict[str, tuple[int, ...]],
) -> Iterator[DetectedFrame]:
    """Generate the frames in order with the boxes of the network, their embeddings and colours.

    `shapes` has the shape of each camera's first image by name, and is updated in place. `embedder` None: no
    embeddings.
    """

    def prepare(some: list[Frame]) -> list[_Ready]:
        return [_prepare(frame, scene, detector, shapes, config) for frame in some]

    source = iter(frames)
    waiting: deque[Future[list[_Ready]]] = deque()
    empty = np.zeros((0, embedder.length if embedder else 0), dtype=np.float32)
    no_colours = np.zeros((0, APPEARANCE_BINS), dtype=np.float32)
    pool = ThreadPoolExecutor(1)
    try:
        while True:
            # One batch is prepared while the network is at the one before.
            while len(waiting) < 2 and (some := list(islice(source, detector.network.batch))):
                waiting.append(pool.submit(prepare, some))
            if not waiting:
                return
            batch = waiting.popleft().result()
            if some := list(islice(source, detector.network.batch)):
                waiting.append(pool.submit(prepare, some))
            wanted = [each.prepared for each in batch if each.prepared is not None]
            found = iter(detector.find(wanted) if wanted else [])
            for each in batch:
                if each.prepared is None or each.image is None:
                    yield DetectedFrame(each.frame, each.lost, None, empty, no_colours)
                    continue
                boxed = next(found)
                vectors, colours = empty, no_colours
                if boxed is not None:
                    n = len(boxed.boxes)
                    vectors = embedder.vectors(each.image, boxed.boxes) if embedder else np.zeros((n, 0), np.float32)
                    colours = box_appearance(each.image, boxed.boxes, boxed.score)
                yield DetectedFrame(each.frame, "" if boxed is not None else NOT_FINITE, boxed, vectors, colours)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _prepare(
    frame: Frame, scene: Scene, detector: NetworkDetector, shapes: dict[str, tuple[int, ...]], config: DetectConfig
) -> _Ready:
    """Decode a frame and resize it for the network; or state the reason why it cannot be used.

    `shapes` has the shape of each camera's first image by name, and is updated in place.
    """
    image = decoded(frame, scene, shapes, config)
    return _Ready(frame, image) if isinstance(image, str) else _Ready(frame, "", image, detector.prepare(image))


def decoded(frame: Frame, scene: Scene, shapes: dict[str, tuple[int, ...]], config: DetectConfig) -> Image | str:
    """Image (height, width, 3) of a frame in BGR, 8 bits; or the reason why it cannot be used, as text.

    Args:
        frame: frame to decode.
        scene: has its camera.
        shapes: shape of each camera's first image by name, updated in place.
        config: its `bit_depth` is used.

    Raises:
        InputError: the image does not fit the camera's calibration.
    """
    try:
        raw = frame.decode()
    except InputError as error:
        # The message begins with file, camera and frame; without them equal reasons are equal.
        return str(error).rsplit(": ", 1)[-1]
    try:
        image = plain_image(raw, config.bit_depth)
    except InputError as error:
        return str(error)
    if frame.sensor not in shapes:
        check_size(scene.camera(frame.sensor), (image.shape[1], image.shape[0]))
    first = shapes.setdefault(frame.sensor, image.shape)
    if image.shape != first:
        return f"image is {size_in_words(image.shape)}, the camera's first was {size_in_words(first)}"
    return in_colour(image)


def in_colour(image: Image) -> Image:
    """BGR image (height, width, 3) of an image that may be grey (height, width)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8) if image.ndim == 2 else image


def _part(seen: list[DetectedFrame], scene: Scene, config: DetectConfig) -> Detections:
    """Views, bearings and losses of some frames.

    Args:
        seen: frames with boxes, embeddings and colours; those without boxes (None) become losses.
        scene: scene with the cameras.
        config: settings of the detection; its minimum confidence is not used, since boxes are already selected by it.
    """
    good = [each for each in seen if each.boxed is not None]
    # Boxes come by falling area, as views are numbered: rows of both tables are in one order.
    tables = [_boxes(each.frame, each.boxed) for each in good if each.boxed is not None]
    losses = _losses(seen)
    if not tables:
        return Detections(Views.empty(), Bearings.empty(), losses, 0, 0)
    boxes = Boxes.concat(tables)
    vectors = np.concatenate([each.embedding for each in good])
    numbers = np.flatnonzero(boxes.box >= 0)
    order = np.lexsort([getattr(boxes, name)[numbers] for name in reversed(Boxes.KEY)])
    (found,) = detect_boxes([boxes.sorted()], scene, replace(config, min_confidence=0.0))
    colours = np.concatenate([each.appearance for each in good])
    views = replace(found.views, embedding=vectors[order], appearance=colours[order])
    return found._replace(views=views, losses=losses)


def _boxes(frame: Frame, boxed: Boxed) -> Boxes:
    """Rows of `Boxes` of a frame, without identities; one row without a box (number -1) if there are none."""
    n = len(boxed.boxes)
    edges = boxed.boxes if n else np.full((1, 4), np.nan)
    rows = len(edges)
    return Boxes.of(
        t_ns=np.full(rows, frame.t_ns),
        sensor=np.full(rows, frame.sensor),
        frame=np.full(rows, frame.index),
        box=np.arange(n, dtype=np.int32) if n else np.full(1, -1, dtype=np.int32),
        target_id=np.full(rows, -1, dtype=np.int32),
        left_px=edges[:, 0],
        top_px=edges[:, 1],
        width_px=edges[:, 2] - edges[:, 0],
        height_px=edges[:, 3] - edges[:, 1],
        confidence=boxed.score if n else np.full(1, np.nan),
    )


def _losses(seen: list[DetectedFrame]) -> tuple[Loss, ...]:
    lost: dict[str, list[tuple[int, str]]] = {}
    for each in seen:
        if each.lost:
            lost.setdefault(each.frame.sensor, []).append((each.frame.index, each.lost))
    return tuple(loss for name, frames in sorted(lost.items()) for loss in segments(name, frames))
