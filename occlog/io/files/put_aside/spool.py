"""Numbers that are put aside: in memory while they are few, then in a file without a name."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from occlog.array_types import Floats
from occlog.io.files.atomic import translate_write_errors

IN_MEMORY = 1 << 20
"""Numbers that are kept in memory; more go to a file in the folder for temporary files, 8 bytes each."""
BLOCK = 1 << 17
"""Numbers that are read of the file at once."""


class Spool:
    """Takes numbers in parts, and gives them back in the same order, as often as wanted.

    The file has no name, so that nothing is left of it, however the program ends.
    """

    def __init__(self, in_memory: int = IN_MEMORY) -> None:
        """No numbers yet."""
        self._file: IO[bytes] | None = None
        self.count = 0
        self._in_memory = in_memory
        self._parts: list[Floats] = []
        self._kept = 0

    def __del__(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()

    def add(self, values: Floats) -> None:
        """Some more numbers; OutputError if the folder for temporary files is full."""
        self.count += len(values)
        self._parts.append(np.array(values, dtype=np.float64))
        self._kept += len(values)
        if self._kept > self._in_memory:
            with translate_write_errors(Path(tempfile.gettempdir())):
                if self._file is None:
                    self._file = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the spool
                for part in self._parts:
                    self._file.write(part.tobytes())
                self._file.flush()
            self._parts, self._kept = [], 0

    @property
    def whole(self) -> Floats | None:
        """(N,) all numbers; None where they are in a file."""
        if self._file is not None:
            return None
        self._parts = [np.concatenate([np.zeros(0), *self._parts])]
        return self._parts[0]

    def blocks(self) -> Iterator[Floats]:
        """All numbers."""
        if self._file is not None:
            self._file.seek(0)
            while data := self._file.read(8 * BLOCK):
                yield np.frombuffer(data, dtype=np.float64)
            self._file.seek(0, 2)
        yield from self._parts
