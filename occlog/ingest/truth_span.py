"""True positions and the frames that a recording has: those outside `frames` are left out, or told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from occlog.array_types import NS
from occlog.io.boxes.reader import BoxSurvey
from occlog.io.files.times.frame_times import FrameTimes
from occlog.records.tables import Truth, TruthBoxes

from .plan import IngestPlan

TOLD_S = 1.0
"""True positions that begin so long before the first frame, or end so long after the last one, are told."""


def span_of(frames: tuple[int, int], times: Mapping[str, FrameTimes]) -> tuple[int, int] | None:
    """First and last time [ns] of the frames first <= number < stop of all cameras, half a frame wider at both ends.

    None where no camera has such a frame.
    """
    ends: list[tuple[int, int]] = []
    for each in times.values():
        stop = frames[1] if each.count is None else min(frames[1], each.count)
        if frames[0] >= stop:
            continue
        first, last = each.at(np.array([frames[0], stop - 1], dtype=np.int64)).tolist()
        step = each.interval_ns()
        half = int(step / 2) if math.isfinite(step) else 0
        ends.append((first - half, last + half))
    return (min(a for a, _ in ends), max(b for _, b in ends)) if ends else None


def within_frames(
    tables: Iterator[Truth | TruthBoxes],
    plan: IngestPlan,
    survey: BoxSurvey | None,
    times: Mapping[str, FrameTimes],
    note: Callable[[str], None],
) -> Iterator[Truth | TruthBoxes]:
    """The tables, true positions only of the frames that are chosen; a note says how many were left out.

    Without a choice all are kept, and a note says by how much they go beyond the looks of a detector.
    """
    looked = None if survey is None or plan.video or plan.images else (survey.first, survey.stop)
    frames = plan.frames or looked
    span = None if frames is None else span_of(frames, times)
    rows = out = 0
    early = late = 0.0
    for table in tables:
        if span is None or not isinstance(table, Truth) or not len(table):
            yield table
            continue
        inside = (table.t_ns >= span[0]) & (table.t_ns <= span[1])
        rows, out = rows + len(table), out + int((~inside).sum())
        early = max(early, (span[0] - int(table.t_ns.min())) / NS)
        late = max(late, (int(table.t_ns.max()) - span[1]) / NS)
        if plan.frames is None:
            yield table
        elif inside.any():
            yield table.take(inside)
    if out and plan.frames is not None:
        tell_left_out(out, rows, plan, note)
    elif max(early, late) > TOLD_S:
        ends = [f"begin {early:.3g} s before the first"] if early > TOLD_S else []
        ends += [f"go on {late:.3g} s after the last"] if late > TOLD_S else []
        note(
            f"truth: true positions {' and '.join(ends)} frame with boxes; people there count as missed: choose the "
            "frames (frames), or cut the truth"
        )


def tell_left_out(out: int, rows: int, plan: IngestPlan, note: Callable[[str], None]) -> None:
    """Note that so many of the rows of the truth are of other frames than those that are chosen."""
    chosen = ":".join(map(str, plan.frames or ()))
    note(f"truth: {out} of {rows} true positions are of other frames than {chosen}, and left out")
