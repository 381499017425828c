"""Rows of tables from messages: true positions, boxes, directions of arrival."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Boxes, Doa, Truth

from .kinds import BoxMessage, DirectionMessage, PoseMessage
from .transforms import Placed

LENGTHS = (0.9, 1.1)
"""Of a vector that is taken for a direction."""


def truth_rows(message: PoseMessage, t_ns: int, first: int, placed: Placed) -> Truth:
    """Positions of one message in the world; the targets are numbered from `first`."""
    if not np.isfinite(message.positions).all():
        raise InputError("a true position is not finite")
    places = message.positions @ placed.rotation.T + placed.translation
    n = len(places)
    x, y, z = places.T
    return Truth.of(
        t_ns=np.full(n, t_ns), target_id=first + np.arange(n), role=np.full(n, "target"), x=x, y=y, z=z.copy()
    )


class BoxRows:
    """Boxes of one camera; counts its frames and its classes."""

    def __init__(self, camera: str, classes: Collection[str], scale: float) -> None:
        """Take boxes of some classes, or of the only one that there is; scores are divided by `scale`."""
        self.camera, self.classes, self.scale = camera, classes, scale
        self.frames = 0
        self.labels: Counter[str] = Counter()
        self._numbers: dict[str, int] = {}
        self._owners: dict[int, str] = {}

    def rows(self, message: BoxMessage, t_ns: int) -> Boxes:
        """The boxes of one message, which is a frame; one without boxes is a row that says that nobody was seen.

        InputError where there are several classes and none is chosen, and for boxes that cannot be.
        """
        kept = [b for b in message.boxes if not self.classes or b.label in self.classes]
        self.labels.update(b.label for b in message.boxes)
        if not self.classes and len(self.labels) > 1:
            raise InputError(f"boxes of classes {', '.join(map(repr, self.labels))}; choose the class that is wanted")
        frame, self.frames = self.frames, self.frames + 1
        edges = np.array([b[:4] for b in kept], dtype=np.float64).reshape(-1, 4)
        score = np.array([b.score for b in kept], dtype=np.float64) / self.scale
        if not (np.isfinite(edges).all() and (edges[:, 2:] > 0).all()):
            raise InputError(f"frame {frame}: a box without a size")
        if ((score < 0) | (score > 1)).any():
            raise InputError(f"frame {frame}: a confidence of {score[(score < 0) | (score > 1)][0]:g}; want 0 to 1")
        n = max(len(kept), 1)
        blank = np.full((1, 4), np.nan)
        left, top, width, height = (edges if len(kept) else blank).T.copy()
        return Boxes.of(
            t_ns=np.full(n, t_ns),
            sensor=np.full(n, self.camera),
            frame=np.full(n, frame),
            box=np.arange(n) if kept else np.array([-1]),
            target_id=np.array([self._identity(b.id) for b in kept] or [-1]),
            left_px=left,
            top_px=top,
            width_px=width,
            height_px=height,
            confidence=score if kept else np.array([np.nan]),
        )

    def _identity(self, text: str) -> int:
        """The number of a track that a detector names: its own where it is one, else the next that is free."""
        if not text:
            return -1
        known = self._numbers.get(text)
        if known is not None:
            return known
        own = text.isascii() and text.isdigit() and len(text) <= 10 and int(text) < 2**31
        number = int(text) if own else len(self._numbers)
        if number in self._owners:
            raise InputError(
                f"tracks {self._owners[number]!r} and {text!r} would both be number {number}: some are named by "
                "numbers, some otherwise; name all alike"
            )
        self._numbers[text], self._owners[number] = number, text
        return number


def direction_rows(message: DirectionMessage, t_ns: int, array: MicrophoneArray) -> Doa:
    """Directions of one message in the world; empty slots (id 0, or no direction) give no row."""
    heard = [s for s in message.sources if s.id != 0 and any(s.vector)]
    vectors: Floats = np.array([s.vector for s in heard], dtype=np.float64).reshape(-1, 3)
    with np.errstate(over="ignore"):  # what is infinite is refused
        length = np.linalg.norm(vectors, axis=1)
    bad = ~((length >= LENGTHS[0]) & (length <= LENGTHS[1]))
    if bad.any():
        raise InputError(f"a direction {vectors[bad][0].tolist()} of length {length[bad][0]:.3g}; want a unit vector")
    rays = vectors @ array.rotation.T
    n = len(heard)
    azimuth = np.arctan2(rays[:, 1], rays[:, 0])
    rows = Doa.of(
        t_ns=np.full(n, t_ns),
        sensor=np.full(n, array.name),
        source_id=np.array([s.id for s in heard]),
        azimuth=np.where(azimuth >= np.pi, -np.pi, azimuth),
        elevation=np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])),
        sigma_azimuth=np.full(n, np.nan),
        sigma_elevation=np.full(n, np.nan),
        confidence=np.clip(np.array([s.strength for s in heard], dtype=np.float64), 0.0, 1.0),
    )
    return rows.sorted()
