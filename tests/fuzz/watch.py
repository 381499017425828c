"""Reads one input and says what is wrong with how it went: the only ways out are a result and one line.

Whatever else comes is a finding: another exception, a warning, a word on standard error, a file left behind, a line
that does not say which file, more than 10 s, more than 512 MB above what is needed otherwise.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from occlog.errors import OcclogError

from .readers import Reader

SECONDS = 10
"""Of a processor, so that a machine that has other things to do finds the same."""
WAITED_S = 60
"""Twice as long after which something waits for what does not come; once may be a machine that slept."""
MEGABYTES = 512
EVERY = int(os.environ.get("OCCLOG_FUZZ_EVERY", "28"))
"""Of the changes of a list every so many are tried, other ones for each reader; 1: all, as `.ci/run fuzz` does."""


class Outcome(NamedTuple):
    """How it went: `read`, `refused` with the line, or a finding, whose first words tell it from others."""

    kind: str
    detail: str

    @property
    def found(self) -> bool:
        """Whether it is a finding."""
        return self.kind not in ("read", "refused")


class HangError(BaseException):
    """Reading takes too long; no `except Exception` of a reader stops it."""


def _too_long(_: int, __: FrameType | None) -> None:
    raise HangError


class _Waiting:
    """Told of the time that goes by; the second time is a hang."""

    def __init__(self) -> None:
        self._told = 0

    def begin(self) -> None:
        """Wait from now on."""
        self._told = 0
        signal.setitimer(signal.ITIMER_REAL, WAITED_S, WAITED_S)

    def __call__(self, _: int, __: FrameType | None) -> None:
        self._told += 1
        if self._told > 1:
            raise HangError


_waiting = _Waiting()


class Watch:
    """A folder to read in, standard error, time and memory."""

    def __init__(self, folder: Path, error: int) -> None:
        """`error` is a file to which standard error goes."""
        self._folder, self._error = folder, error
        self._peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    def outcome(self, reader: Reader, data: bytes) -> Outcome:
        """Read an input."""
        path = self._folder / reader.file
        if path.parent != self._folder:
            path.parent.mkdir(exist_ok=True)
        for name, content in reader.beside.items():
            (self._folder / name).write_bytes(content)
        path.write_bytes(data)
        before = _files(self._folder)
        self._said()  # what others stated since
        outcome = self._read(reader, path)
        left = _files(self._folder) - before
        reported = self._said()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        grown, self._peak = (peak - self._peak) >> 10, max(peak, self._peak)
        if outcome.found:
            return outcome
        if reported and not reported.startswith(f"occlog: warning: {path}: ") and not reader.noisy:
            return Outcome("standard error", reported)
        if left:
            for each in left:
                Path(each).unlink()
            return Outcome("left behind", ", ".join(sorted(Path(each).name for each in left)))
        return Outcome("memory", f"{grown} MB more than before") if grown > MEGABYTES else outcome

    def _read(self, reader: Reader, path: Path) -> Outcome:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        _waiting.begin()
        try:
            reader.read(path)
        except OcclogError as error:
            return _judged(str(error).replace(f"{self._folder}/", ""), reader)
        except HangError as error:
            return Outcome("hang", _place(error))
        except (Exception, SystemExit) as error:
            statement = " ".join(str(error).split())[:200]
            return Outcome(f"{type(error).__name__} {_place(error)}", statement)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
        return Outcome("read", "")

    def _said(self) -> str:
        size = os.fstat(self._error).st_size
        if not size:
            return ""
        reported = os.pread(self._error, 400, 0).decode(errors="replace")
        os.ftruncate(self._error, 0)
        os.lseek(self._error, 0, os.SEEK_SET)
        return " ".join(reported.split())


def _files(folder: str | Path) -> set[str]:
    """All files in a folder and in those in it."""
    found: set[str] = set()
    with os.scandir(folder) as entries:
        for each in entries:
            if each.is_dir(follow_symlinks=False):
                found |= _files(each.path)
            elif each.is_file():
                found.add(each.path)
    return found


def _judged(line: str, reader: Reader) -> Outcome:
    """Whether the line that refuses a file says which one it is."""
    names = {reader.file, *Path(reader.file).parts, *(part for name in reader.beside for part in Path(name).parts)}
    if not any(name in line for name in names):
        return Outcome("a line without the file", line)
    return Outcome("refused", line)


def _place(error: BaseException) -> str:
    """The last place in occlog, or the last one."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "/occlog/" in f.filename and "/tests/" not in f.filename]
    frame = (own or frames)[-1]
    return f"{frame.filename.rpartition('/occlog/')[2]}:{frame.lineno} {frame.name}"


@contextmanager
def watching() -> Iterator[Watch]:
    """A watch; standard error is kept from the terminal meanwhile."""
    handlers = {signal.SIGALRM: _waiting, signal.SIGPROF: _too_long}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    kept = os.dup(2)
    folder = Path(tempfile.mkdtemp(prefix="occlog-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    with tempfile.TemporaryFile() as error, warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", category=ResourceWarning)
        os.dup2(error.fileno(), 2)
        try:
            yield Watch(folder, error.fileno())
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            for number, handler in before.items():
                signal.signal(number, handler)
            shutil.rmtree(folder)
