"""Detectors: an image in, boxes out."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

from numpy.random import Generator

from occlog.array_types import Floats, Floats32
from occlog.records.frames import Image
from occlog.settings import Settings

__all__ = ["Detected", "Detector", "Image"]


class Detected(NamedTuple):
    """The N boxes in an image; N may be 0.

    Attributes:
        boxes: (N, 4) left and upper edge, width and height [px], the last two above 0; the centre of the first pixel is
            (0, 0).
        scores: (N,) confidence, 0 to 1.
        embeddings: (N, D) how those look who are in the boxes, D the same in all images; None: the detector tells none.
    """

    boxes: Floats
    scores: Floats
    embeddings: Floats32 | None = None


class Detector(Protocol):
    """A detector of people (group `occlog.detectors`): an object for each camera.

    It draws random numbers from its generator alone, changes nothing that it is given, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, settings: Settings, rng: Generator) -> None:
        """No image has been seen yet."""

    def detect(self, image: Image) -> Detected:
        """Find people in an image (height, width, 3), BGR, uint8; images come in the order of time."""
