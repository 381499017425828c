"""Where a URL leads: find, read and write files there; every failure is one line that names the URL alone."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from occlog.errors import InputError, OcclogError, OutputError, UsageError

from .urls import EXTRAS, READ_ONLY, kind_of, scrubbed, shown

MARKS = ("ETag", "etag", "LastModified", "mtime", "created", "md5Hash")
"""What file systems tell of a file that changes when the file does."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

SILENCE = 60.0
"""Time that a web server may say nothing [s]."""

PART = ".part"
"""Name of a file that has not come whole; one at a time is fetched into a folder."""

GONE = (404, 410)
"""Answers of a web server that say that a file is not there; others, as 403 and 503, do not."""


class Version(NamedTuple):
    """What is known of a file before it is fetched.

    Attributes:
        size: bytes; None: the server does not say.
        mark: changes when the file does; empty: the server gives none.
    """

    size: int | None
    mark: str


@contextmanager
def _told(url: str, failure: type[OcclogError] = InputError) -> Iterator[None]:
    """Turn what file systems raise into one line."""
    try:
        yield
    except OcclogError:
        raise
    except ImportError as error:
        extra = EXTRAS[kind_of(url)]
        raise UsageError(f"{shown(url)}: wants a package that is not installed; install occlog[{extra}]") from error
    except FileNotFoundError as error:
        reason = _unreached(error)
        if reason is not None:
            raise failure(f"{shown(url)}: cannot be reached: {scrubbed(str(reason))}; try again") from error
        raise failure(f"{shown(url)}: no such file") from None
    except Exception as error:  # each file system has errors of its own
        if isinstance(error, OSError) and error.errno in FULL:
            raise  # of this machine
        words = scrubbed(str(error))
        raise failure(f"{shown(url)}: {type(error).__name__}{f': {words}' if words else ''}; try again") from None


def _unreached(error: FileNotFoundError) -> BaseException | None:
    """Why nobody knows whether a file is there: fsspec says of all that a web server does not give that it is not."""
    cause = error.__cause__
    if isinstance(cause, OSError) and not isinstance(cause, FileNotFoundError):
        return cause  # no such host, no connection, a time limit
    return cause if getattr(cause, "status", None) not in (None, *GONE) else None


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    kind = kind_of(url)
    import fsspec

    settings = {}
    if kind in READ_ONLY:
        import aiohttp

        # Its own limit is for the whole file, and five minutes
        settings = {"client_kwargs": {"timeout": aiohttp.ClientTimeout(total=None, connect=SILENCE, sock_read=SILENCE)}}
    return fsspec.core.url_to_fs(url, **settings)  # type: ignore[no-any-return]


def find(pattern: str) -> list[str]:
    """URLs of the files that a pattern finds, sorted; a URL without `*`, `[` is its own."""
    if not any(mark in pattern.partition("?")[0] for mark in "*["):
        kind_of(pattern)
        return [pattern]
    with _told(pattern):
        system, path = _opened(pattern)
        there = system.glob(path, detail=True).items()
        found = sorted(str(system.unstrip_protocol(each)) for each, told in there if told.get("type") != "directory")
        return found or [pattern] * system.exists(path)  # its name has brackets


def version(url: str) -> Version:
    """What is known of a file; InputError where it is not there, or may not be read."""
    with _told(url):
        system, path = _opened(url)
        told = system.info(path)
        marks = [str(told[key]) for key in MARKS if key in told]
        size = told.get("size")
        return Version(None if size is None else int(size), " ".join(marks))


def fetch(url: str, file: Path) -> int:
    """Copy a file to this machine; its size. What was there is replaced by the whole file or not at all."""
    part = file.with_name(PART)
    try:
        with _told(url):
            system, path = _opened(url)
            system.get_file(path, str(part))
        part.replace(file)
        return file.stat().st_size
    except OSError as error:
        raise OutputError(f"{file.parent}: cannot keep {shown(url)}: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def check_output(url: str) -> None:
    """UsageError for a URL that nothing can be written to."""
    if kind_of(url) in READ_ONLY:
        raise UsageError(
            f"{shown(url)}: nothing can be written to a web server; name a folder, or one in s3:// or gs://"
        )


def put(file: Path, url: str) -> None:
    """Write a whole file, replacing what was there."""
    with _told(url, OutputError):
        system, path = _opened(url)
        system.pipe_file(path, file.read_bytes())


def names_in(url: str) -> list[str]:
    """Names of files and folders in a folder, sorted; none where it is not there."""
    with _told(url):
        system, path = _opened(url)
        system.invalidate_cache()
        try:
            found = [str(each).rstrip("/") for each in system.ls(path, detail=False)]
            # Stores have empty files that stand for the folder itself
            return sorted(Path(each).name for each in found if each != path.rstrip("/"))
        except FileNotFoundError:
            return []


def remove(urls: Iterable[str]) -> None:
    """Remove files, where they are there."""
    for url in urls:
        with _told(url, OutputError):
            system, path = _opened(url)
            if system.exists(path):
                system.rm_file(path)
