"""Standard output and standard error that state clearly what happens when their reader has closed, or no space is left.

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
    """Error: the reader of standard output has closed it."""

    exit_code = ExitCode.PIPE


class _Output(io.FileIO):
    """A standard stream; after a failure the rest of the output is discarded."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write; a failure is reported once."""
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
    """Text of a standard stream, in which control characters of names and values are escapes."""

    bars = False

    def write(self, text: str, /) -> int:
        """Write a text; a byte of a name that is no UTF-8 stays the escape that the encoding makes of it."""
        super().write(escaped(text, bars=self.bars))
        return len(text)


class _TextWithBars(_Text):
    """Text of standard error, to which progress bars write, too."""

    bars = True


class _Messages(_Output):
    """Standard error: what cannot be written is dropped."""

    def _failed(self, error: OSError, size: int) -> int:  # noqa: ARG002
        return size


def _send_nowhere(fd: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, fd)
    os.close(nowhere)


def install() -> None:
    """Replace the standard streams of this process, where they are files or pipes, or closed."""
    _open_closed()
    sys.stdout = _wrapped(sys.stdout, _Output)
    sys.stderr = _wrapped(sys.stderr, _Messages)


def _open_closed() -> None:
    """Give streams that are closed a position; else the next file that is opened, an output perhaps, would be one."""
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
