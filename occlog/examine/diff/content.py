"""Comparison of other files than tables and recordings: JSON and YAML by values, all others byte by byte."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import NamedTuple, TypeGuard, cast

from occlog.errors import InputError

from .result import ColumnDifference, DiffResult, DiffSettings, Limit, RowDifference, Scalar, Tolerances


def diff_json(
    name: str, a: object, b: object, tolerances: Tolerances | None = None, provenance: bool = False
) -> DiffResult:
    """Compare two JSON values, in the order of A's keys.

    Fractional numbers are compared with the tolerances (by the last key of their path); whole numbers, text, truth
    values and null must be equal. Unless `provenance` is set, keys of objects that begin with `_`, and `provenance`,
    are skipped.

    Args:
        name: name of the file, in the result.
        a: value of the first file.
        b: value of the second file.
        tolerances: limits of differences of numbers; None: defaults.
        provenance: whether entries that state how the files were made are compared too.
    """
    limits = tolerances or Tolerances()
    counts = {"both": 0, "missing": 0, "added": 0}
    rows: dict[str, int] = {}
    largest: dict[str, RowDifference] = {}
    first: RowDifference | None = None
    for found in _JsonWalk(name, limits, provenance).values("", "", a, b):
        if not isinstance(found, RowDifference):
            counts[found] += 1
            continue
        first = first or found
        counts["both" if found.kind == "value" else found.kind] += 1
        if found.kind == "value":
            rows[found.column] = rows.get(found.column, 0) + 1
            if found.column not in largest or (found.difference or 0.0) > (largest[found.column].difference or 0.0):
                largest[found.column] = found
    columns = {column: ColumnDifference(rows[column], largest[column]) for column in rows}
    both, missing, added = counts["both"], counts["missing"], counts["added"]
    return DiffResult(
        name,
        "values",
        count_a=both + missing,
        count_b=both + added,
        matched=both,
        missing=missing,
        added=added,
        columns=columns,
        first=first,
    )


_ABSENT = object()


class _JsonWalk(NamedTuple):
    """Recursive comparison of two JSON values: name of the file, tolerances, and whether provenance is compared."""

    name: str
    limits: Tolerances
    provenance: bool

    def values(self, path: str, key: str, a: object, b: object) -> Iterator[RowDifference | str]:
        """Generate, for every value that is not a container, a difference, or `both` if it is equal in both files.

        Args:
            path: position of both values in the file, as `tracks[0].x`; empty for the whole file.
            key: last key of an object on the path to them.
            a: value of the first file.
            b: value of the second file.
        """
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            for k in (*a, *(k for k in b if k not in a)):
                if self.provenance or not (str(k).startswith("_") or k == "provenance"):
                    location = f"{path}.{k}" if path else str(k)
                    yield from self._entry(location, str(k), a.get(k, _ABSENT), b.get(k, _ABSENT))
        elif _is_list(a) and _is_list(b):
            for n in range(max(len(a), len(b))):
                value_a, value_b = (v[n] if n < len(v) else _ABSENT for v in (a, b))
                yield from self._entry(f"{path}[{n}]", key, value_a, value_b)
        else:
            yield self._value(path or "value", key, a, b)

    def _entry(self, path: str, key: str, a: object, b: object) -> Iterator[RowDifference | str]:
        """Generate the comparison of an entry of an object or list, which may be missing (`_ABSENT`) in one file.

        Args:
            path: position of the entry in the file, as `tracks[0].x`.
            key: last key of an object on the path.
            a: value of the first file.
            b: value of the second file.
        """
        if a is _ABSENT:
            yield RowDifference("added", self.name, {"path": path}, key, b=_short(b))
        elif b is _ABSENT:
            yield RowDifference("missing", self.name, {"path": path}, key, a=_short(a))
        else:
            yield from self.values(path, key, a, b)

    def _value(self, path: str, key: str, a: object, b: object) -> RowDifference | str:
        """Return the difference of two values, of which at least one is no container, or `both` if they agree.

        Args:
            path: position of the values in the file.
            key: last key of an object on the path, by which numbers have their tolerance.
            a: value of the first file.
            b: value of the second file.
        """
        if not (_is_number(a) and _is_number(b)):
            same = type(a) is type(b) and a == b
            return "both" if same else RowDifference("value", self.name, {"path": path}, key, a=_short(a), b=_short(b))
        if a == b or (a != a and b != b):
            return "both"
        whole = isinstance(a, int) and isinstance(b, int)
        table = self.name.rsplit("/", maxsplit=1)[-1].split(".")[0]
        limit = (self.limits.named(table, key) or Limit()) if whole else self.limits.of(table, key)
        # Whole numbers of JSON have any length: their difference is exact, and only then a float.
        difference = _float(abs(a - b) if whole else abs(_float(a) - _float(b)))
        allowed = limit.atol + limit.rtol * max(abs(_float(a)), abs(_float(b)))
        if math.isfinite(difference) and difference <= allowed:
            return "both"
        return RowDifference("value", self.name, {"path": path}, key, a=a, b=b, difference=difference, limit=allowed)


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_list(value: object) -> TypeGuard[Sequence[object]]:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _short(value: object) -> Scalar:
    """Return a description of a list or object, such as `a list of 3 entries`; other values unchanged."""
    if isinstance(value, Mapping):
        return f"an object of {len(value)} entries"
    return f"a list of {len(value)} entries" if _is_list(value) else cast(Scalar, value)


def compare_verdicts(name: str, a: Path, b: Path) -> list[DiffResult]:
    """Compare the stored consistency verdicts of the stages that both files have; empty if they agree, else one result.

    `name`: name of the files in the result.
    """
    from occlog.io.files.inputs import verdicts_of_file

    left, right = ({verdict.stage: verdict for verdict in verdicts_of_file(path)} for path in (a, b))
    found_a, found_b = (
        {
            stage: {
                "failed": ", ".join(" ".join([c.id, *c.sensors]) for c in of[stage].checks if c.status == "failed"),
                "plausible": of[stage].plausible,
            }
            for stage in left
            if stage in right
        }
        for of in (left, right)
    )
    return [] if found_a == found_b else [diff_json(f"{name}: verdict", found_a, found_b)]


def compare_provenance(name: str, a: object, b: object) -> DiffResult:
    """Compare the provenance `a` and `b` (JSON values) of two files; `name`: name of the files in the result."""
    return diff_json(f"{name}: provenance", a, b, provenance=True)


HTML = re.compile(rb"\s*<(!doctype )?html\b", re.IGNORECASE)
"""Beginning of a page."""
PNG = b"\x89PNG\r\n\x1a\n"
YAML = (".yaml", ".yml")
"""Endings of names of files with values that are compared, not their text."""


def compare_contents(a: Path, b: Path, name: str, settings: DiffSettings) -> DiffResult:
    """Compare two files of one kind: YAML by value, report pages up to the last digit of decimals, others by byte.

    `name`: name of the files in the result; YAML is recognised by its ending. Provenance in pages and pictures is
    skipped unless the settings compare it.
    """
    data_a, data_b = (content(path, settings) for path in (a, b))
    if data_a != data_b and name.lower().endswith(YAML):
        values_a, values_b = values_in(name, data_a), values_in(name, data_b)
        return diff_json(name, values_a, values_b, settings.tolerances, settings.provenance)
    if HTML.match(data_a) and HTML.match(data_b) and _same_pages(data_a, data_b):
        data_b = data_a
    return diff_bytes(name, data_a, data_b)


FRACTION = re.compile(rb"-?\d+\.\d+(?:[eE][-+]?\d+)?")
"""A number with a decimal point."""


def _same_pages(a: bytes, b: bytes) -> bool:
    """Return whether report pages are equal up to one unit in the last digit of decimal numbers.

    Rounding of displayed numbers depends on the processor.
    """
    if FRACTION.split(a) != FRACTION.split(b):
        return False
    for one, other in zip(FRACTION.findall(a), FRACTION.findall(b), strict=True):
        if one == other:
            continue
        first, second = (Decimal(text.decode()) for text in (one, other))
        exponents = [int(value.as_tuple().exponent) for value in (first, second)]
        if abs(first - second) > Decimal(1).scaleb(max(exponents)):
            return False
    return True


def content(path: Path, settings: DiffSettings) -> bytes:
    """Return the bytes of a file; InputError if it cannot be read.

    Without the provenance in pages (footers) and pictures (text entries), unless the settings compare it.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file", id="file-not-found") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}", id="unreadable-file") from error
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
    """Return the values of YAML, the lines of text, or the SHA-256 of any other content.

    `name`: name of the file; YAML is recognised by its ending.
    """
    from occlog.io.files.texts.yaml import parse_yaml

    try:
        text = data.decode()
        return parse_yaml(text, name, dict) if name.lower().endswith(YAML) else text.splitlines()
    except InputError:
        return text.splitlines()
    except UnicodeDecodeError:
        return hashlib.sha256(data).hexdigest()


def diff_bytes(name: str, a: bytes, b: bytes) -> DiffResult:
    """Compare the contents `a` and `b` byte by byte; the first difference is located by byte, in text also by line.

    `name`: name of the files in the result.
    """
    if a == b:
        return DiffResult(name, "bytes", count_a=len(a), count_b=len(b), matched=len(a))
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
    first = RowDifference("content", name, key, a=found_a, b=found_b)
    return DiffResult(name, "bytes", count_a=len(a), count_b=len(b), matched=at, first=first)


def _line(data: bytes, at: int) -> str | None:
    """Return the line around byte `at`, shortened, as text; None at the end of the file."""
    if at >= len(data):
        return None
    start = data.rfind(b"\n", 0, at) + 1
    end = data.find(b"\n", at)
    text = data[max(start, at - 30) : end if end >= 0 else len(data)].decode("utf-8", "replace")
    return text[:80]
