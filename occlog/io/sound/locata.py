"""Text files of the LOCATA challenge: poses of arrays with their microphones, and positions of sources.

Each is a table with tabs whose rows are times (`year`, `month`, `day`, `hour`, `minute`, `second`) of an optical
tracking system: place `x`, `y`, `z` [m] in a world whose z axis is up, and `rotation_11` to `rotation_33`,
world-from-local by rows.  Arrays also have `mic1_x`, `mic1_y`, `mic1_z`, `mic2_x`, ..., which are in the world.
The challenge counts azimuths of an array from its y axis; here they are counted, as ever, from its x axis.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from occlog.array_types import NS, Floats, Ints
from occlog.errors import InputError
from occlog.io.files.names.sensors import safe_name
from occlog.io.files.texts.csv_rows import first_line
from occlog.io.files.texts.formats import RAW, WHOLE, Column, Format, Part, read_format
from occlog.io.files.untrusted.guard import naming
from occlog.records.scene import MicrophoneArray
from occlog.records.tables import Truth

WHAT = "a table of the LOCATA challenge"
TIMES = ("year", "month", "day", "hour", "minute", "second")
PLACE = ("x", "y", "z")
ROTATION = tuple(f"rotation_{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
STILL_M, STILL_RAD = 0.03, np.radians(2.0)
"""Up to this, changes of an array's pose are taken for noise of the tracking system."""
MAX_ROTATION_ERROR = 1e-3
_MICROPHONE = re.compile(r"^mic(\d{1,4})_([xyz])$")
_NUMBER = re.compile(r"(\d{1,9})$")


def looks_like_locata(head: Sequence[str]) -> bool:
    """Whether a header line is that of a table of poses."""
    return {*TIMES, *PLACE} <= {cell.strip().lower() for cell in head}


def read_array(path: Path, name: str | None) -> MicrophoneArray:
    """An array that stands still, with its microphones in its own frame.

    Args:
        path: `position_array_NAME.txt`.
        name: what the array is called; None: as the file says.

    Raises:
        InputError: the table is malformed, or the array moves, which no array of a scene does.
    """
    head = [cell.strip().lower() for cell in first_line(path, WHAT)]
    numbers = sorted({int(found[1]) for cell in head if (found := _MICROPHONE.match(cell))})
    columns = [f"mic{n}_{axis}" for n in numbers for axis in "xyz"]
    missing = [c for c in (*ROTATION, *columns) if c not in head]
    if missing or not numbers:
        raise InputError(f"{path}: has no column {(missing or ['mic1_x'])[0]}; {WHAT} of an array was expected")
    parts = list(_rows(path, (*PLACE, *ROTATION, *columns)))
    places = np.concatenate([_values(rows, PLACE) for rows in parts])
    turns = np.concatenate([_values(rows, ROTATION) for rows in parts]).reshape(-1, 3, 3)
    heard = np.concatenate([_values(rows, columns) for rows in parts]).reshape(len(places), -1, 3)
    lines = np.concatenate([part.rows.lines for part in parts])
    _check_rotations(path, turns, lines)
    _check_still(path, places, turns, lines)
    # Microphones in the array's frame are p = R^T (m - c), as LOCATA's own programs have it.
    own = np.einsum("nji,nmj->nmi", turns, heard - places[:, None]).mean(axis=0)
    u, _, vt = np.linalg.svd(turns.mean(axis=0))
    yaw, pitch, roll = _angles(u @ vt)
    called = name or safe_name(path.stem.removeprefix("position_array_"))
    return MicrophoneArray(called, places.mean(axis=0), yaw=yaw, microphones=own, pitch=pitch, roll=roll)


def read_source(path: Path) -> Truth:
    """Places of one source in the order of time; its identity is the number at the end of the file's name, or 0.

    A time that is repeated counts once.  InputError where times go back.
    """
    number = _NUMBER.search(path.stem)
    times: list[Ints] = []
    places: list[Floats] = []
    for part in _rows(path, PLACE):
        t_ns = _times(part)
        last = times[-1][-1:] if times else t_ns[:1]
        back = np.flatnonzero(np.diff(np.concatenate([last, t_ns])) < 0)
        if len(back):
            raise part.rows.fail(int(back[0]), "its time is before that of the row above; sort the rows by time")
        times.append(t_ns)
        places.append(_values(part, PLACE))
    t_ns, first = np.unique(np.concatenate(times), return_index=True)
    x, y, z = np.concatenate(places)[first].T
    n = len(t_ns)
    target = np.full(n, int(number[1]) if number else 0)
    with naming(path):
        return Truth.of(t_ns=t_ns, target_id=target, role=np.full(n, "target"), x=x.copy(), y=y.copy(), z=z.copy())


def _rows(path: Path, columns: Sequence[str]) -> list[Part]:
    """The rows of a table that has these columns, and perhaps others."""
    known = {name: Column((name,), RAW if name == "second" else WHOLE) for name in TIMES}
    parts = list(read_format(path, Format(WHAT, known | {name: Column((name,)) for name in columns}, others=True)))
    if not parts:
        raise InputError(f"{path}: has no row; {WHAT} was expected")
    return parts


def _values(part: Part, columns: Sequence[str]) -> Floats:
    return np.column_stack([part[name] for name in columns])


def _times(part: Part) -> Ints:
    """(n,) times [ns since 1970], taken for UTC, exact to the nanosecond."""
    minutes: dict[tuple[int, ...], int] = {}
    out = np.empty(len(part), dtype=np.int64)
    parts = zip(*(part[name].tolist() for name in TIMES[:5]), strict=True)
    for row, (moment, second) in enumerate(zip(parts, part["second"].tolist(), strict=True)):
        try:
            if moment not in minutes:
                minutes[moment] = int(datetime(*moment, tzinfo=UTC).timestamp()) * NS  # type: ignore[misc]
            seconds = Decimal(second)
            if not 0 <= seconds < 60:
                raise ValueError(f"second {second}")
            out[row] = minutes[moment] + round(seconds * NS)
        except (ValueError, OverflowError, InvalidOperation, TypeError) as error:
            raise part.rows.fail(row, f"not a date and time ({error}); correct this line") from None
    return out


def _check_rotations(path: Path, turns: Floats, lines: Ints) -> None:
    """Raise InputError for a matrix that is no rotation."""
    off = np.abs(np.einsum("nij,nkj->nik", turns, turns) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > MAX_ROTATION_ERROR) | (np.linalg.det(turns) < 0))
    if len(bad):
        raise InputError(f"{path}: line {lines[bad[0]]}: rotation_11 to rotation_33 are not a rotation")


def _check_still(path: Path, places: Floats, turns: Floats, lines: Ints) -> None:
    """Raise InputError where the array moves."""
    moved = np.linalg.norm(places - places[0], axis=1)
    cosine = (np.einsum("ij,nij->n", turns[0], turns) - 1) / 2
    turned = np.arccos(np.clip(cosine, -1.0, 1.0))
    bad = np.flatnonzero((moved > STILL_M) | (turned > STILL_RAD))
    if len(bad):
        k = int(bad[0])
        raise InputError(
            f"{path}: line {lines[k]}: the array has moved by {moved[k]:.3g} m and {np.degrees(turned[k]):.3g} degrees "
            f"(limits {STILL_M} m, {np.degrees(STILL_RAD):g} degrees); the arrays of a scene stand still"
        )


def _angles(rotation: Floats) -> tuple[float, float, float]:
    """Yaw, pitch and roll [rad] of a (3, 3) world-from-array rotation: x forward, y left, z up."""
    forward, left = rotation[:, 0], rotation[:, 1]
    flat = float(np.hypot(forward[0], forward[1]))
    yaw = float(np.arctan2(forward[1], forward[0])) if flat > 1e-12 else 0.0
    level = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    roll = float(np.arctan2(left @ np.cross(forward, level), left @ level))
    return yaw, float(np.arctan2(forward[2], flat)), roll
