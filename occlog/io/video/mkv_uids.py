"""Numbers of tracks in a WebM file that was written here: the same ones each time.

FFmpeg draws them by lot, so that equal images would give unequal bytes.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator, Sequence
from pathlib import Path

from .container import BrokenContainerError
from .mkv import ENTRY, SEGMENT, TRACKS, Element, children, element, recognised

TAGS, TAG, TARGETS = 0x1254C367, 0x7373, 0x63C0
TRACK_UID, TAG_TRACK_UID = 0x73C5, 0x63C5


def number_tracks(path: Path) -> None:
    """Give the tracks of a WebM file the UIDs 1, 2, ..., also where its tags name them.

    Not of a Matroska file: there FFmpeg adds check sums of the elements that these stand in.  A file that is damaged or
    of another kind is left alone from where it cannot be understood.
    """
    with path.open("r+b") as file:
        if not path.stat().st_size:
            return
        with mmap.mmap(file.fileno(), 0) as data:
            if not recognised(data):
                return
            try:
                _number(data)
            except BrokenContainerError:
                return  # whoever checks the file says what is wrong with it


def _number(data: mmap.mmap) -> None:
    segment = element(data, element(data, 0, len(data)).stop or len(data), len(data))
    if segment.id != SEGMENT:
        return
    numbers: dict[int, int] = {}
    for path in ((TRACKS, ENTRY, TRACK_UID), (TAGS, TAG, TARGETS, TAG_TRACK_UID)):
        for uid in _below(data, segment, path):
            stop = uid.stop or uid.start
            old = int.from_bytes(data[uid.start : stop], "big")
            # 0 in tags stands for all tracks
            new = numbers.setdefault(old, len(numbers) + 1) if old else 0
            data[uid.start : stop] = new.to_bytes(stop - uid.start, "big")


def _below(data: mmap.mmap, parent: Element, path: Sequence[int]) -> Iterator[Element]:
    """The elements to which a path of identifiers leads."""
    for child in children(data, parent.start, len(data) if parent.stop is None else parent.stop):
        if child.id == path[0]:
            yield from _below(data, child, path[1:]) if len(path) > 1 else [child]
