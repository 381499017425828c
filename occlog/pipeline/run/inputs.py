"""The files that an argument of a stage names, and those that are read beside them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from occlog.errors import InputError
from occlog.io.boxes.folder import names_of_classes
from occlog.io.models.onnx_file import read_onnx
from occlog.io.recording.reader import linked_videos

NETWORK = ".onnx"


def places_of(argument: str) -> list[Path]:
    """The paths that an argument may mean and that are there: the whole of it, and what `NAME=` stands before."""
    texts = dict.fromkeys((argument, argument.split("=", 1)[-1]))
    # A title may be longer than any name of a file, of which Path.exists would complain
    return [Path(text) for text in texts if text and os.path.exists(text)]  # noqa: PTH110


def files_of(argument: str) -> list[Path]:
    """Files that an argument names, with what is read beside them.

    Of a recording these are the videos that it links to, of a network its weights, of folders with labels the names of
    their classes; of a folder all its files.
    """
    found: dict[Path, None] = {}
    for path in places_of(argument):
        found |= dict.fromkeys([path] if path.is_file() else sorted(path.rglob("*")))
        found |= dict.fromkeys(_beside(path))
    return [file for file in found if file.is_file()]


def _beside(path: Path) -> Iterator[Path]:
    if path.is_dir():
        for folder in (path, *sorted(each for each in path.rglob("*") if each.is_dir())):
            names = names_of_classes(folder)
            if names is not None:
                yield names
    elif path.suffix.lower() == NETWORK and path.is_file():
        try:
            yield from read_onnx(path).weights
        except InputError:  # whoever reads it says so
            return
    elif path.is_file():
        yield from linked_videos(path)


def name_of(file: Path, argument: str) -> str:
    """What a file of `files_of` is known by, wherever its folder lies: its name, in a folder with the way to it."""
    folders = (path for path in places_of(argument) if path.is_dir() and file.is_relative_to(path))
    return next((file.relative_to(path).as_posix() for path in folders), file.name)
