"""Files that were fetched, kept in a folder of bounded size that several processes share.

An entry is used while somebody holds its lock, and is never removed meanwhile; a process that is killed lets go.  So
the folder holds at most its limit, or what is in use if that is more.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from occlog.errors import InputError, OutputError, option
from occlog.io.files.provenance import hash_file
from occlog.io.recording.reader import linked_videos, open_recording

from .store import fetch, version
from .urls import identity, shown

LOCK, SCRATCH = ".lock", "scratch-"


@dataclass(frozen=True)
class Cache:
    """A folder of fetched files.

    Attributes:
        folder: made if missing.
        limit: bytes of what is kept when nobody uses it.
    """

    folder: Path
    limit: int

    @contextmanager
    def holding(self, url: str) -> Iterator[Path]:
        """Fetch a recording, and the videos beside it that it links to; it stays while the block lasts.

        Raises:
            InputError: it is not there, may not be read, came incomplete, or is larger than the limit.
        """
        told = version(url)
        if told.size is not None and told.size > self.limit:
            raise InputError(f"{shown(url)}: has {told.size} bytes, limit {self.limit}; raise {option('cache_limit')}")
        key = hashlib.sha256(f"{identity(url)}\0{told.size}\0{told.mark}".encode()).hexdigest()[:32]
        # Without a mark nobody knows whether the file is still what it was
        with self._using(key) if told.mark else self.scratch() as entry:
            file = entry / PurePosixPath(shown(url)).name
            with _fetching(entry):
                if not file.exists():
                    self._fetch(url, file, told.size)
                for video in linked_videos(file):
                    self._fetch_beside(url, file, video)
            yield file

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """A new empty folder that is removed at the end; if the process is killed, by the next one."""
        with self._using(f"{SCRATCH}{uuid.uuid4().hex}") as entry:
            try:
                yield entry
            finally:
                shutil.rmtree(entry, ignore_errors=True)

    def _fetch_beside(self, url: str, recording: Path, video: Path) -> None:
        """Fetch a linked video that lies in the recording's folder; whoever reads others says what is wrong."""
        name = video.name
        if video.parent != recording.parent or video.exists() or name in (".", ".."):
            return
        there = url.partition("?")[0].rpartition("/")[0] + f"/{name}"
        self._fetch(there, video, version(there).size)
        if hash_file(video) not in [link.get("sha256") for link in open_recording(recording).videos.values()]:
            video.unlink()
            raise InputError(
                f"{shown(there)}: is not the video that {recording.name} links to (SHA-256); put that one there"
            )

    def _fetch(self, url: str, file: Path, wanted: int | None) -> None:
        """Fetch a file of so many bytes; None: nobody knows how many."""
        self._trim(wanted or 0)
        size = fetch(url, file)
        if wanted is not None and size != wanted:
            file.unlink()
            raise InputError(f"{shown(url)}: came with {size} bytes of {wanted}; try again")

    @contextmanager
    def _using(self, key: str) -> Iterator[Path]:
        entry = self.folder / key
        try:
            with self._managed():
                entry.mkdir(exist_ok=True)
                lock = (self.folder / f"{key}{LOCK}").open("a")
                fcntl.flock(lock, fcntl.LOCK_SH)
        except OSError as error:
            raise OutputError(f"{self.folder}: the cache cannot be written: {error.strerror or error}") from error
        try:
            yield entry
        finally:
            # The system's own time of a file has steps of some ms, in which two would be used at once
            now = time.time_ns()
            os.utime(lock.fileno(), ns=(now, now))
            lock.close()
            self._trim(0)

    @contextmanager
    def _managed(self) -> Iterator[None]:
        """Nobody else looks at locks meanwhile."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / LOCK).open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _trim(self, wanted: int) -> None:
        """Remove entries that nobody uses, oldest first, until so many bytes more fit in; scratch folders anyway."""
        with self._managed():
            locks = sorted(self.folder.glob(f"?*{LOCK}"), key=lambda lock: (lock.stat().st_mtime_ns, lock.name))
            sizes = {lock: _size(self._entry(lock)) for lock in locks}
            room = self.limit - wanted - sum(sizes.values())
            for lock in locks:
                stale = lock.name.startswith(SCRATCH)
                if (room < 0 or stale) and self._drop(lock):
                    room += sizes[lock]

    def _entry(self, lock: Path) -> Path:
        return self.folder / lock.name.removesuffix(LOCK)

    def _drop(self, lock: Path) -> bool:
        """Remove an entry and its lock, unless somebody uses it."""
        with lock.open("a") as held:
            if not _alone(held):
                return False
            shutil.rmtree(self._entry(lock), ignore_errors=True)
            lock.unlink()
        return True


def default_folder() -> Path:
    """The user's folder for what can be fetched again: `OCCLOG_CACHE`, or `occlog` in the user's caches."""
    told = os.environ.get("OCCLOG_CACHE")
    if told:
        return Path(told)
    caches = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(caches) / "occlog"


@contextmanager
def _fetching(entry: Path) -> Iterator[None]:
    """Nobody else fetches into an entry meanwhile; whoever comes later finds what was fetched."""
    descriptor = os.open(entry, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _alone(lock: IO[str]) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _size(folder: Path) -> int:
    """Bytes of the files in a folder, which whoever uses it may remove meanwhile."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                total += (Path(place) / name).stat().st_size
    return total
