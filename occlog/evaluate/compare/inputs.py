"""Which tracks are compared with which truth: tables, run folders, and folders of many runs."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError, UsageError

TRACKS = "tracks.parquet"
RECORDING = "recording.mcap"
USUAL = (".mcap", ".parquet", ".csv")
"""Endings of truths; others count where none of these is there."""


class Run(NamedTuple):
    """One table of tracks, and the true positions to compare it with."""

    tracks: Path
    truth: Path


def runs_of(method: Path, truth: Path | None) -> dict[str, Run]:
    """The runs of a method by the names of their recordings.

    Args:
        method: a table of tracks, a run folder, or a folder with run folders at any depth.
        truth: a recording or a table, or a folder of such by the names of the run folders, in folders as these are or
            not; None: `recording.mcap` of each run folder.

    Raises:
        UsageError: no truth is given, and there is none.
        InputError: no tracks are there, or no truth of some.
    """
    if not method.is_dir():
        return {"": Run(method, _truth(truth, None, ""))}
    found = {
        "" if path.parent == method else path.parent.relative_to(method).as_posix(): path
        for path in sorted(method.rglob(TRACKS))
    }
    if not found:
        raise InputError(f"{method}: holds no {TRACKS}; name a table of tracks, a run folder, or a folder of those")
    runs = {name: Run(path, _truth(truth, path.parent, name)) for name, path in found.items()}
    if truth is not None and truth.is_dir():
        _check_apart(truth, runs)
    return runs


def _truth(truth: Path | None, folder: Path | None, name: str) -> Path:
    if truth is not None and truth.is_dir() and name:
        stem = Path(name).name
        for place in dict.fromkeys((truth / name, truth / stem)):
            if place.is_file():
                return place
            there = [path for path in sorted(place.parent.glob(f"{glob.escape(stem)}.*")) if path.is_file()]
            there = [path for path in there if path.suffix.lower() in USUAL] or there
            if len(there) > 1:
                names = " and ".join(path.name for path in there[:2])
                raise InputError(f"{place.parent}: {names} are both named as the run {name}; keep one")
            if there:
                return there[0]
        raise InputError(f"{truth}: holds no truth of the run {name}: a file {stem}.mcap, .parquet or .csv")
    if truth is not None:
        return truth
    if folder is not None and (folder / RECORDING).is_file():
        return folder / RECORDING
    raise UsageError("nothing says where the targets truly were; give --truth")


def _check_apart(truth: Path, runs: dict[str, Run]) -> None:
    """InputError where a file is the truth of two runs, which have it by their last name alone."""
    first: dict[Path, str] = {}
    for name, run in runs.items():
        other = first.setdefault(run.truth, name)
        if other != name:
            raise InputError(
                f"{run.truth}: would be the truth of the runs {other} and {name}; put their truths into folders of "
                f"{truth} as theirs are"
            )


def paired(methods: Sequence[Path], truth: Path | None) -> tuple[list[str], list[dict[str, Run]]]:
    """Names of the recordings that all methods have, and the runs of each.

    Raises:
        InputError: they have none in common, or some lack one that others have.
    """
    runs = [runs_of(method, truth) for method in methods]
    names = sorted(set().union(*runs))
    for method, own in zip(methods, runs, strict=True):
        lacking = [name for name in names if name not in own]
        if lacking:
            which = ", ".join(name or "(itself)" for name in lacking[:3]) + (" ..." if len(lacking) > 3 else "")
            raise InputError(
                f"{method}: holds no run of {which}, which another one has; runs are compared on the same recordings"
            )
    return names, runs
