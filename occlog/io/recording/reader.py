"""Reading of a recording: scene, frames and rows of an MCAP file, streamed in the order of time.

Images are in the file, or in a linked video file, which is decoded forwards only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError

from occlog.array_types import NS
from occlog.errors import InputError
from occlog.io.files.limits import Content, content_of
from occlog.io.files.provenance import UNKNOWN, Provenance, hash_file, provenance_from_json
from occlog.io.files.timing.utc import time_words
from occlog.io.formats.scenes.scene import scene_from_yaml
from occlog.io.frames.decoders.subprocess_video import SubprocessVideo, decode_apart
from occlog.records.columns import ColumnTable, bounded_ns
from occlog.records.frames import Frame, Image
from occlog.records.losses import Loss
from occlog.records.scene import Scene

from .chunks import damaged_mcap
from .mcap_errors import open_mcap, read_attachment
from .metadata import leaves_folder, linked_path, read_metadata
from .rebuilt_index import RebuiltIndexReader
from .rows import RowCollector, schema_of
from .writer import METADATA, SCENE_ATTACHMENT, VIDEO_FRAME, VIDEO_METADATA


@dataclass
class LinkedVideo:
    """A linked video of a camera, decoded forwards only; frames keep the numbers that `occlog ingest` assigned.

    `where` names recording and camera in messages.
    """

    path: Path
    where: str
    _video: SubprocessVideo | None = field(default=None)

    def open(self) -> None:
        """Start decoding in a separate process, unless it runs; InputError if not one frame can be decoded."""
        if self._video is None:
            self._video = SubprocessVideo(self.path)

    def read(self, index: int) -> Image:
        """Frame with the number `index`; earlier frames are skipped, so that calls must be in increasing order.

        InputError if it cannot be decoded.
        """
        self.open()
        assert self._video is not None
        image = self._video.read(index)
        if image is not None:
            return image
        # Other losses were reported when the video was ingested.
        why = f"the decoder of {self.path} {self._video.death}" if self._video.death else ""
        raise InputError(
            f"{self.where}: frame {index}: {why or f'cannot be decoded from {self.path}'}; ingest it again",
            id="damaged-file",
        )


def open_linked(recording: Path, sensor: str, link: dict[str, str] | None) -> LinkedVideo:
    """Linked video of a camera; InputError if the link or the video is missing, or its content has changed.

    Args:
        recording: file that has the link.
        sensor: name of the camera.
        link: `path`, relative to the recording, and `sha256` of the video; None: there is no link.
    """
    where = f"{recording}: camera {sensor}"
    if not link or "path" not in link or "sha256" not in link:
        raise InputError(f"{where}: has frame times but no link to its video; ingest it again", id="wrong-content")
    path = linked_path(recording, sensor, link["path"])
    if hash_file(path) != link["sha256"]:
        raise InputError(
            f"{where}: {path} is not the video that was ingested (its content changed); ingest it again",
            id="file-changed",
        )
    return LinkedVideo(path, where)


T = TypeVar("T", bound=ColumnTable)
IMAGE_SCHEMA = "foxglove.CompressedImage"
ROWS_PER_CHUNK = 16_384


@dataclass(frozen=True)
class McapChannel:
    """A channel (topic) of an MCAP file: name, message schema, encoding and number of messages."""

    name: str
    schema: str
    encoding: str
    messages: int


@dataclass(frozen=True)
class McapRecording:
    """An opened recording, or MCAP file of another program, of which only the index has been read.

    Attributes:
        path: the file.
        scene: the attached scene; None: there is none.
        topics: its channels, sorted by name.
        provenance: how it was made.
        attachments: byte offset and length of each attached file, by name.
        videos: path and SHA-256 of the linked video of each camera.
        time_ns: first and last time of the messages [ns since the Unix epoch]; None without messages.
        ours: whether occlog wrote it.
        indexed: whether the file has a complete index; otherwise one was rebuilt.
    """

    path: Path
    scene: Scene | None
    topics: tuple[McapChannel, ...]
    provenance: Provenance
    attachments: dict[str, tuple[int, int]]
    videos: dict[str, dict[str, str]]
    time_ns: tuple[int, int] | None
    ours: bool
    indexed: bool = True
    """True if the file has a complete index; otherwise one was rebuilt in a pass through it."""

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses of input recorded in the recording's provenance."""
        return self.provenance.losses

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that have frames, sorted."""
        return tuple(sorted({sensor_of(t.name) for t in self.topics if _is_image(t)}))

    def has(self, table: type[ColumnTable]) -> bool:
        """Whether the recording has messages with rows of `table`."""
        return any(t.schema == schema_of(table) for t in self.topics)

    def sensors_of(self, table: type[ColumnTable]) -> tuple[str, ...]:
        """Names of the sensors with rows of `table`, sorted."""
        return tuple(sorted(t.name.rsplit("/", 1)[-1] for t in self.topics if t.schema == schema_of(table)))

    def messages(self, table: type[ColumnTable]) -> int:
        """Number of messages with rows of `table`; each has the rows of a sensor at a time."""
        return sum(t.messages for t in self.topics if t.schema == schema_of(table))

    def attachment(self, name: str) -> bytes | None:
        """Content of an attached file; None if missing."""
        if name not in self.attachments:
            return None
        with self.path.open("rb") as file:
            return read_attachment(self.path, file, *self.attachments[name])

    def tables(self, table: type[T], rows: int = ROWS_PER_CHUNK) -> Iterator[T]:
        """Yield the rows of `table`, in the order of time, in chunks of about `rows` rows.

        Rows of one time are in one chunk. InputError for a damaged or invalid message.
        """
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
        """All rows of `table` in the order of time; InputError for a damaged or invalid message."""
        return table.concat(self.tables(table))

    def frames(self, sensors: Iterable[str] | None = None) -> Iterator[Frame]:
        """Yield the frames of cameras, not decoded, sorted by time.

        Args:
            sensors: names of the cameras; None: all.

        Raises:
            InputError: times of a camera do not increase, or its linked video is missing or changed.
        """
        wanted = set(self.cameras if sensors is None else sensors)
        topics = {t.name: t for t in self.topics if _is_image(t) and sensor_of(t.name) in wanted}
        linked: dict[str, LinkedVideo] = {}
        last: dict[str, int] = {}
        counts: dict[str, int] = {}
        for name, t_ns, data, sequence in self._messages(list(topics)):
            sensor = sensor_of(name)
            index = sequence if self.ours else counts.get(sensor, 0)
            counts[sensor] = counts.get(sensor, 0) + 1
            stamp, decode, encoded = self._decoder(topics[name], sensor, t_ns, data, index, linked)
            if sensor in last and stamp <= last[sensor]:
                raise InputError(
                    f"{self.path}: camera {sensor}: frame {index}: time {time_words(stamp)} does not come after "
                    f"{time_words(last[sensor])}; each frame needs its own, later time",
                    id="unsorted-times",
                )
            last[sensor] = stamp
            yield Frame(stamp, sensor, index, decode, encoded)

    def _decoder(
        self, topic: McapChannel, sensor: str, t_ns: int, data: bytes, index: int, linked: dict[str, LinkedVideo]
    ) -> tuple[int, Callable[[], Image], bytes | None]:
        where = f"{self.path}: camera {sensor}: frame {index}"
        if topic.schema == VIDEO_FRAME:
            if sensor not in linked:
                linked[sensor] = open_linked(self.path, sensor, self.videos.get(sensor))
                linked[sensor].open()
            return t_ns, partial(linked[sensor].read, index), None
        stamp, image = parse_image(topic.encoding, data, where)
        return stamp or t_ns, partial(decode_apart, image, where), image

    def _messages(self, topics: list[str]) -> Iterator[tuple[str, int, bytes, int]]:
        """Yield (topic, recording time [ns], data, sequence number) of the messages of some topics, sorted by time.

        InputError if there are fewer than the index states.
        """
        if not topics:
            return
        declared, found = sum(t.messages for t in self.topics if t.name in topics), 0
        with open_mcap(self.path) as (reader, _):
            for _schema, channel, message in reader.iter_messages(topics=topics):
                found += 1
                check_recorded(message.log_time, self.path, channel.topic, message.sequence)
                yield channel.topic, message.log_time, message.data, message.sequence
        # Of a chunk with an index that does not name their topics the library states nothing
        if found != declared:
            names = ", ".join(sorted(topics))[:200]
            raise damaged_mcap(self.path, f"its index counts {declared} messages of {names}, and leads to {found}")


def linked_videos(path: Path) -> tuple[Path, ...]:
    """Paths of the linked videos of a recording; empty for a file that is not a recording or cannot be opened.

    A link inside the recording's folder is listed even if the file is missing, one that leads out of it only if it is a
    video.
    """
    try:
        if content_of(path, "a recording") is not Content.RECORDING:
            return ()
        links = open_recording(path).videos.items()
    except InputError:  # whoever reads it states it
        return ()
    found = []
    for sensor, link in links:
        if "path" in link:
            if leaves_folder(path, link["path"]):
                try:
                    linked_path(path, sensor, link["path"])
                except InputError:  # whoever decodes it states it
                    continue
            found.append(path.parent / link["path"])
    return tuple(found)


def sensor_of(topic: str) -> str:
    """Camera that a topic is of: `/camera/NAME/...` gives NAME, any other topic its path with dots for slashes."""
    parts = topic.strip("/").split("/")
    if len(parts) == 3 and parts[0] == "camera":
        return parts[1]
    return ".".join(parts)


def _is_image(topic: McapChannel) -> bool:
    return topic.schema in (IMAGE_SCHEMA, VIDEO_FRAME)


def check_recorded(t_ns: int, path: Path, topic: str, number: int) -> None:
    """InputError if the recording time `t_ns` [ns] of a message is beyond +-`MAX_NS`.

    `path`, `topic` and `number` (of the message) are for the message of the error.
    """
    try:
        bounded_ns(t_ns)
    except ValueError as error:
        raise InputError(
            f"{path}: {topic}: message {number}: {error}; times are ns since 1970", id="time-out-of-range"
        ) from None


def parse_image(encoding: str, data: bytes, where: str) -> tuple[int, bytes]:
    """Parse a message `foxglove.CompressedImage` to the sensor time and the compressed bytes.

    The time is in ns since the Unix epoch; 0: not given. InputError for an invalid message.

    Args:
        encoding: `json` or `protobuf`.
        data: the message.
        where: describes the frame, for messages.
    """
    try:
        if encoding == "json":
            message = msgspec.json.decode(data, type=_JsonImage)
            stamp = message.timestamp.sec * NS + message.timestamp.nsec
            return bounded_ns(stamp), message.data
        image = CompressedImage.FromString(data)
        stamp = image.timestamp.seconds * NS + image.timestamp.nanos
        return bounded_ns(stamp), image.data
    except (DecodeError, msgspec.DecodeError, ValueError) as error:
        raise InputError(
            f"{where}: not a {IMAGE_SCHEMA} message ({' '.join(str(error).split())[:80]})", id="damaged-file"
        ) from error


class _JsonTime(msgspec.Struct):
    sec: int
    nsec: int = 0


class _JsonImage(msgspec.Struct):
    timestamp: _JsonTime
    data: bytes


def open_recording(path: Path) -> McapRecording:
    """Open a recording of occlog, or an MCAP file of another program; InputError if it is damaged."""
    path = Path(path)
    with open_mcap(path) as (reader, summary):
        indexed = not isinstance(reader, RebuiltIndexReader)
        channels, schemas, statistics = summary.channels, summary.schemas, summary.statistics
        counts = statistics.channel_message_counts if statistics else {}
        topics = tuple(
            McapChannel(
                c.topic,
                schemas[c.schema_id].name if c.schema_id in schemas else "",
                c.message_encoding,
                int(counts.get(c.id, 0)),
            )
            for c in sorted(channels.values(), key=lambda c: c.topic)
        )
        attachments = {a.name: (a.offset, a.length) for a in summary.attachment_indexes}
        metadata = read_metadata(path, summary)
        span = None
        if statistics and statistics.message_count:
            span = statistics.message_start_time, statistics.message_end_time
    own = metadata.get(METADATA)
    recording = McapRecording(
        path=path,
        scene=None,
        topics=topics,
        provenance=provenance_from_json(own.get("provenance", ""), path) if own else UNKNOWN,
        attachments=attachments,
        videos={n.removeprefix(VIDEO_METADATA): m for n, m in metadata.items() if n.startswith(VIDEO_METADATA)},
        time_ns=span,
        ours=own is not None,
        indexed=indexed,
    )
    return _with_scene(recording)


def _with_scene(recording: McapRecording) -> McapRecording:
    raw = recording.attachment(SCENE_ATTACHMENT)
    if raw is None:
        return recording
    scene = scene_from_yaml(raw.decode("utf-8", "replace"), f"{recording.path}: {SCENE_ATTACHMENT}")
    return McapRecording(**{**recording.__dict__, "scene": scene})
