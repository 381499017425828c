"""Statistics of people for a report: counts over time, longest tracks, number of cameras that detect them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import Sum, ratio_or_nan
from occlog.records.declared.people import has_word
from occlog.records.tables import PeopleTracks, Truth

from .coverage import CELLS, SensorSightings

MAX_PEOPLE = 60
"""People with a separate row: those with the longest tracks."""


@dataclass(frozen=True, eq=False)
class PeopleCount:
    """Number of tracked people at each of T times.

    Attributes:
        t_ns: (T,) times of the tracks [ns].
        people: (T,) number of tracks.
        expected: (T,) sum of their existence probabilities.
        seen: (T,) number of those that some camera has a box of.
    """

    t_ns: Ints
    people: Floats
    expected: Floats
    seen: Floats


def people_statistics(tracks: PeopleTracks) -> PeopleCount:
    """Return the number of people at each time of the tracks."""
    times, row = np.unique(tracks.t_ns, return_inverse=True)
    counts = [np.bincount(row, w, len(times)) for w in (None, tracks.existence_probability, tracks.seen_by != "")]
    return PeopleCount(times, *(c.astype(np.float64) for c in counts))


def true_people(truth: Truth, at: Ints) -> tuple[Ints, Floats]:
    """Return the times (T,) [ns] in `at` at which the truth has targets, and the number (T,) of targets at each."""
    own = truth.t_ns[truth.role == "target"]
    times, number = np.unique(own[np.isin(own, at)], return_counts=True)
    return times, number.astype(np.float64)


def _longest(ids: Ints, first: Ints, rows: Ints) -> Ints:
    longest = np.argsort(-rows, kind="stable")[:MAX_PEOPLE]
    return ids[longest[np.argsort(first[longest], kind="stable")]].astype(np.int64)


def _names(tracks: PeopleTracks) -> set[str]:
    return {name for text in np.unique(tracks.seen_by).tolist() for name in text.split(",") if name}


def camera_has_box(tracks: PeopleTracks, name: str) -> Bools:
    """Return the mask (N,) of rows in which the camera `name` has a box of the person."""
    return has_word(tracks.seen_by, name)


def usual_step(t_ns: Ints) -> int:
    """Return the median interval between distinct times `t_ns` (n,) [ns], at least 1."""
    times = np.unique(t_ns)
    return max(int(np.median(np.diff(times))), 1) if len(times) > 1 else 1


class _VisibilityCells:
    """Counts of people, and of people with a box of each camera, in intervals of equal length.

    Args:
        first: begin [ns].
        end: end [ns].
        step: least length of an interval [ns].
    """

    def __init__(self, first: int, end: int, step: int) -> None:
        self._cells = max(min(CELLS, (end - first) // step), 1)
        self._edges = np.linspace(first, end, self._cells + 1).astype(np.int64)
        self._observed = np.zeros(self._cells, np.int64)
        self._seen: dict[str, Ints] = {}

    def add(self, tracks: PeopleTracks, names: tuple[str, ...]) -> None:
        cell = np.clip(np.searchsorted(self._edges, tracks.t_ns, side="right") - 1, 0, self._cells - 1)
        self._observed += np.bincount(cell, minlength=self._cells)
        for name in names:
            seen = np.bincount(cell, camera_has_box(tracks, name), self._cells).astype(np.int64)
            self._seen[name] = self._seen.get(name, np.zeros(self._cells, np.int64)) + seen

    @property
    def names(self) -> set[str]:
        return set(self._seen)

    def sightings(self, name: str) -> SensorSightings:
        return SensorSightings(name, self._edges, self._observed, self._seen[name])


@dataclass
class TrackLife:
    """Lifetime of a track, with the cameras that detected the person.

    Attributes:
        begin: number of its first row in the table.
        span_ns: its first and last time [ns].
        rows: number of its rows.
        unseen: number of rows in which no camera has a box.
        cameras: names of the cameras that have had one.
    """

    begin: int
    span_ns: tuple[int, int]
    rows: int = 0
    unseen: int = 0
    cameras: set[str] = field(default_factory=set)


@dataclass(frozen=True, eq=False)
class PeopleStatistics:
    """Summary of all people's tracks.

    Attributes:
        rows: number of estimates.
        mean: mean number of people at a time.
        most: largest number of people at a time.
        unseen: share of the estimates in which no camera detects the person.
        existence: mean existence probability, of rows that have one.
        several: share of the estimates in which several cameras detect the person.
        identities: number of tracks.
        drawn: identities with a row of their own in figures, in the order of their initiation.
        cameras: names of the cameras that have a box of any person.
        crowd: number of people at the times that are drawn.
        found: by camera, numbers of people and of detected ones over time.
        lives: lifetime of each track, by identity, ascending.
    """

    rows: int
    mean: float
    most: int
    unseen: float
    existence: float
    several: float
    identities: int
    drawn: Ints
    cameras: tuple[str, ...]
    crowd: PeopleCount
    found: Mapping[str, SensorSightings] = field(default_factory=dict)
    lives: Mapping[int, TrackLife] = field(default_factory=dict)

    def sightings(self, name: str) -> SensorSightings:
        """Return the numbers of people, and of those with a box of the named camera, in intervals of equal length."""
        return self.found[name]


class PeopleStreams:
    """Accumulates statistics of people's tracks over a stream, in two passes: `add`, then `see`."""

    def __init__(self) -> None:
        """Create a summary without people."""
        self._rows = self._times = self._people = self._most = self._seen = self._several = self._with_existence = 0
        self._existence = Sum()
        self._lives: dict[int, TrackLife] = {}
        self._cameras: set[str] = set()
        self._cells: _VisibilityCells | None = None

    @property
    def any(self) -> bool:
        """Whether existence probabilities are known for any row."""
        return self._with_existence > 0

    def add(self, tracks: PeopleTracks) -> None:
        """First pass: add the rows of a time interval."""
        found = people_statistics(tracks)
        self._times += len(found.t_ns)
        self._people += int(found.people.sum())
        self._most = max(self._most, int(found.people.max(initial=0)))
        self._seen += int(found.seen.sum())
        self._several += int(np.count_nonzero(np.char.find(tracks.seen_by, ",") >= 0))
        self._with_existence += int(np.count_nonzero(~np.isnan(tracks.existence_probability)))
        self._existence.add(float(np.nansum(tracks.existence_probability)))
        ids, first, row, counts = np.unique(
            tracks.target_id, return_index=True, return_inverse=True, return_counts=True
        )
        unseen = np.bincount(row, tracks.seen_by == "", len(ids)).astype(np.int64)
        last = np.zeros(len(ids), np.int64)
        last[row] = tracks.t_ns  # in the order of time
        begins = tracks.t_ns[first]
        for k, name in enumerate(ids.tolist()):
            life = self._lives.setdefault(name, TrackLife(self._rows + int(first[k]), (int(begins[k]), 0)))
            life.rows, life.unseen = life.rows + int(counts[k]), life.unseen + int(unseen[k])
            life.span_ns = life.span_ns[0], int(last[k])
        texts, text = np.unique(tracks.seen_by, return_inverse=True)
        for name, k in np.unique(np.column_stack([tracks.target_id, text]), axis=0).tolist():
            self._lives[name].cameras.update(filter(None, str(texts[k]).split(",")))
        self._cameras |= _names(tracks)
        self._rows += len(tracks)

    def begin_cells(self, span_ns: tuple[int, int], step_ns: float) -> None:
        """Begin the second pass: create the time intervals in which detections are counted.

        `span_ns`: first and last time [ns]; `step_ns`: usual time between rows [ns].
        """
        step = max(int(step_ns), 1) if self._times > 1 else 1
        self._cells = _VisibilityCells(span_ns[0], span_ns[1] + step, step)

    def see(self, tracks: PeopleTracks, cameras: int) -> None:
        """Second pass: count the detections of people by each of the first `cameras` cameras, by name."""
        assert self._cells is not None
        self._cells.add(tracks, tuple(sorted(self._cameras))[:cameras])

    def finish(self, drawn: PeopleCount) -> PeopleStatistics:
        """Return the summary of all tracks; `drawn`: numbers of people at the times that are drawn."""
        lives = {name: self._lives[name] for name in sorted(self._lives)}
        names = np.array(list(lives), dtype=np.int64)
        first = np.array([life.begin for life in lives.values()], dtype=np.int64)
        rows = np.array([life.rows for life in lives.values()], dtype=np.int64)
        cameras = tuple(sorted(self._cameras))
        cells = self._cells
        return PeopleStatistics(
            rows=self._rows,
            mean=ratio_or_nan(self._people, self._times),
            most=self._most,
            unseen=1.0 - ratio_or_nan(self._seen, self._people),
            existence=ratio_or_nan(self._existence.value, self._with_existence),
            several=ratio_or_nan(self._several, self._rows),
            identities=len(names),
            drawn=_longest(names, first, rows),
            cameras=cameras,
            crowd=drawn,
            found={} if cells is None else {n: cells.sightings(n) for n in cameras if n in cells.names},
            lives=lives,
        )
