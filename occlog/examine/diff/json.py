"""Are two JSON values the same, and where do they first differ?"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .result import ColumnDifference, Comparison, Difference, Limit, Tolerances


def diff_json(name: str, a: Any, b: Any, tolerances: Tolerances | None = None, provenance: bool = False) -> Comparison:
    """Compare two JSON values, in the order of A's keys.

    Fractional numbers are compared with the tolerances (their last key is the column);
    two whole numbers, text, truth values and null must be equal.  Unless `provenance` is
    set, keys of objects that begin with `_`, and `provenance`, are left out.

    Args:
        name: of the file.
        a: value of the first file.
        b: value of the second file.
        tolerances: how far apart numbers may lie.
        provenance: whether how the files were made counts too.
    """
    limits = tolerances or Tolerances()
    counts = {"both": 0, "missing": 0, "added": 0}
    rows: dict[str, int] = {}
    largest: dict[str, Difference] = {}
    first: Difference | None = None
    for found in _walk("", "", a, b, name, limits, provenance):
        if not isinstance(found, Difference):
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
    return Comparison(name, "values", both + missing, both + added, both, missing, added, columns, first=first)


def _walk(
    path: str, key: str, a: Any, b: Any, name: str, limits: Tolerances, provenance: bool
) -> Iterator[Difference | str]:
    """A difference, or `both`, for every value that is not a container."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for k in (*a, *(k for k in b if k not in a)):
            if provenance or not (str(k).startswith("_") or k == "provenance"):
                yield from _child(
                    _joined(path, str(k)), str(k), a.get(k, _ABSENT), b.get(k, _ABSENT), name, limits, provenance
                )
    elif _is_list(a) and _is_list(b):
        for n in range(max(len(a), len(b))):
            place = f"{path}[{n}]"
            value_a, value_b = (v[n] if n < len(v) else _ABSENT for v in (a, b))
            yield from _child(place, key, value_a, value_b, name, limits, provenance)
    else:
        yield _value(path or "value", key, a, b, name, limits)


_ABSENT = object()


def _child(
    path: str, key: str, a: Any, b: Any, name: str, limits: Tolerances, provenance: bool
) -> Iterator[Difference | str]:
    if a is _ABSENT:
        yield Difference("added", name, {"path": path}, key, b=_short(b))
    elif b is _ABSENT:
        yield Difference("missing", name, {"path": path}, key, a=_short(a))
    else:
        yield from _walk(path, key, a, b, name, limits, provenance)


def _value(path: str, key: str, a: Any, b: Any, name: str, limits: Tolerances) -> Difference | str:
    if not (_is_number(a) and _is_number(b)):
        same = type(a) is type(b) and a == b
        return "both" if same else Difference("value", name, {"path": path}, key, _short(a), _short(b))
    if a == b or (a != a and b != b):
        return "both"
    whole = isinstance(a, int) and isinstance(b, int)
    table = name.rsplit("/", maxsplit=1)[-1].split(".")[0]
    limit = (limits.named(table, key) or Limit()) if whole else limits.of(table, key)
    # Whole numbers of JSON have any length: their difference is exact, and only then a float.
    apart = _float(abs(a - b) if whole else abs(_float(a) - _float(b)))
    allowed = limit.atol + limit.rtol * max(abs(_float(a)), abs(_float(b)))
    if math.isfinite(apart) and apart <= allowed:
        return "both"
    return Difference("value", name, {"path": path}, key, a, b, apart, allowed)


def _float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _joined(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _short(value: Any) -> Any:
    """A container in a few words, anything else as it is."""
    if isinstance(value, Mapping):
        return f"an object of {len(value)} entries"
    return f"a list of {len(value)} entries" if _is_list(value) else value
