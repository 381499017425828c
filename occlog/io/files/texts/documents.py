"""Reading and writing of JSON, TOML and XML.

JSON is written atomically with sorted keys, non-finite numbers as null, and read into structs. TOML has bounded keys;
XML is read without entities, with errors that name the missing part.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypeVar
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import msgspec

from occlog.errors import InputError, spelled
from occlog.io.files.atomic import write_bytes
from occlog.io.files.limits import bounded_text, check_input, check_text, guarded
from occlog.records.names import first_double

S = TypeVar("S", bound=msgspec.Struct)
MAX_JSON_BYTES = 64_000_000
"""Size of a JSON file that occlog or a person wrote; metrics may hold a value for each time step."""


FREE_VALUES, BYTES_PER_VALUE = 1_000_000, 12
"""Objects and lists, or lines, that any JSON may have, and bytes of it for each one more: each takes 200 in memory."""


def write_json(path: Path, values: Mapping[str, object], *, overwrite: bool = False) -> None:
    """Write a JSON object atomically, with sorted keys; NaN and infinity become null.

    Args:
        path: the file.
        values: JSON-compatible values by key.
        overwrite: replace an existing file; else OutputExistsError.
    """
    text = spelled(json.dumps(_plain(values), sort_keys=True, indent=2))
    write_bytes(path, f"{text}\n".encode(), overwrite)


def read_json(path: Path) -> dict[str, Any]:
    """Object in a JSON file.

    InputError, with the line, if it is not valid JSON, larger than 64 MB, or another value.
    """
    values = parse_json(bounded_text(path, "a JSON file", limit=MAX_JSON_BYTES), path, "a JSON file")
    if not isinstance(values, dict):
        raise InputError(f"{path}: expected a JSON object, got {type(values).__name__}")
    return values


def parse_json(text: str | bytes, where: Path | str, what: str) -> Any:
    """Value of a JSON text.

    Args:
        text: a whole text, as str or UTF-8 bytes.
        where: the file, and the position in it, for messages.
        what: expected content, for messages.

    Raises:
        InputError: it is not JSON, nested too deeply, repeats a key in an object, has more objects than a text of its
            length sensibly can, or has half of a surrogate pair.
    """
    objects = text.count(b"{") + text.count(b"[") if isinstance(text, bytes) else text.count("{") + text.count("[")
    check_number(objects, "objects and lists", len(text), where)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        out = dict(pairs)
        if len(out) < len(pairs):
            double = first_double([key for key, _ in pairs])
            raise InputError(f"{where}: key {str(double)[:40]!r} appears twice; keep one", id="duplicate-name")
        return out

    with guarded(where, what):
        try:
            value = json.loads(text, object_pairs_hook=once)
        except json.JSONDecodeError as error:
            raise InputError(
                f"{where}: line {error.lineno}: not valid JSON: {error.msg}; {what} was expected", id="invalid-syntax"
            ) from error
        if _may_have_surrogates(text):
            check_text(json.dumps(value, ensure_ascii=False), where)
        return value


def check_number(count: int, what: str, size: int, where: Path | str) -> None:
    """InputError if a JSON text has more objects than are accepted for its length.

    Args:
        count: their number.
        what: what they are, for the message.
        size: length of the text.
        where: the file, for the message.
    """
    most = max(FREE_VALUES, size // BYTES_PER_VALUE)
    if count > most:
        raise InputError(
            f"{where}: {count} {what} in {size} characters of JSON; at most {most} are read; split it",
            id="input-too-large",
        )


def _may_have_surrogates(text: str | bytes) -> bool:
    if isinstance(text, bytes):
        return b"\\ud" in text or b"\\uD" in text
    return "\\ud" in text or "\\uD" in text


def struct_of(values: object, kind: type[S], *, key: str, source: Path | str, otherwise: str) -> S:
    """Convert a JSON object to the msgspec struct that describes its format.

    Args:
        values: the object.
        kind: the struct.
        key: a key that every object of the format has.
        source: the file, for messages.
        otherwise: message for an object without the key: what it is not, and how to make one.

    Raises:
        InputError: the key is missing, or a field is wrong; the message names it.
    """
    if not isinstance(values, Mapping) or key not in values:
        raise InputError(f"{source}: {otherwise}")
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{source}: {error}") from error


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


MAX_KEY_PARTS = 100
"""Parts of a dotted key in TOML; its parser takes the square of their number."""
MAX_TOML_BYTES = 1_000_000
"""Maximum size of a TOML text [bytes]: a table of ten bytes takes its parser some ten microseconds and a kilobyte."""
_LONG_KEY = re.compile(rf"^[^=#\n]*(?:\.[^=#\n.]*){{{MAX_KEY_PARTS},}}", re.MULTILINE)


def toml_values(text: str, where: Path | str, what: str) -> Mapping[str, Any]:
    """Values of a TOML text; InputError if it is invalid or too large.

    Args:
        text: TOML.
        where: its file, for messages.
        what: expected content, for messages.
    """
    size = len(text.encode(errors="replace"))
    if size > MAX_TOML_BYTES:
        raise InputError(
            f"{where}: {size} bytes; {what} was expected, in TOML of at most {MAX_TOML_BYTES} bytes",
            id="input-too-large",
        )
    if _LONG_KEY.search(text):
        raise InputError(
            f"{where}: a TOML key of more than {MAX_KEY_PARTS} parts (a.b.c has 3); {what} was expected",
            id="input-too-large",
        )
    with guarded(where, what):
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{where}: not TOML ({error}); correct this line", id="invalid-syntax") from None


def parse_xml(text: str, path: Path) -> Element:
    """Root element of an XML text; InputError, with the line, if it is invalid or declares entities.

    `path` is its file, for messages.
    """
    if "<!ENTITY" in text:
        raise InputError(f"{path}: declares XML entities; remove them", id="unsupported-format")
    with _parsing_xml(path, "XML"):
        return ElementTree.fromstring(text)


def xml_events(
    path: Path, what: str, events: Iterable[Literal["start", "end"]] = ("end",)
) -> Iterator[tuple[str, Element]]:
    """Yield (event, element) while an XML file is read: `start` and `end` of its elements, as in `iterparse`.

    Args:
        path: the file.
        what: expected content, for messages.
        events: the kinds of events that are yielded.

    Raises:
        InputError: the file cannot be read, or is not XML.
    """
    with check_input(path, what).open("rb") as file:
        found = iter(ElementTree.iterparse(file, events))
        while True:
            with _parsing_xml(path, what):
                each = next(found, None)
            if each is None:
                return
            yield each


@contextmanager
def _parsing_xml(path: Path, what: str) -> Iterator[None]:
    """Context manager that converts exceptions of the XML parser to InputError, with the line."""
    with guarded(path, what):
        try:
            yield
        except ElementTree.ParseError as error:
            raise InputError(
                f"{path}: line {error.position[0]}: not XML ({error}); correct or export it again", id="invalid-syntax"
            ) from None


def required(parent: Element, name: str, where: str) -> Element:
    """First child element of `parent` with the tag `name`; InputError, which begins with `where`, if there is none."""
    child = parent.find(name)
    if child is None:
        raise InputError(f"{where}: the part <{name}> is missing", id="missing-value")
    return child


def number(element: Element, name: str, where: str, default: float | None = None) -> float:
    """Finite number in the attribute `name` of an element, or `default` if it is missing.

    InputError, which begins with `where`, if it is missing without a default, or not a finite number.
    """
    text = element.get(name)
    if text is None:
        if default is None:
            raise InputError(f"{where}: <{element.tag}> has no attribute {name}; add it", id="missing-value")
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {name} of <{element.tag}> is {text!r}; a finite number was expected")
    return value
