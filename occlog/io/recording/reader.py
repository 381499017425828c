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
    """A linked video, decoded forwards only; frames keep the numbers that `occlog ingest` assigned."""

    path: Path
    where: str
    _video: SubprocessVideo | None = field(default=None)

    def open(self) -> None:
        """Start decoding in a separate process; InputError unless at least one frame can be decoded."""
        if self._video is None:
            self._video = SubprocessVideo(self.path)

    def read(self, index: int) -> Image:
        """Frame with number `index`; earlier frames are skipped; InputError if it cannot be decoded."""
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
    """Open the linked video of a camera (`sensor`); InputError if missing or changed.

    `link` has path and SHA-256 of the video; None: the recording has none.
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
    """A channel of an MCAP file."""

    name: str
    schema: str
    encoding: str
    messages: int


@dataclass(frozen=True)
class McapRecording:
    """An opened recording; nothing but its index has been read yet."""

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
        """Losses recorded when the recording was made."""
        return self.provenance.losses

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that have frames, sorted."""
        return tuple(sorted({sensor_of(t.name) for t in self.topics if _is_image(t)}))

    def has(self, table: type[ColumnTable]) -> bool:
        """Whether the recording holds rows of a table."""
        return any(t.schema == schema_of(table) for t in self.topics)

    def sensors_of(self, table: type[ColumnTable]) -> tuple[str, ...]:
        """Names of the sensors with rows of a table, sorted."""
        return tuple(sorted(t.name.rsplit("/", 1)[-1] for t in self.topics if t.schema == schema_of(table)))

    def messages(self, table: type[ColumnTable]) -> int:
        """Number of messages with rows of a table; a message has the rows of a sensor at a time."""
        return sum(t.messages for t in self.topics if t.schema == schema_of(table))

    def attachment(self, name: str) -> bytes | None:
        """Content of an attached file; None if missing."""
        if name not in self.attachments:
            return None
        with self.path.open("rb") as file:
            return read_attachment(self.path, file, *self.attachments[name])

    def tables(self, table: type[T], rows: int = ROWS_PER_CHUNK) -> Iterator[T]:
        """Generate chunks of about `rows` rows of a table; rows of one time are never split."""
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
        """Read all rows of a table."""
        return table.concat(self.tables(table))

    def frames(self, sensors: Iterable[str] | None = None) -> Iterator[Frame]:
        """Generate the frames of cameras sorted by time; InputError if a camera's times do not increase.

        `sensors` are the names of the cameras; None: all.
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
        """Generate the messages of topics sorted by time: topic, log time [ns], data, sequence number.

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
    """Paths of the linked videos of a recording; paths inside its folder are listed even if files are missing.

    Empty for a file that is not a recording or cannot be opened.
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
    """Camera named by a topic: `/camera/NAME/...` gives NAME, any other topic its path with dots for slashes."""
    parts = topic.strip("/").split("/")
    if len(parts) == 3 and parts[0] == "camera":
        return parts[1]
    return ".".join(parts)


def _is_image(topic: McapChannel) -> bool:
    return topic.schema in (IMAGE_SCHEMA, VIDEO_FRAME)


def check_recorded(t_ns: int, path: Path, topic: str, number: int) -> None:
    """InputError if the recording time `t_ns` [ns] of message `number` of a topic is out of range."""
    try:
        bounded_ns(t_ns)
    except ValueError as error:
        raise InputError(
            f"{path}: {topic}: message {number}: {error}; times are ns since 1970", id="time-out-of-range"
        ) from None


def parse_image(encoding: str, data: bytes, where: str) -> tuple[int, bytes]:
    """Parse a foxglove.CompressedImage: sensor time [ns] (0 if not given) and compressed bytes.

    `encoding` is json or protobuf; InputError for other data.
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
    """Open the recording in an MCAP file; InputError if damaged."""
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
