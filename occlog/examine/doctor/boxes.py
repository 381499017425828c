"""Files of boxes: text and JSON of detectors and of benchmarks."""

from __future__ import annotations

from functools import partial

import numpy as np

from occlog.array_types import Ints, Uints
from occlog.errors import InputError
from occlog.io.boxes.columns import BoxSource
from occlog.io.boxes.reader import box_rows, note_times
from occlog.io.boxes.rows import BoxRows, fingerprints
from occlog.io.files.texts.csv_rows import Rows, bad_lines_told_to

from .clock import Clock, judge_clocks
from .findings import Findings
from .rows import halves

MOST_ROWS = 8_000_000
"""Rows among which copies are looked for: 16 bytes of each are kept."""


def look_at_boxes(source: BoxSource, findings: Findings) -> None:
    """Look at every row of a file of boxes, for rows that stand there twice, and at the times of frames."""
    copies, cameras = _Copies(), list[str]()
    stamps: dict[str, dict[int, int]] = {}
    with bad_lines_told_to(partial(findings.refused, "row")):
        try:
            for rows in source.chunks:
                _look_at(rows, cameras, source.first_number or 0, copies, stamps, findings)
        except InputError as error:
            findings.refused("unreadable", error)
    copies.judge(findings)
    judge_clocks([_clock(camera, stamps[camera]) for camera in sorted(stamps)], findings)


def _look_at(
    rows: Rows,
    cameras: list[str],
    first_number: int,
    copies: _Copies,
    stamps: dict[str, dict[int, int]],
    findings: Findings,
) -> None:
    def make(start: int, stop: int) -> tuple[Ints, BoxRows]:
        part = rows.pick(np.arange(start, stop))
        boxes = box_rows(part, cameras, first_number)
        note_times(part, boxes, cameras, stamps)
        return part.lines, boxes

    good: list[tuple[Ints, BoxRows]] = []
    for _, error in halves(len(rows), make, good):
        findings.refused("row", error)
    for lines, boxes in good:
        copies.add(lines, boxes)


def _clock(camera: str, stamps: dict[int, int]) -> Clock:
    """The times of a camera's frames, by their numbers; in one without a row nobody was seen."""
    frames = np.array(sorted(stamps), dtype=np.int64)
    clock = Clock(f"camera {camera}" if camera else "times", unique=True, sporadic=True)
    clock.add(np.array([stamps[frame] for frame in frames.tolist()], dtype=np.int64), frames)
    return clock


class _Copies:
    """Rows that are alike in everything, anywhere in the file."""

    def __init__(self) -> None:
        self._marks: list[Uints] = []
        self._lines: list[Ints] = []
        self._rows = 0

    def add(self, lines: Ints, boxes: BoxRows) -> None:
        """Take rows and the lines where they stand."""
        if self._rows < MOST_ROWS:
            self._marks.append(fingerprints(boxes))
            self._lines.append(lines)
            self._rows += len(lines)

    def judge(self, findings: Findings) -> None:
        """Note the copies."""
        if not self._rows:
            return
        marks, lines = np.concatenate(self._marks), np.concatenate(self._lines)
        _, first, place = np.unique(marks, return_index=True, return_inverse=True)
        copies = np.flatnonzero(first[place.reshape(-1)] != np.arange(len(marks)))
        if len(copies):
            row = int(copies[0])
            value = f"as in line {lines[first[place.reshape(-1)[row]]]}"
            findings.add("repeated-row", f"line {lines[row]}", value, count=len(copies))
