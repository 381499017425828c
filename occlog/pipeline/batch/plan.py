"""Recordings of a batch: patterns are expanded, and each recording gets the name of its run folder."""

from __future__ import annotations

import glob
import hashlib
import os
import stat
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from occlog.errors import InputError
from occlog.io.remote import find, is_url
from occlog.io.remote import public_url as without_secrets
from occlog.pipeline.pack.archive import key_of_name

MIN_DIGITS = 8
"""Digits of the hash that distinguishes recordings of one name; more if they do not."""
MAX_PATHS = 1_000_000
"""Paths that a pattern may represent, with folders: links that lead back into their own folder make them endless."""
LONGEST_NAME = 255
"""Bytes of a name that file systems take."""


class BatchRecording(NamedTuple):
    """A recording of a batch.

    Attributes:
        name: name of its run folder; unique, also if case or the encoding of accents is ignored.
        shown: its file name, with the folders that distinguish it from the others.
        location: absolute path or URL.
        fault: why it cannot be processed, as text to follow its name; empty: it can.
    """

    name: str
    shown: str
    location: str
    fault: str = ""


def sources_of(patterns: Sequence[str], results: str = "") -> list[BatchRecording]:
    """Find the recordings that match patterns, without duplicates, sorted by name.

    Of several paths to one recording through links, the one with the fewest links is used, then the first by name. A
    recording is named by its file name without suffix; equal names get a hash of their relative folder, and long names
    are shortened.

    Args:
        patterns: files, patterns with `*`, `?`, `[...]` and `**`, and URLs.
        results: folder of the results, or its URL; files in it are not found.

    Raises:
        InputError: a file is missing, or a pattern matches none.
    """
    locations = _each_once(location for pattern in patterns for location in _places(pattern, results))
    shown = _shown(locations)
    similar: dict[str, list[str]] = defaultdict(list)
    for location in locations:
        similar[key_of_name(_stem(location))].append(location)
    taken = {stem for stem, group in similar.items() if len(group) == 1 and _fits(_stem(group[0]))}
    found = []
    for stem, group in similar.items():
        for location in sorted(group, key=shown.__getitem__):
            name = _stem(location) if stem in taken else _with_hash(_stem(location), shown[location], taken)
            found.append(BatchRecording(name, in_text(shown[location]), location, _fault(location)))
    return sorted(found)


def in_text(name: str) -> str:
    r"""Return a text with bytes that are not UTF-8, as in names of files, written as `\xe9`."""
    bytewise = (f"\\x{ord(c) - 0xDC00:02x}" if 0xDC80 <= ord(c) <= 0xDCFF else c for c in name)
    return "".join(bytewise).encode("utf-8", "backslashreplace").decode()


def in_line(text: str) -> str:
    """Return a message as one line of text, for a table."""
    return in_text(" ".join(text.split()))


def _each_once(locations: Iterable[str]) -> list[str]:
    """Return one path to each recording among `locations`: through the fewest links, of several the first by name."""
    ways: dict[str, set[str]] = defaultdict(set)
    for location in locations:
        ways[location if is_url(location) else os.path.realpath(location)].add(location)
    return [min(each, key=lambda way: (_links(way), way)) if len(each) > 1 else each.pop() for each in ways.values()]


def _links(location: str) -> int:
    """Return the number of symbolic links on the path `location`; 0 for a URL."""
    return 0 if is_url(location) else sum(part.is_symlink() for part in (Path(location), *Path(location).parents))


def _places(pattern: str, results: str) -> Iterable[str]:
    if is_url(pattern):
        return _found(pattern, results)
    if Path(pattern).is_file():  # also one with a name that has brackets
        return [_absolute(pattern)]
    if Path(pattern).is_dir():
        raise InputError(
            f"{pattern}: is a folder; name the recordings in it: '{Path(pattern) / '*.mcap'}'", id="not-a-file"
        )
    if not glob.has_magic(pattern):
        raise InputError(f"{pattern}: no such file; check the name and the folder", id="file-not-found")
    names = list(islice(glob.iglob(pattern, recursive=True), MAX_PATHS + 1))  # noqa: PTH207
    if len(names) > MAX_PATHS:
        raise InputError(
            f"{pattern}: more than {MAX_PATHS:,} paths; where links lead back into their own folder name folders "
            "without them",
            id="input-too-large",
        )
    own = os.path.realpath(results) if results and not is_url(results) else ""
    names = sorted(name for name in names if _may_be_file(name) and not (own and _is_below(name, own)))
    if not names:
        raise InputError(
            f"{pattern}: finds no file; check the pattern, and quote it so that the shell leaves it alone",
            id="file-not-found",
        )
    return [_absolute(name) for name in names]


def _is_below(name: str, folder: str) -> bool:
    return Path(os.path.realpath(name)).is_relative_to(folder)


def _may_be_file(name: str) -> bool:
    """Return whether a path is a regular file, or inaccessible (which is reported later)."""
    try:
        return stat.S_ISREG(Path(name).stat().st_mode)
    except OSError:
        return True


def _fault(location: str) -> str:
    if is_url(location):
        return ""
    try:
        Path(location).stat()
    except FileNotFoundError:
        return "is a symbolic link to a file that is not there; mend or remove it"
    except OSError as error:
        return f"cannot be accessed: {error.strerror}; repair or remove it"
    name = Path(location).name
    return "" if in_text(name) == name else "its name is not UTF-8, as names in tables have to be; rename it"


def _absolute(name: str) -> str:
    """Return an absolute path that keeps link names, except where a following `..` would lead elsewhere."""
    path, real = os.path.abspath(name), os.path.realpath(name)  # noqa: PTH100 -- Path.absolute keeps `..`
    return path if os.path.realpath(path) == real else real


def _found(pattern: str, results: str) -> list[str]:
    below = f"{results.replace(':///', '://')}/"
    urls = [url for url in find(pattern) if not (results and url.replace(":///", "://").startswith(below))]
    if not urls:
        raise InputError(
            f"{without_secrets(pattern)}: finds no file; check the pattern, and your permission to list the folder",
            id="file-not-found",
        )
    return urls


def _stem(location: str) -> str:
    """Return the file name of a path or URL without suffix; a name of dots only becomes underscores."""
    stem = PurePosixPath(without_secrets(location) if is_url(location) else in_text(location)).stem
    return stem if stem.strip(".") else "_" * len(stem)


def _fits(name: str) -> bool:
    return len(name.encode()) <= LONGEST_NAME


def _shown(locations: Sequence[str]) -> dict[str, str]:
    """Return the short name of each path or URL: its path below their common folder, or the URL without secrets."""
    local = [location for location in locations if not is_url(location)]
    common = os.path.commonpath([str(Path(location).parent) for location in local]) if local else ""
    files = {location: Path(location).relative_to(common).as_posix() for location in local}
    return {location: without_secrets(location) if is_url(location) else files[location] for location in locations}


def _with_hash(stem: str, shown: str, taken: set[str]) -> str:
    """Return a unique name made of `stem` and a hash, which file systems accept, and add its key to `taken`, in place.

    Args:
        stem: first part, cut if too long.
        shown: short name of the recording, which is hashed.
        taken: keys of the names in use (`key_of_name`).
    """
    digest = hashlib.sha256(os.fsencode(shown)).hexdigest()
    ends = (f"-{digest[:length]}" for length in range(MIN_DIGITS, len(digest) + 1))
    names = (stem.encode()[: LONGEST_NAME - len(end)].decode(errors="ignore") + end for end in ends)
    name = next(name for name in names if key_of_name(name) not in taken)
    taken.add(key_of_name(name))
    return name
