"""Tracks in images against true boxes in stretches of time, in memory that does not grow with their length.

The tables are gone through four times: for the cameras, for their frames and who is in them, and twice for the figures.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.evaluate.stage import Evaluation
from occlog.io.open import Opened
from occlog.records.declared.views import Failures, ViewTracks, boxes_of_ellipses
from occlog.records.pieces import windows
from occlog.records.tables import Boxes, TruthBoxes

from .config import ManyConfig
from .stage import ViewFigures, keys_of, left_out_note
from .truth_and_tracks import TruthAndTracks, asked_for, boxes_in_true_frames

B = TypeVar("B", bound=Boxes)


@dataclass
class Known:
    """What is known of the whole.

    Attributes:
        views: cameras that are compared.
        left_out: cameras of the truth that have no track.
        frames: of each view its number of true frames.
        counts: of what was compared and what was left out.
        targets: (G, 2) view and label of each target.
        tracks: (K, 2) view and label of each track.
    """

    views: tuple[str, ...]
    left_out: tuple[str, ...]
    frames: list[int] = field(default_factory=list)
    counts: dict[str, float] = field(default_factory=dict)
    targets: Ints = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    tracks: Ints = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))


class BoxStreams:
    """Tracks in images and their true boxes, which are gone through several times; a frame is a time of a camera."""

    def __init__(self, tracks: Opened, truth: Opened, config: ManyConfig, looked: Collection[str]) -> None:
        """Go through both for what must be known of the whole.

        Args:
            tracks: tracks in images or boxes.
            truth: true boxes.
            config: options; rows of other cameras and frames are left out.
            looked: cameras that are compared even if no track is in them.
        """
        self._tracks, self._truth, self._config, self._looked = tracks, truth, config, looked
        self.known: Known | None = None
        """What is known of the whole; None: they cannot be compared, and whole tables say better what is wrong."""
        with contextlib.suppress(InputError):
            self.known = self._survey()

    def evaluate(self, take: Callable[[Failures], None]) -> Evaluation:
        """All figures, while `take` gets failures as they come."""
        known = self.known
        assert known is not None
        found = ViewFigures(known.views, known.targets, known.tracks, self._config)
        for begin, part in self.parts(known):
            found.first(part, begin)
        for begin, part in self.parts(known):
            take(found.second(part, begin))
        metrics = found.metrics(known.frames, known.counts)
        return Evaluation(metrics, notes=(*left_out_note(known.left_out), *found.notes()))

    def _boxes(self) -> Iterator[Boxes]:
        if self._tracks.has(ViewTracks):
            return map(boxes_of_ellipses, self._tracks.rows(ViewTracks))
        return self._tracks.rows(self._kind)

    def _true_boxes(self) -> Iterator[TruthBoxes]:
        return self._truth.rows(TruthBoxes)

    def _wanted(self, chunks: Iterable[B]) -> Iterator[B]:
        """Rows of the cameras and frames that are asked for."""
        if not self._config.cameras and self._config.frames is None:
            return iter(chunks)
        return (rows.take(asked_for(rows, self._config)) for rows in chunks)

    @property
    def _kind(self) -> type[Boxes]:
        return TruthBoxes if self._tracks.has(TruthBoxes) else Boxes

    def _survey(self) -> Known | None:
        """Cameras, frames and identities; None: nothing can be compared; InputError: a row is wrong."""
        ours, theirs = self._cameras(self._boxes(), self._looked), self._cameras(self._true_boxes())
        if ours is None or theirs is None:
            return None
        both = tuple(sorted(theirs & ours if ours else theirs))
        if not both:
            return None
        known = Known(both, tuple(sorted(theirs - ours)) if ours else ())
        frames, met, other = np.zeros(len(both), dtype=np.int64), 0, 0
        targets, tracks = known.targets, known.tracks
        for _, part in self.parts(known):
            frames += part.frames
            met += int(part.counts["frames"] - part.counts["frames_without_tracks"])
            other += int(part.counts["estimates_other_frames"])
            targets = np.unique(np.concatenate([targets, keys_of(part.truth)]), axis=0)
            tracks = np.unique(np.concatenate([tracks, keys_of(part.tracks)]), axis=0)
        if other and not len(tracks):
            return None
        known.frames, known.targets, known.tracks = frames.tolist(), targets, tracks
        counts = {
            "frames": sum(known.frames),
            "frames_without_tracks": sum(known.frames) - met,
            "estimates_other_frames": other,
            "views_without_tracks": len(known.left_out),
        }
        known.counts = {name: float(n) for name, n in counts.items()}
        return known

    def _cameras(self, chunks: Iterable[Boxes], looked: Collection[str] = ()) -> set[str] | None:
        """Cameras of the rows that are asked for; None: one that is asked for is nowhere in the rows."""
        there, wanted = set(looked), set(looked)
        for boxes in chunks:
            there.update(np.unique(boxes.sensor).tolist())
            wanted.update(np.unique(boxes.sensor[asked_for(boxes, self._config)]).tolist())
        return wanted if there.issuperset(self._config.cameras) else None

    def parts(self, known: Known) -> Iterator[tuple[list[int], TruthAndTracks]]:
        """Number of frames of each view before a part, and the part."""
        begin = [0] * len(known.views)
        sides = self._wanted(self._boxes()), self._wanted(self._true_boxes())
        for found in windows(*sides, (self._kind, TruthBoxes), 0):
            part = boxes_in_true_frames(found.a, found.b, self._config, views=known.views)
            yield begin, part
            begin = [n + more for n, more in zip(begin, part.frames, strict=True)]
