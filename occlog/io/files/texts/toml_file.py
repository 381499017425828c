"""TOML of other programs: a text of bounded keys to its values."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from occlog.errors import InputError
from occlog.io.files.untrusted.guard import guarded

MAX_KEY_PARTS = 100
"""Parts of a dotted key in TOML; its parser takes the square of their number."""
MAX_TOML_BYTES = 1_000_000
"""Of a text at most: its parser takes some ten microseconds and a kilobyte for each table, of ten bytes or less."""
_LONG_KEY = re.compile(rf"^[^=#\n]*(?:\.[^=#\n.]*){{{MAX_KEY_PARTS},}}", re.MULTILINE)


def toml_values(text: str, where: Path | str, what: str) -> Mapping[str, Any]:
    """The values of a TOML text; InputError for anything else."""
    size = len(text.encode(errors="replace"))
    if size > MAX_TOML_BYTES:
        raise InputError(f"{where}: {size} bytes; {what} was expected, in TOML of at most {MAX_TOML_BYTES} bytes")
    if _LONG_KEY.search(text):
        raise InputError(f"{where}: a key of more than {MAX_KEY_PARTS} parts; {what} was expected")
    with guarded(where, what):
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise InputError(f"{where}: not TOML ({error}); correct this line") from None
