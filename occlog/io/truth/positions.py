"""True positions on their way from a text table to the table of the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occlog.array_types import Floats, Ints, Strings
from occlog.errors import InputError, UsageError
from occlog.io.boxes.reader import BoxOptions
from occlog.io.files.csv_rows import Rows
from occlog.io.files.frame_times import FrameTimes
from occlog.io.files.timestamps import TIME_COLUMNS, parse_times, time_column
from occlog.records.tables import Truth

COLUMNS: dict[str, Sequence[str]] = {
    "frame": ("frame", "frame_id", "frame_number", "frame_index"),
    "id": ("id", "target_id", "track_id", "object_id", "person_id"),
    "x": ("x", "x_m", "pos_x"),
    "y": ("y", "y_m", "pos_y"),
    "z": ("z", "z_m", "pos_z"),
    "role": ("role",),
    **TIME_COLUMNS,
}


@dataclass(frozen=True, eq=False)
class TruthOptions:
    """How truth files are to be understood.

    Attributes:
        format: a key of `FORMATS`, or `auto`.
        camera: camera whose boxes a file holds, where it does not say; None: not given.
        cameras: names of the cameras in use.
        times: times of the frames of each camera.
        sync_ns: time of every synchronisation index (caliscope).
        boxes: how boxes are to be read.
    """

    format: str = "auto"
    camera: str | None = None
    cameras: Sequence[str] = ()
    times: Mapping[str, FrameTimes] = field(default_factory=dict)
    sync_ns: Mapping[int, int] | None = None
    boxes: BoxOptions = BoxOptions()

    def frame_times(self, where: str) -> FrameTimes:
        """Times of frames that are not of one camera; UsageError where the cameras do not agree."""
        if self.camera is not None and self.camera in self.times:
            return self.times[self.camera]
        if not self.times:
            raise UsageError(f"{where}: counts frames, and nothing says when they were taken; give the frame rate")
        found = list(self.times.values())
        first = found[0]
        same = all((t.rate, t.start_ns, t.count) == (first.rate, first.start_ns, first.count) for t in found)
        tables = [t.table_ns for t in found if t.table_ns is not None]
        if not same or any(not np.array_equal(t, tables[0]) for t in tables):
            raise UsageError(f"{where}: counts frames, but the cameras' frames differ in time; give CAMERA={where}")
        return first


class Positions(NamedTuple):
    """Rows of true positions, and the line where each stands."""

    t_ns: Ints
    target_id: Ints
    role: Strings
    x: Floats
    y: Floats
    z: Floats
    line: Ints


def csv_positions(rows: Rows, options: TruthOptions) -> Positions:
    """Positions of a table with a header; InputError where a column is missing or a value cannot be."""
    missing = [name for name in ("x", "y") if not rows.has(name)]
    if missing:
        raise InputError(f"{rows.path}: has no column {' and '.join(missing)}; add it")
    n = len(rows)
    role = rows.cells["role"] if rows.has("role") else np.full(n, "target")
    wrong = np.flatnonzero(~np.isin(role, ("target", "occluder")))
    if len(wrong):
        raise rows.fail(int(wrong[0]), f"role {str(role[wrong[0]])!r} must be target or occluder")
    return Positions(
        _row_times(rows, options),
        rows.ints("id") if rows.has("id") else np.zeros(n, dtype=np.int64),
        role,
        rows.floats("x"),
        rows.floats("y"),
        rows.floats("z", blank=True) if rows.has("z") else np.full(n, np.nan),
        rows.lines,
    )


def _row_times(rows: Rows, options: TruthOptions) -> Ints:
    unit = time_column(rows)
    if unit is not None:
        return parse_times(rows, unit, unit)
    if not rows.has("frame"):
        raise InputError(f"{rows.path}: has neither a column of times (time, t_ns) nor frame; add one")
    try:
        return options.frame_times(rows.path.name).at(rows.ints("frame") - options.boxes.first_number)
    except InputError as error:
        raise InputError(f"{rows.path}: {error}") from None


def gather(path: Path, parts: list[Positions]) -> Truth:
    """All positions in the order of time; InputError where a target is at two places at once."""
    columns: list[Any] = [np.concatenate(column) for column in zip(*parts, strict=True)]
    p = Positions(*columns)
    order = np.lexsort((p.target_id, p.t_ns))
    p = Positions(*(c[order] for c in columns))
    double = np.flatnonzero((np.diff(p.t_ns) == 0) & (np.diff(p.target_id) == 0))
    if len(double):
        k = int(double[0])
        raise InputError(
            f"{path}: lines {min(p.line[k : k + 2])} and {max(p.line[k : k + 2])}: target {p.target_id[k]} is twice at "
            f"{p.t_ns[k]} ns; remove one"
        )
    return Truth.of(t_ns=p.t_ns, target_id=p.target_id, role=p.role, x=p.x, y=p.y, z=p.z)


def mot_positions(rows: Rows, options: TruthOptions) -> Positions | None:
    """World positions of the rows that have one (the last three columns are not all -1)."""
    if len(rows.cells) < 10:
        return None
    x, y, z = rows.floats("7"), rows.floats("8"), rows.floats("9")
    known = np.flatnonzero(~((x == -1) & (y == -1) & (z == -1)) & (rows.floats("6") != 0))
    if not len(known):
        return None
    try:
        t_ns = options.frame_times(rows.path.name).at(rows.ints("0")[known] - 1)
    except InputError as error:
        raise InputError(f"{rows.path}: {error}") from None
    role = np.full(len(known), "target")
    return Positions(t_ns, rows.ints("1")[known], role, x[known], y[known], z[known], rows.lines[known])
