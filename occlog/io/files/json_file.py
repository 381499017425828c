"""JSON files: written with sorted keys, numbers that are not finite as null, atomically; read into structs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from occlog.errors import InputError

from .atomic import write_bytes
from .inputs import check_input

S = TypeVar("S", bound=msgspec.Struct)


def write_json(path: Path, values: Mapping[str, object], *, overwrite: bool = False) -> None:
    """Write one object; NaN and infinity become null."""
    write_bytes(path, (json.dumps(_plain(values), sort_keys=True, indent=2) + "\n").encode(), overwrite)


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file; InputError names the line of what is wrong."""
    check_input(path, "a JSON file")
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start}: not UTF-8 text") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: line {error.lineno}: not valid JSON: {error.msg}") from error
    if not isinstance(values, dict):
        raise InputError(f"{path}: want a JSON object, got {type(values).__name__}")
    return values


def struct_of(values: object, kind: type[S], *, key: str, source: Path | str, otherwise: str) -> S:
    """Convert an object of JSON to the struct that describes its format.

    Args:
        values: what was read.
        kind: the struct.
        key: that every object of the format has.
        source: the file, for messages.
        otherwise: what an object without the key is not, and how to make one.

    Raises:
        InputError: the object has no such key, or a field is wrong: one line that names it.
    """
    if not isinstance(values, Mapping) or key not in values:
        raise InputError(f"{source}: {otherwise}")
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{source}: {error}") from error


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
