"""Poses of KITTI odometry: a line of 12 numbers for each frame, three rows of a 4 x 4 matrix, and a file of times.

The matrix is the pose of the left camera in the camera frame of the first pose: x right, y down, z forward.  The scene
has z up and the ground in x and y: x is forward (z of KITTI), y is left (-x), and z is up (-y), from the first camera.
Format: https://www.cvlibs.net/datasets/kitti/eval_odometry.php
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from occlog.array_types import Floats
from occlog.console.notes import note_once
from occlog.errors import InputError
from occlog.io.files.limits import check_input
from occlog.io.files.texts.csv_rows import MAX_CELL, CsvRows, read_plain, text_lines

WHAT = "poses of KITTI (12 numbers a line)"
COLUMNS = 12
NAMES = ("time", "x", "y", "z")
NOT_ORTHOGONAL = 1e-3
"""Difference of a rotation's product with its transpose from the identity, at most."""
CLIMB_RATIO, CLIMB_M = 20.0, 1.0
"""Heights that vary this many times as much as the way forward, and by this much, are of a world with z up."""


def looks_like_kitti(head: Sequence[str]) -> bool:
    """Whether the cells of a first line are a pose of KITTI odometry: twelve numbers, with a rotation matrix."""
    if len(head) != COLUMNS:
        return False
    try:
        rotation = np.array([float(cell) for cell in head]).reshape(3, 4)[:, :3]
    except ValueError:
        return False
    if not np.isfinite(rotation).all() or np.abs(rotation).max() > 1 + NOT_ORTHOGONAL:
        return False
    return bool(np.abs(rotation @ rotation.T - np.eye(3)).max() <= NOT_ORTHOGONAL and np.linalg.det(rotation) > 0)


def read_kitti(path: Path) -> Iterator[CsvRows]:
    """Yield rows with time, x, y and z (as text) of KITTI odometry poses, in file order, in a world with z up.

    A note states the axes and the file of times, which is in the same folder.

    Raises:
        InputError: a line has not 12 numbers, there is no file of times, or it has another number of lines.
    """
    times_file = _times_file(path)
    times = _times(times_file)
    first, low, high = 0, np.full(3, np.inf), np.full(3, -np.inf)
    for rows in read_plain(path, WHAT):
        if len(rows.cells) != COLUMNS:
            raise InputError(f"{path}: {len(rows.cells)} columns; {WHAT} was expected", id="unknown-format")
        position = np.column_stack([rows.floats(str(column)) for column in (3, 7, 11)])
        last = first + len(rows)
        if last > len(times):
            raise InputError(
                f"{path}: {last} poses or more; {times_file.name} has {len(times)} times; one each is needed",
                id="incompatible-inputs",
            )
        low, high = np.minimum(low, position.min(axis=0)), np.maximum(high, position.max(axis=0))
        yield _in_the_scene(rows, position, times[first:last])
        first = last
    if first != len(times):
        raise InputError(
            f"{path}: {first} poses; {times_file.name} has {len(times)} times; one each is needed",
            id="incompatible-inputs",
        )
    note_once(
        f"note: {path}: poses of KITTI with the times of {times_file.name}; x is forward (z of the file), y is "
        "left (-x), "
        "z is up (-y)"
    )
    _, climb, way = (high - low).tolist()
    if climb > CLIMB_M and climb > CLIMB_RATIO * way:
        note_once(
            f"warning: {path}: heights vary by {climb:.3g} m, the way forward by {way:.3g} m: z seems to be up, not "
            "forward; write TUM text instead"
        )


def _in_the_scene(rows: CsvRows, position: Floats, times: Sequence[str]) -> CsvRows:
    right, down, forward = position.T
    axes = {"x": forward, "y": -right, "z": -down}
    cells = {name: np.array([repr(value) for value in values.tolist()]) for name, values in axes.items()}
    return CsvRows(rows.path, rows.lines, {"time": np.array(times), **cells})


def _times_file(path: Path) -> Path:
    """File with the times of the poses, in the same folder: NAME_times.txt, else times.txt; InputError if missing."""
    names = (f"{path.stem}_times.txt", "times.txt")
    found = next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)
    if found is None:
        raise InputError(
            f"{path}: {WHAT} have no times; put the times of the sequence into its folder as {names[0]}, one a "
            "line [s]",
            id="missing-times",
        )
    return found


def _times(path: Path) -> list[str]:
    """Time of each pose as text, one per line of the file; InputError for a line that is not one time."""
    out = []
    with check_input(path, "times of KITTI, one a line").open(encoding="utf-8-sig") as file:
        for line, text in text_lines(path, file):
            cell = text.strip()
            if not cell or len(cell) > MAX_CELL or (len(cell.split()) > 1 and "-" not in cell):
                raise InputError(f"{path}: line {line}: a time was expected, got {cell[:40]!r}")
            out.append(cell)
    return out
