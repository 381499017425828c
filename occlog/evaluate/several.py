"""Work of `occlog evaluate --also`: several recordings in one table, and all of them together.

The figures of all together are those of one long recording in which the recordings follow one another, and in which no
target or track of one is in another: those of each recording are merged.  Counts are added up before rates are made of
them, as TrackEval's COMBINED does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

from occlog.console.details import begin_work
from occlog.errors import UsageError, option
from occlog.evaluate.inputs import lost_earlier, open_sources
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import ManyConfig, own_targets_by
from occlog.evaluate.mot.run import compared_boxes, in_images
from occlog.io.files.texts.json_file import write_json
from occlog.io.open import of_others
from occlog.records.losses import Loss
from occlog.records.verdicts import Verdict, summary_of
from occlog.request import Form
from occlog.runner import Job
from occlog.settings import configure
from occlog.track.images.run.provenance import born_from_detections

from .request import EvaluateRequest
from .stage import Evaluator

Metrics = dict[str, float]
NOT_COMBINED = ("ospa2_window",)
"""Beginnings of names of figures that are of one recording only."""


class Recording(NamedTuple):
    """Tracks and truth of one recording."""

    tracks: Path
    truth: Path


class Several(NamedTuple):
    """Figures of each recording by name, of all together, the unit of lengths; losses and verdicts of inputs."""

    each: dict[str, dict[str, float]]
    combined: dict[str, float]
    unit: str
    losses: tuple[Loss, ...]
    verdicts: tuple[Verdict, ...]

    @property
    def metrics(self) -> dict[str, float]:
        """Flat: those of all together, then those of each recording with names that end in `_recording_NAME`."""
        own = {f"{name}_recording_{who}": value for who, row in self.each.items() for name, value in row.items()}
        return self.combined | own


ALONE = (
    *("metrics", "bearings", "measurements", "doa", "views", "cooperation", "diagnostics"),
    *("errors", "bound", "failures", "counts", "mot"),
)
"""What is of one recording."""


def evaluate_several(request: EvaluateRequest, job: Job) -> Several:
    """Read, compare, write the figures of several recordings, all with tracks in images or all on the ground."""
    for entry in Form(EvaluateRequest).entries():
        if entry.field in ALONE and getattr(request, entry.field):
            raise UsageError(f"{option(entry.key)} is of one recording; leave out {option('also')}")
    if request.tracks is None or request.truth is None:
        raise UsageError(f"{option('also')} wants TRACKS with {option('truth')} beside it")
    recordings = [Recording(request.tracks, request.truth), *(Recording(*pair) for pair in request.more)]
    kinds = {in_images(recording.tracks) for recording in recordings}
    if len(kinds) > 1:
        raise UsageError(f"{option('also')}: tracks in images and tracks on the ground cannot be put together")
    begin_work()
    chosen = configure(EvaluateConfig(), request.settings)
    sides = [replace(request, tracks=each.tracks, truth=each.truth, more=()) for each in recordings]
    if kinds.pop():
        each, whole, unit = *_in_images(sides), "px"
    else:
        each, whole, unit = _on_ground(sides, chosen)
    combined = {n: v for n, v in whole.items() if not n.startswith(NOT_COMBINED) and "_sensor_" not in n}
    provenance = job.provenance({**asdict(chosen), **request.many}, lost_earlier(request.inputs))
    named = dict(zip(_names(recordings), each, strict=True))
    found = Several(named, combined, unit, provenance.losses, provenance.judged)
    if request.output is not None:
        values = {**found.metrics, **summary_of(found.verdicts), "_provenance": provenance.as_dict()}
        write_json(request.output, values, overwrite=job.overwrite)
    return found


def _in_images(sides: Sequence[EvaluateRequest]) -> tuple[list[Metrics], Metrics]:
    """Figures of each recording, and of all together, in which every view of a recording is a view of its own."""
    each, whole = list[Metrics](), None
    views, counts = list[int](), Counter[str]()
    for side in sides:
        compared, _, _ = compared_boxes(side)
        figures = compared.figures()
        each.append(figures.result(compared.frames, compared.counts))
        views += compared.frames
        counts.update(compared.counts)
        if whole is None:
            whole = figures
        else:
            whole.merge(figures)
    assert whole is not None
    return each, whole.result(views, dict(counts))


def _on_ground(sides: Sequence[EvaluateRequest], chosen: EvaluateConfig) -> tuple[list[Metrics], Metrics, str]:
    """Figures of each recording, of all together, and the unit of lengths."""
    opened = [open_sources(side, held_boxes=False) for side in sides]
    units = [scene.length_unit for _, scene, _ in opened]
    if len(set(units)) > 1:
        raise UsageError(
            f"{option('also')}: lengths are in {' and '.join(sorted(set(units)))}; they cannot be put together"
        )
    each, whole = list[Metrics](), None
    for side, (sources, scene, _) in zip(sides, opened, strict=True):
        if sources.truth is None:
            raise UsageError(f"{option('also')}: {side.truth} holds no true positions")
        born = born_from_detections(side.tracks) or of_others(side.tracks)
        own = "start" if born else own_targets_by(chosen, numbered_itself=False)
        config = configure(ManyConfig.in_unit(scene.length_unit), {"own": own, **side.many})
        figures = Evaluator(sources, scene, chosen).of_many(config)
        each.append(figures.result())
        if whole is None:
            whole = figures
        else:
            whole.merge(figures)
    assert whole is not None
    return each, whole.result(), units[0]


def _names(recordings: Sequence[Recording]) -> list[str]:
    """A name for each recording: that of its tracks, or of its truth where these differ and the former do not."""
    for side in ([r.tracks.stem for r in recordings], [r.truth.stem for r in recordings]):
        if len(set(side)) == len(side):
            return side
    return [f"{number}" for number in range(1, len(recordings) + 1)]
