"""Links of recordings to videos: where they may lead.

A recording that somebody else made could name any file. In its own folder and below it may; a link that leaves the
folder is followed only to what begins as a video does, before anything else of the file is read.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from occlog.errors import InputError
from occlog.io.files.untrusted.inputs import check_input

HEAD = 16
_VIDEOS = (
    *((4, box) for box in (b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide")),
    (0, b"\x1a\x45\xdf\xa3"),  # Matroska, WebM
    (8, b"AVI "),
    (0, b"OggS"),
    (0, b"FLV"),
    (0, b"\x30\x26\xb2\x75\x8e\x66\xcf\x11"),  # ASF
    (0, b"\x06\x0e\x2b\x34"),  # MXF
    (0, b"\x00\x00\x01"),  # MPEG, H.264 by itself
    (0, b"\x00\x00\x00\x01"),
    (0, b"\x47"),  # MPEG transport stream
)
"""Place and bytes at which the containers and streams begin that are decoded."""


def begins_as_video(path: Path) -> bool:
    """Whether the first bytes of a regular file are those of a video."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    return any(head[place:].startswith(mark) for place, mark in _VIDEOS)


def leaves(recording: Path, place: str) -> bool:
    """Whether a place that a recording states leads out of its folder, by its name or by symbolic links."""
    lies = (recording.parent / place).resolve()
    return ".." in PurePosixPath(place).parts or not lies.is_relative_to(recording.parent.resolve())


def linked_path(recording: Path, sensor: str, place: str) -> Path:
    """The video file of a camera.

    Args:
        recording: file that has the link.
        sensor: name of the camera.
        place: of the video as the recording states it, relative to the recording's folder.

    Raises:
        InputError: if the place is absolute, if no regular file that can be read is there, or if it leads out of the
            folder and to what is no video.
    """
    where = f"{recording}: camera {sensor}"
    if Path(place).is_absolute():
        raise InputError(f"{where}: links to {place}, which is no place relative to it; ingest it again")
    path = recording.parent / place
    check_input(path, f"the video of camera {sensor} that {recording} links to")
    if leaves(recording, place) and not begins_as_video(path):
        raise InputError(f"{where}: links to {place}, which leads out of its folder and is no video; ingest it again")
    return path
