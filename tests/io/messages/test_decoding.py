"""Definitions of types in bags: how long they may be, and that topics share what is made for them."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from occlog.errors import InputError
from occlog.io.messages import kinds as decoding
from occlog.io.messages.kinds import LONGEST_DEFINITION, decoder
from occlog.io.messages.mcap_file import BagTopic

pytest.importorskip("rosbags")
FIELDS = b"float64 x\n"
HALF = b"\x00\x01\x00\x00" + b"\x00\x00\x00\x00\x00\x00\xe0?"
"""A message of little-endian CDR with one number, 0.5."""


def topic(definition: bytes, name: str = "/a") -> BagTopic:
    return BagTopic(name, "made_msgs/msg/Point", "cdr", definition, "ros2msg", None)


def test_a_definition_may_be_as_long_as_the_limit() -> None:
    """One byte more is refused: the parser of definitions takes seconds for a megabyte."""
    longest = FIELDS + b"#" * (LONGEST_DEFINITION - len(FIELDS))
    assert decoder(topic(longest))(HALF).x == 0.5
    with pytest.raises(InputError, match=rf"/a: .*{LONGEST_DEFINITION + 1} bytes \(at most {LONGEST_DEFINITION}"):
        decoder(topic(longest + b"#"))


def nested(*fields: bytes) -> bytes:
    """A definition of 40 types within one another, each of which has the next one in some fields; the last one last."""
    line = b"\n" + b"=" * 80 + b"\nMSG: made_msgs/T%d\n"
    inner = [line % n + b"".join(field % (n + 1) for field in fields[:-1]) for n in range(40)]
    return b"made_msgs/T0 x\n" + b"".join(inner) + line % 40 + fields[-1]


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        (b"string[10001] x\n", "x: an array of 10001 entries"),
        (b"string[5001] x\nstring[5000] y\n", "y: an array of 5000 entries"),
        (nested(b"made_msgs/T%d[1000] x\n", b"uint8 x\n"), "x: an array of 1000 entries"),
        (nested(b"made_msgs/T%d x\n", b"made_msgs/T%d y\n", b"uint8[0] x\n"), "x: an array of 0 entries"),
        (nested(b"made_msgs/T%d x\n", b"made_msgs/T%d y\n", b""), "made_msgs/msg/T40 has no fields"),
    ],
)
def test_types_that_take_memory_or_time_without_bytes_are_refused(definition: bytes, words: str) -> None:
    with pytest.raises(InputError, match=rf"/a: .*its definition cannot be read \({words}"):
        decoder(topic(definition))


OTHER = b"uint8 x\n" + b"=" * 80 + b"\nMSG: %s\nuint8 y\n"


@pytest.mark.parametrize(
    ("definition", "words"),
    [
        (OTHER % b"999/Header", "999/msg/Header is no name of a type"),
        (OTHER % b"made_msgs/9", "made_msgs/msg/9 is no name"),
        (OTHER % b"/a", "/msg/a is no name"),
        (OTHER % b"_/_", "_/msg/_ is no name"),
        (b"uint8 x\nfloat32 MOST=1e999\n", "made_msgs/msg/Point has a constant that is not finite"),
    ],
)
def test_names_and_constants_that_no_code_can_have_are_refused(definition: bytes, words: str) -> None:
    """Code is generated of definitions."""
    with pytest.raises(InputError, match=rf"/a: .*its definition cannot be read \({words}"):
        decoder(topic(definition))


def test_names_that_mean_something_in_code_are_names() -> None:
    names = ("class", "self", "pos", "rawdata", "typestore", "numpy", "cls", "message", "values")
    fields = b"".join(b"uint8 %s\n" % name.encode() for name in names)
    found = decoder(topic(fields))(b"\x00\x01\x00\x00" + bytes(range(len(names))))
    assert [getattr(found, name, None) or getattr(found, f"{name}_", 0) for name in names] == list(range(len(names)))
    for other in (b"T/T", b"builtins/exec"):
        assert decoder(topic(OTHER % other)) is not None
    text = b"""string TEXT=' \"\"\" {x} %s \\x00"""
    assert decoder(topic(b"uint8 x\nbool TRUE=1\nint64 LEAST=-9223372036854775808\n" + text + b"\n")) is not None


def test_arrays_may_have_as_many_entries_as_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "MAX_ENTRIES", 50)
    assert decoder(topic(b"float64[1] x\nfloat64[100000] y\nstring[50] z\n")) is not None


def test_topics_of_one_name_and_other_definitions_are_decoded_by_their_own() -> None:
    first, second = decoder(topic(b"float64 x\n")), decoder(topic(b"float64 y\n", "/b"))
    assert first(HALF).x == second(HALF).y == 0.5
    assert not hasattr(second(HALF), "x")


def test_messages_with_lists_have_a_length(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "MAX_LISTED_BYTES", 100)
    part = b"\n" + b"=" * 80 + b"\nMSG: made_msgs/Part\nuint8 y\n"
    for length, data in ((92, True), (93, False)):
        message = b"\x00\x01\x00\x00" + length.to_bytes(4, "little") + bytes(length)
        assert len(decoder(topic(b"uint8[] x\n"))(message).x) == length  # numbers take what they take
        with nullcontext() if data else pytest.raises(ValueError, match="with lists has 101 bytes, limit 100"):
            assert len(decoder(topic(b"made_msgs/Part[] x\n" + part))(message).x) == length
    with pytest.raises(ValueError, match="with lists has 101 bytes"):
        decoder(topic(b"string[] x\n"))(bytes(101))
    for name, kind in (("FrameTransforms", "protobuf"), ("FrameTransform", "json")):
        decode = decoder(BagTopic("/a", f"foxglove.{name}", kind, b"", "", None))
        bad = b"\x0a\x00" * 51 if kind == "protobuf" else b'{"a":[' + b",".join([b"{}"] * 99_999) + b"]}"
        with pytest.raises(ValueError, match=r"with lists has 102 bytes|100001 objects and lists"):
            decode(bad)
        decode(bad[:100] if kind == "protobuf" else bad.replace(b"{},", b"", 1))
