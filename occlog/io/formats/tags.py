"""Readers of radio tags: tables of their positions, and logs of their reads.

Positions of readers: a text table with the columns reader, x, y, and perhaps z, range and power.

Logs of reads: a text table with the columns time, reader, tag and perhaps rssi.

Reads may be in any order. If all tags of a log are named by whole numbers, these are their targets; otherwise tags are
numbered from 0 in natural order of names.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from occlog.array_types import Ints, Strings
from occlog.errors import InputError, did_you_mean
from occlog.io.files.names import natural_sorted, safe_name
from occlog.io.files.texts.csv_rows import CsvRows, first_line
from occlog.io.files.texts.formats import LENGTH, TEXT, FormatColumn, TextFormat, read_format
from occlog.io.files.timing.frame_times import to_world_time
from occlog.records.scene import TagReader
from occlog.records.tables import Reads

if TYPE_CHECKING:
    from occlog.records.scene import Clock


READER_POSITIONS = TextFormat(
    "a table of readers",
    {
        "reader": FormatColumn(("reader", "name", "sensor", "anchor", "gateway"), TEXT),
        "x": FormatColumn(("x", "x_m"), LENGTH),
        "y": FormatColumn(("y", "y_m"), LENGTH),
        "z": FormatColumn(("z", "z_m"), default=0.0),
        "range": FormatColumn(("range", "range_m", "radius"), above=0.0, default=math.inf),
        "power": FormatColumn(("power", "power_dbm", "rssi_1m"), default=math.nan),
    },
)


def read_readers(path: Path) -> tuple[TagReader, ...]:
    """Read tag readers of a scene from a text table, in its order: position, range and power.

    An empty range is infinite, an empty power None (unknown).

    Raises:
        InputError: a column is missing, a name occurs twice, or a range is not above 0.
    """
    found: dict[str, TagReader] = {}
    for part in read_format(path, READER_POSITIONS):
        position = np.column_stack([part[axis] for axis in "xyz"])
        for row, cell in enumerate(part["reader"].tolist()):
            name = safe_name(cell)
            if name in found:
                raise part.rows.fail(row, f"reader {name} is there twice; give every reader its own name")
            power = float(part["power"][row])
            reach, known = float(part["range"][row]), None if math.isnan(power) else power
            found[name] = TagReader(name, position[row], range=reach, power=known)
    return tuple(found.values())


TAG_READS = TextFormat(
    "a log of reads",
    {
        "reader": FormatColumn(("reader", "sensor", "anchor", "gateway"), TEXT),
        "tag": FormatColumn(("tag", "beacon", "id", "epc", "target_id"), TEXT),
        "rssi": FormatColumn(("rssi", "rssi_dbm", "signal"), least=-200.0, most=50.0, unit="dBm", default=np.nan),
    },
    times=True,
)


def columns_of_reads(path: Path) -> set[str]:
    """Columns that the header of a log of reads has, by their names in occlog: `reader`, `tag`, `rssi`."""
    head = {cell.lower() for cell in first_line(path, TAG_READS.what)}
    return {name for name, column in TAG_READS.columns.items() if head & set(column.names)}


_NUMBER = re.compile(r"^[0-9]{1,9}$")


@dataclass(frozen=True)
class ReadLog:
    """Reads of tags in a log, and what was corrected.

    Attributes:
        reads: sorted by time.
        tags: target number of each tag.
        late: number of rows that come after a row of a later time.
        double: number of exact duplicates, which were skipped.
    """

    reads: Reads
    tags: Mapping[str, int]
    late: int
    double: int


def read_reads(
    path: Path,
    readers: Sequence[str],
    *,
    start_ns: int = 0,
    clocks: Mapping[str, Clock] | None = None,
    ignore_extra: bool = False,
) -> ReadLog:
    """Read a log of tag reads, in any order, from a text table.

    Args:
        path: the file.
        readers: names of the scene's readers, which the log must use.
        start_ns: time of the origin of a log without absolute times [ns since the Unix epoch].
        clocks: clock models by reader, for those that do not run by world time.
        ignore_extra: skip unknown columns instead of refusing them.

    Raises:
        InputError: a column is missing, a reader is not in the scene, a tag has no name, or a strength is out of range.
    """
    times, names, tags, strengths = [], [], [], []
    for part in read_format(path, TAG_READS, ignore_extra=ignore_extra):
        _check_readers(part.rows, readers)
        times.append(part.times() + start_ns)
        names.append(part["reader"])
        tags.append(part["tag"])
        strengths.append(part["rssi"])
    if not times:
        raise InputError(f"{path}: holds no reads; {TAG_READS.what} was expected", id="empty-input")
    sensor, tag, rssi = np.concatenate(names), np.concatenate(tags), np.concatenate(strengths)
    t_ns = _world_times(np.concatenate(times), sensor, clocks or {})
    late = int(np.count_nonzero(np.diff(t_ns) < 0))
    target = _targets(tag)
    number = np.array([target[name] for name in tag.tolist()], dtype=np.int32)
    kept, double = _without_doubles(t_ns, sensor, tag, rssi)
    reads = Reads.of(t_ns=t_ns[kept], sensor=sensor[kept], tag=tag[kept], target_id=number[kept], rssi=rssi[kept])
    return ReadLog(reads, target, late, double)


def _check_readers(rows: CsvRows, readers: Sequence[str]) -> None:
    """InputError, with the line, if a row names a reader that is not among `readers`, those of the scene."""
    unknown = np.flatnonzero(~np.isin(rows.cells["reader"], list(readers)))
    if not len(unknown):
        return
    name = str(rows.cells["reader"][unknown[0]])
    raise rows.fail(int(unknown[0]), f"reader {name!r} has no position; {did_you_mean(name, readers, 'readers:')}")


def _world_times(t_ns: Ints, sensor: Strings, clocks: Mapping[str, Clock]) -> Ints:
    """(n,) world times [ns] of reads at times (n,) [ns] by the clocks of their readers (n,).

    `clocks` has the clock models by reader; others run by world time.
    """
    out = t_ns.copy()
    for name, clock in clocks.items():
        mine = np.flatnonzero(sensor == name)
        if len(mine):
            out[mine] = to_world_time(t_ns[mine], clock, int(t_ns[mine].min()))
    return out


def _targets(tag: Strings) -> dict[str, int]:
    """Target number of each tag: its name if all names are distinct whole numbers, else its rank in natural order."""
    names = natural_sorted(np.unique(tag).tolist())
    if all(_NUMBER.match(name) for name in names) and len({int(name) for name in names}) == len(names):
        return {name: int(name) for name in names}
    return {name: n for n, name in enumerate(names)}


def _without_doubles(t_ns: Ints, sensor: Strings, tag: Strings, rssi: np.ndarray) -> tuple[Ints, int]:
    """Indices of the rows sorted by time, reader and tag, without exact duplicates; and the number of duplicates.

    Args:
        t_ns: (n,) times [ns].
        sensor: (n,) names of the readers.
        tag: (n,) names of the tags.
        rssi: (n,) signal strengths [dBm]; NaN: none.
    """
    order = np.lexsort((rssi, tag, sensor, t_ns))
    a, b = order[:-1], order[1:]
    similar = (rssi[a] == rssi[b]) | (np.isnan(rssi[a]) & np.isnan(rssi[b]))
    same = (t_ns[a] == t_ns[b]) & (sensor[a] == sensor[b]) & (tag[a] == tag[b]) & similar
    return order[np.concatenate([[True], ~same])], int(same.sum())
