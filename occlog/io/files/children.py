"""Child processes that parse files: environment, pipes and exit codes."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # Windows
    PIPE_SIZE_OPTION = None
else:
    PIPE_SIZE_OPTION = getattr(fcntl, "F_SETPIPE_SZ", None)

import occlog

PIPE_SIZE = 1 << 20
"""Bytes that a pipe holds, where the system lets it: images go through in few pieces."""
_OF_OPENCV = ("OPENCV_FFMPEG_", "OPENCV_LOG", "OPENCV_IO_")


def environment_for_children() -> dict[str, str]:
    """Environment variables for a child process `python -P -m occlog...`, so that it imports this same package.

    OpenBLAS is limited to one thread, and settings of OpenCV's video readers and relative import paths are removed.
    """
    found = {k: v for k, v in os.environ.items() if not k.startswith(_OF_OPENCV)}
    package = str(Path(occlog.__file__).resolve().parents[1])
    found["OPENBLAS_NUM_THREADS"] = "1"  # others take address space, and NumPy computes nothing there
    # Entries that are empty or relative would name the current folder, or one in it
    others = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if Path(path).is_absolute()]
    found["PYTHONPATH"] = os.pathsep.join([package, *others])
    return found


def enlarge_pipe(pipe: IO[bytes] | None) -> None:
    """Enlarge the buffer of a pipe to `PIPE_SIZE` bytes if the system supports it; None is ignored."""
    if PIPE_SIZE_OPTION is not None and pipe is not None:
        with suppress(OSError):
            fcntl.fcntl(pipe, PIPE_SIZE_OPTION, PIPE_SIZE)


def exit_description(code: int, too_long: str) -> str:
    """Words on how a process ended, as the end of a sentence: `crashed (SIGSEGV)`, `stopped with exit code 1`.

    Args:
        code: exit code, or minus the number of the signal that ended it.
        too_long: limit that is named if the limit of processor time ended it, as `60 s of processor time`.
    """
    if code >= 0:
        return f"stopped with exit code {code}"
    if code == -getattr(signal, "SIGXCPU", 0):
        return f"took more than {too_long}"
    with suppress(ValueError):
        return f"crashed ({signal.Signals(-code).name})"
    return f"crashed (signal {-code})"
