"""Trajectories in formats other than tables with a header: TUM, KITTI, TRC, GeoJSON, GPX.

The format of a text is recognised, and rows are returned with table column names. GeoJSON as written by `occlog
export`: a line or point for each target, with times of its vertices; the member `origin` of the collection, or the
user, states the geodetic position of the scene's origin. TRC, OpenSim's table of markers: a line per time, three
columns per marker; markers must be targets, `target_N`, as `occlog export` names them. Times are relative to the first
one of the recording; empty cells are missing markers. TUM: lines `t x y z qx qy qz qw` of one target, in seconds;
attitudes are ignored.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats
from occlog.errors import InputError, option
from occlog.io.files.geodetic import FARTHEST, STATED_ORIGIN, Origin, places_of_degrees
from occlog.io.files.texts.csv_rows import MAX_CELL, CsvRows, read_plain, text_lines
from occlog.io.files.texts.documents import parse_json
from occlog.io.files.texts.formats import FileFormat, Probe, recognise
from occlog.records.names import first_double

from .gpx import MARK as GPX
from .gpx import gpx_columns, read_gpx
from .kitti_poses import NAMES, looks_like_kitti, read_kitti

GEOJSON_COLUMNS = ("t_ns", "target_id", "x_m", "y_m")
COLLECTION = "FeatureCollection"
ORIGIN = "origin"
KEYS = ("latitude", "longitude", "turned_deg")
"""Members of the origin: [deg], and the angle of +x from the east towards the north [deg]."""


def read_geojson(path: Path) -> Iterator[CsvRows]:
    """Yield rows (time, target and scene position as text) of a GeoJSON feature collection, one feature at a time.

    The scene's geodetic origin is a member of the collection, or the user states it.

    Raises:
        InputError: the content is invalid (with the number of the feature), or no origin is known.
    """
    value = parse_json(path.read_bytes(), path, "GeoJSON")
    features = value.get("features") if isinstance(value, dict) else None
    if not isinstance(features, list) or value.get("type") != COLLECTION:
        raise InputError(
            f"{path}: is no {COLLECTION}; GeoJSON with a list of features was expected", id="unknown-format"
        )
    origin = _origin(path, value.get(ORIGIN))
    for number, feature in enumerate(features, start=1):
        identity, t_ns, corners = _feature(path, number, feature)
        xy = places_of_degrees(corners, origin)
        cells = {
            "t_ns": np.array([str(t) for t in t_ns]),
            "target_id": np.full(len(t_ns), str(identity)),
            "x_m": np.array([repr(x) for x in xy[:, 0].tolist()]),
            "y_m": np.array([repr(y) for y in xy[:, 1].tolist()]),
        }
        yield CsvRows(path, np.full(len(t_ns), number), cells, "feature")


def _origin(path: Path, value: object) -> Origin:
    members: Mapping[str, Any] = value if isinstance(value, dict) else {}
    values: list[Any] = [members.get(key, 0.0 if key == KEYS[2] else None) for key in KEYS]
    stated = STATED_ORIGIN.get()
    if value is None and stated is not None:
        stated.used = True
        return stated.origin
    if not all(_is_number(v) for v in values):
        raise InputError(
            f"{path}: does not state where the scene's origin is: {option('origin')} LAT,LON, or the member "
            f'"{ORIGIN}": {{"{KEYS[0]}": 52.5163, "{KEYS[1]}": 13.3777, "{KEYS[2]}": 0}} next to "features"',
            id="missing-value",
        )
    found = Origin(*(float(v) for v in values))
    if abs(found.latitude) > FARTHEST or abs(found.longitude) > 180:
        raise InputError(f"{path}: {ORIGIN}: latitude must be within {FARTHEST:g} degrees and longitude within 180")
    return found


def _feature(path: Path, number: int, feature: object) -> tuple[int, list[int], Floats]:
    """Identity, times [ns], and longitude and latitude (n, 2) [deg] of a GeoJSON feature with n vertices.

    InputError, with its number, if it is invalid.
    """
    location = f"{path}: feature {number}"
    properties = _member(feature, "properties")
    shape = _member(feature, "geometry")
    kind, coordinates = shape.get("type"), shape.get("coordinates")
    if kind not in ("LineString", "Point"):
        raise InputError(
            f"{location}: its geometry is {kind!r}; LineString or Point was expected", id="unsupported-format"
        )
    corners = [coordinates] if kind == "Point" else coordinates
    good = isinstance(corners, list) and all(
        isinstance(corner, list) and len(corner) in (2, 3) and all(_is_number(v) for v in corner) for corner in corners
    )
    if not good or not isinstance(corners, list) or not corners:
        raise InputError(f"{location}: its coordinates are no list of [longitude, latitude]; correct it")
    degrees = np.array([corner[:2] for corner in corners], dtype=np.float64)
    if (np.abs(degrees) > (180.0 + 1e-6, 90.0)).any():
        raise InputError(
            f"{location}: a longitude is beyond 180 degrees, or a latitude beyond 90; the longitude comes first"
        )
    identity: Any = properties.get("target_id")
    t_ns: Any = properties.get("t_ns")
    if not _is_whole(identity):
        raise InputError(f"{location}: has no whole number target_id among its properties", id="missing-value")
    if not isinstance(t_ns, list) or len(t_ns) != len(corners) or not all(_is_whole(t) for t in t_ns):
        raise InputError(
            f"{location}: requires t_ns, a list of whole numbers, one for each of its {len(corners)} positions",
            id="missing-value",
        )
    return identity, t_ns, degrees


def _member(feature: object, name: str) -> Mapping[str, Any]:
    found = feature.get(name) if isinstance(feature, dict) else None
    return found if isinstance(found, dict) else {}


def _is_number(value: object) -> bool:
    # An integer of hundreds of digits is no float
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


MAGIC = "PathFileType"
UNITS = ("m", "mm")
HEADER = 5
"""Lines before the first time; an empty one may follow."""
ROWS_PER_CHUNK = 16_384
_MARKER = re.compile(r"^target_(\d{1,10})$")


def names_of(path: Path) -> tuple[str, ...]:
    """Column names of the rows that `read_trc` yields, with the length unit of the file.

    InputError for another unit.
    """
    unit = _unit(path, _header(path))
    return ("time", "target_id", *(f"{axis}_{unit}" for axis in "xyz"))


def read_trc(path: Path) -> Iterator[CsvRows]:
    """Yield rows (time, target and position as text) of a TRC file, sorted as in the file; empty cells are omitted.

    InputError, with the line, for invalid content.
    """
    header = _header(path)
    names = names_of(path)
    targets = _targets(path, header)
    records: list[tuple[int, tuple[str, ...]]] = []
    for line, text in islice(enumerate(_lines(path), start=1), HEADER, None):
        if text.strip():
            records += [(line, cells) for cells in _targets_of(path, line, text, targets)]
        if len(records) >= ROWS_PER_CHUNK:
            yield _rows(path, records, names)
            records = []
    if records:
        yield _rows(path, records, names)


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file without line ends; InputError unless it is UTF-8."""
    with path.open(encoding="utf-8-sig") as file:
        try:
            for _, line in text_lines(path, file):
                yield line.rstrip("\r\n")
        except UnicodeDecodeError as error:
            bad = error.object[error.start]
            raise InputError(
                f"{path}: has a byte {bad:#04x} that is not UTF-8; TRC is text, save it as UTF-8", id="wrong-encoding"
            ) from None


def _header(path: Path) -> list[str]:
    lines = list(islice(_lines(path), HEADER))
    if len(lines) < HEADER:
        raise InputError(
            f"{path}: {len(lines)} lines, but the header of TRC alone has {HEADER}; export it again",
            id="unknown-format",
        )
    return lines


def _unit(path: Path, header: list[str]) -> str:
    values = dict(zip(header[1].split("\t"), header[2].split("\t"), strict=False))
    unit = values.get("Units", "").strip()
    if unit not in UNITS:
        raise InputError(f"{path}: line 3: Units are {unit!r}; {' or '.join(UNITS)} was expected")
    return unit


def _targets(path: Path, header: list[str]) -> list[str]:
    """Target identities of the markers of a TRC file, in order, as text.

    `header` are the first lines of the file. InputError for markers not called target_0, target_1, ...
    """
    markers = [cell.strip() for cell in header[3].split("\t")[2:] if cell.strip()]
    if not markers:
        raise InputError(f"{path}: line 4: names no marker; target_0, target_1, ... were expected", id="missing-value")
    found = [_MARKER.match(marker) for marker in markers]
    for marker, match in zip(markers, found, strict=True):
        if match is None:
            raise InputError(
                f"{path}: line 4: marker {marker!r} is not a target; markers must be called target_0, target_1, ..., "
                "and have their position on the ground (x, y) with z up",
                id="unknown-name",
            )
    numbers = [match[1] for match in found if match is not None]
    twice = first_double(numbers)
    if twice is not None:
        raise InputError(f"{path}: line 4: marker target_{twice} is there twice; name each once", id="duplicate-name")
    return numbers


def _targets_of(path: Path, line: int, text: str, targets: list[str]) -> Iterator[tuple[str, ...]]:
    """Yield time, identity and x, y, z, as text, of each target in a line of a TRC file.

    Targets without position are omitted.

    Args:
        path: the file.
        line: number of the line.
        text: the line.
        targets: identities of all markers.
    """
    cells = [cell.strip() for cell in text.split("\t")]
    wanted = 2 + 3 * len(targets)
    if max(map(len, cells)) > MAX_CELL:
        raise InputError(
            f"{path}: line {line}: a cell of more than {MAX_CELL} characters; correct this line", id="input-too-large"
        )
    if len(cells) > wanted and any(cells[wanted:]):
        raise InputError(
            f"{path}: line {line}: {len(cells)} cells; lines of {len(targets)} markers have {wanted}; correct it"
        )
    cells += [""] * (wanted - len(cells))
    for n, target in enumerate(targets):
        position = cells[2 + 3 * n : 5 + 3 * n]
        if all(position):
            yield cells[1], target, *position
        elif any(position):
            raise InputError(
                f"{path}: line {line}: target_{target} has a position with an empty cell; give all three or none"
            )


def _rows(path: Path, records: list[tuple[int, tuple[str, ...]]], names: tuple[str, ...]) -> CsvRows:
    lines = np.array([line for line, _ in records], dtype=np.int64)
    columns = zip(*(cells for _, cells in records), strict=True)
    return CsvRows(path, lines, {name: np.array(column) for name, column in zip(names, columns, strict=True)})


TUM_COLUMNS = ("time", "x", "y", "z")
COLUMNS = 8
WHAT = "a trajectory in TUM text"
UNIT = 1e-3
"""Tolerance of the quaternion's length from 1 in the first line for recognising TUM text."""


def looks_like_tum(head: Sequence[str]) -> bool:
    """Whether the cells of a first line are eight numbers, of which the last four are a unit quaternion."""
    if len(head) != COLUMNS:
        return False
    try:
        values = [float(cell) for cell in head]
    except ValueError:
        return False
    return abs(math.hypot(*values[4:]) - 1.0) <= UNIT


def read_tum(path: Path) -> Iterator[CsvRows]:
    """Yield rows with time, x, y and z (as text) of a TUM trajectory; InputError unless it has eight columns."""
    for rows in read_plain(path, WHAT):
        if len(rows.cells) != COLUMNS:
            raise InputError(
                f"{path}: {len(rows.cells)} columns; TUM text has {COLUMNS}: t x y z qx qy qz qw", id="unknown-format"
            )
        yield replace(rows, cells=dict(zip(TUM_COLUMNS, rows.cells.values(), strict=False)))


class Trajectories(NamedTuple):
    """A file of trajectories in a format other than a table with a header.

    Attributes:
        kind: the format, in words.
        names: names of the columns of its rows.
        read: function that yields its rows in parts.
    """

    kind: str
    names: tuple[str, ...]
    read: Callable[[Path], Iterator[CsvRows]]


def _is_geojson(probe: Probe) -> bool:
    return probe.start.startswith(b"{") and f'"{COLLECTION}"'.encode() in probe.start


def _is_tum(probe: Probe) -> bool:
    try:
        return not probe.start.startswith(b"{") and looks_like_tum(probe.cells)
    except InputError:
        return False


def _is_kitti(probe: Probe) -> bool:
    try:
        return not probe.start.startswith(b"{") and looks_like_kitti(probe.cells)
    except InputError:
        return False


FORMATS: dict[str, FileFormat[Callable[[Path], Trajectories]]] = {
    "trc": FileFormat(
        lambda path: Trajectories("TRC", names_of(path), read_trc),
        "TRC of motion capture",
        lambda probe: probe.start.startswith(MAGIC.encode()),
    ),
    "geojson": FileFormat(
        lambda _: Trajectories("GeoJSON", GEOJSON_COLUMNS, read_geojson),
        "GeoJSON with times",
        _is_geojson,
    ),
    "gpx": FileFormat(
        lambda _: Trajectories("GPX", gpx_columns(), read_gpx), "GPX with times", lambda probe: GPX in probe.start
    ),
    "kitti_poses": FileFormat(
        lambda _: Trajectories("poses of KITTI", NAMES, read_kitti), "poses of KITTI odometry", _is_kitti
    ),
    "tum": FileFormat(lambda _: Trajectories("TUM text", TUM_COLUMNS, read_tum), "text of TUM", _is_tum),
}
"""Every format of trajectories."""


def find_trajectories(path: Path) -> Trajectories | None:
    """Recognise a trajectory format of a file by its content; None for other files.

    InputError if the header of a known format cannot be read.
    """
    name = recognise(FORMATS, Probe(path, WHAT))
    return None if name is None else FORMATS[name].read(path)
