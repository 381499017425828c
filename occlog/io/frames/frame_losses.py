"""Bookkeeping of a video's frames: which were delivered, which should have been, and why not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError
from occlog.io.video.container import Container
from occlog.records.losses import Loss

MAX_STRETCHES = 20
"""Lost stretches listed one by one; the rest is added up in one line."""
ESTIMATE_SLACK = 0.02
"""Relative error allowed to a frame count that is only the container's estimate."""


class Ledger:
    """Frames start <= number < stop of one video as they arrive."""

    def __init__(
        self,
        path: Path,
        container: Container | None,
        frames: int | None,
        size: tuple[int, int],
        start: int,
        stop: int | None,
    ) -> None:
        self.met = 0
        self._misplaced = False
        self._path, self._container, self._frames, self._size = path, container, frames, size
        self._start, self._stop = start, stop
        listed = container.frames if container else None
        self._seen = None if listed is None else np.zeros(listed, dtype=np.bool_)
        self._last = start - 1
        self._unplaced = 0
        self._complaints: list[tuple[int, str]] = []
        self._odd: list[tuple[int, tuple[int, int]]] = []

    def accept(self, index: int) -> bool:
        """Whether a picture is wanted: it has a number, in the range, later than the last one, with all its bytes."""
        if index < 0 or (self._start <= index <= self._last):
            self._unplaced += 1
            return False
        if index < self._start or (self._stop is not None and index >= self._stop):
            return False
        self._last = index
        broken = self._container.broken if self._container is not None else ()
        return index >= len(broken) or not broken[index]

    def note(self, index: int, complaint: str) -> None:
        """Remember what the decoder wrote about a picture that it delivered all the same."""
        if complaint:
            self._complaints.append((index, complaint))

    def fits(self, index: int, size: tuple[int, int]) -> bool:
        """Note a picture that was decoded; false if it has another size than the others."""
        self.met += 1
        if self._seen is not None and index < len(self._seen):
            self._seen[index] = True
        if size == self._size:
            return True
        self._odd.append((index, size))
        return False

    def misplaced(self) -> None:
        """Note that pictures are stored in another order than shown, and that some were dropped."""
        self._misplaced = True

    def faults(self) -> Iterator[Loss]:
        """Faults of the container itself."""
        for place, what in self._container.problems if self._container else ():
            yield Loss(self._path.name, place, what)

    def check_any(self) -> None:
        """Raise InputError unless a frame of the range was delivered."""
        if self.met:
            return
        if self._frames is not None and self._start >= self._frames:
            raise InputError(
                f"{self._path}: frames from {self._start} on are wanted, but the video has only {self._frames}"
            )
        faults = "".join(f"; {place}: {what}" for place, what in (self._container.problems if self._container else ()))
        raise InputError(f"{self._path}: not one of the wanted frames can be used{faults}; copy or repair the file")

    def report(self, lost: Callable[[Loss], None]) -> None:
        """Tell everything that is missing from the range, and what may be wrong in it."""
        losses = [*self._missing(), *self._odd_sizes(), *self._reported()]
        if self._misplaced:
            what = "pictures are stored in another order than shown, and some were dropped: times near these may be off"
            losses.append(Loss(self._path.name, "dropped frames", what))
        if self._unplaced:
            what = "pictures without a place in the container's list of frames were left out"
            losses.append(Loss(self._path.name, "behind the damage", what, self._unplaced))
        if losses or self._stop is None:
            for loss in (*self.faults(), *losses):
                lost(loss)

    def _missing(self) -> Iterator[Loss]:
        if self._seen is None or self._container is None:
            yield from self._estimated()
            return
        gone = np.flatnonzero(~self._seen[self._start : self._stop]) + self._start
        broken = self._container.broken[gone]
        absent = "not in the file, or not completely"
        yield from _stretches(self._path.name, gone[broken], absent)
        yield from _stretches(self._path.name, gone[~broken], "could not be decoded")

    def _estimated(self) -> Iterator[Loss]:
        """For a container that we cannot read ourselves: its estimate of the number of frames."""
        if self._frames is None:
            return
        wanted = (self._frames if self._stop is None else min(self._frames, self._stop)) - self._start
        if self.met < wanted * (1 - ESTIMATE_SLACK) - 1:
            what = f"{self.met} frames decoded where the file announces about {wanted}"
            yield Loss(self._path.name, f"after frame {self._last}", what, wanted - self.met)

    def _odd_sizes(self) -> Iterator[Loss]:
        for size in dict.fromkeys(s for _, s in self._odd):
            frames = np.array([i for i, s in self._odd if s == size], dtype=np.int64)
            want = f"{self._size[0]} x {self._size[1]}"
            yield from _stretches(self._path.name, frames, f"{size[0]} x {size[1]} px where {want} was expected")

    def _reported(self) -> Iterator[Loss]:
        """Pictures that were delivered although the decoder met damage in them."""
        texts = dict(self._complaints)
        for loss in _stretches(self._path.name, np.array(sorted(texts), dtype=np.int64), ""):
            first = texts[int(loss.place.split()[1].split("-")[0])] if loss.place.startswith("frame") else "errors"
            what = f"the decoder reported damage ({first}); the image and those built on it may be wrong"
            yield Loss(loss.source, loss.place, what)


def _stretches(source: str, frames: Ints, what: str) -> Iterable[Loss]:
    """One loss for each run of consecutive frame numbers."""
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(frames) else []
    for run in runs[:MAX_STRETCHES]:
        place = f"frame {run[0]}" if len(run) == 1 else f"frames {run[0]}-{run[-1]}"
        yield Loss(source, place, what, len(run))
    rest = runs[MAX_STRETCHES:]
    if rest:
        place = f"{len(rest)} more stretches in frames {rest[0][0]}-{rest[-1][-1]}"
        yield Loss(source, place, what, sum(map(len, rest)))
