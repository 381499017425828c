"""What a folder holds: a line for each file that occlog reads, and how many others there are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path

from occlog.console.text import counted
from occlog.errors import InputError

MOST = 1000
"""Entries of a folder that are looked at."""
PART = re.compile(r"_\d+$")
"""What the names of files of one split bag end with."""
CONTAINERS = (".mcap", ".db3", ".zstd")

Described = tuple[Mapping[str, object], list[str]]


def is_one_bag(folder: Path) -> bool:
    """Whether the files of a folder are one bag of ROS 2: it has the bag's metadata, or they are parts of one name."""
    from occlog.io.messages.bag import METADATA, is_bag
    from occlog.io.recording.reader import open_recording

    if (folder / METADATA).is_file():
        return True
    if not is_bag(folder):
        return False
    files = [path for path in folder.iterdir() if path.suffix in CONTAINERS]
    if len({PART.sub("", path.name.split(".")[0]) for path in files}) != 1:
        return False
    try:
        return not any(path.suffix == ".mcap" and open_recording(path).ours for path in files)
    except InputError:
        return True


def describe_folder(folder: Path, describe: Callable[[Path], Described]) -> Described:
    """Describe each file of a folder in one line.

    Args:
        folder: whose entries are looked at, up to `MOST`; those of its own folders that are bags, too.
        describe: values and lines of one file; InputError where it is none that occlog reads.

    Raises:
        InputError: the folder is empty, or cannot be listed.
    """
    try:
        entries = sorted(islice(folder.iterdir(), MOST + 1))
    except OSError as error:
        raise InputError(f"{folder}: cannot be listed: {error.strerror or error}") from error
    if not entries:
        raise InputError(f"{folder}: is an empty folder")
    files: list[Mapping[str, object]] = []
    lines, others = [], Counter[str]()
    width = max(len(path.name) for path in entries[:MOST])
    for path in entries[:MOST]:
        try:
            if path.is_dir() and not is_one_bag(path):
                others["folder"] += 1
                continue
            values, said = describe(path)
        except InputError as error:
            if path.suffix.lower() not in (".mcap", ".parquet", ".db3"):
                others[path.suffix.lower() or "without an ending"] += 1
                continue
            values, said = {"kind": "unreadable", "error": str(error)}, [f"cannot be read: {error}"]
        files.append({"file": path.name, **values})
        time = "".join(f", {line.removeprefix('time').strip()}" for line in said[1:2] if line.startswith("time"))
        lines.append(f"{path.name:<{width}}  {said[0]}{time}")
    head = f"folder, {counted(len(files), 'file')} that occlog reads"
    more = [f"{n} x {what}" for what, n in sorted(others.items())]
    more += [f"entries after the first {MOST} were not looked at"] if len(entries) > MOST else []
    values = {
        "kind": "folder",
        "files": files,
        "others": dict(sorted(others.items())),
        "complete": len(entries) <= MOST,
    }
    return values, [head, *lines, *([f"others: {', '.join(more)}"] if more else [])]
