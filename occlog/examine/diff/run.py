"""Work of `occlog diff`: reads two outputs and compares them: tables, recordings, JSON, other files, folders."""

from __future__ import annotations

import difflib
import fnmatch
import hashlib
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from occlog.array_types import Ints, Strings
from occlog.errors import InputError, UsageError
from occlog.io.files.json_file import read_json
from occlog.io.files.parquet import describe, iter_table
from occlog.io.files.yaml_file import parse_yaml
from occlog.io.frames.codec import image_kind
from occlog.io.open import Content, content_of
from occlog.io.recording.mcap_errors import open_mcap
from occlog.io.recording.reader import Recording, open_recording
from occlog.io.recording.rows import RECORDED, schema_of
from occlog.records.columns import Table, check_order, column
from occlog.records.tables import TABLES

from .json import diff_json
from .result import Comparison, Difference, Tolerances
from .stage import diff_bytes, diff_schemas, diff_tables

STAGES = (
    "scene",
    "truth",
    "recording",
    "views",
    "bearings",
    "occluders",
    "tracks",
    "diagnostics",
    "errors",
    "bound",
    "metrics",
    "report",
)
"""Names of outputs, those of earlier stages first: the first output that differs is nearest to the cause."""
HTML = re.compile(rb"\s*<(!doctype )?html\b", re.IGNORECASE)
"""Beginning of a page."""
RUN_STATE = "run.json"
"""State of `occlog run`: hashes of everything, so it counts as provenance."""
ROWS = 4096
"""Messages in a chunk."""
YAML = (".yaml", ".yml")
NAMED = {".mcap": Content.RECORDING, ".parquet": Content.TABLE}
"""What a file is thought to be whose content has no signature: its reader says what is wrong with it."""


@dataclass(frozen=True)
class DiffSettings:
    """Tolerances, and parts of outputs that count.

    Attributes:
        tolerances: limits of differences.
        provenance: true: how outputs were made counts too.
        pixels: true: frames are compared by their pixels, false: by their encoded bytes.
        exclude: patterns of files that are left out.
    """

    tolerances: Tolerances
    provenance: bool = False
    pixels: bool = False
    exclude: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RecordedMessages(Table):
    """Frames of a recording, and messages of other programs, one a row; never written to a file."""

    NAME: ClassVar[str] = "messages"
    KEY: ClassVar[tuple[str, ...]] = ("t_ns", "topic")

    t_ns: Ints = column("i8", "ns", "time of the message since the Unix epoch")
    topic: Strings = column("U", "1", "topic, or camera for decoded frames")
    number: Ints = column("i8", "1", "sequence number, or number of the frame")
    content: Strings = column("U", "1", "SHA-256 of the content")

    def check(self) -> None:
        """Raise ValueError where times are not in order."""
        check_order(self)


def compare_paths(a: Path, b: Path, settings: DiffSettings) -> list[Comparison]:
    """Compare two files or folders; parts made by earlier stages come first.

    Raises:
        UsageError: a file and a folder, or files of different kinds.
        InputError: a file is missing or damaged.
    """
    for path in (a, b):
        if not path.exists():
            raise InputError(f"{path}: no such file or folder")
    if a.is_dir() != b.is_dir():
        folder, file = (a, b) if a.is_dir() else (b, a)
        raise UsageError(f"{folder} is a folder and {file} is a file; give two of one kind")
    if a.is_dir() and b.is_dir():
        return _compare_folders(a, b, settings)
    kind = kind_of(a)
    if kind != kind_of(b):
        raise UsageError(
            f"{a.name} and {b.name} are of different kinds; give two tables, two recordings, "
            "or two other files with the same ending"
        )
    if kind is Content.TABLE:
        _check_tables(a, b, settings)
    return compare_files(a, b, a.name, settings)


def kind_of(path: Path) -> Content | str:
    """Kind of a file by its content; of one without a signature (text, other formats) the ending of its name."""
    content = content_of(path) if path.stat().st_size else Content.OTHER
    suffix = path.suffix.lower()
    return NAMED.get(suffix, suffix) if content is Content.OTHER else content


def _check_tables(a: Path, b: Path, settings: DiffSettings) -> None:
    """Raise UsageError for tables of two kinds, and for tolerances of columns that they do not have."""
    said_a, said_b = describe(a), describe(b)
    if said_a["schema"] != said_b["schema"]:
        raise UsageError(f"{a} holds {said_a['schema']} and {b} holds {said_b['schema']}; give two tables of one kind")
    names = [c["name"] for c in said_a["columns"]]
    for wanted in settings.tolerances.columns:
        if wanted.rpartition(".")[2] not in names:
            near = difflib.get_close_matches(wanted, names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"columns: {', '.join(names)}"
            raise UsageError(f"--tol {wanted}: {said_a['schema']} has no such column; {hint}")


def stage_order(names: Iterable[str]) -> list[str]:
    """Sort file names: those of earlier stages first, others after them by name."""

    def place(name: str) -> tuple[int, str]:
        stem = name.rsplit("/", maxsplit=1)[-1].split(".")[0].lower()
        found = [n for n, stage in enumerate(STAGES) if stage in stem]
        return (min(found) if found else len(STAGES), name)

    return sorted(names, key=place)


def _compare_folders(a: Path, b: Path, settings: DiffSettings) -> list[Comparison]:
    files_a, files_b = _files(a, settings), _files(b, settings)
    out: list[Comparison] = []
    for name in stage_order(files_a | files_b):
        if name in files_a and name in files_b:
            out += compare_files(a / name, b / name, name, settings)
            continue
        kind = "missing" if name in files_a else "added"
        out.append(Comparison(name, "files", first=Difference(kind, name)))
    return out


def _files(folder: Path, settings: DiffSettings) -> set[str]:
    """Return the relative names of a folder's files, without hidden and excluded ones."""
    found = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    names = {str(p.as_posix()) for p in found if not any(part.startswith(".") for part in p.parts)}
    skipped = settings.exclude if settings.provenance else (*settings.exclude, RUN_STATE)
    return {
        name
        for name in names
        if not any(fnmatch.fnmatch(name, glob) or fnmatch.fnmatch(Path(name).name, glob) for glob in skipped)
    }


def compare_files(a: Path, b: Path, name: str, settings: DiffSettings) -> list[Comparison]:
    """Compare two files, those of different kinds byte by byte; recordings have several parts."""
    kind = kind_of(a)
    if kind != kind_of(b):
        return [diff_bytes(name, _content(a, settings), _content(b, settings))]
    if kind is Content.TABLE:
        return _compare_tables(a, b, name, settings)
    if kind is Content.RECORDING:
        return _compare_recordings(a, b, name, settings)
    if kind == ".json":
        return [diff_json(name, read_json(a), read_json(b), settings.tolerances, settings.provenance)]
    return [_compare_bytes(a, b, name, settings)]


def _compare_tables(a: Path, b: Path, name: str, settings: DiffSettings) -> list[Comparison]:
    said_a, said_b = describe(a), describe(b)
    schema = diff_schemas(name, said_a, said_b)
    if said_a["schema"] not in TABLES:
        raise InputError(f"{a}: unknown table {said_a['schema']!r}; occlog knows {', '.join(TABLES)}")
    if any(found.column != "length_unit" and found.key.get("entry") != "unit" for found in schema):
        # Rows of different tables, or with different columns, cannot be joined.
        found = Comparison(name, "rows", count_a=said_a["rows"], count_b=said_b["rows"], schema=schema)
    else:
        table = TABLES[said_a["schema"]]
        rows = diff_tables(table, iter_table(a, table), iter_table(b, table), settings.tolerances)
        found = replace(rows, name=name, schema=schema)
    if not settings.provenance:
        return [found]
    return [found, _compare_provenance(name, said_a["provenance"], said_b["provenance"])]


def _compare_provenance(name: str, a: object, b: object) -> Comparison:
    return diff_json(f"{name}: provenance", a, b, provenance=True)


def _compare_recordings(a: Path, b: Path, name: str, settings: DiffSettings) -> list[Comparison]:
    left, right = open_recording(a), open_recording(b)
    out = [_compare_attachments(left, right, name, settings)]
    out.append(
        replace(
            diff_tables(RecordedMessages, _frames(left, settings), _frames(right, settings)), name=f"{name}: frames"
        )
    )
    for table in RECORDED:
        if left.has(table) or right.has(table):
            rows = diff_tables(table, left.tables(table), right.tables(table), settings.tolerances)
            out.append(replace(rows, name=f"{name}: {table.NAME}"))
    if settings.provenance:
        out.append(_compare_provenance(name, left.provenance.as_dict(), right.provenance.as_dict()))
    return [found for found in out if found.count_a or found.count_b]


def _compare_attachments(a: Recording, b: Recording, name: str, settings: DiffSettings) -> Comparison:
    """Compare attached files by content (YAML by value, text by line, others by hash), and linked videos."""
    return diff_json(f"{name}: files", _attached(a), _attached(b), settings.tolerances, provenance=True)


def _attached(recording: Recording) -> dict[str, object]:
    out: dict[str, object] = {}
    for name in sorted(recording.attachments):
        data = recording.attachment(name) or b""
        out[name] = _values(name, data)
    videos = {f"video of {sensor}": video.get("sha256", "") for sensor, video in sorted(recording.videos.items())}
    return out | videos


def _values(name: str, data: bytes) -> object:
    """Return the values of YAML, the lines of text, or the hash of any other file."""
    try:
        text = data.decode()
        return parse_yaml(text, name, dict) if name.lower().endswith(YAML) else text.splitlines()
    except InputError:
        return text.splitlines()
    except UnicodeDecodeError:
        return hashlib.sha256(data).hexdigest()


def _frames(recording: Recording, settings: DiffSettings) -> Iterator[RecordedMessages]:
    """Hash everything in a recording that is not a row of a table: frames, and messages of other programs."""
    ours = {schema_of(table) for table in RECORDED}
    topics = [t.name for t in recording.topics if t.schema not in ours]
    if not topics:
        return
    pixels = settings.pixels and bool(recording.cameras)
    yield from _gathered(_decoded(recording) if pixels else _raw(recording, topics))


def _raw(recording: Recording, topics: list[str]) -> Iterator[tuple[int, str, int, str]]:
    with open_mcap(recording.path) as (reader, _):
        for _schema, channel, message in reader.iter_messages(topics=topics):
            digest = hashlib.sha256(message.data).hexdigest()
            yield message.log_time, channel.topic, message.sequence, digest


def _decoded(recording: Recording) -> Iterator[tuple[int, str, int, str]]:
    for frame in recording.frames():
        image = frame.decode()
        digest = hashlib.sha256(f"{image.shape}".encode() + image.tobytes()).hexdigest()
        yield frame.t_ns, frame.sensor, frame.index, digest


def _gathered(messages: Iterator[tuple[int, str, int, str]]) -> Iterator[RecordedMessages]:
    """Gather messages in chunks of a table."""
    pending: list[tuple[int, str, int, str]] = []
    for message in messages:
        pending.append(message)
        if len(pending) >= ROWS:
            yield RecordedMessages.of(**dict(zip(RecordedMessages.__slots__, zip(*pending, strict=True), strict=True)))
            pending = []
    if pending:
        yield RecordedMessages.of(**dict(zip(RecordedMessages.__slots__, zip(*pending, strict=True), strict=True)))


def _compare_bytes(a: Path, b: Path, name: str, settings: DiffSettings) -> Comparison:
    data_a, data_b = (_content(path, settings) for path in (a, b))
    if data_a != data_b and name.lower().endswith(YAML):
        return diff_json(name, _values(name, data_a), _values(name, data_b), settings.tolerances, settings.provenance)
    return diff_bytes(name, data_a, data_b)


def _content(path: Path, settings: DiffSettings) -> bytes:
    """Read a file; the provenance in a report's page or picture is left out unless it counts."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if settings.provenance:
        return data
    if HTML.match(data):
        return re.sub(rb"<footer>.*?</footer>", b"", data, flags=re.DOTALL)
    return _without_texts(data) if image_kind(data) == "png" else data


def _without_texts(png: bytes) -> bytes:
    """Return a PNG file without its text entries."""
    out, at = png[:8], 8
    while at + 12 <= len(png):
        end = at + 12 + int.from_bytes(png[at : at + 4], "big")
        if png[at + 4 : at + 8] not in (b"tEXt", b"iTXt", b"zTXt"):
            out += png[at:end]
        at = end
    return out
