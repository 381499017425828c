"""Work of `occlog evaluate --also`: several recordings in one table, and all of them together.

The figures of all together are those of one long recording in which the recordings follow one another, and in which no
target or track of one is in another: those of each recording are merged.  Counts are added up before rates are made of
them, as TrackEval's COMBINED does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from occlog.console.details import begin_work
from occlog.errors import UsageError
from occlog.evaluate.inputs import Paths, lost_earlier, open_sources
from occlog.evaluate.matching.config import EvaluateConfig
from occlog.evaluate.mot.config import ManyConfig, own_targets_by
from occlog.evaluate.mot.run import compared_boxes, in_images
from occlog.io.files.atomic import check_outputs
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.texts.json_file import write_json
from occlog.io.open import of_others
from occlog.records.losses import Loss
from occlog.records.verdicts import Verdict, summary_of
from occlog.settings import configure
from occlog.track.images.run.provenance import born_from_detections

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


def run_evaluate_several(
    recordings: Sequence[Recording],
    paths: Paths,
    chosen: EvaluateConfig,
    given: Mapping[str, object],
    frames: tuple[int, int] | None,
) -> Several:
    """Read, compare, write the figures of several recordings.

    Args:
        recordings: two or more, all with tracks in images or all with tracks on the ground.
        paths: scene and output; nothing else is used.
        chosen: settings of the comparison.
        given: settings of `ManyConfig` that were given.
        frames: first frame of each to compare, and the one after the last.
    """
    files = [path for recording in recordings for path in recording]
    files += [] if paths.scene is None else [paths.scene]
    check_outputs(files, (paths.output,), paths.overwrite)
    kinds = {in_images(recording.tracks) for recording in recordings}
    if len(kinds) > 1:
        raise UsageError("also: tracks in images and tracks on the ground cannot be put together")
    begin_work()
    sides = [Paths(tracks=each.tracks, truth=each.truth, scene=paths.scene) for each in recordings]
    if kinds.pop():
        parameters = {**given} if frames is None else {**given, "frames": frames}
        each, whole, unit = *_in_images(sides, chosen.box_overlap, parameters), "px"
    else:
        each, whole, unit = _on_ground(sides, chosen, given, frames)
    combined = {n: v for n, v in whole.items() if not n.startswith(NOT_COMBINED) and "_sensor_" not in n}
    provenance = Provenance("evaluate", {**asdict(chosen), **given}, None, hash_inputs(files), lost_earlier(files))
    named = dict(zip(_names(recordings), each, strict=True))
    found = Several(named, combined, unit, provenance.losses, provenance.judged)
    if paths.output is not None:
        values = {**found.metrics, **summary_of(found.verdicts), "_provenance": provenance.as_dict()}
        write_json(paths.output, values, overwrite=paths.overwrite)
    return found


def _in_images(sides: Sequence[Paths], overlap: float, given: Mapping[str, object]) -> tuple[list[Metrics], Metrics]:
    """Figures of each recording, and of all together, in which every view of a recording is a view of its own."""
    each, whole = list[Metrics](), None
    views, counts = list[int](), Counter[str]()
    for paths in sides:
        compared, _, _ = compared_boxes(paths, overlap, given)
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


def _on_ground(
    sides: Sequence[Paths], chosen: EvaluateConfig, given: Mapping[str, object], frames: tuple[int, int] | None
) -> tuple[list[Metrics], Metrics, str]:
    """Figures of each recording, of all together, and the unit of lengths."""
    opened = [open_sources(paths, frames, held_boxes=False) for paths in sides]
    units = [scene.length_unit for _, scene, _ in opened]
    if len(set(units)) > 1:
        raise UsageError(f"also: lengths are in {' and '.join(sorted(set(units)))}; they cannot be put together")
    each, whole = list[Metrics](), None
    for paths, (sources, scene, _) in zip(sides, opened, strict=True):
        if sources.truth is None:
            raise UsageError(f"also: {paths.truth} holds no true positions")
        born = born_from_detections(paths.tracks) or of_others(paths.tracks)
        own = "start" if born else own_targets_by(chosen, numbered_itself=False)
        config = configure(ManyConfig.in_unit(scene.length_unit), {"own": own, **given})
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
