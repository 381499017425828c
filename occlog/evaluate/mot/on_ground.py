"""Tracks of many targets on the ground against true positions, as points at the times of the truth.

Beside the figures of `figures`: MODA and MODP, OSPA(2), trajectory GOSPA, whether covariances say how far tracks are
from the targets that they are on, and how many people there are and were found over time.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from occlog.array_types import Ints
from occlog.core.metrics.clear_mot import ClearRule, Matches, clear_mot, match
from occlog.core.metrics.errors import (
    CHI2_95_2D,
    normalised_squared_errors,
    quantile,
    ratio,
    root_mean_square,
)
from occlog.core.metrics.frame_pairs import Frames, Objects, of_points
from occlog.core.metrics.ospa2 import ospa2, ospa2_over_time
from occlog.core.metrics.trajectory_gospa import trajectory_gospa
from occlog.errors import InputError
from occlog.evaluate.matching.paths import Path, paths_of
from occlog.evaluate.stage import Evaluation
from occlog.records.tables import Tracks, Truth
from occlog.records.views import Counts

from .config import ManyConfig
from .figures import RULES, Metrics, failure_figures, mot_figures, power_of
from .stage import Places, failure_rows, find_failures, without_common_numbers

EACH_FRAME = ClearRule(memory=0)
"""Pairs of each frame alone, as many as can be: detections without identities."""


def evaluate_ground(
    tracks: Tracks,
    truth: Truth,
    config: ManyConfig,
    limit_ns: int | None,
    unit: str = "m",
    times: Ints | None = None,
) -> Evaluation:
    """Figures of points (x, y); heights are not looked at.

    A frame is a time at which the truth has a sample of any target.  Truth and tracks are
    interpolated to it, the truth over gaps of at most `limit_ns`, tracks over gaps of at most
    `config.track_gap_s`; nothing is extrapolated, so that a track that begins late misses its
    target until then.  Of an empty truth, which says that nobody is there, every time of the tracks is a frame.

    Args:
        tracks: estimates of any number of targets.
        truth: rows of role `target` are used.
        config: options; `match_distance` is at once the distance at which a pair still meets, and tau.
        limit_ns: widest gap of the truth that is bridged [ns]; None: by the usual time between its rows.
        unit: of lengths.
        times: of the frames, if not `times_of` the truth.

    Raises:
        InputError: no distance is given, or the truth has rows, but no target.
    """
    if config.match_distance is None:
        raise InputError("evaluate: targets and tracks on the ground need a distance at which they meet")
    times = times_of(tracks, truth) if times is None else times
    places = points_in_true_frames(tracks, truth, times, config, limit_ns, unit)
    found = find_failures(places, config)
    frames = of_points(places.truth, places.tracks, config.match_distance)
    cells = len(places.t_ns[0])
    metrics = failure_figures(found, found.frame >= 0, len(places.truth.frame))
    metrics |= {"objects_interpolated": _interpolated(places, truth)}
    metrics |= mot_figures(frames, config, cells, unit=unit) | {"frames": cells}
    made = match(frames, RULES[config.clear_rule])
    counts = counts_over_time(frames, made, places)
    metrics |= detection_figures(places, config) | trajectory_figures(frames, config, cells, unit)
    metrics |= pair_figures(frames, match(frames, EACH_FRAME), places, tracks, unit) | count_figures(counts)
    flat = {name: float(value) for name, value in metrics.items()}
    notes = tuple(without_common_numbers(places, config))
    return Evaluation(flat, failures=failure_rows(found, places), counts=counts, notes=notes)


def detection_figures(places: Places, config: ManyConfig) -> Metrics:
    """MODA and MODP: how many people are found, and how near, whatever their identities.

    MODA = 1 - (missed + false) / objects and MODP = mean of 1 - d / limit over the pairs of all frames together, as the
    evaluation of WILDTRACK has them (Chavdarova et al. 2018; Kasturi et al. 2009), within `moda_distance`.
    """
    limit = config.moda_distance or config.match_distance
    if limit is None:
        return {}
    got = clear_mot(of_points(places.truth, places.tracks, limit), EACH_FRAME)
    return {
        "moda": 1.0 - ratio(got.fp + got.fn, got.objects),
        "modp": 1.0 - got.motp / limit,
        "moda_missed": got.fn,
        "moda_false": got.fp,
    }


def trajectory_figures(frames: Frames, config: ManyConfig, cells: int, unit: str) -> Metrics:
    """OSPA(2) and trajectory GOSPA.

    Args:
        frames: truth and tracks as points.
        config: how.
        cells: number of frames, empty ones included, over which trajectory GOSPA is averaged.
        unit: of lengths.
    """
    cutoff, p = config.ospa_cutoff or frames.limit, config.ospa_p
    whole = ospa2(frames, cutoff, p)
    out: Metrics = {
        f"ospa2_{unit}": whole.ospa2,
        f"ospa2_localisation_{unit}": whole.localisation,
        f"ospa2_cardinality_{unit}": whole.cardinality,
    }
    if config.ospa_window is not None:
        parts = ospa2_over_time(frames, cutoff, p, config.ospa_window, range(cells))
        out[f"ospa2_window_{unit}"] = float(np.mean([part.ospa2 for part in parts]))
    cutoff = config.gospa_cutoff or frames.limit
    got = trajectory_gospa(frames, cutoff, config.gospa_switch or cutoff, config.gospa_p)
    power, n = power_of(config, unit), max(cells, 1)
    out[f"tgospa_{unit}"] = (got.total / n) ** (1.0 / got.p)
    for name in ("localisation", "missed", "false", "switch"):
        out[f"tgospa_{name}_{unit}{power}"] = getattr(got, name) / n
    return out


def pair_figures(frames: Frames, made: Matches, places: Places, tracks: Tracks, unit: str) -> Metrics:
    """Errors of tracks from the targets that they are on, frame by frame, whatever their identities.

    Pairs are made anew in each frame: CLEAR-MOT's keep a track that has gone over to a neighbour as long as it is near.
    Covariances are judged where the track has a row of its own at the time: an interpolated one has none.  A pair is
    within the match distance, which bounds the error: a NEES that is to be 2 is a little less where standard deviations
    come near a third of it.
    """
    true, ours = frames.truth_row[made.truth], frames.track_row[made.track]
    error = places.tracks.place[ours] - places.truth.place[true]
    times, labels = places.t_ns[0][places.tracks.frame[ours]], places.tracks.label[ours]
    row = _rows_at(tracks, times, labels)
    own = row >= 0
    at = tracks.take(row[own])
    covariance = np.stack([at.cov_xx, at.cov_xy, at.cov_xy, at.cov_yy], axis=1).reshape(-1, 2, 2)
    nees = normalised_squared_errors(error[own], covariance)
    told = nees[np.isfinite(nees)]
    distance = np.hypot(error[:, 0], error[:, 1])
    return {
        f"pairs_rmse_{unit}": root_mean_square(distance),
        f"pairs_error_median_{unit}": quantile(distance, 0.5),
        f"pairs_error_p95_{unit}": quantile(distance, 0.95),
        "pairs_nees_mean": ratio(float(told.sum()), len(told)),
        "pairs_nees_share_95": ratio(int(np.count_nonzero(told <= CHI2_95_2D)), len(told)),
        "pairs_nees_compared": len(told),
    }


def _rows_at(tracks: Tracks, times: Ints, labels: Ints) -> Ints:
    """Row of each track at each time; -1 where it has none."""
    order = np.lexsort((tracks.target_id, tracks.t_ns))
    keys = list(zip(tracks.t_ns[order].tolist(), tracks.target_id[order].tolist(), strict=True))
    place = dict(zip(keys, order.tolist(), strict=True))
    wanted = zip(times.tolist(), labels.tolist(), strict=True)
    return np.array([place.get(key, -1) for key in wanted], dtype=np.int64)


def counts_over_time(frames: Frames, made: Matches, places: Places) -> Counts:
    """How many targets and tracks there are in each frame, and how many of them are pairs."""
    cells = len(places.t_ns[0])
    true = np.bincount(places.truth.frame, minlength=cells)
    found = np.bincount(places.tracks.frame, minlength=cells)
    paired = np.bincount(frames.frame[made.frame], minlength=cells)
    switched = np.bincount(frames.frame[made.frame[made.switch]], minlength=cells)
    return Counts.of(
        t_ns=places.t_ns[0],
        frame=places.number[0],
        targets=true,
        tracks=found,
        paired=paired,
        missed=true - paired,
        false=found - paired,
        switches=switched,
    )


def count_figures(counts: Counts) -> Metrics:
    """Mean number of targets and of tracks, and the difference: its mean, root mean square and largest."""
    off = (counts.tracks - counts.targets).astype(np.float64)
    n = len(counts)
    return {
        "count_targets_mean": ratio(float(counts.targets.sum()), n),
        "count_tracks_mean": ratio(float(counts.tracks.sum()), n),
        "count_error_mean": ratio(float(off.sum()), n),
        "count_error_rms": root_mean_square(off),
        "count_error_max": float(np.abs(off).max(initial=0.0)),
    }


def _interpolated(places: Places, truth: Truth) -> int:
    """True objects at times of which the truth has no row for them, but for others."""
    paths, times = paths_of(truth, "target"), places.t_ns[0]
    mine = ((path, times[places.truth.frame[places.truth.label == k]]) for k, path in paths.items())
    return sum(int(np.count_nonzero(~path.sampled(at))) for path, at in mine)


def times_of(tracks: Tracks, truth: Truth) -> Ints:
    """(T,) times at which the truth has a target [ns]; those of the tracks where it is empty."""
    return np.unique(truth.t_ns[truth.role == "target"] if len(truth) else tracks.t_ns)


def points_in_true_frames(
    tracks: Tracks, truth: Truth, times: Ints, config: ManyConfig, limit_ns: int | None, unit: str
) -> Places:
    """Truth and tracks at the times of the frames, as the one view without a name."""
    targets = paths_of(truth, "target")
    if len(truth) and not targets:
        raise InputError("truth: has no rows of role target; nothing to compare with")
    left = _points(targets, times, limit_ns)
    right = _points(paths_of(tracks), times, config.gap_ns(limit_ns))
    tau = np.full(len(left.frame), config.match_distance)
    return Places(
        truth=left,
        tracks=right,
        tau=tau,
        views=("",),
        t_ns=(times,),
        number=(np.arange(len(times)),),
        visible=np.full(len(tau), np.nan),
        unit=unit,
    )


def _points(paths: Mapping[int, Path], times: Ints, limit_ns: int | None) -> Objects:
    """Where each path is at these times; no row where that is not known."""
    parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))]
    for label, path in paths.items():
        xy, good = path.at(times, limit_ns)
        rows = np.flatnonzero(good)
        parts.append((rows.astype(np.int64), np.full(len(rows), label, dtype=np.int64), xy[rows]))
    frame, name, place = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Objects(frame, name, place)
