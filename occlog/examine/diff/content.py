"""Comparison of files that are neither tables nor recordings: YAML by its values, all others byte by byte."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from occlog.errors import InputError

from .json import diff_json
from .result import Comparison, Difference, DiffSettings

HTML = re.compile(rb"\s*<(!doctype )?html\b", re.IGNORECASE)
"""Beginning of a page."""
PNG = b"\x89PNG\r\n\x1a\n"
YAML = (".yaml", ".yml")
"""Endings of names of files whose values are compared, not their text."""


def compare_contents(a: Path, b: Path, name: str, settings: DiffSettings) -> Comparison:
    """Compare two files of one kind."""
    data_a, data_b = (content(path, settings) for path in (a, b))
    if data_a != data_b and name.lower().endswith(YAML):
        values_a, values_b = values_in(name, data_a), values_in(name, data_b)
        return diff_json(name, values_a, values_b, settings.tolerances, settings.provenance)
    return diff_bytes(name, data_a, data_b)


def content(path: Path, settings: DiffSettings) -> bytes:
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
        return _without_footers(data)
    return _without_texts(data) if data.startswith(PNG) else data


def _without_footers(page: bytes) -> bytes:
    out, at = [], 0
    while (begin := page.find(b"<footer>", at)) >= 0 and (end := page.find(b"</footer>", begin)) >= 0:
        out.append(page[at:begin])
        at = end + len(b"</footer>")
    return b"".join((*out, page[at:]))


def _without_texts(png: bytes) -> bytes:
    """Return a PNG file without its text entries."""
    out, at = png[:8], 8
    while at + 12 <= len(png):
        end = at + 12 + int.from_bytes(png[at : at + 4], "big")
        if png[at + 4 : at + 8] not in (b"tEXt", b"iTXt", b"zTXt"):
            out += png[at:end]
        at = end
    return out


def values_in(name: str, data: bytes) -> object:
    """Return the values of YAML, the lines of text, or the hash of any other file."""
    from occlog.io.files.texts.yaml_file import parse_yaml

    try:
        text = data.decode()
        return parse_yaml(text, name, dict) if name.lower().endswith(YAML) else text.splitlines()
    except InputError:
        return text.splitlines()
    except UnicodeDecodeError:
        return hashlib.sha256(data).hexdigest()


def diff_bytes(name: str, a: bytes, b: bytes) -> Comparison:
    """Compare two files byte by byte; the first difference is named by byte, and by line in text."""
    if a == b:
        return Comparison(name, "bytes", count_a=len(a), count_b=len(b), matched=len(a))
    shorter = min(len(a), len(b))
    at = next((n for n in range(0, shorter, 4096) if a[n : n + 4096] != b[n : n + 4096]), shorter)
    while at < shorter and a[at] == b[at]:
        at += 1
    key: dict[str, object] = {"byte": at}
    found_a: str | None = None
    found_b: str | None = None
    if b"\0" not in a[:4096] and b"\0" not in b[:4096]:
        key["line"] = a.count(b"\n", 0, at) + 1
        found_a, found_b = _line(a, at), _line(b, at)
    first = Difference("content", name, key, a=found_a, b=found_b)
    return Comparison(name, "bytes", count_a=len(a), count_b=len(b), matched=at, first=first)


def _line(data: bytes, at: int) -> str | None:
    """Return the line around a byte, shortened; None at the end of the file."""
    if at >= len(data):
        return None
    start = data.rfind(b"\n", 0, at) + 1
    end = data.find(b"\n", at)
    text = data[max(start, at - 30) : end if end >= 0 else len(data)].decode("utf-8", "replace")
    return text[:80]
