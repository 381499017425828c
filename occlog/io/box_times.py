"""Times of frames from the times that rows of boxes carry."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .box_rows import BoxRows
from .csv_rows import Rows
from .frame_times import FrameTimes
from .timestamps import parse_times, time_column


def note_times(rows: Rows, boxes: BoxRows, cameras: list[str], stamps: dict[str, dict[int, int]]) -> None:
    """Remember the time of every frame of every camera; InputError where one frame has two."""
    unit = time_column(rows)
    if unit is None:
        return
    t_ns = parse_times(rows, unit, unit)
    for n, name in enumerate(cameras):
        found = stamps.setdefault(name, {})
        for row in np.flatnonzero(boxes.camera == n).tolist():
            frame, t = int(boxes.frame[row]), int(t_ns[row])
            if found.setdefault(frame, t) != t:
                raise rows.fail(row, f"frame {frame} of camera {name} has two times ({found[frame]} and {t} ns)")


def table_times(found: dict[int, int], first: int, stop: int, where: str) -> FrameTimes:
    """Times of all frames; those without a row lie evenly between their neighbours."""
    frames = np.array(sorted(found), dtype=np.int64)
    t_ns = np.array([found[int(f)] for f in frames], dtype=np.int64)
    if (np.diff(t_ns) <= 0).any():
        k = int(np.flatnonzero(np.diff(t_ns) <= 0)[0])
        raise InputError(
            f"{where}: frame {frames[k + 1]} has time {t_ns[k + 1]} ns, not after the {t_ns[k]} ns of frame {frames[k]}"
        )
    step = (t_ns[-1] - t_ns[0]) / max(int(frames[-1] - frames[0]), 1)
    if not step and stop - first > 1:
        raise InputError(f"{where}: only frame {frames[0]} has a time, which says nothing of the others; give --fps")
    wanted = np.arange(stop)
    # Relative to the first time: float64 cannot hold ns since 1970 exactly.
    relative = np.interp(wanted, frames, (t_ns - t_ns[0]).astype(np.float64))
    before, after = wanted < frames[0], wanted > frames[-1]
    relative[before] = (wanted[before] - frames[0]) * step
    relative[after] = float(t_ns[-1] - t_ns[0]) + (wanted[after] - frames[-1]) * step
    table = np.round(relative).astype(np.int64) + t_ns[0]
    table[frames[frames < stop]] = t_ns[frames < stop]
    return FrameTimes("column of times", 0, table)
