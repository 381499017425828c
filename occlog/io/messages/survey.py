"""What a bag holds: its topics, what each is taken as, calibrations, frames of reference, sizes of images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from occlog.errors import InputError, OcclogError

from .bag import Bag
from .decoding import FAILURES, Decode, decoder
from .images import is_picture, pixels
from .kinds import ImageMessage, InfoMessage, Kind, kind_of, read_message
from .mcap_file import Topic
from .topics import TopicMap, map_topics
from .transforms import Transforms

TRIALS = 5
"""Messages of a topic that may be unreadable before the topic is given up."""


@dataclass
class BagSurvey:
    """What a bag holds.

    Attributes:
        topics: its topics by name.
        map: what is taken.
        frames: frame of reference of the images of each camera (or of its calibration), where one is stated.
        sizes: width and height of the first image of each camera [px].
        infos: calibration of each camera, where there is one.
        transforms: the frames of the bag.
    """

    topics: dict[str, Topic]
    map: TopicMap
    frames: dict[str, str] = field(default_factory=dict)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    infos: dict[str, InfoMessage] = field(default_factory=dict)
    transforms: Transforms = field(default_factory=Transforms)


CLOCKS_APART_S = 0.5
"""Where the stamps of messages are farther from the time of recording than this, the user is told."""


class Messages:
    """Decodes messages of a bag into their one form; each topic's decoder is made when it is first needed."""

    def __init__(self, topics: dict[str, Topic]) -> None:
        """Know the topics."""
        self._topics = topics
        self._decoders: dict[str, Decode] = {}

    def read(self, topic: str, data: bytes) -> Any:
        """A message as its type is read by `read_message`; InputError for bytes that are no such message."""
        if topic not in self._decoders:
            self._decoders[topic] = decoder(self._topics[topic])
        kind = self._topics[topic].kind
        try:
            found = read_message(kind, self._decoders[topic](data))
            return list(found) if kind_of(kind) is Kind.TRANSFORM else found
        except OcclogError:
            raise
        except (*FAILURES, RecursionError) as error:
            reason = " ".join(str(error).split())[:80] or type(error).__name__
            raise InputError(f"topic {topic}: not a message of type {kind} ({reason})") from None


def survey(bag: Bag, asked: Sequence[tuple[str, str]], *, transforms_too: bool = True) -> BagSurvey:
    """Go through transforms, the first calibrations and the first images of a bag.

    Args:
        bag: the bag.
        asked: names and topics that the user gives.
        transforms_too: go through the whole bag for its transforms.

    Raises:
        UsageError: a topic that is asked for is not there, or a package is missing that reads it.
        InputError: a topic that is asked for cannot be read.
    """
    topics = bag.topics()
    named = {topic for _, topic in asked}
    early = map_topics(topics, asked, [t.name for t in topics.values() if kind_of(t.kind) is Kind.IMAGE])
    seeking = _of(topics, Kind.IMAGE) if not any(early.images.get(n) == t for n, t in asked) else early.images.values()
    wanted = {*seeking, *_of(topics, Kind.INFO), *(early.transforms if transforms_too else ())}
    messages = Messages(topics)
    images: dict[str, ImageMessage] = {}
    sizes: dict[str, tuple[int, int]] = {}
    infos: dict[str, InfoMessage] = {}
    transforms = Transforms()
    faults: Counter[str] = Counter()
    for message in bag.messages(wanted):
        if message.topic not in wanted:
            continue
        try:
            found = messages.read(message.topic, message.data)
            if isinstance(found, ImageMessage) and (is_picture(found) or message.topic in named):
                sizes[message.topic] = _size(found, message.topic)
        except InputError:
            # Single damaged messages are told later; a topic that nobody asked for may hold whatever it likes.
            faults[message.topic] += 1
            if faults[message.topic] > TRIALS:
                if message.topic in named:
                    raise
                wanted.discard(message.topic)
            continue
        if kind_of(topics[message.topic].kind) is Kind.TRANSFORM:
            for transform in found:
                transforms.add(transform)
            continue
        (images if isinstance(found, ImageMessage) else infos)[message.topic] = found
        wanted.discard(message.topic)
        if not wanted:
            break
    out = BagSurvey(topics, map_topics(topics, asked, sizes), transforms=transforms)
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
        raise InputError(f"topic {unread}: holds no image that can be read; leave it out")
    return out


def _size(image: ImageMessage, topic: str) -> tuple[int, int]:
    """Width and height of an image [px]; InputError for one that is damaged."""
    shown = pixels(image, f"an image of {topic}")
    return shown.shape[1], shown.shape[0]


def _of(topics: dict[str, Topic], kind: Kind) -> Iterable[str]:
    return [t.name for t in topics.values() if kind_of(t.kind) is kind and t.messages != 0]


def taken_lines(found: BagSurvey) -> list[str]:
    """One line for each name that is taken of a bag, and one for what could be taken too."""
    chosen = found.map
    lines = []
    for camera, topic in chosen.images.items():
        info = f", calibration {chosen.infos[camera]}" if camera in chosen.infos else ", no calibration"
        frame = f", frame {found.frames[camera]}" if found.frames.get(camera) else ""
        lines.append(f"camera {camera}: {topic}{info}{frame}")
    lines += [f"camera {camera}: boxes {topic}" for camera, topic in chosen.boxes.items()]
    lines += [f"array {array}: directions {topic}" for array, topic in chosen.directions.items()]
    lines += [f"target {target}: true positions {topic}" for target, topic in chosen.poses.items()]
    if chosen.others:
        lines.append("not taken: " + ", ".join(f"{t} ({kind.value})" for t, kind in chosen.others.items()))
    return lines
