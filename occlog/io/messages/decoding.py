"""Bytes of messages to objects with the fields of their types: CDR of ROS 2, protobuf of Foxglove, JSON.

CDR needs the package rosbags (extra `ros2`), which also knows the types of ROS for old bags that do not define them.
"""

from __future__ import annotations

import importlib
import json
import math
import re
import struct
from collections.abc import Callable
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from google.protobuf.message import DecodeError

from occlog.errors import InputError, UsageError

from .mcap_file import Topic

Decode = Callable[[bytes], Any]
"""Bytes of a message to an object whose attributes are the message's fields."""
FAILURES = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    DecodeError,
    LookupError,
    MemoryError,
    TypeError,
    ValueError,
    struct.error,
)
"""What decoders raise for bytes that are not such a message."""
LISTS = ("FrameTransforms", "PosesInFrame")
"""Types of Foxglove that have lists of others."""
INSTALL = "pip install 'occlog[ros2]'"
LONGEST_DEFINITION = 128 << 10
"""Bytes of a definition of ROS that is read, which takes about two seconds; types of ROS itself have a few thousand."""
MOST_ENTRIES = 10_000
"""Entries, but for numbers, of all arrays whose length a definition gives."""
MAX_LISTED_BYTES = 4 << 20
"""Bytes of a message with lists of texts or types: each entry of a byte takes a hundred in memory."""
MAX_OBJECTS = 100_000
"""Objects and lists of a message in JSON: each takes 400 bytes in memory."""
_LINE = "=" * 80 + "\n"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)+")
"""Of a type: its package, perhaps `msg`, and its own."""


def decoder(topic: Topic) -> Decode:
    """How messages of a topic are decoded.

    Raises:
        UsageError: they need a package that is not installed.
        InputError: their encoding or the definition of their type is not known.
    """
    if topic.encoding == "cdr":
        return _cdr(topic)
    if topic.encoding == "protobuf" and topic.kind.startswith("foxglove."):
        return _foxglove(topic)
    if topic.encoding == "json":
        return _json
    raise InputError(
        f"topic {topic.name}: messages of type {topic.kind or '(none)'} in the encoding {topic.encoding!r} cannot be "
        "read; known: cdr, json, and protobuf of foxglove's types"
    )


def _json(data: bytes) -> object:
    if (objects := data.count(b"{") + data.count(b"[")) > MAX_OBJECTS:
        raise ValueError(f"{objects} objects and lists in a message of JSON; at most {MAX_OBJECTS} are read")
    return json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))


def _foxglove(topic: Topic) -> Decode:
    name = topic.kind.removeprefix("foxglove.")
    try:
        module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
    except ImportError:
        raise InputError(f"topic {topic.name}: type {topic.kind} is not known") from None
    message: Any = getattr(module, name)
    listed = name in LISTS

    def decode(data: bytes) -> object:
        if listed:
            _check_listed(data)
        return message.FromString(data)

    return decode


def _check_listed(data: bytes) -> None:
    if len(data) > MAX_LISTED_BYTES:
        raise ValueError(f"a message with lists of {len(data)} bytes; at most {MAX_LISTED_BYTES} are read")


def _cdr(topic: Topic) -> Decode:
    """Decoder of CDR by the definition in the bag, or by the newest one of ROS where the bag has none."""
    try:
        types = importlib.import_module("rosbags.typesys")
        serde = importlib.import_module("rosbags.serde")
    except ImportError:
        raise UsageError(
            f"topic {topic.name}: messages of ROS 2 want the package rosbags, which is not installed; {INSTALL}"
        ) from None
    if len(topic.definition) > LONGEST_DEFINITION:
        raise InputError(
            f"topic {topic.name}: type {topic.kind}: its definition has {len(topic.definition)} bytes; at most "
            f"{LONGEST_DEFINITION} are read"
        )
    try:
        store, listed = _types(topic.kind, topic.language, topic.definition)
    except (*FAILURES, types.TypesysError, RecursionError) as error:
        reason = " ".join(str(error).split())[:80]
        what = "its definition cannot be read" if topic.definition else "the bag does not define it, nor does ROS"
        raise InputError(f"topic {topic.name}: type {topic.kind}: {what} ({reason})") from None

    def decode(data: bytes) -> object:
        if listed:
            _check_listed(data)
        try:
            return store.deserialize_cdr(data, topic.kind)
        except serde.SerdeError as error:
            raise ValueError(str(error)) from None

    return decode


@lru_cache(maxsize=32)
def _types(kind: str, language: str, definition: bytes) -> tuple[Any, bool]:
    """Store of a type of ROS 2, and whether it has lists of texts or types.

    Code is generated for it, which takes milliseconds, and cameras share their types.
    """
    types = importlib.import_module("rosbags.typesys")
    nodes = importlib.import_module("rosbags.interfaces").Nodetype
    store = types.get_typestore(types.Stores.EMPTY if definition else types.Stores.LATEST)
    text = definition.decode("utf-8", "replace")
    if language == "ros2idl":
        parts = [part.split("\n", 1)[1] for part in text.split(_LINE)[1:]] if text.startswith(_LINE) else [text]
        for part in parts:
            store.register(_checked(types.get_types_from_idl(part)))
    elif definition:
        store.register(_checked(types.get_types_from_msg(text, kind)))
    store.get_msgdef(kind)
    told = [field for _, fields in store.fielddefs.values() for _, field in fields] if definition else []
    lists = [of for node, of in told if node == nodes.SEQUENCE]
    listed = any(kind != nodes.BASE or of[0] == "string" for (kind, of), _ in lists)
    return store, listed


def _checked(found: Any) -> Any:
    """Types by name; ValueError where code of them cannot be, or takes memory or time without a byte of a message.

    The code that is generated has the names, the constants, and lines for each entry of an array whose length is given,
    if they are no numbers; and a message may have any number of entries that take no bytes.
    """
    nodes = importlib.import_module("rosbags.interfaces").Nodetype
    entries = 0
    for name, (constants, fields) in found.items():
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name} is no name of a type")
        if not fields:
            raise ValueError(f"{name} has no fields")
        if any(isinstance(value, float) and not math.isfinite(value) for _, _, value in constants):
            raise ValueError(f"{name} has a constant that is no number")
        for field, (node, told) in fields:
            if node == nodes.ARRAY:
                (kind, of), length = told
                entries += length if kind != nodes.BASE or of[0] == "string" else 0
                if length < 1 or entries > MOST_ENTRIES:
                    raise ValueError(f"{field}: {length} entries; 1 to {MOST_ENTRIES} can be")
    return found
