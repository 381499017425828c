"""The folder that TrackEval evaluates: MOTChallenge truth, and tracks of one or several programs.

    gt/MOT17-train/SEQUENCE/gt/gt.txt, seqinfo.ini
    gt/seqmaps/MOT17-train.txt
    trackers/MOT17-train/TRACKER/data/SEQUENCE.txt

MOT17-train is what TrackEval looks at when nothing else is said, so that it needs the two folders only.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

from occlog.errors import InputError, OutputError, OutputExistsError
from occlog.io.files.atomic import translate_write_errors
from occlog.records.tables import Boxes, TruthBoxes

from .mot_challenge import SequenceInfo, write_mot, write_sequence, write_sequence_list

BENCHMARK = "MOT17-train"
_NAME = re.compile(r"^[^\s/\\,:]{1,64}$")


class MotSequence(NamedTuple):
    """One camera's frames; `info.name` names the sequence."""

    info: SequenceInfo
    truth: TruthBoxes
    tracks: Boxes


def write_layout(folder: Path, tracker: str, sequences: Sequence[MotSequence], *, overwrite: bool = False) -> None:
    """Write truth and tracks of several sequences.

    Truth that is there already with the same content stays, so that tracks of several programs
    can be put into one folder.  Everything is written beside the folder first, and moved when complete.

    Args:
        folder: made where it is missing.
        tracker: name of the tracks.
        sequences: one for each camera.
        overwrite: replace files that are there with another content.

    Raises:
        InputError: a name cannot be that of a file.
        OutputExistsError: a file is there with another content and `overwrite` is false.
        OutputError: the folder is a file or cannot be written.
    """
    for name in (tracker, *(s.info.name for s in sequences)):
        if not _NAME.match(name) or name.startswith("."):
            raise InputError(f"{folder}: {name!r} cannot be the name of a sequence or a tracker; rename the file")
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: is a file; name a folder")
    if not folder.parent.is_dir():
        raise OutputError(f"{folder}: the folder {folder.parent} does not exist; make it first")
    with translate_write_errors(folder):
        beside = Path(mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=folder.parent))
    try:
        _fill(beside, tracker, sequences)
        _move(beside, folder, overwrite)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _fill(folder: Path, tracker: str, sequences: Sequence[MotSequence]) -> None:
    data = folder / "trackers" / BENCHMARK / tracker / "data"
    with translate_write_errors(folder):
        data.mkdir(parents=True)
        (folder / "gt" / "seqmaps").mkdir(parents=True)
    for info, truth, tracks in sequences:
        write_sequence(folder / "gt" / BENCHMARK / info.name, truth, info)
        write_mot(data / f"{info.name}.txt", tracks, "tracks")
    write_sequence_list(folder / "gt" / "seqmaps" / f"{BENCHMARK}.txt", [s.info.name for s in sequences])


def _move(beside: Path, folder: Path, overwrite: bool) -> None:
    """Move what is new or other; nothing if something may not be replaced."""
    files = sorted(path for path in beside.rglob("*") if path.is_file())
    new = []
    with translate_write_errors(folder):
        for path in files:
            target = folder / path.relative_to(beside)
            same = target.is_file() and target.read_bytes() == path.read_bytes()
            if target.exists() and not same and not overwrite:
                raise OutputExistsError(f"{target}: exists with another content")
            if not same:
                new.append((path, target))
        for path, target in new:
            target.parent.mkdir(parents=True, exist_ok=True)
            path.replace(target)
