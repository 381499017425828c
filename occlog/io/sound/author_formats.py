"""Logs of direction finders in their authors' own formats, and the places of their arrays."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Ints, Strings
from occlog.errors import InputError, UsageError
from occlog.io.files.texts.csv_rows import first_line, is_header, read_plain
from occlog.io.files.texts.formats import RAW, Column, Format, read_format
from occlog.records.losses import Loss
from occlog.records.scene import MicrophoneArray

from .csv_log import DoaOptions, DoaRows, azimuths_only
from .locata import looks_like_locata, read_array

WHAT = "a table of places of arrays"
MOST_ARRAYS = 10_000
"""Direction finders of a table at most: each becomes a sensor of the scene."""
FRIDA = Format(
    "a table of DOA estimates",
    {
        "recording": Column(("recording",), RAW),
        "algorithm": Column(("algorithm",), RAW),
        "estimate": Column(("estimate_deg",)),
    },
    ignored=("n_speakers", "snr_db", "speakers"),
)
MICROPHONES = Format("a table of microphones", {axis: Column((axis, f"{axis}_m")) for axis in "xyz"})
_DATE = re.compile(r"^\d\d/\d\d/\d\d$")
_NUMBER = re.compile(r"^[0-9]{1,9}$")


def read_frida(path: Path, options: DoaOptions, _losses: list[Loss]) -> Iterator[DoaRows]:
    """One algorithm's estimates; recording k of the file (from 0) gets the time k seconds.

    The estimates of one recording are a set without order or identity, measured from the
    array's own x axis.  The recordings have no time of their own.
    """
    if options.sensor is None:
        raise UsageError(f"{path}: does not name its array; give it as ARRAY={path.name}")
    numbers: dict[str, int] = {}
    algorithms: dict[str, None] = {}
    for part in read_format(path, FRIDA):
        number = np.array([numbers.setdefault(r, len(numbers)) for r in part["recording"].tolist()])
        algorithms.update(dict.fromkeys(part["algorithm"].tolist()))
        if options.algorithm is None and len(algorithms) > 1:
            raise UsageError(f"{path}: holds estimates of {', '.join(algorithms)}; choose one algorithm")
        kept = part["algorithm"] == (options.algorithm or next(iter(algorithms)))
        if not kept.any():
            continue
        t_ns = options.start_ns + number[kept].astype(np.int64) * NS
        azimuth = np.radians(part["estimate"][kept])
        yield azimuths_only(part.rows.lines[kept], t_ns, np.full(len(t_ns), options.sensor), azimuth)
    if options.algorithm is not None and options.algorithm not in algorithms:
        raise UsageError(f"{path}: has no algorithm {options.algorithm!r}; it has {', '.join(algorithms)}")


def looks_like_telemetr(head: list[str]) -> bool:
    """Whether the first line is date, time, animal, code and pairs of tower and bearing."""
    return len(head) >= 6 and len(head) % 2 == 0 and bool(_DATE.match(head[0])) and head[1].count(":") == 2


def read_telemetr(path: Path, options: DoaOptions, _losses: list[Loss]) -> Iterator[DoaRows]:
    """Bearings of towers, clockwise from north; dates are month/day/year, 1900 + yy, and taken for UTC.

    An animal's number is the identity of its bearings.  0 stands for a tower without a bearing
    (north is 360): the program that made such logs took the other towers alone for its fix.
    """
    for rows in read_plain(path, "a field log of bearings"):
        columns = len(rows.cells)
        if columns < 6 or columns % 2:
            raise InputError(
                f"{path}: {columns} columns; date, time, animal, code and pairs of tower and bearing expected"
            )
        t_ns = np.array(
            [_moment(path, rows.lines[n], rows.cells["0"][n], rows.cells["1"][n]) for n in range(len(rows))]
        )
        pairs = range(4, columns, 2)
        line = np.concatenate([rows.lines for _ in pairs])
        tower = np.concatenate([rows.cells[str(c)] for c in pairs])
        degrees = np.concatenate([rows.floats(str(c + 1)) for c in pairs])
        if ((degrees < 0) | (degrees > 360)).any():
            row = int(np.flatnonzero((degrees < 0) | (degrees > 360))[0])
            raise InputError(f"{path}: line {line[row]}: bearing {degrees[row]:g}; it must be 0 to 360 degrees")
        times = np.concatenate([t_ns for _ in pairs]) + options.start_ns
        animal = np.concatenate([_animals(rows.cells["2"]) for _ in pairs])
        order = np.argsort(line, kind="stable")
        order = order[degrees[order] != 0.0]
        found = azimuths_only(line[order], times[order], tower[order], np.radians(degrees[order]))
        yield found._replace(source_id=animal[order])


def _animals(cells: Strings) -> Ints:
    """Numbers of animals; -1 for a name that is not a number, which an identity must be."""
    return np.array([int(c) if _NUMBER.match(c) else -1 for c in cells.tolist()], dtype=np.int64)


def _moment(path: Path, line: int, day: str, clock: str) -> int:
    try:
        moment = datetime.strptime(f"{day} {clock}", "%m/%d/%y %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        raise InputError(
            f"{path}: line {line}: {day} {clock} is not a date and time (month/day/year hour:minute:second)"
        ) from None
    return int(moment.timestamp()) * NS


def read_arrays(path: Path, name: str | None = None) -> tuple[MicrophoneArray, ...]:
    """Arrays of a scene from a table of places.

    A table of LOCATA is one array with its pose.  With a header x, y, z the rows are the microphones
    of one array at the origin, called `name` or after the file; without a header, rows x, y are
    direction finders 1, 2, ... called tower1, tower2, ...
    """
    head = first_line(path, WHAT)
    if looks_like_locata(head):
        return (read_array(path, name),)
    if is_header(head):
        parts = [np.column_stack([part[axis] for axis in "xyz"]) for part in read_format(path, MICROPHONES)]
        if not parts:
            raise InputError(f"{path}: holds a header and no row; columns x, y and z of microphones were expected")
        microphones = np.concatenate(parts)
        return (MicrophoneArray(name or path.stem, np.zeros(3), microphones=microphones),)
    plain = list(read_plain(path, WHAT))
    if (count := sum(map(len, plain))) > MOST_ARRAYS:
        raise InputError(f"{path}: {count} rows; places of at most {MOST_ARRAYS} direction finders were expected")
    if len(plain[0].cells) not in (2, 3):
        raise InputError(f"{path}: {len(plain[0].cells)} columns; x and y of direction finders were expected")
    places = np.concatenate([np.column_stack([rows.floats(c) for c in rows.cells]) for rows in plain])
    places = np.column_stack([places, np.zeros((len(places), 3 - places.shape[1]))])
    return tuple(MicrophoneArray(f"{name or 'tower'}{n}", xyz) for n, xyz in enumerate(places, start=1))
