"""Comparison of whole files: their order by stage, their declared schema, and their bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from .result import Comparison, Difference

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


def stage_order(names: Iterable[str]) -> list[str]:
    """Sort file names: those of earlier stages first, others after them by name."""

    def place(name: str) -> tuple[int, str]:
        stem = name.rsplit("/", maxsplit=1)[-1].split(".")[0].lower()
        found = [n for n, stage in enumerate(STAGES) if stage in stem]
        return (min(found) if found else len(STAGES), name)

    return sorted(names, key=place)


def diff_schemas(name: str, a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Compare what two tables declare.

    Args:
        name: of the table or file.
        a: `schema` (name), `version`, `length_unit` and `columns`, a list of mappings with
            `name`, `type` and `unit`; other entries are not compared.
        b: the same of the second table.
    """
    out = [
        Difference("schema", name, {}, entry, a=a.get(entry), b=b.get(entry))
        for entry in ("schema", "version", "length_unit")
        if a.get(entry) != b.get(entry)
    ]
    columns_a = {c["name"]: c for c in a.get("columns", ())}
    columns_b = {c["name"]: c for c in b.get("columns", ())}
    out += [Difference("schema", name, {}, c, a="column") for c in columns_a if c not in columns_b]
    out += [Difference("schema", name, {}, c, b="column") for c in columns_b if c not in columns_a]
    lengths = (a.get("length_unit"), b.get("length_unit"))
    for column in (c for c in columns_a if c in columns_b):
        for entry in ("type", "unit"):
            left, right = columns_a[column].get(entry), columns_b[column].get(entry)
            # Another unit of length is one difference of the table, not one of each column.
            if left != right and not (entry == "unit" and _swapped(left, lengths) == right):
                out.append(Difference("schema", name, {"entry": entry}, column, a=left, b=right))
    return tuple(out)


def _swapped(unit: Any, lengths: tuple[Any, Any]) -> Any:
    """Return a unit with the second length unit in place of the first."""
    old, new = lengths
    units = [f"{old}{rest}" for rest in ("", "^2", "/s", "^2/s", "^2/s^2")]
    return str(unit).replace(str(old), str(new)) if unit in units else unit


def diff_bytes(name: str, a: bytes, b: bytes) -> Comparison:
    """Compare two files byte by byte; the first difference is named by byte, and by line in text."""
    if a == b:
        return Comparison(name, "bytes", count_a=len(a), count_b=len(b), matched=len(a))
    shorter = min(len(a), len(b))
    at = next((n for n in range(0, shorter, 4096) if a[n : n + 4096] != b[n : n + 4096]), shorter)
    while at < shorter and a[at] == b[at]:
        at += 1
    key: dict[str, Any] = {"byte": at}
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
