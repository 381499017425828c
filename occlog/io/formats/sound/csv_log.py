"""CSV logs of directions of arrival, and the rows that a log of any format gives.

Names of columns of angles end in their unit, `_deg` or `_rad`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints, Strings
from occlog.console.notes import note_once
from occlog.errors import InputError, UsageError, option
from occlog.io.files.texts.csv_rows import CsvRows, check_one_sensor
from occlog.io.files.texts.formats import IDENTITY, RAW, FormatColumn, TextFormat, read_format
from occlog.io.files.timing.times import check_unit
from occlog.records.losses import Loss


@dataclass(frozen=True)
class DoaOptions:
    """Options for reading a log of directions of arrival, for values that it does not state.

    Attributes:
        format: a key of `occlog.io.formats.sound.directions.FORMATS`, or `auto`.
        sensor: array of a log that does not name one; None: the log names it.
        unit: `deg` or `rad`, for columns that do not state it in their names; None: not given.
        convention: of azimuths: `math`, `compass` or `array`; None: the format's own.
        algorithm: algorithm to read, of a log with the estimates of several (frida); None: not given.
        start_ns: time of the origin of a log without absolute times [ns since the Unix epoch].
        ignore_extra: skip unknown columns instead of refusing them.
        hop: time from one hop to the next [s], of logs that count hops (odas); None: not given.
    """

    format: str = "auto"
    sensor: str | None = None
    unit: str | None = None
    convention: str | None = None
    algorithm: str | None = None
    start_ns: int = 0
    ignore_extra: bool = False
    hop: Fraction | None = None


class DoaRows(NamedTuple):
    """Directions of a log in columns (n,); angles and their standard deviations [rad] in the log's own convention.

    Elevations, standard deviations and confidences are NaN, identities -1, if the log has none.
    """

    line: Ints
    t_ns: Ints
    sensor: Strings
    source_id: Ints
    azimuth: Floats
    elevation: Floats
    sigma_azimuth: Floats
    sigma_elevation: Floats
    confidence: Floats


def azimuths_only(line: Ints, t_ns: Ints, sensor: Strings, azimuth: Floats) -> DoaRows:
    """Rows of a log that has azimuths only; all other values are unknown (NaN, identity -1).

    Args:
        line: (n,) line numbers.
        t_ns: (n,) times [ns].
        sensor: (n,) names of the arrays.
        azimuth: (n,) in the log's convention [rad].
    """
    unknown = np.full(len(line), np.nan)
    unlabelled = np.full(len(line), -1, dtype=np.int64)
    return DoaRows(
        line=line,
        t_ns=t_ns,
        sensor=sensor,
        source_id=unlabelled,
        azimuth=azimuth,
        elevation=unknown,
        sigma_azimuth=unknown,
        sigma_elevation=unknown,
        confidence=unknown,
    )


ANGLES = {
    "azimuth": ("azimuth", "bearing", "doa", "az"),
    "elevation": ("elevation", "el"),
    "sigma_azimuth": ("sigma_azimuth", "sigma", "sigma_az"),
    "sigma_elevation": ("sigma_elevation", "sigma_el"),
}
WHAT = "a log of directions of arrival"
FORMAT = TextFormat(
    WHAT,
    {
        "sensor": FormatColumn(("sensor", "array", "tower", "station", "node"), RAW, default=""),
        "id": FormatColumn(("id", "source_id", "source"), IDENTITY, least=-1, default=-1),
        "confidence": FormatColumn(("confidence", "conf", "score", "activity"), least=0.0, most=1.0, default=np.nan),
        **{
            name + unit: FormatColumn(tuple(alias + unit for alias in aliases), RAW, default="")
            for name, aliases in ANGLES.items()
            for unit in ("", "_deg", "_rad")
        },
    },
    times=True,
)
MIN_ROWS = 20
"""Number of directions from which their unit is judged by their range."""
AZIMUTHS = {name for key, names in FORMAT.names.items() if key.startswith("azimuth") for name in names}
"""Names of columns that a log is known by."""


def read_table(path: Path, options: DoaOptions, _losses: list[Loss]) -> Iterator[DoaRows]:
    """Yield the rows of a text table of directions of arrival.

    Args:
        path: the file.
        options: unit of angles, name of the array and origin of the times, where the file does not state them.
        _losses: not used by this format.

    Raises:
        InputError: a column is missing, or a value is invalid or out of range.
        UsageError: a column of angles does not state its unit.
    """
    label, names, count, least, most = "", set[str](), 0, np.inf, -np.inf
    for part in read_format(path, FORMAT, ignore_extra=options.ignore_extra):
        rows = part.rows
        elevation = _angle(rows, "elevation", options)
        _check_limits(rows, "elevation", np.abs(elevation) > np.pi / 2, "must be within 90 degrees")
        azimuth = _angle(rows, "azimuth", options)
        if np.isnan(azimuth).any():
            raise InputError(f"{path}: has no column azimuth_deg or azimuth_rad; add it", id="missing-column")
        label = label or (str(rows.cells["sensor"][0]) if rows.has("sensor") else "")
        t_ns, sensor = part.times(), _sensors(rows, options, label)
        steps: Floats = np.diff(np.unique(t_ns)).astype(np.float64) / NS
        check_unit(rows, steps)
        names, count = names | set(sensor.tolist()), count + len(rows)
        least, most = min(least, float(azimuth.min())), max(most, float(azimuth.max()))
        yield DoaRows(
            line=rows.lines,
            t_ns=t_ns + options.start_ns,
            sensor=sensor,
            source_id=part["id"],
            azimuth=azimuth,
            elevation=elevation,
            sigma_azimuth=_sigma(rows, "sigma_azimuth", options),
            sigma_elevation=_sigma(rows, "sigma_elevation", options),
            confidence=part["confidence"],
        )
    if count >= MIN_ROWS and (doubt := _unit_doubt(math.degrees(least), math.degrees(most), several=len(names) > 1)):
        note_once(f"warning: {path}: {doubt}")


def _unit_doubt(least_deg: float, most_deg: float, *, several: bool) -> str:
    """Text on angles that seem to be in another unit than degrees, by their range; empty: they do not.

    Args:
        least_deg: least azimuth, as read [degrees].
        most_deg: greatest azimuth.
        several: they are of several arrays.
    """
    widest = max(abs(least_deg), abs(most_deg))
    if several and 0.0 < widest <= 1.0:
        return f"all azimuths are within {widest:.3g} degrees of 0; turns? Then multiply them by 360"
    # From -pi to pi, or from 0 to 2 pi, and no more
    around = most_deg - least_deg > 0.95 * 2.0 * math.pi
    if (several or around) and widest <= 2.0 * math.pi:
        return f"all azimuths are within {widest:.3g} degrees of 0; are they radians? Then name the column azimuth_rad"
    if least_deg >= 0.0 and 361.0 < most_deg <= 400.0:
        return f"azimuths are 0 to {most_deg:.4g} degrees; gon? Then multiply them by 0.9"
    return ""


def _sensors(rows: CsvRows, options: DoaOptions, label: str) -> Strings:
    """(n,) names of the arrays of the rows: the one that the user states, or those in the file.

    InputError if neither is known, or if the file names another array than in its first row, `label`, and the user
    states one.
    """
    if options.sensor is not None:
        if rows.has("sensor"):
            check_one_sensor(rows, "sensor", options.sensor, label)
        return np.full(len(rows), options.sensor)
    if not rows.has("sensor"):
        raise InputError(
            f"{rows.path}: has no column sensor; add it, or name the microphone array: ARRAY={rows.path.name}",
            id="camera-not-named",
        )
    return rows.cells["sensor"]


def _angle(rows: CsvRows, name: str, options: DoaOptions) -> Floats:
    """(n,) angles [rad] of the column `name`, with the unit in its name or that of the options; NaN if missing.

    Raises:
        UsageError: no unit is known.
        InputError: there are two such columns, or angles are too large for radians.
    """
    found = [unit for unit in ("", "_deg", "_rad") if rows.has(name + unit)]
    if not found:
        return np.full(len(rows), np.nan)
    if len(found) > 1:
        raise InputError(
            f"{rows.path}: columns {' and '.join(name + unit for unit in found)} both state the {name}; keep one",
            id="duplicate-name",
        )
    unit = found[0].removeprefix("_") or options.unit
    if unit is None:
        raise UsageError(
            f"{rows.path}: column {name} does not state its unit; name it {name}_deg, or give {option('doa_unit')}",
            id="missing-unit",
        )
    values = rows.floats(name + found[0], blank=name != "azimuth")
    if unit == "rad":
        _check_limits(rows, name + found[0], np.abs(values) > 4 * np.pi, "is too large for radians; are these degrees?")
    return np.radians(values) if unit == "deg" else values


def _sigma(rows: CsvRows, name: str, options: DoaOptions) -> Floats:
    values = _angle(rows, name, options)
    _check_limits(rows, name, values <= 0, "must be above 0")
    return values


def _check_limits(rows: CsvRows, name: str, bad: np.ndarray, what: str) -> None:
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        column = next(n for n in (name, f"{name}_deg", f"{name}_rad") if rows.has(n))
        raise rows.fail(row, f"{column} is {rows.cells[column][row]}; it {what}; correct this line")
