"""Files of a bag: which belong to it, what was written last, and how they are packed."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import zstandard

from occlog.errors import InputError
from occlog.io.files.limits import FREE_BYTES
from occlog.io.messages.bag import open_bag
from occlog.io.messages.mcap_file import unpack_frames
from occlog.io.recording.chunks import MAX_CHUNK_BYTES

TABLES = """CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/String', 'cdr');
"""
ADD = "INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)"


def written(path: Path, *rows: bytes, first: int = 0) -> Path:
    with closing(sqlite3.connect(path)) as base:
        base.executescript(TABLES)
        base.executemany(ADD, list(enumerate(rows, first)))
        base.commit()
    return path


def packed(data: bytes, stated: bool = True) -> bytes:
    return zstandard.ZstdCompressor(write_content_size=stated).compress(data)


def read(*paths: Path) -> tuple[list[bytes], list[str]]:
    """Data of the messages, and what was lost."""
    with open_bag(paths) as bag:
        found = [message.data for message in bag.messages(["/a"])]
        return found, [str(loss) for loss in bag.losses]


def test_a_file_that_the_metadata_do_not_name_is_reported(tmp_path: Path) -> None:
    """A recorder that was killed, or a copy that was interrupted, leaves such a folder."""
    for number in range(3):
        written(tmp_path / f"b_{number}.db3", b"%d" % number, first=number)
    metadata = tmp_path / "metadata.yaml"
    metadata.write_text("rosbag2_bagfile_information: {relative_file_paths: [b_0.db3, b_1.db3]}\n")
    found, lost = read(tmp_path)
    assert found == [b"0", b"1"]
    assert lost == [
        "b_2.db3: whole file: metadata.yaml does not name it, and it was not read; remove metadata.yaml to take it"
    ]
    metadata.unlink()
    assert read(tmp_path) == ([b"0", b"1", b"2"], [])


def test_files_follow_each_other_by_their_times(tmp_path: Path) -> None:
    files = [written(tmp_path / f"b_{number}.db3", b"%d" % number, first=number) for number in (9, 10, 2)]
    assert read(*files) == ([b"2", b"9", b"10"], [])


def test_a_file_that_is_cut_off_stays_where_it_is(tmp_path: Path) -> None:
    """Its times cannot be stated before it is read, which is as far as it goes."""
    whole = written(tmp_path / "b_0.db3", b"0")
    cut = written(tmp_path / "b_1.db3", *[bytes(3000)] * 20, first=1)
    cut.write_bytes(cut.read_bytes()[:30000])
    found, lost = read(whole, cut)
    assert found[0] == b"0"
    assert 1 < len(found) < 21
    assert len(lost) == 1


@pytest.mark.parametrize("listed", [True, False])
def test_a_file_that_is_there_unpacked_too_is_read_once(tmp_path: Path, listed: bool) -> None:
    """rosbag2 unpacks files next to the packed ones when it plays them."""
    base = written(tmp_path / "b_0.db3", b"one", b"two")
    (tmp_path / "b_0.db3.zstd").write_bytes(packed(base.read_bytes()))
    if listed:
        text = "rosbag2_bagfile_information: {relative_file_paths: [b_0.db3.zstd]}\n"
        (tmp_path / "metadata.yaml").write_text(text)
    assert read(tmp_path) == ([b"one", b"two"], [])


@pytest.mark.parametrize(("mode", "log"), [("WAL", "b.db3-wal"), ("DELETE", "b.db3-journal")])
def test_writes_that_are_still_next_to_the_file_are_reported(tmp_path: Path, mode: str, log: str) -> None:
    made = tmp_path / "made"
    made.mkdir()
    base = written(made / "b.db3", b"one")
    with closing(sqlite3.connect(base, isolation_level=None)) as kept:
        kept.execute(f"PRAGMA journal_mode = {mode}")
        kept.execute("PRAGMA cache_size = 1")
        kept.execute("BEGIN")
        kept.executemany(ADD, [(n, bytes(9000)) for n in range(1, 9)])
        if mode == "WAL":
            kept.execute("COMMIT")
        left = shutil.copytree(made, tmp_path / "left")  # as a kill leaves it
    _, (lost,) = read(left / "b.db3")
    assert f"its last writes are in {log}, which was not read; let SQLite put it right" in lost
    with closing(sqlite3.connect(left / "b.db3")) as mended:
        mended.execute("PRAGMA journal_mode = DELETE")
    found, lost_then = read(left / "b.db3")
    assert (len(found), lost_then) == (9 if mode == "WAL" else 1, [])


@pytest.mark.parametrize("log", [b"", bytes(40)])
def test_logs_that_are_done_are_not_stated(tmp_path: Path, log: bytes) -> None:
    base = written(tmp_path / "b.db3", b"one")
    for ending in ("wal", "journal"):
        base.with_name(f"b.db3-{ending}").write_bytes(log)
    assert read(base) == ([b"one"], [])


def test_a_file_packed_in_several_frames_is_read_to_its_end(tmp_path: Path) -> None:
    """zstd makes such files of pieces that are put one behind the other."""
    data = written(tmp_path / "b.db3", *(b"%d" % n for n in range(999))).read_bytes()
    path = tmp_path / "c.db3.zstd"
    path.write_bytes(packed(data[:5000]) + packed(data[5000:], stated=False))
    found, lost = read(path)
    assert (len(found), lost) == (999, [])
    path.write_bytes(packed(data) + b"more")
    found, lost = read(path)
    assert len(found) == 999
    assert len(lost) == 1
    assert f"after {len(data)} unpacked bytes: damaged zstd" in lost[0]


def test_a_packed_file_of_which_nothing_is_left_says_so(tmp_path: Path) -> None:
    path = tmp_path / "c.db3.zstd"
    path.write_bytes(packed(written(tmp_path / "b.db3", b"one").read_bytes())[:-5])
    with pytest.raises(
        InputError, match=r"c\.db3\.zstd: nothing of it can be unpacked: its zstd is cut off or damaged"
    ):
        open_bag([path])


def test_messages_packed_by_a_stream_are_read(tmp_path: Path) -> None:
    """Such a stream does not know at its beginning how long the message is, and leaves its size out."""
    data = os.urandom(3000)
    base = written(tmp_path / "b.db3", packed(data, stated=False), packed(data), packed(data) + b"more")
    found, lost = read(base)
    assert found == [data, data]
    assert len(lost) == 1
    assert "0.000000002 s: damaged compressed message" in lost[0]


def test_packed_messages_unpack_to_a_thousand_times_their_file_at_most(tmp_path: Path) -> None:
    large = packed(bytes(MAX_CHUNK_BYTES // 2))
    base = written(tmp_path / "b.db3", *[large] * 3)
    with pytest.raises(
        InputError, match=f"b.db3: the compressed messages of a file of .* more than {FREE_BYTES} bytes"
    ):
        read(base)


SKIPPED = b"\x53\x2a\x4d\x18\x05\0\0\0notes"


def test_data_packed_in_several_frames_or_behind_notes_are_read(tmp_path: Path) -> None:
    whole = packed(b"a" * 300, stated=False) + SKIPPED + packed(os.urandom(300)) + packed(b"") + packed(b"c" * 9)
    base = written(tmp_path / "b.db3", whole, SKIPPED + whole, whole[:-1])
    found, lost = read(base)
    assert [(len(data), data[:1], data[-1:]) for data in found] == [(609, b"a", b"c")] * 2
    assert len(lost) == 1
    assert "damaged compressed message: the frame at byte" in lost[0]
    path = tmp_path / "c.db3.zstd"
    path.write_bytes(SKIPPED + packed(base.read_bytes()))
    assert len(read(path)[0]) == 2


def test_frames_of_a_message_unpack_to_the_limit_together(tmp_path: Path) -> None:
    half = packed(bytes(MAX_CHUNK_BYTES // 2 + 1))
    assert unpack_frames(half, MAX_CHUNK_BYTES)
    with pytest.raises(zstandard.ZstdError, match=f"would unpack to {MAX_CHUNK_BYTES + 2} bytes"):
        unpack_frames(half * 2, MAX_CHUNK_BYTES)


@pytest.mark.parametrize(("named", "there"), [("b_0.db3", "b_0.db3.zstd"), ("b_0.db3.zstd", "b_0.db3")])
def test_metadata_may_name_a_file_without_its_packing(tmp_path: Path, named: str, there: str) -> None:
    data = written(tmp_path / "b.sqlite", b"one").read_bytes()
    (tmp_path / "b.sqlite").unlink()
    (tmp_path / there).write_bytes(packed(data) if there.endswith(".zstd") else data)
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {{relative_file_paths: [{named}]}}\n")
    assert read(tmp_path) == ([b"one"], [])


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (1, []),  # nothing is lost: the remarks say it
        (2, []),
        (5, ["metadata.yaml: /a: messages that it counts are not in the files (it counts 5, and there are 2)"]),
    ],
)
def test_metadata_that_count_other_messages_than_there_are(tmp_path: Path, count: int, expected: list[str]) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    written(folder / "b.db3", b"one", b"two")
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths: [b.db3]\n  topics_with_message_count:\n"
        f"  - {{topic_metadata: {{name: /a}}, message_count: {count}}}\n"
    )
    found, lost = read(folder)
    assert found == [b"one", b"two"]
    assert [line[: len(words)] for line, words in zip(lost, expected, strict=True)] == expected
    with open_bag([folder]) as bag:
        assert len(list(bag.messages(["/a"]))) == 2
        less = "metadata.yaml counts 1 messages, and there are 2, which were read; write it again: ros2 bag reindex"
        assert bag.remarks == ({"/a": less} if count == 1 else {})
    if count == 2:  # another file without metadata next to it
        assert read(folder, written(tmp_path / "c.db3", b"three", first=9))[1] == []
