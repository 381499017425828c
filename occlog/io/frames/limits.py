"""Resource limits of a decoding process: memory, time, files."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from pathlib import Path

with suppress(ImportError):  # no such limits on Windows
    import resource
LIMITED = "resource" in globals()

MAX_PIXELS = 100_000_000
"""Larger images are refused: 8192 x 8192 has 67 million pixels."""
MEMORY = 2 * 2**30
"""Address space of a decoder [B]; a damaged file can ask for any amount."""
MEMORY_PER_PIXEL = 24
"""Size added for each pixel of a frame [B]: 16 reference frames of YUV 4:2:0."""
SECONDS = 60
"""CPU time from one frame to the next [s]."""
BYTES_PER_SECOND = 10_000_000
"""A pass over all packets of a file is given a second for this many bytes."""
FILES = 64
"""Files that may be open at once; a decoder opens one."""
WRITTEN = 16 * 2**20
"""Size of a file that is written [B]: one limit holds, by what the decoders report."""


def lower_limits(memory: int | None = MEMORY) -> None:
    """Set the limits of this process that are equal for all inputs: memory, core dumps, size and number of files.

    Args:
        memory: address space [bytes]; None: not limited.
    """
    if LIMITED:
        if memory is not None:
            _set(resource.RLIMIT_AS, memory)
        _set(resource.RLIMIT_CORE, 0)
        _set(resource.RLIMIT_FSIZE, WRITTEN)
        _set(resource.RLIMIT_NOFILE, FILES)


def allow_pixels(pixels: int) -> None:
    """Set the limit of address space to what frames of this many pixels need."""
    if LIMITED:
        _set(resource.RLIMIT_AS, MEMORY + MEMORY_PER_PIXEL * pixels)


class CpuTimeLimit:
    """Limit of the processor time of this process per frame: it is extended with every frame."""

    def __init__(self, path: Path | None = None, seconds: int | None = None) -> None:
        """Set the limit for the first frame.

        Args:
            path: file that is read as a whole first, for which time is added by its size; None: no such file.
            seconds: processor time from one frame to the next [s]; None: `SECONDS`.
        """
        size = 0
        if path is not None:
            with suppress(OSError):
                size = path.stat().st_size
        self._seconds = (SECONDS if seconds is None else seconds) + size // BYTES_PER_SECOND
        self._moved_on = -math.inf
        self.go_on()

    def go_on(self) -> None:
        """Extend the limit for the next frame, at most once a second."""
        now = time.monotonic()
        if LIMITED and now - self._moved_on >= 1:
            self._moved_on = now
            _set(resource.RLIMIT_CPU, int(time.process_time()) + 2 + self._seconds)


def _set(kind: int, value: int) -> None:
    """Set the soft limit of the resource `kind` (`resource.RLIMIT_...`), at most to the hard one.

    Errors are ignored.
    """
    with suppress(ValueError, OSError):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
