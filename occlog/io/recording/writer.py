"""Writing of a recording: one MCAP file with images, rows, scene and provenance."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from occlog import __version__
from occlog.array_types import NS
from occlog.errors import InputError, option
from occlog.io.files.atomic import OutputGroup, open_output
from occlog.io.files.names import RECORDING, check_output_name
from occlog.io.files.provenance import Provenance
from occlog.io.formats.scenes.scene import scene_to_yaml
from occlog.records.columns import ColumnTable
from occlog.records.scene import Scene

from .chunks import PROGRAM
from .metadata import add_metadata
from .rows import message_schema, schema_of, table_to_messages

SCENE_ATTACHMENT = "scene.yaml"
METADATA = "occlog"
VIDEO_METADATA = "occlog.video/"
FORMAT = "recording/1"
VIDEO_FRAME = "occlog.VideoFrame"
PROTOBUF, ROS2 = ("protobuf", "protobuf"), ("cdr", "ros2msg")
"""Encodings of messages and schemas, by MCAP's registry of well-known encodings."""
VIDEO_FRAME_SCHEMA = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": VIDEO_FRAME,
    "description": "One frame of a video file that lies next to the recording.",
    "type": "object",
    "properties": {
        "t_ns": {"type": "integer", "description": "ns since the Unix epoch"},
        "index": {"type": "integer", "description": "number of the frame in the file, from 0"},
    },
    "required": ["t_ns", "index"],
    "additionalProperties": False,
}


def begin_mcap(file: IO[bytes]) -> Writer:
    """Start writing an MCAP file: header with the version of occlog, chunks of 1 MiB, all indexes and check sums."""
    writer = Writer(
        file,
        chunk_size=1024 * 1024,
        compression=CompressionType.ZSTD,
        index_types=IndexType.ALL,
        enable_crcs=True,
        enable_data_crcs=True,
    )
    writer.start(profile="", library=f"{PROGRAM}{__version__}")
    return writer


class RecordingWriter:
    """Writer of a recording (MCAP), a context manager; the file appears when the block ends without an error.

    Messages may be added in any order; each camera's frames must come in the order of time.

    Attributes:
        together: group of outputs that appear together; None: none.
        messages: number of messages written.
    """

    def __init__(
        self,
        path: Path,
        scene: Scene | None,
        provenance: Provenance,
        *,
        overwrite: bool = False,
        together: OutputGroup | None = None,
    ) -> None:
        """Prepare to write; nothing is opened before the block begins.

        Args:
            path: the file.
            scene: attached to it; None: no scene.
            provenance: stored in it.
            overwrite: replace an existing file; else OutputExistsError at the beginning of the block.
            together: group at the end of which the file appears; None: at the end of the block.

        Raises:
            UsageError: the name promises another format than MCAP.
        """
        self.together = together
        self._path = Path(path)
        check_output_name(self._path, RECORDING)
        self._output = open_output(self._path, overwrite, together)
        self._scene, self._provenance = scene, provenance
        self._videos: dict[str, dict[str, str]] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self.messages = 0

    def __enter__(self) -> Self:
        """Open the output and write the scene."""
        self._writer = begin_mcap(self._output.__enter__())
        if self._scene is not None:
            self.attach(SCENE_ATTACHMENT, "application/yaml", scene_to_yaml(self._scene).encode())
        return self

    def image(self, sensor: str, t_ns: int, index: int, data: bytes, kind: str) -> None:
        """Write a compressed image of a camera as `foxglove.CompressedImage`.

        Args:
            sensor: name of the camera.
            t_ns: time of the frame [ns since the Unix epoch].
            index: number of the frame, from 0.
            data: the compressed image.
            kind: its format, `png` or `jpeg`.
        """
        message = CompressedImage(frame_id=sensor, data=data, format=kind)
        message.timestamp.FromNanoseconds(t_ns)
        channel = self._channel(f"/camera/{sensor}/image", CompressedImage.DESCRIPTOR.full_name, "protobuf")
        self._add(channel, t_ns, message.SerializeToString(), index)

    def video(self, sensor: str, path: str, sha256: str) -> None:
        """Link the video file with the frames of a camera.

        `path` is relative to the recording, `sha256` that of its content. Stored at the end.
        """
        self._videos[sensor] = {"path": path, "sha256": sha256}

    def video_frame(self, sensor: str, t_ns: int, index: int) -> None:
        """Write the time `t_ns` [ns since the Unix epoch] of frame `index` (from 0) of a camera's linked video."""
        channel = self._channel(f"/camera/{sensor}/video", VIDEO_FRAME, "json")
        self._add(channel, t_ns, json.dumps({"t_ns": t_ns, "index": index}).encode(), index)

    def table(self, table: ColumnTable) -> None:
        """Write the rows of a table, sorted by time, as messages; it must be one of `RECORDED`."""
        name = schema_of(type(table))
        for topic, t_ns, data in table_to_messages(table):
            if name not in self._schemas:
                self._register(name, "jsonschema", json.dumps(message_schema(type(table))).encode())
            sequence = self._sequence.get(topic, 0)
            self._sequence[topic] = sequence + 1
            self._add(self._channel(topic, name, "json"), t_ns, data, sequence)

    def message(
        self,
        topic: str,
        schema: str,
        described: Callable[[], bytes],
        t_ns: int,
        data: bytes,
        coded: tuple[str, str] = PROTOBUF,
    ) -> None:
        """Write a message of any type.

        Args:
            topic: of the message.
            schema: name of its schema.
            described: returns the content of the schema; called once for each name.
            t_ns: time [ns since the Unix epoch].
            data: encoded message.
            coded: encoding of the message, and language of the schema.
        """
        encoding, language = coded
        if schema not in self._schemas:
            self._register(schema, language, described())
        sequence = self._sequence.get(topic, 0)
        self._sequence[topic] = sequence + 1
        self._add(self._channel(topic, schema, encoding), t_ns, data, sequence)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file with this name, media type (MIME) and content."""
        self._writer.add_attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)

    def annotate(self, provenance: Provenance) -> None:
        """Replace the provenance, when it is complete only at the end (for example with losses)."""
        self._provenance = provenance

    def _register(self, name: str, encoding: str, data: bytes) -> int:
        self._schemas[name] = self._writer.register_schema(name, encoding, data)
        return self._schemas[name]

    def _channel(self, topic: str, schema: str, encoding: str) -> int:
        if topic not in self._channels:
            if schema not in self._schemas:
                self._register(schema, *_schema_data(schema))
            self._channels[topic] = self._writer.register_channel(topic, encoding, self._schemas[schema])
        return self._channels[topic]

    def _add(self, channel: int, t_ns: int, data: bytes, sequence: int) -> None:
        if t_ns < 0:
            raise InputError(
                f"{self._path}: a time of {t_ns / NS:.6g} s is before 1970, which a recording cannot hold; give the "
                f"origin of the times (ingest {option('start_time')}), or later times",
                id="time-out-of-range",
            )
        self._writer.add_message(channel, log_time=t_ns, publish_time=t_ns, sequence=sequence, data=data)
        self.messages += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        """Complete the file, or delete it after an error."""
        if kind is None:
            try:
                self._finish()
            except BaseException as failure:
                if not self._output.__exit__(type(failure), failure, failure.__traceback__):
                    raise
        return self._output.__exit__(kind, error, trace)

    def _finish(self) -> None:
        records = {VIDEO_METADATA + sensor: video for sensor, video in self._videos.items()}
        add_metadata(self._writer, {**records, METADATA: {"format": FORMAT, "provenance": self._provenance.json()}})
        self._writer.finish()


def _schema_data(name: str) -> tuple[str, bytes]:
    if name == VIDEO_FRAME:
        return "jsonschema", json.dumps(VIDEO_FRAME_SCHEMA).encode()
    descriptor = build_file_descriptor_set(CompressedImage)
    return "protobuf", descriptor.SerializeToString(deterministic=True)
