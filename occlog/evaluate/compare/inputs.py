"""Which tracks are compared with which truth: tables, run folders, and folders of many runs."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from occlog.errors import InputError, UsageError

TRACKS = "tracks.parquet"
RECORDING = "recording.mcap"


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
    return {name: Run(path, _truth(truth, path.parent, name)) for name, path in found.items()}


def _truth(truth: Path | None, folder: Path | None, name: str) -> Path:
    if truth is not None and truth.is_dir() and name:
        stem = Path(name).name
        for place in dict.fromkeys((truth / name, truth / stem)):
            for candidate in (place, *sorted(place.parent.glob(f"{glob.escape(stem)}.*"))):
                if candidate.is_file():
                    return candidate
        raise InputError(f"{truth}: holds no truth of the run {name}: a file {stem}.mcap, .parquet or .csv")
    if truth is not None:
        return truth
    if folder is not None and (folder / RECORDING).is_file():
        return folder / RECORDING
    raise UsageError("nothing says where the targets truly were; give --truth")


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
