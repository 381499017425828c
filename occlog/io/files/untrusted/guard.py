"""The border that foreign bytes cross: sizes before reading, and one line for whatever a parser raises.

Parsers fail in more ways than they say: a date of a 99th month is a ValueError, a list as a key a TypeError, brackets
within brackets a RecursionError.  Each is called inside `guarded`, on bytes whose number was looked at before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from occlog.errors import InputError

from .inputs import check_input

MAX_CONFIGURATION_BYTES = 4_000_000
"""Size of a text that describes something and holds no rows: scenes, calibrations, settings."""
LONG_TEXT = 1_000
"""Characters of a text that a column of many rows may hold, whatever their number."""
MAX_TEXTS_BYTES = 2**28
"""Memory of a column with longer texts at most: each of its rows takes as much as the longest."""
FAILURES = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError)
"""What parsers raise for bytes that they do not expect, each besides an exception of its own."""


@contextmanager
def guarded(where: Path | str, what: str) -> Iterator[None]:
    """Turn every failure of a parser into one InputError.

    Args:
        where: the file, and the place in it.
        what: what was expected.

    Raises:
        InputError: the parser failed; its own InputError goes through as it is.
    """
    try:
        yield
    except RecursionError:
        raise InputError(f"{where}: nested too deeply; {what} was expected") from None
    except FAILURES as error:
        reason = " ".join(str(error).split())[:140] or type(error).__name__
        raise InputError(f"{where}: cannot be read ({reason}); {what} was expected") from error


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the file before what a table that is made of its rows says of them."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_configuration(path: Path, what: str, *, limit: int = MAX_CONFIGURATION_BYTES) -> str:
    """The text of a file of at most `limit` bytes; InputError for anything else; `what` was expected."""
    path = check_input(path, what)
    size = path.stat().st_size
    if size > limit:
        raise InputError(f"{path}: {size} bytes; {what} was expected, of at most {limit} bytes")
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start}: not UTF-8 text; {what} was expected") from error


def check_texts(texts: Iterable[str], rows: int, where: Path | str) -> None:
    """InputError for texts that are too long for a column of so many rows, or that no array holds (with a NUL)."""
    different = set(texts)
    cut = next((text for text in different if "\0" in text), None)
    if cut is not None:
        raise InputError(
            f"{where}: {cut[:40]!r}: a text has no character 0, behind which it would be cut off; rename it"
        )
    longest = max(map(len, different), default=0)
    if longest > LONG_TEXT and 4 * longest * rows > MAX_TEXTS_BYTES:
        raise InputError(f"{where}: a text of {longest} characters in {rows} rows; shorten it to {LONG_TEXT}")


def check_text(value: str, where: Path | str) -> None:
    """InputError for a text with half of a pair of surrogates, which no file can hold."""
    try:
        value.encode()
    except UnicodeEncodeError as error:
        half = f"\\u{ord(value[error.start]):04x}"
        raise InputError(f"{where}: {half} is half a character; write the whole character") from None
