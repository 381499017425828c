"""Names of cameras and arrays as files give them, matched with the names in use."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from occlog.errors import InputError

from .last_number import last_number


def match_sensor(given: str, names: Sequence[str], where: str, *, what: str = "camera") -> str:
    """The name in use that a file means by `given`.

    It is the equal name, or else the only one whose last number is the same: `2`,
    `cam_2` and `cam02` mean each other.  InputError where there is none, or several; `what` says what has the name.
    """
    if given in names:
        return given
    number = _last_number(given)
    same = [name for name in names if number is not None and _last_number(name) == number]
    if len(same) == 1:
        return same[0]
    found = f"may be any of {', '.join(same)}" if same else f"is none of {', '.join(names) or f'the {what}s (none)'}"
    raise InputError(f"{where}: {what} {given!r} {found}; give them equal names")


def check_meaning(meant: dict[str, str], label: str, name: str, where: str, *, what: str = "camera") -> None:
    """InputError where a file calls one sensor by two labels, as `cam1` and `cam01`: they may be two sensors.

    Args:
        meant: the label of each name so far; this one is added.
        label: as the file has it.
        name: what `match_sensor` takes it for.
        where: the file.
        what: what has the name.
    """
    other = meant.setdefault(name, label)
    if other != label:
        raise InputError(f"{where}: {what}s {other!r} and {label!r} would both be {name}; give them names in use")


def means_none(given: str, names: Sequence[str]) -> bool:
    """Whether no name in use is what a file may mean by `given`, as `match_sensor` takes it."""
    number = _last_number(given)
    return given not in names and (number is None or all(_last_number(name) != number for name in names))


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Sort key in which cam2 comes before cam10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in re.split(r"(\d+)", name) if part]


def natural_sorted(names: Iterable[str]) -> list[str]:
    """Names in the order a person expects."""
    return sorted(names, key=lambda name: (natural_key(name), name))


def safe_name(text: str) -> str:
    """A name that scene files allow: blanks, control characters and , / = : become `_`; InputError for an empty one."""
    name = re.sub(r"[\s,/=:\x00-\x1f\x7f-\x9f]+", "_", text.strip())[:64]
    if not name:
        raise InputError(f"{text!r}: cannot be the name of a sensor; use letters and digits")
    return name


def _last_number(name: str) -> int | None:
    found = last_number(name)
    return None if found is None else int(found)
