"""Tracks of many targets on the ground against true positions, as points at the times of the truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from occlog.array_types import Ints
from occlog.core.metrics.frame_pairs import Objects, of_points
from occlog.errors import InputError
from occlog.evaluate.evaluation import Evaluation
from occlog.evaluate.matching.paths import Path, paths_of
from occlog.records.tables import Tracks, Truth

from .config import ManyConfig
from .figures import failure_figures, mot_figures
from .stage import Places, failure_rows, find_failures, without_common_numbers


def evaluate_ground(tracks: Tracks, truth: Truth, config: ManyConfig, limit_ns: int, unit: str = "m") -> Evaluation:
    """Figures of points (x, y); heights are not looked at.

    A frame is a time at which the truth has a sample of any target.  Truth and tracks are
    interpolated to it, over gaps of at most `limit_ns` and `config.track_gap_s`; nothing is
    extrapolated, so that a track that begins late misses its target until then.

    Args:
        tracks: estimates of any number of targets.
        truth: rows of role `target` are used.
        config: options; `match_distance` is at once the distance at which a pair still meets, and tau.
        limit_ns: widest gap of the truth that is bridged [ns].
        unit: of lengths.

    Raises:
        InputError: no distance is given, or the truth has no target.
    """
    if config.match_distance is None:
        raise InputError("evaluate: targets and tracks on the ground need a distance at which they meet")
    places = points_in_true_frames(tracks, truth, config, limit_ns, unit)
    found = find_failures(places, config)
    frames = of_points(places.truth, places.tracks, config.match_distance)
    metrics = failure_figures(found, found.frame >= 0, len(places.truth.frame))
    metrics |= mot_figures(frames, config, len(places.t_ns[0]), unit=unit) | {"frames": len(places.t_ns[0])}
    flat = {name: float(value) for name, value in metrics.items()}
    return Evaluation(flat, failures=failure_rows(found, places), notes=tuple(without_common_numbers(places, config)))


def points_in_true_frames(tracks: Tracks, truth: Truth, config: ManyConfig, limit_ns: int, unit: str) -> Places:
    """Truth and tracks at the times of the truth, as the one view without a name."""
    targets = paths_of(truth, "target")
    if not targets:
        raise InputError("truth: has no rows of role target; nothing to compare with")
    times = np.unique(truth.t_ns[truth.role == "target"])
    left = _points(targets, times, limit_ns)
    right = _points(paths_of(tracks), times, config.gap_ns(limit_ns))
    tau = np.full(len(left.frame), config.match_distance)
    return Places(left, right, tau, ("",), (times,), (np.arange(len(times)),), np.full(len(tau), np.nan), unit)


def _points(paths: Mapping[int, Path], times: Ints, limit_ns: int) -> Objects:
    """Where each path is at these times; no row where that is not known."""
    parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))]
    for label, path in paths.items():
        xy, good = path.at(times, limit_ns)
        rows = np.flatnonzero(good)
        parts.append((rows.astype(np.int64), np.full(len(rows), label, dtype=np.int64), xy[rows]))
    frame, name, place = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Objects(frame, name, place)
