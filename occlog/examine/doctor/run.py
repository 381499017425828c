"""Checking of files and folders, each file separately, so that a damaged one does not stop the others."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from occlog.cli.input_paths import is_missing, no_such_file
from occlog.errors import InputError, OcclogError, UsageError
from occlog.io.external.source import FILE_MAGIC, STREAM_MAGIC, find_source
from occlog.io.files.limits import BAG_MAGICS, RECORDING_MAGIC, Content, content_of, is_zstd
from occlog.io.files.tables.parquet import is_ours
from occlog.io.formats.sound.wav import open_sound
from occlog.io.frames.codec import image_kind
from occlog.io.messages.bag import METADATA
from occlog.io.recording.reader import open_recording
from occlog.io.video.reader import read_container

from .findings import Finding, Findings
from .recording import check_bag, check_image_file, check_recording, check_video
from .tables import check_others, check_table
from .texts import check_text_file

MAX_FILES = 10_000
"""Files of a folder, with its own folders, that are checked."""
VIDEOS = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts", ".flv", ".m4v", ".wmv")
PAGES = (".md", ".html", ".pdf", ".py", ".sh", ".log", ".source", ".svg")
"""Endings of names of files that hold no data."""


@dataclass
class Diagnosis:
    """Result of checking files.

    Attributes:
        files: number of files that were checked.
        others: number of files in folders of unknown kind, by ending.
        findings: all findings, in the order of the files.
    """

    files: int = 0
    others: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)


def check_files(paths: Sequence[Path], each: Callable[[Path], None] = lambda _: None) -> Diagnosis:
    """Check files, and all files in folders; return the findings.

    Args:
        paths: files and folders.
        each: is called with each file before it is checked.
    """
    out, seen = Diagnosis(), set[Path]()
    for path in paths:
        for file, named in _files(path, out):
            each(file)
            findings = Findings(str(file))
            known = file.resolve() in seen or _look_at_one(file, findings, seen)
            if not known and named:
                findings.add("unknown", "", "")
            if known or named:
                out.files += 1
            else:
                out.others[file.suffix.lower() or "without an ending"] += 1
            out.findings += findings
    return out


def _files(path: Path, out: Diagnosis) -> Iterator[tuple[Path, bool]]:
    """Generate the files to check under `path`, each with a flag: True if named by the user, False if in a folder.

    A folder that is one bag counts as a file. Hidden files are skipped; if there are more than `MAX_FILES`, a finding
    is added to `out`.
    """
    if not path.is_dir() or _is_bag(path):
        yield path, True
        return
    number = 0
    for folder, folders, names in os.walk(path):
        folders.sort()
        bags = [name for name in folders if _is_bag(Path(folder, name))]
        folders[:] = [name for name in folders if name not in bags and not name.startswith(".")]
        # Recordings first: what they link to is checked with them
        for name in sorted([*bags, *names], key=lambda name: (not name.endswith(".mcap"), name)):
            number += 1
            if number > MAX_FILES:
                beyond = Findings(str(path))
                beyond.add("not-checked", "", f"files after the first {MAX_FILES}")
                out.findings += beyond
                return
            if not name.startswith("."):
                yield Path(folder, name), False


def _is_bag(folder: Path) -> bool:
    """Return whether a folder is a ROS 2 bag (has its metadata file)."""
    return (folder / METADATA).is_file()


def _look_at_one(path: Path, findings: Findings, seen: set[Path]) -> bool:
    """Check one file and add its findings; return whether its kind is known.

    `seen`: paths of videos that need no further check; updated in place.
    """
    try:
        if is_missing(path):
            raise no_such_file(path)
        return _by_content(path, findings, seen)
    except OcclogError as error:
        findings.refused("unreadable", error)
    except OSError as error:
        findings.add("unreadable", "", error.strerror or str(error))
    return True


def _by_content(path: Path, findings: Findings, seen: set[Path]) -> bool:
    if path.is_dir():
        check_bag(path, findings)
        return True
    if path.suffix.lower() in PAGES:
        return False
    content = content_of(path)
    with path.open("rb") as file:
        head = file.read(16)
    if content is Content.RECORDING:
        _mcap(path, findings, seen)
    elif head.startswith(BAG_MAGICS) or is_zstd(head):
        check_bag(path, findings)
    elif content is Content.TABLE or head.startswith((FILE_MAGIC, STREAM_MAGIC)):
        if content is Content.TABLE and is_ours(path):
            check_table(path, findings)
        elif (source := find_source(path)) is not None:
            return check_others(source, findings)
    elif head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE":
        sound = open_sound(path)
        for _ in sound.blocks():
            pass
        for loss in sound.losses:
            findings.add("sound", loss.place, loss.what, count=max(loss.count, 1))
    elif image_kind(head) is not None or path.suffix.lower() in (".png", ".jpg", ".jpeg"):
        check_image_file(path, findings)
    elif path.suffix.lower() in VIDEOS or read_container(path) is not None:
        seen.add(path.resolve())
        check_video(path, findings)
    elif path.suffix.lower() in (".mcap", ".parquet"):
        raise InputError(
            f"{path}: does not begin as a {path.suffix.lower()} file does; copy it again, or correct its ending",
            id="damaged-file",
        )
    else:
        return check_text_file(path, findings)
    return True


def _mcap(path: Path, findings: Findings, seen: set[Path]) -> None:
    """Check an MCAP file and add its findings: it is an occlog recording, possibly damaged, or a bag.

    `seen`: paths of videos that need no further check; linked ones are added in place.
    """
    with path.open("rb") as file:
        by_occlog = b"occlog" in file.read(64)[len(RECORDING_MAGIC) :]
    try:
        recording = open_recording(path)
    except (InputError, UsageError) as error:
        if not by_occlog:
            check_bag(path, findings)
            return
        findings.refused("unreadable", error)
        check_recording(path, None, findings, seen)
        return
    if recording.ours:
        check_recording(path, recording, findings, seen)
    else:
        check_bag(path, findings)
