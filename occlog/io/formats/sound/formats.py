"""Logs of direction finders in their authors' own formats, and the positions of their arrays.

Text files of the LOCATA challenge: poses of arrays with their microphones, and positions of sources.

Each is a table with tabs with rows that are times (`year`, `month`, `day`, `hour`, `minute`, `second`) of an optical
tracking system: position `x`, `y`, `z` [m] in a world with z up, and `rotation_11` to `rotation_33`,
world-from-local by rows.  Arrays also have `mic1_x`, `mic1_y`, `mic1_z`, `mic2_x`, ..., which are in the world.
The challenge counts azimuths of an array from its y axis; here they are counted, as ever, from its x axis.

Streams of ODAS: sources that it tracks (SST) or finds (SSL), as JSON objects one after another.

An object is a hop of the sound: `{"timeStamp": 17, "src": [{"id": 3, "tag": "dynamic", "x": 0.6, "y": 0.8, "z": 0.0,
"activity": 0.9}, ...]}`; sources that are found but not tracked have `x, y, z, E`.  The time stamp counts hops; their
length (hopSize / fS) is in ODAS' configuration only.  The vector is a unit vector in the array's frame.  An empty
slot has the id 0, or no direction: a hop with empty slots alone has no source.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from fractions import Fraction
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occlog.array_types import NS, Floats, Ints, Strings
from occlog.console.notes import note_once
from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import naming
from occlog.io.files.names import safe_name
from occlog.io.files.texts.csv_rows import first_line, is_header, read_plain
from occlog.io.files.texts.formats import RAW, WHOLE, FormatColumn, TextFormat, TextPart, read_format
from occlog.io.formats.scenes.stations import holds_stations, read_stations
from occlog.records.losses import Loss
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Truth

from .csv_log import DoaOptions, DoaRows, azimuths_only

LOCATA_TABLE = "a table of the LOCATA challenge"
TIMES = ("year", "month", "day", "hour", "minute", "second")
PLACE = ("x", "y", "z")
ROTATION = tuple(f"rotation_{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
STILL_M, STILL_RAD = 0.03, np.radians(2.0)
"""Up to this, changes of an array's pose are taken for noise of the tracking system."""
MAX_ROTATION_ERROR = 1e-3
_MICROPHONE = re.compile(r"^mic(\d{1,4})_([xyz])$")
_LAST_NUMBER = re.compile(r"(\d{1,9})$")


def looks_like_locata(head: Sequence[str]) -> bool:
    """Whether the cells of a header line are those of a LOCATA table of poses."""
    return {*TIMES, *PLACE} <= {cell.strip().lower() for cell in head}


def read_array(path: Path, name: str | None) -> MicrophoneArray:
    """Read a static microphone array of the LOCATA challenge: mean pose, and microphones in its own frame.

    Args:
        path: `position_array_NAME.txt`.
        name: of the array in the scene; None: that in the file name.

    Raises:
        InputError: the table is malformed, or the array moves.
    """
    head = [cell.strip().lower() for cell in first_line(path, LOCATA_TABLE)]
    numbers = sorted({int(found[1]) for cell in head if (found := _MICROPHONE.match(cell))})
    columns = [f"mic{n}_{axis}" for n in numbers for axis in "xyz"]
    missing = [c for c in (*ROTATION, *columns) if c not in head]
    if missing or not numbers:
        raise InputError(
            f"{path}: has no column {(missing or ['mic1_x'])[0]}; a microphone array of LOCATA "
            "(position_array_NAME.txt) "
            "was expected",
            id="missing-column",
        )
    parts = list(_locata_rows(path, (*PLACE, *ROTATION, *columns)))
    positions = np.concatenate([_values(rows, PLACE) for rows in parts])
    turns = np.concatenate([_values(rows, ROTATION) for rows in parts]).reshape(-1, 3, 3)
    heard = np.concatenate([_values(rows, columns) for rows in parts]).reshape(len(positions), -1, 3)
    lines = np.concatenate([part.rows.lines for part in parts])
    _check_rotations(path, turns, lines)
    _check_still(path, positions, turns, lines)
    # Microphones in the array's frame are p = R^T (m - c), as LOCATA's own programs have it.
    own = np.einsum("nji,nmj->nmi", turns, heard - positions[:, None]).mean(axis=0)
    u, _, vt = np.linalg.svd(turns.mean(axis=0))
    yaw, pitch, roll = _angles(u @ vt)
    called = name or safe_name(path.stem.removeprefix("position_array_"))
    return MicrophoneArray(called, positions.mean(axis=0), yaw=yaw, microphones=own, pitch=pitch, roll=roll)


def read_source(path: Path) -> Truth:
    """Read the positions of one source of the LOCATA challenge; its identity is the last number in the file name, or 0.

    Repeated times count once. InputError if times decrease.
    """
    number = _LAST_NUMBER.search(path.stem)
    times: list[Ints] = []
    positions: list[Floats] = []
    for part in _locata_rows(path, PLACE):
        t_ns = _times(part)
        last = times[-1][-1:] if times else t_ns[:1]
        back = np.flatnonzero(np.diff(np.concatenate([last, t_ns])) < 0)
        if len(back):
            raise part.rows.fail(int(back[0]), "its time is before that of the row above; sort the rows by time")
        times.append(t_ns)
        positions.append(_values(part, PLACE))
    t_ns, first = np.unique(np.concatenate(times), return_index=True)
    x, y, z = np.concatenate(positions)[first].T
    n = len(t_ns)
    target = np.full(n, int(number[1]) if number else 0)
    with naming(path):
        return Truth.of(t_ns=t_ns, target_id=target, role=np.full(n, "target"), x=x.copy(), y=y.copy(), z=z.copy())


def _locata_rows(path: Path, columns: Sequence[str]) -> list[TextPart]:
    """Rows of a LOCATA table in parts; it must have the given columns, and may have others. InputError without rows."""
    known = {name: FormatColumn((name,), RAW if name == "second" else WHOLE) for name in TIMES}
    parts = list(
        read_format(
            path, TextFormat(LOCATA_TABLE, known | {name: FormatColumn((name,)) for name in columns}, others=True)
        )
    )
    if not parts:
        raise InputError(f"{path}: has no row; {LOCATA_TABLE} was expected", id="empty-input")
    return parts


def _values(part: TextPart, columns: Sequence[str]) -> Floats:
    return np.column_stack([part[name] for name in columns])


def _times(part: TextPart) -> Ints:
    """(n,) times [ns since the Unix epoch] of date and time columns, taken as UTC, exact to the nanosecond."""
    minutes: dict[tuple[int, ...], int] = {}
    out = np.empty(len(part), dtype=np.int64)
    parts = zip(*(part[name].tolist() for name in TIMES[:5]), strict=True)
    for row, (instant, second) in enumerate(zip(parts, part["second"].tolist(), strict=True)):
        try:
            if instant not in minutes:
                minutes[instant] = int(datetime(*instant, tzinfo=UTC).timestamp()) * NS  # type: ignore[misc]
            seconds = Decimal(second)
            if not 0 <= seconds < 60:
                raise ValueError(f"second {second}")
            out[row] = minutes[instant] + round(seconds * NS)
        except (ValueError, OverflowError, InvalidOperation, TypeError) as error:
            raise part.rows.fail(row, f"not a date and time ({error}); correct this line") from None
    return out


def _check_rotations(path: Path, turns: Floats, lines: Ints) -> None:
    """InputError, with the line, if one of the matrices `turns` (n, 3, 3) is not a rotation."""
    off = np.abs(np.einsum("nij,nkj->nik", turns, turns) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > MAX_ROTATION_ERROR) | (np.linalg.det(turns) < 0))
    if len(bad):
        raise InputError(
            f"{path}: line {lines[bad[0]]}: rotation_11 to rotation_33 are not a rotation matrix; correct them"
        )


def _check_still(path: Path, positions: Floats, turns: Floats, lines: Ints) -> None:
    """InputError, with the line, if an array moves from its first pose by more than `STILL_M` or `STILL_RAD`.

    Args:
        path: file, for messages.
        positions: (n, 3) [m].
        turns: (n, 3, 3) world-from-array rotations.
        lines: (n,) line numbers.
    """
    moved = np.linalg.norm(positions - positions[0], axis=1)
    cosine = (np.einsum("ij,nij->n", turns[0], turns) - 1) / 2
    turned = np.arccos(np.clip(cosine, -1.0, 1.0))
    bad = np.flatnonzero((moved > STILL_M) | (turned > STILL_RAD))
    if len(bad):
        k = int(bad[0])
        raise InputError(
            f"{path}: line {lines[k]}: the array has moved by {moved[k]:.3g} m and {np.degrees(turned[k]):.3g} degrees "
            f"since the first line (limits {STILL_M} m, {np.degrees(STILL_RAD):g} degrees); moving arrays cannot be "
            "used",
            id="not-applicable",
        )


def _angles(rotation: Floats) -> tuple[float, float, float]:
    """Yaw, pitch and roll [rad] of a (3, 3) world-from-array rotation; array frame x forward, y left, z up."""
    forward, left = rotation[:, 0], rotation[:, 1]
    flat = float(np.hypot(forward[0], forward[1]))
    yaw = float(np.arctan2(forward[1], forward[0])) if flat > 1e-12 else 0.0
    level = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    roll = float(np.arctan2(left @ np.cross(forward, level), left @ level))
    return yaw, float(np.arctan2(forward[2], flat)), roll


ARRAY_POSITIONS = "a table of positions of arrays"
MAX_ARRAYS = 10_000
"""Direction finders of a table at most: each becomes a sensor of the scene."""
FRIDA = TextFormat(
    "a table of DOA estimates",
    {
        "recording": FormatColumn(("recording",), RAW),
        "algorithm": FormatColumn(("algorithm",), RAW),
        "estimate": FormatColumn(("estimate_deg",)),
    },
    ignored=("n_speakers", "snr_db", "speakers"),
)
MICROPHONE_UNITS = {"": 1.0, "_cm": 0.01, "_mm": 0.001}
"""Endings of names of columns of microphones, and their units [m]."""
MICROPHONES = TextFormat(
    "a table of microphones",
    {
        f"{axis}{unit}": FormatColumn(
            (axis, f"{axis}_m") if not unit else (f"{axis}{unit}",), default=math.nan, blank=False
        )
        for unit in MICROPHONE_UNITS
        for axis in "xyz"
    },
)
_DATE = re.compile(r"^\d\d/\d\d/\d\d$")
_WHOLE_NUMBER = re.compile(r"^[0-9]{1,9}$")


def _array_of(path: Path, options: DoaOptions) -> str:
    """Name of the array of a log that names none, as the options state it; UsageError if they do not."""
    if options.sensor is None:
        raise UsageError(f"{path}: does not name its array; give it as ARRAY={path.name}", id="camera-not-named")
    return options.sensor


def read_frida(path: Path, options: DoaOptions, _losses: list[Loss]) -> Iterator[DoaRows]:
    """Yield the estimates of one algorithm in FRIDA's file; recording k (from 0) gets the time k seconds.

    The estimates of one recording are a set without order or identity, measured from the array's own x axis. The
    recordings have no time stamps.

    Args:
        path: the file.
        options: must name the array, and the algorithm if the file has several.
        _losses: not used by this format.

    Raises:
        UsageError: the array or the algorithm is not stated, or does not exist.
    """
    sensor = _array_of(path, options)
    numbers: dict[str, int] = {}
    algorithms: dict[str, None] = {}
    for part in read_format(path, FRIDA):
        number = np.array([numbers.setdefault(r, len(numbers)) for r in part["recording"].tolist()])
        algorithms.update(dict.fromkeys(part["algorithm"].tolist()))
        if options.algorithm is None and len(algorithms) > 1:
            raise UsageError(
                f"{path}: holds estimates of {', '.join(algorithms)}; choose one ({option('doa_algorithm')})",
                id="ambiguous-input",
            )
        kept = part["algorithm"] == (options.algorithm or next(iter(algorithms)))
        if not kept.any():
            continue
        t_ns = options.start_ns + number[kept].astype(np.int64) * NS
        azimuth = np.radians(part["estimate"][kept])
        yield azimuths_only(part.rows.lines[kept], t_ns, np.full(len(t_ns), sensor), azimuth)
    if options.algorithm is not None and options.algorithm not in algorithms:
        raise UsageError(
            f"{path}: has no algorithm {options.algorithm!r} ({option('doa_algorithm')}); choose one of "
            f"{', '.join(algorithms)}",
            id="unknown-name",
        )


def looks_like_telemetr(head: list[str]) -> bool:
    """Whether the cells of a first line are date, time, animal, code and pairs of tower and bearing."""
    return len(head) >= 6 and len(head) % 2 == 0 and bool(_DATE.match(head[0])) and head[1].count(":") == 2


def read_telemetr(path: Path, options: DoaOptions, _losses: list[Loss]) -> Iterator[DoaRows]:
    """Yield bearings of towers, clockwise from north, from a field log of telemetr; animals are identities.

    Dates are month/day/year, 1900 + yy, taken as UTC. A bearing of 0 means none (north is 360) and is omitted.

    Args:
        path: the log.
        options: has the origin of the times.
        _losses: not used by this format.
    """
    for rows in read_plain(path, "a field log of bearings"):
        columns = len(rows.cells)
        if columns < 6 or columns % 2:
            raise InputError(
                f"{path}: {columns} columns; date, time, animal, code and pairs of tower and bearing expected",
                id="unknown-format",
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
    """(n,) identities from the cells of the column of animals: whole numbers; -1 for other names."""
    return np.array([int(c) if _WHOLE_NUMBER.match(c) else -1 for c in cells.tolist()], dtype=np.int64)


def _moment(path: Path, line: int, day: str, clock: str) -> int:
    try:
        instant = datetime.strptime(f"{day} {clock}", "%m/%d/%y %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        raise InputError(
            f"{path}: line {line}: {day} {clock} is not a date and time (month/day/year hour:minute:second)"
        ) from None
    return int(instant.timestamp()) * NS


def _microphones(path: Path, part: TextPart) -> Floats:
    """(M, 3) positions [m] in a part of a table of microphones; columns end in the unit, `_cm` or `_mm`, or are in m.

    InputError without exactly one column for each axis.
    """
    out = np.empty((len(part), 3))
    for n, axis in enumerate("xyz"):
        found = [unit for unit in MICROPHONE_UNITS if part.rows.has(axis + unit)]
        if len(found) != 1:
            problem = f"two columns of {axis}; keep one" if found else f"no column {axis}; add it"
            raise InputError(f"{path}: has {problem} (x, y, z in m, or x_cm, x_mm)", id="missing-column")
        out[:, n] = MICROPHONE_UNITS[found[0]] * part[axis + found[0]]
    return out


def read_arrays(path: Path, name: str | None = None) -> tuple[MicrophoneArray, ...]:
    """Read microphone arrays (or direction finders) of a scene from a table of positions, in metres.

    A table of LOCATA is one array with its pose. With a header x, y, z the rows are the microphones of one array at the
    origin, called `name` or after the file. With names as well, rows are arrays. Without a header, rows x, y are
    direction finders called tower1, tower2, ... (or `name`1, ...).

    Raises:
        InputError: the table is none of these, or has lengths in another unit.
        UsageError: `name` is given for a table that names its arrays.
    """
    head = first_line(path, ARRAY_POSITIONS)
    if looks_like_locata(head):
        return (read_array(path, name),)
    if holds_stations(path):
        if name is not None:
            raise UsageError(
                f"{path}: names its arrays; give the file without a name ({option('arrays')} {path.name})",
                id="conflicting-options",
            )
        scene = read_stations(path)
        if scene.length_unit != "m":
            raise InputError(
                f"{path}: positions of arrays are in {scene.length_unit}; convert them to m", id="unit-mismatch"
            )
        return scene.arrays
    if is_header(head):
        parts = [_microphones(path, part) for part in read_format(path, MICROPHONES)]
        if not parts:
            raise InputError(
                f"{path}: holds a header and no row; columns x, y and z of microphones were expected", id="empty-input"
            )
        microphones = np.concatenate(parts)
        return (MicrophoneArray(name or path.stem, np.zeros(3), microphones=microphones),)
    plain = list(read_plain(path, ARRAY_POSITIONS))
    if (count := sum(map(len, plain))) > MAX_ARRAYS:
        raise InputError(
            f"{path}: {count} rows; positions of at most {MAX_ARRAYS} direction finders were expected",
            id="input-too-large",
        )
    if len(plain[0].cells) not in (2, 3):
        raise InputError(
            f"{path}: {len(plain[0].cells)} columns; x, y and perhaps z of direction finders were expected",
            id="unknown-format",
        )
    positions = np.concatenate([np.column_stack([rows.floats(c) for c in rows.cells]) for rows in plain])
    positions = np.column_stack([positions, np.zeros((len(positions), 3 - positions.shape[1]))])
    return tuple(MicrophoneArray(f"{name or 'tower'}{n}", xyz) for n, xyz in enumerate(positions, start=1))


READ_BYTES = 1 << 18
MAX_OBJECT = 1 << 20
"""Characters of one object: ODAS writes about 100 for a source."""
LENGTHS = (0.9, 1.1)
"""Limits of the length of a direction vector; ODAS writes three decimals."""
MAX_ELEVATION = math.radians(89.0)
"""Elevation above which three decimals of a direction give no azimuth."""
MAX_COUNT, COUNTER = 10**11, 2**32
"""A greater time stamp is no count of hops: at a hop of 1 ms it would be three years after the start; number of
values of a counter of 32 bits."""
MAX_GAP = 10**6
"""Hops that may be missing where such a counter begins again."""
MAX_DISORDER, MAX_PAUSE_S = 10, 60.0
"""Hops by which objects out of order go back at most; pause between hops [s] above which it is noted."""
ROWS_PER_CHUNK = 16_384


class _OdasObject(NamedTuple):
    """One JSON object of an ODAS stream, a hop: line on which it begins, number of the hop, and its sources."""

    line: int
    number: int
    sources: list[dict[str, object]]


def looks_like_odas(head: list[str]) -> bool:
    """Whether the first line of a file, split into cells, begins a JSON object."""
    return bool(head) and head[0].lstrip("\ufeff").lstrip().startswith("{")


def read_odas(path: Path, options: DoaOptions, losses: list[Loss]) -> Iterator[DoaRows]:
    """Yield the directions of a stream of ODAS, in the array's frame.

    Sources without activity (which ODAS only predicts), or straight above or below (without azimuth), are skipped with
    a note.

    Args:
        path: the stream.
        options: must name the array and the hop length.
        losses: an object that the end of the file cuts off is added.

    Raises:
        UsageError: the hop or the array is not stated.
        InputError: an object is not what ODAS writes; with the line.
    """
    sensor = _array_of(path, options)
    if options.hop is None:
        raise UsageError(
            f"{path}: its timeStamp counts hops; state the hop [s] ({option('odas_hop')}), "
            f"hopSize / fS of ODAS' configuration, "
            "for example 0.008 or 128/16000",
            id="missing-times",
        )
    rows: list[tuple[int, int, int, float, float, float]] = []
    hops = taken = idle = above = wraps = 0
    counter = _Counter(path, sensor, float(options.hop))
    for hop, after in pairwise(chain(_hops(path, losses), [None])):
        if hop is None:
            break
        wraps += counter.advance(hop, after)
        t_ns = options.start_ns + round((hop.number + wraps * COUNTER) * options.hop * NS)
        sources = list(_sources(path, hop))
        heard = [source for source in sources if source[3] != 0.0]
        level = [source for source in heard if abs(source[2]) < MAX_ELEVATION]
        hops, taken = hops + 1, taken + len(level)
        idle, above = idle + len(sources) - len(heard), above + len(heard) - len(level)
        rows += [(hop.line, t_ns, *source) for source in level]
        if len(rows) >= ROWS_PER_CHUNK:
            yield _odas_rows(rows, sensor)
            rows = []
    if rows:
        yield _odas_rows(rows, sensor)
    counter.note()
    if idle:
        note_once(
            f"note: {path}: {idle} directions without activity omitted: ODAS predicted them without hearing a source"
        )
    if above:
        note_once(f"note: {path}: {above} directions straight up or down omitted: they have no azimuth")
    if hops and not taken:
        note_once(
            f"warning: {path}: {hops} hops and no direction; check the thresholds of ODAS, and that its "
            "microphones recorded"
        )


@dataclass
class _Counter:
    """The counter of hops of a stream of ODAS, checked from object to object.

    Attributes:
        path: the stream, for messages.
        sensor: name of the array.
        hop_s: hop length [s].
        before: hop before; None: there is none.
        counted: number of hops so far.
        silent: number of those without a source.
        repeats: number of those with the count of the one before.
        repeat: line of the first of these.
        jump: largest increase.
        jump_line: line of the hop behind it.
    """

    path: Path
    sensor: str
    hop_s: float
    before: _OdasObject | None = None
    counted: int = 0
    silent: int = 0
    repeats: int = 0
    repeat: int = 0
    jump: int = 0
    jump_line: int = 0

    def advance(self, hop: _OdasObject, after: _OdasObject | None) -> bool:
        """Take the next hop, followed by `after`; return whether a counter of 32 bits has begun again at 0.

        InputError if the count of one object is off, goes back (a second run) or jumps by half the range of such a
        counter.
        """
        before, self.before = self.before, hop
        self.counted += 1
        self.silent += all(s.get("id") == 0 or not any(s.get(axis) for axis in "xyz") for s in hop.sources)
        if before is None:
            return False
        step = hop.number - before.number
        if after is not None and before.number < after.number and not before.number <= hop.number <= after.number:
            raise self._error(hop, f"timeStamp is {hop.number} between {before.number} and {after.number}; correct it")
        if self.counted > 2 and COUNTER - MAX_GAP < -step < COUNTER:
            return True
        if step < 0:
            remedy = (
                "sort the log by time"
                if -step <= MAX_DISORDER
                else "it starts again there: these are two runs in one file; split it at this line"
            )
            raise self._error(hop, f"time of {self.sensor} goes back by {-step * self.hop_s:.3g} s; {remedy}")
        if step > COUNTER // 2:
            raise self._error(
                hop, f"timeStamp jumps from {before.number} to {hop.number}; correct it, or split the log"
            )
        if step == 0:
            self.repeats, self.repeat = self.repeats + 1, self.repeat or hop.line
        if step > self.jump:
            self.jump, self.jump_line = step, hop.line
        return False

    def note(self) -> None:
        """Note repeated counts and a long jump; InputError if most counts repeat."""
        if 2 * self.repeats > self.counted:
            raise InputError(
                f"{self.path}: timeStamp repeats in {self.repeats} of {self.counted} objects, so that it does not "
                "count hops; write the number of each hop",
                id="unsorted-times",
            )
        if self.repeats:
            note_once(
                f"warning: {self.path}: line {self.repeat}: timeStamp repeats ({self.repeats} in all): "
                "two logs in one file, or a part twice?"
            )
        if (jump_s := self.jump * self.hop_s) > MAX_PAUSE_S:
            # A log of hops with a source alone has such pauses
            note_once(
                f"{'warning' if self.silent else 'note'}: {self.path}: line {self.jump_line}: timeStamp jumps by "
                f"{self.jump} hops ({jump_s:.6g} s): is this one recording?"
            )

    def _error(self, hop: _OdasObject, text: str) -> InputError:
        return InputError(f"{self.path}: line {hop.line}: {text}", id="unsorted-times")


def parse_hop(text: str) -> Fraction:
    """Parse a hop length [s], a number or a quotient such as 128/16000; UsageError unless above 0 and at most 1."""
    try:
        value = Fraction(text.replace(" ", ""))
    except (ValueError, ZeroDivisionError):
        value = Fraction(0)
    if not 0 < value <= 1:
        raise UsageError(
            f"{option('odas_hop')} {text}: expected seconds above 0 and at most 1, for example 0.008 or 128/16000"
        )
    return value


def _hops(path: Path, losses: list[Loss]) -> Iterator[_OdasObject]:
    """Yield the JSON objects of an ODAS stream, which is read in pieces.

    If the file ends within the last object, this is added to `losses`.
    """
    decoder = json.JSONDecoder(parse_constant=_refuse_constant)
    text, at, line, ended = "", 0, 1, False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        while True:
            start = _after_blanks(text, at)
            line += text.count("\n", at, start)
            found, end, problem = _decode(decoder, text, start)
            at = start
            if found is not None:
                yield _check(path, line, found)
                line += text.count("\n", at, end)
                at = end
            elif ended:
                if at < len(text):
                    _end(path, line, text[at:], problem, losses)
                return
            elif len(text) - at > MAX_OBJECT:
                raise _malformed(path, line, problem)
            else:
                more = file.read(READ_BYTES)
                text, at, ended = text[at:] + more, 0, not more


def _after_blanks(text: str, at: int) -> int:
    """Index of the first character of `text`, from `at` on, that is not white space."""
    while at < len(text) and text[at] in " \t\r\n":
        at += 1
    return at


def _decode(decoder: json.JSONDecoder, text: str, at: int) -> tuple[object, int, str]:
    """Decode the JSON value at index `at` of a text; return the value, the index behind it, and an empty text.

    None, `at` and the parser's reason if the value is incomplete or invalid.
    """
    if at >= len(text):
        return None, at, ""
    try:
        found, end = decoder.raw_decode(text, at)
    except (ValueError, RecursionError) as error:
        return None, at, str(error).split(":")[0]
    return found, end, ""


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def _end(path: Path, line: int, text: str, problem: str, losses: list[Loss]) -> None:
    """Handle the text after the last complete object of an ODAS stream.

    An object that is cut off is added to `losses`; other text is an InputError with `problem`, the parser's reason.
    """
    cut = text.startswith("{") and text.count("{") > text.count("}")
    if not cut:
        raise _malformed(path, line, problem)
    losses.append(Loss(path.name, f"line {line}", "the file ends within this object", 1))


def _malformed(path: Path, line: int, problem: str) -> InputError:
    return InputError(
        f"{path}: line {line}: not an object of ODAS ({problem}); JSON objects one after another were expected",
        id="invalid-syntax",
    )


def _check(path: Path, line: int, found: object) -> _OdasObject:
    """Convert a JSON value on a line of an ODAS stream to a hop; InputError if it has another form."""
    if not isinstance(found, dict):
        raise _malformed(path, line, f"a JSON {type(found).__name__}")
    count, sources = found.get("timeStamp"), found.get("src")
    if isinstance(count, bool) or not isinstance(count, int) or not 0 <= count <= MAX_COUNT:
        raise InputError(f"{path}: line {line}: timeStamp is {count!r}; a number of hops, 0 or more, was expected")
    if not isinstance(sources, list) or not all(isinstance(s, dict) for s in sources):
        raise InputError(f"{path}: line {line}: src is not a list of JSON objects, one for each source; correct it")
    return _OdasObject(line, count, sources)


def _sources(path: Path, hop: _OdasObject) -> Iterator[tuple[int, float, float, float]]:
    """Yield identity, azimuth, elevation and confidence of each source of a hop.

    Angles [rad] are in the array's frame; the identity is -1 if there is none. Idle slots are omitted. InputError for
    a direction that is not a unit vector.
    """
    for source in hop.sources:
        identity = source.get("id", -1)
        if isinstance(identity, bool) or not isinstance(identity, int) or not -1 <= identity < 2**31:
            raise InputError(f"{path}: line {hop.line}: id is {identity!r}; a whole number was expected")
        x, y, z = (_number(path, hop, source, key) for key in ("x", "y", "z"))
        length = float(np.sqrt(x * x + y * y + z * z))
        if identity == 0 or length == 0.0:
            continue
        if not LENGTHS[0] <= length <= LENGTHS[1]:
            raise InputError(
                f"{path}: line {hop.line}: x, y, z is ({x:g}, {y:g}, {z:g}), of length {length:.3g}; a unit vector was "
                "expected"
            )
        strength = next((_number(path, hop, source, key) for key in ("activity", "E") if key in source), np.nan)
        elevation = float(np.arctan2(z, np.hypot(x, y)))
        yield identity, float(np.arctan2(y, x)), elevation, float(np.clip(strength, 0.0, 1.0))


def _number(path: Path, hop: _OdasObject, source: dict[str, object], key: str) -> float:
    value = source.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InputError(f"{path}: line {hop.line}: {key} of a source is {value!r}; a number was expected")
    return float(value)


def _odas_rows(rows: list[tuple[int, int, int, float, float, float]], sensor: str) -> DoaRows:
    line, t_ns, identity = np.array([row[:3] for row in rows], dtype=np.int64).T
    azimuth, elevation, confidence = np.array([row[3:] for row in rows], dtype=np.float64).T
    found = azimuths_only(line, t_ns, np.full(len(rows), sensor), azimuth)
    return found._replace(source_id=identity, elevation=elevation, confidence=confidence)
