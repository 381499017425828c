"""Copies of recordings: of other programs, without an index, and what is left when copying fails."""

import pytest
from mcap.reader import NonSeekingReader
from mcap.writer import IndexType, Writer

from occlog.errors import InputError, OutputExistsError
from occlog.io.files.provenance import Provenance
from occlog.io.recording.copy import copy_recording
from occlog.io.recording.reader import open_recording

MADE = Provenance("epipolar", {})


def external_table(path, indexes):
    """A recording of another program: its own schema, metadata, sequence numbers, messages out of order."""
    with path.open("wb") as file:
        writer = Writer(file, index_types=indexes, chunk_size=200)
        writer.start(profile="ros2", library="other")
        schema = writer.register_schema("a/B", "ros2msg", b"int8 x")
        one = writer.register_channel("/one", "cdr", schema, {"qos": "best"})
        two = writer.register_channel("/two", "raw", 0)
        for n in range(50):
            t_ns = 1000 + 10 * (n ^ 1)
            writer.add_message(one if n % 3 else two, t_ns, bytes([n]) * 9, t_ns - 1, 900 + n)
        writer.add_attachment(5, 6, "map.png", "image/png", b"123")
        writer.add_metadata("trip", {"driver": "x"})
        writer.finish()


def content(path):
    with path.open("rb") as file:
        found = [
            (
                c.topic,
                c.message_encoding,
                c.metadata,
                s and (s.name, s.encoding, s.data),
                m.log_time,
                m.publish_time,
                m.sequence,
                m.data,
            )
            for s, c, m in NonSeekingReader(file).iter_messages(log_time_order=False)
        ]
    with path.open("rb") as file:
        attached = [(a.create_time, a.name, a.media_type, a.data) for a in NonSeekingReader(file).iter_attachments()]
    with path.open("rb") as file:
        return found, attached, [(m.name, m.metadata) for m in NonSeekingReader(file).iter_metadata()]


@pytest.mark.parametrize("indexes", [IndexType.ALL, IndexType.NONE])
def test_everything_of_another_program_is_kept(tmp_path, indexes):
    external_table(tmp_path / "a.mcap", indexes)
    source = open_recording(tmp_path / "a.mcap")
    assert copy_recording(source, tmp_path / "b.mcap", {"epipolar.json": b"{}"}, MADE) == 50
    old, new = content(tmp_path / "a.mcap"), content(tmp_path / "b.mcap")
    assert sorted(new[0], key=lambda m: m[6]) == sorted(old[0], key=lambda m: m[6])
    assert [m[4] for m in new[0]] == [m[4] for m in old[0]]
    assert new[1] == [*old[1], (0, "epipolar.json", "application/json", b"{}")]
    assert new[2] == old[2]
    copied = open_recording(tmp_path / "b.mcap")
    assert copied.ours is False
    assert copied.attachment("epipolar.json") == b"{}"


def test_a_damaged_recording_leaves_nothing(tmp_path):
    external_table(tmp_path / "a.mcap", IndexType.ALL)
    source = open_recording(tmp_path / "a.mcap")
    raw = bytearray((tmp_path / "a.mcap").read_bytes())
    middle = len(raw) // 3
    raw[middle : middle + 4] = bytes(b ^ 255 for b in raw[middle : middle + 4])
    (tmp_path / "a.mcap").write_bytes(bytes(raw))
    with pytest.raises(InputError, match=r"a\.mcap"):
        copy_recording(source, tmp_path / "b.mcap", {}, MADE)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_nothing_is_overwritten_unasked(tmp_path):
    external_table(tmp_path / "a.mcap", IndexType.ALL)
    source = open_recording(tmp_path / "a.mcap")
    (tmp_path / "b.mcap").write_text("mine")
    with pytest.raises(OutputExistsError):
        copy_recording(source, tmp_path / "b.mcap", {}, MADE)
    assert (tmp_path / "b.mcap").read_text() == "mine"
