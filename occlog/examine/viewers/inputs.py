"""Inputs of a viewer: a run folder with its recording, a recording, or a table with or without one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from occlog import console
from occlog.errors import InputError, UsageError, option
from occlog.io.open import Opened, open_if_ours, open_input, scene_in
from occlog.io.recording.reader import McapRecording
from occlog.records.columns import ColumnTable
from occlog.records.scene import Scene
from occlog.records.tables import (
    Bearings,
    Bound,
    Boxes,
    Diagnostics,
    Doa,
    Errors,
    Events,
    Hulls,
    Occluders,
    Particles,
    PeopleTracks,
    Tracks,
    Truth,
    TruthBoxes,
    Views,
    ViewTracks,
    whole_times,
)
from occlog.settings import METRES

T = TypeVar("T", bound=ColumnTable)
RECORDING = "recording.mcap"
ROWS = 8192
"""Rows of a table that are held at once: of several tables, each up to three times between chunks."""
SHOWN: tuple[type[ColumnTable], ...] = (
    Truth,
    Diagnostics,
    Particles,
    PeopleTracks,
    Errors,
    Bound,
    Occluders,
    Hulls,
    Bearings,
    Doa,
    Events,
    ViewTracks,
    Views,
    Boxes,
    TruthBoxes,
)
"""Tables of which something is shown."""


@dataclass(frozen=True)
class ViewerInputs:
    """Everything that a viewer shows; each table has one source.

    Attributes:
        tables: opened input of each table, by name.
        recording: images; None: missing.
        scene: cameras and plan; None: missing.
        unit: unit of lengths.
    """

    tables: Mapping[str, Opened] = field(default_factory=dict)
    recording: McapRecording | None = None
    scene: Scene | None = None
    unit: str = "m"

    @property
    def metres(self) -> float:
        """Metres per length unit; 1 for an unknown unit."""
        return METRES.get(self.unit, 1.0)

    @property
    def opened(self) -> list[Opened]:
        """Inputs that hold tables, each once."""
        return list({opened.path: opened for opened in self.tables.values()}.values())

    def has(self, table: type[ColumnTable]) -> bool:
        """Return whether an input holds a table of this type."""
        return table.NAME in self.tables

    def pieces(self, table: type[T]) -> Iterator[T]:
        """Generate the rows of a table, in parts of equal time and sensor; empty if the table is missing."""
        if not self.has(table):
            return
        for rows in whole_times(self.tables[table.NAME].rows(table, at_once=ROWS)):
            yield from chunks_of_equal_time(rows)

    def targets(self) -> set[int]:
        """Return the identities of all tracks, on the ground and in images."""
        kinds: tuple[type[Tracks] | type[ViewTracks], ...] = (Tracks, ViewTracks)
        found = (rows for kind in kinds if self.has(kind) for rows in self.tables[kind.NAME].rows(kind, at_once=ROWS))
        return {target for rows in found for target in np.unique(rows.target_id).tolist()}


def chunks_of_equal_time(rows: T) -> Iterator[T]:
    """Generate parts of a table, split where the time or the sensor changes."""
    change = np.diff(rows.t_ns) != 0  # type: ignore[attr-defined]
    sensor = getattr(rows, "sensor", None)
    if sensor is not None:
        change |= sensor[1:] != sensor[:-1]
    bounds = [0, *(np.flatnonzero(change) + 1).tolist(), len(rows)]
    for start, stop in itertools.pairwise(bounds):
        if stop > start:
            yield rows.take(slice(start, stop))


def find_inputs(path: Path, recording: Path | None, scene: Path | None) -> ViewerInputs:
    """Find and open what is to be shown, in a folder or a file.

    Args:
        path: run folder, recording or table.
        recording: has images, scene and true positions; None: that of the folder.
        scene: scene file; None: that of the recording.

    Raises:
        InputError: there is nothing that can be shown, or lengths are in several units.
        UsageError: an input is itself an export for a viewer, or `recording` is none.
    """
    files = _files(path) if path.is_dir() else [path]
    for given in (path, recording):
        if given is not None and not given.is_dir() and (made := viewer_format_of(given)) is not None:
            raise UsageError(
                f"{given}: is an export for {made}; name the run or the recording that it was made from",
                id="wrong-content",
            )
    # The recording that was named comes first: its rows count, not those of one in the folder
    opened = [open_input(each) for each in [*([recording] if recording is not None else []), *files]]
    recordings = [each.recording for each in opened if each.recording is not None]
    found: dict[str, Opened] = {}
    for each in opened:
        for table in SHOWN:
            if each.has(table) and (each.recording is None or table.NAME not in found):
                found[table.NAME] = each
    source = recordings[0] if recordings else None
    if not found and (source is None or not source.cameras):
        raise InputError(
            f"{path}: holds nothing that viewers show: no images, tracks or other tables that they draw",
            id="wrong-content",
        )
    if source is None and recording is not None:
        raise UsageError(f"{recording}: is no recording", id="wrong-content")
    resolved = scene_in(scene) if scene is not None else (source.scene if source is not None else None)
    return ViewerInputs(found, source, resolved, _unit(list(found.values()), resolved))


def viewer_format_of(path: Path) -> str | None:
    """Return the name of the viewer format that a file was exported to; None for other files."""
    opened = open_if_ours(path)
    if opened is None or opened.recording is None or opened.provenance.command != "export":
        return None
    return str(opened.provenance.parameters.get("to"))


def _unit(opened: list[Opened], scene: Scene | None) -> str:
    """Return the length unit of the scene, or of the tables without one; InputError if a table has another."""
    from occlog.io.open import check_unit, common_unit

    tables = [each for each in opened if each.recording is None]
    telling = [each for each in tables if each.external_table is not None or each.made_in_a_scene]
    unit, source = common_unit(telling) if scene is None else (scene.length_unit, "the scene")
    for each in tables:
        check_unit(each, unit, source, InputError)
    return unit


def _files(folder: Path) -> list[Path]:
    """Return tables and recording of a run folder; InputError if it has none."""
    names = [RECORDING, *(f"{table.NAME}.parquet" for table in SHOWN)]
    files = [folder / name for name in names if (folder / name).is_file()]
    if not files:
        raise InputError(
            f"{folder}: holds no {RECORDING} and no tables of a run, so it is not the folder of a run",
            id="wrong-content",
        )
    return files


def note_unexpected(inputs: ViewerInputs, quiet: bool) -> None:
    """Print notes about what is not shown for lack of an input: images, plan, or a unit of length."""
    if inputs.recording is None:
        console.note(
            f"no recording is given: no images and no truth are shown; name it with {option('recording')}", quiet
        )
    if inputs.scene is None:
        console.note(
            f"no scene is given: no plan, cameras and lines of sight are shown; name one with {option('scene')}", quiet
        )
    if inputs.unit not in METRES:
        console.note(f"lengths are in {inputs.unit}, of which the length is not known: viewers show one as 1 m", quiet)
