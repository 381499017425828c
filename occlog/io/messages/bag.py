"""A bag: the files of one recording of another program, in sequence, with their losses.

Files are bags of ROS 1 (.bag) or 2 (.mcap, .db3).  A folder of rosbag2 states in `metadata.yaml` which files belong to
it and how many messages they hold; without it all .mcap and .db3 files of the folder are taken.  Files compressed as a
whole (.zstd) are unpacked into a temporary folder, messages compressed one by one as they come.

The survey of a bag lists topics with their interpretation, calibrations, coordinate frames, and image sizes.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zstandard

from occlog.errors import InputError, OcclogError
from occlog.io.files.limits import (
    RECORDING_MAGIC,
    ROS1_MAGIC,
    SQLITE_MAGIC,
    bounded_text,
    check_input,
    describe_unsupported,
    is_zstd,
    max_decompressed_bytes,
)
from occlog.io.files.names import is_hidden, natural_key
from occlog.io.files.texts.yaml import yaml_documents
from occlog.io.files.timing.utc import time_words
from occlog.io.recording.chunks import MAX_CHUNK_BYTES
from occlog.records.columns import bounded_ns
from occlog.records.losses import Loss

from .contents import Transforms, is_picture, pixels
from .kinds import (
    FAILURES,
    Decode,
    ImageMessage,
    InfoMessage,
    TopicKind,
    borrowed_types,
    decoder,
    kind_of,
    read_message,
)
from .mcap_file import BagMessage, BagTopic, McapFile, unpack_frames
from .rosbag1_file import Rosbag1File
from .sqlite_file import SqliteFile
from .topics import TopicMap, map_topics
from .video_stream import is_video, stream_size

METADATA = "metadata.yaml"
SUFFIXES = (".mcap", ".db3")
PACKED = (".zstd", ".zst")
WHAT = "a bag (MCAP, ROS 2 or ROS 1)"
BagFile = McapFile | SqliteFile | Rosbag1File
_PIECE = 1 << 20
MAX_GROWTH = 1000
"""A file that is compressed as a whole may unpack to this many times its size: recordings come to ten times."""


@dataclass
class Bag:
    """An opened bag: its files in the order of time; a context manager that removes decompressed temporary files.

    Attributes:
        paths: files and folders as given.
        files: readers of the files.
        promised: number of messages of each topic that the metadata state.
        described: the metadata list all files, so that these hold no more messages than stated.
        remarks: faults of topics without losses.
    """

    paths: tuple[Path, ...]
    files: list[BagFile] = field(default_factory=list)
    promised: dict[str, int] = field(default_factory=dict)
    described: bool = True  # metadata report all files, so that they hold no more than is promised
    remarks: dict[str, str] = field(default_factory=dict)  # of topics: faults without losses
    _losses: list[Loss] = field(default_factory=list)
    _far: dict[str, tuple[str, int]] = field(default_factory=dict)  # of topics with times out of range, the first
    _folder: tempfile.TemporaryDirectory[str] | None = None
    _packed: dict[Path, Path] = field(default_factory=dict)  # of each file that was unpacked, what it was made of

    @property
    def losses(self) -> list[Loss]:
        """Losses of all files so far, without duplicates."""
        far = [Loss(topic, "time of recording", what, count) for topic, (what, count) in self._far.items()]
        return list(dict.fromkeys([*self._losses, *far, *(loss for file in self.files for loss in file.losses)]))

    def topics(self) -> dict[str, BagTopic]:
        """Topics of all files by name, with message counts summed (None if one is unknown).

        InputError if files give a topic different types.
        """
        out: dict[str, BagTopic] = {}
        for file in self.files:
            for topic in file.topics():
                old = out.get(topic.name)
                if old is None:
                    out[topic.name] = topic
                    continue
                if (old.kind, old.encoding) != (topic.kind, topic.encoding):
                    where = self._packed.get(file.path, file.path)
                    raise InputError(
                        f"{where}: topic {topic.name} holds {topic.kind} ({topic.encoding}), but {old.kind} "
                        f"({old.encoding}) in an earlier file; ingest the files one by one",
                        id="incompatible-inputs",
                    )
                count = None if old.messages is None or topic.messages is None else old.messages + topic.messages
                out[topic.name] = old._replace(messages=count)
        return dict(sorted(out.items()))

    def span(self) -> tuple[int, int] | None:
        """First and last recording time of the messages [ns since the Unix epoch]; None without messages."""
        spans = [span for file in self.files if (span := file.span()) is not None]
        return (min(low for low, _ in spans), max(high for _, high in spans)) if spans else None

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of the given topics, decompressed, file by file; memory does not grow with the bag.

        A topic that is removed from the collection meanwhile is no longer read. Messages with impossible times or
        damaged compression are losses. At the end, counts are compared with the metadata.
        """
        counts: dict[str, int] = {}
        for file in self.files:
            size = file.path.stat().st_size
            most, unpacked = max_decompressed_bytes(size), 0
            for message in file.messages(topics):
                counts[message.topic] = counts.get(message.topic, 0) + 1
                try:
                    bounded_ns(message.log_ns)
                except ValueError as error:
                    first, lost = self._far.get(message.topic, (str(error), 0))
                    self._far[message.topic] = (first, lost + 1)
                    continue
                if not is_zstd(message.data):
                    yield message
                elif (data := self._unpacked(message)) is not None:
                    unpacked += len(data)
                    if unpacked > most:
                        raise InputError(
                            f"{self._packed.get(file.path, file.path)}: the compressed messages of a file of {size} "
                            f"bytes unpack to more than {most} bytes; it is damaged, copy it again",
                            id="input-too-large",
                        )
                    yield message._replace(data=data)
        # Topics that are no longer needed were not read to the end.
        for topic in sorted(topics):
            declared, found = self.promised.get(topic), counts.get(topic, 0)
            if declared is None or declared == found:
                continue
            if declared > found:
                what = f"messages that it counts are not in the files (it counts {declared}, and there are {found})"
                self._losses.append(Loss(METADATA, topic, what, declared - found))
            elif self.described:
                what = f"{METADATA} counts {declared} messages, and there are {found}, which were read"
                self.remarks[topic] = f"{what}; write it again: ros2 bag reindex"

    def __enter__(self) -> Self:
        """Return the bag, which is open already."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove decompressed files."""
        if self._folder is not None:
            self._folder.cleanup()

    def _unpacked(self, message: BagMessage) -> bytes | None:
        """Decompressed bytes of a zstd-compressed message; None, and a loss is added, if damaged or too large."""
        try:
            return unpack_frames(message.data, MAX_CHUNK_BYTES)
        except zstandard.ZstdError as error:
            reason = str(error)
        self._losses.append(Loss(message.topic, time_words(message.log_ns), f"damaged compressed message: {reason}", 1))
        return None

    def unpack(self, path: Path) -> Path:
        """Decompress a file that is compressed by zstd as a whole; return the path of the temporary file.

        Damage is a loss; InputError if nothing can be decompressed, or far more than a recording can have.
        """
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix="occlog-bag-")
        out = Path(self._folder.name) / f"{len(self.files)}-{path.stem}"
        self._packed[out] = path
        limit = MAX_CHUNK_BYTES + MAX_GROWTH * path.stat().st_size
        with path.open("rb") as source, out.open("wb") as target:
            reader = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
            try:
                while piece := reader.read1(_PIECE):
                    target.write(piece)
                    if target.tell() > limit:
                        raise InputError(
                            f"{path}: unpacks to more than {MAX_GROWTH} times its size; if it is a recording, unpack "
                            "it first: zstd -d",
                            id="input-too-large",
                        )
            except zstandard.ZstdError as error:
                self._losses.append(Loss(path.name, f"after {target.tell()} unpacked bytes", f"damaged zstd ({error})"))
            if not target.tell():
                raise InputError(
                    f"{path}: nothing of it can be unpacked: its zstd is cut off or damaged; copy it again",
                    id="damaged-file",
                )
        return out


def is_bag(path: Path) -> bool:
    """Whether a path is probably a bag: a folder with bag files or metadata, or a bag file by its first bytes."""
    if path.is_dir():
        return (path / METADATA).is_file() or bool(_members(path))
    return path.is_file() and _kind(path) is not None


def open_bag(paths: Collection[Path]) -> Bag:
    """Open the files of one recording as a bag.

    A file of several that cannot be opened is a loss.

    Args:
        paths: folders of rosbag2, or files (.mcap, .db3, .bag, also compressed by zstd), in any order.

    Raises:
        InputError: no file can be opened, or the single file given is not a bag.
    """
    bag = Bag(tuple(paths))
    try:
        for path in paths:
            listed = _listed(path, bag)
            for file in listed:
                _add(bag, file)
            bag._losses += _left_out(path, listed)
        if not bag.files:
            loss = bag.losses[0] if bag.losses else None
            where = next(iter(paths))
            ros1 = f"; give its bags of ROS 1 as files: {where}/*.bag" if any(where.glob("*.bag")) else ""
            if loss is not None:
                source = next((path for path in paths if path.name == loss.source), where / loss.source)
                raise InputError(f"{source}: {loss.what}", id="damaged-file")
            raise InputError(f"{where}: holds no .mcap or .db3 file{ros1}", id="unsupported-format")
        if len(bag.files) > 1:
            bag.files = _in_order(bag.files)
    except BaseException:
        bag.__exit__(None, None, None)
        raise
    return bag


def _in_order(files: list[BagFile]) -> list[BagFile]:
    """Files sorted by the time of their first message (a shell sorts `bag_10` before `bag_2`).

    A file with unknown times (damaged or empty) stays behind its predecessor.
    """
    begins, last = list[int](), 0
    for file in files:
        span = file.span()
        last = last if span is None else span[0]
        begins.append(last)
    return [files[n] for n in sorted(range(len(files)), key=begins.__getitem__)]


def _add(bag: Bag, path: Path) -> None:
    """Open a file, decompressed if necessary, and append its reader to the bag.

    InputError if it cannot be opened and is the only file given; in other cases that is a loss of the bag.
    """
    try:
        check_input(path, WHAT)
        kind = _kind(path)
        unpacked = bag.unpack(path) if kind == "zstd" else path
        kind = _kind(unpacked) if kind == "zstd" else kind
        reader = _READERS.get(kind or "")
        if reader is None:
            mistaken = describe_unsupported(path)
            what = "neither an MCAP file nor a .db3 or .bag file of ROS" if mistaken is None else f"is {mistaken}"
            raise InputError(f"{path}: {what}; {WHAT} was expected", id="empty-input")
        bag.files.append(reader(unpacked, path.name))
    except InputError as error:
        if len(bag.paths) == 1 and not bag.paths[0].is_dir():
            raise
        bag._losses.append(Loss(path.name, "whole file", str(error).removeprefix(f"{path}: ")))


_READERS: dict[str, Callable[[Path, str], BagFile]] = {"mcap": McapFile, "sqlite": SqliteFile, "ros1": Rosbag1File}
"""Readers of files by their kind."""


def _kind(path: Path) -> str | None:
    """Kind of a file by its first bytes: `mcap`, `sqlite`, `ros1`, `zstd`, or None."""
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(RECORDING_MAGIC):
        return "mcap"
    if head.startswith(SQLITE_MAGIC):
        return "sqlite"
    if head.startswith(ROS1_MAGIC):
        return "ros1"
    return "zstd" if is_zstd(head) else None


def _members(folder: Path) -> list[Path]:
    """Files of a ROS 2 bag in a folder (.mcap, .db3, also compressed), in natural order.

    A compressed file is omitted if it exists decompressed as well.
    """
    found = [p for p in folder.iterdir() if p.is_file() and not is_hidden(p) and _bare(p).suffix in SUFFIXES]
    return sorted((p for p in found if p == _bare(p) or _bare(p) not in found), key=lambda p: natural_key(p.name))


def _bare(path: Path) -> Path:
    """Path of the decompressed file that rosbag2 writes next to the compressed file `path`; other paths unchanged."""
    return path.with_suffix("") if path.suffix in PACKED else path


def _listed(path: Path, bag: Bag) -> list[Path]:
    """Bag files of a path: itself if it is a file; of a folder those that its metadata list, or without metadata all.

    Sets `bag.promised` and `bag.described` by the metadata. InputError if these list no files.
    """
    described = path / METADATA
    bag.described &= path.is_dir() and described.is_file()
    if not path.is_dir():
        return [path]
    if not described.is_file():
        return _members(path)
    information = _information(described)
    names = information.get("relative_file_paths")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(
            f"{described}: has no relative_file_paths; remove this file to read all bag files of its folder",
            id="missing-value",
        )
    counts = information.get("topics_with_message_count")
    for entry in counts if isinstance(counts, list) else ():
        try:
            name, count = str(entry["topic_metadata"]["name"]), int(entry["message_count"])
        except (KeyError, TypeError, ValueError, OverflowError):
            continue
        bag.promised[name] = bag.promised.get(name, 0) + count
    # A name may be an old absolute path, or lead out of the folder: only the file next to the metadata counts.
    return [_packed_or_not(path / Path(name.replace("\\", "/")).name) for name in names]


def _packed_or_not(path: Path) -> Path:
    """The path itself if it exists, else the one with or without a compression suffix that does.

    Rosbag2 lists either.
    """
    others = (_bare(path), *(path.with_name(path.name + ending) for ending in PACKED))
    # Unlike methods of Path these take names of any length
    return path if os.path.exists(path) else next((other for other in others if os.path.isfile(other)), path)  # noqa: PTH110, PTH113


def _left_out(path: Path, listed: list[Path]) -> list[Loss]:
    """Losses for the files of the folder `path` that are not among `listed`, those that its metadata list."""
    if not path.is_dir():
        return []
    known = {_bare(file) for file in listed}
    what = f"{METADATA} does not name it, and it was not read; remove {METADATA} to take it"
    return [Loss(file.name, "whole file", what) for file in _members(path) if _bare(file) not in known]


def _information(path: Path) -> dict[str, object]:
    """Mapping `rosbag2_bagfile_information` of a bag's metadata file (YAML); InputError if there is none."""
    documents = yaml_documents(bounded_text(path, "the metadata of a ROS 2 bag"), path, "metadata of a ROS 2 bag")
    content = documents[0] if len(documents) == 1 else None
    found = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(found, dict):
        raise InputError(
            f"{path}: not metadata of a ROS 2 bag; remove this file to read all bag files of its folder",
            id="unknown-format",
        )
    return found


STATIC = "tf_static"
"""Name of the topic of transforms that hold for all times."""
TRIALS = 5
"""Messages of a topic that may be unreadable before the topic is given up."""


@dataclass
class BagSurvey:
    """What a bag holds, as found by its first messages.

    Attributes:
        topics: its topics by name.
        map: topics selected for use.
        frames: transform frame of the images of each camera (or of its calibration), where one is stated.
        sizes: width and height of the first image of each camera [px].
        infos: calibration of each camera that has one.
        transforms: transforms between the frames of the bag.
        faults: why the first unreadable message of a topic cannot be read, by topic.
    """

    topics: dict[str, BagTopic]
    map: TopicMap
    frames: dict[str, str] = field(default_factory=dict)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    infos: dict[str, InfoMessage] = field(default_factory=dict)
    transforms: Transforms = field(default_factory=Transforms)
    faults: dict[str, str] = field(default_factory=dict)


CLOCKS_APART_S = 0.5
"""Difference of header stamps and recording times above which a note is printed."""


class NoSizeError(InputError):
    """A picture of a video stream does not state its size, which the first key frame does."""


class BagDecoder:
    """Decodes messages of a bag to the common types of `kinds`; the decoder of a topic is created on first use."""

    def __init__(self, topics: dict[str, BagTopic]) -> None:
        """Prepare for messages of the given topics of a bag."""
        self._topics = topics
        self._decoders: dict[str, Decode] = {}

    def read(self, topic: str, data: bytes) -> Any:
        """Decode a message of a topic to the common type of its kind (`ImageMessage`, ...); a list for transforms.

        InputError for invalid bytes.
        """
        if topic not in self._decoders:
            self._decoders[topic] = decoder(self._topics[topic])
        kind = self._topics[topic].kind
        try:
            found = read_message(kind, self._decoders[topic](data))
            return list(found) if kind_of(kind) is TopicKind.TRANSFORM else found
        except OcclogError:
            raise
        except (*FAILURES, RecursionError) as error:
            reason = " ".join(str(error).split())[:80] or type(error).__name__
            raise InputError(f"topic {topic}: not a message of type {kind} ({reason})", id="damaged-file") from None


def survey(bag: Bag, asked: Sequence[tuple[str, str]], *, transforms_too: bool = True) -> BagSurvey:
    """Survey a bag: read all transforms, and the first calibration and image of each topic; select topics.

    Args:
        bag: the bag.
        asked: (name, topic) pairs that the user gives.
        transforms_too: read the whole bag for its transforms.

    Raises:
        UsageError: a topic that the user names is missing, or a package that reads it is not installed.
        InputError: a topic that the user names cannot be read.
    """
    topics = bag.topics()
    named = {topic for _, topic in asked}
    early = map_topics(topics, asked, [t.name for t in topics.values() if kind_of(t.kind) is TopicKind.IMAGE])
    seeking = (
        _of(topics, TopicKind.IMAGE) if not any(early.images.get(n) == t for n, t in asked) else early.images.values()
    )
    wanted = {*seeking, *_of(topics, TopicKind.INFO), *(early.transforms if transforms_too else ())}
    messages = BagDecoder(topics)
    images: dict[str, ImageMessage] = {}
    sizes: dict[str, tuple[int, int]] = {}
    infos: dict[str, InfoMessage] = {}
    transforms = Transforms()
    faults: Counter[str] = Counter()
    reasons: dict[str, str] = {}
    for message in bag.messages(wanted):
        if message.topic not in wanted:
            continue
        try:
            found = messages.read(message.topic, message.data)
            if isinstance(found, ImageMessage) and (is_picture(found) or message.topic in named):
                sizes[message.topic] = _size(found, message.topic)
        except NoSizeError as error:
            reasons[message.topic] = str(error)
            continue
        except InputError as error:
            # Single damaged messages are reported later; a topic that was not requested may hold anything.
            faults[message.topic] += 1
            reasons.setdefault(message.topic, str(error))
            if faults[message.topic] > TRIALS:
                if message.topic in named:
                    raise
                wanted.discard(message.topic)
            continue
        if kind_of(topics[message.topic].kind) is TopicKind.TRANSFORM:
            for transform in found:
                transforms.add(transform, static=message.topic.endswith(STATIC))
            continue
        (images if isinstance(found, ImageMessage) else infos)[message.topic] = found
        wanted.discard(message.topic)
        if not wanted:
            break
    out = BagSurvey(topics, map_topics(topics, asked, sizes), transforms=transforms, faults=reasons)
    for camera in out.map.cameras:
        topic, info = out.map.images.get(camera, ""), infos.get(out.map.infos.get(camera, ""))
        if topic in sizes:
            out.sizes[camera] = sizes[topic]
            out.frames[camera] = images[topic].header.frame
        if info is not None:
            out.infos[camera] = info
            out.frames[camera] = out.frames.get(camera) or info.header.frame
    unread = next((topic for topic in out.map.images.values() if topic not in sizes), None)
    if unread is not None:
        raise InputError(
            f"topic {unread}: holds no image that can be read; leave this topic out", id="unsupported-format"
        )
    return out


def _size(image: ImageMessage, topic: str) -> tuple[int, int]:
    """Width and height [px] of an image of a topic, which is decoded unless it is of a video stream.

    InputError if it is damaged, NoSizeError for a picture of a video stream that does not state its size.
    """
    if image.size is None and is_video(image.encoding):
        try:
            size = stream_size(image.data, image.encoding)
        except InputError as error:
            raise InputError(f"topic {topic}: {error}") from error
        if size is None:
            raise NoSizeError(
                f"topic {topic}: no message of its video has a key frame, without which it cannot be decoded"
            )
        return size
    shown = pixels(image, f"an image of {topic}")
    return shown.shape[1], shown.shape[0]


def _of(topics: dict[str, BagTopic], kind: TopicKind) -> Iterable[str]:
    return [t.name for t in topics.values() if kind_of(t.kind) is kind and t.messages != 0]


def topic_lines(found: BagSurvey) -> list[str]:
    """One line of text for each selected topic of a bag, and one for topics that could be selected."""
    chosen = found.map
    lines = []
    for camera, topic in chosen.images.items():
        info = f", calibration {chosen.infos[camera]}" if camera in chosen.infos else ", no calibration"
        frame = f", frame {found.frames[camera]}" if found.frames.get(camera) else ""
        lines.append(f"camera {camera}: {topic}{info}{frame}")
    for camera, topic in chosen.boxes.items():
        info = f", calibration {chosen.infos[camera]}" if camera in chosen.infos else ", no calibration"
        lines.append(f"camera {camera}: boxes {topic}" + ("" if camera in chosen.images else info))
    lines += [f"array {array}: directions {topic}" for array, topic in chosen.directions.items()]
    lines += [f"target {target}: true positions {topic}" for target, topic in chosen.poses.items()]
    if chosen.others:
        lines.append("not taken: " + ", ".join(f"{t} ({kind.value})" for t, kind in chosen.others.items()))
    return lines


def borrowed_lines(found: BagSurvey) -> list[str]:
    """One line of text for each selected topic with message types that the bag does not define.

    The definitions of ROS are used for them.
    """
    chosen, lines = found.map, []
    taken = {*chosen.images.values(), *chosen.infos.values(), *chosen.boxes.values(), *chosen.directions.values()}
    for topic in sorted({*taken, *chosen.poses.values(), *chosen.transforms}):
        content = found.topics[topic]
        if content.definition and (borrowed := borrowed_types(content)):
            lines.append(f"{topic}: the bag does not define {', '.join(borrowed)}; the definition of ROS was taken")
    return lines
