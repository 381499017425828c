"""Definitions of types in bags: how long they may be, and that topics share what is made for them."""

from __future__ import annotations

import pytest

from occlog.errors import InputError
from occlog.io.messages.decoding import LONGEST_DEFINITION, decoder
from occlog.io.messages.mcap_file import Topic

pytest.importorskip("rosbags")
FIELDS = b"float64 x\n"
HALF = b"\x00\x01\x00\x00" + b"\x00\x00\x00\x00\x00\x00\xe0?"
"""A message of little-endian CDR with one number, 0.5."""


def topic(definition: bytes, name: str = "/a") -> Topic:
    return Topic(name, "made_msgs/msg/Point", "cdr", definition, "ros2msg", None)


def test_a_definition_may_be_as_long_as_the_limit() -> None:
    """One byte more is refused: the parser of definitions takes seconds for a megabyte."""
    longest = FIELDS + b"#" * (LONGEST_DEFINITION - len(FIELDS))
    assert decoder(topic(longest))(HALF).x == 0.5
    with pytest.raises(InputError, match=f"/a: .*{LONGEST_DEFINITION + 1} bytes; at most {LONGEST_DEFINITION}"):
        decoder(topic(longest + b"#"))


def test_topics_of_one_name_and_other_definitions_are_decoded_by_their_own() -> None:
    first, second = decoder(topic(b"float64 x\n")), decoder(topic(b"float64 y\n", "/b"))
    assert first(HALF).x == second(HALF).y == 0.5
    assert not hasattr(second(HALF), "x")
