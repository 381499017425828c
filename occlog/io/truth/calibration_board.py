"""Triangulated corners of a calibration board (caliscope's xyz_*.csv) as the truth of one point."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from occlog.array_types import Floats, Ints
from occlog.errors import InputError, UsageError
from occlog.io.files.texts.formats import RAW, WHOLE, Column, Format, read_format
from occlog.io.files.untrusted.guard import naming
from occlog.records.tables import Truth

CORNERS = Format(
    "board corners",
    {
        "sync": Column(("sync_index",), WHOLE),
        "object": Column(("object_id",), WHOLE, default=0, blank=False),
        "corner": Column(("keypoint_id", "point_id"), WHOLE),
        "x": Column(("x_coord", "x")),
        "y": Column(("y_coord", "y")),
        "z": Column(("z_coord", "z")),
        "time": Column(("frame_time",), RAW, default=""),
    },
)
SYNC_TIMES = Format("time stamps with a column sync_index", {"sync": Column(("sync_index",), WHOLE)}, True, others=True)
MIN_CORNERS = 3


def read_board(path: Path, sync_ns: Mapping[int, int] | None) -> Truth:
    """The middle of the board over time, as target 0.

    Corners come and go, and the mean of whichever are seen would jump.  So it is taken of
    the corners that are there at every time, or, if these are fewer than three, of all
    corners at the times when all are there.

    Args:
        path: the file.
        sync_ns: time [ns] of every synchronisation index, from `read_sync_times`.
    """
    if sync_ns is None:
        raise UsageError(f"{path}: counts synchronisation indices; give their times (timestamps.csv)")
    sync, corner, xyz = _read(path)
    names, column = np.unique(corner, return_inverse=True)
    times, row = np.unique(sync, return_inverse=True)
    grid = np.full((len(times), len(names), 3), np.nan)
    if len(np.unique(row * len(names) + column)) < len(row):
        first = np.unique(row * len(names) + column, return_index=True)[1]
        double = int(np.setdiff1d(np.arange(len(row)), first)[0])
        raise InputError(
            f"{path}: a corner is there twice at sync_index {sync[double]}; leave out the copies, or split the file"
        )
    grid[row, column] = xyz
    there = np.isfinite(grid[:, :, 0])
    always = there.all(axis=0)
    if int(always.sum()) >= MIN_CORNERS:
        middle, kept = grid[:, always].mean(axis=1), times
    else:
        whole = there.all(axis=1)
        middle, kept = grid[whole].mean(axis=1), times[whole]
    if not len(kept):
        raise InputError(f"{path}: at no time are all corners of the board there, and fewer than 3 are there always")
    missing = [int(s) for s in kept if int(s) not in sync_ns]
    if missing:
        raise InputError(f"{path}: sync_index {missing[0]} has no time in the time stamps")
    t_ns = np.array([sync_ns[int(s)] for s in kept], dtype=np.int64)
    n = len(kept)
    with naming(path):
        return Truth.of(
            t_ns=t_ns,
            target_id=np.zeros(n, dtype=np.int32),
            role=np.full(n, "target"),
            x=middle[:, 0],
            y=middle[:, 1],
            z=middle[:, 2],
        )


def _read(path: Path) -> tuple[Ints, Ints, Floats]:
    sync, corner, xyz = [], [], []
    for part in read_format(path, CORNERS):
        sync.append(part["sync"])
        corner.append(part["corner"] + 1_000_000 * part["object"])  # of several boards
        xyz.append(np.column_stack([part[axis] for axis in "xyz"]))
    if not sync:
        raise InputError(f"{path}: holds a header and no row; {CORNERS.what} were expected")
    return np.concatenate(sync), np.concatenate(corner), np.concatenate(xyz)


def read_sync_times(path: Path) -> dict[int, int]:
    """Time [ns] of each synchronisation index in a caliscope timestamps.csv: the mean over its cameras."""
    found: dict[int, list[int]] = {}
    for part in read_format(path, SYNC_TIMES):
        for sync, t in zip(part["sync"].tolist(), part.times().tolist(), strict=True):
            found.setdefault(sync, []).append(t)
    return {sync: _mean(times) for sync, times in found.items()}


def _mean(times: list[int]) -> int:
    """Mean of times [ns], which are too large to be added up as floats."""
    first = min(times)
    return first + round(sum(t - first for t in times) / len(times))
