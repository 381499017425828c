"""Changes of files: what damage, other programs and hostile people make of bytes.

A change is a few whole numbers, so that hypothesis can draw and shorten it, a generator of random numbers can draw
millions, and a finding can be written down.  The same changes of the same bytes give the same bytes.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from random import Random
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from occlog.pipeline.pack.archive import INPUTS, MANIFEST, OUTPUTS

LONGEST = 1 << 18
"""Bytes of an input: what is larger takes time, and shows nothing else."""
BOUNDARIES = tuple(
    n & (2**64 - 1)
    for bits in (7, 8, 15, 16, 24, 31, 32, 53, 63, 64)
    for n in (2**bits - 2, 2**bits - 1, 2**bits, -(2**bits), -1, 0, 1)
)
NUMBERS = (
    *("0", "-0", "1", "-1", "2", "0.5", "-0.5", "1e-320", "1e308", "-1e308", "1e309", "1e-9", "nan", "inf", "-inf"),
    *("2147483647", "2147483648", "-2147483649", "4294967296", "9007199254740993", "9223372036854775807"),
    *("9223372036854775808", "-9223372036854775809", "18446744073709551616", "1e18", "1e19", "1e30", "1_0", "0x10"),
    *("1,5", "+1", "01", "1e", ".", "-", "²", "٣", "1" + "0" * 40, "9" * 400, "9" * 4400, "true", "null", "''", '""'),
)
WORDS = (
    *(
        "\n",
        "\r\n",
        "\n\n",
        ",",
        ";",
        "\t",
        " ",
        '"',
        "'",
        "#",
        ":",
        "- ",
        "{",
        "}",
        "[",
        "]",
        "[]",
        "{}",
        "<",
        ">",
        "</",
    ),
    *(
        "/>",
        "<a/>",
        "&amp;",
        "&a;",
        "<!--",
        "]]>",
        "!!",
        "*a",
        "&a ",
        "? ",
        "---\n",
        "...\n",
        "\x00",
        "\ufeff",
        "\u2028",
    ),
    *(
        "\x85",
        "\x0c",
        "\x1b[2J",
        "é",
        "\U0001f600",
        "\\ud800",
        "\\u0000",
        "\\",
        "%",
        "a",
        "..",
        "/",
        "../",
        "null",
        "~",
    ),
    *(
        "true",
        "false",
        "nan",
        "NaN",
        "Infinity",
        "-Infinity",
        "x",
        "frame",
        "time",
        "t_ns",
        "sensor",
        "1.5",
        "-1",
        "1e999",
    ),
    *("2001-99-99", "12:60:61", "9" * 30, "[[[[", "{a: {b: ", "=", "|", ">-\n"),
)
BYTES = (b"\xff", b"\xc3", b"\xed\xa0\x80", b"\xff\xfe", bytes(8), b"\xff" * 8, b"PAR1", b"PK\x03\x04", b"\x1f\x8b")
TOKENS = (*(word.encode() for word in WORDS), *BYTES)
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w.-]*")
_NEAR = 64
"""Bytes after a place that are searched for a number or a word; of text files with long rows every cell is near one."""


class Edit(NamedTuple):
    """One change: which kind, where (a share of 2**32 of the length), and a number that says how."""

    kind: int
    place: int
    value: int


class Change(NamedTuple):
    """Edits of the bytes themselves, or of what a container holds, which is packed again with right check sums."""

    inside: bool
    edits: tuple[Edit, ...]


def _write(data: bytes, at: int, value: int, other: bytes) -> bytes:
    return data[:at] + bytes([value & 255]) + data[at + 1 :]


def _flip(data: bytes, at: int, value: int, other: bytes) -> bytes:
    return data[:at] + bytes([data[at] ^ 1 << value % 8]) + data[at + 1 :] if at < len(data) else data


def _length(value: int) -> int:
    """Length of a stretch, short ones above all."""
    return 1 + (value >> 3) % (4, 16, 64, 256, 1024, 4, 8, 32)[value & 7]


def _delete(data: bytes, at: int, value: int, other: bytes) -> bytes:
    return data[:at] + data[at + _length(value) :]


def _repeat(data: bytes, at: int, value: int, other: bytes) -> bytes:
    part = data[at : at + _length(value)]
    return data[:at] + part * (2 if value & 1024 else 1 + (value >> 12) % 40) + data[at:]


def _insert(data: bytes, at: int, value: int, other: bytes) -> bytes:
    return data[:at] + TOKENS[value % len(TOKENS)] + data[at:]


def _overwrite(data: bytes, at: int, value: int, other: bytes) -> bytes:
    token = TOKENS[value % len(TOKENS)]
    return data[:at] + token + data[at + len(token) :]


def _cut(data: bytes, at: int, value: int, other: bytes) -> bytes:
    return data[:at]


def _number_of_bytes(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """A whole number at the boundary of a type, of 1 to 8 bytes, in either order of bytes."""
    width, order = (1, 2, 4, 8)[value & 3], "little" if value & 4 else "big"
    number = BOUNDARIES[(value >> 3) % len(BOUNDARIES)] & (2 ** (8 * width) - 1)
    return data[:at] + number.to_bytes(width, order) + data[at + width :]


def _near_number_of_bytes(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """A length, count or place that is wrong by a little."""
    width, order = (1, 2, 4, 8)[value & 3], "little" if value & 4 else "big"
    old = int.from_bytes(data[at : at + width], order)
    number = (old + (value >> 3) % 33 - 16) % 2 ** (8 * width)
    return data[:at] + number.to_bytes(width, order) + data[at + width :]


def _splice(data: bytes, at: int, value: int, other: bytes) -> bytes:
    return data[:at] + other[value % (len(other) + 1) :]


def _move_in(data: bytes, at: int, value: int, other: bytes) -> bytes:
    begin = (value >> 16) % (len(other) + 1)
    return data[:at] + other[begin : begin + _length(value)] + data[at:]


def _number(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """Another number in a text."""
    found = _NUMBER.search(data, at, at + _NEAR) or _NUMBER.search(data, at)
    if found is None:
        return data
    return data[: found.start()] + NUMBERS[value % len(NUMBERS)].encode() + data[found.end() :]


def _word(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """Another word of the same text, or a token."""
    found = _WORD.search(data, at, at + _NEAR)
    words = _WORD.findall(data, 0, 4096)
    if found is None or not words:
        return data
    new = words[(value >> 1) % len(words)] if value & 1 else TOKENS[(value >> 1) % len(TOKENS)]
    return data[: found.start()] + new + data[found.end() :]


def _line(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """A line that is gone, twice there, at another place, shorter, or as in another file."""
    lines = data.split(b"\n")
    n = data.count(b"\n", 0, at)
    m = (value >> 3) % len(lines)
    match value & 7:
        case 0 | 1:
            del lines[n]
        case 2:
            lines.insert(m, lines[n])
        case 3:
            lines[n], lines[m] = lines[m], lines[n]
        case 4:
            lines[n] = lines[n][: (value >> 3) % (len(lines[n]) + 1)]
        case 5:
            others = other.split(b"\n")
            lines[n] = others[(value >> 3) % len(others)]
        case 6:
            lines[n] += lines[m]
        case _:
            lines = lines[: n + 1]
    return b"\n".join(lines)


def _cell(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """A cell of a line that is gone, empty, or twice there."""
    begin, end = data.rfind(b"\n", 0, at) + 1, data.find(b"\n", at)
    end = len(data) if end < 0 else end
    line = data[begin:end]
    mark = next((m for m in (b",", b"\t", b";", b" ") if m in line), None)
    if mark is None:
        return data
    cells = line.split(mark)
    n = (value >> 2) % len(cells)
    match value & 3:
        case 0:
            del cells[n]
        case 1:
            cells[n] = b""
        case 2:
            cells.insert(n, cells[n])
        case _:
            m = (value >> 8) % len(cells)
            cells[n], cells[m] = cells[m], cells[n]
    return data[:begin] + mark.join(cells) + data[end:]


def _nest(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """Brackets in brackets."""
    pair = ((b"[", b"]"), (b"{", b"}"), (b'{"a":', b"}"), (b"<a>", b"</a>"), (b"- ", b""), (b"(", b")"))[value % 6]
    depth = (1, 3, 40, 120, 1100, 3000)[(value >> 4) % 6]
    return data[:at] + pair[0] * depth + (pair[1] * depth if value & 8 else b"") + data[at:]


def _noise(data: bytes, at: int, value: int, other: bytes) -> bytes:
    """Bytes that mean nothing, as a bad block has."""
    noise = Random(value).randbytes(_length(value >> 8))
    return data[:at] + noise + data[at + len(noise) :]


EDITS: tuple[Callable[[bytes, int, int, bytes], bytes], ...] = (
    *(_write, _flip, _delete, _repeat, _insert, _overwrite, _cut, _number_of_bytes, _near_number_of_bytes, _splice),
    *(_move_in, _number, _number, _word, _line, _cell, _nest, _noise),
)
_OF_TEXTS = (_delete, _repeat, _insert, _cut, _splice, _move_in, _number, _word, _line, _cell, _nest)
TEXT = tuple(n for n, edit in enumerate(EDITS) if edit in _OF_TEXTS)
"""Kinds of edits after which most texts are texts still."""


def edited(data: bytes, edits: Sequence[Edit], other: bytes) -> bytes:
    """The bytes after edits; `other` is what splices take from."""
    for edit in edits:
        data = EDITS[edit.kind % len(EDITS)](data, (edit.place * (len(data) + 1)) >> 32, edit.value, other)
        data = data[:LONGEST]
    return data


class Layer(NamedTuple):
    """How what a container holds is taken out, and put back with right lengths and check sums."""

    parts: Callable[[bytes], list[bytes]]
    pack: Callable[[bytes, int, bytes], bytes]
    """Container, number of the part, and the part as it is to be."""


@lru_cache(maxsize=1024)
def _parts(layer: Layer, data: bytes) -> list[bytes]:
    """Parts of a container; none of what cannot be taken apart."""
    try:
        return layer.parts(data)
    except Exception:  # of the libraries that unpack
        return []


def changed(data: bytes, change: Change, other: bytes, layer: Layer | None = None) -> bytes:
    """The bytes after a change; those outside where a container cannot be taken apart."""
    if layer is not None and change.inside and change.edits:
        with suppress(Exception):  # of the libraries that pack: whatever they cannot write is no input
            parts, source = _parts(layer, data), _parts(layer, other)
            number = change.edits[0].place % len(parts)
            part = edited(parts[number], change.edits[1:] or change.edits, source[number % len(source)])
            return layer.pack(data, number, part)[:LONGEST]
    return edited(data, change.edits, other)


def draw(random: Random, text: bool = False) -> Change:
    """A change, most often of one or two edits; of a `text` most often one that leaves a text."""
    count = random.choice((1, 1, 1, 2, 2, 3, 4, 8))
    kinds = TEXT if text and random.random() < 0.75 else range(len(EDITS))
    edits = (Edit(random.choice(kinds), random.getrandbits(32), random.getrandbits(32)) for _ in range(count))
    return Change(random.random() < 0.6, tuple(edits))


def grown(data: bytes, random: Random, size: int, layer: Layer | None = None) -> bytes:
    """The bytes with one piece of them, or one token, so often that there are `size` bytes."""
    if layer is not None and random.random() < 0.5:
        with suppress(Exception):
            parts = _parts(layer, data)
            number = random.randrange(len(parts))
            return layer.pack(data, number, grown(parts[number], random, size))
    at = random.randrange(len(data) + 1)
    match random.randrange(4):
        case 0:  # a line
            begin, end = data.rfind(b"\n", 0, at) + 1, data.find(b"\n", at) + 1
            at, piece = begin, data[begin : end or len(data)]
        case 1:  # a token, perhaps with a mark behind it
            piece = random.choice((*TOKENS, b"1", b"a")) + random.choice((b"", b"", b" ", b",", b".", b":", b"\n"))
        case 2:  # a word or a number, with what is behind it
            found = _WORD.search(data, at) or _NUMBER.search(data, at)
            piece = data[found.start() : found.end() + random.randrange(3)] if found else data
        case _:
            piece = data[at : at + random.choice((1, 2, 4, 8, 16, 64, 256))]
    return data[:at] + piece * (max(size - len(data), 0) // max(len(piece), 1)) + data[at:]


class _Recording(NamedTuple):
    """What a recording holds."""

    messages: list[tuple[Channel, Message]]
    attachments: list[Attachment]
    schemas: list[Schema]
    metadata: list[Metadata]
    channels: list[Channel]


@lru_cache(maxsize=512)
def _recording(data: bytes) -> _Recording:
    reader = make_reader(io.BytesIO(data))
    summary = reader.get_summary()
    assert summary is not None
    return _Recording(
        [(channel, message) for _, channel, message in reader.iter_messages(log_time_order=False)],
        list(reader.iter_attachments()),
        list(summary.schemas.values()),
        list(reader.iter_metadata()),
        list(summary.channels.values()),
    )


def _mcap_parts(data: bytes) -> list[bytes]:
    """Data of messages, attachments, schemas, metadata and names of topics, in this order."""
    held = _recording(data)
    out = [message.data for _, message in held.messages]
    out += [attachment.data for attachment in held.attachments]
    out += [schema.data for schema in held.schemas]
    out += [value.encode() for record in held.metadata for value in record.metadata.values()]
    return out + [name.encode() for c in held.channels for name in (c.topic, c.message_encoding)]


def _pack_mcap(data: bytes, number: int, part: bytes) -> bytes:
    """The recording with one of these parts another; its times are as they were."""
    held, at = _recording(data), 0

    def new(old: bytes) -> bytes:
        nonlocal at
        at += 1
        return part if at == number + 1 else old

    messages = [(c.id, m, new(m.data)) for c, m in held.messages]
    attached = [(a, new(a.data)) for a in held.attachments]
    schemas = [(s, new(s.data)) for s in held.schemas]
    metadata = [
        (m.name, {k: new(v.encode()).decode("utf-8", "replace") for k, v in m.metadata.items()}) for m in held.metadata
    ]
    channels = [
        (c, *(new(name.encode()).decode("utf-8", "replace") for name in (c.topic, c.message_encoding)))
        for c in held.channels
    ]
    out = io.BytesIO()
    kinds = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
    writer = Writer(out, compression=kinds[len(part) % 3])
    writer.start()
    known = {0: 0} | {s.id: writer.register_schema(s.name, s.encoding, text) for s, text in schemas}
    ids = {c.id: writer.register_channel(topic, code, known[c.schema_id]) for c, topic, code in channels}
    for attachment, content in attached:
        writer.add_attachment(attachment.create_time, attachment.log_time, attachment.name, "", content)
    for channel, message, content in messages:
        writer.add_message(ids[channel], message.log_time, content, message.publish_time, message.sequence)
    for name, values in metadata:
        writer.add_metadata(name, values)
    writer.finish()
    return out.getvalue()


def _png_parts(data: bytes) -> list[bytes]:
    """Head and content of each part; those of pixels unpacked."""
    out, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        content = data[at + 8 : at + 8 + length]
        out.append(zlib.decompress(content) if data[at + 4 : at + 8] == b"IDAT" else content)
        at += 12 + length
    return out


def _pack_png(data: bytes, number: int, part: bytes) -> bytes:
    out, at = data[:8], 8
    for n in range(len(_png_parts(data))):
        (length,) = struct.unpack_from(">I", data, at)
        name, content = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if n == number:
            content = zlib.compress(part, 1) if name == b"IDAT" else part
        out += struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        at += 12 + length
    return out


def _zip_parts(data: bytes) -> list[bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [archive.read(name) for name in archive.namelist()]


def _pack_zip(data: bytes, number: int, part: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        members = {name: part if n == number else old.read(name) for n, name in enumerate(old.namelist())}
        name = list(members)[number]
        if MANIFEST in members and name != MANIFEST:
            members[MANIFEST] = _restated(members[MANIFEST], name, part)
        for name, content in members.items():
            new.writestr(name, content)
    return out.getvalue()


def _restated(manifest: bytes, name: str, part: bytes) -> bytes:
    """The manifest of a packed run, with size and digest of a file as they are."""
    stated = json.loads(manifest)
    folder, _, path = name.partition("/")
    for file in stated[{INPUTS: "inputs", OUTPUTS: "outputs"}[folder]]:
        if file["path"] == path:
            file |= {"bytes": len(part), "sha256": hashlib.sha256(part).hexdigest()}
    return json.dumps(stated).encode()


@lru_cache(maxsize=512)
def _table(data: bytes) -> pa.Table:
    return pq.read_table(pa.BufferReader(data))


def _parquet_parts(data: bytes) -> list[bytes]:
    """The table without our check sums, entries of its footer, and the numbers of its columns."""
    table = _table(data)
    plain = io.BytesIO()
    pq.write_table(table, plain)
    columns = [c.combine_chunks() for c in table.columns if pa.types.is_primitive(c.type)]
    numbers = [c.cast(pa.int8()) if pa.types.is_boolean(c.type) else c for c in columns]
    return [plain.getvalue(), *(table.schema.metadata or {}).values(), *(c.to_numpy(False).tobytes() for c in numbers)]


def _pack_parquet(data: bytes, number: int, part: bytes) -> bytes:
    if number == 0:
        return part
    table, out = _table(data), io.BytesIO()
    reported = dict(table.schema.metadata or {})
    if number <= len(reported):
        table = table.replace_schema_metadata({**reported, list(reported)[number - 1]: part})
    else:
        places = [n for n, field in enumerate(table.schema) if pa.types.is_primitive(field.type)]
        place = places[number - len(reported) - 1]
        field = table.schema.field(place)
        kind = np.dtype(np.int8 if pa.types.is_boolean(field.type) else field.type.to_pandas_dtype())
        values = np.frombuffer(part.ljust(len(table) * kind.itemsize, b"\0"), kind, len(table))
        array = pa.array(values != 0) if pa.types.is_boolean(field.type) else pa.array(values, from_pandas=False)
        table = table.set_column(place, field, array.cast(field.type))
    pq.write_table(table, out)
    return out.getvalue()


PARQUET = Layer(_parquet_parts, _pack_parquet)
MCAP = Layer(_mcap_parts, _pack_mcap)
PNG = Layer(_png_parts, _pack_png)
ZIP = Layer(_zip_parts, _pack_zip)
GZIP = Layer(lambda data: [gzip.decompress(data)], lambda _, __, part: gzip.compress(part, 1, mtime=0))
ZSTD = Layer(
    lambda data: [zstandard.ZstdDecompressor().decompress(data, max_output_size=LONGEST)],
    lambda _, __, part: zstandard.ZstdCompressor(level=1).compress(part),
)
