"""Tracks against the truth in stretches of time: figures of whole tables, in memory that does not grow with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import numpy as np

from occlog.io.files.parquet import TableWriter
from occlog.io.open import Opened, open_input
from occlog.records.columns import Table
from occlog.records.scene import Scene
from occlog.records.tables import Diagnostics, Errors, Tracks, Truth
from occlog.records.views import Counts, Failures
from occlog.track.images.run.provenance import own_notes
from occlog.track.plausibility.verdict import Evidence

from .errors.streamed import CompareStreams, PairSums, Stretch, stretches
from .errors.survey import Survey, survey
from .inputs import Paths, provenance_of
from .matching.config import EvaluateConfig
from .mot.apart import line_of_errors_apart
from .mot.config import ManyConfig
from .mot.on_ground import GroundFigures, GroundPart, places_of
from .stage import Evaluation
from .verdict import AgainstTruth, Made, with_truth


class InStretches:
    """Tracks and their truth, which are gone through several times."""

    def __init__(self, tracks: Opened, truth: Opened, scene: Scene, config: EvaluateConfig) -> None:
        """Nothing is read but what must be known of the whole (`survey`)."""
        self._tracks, self._truth, self._scene, self._config = tracks, truth, scene, config
        self.known: Survey = survey(tracks.rows(Tracks), truth.rows(Truth))

    @property
    def can(self) -> bool:
        """Whether there is something to compare; whole tables say better what is wrong with the others."""
        known = self.known
        return bool(known.tracks and known.targets) and (self._config.match != "id" or bool(self._by_number()))

    @property
    def several(self) -> bool:
        """Whether there are several tracks or targets."""
        return max(len(self.known.tracks), len(self.known.targets)) > 1

    def evaluate(
        self,
        paths: Paths,
        parameters: Mapping[str, object],
        many: ManyConfig | None,
        asked: str | None,
    ) -> Evaluation:
        """All figures; tables of errors, failures and counts are written as they come.

        Args:
            paths: inputs and outputs.
            parameters: for the provenance of tables.
            many: settings of the figures of many targets, with a match distance; None: these are not wanted.
            asked: which identities are a target's own, as the user asked for it.
        """
        known, unit, config = self.known, self._scene.length_unit, self._config
        made = Made.of(self._tracks.provenance)
        against, evidence = AgainstTruth(made, self._scene), Evidence(rows=known.estimates)
        with ExitStack() as stack:

            def written(path: Path | None, table: type[Table]) -> TableWriter | None:
                if path is None:
                    return None
                provenance = provenance_of(paths, parameters)
                return stack.enter_context(
                    TableWriter(path, table, provenance, overwrite=paths.overwrite, length_unit=unit)
                )

            errors_out = written(paths.errors, Errors)
            failures_out = None if many is None else written(paths.failures, Failures)
            counts_out = None if many is None else written(paths.counts, Counts)
            theirs, ours = (np.array(list(each), dtype=np.int64) for each in (known.targets, known.tracks))
            ground = None if many is None else GroundFigures(theirs, ours, known.frames, many, unit)
            by_distance = None if config.match == "id" or known.single is not None else PairSums(known)
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
            if known.single is not None:
                pairs = dict([known.single])
            streams, begin = CompareStreams(known, pairs, config, unit), 0
            for part in self._stretches(many):
                errors = streams.add(part)
                against.add(errors)
                if errors_out is not None:
                    errors_out.write(errors)
                if ground is not None and many is not None and len(part.times):
                    failures = ground.second(self._part(part, begin, many))
                    begin += len(part.times)
                    if failures_out is not None:
                        failures_out.write(failures)
            metrics = streams.metrics() | ({"tracks_smoothed": 1.0} if made.smoothed else {})
            notes = () if streams.note is None else (streams.note,)
            if ground is not None and many is not None:
                metrics = {**metrics, **{name: v for name, v in ground.metrics().items() if name not in metrics}}
                apart = line_of_errors_apart(metrics, unit, config.match)
                notes = (*notes, *ground.notes(), *own_notes(paths.tracks, many.own, asked), *apart)
            if paths.diagnostics is not None:
                evidence.rows = 0
                for rows in open_input(paths.diagnostics).rows(Diagnostics):
                    evidence.fared(rows)
            findings = with_truth(evidence, made, against, unknown=known.unknown, metrics=metrics)
        return Evaluation(metrics, notes=notes, findings=findings)

    def _by_number(self) -> dict[int, int]:
        return {track: track for track in self.known.tracks if track in self.known.targets}

    def _stretches(self, many: ManyConfig | None) -> Iterator[Stretch]:
        gap = 0 if many is None else many.gap_ns(self._config.limit_ns)
        return stretches(self._tracks.rows(Tracks), self._truth.rows(Truth), self.known, self._config, gap)

    def _part(self, part: Stretch, begin: int, many: ManyConfig) -> GroundPart:
        limit, unit = self._config.limit_ns, self._scene.length_unit
        places = places_of(part.targets, part.tracks, part.times, begin, many, limit, unit)
        last = int(part.times[-1])
        over = tuple(
            np.array([life.last_ns <= last for life in each.values()], dtype=np.bool_)
            for each in (self.known.targets, self.known.tracks)
        )
        return GroundPart(places, begin, part.rows, part.targets, (over[0], over[1]))


def parameters_of(paths: Paths, config: EvaluateConfig, many: ManyConfig | None) -> dict[str, object]:
    """Parameters of the comparison, as the provenance of outputs has them."""
    labels = {"doa_labels": True} if paths.doa_labels else {}
    return {**asdict(config), **labels, **({} if many is None else {"many": asdict(many)})}
