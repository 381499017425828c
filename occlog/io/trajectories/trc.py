"""TRC, OpenSim's table of markers: a line for each time, three columns for each marker.

Markers must be targets, `target_N`, as `occlog export` calls them: those of others are points of a body, whose axes
the file does not tell.  Times count from the first one of the recording; empty cells are markers that are not there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from occlog.errors import InputError
from occlog.io.files.texts.csv_rows import MAX_CELL, Rows, text_lines
from occlog.records.names import first_double

MAGIC = "PathFileType"
UNITS = ("m", "mm")
HEADER = 5
"""Lines before the first time; an empty one may follow."""
ROWS_PER_CHUNK = 16_384
_MARKER = re.compile(r"^target_(\d{1,10})$")


def names_of(path: Path) -> tuple[str, ...]:
    """Names of the columns that `read_trc` gives; InputError where the unit of lengths is not one of `UNITS`."""
    unit = _unit(path, _header(path))
    return ("time", "target_id", *(f"{axis}_{unit}" for axis in "xyz"))


def read_trc(path: Path) -> Iterator[Rows]:
    """Rows of all targets by time; InputError, with the line, for what is not such a table."""
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
    """Lines of a text, without their ends."""
    with path.open(encoding="utf-8-sig") as file:
        try:
            for _, line in text_lines(path, file):
                yield line.rstrip("\r\n")
        except UnicodeDecodeError as error:
            bad = error.object[error.start]
            raise InputError(f"{path}: byte {bad:#04x}: not UTF-8 text; TRC was expected") from None


def _header(path: Path) -> list[str]:
    lines = list(islice(_lines(path), HEADER))
    if len(lines) < HEADER:
        raise InputError(f"{path}: {len(lines)} lines; TRC has a header of {HEADER}; make it again")
    return lines


def _unit(path: Path, header: list[str]) -> str:
    told = dict(zip(header[1].split("\t"), header[2].split("\t"), strict=False))
    unit = told.get("Units", "").strip()
    if unit not in UNITS:
        raise InputError(f"{path}: line 3: Units are {unit!r}; {' or '.join(UNITS)} was expected")
    return unit


def _targets(path: Path, header: list[str]) -> list[str]:
    """Identities of the markers, in order, as text."""
    markers = [cell.strip() for cell in header[3].split("\t")[2:] if cell.strip()]
    if not markers:
        raise InputError(f"{path}: line 4: names no marker; target_0, target_1, ... were expected")
    found = [_MARKER.match(marker) for marker in markers]
    for marker, match in zip(markers, found, strict=True):
        if match is None:
            raise InputError(
                f"{path}: line 4: marker {marker!r} is not a target; markers must be called target_0, target_1, ..., "
                "and have their place on the ground (x, y) with z up"
            )
    numbers = [match[1] for match in found if match is not None]
    twice = first_double(numbers)
    if twice is not None:
        raise InputError(f"{path}: line 4: marker target_{twice} is there twice; name each once")
    return numbers


def _targets_of(path: Path, line: int, text: str, targets: list[str]) -> Iterator[tuple[str, ...]]:
    """Time, identity and place of each target that a line has."""
    cells = [cell.strip() for cell in text.split("\t")]
    wanted = 2 + 3 * len(targets)
    if max(map(len, cells)) > MAX_CELL:
        raise InputError(f"{path}: line {line}: a cell of more than {MAX_CELL} characters; correct this line")
    if len(cells) > wanted and any(cells[wanted:]):
        raise InputError(f"{path}: line {line}: {len(cells)} cells; {len(targets)} markers have {wanted}")
    cells += [""] * (wanted - len(cells))
    for n, target in enumerate(targets):
        place = cells[2 + 3 * n : 5 + 3 * n]
        if all(place):
            yield cells[1], target, *place
        elif any(place):
            raise InputError(
                f"{path}: line {line}: target_{target} has a place with an empty cell; give all three or none"
            )


def _rows(path: Path, records: list[tuple[int, tuple[str, ...]]], names: tuple[str, ...]) -> Rows:
    lines = np.array([line for line, _ in records], dtype=np.int64)
    columns = zip(*(cells for _, cells in records), strict=True)
    return Rows(path, lines, {name: np.array(column) for name, column in zip(names, columns, strict=True)})
