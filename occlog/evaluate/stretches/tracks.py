"""Tracks against the truth in stretches of time: figures of whole tables, in memory that does not grow with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import numpy as np

from occlog.consistency.verdict import Evidence
from occlog.evaluate.bearings.known_places import MeasuredNoise, figures_of, notes_of
from occlog.evaluate.errors.streamed import Beside, CompareStreams, PairSums, Stretch, stretches
from occlog.evaluate.errors.survey import Survey, survey
from occlog.evaluate.inputs import Paths, provenance_of
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.matching.outline import Outlines
from occlog.evaluate.mot.apart import line_of_errors_apart
from occlog.evaluate.mot.config import ManyConfig
from occlog.evaluate.mot.on_ground import GroundFigures, GroundPart, places_of
from occlog.evaluate.stage import Evaluation
from occlog.evaluate.stretches.bearings import WithBearings
from occlog.evaluate.stretches.sources import Sources
from occlog.evaluate.verdict import AgainstTruth, Made, with_truth
from occlog.io.files.tables.table_writer import TableWriter
from occlog.records.columns import Table
from occlog.records.declared.views import Counts, Failures
from occlog.records.scene import Scene
from occlog.records.tables import Bound, Errors, Tracks
from occlog.track.images.run.provenance import own_notes

BOUND_WITHOUT_DISTANCES = (
    "the bound knows nothing of the ranges, signal strengths or time differences of the tracks, so that no ratio to it "
    "means anything; give --measurements"
)
"""What is said of tracks that were made with measurements of distances, where these are not given."""


class InStretches:
    """Tracks, their truth and bearings, which are gone through several times."""

    def __init__(self, sources: Sources, scene: Scene, config: EvaluateConfig) -> None:
        """Nothing is read but what must be known of the whole (`survey`)."""
        self._sources, self._scene, self._config = sources, scene, config
        self._outlines, self._high = Outlines(), False
        self.noise: dict[str, MeasuredNoise] = {}
        """Noise of each camera at known places, after `evaluate` with a scene to write."""
        truth = sources.rows_of_truth()
        truth = self._outlines.watch(truth) if self._beside else truth
        self.known: Survey = survey(self._watched(sources.rows_of_tracks()), truth)

    def _watched(self, chunks: Iterator[Tracks]) -> Iterator[Tracks]:
        for chunk in chunks:
            self._high = self._high or bool(np.isfinite(chunk.z).any())
            yield chunk

    @property
    def can(self) -> bool:
        """Whether there is something to compare; whole tables say better what is wrong with the others."""
        known, sources = self.known, self._sources
        missing = (sources.tracks is not None and not known.tracks) or (sources.truth is not None and not known.targets)
        return not missing and (not self._compares or self._config.match != "id" or bool(self._by_number()))

    @property
    def _compares(self) -> bool:
        """Whether there are tracks and a truth."""
        return self._sources.tracks is not None and self._sources.truth is not None

    @property
    def _beside(self) -> bool:
        """Whether there are bearings or measurements of distances."""
        return self._sources.bearings is not None or self._sources.measured is not None

    @property
    def several(self) -> bool:
        """Whether there are several tracks or targets to compare."""
        return self._compares and max(len(self.known.tracks), len(self.known.targets)) > 1

    def evaluate(
        self,
        paths: Paths,
        parameters: Mapping[str, object],
        many: ManyConfig | None,
        asked: str | None,
        more: Mapping[str, float] | None = None,
    ) -> Evaluation:
        """All figures; tables of errors, failures, counts and the bound are written as they come.

        Args:
            paths: inputs and outputs.
            parameters: for the provenance of tables.
            many: settings of the figures of many targets, with a match distance; None: these are not wanted.
            asked: which identities are a target's own, as the user asked for it.
            more: figures of what is beside these.
        """
        known, unit, config, sources = self.known, self._scene.length_unit, self._config, self._sources
        made = Made() if sources.tracks is None else Made.of(sources.tracks.provenance)
        against, evidence = AgainstTruth(made, self._scene), Evidence(rows=known.estimates)
        if sources.diagnostics is not None:
            evidence.rows = 0
            for rows in sources.rows_of_diagnostics():
                evidence.fared(rows)
        with ExitStack() as stack:
            out = Written(stack, paths, parameters, unit)
            errors_out = out.table(paths.errors, Errors)
            failures_out = None if many is None else out.table(paths.failures, Failures)
            counts_out = None if many is None else out.table(paths.counts, Counts)
            bound_out = out.table(paths.bound, Bound)
            theirs, ours = (np.array(list(each), dtype=np.int64) for each in (known.targets, known.tracks))
            ground = None if many is None else GroundFigures(theirs, ours, known.frames, many, unit)
            by_distance = None if not self._compares or config.match == "id" or known.single else PairSums(known)
            if ground is not None or by_distance is not None:
                begin = 0
                for part in self._stretches(many):
                    if by_distance is not None:
                        by_distance.add(part, config)
                    if ground is not None and many is not None and len(part.times):
                        counts = ground.first(self._part(part, begin, many))
                        begin += len(part.times)
                        if counts_out is not None:
                            counts_out.write(counts)
            pairs = self._by_number() if by_distance is None else by_distance.pairs()
            if self._compares and known.single is not None:
                pairs = dict([known.single])
            seen, beside = None, None
            if self._beside:
                places = paths.write_scene is not None
                seen = WithBearings(sources, known, self._outlines, self._scene, config, places=places)
                beside = seen.begin(pairs, evidence, made, high_tracks=self._high)
            streams, begin = CompareStreams(known, pairs, config, unit), 0
            for part in self._stretches(many, beside):
                errors = streams.add(part) if self._compares else Errors.empty()
                if seen is not None:
                    seen.add(part, errors, streams.late)
                against.add(errors)
                if errors_out is not None:
                    errors_out.write(errors)
                if ground is not None and many is not None and len(part.times):
                    failures = ground.second(self._part(part, begin, many))
                    begin += len(part.times)
                    if failures_out is not None:
                        failures_out.write(failures)
            if seen is not None:
                seen.finish(bound_out.write if bound_out is not None else lambda _: None)
            metrics, notes = self._figures(streams, seen, smoothed=made.smoothed)
            metrics |= {name: float(value) for name, value in (more or {}).items()}
            if ground is not None and many is not None:
                metrics = {**metrics, **{name: v for name, v in ground.metrics().items() if name not in metrics}}
                apart = line_of_errors_apart(metrics, unit, config.match)
                notes = (*notes, *ground.notes(), *own_notes(paths.tracks, many.own, asked), *apart)
            if seen is not None:
                self.noise = seen.noise_at_known_places()
                metrics |= figures_of(self.noise)
                notes = (*notes, *(notes_of(self._scene, self.noise) if self.noise else ()))
            findings = None
            if against.rows or sources.diagnostics is not None or (seen is not None and seen.rows):
                findings = with_truth(evidence, made, against, unknown=known.unknown, metrics=metrics)
            if made.measured and sources.measured is None and seen is not None and seen.bound_rows:
                notes = (*notes, BOUND_WITHOUT_DISTANCES)
        return Evaluation(metrics, notes=notes, findings=None if sources.tracks is None else findings)

    def _figures(
        self, streams: CompareStreams, seen: WithBearings | None, *, smoothed: bool
    ) -> tuple[dict[str, float], tuple[str, ...]]:
        """Figures in the order of whole tables, and what the user must know."""
        known, notes = self.known, list[str]()
        metrics: dict[str, float] = {}
        if self._compares:
            notes += [] if streams.note is None else [streams.note]
            metrics |= streams.metrics()
        elif self._sources.tracks is not None:
            metrics |= {"tracks": len(known.tracks), "estimates_without_truth": known.estimates}
        if seen is not None:
            metrics |= seen.against_truth()
        if self._compares:
            metrics |= streams.settled(None if seen is None else seen.settled_bound)
        metrics |= {} if seen is None else seen.noise()
        metrics |= {"tracks_smoothed": 1.0} if smoothed else {}
        if seen is not None:
            compared = seen.meeting()
            if self._sources.truth is None and not compared:
                notes.append(seen.note())
            metrics |= compared
        return {name: float(value) for name, value in metrics.items()}, tuple(notes)

    def _by_number(self) -> dict[int, int]:
        return {track: track for track in self.known.tracks if track in self.known.targets}

    def _stretches(self, many: ManyConfig | None, beside: Beside | None = None) -> Iterator[Stretch]:
        gap = 0 if many is None else many.gap_ns(self._config.limit_ns)
        rows = self._sources.rows_of_tracks(), self._sources.rows_of_truth()
        return stretches(*rows, self.known, self._config, gap, beside)

    def _part(self, part: Stretch, begin: int, many: ManyConfig) -> GroundPart:
        limit, unit = self._config.limit_ns, self._scene.length_unit
        places = places_of(part.targets, part.tracks, part.times, begin, many, limit, unit)
        return GroundPart(places, begin, part.rows, part.targets, self.known.over(int(part.times[-1])))


class Written:
    """Tables that are written while rows come."""

    def __init__(self, stack: ExitStack, paths: Paths, parameters: Mapping[str, object], unit: str) -> None:
        """Tables are complete when the stack is left."""
        self._stack, self._paths, self._parameters, self._unit = stack, paths, parameters, unit

    def table(self, path: Path | None, table: type[Table]) -> TableWriter | None:
        """A table; None without a path."""
        if path is None:
            return None
        provenance = provenance_of(self._paths, self._parameters)
        writer = TableWriter(path, table, provenance, overwrite=self._paths.overwrite, length_unit=self._unit)
        return self._stack.enter_context(writer)


def parameters_of(paths: Paths, config: EvaluateConfig, many: ManyConfig | None) -> dict[str, object]:
    """Parameters of the comparison, as the provenance of outputs has them."""
    labels = {"doa_labels": True} if paths.doa_labels else {}
    return {**asdict(config), **labels, **({} if many is None else {"many": asdict(many)})}
