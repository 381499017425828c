"""Errors of tracks: which track is of which target, and the error of each estimate.

Errors are those of (x, y).  Where a track has heights and its target's height is known, errors in space
stand beside them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats, Ints
from occlog.core.metrics.errors import (
    normalised_squared_errors,
    normalised_squared_errors_in_space,
    pair_tracks,
    ratio,
)
from occlog.errors import InputError
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.paths import Path, paths_of
from occlog.records.tables import Errors, Tracks, Truth

Metrics = dict[str, float]


def errors_in_space(tracks: Tracks, error: Floats, covariance: Floats, truth_z: Floats) -> dict[str, Floats]:
    """The columns of `Errors` about heights, NaN where the estimate or the truth has none.

    Args:
        tracks: N estimates.
        error: (N, 2) their errors on the ground.
        covariance: (N, 2, 2) theirs on the ground.
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


def in_space(errors: Errors) -> Bools:
    """(N,) bool: errors of estimates whose height and true height are known."""
    return np.isfinite(errors.error_space)


class Matched(NamedTuple):
    """Errors of the matched tracks and what was left out."""

    errors: Errors
    pairs: dict[int, int]  # identity of a track -> identity of its target
    counts: Metrics


def match_tracks(tracks: Tracks, truth: Truth, config: EvaluateConfig) -> dict[int, int]:
    """Which target each track is of: the one of its own number, or the assignment of least overall RMSE.

    Tracks that are of no target are left out.  InputError if none is of any, unless the truth is empty.
    """
    if not len(truth):
        return {}
    targets, estimated = paths_of(truth, "target"), paths_of(tracks)
    if not targets:
        raise InputError("truth: has no rows of role target; nothing to compare with")
    if config.match == "id":
        pairs = {track: track for track in estimated if track in targets}
        if estimated and not pairs:
            raise InputError(
                f"tracks: no track number ({_some(list(estimated))}) is a target of the truth "
                f"({_some(list(targets))}); pair them by distance (match optimal)"
            )
        return pairs
    squares = [[_squares(path, target, config) for target in targets.values()] for path in estimated.values()]
    names, goals = list(estimated), list(targets)
    return {names[i]: goals[j] for i, j in pair_tracks(squares)}


def _some(numbers: list[int]) -> str:
    shown = ", ".join(str(n) for n in numbers[:8])
    return f"{shown}, ..." if len(numbers) > 8 else shown or "none"


def _squares(path: Path, target: Path, config: EvaluateConfig) -> Floats:
    true, good = target.at(path.t_ns, config.limit_ns)
    return np.asarray(np.sum((path.xy[good] - true[good]) ** 2, axis=1))


class Gaps:
    """Counts estimates during the truth, and those of them that fall into gaps of it that are not bridged."""

    def __init__(self) -> None:
        """No estimates yet."""
        self._inside = self._missed = self._widest_ns = 0

    def add(self, t_ns: Ints, path: Path, span_ns: tuple[int, int], config: EvaluateConfig) -> None:
        """Some more estimates of one track.

        Args:
            t_ns: their times.
            path: of the target, or the part of it about these times.
            span_ns: first and last time of the whole path.
            config: how far apart samples of the truth may be.
        """
        t_ns = t_ns[(t_ns >= span_ns[0]) & (t_ns <= span_ns[1])]
        unknown = int(np.count_nonzero(~path.at(t_ns, config.limit_ns)[1]))
        self._inside, self._missed = self._inside + len(t_ns), self._missed + unknown
        if unknown:
            self._widest_ns = max(self._widest_ns, path.usual_gap_ns if config.limit_ns is None else config.limit_ns)

    @property
    def note(self) -> str | None:
        """A line where most of the estimates during the truth fall into such gaps; else None."""
        if 2 * self._missed <= self._inside:
            return None
        return (
            f"warning: {self._missed} of {self._inside} estimates fall into gaps of the truth that are wider than "
            f"{self._widest_ns / NS:.3g} s, which are not bridged: no figure knows of their errors; where the truth "
            "holds still or runs straight over such a gap, bridge it (max_gap)"
        )


def gaps_note(tracks: Tracks, truth: Truth, pairs: Mapping[int, int], config: EvaluateConfig) -> str | None:
    """What `Gaps` says of whole tables."""
    targets, found = paths_of(truth, "target"), Gaps()
    for track, target in pairs.items():
        t_ns = targets[target].t_ns
        found.add(tracks.t_ns[tracks.target_id == track], targets[target], (int(t_ns[0]), int(t_ns[-1])), config)
    return found.note


def compare(tracks: Tracks, truth: Truth, config: EvaluateConfig) -> Matched:
    """Errors of every estimate that has a truth near enough in time, and counts of those that have not.

    InputError if the truth covers the time of no estimate at all.
    """
    pairs = match_tracks(tracks, truth, config)
    targets = paths_of(truth, "target")
    parts, left_out, interpolated = [], 0, 0
    for track, target in pairs.items():
        rows = tracks.take(tracks.target_id == track)
        part, good = errors_of(rows, target, targets[target], config)
        parts.append(part)
        left_out += int(np.count_nonzero(~good))
        interpolated += int(np.count_nonzero(~targets[target].sampled(part.t_ns)))
    errors = Errors.merge(parts)
    if not len(errors) and len(tracks) and len(truth):
        raise apart((tracks.t_ns[0], tracks.t_ns[-1]), (truth.t_ns[0], truth.t_ns[-1]), config)
    matched = np.isin(tracks.target_id, list(pairs))
    counts: Metrics = {
        "estimates": len(errors),
        "estimates_without_truth": left_out,
        "estimates_interpolated_truth": interpolated,
        "estimates_unmatched": int(np.count_nonzero(~matched)),
        "tracks": len(np.unique(tracks.target_id)),
        "tracks_unmatched": len(np.unique(tracks.target_id[~matched])),
        "targets": len(targets),
        "targets_unmatched": len(set(targets) - set(pairs.values())),
        "time_coverage": _coverage(tracks, targets, pairs, config),
    }
    return Matched(errors, pairs, counts)


def apart(tracks_ns: tuple[int, int], truth_ns: tuple[int, int], config: EvaluateConfig) -> InputError:
    """What is said where the truth covers the time of no estimate; first and last times of both."""
    tracks, truth = (f"{first} to {last} ns" for first, last in (tracks_ns, truth_ns))
    if config.match == "id" and tracks_ns[0] <= truth_ns[1] and truth_ns[0] <= tracks_ns[1]:
        return InputError(
            f"tracks: no track has an estimate while the truth has its target, the one of its number: tracks {tracks}, "
            f"truth {truth}, gaps of at most {config.bridge_s:g} s are bridged; pair them by their places (match "
            "optimal) if numbers are not those of the truth, or check the clocks or raise max_gap"
        )
    return InputError(
        f"tracks: the truth covers the time of no estimate: tracks {tracks}, truth {truth}, "
        f"gaps of at most {config.bridge_s:g} s are bridged; check the clocks or raise max_gap"
    )


def errors_of(rows: Tracks, target: int, path: Path, config: EvaluateConfig) -> tuple[Errors, Bools]:
    """Errors of the estimates of a target, and (N,) which of them have a truth near enough in time.

    Args:
        rows: N estimates of one track.
        target: identity in the truth.
        path: of the target.
        config: how far apart samples of the truth may be.
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


def _coverage(tracks: Tracks, targets: dict[int, Path], pairs: dict[int, int], config: EvaluateConfig) -> float:
    """Share of the targets' true positions at which their track gives one too (interpolated under the same limit)."""
    estimated = {pairs[k]: path for k, path in paths_of(tracks).items() if k in pairs}
    covered = sum(
        int(np.count_nonzero(estimated[k].at(path.t_ns, config.bridge_ns)[1]))
        for k, path in targets.items()
        if k in estimated
    )
    return ratio(covered, sum(len(path.t_ns) for path in targets.values()))


def settled(errors: Errors, config: EvaluateConfig, begun: dict[int, int] | None = None) -> Bools:
    """(N,) bool: errors after the transient, by `skip_s` after each target's first estimate and `from_ns`.

    Args:
        errors: in the order of time.
        config: length of the transient.
        begun: first estimate of each target of the rows before these, to which those of these rows are added.
    """
    first = {} if begun is None else begun
    keep = np.ones(len(errors), dtype=np.bool_)
    for target in np.unique(errors.target_id).tolist():
        rows = errors.target_id == target
        keep[rows] = errors.t_ns[rows] >= first.setdefault(target, int(errors.t_ns[rows][0])) + round(
            config.skip_s * NS
        )
    if config.from_ns is not None:
        keep &= errors.t_ns >= config.from_ns
    return keep
