"""The name of an output says its format: one that promises a format that is not written there is refused."""

from __future__ import annotations

from pathlib import Path

from occlog.errors import UsageError

TABLE, RECORDING = ".parquet", ".mcap"
WRITTEN = {TABLE: ("tables", "Parquet"), RECORDING: ("recordings", "MCAP")}
"""What is written in files with an ending, and the name of the format."""
PROMISING = (
    *(".csv", ".tsv", ".txt", ".json", ".jsonl", ".geojson", ".xlsx", ".feather", ".arrow", ".npz", ".mat"),
    *(".yaml", ".yml", ".html", ".png", ".svg", ".mp4", ".gz", TABLE, RECORDING),
)
"""Endings of names that promise a format."""


def check_output_name(path: Path, ending: str) -> None:
    """UsageError for an output whose name promises another format than that of files with an ending."""
    suffix = Path(path).suffix.lower()
    if suffix in PROMISING and suffix != ending:
        what, form = WRITTEN[ending]
        raise UsageError(f"{path}: {what} are written as {form}, not {suffix}; name it {Path(path).stem}{ending}")
