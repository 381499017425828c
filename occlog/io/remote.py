"""Files in object stores and on web servers, by fsspec: listed, fetched into a bounded cache, and written.

Several processes share the cache folder. An entry is locked while it is used, and removed only when unlocked; the lock
of a killed process is released. So the folder holds at most its limit, or the files in use if these are larger. Errors
are one line that names the URL. Credentials in URLs (passwords before the host, signatures in the query) are sent to
the server only, and removed from tables, provenance and messages.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import time
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, NamedTuple

from occlog.errors import InputError, OcclogError, OutputError, UsageError, option

from .files.provenance import hash_file
from .recording.reader import linked_videos, open_recording

with suppress(ImportError):  # no such locks on Windows
    import fcntl

PACKAGES = {"s3": "s3fs", "gs": "gcsfs", "https": "fsspec aiohttp", "http": "fsspec aiohttp", "memory": "fsspec"}
"""Kinds of URLs, and the packages that each requires."""
READ_ONLY = ("https", "http")
"""Kinds that nothing is written to."""
_URL = re.compile(r"^([A-Za-z][A-Za-z0-9+.-]*)(?:::|://)")
_SECRETS = re.compile(r"(?<=://)[^/@\s'\"]*@|\?[^\s'\")>]+")
_SIGNATURE = re.compile(
    r"(?:x-amz-|x-goog-|awsaccesskeyid=|googleaccessid=|signature=|expires=|key-pair-id=|policy=)", re.IGNORECASE
)
"""Beginning of the parts of a query that differ each time that a URL is signed."""
MAX_WORDS = 160
"""Characters of the words of a library that a message repeats."""


def is_url(text: str) -> bool:
    """Whether a text is a URL (`SCHEME://...`) rather than a file name."""
    return _URL.match(text) is not None


def kind_of(url: str) -> str:
    """Scheme of a URL in lower case, e.g. `s3`; UsageError for schemes that are not supported."""
    found = _URL.match(url)
    kind = found.group(1).lower() if found else ""
    if kind not in PACKAGES or "::" in url:
        raise UsageError(
            f"{public_url(url)}: {kind}: is not taken; give a file, or one of {', '.join(PACKAGES)}",
            id="unsupported-format",
        )
    return kind


def without_end(location: str) -> str:
    """Location without trailing slashes if it is a URL, since in object stores `a//b` differs from `a/b`."""
    kind, mark, path = location.partition("://")
    return f"{kind}{mark}{path.rstrip('/')}" if is_url(location) else location


def public_url(url: str) -> str:
    """URL without user, password, query and fragment, for messages and tables."""
    kind, mark, rest = url.partition("://")
    path = re.split(r"[?#]" if kind.lower() in READ_ONLY else r"[?]", rest, maxsplit=1)[0]
    host, slash, below = path.partition("/")
    return f"{kind}{mark}{host.rpartition('@')[2]}{slash}{below}"


def identity(url: str) -> str:
    """URL without credentials (user, password, signatures in the query), which identifies the file."""
    query = url.partition("?")[2].partition("#")[0]
    asked = "&".join(part for part in query.split("&") if not _SIGNATURE.match(part))
    return f"{public_url(url)}?{asked}" if asked else public_url(url)


def without_secrets(text: str) -> str:
    """Text of an error in one line of at most `MAX_WORDS` characters, without credentials and queries of URLs."""
    return _SECRETS.sub("", " ".join(text.split()))[:MAX_WORDS]


MARKS = ("ETag", "etag", "LastModified", "mtime", "created", "md5Hash")
"""File system entries that change when a file does."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

SILENCE = 60.0
"""Time that a web server may state nothing [s]."""

PART = ".part"
"""Name of a file that has not come whole; one at a time is fetched into a folder."""

GONE = (404, 410)
"""Answers of a web server that state that a file is not there; others, as 403 and 503, do not."""


class Version(NamedTuple):
    """State of a remote file, by which changes are detected.

    Attributes:
        size: bytes; None: the server does not state it.
        mark: text that changes when the file does (ETag, time); empty: the server gives none.
    """

    size: int | None
    mark: str


@contextmanager
def _as_output_error(url: str, failure: type[OcclogError] = InputError) -> Iterator[None]:
    """Context manager that converts exceptions of remote file systems to one-line errors of the type `failure`.

    UsageError if the package for such URLs is not installed; errors of a full local disk are passed on. `url` is named
    without credentials.
    """
    try:
        yield
    except OcclogError:
        raise
    except ImportError as error:
        packages = PACKAGES[kind_of(url)]
        raise UsageError(
            f"{public_url(url)}: requires a package that is not installed; pip install {packages}", id="missing-package"
        ) from error
    except FileNotFoundError as error:
        reason = _unreached(error)
        if reason is not None:
            raise failure(f"{public_url(url)}: cannot be reached: {without_secrets(str(reason))}; try again") from error
        raise failure(f"{public_url(url)}: no such file") from None
    except Exception as error:  # each file system has its own errors
        if isinstance(error, OSError) and error.errno in FULL:
            raise  # of this machine
        words = without_secrets(str(error))
        raise failure(f"{public_url(url)}: {type(error).__name__}{f': {words}' if words else ''}; try again") from None


def _unreached(error: FileNotFoundError) -> BaseException | None:
    """Why it is unknown whether a file exists, as the exception of the connection; None if it is missing.

    fsspec reports every refusal of a web server as a missing file.
    """
    cause = error.__cause__
    if isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError):
        return cause  # no such host, no connection, a time limit
    return cause if getattr(cause, "status", None) not in (None, *GONE) else None


def _opened(url: str) -> tuple[Any, str]:
    """File system of a URL, of the library fsspec, and the path in it."""
    kind = kind_of(url)
    import fsspec

    settings = {}
    if kind in READ_ONLY:
        import aiohttp

        # Its own limit is for the whole file, and five minutes
        settings = {"client_kwargs": {"timeout": aiohttp.ClientTimeout(total=None, connect=SILENCE, sock_read=SILENCE)}}
    return fsspec.core.url_to_fs(url, **settings)  # type: ignore[no-any-return]


def find(pattern: str) -> list[str]:
    """URLs of the files that match a pattern, sorted; a URL without `*` and `[` is returned as it is.

    Empty if none matches.
    """
    if not any(mark in pattern.partition("?")[0] for mark in "*["):
        kind_of(pattern)
        return [pattern]
    with _as_output_error(pattern):
        system, path = _opened(pattern)
        there = system.glob(path, detail=True).items()
        found = sorted(
            str(system.unstrip_protocol(each)) for each, details in there if details.get("type") != "directory"
        )
        return found or [pattern] * system.exists(path)  # its name has brackets


def version(url: str) -> Version:
    """State of the file at a URL, by which changes are detected; InputError if it is missing or unreadable."""
    with _as_output_error(url):
        system, path = _opened(url)
        details = system.info(path)
        marks = [str(details[key]) for key in MARKS if key in details]
        size = details.get("size")
        return Version(None if size is None else int(size), " ".join(marks))


def fetch(url: str, file: Path) -> int:
    """Download the file at `url` to the local path `file`, atomically; return its size [bytes].

    Raises:
        InputError: it is missing or cannot be reached.
        OutputError: the local file cannot be written.
    """
    part = file.with_name(PART)
    try:
        with _as_output_error(url):
            system, path = _opened(url)
            system.get_file(path, str(part))
        part.replace(file)
        return file.stat().st_size
    except OSError as error:
        raise OutputError(f"{file.parent}: cannot keep {public_url(url)}: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def check_output(url: str) -> None:
    """UsageError if nothing can be written to a URL (web servers, unsupported schemes)."""
    if kind_of(url) in READ_ONLY:
        raise UsageError(
            f"{public_url(url)}: nothing can be written to a web server; name a folder, or one in s3:// or gs://",
            id="not-applicable",
        )


def put(file: Path, url: str) -> None:
    """Upload a file to a URL, replacing an existing one; OutputError if that fails."""
    with _as_output_error(url, OutputError):
        system, path = _opened(url)
        system.pipe_file(path, file.read_bytes())


def names_in(url: str) -> list[str]:
    """Names of files and folders in the folder at a URL, sorted; empty if it does not exist."""
    with _as_output_error(url):
        system, path = _opened(url)
        system.invalidate_cache()
        try:
            found = [str(each).rstrip("/") for each in system.ls(path, detail=False)]
            # Stores have empty files that represent the folder itself
            return sorted(Path(each).name for each in found if each != path.rstrip("/"))
        except FileNotFoundError:
            return []


def remove(urls: Iterable[str]) -> None:
    """Delete the files at URLs, as far as they exist; OutputError if that fails."""
    for url in urls:
        with _as_output_error(url, OutputError):
            system, path = _opened(url)
            if system.exists(path):
                system.rm_file(path)


LOCK, SCRATCH = ".lock", "scratch-"


@dataclass(frozen=True)
class Cache:
    """Folder in which fetched files are kept; several processes can share it.

    Attributes:
        folder: made if missing.
        limit: total size of the files that are kept [bytes]; files in use may exceed it.
    """

    folder: Path
    limit: int

    @contextmanager
    def holding(self, url: str) -> Iterator[Path]:
        """Context manager: local copy of the recording at a URL, with the linked videos next to it.

        The copies are fetched unless they are in the cache, and kept at least until the end of the block.

        Raises:
            InputError: the file is missing, cannot be read, came incomplete, or is larger than the limit.
        """
        remote_version = version(url)
        if remote_version.size is not None and remote_version.size > self.limit:
            raise InputError(
                f"{public_url(url)}: has {remote_version.size} bytes, limit {self.limit}; raise "
                f"{option('cache_limit')}",
                id="input-too-large",
            )
        key = hashlib.sha256(f"{identity(url)}\0{remote_version.size}\0{remote_version.mark}".encode()).hexdigest()[:32]
        # Without a mark a change of the file cannot be noticed
        with self._using(key) if remote_version.mark else self.scratch() as entry:
            file = entry / PurePosixPath(public_url(url)).name
            with _fetching(entry):
                if not file.exists():
                    self._fetch(url, file, remote_version.size)
                for video in linked_videos(file):
                    self._fetch_videos(url, file, video)
            yield file

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """Context manager: empty temporary folder in the cache, removed at the end.

        If this process is killed, a later one removes it.
        """
        with self._using(f"{SCRATCH}{uuid.uuid4().hex}") as entry:
            try:
                yield entry
            finally:
                shutil.rmtree(entry, ignore_errors=True)

    def _fetch_videos(self, url: str, recording: Path, video: Path) -> None:
        """Download a linked video that belongs into the recording's folder, and check its SHA-256.

        Nothing is done for a video that exists or is elsewhere, which the reader reports.

        Args:
            url: of the recording.
            recording: local copy of it.
            video: local path of the video.

        Raises:
            InputError: the video is missing, or is not the one that is linked.
        """
        name = video.name
        if video.parent != recording.parent or video.exists() or name in (".", ".."):
            return
        there = url.partition("?")[0].rpartition("/")[0] + f"/{name}"
        self._fetch(there, video, version(there).size)
        if hash_file(video) not in [link.get("sha256") for link in open_recording(recording).videos.values()]:
            video.unlink()
            raise InputError(
                f"{public_url(there)}: is not the video that {recording.name} links to (SHA-256); put that one there",
                id="file-changed",
            )

    def _fetch(self, url: str, file: Path, wanted: int | None) -> None:
        """Download the file at `url` to `file`, after older entries of the cache are removed to make room.

        `wanted` is its expected size [bytes], None: unknown. InputError if it arrives with another size.
        """
        self._trim(wanted or 0)
        size = fetch(url, file)
        if wanted is not None and size != wanted:
            file.unlink()
            raise InputError(f"{public_url(url)}: came with {size} bytes of {wanted}; try again", id="transfer-failed")

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
        """Context manager that makes the folder and holds the lock of the whole cache, waiting for other processes.

        UsageError if the system has no such locks.
        """
        if "fcntl" not in globals():
            raise UsageError(
                "recordings at URLs need file locks, which this system lacks; copy them into a folder",
                id="missing-package",
            )
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / LOCK).open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _trim(self, wanted: int) -> None:
        """Remove abandoned temporary folders, and the least recently used entries until `wanted` more bytes fit."""
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
        """Remove the entry of a lock file, and that file, unless it is in use; return whether it was removed."""
        with lock.open("a") as held:
            if not _alone(held):
                return False
            shutil.rmtree(self._entry(lock), ignore_errors=True)
            lock.unlink()
        return True


def default_folder() -> Path:
    """Default cache folder: the environment variable `OCCLOG_CACHE`, or `occlog` in the user's cache folder."""
    value = os.environ.get("OCCLOG_CACHE")
    if value:
        return Path(value)
    caches = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(caches) / "occlog"


@contextmanager
def _fetching(entry: Path) -> Iterator[None]:
    """Context manager that locks an entry of the cache, so that other processes wait instead of fetching it, too."""
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
    """Total size of the files in a folder [bytes]; files that are removed meanwhile are ignored."""
    total = 0
    for location, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                total += (Path(location) / name).stat().st_size
    return total
