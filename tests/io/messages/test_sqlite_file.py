"""SQLite files of bags, whose columns may hold values of any kind, whatever is declared."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from occlog.io.messages.sqlite_file import SqliteFile

TOPICS = [(1, "/a", "std_msgs/msg/String", "cdr"), (2, "/b", "std_msgs/msg/String", "cdr")]
ROWS = [(1, 10, b"one"), (2, 20, b"two"), (1, 30, b"three")]


def written(path: Path, topics: list[tuple[object, ...]], rows: list[tuple[object, ...]]) -> SqliteFile:
    """A file whose tables declare nothing."""
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE topics(id, name, type, serialization_format)")
        base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        base.executemany("INSERT INTO topics VALUES(?, ?, ?, ?)", topics)
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
        base.commit()
    return SqliteFile(path, path.name)


def test_messages_come_in_the_order_of_recording(tmp_path: Path) -> None:
    file = written(tmp_path / "b.db3", [*TOPICS], [*ROWS])
    assert [(t.name, t.messages) for t in file.topics()] == [("/a", 2), ("/b", 1)]
    assert list(file.messages(["/a", "/b"])) == [("/a", 10, b"one"), ("/b", 20, b"two"), ("/a", 30, b"three")]
    assert [m.data for m in file.messages(["/b"])] == [b"two"]
    assert file.span() == (10, 30)
    assert not file.losses


@pytest.mark.parametrize(
    "bad", [(None, "/c", "x", "cdr"), ("3", "/c", "x", "cdr"), (3, None, "x", "cdr"), (3, "/c", b"x", "cdr")]
)
def test_a_topic_that_is_none_is_a_loss_and_the_others_are_read(tmp_path: Path, bad: tuple[object, ...]) -> None:
    file = written(tmp_path / "b.db3", [bad, *TOPICS], [*ROWS])
    assert [t.name for t in file.topics()] == ["/a", "/b"]
    (loss,) = file.losses
    assert (loss.source, loss.place) == ("b.db3", "topics")
    assert "without a number, a name or a type" in loss.what


@pytest.mark.parametrize("bad", [(1, "25", b"x"), (1, 25.5, b"x"), (1, None, b"x"), (1, 25, "x"), (1, 25, 10**15)])
def test_a_message_of_another_kind_ends_what_is_read(tmp_path: Path, bad: tuple[object, ...]) -> None:
    """A number for the data would be as many bytes of zeros, which would take all memory."""
    file = written(tmp_path / "b.db3", [*TOPICS], [ROWS[0], bad, ROWS[1]])
    assert [m.data for m in file.messages(["/a", "/b"])] == [b"one"]
    (loss,) = file.losses
    assert loss.place == "after 0.00000001 s"
    assert "the rest cannot be read" in loss.what


def test_times_that_are_no_numbers_are_no_span(tmp_path: Path) -> None:
    assert written(tmp_path / "b.db3", [*TOPICS], [(1, "later", b"x")]).span() is None
