"""A comparison in words, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from .result import Comparison, Difference, Scalar

MOST_SCHEMA_LINES = 12


def as_dict(found: Sequence[Comparison]) -> dict[str, object]:
    """Return all comparisons as plain values for JSON; `first` is the first difference of the earliest stage."""
    different = [part for part in found if not part.same]
    return {
        "same": not different,
        "first": {"name": different[0].name, **_first(different[0])} if different else None,
        "parts": [part.as_dict() for part in found],
    }


def _first(part: Comparison) -> dict[str, object]:
    first = part.schema[0] if part.schema else part.first
    return first.as_dict() if first is not None else {}


def report_lines(found: Sequence[Comparison]) -> list[str]:
    """Write all comparisons for a person, and the part that differs first at the end."""
    different = [part for part in found if not part.same]
    lines = [line for part in found for line in comparison_lines(part)]
    if not found:
        return ["same: there is nothing to compare"]
    if len(found) == 1:
        return lines
    head = f"{len(different)} of {len(found)} parts differ, first: {different[0].name}" if different else "the same"
    return [*lines, head]


def comparison_lines(found: Comparison) -> list[str]:
    """Write what two tables or files have in common, and where they differ first and most."""
    if found.same:
        return [f"same       {found.name}{_count(found)}"]
    if found.what == "files":
        where = "A" if found.first is not None and found.first.kind == "missing" else "B"
        return [f"different  {found.name}: only in {where}"]
    lines = [f"different  {found.name}: {_counts(found)}"]
    lines += [f"    schema  {_schema(item)}" for item in found.schema[:MOST_SCHEMA_LINES]]
    if len(found.schema) > MOST_SCHEMA_LINES:
        lines.append(f"    schema  and {len(found.schema) - MOST_SCHEMA_LINES} more differences")
    if found.first is not None:
        lines.append(f"    first   {difference_words(found.first)}")
    width = max((len(name) for name in found.columns), default=0)
    for name, column in found.columns.items():
        what = f"{found.what} differ" if column.rows != 1 else f"{found.what.removesuffix('s')} differs"
        lines.append(f"    {name:<{width}}  {column.rows} {what}, most {_most(column.largest)}")
    return lines


def _count(found: Comparison) -> str:
    return f" ({found.count_a} {found.what})" if found.what != "files" else ""


def _counts(found: Comparison) -> str:
    if found.what == "bytes":
        return f"{found.count_a} and {found.count_b} bytes"
    if not found.matched and not found.missing and not found.added:
        return f"{found.count_a} and {found.count_b} {found.what}, not compared"
    text = f"{found.count_a} and {found.count_b} {found.what}, {found.matched} in both"
    text += f", {found.missing} only in A" if found.missing else ""
    return text + (f", {found.added} only in B" if found.added else "")


def _schema(found: Difference) -> str:
    if found.a == "column" or found.b == "column":
        return f"column {found.column} is only in {'A' if found.a == 'column' else 'B'}"
    what = f"{found.key['entry']} of {found.column}" if found.key else found.column.replace("_", " ")
    return f"{what}: {found.a} in A, {found.b} in B"


def difference_words(found: Difference) -> str:
    """Write one difference with its place, both values, their distance and the limit."""
    place = _key(found.key)
    if found.kind in ("missing", "added"):
        where, value = ("A", found.a) if found.kind == "missing" else ("B", found.b)
        return f"only in {where}: {place}" + (f" = {_value(value)}" if value is not None else "")
    if found.kind == "content":
        if found.a is None and found.b is None:
            return f"at {place}"
        return f"at {place}: {_line(found.a)} in A, {_line(found.b)} in B"
    column = f": {found.column}" if found.column and "path" not in found.key else ""
    return f"{place}{column} is {_value(found.a)} in A, {_value(found.b)} in B{_apart(found)}"


def _line(text: Scalar) -> str:
    return "the end" if text is None else repr(text)


def _apart(found: Difference) -> str:
    if found.difference is None or math.isnan(found.difference):
        return ""
    unit = f" {found.unit}" if found.unit else ""
    return f" ({found.difference:.6g}{unit} apart, limit {found.limit:.3g})"


def _most(found: Difference) -> str:
    where = _key(found.key)
    if found.difference is None or math.isnan(found.difference):
        return f"at {where}: {_value(found.a)} and {_value(found.b)}"
    unit = f" {found.unit}" if found.unit else ""
    return f"by {found.difference:.6g}{unit} at {where}"


def _key(key: Mapping[str, object]) -> str:
    """`t_ns 1700000000000000000, sensor cam1` and the like."""
    if "path" in key:
        return str(key["path"])
    return ", ".join(f"{name} {value}" for name, value in key.items()) or "the row"


def _value(value: Scalar) -> str:
    return repr(value)
