"""Comparison of two recordings: frames and external messages, table rows, attachments."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from occlog.array_types import Ints, Strings
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.reader import McapRecording, open_recording
from occlog.io.recording.rows import RECORDED, schema_of
from occlog.records.columns import ColumnTable, column

from .content import compare_provenance, compare_verdicts, diff_json, values_in
from .result import DiffResult, DiffSettings
from .stage import diff_tables

ROWS = 4096
"""Messages in a chunk."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMessages(ColumnTable):
    """Frames and other messages of a recording that are no table rows, one per row, with hashes, to compare."""

    NAME: ClassVar[str] = "messages"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "topic")

    t_ns: Ints = column("time of the message since the Unix epoch", "ns")
    topic: Strings = column("topic, or camera for decoded frames")
    number: Ints = column("sequence number, or number of the frame")
    content: Strings = column("SHA-256 of the content")


def compare_recordings(a: Path, b: Path, name: str, settings: DiffSettings) -> list[DiffResult]:
    """Compare two recordings; return a result for each part that one of them has.

    Parts are attachments, frames, each table, verdicts and, if the settings say so, provenance. `name`: name of the
    files in the results.
    """
    left, right = open_recording(a), open_recording(b)
    out = [_compare_attachments(left, right, name, settings)]
    out.append(
        replace(
            diff_tables(RecordedMessages, _frames(left, settings), _frames(right, settings)), name=f"{name}: frames"
        )
    )
    units = {"m" if each.scene is None else each.scene.length_unit for each in (left, right)}
    unit = units.pop() if len(units) == 1 else ""
    for table in RECORDED:
        if left.has(table) or right.has(table):
            rows = diff_tables(table, left.tables(table), right.tables(table), settings.tolerances, length_unit=unit)
            out.append(replace(rows, name=f"{name}: {table.NAME}"))
    out += compare_verdicts(name, a, b)
    if settings.provenance:
        out.append(compare_provenance(name, left.provenance.as_dict(), right.provenance.as_dict()))
    return [found for found in out if found.count_a or found.count_b]


def _compare_attachments(a: McapRecording, b: McapRecording, name: str, settings: DiffSettings) -> DiffResult:
    """Compare attachments by content (YAML by value, text by line, others by hash), and linked videos.

    `name`: name of the files in the result.
    """
    return diff_json(f"{name}: files", _attached(a), _attached(b), settings.tolerances, provenance=True)


def _attached(recording: McapRecording) -> dict[str, object]:
    out: dict[str, object] = {}
    for name in sorted(recording.attachments):
        data = recording.attachment(name) or b""
        out[name] = values_in(name, data)
    videos = {f"video of {sensor}": video.get("sha256", "") for sensor, video in sorted(recording.videos.items())}
    return out | videos


def _frames(recording: McapRecording, settings: DiffSettings) -> Iterator[RecordedMessages]:
    """Generate hashes of everything in a recording that is not a table row: frames, and external messages, in chunks.

    Frames are hashed as encoded, or by their pixels if the settings say so.
    """
    ours = {schema_of(table) for table in RECORDED}
    topics = [t.name for t in recording.topics if t.schema not in ours]
    if not topics:
        return
    pixels = settings.pixels and bool(recording.cameras)
    yield from _collected(_decoded(recording) if pixels else _raw(recording, topics))


def _raw(recording: McapRecording, topics: list[str]) -> Iterator[tuple[int, str, int, str]]:
    with open_mcap(recording.path) as (reader, _):
        for _schema, channel, message in reader.iter_messages(topics=topics):
            digest = hashlib.sha256(message.data).hexdigest()
            yield message.log_time, channel.topic, message.sequence, digest


def _decoded(recording: McapRecording) -> Iterator[tuple[int, str, int, str]]:
    for frame in recording.frames():
        image = frame.decode()
        digest = hashlib.sha256(f"{image.shape}".encode() + image.tobytes()).hexdigest()
        yield frame.t_ns, frame.sensor, frame.index, digest


def _collected(messages: Iterator[tuple[int, str, int, str]]) -> Iterator[RecordedMessages]:
    """Generate tables of up to `ROWS` rows from messages (time [ns], topic, number, hash)."""
    pending: list[tuple[int, str, int, str]] = []
    for message in messages:
        pending.append(message)
        if len(pending) >= ROWS:
            yield RecordedMessages.of(**dict(zip(RecordedMessages.__slots__, zip(*pending, strict=True), strict=True)))
            pending = []
    if pending:
        yield RecordedMessages.of(**dict(zip(RecordedMessages.__slots__, zip(*pending, strict=True), strict=True)))
