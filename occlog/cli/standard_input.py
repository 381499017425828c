"""Standard input as an input file: `-` is kept in a temporary file, since readers look at a file more than once."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from occlog.errors import InputError, OutputError
from occlog.io.files.inputs import STANDARD_INPUT

NAME = "standard input"
KEPT = "occlog.standard_input"
"""Key of the temporary file in the metadata of click's context."""


class Input(click.Path):
    """The path of an input; `-` is standard input."""

    def __init__(self) -> None:
        """A path; whoever reads the file says whether it is there."""
        super().__init__(path_type=Path, allow_dash=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; that of the temporary file for `-`, which one input alone may name."""
        if str(value) != STANDARD_INPUT or ctx is None or ctx.resilient_parsing:
            return Path(str(super().convert(value, param, ctx)))
        root = ctx.find_root()
        if KEPT in root.meta:
            self.fail("standard input (-) is an input already; name a file.", param, ctx)
        root.meta[KEPT] = _keep(root)
        return Path(root.meta[KEPT])


def _keep(root: click.Context) -> Path:
    """Copy standard input to a file that is removed when the command ends, however it ends.

    The file is called `-`: the name that provenance has for it.
    """
    import shutil
    import tempfile

    if sys.stdin is None or sys.stdin.isatty():
        raise InputError(f"{NAME}: is a terminal; name a file, or pipe one into the command")
    folder = tempfile.mkdtemp(prefix="occlog-")
    root.call_on_close(lambda: shutil.rmtree(folder, ignore_errors=True))
    path = Path(folder) / STANDARD_INPUT
    _KEPT_AS.append(str(path))
    try:
        with path.open("wb") as file:
            shutil.copyfileobj(sys.stdin.buffer, file, 1 << 20)
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot keep standard input: {error.strerror or error}; free some space"
        ) from error
    if not path.stat().st_size:
        raise InputError(f"{NAME}: is empty; the command before the pipe wrote nothing")
    return path


_KEPT_AS: list[str] = []


def named(text: str) -> str:
    """A text for the user, with `standard input` for the name of the temporary file."""
    for path in _KEPT_AS:
        text = text.replace(path, NAME)
    return text
