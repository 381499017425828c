"""Formatting of rows as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

from occlog.console.text import as_bytes
from occlog.io.files.texts.csv_rows import no_formula


def to_csv(rows: Sequence[Mapping[str, object]]) -> bytes:
    """Return rows as CSV with one header, numbers with all digits, and texts escaped against formulas."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: no_formula(v) if isinstance(v, str) else v for k, v in row.items()} for row in rows)
    return as_bytes(text.getvalue())
