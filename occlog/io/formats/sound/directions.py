"""Directions of arrival: logs of microphone arrays and other direction finders.

Formats (`FORMATS`), found out from the content:

    csv        a header line with a column of times, sensor (where the file holds several),
               azimuth_deg or azimuth_rad, and perhaps elevation, sigma, confidence, id
    frida      estimates of several algorithms, one unordered set a recording
    telemetr   field log of direction finders: date time animal code, then tower and bearing
    odas       JSON objects of ODAS, one after another; times are counts of hops

Conventions of azimuth: `math` from +x towards +y; `compass` clockwise from north, which is
+y; `array` from the array's own x axis towards its y axis, to which its yaw is added.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Floats, Ints, Strings
from occlog.errors import InputError
from occlog.io.files.limits import check_input
from occlog.io.files.names import check_meaning, match_sensor
from occlog.io.files.texts.formats import FileFormat, Probe, by_cells, recognise
from occlog.io.files.timing.frame_times import to_world_time
from occlog.io.files.timing.times import restart_of
from occlog.records.losses import Loss
from occlog.records.scene import Clock, MicrophoneArray
from occlog.records.tables import Doa

from .csv_log import AZIMUTHS, WHAT, DoaOptions, DoaRows, read_table
from .formats import looks_like_odas, looks_like_telemetr, read_frida, read_odas, read_telemetr

DoaFormat = FileFormat[Callable[[Path, DoaOptions, list[Loss]], Iterator[DoaRows]]]
FORMATS: dict[str, DoaFormat] = {
    "odas": DoaFormat(read_odas, "JSON stream of ODAS, tracked or found sources", by_cells(looks_like_odas), "array"),
    "frida": DoaFormat(
        read_frida, "estimates of FRIDA/Pyramic", by_cells({"algorithm", "estimate_deg"}.issubset), "array"
    ),
    "telemetr": DoaFormat(
        read_telemetr, "field log of telemetr (azimuth.dat)", by_cells(looks_like_telemetr), "compass"
    ),
    "csv": DoaFormat(
        read_table, "CSV with a header", by_cells(lambda head: any(cell in AZIMUTHS for cell in head)), "math"
    ),
}
"""Every format, with the convention of its azimuths."""


def read_doa(
    path: Path,
    arrays: Sequence[MicrophoneArray],
    options: DoaOptions,
    clocks: Mapping[str, Clock] | None = None,
    losses: list[Loss] | None = None,
) -> Iterator[Doa]:
    """Yield tables of directions of arrival from a log, with azimuths in the world and world times.

    Args:
        path: the log.
        arrays: arrays of the scene; sensors of the log are matched with their names.
        options: what the log does not state itself.
        clocks: clock models by array, for those that do not run by world time.
        losses: the part that the end of the file cuts off is added; None: that is an error.

    Raises:
        InputError: the log is malformed, names an array that the scene lacks, or its times decrease.
    """
    check_input(path, WHAT)
    entry = FORMATS[_format(path, options)]
    convention = options.convention or entry.assumed
    names = [a.name for a in arrays]
    spans: dict[str, tuple[int, int]] = {}
    first: dict[str, int] = {}
    meant: dict[str, str] = {}
    collected: list[Loss] = [] if losses is None else losses
    tilted = {a.name: a for a in arrays if not a.upright}
    for rows in entry.read(path, options, collected):
        unique, inverse = np.unique(rows.sensor, return_inverse=True)
        matched = [match_sensor(str(label), names, str(path), what="array") for label in unique]
        for label, name in zip(unique.tolist(), matched, strict=True):
            check_meaning(meant, label, name, str(path), what="array")
        sensor = np.array(matched, dtype=np.str_)[inverse]
        _check_times(path, rows, sensor, spans)
        rows = _by_clocks(rows, sensor, clocks or {}, first)
        yaw = {a.name: a.yaw for a in arrays}
        offset = np.array([yaw[name] for name in matched])[inverse]
        azimuth = to_world(rows.azimuth, convention, offset)
        if convention == "array" and tilted:
            azimuth, rows = _untilted(rows, sensor, azimuth, tilted)
        yield _table(rows, sensor, azimuth)
    if losses is None and collected:
        raise InputError(f"{collected[0]}; repair the log")


def _format(path: Path, options: DoaOptions) -> str:
    name = recognise(FORMATS, Probe(path, WHAT), options.format, "DOA")
    if name is None and Probe(path, WHAT).start.startswith(b"["):
        raise InputError(
            f"{path}: is a list of JSON; write its objects one after another, as ODAS does, without [ ] and commas",
            id="unsupported-format",
        )
    if name is None:
        raise InputError(
            f"{path}: has no column of azimuths (azimuth_deg, azimuth_rad); name the columns in a header line",
            id="missing-column",
        )
    return name


def to_world(azimuth: Floats, convention: str, array_yaw: Floats | float = 0.0) -> Floats:
    """(n,) world azimuths [rad] in [-pi, pi), from +x towards +y.

    Args:
        azimuth: (n,) angles [rad] in the stated convention.
        convention: `math` (from +x towards +y), `compass` (clockwise from +y) or `array` (from the array's own x axis).
        array_yaw: yaw [rad] of the array of each row, used by `array`.
    """
    angle = np.pi / 2 - azimuth if convention == "compass" else azimuth
    if convention == "array":
        angle = angle + array_yaw
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    return np.where(wrapped >= np.pi, wrapped - 2 * np.pi, wrapped)


def _untilted(
    rows: DoaRows, sensor: Strings, azimuth: Floats, tilted: Mapping[str, MicrophoneArray]
) -> tuple[Floats, DoaRows]:
    """World azimuths (n,), and rows with world elevations, from directions in the frames of tilted arrays.

    Rows without elevation, and of arrays that are upright, are unchanged.

    Args:
        rows: n rows with angles in the frames of the arrays.
        sensor: (n,) names of the arrays.
        azimuth: (n,) world azimuths if the arrays were upright [rad].
        tilted: tilted arrays by name.
    """
    azimuth, elevation = azimuth.copy(), rows.elevation.copy()
    for name, array in tilted.items():
        mine = np.flatnonzero((sensor == name) & np.isfinite(rows.elevation))
        own, up = rows.azimuth[mine], rows.elevation[mine]
        rays = np.column_stack([np.cos(up) * np.cos(own), np.cos(up) * np.sin(own), np.sin(up)]) @ array.rotation.T
        azimuth[mine] = to_world(np.arctan2(rays[:, 1], rays[:, 0]), "math")
        elevation[mine] = np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1]))
    return azimuth, rows._replace(elevation=elevation)


MAX_RESTART_SHARE = 0.1
"""Times that go back to this share of those so far, or less, are those of another run."""


def _check_times(path: Path, rows: DoaRows, sensor: Strings, spans: dict[str, tuple[int, int]]) -> None:
    """InputError if times of one array decrease; several directions at one time are allowed.

    Args:
        path: file, for messages.
        rows: n rows.
        sensor: (n,) name of the array of each row.
        spans: first and last time of each array so far; updated.
    """
    for name in np.unique(sensor).tolist():
        mine = np.flatnonzero(sensor == name)
        t_ns: Ints = rows.t_ns[mine]
        first, last = spans.get(name, (int(t_ns[0]), int(t_ns[0])))
        before = np.concatenate([[last], t_ns[:-1]])
        back = np.flatnonzero(t_ns < before)
        if len(back):
            k = int(back[0])
            began = t_ns[k] - first < MAX_RESTART_SHARE * (before[k] - first)
            remedy = restart_of(float(before[k] - t_ns[k]) / NS) or (
                "it starts again there: these are two runs in one file; split it at this line"
                if began
                else "sort the log by time"
            )
            raise InputError(
                f"{path}: line {int(rows.line[mine[k]])}: time of {name} goes back by "
                f"{(before[k] - t_ns[k]) / NS:.3g} s; {remedy}",
                id="unsorted-times",
            )
        spans[name] = first, int(t_ns[-1])


def _by_clocks(rows: DoaRows, sensor: Strings, clocks: Mapping[str, Clock], first: dict[str, int]) -> DoaRows:
    """Copy of the rows with world times, by the clock models of the arrays.

    Args:
        rows: n rows.
        sensor: (n,) name of the array of each row.
        clocks: clock models by array.
        first: first time of each array [ns], at which its drift is 0; updated.
    """
    t_ns = rows.t_ns.copy()
    for name, clock in clocks.items():
        mine = np.flatnonzero(sensor == name)
        if len(mine):
            start = first.setdefault(name, int(t_ns[mine[0]]))
            t_ns[mine] = to_world_time(t_ns[mine], clock, start)
    return rows._replace(t_ns=t_ns)


def _table(rows: DoaRows, sensor: Strings, azimuth: Floats) -> Doa:
    order = np.lexsort((rows.source_id, sensor, rows.t_ns))
    values = rows._asdict() | {"sensor": sensor, "azimuth": azimuth}
    return Doa.of(**{c.name: values[c.name][order] for c in Doa.columns()})
