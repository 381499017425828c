"""Copy of a recording with other attachments; nothing is decoded, and memory is bounded."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from mcap.writer import Writer

from occlog.io.files.atomic import open_output
from occlog.io.files.names import RECORDING, check_output_name
from occlog.io.files.provenance import Provenance

from .mcap_errors import open_mcap
from .metadata import add_metadata, read_metadata
from .reader import McapRecording
from .rebuilt_index import McapMessages
from .writer import FORMAT, METADATA, VIDEO_METADATA, begin_mcap


def copy_recording(
    source: McapRecording,
    path: Path,
    attachments: Mapping[str, bytes],
    provenance: Provenance,
    *,
    overwrite: bool = False,
) -> int:
    """Write a copy of a recording with other attachments, atomically; return the number of messages.

    Messages keep their order, times and numbers; links to videos are adapted to the new folder.

    Args:
        source: the recording.
        path: the copy, another file.
        attachments: JSON files that are attached, in place of those of the same name.
        provenance: how the copy was made; not stored in an MCAP file of another program.
        overwrite: replace an existing file; else OutputExistsError.
    """
    check_output_name(path, RECORDING)
    with open_output(path, overwrite) as file:
        writer = begin_mcap(file)
        with open_mcap(source.path) as (reader, summary):
            for each in reader.iter_attachments():
                if each.name not in attachments:
                    writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
            for name, data in attachments.items():
                writer.add_attachment(0, 0, name, "application/json", data)
            messages = _copy_messages(reader, writer)
            if source.ours:
                records = read_metadata(source.path, summary).items()
                add_metadata(writer, {n: moved_metadata(n, v, source.path, path, provenance) for n, v in records})
            else:
                for record in reader.iter_metadata():
                    writer.add_metadata(record.name, dict(record.metadata))
        writer.finish()
    return messages


def _copy_messages(reader: McapMessages, writer: Writer) -> int:
    """Copy all messages in file order, with their schemas and channels; return their number."""
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    count = 0
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if schema is not None and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[channel.schema_id], dict(channel.metadata)
            )
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        count += 1
    return count


def moved_metadata(
    name: str, values: dict[str, str], source: Path, path: Path, provenance: Provenance
) -> dict[str, str]:
    """Values of the metadata record `name` of a recording for its copy in another place.

    Links to videos become relative to the new folder; the main record gets the format and the new provenance.

    Args:
        name: of the record.
        values: its values.
        source: the recording.
        path: the copy.
        provenance: of the copy.
    """
    if name == METADATA:
        return {"format": FORMAT, "provenance": provenance.json()}
    if name.startswith(VIDEO_METADATA) and "path" in values:
        video = source.resolve().parent / values["path"]
        return {**values, "path": Path(os.path.relpath(video, path.resolve().parent)).as_posix()}
    return values
