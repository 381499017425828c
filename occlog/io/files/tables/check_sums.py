"""Check sums of every byte of a Parquet file, in a trailer that stands before its footer.

The format has check sums of the data of pages alone: a flipped bit in the head of a page is a wrong number, one in
the footer a wrong unit, or a list of losses that is gone.  Programs that do not know the trailer pass it over, since
they find pages by their places and the footer from the end.

    head and pages | check sums of blocks | trailer | footer | length of the footer | PAR1
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple, Self

from occlog.errors import InputError

BLOCK = 1 << 16
"""Bytes of the file that one check sum is of: what is read of the file is checked, and less than this beside it."""
MARK = b"occlogCS"
_TRAILER = struct.Struct("<8sQIIII8s")
_FOOTER_END = struct.Struct("<I4s")


class Trailer(NamedTuple):
    """Where the checked bytes end, and the CRC-32 of each block of them."""

    end: int
    sums: tuple[int, ...]


class Summed:
    """Binary output of a Parquet writer, of which check sums are kept and put before the footer."""

    def __init__(self, file: IO[bytes]) -> None:
        """Write to `file`, from its beginning."""
        self._file = file
        self._sums: list[int] = []
        self._sum = 0
        self._size = 0
        self._end: bytearray | None = None
        self._span = 0
        self.closed = False

    def begin_span(self) -> int:
        """Begin a check sum of what follows; its place in the file."""
        self._span = 0
        return self._size

    def end_span(self) -> int:
        """The CRC-32 of what was written since `begin_span`."""
        return self._span

    def write(self, data: bytes) -> int:
        """Write, or keep what may be the footer."""
        view = memoryview(data).cast("B")
        if self._end is None:
            self._put(view)
        else:
            self._end += view
        return len(view)

    def _put(self, view: memoryview) -> None:
        self._file.write(view)
        self._span = zlib.crc32(view, self._span)
        for start in _parts(self._size, len(view)):
            part = view[start : start + BLOCK - (self._size % BLOCK)]
            self._sum = zlib.crc32(part, self._sum)
            self._size += len(part)
            if self._size % BLOCK == 0:
                self._sums.append(self._sum)
                self._sum = 0

    def tell(self) -> int:
        """Number of bytes so far."""
        return self._size + len(self._end or b"")

    def flush(self) -> None:
        """Do nothing: the file is flushed when it is complete."""

    def close(self) -> None:
        """Do nothing: the file is closed by whoever opened it."""

    def begin_end(self) -> None:
        """Say that what follows ends with the footer."""
        self._end = bytearray()

    def finish(self) -> None:
        """Write check sums and footer."""
        held = bytes(self._end or b"")
        self._end = None
        length, _ = _FOOTER_END.unpack(held[-_FOOTER_END.size :])
        at = len(held) - _FOOTER_END.size - length
        self._put(memoryview(held[:at]))
        sums = [*self._sums, self._sum] if self._size % BLOCK else self._sums
        packed = struct.pack(f"<{len(sums)}I", *sums)
        fields = (self._size, BLOCK, len(sums), zlib.crc32(held[at:]))
        own = zlib.crc32(packed + struct.pack("<QIII", *fields))
        self._file.write(packed + _TRAILER.pack(MARK, *fields, own, MARK) + held[at:])


def _parts(begin: int, length: int) -> range | list[int]:
    """Where in `length` bytes that begin at `begin` of the file the parts of blocks begin."""
    first = BLOCK - begin % BLOCK
    return [0, *range(first, length, BLOCK)] if length else []


class Checked:
    """Binary input that gives no byte whose check sum was not tried; for pyarrow, which takes it as a file.

    Files without a trailer, which others wrote, or occlog before it had check sums, are given as they are.
    """

    def __init__(self, path: Path) -> None:
        """Open `path` and try the check sums of its footer.

        Raises:
            InputError: they are wrong.
            OSError: it cannot be read.
        """
        self.path = path
        self._file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)  # by bytes: names that are not UTF-8, too
        self._at = 0
        self.closed = False
        try:
            self.size = os.fstat(self._file).st_size
            self.trailer = self._find_trailer()
        except BaseException:
            self.close()
            raise
        self._tried = bytearray(len(self.trailer.sums) if self.trailer else 0)

    def _find_trailer(self) -> Trailer | None:
        tail = os.pread(self._file, _FOOTER_END.size, max(self.size - _FOOTER_END.size, 0))
        if len(tail) < _FOOTER_END.size:
            return None
        at = self.size - _FOOTER_END.size - _FOOTER_END.unpack(tail)[0]
        if at < _TRAILER.size:
            return None
        raw = os.pread(self._file, _TRAILER.size, at - _TRAILER.size)
        mark, end, block, count, footer, own, again = _TRAILER.unpack(raw)
        if MARK not in (mark, again):
            return None
        if mark != again or end + 4 * count + _TRAILER.size != at or block != BLOCK or count != -(-end // BLOCK):
            raise self._wrong("its check sums", end)
        packed = os.pread(self._file, 4 * count, end)
        if zlib.crc32(packed + struct.pack("<QIII", end, block, count, footer)) != own:
            raise self._wrong("its check sums", end)
        if zlib.crc32(os.pread(self._file, self.size - at, at)) != footer:
            raise self._wrong("its footer, with units and provenance,", at)
        return Trailer(end, struct.unpack(f"<{count}I", packed))

    def footer(self) -> bytes | None:
        """The footer with its length and mark, whose check sum is right; None: the file has no check sums."""
        if self.trailer is None:
            return None
        tail = os.pread(self._file, _FOOTER_END.size, self.size - _FOOTER_END.size)
        length = _FOOTER_END.size + _FOOTER_END.unpack(tail)[0]
        return os.pread(self._file, length, self.size - length)

    def _wrong(self, what: str, at: int) -> InputError:
        return InputError(
            f"{self.path}: damaged: {what} at byte {at} of {self.size} changed since it was written (wrong check "
            "sum); copy it again, make it again, or salvage the rest by `occlog recover`"
        )

    def read(self, size: int = -1) -> bytes | memoryview:
        """The next bytes, whose blocks are right; InputError for a block that is not."""
        size = max(self.size - self._at, 0) if size < 0 else size
        begin, self._at = self._at, min(self._at + size, self.size)
        return self.read_at(begin, size)

    def peek(self, begin: int, size: int) -> bytes:
        """Bytes from a place on, as many as there are of `size`, whether they are right or not."""
        return os.pread(self._file, size, begin)

    def read_at(self, begin: int, size: int) -> bytes | memoryview:
        """Bytes from a place on, as many as there are of `size`; InputError for a block that is not right."""
        end = min(begin + size, self.size)
        blocks = range(begin // BLOCK, -(-min(end, self.trailer.end) // BLOCK)) if self.trailer else range(0)
        if all(self._tried[block] for block in blocks):
            return os.pread(self._file, size, begin)
        assert self.trailer is not None
        low, high = blocks.start * BLOCK, max(min(blocks.stop * BLOCK, self.trailer.end), end)
        data = memoryview(self._read_all(low, high))
        for block in blocks:
            at = block * BLOCK
            if zlib.crc32(data[at - low : min(at + BLOCK, self.trailer.end) - low]) != self.trailer.sums[block]:
                raise self._wrong("a block", at)
            self._tried[block] = 1
        return data[begin - low : end - low]

    def _read_all(self, low: int, high: int) -> bytes:
        data = os.pread(self._file, high - low, low)
        while len(data) < high - low:  # a read gives 2 GiB at most
            more = os.pread(self._file, high - low - len(data), low + len(data))
            if not more:
                break
            data += more
        return data

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def tell(self) -> int:
        """Place of the next byte."""
        return self._at

    def readable(self) -> bool:
        """Whether it can be read: yes."""
        return True

    def seekable(self) -> bool:
        """Whether places can be gone to: yes."""
        return True

    def writable(self) -> bool:
        """Whether it can be written: no."""
        return False

    def close(self) -> None:
        """Let go of the file."""
        if not self.closed:
            self.closed = True
            os.close(self._file)

    def __enter__(self) -> Self:
        """The file itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go of the file."""
        self.close()
