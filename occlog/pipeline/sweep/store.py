"""Finished trials in a file, one JSON object a line; the process may be killed at any time."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from io import BufferedWriter
from pathlib import Path
from typing import Any

from occlog import __version__
from occlog.errors import InputError, OutputError


def key_of(spec: Mapping[str, Any]) -> str:
    """Hash what identifies a trial: its description and the version of the program."""
    text = json.dumps([__version__, spec], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


class Store:
    """Results by key; without a path they are kept in memory only.

    A last line that was cut off is left out and overwritten; its trial is run again.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file if there is one; InputError for a file of another kind."""
        self.results: dict[str, dict[str, float]] = {}
        self._path = path
        self._file: BufferedWriter | None = None
        self._good = 0
        if path is not None and path.exists():
            self._read(path)

    def _read(self, path: Path) -> None:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        for number, line in enumerate(data.split(b"\n")[:-1], start=1):
            try:
                row = json.loads(line)
                self.results[row["key"]] = {n: math.nan if v is None else v for n, v in row["result"].items()}
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                raise InputError(
                    f"{path}: line {number}: is no finished trial; remove the file to begin again"
                ) from error
        self._good = data.rfind(b"\n") + 1

    def __enter__(self) -> Store:
        """Open the file for writing."""
        if self._path is not None:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self._path.open("ab")
                self._file.truncate(self._good)
            except OSError as error:
                raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error
        return self

    def add(self, key: str, result: dict[str, float]) -> None:
        """Keep a result; it is on the disk when this returns."""
        self.results[key] = result
        if self._file is None:
            return
        row = {"key": key, "result": {n: None if math.isnan(v) else v for n, v in result.items()}}
        try:
            self._file.write(json.dumps(row).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from error

    def __exit__(self, *reason: object) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
