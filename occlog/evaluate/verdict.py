"""Verdict on finished tracks, from their diagnostics, bearings, truth and bound.

`occlog.consistency.verdict` evaluates what the tracks and their bearings show; this module adds findings that need the
truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.consistency.bearings import CONFIRMATION_WINDOW_S, BearingConsistency, confirmed_by_another, pose_share
from occlog.consistency.verdict import (
    MAX_REJECTED_SHARE,
    MIN_SAMPLES,
    NIS_HIGH,
    SIGNIFICANCE,
    ConsistencyEvidence,
    exceeds_share,
)
from occlog.core.metrics.errors import CHI2_95_2D, CHI2_95_3D
from occlog.core.metrics.normalised_squares import BatchMeans, Ratio
from occlog.errors import InputError
from occlog.io.files.provenance import Provenance
from occlog.io.files.spill import NUMBERS_IN_MEMORY, Spool
from occlog.records.columns import rows_by_label
from occlog.records.scene import Scene
from occlog.records.tables import LAST, Bearings, Diagnostics, Errors, Limits, Residuals, TableBuffer, Tracks
from occlog.records.verdicts import Check, finding, outcome
from occlog.track.catalogue import smooths

from .errors.sums import median_of, space_errors
from .mot.config import MultiTargetConfig
from .mot.figures import independent_ids

COVARIANCES, IDENTITY = "covariances against the truth (NEES)", "truth matches bearings"
DETECTIONS, BOUND = "detection rate at the true positions", "errors against the bound"
"""Names of checks."""
NEES_HIGH, NEES_LOW = 2.0, 0.2
"""Normalised squared errors over their number of dimensions that matter."""
MAX_OUTSIDE_95_SHARE = 0.12
"""Share of errors outside of the 95 % ellipse that matters."""
MAX_SINGULAR_SHARE = 0.01
"""Share of estimates with a singular covariance that matters."""
MIN_DETECTION_RATE = 0.3
"""Share of visible targets seen where they are, below which bearings are not of the targets of the truth."""
MAX_BEARING_NIS = 4.0
"""Normalised squared residual of bearings at the true positions, above which these may be of something else."""
MAX_BOUND_RATIO = 5.0
"""RMSE over the bound that is worth a word."""


class TrackProvenance(NamedTuple):
    """How tracks were made, as far as a verdict on them needs it; from their provenance.

    `smoothed`: estimated with later measurements, too; `one_target`: unlabelled bearings were taken to be of one
    target; `unlabelled`: such bearings were used; `sensors`: names of those that were used, None: unknown; `window_ns`:
    bearings up to so long before an estimate belong to it [ns]; `own_numbers`: identities are the tracker's own and may
    be exchanged; `measured`: distance measurements were used.
    """

    smoothed: bool = False  # estimated with later measurements
    one_target: bool = False  # candidates without a label were taken for one target's
    unlabelled: bool = True  # candidates without a label were used
    sensors: frozenset[str] | None = None  # those that were used; None: not known
    window_ns: int = 0  # bearings so long before an estimate belong to it
    own_numbers: bool = False  # identities are the tracker's own, and may be exchanged
    measured: bool = False  # they were made with measurements of distances, too

    @classmethod
    def of(cls, provenance: Provenance) -> TrackProvenance:
        """Return what the provenance of tracks states about how they were made."""
        parameters = provenance.parameters
        sensors, window = parameters.get("sensors"), parameters.get("window_ns")
        return cls(
            smoothed=smooths(provenance.command, parameters),
            one_target=provenance.command == "track" and parameters.get("method") != "imm",
            unlabelled=parameters.get("unlabelled") is not False,
            sensors=frozenset(str(s) for s in sensors) if isinstance(sensors, list | tuple) else None,
            window_ns=window if isinstance(window, int) else 0,
            own_numbers=parameters.get("births", "initial") != "initial",
            measured=parameters.get("measurements") is not None,
        )


def bearings_used(bearings: Bearings, made: TrackProvenance, held_out: tuple[str, ...]) -> Bearings:
    """Return the bearings that the tracks were made from, as far as is known.

    `held_out`: names of sensors that were not used.
    """
    use = np.isin(bearings.sensor, list(held_out), invert=True)
    if made.sensors is not None:
        use &= np.isin(bearings.sensor, sorted(made.sensors))
    if not made.unlabelled:
        use &= bearings.target_id >= 0
    return bearings.take(use)


def checks_with_truth(
    found: ConsistencyEvidence,
    made: TrackProvenance,
    against: CovarianceConsistency,
    *,
    unknown: bool,
    metrics: Mapping[str, object],
) -> tuple[Check, ...]:
    """Return all consistency checks of tracks: against their bearings, and against the truth.

    Args:
        found: statistics of the tracks and their bearings.
        made: provenance of the tracks.
        against: statistics of their errors.
        unknown: whether the covariance of some estimate is not known.
        metrics: figures of the evaluation by name.
    """
    check = found.checks(one_target=made.one_target, smoothed=made.smoothed)
    if unknown:
        return (*check, finding(COVARIANCES, "no-covariance"), *_of_figures(metrics))
    errors = against.checks()
    large = any(each.id == "nees-large" for each in errors)
    else_ = outcome(
        IDENTITY,
        _truth_of_another_target(found, metrics) if large else (),
        unless="" if math.isfinite(_number(metrics, "bearing_nis")) else "no bearings are compared with the truth",
    )
    return (*check, *errors, *else_, *_of_figures(metrics))


def _truth_of_another_target(found: ConsistencyEvidence, metrics: Mapping[str, object]) -> Iterator[Check]:
    """Generate a warning if bearings agree with the tracks, and both are far from the truth.

    The truth is then probably of another target.

    Args:
        found: agreement of the bearings with the tracks.
        metrics: figures of the evaluation, by name.
    """
    nis, there = found.agreements.nis, _number(metrics, "bearing_nis")
    if there > MAX_BEARING_NIS and nis.value <= NIS_HIGH and found.agreements.doubted <= MAX_REJECTED_SHARE:
        yield finding(IDENTITY, "truth-of-another-target", nis_of_tracks=nis.value, nis=there, allowed=MAX_BEARING_NIS)


def _errors_on_assigned_target(errors: Errors, scene: Scene) -> Errors:
    """Return only the errors below the match distance, in which tracks are on their assigned target.

    After an identity switch, the distance to the assigned target says nothing about covariances.
    """
    near = MultiTargetConfig.in_unit(scene.length_unit).match_distance
    return errors if near is None else errors.take(errors.error <= near)


class _Nees:
    """Sums of normalised estimation errors squared (NEES) of each target, for their mean and the share above a limit.

    `dimensions`: 2 or 3; `limit`: 95 % quantile of chi-square for it.
    """

    def __init__(self, dimensions: int, limit: float) -> None:
        self.dimensions, self._limit = dimensions, limit
        self.n_finite = 0
        self._squares: dict[int, BatchMeans] = {}
        self._outside: dict[int, BatchMeans] = {}

    def update(self, target: int, nees: Floats) -> None:
        """Add values `nees` (n,) of a target, NaN where the covariance is singular."""
        finite = np.isfinite(nees)
        self.n_finite += int(finite.sum())
        squares = nees[finite]
        self._squares.setdefault(target, BatchMeans()).add(squares, np.full(len(squares), float(self.dimensions)))
        outside = np.where(finite, nees > self._limit, True).astype(np.float64)
        self._outside.setdefault(target, BatchMeans()).add(outside, np.full(len(nees), 0.05))

    @property
    def mean(self) -> Ratio:
        """Mean NEES over the number of dimensions (consistent: 1), with its uncertainty."""
        return Ratio.of_parts(self._squares[k] for k in sorted(self._squares))

    @property
    def share(self) -> Ratio:
        """Share of errors outside the 95 % ellipse over the expected 5 % (consistent: 1), with its uncertainty.

        Errors with a singular covariance count as outside.
        """
        return Ratio.of_parts(self._outside[k] for k in sorted(self._outside))


class CovarianceConsistency:
    """Accumulates the NEES of errors over a stream, to check whether the covariances of the tracks are consistent."""

    def __init__(self, made: TrackProvenance, scene: Scene | None) -> None:
        """Start without errors; `made`: how the tracks were made.

        `scene`: for the unit of the match distance, None: unknown.
        """
        self.rows = self._high = 0
        self._own_numbers, self._scene = made.own_numbers, scene
        self._ground, self._space = _Nees(2, CHI2_95_2D), _Nees(3, CHI2_95_3D)

    def update(self, errors: Errors) -> None:
        """Add errors with their NEES, in the order of time."""
        if self._own_numbers and self._scene is not None:
            errors = _errors_on_assigned_target(errors, self._scene)
        self.rows += len(errors)
        self._high += int(np.count_nonzero(space_errors(errors)))
        for target in np.unique(errors.target_id).tolist():
            own = errors.target_id == target
            self._ground.update(target, errors.nees[own])
            self._space.update(target, errors.nees_space[own])

    def update_pairs(self, targets: Ints, nees: Floats) -> None:
        """Add per-frame pairs on the ground, in the order of time: their targets (n,) and NEES (n,)."""
        self.rows += len(nees)
        for target, rows in rows_by_label(targets):
            self._ground.update(target, nees[rows])

    def checks(self) -> tuple[Check, ...]:
        """Return the check of whether covariances are consistent with the errors (NEES), with warnings if not.

        It is in space if all errors are.
        """
        if self.rows < MIN_SAMPLES:
            few = f"fewer than {MIN_SAMPLES} errors" if self.rows else "no errors against a truth"
            return outcome(COVARIANCES, (), unless=few)
        high = self._high == self.rows
        found = self._space if high else self._ground
        return outcome(
            COVARIANCES,
            _of_nees(found, self.rows),
            nees=found.mean.value * found.dimensions,
            allowed=NEES_HIGH * found.dimensions,
        )


def _of_nees(found: _Nees, rows: int) -> Iterator[Check]:
    """Generate warnings about covariances that are singular, too small or too large.

    `found`: accumulated NEES; `rows`: number of estimates.
    """
    dimensions, mean, share = found.dimensions, found.mean, found.share
    singular = rows - found.n_finite
    if exceeds_share(singular, rows, MAX_SINGULAR_SHARE):
        yield finding(
            COVARIANCES,
            "covariances-singular",
            count=singular,
            rows=rows,
            share=singular / rows,
            allowed=MAX_SINGULAR_SHARE,
        )
    if not found.n_finite:
        return
    nees, outside = mean.value * dimensions, 0.05 * share.value
    large = mean.value > NEES_HIGH and mean.interval(SIGNIFICANCE)[0] > 1.0
    many = outside > MAX_OUTSIDE_95_SHARE and share.interval(SIGNIFICANCE)[0] > 1.0
    if large or many:
        yield finding(
            COVARIANCES,
            "nees-large",
            nees=nees,
            allowed=NEES_HIGH * dimensions,
            outside=outside,
            allowed_outside=MAX_OUTSIDE_95_SHARE,
        )
    elif mean.value < NEES_LOW and mean.interval(SIGNIFICANCE)[1] < 1.0:
        factor = 1.0 / math.sqrt(mean.value) if mean.value > 0.0 else math.inf
        allowed = NEES_LOW * dimensions
        yield finding(COVARIANCES, "nees-small", nees=nees, outside=outside, factor=factor, allowed=allowed)


def _of_figures(metrics: Mapping[str, object]) -> tuple[Check, ...]:
    """Return the checks of the detection rate, and of the errors against the bound, from figures by name."""
    return (
        *outcome(
            DETECTIONS,
            _not_detected(metrics),
            unless="" if math.isfinite(_number(metrics, "detection_rate")) else "no bearings are compared with a truth",
            share=_number(metrics, "detection_rate"),
            allowed=MIN_DETECTION_RATE,
        ),
        *outcome(
            BOUND,
            _far_from_bound(metrics),
            unless=_no_bound(metrics),
            ratio=_number(metrics, "bound_ratio"),
            allowed=MAX_BOUND_RATIO,
        ),
    )


def _no_bound(metrics: Mapping[str, object]) -> str:
    """Return the reason why errors are not compared with the bound, from figures by name; empty if they are."""
    if independent_ids(metrics):
        return "tracks have their own identities, so that errors count their switches"
    return "" if _number(metrics, "bound_estimates") >= MIN_SAMPLES else "there is no bound"


def _not_detected(metrics: Mapping[str, object]) -> Iterator[Check]:
    """Generate a warning if the detection rate in `metrics` is low: bearings are probably not of the true targets."""
    rate, visible = _number(metrics, "detection_rate"), _number(metrics, "visible")
    if rate < MIN_DETECTION_RATE and exceeds_share(
        round((1.0 - rate) * visible), round(visible), 1.0 - MIN_DETECTION_RATE
    ):
        yield finding(DETECTIONS, "low-detection-rate", share=rate, allowed=MIN_DETECTION_RATE)


def _far_from_bound(metrics: Mapping[str, object]) -> Iterator[Check]:
    """Generate a warning if the ratio of the errors to the bound in `metrics` exceeds `MAX_BOUND_RATIO`."""
    ratio = _number(metrics, "bound_ratio")
    if ratio > MAX_BOUND_RATIO and not _no_bound(metrics):
        yield finding(BOUND, "error-far-above-bound", ratio=ratio, allowed=MAX_BOUND_RATIO)


def _number(metrics: Mapping[str, object], name: str) -> float:
    """Return the figure of this name; NaN if it is missing or no number."""
    value = metrics.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


class SightEvidence:
    """Compares bearings with tracks over a stream, interval by interval, and adds to a `ConsistencyEvidence`.

    It adds the residuals of bearings, the numbers of bearings near no track, the intersections of bearings, and how
    many bearings another sensor confirms.
    """

    def __init__(
        self,
        evidence: ConsistencyEvidence,
        scene: Scene,
        made: TrackProvenance,
        held_out: tuple[str, ...],
        in_memory: int = NUMBERS_IN_MEMORY,
    ) -> None:
        """Create empty evidence.

        Args:
            evidence: receives the statistics, in place.
            scene: the sensors.
            made: provenance of the tracks.
            held_out: names of sensors that the tracks were made without.
            in_memory: how many distances of all cameras are kept in memory.
        """
        self._evidence, self._scene, self._made, self._held_out = evidence, scene, made, held_out
        self._of_estimates, self._of_frames = (BearingConsistency(scene, made.window_ns) for _ in range(2))
        self._alone = _Alone(evidence)
        unsure = [c for c in scene.cameras if c.sigma_yaw > 0.0 or c.sigma_position > 0.0]
        self._distances = {c.name: Spool(in_memory // len(unsure)) for c in unsure}

    @property
    def margin_ns(self) -> int:
        """How long before and after a time interval `update` needs tracks and bearings, too [ns]."""
        return self._made.window_ns + 1

    def update(
        self,
        limits: Limits,
        tracks: TableBuffer[Tracks],
        bearings: TableBuffer[Bearings],
        diagnostics: TableBuffer[Diagnostics] | None,
    ) -> None:
        """Compare the bearings of a time interval with the tracks, and add the residuals to the evidence.

        Args:
            limits: begin and end of the interval.
            tracks: buffered tracks.
            bearings: buffered bearings.
            diagnostics: one row for each row of the tracks (`in_rows_of`); None: there are none.
        """
        window_ns, before = self._made.window_ns, Limits(limits.begin, limits.end)
        ours, its = before.about(tracks, window_ns, 0), before.about(bearings, window_ns, 0)
        filter_diagnostics = None if diagnostics is None else before.about(diagnostics, window_ns, 0)
        its = bearings_used(its, self._made, self._held_out)
        residuals, frames = self._of_estimates.compare(ours, its, filter_diagnostics)
        if window_ns:
            # A bearing may belong to an estimate after the section
            ours, its = (
                before.about(tracks, 0, self.margin_ns),
                bearings_used(before.of(bearings), self._made, self._held_out),
            )
            filter_diagnostics = None if diagnostics is None else before.about(diagnostics, 0, self.margin_ns)
            _, frames = self._of_frames.compare(ours, its, filter_diagnostics)
            ours = before.about(tracks, window_ns, 0)
        residuals = residuals.take(residuals.t_ns >= limits.begin)
        evidence, own = self._evidence, limits.of(tracks)
        for camera in self._scene.cameras:
            if camera.name in self._distances:
                x, y = own.x - camera.position[0], own.y - camera.position[1]
                self._distances[camera.name].add(np.hypot(x, y))
        evidence.agreements.add(residuals)
        evidence.crowd.add(frames)
        evidence.positions.add(ours, residuals, self._scene)
        self._alone.add(residuals, limits.end)

    def finish(self) -> None:
        """Finish after the last interval: process pending bearings, and set each camera's share of pose errors."""
        self._alone.add(Residuals.empty(), LAST)
        for camera in self._scene.cameras:
            found = self._evidence.agreements.sensors.get(camera.name)
            if found is not None and camera.name in self._distances and self._distances[camera.name].count:
                found.pose = pose_share(camera, median_of(self._distances[camera.name])) * found.means.expected


class _Alone:
    """Counts bearings, those that another sensor confirms, and rejected ones, in place in a `ConsistencyEvidence`.

    A bearing is confirmed by one of the same target within 1 s. It is counted once all rows near it in time are known.
    """

    def __init__(self, evidence: ConsistencyEvidence) -> None:
        self._evidence = evidence
        self._kept, self._begin = Residuals.empty(), 0
        self._first: dict[int, int] = {}

    def add(self, residuals: Residuals, end_ns: int) -> None:
        """Add residuals in the order of time.

        `end_ns`: no later row is before this time [ns], `LAST`: no row follows.
        """
        rows = Residuals.concat([self._kept, residuals])
        if not len(rows):
            return
        near_ns = round(CONFIRMATION_WINDOW_S * NS) + 1
        ready = len(rows) if end_ns == LAST else int(np.searchsorted(rows.t_ns, end_ns - near_ns))
        done, alone = np.arange(len(rows)) < self._begin, self._evidence.alone
        for target in np.unique(rows.target_id).tolist():
            mine = rows.target_id == target
            own = rows.take(mine)
            # Seconds since the first bearing of all, so that chunks change no rounding
            seconds = (own.t_ns - self._first.setdefault(target, int(own.t_ns[0]))) / NS
            new = ~done[mine] & (np.flatnonzero(mine) < ready)
            alone.bearings += int(np.count_nonzero(new))
            alone.confirmed += int(np.count_nonzero(confirmed_by_another(own.sensor, seconds)[new]))
            alone.doubted += int(np.count_nonzero(own.inlier_probability[new] < 0.5))
        since = 0 if ready == 0 else int(np.searchsorted(rows.t_ns, rows.t_ns[ready - 1] - near_ns))
        self._kept, self._begin = rows.take(slice(since, None)), max(ready, self._begin) - since


def in_rows_of(tracks: Iterable[Tracks], diagnostics: Iterable[Diagnostics]) -> Iterator[Diagnostics]:
    """Generate the diagnostics of the rows of tracks, in chunks with the lengths and times of those of tracks.

    Raises:
        InputError: there are fewer rows of diagnostics than of tracks.
    """
    held, rest = Diagnostics.empty(), iter(diagnostics)
    for chunk in tracks:
        while len(held) < len(chunk):
            more = next(rest, None)
            if more is None:
                raise InputError(
                    "diagnostics: fewer rows than the tracks; give the diagnostics that were written together "
                    "with these tracks",
                    id="incompatible-inputs",
                )
            held = Diagnostics.concat([held, more])
        yield replace(held.take(slice(0, len(chunk))), t_ns=chunk.t_ns)
        held = held.take(slice(len(chunk), None))
