"""Work of `occlog evaluate --also`: several recordings in one table, and all of them together.

The figures of all together are those of one long recording in which the recordings follow one another, and in which no
target or track of one is in another: counts are added up before rates are made of them, as TrackEval's COMBINED does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Ints, Ints32
from occlog.cli import options
from occlog.core.metrics.frame_pairs import Objects
from occlog.details import begin_work
from occlog.errors import UsageError
from occlog.io.files.json_file import write_json
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.open import of_others
from occlog.records.tables import Tracks, Truth
from occlog.settings import configure
from occlog.track.images.run.provenance import born_from_detections

from .inputs import Paths, in_frames, read_tables
from .matching.config import EvaluateConfig
from .mot.config import ManyConfig
from .mot.on_ground import evaluate_ground, times_of
from .mot.run import compared_boxes, in_images
from .mot.stage import evaluate_views
from .mot.truth_and_tracks import TruthAndTracks

COMBINED = "combined"
APART = 3600 * NS
"""Time between the recordings where they follow one another [ns]; no gap is bridged over it."""
NOT_COMBINED = ("ospa2_window",)
"""Beginnings of names of figures that are of one recording only."""


class Recording(NamedTuple):
    """Tracks and truth of one recording."""

    tracks: Path
    truth: Path


class Several(NamedTuple):
    """Figures of each recording by name, of all together, and the unit of lengths."""

    each: dict[str, dict[str, float]]
    combined: dict[str, float]
    unit: str

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
    options.check_outputs(files, (paths.output,), paths.overwrite)
    kinds = {in_images(recording.tracks) for recording in recordings}
    if len(kinds) > 1:
        raise UsageError("also: tracks in images and tracks on the ground cannot be put together")
    names = _names(recordings)
    begin_work()
    if kinds.pop():
        told = {**given} if frames is None else {**given, "frames": frames}
        found = _of_images(recordings, names, chosen, told)
    else:
        found = _of_ground(recordings, names, paths, chosen, given, frames)
    if paths.output is not None:
        provenance = Provenance("evaluate", {**asdict(chosen), **given}, None, hash_inputs(files))
        write_json(paths.output, {**found.metrics, "_provenance": provenance.as_dict()}, overwrite=paths.overwrite)
    return found


def _names(recordings: Sequence[Recording]) -> list[str]:
    """A name for each recording: that of its tracks, or of its truth where these differ and the former do not."""
    for side in ([r.tracks.stem for r in recordings], [r.truth.stem for r in recordings]):
        if len(set(side)) == len(side):
            return side
    return [f"{number}" for number in range(1, len(recordings) + 1)]


def _combined(metrics: Mapping[str, float]) -> dict[str, float]:
    return {n: v for n, v in metrics.items() if not n.startswith(NOT_COMBINED) and "_sensor_" not in n}


def _of_images(
    recordings: Sequence[Recording], names: list[str], chosen: EvaluateConfig, given: Mapping[str, object]
) -> Several:
    each, parts, config = {}, [], ManyConfig()
    for recording, name in zip(recordings, names, strict=True):
        paths = Paths(tracks=recording.tracks, truth=recording.truth)
        compared, config, _ = compared_boxes(paths, chosen.box_overlap, given)
        each[name] = evaluate_views(compared, config).metrics
        parts.append(compared)
    return Several(each, _combined(evaluate_views(_boxes_together(parts, names), config).metrics), "px")


def _boxes_together(parts: Sequence[TruthAndTracks], names: Sequence[str]) -> TruthAndTracks:
    """Recordings as views of one, with identities of their own."""
    truth, tracks, used, views = [], [], 0, 0
    for part in parts:
        known = np.unique(np.concatenate([part.truth.label, part.tracks.label]))
        truth.append(_renumbered(part.truth, known, used, views))
        tracks.append(_renumbered(part.tracks, known, used, views))
        used, views = used + len(known), views + len(part.views)
    return TruthAndTracks(
        views=tuple(f"{name}/{view}" for name, part in zip(names, parts, strict=True) for view in part.views),
        truth=_joined(truth),
        tracks=_joined(tracks),
        visible=np.concatenate([part.visible for part in parts]),
        t_ns=tuple(times for part in parts for times in part.t_ns),
        number=tuple(numbers for part in parts for numbers in part.number),
        counts={name: sum(part.counts[name] for part in parts) for name in parts[0].counts},
        left_out=(),
    )


def _renumbered(side: Objects, known: Ints, used: int, views: int) -> Objects:
    view = np.zeros(len(side.frame), dtype=np.int64) if side.view is None else side.view
    return side._replace(label=used + np.searchsorted(known, side.label), view=views + view)


def _joined(sides: Sequence[Objects]) -> Objects:
    return Objects(
        frame=np.concatenate([s.frame for s in sides]),
        label=np.concatenate([s.label for s in sides]),
        place=np.concatenate([s.place for s in sides]),
        view=np.concatenate([s.view for s in sides if s.view is not None]),
    )


def _of_ground(
    recordings: Sequence[Recording],
    names: list[str],
    paths: Paths,
    chosen: EvaluateConfig,
    given: Mapping[str, object],
    frames: tuple[int, int] | None,
) -> Several:
    each, sides, units, config = {}, [], [], ManyConfig()
    for recording, name in zip(recordings, names, strict=True):
        tables = read_tables(replace(paths, tracks=recording.tracks, truth=recording.truth))
        tables = tables if frames is None else in_frames(tables, frames)
        if tables.tracks is None or tables.truth is None:
            raise UsageError(f"also: {recording.truth} holds no true positions")
        units.append(tables.scene.length_unit)
        born = born_from_detections(recording.tracks) or of_others(recording.tracks)
        own = "start" if born else ("label" if chosen.match == "id" else "best")
        config = configure(ManyConfig.in_unit(units[0]), {"own": own, **given})
        each[name] = evaluate_ground(tables.tracks, tables.truth, config, chosen.limit_ns, units[0]).metrics
        sides.append((tables.tracks, tables.truth))
    if len(set(units)) > 1:
        raise UsageError(f"also: lengths are in {' and '.join(sorted(set(units)))}; they cannot be put together")
    tracks, truth, times = _positions_together(sides)
    whole = evaluate_ground(tracks, truth, config, chosen.limit_ns, units[0], times)
    return Several(each, _combined(whole.metrics), units[0])


def _positions_together(sides: Sequence[tuple[Tracks, Truth]]) -> tuple[Tracks, Truth, Ints]:
    """Recordings one after another, with identities of their own, and the times of their frames."""
    tracks: list[Tracks] = []
    truth: list[Truth] = []
    frames: list[Ints] = [np.zeros(0, dtype=np.int64)]
    used = now = 0
    for ours, theirs in sides:
        known = np.unique(np.concatenate([ours.target_id, theirs.target_id]))
        times = np.concatenate([ours.t_ns, theirs.t_ns])
        if not len(times):
            continue
        begin = int(times.min()) - now
        frames.append(times_of(ours, theirs) - begin)
        tracks.append(replace(ours, t_ns=ours.t_ns - begin, target_id=_numbered(ours.target_id, known, used)))
        truth.append(replace(theirs, t_ns=theirs.t_ns - begin, target_id=_numbered(theirs.target_id, known, used)))
        used, now = used + len(known), now + int(np.ptp(times)) + APART
    return Tracks.concat(tracks), Truth.concat(truth), np.concatenate(frames)


def _numbered(labels: Ints32, known: Ints32, used: int) -> Ints32:
    """Places of labels among those that are known, after so many that are used."""
    return (used + np.searchsorted(known, labels)).astype(np.int32)
