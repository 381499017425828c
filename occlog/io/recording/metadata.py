"""Metadata records of a recording, with digests in a separate record, since MCAP has no check sums for them.

Also the links of recordings to videos: a link within the recording's folder may be opened; one that leaves the folder
only if the file begins like a video, since a recording from an untrusted source could name any file.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from mcap.data_stream import ReadDataStream
from mcap.records import Metadata
from mcap.summary import Summary
from mcap.writer import Writer

from occlog.errors import InputError
from occlog.io.files.limits import check_input

from ..files.names import is_utf8
from .chunks import MAX_CHUNK_BYTES, damaged_mcap

DIGESTS = "occlog.digests"
"""Record that has the SHA-256 of each other one by its name."""
_HEAD_BYTES = 9


def digest_of(name: str, values: Mapping[str, str]) -> str:
    """SHA-256, in hexadecimal, of a metadata record: of its name and values as JSON with sorted keys."""
    return hashlib.sha256(json.dumps([name, dict(values)], sort_keys=True).encode()).hexdigest()


def add_metadata(writer: Writer, records: Mapping[str, Mapping[str, str]]) -> None:
    """Write all metadata records of a recording, and a record with their digests.

    Args:
        writer: of the MCAP file.
        records: values of each record, by its name.

    Raises:
        InputError: a value (a link to a video) is not UTF-8.
    """
    for values in records.values():
        for value in values.values():
            if not is_utf8(value):
                raise InputError(f"{value}: a recording cannot name this file; its name is not UTF-8; rename it")
    for name, values in records.items():
        writer.add_metadata(name, dict(values))
    writer.add_metadata(DIGESTS, {name: digest_of(name, values) for name, values in records.items()})


def read_metadata(path: Path, summary: Summary) -> dict[str, dict[str, str]]:
    """Read the values of all metadata records by name, and verify their digests.

    Args:
        path: the MCAP file.
        summary: its index.

    Raises:
        InputError: a record differs from the written one, or is not where the index states.
        McapError, struct.error, ValueError: a record cannot be parsed.
    """
    found: dict[str, dict[str, str]] = {}
    with path.open("rb") as file:
        for index in summary.metadata_indexes:
            file.seek(index.offset)
            data = file.read(min(index.length, MAX_CHUNK_BYTES))[_HEAD_BYTES:]
            record = Metadata.read(ReadDataStream(io.BytesIO(data)))
            if record.name != index.name:
                raise wrong_metadata(path, index.name, index.offset)
            found[record.name] = dict(record.metadata)
        damaged = damaged_metadata(found)
        if damaged:
            offsets = {index.name: index.offset for index in summary.metadata_indexes}
            raise wrong_metadata(path, damaged[0], offsets.get(damaged[0], 0))
    found.pop(DIGESTS, None)
    return found


def damaged_metadata(records: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Names of metadata records that are missing or differ from their digests; empty if there are no digests."""
    digests = records.get(DIGESTS, {})
    return [name for name, digest in digests.items() if name not in records or digest_of(name, records[name]) != digest]


def wrong_metadata(path: Path, name: str, at: int) -> InputError:
    """InputError, to be raised, for the damaged metadata record `name` at byte `at`."""
    return damaged_mcap(path, f"the metadata {name!r} at byte {at} changed since they were written (wrong digest)")


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
"""Position and bytes at which the containers and streams begin that are decoded."""


def is_video_header(path: Path) -> bool:
    """Whether the first bytes of a file are those of a video container or stream."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    return any(head[offset:].startswith(mark) for offset, mark in _VIDEOS)


def leaves_folder(recording: Path, location: str) -> bool:
    """Whether the link `location` in a recording leads out of its folder, by name or through symbolic links."""
    lies = (recording.parent / location).resolve()
    return ".." in PurePosixPath(location).parts or not lies.is_relative_to(recording.parent.resolve())


def linked_path(recording: Path, sensor: str, location: str) -> Path:
    """Path of the video file of a camera that a recording links to.

    Args:
        recording: file that has the link.
        sensor: name of the camera.
        location: the link, relative to the recording's folder.

    Raises:
        InputError: the link is absolute, there is no readable regular file, or it leads out of the folder to a file
            that is no video.
    """
    where = f"{recording}: camera {sensor}"
    if Path(location).is_absolute():
        raise InputError(f"{where}: links to {location}, which is no relative path; ingest it again")
    path = recording.parent / location
    check_input(path, f"the video of camera {sensor} that {recording} links to")
    if leaves_folder(recording, location) and not is_video_header(path):
        raise InputError(
            f"{where}: links to {location}, which leads out of its folder and is no video; ingest it again"
        )
    return path
