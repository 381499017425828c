"""Folders of tables that are removed with the last reference to them."""

from __future__ import annotations

import os
import shutil
import weakref
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import Any


class Folder:
    """A new folder for temporary files; it goes with the last reference to it, at the latest when Python ends."""

    def __init__(self) -> None:
        """Make it, where `TMPDIR` says."""
        self.path = Path(mkdtemp(prefix="occlog-"))
        self.remove = weakref.finalize(self, _remove, self.path, os.getpid())

    def file(self, name: str) -> Path:
        """A file in it."""
        return self.path / name

    def written(self, names: Iterable[str]) -> dict[str, Path]:
        """Those of some Parquet files that are there, by the names of their tables."""
        paths = {name: self.file(f"{name}.parquet") for name in names}
        return {name: path for name, path in paths.items() if path.is_file()}

    def without_paths(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        """The figures of a summary, without the files that were written here."""
        return {name: value for name, value in summary.items() if not str(value).startswith(str(self.path))}


def _remove(path: Path, process: int) -> None:
    """Remove a folder; a process that was forked leaves it to its parent."""
    if os.getpid() == process:
        shutil.rmtree(path, ignore_errors=True)
