"""Detection of people with a plug-in: frames to views (with embeddings) and candidate bearings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from occlog.errors import PluginError
from occlog.measure.detections import Detections
from occlog.measure.networks.detector import Boxed
from occlog.measure.regions.box_appearance import box_appearance
from occlog.plugins.interface import Detected, Detector
from occlog.plugins.loading import Chosen, plugin_errors
from occlog.records.frames import Frame
from occlog.records.scene import Scene
from occlog.records.tables import APPEARANCE_BINS

from .by_network import DetectedFrame, decoded, in_parts
from .config import DetectConfig


def detect_by_plugin(
    frames: Iterable[Frame], scene: Scene, chosen: Chosen, config: DetectConfig
) -> Iterator[Detections]:
    """Generate boxes of a detector plug-in as views and unlabelled candidate bearings, sorted by time.

    Frames that cannot be decoded, or have another size than the camera's first, are losses without rows.

    Args:
        frames: frames in the order of time; each camera's also in the order of its index.
        scene: scene with the cameras.
        chosen: the plug-in; each camera has its own object, with its own reproducible random numbers.
        config: its `bit_depth`, `sigma_px`, `sigma_scale` and `min_confidence` are used.

    Raises:
        InputError: an image does not fit its calibration, or times go back.
        PluginError: the plug-in fails, or returns something other than valid boxes.
    """
    yield from in_parts(_detect_frames(frames, scene, chosen, config), scene, config)


def _detect_frames(
    frames: Iterable[Frame], scene: Scene, chosen: Chosen, config: DetectConfig
) -> Iterator[DetectedFrame]:
    """Generate the frames in order with boxes, embeddings and colours; those the plug-in cannot get are losses.

    PluginError if the results of the plug-in `chosen` are not valid, or lengths of embeddings differ.
    """
    shapes: dict[str, tuple[int, ...]] = {}
    own: dict[str, Detector] = {}
    names = sorted(camera.name for camera in scene.cameras)
    length: int | None = None
    for frame in frames:
        image = decoded(frame, scene, shapes, config)
        if isinstance(image, str):
            nothing = np.zeros((0, length or 0), dtype=np.float32)
            yield DetectedFrame(frame, image, None, nothing, np.zeros((0, APPEARANCE_BINS), dtype=np.float32))
            continue
        if frame.sensor not in own:
            rng = np.random.default_rng(names.index(frame.sensor))
            own[frame.sensor] = chosen.make(scene.length_unit, rng)
        with plugin_errors(chosen.plugin):
            found = own[frame.sensor].detect(image)
        wrong = fault_of(found)
        if wrong is not None:
            raise PluginError(f"{chosen.plugin.label}: camera {frame.sensor}: frame {frame.index}: {wrong}")
        vectors = vectors_of(found)
        length = vectors.shape[1] if length is None and len(vectors) else length
        if len(vectors) and vectors.shape[1] != length:
            raise PluginError(
                f"{chosen.plugin.label}: camera {frame.sensor}: frame {frame.index}: embeddings of {vectors.shape[1]} "
                f"numbers, earlier ones had {length}; it must return one length"
            )
        kept = np.flatnonzero(np.asarray(found.scores, dtype=np.float64) >= config.min_confidence)
        boxes = np.asarray(found.boxes, dtype=np.float64).reshape(-1, 4)[kept]
        order = np.argsort(-boxes[:, 2] * boxes[:, 3], kind="stable")
        edges = np.column_stack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])[order]
        scores = np.asarray(found.scores, dtype=np.float64)[kept][order]
        colours = box_appearance(image, edges, scores)
        yield DetectedFrame(frame, "", Boxed(edges, scores), vectors[kept][order], colours)


def vectors_of(found: Detected) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """(N, D) embeddings of a detector's N boxes scaled to length 1; D = 0 if it has none."""
    if found.embeddings is None:
        return np.zeros((len(found.boxes), 0), dtype=np.float32)
    vectors = np.asarray(found.embeddings, dtype=np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), dtype=np.float32)


def fault_of(found: object) -> str | None:
    """Description of what is wrong with a detector plug-in's result; None if it is valid."""
    if not isinstance(found, Detected):
        return f"detect gives a {type(found).__name__}; a Detected was expected"
    try:
        boxes = np.asarray(found.boxes, dtype=np.float64)
        scores = np.asarray(found.scores, dtype=np.float64)
        vectors = np.asarray(vectors_of(found))
    except (TypeError, ValueError):
        return "boxes, scores or embeddings are not made of numbers"
    n = len(boxes) if boxes.ndim else -1
    if boxes.shape != (n, 4) and boxes.size:
        return f"boxes have the shape {boxes.shape}; (N, 4) was expected"
    if scores.shape != (n,):
        return f"scores have the shape {scores.shape}; ({n},) was expected"
    if vectors.ndim != 2 or len(vectors) != n:
        return f"embeddings have the shape {vectors.shape}; ({n}, D) was expected"
    if not np.isfinite(boxes).all():
        return "boxes are not finite"
    if not np.isfinite(vectors).all():
        return "embeddings are not finite, or have the length 0"
    if n and not (boxes[:, 2:] > 0).all():
        row = int(np.flatnonzero((boxes[:, 2:] <= 0).any(axis=1))[0])
        return f"box {row} is {boxes[row, 2]:g} x {boxes[row, 3]:g} px; width and height must be above 0"
    if not ((scores >= 0) & (scores <= 1)).all():
        row = int(np.flatnonzero(~((scores >= 0) & (scores <= 1)))[0])
        return f"score {row} is {scores[row]:g}; it must be 0 to 1"
    return None
