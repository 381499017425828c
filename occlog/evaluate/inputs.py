"""What `occlog evaluate` reads: tracks, truth, bearings, directions of arrival, views, and the scene.

How the outputs of `occlog evaluate` were made.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.io.files.parquet import describe, read_provenance, read_table, schema_name
from occlog.io.files.provenance import Provenance, hash_inputs
from occlog.io.recording.reader import open_recording
from occlog.measure.scans.sources import bearings_of_doa
from occlog.records.scene import Scene
from occlog.records.tables import Bearings, Cooperation, Doa, Tracks, Truth, TruthBoxes, Views

if TYPE_CHECKING:
    from occlog.records.columns import Table


T = TypeVar("T", bound="Table")


@dataclass(frozen=True)
class Paths:
    """Files to read and to write; None where not given."""

    tracks: Path | None = None
    truth: Path | None = None
    bearings: Path | None = None
    doa: Path | None = None
    views: Path | None = None
    cooperation: Path | None = None
    scene: Path | None = None
    output: Path | None = None
    errors: Path | None = None
    bound: Path | None = None
    failures: Path | None = None
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
        given = (self.tracks, self.truth, self.bearings, self.doa, self.views, self.cooperation, self.scene)
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


def read_tables(paths: Paths) -> Tables:
    """Everything that was named, with the scene of `--scene` or of the recording with the truth."""
    truth, boxes, recorded = _read_truth(paths.truth) if paths.truth is not None else (None, None, None)
    scene = _scene(paths, recorded)
    for path in (paths.tracks, paths.truth):
        _check_unit(path, scene)
    if paths.views is not None and boxes is None:
        raise InputError(f"{paths.truth}: holds no true boxes; --views needs a recording or a table that has them")
    return Tables(
        scene,
        _read_rows(paths.tracks, Tracks),
        truth,
        boxes,
        read_bearings(paths.bearings, paths.doa, paths.doa_labels, scene),
        _read_rows(paths.views, Views),
        _read_rows(paths.cooperation, Cooperation),
    )


def _scene(paths: Paths, recorded: Scene | None) -> Scene:
    """The scene of `--scene` or of the recording; views are compared without one."""
    if paths.tracks is None and paths.directions is None and paths.scene is None:
        return recorded or Scene()
    for path in (paths.bearings, paths.doa):
        if recorded is None and paths.scene is None and path is not None and _is_recording(path):
            recorded = options.read_scene_of(path)
    return options.load_scene(paths.scene, recorded, paths.truth or paths.inputs[0])


def _read_rows(path: Path | None, table: type[T]) -> T | None:
    """All rows of a table in a file, None without one."""
    return None if path is None else _rows_of(path, table)


def _rows_of(path: Path, table: type[T]) -> T:
    """All rows of a table in a Parquet file or a recording."""
    if not _is_recording(path):
        return read_table(path, table)
    recording = open_recording(path)
    if not recording.has(table):
        raise InputError(f"{path}: holds no {table.NAME}; give a recording or a table that has them")
    return recording.read(table)


def read_bearings(path: Path | None, doa: Path | None, labels: bool, scene: Scene) -> Bearings | None:
    """All bearings, and directions of arrival as such: as `occlog track` reads them.

    Those of a recording are used along with its bearings unless others are named.
    """
    recording = open_recording(path) if path is not None and _is_recording(path) else None
    parts: list[Bearings] = []
    if doa is None and path is not None and recording is not None and recording.has(Doa):
        doa = path
    if path is not None and (recording is None or doa is None or recording.has(Bearings)):
        parts.append(_rows_of(path, Bearings))
    if doa is not None:
        parts += bearings_of_doa([_rows_of(doa, Doa)], scene, labels)
    elif labels:
        raise UsageError("--doa-labels wants directions of arrival; give them with --doa")
    return Bearings.merge(parts) if len(parts) > 1 else next(iter(parts), None)


def _is_recording(path: Path) -> bool:
    return path.suffix.lower() == ".mcap"


def _read_truth(path: Path) -> tuple[Truth | None, TruthBoxes | None, Scene | None]:
    """True positions and boxes, None where there are none, and the scene of a recording."""
    if _is_recording(path):
        recording = open_recording(path)
        truth = recording.read(Truth) if recording.has(Truth) else None
        boxes = recording.read(TruthBoxes) if recording.has(TruthBoxes) else None
        if truth is None and boxes is None:
            raise InputError(f"{path}: holds no truth; leave out --truth, or ingest the recording with its truth")
        return truth, boxes, recording.scene
    if schema_name(path) == TruthBoxes.NAME:
        return None, read_table(path, TruthBoxes), None
    return read_table(path, Truth), None, None


def _check_unit(path: Path | None, scene: Scene) -> None:
    """InputError if a table or a recording is in another unit than the scene."""
    if path is None:
        return
    if _is_recording(path):
        other = options.read_scene_of(path)
        unit = scene.length_unit if other is None else other.length_unit
    else:
        unit = describe(path)["length_unit"]
    if unit != scene.length_unit:
        raise InputError(
            f"{path}: lengths are in {unit}, but in {scene.length_unit} in the scene; use one scene for both"
        )


def provenance_of(paths: Paths, parameters: Mapping[str, Any]) -> Provenance:
    """Parameters, inputs, and what was lost in making the inputs."""
    losses: dict[Any, None] = {}  # of all inputs, each once, in order
    for path in paths.inputs:
        kind = path.suffix.lower()
        if kind == ".mcap":
            losses |= dict.fromkeys(open_recording(path).losses)
        elif kind == ".parquet":
            losses |= dict.fromkeys(read_provenance(path).losses)
    return Provenance("evaluate", dict(parameters), None, hash_inputs(paths.inputs), tuple(losses))
