"""Small bags in SQLite whose tables have rows without end, or rows of gigabytes: each is refused in one line."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import pytest
from apart import check_apart

from occlog.errors import ExitCode

TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
TOPIC = "INSERT INTO topics VALUES(1, '/a', 'sensor_msgs/msg/CompressedImage', 'cdr');"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
CASES = {
    "messages without end": (
        f"{TOPICS}{TOPIC}CREATE VIEW messages AS {ENDLESS} SELECT i id, 1 topic_id, i timestamp, x'00' data FROM n;",
        "messages is no plain table",
    ),
    "topics without end": (
        f"{MESSAGES}CREATE VIEW topics AS {ENDLESS} SELECT i id, '/' || i name, 'x' type, 'cdr' "
        "serialization_format FROM n",
        "topics is no plain table",
    ),
    "a message of a gigabyte": (
        TOPICS + TOPIC + "CREATE VIEW messages AS SELECT 1 id, 1 topic_id, 1 timestamp, zeroblob(900000000) data;",
        "messages is no plain table",
    ),
    "computed data": (
        f"{TOPICS}{TOPIC}CREATE TABLE messages(id, topic_id, timestamp, data AS (zeroblob(900000000)));"
        "INSERT INTO messages VALUES(1, 1, 1);",
        "messages is no plain table",
    ),
}


@pytest.mark.parametrize(("script", "words"), CASES.values(), ids=CASES)
def test_tables_that_make_up_their_rows_are_refused(tmp_path: Path, script: str, words: str) -> None:
    path = tmp_path / "a.db3"
    with closing(sqlite3.connect(path)) as base:
        base.executescript(script)
    outcome = check_apart("info", path)
    assert (outcome.code, outcome.output.strip().count("\n")) == (ExitCode.BAD_INPUT, 0)
    assert words in outcome.output


def looped(path: Path, depth: int) -> None:
    """A bag of ten kilobytes, in which pages of the table of messages refer to one page again and again."""
    size = 512
    with closing(sqlite3.connect(path)) as base:
        base.executescript(f"PRAGMA page_size = {size};{TOPICS}{TOPIC}{MESSAGES}")
        rows = [(n, n, bytes(8)) for n in range(300)]
        base.executemany("INSERT INTO messages VALUES(?, 1, ?, ?)", rows)
        base.commit()
        (root,) = base.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    data = bytearray(path.read_bytes())
    top = bytes(data[(root - 1) * size : root * size])
    cells = [struct.unpack_from(">H", top, 12 + 2 * n)[0] for n in range(struct.unpack_from(">H", top, 3)[0])]

    def of_one(child: int) -> bytes:
        page = bytearray(top)
        for place in (8, *cells):
            struct.pack_into(">I", page, place, child)
        return bytes(page)

    (child,) = struct.unpack_from(">I", top, cells[0])
    for _ in range(depth):
        data += of_one(child)
        child = len(data) // size
    data[(root - 1) * size : root * size] = of_one(child)
    struct.pack_into(">I", data, 28, child)
    path.write_bytes(data)


def test_pages_that_refer_to_one_page_are_not_read_without_end(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    looped(path, 8)
    outcome = check_apart("info", path)
    assert outcome.code == ExitCode.DONE
    assert "damaged SQLite file: the rest cannot be read" in outcome.output
