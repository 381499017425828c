"""Background subtraction with OpenCV's MOG2 and KNN: frames in, foreground masks out.

A model that has seen only a few frames takes people for background within a few frames
more, because OpenCV's automatic learning rate starts high (1 / (2 n) after n frames).
So a model can be started from an image of the empty scene (`occlog.measure.regions.empty_scene`);
it then learns at the rate that the automatic one settles at, 1 / history, from its first
frame on.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from occlog.array_types import Bytes

FOREGROUND = 255  # OpenCV marks shadows with 127
DEFAULT_THRESHOLD = {"mog2": 36.0, "knn": 800.0}
"""Above OpenCV's 16 and 400: clouds brighten a wall by more than that within seconds."""

LARGEST_IMAGE, LARGEST_KNN = 34_000_000, 25_000_000
"""Pixels of an image.

The models take 100 and 84 bytes for each, and OpenCV counts those of KNN in 32 bits: larger ones end the process.
"""

KNN_START_FRAMES = 30  # fills the short, middle and long sample sets of the KNN model


@dataclass(frozen=True)
class Subtractor:
    """A background model of one camera; `foreground` advances the OpenCV object inside."""

    model: cv2.BackgroundSubtractor
    rate: float  # learning rate; negative: OpenCV's automatic one
    seed: int


def make_subtractor(
    kind: str, history: int, threshold: float | None, shadows: bool, start: Bytes | None = None, seed: int = 0
) -> Subtractor:
    """A new background model.

    Args:
        kind: `mog2` or `knn`.
        history: number of frames that the model remembers; a person who stands still
            becomes background after about a tenth of it.
        threshold: squared distance of a pixel from the background, for MOG2 in units of
            the background's variance, for KNN in squared grey levels; None: the default.
        shadows: tell shadows from foreground.
        start: image of the empty scene to start from; None: learn from the first frames.
        seed: of KNN's random choice of samples (MOG2 has none).

    Raises:
        ValueError: the kind is not known.
    """
    if kind not in DEFAULT_THRESHOLD:
        raise ValueError(f"background model {kind!r} is not one of: {', '.join(DEFAULT_THRESHOLD)}")
    make = cv2.createBackgroundSubtractorMOG2 if kind == "mog2" else cv2.createBackgroundSubtractorKNN
    model = make(history, DEFAULT_THRESHOLD[kind] if threshold is None else threshold, shadows)
    if start is None:
        return Subtractor(model, -1.0, seed)
    cv2.setRNGSeed(seed)
    model.apply(start, learningRate=1.0)
    for _ in range(KNN_START_FRAMES if kind == "knn" else 0):
        model.apply(start, learningRate=0.5)
    return Subtractor(model, 1.0 / history, seed)


def largest_image(kind: str) -> int:
    """Pixels that an image for a model of this kind may have."""
    return LARGEST_KNN if kind == "knn" else LARGEST_IMAGE


def foreground(subtractor: Subtractor, image: Bytes, number: int, clean_px: int) -> Bytes:
    """(height, width) mask, 255 on the foreground and 0 elsewhere; the model learns from the image.

    Args:
        subtractor: the camera's model; frames must come in order.
        image: (height, width, 3) BGR or (height, width) grey, always of one size.
        number: of the frame; with the model's seed it makes KNN's random numbers, so
            that they do not depend on the thread that happens to do the work.
        clean_px: side of the median filter that removes speckle, odd; 0 or 1: none.
    """
    cv2.setRNGSeed((subtractor.seed + number) & 0x7FFFFFFF)
    raw = subtractor.model.apply(image, learningRate=subtractor.rate)
    # Shadows (127) go to background.
    _, mask = cv2.threshold(raw, FOREGROUND - 1, FOREGROUND, cv2.THRESH_BINARY)
    if clean_px > 1:
        mask = cv2.medianBlur(mask, clean_px)
    return mask  # type: ignore[no-any-return]
