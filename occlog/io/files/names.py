"""Names of files and sensors: matching, sorting, and checks.

The last number in the name of a file or sensor is its frame or camera number. The suffix of an output states its
format; one of a format that is not written there is refused. Sensor names in files are matched with those in use.
Libraries that accept only UTF-8 paths get a safe name.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from occlog.errors import InputError, UsageError

_LAST = re.compile(r"(?<!\d)(\d+)\D*$")
_HASH = re.compile(r"\.rf\.[0-9A-Za-z]+$")


def last_number(name: str) -> str | None:
    """Digits of the last number in a file name without its suffix, as text (`cam_007` gives `007`).

    None if there is none. The `.rf.` and hash that Roboflow appends to names of images are ignored.
    """
    found = _LAST.search(_HASH.sub("", name))
    return found.group(1) if found else None


TABLE, RECORDING = ".parquet", ".mcap"
WRITTEN = {
    TABLE: ("tables", "Parquet"),
    RECORDING: ("recordings", "MCAP"),
    ".html": ("pages", "HTML"),
    ".md": ("reports", "Markdown"),
    ".png": ("pictures", "PNG"),
}
"""Content of files with an ending, and the name of the format."""
PROMISING = (
    *(".csv", ".tsv", ".txt", ".json", ".jsonl", ".geojson", ".xlsx", ".feather", ".arrow", ".npz", ".mat"),
    *(".yaml", ".yml", ".pdf", ".svg", ".jpg", ".mp4", ".gz", *WRITTEN),
)
"""Endings of names that promise a format."""


def check_output_name(path: Path, ending: str) -> None:
    """UsageError if an output has a suffix that promises another format than `ending`, the suffix of its own format."""
    suffix = Path(path).suffix.lower()
    if suffix in PROMISING and suffix != ending:
        what, form = WRITTEN[ending]
        raise UsageError(
            f"{path}: {what} are written as {form}, not {suffix}; name it {Path(path).stem}{ending}",
        )


def match_sensor(given: str, names: Sequence[str], where: str, *, what: str = "camera") -> str:
    """Return the name among `names` (those in use) that is meant by `given`, a name in a file.

    It is the equal name, else the only one that is equal but for the case of letters, else the only one with the same
    last number: `2`, `cam_2` and `cam02` mean each other.

    Args:
        given: name in the file.
        names: names in use.
        where: the file, for the message.
        what: kind of thing that is named, for the message.

    Raises:
        InputError: no name, or several, are meant.
    """
    if given in names:
        return given
    number = _last_number(given)
    same = [name for name in names if name.lower() == given.lower()]
    same = same or [name for name in names if number is not None and _last_number(name) == number]
    if len(same) == 1:
        return same[0]
    found = f"may be any of {', '.join(same)}" if same else f"is none of {', '.join(names) or f'the {what}s (none)'}"
    raise InputError(f"{where}: {what} {given!r} {found}; use the same name in all inputs")


def check_meaning(meant: dict[str, str], label: str, name: str, where: str, *, what: str = "camera") -> None:
    """InputError if a file names one sensor by two labels, such as `cam1` and `cam01`, which may be two sensors.

    Args:
        meant: label in the file by name in use; this one is added.
        label: as the file has it.
        name: name in use that it is matched with (`match_sensor`).
        where: the file.
        what: kind of thing that is named.
    """
    other = meant.setdefault(name, label)
    if other != label:
        raise InputError(
            f"{where}: {what}s {other!r} and {label!r} would both be taken for {name}; write the exact name of each",
            id="duplicate-name",
        )


def means_none(given: str, names: Sequence[str]) -> bool:
    """Whether `given` matches none of `names`, neither without the case of letters nor by its last number."""
    number = _last_number(given)
    return not any(
        name.lower() == given.lower() or (number is not None and _last_number(name) == number) for name in names
    )


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key in which cam2 comes before cam10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def natural_sorted(names: Iterable[str]) -> list[str]:
    """Names sorted in natural order, in which cam2 comes before cam10."""
    return sorted(names, key=lambda name: (natural_key(name), name))


def is_hidden(path: Path) -> bool:
    """Whether the name of a file begins with a dot, as those that systems add (`._a.png` and `.DS_Store` of macOS)."""
    return path.name.startswith(".")


def safe_name(text: str) -> str:
    """Convert a text to a name allowed in scene files, of at most 64 characters.

    Blanks, control characters and `,` `/` `=` `:` become `_`. InputError for an empty text.
    """
    name = re.sub(r"[\s,/=:\x00-\x1f\x7f-\x9f]+", "_", text.strip())[:64]
    if not name:
        raise InputError(f"{text!r}: cannot be the name of a sensor; use letters and digits")
    return name


def _last_number(name: str) -> int | None:
    found = last_number(name)
    return None if found is None else int(found)


def is_utf8(name: str) -> bool:
    """Whether the bytes of a file name are valid UTF-8 (on Linux they may be anything)."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


@contextmanager
def utf8_name(path: Path) -> Iterator[str]:
    """Context manager: valid UTF-8 path to a file, through /proc/self/fd if its own path is not valid UTF-8.

    The file exists, or is to be created in an existing folder.
    """
    if is_utf8(str(path)):
        yield str(path)
        return
    # The name of a descriptor is plain; a file that is not there yet is found through its folder's.
    there = path.exists()
    descriptor = os.open(path if there else path.parent, os.O_RDONLY)
    try:
        yield f"/proc/self/fd/{descriptor}" + ("" if there else f"/{path.name}")
    finally:
        os.close(descriptor)
