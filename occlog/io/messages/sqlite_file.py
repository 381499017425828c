"""One SQLite file of a ROS 2 bag (.db3), read row by row; a damaged file is read up to the damage."""

from __future__ import annotations

import itertools
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from occlog.errors import InputError
from occlog.io.files.timing.utc import time_words
from occlog.io.recording.chunks import MAX_CHUNK_BYTES
from occlog.records.losses import Loss

from .mcap_file import BagMessage, BagTopic

FREE_STEPS, STEPS_PER_BYTE = 1_000_000, 50
"""Steps of SQLite that a pass through any file may take, and above that for each of its bytes: a row, which has four
bytes or more, takes some ten."""
_STEPS_AT_ONCE = 100_000
_LOGS = {
    "-wal": (b"\x37\x7f\x06\x82", b"\x37\x7f\x06\x83"),
    "-journal": (b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7",),
}
"""First bytes of SQLite logs with pending writes; a finished log is empty, or begins with zeros."""
_LOG_HEAD = 32
_TABLES = ("topics", "messages", "message_definitions")


class SqliteFile:
    """Reader of a .db3 file of a ROS 2 bag, also a damaged one.

    Attributes:
        path: the file.
        name: its name in losses.
        losses: losses found so far, as keys; extended while the file is read.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Read the topics; InputError if the file is not a ROS 2 bag. `name` is the file's name in losses."""
        self.path, self.name = path, name
        self.losses: dict[Loss, None] = {}
        try:
            with closing(self._connect()) as base:
                self._topics = self._read_topics(base)
        except sqlite3.Error as error:
            raise InputError(
                f"{path}: not a ROS 2 bag that can be read ({error}); copy it again", id="damaged-file"
            ) from None
        self._note_side_files()

    def topics(self) -> list[BagTopic]:
        """Topics of the file, with their numbers of messages (None if the file is damaged)."""
        return list(self._topics.values())

    def span(self) -> tuple[int, int] | None:
        """First and last recording time of the messages [ns since the Unix epoch].

        None without messages or if unreadable.
        """
        try:
            with closing(self._connect()) as base:
                low, high = base.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
        except sqlite3.Error:
            return None
        return (low, high) if isinstance(low, int) and isinstance(high, int) else None

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of the given topics in the order of recording; damage ends the reading, and is a loss."""
        wanted = [number for number, topic in self._topics.items() if topic.name in topics]
        if not wanted:
            return
        marks = ", ".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id"
        last = 0
        try:
            with closing(self._connect()) as base:
                for number, log_ns, data in base.execute(query, wanted):
                    # SQLite keeps values of any kind in any column, and `bytes` of a number would be as many zeros
                    if not (isinstance(log_ns, int) and isinstance(data, bytes)):
                        raise ValueError(
                            f"a message has timestamp {log_ns!r:.40} and data {data!r:.40}; an integer and bytes "
                            "were expected"
                        )
                    last = log_ns
                    yield BagMessage(self._topics[number].name, last, data)
        except (sqlite3.Error, ValueError) as error:
            location = f"after {time_words(last)}" if last else "first message"
            self.losses[Loss(self.name, location, f"damaged SQLite file: the rest cannot be read ({error})")] = None

    def _note_side_files(self) -> None:
        """Add a loss if a SQLite log next to the file has writes of an interrupted recorder that the file lacks."""
        for ending, magics in _LOGS.items():
            log = self.path.with_name(self.path.name + ending)
            if log.is_file():
                with log.open("rb") as file:
                    begins = file.read(_LOG_HEAD + 1)
                if len(begins) > _LOG_HEAD and begins.startswith(magics):
                    remedy = f"let SQLite put it right: sqlite3 {self.name} 'PRAGMA journal_mode = DELETE'"
                    what = f"its last writes are in {log.name}, which was not read; {remedy}"
                    self.losses[Loss(self.name, "end", what)] = None

    def _connect(self) -> sqlite3.Connection:
        # Immutable: nothing is written next to the file, not even a lock.
        base = sqlite3.connect(f"file:{quote(str(self.path.resolve()))}?mode=ro&immutable=1", uri=True)
        # SQLite refuses all of a file that has become shorter, unless its tables may be wrong.
        base.execute("PRAGMA writable_schema = ON")
        # Pages that refer to each other, and views that never end, are rows without end in a small file
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        left = FREE_STEPS + STEPS_PER_BYTE * self.path.stat().st_size
        rounds = itertools.count()
        base.set_progress_handler(lambda: next(rounds) * _STEPS_AT_ONCE > left, _STEPS_AT_ONCE)
        return base

    def _check_tables(self, base: sqlite3.Connection) -> None:
        """InputError if a table of the bag is a view or has computed columns, which could yield rows without end."""
        marks = ", ".join("?" * len(_TABLES))
        for kind, name, sql in base.execute(
            f"SELECT type, name, sql FROM sqlite_master WHERE name IN ({marks})", _TABLES
        ):
            hidden = base.execute("SELECT 1 FROM pragma_table_xinfo(?) WHERE hidden", (name,)).fetchone()
            if kind != "table" or hidden or str(sql).upper().split()[:2] != ["CREATE", "TABLE"]:
                raise InputError(
                    f"{self.path}: {name} is no plain table, as it is in bags of ROS 2; copy the bag again",
                    id="damaged-file",
                )

    def _read_topics(self, base: sqlite3.Connection) -> dict[int, BagTopic]:
        self._check_tables(base)
        definitions: dict[str, tuple[str, str]] = {}
        if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
            rows = base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            definitions = {str(kind): (str(language), str(text)) for kind, language, text in rows}
        try:
            counts = dict(base.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        except sqlite3.DatabaseError:
            counts = None
        out: dict[int, BagTopic] = {}
        for number, name, kind, encoding in base.execute("SELECT id, name, type, serialization_format FROM topics"):
            if not (isinstance(number, int) and all(isinstance(each, str) for each in (name, kind, encoding))):
                listed = ", ".join(f"{each!r:.40}" for each in (number, name, kind, encoding))
                self.losses[Loss(self.name, "topics", f"a topic without a number, a name or a type ({listed})")] = None
                continue
            language, text = definitions.get(kind, ("", ""))
            messages = None if counts is None else int(counts.get(number, 0))
            out[number] = BagTopic(name, kind, encoding, text.encode(), language, messages)
        return out
