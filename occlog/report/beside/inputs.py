"""Two runs as they are opened: their names, files, estimates, and the truth of both."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError, UsageError
from occlog.io.files.tables.header import describe
from occlog.io.files.untrusted.content import Content, content_of
from occlog.io.open import check_unit, open_input
from occlog.records.tables import Tracks, Truth
from occlog.report.content.model import ReportInput
from occlog.report.inputs import read_input
from occlog.report.request import PageRequest

from .stage import same_room, same_rows

MOST_ROWS = 1_000_000
"""Estimates of one run that are laid beside another: they are in memory as a whole."""


WHOLE = ("tracks", "diagnostics", "occluders")
"""Tables of which everything is laid beside another run's, or shown at its moments."""


class Run(NamedTuple):
    """One of two runs: its name, the table of its tracks, all of it, and what a report shows of it."""

    name: str
    file: Path
    tracks: Tracks
    data: ReportInput


def names_of(a: Path, b: Path) -> tuple[str, str]:
    """Names of two runs: the ends of their paths, as many parts of them as tell them apart."""
    ways = []
    for path in (a, b):
        whole = Path(os.path.abspath(path))  # noqa: PTH100  # links keep their names
        ways.append((whole if path.is_dir() else whole.with_suffix("")).parts)
    for count in range(1, max(map(len, ways)) + 1):
        names = ["/".join(way[-count:]) for way in ways]
        if names[0] != names[1]:
            return names[0], names[1]
    return ways[0][-1], f"{ways[1][-1]}, again"


def files_of(run: Path, shared: PageRequest) -> PageRequest:
    """The files of a run; UsageError where a recording is named.

    Args:
        run: a run folder or a table of tracks.
        shared: what is named besides, of both runs.
    """
    found = replace(shared, tracks=run).found
    if found.tracks is not None and content_of(found.tracks) is Content.RECORDING:
        raise UsageError(f"{run}: is a recording, not tracks; name run folders or tables of tracks")
    return found


def open_run(name: str, paths: PageRequest) -> Run:
    """Everything of a run; InputError where it has no estimates, or too many."""
    file = paths.tracks
    assert file is not None
    opened = open_input(file)
    rows = describe(file)["rows"] if opened.recording is None and opened.foreign is None else 0
    data = read_input(replace(paths, title=name), whole=WHOLE) if rows <= MOST_ROWS else None
    tracks = None if data is None else data.tracks
    if data is None or tracks is None or len(tracks) > MOST_ROWS:
        raise InputError(
            f"{file}: holds {rows if tracks is None else len(tracks):,} estimates, of a run {MOST_ROWS:,} at most are "
            "laid beside another; name runs of a part of the recording, or compare figures alone (occlog compare)"
        )
    if not len(tracks):
        raise InputError(f"{file}: holds no estimates, so that there is nothing to lay beside another run")
    return Run(name, file, tracks, data)


def check_scenes(a: Run, b: Run) -> None:
    """InputError where two runs are not of one scene."""
    if a.data.unit != b.data.unit:
        raise InputError(
            f"{b.file}: lengths are in {b.data.unit}, those of {a.file} in {a.data.unit}; name two runs of one scene"
        )
    if not same_room(a.data.scene, b.data.scene):
        raise InputError(f"{a.file} and {b.file} are of different scenes; name two runs of one scene")


def truth_of(files: Sequence[PageRequest], unit: str) -> tuple[Path, Truth] | None:
    """The truth of both runs; None: there is none with targets.  InputError where each has another one, or unit."""
    first: tuple[Path, Truth] | None = None
    for path in dict.fromkeys(each.truth for each in files if each.truth is not None):
        opened = open_input(path)
        if opened.recording is None:
            check_unit(opened, unit, "the runs", InputError)
        elif not opened.has(Truth):
            continue
        truth = opened.read(Truth)
        if first is not None and not same_rows(truth, first[1]):
            raise InputError(
                f"{path}: is another truth than that of {first[0]}: the runs are of different recordings; name two "
                "runs of one recording, or give the truth of both"
            )
        first = first or (path, truth)
    return None if first is None or not (first[1].role == "target").any() else first
