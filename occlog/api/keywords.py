"""Settings as keyword arguments: found by name, checked as those of the command line."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields
from difflib import get_close_matches
from typing import TypeAlias

import numpy as np

from occlog.errors import UsageError
from occlog.settings import Settings, kind_of, plain_kind
from occlog.settings import item_kind as kind_of_items

Setting: TypeAlias = float | int | str | bool | Sequence[float] | Sequence[str] | None
"""Value of a setting; a text is read as on the command line."""


def settings_by_class(
    verb: str,
    keywords: Mapping[str, Setting],
    classes: Sequence[tuple[str, type[Settings]]],
    arguments: Collection[str],
) -> list[dict[str, object]]:
    """The keywords of each class of settings; one that several classes have is for all of them.

    Args:
        verb: for messages.
        keywords: names and values.
        classes: each after what the names of its settings begin with as keywords; most begin with nothing.
        arguments: names of the function's other arguments, for hints.

    Raises:
        UsageError: no class has a setting of that name; the message has the nearest name.
    """
    names = [{begin + f.name: f.name for f in fields(of)} for begin, of in classes]
    known = sorted(set().union(*names))
    for name in keywords:
        if name not in known:
            near = get_close_matches(name, [*arguments, *known], n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has: {', '.join(known)}"
            raise UsageError(f"{verb} has no setting {name!r}; {hint}")
    return [
        {own[name]: declared_value(of, own[name], value) for name, value in keywords.items() if name in own}
        for own, (_, of) in zip(names, classes, strict=True)
    ]


def declared_value(of: type[Settings], name: str, value: object) -> object:
    """A value as the setting's type wants it, so that 1 and 1.0, lists and tuples are the same setting."""
    kind = kind_of(of, name)
    plain = plain_kind(kind)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str) or value is None:
        return value
    if isinstance(value, Iterable):
        items = [v.item() if isinstance(v, np.generic) else v for v in value]
        if plain is str:
            return ",".join(str(v) for v in items)
        floats = kind_of_items(kind) == (tuple, float)
        return tuple(float(v) if floats and isinstance(v, int) and not isinstance(v, bool) else v for v in items)
    if plain is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


def names_of(value: str | Sequence[str]) -> tuple[str, ...]:
    """Names of sensors: one, or several in a list, or separated by commas."""
    texts = [value] if isinstance(value, str) else list(value)
    return tuple(part.strip() for text in texts for part in str(text).split(",") if part.strip())
