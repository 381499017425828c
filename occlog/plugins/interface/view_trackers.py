"""Tracking methods of one camera: boxes in, identities out."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

from numpy.random import Generator

from occlog.array_types import Floats, Floats32, Ints
from occlog.settings import Settings


class BoxesInFrame(NamedTuple):
    """The N boxes that a detector has found in a frame of one camera; N may be 0.

    Attributes:
        t_ns: time of the frame [ns since the Unix epoch]; it never goes back.
        frame: number of the frame in the camera's stream; it grows, perhaps by more than 1.
        boxes: (N, 4) left and upper edge, width and height [px].
        scores: (N,) confidence of the detector, 0 to 1; NaN: it tells none.
        embeddings: (N, D) how those look who are in the boxes; D is 0 where nobody tells.
    """

    t_ns: int
    frame: int
    boxes: Floats
    scores: Floats
    embeddings: Floats32


class ViewTracker(Protocol):
    """A tracking method in the images of one camera (group `occlog.view_trackers`): an object for each camera.

    It draws random numbers from its generator alone, changes nothing that it is given, and writes nothing.
    """

    summary: ClassVar[str]  # one line for --help
    settings: ClassVar[type[Settings]]

    def __init__(self, settings: Settings, rng: Generator) -> None:
        """Nobody has been seen yet."""

    def step(self, found: BoxesInFrame) -> Ints:
        """Give the (N,) identities of the boxes, from 0 and each once; -1 for a box that is of nobody (yet)."""
