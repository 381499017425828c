"""Computation of all figures that the given inputs allow, in bounded memory.

All tables are read in chunks, two or three times, in common time intervals: for the survey of the whole, if requested
for the pairs of tracks and targets (`prepare`), and for the figures. A table in memory is one chunk. Also the cost of
requests to cameras (requests, frames, mean period), and figures of plug-ins.
"""

from __future__ import annotations

import math
import numbers
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from occlog.array_types import NS
from occlog.consistency.verdict import ConsistencyEvidence
from occlog.errors import InputError, PluginError, UsageError
from occlog.plugins.interface import Metric, MetricInput
from occlog.plugins.loading import Chosen, plugin_errors
from occlog.records.columns import ColumnTable
from occlog.records.declared.people import PeopleTracks
from occlog.records.declared.sensors import Measurements
from occlog.records.declared.views import Counts, Failures
from occlog.records.scene import Scene
from occlog.records.tables import (
    Bearings,
    Bound,
    Boxes,
    Cooperation,
    Errors,
    Tracks,
    Truth,
    TruthBoxes,
    Views,
    whole_times,
    windows,
)
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import Radio
from occlog.settings import METRES

from .bearings.detections import RegionFigures
from .bearings.held_out import held_out_box_metrics
from .bearings.noise import MeasuredNoise, figures_of, notes_of
from .bearings.residuals import AgainstBearings
from .errors.misalignment import TruthAlignment
from .errors.on_ground import NoCommonTimeError, PairSums, TrackErrors, no_targets, pairs_by_number
from .errors.survey import EvaluationChunk, EvaluationSurvey, SegmentTables, check_pairs, chunks_in_time, survey
from .matching.config import EvaluateConfig
from .matching.path_outline import TruthOutlines
from .mot import figures as headline
from .mot.config import MultiTargetConfig
from .mot.on_ground import EvaluatedPart, GroundFigures, places_of
from .results import Evaluation
from .sources import Chunks, EvaluationSources, MeasuredSource, in_memory, no_true_box_message, rows_of
from .verdict import CovarianceConsistency, TrackProvenance, checks_with_truth

SHARED = "shared"
CAUSES = ("periodic", "count", "bearing", "ellipse", "spread")


class CooperationCounts:
    """Accumulates counts of the requests of a tracker to cameras (`track --cooperation`), in the order of time."""

    def __init__(self) -> None:
        """Create counts without requests."""
        self._rows = self._own = self._answered = self._frames = self._times = 0
        self._causes: Counter[str] = Counter()
        self._span: tuple[int, int] | None = None

    def update(self, asked: Cooperation) -> None:
        """Add the requests of further times; all requests of a time must come in one call."""
        own = asked.take(asked.cause != SHARED)
        self._rows, self._own = self._rows + len(asked), self._own + len(own)
        self._answered += int(np.count_nonzero(own.answered))
        self._frames += int(asked.frames.sum())
        self._causes.update(cause for text in own.cause.tolist() for cause in text.split(","))
        times = np.unique(own.t_ns)
        self._times += len(times)
        if len(times):
            self._span = (int(times[0]) if self._span is None else self._span[0]), int(times[-1])

    def result(self, tracked: tuple[int, int] | None) -> dict[str, float]:
        """Return numbers of requests and frames, and the mean period of requests.

        Args:
            tracked: first and last time of the tracks [ns]; the period is the time between them over the number of
                times at which cameras were asked. None, without tracks: the mean interval of these times.

        Returns:
            `cooperation_requests` (one for each target and time), `cooperation_answered`, `cooperation_shared` (rows of
            this cause are no requests, but positions that came along with others), `cooperation_frames`,
            `cooperation_period_s` (NaN if unknown), and `cooperation_requests_CAUSE`; a request with several causes
            counts for each.
        """
        first, last = tracked or self._span or (0, 0)
        count, causes = (self._times if tracked else self._times - 1), self._causes
        return {
            "cooperation_requests": float(self._own),
            "cooperation_answered": float(self._answered),
            "cooperation_shared": float(self._rows - self._own),
            "cooperation_frames": float(self._frames),
            "cooperation_period_s": float(last - first) / NS / count if count > 0 else math.nan,
            **{f"cooperation_requests_{c}": float(causes[c]) for c in (*CAUSES, *sorted(set(causes) - set(CAUSES)))},
        }


Metrics = dict[str, float]
BOUND_WITHOUT_DISTANCES = (
    "the bound knows nothing of the ranges, signal strengths or time differences of the tracks, so that no ratio to it "
    "means anything; give --measurements"
)
"""Description of tracks that were made with measurements of distances, where these are not given."""


def evaluate(
    tracks: Tracks | None,
    truth: Truth | None,
    bearings: Bearings | None,
    scene: Scene,
    config: EvaluateConfig | None = None,
    *,
    views: Views | None = None,
    truth_boxes: TruthBoxes | None = None,
    cooperation: Cooperation | None = None,
    made: TrackProvenance | None = None,
    boxes: Boxes | Views | None = None,
    measured: tuple[Measurements, DistanceMeasurementConfig, Radio | None] | None = None,
    many: MultiTargetConfig | None = None,
) -> Evaluation:
    """Evaluate tables in memory: all figures that the given tables allow; see `Evaluator`.

    Args:
        tracks: estimates.
        truth: true positions.
        bearings: bearings of all sensors.
        scene: the sensors; its unit of lengths ends the names of figures (`rmse_m`).
        config: settings; None: defaults.
        views: silhouettes to compare with `truth_boxes`.
        truth_boxes: true boxes.
        cooperation: requests to cameras.
        made: provenance of the tracks; None: unknown.
        boxes: detections of all people, to be predicted in cameras that are held out.
        measured: distance measurements, which count in the bound, with their settings and a fitted path loss.
        many: settings of the figures of many targets; None: these are skipped.

    Raises:
        InputError: the tables do not fit together (no common identity, time or sensor).
    """
    distances = None if measured is None else MeasuredSource(lambda: iter([measured[0]]), *measured[1:])
    sources = EvaluationSources(
        tracks=in_memory(tracks),
        truth=in_memory(truth),
        bearings=in_memory(bearings),
        measured=distances,
        views=in_memory(views),
        truth_boxes=in_memory(truth_boxes),
        cooperation=in_memory(cooperation),
        boxes=in_memory(boxes),
        made=made or TrackProvenance(),
    )
    found: dict[str, list[Any]] = {kind.NAME: [] for kind in (Errors, Bound, Failures, Counts)}
    result = Evaluator(sources, scene, config or EvaluateConfig()).run(lambda rows: found[rows.NAME].append(rows), many)
    return replace(
        result,
        errors=Errors.concat(found[Errors.NAME]),
        bound=Bound.concat(found[Bound.NAME]),
        failures=Failures.concat(found[Failures.NAME]),
        counts=Counts.concat(found[Counts.NAME]),
    )


class Evaluator:
    """Evaluates all given inputs, in chunks and bounded memory.

    Tracks and truth give errors and, if requested, the figures of many targets; bearings and truth give detections and
    the bound; bearings and tracks give distances of the tracks from triangulated positions, and the prediction of
    held-out sensors; views and true boxes give recall and precision; camera requests give their cost.
    """

    def __init__(self, sources: EvaluationSources, scene: Scene, config: EvaluateConfig) -> None:
        """Read tracks and truth once, to find identities and times.

        Args:
            sources: inputs to evaluate.
            scene: the sensors, and the unit of lengths.
            config: settings.

        Raises:
            InputError: a sensor is held out, and there are no tracks, or neither bearings nor boxes; the truth has
                rows, but none of a target; or too many targets and tracks exist at the same time.
        """
        if config.held_out and (sources.tracks is None or (sources.bearings is None and sources.boxes is None)):
            raise InputError(
                "evaluate: a held-out sensor needs tracks made without it, and bearings or boxes that include it",
                id="missing-option",
            )
        self._sources, self._scene, self._config = sources, scene, config
        self._outlines, self._high = TruthOutlines(), False
        self._compares = sources.tracks is not None and sources.truth is not None
        self._sees = sources.bearings is not None or (sources.measured is not None and sources.truth is not None)
        truth = rows_of(sources.truth) if self._compares or self._sees else iter(())
        truth = self._outlines.watch(truth) if self._sees else truth
        self.known: EvaluationSurvey = survey(self._watched(rows_of(sources.tracks)), truth)
        self.noise: dict[str, MeasuredNoise] = {}
        """Noise of each camera at known positions, after `run` with `with_positions`."""
        if self._compares:
            check_pairs(self.known)
        if self._compares and self.known.truth_ns is not None and not self.known.targets:
            raise no_targets()

    def _watched(self, chunks: Iterator[Tracks]) -> Iterator[Tracks]:
        for chunk in chunks:
            self._high = self._high or bool(np.isfinite(chunk.z).any())
            yield chunk

    @property
    def several(self) -> bool:
        """Whether multi-target figures apply: several tracks or targets are compared, or the truth is empty."""
        known = self.known
        return self._compares and (max(len(known.tracks), len(known.targets)) > 1 or known.truth_ns is None)

    def run(
        self,
        take: Callable[[ColumnTable], None],
        many: MultiTargetConfig | None = None,
        *,
        with_positions: bool = False,
        numbers: Sequence[str] = (),
    ) -> Evaluation:
        """Compute all figures.

        Args:
            take: is called with tables of errors, bound, failures and counts in parts, in the order of time.
            many: settings of the figures of many targets, with a match distance; None: these are skipped.
            with_positions: whether the noise of cameras is measured at true positions.
            numbers: notes on the identities of the tracks, which precede the note on the errors.

        Raises:
            InputError: the tables do not fit together (no common identity, time or sensor).
        """
        known, unit, config, sources = self.known, self._scene.length_unit, self._config, self._sources
        against, evidence = CovarianceConsistency(sources.made, self._scene), ConsistencyEvidence(rows=known.estimates)
        if sources.diagnostics is not None:
            evidence.rows = 0
            for rows in sources.diagnostics():
                evidence.add_diagnostics(rows)
        ground = None if many is None or not self._compares else GroundFigures.of(known, many, unit)
        pairs = self._prepare(ground, many)
        errors = TrackErrors(known, pairs, config, unit)
        gate = (many or MultiTargetConfig.in_unit(unit)).match_distance or math.inf
        aligned = TruthAlignment(lambda: (rows_of(sources.tracks), rows_of(sources.truth)), gate, unit)
        seen, companion = None, None
        if self._sees:
            seen = AgainstBearings(sources, known, self._outlines, self._scene, config, with_positions=with_positions)
            companion = seen.begin(pairs, evidence, high_tracks=self._high)
        # Of tracks with their own identities the pairs of each frame show whether covariances are right
        own = ground is not None and config.match != "id" and known.single is None
        for part, frames in self._parts(many, companion) if self._compares or self._sees else ():
            found = errors.update(part) if self._compares else Errors.empty()
            if seen is not None:
                seen.update(part, found, errors.late)
            take(found)
            for table in ground.update(frames) if ground is not None and frames is not None else ():
                take(table)
            if not own:
                against.update(found)
                aligned.update(found, part.targets, config.limit_ns)
            elif ground is not None and frames is not None:
                against.update_pairs(ground.pairs.target[ground.pairs.own], ground.pairs.nees)
                aligned.update_pairs(*ground.pairs[:3], part.targets, config.limit_ns)
        if seen is not None:
            seen.finish(take)
        try:
            metrics, notes = self._figures(errors, seen)
        except NoCommonTimeError as error:
            raise InputError(
                "; ".join([str(error), *(each.text for each in aligned.found())]), id="disjoint-inputs"
            ) from error
        if ground is not None:
            metrics = {**metrics, **{name: v for name, v in ground.result().items() if name not in metrics}}
            metrics = headline.first({**metrics, headline.INDEPENDENT_IDS: 1.0}, unit) if own else metrics
            notes += [*ground.notes(), *numbers, *headline.notes(metrics, unit, config.match)]
        if with_positions and seen is not None:
            self.noise = seen.noise_at_known_positions()
            metrics |= figures_of(self.noise)
            notes += notes_of(self._scene, self.noise)
        checks = None
        asked = errors.rows or (seen is not None and seen.rows) or (sources.diagnostics is not None and evidence.rows)
        if sources.tracks is not None and asked:
            checks = checks_with_truth(evidence, sources.made, against, unknown=known.unknown, metrics=metrics)
            checks = (*aligned.checks(metrics), *checks) if self._compares and len(known.targets) else checks
        if sources.made.measured and sources.measured is None and seen is not None and seen.bound_rows:
            notes.append(BOUND_WITHOUT_DISTANCES)
        return Evaluation({name: float(v) for name, v in metrics.items()}, notes=tuple(notes), checks=checks)

    def _prepare(self, ground: GroundFigures | None, many: MultiTargetConfig | None) -> dict[int, int]:
        """Return the target of each track by identity, found by a pass over all frames if needed.

        Empty if there are no tracks or no truth to compare. The pass also prepares `ground`.

        Args:
            ground: multi-target figures, for which the pass is the first of two; None: there are none.
            many: their settings.
        """
        known, by_number = self.known, self._config.match == "id"
        if not self._compares:
            return {}
        sums = None if by_number or known.single is not None else PairSums(known)
        for part, frames in self._parts(many) if sums is not None or ground is not None else ():
            if sums is not None:
                sums.update(part, self._config)
            if ground is not None and frames is not None:
                ground.prepare(frames)
        if sums is not None:
            return sums.pairs()
        return pairs_by_number(known) if by_number or known.single is None else dict([known.single])

    def of_many(self, many: MultiTargetConfig) -> GroundFigures:
        """Compute the multi-target figures only, in two passes, and return them.

        `many`: settings with a match distance.
        """
        ground = GroundFigures.of(self.known, many, self._scene.length_unit)
        for take in (ground.prepare, ground.update):
            for _, frames in self._parts(many):
                if frames is not None:
                    take(frames)
        return ground

    def _parts(
        self, many: MultiTargetConfig | None, companion: SegmentTables | None = None
    ) -> Iterator[tuple[EvaluationChunk, EvaluatedPart | None]]:
        """Generate tracks and truth in time intervals, each with its frames for the multi-target figures.

        Frames are the times of true targets; if the truth is empty, those of the tracks; None: not needed, or none.

        Args:
            many: settings of the multi-target figures; None: no frames are made.
            companion: other tables that are read along; None: none.
        """
        known, limit, begin = self.known, self._config.limit_ns, 0
        truth = self._sources.truth if self._compares or self._sees else None
        gap = 0 if many is None else many.gap_ns(limit)
        for part in chunks_in_time(rows_of(self._sources.tracks), rows_of(truth), known, self._config, gap, companion):
            times = np.unique(part.rows.t_ns) if known.truth_ns is None else part.times
            if many is None or not len(times):
                yield part, None
                continue
            points = places_of(part.targets, part.tracks, times, begin, many, limit, self._scene.length_unit)
            yield part, EvaluatedPart(points, begin, part.rows, part.targets, known.over(int(times[-1])))
            begin += len(times)

    def _figures(self, errors: TrackErrors, seen: AgainstBearings | None) -> tuple[Metrics, list[str]]:
        """Return all figures except multi-target ones by name, and notes for the user.

        Args:
            errors: accumulated errors.
            seen: accumulated figures of bearings; None: there are none.
        """
        known, sources, notes = self.known, self._sources, list[str]()
        metrics: Metrics = {}
        if self._compares:
            notes += [] if errors.note is None else [errors.note]
            metrics |= errors.result()
        elif sources.tracks is not None:
            metrics |= {"tracks": len(known.tracks), "estimates_without_truth": known.estimates}
        if seen is not None:
            metrics |= seen.against_truth()
        if self._compares:
            metrics |= errors.settled(None if seen is None else seen.settled_bound)
        metrics |= {} if seen is None else seen.noise()
        metrics |= {"tracks_smoothed": 1.0} if sources.made.smoothed else {}
        if seen is not None:
            compared = seen.meeting()
            if sources.truth is None and not compared:
                notes.append(seen.note())
            metrics |= compared
        return metrics | self._of_boxes() | self._of_views() | self._of_requests(), notes

    def _of_boxes(self) -> Metrics:
        """Return the figures of boxes in held-out cameras as predicted by the tracks; empty without boxes and tracks.

        Tables are read as a whole.
        """
        sources = self._sources
        if sources.boxes is None or sources.tracks is None:
            return {}
        tracks, boxes = list(sources.tracks()), list[Boxes | Views](sources.boxes())
        whole = PeopleTracks.concat(part for part in tracks if isinstance(part, PeopleTracks))
        table = type(boxes[0]).concat(boxes) if boxes else Boxes.empty()  # type: ignore[arg-type]
        return held_out_box_metrics(whole, table, self._scene, self._config)

    def _of_views(self) -> Metrics:
        """Return the figures of views (silhouettes) against true boxes; empty without both."""
        views, true = self._sources.views, self._sources.truth_boxes
        if views is None or true is None:
            return {}
        figures, boxes = RegionFigures(self._config), 0
        for part in windows(views(), true(), (Views, TruthBoxes), 0):
            figures.update(part.a, part.b)
            boxes += len(part.b)
        if self._sources.frames is not None and not boxes:
            raise no_true_box_message(self._sources.frames)
        return figures.result()

    def _of_requests(self) -> Metrics:
        """Return the figures of camera requests (numbers, causes); empty without requests."""
        asked: Chunks[Cooperation] | None = self._sources.cooperation
        if asked is None:
            return {}
        counts = CooperationCounts()
        for rows in whole_times(asked()):
            counts.update(rows)
        return counts.result(self.known.tracks_ns)


PURE = ("", "1")
"""Units of numbers without one, which end no name."""


def full_name(plugin: str, figure: str, unit: str, length_unit: str) -> str:
    """Return the name of a plug-in's figure in the summary, for example `gaps_longest_s`.

    Args:
        plugin: name of the plug-in.
        figure: name of the figure in the plug-in.
        unit: unit of the figure; the word `length` in it is replaced.
        length_unit: unit of lengths of the scene.
    """
    of = unit.replace("length", length_unit)
    own = f"{plugin.replace('-', '_')}_{figure}"
    return own if of in PURE else f"{own}_{of}"


def names_of_figures(plugged: Iterable[Chosen]) -> set[str]:
    """Return the full names of all figures of the chosen metric plug-ins, for every possible length unit."""
    lengths = (*METRES, "unit")
    return {
        full_name(each.plugin.name, name, unit, length)
        for each in plugged
        for name, unit in each.plugin.load().units.items()
        for length in lengths
    }


def fault_of(figures: object, units: Mapping[str, str]) -> str | None:
    """Return what is wrong with the figures that a metric plug-in returned; None if they are valid.

    `units`: unit of each figure that the plug-in declares.
    """
    if not isinstance(figures, Mapping):
        return f"figures gives a {type(figures).__name__}; a mapping of names to numbers was expected"
    for name in units:
        if name not in figures:
            return f"figures gives no {name}, which units declares"
    for name, value in figures.items():
        if name not in units:
            return f"figures gives {name}, which units does not declare"
        if not isinstance(value, numbers.Real):
            return f"{name} is a {type(value).__name__}; a number was expected"
        if math.isinf(value):
            return f"{name} is infinite; NaN states that there is nothing to compute it from"
    return None


def with_plugins(
    result: Evaluation, plugged: Iterable[Chosen], tracks: Tracks, truth: Truth, length_unit: str
) -> Evaluation:
    """Return the evaluation with the figures of plug-ins added.

    Args:
        result: the evaluation.
        plugged: chosen metric plug-ins.
        tracks: evaluated tracks.
        truth: truth that they were compared with.
        length_unit: unit of lengths in both tables.

    Raises:
        PluginError: a plug-in fails or returns invalid values.
        UsageError: a name of a figure is already in the evaluation.
    """
    metrics, names = dict(result.metrics), list[str]()
    for each in plugged:
        own: Metric = each.make(length_unit)
        with plugin_errors(each.plugin):
            found = own.figures(MetricInput(tracks, truth, result.errors, length_unit))
        wrong = fault_of(found, own.units)
        if wrong is not None:
            raise PluginError(f"{each.plugin.label}: {wrong}")
        named = {full_name(each.plugin.name, n, own.units[n], length_unit): float(v) for n, v in found.items()}
        both = sorted(named.keys() & metrics.keys())
        if both:
            raise UsageError(
                f"{each.plugin.label}: its metric has the name {both[0]}, which is one of occlog's own; rename the "
                "plug-in",
                id="duplicate-name",
            )
        metrics |= named
        names += named
    return replace(result, metrics=metrics, plugged=tuple(names))
