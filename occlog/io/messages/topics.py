"""Selection of a bag's topics, their kinds and names: by the user, or by type and name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from occlog.errors import InputError, UsageError, option
from occlog.io.files.limits import check_input
from occlog.io.files.names import safe_name
from occlog.io.files.texts.yaml import read_yaml

from .kinds import TopicKind, is_readable, kind_of
from .mcap_file import BagTopic

TRANSPORTS = ("compressed", "theora", "compressedDepth", "ffmpeg", "h264", "zstd")
PLAIN = (
    "image", "image_raw", "image_rect", "image_color", "image_mono", "image_rect_color", "image_rect_raw",
    "image_raw_color", "video", "camera_info", "compressed", "detections", "detections_2d", "boxes", "yolo",
)  # fmt: skip
"""Last parts of topics that contain nothing about the camera's name."""


@dataclass(frozen=True)
class TopicMap:
    """Topics selected from a bag.

    Attributes:
        images: topic of the images of each camera.
        infos: topic of the calibration of each camera.
        transforms: topics of transforms.
        poses: topic of true positions, by the identity of its (first) target.
        boxes: topic of boxes of each camera.
        directions: topic of directions of each array.
        others: usable topics that were not selected, and what they hold.
    """

    images: dict[str, str] = field(default_factory=dict)
    infos: dict[str, str] = field(default_factory=dict)
    transforms: tuple[str, ...] = ()
    poses: dict[int, str] = field(default_factory=dict)
    boxes: dict[str, str] = field(default_factory=dict)
    directions: dict[str, str] = field(default_factory=dict)
    others: dict[str, TopicKind] = field(default_factory=dict)

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras with images or boxes."""
        return list(dict.fromkeys([*self.images, *self.boxes]))


def read_topic_map(path: Path) -> list[tuple[str, str]]:
    """(name, topic) pairs from a YAML file with `NAME: TOPIC`, or `NAME: [TOPIC, ...]`."""
    check_input(path, "a map of topics (YAML: name and topic, or a list of topics)")
    found = read_yaml(path, dict[str | int, str | list[str]], "a map of topics")
    return [(str(name), t) for name, topics in found.items() for t in ([topics] if isinstance(topics, str) else topics)]


def map_topics(topics: Mapping[str, BagTopic], asked: Sequence[tuple[str, str]], pictures: Iterable[str]) -> TopicMap:
    """Select topics of a bag for cameras, arrays and targets, by the user's choice or by type and name.

    Args:
        topics: topics of the bag.
        asked: (name, topic) pairs that the user gives; if there are any of one kind, no others of that kind are
            selected.
        pictures: topics of images with a first message that shows visible light (and not depth).

    Raises:
        UsageError: a topic that the user gives is missing or cannot be used, or a name is given twice.
    """
    named: dict[TopicKind, dict[str, str]] = {kind: {} for kind in TopicKind}
    for name, topic in asked:
        kind = _kind_asked(topics, name, topic)
        if name in named[kind]:
            raise UsageError(
                f"topic {topic}: {name} already has {kind.value} in {named[kind][name]}; give one",
                id="conflicting-options",
            )
        named[kind][name] = topic
    shown = set(pictures)
    found = {
        kind: [t.name for t in topics.values() if kind_of(t.kind) is kind and t.messages != 0 and is_readable(t)]
        for kind in TopicKind
    }
    candidates = [t for t in found[TopicKind.IMAGE] if t in shown]
    images = named[TopicKind.IMAGE] or name_cameras(_one_of_each(candidates, topics))
    infos = dict(named[TopicKind.INFO])
    for camera, topic in images.items():
        match = _info_of(topic, found[TopicKind.INFO])
        if camera not in infos and match is not None:
            infos[camera] = match
    boxes = named[TopicKind.BOX] or (
        {} if images else _boxes_alone(found[TopicKind.BOX], topics, found[TopicKind.INFO])
    )
    for camera, topic in boxes.items():
        match = _info_above(topic, found[TopicKind.INFO], len(boxes))
        if camera not in infos and match is not None:
            infos[camera] = match
    directions = named[TopicKind.DIRECTION] or _named_by_path(found[TopicKind.DIRECTION])
    taken = {*images.values(), *infos.values(), *boxes.values(), *directions.values(), *named[TopicKind.POSE].values()}
    others: dict[str, TopicKind] = {
        t: kind for kind in TopicKind if kind is not TopicKind.TRANSFORM for t in found[kind] if t not in taken
    }
    return TopicMap(
        images=images,
        infos=infos,
        transforms=tuple(named[TopicKind.TRANSFORM].values()) or tuple(found[TopicKind.TRANSFORM]),
        poses={_identity(name, topic): topic for name, topic in named[TopicKind.POSE].items()},
        boxes=boxes,
        directions=directions,
        others=others,
    )


def _kind_asked(topics: Mapping[str, BagTopic], name: str, topic: str) -> TopicKind:
    """What a topic that the user names holds, by its type; UsageError if it is missing or cannot be used.

    `name` is that of the sensor or target for which the user names it.
    """
    if topic not in topics:
        known = ", ".join(topics) or "none"
        raise UsageError(f"topic {topic}: the bag has no such topic; it has: {known}", id="unknown-name")
    kind = kind_of(topics[topic].kind)
    if kind is None:
        raise UsageError(
            f"topic {topic}: messages of type {topics[topic].kind or '(none)'} cannot be read; leave this topic out",
            id="unsupported-format",
        )
    if kind not in (TopicKind.POSE, TopicKind.TRANSFORM) and safe_name(name) != name:
        raise UsageError(f"topic {topic}: {name!r} cannot be the name of a sensor; try {safe_name(name)!r}")
    return kind


def _identity(name: str, topic: str) -> int:
    if not (name.isascii() and name.isdigit() and len(name) <= 10 and int(name) < 2**31):
        raise UsageError(
            f"topic {topic}: holds true positions; name it by the number of its (first) target, for example 0={topic}",
            id="camera-not-named",
        )
    return int(name)


def base_of(topic: str) -> str:
    """Image topic without its transport suffix: /cam/image_raw/compressed becomes /cam/image_raw."""
    head, _, last = topic.rpartition("/")
    return head if last in TRANSPORTS and head else topic


def is_rectified(topic: str) -> bool:
    """Whether the last part of an image topic's name (without transport suffix) contains `rect`."""
    return "rect" in base_of(topic).rpartition("/")[2]


def _one_of_each(images: Iterable[str], topics: Mapping[str, BagTopic]) -> list[str]:
    """One image topic of each namespace, sorted.

    It is the one with most messages; among equals, one of raw images rather than rectified ones, then a compressed one.
    `topics` has the numbers of messages.
    """
    groups: dict[str, list[str]] = {}
    for topic in images:
        groups.setdefault(base_of(topic).rpartition("/")[0] or topic, []).append(topic)

    def rank(topic: str) -> tuple[int, bool, bool, str]:
        return (-(topics[topic].messages or 0), is_rectified(topic), base_of(topic) == topic, topic)

    return sorted(min(group, key=rank) for group in groups.values())


def name_cameras(images: Sequence[str]) -> dict[str, str]:
    """Topic by name of the camera, for the image topics `images`.

    The name is the last meaningful part of the topic, with as many preceding parts as distinguish the cameras.
    UsageError if two cameras get one name.
    """
    parts = {topic: _telling(topic) for topic in images}
    for depth in range(1, 1 + max((len(p) for p in parts.values()), default=0)):
        names = {topic: "_".join(p[-depth:]) for topic, p in parts.items()}
        if len(set(names.values())) == len(names):
            break
    else:
        names = {topic: topic.strip("/").replace("/", "_") for topic in images}
    found: dict[str, str] = {}
    for topic, name in names.items():
        safe = safe_name(name.strip() or "camera")
        if safe in found:
            raise UsageError(
                f"topics {found[safe]} and {topic} would both be camera {safe!r}; name them: "
                f"{option('topic')} {safe[:60]}_1={found[safe]} {option('topic')} {safe[:60]}_2={topic}",
                id="duplicate-name",
            )
        found[safe] = topic
    return found


def _telling(topic: str) -> list[str]:
    parts = [part for part in topic.split("/") if part]
    while len(parts) > 1 and parts[-1] in (*TRANSPORTS, *PLAIN):
        parts.pop()
    return parts or ["camera"]


def _info_of(image: str, infos: Sequence[str]) -> str | None:
    """Calibration topic among `infos` that belongs to an image topic; None if there is none.

    It is `/cam/camera_info` for `/cam/image_raw`, or the only one of the namespace.
    """
    space = base_of(image).rpartition("/")[0]
    same_namespace = [t for t in infos if t.rpartition("/")[0] == space]
    exact = [t for t in same_namespace if t.rpartition("/")[2] == "camera_info"]
    return exact[0] if exact else (same_namespace[0] if len(same_namespace) == 1 else None)


def _info_above(boxes: str, infos: Sequence[str], cameras: int) -> str | None:
    """Calibration topic among `infos` that belongs to a box topic; None if there is none.

    It is that of the nearest enclosing namespace: `/cam/camera_info` for `/cam/yolo/boxes`. If the bag has one
    calibration and one box topic (`cameras` = 1), these belong together, wherever they are.
    """
    spaces = {t.rpartition("/")[0]: t for t in sorted(infos, reverse=True)}
    parts = boxes.split("/")
    above = ("/".join(parts[:n]) for n in range(len(parts) - 1, 1, -1))
    found = next((spaces[space] for space in above if space in spaces), None)
    return infos[0] if found is None and len(infos) == cameras == 1 else found


def _boxes_alone(boxes: Sequence[str], topics: Mapping[str, BagTopic], infos: Sequence[str]) -> dict[str, str]:
    """Box topic by name of the camera, for a bag without images: for each calibration the topic with most messages.

    Args:
        boxes: box topics.
        topics: topics of the bag, with their numbers of messages.
        infos: calibration topics.
    """
    groups: dict[str, list[str]] = {}
    for topic in boxes:
        groups.setdefault(_info_above(topic, infos, len(boxes)) or topic, []).append(topic)
    best = {owner: min(group, key=lambda t: (-(topics[t].messages or 0), t)) for owner, group in groups.items()}
    return {name: best[owner] for name, owner in name_cameras(sorted(best)).items()}


def _named_by_path(topics: Sequence[str]) -> dict[str, str]:
    """Topic of directions by name of the array: the parts of its path but ODAS' own, joined by `_`; or else odas.

    `/lab/mic1/odas/sst` is lab_mic1, and `/sst` is odas.

    InputError if two topics give one name.
    """
    out: dict[str, str] = {}
    for topic in topics:
        parts = [p for p in topic.split("/") if p and p not in ("odas", "sst", "ssl", "odas_server_node")]
        name = safe_name("_".join(parts).strip() or "odas")
        if name in out:
            raise InputError(
                f"topics {out[name]} and {topic}: both hold directions of {name}; name one: {option('topic')} "
                f"{name}={topic}",
                id="ambiguous-input",
            )
        out[name] = topic
    return out
