"""Input files on the command line: check of existence, and `-` for standard input.

Standard input is kept in a temporary file, since readers read a file more than once.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from occlog.console.notes import ALIASES
from occlog.errors import InputError, OutputError
from occlog.io.files.limits import STANDARD_INPUT

NAME = "standard input"
MAX_NAMES = 10_000
"""Number of names of a folder that are searched for one similar to a missing one."""
KEPT = "occlog.standard_input"
"""Key of the temporary file in the metadata of click's context."""


class Input(click.Path):
    """Parameter type: path of an input; `-` is standard input."""

    def __init__(self, *, some: bool = False) -> None:
        """Create the type; existence is checked later by `check_there`, readability by the reader.

        `some`: of several paths some may be missing, which the command reports itself.
        """
        super().__init__(path_type=Path, allow_dash=True)
        self.some = some

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Return the path that `value` names; for `-` that of a temporary file with the content of standard input.

        Usage error if `-` is given for a second input.
        """
        if str(value) != STANDARD_INPUT or ctx is None or ctx.resilient_parsing:
            return Path(str(super().convert(value, param, ctx)))
        root = ctx.find_root()
        if KEPT in root.meta:
            self.fail("standard input (-) is an input already; name a file.", param, ctx)
        root.meta[KEPT] = root.with_resource(standard_input())
        return Path(root.meta[KEPT])


def check_there(ctx: click.Context) -> None:
    """Raise InputError, with the most similar name in the folder, if an input of the command is missing.

    It is called before the command's modules are imported, which takes much longer.
    """
    for param in ctx.command.get_params(ctx):
        if not isinstance(param.type, Input) or param.name is None:
            continue
        value = ctx.params.get(param.name)
        paths = [path for path in (value if isinstance(value, tuple) else (value,)) if isinstance(path, Path)]
        missing = [path for path in paths if is_missing(path)]
        if missing and not (param.type.some and len(missing) < len(paths)):
            raise no_such_file(missing[0])


def no_such_file(path: Path) -> InputError:
    """Return the error for a missing file, with the most similar name in its folder."""
    return InputError(f"{path}: no such file{_nearest(path)}", id="file-not-found")


def is_missing(path: Path) -> bool:
    """Return whether no file or folder of that name exists; False if it cannot be accessed."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except OSError:
        # Its reader states why it cannot be read
        return False
    return False


def _nearest(path: Path) -> str:
    """Return a hint at the most similar name in the same folder, or a general one, as the end of a message."""
    import difflib
    import itertools

    try:
        names = [entry.name for entry in itertools.islice(path.parent.iterdir(), MAX_NAMES)]
    except OSError:
        names = []
    near = difflib.get_close_matches(path.name, names, n=1)
    return f"; did you mean {path.with_name(near[0])}?" if near else "; check the name and the folder"


@contextmanager
def standard_input() -> Iterator[Path]:
    """Context manager that copies standard input to a temporary file named `-`, and yields its path.

    Provenance then has this name. InputError if standard input is a terminal or empty.
    """
    import tempfile

    if sys.stdin is None or sys.stdin.isatty():
        raise InputError(f"{NAME}: is a terminal; name a file, or pipe one into the command", id="not-a-file")
    with tempfile.TemporaryDirectory(prefix="occlog-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / STANDARD_INPUT
        ALIASES[str(path)] = NAME
        _copy(path)
        yield path


def _copy(path: Path) -> None:
    """Write all of standard input to the file at `path`."""
    import shutil

    try:
        with path.open("wb") as file:
            shutil.copyfileobj(sys.stdin.buffer, file, 1 << 20)
    except OSError as error:
        raise OutputError(
            f"{path.parent}: cannot keep standard input: {error.strerror or error}; free some space"
        ) from error
    if not path.stat().st_size:
        raise InputError(f"{NAME}: is empty; the command before the pipe wrote nothing", id="empty-input")
