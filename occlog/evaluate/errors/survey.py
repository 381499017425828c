"""Survey of tracks and truth, and their division into common time intervals (sections).

Memory does not grow with their length. Properties of the whole are determined by `survey` in a first pass.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import group_medians
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import ObjectPath, paths_of, usual_gap_ns
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.tables import Limits, TableBuffer, Tracks, Truth, in_step


@dataclass
class Lifetime:
    """First and last time of a target or track.

    Attributes:
        rows: number of its rows.
        first_ns: time of the first row [ns].
        last_ns: time of the last row [ns].
    """

    rows: int
    first_ns: int
    last_ns: int


@dataclass
class EvaluationSurvey:
    """Identities and times of all tracks and targets, from a first pass over both tables.

    Attributes:
        tracks: by identity, ascending.
        targets: true targets by identity, ascending.
        unknown: whether the covariance of some estimate is not known.
        tracks_ns: first and last time of the tracks [ns]; None: they have no rows.
        truth_ns: first and last time of the truth with all its roles [ns]; None: it has no rows.
        frames: number of distinct times of true targets; if the truth is empty, of the tracks.
        gaps_ns: default for the widest gap of each target's truth that is interpolated [ns].
    """

    tracks: dict[int, Lifetime] = field(default_factory=dict)
    targets: dict[int, Lifetime] = field(default_factory=dict)
    unknown: bool = False
    tracks_ns: tuple[int, int] | None = None
    truth_ns: tuple[int, int] | None = None
    frames: int = 0
    gaps_ns: dict[int, int] = field(default_factory=dict)

    @property
    def estimates(self) -> int:
        """Number of rows of all tracks."""
        return sum(each.rows for each in self.tracks.values())

    def over(self, t_ns: int) -> tuple[Bools, Bools]:
        """Return masks of the targets and of the tracks without a row after the time `t_ns` [ns]."""
        targets, tracks = (
            np.array([life.last_ns <= t_ns for life in each.values()], dtype=np.bool_)
            for each in (self.targets, self.tracks)
        )
        return targets, tracks

    @property
    def single(self) -> tuple[int, int] | None:
        """The only track and the only target, if there is one of each; else None."""
        return (min(self.tracks), min(self.targets)) if len(self.tracks) == len(self.targets) == 1 else None


def survey(tracks: Iterable[Tracks], truth: Iterable[Truth], in_memory: int = NUMBERS_IN_MEMORY) -> EvaluationSurvey:
    """Determine identities and times of tracks and truth in one pass.

    Args:
        tracks: chunks in the order of time.
        truth: chunks in the order of time.
        in_memory: how many intervals are kept in memory; more go to a temporary file.

    Raises:
        InputError: more than `MAX_IDENTITIES` targets or tracks.
    """
    found, steps = EvaluationSurvey(), TruthIntervals(in_memory)
    latest: int | None = None
    for rows in truth:
        if not len(rows):
            continue
        found.truth_ns = _span(found.truth_ns, rows.t_ns)
        own = rows.role == "target"
        t_ns, labels = rows.t_ns[own], rows.target_id[own]
        for label, at in _by_identity(labels, t_ns):
            before = found.targets.get(label)
            steps.add(label, at, None if before is None else before.last_ns)
            _live(found.targets, label, at)
        _check_identities(found.targets, "targets")
        found.frames, latest = _counted(found.frames, latest, t_ns)
    for part in tracks:
        if not len(part):
            continue
        found.tracks_ns = _span(found.tracks_ns, part.t_ns)
        if found.truth_ns is None:
            found.frames, latest = _counted(found.frames, latest, part.t_ns)
        for label, at in _by_identity(part.target_id, part.t_ns):
            _live(found.tracks, label, at)
        _check_identities(found.tracks, "tracks")
        found.unknown = found.unknown or bool(np.isnan(part.cov_xx).any())
    found.tracks, found.targets = (dict(sorted(each.items())) for each in (found.tracks, found.targets))
    found.gaps_ns = steps.usual_gaps_ns()
    return found


def _counted(frames: int, latest: int | None, t_ns: Ints) -> tuple[int, int | None]:
    """Return the number of distinct times including further rows, and the last of these times [ns].

    Args:
        frames: number of distinct times before.
        latest: last time before [ns]; None: none.
        t_ns: (n,) times of the rows [ns], not before `latest`.
    """
    times = np.unique(t_ns)
    new = len(times) if latest is None else int(np.count_nonzero(times != latest))
    return frames + new, int(times[-1]) if len(times) else latest


def _span(before: tuple[int, int] | None, t_ns: Ints) -> tuple[int, int]:
    return (int(t_ns[0]) if before is None else before[0], int(t_ns[-1]))


def _by_identity(labels: np.ndarray, t_ns: Ints) -> Iterator[tuple[int, Ints]]:
    """Generate each distinct identity in `labels` (n,) with its times: the entries of `t_ns` (n,) of its rows."""
    order = np.argsort(labels, kind="stable")
    names, first = np.unique(labels[order], return_index=True)
    for name, (start, stop) in zip(names.tolist(), pairwise([*first.tolist(), len(labels)]), strict=True):
        yield int(name), t_ns[order[start:stop]]


def _live(lives: dict[int, Lifetime], label: int, t_ns: Ints) -> None:
    known = lives.setdefault(label, Lifetime(0, int(t_ns[0]), int(t_ns[-1])))
    known.rows, known.last_ns = known.rows + len(t_ns), int(t_ns[-1])


class TruthIntervals:
    """Intervals between successive true positions of each object."""

    def __init__(self, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Start without intervals; up to `in_memory` of them stay in memory."""
        self._number: dict[int, int] = {}
        self._steps, self._owner = Spool(in_memory), Spool(in_memory)
        self._counts: list[int] = []

    def add(self, label: int, t_ns: Ints, last_ns: int | None) -> None:
        """Add the time intervals between further positions of an object.

        Args:
            label: identity of the object.
            t_ns: (n,) increasing times [ns].
            last_ns: time of its last position before them [ns]; None: these are its first.
        """
        number = self._number.setdefault(label, len(self._number))
        if number == len(self._counts):
            self._counts.append(0)
        steps = np.diff(t_ns if last_ns is None else np.insert(t_ns, 0, last_ns)).astype(np.float64)
        self._counts[number] += len(steps)
        self._steps.add(steps)
        self._owner.add(np.full(len(steps), float(number)))

    def usual_gaps_ns(self) -> dict[int, int]:
        """Return for each object, by identity, the default for the widest gap that is interpolated [ns]."""
        return {label: usual_gap_ns(step) for label, step in self.medians().items()}

    def medians(self) -> dict[int, float]:
        """Return the median interval between successive positions [ns] of each object.

        Infinite for a single position.
        """
        found = group_medians(self._blocks, np.array(self._counts, dtype=np.int64)).tolist()
        return {label: math.inf if math.isnan(found[k]) else found[k] for label, k in self._number.items()}

    def _blocks(self) -> Iterator[tuple[Ints, Floats]]:
        for owner, steps in zip(self._owner.blocks(), self._steps.blocks(), strict=True):
            yield owner.astype(np.int64), steps


MAX_IDENTITIES = 100_000
"""Targets, and tracks, that are compared: each takes 2 ms of processor time and 20 kB."""
MAX_PAIRS = 10_000_000
"""Pairs of a target and a track that exist at the same time: each takes 300 bytes."""


def _check_identities(lives: Mapping[int, Lifetime], name: str) -> None:
    """Raise InputError for more than `MAX_IDENTITIES` identities; `name`: `targets` or `tracks`, for the message."""
    if len(lives) > MAX_IDENTITIES:
        raise InputError(
            f"evaluate: more than {MAX_IDENTITIES} {name} cannot be compared; evaluate shorter parts of the recording",
            id="problem-too-large",
        )


def check_pairs(known: EvaluationSurvey) -> None:
    """Raise InputError for more than `MAX_PAIRS` pairs of a target and a track with overlapping lifetimes."""
    (first, last), (its_first, its_last) = (
        [np.sort([getattr(life, name) for life in lives.values()]) for name in ("first_ns", "last_ns")]
        for lives in (known.targets, known.tracks)
    )
    apart = np.searchsorted(last, its_first).sum() + np.searchsorted(its_last, first).sum()
    if (pairs := len(first) * len(its_first) - int(apart)) > MAX_PAIRS:
        raise InputError(
            f"evaluate: {pairs} pairs of a target and a track exist at the same time (limit {MAX_PAIRS}); evaluate "
            "shorter parts of the recording",
            id="problem-too-large",
        )


class EvaluationChunk(NamedTuple):
    """Tracks and truth of one time interval, with the paths around it.

    Attributes:
        rows: estimates in the interval.
        truth: true positions in the interval, of all roles.
        targets: true path of each target by identity, in the interval and a margin around it.
        tracks: estimated path of each track by identity, in the same time span.
        times: (T,) distinct times of true targets in the interval [ns].
        limits: begin and end of the interval.
        sides: buffers of tracks and truth, for rows further around the interval.
    """

    rows: Tracks
    truth: Truth
    targets: Mapping[int, ObjectPath]
    tracks: Mapping[int, ObjectPath]
    times: Ints
    limits: Limits
    sides: tuple[TableBuffer[Tracks], TableBuffer[Truth]]


class SegmentTables(NamedTuple):
    """Tables to read along with tracks and truth, with the margins around a time interval that are needed [ns].

    Attributes:
        sides: buffers of the other tables, not read yet.
        margins_ns: margin of each of them.
        tracks_ns: margin of the tracks, if larger than the interpolated gap.
        truth_ns: margin of the truth, if larger than the interpolated gap.
    """

    sides: Sequence[TableBuffer[Any]] = ()
    margins_ns: Sequence[int] = ()
    tracks_ns: int = 0
    truth_ns: int = 0


def chunks_in_time(
    tracks: Iterable[Tracks],
    truth: Iterable[Truth],
    known: EvaluationSurvey,
    config: EvaluateConfig,
    track_gap_ns: int = 0,
    companion: SegmentTables | None = None,
) -> Iterator[EvaluationChunk]:
    """Generate tracks and truth in successive time intervals.

    Paths extend beyond an interval by the widest interpolated gap, so that interpolation in it equals that in the
    whole.

    Args:
        tracks: chunks in the order of time.
        truth: chunks in the order of time.
        known: identities and times of both tables.
        config: largest gaps that are interpolated.
        track_gap_ns: largest gap of tracks that is interpolated [ns], if larger.
        companion: other tables of which rows are read for the same intervals; None: none.
    """
    more = companion or SegmentTables()
    limit = max(known.gaps_ns.values(), default=0) if config.limit_ns is None else config.limit_ns
    margin = max(limit, config.bridge_ns, track_gap_ns)
    ours, theirs = TableBuffer(tracks, Tracks), TableBuffer(truth, Truth)
    margins = (max(margin, more.tracks_ns), max(margin, more.truth_ns), *more.margins_ns)
    for limits in in_step((ours, theirs, *more.sides), margins):
        rows, true = limits.of(ours), limits.of(theirs)
        if not (len(rows) or len(true) or more.sides):
            continue
        targets = {
            label: replace(path, gap_ns=known.gaps_ns[label])
            for label, path in paths_of(limits.about(theirs, margin), "target").items()
        }
        times = np.unique(true.t_ns[true.role == "target"])
        yield EvaluationChunk(rows, true, targets, paths_of(limits.about(ours, margin)), times, limits, (ours, theirs))
