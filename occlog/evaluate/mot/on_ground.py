"""Tracks of many targets on the ground against true positions, as points at the times of the truth.

In addition to the figures of `figures`: MODA and MODP, OSPA(2), trajectory GOSPA, consistency of covariances with the
errors of per-frame pairs, and numbers of targets and tracks over time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from occlog.array_types import Bools, Floats, Ints
from occlog.core.metrics.errors import CHI2_95_2D, Sum, normalised_squared_errors, ratio_or_nan
from occlog.core.metrics.mot.clear_mot import ClearCounts, ClearRule, MatchedPairs, Matcher
from occlog.core.metrics.mot.frame_pairs import MatchedFrames, Objects, numbered, of_points
from occlog.core.metrics.mot.gospa import Ospa2Sums, Ospa2Windows
from occlog.core.metrics.mot.trajectory_gospa import TrajectoryCosts
from occlog.errors import InputError, option
from occlog.evaluate.errors.on_ground import no_targets
from occlog.evaluate.errors.sums import Consistency, Spread
from occlog.evaluate.errors.survey import EvaluationSurvey, survey
from occlog.evaluate.matching.paths import ObjectPath, paths_of
from occlog.evaluate.results import Evaluation
from occlog.io.files.spill import NUMBERS_IN_MEMORY
from occlog.records.declared.views import Counts, Failures
from occlog.records.tables import Tracks, Truth

from .config import MultiTargetConfig
from .figures import FailureCounts, Metrics, MotFigures, power_of
from .stage import AssignedTargets, PointTracks, failure_rows, find_failures, unrelated_ids_note

EACH_FRAME = ClearRule(memory=0)
"""Pairs of each frame alone, as many as can be: detections without identities."""


def evaluate_ground(
    tracks: Tracks,
    truth: Truth,
    config: MultiTargetConfig,
    limit_ns: int | None,
    unit: str = "m",
) -> Evaluation:
    """Evaluate tracks on the ground as points (x, y) by multi-target metrics; heights are ignored.

    A frame is a time at which the truth has a sample of any target. Truth and tracks are interpolated to it, the truth
    over gaps of at most `limit_ns`, tracks over gaps of at most `config.track_gap_s`; nothing is extrapolated, so that
    a track that begins late misses its target until then. If the truth is empty (no target is present), every time of
    the tracks is a frame.

    Args:
        tracks: estimates of any number of targets.
        truth: rows of role `target` are used.
        config: options; `match_distance` is both the gate of a match and the distance limit tau of failures.
        limit_ns: widest gap of the truth that is interpolated [ns]; None: by the usual interval of its rows.
        unit: unit of lengths.

    Raises:
        InputError: no distance is given, or the truth has rows, but no target.
    """
    known = survey(iter([tracks]), iter([truth]))
    times = times_of(tracks, truth)
    points = points_in_true_frames(tracks, truth, times, config, limit_ns, unit)
    found = GroundFigures.of(known, config, unit)
    part = EvaluatedPart(points, 0, tracks, paths_of(truth, "target"))
    found.prepare(part)
    counts, failures = found.update(part)
    return Evaluation(found.result(), failures=failures, counts=counts, notes=tuple(found.notes()))


class EvaluatedPart(NamedTuple):
    """Frames of a part of a recording on the ground.

    `points`: truth and tracks interpolated at the frame times; `begin`: number of frames before; `rows`: rows of the
    tracks at these times, perhaps others too; `targets`: true paths around these times; `over`: masks of the targets
    and tracks without later rows, None: unknown.
    """

    points: PointTracks
    begin: int  # number of frames before it
    rows: Tracks  # rows of the tracks at the times of these frames, and perhaps others
    targets: Mapping[int, ObjectPath]  # true positions at these times, and perhaps others
    over: tuple[Bools, Bools] | None = None  # of each target and track whether no row is to come; None: not known


class FramePairs(NamedTuple):
    """n pairs of a target and a track, each in one frame.

    Attributes:
        target: (n,) identity of the target.
        t_ns: (n,) times [ns].
        error: (n, 2) estimate minus truth, where the estimate may be interpolated between rows of the track.
        own: (n,) whether the track has a row at that time.
        nees: (number of those,) normalised estimation errors squared of the pairs in `own`.
    """

    target: Ints
    t_ns: Ints
    error: Floats
    own: Bools
    nees: Floats


class GroundFigures:
    """Accumulates all multi-target figures on the ground over parts of a recording, in two passes: `prepare`, `update`.

    Memory grows with the number of targets and tracks, not of frames, except for intervals in which later frames may
    change the pairs of trajectory GOSPA.
    """

    def __init__(
        self,
        targets: Ints,
        tracks: Ints,
        frames: int,
        config: MultiTargetConfig,
        unit: str,
        in_memory: int = NUMBERS_IN_MEMORY,
    ) -> None:
        """Start without frames.

        Args:
            targets: all identities of targets, ascending; additional ones do no harm.
            tracks: all identities of tracks, ascending.
            frames: number of all frames.
            config: options, with a match distance.
            unit: unit of lengths.
            in_memory: how many distances are kept in memory; more go to a temporary file.

        Raises:
            InputError: no match distance is given.
        """
        limit = config.match_distance
        if limit is None:
            raise InputError(
                f"evaluate: matching on the ground needs a largest match distance; give {option('match_distance')}",
                id="missing-option",
            )
        g, k = len(targets), len(tracks)
        self._config, self._unit, self._cells, self._limit = config, unit, frames, limit
        self._keys = tuple(np.column_stack([np.zeros(len(each), np.int64), each]) for each in (targets, tracks))
        none = np.zeros(0, dtype=np.int64)
        empty = Objects(none, none, np.zeros((0, 2)))
        self._mot = MotFigures(numbered(of_points(empty, empty, limit), *self._keys), config)
        self._owners, self._failures = AssignedTargets(config.assigned_target), FailureCounts()
        self._interpolated = np.zeros(2, dtype=np.int64)  # positions of the truth and of tracks
        self._labels: tuple[set[int], set[int]] = set(), set()
        self._moda_limit = config.moda_distance or limit
        self._moda_matcher, self._moda = Matcher(g, EACH_FRAME), ClearCounts(g)
        cutoff, p = config.ospa_cutoff or limit, config.ospa_p
        self._ospa2 = Ospa2Sums(g, k, cutoff, p)
        self._windows = None if config.ospa_window is None else Ospa2Windows(g, k, cutoff, p, config.ospa_window)
        self._window_sum = Sum()
        cutoff = config.gospa_cutoff or limit
        self._trajectories = TrajectoryCosts(
            frames, g, k, cutoff, config.gospa_switch_penalty or cutoff, config.gospa_p
        )
        self._each_matcher, self._pairs = Matcher(g, EACH_FRAME), PairErrors(unit, in_memory)
        self._counts = CountSums()
        self.pairs = FramePairs(none, none, np.zeros((0, 2)), none.astype(np.bool_), np.zeros(0))
        """Pairs of the last part."""

    @classmethod
    def of(cls, known: EvaluationSurvey, config: MultiTargetConfig, unit: str) -> GroundFigures:
        """Create the figures for the identities and frames that a first pass (`known`) has found.

        `unit`: unit of lengths.
        """
        targets, tracks = (np.array(list(each), dtype=np.int64) for each in (known.targets, known.tracks))
        return cls(targets, tracks, known.frames, config, unit)

    def _frames_of(self, part: EvaluatedPart) -> MatchedFrames:
        found = of_points(part.points.truth, part.points.tracks, self._limit)
        found = numbered(found, *self._keys)
        return found._replace(frame=found.frame + part.begin)

    def prepare(self, part: EvaluatedPart) -> None:
        """First pass: add a part, in the order of time, to the assignment of targets and to the alignment of HOTA."""
        points = part.points
        self._labels[0].update(np.unique(points.truth.label).tolist())
        self._labels[1].update(np.unique(points.tracks.label).tolist())
        self._owners.update(points.truth, points.tracks, points.tau, points.times(points.tracks))
        self._mot.prepare(self._frames_of(part))

    def update(self, part: EvaluatedPart) -> tuple[Counts, Failures]:
        """Second pass: add a part, in the order of time; return its numbers of targets and tracks, and its failures.

        The pairs of the part are then in `pairs`.
        """
        points, frames = part.points, self._frames_of(part)
        times = points.t_ns[0]
        self._interpolated[0] += _interpolated(points.truth, times, part.targets)
        self._interpolated[1] += _interpolated(points.tracks, times, paths_of(part.rows))
        made = self._mot.update(frames)
        near = frames._replace(limit=self._moda_limit)
        self._moda.update(near, self._moda_matcher.update(near))
        self._ospa2.update(frames)
        if self._windows is not None:
            ends = range(part.begin, part.begin + len(points.t_ns[0]))
            for each in self._windows.update(frames, ends):
                self._window_sum.add(each.ospa2)
        self._trajectories.update(frames, part.begin, part.over)
        self.pairs = self._pairs.update(frames, self._each_matcher.update(frames), points, part.rows)
        counts = counts_over_time(frames, made, points, part.begin)
        self._counts.update(counts)
        found = find_failures(points, self._owners)
        self._failures.update(found, found.frame >= 0, len(points.truth.frame))
        return counts, failure_rows(found, points)

    def merge(self, other: GroundFigures) -> None:
        """Add another recording without common targets or tracks; no frame may be added afterwards.

        Counts are added up before rates are made of them, as TrackEval's COMBINED does.
        """
        self._cells += other._cells
        self._interpolated += other._interpolated
        self._mot.merge(other._mot)
        self._moda.merge(other._moda)
        self._ospa2.merge(other._ospa2)
        self._window_sum.merge(other._window_sum)
        self._trajectories.merge(other._trajectories)
        self._pairs.merge(other._pairs)
        self._counts.merge(other._counts)
        self._failures.merge(other._failures)

    def result(self) -> Metrics:
        """Return all figures by name."""
        unit, cells = self._unit, self._cells
        names = ("objects_interpolated", "tracks_interpolated")
        out = self._failures.result() | dict(zip(names, self._interpolated.tolist(), strict=True))
        out |= self._mot.result(cells, unit=unit) | {"frames": cells}
        out |= self._detection() | self._trajectory(cells, unit)
        out |= self._pairs.result() | {f"matched_gate_{unit}": self._limit} | self._counts.result()
        return {name: float(value) for name, value in out.items()}

    def notes(self) -> list[str]:
        """Return a note for the user if no track has the number of a target although tracks are assigned by number."""
        theirs, ours = (np.array(sorted(each), dtype=np.int64) for each in self._labels)
        return unrelated_ids_note(ours, theirs, self._config)

    def _detection(self) -> Metrics:
        """Return MODA and MODP (detection and precision of positions, without identities), misses and false alarms.

        MODA = 1 - (missed + false) / objects and MODP = mean of 1 - d / limit over the pairs of all frames together,
        within `moda_distance`, as in the evaluation of WILDTRACK (Chavdarova et al. 2018; Kasturi et al. 2009).
        """
        got = self._moda.result()
        return {
            "moda": 1.0 - ratio_or_nan(got.fp + got.fn, got.objects),
            "modp": 1.0 - got.motp / self._moda_limit,
            "moda_missed": got.fn,
            "moda_false": got.fp,
        }

    def _trajectory(self, cells: int, unit: str) -> Metrics:
        """Return OSPA(2) and trajectory GOSPA with their parts, by name; GOSPA is averaged over the frames.

        If sliding windows are configured, OSPA(2) in windows is averaged over the frames, too.

        Args:
            cells: number of frames.
            unit: unit of lengths, in the names.
        """
        whole = self._ospa2.result()
        out: Metrics = {
            f"ospa2_{unit}": whole.ospa2,
            f"ospa2_localisation_{unit}": whole.localisation,
            f"ospa2_cardinality_{unit}": whole.cardinality,
        }
        if self._windows is not None:
            out[f"ospa2_window_{unit}"] = ratio_or_nan(self._window_sum.value, cells)
        got = self._trajectories.result()
        power, n = power_of(self._config, unit), max(cells, 1)
        out[f"tgospa_{unit}"] = (got.total / n) ** (1.0 / got.p)
        for name in ("localisation", "missed", "false", "switch"):
            out[f"tgospa_{name}_{unit}{power}"] = getattr(got, name) / n
        return out


class PairErrors:
    """Accumulates distances of tracks from targets in per-frame pairs, regardless of identities.

    Each frame is paired on its own. CLEAR-MOT, in contrast, keeps a pair while the track is near, even if the track has
    changed to a neighbour. Covariances are evaluated (NEES) where the track has a row at the time. Since the match
    distance bounds errors, the mean NEES is slightly below 2 if standard deviations approach a third of it.
    """

    def __init__(self, unit: str, in_memory: int = NUMBERS_IN_MEMORY) -> None:
        """Create sums without pairs; `unit`: unit of lengths, `in_memory`: number of distances that stay in memory."""
        self._unit = unit
        self._distances, self._squares = Spread(in_memory), Sum()
        self._nees, self._pairs = Consistency(CHI2_95_2D), 0

    def update(self, frames: MatchedFrames, made: MatchedPairs, points: PointTracks, tracks: Tracks) -> FramePairs:
        """Add frames, and return their pairs.

        Args:
            frames: truth and tracks.
            made: pairs of each frame.
            points: positions from which the frames were made.
            tracks: rows at the times of the frames, with covariances.
        """
        true, ours = frames.truth_row[made.truth], frames.track_row[made.track]
        error = points.tracks.position[ours] - points.truth.position[true]
        times, labels = points.t_ns[0][points.tracks.frame[ours]], points.tracks.label[ours]
        row = _rows_at(tracks, times, labels)
        own = row >= 0
        at = tracks.take(row[own])
        covariance = np.stack([at.cov_xx, at.cov_xy, at.cov_xy, at.cov_yy], axis=1).reshape(-1, 2, 2)
        nees = normalised_squared_errors(error[own], covariance)
        self._nees.update(nees)
        distance = np.hypot(error[:, 0], error[:, 1])
        self._distances.update(distance)
        self._squares.add(float(np.sum(np.square(distance))))
        self._pairs += len(distance)
        return FramePairs(points.truth.label[true], times, error, own, nees)

    def merge(self, other: PairErrors) -> None:
        """Add the pairs of another recording to these."""
        self._distances.merge(other._distances)
        self._squares.merge(other._squares)
        self._nees.merge(other._nees)
        self._pairs += other._pairs

    def result(self) -> Metrics:
        """Return RMSE, median and 95 % quantile of the distances, and mean and consistency of the NEES, by name."""
        unit = self._unit
        spread = self._distances.result("matched_error", unit)
        nees = self._nees.result("matched_nees", "")
        return {
            f"matched_rmse_{unit}": math.sqrt(ratio_or_nan(self._squares.value, self._pairs)),
            f"matched_error_median_{unit}": spread[f"matched_error_median_{unit}"],
            f"matched_error_p95_{unit}": spread[f"matched_error_p95_{unit}"],
            "matched_nees_mean": nees["matched_nees_mean"],
            "matched_nees_share_95": nees["matched_nees_share_95"],
            "matched_nees_compared": self._nees.n_finite,
        }


def _rows_at(tracks: Tracks, times: Ints, labels: Ints) -> Ints:
    """Return the index (n,) of the row in `tracks` with each time in `times` (n,) and identity in `labels` (n,).

    -1: none.
    """
    order = np.lexsort((tracks.target_id, tracks.t_ns))
    keys = list(zip(tracks.t_ns[order].tolist(), tracks.target_id[order].tolist(), strict=True))
    index_of = dict(zip(keys, order.tolist(), strict=True))
    wanted = zip(times.tolist(), labels.tolist(), strict=True)
    return np.array([index_of.get(key, -1) for key in wanted], dtype=np.int64)


def counts_over_time(frames: MatchedFrames, made: MatchedPairs, points: PointTracks, begin: int) -> Counts:
    """Return the numbers of targets, tracks, pairs, misses, false tracks and switches in each frame of a part.

    Args:
        frames: truth and tracks that were matched.
        made: CLEAR-MOT pairs.
        points: targets and tracks of the part.
        begin: number of its first frame.
    """
    cells = len(points.t_ns[0])
    true = np.bincount(points.truth.frame, minlength=cells)
    found = np.bincount(points.tracks.frame, minlength=cells)
    at = frames.frame - begin
    paired = np.bincount(at[made.frame], minlength=cells)
    switched = np.bincount(at[made.frame[made.switch]], minlength=cells)
    return Counts.of(
        t_ns=points.t_ns[0],
        frame=points.number[0],
        targets=true,
        tracks=found,
        paired=paired,
        missed=true - paired,
        false=found - paired,
        switches=switched,
    )


class CountSums:
    """Accumulates numbers of targets and tracks per frame, for their means and for statistics of their difference."""

    def __init__(self) -> None:
        """Create sums without frames."""
        self._frames = self._targets = self._tracks = self._off = self._squares = self._most = 0

    def update(self, counts: Counts) -> None:
        """Add the numbers of targets and tracks of further frames."""
        off = counts.tracks.astype(np.int64) - counts.targets
        self._frames += len(counts)
        self._targets += int(counts.targets.sum())
        self._tracks += int(counts.tracks.sum())
        self._off += int(off.sum())
        self._squares += int(np.sum(off**2))
        self._most = max(self._most, int(np.abs(off).max(initial=0)))

    def merge(self, other: CountSums) -> None:
        """Add the sums of another recording to these."""
        self._frames, self._targets = self._frames + other._frames, self._targets + other._targets
        self._tracks, self._off = self._tracks + other._tracks, self._off + other._off
        self._squares, self._most = self._squares + other._squares, max(self._most, other._most)

    def result(self) -> Metrics:
        """Return the mean numbers of targets and of tracks per frame, and statistics of tracks minus targets.

        These are the signed mean, the RMS, and the largest absolute value. Without frames the first four are NaN, and
        the last is 0.
        """
        n = self._frames
        return {
            "count_targets_mean": ratio_or_nan(self._targets, n),
            "count_tracks_mean": ratio_or_nan(self._tracks, n),
            "count_error_mean": ratio_or_nan(self._off, n),
            "count_error_rms": math.sqrt(ratio_or_nan(self._squares, n)),
            "count_error_max": self._most,
        }


def _interpolated(objects: Objects, times: Ints, paths: Mapping[int, ObjectPath]) -> int:
    """Return how many positions in `objects` are interpolated, i.e. are at times without a sample of the object.

    `times` (F,): times of the frames [ns]; `paths`: samples by identity.
    """
    mine = ((path, times[objects.frame[objects.label == k]]) for k, path in paths.items())
    return len(objects.frame) - sum(int(np.count_nonzero(path.sampled(at))) for path, at in mine)


def times_of(tracks: Tracks, truth: Truth) -> Ints:
    """Return the times (T,) at which the truth has a target [ns]; those of the tracks if the truth is empty."""
    return np.unique(truth.t_ns[truth.role == "target"] if len(truth) else tracks.t_ns)


def points_in_true_frames(
    tracks: Tracks, truth: Truth, times: Ints, config: MultiTargetConfig, limit_ns: int | None, unit: str
) -> PointTracks:
    """Return truth and tracks interpolated at the frame times, as one view without a name.

    Args:
        tracks: estimates.
        truth: true positions; InputError if it has rows, but none of a target.
        times: (F,) increasing frame times [ns].
        config: largest match distance and gap of tracks.
        limit_ns: widest gap of the truth that is interpolated [ns]; None: that of each path.
        unit: unit of lengths.
    """
    targets = paths_of(truth, "target")
    if len(truth) and not targets:
        raise no_targets()
    return places_of(targets, paths_of(tracks), times, 0, config, limit_ns, unit)


def places_of(
    targets: Mapping[int, ObjectPath],
    tracks: Mapping[int, ObjectPath],
    times: Ints,
    begin: int,
    config: MultiTargetConfig,
    limit_ns: int | None,
    unit: str,
) -> PointTracks:
    """Return true and estimated paths interpolated at the frame times, as one view without a name.

    Args:
        targets: true paths by identity.
        tracks: estimated paths by identity.
        times: (F,) increasing frame times [ns].
        begin: number of the first frame.
        config: largest match distance and gap of tracks.
        limit_ns: widest gap of true paths that is interpolated [ns]; None: that of each path.
        unit: unit of lengths.
    """
    left = _points(targets, times, limit_ns)
    right = _points(tracks, times, config.gap_ns(limit_ns))
    tau = np.full(len(left.frame), config.match_distance)
    return PointTracks(
        truth=left,
        tracks=right,
        tau=tau,
        views=("",),
        t_ns=(times,),
        number=(np.arange(begin, begin + len(times)),),
        visible=np.full(len(tau), np.nan),
        unit=unit,
    )


def _points(paths: Mapping[int, ObjectPath], times: Ints, limit_ns: int | None) -> Objects:
    """Return the positions of each path at increasing times (F,) [ns], interpolated, with index of time and identity.

    Unknown positions get no row. `limit_ns`: widest gap that is interpolated [ns]; None: that of each path.
    """
    parts = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))]
    for label, path in paths.items():
        begin, end = np.searchsorted(times, path.t_ns[0]), np.searchsorted(times, path.t_ns[-1], "right")
        xy, good = path.at(times[begin:end], limit_ns)
        rows = np.flatnonzero(good)
        parts.append(((begin + rows).astype(np.int64), np.full(len(rows), label, dtype=np.int64), xy[rows]))
    frame, name, position = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Objects(frame, name, position)
