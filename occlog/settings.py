"""Settings of a method from names and values, with one-line errors."""

from __future__ import annotations

import difflib
import math
import types
import typing
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

from occlog.errors import InputError, UsageError

C = TypeVar("C")


def configure(config: C, values: Mapping[str, Any], method: str) -> C:
    """The settings with some of them replaced; texts are read as the type of the setting.

    UsageError names a setting that the method does not have, or a value that is none.
    """
    kinds = typing.get_type_hints(type(config))
    known = [f.name for f in fields(config)]  # type: ignore[arg-type]
    changed = {}
    for name, value in values.items():
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has: {', '.join(known)}"
            raise UsageError(f"method {method} has no setting {name!r}; {hint}")
        changed[name] = _read(value, kinds[name], name) if isinstance(value, str) else value
    return replace(config, **changed)  # type: ignore[type-var]


def _read(text: str, kind: Any, name: str) -> Any:
    options = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    if types.NoneType in options and text.strip().lower() in ("none", ""):
        return None
    kind = next(k for k in options if k is not types.NoneType)
    truths = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    try:
        if kind is bool:
            return truths[text.strip().lower()]
        if typing.get_origin(kind) is tuple:
            return tuple(float(part) for part in text.split(","))
        return kind(text)
    except (ValueError, KeyError) as error:
        what = {int: "a whole number", float: "a number", bool: "true or false"}.get(kind, "numbers with commas")
        raise UsageError(f"setting {name}: want {what}, got {text!r}") from error


def check_settings(config: Any, method: str, limits: Iterable[tuple[str, bool, str]]) -> None:
    """InputError for a setting that is not finite or breaks its limit (name, whether it holds, what it is)."""
    for f in fields(config):
        value = getattr(config, f.name)
        numbers = value if isinstance(value, tuple) else (value,)
        if any(isinstance(n, float) and not math.isfinite(n) for n in numbers):
            raise InputError(f"{method}: {f.name} is {value}, must be finite")
    for name, holds, limit in limits:
        if not holds:
            raise InputError(f"{method}: {name} is {getattr(config, name)}, must be {limit}")
