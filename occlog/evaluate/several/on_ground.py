"""Figures of several recordings on the ground, in memory that does not grow with the length of tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from occlog.array_types import Ints, Ints32
from occlog.errors import UsageError
from occlog.evaluate.errors.streamed import stretches
from occlog.evaluate.errors.survey import survey
from occlog.evaluate.inputs import Paths, open_tables
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.figures import Metrics
from occlog.evaluate.mot.on_ground import GroundFigures, GroundPart, no_targets, places_of
from occlog.evaluate.stretches.sources import Span, any_long, no_frames, rows_during, span_of_frames
from occlog.io.open import Opened, of_others
from occlog.records.columns import Table
from occlog.records.tables import Tracks, Truth, TruthBoxes
from occlog.settings import configure
from occlog.track.images.run.provenance import born_from_detections

T = TypeVar("T", bound=Table)
V = TypeVar("V")


def figures_on_ground(
    sides: Sequence[Paths], chosen: EvaluateConfig, given: Mapping[str, object], frames: tuple[int, int] | None
) -> tuple[list[Metrics], Metrics, str]:
    """Figures of each recording, those of all together, and the unit of lengths.

    Args:
        sides: tracks, truth and scene of each.
        chosen: settings of the comparison.
        given: settings of `ManyConfig` that were given.
        frames: first frame of each to compare, and the one after the last.
    """
    opened = [_open(paths) for paths in sides]
    units = [unit for *_, unit in opened]
    if len(set(units)) > 1:
        raise UsageError(f"also: lengths are in {' and '.join(sorted(set(units)))}; they cannot be put together")
    recordings = list[_Recording]()
    for paths, (tracks, truth, unit) in zip(sides, opened, strict=True):
        born = born_from_detections(paths.tracks) or of_others(paths.tracks)
        own = "start" if born else ("label" if chosen.match == "id" else "best")
        config = configure(ManyConfig.in_unit(unit), {"own": own, **given})
        used = sum(len(each.labels) for each in recordings)
        recordings.append(_Recording(_Sides.of(tracks, truth, frames), used, chosen, config, unit))
    figures = [GroundFigures(r.targets, r.tracks, r.frames, r.config, unit) for r in recordings]
    targets, ours = (np.concatenate(one) for one in ([r.targets for r in recordings], [r.tracks for r in recordings]))
    frames_of_all = sum(r.frames for r in recordings)
    # A window is of one recording
    config = replace(recordings[-1].config, ospa_window=None)
    whole = GroundFigures(targets, ours, frames_of_all, config, unit)
    for n, recording in enumerate(recordings):
        for part in recording.parts():
            figures[n].first(part)
            whole.first(_among(recordings, n, part))
    for n, recording in enumerate(recordings):
        for part in recording.parts():
            figures[n].second(part)
            whole.second(_among(recordings, n, part))
    return [own.metrics() for own in figures], whole.metrics(), unit


def _open(paths: Paths) -> tuple[Opened, Opened, str]:
    """Tracks, truth and their unit of lengths."""
    tracks, truth, scene = open_tables(paths)
    if tracks is None or truth is None or not truth.has(Truth):
        raise UsageError(f"also: {paths.truth} holds no true positions")
    return tracks, truth, scene.length_unit


class _Sides(NamedTuple):
    """Tracks and truth of one recording, which are gone through as often as wanted."""

    tracks: Callable[[], Iterator[Tracks]]
    truth: Callable[[], Iterator[Truth]]

    @classmethod
    def of(cls, tracks: Opened, truth: Opened, frames: tuple[int, int] | None) -> _Sides:
        """The rows of some frames; None: all.

        Raises:
            InputError: there are no such frames.
        """
        held = not any_long(tracks, truth)
        whole = cls(_rows(tracks, Tracks, held=held), _rows(truth, Truth, held=held))
        if frames is None:
            return whole
        targets = (rows.t_ns[rows.role == "target"] for rows in whole.truth())
        boxes = (rows.t_ns for rows in (truth.rows(TruthBoxes) if truth.has(TruthBoxes) else ()))
        for times in (targets, boxes, (rows.t_ns for rows in whole.tracks())):
            span = span_of_frames(times, frames)
            if span is not None:
                return cls(partial(_during, whole.tracks, span), partial(_during, whole.truth, span))
        raise no_frames(frames, 0)


def _during(rows: Callable[[], Iterator[T]], span: Span) -> Iterator[T]:
    return rows_during(rows(), span)


def _rows(opened: Opened, table: type[T], *, held: bool) -> Callable[[], Iterator[T]]:
    """Gives the rows of a table; those of a short recording, which is slow to read, are held in memory."""
    if opened.recording is None or not held:
        return partial(opened.rows, table)
    rows = opened.read(table)
    return lambda: iter([rows])


class _Recording:
    """Parts of one recording, whose identities are numbered on from those of the recordings before it."""

    def __init__(self, sides: _Sides, used: int, chosen: EvaluateConfig, config: ManyConfig, unit: str) -> None:
        """Go through both sides for what must be known of the whole.

        Args:
            sides: tracks and truth.
            used: how many identities the recordings before this one have.
            chosen: settings of the comparison.
            config: settings of the figures.
            unit: of lengths.

        Raises:
            InputError: the truth has rows, but none of a target.
        """
        self.config, self._chosen, self._unit, self._sides, self._used = config, chosen, unit, sides, used
        known = survey(sides.tracks(), sides.truth())
        if known.truth_ns is not None and not known.targets:
            raise no_targets()
        self._nobody = known.truth_ns is None
        self.labels = np.unique(np.array([*known.tracks, *known.targets], dtype=np.int32))
        """All identities as they are in the files, rising."""
        self.frames = _number_of(rows.t_ns for rows in sides.tracks()) if self._nobody else known.frames
        """Number of times of true targets; of an empty truth, in which nobody is there, of the tracks."""
        ours, theirs = self._numbered(known.tracks), self._numbered(known.targets)
        self._known = replace(known, tracks=ours, targets=theirs, gaps_ns=self._numbered(known.gaps_ns))
        self.tracks, self.targets = (np.array(list(each), dtype=np.int64) for each in (ours, theirs))

    def _numbered(self, of_each: Mapping[int, V]) -> dict[int, V]:
        numbers = self._numbers(np.array(list(of_each), dtype=np.int32)).tolist()
        return dict(zip(numbers, of_each.values(), strict=True))

    def _numbers(self, labels: Ints32) -> Ints32:
        """Numbers of identities among those of all recordings."""
        return (self._used + np.searchsorted(self.labels, labels)).astype(np.int32)

    def parts(self) -> Iterator[GroundPart]:
        """Its frames, in the order of time."""
        limit, known, begin = self._chosen.limit_ns, self._known, 0
        tracks = (replace(rows, target_id=self._numbers(rows.target_id)) for rows in self._sides.tracks())
        own = (rows.take(rows.role == "target") for rows in self._sides.truth())
        truth = (replace(rows, target_id=self._numbers(rows.target_id)) for rows in own)
        for part in stretches(tracks, truth, known, self._chosen, self.config.gap_ns(limit)):
            times = np.unique(part.rows.t_ns) if self._nobody else part.times
            if len(times):
                places = places_of(part.targets, part.tracks, times, begin, self.config, limit, self._unit)
                over = known.over(int(times[-1]))
                yield GroundPart(places, begin, part.rows, part.targets, over)
                begin += len(times)


def _number_of(chunks: Iterable[Ints]) -> int:
    """How many different times there are in chunks of them, which do not fall."""
    count, latest = 0, None
    for t_ns in chunks:
        found = np.unique(t_ns)
        count += len(found) - (len(found) > 0 and int(found[0]) == latest)
        latest = int(found[-1]) if len(found) else latest
    return count


def _among(recordings: Sequence[_Recording], number: int, part: GroundPart) -> GroundPart:
    """A part of the recording of this number as one of all recordings, which follow one another."""
    before, behind = recordings[:number], recordings[number + 1 :]
    over = part.over
    if over is not None:
        sides = ([(len(r.targets), len(r.tracks)) for r in each] for each in (before, behind))
        done, left = (np.sum([(0, 0), *sizes], axis=0).tolist() for sizes in sides)
        over = tuple(np.r_[np.ones(done[k], np.bool_), over[k], np.zeros(left[k], np.bool_)] for k in (0, 1))
    return part._replace(begin=part.begin + sum(r.frames for r in before), over=over)
