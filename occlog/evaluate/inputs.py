"""What `occlog evaluate` reads (tracks, truth, bearings, directions, views, scene), and how that was made."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from occlog.errors import InputError, UsageError
from occlog.io.files.inputs import hash_inputs
from occlog.io.files.provenance import Provenance
from occlog.io.files.put_aside.table import Aside
from occlog.io.open import Opened, check_unit, common_unit, load_scene, losses_of, open_if_ours, open_input
from occlog.records.columns import Table
from occlog.records.declared.measurements import Measurements
from occlog.records.declared.people import PeopleTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import (
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

from .sources import MeasuredSource, Sources, opened_rows, streamed_bearings
from .verdict import Made


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


def open_sources(
    paths: Paths, frames: tuple[int, int] | None, *, held_boxes: bool
) -> tuple[Sources, Scene, Opened | None]:
    """Everything that is named, of which nothing is read yet; the scene, and the tracks.

    Args:
        paths: the inputs.
        frames: first frame that counts, and the one after the last; None: all.
        held_boxes: views, or boxes, are not compared with true boxes, but predicted in cameras that are held out.
    """
    tracks, truth, scene = open_tables(paths)
    if paths.views is not None and truth is not None and not held_boxes:
        truth.require(TruthBoxes)
    views = _opened(paths.views, *((Boxes, Views) if held_boxes else (Views,)))
    boxes: Any = None
    if held_boxes and views is not None:
        # Of a recording with both those of the detector
        boxes = opened_rows(views, Boxes) if views.has(Boxes) else opened_rows(views, Views)
    sources = Sources(
        tracks=opened_rows(tracks, PeopleTracks if held_boxes else Tracks),
        truth=opened_rows(truth, Truth),
        bearings=streamed_bearings(paths.bearings, paths.doa, paths.doa_labels, scene),
        diagnostics=opened_rows(_opened(paths.diagnostics, Diagnostics), Diagnostics),
        measured=None if paths.measurements is None else open_measured(paths.measurements, tracks, scene),
        views=None if held_boxes else opened_rows(views, Views),
        truth_boxes=opened_rows(truth, TruthBoxes),
        cooperation=opened_rows(_opened(paths.cooperation, Cooperation), Cooperation),
        boxes=boxes,
        made=Made() if tracks is None else Made.of(tracks.provenance),
    )
    return (sources if frames is None else sources.in_frames(frames)), scene, tracks


def _opened(path: Path | None, *tables: type[Table]) -> Opened | None:
    return None if path is None else open_input(path, *tables)


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
    again = rows if opened.recording is None else Aside(Measurements, rows).chunks
    return MeasuredSource(again, MeasuredConfig(**known), _radio(radio) if isinstance(radio, dict) else None)


def _radio(said: dict[str, Any]) -> Radio:
    """The path loss that tracks were made with."""
    return Radio(**(said | {"shadowing": Shadowing(**said["shadowing"])}))


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


def provenance_of(paths: Paths, parameters: Mapping[str, object]) -> Provenance:
    """Parameters, inputs, and what was lost in making the inputs."""
    return Provenance("evaluate", dict(parameters), None, hash_inputs(paths.inputs), lost_earlier(paths.inputs))


def lost_earlier(paths: Iterable[Path]) -> tuple[Loss, ...]:
    """What was lost in making the inputs."""
    return losses_of(open_if_ours(path) for path in paths)
