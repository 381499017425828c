"""GPX: tracks of GPS receivers, with a time at each point (https://www.topografix.com/GPX/1/1/)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from occlog.errors import InputError, option
from occlog.io.files.geodetic import begin_positions, has_heights, note_unused_heights, positions_on_earth
from occlog.io.files.texts.csv_rows import CsvRows
from occlog.io.files.texts.documents import xml_events

WHAT = "GPX with times"
MARK = b"<gpx"
POINTS_PER_CHUNK = 16_384
MAX_DEPTH = 100
"""Elements in one another at most."""


def gpx_columns() -> tuple[str, ...]:
    """Column names of the rows that `read_gpx` yields; `z_m` only if the user's geodetic origin has a height.

    The origin counts as used from now on.
    """
    begin_positions()
    return ("time", "target_id", "x_m", "y_m", *(("z_m",) if has_heights() else ()))


def read_gpx(path: Path) -> Iterator[CsvRows]:
    """Yield rows (time, target_id and scene position as text) of the points of all GPX tracks; track n is target n - 1.

    Raises:
        InputError: it is not XML, a point has no time or position, or no track has a point.
        UsageError: the geodetic origin of the scene is not stated.
    """
    found, number = _points(path), 0
    while points := list(islice(found, POINTS_PER_CHUNK)):
        number += len(points)
        yield _rows(path, points, number)
    if not number:
        raise InputError(f"{path}: no track (<trk>) has a point (<trkpt>); {WHAT} was expected", id="empty-input")


def _points(path: Path) -> Iterator[tuple[int, str, float, float, float]]:
    """Yield number of the track (from 0), time as text, latitude and longitude [deg], height [m] (NaN: not stated)."""
    depth, track, number = 0, -1, 0
    for event, element in xml_events(path, WHAT, ("start", "end")):
        name = element.tag.rpartition("}")[2]
        depth += 1 if event == "start" else -1
        if depth > MAX_DEPTH:
            raise InputError(
                f"{path}: more than {MAX_DEPTH} elements in one another; {WHAT} was expected", id="input-too-large"
            )
        if event == "start":
            track += name == "trk"
            continue
        if name == "trkpt":
            number += 1
            texts = {child.tag.rpartition("}")[2]: (child.text or "").strip() for child in element}
            where = f"{path}: point {number}"
            if not texts.get("time"):
                raise InputError(f"{where}: has no <time>; export the track with its times", id="missing-value")
            values = [element.get("lat"), element.get("lon"), texts.get("ele") or "nan"]
            try:
                latitude, longitude, height = (float(value or "") for value in values)
            except ValueError:
                raise InputError(f"{where}: lat, lon or <ele> is not a number: {values}") from None
            yield max(track, 0), texts["time"], latitude, longitude, height
        if name in ("trkpt", "trkseg", "trk", "wpt", "rte"):
            element.clear()


def _rows(path: Path, points: list[tuple[int, str, float, float, float]], last: int) -> CsvRows:
    tracks, times, latitudes, longitudes, heights = zip(*points, strict=True)
    numbers = np.arange(last - len(points) + 1, last + 1)
    degrees = np.column_stack([longitudes, latitudes])
    where = f"{path}: points {numbers[0]} to {numbers[-1]}"
    if has_heights() and np.isnan(heights).any():
        bad = int(numbers[np.isnan(heights)][0])
        raise InputError(
            f"{path}: point {bad}: has no <ele>; leave the height out of {option('origin')}", id="missing-value"
        )
    xyz = positions_on_earth(degrees, np.array(heights) if has_heights() else None, where)
    if np.isfinite(heights).any():
        note_unused_heights(str(path))
    cells = {"time": np.array(times), "target_id": np.array([str(track) for track in tracks])}
    for axis, values in zip(gpx_columns()[2:], xyz.T, strict=False):
        cells[axis] = np.array([repr(value) for value in values.tolist()])
    return CsvRows(path, numbers, cells, "point")
