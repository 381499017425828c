"""What `occlog track` and `occlog label` read: bearings, directions of arrival, priors, and the scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from occlog.cli import options
from occlog.errors import InputError, UsageError
from occlog.io.files.parquet import describe, iter_table, read_provenance
from occlog.io.recording.reader import open_recording
from occlog.records.tables import Bearings, Doa, Hulls, Occluders, Truth

from .occluder_priors import known_positions
from .sources import bearings_of_doa, in_time

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene


class Inputs:
    """The measurements as one stream, with the scene and what had been lost before."""

    def __init__(
        self,
        bearings: Path,
        scene: Path | None,
        doa: Path | None = None,
        doa_labels: bool = False,
        occluders: Path | None = None,
    ) -> None:
        """Open everything; nothing but headers is read yet."""
        self.losses: dict[Loss, None] = {}  # each once, in order
        recording = open_recording(bearings) if is_recording(bearings) else None
        self.scene: Scene = options.load_scene(scene, recording.scene if recording else None, bearings)
        streams: list[Iterable[Bearings]] = []
        directions = recording is None and describe(bearings)["schema"] == Doa.NAME
        if directions:
            streams.append(bearings_of_doa(self.open(bearings, Doa), self.scene, doa_labels))
        elif recording is None or recording.has(Bearings):
            streams.append(self.open(bearings, Bearings))
        if doa is None and recording is not None and recording.has(Doa):
            doa = bearings
        if doa is not None:
            streams.append(bearings_of_doa(self.open(doa, Doa), self.scene, doa_labels))
        elif doa_labels and not directions:
            raise UsageError("doa_labels wants directions of arrival; give some (doa)")
        if not streams:
            remedy = "make them with `occlog detect` or `occlog listen`"
            if recording is not None and recording.cameras:
                remedy = "make bearings with `occlog detect`, or track in its images with method bmct"
            raise InputError(f"{bearings}: holds no bearings and no directions of arrival; {remedy}")
        self.chunks = _not_empty(in_time(streams), bearings)
        self.occluders = None if occluders is None else self._priors(occluders)

    def _priors(self, path: Path) -> Iterator[Occluders] | Iterator[Hulls]:
        """Priors of the moving occluders; true positions are known exactly."""
        if is_recording(path):
            return known_positions(self.open(path, Truth))
        name = describe(path)["schema"]
        if name == Truth.NAME:
            return known_positions(self.open(path, Truth))
        if name == Hulls.NAME:
            return self.open(path, Hulls)
        return self.open(path, Occluders)

    def open(self, path: Path, table: type[Any]) -> Iterator[Any]:
        """Chunks of a table in a file of either kind."""
        if not is_recording(path):
            made = read_provenance(path)
            self.losses |= dict.fromkeys(made.losses)
            unit = describe(path)["length_unit"]
            if made.inputs and unit != self.scene.length_unit:  # without inputs nobody says what it was made from
                raise UsageError(
                    f"{path}: was made in a scene in {unit}, but the scene given is in {self.scene.length_unit}; "
                    "give the scene that it was made in"
                )
            return iter_table(path, table)
        recording = open_recording(path)
        if not recording.has(table):
            raise InputError(f"{path}: holds no {table.NAME}; give a recording or a table that has them")
        self.losses |= dict.fromkeys(recording.losses)
        return recording.tables(table)


def is_recording(path: Path) -> bool:
    """Whether the name is that of a recording."""
    return path.suffix.lower() == ".mcap"


def _not_empty(chunks: Iterable[Bearings], path: Path) -> Iterator[Bearings]:
    """The chunks; refuses input without rows, from which nothing can be tracked."""
    rows = 0
    for chunk in chunks:
        rows += len(chunk)
        yield chunk
    if rows == 0:
        raise InputError(f"{path}: has no rows; nothing can be tracked from it")
