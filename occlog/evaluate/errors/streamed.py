"""Errors of tracks against targets, in memory that does not grow with their length.

The tables are gone through twice or more: for what must be known of the whole (`survey`, and for tracks that are paired
by distance `PairSums`), then side by side in stretches of time (`CompareStreams`).  Figures are those of `compare` and
`error_metrics` of whole tables, up to the rounding of sums.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Bools, Ints
from occlog.core.metrics.errors import pair_by_sums, ratio
from occlog.core.metrics.mot.couples import Couples
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Path, paths_of
from occlog.io.files.put_aside.spool import IN_MEMORY
from occlog.records.columns import rows_by_label
from occlog.records.pieces import Limits, Side, in_step
from occlog.records.tables import Errors, Tracks, Truth

from .on_ground import Gaps, apart, errors_of, settled
from .sums import ErrorFigures
from .survey import Survey

Metrics = dict[str, float]


class Stretch(NamedTuple):
    """What there is during a stretch of time.

    Attributes:
        rows: estimates.
        truth: true positions, of all roles.
        targets: path of each target that is there or near, in it and about it.
        tracks: path of each track, likewise.
        times: of true targets, each once.
        limits: first moment, and that after the last one.
        sides: tracks and truth, which have as much about the stretch as was asked for.
    """

    rows: Tracks
    truth: Truth
    targets: Mapping[int, Path]
    tracks: Mapping[int, Path]
    times: Ints
    limits: Limits
    sides: tuple[Side[Tracks], Side[Truth]]


class Beside(NamedTuple):
    """Tables that are gone through beside tracks and truth, and how much of these there is about a stretch [ns].

    Attributes:
        sides: the other tables, of which nothing is read yet.
        margins_ns: of each of them.
        tracks_ns: of tracks, if more than what is bridged.
        truth_ns: of the truth, likewise.
    """

    sides: Sequence[Side[Any]] = ()
    margins_ns: Sequence[int] = ()
    tracks_ns: int = 0
    truth_ns: int = 0


def stretches(
    tracks: Iterable[Tracks],
    truth: Iterable[Truth],
    known: Survey,
    config: EvaluateConfig,
    track_gap_ns: int = 0,
    beside: Beside | None = None,
) -> Iterator[Stretch]:
    """Go through tracks and truth side by side.

    A stretch has about it as much as gaps are bridged, so that what is interpolated in it is the same as in the whole.

    Args:
        tracks: chunks in the order of time.
        truth: likewise.
        known: of the same chunks.
        config: how far apart samples may be.
        track_gap_ns: how far apart samples of tracks may be, if that is further.
        beside: other tables, of which rows may be looked at while a stretch is.
    """
    more = beside or Beside()
    limit = max(known.gaps_ns.values(), default=0) if config.limit_ns is None else config.limit_ns
    margin = max(limit, config.bridge_ns, track_gap_ns)
    ours, theirs = Side(tracks, Tracks), Side(truth, Truth)
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
        yield Stretch(rows, true, targets, paths_of(limits.about(ours, margin)), times, limits, (ours, theirs))


class PairSums:
    """How far each track is from each target, while stretches come by, for pairs of least overall RMSE."""

    def __init__(self, known: Survey) -> None:
        """No estimate yet."""
        self._tracks, self._targets = list(known.tracks), list(known.targets)
        self._place = {label: n for n, label in enumerate(self._targets)}
        self._sums, self._worst = Couples(len(self._targets), len(self._tracks), sums=3), 0.0

    def add(self, part: Stretch, config: EvaluateConfig) -> None:
        """Estimates of another stretch."""
        rows = part.rows
        number = np.searchsorted(self._tracks, rows.target_id)
        xy = np.column_stack([rows.x, rows.y])
        found = []
        for label, path in part.targets.items():
            begin, end = np.searchsorted(rows.t_ns, path.t_ns[0]), np.searchsorted(rows.t_ns, path.t_ns[-1], "right")
            true, good = path.at(rows.t_ns[begin:end], config.limit_ns)
            if not good.any():
                continue
            square = np.sum((xy[begin:end][good] - true[good]) ** 2, axis=1)
            self._worst = max(self._worst, float(square.max()))
            track, which, shared = np.unique(number[begin:end][good], return_inverse=True, return_counts=True)
            found.append((np.full(len(track), self._place[label]), track, shared, np.bincount(which, square)))
        if found:
            target, track, shared, more = (np.concatenate(column) for column in zip(*found, strict=True))
            # The rounding of each addition is kept beside the sum (Neumaier 1974)
            before = self._sums.at(target, track)[1]
            total = before + more
            lost = np.where(before >= more, (before - total) + more, (more - total) + before)
            self._sums.add(target, track, np.stack([shared, more, lost]))

    def pairs(self) -> dict[int, int]:
        """Which target each track is of."""
        target, track, (shared, squares, lost) = self._sums.all()
        made = pair_by_sums(track, target, shared, squares + lost, self._worst)
        return {self._tracks[track[n]]: self._targets[target[n]] for n in made.tolist()}


class CompareStreams:
    """Gathers the figures of errors of tracks against their targets, while stretches come by."""

    def __init__(
        self, known: Survey, pairs: Mapping[int, int], config: EvaluateConfig, unit: str, in_memory: int = IN_MEMORY
    ) -> None:
        """No estimate yet.

        Args:
            known: of all chunks.
            pairs: which target each track is of.
            config: limits in time, length of the transient.
            unit: of lengths.
            in_memory: how many distances are kept in memory.
        """
        self._known, self._pairs, self._config = known, pairs, config
        self._track_of = {target: track for track, target in pairs.items()}
        self._figures, self._late = ErrorFigures(unit, in_memory), ErrorFigures(unit, in_memory)
        self._gaps, self._begun = Gaps(), dict[int, int]()
        self._transient = config.skip_s > 0 or config.from_ns is not None
        self._left_out = self._interpolated = self._covered = 0
        self.late: Bools = np.zeros(0, dtype=np.bool_)
        """Which errors of the last stretch are after the transient; none without one."""

    def add(self, part: Stretch) -> Errors:
        """Estimates of another stretch, in the order of time; their errors."""
        config, nothing = self._config, Path(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
        found = []
        for track, which in rows_by_label(part.rows.target_id):
            target = self._pairs.get(track)
            if target is None:
                continue
            rows = part.rows.take(which)
            path = part.targets.get(target, replace(nothing, gap_ns=self._known.gaps_ns[target]))
            errors, good = errors_of(rows, target, path, config)
            life = self._known.targets[target]
            self._gaps.add(rows.t_ns, path, (life.first_ns, life.last_ns), config)
            self._left_out += int(np.count_nonzero(~good))
            self._interpolated += int(np.count_nonzero(~path.sampled(errors.t_ns)))
            found.append(errors)
        own = np.flatnonzero(part.truth.role == "target")
        for target, which in rows_by_label(part.truth.target_id[own]):
            estimated = part.tracks.get(self._track_of[target]) if target in self._track_of else None
            if estimated is not None:
                times = part.truth.t_ns[own[which]]
                self._covered += int(np.count_nonzero(estimated.at(times, config.bridge_ns)[1]))
        errors = Errors.merge(found)
        self._figures.add(errors)
        self.late = np.zeros(len(errors), dtype=np.bool_)
        if self._transient and len(errors):
            self.late = settled(errors, config, self._begun)
            self._late.add(errors.take(self.late))
        return errors

    @property
    def note(self) -> str | None:
        """A line on gaps of the truth where there is one to say."""
        return self._gaps.note

    def metrics(self) -> Metrics:
        """All figures.

        Raises:
            InputError: the truth covers the time of no estimate.
        """
        known, figures, matched = self._known, self._figures, self._pairs
        if not figures.rows:
            raise apart(known.tracks_ns or (0, 0), known.truth_ns or (0, 0), self._config)
        unmatched = [life.rows for label, life in known.tracks.items() if label not in matched]
        metrics: Metrics = {
            "estimates": figures.rows,
            "estimates_without_truth": self._left_out,
            "estimates_interpolated_truth": self._interpolated,
            "estimates_unmatched": sum(unmatched),
            "tracks": len(known.tracks),
            "tracks_unmatched": len(unmatched),
            "targets": len(known.targets),
            "targets_unmatched": len(set(known.targets) - set(matched.values())),
            "time_coverage": ratio(self._covered, sum(life.rows for life in known.targets.values())),
            **figures.metrics(),
        }
        if known.unknown:
            metrics = {name: value for name, value in metrics.items() if not name.startswith("nees_")}
        return {name: float(value) for name, value in metrics.items()}

    def settled(self, bound: Callable[[], Metrics] | None = None) -> Metrics:
        """The figures of errors, and of the bound, once more after the transient; none where there is none."""
        if not (self._transient and self._figures.rows):
            return {}
        after = {**self._late.metrics(), "estimates": self._late.rows}
        after |= {} if bound is None or not self._late.rows else bound()
        return {f"settled_{name}": float(value) for name, value in after.items()}
