"""Errors of tracks: assignment of tracks to targets, error of each estimate, and figures of all errors.

Errors are those of (x, y). Where a track has heights and its target's height is known, errors in space are computed,
too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.console.text import in_seconds
from occlog.core.metrics.errors import (
    normalised_squared_errors,
    normalised_squared_errors_in_space,
    pair_by_sums,
    ratio_or_nan,
)
from occlog.core.metrics.mot.frame_pairs import TargetTrackSums
from occlog.errors import InputError, option
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import ObjectPath
from occlog.io.files.spill import NUMBERS_IN_MEMORY
from occlog.records.columns import rows_by_label
from occlog.records.tables import Errors, Tracks

from .sums import ErrorFigures
from .survey import EvaluationChunk, EvaluationSurvey

Metrics = dict[str, float]


def errors_in_space(tracks: Tracks, error: Floats, covariance: Floats, truth_z: Floats) -> dict[str, Floats]:
    """Return the columns of the table `Errors` for space; NaN if estimate or truth has no height.

    Args:
        tracks: N estimates.
        error: (N, 2) estimate minus truth on the ground.
        covariance: (N, 2, 2) covariance of the estimate on the ground.
        truth_z: (N,) true heights, NaN where not known.
    """
    error_z = tracks.z - truth_z
    whole = np.empty((len(tracks), 3, 3))
    whole[:, :2, :2] = covariance
    whole[:, 0, 2] = whole[:, 2, 0] = tracks.cov_xz
    whole[:, 1, 2] = whole[:, 2, 1] = tracks.cov_yz
    whole[:, 2, 2] = tracks.cov_zz
    return {
        "z": tracks.z,
        "truth_z": truth_z,
        "error_z": error_z,
        "error_space": np.sqrt(np.sum(error**2, axis=1) + error_z**2),
        "nees_space": normalised_squared_errors_in_space(np.column_stack([error, error_z]), whole),
    }


def pairs_by_number(known: EvaluationSurvey) -> dict[int, int]:
    """Pair each track with the target of the same identity; return the target by track.

    Raises:
        InputError: there are tracks and targets, and no identity is in both.
    """
    pairs = {track: track for track in known.tracks if track in known.targets}
    if known.tracks and known.targets and not pairs:
        raise InputError(
            f"tracks: no target_id of a track ({_some(list(known.tracks))}) is one of the truth "
            f"({_some(list(known.targets))}); pair them by distance ({option('match')} optimal)",
            id="disjoint-inputs",
        )
    return pairs


def _some(numbers: list[int]) -> str:
    shown = ", ".join(str(n) for n in numbers[:8])
    return f"{shown}, ..." if len(numbers) > 8 else shown or "none"


class Gaps:
    """Counts the estimates within the time of the truth that fall into gaps of it too wide to be interpolated."""

    def __init__(self) -> None:
        """Start with all counts at 0."""
        self._inside = self._missed = self._widest_ns = 0

    def add(self, t_ns: Ints, path: ObjectPath, span_ns: tuple[int, int], config: EvaluateConfig) -> None:
        """Add the estimates of one track.

        Args:
            t_ns: (n,) their times [ns].
            path: true path of its target, at least around these times.
            span_ns: first and last time of the whole true path [ns].
            config: largest gap of the truth that is interpolated.
        """
        t_ns = t_ns[(t_ns >= span_ns[0]) & (t_ns <= span_ns[1])]
        unknown = int(np.count_nonzero(~path.at(t_ns, config.limit_ns)[1]))
        self._inside, self._missed = self._inside + len(t_ns), self._missed + unknown
        if unknown:
            self._widest_ns = max(self._widest_ns, path.usual_gap_ns if config.limit_ns is None else config.limit_ns)

    @property
    def note(self) -> str | None:
        """Note for the user if most of the estimates fall into such gaps; else None."""
        if 2 * self._missed <= self._inside:
            return None
        return (
            f"warning: {self._missed} of {self._inside} estimates fall into gaps of the truth that are wider than "
            f"{self._widest_ns / NS:.3g} s, which are not bridged: no figure knows of their errors; where the truth "
            "holds still or runs straight over such a gap, bridge it (max_gap_s)"
        )


class NoCommonTimeError(InputError):
    """Raised if the truth covers the time of none of the estimates."""

    default_id = "disjoint-inputs"


def errors_of_pairs(tracks_ns: tuple[int, int], truth_ns: tuple[int, int], config: EvaluateConfig) -> NoCommonTimeError:
    """Return the error that the truth covers the time of no estimate; its message states both time ranges.

    Args:
        tracks_ns: first and last time of the tracks [ns].
        truth_ns: first and last time of the truth [ns].
        config: matching, and the largest gap that is interpolated.
    """
    tracks, truth = (f"{in_seconds(first)} to {in_seconds(last)} s" for first, last in (tracks_ns, truth_ns))
    if config.match == "id" and tracks_ns[0] <= truth_ns[1] and truth_ns[0] <= tracks_ns[1]:
        return NoCommonTimeError(
            f"tracks: no track overlaps in time with the target of its target_id (tracks {tracks}, truth {truth}, "
            f"max_gap_s {config.bridge_s:g}); match by position ({option('match')} optimal), check "
            f"the clocks, or raise {option('max_gap')}"
        )
    return NoCommonTimeError(
        f"tracks: the truth covers the time of no estimate: tracks {tracks}, truth {truth}, "
        f"gaps of at most {config.bridge_s:g} s are bridged; check the clocks or raise "
        f"{option('max_gap')}"
    )


def errors_of(rows: Tracks, target: int, path: ObjectPath, config: EvaluateConfig) -> tuple[Errors, Bools]:
    """Return the errors of a target's estimates, and the mask (N,) of the estimates that have one.

    Args:
        rows: N estimates of one track.
        target: identity in the truth.
        path: true path of the target.
        config: largest gap of the truth that is interpolated; estimates in wider gaps have no error.
    """
    true, good = path.at(rows.t_ns, config.limit_ns)
    kept, true = rows.take(good), true[good]
    xy = np.column_stack([kept.x, kept.y])
    error = xy - true
    covariance = np.empty((len(kept), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = kept.cov_xx, kept.cov_yy
    covariance[:, 0, 1] = covariance[:, 1, 0] = kept.cov_xy
    table = Errors.of(
        t_ns=kept.t_ns,
        target_id=np.full(len(kept), target, dtype=np.int32),
        x=xy[:, 0],
        y=xy[:, 1],
        truth_x=true[:, 0],
        truth_y=true[:, 1],
        error_x=error[:, 0],
        error_y=error[:, 1],
        error=np.hypot(error[:, 0], error[:, 1]),
        nees=normalised_squared_errors(error, covariance),
        **errors_in_space(kept, error, covariance, path.height_at(kept.t_ns, config.limit_ns)),
    )
    return table, good


def settled(errors: Errors, config: EvaluateConfig, begun: dict[int, int] | None = None) -> Bools:
    """Return the mask (N,) of errors after the settling time.

    That is `settling_s` after each target's first estimate, and after `from_ns`.

    Args:
        errors: N rows in the order of time.
        config: both times.
        begun: time [ns] of the first estimate of each target in earlier rows; new targets are added in place.
    """
    first = {} if begun is None else begun
    keep = np.ones(len(errors), dtype=np.bool_)
    for target in np.unique(errors.target_id).tolist():
        rows = errors.target_id == target
        keep[rows] = errors.t_ns[rows] >= first.setdefault(target, int(errors.t_ns[rows][0])) + round(
            config.settling_s * NS
        )
    if config.from_ns is not None:
        keep &= errors.t_ns >= config.from_ns
    return keep


def no_targets() -> InputError:
    """Return the error for a truth with rows but no target."""
    return InputError("truth: has no rows of role target; nothing to compare with", id="empty-input")


class PairSums:
    """Accumulates squared distances of each track from each target, for one-to-one pairs over the whole run."""

    def __init__(self, known: EvaluationSurvey) -> None:
        """Create sums for the targets and tracks that the survey found."""
        self._tracks, self._targets = list(known.tracks), list(known.targets)
        self._index_of = {label: n for n, label in enumerate(self._targets)}
        self._sums, self._worst = TargetTrackSums(len(self._targets), len(self._tracks), sums=3), 0.0

    def update(self, part: EvaluationChunk, config: EvaluateConfig) -> None:
        """Add the squared distances of all tracks from all targets in a time interval (`part`)."""
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
            found.append((np.full(len(track), self._index_of[label]), track, shared, np.bincount(which, square)))
        if found:
            target, track, shared, more = (np.concatenate(column) for column in zip(*found, strict=True))
            # The rounding of each addition is kept with the sum (Neumaier 1974)
            before = self._sums.at(target, track)[1]
            total = before + more
            lost = np.where(before >= more, (before - total) + more, (more - total) + before)
            self._sums.add(target, track, np.stack([shared, more, lost]))

    def pairs(self) -> dict[int, int]:
        """Return the target of each track by identity: the one-to-one pairs with the least overall RMSE.

        Tracks and targets without a counterpart are omitted.
        """
        target, track, (shared, squares, lost) = self._sums.all()
        made = pair_by_sums(track, target, shared, squares + lost, self._worst)
        return {self._tracks[track[n]]: self._targets[target[n]] for n in made.tolist()}


class TrackErrors:
    """Accumulates the errors of tracks against their targets, and their figures."""

    def __init__(
        self,
        known: EvaluationSurvey,
        pairs: Mapping[int, int],
        config: EvaluateConfig,
        unit: str,
        in_memory: int = NUMBERS_IN_MEMORY,
    ) -> None:
        """Start without estimates.

        Args:
            known: identities and times of all tracks and targets.
            pairs: target of each track, by identity.
            config: limits in time, settling time.
            unit: unit of lengths.
            in_memory: how many distances are kept in memory; more go to a temporary file.
        """
        self._known, self._pairs, self._config = known, pairs, config
        self._track_of = {target: track for track, target in pairs.items()}
        self._figures, self._late = ErrorFigures(unit, in_memory), ErrorFigures(unit, in_memory)
        self._gaps, self._begun = Gaps(), dict[int, int]()
        self._transient = config.settling_s > 0 or config.from_ns is not None
        self._left_out = self._interpolated = self._covered = 0
        self.late: Bools = np.zeros(0, dtype=np.bool_)
        """Errors of the last section after the transient; none without one."""

    def update(self, part: EvaluationChunk) -> Errors:
        """Add the estimates of a time interval (`part`), in the order of time; return their errors."""
        config, nothing = self._config, ObjectPath(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
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
        self._figures.update(errors)
        self.late = np.zeros(len(errors), dtype=np.bool_)
        if self._transient and len(errors):
            self.late = settled(errors, config, self._begun)
            self._late.update(errors.take(self.late))
        return errors

    @property
    def rows(self) -> int:
        """Number of errors so far."""
        return self._figures.rows

    @property
    def note(self) -> str | None:
        """Note about estimates in wide gaps of the truth; None if there are few."""
        return self._gaps.note

    def result(self) -> Metrics:
        """Return counts of estimates, tracks and targets, and all figures of the errors, by name.

        Raises:
            InputError: the truth covers the time of no estimate.
        """
        known, figures, matched = self._known, self._figures, self._pairs
        if not figures.rows and known.tracks_ns is not None and known.truth_ns is not None:
            raise errors_of_pairs(known.tracks_ns, known.truth_ns, self._config)
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
            "time_coverage": ratio_or_nan(self._covered, sum(life.rows for life in known.targets.values())),
            **figures.result(),
        }
        if known.unknown:
            metrics = {name: value for name, value in metrics.items() if not name.startswith("nees_")}
        return metrics

    def settled(self, bound: Callable[[], Metrics] | None = None) -> Metrics:
        """Return the figures of the errors after the settling time, named `settled_...`; empty without a settling time.

        `bound`: returns the figures of the Cramer-Rao bound for that time, which are added; None: none.
        """
        if not (self._transient and self._figures.rows):
            return {}
        after = {**self._late.result(), "estimates": self._late.rows}
        after |= {} if bound is None or not self._late.rows else bound()
        return {f"settled_{name}": value for name, value in after.items()}
