"""Records that are put aside in blocks of equal length, to be read and replaced in any order, forwards or backwards."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from occlog.io.files.atomic import translate_write_errors

BLOCK = 1 << 14
"""Records of a block."""
IN_MEMORY = 1 << 23
"""Bytes that are kept in memory; more go to a file in the folder for temporary files."""

Records = np.ndarray[Any, np.dtype[Any]]


class Blocks:
    """Records of one type; the file has no name, so that nothing is left of it, however the program ends."""

    def __init__(self, record: np.dtype[Any], block: int = BLOCK, in_memory: int = IN_MEMORY) -> None:
        """No records yet.

        Args:
            record: their type.
            block: records of a block.
            in_memory: how many bytes are kept in memory.
        """
        self._record, self._block, self._in_memory = record, block, in_memory
        self._file: IO[bytes] | None = None
        self._kept: dict[int, Records] = {}
        self._open: list[Records] = []
        self._rows = 0
        self.count = 0
        """Number of blocks, once `end` was called."""

    def __del__(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()

    def append(self, rows: Records) -> None:
        """Some more records; OutputError if the folder for temporary files is full."""
        self._open.append(rows)
        self._rows += len(rows)
        if self._rows < self._block:
            return
        together = np.concatenate(self._open)
        whole = self._rows - self._rows % self._block
        for start in range(0, whole, self._block):
            self.put(self.count, together[start : start + self._block])
            self.count += 1
        self._open, self._rows = [together[whole:].copy()], self._rows - whole

    def end(self) -> None:
        """Say that all records are there."""
        if self._rows:
            self.put(self.count, np.concatenate(self._open))
            self.count += 1
        self._open, self._rows = [], 0

    def put(self, number: int, rows: Records) -> None:
        """Write a block; all but the last one have the same length."""
        if self._file is None:
            self._kept[number] = rows.copy()
            if sum(each.nbytes for each in self._kept.values()) <= self._in_memory:
                return
        with translate_write_errors(Path(tempfile.gettempdir())):
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115 - as long as these are
                for at, each in self._kept.items():
                    self._write(self._file, at, each)
                self._kept = {}
            else:
                self._write(self._file, number, rows)
            self._file.flush()

    def _write(self, file: IO[bytes], number: int, rows: Records) -> None:
        file.seek(number * self._block * self._record.itemsize)
        file.write(rows.tobytes())

    def get(self, number: int) -> Records:
        """A block that was written."""
        if self._file is None:
            return self._kept[number]
        self._file.seek(number * self._block * self._record.itemsize)
        return np.frombuffer(self._file.read(self._block * self._record.itemsize), dtype=self._record)

    def rows(self, first: int, last: int) -> Records:
        """Records from one number up to another, which is left out, once `end` was called."""
        parts = [np.zeros(0, dtype=self._record)]
        for number in range(first // self._block, -(-last // self._block)):
            start = number * self._block
            parts.append(self.get(number)[max(first - start, 0) : last - start])
        return np.concatenate(parts)
