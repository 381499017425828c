"""Standard output and standard error with defined behaviour if the reader has closed or the disk is full.

* Standard error: a message that cannot be written is dropped; the work goes on.
* Standard output: a reader that went away (`| head`) ends the program quietly, as SIGPIPE ends other programs; a full
  disk is an error of one line.
* Control characters in names and values, and those that turn the direction of writing, become escapes: text of a file
  does not move the cursor of a terminal, nor reorder a line.  Bytes that an output is (`-o -`) stay as they are.
* A stream that was closed before the program began has no reader, and has nothing to be read.
"""

from __future__ import annotations

import io
import os
import sys
from typing import TYPE_CHECKING, TextIO

from occlog.console.text import escaped
from occlog.errors import ExitCode, OcclogError, OutputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


class ReaderGoneError(OcclogError):
    """Raised if the program that reads standard output has closed it."""

    exit_code = ExitCode.PIPE


class _Output(io.FileIO):
    """A standard stream; the first failure of writing is raised, and further output is discarded."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write `data` and return the number of bytes; the first failure is reported, later output is discarded."""
        try:
            return super().write(data)
        except OSError as error:
            _send_nowhere(self.fileno())
            return self._failed(error, len(memoryview(data)))

    def _failed(self, error: OSError, size: int) -> int:  # noqa: ARG002
        if isinstance(error, BrokenPipeError):
            raise ReaderGoneError("standard output: its reader has closed it") from error
        raise OutputError(f"standard output: cannot be written: {error.strerror or error}; free some space") from error


class _Text(io.TextIOWrapper):
    """Text layer of a standard stream that escapes control characters, which come from names and values in files."""

    bars = False

    def write(self, text: str, /) -> int:
        """Write a text, and return the number of its characters; a byte that is not UTF-8 is written as an escape."""
        super().write(escaped(text, bars=self.bars))
        return len(text)


class _TextWithBars(_Text):
    """Text layer of standard error, which also passes the control characters of progress bars."""

    bars = True


class _Messages(_Output):
    """Standard error; text that cannot be written is discarded."""

    def _failed(self, error: OSError, size: int) -> int:  # noqa: ARG002
        return size


def _send_nowhere(fd: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, fd)
    os.close(nowhere)


def install() -> None:
    """Replace the standard streams of this process if they are files, pipes or closed."""
    _open_closed()
    sys.stdout = _wrapped(sys.stdout, _Output)
    sys.stderr = _wrapped(sys.stderr, _Messages)


def _open_closed() -> None:
    """Open closed standard streams on the null device, so that an output file does not get their descriptors."""
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(fd, True)
    os.close(fd)
    for descriptor, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8", closefd=False))


def _wrapped(stream: TextIO, kind: type[_Output]) -> TextIO:
    if not isinstance(stream, io.TextIOWrapper):  # none, where it was closed before the program began
        return stream
    stream.flush()
    raw = kind(stream.fileno(), "wb", closefd=False)
    lines = stream.line_buffering or stream.write_through or kind is _Messages
    # Names of files and cameras may have what an encoding has not: an escape is better than no answer.
    errors = "backslashreplace" if stream.errors == "strict" else stream.errors
    text = _TextWithBars if kind is _Messages else _Text
    return text(io.BufferedWriter(raw), encoding=stream.encoding, errors=errors, newline="\n", line_buffering=lines)
