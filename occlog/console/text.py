"""Formatting of counts, times and untrusted text in messages and summaries."""

from __future__ import annotations

import re

LONGEST = 400
"""Characters of a line that is reported, at most."""
LONGEST_QUOTED = 80
"""Characters of a value in quotes in such a line: it may come from a file."""
_QUOTED = re.compile(rf"(?<![\w'])'([^'\n]{{{LONGEST_QUOTED + 1},}})'(?!\w)")
_INVISIBLE = r"\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\U000e0000-\U000e007f"
_CONTROL = re.compile(rf"[\x00-\x08\x0b-\x1f{_INVISIBLE}]")
_FOREIGN = re.compile(rf"[\x00-\x06\x0b\x0c\x0e-\x1a\x1c-\x1f{_INVISIBLE}]")
"""As `_CONTROL`, without what progress bars and colours write: backspace, carriage return, escape and bell."""


def noun(count: float, one: str, many: str = "") -> str:
    """Return the noun for a count: `one` for 1, else `many` (empty: `one` with an s)."""
    return one if count == 1 else many or f"{one}s"


def counted(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun: `1 camera`, `2 cameras`, and `2 boxes` with one="box", many="boxes"."""
    return f"{count} {noun(count, one, many)}"


def in_seconds(t_ns: int) -> str:
    """Return a time [ns] in seconds with all digits: `1.25` for 1,250,000,000 ns."""
    whole, rest = divmod(abs(t_ns), 10**9)
    text = f"{whole}.{rest:09d}".rstrip("0").rstrip(".")
    return f"-{text}" if t_ns < 0 else text


def as_bytes(text: str) -> bytes:
    r"""Return a text in UTF-8; invalid bytes of file names become escapes (`\udce9`)."""
    return text.encode(errors="backslashreplace")


def escaped(text: str, *, bars: bool = False) -> str:
    r"""Return a text with escapes for control characters and those that change the writing direction (`\u202e`).

    Line ends and tabs are kept; with `bars` also the cursor controls of progress bars.
    """
    return (_FOREIGN if bars else _CONTROL).sub(lambda found: ascii(found[0])[1:-1], text)


def shortened(text: str) -> str:
    r"""Make a text safe for a terminal: parts of it come from files.

    Control characters (except line ends and tabs) and those that change the writing direction are escaped (`\x1b`);
    long quoted values (`LONGEST_QUOTED`) and long texts (`LONGEST`) are shortened in the middle.
    """
    plain = _QUOTED.sub(lambda found: f"'{found[1][: LONGEST_QUOTED // 2]}[...]{found[1][-10:]}'", escaped(text))
    return plain if len(plain) <= LONGEST else f"{plain[: LONGEST * 2 // 3]} [...] {plain[-LONGEST // 4 :]}"
