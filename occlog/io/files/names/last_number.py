"""The last number in the name of a file or sensor: its frame, or which camera it is."""

from __future__ import annotations

import re

_LAST = re.compile(r"(?<!\d)(\d+)\D*$")
_HASH = re.compile(r"\.rf\.[0-9A-Za-z]+$")


def last_number(name: str) -> str | None:
    """Digits of the last number in a name without its ending; None where there is none.

    Roboflow writes `.rf.` and a hash behind the names of images; its digits number nothing.
    """
    found = _LAST.search(_HASH.sub("", name))
    return found.group(1) if found else None
