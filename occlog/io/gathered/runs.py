"""The tables `runs` and `metrics` of a batch: what became of each recording, and every figure of its evaluation."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from occlog.io.files.provenance import Provenance

from .schema import NAMES, field, gathered_schema, write_rows

_LOSS = pa.struct([("source", pa.string()), ("place", pa.string()), ("what", pa.string()), ("count", pa.int64())])
RUNS = (
    field(
        "source",
        pa.string(),
        "the recording's file, with the folders that tell it from the others; a byte that is not UTF-8 as \\xe9",
    ),
    field("sha256", pa.string(), "of the recording's bytes; empty: it could not be read"),
    field("state", NAMES, "done, lossy (input was lost), threshold (not met) or failed"),
    field("exit_code", pa.int32(), "as `occlog run` would have ended"),
    field("stage", NAMES, "the stage that failed; empty: none did"),
    field("message", pa.string(), "why it failed, in one line"),
    field("plausible", pa.bool_(), "whether every stage found its results plausible; null: none judged", nullable=True),
    field("warnings", pa.list_(pa.string()), "why results are not to be believed: stage, id and sentence"),
    field("losses", pa.list_(_LOSS), "input that was lost: source, place, what, and how many (0: not known)"),
)
METRICS = (
    field("file", NAMES, "of the run folder that has the figure"),
    field("name", NAMES, "of the figure"),
    field(
        "value",
        pa.float64(),
        "in the unit that the name ends with; null: it is not defined",
        nullable=True,
    ),
)


def write_runs(path: Path, rows: Iterable[dict[str, object]], provenance: Provenance) -> int:
    """Write the table of runs, a row a recording; the number of rows."""
    return write_rows(path, gathered_schema("runs", RUNS, provenance), rows)


def write_metrics(path: Path, rows: Iterable[dict[str, object]], provenance: Provenance) -> int:
    """Write the table of metrics, a row a figure; the number of rows."""
    return write_rows(path, gathered_schema("metrics", METRICS, provenance), rows)
