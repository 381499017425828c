"""Inputs of `occlog track`, `label` and `fuse`: bearings, directions of arrival, priors, and the scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from occlog import console
from occlog.errors import InputError, UsageError, option
from occlog.io.open import Opened, check_unit, input_losses, load_scene, open_input
from occlog.records.columns import ColumnTable
from occlog.records.declared.sensors import Measurements
from occlog.records.tables import Bearings, Boxes, Doa, Hulls, Occluders, Reads, Truth

from .distance_measurements import measurements_of_reads
from .occluder_priors import known_positions
from .sources import bearings_of_doa, within_times

if TYPE_CHECKING:
    from occlog.records.losses import Loss
    from occlog.records.scene import Scene

T = TypeVar("T", bound=ColumnTable)


class MeasurementInputs:
    """All measurements of `track`, `label` or `fuse` as one stream, with the scene and recorded losses.

    `chunks`: bearings in the order of time. `measurements`: distances, None without. `occluders`: priors of moving
    occluders, None without.
    """

    def __init__(
        self,
        bearings: Path,
        scene: Path | None,
        doa: Path | None = None,
        doa_labels: bool = False,
        occluders: Path | None = None,
        measurements: Path | None = None,
        *,
        distances: bool = False,
        reads: bool = False,
    ) -> None:
        """Open all inputs; only headers are read. UsageError or InputError if they do not fit.

        Args:
            bearings: bearings or directions of arrival, or what `distances` allows.
            scene: scene; None: that of the recording.
            doa: directions of arrival in addition.
            doa_labels: identities of directions of arrival are those of targets.
            occluders: priors of moving occluders, or true positions.
            measurements: ranges, signal strengths and time differences, or reads of tags, in addition.
            distances: `bearings` may hold measurements of distances alone.
            reads: `bearings` may also be a recording with reads of tags alone.
        """
        self._opened: list[Opened] = []
        measured = open_input(bearings)
        # A file of directions of arrival takes the position of those of a recording
        own = measured.has(Doa) and (doa is None or measured.recording is None)
        directions = [*([measured] if own else []), *([open_input(doa)] if doa is not None else [])]
        if doa_labels and not directions:
            raise UsageError(
                f"{option('doa_labels')} requires directions of arrival; give some ({option('doa')})",
                id="missing-option",
            )
        alone = distances and not measured.has(Bearings) and not measured.has(Doa)
        # Any external table with times, sensors and identities might be reads without strengths
        alone = alone and (
            measured.has(Measurements) or (reads and measured.external_table is None and measured.has(Reads))
        )
        if not distances and measured.has(Measurements):
            raise InputError(
                f"{bearings}: holds measurements of distances, which this method does not take; use method apf, "
                "ekf, fix, map or ukf",
                id="wrong-content",
            )
        if not alone and (doa is None or measured.recording is None):
            more: tuple[type[ColumnTable], ...] = (Measurements,) if distances else ()
            measured.require(Bearings, Doa, *more, remedy=_remedy(measured))
        self.scene: Scene = load_scene(scene, measured.scene, bearings)
        if measured.external_table is not None and measured.table == Doa.NAME:
            sources = f"those of sources of sound, not of targets (unless {option('doa_labels')} is given)"
            labels = "labels of targets" if doa_labels else sources
            console.note(
                f"{bearings}: has no column sigma, so that it is read as directions of arrival; standard deviations "
                f"are those of the scene, and identities are {labels}"
            )
        streams: list[Iterable[Bearings]] = []
        if measured.has(Bearings):
            streams.append(self._rows(measured, Bearings))
        streams += [bearings_of_doa(self._rows(each, Doa), self.scene, doa_labels, each.scene) for each in directions]
        self.measurements = self._measurements([*([measured] if alone else []), *_opened(measurements)])
        self.chunks = iter(()) if alone and not streams else _not_empty(within_times(streams), bearings)
        self.occluders = None if occluders is None else self._priors(occluders)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Return the losses recorded in the inputs, without duplicates, in the order of opening."""
        return input_losses(self._opened)

    def _measurements(self, inputs: list[Opened]) -> Iterator[Measurements] | None:
        """Return the distance measurements of all inputs as one stream, including reads of tags; None without any."""
        streams: list[Iterable[Measurements]] = []
        for each in inputs:
            each.require(Measurements, Reads, remedy="give ranges, signal strengths or time differences")
            if each.has(Measurements):
                streams.append(self._rows(each, Measurements))
            if each.has(Reads):
                streams.append(measurements_of_reads(self._rows(each, Reads)))
        return within_times(streams) if streams else None

    def _priors(self, path: Path) -> Iterator[Occluders] | Iterator[Hulls]:
        """Return the priors of moving occluders in a file; true positions are priors with covariance 0."""
        opened = open_input(path, Truth, Hulls, Occluders)
        if opened.has(Truth):
            return known_positions(self._rows(opened, Truth))
        return self._rows(opened, Hulls) if opened.has(Hulls) else self._rows(opened, Occluders)

    def open(self, path: Path, table: type[T]) -> Iterator[T]:
        """Return the chunks of a table in a recording or a table file; InputError if the file has no such table."""
        return self._rows(open_input(path), table)

    def _rows(self, opened: Opened, table: type[T]) -> Iterator[T]:
        """Return the chunks of a table of an open input; its losses are recorded.

        An error if its length unit is not the scene's.
        """
        rows = opened.rows(table)
        self._opened.append(opened)
        if opened.has_lengths(table):
            check_unit(opened, self.scene.length_unit)
        return rows


def _opened(path: Path | None) -> list[Opened]:
    """Return the open input with measurements or reads at `path`, in a list; empty for None."""
    return [] if path is None else [open_input(path, Measurements, Reads)]


def _remedy(measured: Opened) -> str:
    """Return what to do, as text, where an input has no bearings or directions of arrival."""
    if measured.recording is not None and measured.has(Reads):
        return "track the reads of its tags with method rssi or virtual"
    if measured.recording is not None and measured.recording.cameras:
        return "make bearings with `occlog detect`, or track in its images with method bmct"
    if measured.recording is not None and measured.has(Boxes):
        if measured.scene is not None and any(c.placed for c in measured.scene.cameras):
            return "track all people by its boxes with method jipda, or make bearings with `occlog detect`"
        return "its boxes are of cameras without a pose: ingest them with a calibration, and use method jipda"
    return "make them with `occlog detect` or `occlog listen`"


def _not_empty(chunks: Iterable[Bearings], path: Path) -> Iterator[Bearings]:
    """Generate the chunks; InputError at the end if there was no row."""
    rows = 0
    for chunk in chunks:
        rows += len(chunk)
        yield chunk
    if rows == 0:
        raise InputError(f"{path}: has no rows; nothing can be tracked from it", id="empty-input")
