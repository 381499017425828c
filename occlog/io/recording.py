"""Reads a recording: scene, frames and rows of an MCAP file, in the order of time, streaming."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import cv2
import msgspec
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError

from ..columns import Table
from ..errors import InputError
from ..frames import Frame, Image
from ..losses import Loss
from ..scene import Scene
from .linked_video import LinkedVideo, open_linked
from .mcap_guard import open_mcap, read_attachment
from .messages import RECORDED, RowCollector, schema_of
from .provenance import Provenance, provenance_from_json
from .recording_writer import METADATA, SCENE_ATTACHMENT, VIDEO_FRAME, VIDEO_METADATA, RecordingWriter
from .scene_file import scene_from_yaml

T = TypeVar("T", bound=Table)
IMAGE_SCHEMA = "foxglove.CompressedImage"
ROWS_PER_CHUNK = 16_384


@dataclass(frozen=True)
class Topic:
    """One channel of the file."""

    name: str
    schema: str
    encoding: str
    messages: int


@dataclass(frozen=True)
class Recording:
    """An opened recording; nothing but its index has been read yet."""

    path: Path
    scene: Scene | None
    topics: tuple[Topic, ...]
    provenance: Provenance
    attachments: dict[str, tuple[int, int]]
    videos: dict[str, dict[str, str]]
    time_ns: tuple[int, int] | None
    ours: bool

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Input that was lost when the recording was made."""
        return self.provenance.losses

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that have frames, sorted."""
        return tuple(sorted({sensor_of(t.name) for t in self.topics if _is_image(t)}))

    def has(self, table: type[Table]) -> bool:
        """Whether the recording holds rows of a table."""
        return any(t.schema == schema_of(table) for t in self.topics)

    def attachment(self, name: str) -> bytes | None:
        """Content of an attached file, None if there is no such file."""
        if name not in self.attachments:
            return None
        with self.path.open("rb") as file:
            return read_attachment(self.path, file, *self.attachments[name])

    def tables(self, table: type[T], rows: int = ROWS_PER_CHUNK) -> Iterator[T]:
        """Chunks of about `rows` rows; rows of one time are never split."""
        topics = [t.name for t in self.topics if t.schema == schema_of(table)]
        collector = RowCollector(table, str(self.path))
        last = None
        for topic, t_ns, data, _ in self._messages(topics):
            if collector.rows >= rows and t_ns != last:
                yield collector.take()
            collector.add(topic, data)
            last = t_ns
        if collector.rows:
            yield collector.take()

    def read(self, table: type[T]) -> T:
        """All rows of a table."""
        return table.concat(self.tables(table))

    def frames(self, sensors: Iterable[str] | None = None) -> Iterator[Frame]:
        """Frames of the cameras in the order of time; InputError where a camera's time stamps repeat or go back."""
        wanted = set(self.cameras if sensors is None else sensors)
        topics = {t.name: t for t in self.topics if _is_image(t) and sensor_of(t.name) in wanted}
        linked: dict[str, LinkedVideo] = {}
        last: dict[str, int] = {}
        counts: dict[str, int] = {}
        try:
            for name, t_ns, data, sequence in self._messages(list(topics)):
                sensor = sensor_of(name)
                index = sequence if self.ours else counts.get(sensor, 0)
                counts[sensor] = counts.get(sensor, 0) + 1
                stamp, decode = self._decoder(topics[name], sensor, t_ns, data, index, linked)
                if sensor in last and stamp <= last[sensor]:
                    raise InputError(
                        f"{self.path}: camera {sensor}: frame {index}: time {stamp} ns does not come after "
                        f"{last[sensor]} ns; each frame needs its own, later time"
                    )
                last[sensor] = stamp
                yield Frame(stamp, sensor, index, decode)
        finally:
            for video in linked.values():
                video.close()

    def _decoder(
        self, topic: Topic, sensor: str, t_ns: int, data: bytes, index: int, linked: dict[str, LinkedVideo]
    ) -> tuple[int, Callable[[], Image]]:
        where = f"{self.path}: camera {sensor}: frame {index}"
        if topic.schema == VIDEO_FRAME:
            if sensor not in linked:
                linked[sensor] = open_linked(self.path, sensor, self.videos.get(sensor))
            return t_ns, partial(linked[sensor].read, index)
        stamp, image = _parse_image(topic.encoding, data, where)
        return stamp or t_ns, partial(_decode, image, where)

    def _messages(self, topics: list[str]) -> Iterator[tuple[str, int, bytes, int]]:
        """(topic, log time, data, sequence) in the order of time."""
        if not topics:
            return
        with open_mcap(self.path) as (reader, _):
            for _schema, channel, message in reader.iter_messages(topics=topics):
                yield channel.topic, message.log_time, message.data, message.sequence


def sensor_of(topic: str) -> str:
    """Camera named by a topic: `/camera/NAME/...` gives NAME, any other topic its path with dots for slashes."""
    parts = topic.strip("/").split("/")
    if len(parts) == 3 and parts[0] == "camera":
        return parts[1]
    return ".".join(parts)


def _is_image(topic: Topic) -> bool:
    return topic.schema in (IMAGE_SCHEMA, VIDEO_FRAME)


def _parse_image(encoding: str, data: bytes, where: str) -> tuple[int, bytes]:
    """Sensor time [ns] (0 if not given) and compressed bytes of a foxglove.CompressedImage."""
    try:
        if encoding == "json":
            message = msgspec.json.decode(data, type=_JsonImage)
            return message.timestamp.sec * 1_000_000_000 + message.timestamp.nsec, message.data
        image = CompressedImage.FromString(data)
        return image.timestamp.ToNanoseconds(), image.data
    except (DecodeError, msgspec.DecodeError) as error:
        raise InputError(f"{where}: not a {IMAGE_SCHEMA} message ({' '.join(str(error).split())[:80]})") from error


class _JsonTime(msgspec.Struct):
    sec: int
    nsec: int = 0


class _JsonImage(msgspec.Struct):
    timestamp: _JsonTime
    data: bytes


def _decode(data: bytes, where: str) -> Image:
    try:
        image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYCOLOR)
    except cv2.error as error:
        raise InputError(f"{where}: the image cannot be decoded ({error.err})") from error
    if image is None:
        raise InputError(f"{where}: the image cannot be decoded ({len(data)} bytes)")
    return image  # type: ignore[no-any-return]


def open_recording(path: Path) -> Recording:
    """The recording in an MCAP file; InputError where the file is damaged."""
    path = Path(path)
    with open_mcap(path) as (reader, summary):
        channels = summary.channels if summary else {}
        counts = summary.statistics.channel_message_counts if summary and summary.statistics else {}
        schemas = summary.schemas if summary else {}
        topics = tuple(
            Topic(c.topic, schemas[c.schema_id].name if c.schema_id in schemas else "", c.message_encoding,
                  int(counts.get(c.id, 0)))
            for c in sorted(channels.values(), key=lambda c: c.topic)
        )  # fmt: skip
        attachments = {a.name: (a.offset, a.length) for a in (summary.attachment_indexes if summary else ())}
        metadata = {m.name: dict(m.metadata) for m in reader.iter_metadata()} if summary else {}
        s = summary.statistics if summary else None
        span = (s.message_start_time, s.message_end_time) if s is not None and s.message_count else None
    own = metadata.get(METADATA)
    recording = Recording(
        path=path,
        scene=None,
        topics=topics,
        provenance=provenance_from_json(own.get("provenance", "")) if own else Provenance("unknown"),
        attachments=attachments,
        videos={n.removeprefix(VIDEO_METADATA): m for n, m in metadata.items() if n.startswith(VIDEO_METADATA)},
        time_ns=span,
        ours=own is not None,
    )
    return _with_scene(recording)


def _with_scene(recording: Recording) -> Recording:
    raw = recording.attachment(SCENE_ATTACHMENT)
    if raw is None:
        return recording
    scene = scene_from_yaml(raw.decode("utf-8", "replace"), f"{recording.path}: {SCENE_ATTACHMENT}")
    return Recording(**{**recording.__dict__, "scene": scene})


__all__ = ["RECORDED", "Recording", "RecordingWriter", "open_recording"]
