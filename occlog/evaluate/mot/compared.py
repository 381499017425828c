"""Tracks in images and true boxes, laid against each other frame by frame in memory that does not grow with length.

The tables are gone through four times: for the cameras, for their frames and who is in them, and twice for the figures.
Tables in memory are one chunk.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.evaluate.results import Evaluation
from occlog.records.declared.views import Failures
from occlog.records.tables import Boxes, TruthBoxes

from .config import ManyConfig
from .stage import ViewFigures, keys_of, left_out_note
from .truth_and_tracks import TruthAndTracks, asked_for, boxes_in_true_frames, compared_views

Sides = Callable[[], Iterator[tuple[Boxes, TruthBoxes]]]
"""Gives tracks and true boxes in chunks of the same frames, in the order of time, as often as asked."""


@dataclass
class _Side:
    """What is known of one side: its cameras, those asked for, numbers of frames of all rows and of those asked for."""

    cameras: set[str] = field(default_factory=set)
    wanted: set[str] = field(default_factory=set)
    frames: tuple[int, int] | None = None
    rows: int = 0

    def update(self, boxes: Boxes, config: ManyConfig) -> None:
        keep = asked_for(boxes, config)
        self.cameras.update(np.unique(boxes.sensor).tolist())
        self.wanted.update(np.unique(boxes.sensor[keep]).tolist())
        self.rows += int(np.count_nonzero(keep))
        if len(boxes):
            low, high = self.frames or (int(boxes.frame[0]), int(boxes.frame[0]))
            self.frames = min(low, int(boxes.frame.min())), max(high, int(boxes.frame.max()))

    def check(self, what: str, config: ManyConfig) -> None:
        """InputError where a camera, or of the truth any frame, that is asked for is missing."""
        if missing := [name for name in config.cameras if name not in self.cameras]:
            raise InputError(
                f"{what}: no camera {', '.join(missing)}; there is {', '.join(sorted(self.cameras)) or 'none'}"
            )
        if what == "truth" and config.frames is not None and self.frames is not None and not self.rows:
            first, stop = config.frames
            raise InputError(f"truth: no row in frames {first}:{stop}; they are {self.frames[0]} to {self.frames[1]}")


class ComparedBoxes:
    """Tracks in images and their true boxes, in the frames that the truth has.

    Attributes:
        views: cameras that are compared.
        left_out: cameras of the truth that have no track.
        frames: of each view its number of true frames.
        counts: what was compared and what was left out.
        targets: (G, 2) view and label of each target.
        tracks: (K, 2) view and label of each track.
    """

    def __init__(
        self,
        sides: Sides,
        config: ManyConfig,
        *,
        looked: Collection[str] = (),
        by_number: bool = False,
        adjust: Callable[[TruthAndTracks], TruthAndTracks] | None = None,
    ) -> None:
        """Go through both sides for what must be known of the whole.

        Args:
            sides: tracks and truth; rows of other cameras and frames than those asked for are left out.
            config: options.
            looked: cameras that are compared even if no track is in them.
            by_number: frames are the same when camera and number are; otherwise when camera and time are.
            adjust: what is done to each part, such as leaving out tracks of distractors.

        Raises:
            InputError: nothing is to be compared, or an object has no identity, or the same one twice in a frame.
        """
        self._sides, self._config, self._by_number, self._adjust = sides, config, by_number, adjust
        ours, theirs = _Side(cameras=set(looked), wanted=set(looked)), _Side()
        for tracks, truth in sides():
            ours.update(tracks, config)
            theirs.update(truth, config)
        theirs.check("truth", config)
        ours.check("tracks", config)
        self.views, self.left_out = compared_views(ours.wanted, theirs.wanted)
        frames, met = np.zeros(len(self.views), dtype=np.int64), 0
        self.targets: Ints = np.zeros((0, 2), dtype=np.int64)
        self.tracks: Ints = np.zeros((0, 2), dtype=np.int64)
        counts: dict[str, float] = {}
        for _, part in self.parts():
            frames += part.frames
            met += int(part.counts["frames"] - part.counts["frames_without_tracks"])
            counts = {name: counts.get(name, 0.0) + n for name, n in part.counts.items()}
            self.targets = np.unique(np.concatenate([self.targets, keys_of(part.truth)]), axis=0)
            self.tracks = np.unique(np.concatenate([self.tracks, keys_of(part.tracks)]), axis=0)
        self.frames: list[int] = frames.tolist()
        if counts.get("estimates_other_frames") and not counts["estimates_compared"]:
            raise InputError(self._apart())
        del counts["estimates_compared"]
        self.counts = counts | {
            "frames": float(sum(self.frames)),
            "frames_without_tracks": float(sum(self.frames) - met),
            "views_without_tracks": float(len(self.left_out)),
        }

    def _wanted(self) -> Iterator[tuple[Boxes, TruthBoxes]]:
        """Rows of the cameras and frames that are asked for."""
        for tracks, truth in self._sides():
            if self._config.cameras or self._config.frames is not None:
                yield tracks.take(asked_for(tracks, self._config)), truth.take(asked_for(truth, self._config))
            else:
                yield tracks, truth

    def parts(self) -> Iterator[tuple[list[int], TruthAndTracks]]:
        """Number of frames of each view before a part, and the part."""
        begin = [0] * len(self.views)
        for tracks, truth in self._wanted():
            part = boxes_in_true_frames(tracks, truth, self.views, by_number=self._by_number)
            part = part if self._adjust is None else self._adjust(part)
            yield begin, part
            begin = [n + more for n, more in zip(begin, part.frames, strict=True)]

    def _apart(self) -> str:
        """Why no track is in a frame of the truth."""
        found, true = (_first_of(rows) for rows in zip(*self._wanted(), strict=True))
        if self._by_number:
            return (
                f"tracks: their frames ({found[1]}) are none of the truth's ({true[1]}); frames must have the same "
                "numbers"
            )
        return (
            f"tracks: the time of no frame of theirs (first: {found[0]}) is among the true boxes (first: {true[0]}); "
            "times must be the same"
        )

    def figures(self, take: Callable[[Failures], None] | None = None) -> ViewFigures:
        """All figures, while `take` gets failures as they come."""
        out = ViewFigures(self.views, self.targets, self.tracks, self._config)
        for begin, part in self.parts():
            out.prepare(part, begin)
        for begin, part in self.parts():
            failures = out.update(part, begin)
            if take is not None:
                take(failures)
        return out

    def evaluate(self, take: Callable[[Failures], None] | None = None) -> Evaluation:
        """The evaluation, while `take` gets failures as they come."""
        found = self.figures(take)
        notes = (*left_out_note(self.left_out), *found.notes())
        return Evaluation(found.result(self.frames, self.counts), notes=notes)


def _first_of(parts: Iterable[Boxes]) -> tuple[str, str]:
    """The first row with a box, in words, and the numbers of the frames that have one."""
    rows = [part.take(part.box >= 0) if not isinstance(part, TruthBoxes) else part for part in parts if len(part)]
    rows = [part for part in rows if len(part)]
    low, high = min(int(part.frame.min()) for part in rows), max(int(part.frame.max()) for part in rows)
    return f"{rows[0].sensor[0]} at {rows[0].t_ns[0]} ns", f"{low} to {high}"
