"""Tracks of the world on their way over the video: onto the plan, and into the images of cameras that stand in it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from occlog.array_types import NS, Floats
from occlog.errors import InputError
from occlog.examine.viewers.drawings.people import (
    Crowd,
    Palette,
    Told,
    body_in_image,
    corners,
    feet_in_image,
    name_of,
    people_of,
)
from occlog.examine.viewers.inputs import alike
from occlog.io.open import check_unit, open_input
from occlog.records.columns import Table
from occlog.records.declared.people import PeopleTracks
from occlog.records.declared.views import ViewTracks
from occlog.records.pieces import whole_times
from occlog.records.scene import Camera
from occlog.records.tables import Diagnostics, Tracks, Truth
from occlog.track.images.births.loop_distances import anchors

from .draw import Way

T = TypeVar("T", bound=Table)


class Latest(Generic[T]):
    """Rows of the latest time of a table that is gone through once."""

    def __init__(self, path: Path, table: type[T], unit: str | None) -> None:
        """Open it; `unit`: of lengths, None: as the file has them.  InputError where one of ours has another."""
        opened = open_input(path)
        if unit is not None:
            check_unit(opened, unit, "the scene", InputError)
        self._pieces: Iterator[T] = (piece for rows in whole_times(opened.rows(table)) for piece in alike(rows))
        self._next = next(self._pieces, None)
        self.used = 0

    def until(self, t_ns: int) -> Iterator[T]:
        """The rows of each time that has come since the last call, up to `t_ns`."""
        while self._next is not None and int(self._next.t_ns[0]) <= t_ns:  # type: ignore[attr-defined]
            piece, self._next = self._next, next(self._pieces, None)
            self.used += len(piece)
            yield piece


class Sources(NamedTuple):
    """Tables of the world: tracks, what the filter said of itself, and the input with true positions.

    `unit`: of their lengths; None: as the files have them.
    """

    tracks: Path
    diagnostics: Path | None = None
    truth: Path | None = None
    unit: str | None = None


class World:
    """Where targets are in the world at the time of the frames, which must not go back."""

    def __init__(self, sources: Sources, metres: float, ranks: Mapping[int, int], trail_s: float) -> None:
        """Open the tables; lengths are of a unit of `metres`, trails are as long as `trail_s`."""
        tracks, diagnostics, truth, unit = sources
        self._tracks = Latest(tracks, PeopleTracks, unit)
        self._diagnostics = None if diagnostics is None else Latest(diagnostics, Diagnostics, unit)
        self._told = Told()
        self._truth = Latest(truth, Truth, unit) if truth is not None and open_input(truth).has(Truth) else None
        self._metres, self._trail_ns = metres, round(trail_s * NS)
        self.crowd = Crowd(Palette(ranks), self._trail_ns)
        self.true: list[Floats] = []

    @property
    def used(self) -> int:
        """Rows of tracks so far."""
        return self._tracks.used

    def move(self, t_ns: int) -> None:
        """Go on to a time."""
        for said in self._diagnostics.until(t_ns) if self._diagnostics is not None else ():
            self._told.add(said)
        for rows in self._tracks.until(t_ns):
            self.crowd.add(people_of(rows, self._metres, self._told))
        for true in self._truth.until(t_ns) if self._truth is not None else ():
            own = true.role == "target"
            self.true = list(self._metres * np.column_stack([true.x[own], true.y[own]]))

    def ways(self, camera: Camera, t_ns: int) -> list[Way]:
        """Bodies, ellipses on the floor and trails as a camera sees them; dashed what it does not see."""
        out = []
        for person in self.crowd.at(t_ns):
            box = body_in_image(person, camera, self._metres)
            if box is None:
                continue
            unseen = person.unsure or (person.seen_by is not None and camera.name not in person.seen_by)
            out.append(Way(corners(box), person.target, 2, unseen, name_of(person)))
            feet = feet_in_image(person, camera, self._metres)
            if feet is not None:
                out.append(Way(feet, person.target, 1, unseen))
            trail = self.crowd.trail(person.target)
            if camera.above_floor and len(trail) > 1:
                floor = np.column_stack([trail, np.full(len(trail), person.floor)])
                pixels = camera.project(floor / self._metres)
                if np.isfinite(pixels).all():
                    out.append(Way(pixels, person.target, 1))
        return out


class Trails:
    """Where the feet of targets were in the images of one camera."""

    def __init__(self, trail_s: float) -> None:
        """Keep the last seconds."""
        self._keep_ns = round(trail_s * NS)
        self._places: dict[int, deque[tuple[int, Floats]]] = {}

    def ways(self, rows: ViewTracks, t_ns: int) -> list[Way]:
        """Take the rows of a frame; the trails of those who are in it."""
        ellipses = np.column_stack([rows.x_px, rows.y_px, rows.a_px, rows.b_px, rows.rho])
        for target, foot in zip(rows.target_id.tolist(), anchors(ellipses, True), strict=True):
            self._places.setdefault(target, deque()).append((t_ns, foot))
        out = []
        for target, places in list(self._places.items()):
            while places and places[0][0] < t_ns - self._keep_ns:
                places.popleft()
            if not places:
                del self._places[target]
            elif len(places) > 1 and places[-1][0] == t_ns:
                out.append(Way(np.array([place for _, place in places]), target, 1))
        return out


def targets_of(paths: Mapping[Path, type[Tracks] | type[ViewTracks]]) -> dict[int, int]:
    """Place of each identity among all of the tables; a pass over their rows."""
    found = (rows for path, table in paths.items() for rows in open_input(path).rows(table))
    names = {target for rows in found for target in np.unique(rows.target_id).tolist()}
    return {target: rank for rank, target in enumerate(sorted(names))}
