"""`occlog export`: opens a table, selects the format, and writes the file; also formats of plug-ins."""

from __future__ import annotations

import gzip
import io
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeVar, cast

import numpy as np

from occlog import console
from occlog.console.notes import begin_work
from occlog.errors import InputError, PluginError, UsageError
from occlog.io.files.atomic import OutputGroup, check_outputs, open_output
from occlog.io.files.geodetic import Origin, begin_positions, origin_is_unused
from occlog.io.formats.boxes.mot_challenge import SEQUENCE_INFO, Kind, mot_text
from occlog.io.open import Opened, load_scene, open_input
from occlog.plugins.interface import ExportContext, Exporter
from occlog.plugins.loading import Chosen, plugin_errors
from occlog.records.columns import ColumnTable
from occlog.records.declared.views import ViewTracks
from occlog.records.losses import Loss
from occlog.records.scene import Scene
from occlog.records.tables import TABLES, Boxes, Tracks, Truth, TruthBoxes, Views, whole_times
from occlog.records.verdicts import texts_of

from .formats import FORMATS, ExportFormat, format_of
from .in_images import Cameras, boxes_of, chosen_camera, coco_texts, kitti_text, sequence_info, survey
from .readable import UnrepresentableColumns, readable
from .trajectories import (
    ExportedPositions,
    check_one_target,
    check_targets,
    geojson_texts,
    mot3d_text,
    places_of,
    trc_texts,
    tum_text,
    write_csv,
    write_parquet,
)


class Sink(io.RawIOBase):
    """Write-only view of a file for exporter plug-ins: they can neither close, seek nor read it."""

    def __init__(self, file: IO[bytes]) -> None:
        """Wrap an open binary file, which its owner closes."""
        self._file = file

    def write(self, data: Any) -> int:
        """Write bytes to the file and return their number; TypeError for anything but bytes."""
        if not isinstance(data, bytes | bytearray | memoryview):
            raise TypeError(f"an exporter writes bytes, not {type(data).__name__}; encode the text")
        return self._file.write(data)

    def writable(self) -> bool:
        """Return True, as wrappers such as `io.TextIOWrapper` require."""
        return True

    def close(self) -> None:
        """Do nothing: the owner closes the file."""


def format_of_plugin(exporter: Chosen) -> ExportFormat:
    """Return the export format of an exporter plug-in; PluginError if it names no table or an unknown one."""
    of = exporter.plugin.load()
    unknown = [name for name in of.tables if name not in TABLES]
    if unknown or not of.tables:
        raise PluginError(
            f"{exporter.plugin.label}: tables: {unknown[0] if unknown else 'none'}; give {', '.join(TABLES)}"
        )
    return ExportFormat((), tuple(of.tables), str(of.summary))


def chosen_rows(rows: ColumnTable, name: str, targets: Sequence[int], camera: str | None) -> ColumnTable:
    """Return the rows of some targets and of one camera; UsageError if the table has no such column.

    Args:
        rows: rows of a table.
        name: name of the format, for messages.
        targets: identities; empty: all.
        camera: name; None: all.
    """
    for option, column, given in (("target", "target_id", tuple(targets)), ("camera", "sensor", camera)):
        if not given:
            continue
        if not hasattr(rows, column):
            raise UsageError(
                f"{option}: format {name} writes {rows.NAME}, which have no {column}; leave it out", id="not-applicable"
            )
        rows = rows.take(np.isin(getattr(rows, column), given))
    return rows


def write_by_plugin(exporter: Chosen, rows: ColumnTable, world: ExportContext, file: IO[bytes]) -> None:
    """Write rows to an open file by an exporter plug-in; PluginError if it fails.

    `world`: scene and length unit of the rows.
    """
    own: Exporter = exporter.make(world.length_unit)
    with plugin_errors(exporter.plugin):
        own.write(rows, world, Sink(file))  # type: ignore[arg-type]


T = TypeVar("T", bound=ColumnTable)

STANDARD = Path("-")


@dataclass(frozen=True)
class ExportRequest:
    """Request of an export.

    Attributes:
        input: a table or a recording.
        output: the file; `-`: standard output.
        to: name of the format; None: by the ending of the output.
        table: name of the table in a recording; None: the first that the format can hold.
        targets: identities to export; empty: all.
        camera: camera of the boxes; None: the only one.
        origin: position of the scene's origin on earth; None: not given.
        scene: scene file, for the sizes of images; None: that of the recording.
        overwrite: replace an existing output.
        exporter: the plug-in that `to` names; None: the format is one of occlog's.
        quiet: print no notes about what the format cannot hold.
    """

    input: Path
    output: Path
    to: str | None
    table: str | None
    targets: tuple[int, ...]
    camera: str | None
    origin: Origin | None
    scene: Path | None
    overwrite: bool
    exporter: Chosen | None = None
    quiet: bool = False


def run_export(request: ExportRequest) -> tuple[dict[str, object], tuple[Loss, ...]]:
    """Export a table; return the summary, and the data losses of the input."""
    name = request.to or format_of(request.output.name)
    if name is None:
        known = ", ".join(ending for entry in FORMATS.values() for ending in entry.endings)
        raise UsageError(
            f"{request.output}: its name does not state the format; end it in one of {known}, or name the format (to): "
            f"{', '.join(FORMATS)}",
            id="unknown-format",
        )
    form = FORMATS[name] if request.exporter is None else format_of_plugin(request.exporter)
    _check_request(request, name, form)
    info = _info_path(request.output) if name == "mot" else None
    if request.output != STANDARD:
        check_outputs([request.input, request.scene], (request.output, info), request.overwrite)
    opened = open_input(request.input)
    if name != "geojson" and origin_is_unused():
        raise UsageError(
            f"origin: format {name} takes none, and the input has no latitudes and longitudes; leave it out",
            id="not-applicable",
        )
    table = _table(opened, form, name, request.table)
    scene = load_scene(request.scene, None, request.scene) if request.scene is not None else opened.scene
    unit = opened.length_unit or ("m" if scene is None else scene.length_unit)
    summary: dict[str, object] = {"output": str(request.output), "format": name, "table": table.NAME}
    missed: tuple[str, ...] = ()
    begin_work()
    with OutputGroup() as together, _output(request.output, request.overwrite, together) as file:
        if request.exporter is not None:
            rows = chosen_rows(opened.read(table), name, request.targets, request.camera)
            write_by_plugin(request.exporter, rows, ExportContext(unit, scene), file)
            summary |= {"rows": len(rows), "plugin": request.exporter.plugin.origin}
        elif name == "csv":
            summary["rows"], left = write_csv(_rows(opened, table, text=True), table, file, unit)
            summary |= {"skipped": list(left)} if left else {}
            missed = tuple(f"column {column}" for column in left)
        elif name == "parquet":
            summary["rows"] = write_parquet(_rows(opened, table), table, file, unit)
        else:
            try:
                summary["rows"], found, missed = _write_text(name, opened, table, request, file, (unit, scene))
            except (InputError, UsageError) as error:
                raise type(error)(f"{request.input}: {error}", id=error.id) from None
            if info is not None and found is not None:
                try:
                    about = sequence_info(found, request.camera, info.resolve().parent.name, scene)
                except InputError as error:
                    console.note(f"{info}: not written: {error}")
                else:
                    with open_output(info, request.overwrite, together) as companion:
                        companion.write(about.text().encode())
                    summary["sequence"] = str(info)
    if missed:
        console.note(f"{request.output}: {name} cannot store: {'; '.join(missed)}", request.quiet)
        summary |= {} if name == "csv" else {"not_representable": list(missed)}
    console.note_findings(texts_of(opened.provenance.judged, "export"), request.quiet)
    return summary, opened.losses


def _info_path(output: Path) -> Path | None:
    """Return the path of `seqinfo.ini`, next to the folder `gt` or `det` of a MOTChallenge sequence.

    None if the output is not in such a folder.
    """
    folder = output.resolve().parent
    return folder.parent / SEQUENCE_INFO if folder.name in ("gt", "det") else None


def _check_request(request: ExportRequest, name: str, form: ExportFormat) -> None:
    """Raise UsageError for options that the format does not use, or a missing origin that it needs.

    Args:
        request: the request.
        name: name of the format.
        form: its declaration.
    """
    if request.exporter is None:
        if request.targets and form.tables != FORMATS["tum"].tables:
            raise UsageError(f"target: format {name} writes all rows; leave it out", id="not-applicable")
        if request.camera is not None and form.tables != FORMATS["mot"].tables:
            raise UsageError(f"camera: format {name} has no images; leave it out", id="not-applicable")
    if name == "geojson" and request.origin is None:
        raise UsageError(
            "origin: format geojson requires the position of the scene's origin on earth, as 52.5163,13.3777",
            id="missing-value",
        )


def _table(opened: Opened, form: ExportFormat, name: str, wanted: str | None) -> type[ColumnTable]:
    """Return the type of table to export: the wanted one, or the first in the input that the format can hold.

    Args:
        opened: the input.
        form: the format.
        name: name of the format, for messages.
        wanted: name of the table; None: any.

    Raises:
        UsageError: the format cannot hold the wanted table.
        InputError: the input has no such table.
    """
    takes = list(form.tables) or list(TABLES)
    if wanted is not None and wanted not in takes:
        raise UsageError(f"table: format {name} takes {', '.join(takes)}, not {wanted}", id="not-applicable")
    asked = [TABLES[each] for each in ([wanted] if wanted is not None else takes)]
    opened.require(*asked, remedy=f"format {name} takes {', '.join(takes)}")
    return opened.widest(next((table for table in asked if opened.has(table)), asked[0]))


def _rows(opened: Opened, table: type[T], *, text: bool = False) -> Iterator[T]:
    return readable(opened.rows(table), opened.path, text=text)


def _write_text(
    name: str,
    opened: Opened,
    table: type[ColumnTable],
    request: ExportRequest,
    file: IO[bytes],
    world: tuple[str, Scene | None],
) -> tuple[int, Cameras | None, tuple[str, ...]]:
    """Write rows in a text format, in two passes over the input.

    Return their number, cameras of a table in images (else None), and what the format cannot hold.

    Args:
        name: name of the format.
        opened: the input.
        table: its table.
        request: targets, camera, origin, output.
        file: open binary file.
        world: length unit and scene (None: unknown).
    """
    missed = UnrepresentableColumns(name, table, world[0], request.targets, request.camera)
    if issubclass(table, Tracks | Truth):
        return _write_places(name, opened, table, request, file, world[0], missed), None, missed.words()
    if not issubclass(table, Boxes | Views | ViewTracks):
        raise InputError(f"format {name} cannot hold {table.NAME}; choose another format", id="not-applicable")
    return *_write_boxes(name, opened, table, request, file, world[1], missed), missed.words()


def _write_places(
    name: str,
    opened: Opened,
    table: type[Tracks] | type[Truth],
    request: ExportRequest,
    file: IO[bytes],
    unit: str,
    missed: UnrepresentableColumns,
) -> int:
    """Write positions of targets to an open file, part by part; return the number of rows.

    Args:
        name: name of the format: tum, mot3d, trc or geojson.
        opened: the input.
        table: type of its table.
        request: targets and origin.
        file: binary file.
        unit: unit of lengths.
        missed: collects what the format cannot hold.
    """
    targets = check_targets(missed.watched(_rows(opened, table)), request.targets)
    if name == "tum":
        check_one_target(targets)
    count = 0

    def pieces() -> Iterator[ExportedPositions]:
        nonlocal count
        count = 0  # a document is read several times
        for piece in whole_times(opened.rows(table)):
            positions = places_of(piece, request.targets)
            count += len(positions.t_ns)
            yield positions

    if name == "geojson" and request.origin is not None:
        begin_positions()
        texts = geojson_texts(pieces, request.origin, unit)
    elif name == "trc":
        texts = trc_texts(pieces, unit, request.output.name)
    else:
        texts = mot3d_text(pieces()) if name == "mot3d" else map(tum_text, pieces())
    for text in texts:
        file.write(text.encode())
    return count


def _write_boxes(
    name: str,
    opened: Opened,
    table: type[Boxes] | type[Views] | type[ViewTracks],
    request: ExportRequest,
    file: IO[bytes],
    scene: Scene | None,
    missed: UnrepresentableColumns,
) -> tuple[int, Cameras]:
    """Write boxes to an open file; return their number, and the cameras of the table.

    Rows are read in parts if frames rise with time or each line of the format is a box, else all at once.

    Args:
        name: name of the format: mot, kitti or coco.
        opened: the input.
        table: type of its table; ellipses are written as boxes.
        request: camera and output.
        file: binary file.
        scene: image sizes; None: unknown.
        missed: collects what the format cannot hold.
    """
    found = survey(missed.watched(whole_times(_rows(opened, table))))
    camera = request.camera
    if name != "coco" or camera is not None:
        camera = chosen_camera(found.boxed, camera)
    # Lines, and numbers of images, are in the order of frames; text of frames that go back is refused as a whole
    wanted = set(found.boxed) if camera is None else {camera}
    streams = name == "kitti" or wanted <= found.rising
    count = 0
    kind: Kind = "tracks" if issubclass(table, ViewTracks) else "detections"
    kind = "truth" if issubclass(table, TruthBoxes) else kind

    def pieces() -> Iterator[tuple[Boxes, Kind]]:
        nonlocal count
        count = 0
        for piece in whole_times(opened.rows(table)) if streams else [opened.read(table)]:
            boxes = boxes_of(piece)
            boxes = boxes if camera is None else boxes.take(boxes.sensor == camera)
            count += len(boxes)
            yield boxes, kind

    if name == "coco":
        texts = coco_texts(lambda: (boxes for boxes, _ in pieces()), scene)
    elif name == "kitti":
        texts = (kitti_text(boxes) for boxes, _ in pieces())
    else:
        texts = (mot_text(request.output, boxes, kind) for boxes, kind in pieces())
    for text in texts:
        file.write(text.encode())
    return count, found


@contextmanager
def _output(path: Path, overwrite: bool, together: OutputGroup) -> Iterator[IO[bytes]]:
    """Context manager that yields the output as an open binary file, or standard output for `-`.

    The file is compressed if its name ends in .gz, and appears when the block ends, together with the other files of
    the group `together`. `overwrite`: replace a file that exists.
    """
    if path == STANDARD:
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    with open_output(path, overwrite, together) as file:
        if path.suffix.lower() != ".gz":
            yield file
            return
        with gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0) as packed:
            yield cast("IO[bytes]", packed)
