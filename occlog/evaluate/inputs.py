"""Inputs of `occlog evaluate`: tracks, truth, bearings, directions, views, scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from fractions import Fraction
from pathlib import Path
from typing import Any

from occlog.errors import InputError, UsageError, option
from occlog.io.files.spill import SpilledTable
from occlog.io.files.timing.frame_times import as_rate
from occlog.io.open import REMEDY, Opened, check_unit, common_unit, frames_counted_by, load_scene, open_input
from occlog.records.columns import ColumnTable
from occlog.records.declared.people import PeopleTracks
from occlog.records.declared.sensors import Measurements
from occlog.records.scene import Scene
from occlog.records.tables import Boxes, Cooperation, Diagnostics, Reads, Tracks, Truth, TruthBoxes, Views
from occlog.scans.config import DistanceMeasurementConfig
from occlog.scans.distance_measurements import Radio, SignalErrors, measurements_of_reads

from .request import EvaluateRequest
from .sources import EvaluationSources, MeasuredSource, opened_rows, streamed_bearings
from .verdict import TrackProvenance


def open_sources(request: EvaluateRequest, *, held_boxes: bool) -> tuple[EvaluationSources, Scene, Opened | None]:
    """Open all inputs of the request without reading them; return them, the scene, and the tracks (None: not given).

    Args:
        request: names the files.
        held_boxes: true if `--views` has boxes of held-out cameras, to be predicted from tracks, instead of views to be
            compared with true boxes.
    """
    tracks, truth, scene = open_tables(request)
    if request.views is not None and truth is not None and not held_boxes:
        truth.require(TruthBoxes)
    if truth is not None and not truth.has(Truth) and request.views is None and request.directions is None:
        raise InputError(
            f"{truth.path}: holds true boxes, no positions; compare tracks in images (view_tracks.parquet)",
            id="wrong-content",
        )
    views = _opened(request.views, *((Boxes, Views) if held_boxes else (Views,)))
    boxes: Any = None
    if held_boxes and views is not None:
        # Of a recording with both those of the detector
        boxes = opened_rows(views, Boxes) if views.has(Boxes) else opened_rows(views, Views)
    sources = EvaluationSources(
        tracks=opened_rows(tracks, PeopleTracks if held_boxes else Tracks),
        truth=opened_rows(truth, Truth),
        bearings=streamed_bearings(request.bearings, request.doa, request.doa_labels, scene),
        diagnostics=opened_rows(_opened(request.diagnostics, Diagnostics), Diagnostics),
        measured=None if request.measurements is None else open_measured(request.measurements, tracks, scene),
        views=None if held_boxes else opened_rows(views, Views),
        truth_boxes=opened_rows(truth, TruthBoxes),
        cooperation=opened_rows(_opened(request.cooperation, Cooperation), Cooperation),
        boxes=boxes,
        made=TrackProvenance() if tracks is None else TrackProvenance.of(tracks.provenance),
    )
    return (sources if request.frames is None else sources.in_frames(request.frames)), scene, tracks


def _opened(path: Path | None, *tables: type[ColumnTable]) -> Opened | None:
    return None if path is None else open_input(path, *tables)


def open_tables(request: EvaluateRequest) -> tuple[Opened | None, Opened | None, Scene]:
    """Open tracks and truth of the request (None if not given) without reading them, and the scene.

    InputError if their length unit differs from the scene's; UsageError for a frame rate that no table needs.
    """
    rate = request.multi_target.get("fps")
    fps = None if rate is None else as_rate(str(rate))
    truth = None if request.truth is None else _open_truth(request.truth, fps)
    tracks = None if request.tracks is None else _open(request.tracks, fps, Tracks)
    if fps is not None and not any(opened is not None and opened.counts_frames for opened in (truth, tracks)):
        raise UsageError(
            f"{option('fps')} is for tables that count frames; {request.truth or request.tracks} has times, leave "
            "it out",
            id="not-applicable",
        )
    scene = _scene(request, tracks, truth)
    for opened in (tracks, truth):
        if opened is not None:
            check_unit(opened, scene.length_unit, error=InputError)
    return tracks, truth, scene


def open_measured(path: Path, tracks: Opened | None, scene: Scene) -> MeasuredSource:
    """Open distance measurements or tag reads, with the settings that the tracks were made with.

    Args:
        path: file or recording.
        tracks: tracks that state these settings in their provenance; None: defaults are used.
        scene: positions of the stations; UsageError without sensors.
    """
    opened = open_input(path, Measurements, Reads)
    if not scene.sensors:
        raise UsageError(
            f"{path}: the positions of its stations are unknown; give a scene ({option('scene')})", id="missing-pose"
        )
    if opened.has_lengths(Measurements):
        check_unit(opened, scene.length_unit, error=InputError)

    def rows() -> Iterator[Measurements]:
        if opened.has(Reads) and not opened.has(Measurements):
            return measurements_of_reads(opened.rows(Reads))
        return opened.rows(Measurements)

    made = {} if tracks is None else tracks.provenance.parameters.get("measurements")
    reported = dict(made) if isinstance(made, dict) else {}
    radio = reported.get("radio")
    known = {f.name: reported[f.name] for f in fields(DistanceMeasurementConfig) if f.name in reported}
    again = rows if opened.recording is None else SpilledTable(Measurements, rows).chunks
    return MeasuredSource(again, DistanceMeasurementConfig(**known), _radio(radio) if isinstance(radio, dict) else None)


def _radio(reported: dict[str, Any]) -> Radio:
    """Return the path loss model of radio signals from its values in the provenance of tracks."""
    return Radio(**(reported | {"shadowing": SignalErrors(**reported["shadowing"])}))


def _open_truth(path: Path, fps: Fraction | None) -> Opened:
    """Open an input with true positions, true boxes or both.

    `fps`: frame rate for tables that count frames; None: unknown.
    """
    return _open(path, fps, Truth, TruthBoxes, remedy="leave the truth out, or ingest the recording with its truth")


def _open(path: Path, fps: Fraction | None, *tables: type[ColumnTable], remedy: str = REMEDY) -> Opened:
    """Open an input that holds one of the tables; an external one may count frames.

    Args:
        path: file or recording.
        fps: frame rate; None: InputError if the file counts frames.
        tables: types of the tables that are needed.
        remedy: words for the message if a table is missing.
    """
    if fps is None and (counted := frames_counted_by(path)):
        raise InputError(
            f"{path}: column {counted} counts frames, not times; give the frame rate ({option('fps')})",
            id="missing-times",
        )
    return open_input(path, *tables, remedy=remedy, fps=fps)


def _scene(request: EvaluateRequest, tracks: Opened | None, truth: Opened | None) -> Scene:
    """Return the scene given by `--scene` or in the recording of the truth.

    If neither is given and tracks are compared with a truth, or views are evaluated, the result is an empty scene in
    the unit that the tables state, or in metres.
    """
    recorded = None if truth is None else truth.scene
    if request.scene is None and recorded is None and request.directions is None and request.views is None:
        return Scene(length_unit=common_unit((truth, tracks))[0])
    if request.tracks is None and request.directions is None and request.scene is None:
        return recorded or Scene()
    for path in (request.bearings, request.doa, request.views):
        if recorded is None and request.scene is None and path is not None:
            recorded = open_input(path).scene
    return load_scene(request.scene, recorded, request.truth or request.inputs[0])
