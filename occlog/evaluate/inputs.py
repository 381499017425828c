"""What `occlog evaluate` reads (tracks, truth, bearings, directions, views, scene), and how that was made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from occlog.array_types import Ints
from occlog.errors import InputError, UsageError
from occlog.evaluate.stretches.sources import MeasuredSource, no_frames, no_true_box, streamed_bearings
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.open import Opened, check_unit, common_unit, load_scene, losses_of, open_if_ours, open_input
from occlog.records.columns import Table
from occlog.records.declared.measurements import Measurements
from occlog.records.declared.people import PeopleTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import (
    Bearings,
    Boxes,
    Cooperation,
    Diagnostics,
    Reads,
    Tracks,
    Truth,
    TruthBoxes,
    Views,
)
from occlog.scans.config import MeasuredConfig
from occlog.scans.measured import Radio, measurements_of_reads
from occlog.scans.shadowing import Shadowing

from .verdict import Made

T = TypeVar("T", bound=Table)
N = TypeVar("N", Views, TruthBoxes)


@dataclass(frozen=True)
class Paths:
    """Files to read and to write; None where not given."""

    tracks: Path | None = None
    truth: Path | None = None
    bearings: Path | None = None
    doa: Path | None = None
    views: Path | None = None
    measurements: Path | None = None
    cooperation: Path | None = None
    diagnostics: Path | None = None
    scene: Path | None = None
    output: Path | None = None
    errors: Path | None = None
    bound: Path | None = None
    write_scene: Path | None = None
    failures: Path | None = None
    counts: Path | None = None
    mot: Path | None = None
    doa_labels: bool = False
    overwrite: bool = False

    @property
    def directions(self) -> Path | None:
        """What holds bearings or directions of arrival, for messages."""
        return self.bearings or self.doa

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that is read."""
        files = (self.tracks, self.truth, self.bearings, self.doa, self.views, self.cooperation, self.diagnostics)
        given = (*files, self.measurements, self.scene)
        return tuple(dict.fromkeys(p for p in given if p is not None))


@dataclass(frozen=True)
class Tables:
    """What was read."""

    scene: Scene
    tracks: Tracks | None
    truth: Truth | None
    truth_boxes: TruthBoxes | None
    bearings: Bearings | None
    views: Views | None
    cooperation: Cooperation | None
    diagnostics: Diagnostics | None
    made: Made  # how the tracks were made
    found: Boxes | Views | None = None  # everybody's boxes, of which a camera's are to be predicted
    measured: tuple[Measurements, MeasuredConfig, Radio | None] | None = None  # of distances, for the bound


def read_tables(paths: Paths, *, everybody: bool = False) -> Tables:
    """Everything that was named, with the scene of `--scene` or of the recording with the truth.

    With `everybody` the views are not compared with true boxes, but predicted; boxes serve as well.
    """
    tracks, truth, scene = open_tables(paths)
    boxes = _rows_of(truth, TruthBoxes)
    found = open_input(paths.views) if paths.views is not None and everybody else None
    if paths.views is not None and truth is not None and boxes is None and not everybody:
        truth.require(TruthBoxes)
    return Tables(
        scene=scene,
        tracks=None if tracks is None else tracks.read(PeopleTracks if everybody else Tracks),
        truth=_rows_of(truth, Truth),
        truth_boxes=boxes,
        bearings=read_bearings(paths.bearings, paths.doa, paths.doa_labels, scene),
        views=None if paths.views is None or everybody else open_input(paths.views).read(Views),
        cooperation=None if paths.cooperation is None else open_input(paths.cooperation).read(Cooperation),
        diagnostics=None if paths.diagnostics is None else open_input(paths.diagnostics).read(Diagnostics),
        made=Made() if tracks is None else Made.of(tracks.provenance),
        found=None if found is None else _boxes_or_views(found),
        measured=None if paths.measurements is None else open_measured(paths.measurements, tracks, scene).read(),
    )


def open_tables(paths: Paths) -> tuple[Opened | None, Opened | None, Scene]:
    """Tracks and truth, of which nothing is read yet, and the scene, whose unit of lengths they have."""
    truth = None if paths.truth is None else _open_truth(paths.truth)
    tracks = None if paths.tracks is None else open_input(paths.tracks, Tracks)
    scene = _scene(paths, tracks, truth)
    for opened in (tracks, truth):
        if opened is not None:
            check_unit(opened, scene.length_unit, error=InputError)
    return tracks, truth, scene


def open_measured(path: Path, tracks: Opened | None, scene: Scene) -> MeasuredSource:
    """Measurements of distances, with the settings that the tracks were made with; defaults where these do not say."""
    opened = open_input(path, Measurements, Reads)
    if not scene.sensors:
        raise UsageError(f"{path}: stations have no places without a scene; give one")
    if opened.has_lengths(Measurements):
        check_unit(opened, scene.length_unit, error=InputError)

    def rows() -> Iterator[Measurements]:
        if opened.has(Reads) and not opened.has(Measurements):
            return measurements_of_reads(opened.rows(Reads))
        return opened.rows(Measurements)

    made = {} if tracks is None else tracks.provenance.parameters.get("measurements")
    said = dict(made) if isinstance(made, dict) else {}
    radio = said.get("radio")
    known = {f.name: said[f.name] for f in fields(MeasuredConfig) if f.name in said}
    return MeasuredSource(rows, MeasuredConfig(**known), _radio(radio) if isinstance(radio, dict) else None)


def _radio(said: dict[str, Any]) -> Radio:
    """The path loss that tracks were made with."""
    return Radio(**(said | {"shadowing": Shadowing(**said["shadowing"])}))


def in_frames(tables: Tables, frames: tuple[int, int]) -> Tables:
    """Rows of the frames first <= number < stop.

    Views and true boxes have numbers of frames; everything else is taken from the time of the first frame on up to that
    of the one after the last, where frames are the times of true targets, else of true boxes, bearings or tracks.

    Raises:
        InputError: no row is in these frames.
    """
    first, stop = frames
    timed = (tables.tracks, tables.truth, tables.bearings, tables.cooperation, tables.diagnostics, tables.found)
    times = _times_of_frames(tables)
    if any(table is not None for table in timed) and not 0 <= first < min(stop, len(times)):
        raise no_frames(frames, len(times))
    low = int(times[first]) if first < len(times) else 0
    high = int(times[stop]) if stop < len(times) else np.iinfo(np.int64).max

    def during(table: T | None) -> T | None:
        if table is None:
            return None
        t_ns = table.t_ns  # type: ignore[attr-defined]
        return table.take((t_ns >= low) & (t_ns < high))

    found = tables.found
    if found is not None:
        found = found.take((found.t_ns >= low) & (found.t_ns < high))
    measured = tables.measured
    if measured is not None:
        measured = (measured[0].take((measured[0].t_ns >= low) & (measured[0].t_ns < high)), *measured[1:])

    def numbered(table: N | None) -> N | None:
        return None if table is None else table.take((table.frame >= first) & (table.frame < stop))

    boxes = numbered(tables.truth_boxes)
    if boxes is not None and tables.views is not None and not len(boxes):
        raise no_true_box(frames)
    return replace(
        tables,
        tracks=during(tables.tracks),
        truth=during(tables.truth),
        truth_boxes=boxes,
        bearings=during(tables.bearings),
        views=numbered(tables.views),
        found=found,
        measured=measured,
        cooperation=during(tables.cooperation),
        diagnostics=during(tables.diagnostics),
    )


def _times_of_frames(tables: Tables) -> Ints:
    """Distinct times by which frames are numbered."""
    truth = tables.truth
    if truth is not None and (truth.role == "target").any():
        return np.unique(truth.t_ns[truth.role == "target"])
    for table in (tables.truth_boxes, tables.bearings, tables.found, tables.tracks):
        if table is not None and len(table):
            return np.unique(table.t_ns)
    return np.zeros(0, dtype=np.int64)


def _open_truth(path: Path) -> Opened:
    """True positions, boxes or both."""
    remedy = "leave the truth out, or ingest the recording with its truth"
    return open_input(path, Truth, TruthBoxes, remedy=remedy)


def _scene(paths: Paths, tracks: Opened | None, truth: Opened | None) -> Scene:
    """The scene of `--scene` or of the recording.

    Views are compared without one, and so are tracks with a truth, in the unit that they state, or in metres.
    """
    recorded = None if truth is None else truth.scene
    if paths.scene is None and recorded is None and paths.directions is None and paths.views is None:
        return Scene(length_unit=common_unit((truth, tracks))[0])
    if paths.tracks is None and paths.directions is None and paths.scene is None:
        return recorded or Scene()
    for path in (paths.bearings, paths.doa, paths.views):
        if recorded is None and paths.scene is None and path is not None:
            recorded = open_input(path).scene
    return load_scene(paths.scene, recorded, paths.truth or paths.inputs[0])


def _boxes_or_views(opened: Opened) -> Boxes | Views:
    """Everybody's boxes; of a recording with both those of the detector."""
    return opened.read(Boxes) if opened.has(Boxes) else opened.read(Views)


def _rows_of(opened: Opened | None, table: type[T]) -> T | None:
    """All rows of a table; None without a file, or in a file that holds none."""
    return opened.read(table) if opened is not None and opened.has(table) else None


def read_bearings(path: Path | None, doa: Path | None, labels: bool, scene: Scene) -> Bearings | None:
    """All bearings, and directions of arrival as such: see `streamed_bearings`."""
    rows = streamed_bearings(path, doa, labels, scene)
    return None if rows is None else Bearings.concat(rows())


def provenance_of(paths: Paths, parameters: Mapping[str, object]) -> Provenance:
    """Parameters, inputs, and what was lost in making the inputs."""
    return Provenance("evaluate", dict(parameters), None, hash_inputs(paths.inputs), lost_earlier(paths.inputs))


def lost_earlier(paths: Iterable[Path]) -> tuple[Loss, ...]:
    """What was lost in making the inputs."""
    return losses_of(open_if_ours(path) for path in paths)
