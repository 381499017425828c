"""Differences of whole files: their declared schema, their bytes, and the order in which stages made them."""

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
"""Names of outputs, those of earlier stages first: what differs first is nearest to the cause."""


def stage_order(names: Iterable[str]) -> list[str]:
    """File names with those of earlier stages first, others after them by name."""

    def place(name: str) -> tuple[int, str]:
        stem = name.rsplit("/", maxsplit=1)[-1].split(".")[0].lower()
        found = [n for n, stage in enumerate(STAGES) if stage in stem]
        return (min(found) if found else len(STAGES), name)

    return sorted(names, key=place)


def diff_schemas(name: str, a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[Difference, ...]:
    """Differences of what two tables declare.

    Args:
        name: of the table or file.
        a: `schema` (name), `version`, `length_unit` and `columns`, a list of mappings with
            `name`, `type` and `unit`; other entries are not compared.
        b: the same of the second table.
    """
    out = [
        Difference("schema", name, {}, entry, a.get(entry), b.get(entry))
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
            # Other units of length have been named once already.
            if left != right and not (entry == "unit" and _swapped(left, lengths) == right):
                out.append(Difference("schema", name, {"entry": entry}, column, left, right))
    return tuple(out)


def _swapped(unit: Any, lengths: tuple[Any, Any]) -> Any:
    """A unit with one length unit in place of the other."""
    old, new = lengths
    units = [f"{old}{rest}" for rest in ("", "^2", "/s", "^2/s", "^2/s^2")]
    return str(unit).replace(str(old), str(new)) if unit in units else unit


def diff_bytes(name: str, a: bytes, b: bytes) -> Comparison:
    """Compare two files byte by byte; the first difference is named by byte, and by line in text."""
    if a == b:
        return Comparison(name, "bytes", len(a), len(b), len(a))
    shorter = min(len(a), len(b))
    at = next((n for n in range(0, shorter, 4096) if a[n : n + 4096] != b[n : n + 4096]), shorter)
    while at < shorter and a[at] == b[at]:
        at += 1
    key: dict[str, Any] = {"byte": at}
    found_a: Any = None
    found_b: Any = None
    if b"\0" not in a[:4096] and b"\0" not in b[:4096]:
        key["line"] = a.count(b"\n", 0, at) + 1
        found_a, found_b = _line(a, at), _line(b, at)
    first = Difference("content", name, key, "", found_a, found_b)
    return Comparison(name, "bytes", len(a), len(b), at, first=first)


def _line(data: bytes, at: int) -> str | None:
    """The line around a byte, shortened; None at the end of the file."""
    if at >= len(data):
        return None
    start = data.rfind(b"\n", 0, at) + 1
    end = data.find(b"\n", at)
    text = data[max(start, at - 30) : end if end >= 0 else len(data)].decode("utf-8", "replace")
    return text[:80]
