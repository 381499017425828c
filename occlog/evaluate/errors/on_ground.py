"""Errors of tracks: which track is of which target, the error of each estimate, and figures of the errors.

Errors are those of (x, y).  Where a track has heights and its target's height is known, errors in space
stand beside them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Bools, Floats
from occlog.core.metrics.errors import (
    CHI2_95_2D,
    CHI2_95_3D,
    ErrorSums,
    add_sums,
    error_sums,
    normalised_squared_errors,
    normalised_squared_errors_in_space,
    pair_tracks,
    quantile,
    ratio,
    root_mean_square,
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


def space_metrics(errors: Errors, unit: str, whose: str) -> Metrics:
    """RMSE along z and in space and consistency there (mean NEES 3); nothing if no error in space is known.

    Over the errors in space only, which may be fewer than those on the ground.
    """
    high = errors.take(in_space(errors))
    if not len(high):
        return {}
    nees = high.nees_space[np.isfinite(high.nees_space)]
    return {
        f"rmse_z{whose}_{unit}": root_mean_square(high.error_z),
        f"rmse_space{whose}_{unit}": root_mean_square(high.error_space),
        f"nees_space_mean{whose}": ratio(float(nees.sum()), len(nees)),
        f"nees_space_share_95{whose}": ratio(int(np.count_nonzero(nees <= CHI2_95_3D)), len(nees)),
        f"nees_space_singular{whose}": len(high) - len(nees),
        f"estimates_space{whose}": len(high),
    }


def space_spread(errors: Errors, unit: str) -> Metrics:
    """Mean and quantiles of the distance in space, and the mean error along z; nothing if none is known."""
    high = errors.take(in_space(errors))
    if not len(high):
        return {}
    return {
        f"error_space_mean_{unit}": ratio(float(high.error_space.sum()), len(high)),
        f"error_space_median_{unit}": quantile(high.error_space, 0.5),
        f"error_space_p95_{unit}": quantile(high.error_space, 0.95),
        f"error_space_max_{unit}": quantile(high.error_space, 1.0),
        f"bias_z_{unit}": ratio(float(high.error_z.sum()), len(high)),
    }


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


def gaps_note(tracks: Tracks, truth: Truth, pairs: Mapping[int, int], config: EvaluateConfig) -> str | None:
    """A line where most of the estimates during the truth fall into gaps of it that are not bridged; else None."""
    targets = paths_of(truth, "target")
    inside = missed = 0
    widest = 0.0
    for track, target in pairs.items():
        path = targets[target]
        t_ns = tracks.t_ns[tracks.target_id == track]
        t_ns = t_ns[(t_ns >= path.t_ns[0]) & (t_ns <= path.t_ns[-1])]
        unknown = int(np.count_nonzero(~path.at(t_ns, config.limit_ns)[1]))
        inside, missed = inside + len(t_ns), missed + unknown
        if unknown:
            widest = max(widest, (path.usual_gap_ns if config.limit_ns is None else config.limit_ns) / NS)
    if 2 * missed <= inside:
        return None
    return (
        f"warning: {missed} of {inside} estimates fall into gaps of the truth that are wider than {widest:.3g} s, "
        "which are not bridged: no figure knows of their errors; where the truth holds still or runs straight "
        "over such a gap, bridge it (max_gap)"
    )


def compare(tracks: Tracks, truth: Truth, config: EvaluateConfig) -> Matched:
    """Errors of every estimate that has a truth near enough in time, and counts of those that have not.

    InputError if the truth covers the time of no estimate at all.
    """
    pairs = match_tracks(tracks, truth, config)
    targets = paths_of(truth, "target")
    parts, left_out, interpolated = [], 0, 0
    for track, target in pairs.items():
        rows = tracks.take(tracks.target_id == track)
        part, good = _errors(rows, target, targets[target], config)
        parts.append(part)
        left_out += int(np.count_nonzero(~good))
        interpolated += int(np.count_nonzero(~targets[target].sampled(part.t_ns)))
    errors = Errors.merge(parts)
    if not len(errors) and len(tracks) and len(truth):
        raise InputError(
            f"tracks: the truth covers the time of no estimate: tracks {_span(tracks)}, truth {_span(truth)}, "
            f"gaps of at most {config.bridge_s:g} s are bridged; check the clocks or raise max_gap"
        )
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


def _span(table: Tracks | Truth) -> str:
    return f"{table.t_ns[0]} to {table.t_ns[-1]} ns" if len(table) else "has no rows"


def _errors(rows: Tracks, target: int, path: Path, config: EvaluateConfig) -> tuple[Errors, Bools]:
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


def settled(errors: Errors, config: EvaluateConfig) -> Bools:
    """(N,) bool: errors after the transient, by `skip_s` after each target's first estimate and `from_ns`."""
    keep = np.ones(len(errors), dtype=np.bool_)
    for target in np.unique(errors.target_id):
        rows = errors.target_id == target
        keep[rows] = errors.t_ns[rows] >= errors.t_ns[rows][0] + round(config.skip_s * NS)
    if config.from_ns is not None:
        keep &= errors.t_ns >= config.from_ns
    return keep


def error_metrics(errors: Errors, unit: str) -> Metrics:
    """Figures over all targets, from sums over all rows, then for each target."""
    parts = {int(k): errors.take(errors.target_id == k) for k in np.unique(errors.target_id)}
    sums = {k: error_sums(_xy(part)) for k, part in parts.items()}
    out = _accuracy(add_sums(sums.values()), unit, "") | _spread(errors, unit) | _consistency(errors, "")
    out |= space_metrics(errors, unit, "") | space_spread(errors, unit)
    for k, part in parts.items():
        out |= _accuracy(sums[k], unit, f"_target_{k}") | _consistency(part, f"_target_{k}")
        out |= space_metrics(part, unit, f"_target_{k}")
        out[f"estimates_target_{k}"] = len(part)
    return out


def _xy(errors: Errors) -> Floats:
    return np.column_stack([errors.error_x, errors.error_y])


def _accuracy(sums: ErrorSums, unit: str, whose: str) -> Metrics:
    return {
        f"rmse{whose}_{unit}": sums.rmse,
        f"rmse_x{whose}_{unit}": sums.rmse_x,
        f"rmse_y{whose}_{unit}": sums.rmse_y,
    }


def _spread(errors: Errors, unit: str) -> Metrics:
    return {
        f"error_mean_{unit}": ratio(float(errors.error.sum()), len(errors)),
        f"error_median_{unit}": quantile(errors.error, 0.5),
        f"error_p95_{unit}": quantile(errors.error, 0.95),
        f"error_max_{unit}": quantile(errors.error, 1.0),
        f"bias_x_{unit}": ratio(float(errors.error_x.sum()), len(errors)),
        f"bias_y_{unit}": ratio(float(errors.error_y.sum()), len(errors)),
    }


def _consistency(errors: Errors, whose: str) -> Metrics:
    """Mean NEES (2 where the covariance says what the errors are) and the share inside the 95 % ellipse."""
    nees = errors.nees[np.isfinite(errors.nees)]
    return {
        f"nees_mean{whose}": ratio(float(nees.sum()), len(nees)),
        f"nees_share_95{whose}": ratio(int(np.count_nonzero(nees <= CHI2_95_2D)), len(nees)),
        f"nees_singular{whose}": len(errors) - len(nees),
    }
